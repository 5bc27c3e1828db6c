//! Custom properties: `gdibl_*` in the `extras` of nodes, meshes and materials. Every one that is not understood is said, wherever in
//! the file it stands: a word that is spelt wrongly, or stands in the wrong place, would else change nothing without a word.

use serde_json::{Map, Value};

use super::findings::Findings;
use crate::scene::Role;
use crate::{Error, Result};

/// What is read on nodes; on meshes and materials, of these, the role.
pub(super) const KEYS: [&str; 3] = [ROLE, "gdibl_probe", VOLUME];
const VOLUME: &str = "gdibl_volume";
/// How our properties begin.
pub(super) const OURS: &str = "gdibl_";
pub(super) const ROLE: &str = "gdibl_role";

/// What a role says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Said {
    Role(Role),
    Ignore,
}

/// Reads a role; an error says what it must be. `place`: whose extras they are.
pub(super) fn role(
    value: Option<&Value>,
    place: impl FnOnce() -> String,
    invalid: impl FnOnce(String) -> Error,
) -> Result<Option<Said>> {
    let Some(value) = value else { return Ok(None) };
    match value.as_str() {
        Some("environment") => Ok(Some(Said::Role(Role::Environment))),
        Some("scene") => Ok(Some(Said::Role(Role::Scene))),
        Some("ignore") => Ok(Some(Said::Ignore)),
        _ => Err(invalid(format!(
            "{}: extras.gdibl_role is {value}; expected \"environment\", \"scene\" or \"ignore\"",
            place()
        ))),
    }
}

/// The roles of the elements of a list of the file.
pub(super) fn roles(root: &Map<String, Value>, list: &str) -> Vec<Option<Value>> {
    let elements = root.get(list).and_then(Value::as_array);
    elements.map_or_else(Vec::new, |elements| {
        elements.iter().map(|element| element.get("extras")?.get(ROLE).cloned()).collect()
    })
}

/// Says which properties of the file are not understood.
pub(super) fn check(root: &Map<String, Value>, findings: &mut Findings) {
    let mut unknown = Vec::new();
    for (name, value) in root {
        match (name.as_str(), value) {
            ("extras", extras) => check_extras(extras, "the file", &[], &mut unknown),
            (_, Value::Array(elements)) => {
                let known = match name.as_str() {
                    "nodes" => &KEYS[..],
                    "meshes" | "materials" => &KEYS[..1],
                    _ => &[],
                };
                for (index, element) in elements.iter().enumerate() {
                    walk(element, &|| format!("{name}[{index}]"), known, &mut unknown);
                }
            }
            (_, value) => walk(value, &|| name.clone(), &[], &mut unknown),
        }
    }
    findings.add("unknown-properties", unknown.len() as u64, || {
        format!(
            "Custom properties that gdibl does not know there were ignored: {}; it reads {} of nodes, and {ROLE} of meshes \
             and materials",
            unknown.join(", "),
            KEYS.join(", ")
        )
    });
}

/// Looks into the extras of an object (where `known` counts) and of all below it.
fn walk(value: &Value, place: &dyn Fn() -> String, known: &[&str], unknown: &mut Vec<String>) {
    match value {
        Value::Object(object) => {
            for (name, member) in object {
                match (name.as_str(), member) {
                    ("extras", extras) => check_extras(extras, &place(), known, unknown),
                    (_, Value::Object(_) | Value::Array(_)) => {
                        walk(member, &|| format!("{}.{name}", place()), &[], unknown);
                    }
                    _ => {}
                }
            }
        }
        Value::Array(elements) => {
            let elements = elements.iter().enumerate().filter(|(_, element)| !element.is_number());
            elements.for_each(|(index, element)| walk(element, &|| format!("{}[{index}]", place()), &[], unknown));
        }
        _ => {}
    }
}

/// At most so many are named.
const NAMED: usize = 20;

fn check_extras(extras: &Value, place: &str, known: &[&str], unknown: &mut Vec<String>) {
    let Some(extras) = extras.as_object() else { return };
    // Who bakes a volume knows its settings, and refuses others.
    let has_settings = known.contains(&VOLUME) && extras.contains_key(VOLUME);
    for (key, value) in extras {
        let is_ours = key.get(..5).is_some_and(|start| start.eq_ignore_ascii_case("gdibl"));
        let is_known = known.contains(&key.as_str()) || (has_settings && key.starts_with(OURS));
        if is_ours && !is_known && unknown.len() < NAMED {
            unknown.push(format!("{place}.extras.{key} = {value}"));
        }
    }
}
