//! Which colour space a file says that its numbers are in, and their conversion to linear Rec.709.
//!
//! An EXR file may say it in three ways. They are asked in the order that the Color Interop Forum recommends
//! (*Identifying the Color Space of OpenEXR Files*), for chromaticities are often copied from file to file without
//! being true:
//!
//! 1. `acesImageContainerFlag` = 1: ACES 2065-1 (SMPTE ST 2065-4).
//! 2. `colorInteropID`, `encoding_primaries_state`: `lin_ap1_scene`. `unknown` says nothing; `data` is no colour,
//!    and is read as it is.
//! 3. `chromaticities`.
//!
//! A `.hdr` file says it with PRIMARIES, or with FORMAT=32-bit_rle_xyze. A file that says nothing is linear Rec.709.

use std::path::Path;

use ::exr::meta::attribute::{AttributeValue, Text};
use ::exr::meta::header::Header;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

use crate::colour::{Curve, Primaries, xyz_d65_to_rec709};
use crate::panorama::Image;
use crate::{Error, Finding, Result};

/// Negative light as small as this, next to the pixel's brightest channel, is rounding.
const ROUNDING: f64 = 1e-6;

/// What makes linear Rec.709 of a file's numbers: the curve, then the matrix.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Conversion {
    curve: Curve,
    matrix: DMat3,
}

impl Conversion {
    /// `None` where linear Rec.709 is what the numbers are.
    fn new(curve: Curve, space: Space) -> Option<Conversion> {
        let is_own = matches!(space, Space::Primaries(primaries) if primaries.is_close_to(&Primaries::REC709));
        if is_own && curve == Curve::Linear {
            return None;
        }
        Some(Conversion { curve, matrix: if is_own { DMat3::IDENTITY } else { space.to_rec709()? } })
    }

    /// Multiplies all light.
    pub fn scaled(self, factor: f64) -> Conversion {
        Conversion { matrix: self.matrix * factor, ..self }
    }

    /// Converts all pixels. Numbers that Rec.709 shows as negative light become 0, and are told.
    pub fn apply(&self, path: &Path, image: &mut Image, findings: &mut Vec<Finding>) -> Result<()> {
        let convert = |(index, pixel): (usize, &mut [f32; 3])| {
            let light = self.matrix * DVec3::from_array(pixel.map(|v| self.curve.decode(v.into())));
            let shown = light.max(DVec3::ZERO).as_vec3();
            if !shown.is_finite() {
                return (0, Some((index, *pixel)));
            }
            let outside = light.min_element() < -ROUNDING * light.max_element().max(f64::MIN_POSITIVE);
            *pixel = shown.to_array();
            (u64::from(outside), None)
        };
        // Of several pixels that are too bright the first one is named, whichever thread was first.
        let join = |(a, first): (u64, Option<_>), (b, second): (u64, Option<_>)| (a + b, first.or(second));
        let pixels = image.pixels.par_iter_mut().enumerate();
        let (outside, too_bright) = pixels.map(convert).reduce(|| (0, None), join);
        if let Some((index, pixel)) = too_bright {
            let (x, y) = (index % image.width, index / image.width);
            return Err(Error::invalid(
                path,
                format!(
                    "the pixel at x {x}, y {y} is {pixel:?}, more light than a float holds once converted to Rec.709: \
                     make the panorama darker, and raise its exposure"
                ),
            ));
        }
        if outside > 0 {
            let message = format!(
                "{outside} pixels have colours that Rec.709 cannot show: their channels below 0 became 0, and they are \
                 a little brighter than in the file"
            );
            findings.push(Finding::new("outside-gamut", outside, message));
        }
        Ok(())
    }
}

/// What linear numbers measure.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Space {
    Primaries(Primaries),
    /// CIE XYZ in which D65 is white.
    XyzD65,
}

impl Space {
    fn to_rec709(self) -> Option<DMat3> {
        match self {
            Space::Primaries(primaries) => primaries.to_rec709(),
            Space::XyzD65 => Some(xyz_d65_to_rec709()),
        }
    }

    /// Whether a file that also has these chromaticities says the same twice.
    fn agrees_with(self, chromaticities: &Primaries) -> bool {
        match self {
            Space::Primaries(primaries) => primaries.is_close_to(chromaticities),
            Space::XyzD65 => chromaticities.has_primaries_of(&Primaries::XYZ),
        }
    }
}

/// What a `colorInteropID` says.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Id {
    /// Nothing.
    Unknown,
    /// No colour.
    Data,
    Known(Curve, Space),
    /// Primaries that are not known here.
    Foreign(Curve),
    /// A curve that is not known here.
    Encoded,
    /// As a display shows it, encoded.
    Display,
}

impl Id {
    fn parse(id: &str) -> Id {
        let id = id.trim_matches(|c: char| c == '\0' || c.is_whitespace()).to_ascii_lowercase();
        // What stands before a colon says whose name it is.
        let name = id.rsplit(':').next().unwrap_or_default();
        let (encoding, space, state) = match name.split('_').collect::<Vec<_>>()[..] {
            [""] | ["unknown"] => return Id::Unknown,
            ["data"] | ["raw"] => return Id::Data,
            [encoding, space, state @ ("scene" | "display")] => (encoding, space, state),
            _ => return Id::Foreign(Curve::Linear),
        };
        let gamma = encoding.strip_prefix('g').and_then(|digits| digits.parse().ok()).filter(|tenths| *tenths >= 10);
        let curve = match (encoding, gamma) {
            ("lin", _) => Curve::Linear,
            (_, _) if state == "display" => return Id::Display,
            ("srgb" | "srgbx" | "srgbe", _) => Curve::Srgb,
            (_, Some(tenths)) => Curve::Gamma(f64::from(u8::min(tenths, 99)) / 10.0),
            _ => return Id::Encoded,
        };
        let primaries = match space {
            "rec709" => Primaries::REC709,
            "rec2020" => Primaries::REC2020,
            "p3d65" => Primaries::P3_D65,
            "adobergb" => Primaries::ADOBE_RGB,
            "ap0" => Primaries::AP0,
            "ap1" => Primaries::AP1,
            "prophoto" => Primaries::PROPHOTO,
            "ciexyzd65" | "xyzd65" => return Id::Known(curve, Space::XyzD65),
            _ => return Id::Foreign(curve),
        };
        Id::Known(curve, Space::Primaries(primaries))
    }
}

/// Name of the attribute.
const INTEROP_ID: &str = "colorInteropID";

/// A part's `colorInteropID`, where it has one.
fn interop_id(header: &Header) -> Option<String> {
    let name = Text::from(INTEROP_ID);
    let found = header.own_attributes.other.get(&name).or_else(|| header.shared_attributes.other.get(&name))?;
    match found {
        AttributeValue::Text(id) => Some(id.to_string()),
        _ => None,
    }
}

/// Whether the part says that it holds no colour.
pub(super) fn is_data(header: &Header) -> bool {
    interop_id(header).is_some_and(|id| Id::parse(&id) == Id::Data)
}

/// Whether the part says that its three channels are CIE XYZ.
pub(super) fn is_xyz(header: &Header) -> bool {
    match interop_id(header).map(|id| Id::parse(&id)) {
        Some(Id::Known(_, space)) => space == Space::XyzD65,
        _ => chromaticities(header).is_some_and(|found| found.has_primaries_of(&Primaries::XYZ)),
    }
}

fn chromaticities(header: &Header) -> Option<Primaries> {
    let c = header.shared_attributes.chromaticities?;
    let [red, green, blue, white] = [c.red, c.green, c.blue, c.white].map(|v| [v.x().into(), v.y().into()]);
    Some(Primaries { red, green, blue, white })
}

fn is_aces(header: &Header) -> bool {
    let name = Text::from("acesImageContainerFlag");
    let found = header.own_attributes.other.get(&name).or_else(|| header.shared_attributes.other.get(&name));
    found == Some(&AttributeValue::I32(1))
}

/// The conversion that a part of an EXR file asks for. A `grey` one has no colour to convert, only a curve.
pub(super) fn of_exr(
    path: &Path,
    headers: &[Header],
    part: usize,
    grey: bool,
    findings: &mut Vec<Finding>,
) -> Result<Option<Conversion>> {
    let header = &headers[part];
    let conversion = stated_by_exr(path, headers, part, findings)?;
    if !grey {
        return Ok(conversion);
    }
    findings.retain(|finding| finding.id != CHROMATICITIES && finding.id != ID);
    let curve = conversion.map_or(Curve::Linear, |conversion| conversion.curve);
    let space = Space::Primaries(Primaries::REC709);
    if curve != Curve::Linear {
        let id = interop_id(header).unwrap_or_default();
        let message = format!("the attribute {INTEROP_ID} is {id}: its values were decoded to linear light");
        findings.push(Finding::new(ID, 1, message));
    }
    Ok(Conversion::new(curve, space))
}

/// Finding ids.
const CHROMATICITIES: &str = "chromaticities";
const ID: &str = "color-interop-id";

fn stated_by_exr(
    path: &Path,
    headers: &[Header],
    part: usize,
    findings: &mut Vec<Finding>,
) -> Result<Option<Conversion>> {
    let header = &headers[part];
    let chromaticities = chromaticities(header);
    // A part without an ID has that of the others, if they are of colour.
    let is_colour = |id: &String| !matches!(Id::parse(id), Id::Data | Id::Unknown);
    let id = interop_id(header).or_else(|| headers.iter().filter_map(interop_id).find(is_colour));
    let (id, parsed) = match id {
        _ if is_aces(header) => {
            ("acesImageContainerFlag".into(), Id::Known(Curve::Linear, Space::Primaries(Primaries::AP0)))
        }
        Some(id) => (format!("{INTEROP_ID} is {id}"), Id::parse(&id)),
        None => (String::new(), Id::Unknown),
    };
    let refuse = |why: &str| {
        let what_to_do = "save the panorama in linear light of the scene, e.g. as lin_rec709_scene";
        Err(Error::unsupported(path, format!("the attribute {id}: {why}; {what_to_do}")))
    };
    let mut said = |message: String| findings.push(Finding::new(ID, 1, format!("the attribute {id}: {message}")));
    let curve = match parsed {
        Id::Known(curve, space) => {
            if let Some(other) = chromaticities.filter(|other| !space.agrees_with(other)) {
                let message = format!(
                    "the attribute {id}, and the chromaticities are {}: they contradict each other, and chromaticities \
                     count less, being copied from file to file more often",
                    words(&other)
                );
                findings.push(Finding::new("color-space-conflict", 1, message));
            }
            let conversion = Conversion::new(curve, space);
            if conversion.is_some() {
                let decoded = if curve == Curve::Linear { "" } else { "decoded to linear light and " };
                let message =
                    format!("the attribute {id}: the light was {decoded}converted to linear Rec.709, white adapted");
                findings.push(Finding::new(ID, 1, message));
            }
            return Ok(conversion);
        }
        Id::Data => {
            said("that is no colour; the numbers are used as linear Rec.709 light all the same".into());
            return Ok(None);
        }
        Id::Encoded => return refuse("its numbers are encoded in a way that is not known here"),
        Id::Display => return refuse("that is what a display shows, and no longer light of a scene"),
        Id::Foreign(curve) => {
            let space = if chromaticities.is_some() { "the chromaticities count" } else { "Rec.709 is assumed" };
            said(format!("its primaries are not known here; {space}"));
            curve
        }
        Id::Unknown => Curve::Linear,
    };
    let Some(primaries) = chromaticities else {
        return Ok(Conversion::new(curve, Space::Primaries(Primaries::REC709)));
    };
    Ok(of_primaries(CHROMATICITIES, "the attribute chromaticities", curve, primaries, findings))
}

/// The conversion from these primaries; `place`: where in the file they are.
pub(super) fn of_primaries(
    id: &str,
    place: &str,
    curve: Curve,
    primaries: Primaries,
    findings: &mut Vec<Finding>,
) -> Option<Conversion> {
    // Zeros say nothing: panoramas that are widely shared have PRIMARIES=0 0 0 0 0 0 0 0.
    let Primaries { red, green, blue, white } = primaries;
    if [red, green, blue, white] == [[0.0; 2]; 4] {
        return Conversion::new(curve, Space::Primaries(Primaries::REC709));
    }
    let found = words(&primaries);
    if primaries.to_rec709().is_none() {
        let message =
            format!("{place} says {found}, which is no triangle around a white; the light is taken as Rec.709");
        findings.push(Finding::new(id, 1, message));
        return Conversion::new(curve, Space::Primaries(Primaries::REC709));
    }
    let conversion = Conversion::new(curve, Space::Primaries(primaries));
    if !primaries.is_close_to(&Primaries::REC709) {
        let message =
            format!("{place} says {found}, not Rec.709: the light was converted to linear Rec.709, white adapted");
        findings.push(Finding::new(id, 1, message));
    }
    conversion
}

/// Primaries for a person.
fn words(p: &Primaries) -> String {
    let point = |[x, y]: [f64; 2]| format!("({:.4} {:.4})", x, y);
    let known = [
        (Primaries::REC709, "Rec.709"),
        (Primaries::REC2020, "Rec.2020"),
        (Primaries::P3_D65, "P3-D65"),
        (Primaries::ADOBE_RGB, "Adobe RGB"),
        (Primaries::AP0, "ACES AP0"),
        (Primaries::AP1, "ACES AP1"),
        (Primaries::PROPHOTO, "ProPhoto"),
        (Primaries::XYZ, "CIE XYZ"),
    ];
    let name =
        known.iter().find(|(known, _)| known.is_close_to(p)).map_or(String::new(), |(_, name)| format!("{name}, "));
    format!("{name}red {} green {} blue {} white {}", point(p.red), point(p.green), point(p.blue), point(p.white))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_read_by_their_three_words() {
        let known = |curve, primaries| Id::Known(curve, Space::Primaries(primaries));
        for (id, expected) in [
            ("lin_rec709_scene", known(Curve::Linear, Primaries::REC709)),
            ("lin_ap1_scene", known(Curve::Linear, Primaries::AP1)),
            ("lin_ap0_scene", known(Curve::Linear, Primaries::AP0)),
            ("lin_rec2020_scene", known(Curve::Linear, Primaries::REC2020)),
            ("lin_p3d65_scene", known(Curve::Linear, Primaries::P3_D65)),
            ("lin_adobergb_scene", known(Curve::Linear, Primaries::ADOBE_RGB)),
            ("lin_ciexyzd65_scene", Id::Known(Curve::Linear, Space::XyzD65)),
            ("oiio:lin_prophoto_scene", known(Curve::Linear, Primaries::PROPHOTO)),
            ("lin_rec709_display", known(Curve::Linear, Primaries::REC709)),
            ("LIN_AP1_scene\0", known(Curve::Linear, Primaries::AP1)),
            ("srgb_rec709_scene", known(Curve::Srgb, Primaries::REC709)),
            ("srgb_p3d65_scene", known(Curve::Srgb, Primaries::P3_D65)),
            ("g22_ap1_scene", known(Curve::Gamma(2.2), Primaries::AP1)),
            ("g18_rec709_scene", known(Curve::Gamma(1.8), Primaries::REC709)),
            ("lin_awg3_scene", Id::Foreign(Curve::Linear)),
            ("studio-camera", Id::Foreign(Curve::Linear)),
            ("ocio:acescct_ap1_scene", Id::Encoded),
            ("ocio:arrilogc3_awg3_scene", Id::Encoded),
            ("srgb_rec709_display", Id::Display),
            ("pq_rec2020_display", Id::Display),
            ("data", Id::Data),
            ("unknown", Id::Unknown),
            ("", Id::Unknown),
        ] {
            assert_eq!(Id::parse(id), expected, "{id}");
        }
    }
}
