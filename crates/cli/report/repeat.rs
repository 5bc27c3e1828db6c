//! The command line that makes a volume again, from what the file says of its settings.

use gdibl_baker::job::records::SettingsRecord;
use gdibl_baker::job::{ROWS, Settings};

/// Names of the settings that differ from what a bake without any flag takes.
pub fn changed_names(record: &SettingsRecord) -> Vec<String> {
    changed(record).map(|(name, _)| name.to_owned()).collect()
}

/// `gdibl bake LEVEL --flag value …`; `None` where the file names no level. Names are without their folders, as in the file.
pub fn command(record: &SettingsRecord) -> Option<String> {
    let of_role = |role: &'static str| record.inputs.iter().filter(move |input| input.role == role);
    let level = of_role("level").next()?;
    let mut words = vec!["gdibl".into(), "bake".into(), quoted(&level.name)];
    let flags = [("distant", "--distant"), ("environment", "--environment"), ("probe", "--probes")];
    for (role, flag) in flags {
        let files = of_role(role);
        // Files that an environment refers to have its role, too: the first is its own.
        let count = if role == "probe" { usize::MAX } else { 1 };
        files.take(count).for_each(|file| words.extend([flag.into(), quoted(&file.name)]));
    }
    for (name, value) in changed(record) {
        let Some(row) = ROWS.iter().find(|row| row.full_name() == name) else { continue };
        let flag = format!("--{}", row.flag());
        match (row.is_switch, row.is_list) {
            (true, _) if value == "true" => words.push(flag),
            (true, _) => words.push(format!("{flag}={value}")),
            (false, true) => value.split(';').for_each(|item| words.extend([flag.clone(), quoted(item)])),
            (false, false) => words.extend([flag, quoted(value)]),
        }
    }
    Some(words.join(" "))
}

/// Settings that are set to something else than by default.
fn changed(record: &SettingsRecord) -> impl Iterator<Item = (&str, &str)> {
    let mut usual = Settings::default();
    usual.quality.target_error = record.target_error;
    let mut usual = usual.recorded();
    // It was taken for the usual number of samples alone.
    usual.retain(|(name, _)| name != "quality.target_error");
    record.settings.iter().filter_map(move |setting| {
        let value = setting.value.as_deref()?;
        let same = usual.iter().any(|(name, usual)| *name == setting.name && usual.as_deref() == Some(value));
        (!same).then_some((setting.name.as_str(), value))
    })
}

/// As a shell takes it for one word.
fn quoted(text: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_.,:/=+".contains(c);
    if !text.is_empty() && text.chars().all(is_plain) {
        text.into()
    } else {
        format!("'{}'", text.replace('\'', r"'\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gdibl_baker::job::records::{InputRecord, SettingRecord};

    fn record(changes: &[(&str, &str, &str)], inputs: &[(&str, &str)]) -> SettingsRecord {
        let mut settings = Settings::default();
        for (section, name, text) in changes {
            settings.set(section, name, &[text]).unwrap();
        }
        SettingsRecord {
            target_error: settings.quality.target_error,
            settings: settings.recorded().into_iter().map(|(name, value)| SettingRecord { name, value }).collect(),
            inputs: inputs
                .iter()
                .map(|(role, name)| InputRecord {
                    role: (*role).into(),
                    name: (*name).into(),
                    bytes: 1,
                    blake3: [0; 32],
                })
                .collect(),
            ..SettingsRecord::default()
        }
    }

    #[test]
    fn the_command_names_inputs_and_what_differs_from_defaults() {
        let changes = [
            ("grid", "spacing", "0.5"),
            ("quality", "zstd", "true"),
            ("quality", "target_error", "0.01"),
            ("capture", "positions", "1,2,3;4,5,6"),
        ];
        let inputs = [
            ("level", "a b.glb"),
            ("level", "texture.png"),
            ("distant", "sky.hdr"),
            ("probe", "1.exr"),
            ("probe", "2.exr"),
        ];
        assert_eq!(
            command(&record(&changes, &inputs)).unwrap(),
            "gdibl bake 'a b.glb' --distant sky.hdr --probes 1.exr --probes 2.exr --spacing 0.5 --target-error 0.01 --zstd \
             --position 1,2,3 --position 4,5,6"
        );
        assert_eq!(command(&record(&[], &[("level", "a.glb")])).unwrap(), "gdibl bake a.glb");
        assert_eq!(command(&record(&[], &[])), None);
    }

    #[test]
    fn names_from_files_stay_one_word_of_a_shell() {
        assert_eq!(quoted("$(rm x)'s"), r"'$(rm x)'\''s'");
    }
}
