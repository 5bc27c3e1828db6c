//! Decodes Radiance `.hdr` (`.pic`): the header here, the run-length coded RGBE scan lines by the `image` crate.
//!
//! The header's EXPOSURE and COLORCORR have been multiplied into the pixels by whoever wrote the file, each line
//! once more; dividing by all of them gives radiance back. PRIMARIES and the format XYZE name the colour space
//! ([`space`]).

use std::io::{BufRead, Cursor, ErrorKind, Read};
use std::path::Path;

use ::image::codecs::hdr::HdrDecoder;
use ::image::{ImageDecoder, ImageError};

use super::decoded::{Decoded, check_size, guard};
use super::pose::Pose;
use super::space::{self, Conversion};
use crate::colour::{Curve, Primaries};
use crate::panorama::Image;
use crate::{Error, Finding, Result};

/// Bytes of the longest header that is read.
const MAX_HEADER_BYTES: u64 = 1 << 20;

/// What the header says.
struct Header {
    width: usize,
    height: usize,
    /// Divides R, G and B: the product of all EXPOSURE and COLORCORR lines.
    exposure: [f64; 3],
    /// Bytes up to the first scan line.
    length: u64,
    /// What makes linear Rec.709 of the pixels; `None` where they are.
    conversion: Option<Conversion>,
    findings: Vec<Finding>,
}

/// Decodes the file.
pub(super) fn decode(path: &Path, file: &[u8]) -> Result<Decoded> {
    let mut reader = file;
    let header = read_header(path, &mut reader)?;
    let Header { width, height, exposure, .. } = header;
    check_size(path, width, height)?;
    // The shortest scan line is one pixel and repetitions: 4 bytes.
    let available = (file.len() as u64).saturating_sub(header.length);
    if (height as u64) * 4 > available {
        return Err(Error::invalid(
            path,
            format!(
                "the header claims {width} x {height} pixels, but only {available} bytes follow: the file is cut off"
            ),
        ));
    }
    // The decoder gets a header without surprises, whatever line ends and comments the file had.
    let plain = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n");
    let mut pixels = guard(path, || {
        let decoder =
            HdrDecoder::with_strictness(Cursor::new(plain).chain(reader), false).map_err(|e| convert_error(path, e))?;
        let mut pixels = vec![[0.0f32; 3]; width * height];
        decoder.read_image(bytemuck::cast_slice_mut(&mut pixels)).map_err(|e| convert_error(path, e))?;
        Ok(pixels)
    })?;
    if exposure != [1.0; 3] {
        for pixel in &mut pixels {
            *pixel = std::array::from_fn(|c| (f64::from(pixel[c]) / exposure[c]) as f32);
        }
    }
    Ok(Decoded {
        image: Image::new(width, height, pixels),
        channel_names: ["R", "G", "B", ""].map(String::from),
        half_float: [false; 3],
        pose: Pose::default(),
        mapping: None,
        conversion: header.conversion,
        findings: header.findings,
    })
}

/// Reads the lines up to and including the resolution.
fn read_header(path: &Path, reader: &mut impl BufRead) -> Result<Header> {
    let mut length = 0;
    let mut next_line = || -> Result<String> {
        let mut line = Vec::new();
        reader.take(MAX_HEADER_BYTES - length).read_until(b'\n', &mut line).map_err(|e| Error::io(path, e))?;
        length += line.len() as u64;
        if line.pop() != Some(b'\n') {
            return Err(Error::invalid(
                path,
                "the header does not end; expected lines, an empty line, and `-Y height +X width`: the file is cut off or damaged",
            ));
        }
        Ok(String::from_utf8_lossy(&line).trim_end_matches('\r').to_string())
    };

    next_line()?; // the signature, which brought us here
    let mut exposure = [1.0f64; 3];
    let mut findings = Vec::new();
    let mut primaries = None;
    let mut xyz = false;
    // XYZ of Radiance is photometric, and its programs say so by a factor that they write into EXPOSURE.
    let mut photometric = false;
    loop {
        let line = next_line()?;
        photometric |= line.contains("EXPOSURE") || line.contains("ra_xyze");
        if line.is_empty() {
            break;
        }
        let Some((key, value)) = line.split_once('=') else { continue };
        let value = value.trim();
        // Comments; and, indented, the headers of the pictures that this one was made of.
        if line.starts_with('#') || line.starts_with([' ', '\t']) {
            continue;
        }
        match key.trim() {
            "FORMAT" if value == "32-bit_rle_rgbe" => {}
            "FORMAT" if value == "32-bit_rle_xyze" => xyz = true,
            "FORMAT" => {
                return Err(Error::unsupported(
                    path,
                    format!(
                        "the header says FORMAT={value}; expected 32-bit_rle_rgbe or 32-bit_rle_xyze: save it as \
                         Radiance RGBE"
                    ),
                ));
            }
            "EXPOSURE" => {
                let [factor] = factors(path, &line, value)?;
                exposure = exposure.map(|e| e * factor);
            }
            "COLORCORR" => {
                let factors: [f64; 3] = factors(path, &line, value)?;
                exposure = std::array::from_fn(|c| exposure[c] * factors[c]);
            }
            // The last one counts, as in Radiance.
            "PRIMARIES" => primaries = Some(parse_primaries(path, &line, value)?),
            "GAMMA" if value.parse() != Ok(1.0f64) => findings.push(Finding::new(
                "hdr-gamma",
                1,
                format!("the header says GAMMA={value}; the pixels are taken as linear all the same"),
            )),
            _ => {}
        }
    }
    if exposure.iter().any(|e| !(e.is_finite() && *e > 0.0)) {
        return Err(Error::invalid(path, format!("EXPOSURE and COLORCORR multiply to {exposure:?}; expected > 0")));
    }
    let conversion = match primaries {
        _ if xyz => Some(of_xyz(photometric, &mut findings)),
        Some(primaries) => {
            space::of_primaries("hdr-primaries", "the header line PRIMARIES", Curve::Linear, primaries, &mut findings)
        }
        None => None,
    };
    let (width, height) = parse_resolution(path, &next_line()?)?;
    Ok(Header { width, height, exposure, length, conversion, findings })
}

/// Lumens per watt of white light in Radiance (WHTEFFICACY of its `color.h`).
const WHITE_EFFICACY: f64 = 179.0;

/// The conversion of a picture in XYZ. Radiance's XYZ has the equal-energy white, and is in lumens where RGB is in
/// watts: `ra_xyze` writes EXPOSURE=5.5866e-03, 1/179, when it makes XYZ of RGB. A file without any EXPOSURE is not of
/// such a program, and its numbers are taken as they are.
fn of_xyz(photometric: bool, findings: &mut Vec<Finding>) -> Conversion {
    let place = "the header line FORMAT=32-bit_rle_xyze";
    let conversion = space::of_primaries("hdr-xyz", place, Curve::Linear, Primaries::XYZ, findings);
    let conversion = conversion.expect("XYZ is not Rec.709");
    if !photometric {
        return conversion;
    }
    let message =
        format!("{place} means lumens: the light was divided by {WHITE_EFFICACY} lumens per watt, as Radiance does");
    findings.push(Finding::new("hdr-lumens", 1, message));
    conversion.scaled(1.0 / WHITE_EFFICACY)
}

/// `rx ry gx gy bx by wx wy`.
fn parse_primaries(path: &Path, line: &str, value: &str) -> Result<Primaries> {
    let numbers: Option<Vec<f64>> = value.split_whitespace().map(|word| word.parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[rx, ry, gx, gy, bx, by, wx, wy]) => {
            Ok(Primaries { red: [rx, ry], green: [gx, gy], blue: [bx, by], white: [wx, wy] })
        }
        _ => Err(Error::invalid(
            path,
            format!("the header line `{line}` should have 8 numbers: x and y of red, green, blue and white"),
        )),
    }
}

/// `N` positive numbers.
fn factors<const N: usize>(path: &Path, line: &str, value: &str) -> Result<[f64; N]> {
    let numbers: Vec<f64> = value.split_whitespace().filter_map(|word| word.parse().ok()).collect();
    let all = numbers.len() == value.split_whitespace().count();
    match <[f64; N]>::try_from(numbers) {
        Ok(numbers) if all && numbers.iter().all(|n| n.is_finite() && *n > 0.0) => Ok(numbers),
        _ => Err(Error::invalid(path, format!("the header line `{line}` should have {N} number(s) > 0"))),
    }
}

/// `-Y height +X width`: rows from the top, pixels from the left.
fn parse_resolution(path: &Path, line: &str) -> Result<(usize, usize)> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let size = |word: &str| word.parse::<usize>().ok();
    if let [a, first, b, second] = words[..]
        && let (Some(first), Some(second)) = (size(first), size(second))
    {
        if (a, b) == ("-Y", "+X") {
            return Ok((second, first));
        }
        let axis = |word: &str| matches!(word, "-X" | "+X" | "-Y" | "+Y");
        if axis(a) && axis(b) && a[1..] != b[1..] {
            return Err(Error::unsupported(
                path,
                format!(
                    "the rows are stored in the order `{line}`; expected -Y … +X …: turn it with Radiance's `pflip` or `protate`"
                ),
            ));
        }
    }
    Err(Error::invalid(path, format!("the resolution line is `{line}`; expected `-Y height +X width`")))
}

fn convert_error(path: &Path, error: ImageError) -> Error {
    match error {
        ImageError::IoError(source) if source.kind() != ErrorKind::UnexpectedEof => Error::io(path, source),
        ImageError::IoError(_) => Error::invalid(path, "the file ends before its last scan line: it is cut off"),
        ImageError::Unsupported(what) => Error::unsupported(path, what.to_string()),
        other => Error::invalid(path, format!("the scan lines are damaged: {other}")),
    }
}
