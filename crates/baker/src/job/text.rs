//! The text form of a setting: the same on the command line, in a BAKE.toml and in the record of a file.

use std::path::PathBuf;

use crate::pack::Precision;
use crate::radiance::blend::BlendRule;
use crate::radiance::gdibl::SceneHit;
use crate::radiance::unseen::Unseen;
use crate::sampling::Sampler;
use crate::scene::Metals;

/// A value that has a text form: [`Text::text`] of a value reads back as that value.
pub trait Text: Sized {
    /// All texts that there are, where these are few words.
    const WORDS: &[&str] = &[];
    /// It is given once for each of its values, as `--position` is.
    const IS_LIST: bool = false;
    /// A flag without a value means `true`.
    const IS_SWITCH: bool = false;

    /// Reads all texts that were given, of which the last one counts unless it is a list. Says what was expected.
    fn parse(texts: &[&str]) -> Result<Self, String>;

    /// The text form. `None`: not set.
    fn text(&self) -> Option<String>;
}

fn last<'a>(texts: &[&'a str]) -> &'a str {
    texts.last().copied().unwrap_or_default()
}

macro_rules! numbers {
    ($($kind:ty: $expected:literal),+) => {$(
        impl Text for $kind {
            fn parse(texts: &[&str]) -> Result<Self, String> {
                last(texts).trim().parse().map_err(|_| $expected.into())
            }
            fn text(&self) -> Option<String> {
                Some(self.to_string())
            }
        }
    )+};
}
numbers! {
    u32: "expected a whole number, 0 or more",
    u64: "expected a whole number, 0 or more",
    usize: "expected a whole number, 0 or more",
    f32: "expected a number",
    f64: "expected a number"
}

impl Text for bool {
    const WORDS: &[&str] = &["true", "false"];
    const IS_SWITCH: bool = true;

    fn parse(texts: &[&str]) -> Result<Self, String> {
        last(texts).parse().map_err(|_| "expected true or false".into())
    }

    fn text(&self) -> Option<String> {
        Some(self.to_string())
    }
}

impl<T: Text> Text for Option<T> {
    const WORDS: &[&str] = T::WORDS;
    const IS_LIST: bool = T::IS_LIST;
    const IS_SWITCH: bool = T::IS_SWITCH;

    fn parse(texts: &[&str]) -> Result<Self, String> {
        T::parse(texts).map(Some)
    }

    fn text(&self) -> Option<String> {
        self.as_ref().and_then(T::text)
    }
}

/// Numbers with commas between them.
fn numbers<T: std::str::FromStr, const N: usize>(text: &str) -> Option<[T; N]> {
    let numbers: Option<Vec<T>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    numbers?.try_into().ok()
}

fn joined(numbers: &[impl ToString]) -> String {
    numbers.iter().map(ToString::to_string).collect::<Vec<_>>().join(",")
}

/// A box: the lower corner, then the upper one.
impl Text for [f64; 6] {
    fn parse(texts: &[&str]) -> Result<Self, String> {
        let text = last(texts);
        let found = text.split(',').count();
        numbers(text).ok_or_else(|| format!("{found} numbers; expected x0,y0,z0,x1,y1,z1"))
    }

    fn text(&self) -> Option<String> {
        Some(joined(self))
    }
}

/// Nodes per axis.
impl Text for [u32; 3] {
    fn parse(texts: &[&str]) -> Result<Self, String> {
        let counts = numbers::<u32, 3>(last(texts)).filter(|counts| !counts.contains(&0));
        counts.ok_or_else(|| format!("an empty grid, or too many; expected X,Y,Z, 1 to {} each", u32::MAX))
    }

    fn text(&self) -> Option<String> {
        Some(joined(self))
    }
}

/// Places, world metres.
impl Text for Vec<[f64; 3]> {
    const IS_LIST: bool = true;

    fn parse(texts: &[&str]) -> Result<Self, String> {
        let place = |text: &&str| {
            let place = numbers::<f64, 3>(text).filter(|place| place.iter().all(|number| number.is_finite()));
            place.ok_or_else(|| "expected x,y,z".to_string())
        };
        texts.iter().flat_map(|text| text.split(';')).map(|text| place(&text)).collect()
    }

    fn text(&self) -> Option<String> {
        (!self.is_empty()).then(|| self.iter().map(|place| joined(place)).collect::<Vec<_>>().join(";"))
    }
}

/// Text forms that are a type's own `Display` and `FromStr`.
macro_rules! by_display {
    ($($kind:ty),+) => {$(
        impl Text for $kind {
            fn parse(texts: &[&str]) -> Result<Self, String> {
                last(texts).parse()
            }
            fn text(&self) -> Option<String> {
                Some(self.to_string())
            }
        }
    )+};
}
by_display!(BlendRule, SceneHit, Precision, NodeKind, Bands);

/// Few words: an enum, each of its values with its text.
macro_rules! words {
    ($kind:ty { $($word:literal = $value:expr),+ }) => {
        impl Text for $kind {
            const WORDS: &[&str] = &[$($word),+];

            fn parse(texts: &[&str]) -> Result<Self, String> {
                match last(texts) {
                    $($word => Ok($value),)+
                    _ => Err(format!("expected {}", [$($word),+].join(" or "))),
                }
            }

            fn text(&self) -> Option<String> {
                [$(($word, $value)),+].into_iter().find(|(_, value)| value == self).map(|(word, _)| word.into())
            }
        }
    };
}
words!(Sampler { "sobol" = Sampler::Sobol, "random" = Sampler::Random });
words!(Method { "auto" = Method::Auto, "gdibl" = Method::Gdibl, "path" = Method::Path });
words!(Punctual { "include" = Punctual::Include, "exclude" = Punctual::Exclude });
words!(Unseen { "auto" = Unseen::Auto, "trace" = Unseen::Trace, "fill" = Unseen::Fill });
words!(Metals { "diffuse" = Metals::Diffuse, "black" = Metals::Black });
words!(SunLight { "include" = SunLight::Include, "extract" = SunLight::Extract });

/// The radiance function.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// [`Method::Gdibl`] where probes are given, else [`Method::Path`].
    #[default]
    Auto,
    /// The light that probes show.
    Gdibl,
    /// Path tracing by the level's own materials and lights.
    Path,
}

/// The direct light of punctual lights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Punctual {
    /// It is part of the volume.
    Include,
    /// The engine adds it.
    #[default]
    Exclude,
}

/// The direct light of a sun in the distant panorama.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SunLight {
    /// It is part of the volume.
    #[default]
    Include,
    /// The engine adds it.
    Extract,
}

/// Where nodes stand.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum NodeKind {
    /// On a grid over a box.
    #[default]
    Grid,
    /// At the vertices of the level's meshes.
    Vertices,
    /// At the places of a CSV file.
    Points(PathBuf),
}

impl std::fmt::Display for NodeKind {
    /// Of a file the name alone: records must not depend on where a level lies.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            NodeKind::Grid => f.write_str("grid"),
            NodeKind::Vertices => f.write_str("vertices"),
            NodeKind::Points(path) => {
                write!(f, "points:{}", path.file_name().unwrap_or(path.as_os_str()).to_string_lossy())
            }
        }
    }
}

impl std::str::FromStr for NodeKind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once(':') {
            None if text == "grid" => Ok(NodeKind::Grid),
            None if text == "vertices" => Ok(NodeKind::Vertices),
            Some(("points", file)) if !file.is_empty() => Ok(NodeKind::Points(file.into())),
            _ => Err("expected grid, vertices or points:FILE.csv".into()),
        }
    }
}

/// Highest band of spherical harmonics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bands {
    /// What the light needs.
    Auto,
    /// This one.
    To(u32),
}

impl Default for Bands {
    fn default() -> Self {
        Bands::To(2)
    }
}

impl std::fmt::Display for Bands {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Bands::Auto => f.write_str("auto"),
            Bands::To(bands) => write!(f, "L{bands}"),
        }
    }
}

impl std::str::FromStr for Bands {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let bands = text.strip_prefix('L').and_then(|digits| digits.parse().ok());
        match bands.filter(|bands| *bands <= gdibl_runtime::sh::MAX_BANDS) {
            Some(bands) => Ok(Bands::To(bands)),
            None if text == "auto" => Ok(Bands::Auto),
            None => Err("expected L0, L1, L2, L3, L4 or auto".into()),
        }
    }
}
