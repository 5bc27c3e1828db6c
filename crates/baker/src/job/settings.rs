//! All settings of a bake, each defined once: name, type, default, range and what it means. The flags of the command line,
//! BAKE.toml, the record in the file and what `inspect` shows are made from this table.
//!
//! A new setting is a row of the table, and the place that reads its field. See CONTRIBUTING.md for an example.

use super::text::{Bands, Method, NodeKind, Punctual, SunLight, Text};
use crate::bake::BakeSettings;
use crate::capture::CaptureSettings;
use crate::import::gltf::{GltfOptions, TextureNeeds};
use crate::pack::{PackSettings, Precision};
use crate::radiance::blend::BlendRule;
use crate::radiance::gdibl::{GdiblSettings, SceneHit};
use crate::radiance::path::PathSettings;
use crate::radiance::unseen::Unseen;
use crate::sampling::Sampler;
use crate::scene::Metals;

/// What is known of a setting beside its value.
#[derive(Debug, Clone, Copy)]
pub struct Row {
    /// Its table in BAKE.toml: `grid`, `quality` or `capture`.
    pub section: &'static str,
    /// Its name in that table, and as a flag with dashes.
    pub name: &'static str,
    /// Stands for the value in help.
    pub value: &'static str,
    /// What it means, for help. Lines begin with a space.
    pub about: &'static str,
    /// All values, where these are few words.
    pub words: &'static [&'static str],
    /// It may be given several times.
    pub is_list: bool,
    /// A flag without a value means `true`.
    pub is_switch: bool,
    /// It changes the result, so files say it. Without it: what the machine may use.
    pub is_recorded: bool,
    /// Reads the texts that were given, and says what is wrong with them.
    pub check: fn(&[&str]) -> Result<(), String>,
}

impl Row {
    /// The flag, without dashes in front. That of a list takes one value at a time: `position` for `positions`.
    pub fn flag(&self) -> String {
        let name = if self.is_list { self.name.strip_suffix('s').unwrap_or(self.name) } else { self.name };
        name.replace('_', "-")
    }

    /// The name in the record of a file: `quality.samples`.
    pub fn full_name(&self) -> String {
        format!("{}.{}", self.section, self.name)
    }

    /// Each volume of a level may have its own; the others belong to the level, its light and its probes.
    pub fn is_of_volumes(&self) -> bool {
        OF_VOLUMES.contains(&(self.section, self.name))
    }
}

/// What each volume of a level may have of its own.
const OF_VOLUMES: &[(&str, &str)] = &[
    ("grid", "counts"),
    ("grid", "tolerance"),
    ("quality", "samples"),
    ("quality", "target_error"),
    ("quality", "seen_places"),
    ("quality", "max_seen_error"),
    ("quality", "seed"),
    ("quality", "sampler"),
    ("quality", "bounces"),
    ("quality", "punctual"),
    ("quality", "clamp"),
    ("quality", "scene"),
    ("quality", "sh"),
    ("quality", "precision"),
    ("quality", "zstd"),
    ("quality", "coefficient_errors"),
    ("quality", "dering"),
    ("quality", "blend"),
];

/// A value out of its range: the name of the setting in full, and what is wrong.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OutOfRange {
    /// Of the setting.
    pub row: String,
    /// As a flag, with dashes in front.
    pub flag: String,
    /// Value found, and what was expected.
    pub message: String,
}

macro_rules! settings {
    ($(
        $(#[doc = $title:literal])*
        $section:ident: $section_type:ident {
            $(
                $(#[doc = $about:literal])+
                $value:literal $(($unrecorded:ident))?
                $name:ident: $kind:ty = $default:expr $(, $valid:expr => $expected:literal)?;
            )*
        }
    )*) => {
        /// All settings of a bake. `Settings::default()` is what a bake without any flag does.
        #[derive(Debug, Clone, Default, PartialEq)]
        pub struct Settings {
            $( $(#[doc = $title])* pub $section: $section_type, )*
        }

        $(
            $(#[doc = $title])*
            #[derive(Debug, Clone, PartialEq)]
            pub struct $section_type {
                $( $(#[doc = $about])+ pub $name: $kind, )*
            }

            impl Default for $section_type {
                fn default() -> Self {
                    $section_type { $( $name: $default, )* }
                }
            }
        )*

        /// One row for each setting, in the order of help.
        pub const ROWS: &[Row] = &[$($(
            Row {
                section: stringify!($section),
                name: stringify!($name),
                value: $value,
                about: concat!($($about, "\n"),+),
                words: <$kind as Text>::WORDS,
                is_list: <$kind as Text>::IS_LIST,
                is_switch: <$kind as Text>::IS_SWITCH,
                is_recorded: true $( && settings!(@$unrecorded) )?,
                check: |texts| <$kind as Text>::parse(texts).map(drop),
            },
        )*)*];

        impl Settings {
            /// Sets one setting from its texts.
            ///
            /// # Errors
            /// What is wrong, and what was expected; also where no setting is called that.
            pub fn set(&mut self, section: &str, name: &str, texts: &[&str]) -> Result<(), String> {
                match (section, name) {
                    $($(
                        (stringify!($section), stringify!($name)) => {
                            self.$section.$name = <$kind as Text>::parse(texts)?;
                        }
                    )*)*
                    _ => {
                        let names = ROWS.iter().filter(|row| row.section == section).map(|row| row.name);
                        let names = names.collect::<Vec<_>>().join(", ");
                        return Err(format!("no setting is called that; [{section}] has {names}"));
                    }
                }
                Ok(())
            }

            /// The text of each row of [`ROWS`]; `None` where it is not set.
            fn texts(&self) -> Vec<Option<String>> {
                vec![$($( self.$section.$name.text(), )*)*]
            }

            /// The first value that is out of its range, if any is.
            fn out_of_range(&self) -> Option<OutOfRange> {
                $($($(
                    let is_valid: fn(&$kind) -> bool = $valid;
                    if !is_valid(&self.$section.$name) {
                        let value = self.$section.$name.text().unwrap_or_default();
                        return Some(OutOfRange {
                            row: concat!(stringify!($section), ".", stringify!($name)).into(),
                            flag: format!("--{}", stringify!($name).replace('_', "-")),
                            message: format!("{value}: expected {}", $expected),
                        });
                    }
                )?)*)*
                None
            }
        }
    };
    (@unrecorded) => { false };
}

/// A share above 0.
fn is_share(share: &Option<f64>) -> bool {
    share.is_none_or(|share| share > 0.0 && share.is_finite())
}

settings! {
    /// Where nodes stand.
    grid: GridSettings {
        /// Where to bake: grid, vertices, or points:FILE.csv (x,y,z with a header line) [default: grid]
        "WHERE" nodes: NodeKind = NodeKind::Grid;
        /// Box of the grid, world metres: x0,y0,z0,x1,y1,z1 [default: that of the air that people can be in,
        /// without ground planes, sky domes and rock around it]
        "BOX" bounds: Option<[f64; 6]> = None;
        /// Greatest distance between grid nodes, metres [default: the greatest with which --max-seen-error holds, or 5 %,
        /// within --max-nodes, --max-bytes and --budget]
        "M" spacing: Option<f64> = None, |spacing| spacing.is_none_or(|m| m > 0.0 && m.is_finite()) => "metres above 0";
        /// Grid nodes per axis: X,Y,Z
        "X,Y,Z" counts: Option<[u32; 3]> = None;
        /// The most nodes that a grid may have whose spacing is not given [default: 8192; with --budget what time allows]
        "N" max_nodes: Option<u64> = None, |nodes| nodes.is_none_or(|n| n >= 1) => "1 or more";
        /// The most bytes that the light of a grid may take whose spacing is not given [default: any]
        "N" max_bytes: Option<u64> = None, |bytes| bytes.is_none_or(|n| n >= 1) => "1 or more";
        /// Choose the spacing so that the bake ends within these seconds on this machine; the file records the most nodes that
        /// fit, as --max-nodes, which gives the same bake again
        "SECONDS" (unrecorded) budget: Option<f64> = None,
            |seconds| seconds.is_none_or(|s| s > 0.0 && s.is_finite()) => "seconds above 0";
        /// Leave grid nodes out where light between their neighbours is right to this share (0.01 is 1 %); spacing, or
        /// counts, then say how fine the grid may become, and counts grow until coarser cells fit in [default: all are
        /// baked]
        "F" tolerance: Option<f64> = None, is_share => "a positive share, 0.01 for 1 %";
    }
    /// How light is found, and how it is stored.
    quality: QualitySettings {
        /// Directions per node; with --target-error the most a node may take [default: 4096; with a target 65536]
        "N" samples: Option<u64> = None,
            |samples| samples.is_none_or(|n| (1..=BakeSettings::MAX_SAMPLES).contains(&n)) => "1 to 2147483648";
        /// Sample each node until the relative error of its irradiance is at most this (0.01 is 1 %)
        "F" target_error: Option<f64> = None, is_share => "a positive share, 0.01 for 1 %";
        /// Places in the air, and as many on surfaces, where the error is measured as an engine sees it; 0: nowhere
        /// [default: an eighth of the nodes, 8 to 512]
        "N" seen_places: Option<u32> = None, |places| places.is_none_or(|n| n <= 1 << 20) => "0 to 1048576";
        /// Exit with 5 if the error as an engine sees it is over this share at more than 5 % of the places, in the air or on
        /// surfaces (0.05 is 5 %); the volume is written
        "F" max_seen_error: Option<f64> = None, is_share => "a positive share, 0.01 for 1 %";
        /// Same seed, same bytes [default: 0]
        "N" seed: u64 = 0;
        /// Worker threads; the result does not depend on it [default: all]
        "N" (unrecorded) threads: Option<usize> = None,
            |threads| threads.is_none_or(|n| (1..=1024).contains(&n)) => "1 to 1024";
        /// sobol, or random (the report's, a baseline) [default: sobol]
        "NAME" sampler: Sampler = Sampler::Sobol;
        /// gdibl: the light that probes show, captured from the level where none is given; path: path tracing by the
        /// level's own materials and lights; auto: gdibl where probes are given, else path [default: auto]
        "NAME" method: Method = Method::Auto;
        /// Surfaces that light may leave on its way to a node, by path tracing: 1 is direct light [default: unlimited,
        /// with roulette]
        "N" bounces: Option<u32> = None;
        /// Direct light of point, spot and directional lights: include, or exclude for the engine to add it, moving and
        /// sharp; their bounced light is there in any case [default: exclude]
        "WHAT" punctual: Punctual = Punctual::Exclude;
        /// Sun of the distant panorama: extract leaves its direct light out for the engine to add as the directional
        /// light that is reported; its bounced light stays; include leaves all in [default: include]
        "WHAT" sun: SunLight = SunLight::Include;
        /// Cut every sample's radiance off at this, and say how much light that took [default: off]
        "L" clamp: Option<f32> = None, |clamp| clamp.is_none_or(|clamp| clamp > 0.0) => "a radiance above 0";
        /// What a ray does at scene geometry: recurse:DEPTH or occlude [default: recurse:3]
        "HOW" scene: SceneHit = SceneHit::default();
        /// Bands of spherical harmonics: L0, L1, L2, L3, L4, or auto: the fewest with which irradiance at 95 % of the
        /// nodes is that of L4 to --tolerance, or to 10 % [default: L2]
        "BANDS" sh: Bands = Bands::default();
        /// Numbers in the file: packed, a quarter of f16's bytes, adds a third of the noise to E in 95 % of the nodes at
        /// most, and packed:ERROR this share (0.002 to 0.1); f16; f32 [default: packed]
        "TYPE" precision: Precision = Precision::PACKED;
        /// Compress the file's sections with zstd where that makes them smaller; readers need a decoder then
        "BOOL" zstd: bool = false;
        /// Store the standard error of every coefficient and of the worst direction, per node
        "BOOL" coefficient_errors: bool = false;
        /// Scale down bands 1 and up of nodes whose irradiance turns negative for some normal, by as little as ends that
        "BOOL" dering: bool = false;
        /// How probes that see a point share it: distance:k, angular:k, angular-smooth:k, nearest, footprint:k
        /// [default: footprint:4]
        "RULE" blend: BlendRule = BlendRule::default();
        /// What no probe sees finely enough: trace it by the level's materials, fill it from what is seen, or auto: trace
        /// where probes and materials agree to 20 % [default: auto]
        "WHAT" unseen: Unseen = Unseen::Auto;
        /// What metals reflect: diffuse, the share that keeps the energy of a rough metal, or black [default: diffuse]
        "WHAT" metals: Metals = Metals::Diffuse;
        /// Divide the level's punctual lights by this: lumens that an exporter made of a watt (Blender: 683) [default: off]
        "LM" lumens_per_watt: Option<f32> = None,
            |lumens| lumens.is_none_or(|n| n > 0.0 && n.is_finite()) => "a number above 0";
        /// Mid-grey in place of textures that are missing or cannot be read, instead of an error
        "BOOL" allow_missing_textures: bool = false;
        /// Replace NaN, infinite and negative pixels instead of refusing the image
        "BOOL" repair_pixels: bool = false;
        /// Match the exposures of photographed probes by surfaces that two or more of them show, and name probes that
        /// seem misplaced
        "BOOL" match_exposure: bool = false;
        /// Store the wall and CPU seconds of each stage in the file; its bytes then differ from run to run
        "BOOL" record_times: bool = false;
        /// Refuse a bake that needs more memory than this, GiB [default: what the machine has free]
        "GIB" (unrecorded) max_memory: Option<f64> = None;
    }
    /// How probes are captured from the level.
    capture: CapturePlan {
        /// Place probes automatically, at most --most of them
        "BOOL" auto: bool = false;
        /// A probe's place, world metres: x,y,z; repeatable
        "X,Y,Z" positions: Vec<[f64; 3]> = Vec::new();
        /// Most probes that --auto places [default: 32]
        "N" most: Option<usize> = None;
        /// Pixels around the horizon [default: 256]
        "PIXELS" width: Option<usize> = None,
            |width| width.is_none_or(|width| (4..=16384).contains(&width) && width.is_multiple_of(2))
                => "an even number from 4 to 16384";
        /// Paths per pixel; with --target-error the most a pixel may take [default: 64; with a target 65536]
        "N" samples: Option<u32> = None, |samples| samples.is_none_or(|n| n > 0) => "at least 1";
        /// Sample each pixel until its relative standard error is at most this (0.01 is 1 %)
        "F" target_error: Option<f64> = None, is_share => "a positive share, 0.01 for 1 %";
    }
}

/// Paths per pixel when a target is given and nothing else is said.
const TARGET_PATHS: u32 = 65_536;

impl Settings {
    /// The first value that makes no sense, by itself or beside another.
    ///
    /// # Errors
    /// That value, and what was expected.
    pub fn check(&self) -> Result<(), OutOfRange> {
        if let Some(out) = self.out_of_range() {
            return Err(out);
        }
        if let Some(bounds) = self.grid.bounds
            && !(bounds.iter().all(|number| number.is_finite()) && (0..3).all(|axis| bounds[axis] <= bounds[axis + 3]))
        {
            let message = format!(
                "{}: expected finite numbers, the lower corner first: x0,y0,z0,x1,y1,z1",
                bounds.text().unwrap_or_default()
            );
            return Err(OutOfRange { row: "grid.bounds".into(), flag: "--bounds".into(), message });
        }
        Ok(())
    }

    /// Every setting that is recorded: its name in full, and its text as it is in force. `None`: not set.
    pub fn recorded(&self) -> Vec<(String, Option<String>)> {
        let mut in_force = self.clone();
        in_force.quality.samples = Some(self.samples());
        let rows = ROWS.iter().zip(in_force.texts()).filter(|(row, _)| row.is_recorded);
        rows.map(|(row, text)| (row.full_name(), text)).collect()
    }

    /// Directions per node, or with a target the most of them.
    pub fn samples(&self) -> u64 {
        let default = match self.quality.target_error {
            Some(_) => BakeSettings::TARGET_SAMPLES,
            None => BakeSettings::default().samples,
        };
        self.quality.samples.unwrap_or(default)
    }

    /// How nodes are sampled. `sh = "auto"` bakes all bands: those that are not needed go once they are known.
    pub fn bake(&self) -> BakeSettings {
        let quality = &self.quality;
        BakeSettings {
            bands: match quality.sh {
                Bands::To(bands) => bands,
                Bands::Auto => gdibl_runtime::sh::MAX_BANDS,
            },
            samples: self.samples(),
            target_error: quality.target_error,
            seed: quality.seed,
            sampler: quality.sampler,
            importance: true,
            coefficient_errors: quality.coefficient_errors,
            punctual: quality.punctual == Punctual::Include,
            clamp: quality.clamp.unwrap_or(f32::INFINITY),
        }
    }

    /// How the probes' light is computed. `captured`: they were captured from the level, without its emission.
    /// `directions`: those that will leave nodes, all together, 0 where there are none. `coarsest`: a probe counts where its
    /// pixel covers a square of at most this edge, metres.
    pub fn gdibl(&self, captured: bool, directions: u64, coarsest: f32) -> GdiblSettings {
        let quality = &self.quality;
        GdiblSettings {
            blend: quality.blend,
            scene_hit: quality.scene,
            emission_from_materials: captured,
            walks: GdiblSettings::walks_beside(self.bake().directions(1)),
            seed: quality.seed,
            directions,
            coarsest,
        }
    }

    /// How levels are read.
    pub fn gltf(&self, textures: TextureNeeds) -> GltfOptions {
        let QualitySettings { metals, lumens_per_watt, allow_missing_textures, .. } = self.quality;
        GltfOptions { textures, metals, lumens_per_watt, allow_missing_textures, ..GltfOptions::default() }
    }

    /// How paths are traced.
    pub fn path(&self) -> PathSettings {
        PathSettings { bounces: self.quality.bounces, ..PathSettings::default() }
    }

    /// How paths to probes are traced: these have not seen scene geometry.
    pub fn capture_path(&self) -> PathSettings {
        PathSettings { scene_geometry: false, ..self.path() }
    }

    /// How probes are captured.
    pub fn capture_probes(&self) -> CaptureSettings {
        let (capture, defaults) = (&self.capture, CaptureSettings::default());
        CaptureSettings {
            width: capture.width.unwrap_or(defaults.width),
            samples: capture.samples.unwrap_or(match capture.target_error {
                Some(_) => TARGET_PATHS,
                None => defaults.samples,
            }),
            target_error: capture.target_error,
            seed: self.quality.seed,
            clamp: self.quality.clamp.unwrap_or(f32::INFINITY),
            emission: true,
        }
    }

    /// How the file is packed.
    pub fn pack(&self) -> PackSettings {
        let quality = &self.quality;
        PackSettings { precision: quality.precision, zstd: quality.zstd, dering: quality.dering, step: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_read_back_as_the_same_settings() {
        let mut settings = Settings::default();
        for (section, name, text) in [
            ("grid", "bounds", "-1,0.5,0,1,2,1e-3"),
            ("grid", "counts", "3,4,5"),
            ("quality", "blend", "angular:2.5"),
            ("quality", "precision", "packed:0.01"),
            ("quality", "sh", "auto"),
            ("quality", "zstd", "true"),
            ("quality", "scene", "occlude"),
            ("capture", "positions", "1,2,3;4,5,6"),
        ] {
            settings.set(section, name, &[text]).unwrap_or_else(|why| panic!("{section}.{name}: {why}"));
        }
        assert_ne!(settings, Settings::default());
        let mut again = Settings::default();
        for (row, text) in ROWS.iter().zip(settings.texts()) {
            if let Some(text) = text {
                again.set(row.section, row.name, &[&text]).unwrap();
            }
        }
        assert_eq!(again, settings);
    }

    #[test]
    fn names_are_unique_and_unknown_ones_are_refused_with_those_there_are() {
        let mut names: Vec<String> = ROWS.iter().map(Row::full_name).collect();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), ROWS.len());
        let why = Settings::default().set("quality", "sample", &["1"]).unwrap_err();
        assert!(why.contains("samples") && why.contains("target_error") && !why.contains("spacing"), "{why}");
    }

    #[test]
    fn what_volumes_may_have_of_their_own_are_settings() {
        assert_eq!(ROWS.iter().filter(|row| row.is_of_volumes()).count(), OF_VOLUMES.len());
    }

    #[test]
    fn values_out_of_range_are_refused_with_the_range() {
        for (section, name, text, words) in [
            ("quality", "samples", "0", "1 to 2147483648"),
            ("quality", "samples", "2147483649", "1 to 2147483648"),
            ("quality", "target_error", "-0.5", "a positive share"),
            ("quality", "target_error", "NaN", "a positive share"),
            ("quality", "threads", "0", "1 to 1024"),
            ("quality", "clamp", "0", "above 0"),
            ("grid", "spacing", "inf", "metres above 0"),
            ("grid", "bounds", "1,0,0,0,1,1", "the lower corner first"),
            ("capture", "width", "5", "an even number"),
        ] {
            let mut settings = Settings::default();
            settings.set(section, name, &[text]).unwrap();
            let out = settings.check().unwrap_err();
            assert_eq!(out.row, format!("{section}.{name}"));
            assert!(out.message.contains(words), "{out:?}");
        }
        assert_eq!(Settings::default().check(), Ok(()));
    }

    #[test]
    fn help_names_the_default() {
        // A row whose default is not a plain word says in words what happens without it.
        for (row, text) in ROWS.iter().zip(Settings::default().texts()) {
            let default = text.filter(|_| !row.is_switch);
            if let Some(default) = default {
                assert!(row.about.contains(&format!("[default: {default}")), "{}: {default}", row.full_name());
            }
        }
    }
}
