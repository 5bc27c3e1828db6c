//! Flags made from the table of settings: the same names, texts and help as in BAKE.toml and in the record of a file.

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Arg, ArgAction, ArgMatches, Command};
use gdibl_baker::job::{ROWS, Row};
use std::marker::PhantomData;

/// A setting and the texts that were given for it.
#[derive(Clone, Debug)]
pub struct Given {
    pub section: &'static str,
    pub name: &'static str,
    pub texts: Vec<String>,
}

impl Given {
    pub fn new(section: &'static str, name: &'static str, text: impl ToString) -> Given {
        Given { section, name, texts: vec![text.to_string()] }
    }
}

/// Which settings a verb has flags for.
pub trait Which {
    fn has(row: &Row) -> bool;
}

/// All that bakes have.
#[derive(Clone, Debug)]
pub struct OfBakes;

impl Which for OfBakes {
    fn has(row: &Row) -> bool {
        row.section != "capture"
    }
}

/// Those of captures, and of the paths that these trace.
#[derive(Clone, Debug)]
pub struct OfCaptures;

impl Which for OfCaptures {
    fn has(row: &Row) -> bool {
        row.section == "capture" || matches!(row.name, "bounces" | "clamp") || OfReading::has(row)
    }
}

/// Those of pictures.
#[derive(Clone, Debug)]
pub struct OfPictures;

impl Which for OfPictures {
    fn has(row: &Row) -> bool {
        matches!(row.name, "method" | "blend" | "bounces") || OfReading::has(row)
    }
}

/// Those of every verb that reads a level and traces rays.
#[derive(Clone, Debug)]
pub struct OfReading;

impl Which for OfReading {
    fn has(row: &Row) -> bool {
        row.section == "quality"
            && matches!(
                row.name,
                "repair_pixels" | "seed" | "threads" | "metals" | "lumens_per_watt" | "allow_missing_textures"
            )
    }
}

/// The flags of a verb as they were given.
#[derive(Clone, Debug)]
pub struct SettingFlags<W> {
    pub given: Vec<Given>,
    which: PhantomData<W>,
}

fn argument(row: &'static Row) -> Arg {
    let about: Vec<&str> = row.about.lines().map(str::trim).collect();
    let arg = Arg::new(row.full_name()).long(row.flag()).value_name(row.value).help(about.join(" "));
    let arg = if row.is_list { arg.action(ArgAction::Append) } else { arg.action(ArgAction::Set) };
    if row.is_switch {
        let words = PossibleValuesParser::new(row.words.iter().copied());
        return arg
            .num_args(0..=1)
            .require_equals(true)
            .default_missing_value("true")
            .value_parser(words)
            .hide_possible_values(true);
    }
    if !row.words.is_empty() {
        return arg.value_parser(PossibleValuesParser::new(row.words.iter().copied())).hide_possible_values(true);
    }
    let check = row.check;
    let checked = clap::builder::StringValueParser::new().try_map(move |text| check(&[&text]).map(|()| text));
    // Coordinates begin with a minus.
    arg.value_parser(checked).allow_hyphen_values(matches!(row.name, "bounds" | "positions"))
}

impl<W: Which> SettingFlags<W> {
    fn rows() -> impl Iterator<Item = &'static Row> {
        ROWS.iter().filter(|row| W::has(row))
    }
}

impl<W: Which> clap::Args for SettingFlags<W> {
    fn augment_args(command: Command) -> Command {
        command.args(Self::rows().map(argument))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl<W: Which> clap::FromArgMatches for SettingFlags<W> {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let given = Self::rows().filter_map(|row| {
            let texts: Vec<String> = matches.get_many::<String>(&row.full_name())?.cloned().collect();
            Some(Given { section: row.section, name: row.name, texts })
        });
        Ok(SettingFlags { given: given.collect(), which: PhantomData })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}
