//! Reads truth to compare with: a JSON of sets of places, as `assets/uffizi-box/reference.json`.
//!
//! ```text
//! { "what": "…",                                 what is no object is for people, but for
//!   "level": "room.glb",                         whose light it is; may be missing; a set may name another
//!   "grid": { "position": [[x, y, z], …],         every object is a set; world metres
//!             "sh": [[[r, g, b], …], …],          by place and coefficient (1, 4, 9, 16 or 25): radiance as in gdibl
//!             "standard_error": [[[r, g, b], …], …] },   may be missing
//!   "ball": { "position": …,
//!             "normal": [[x, y, z], …],           unit length
//!             "irradiance": [[r, g, b], …],       E at that normal
//!             "standard_error": [[r, g, b], …] } }
//! ```
//! Sets come sorted by name. Fields with other names are for people, too.

use gdibl_runtime::{RadianceSh, sh};
use serde_json::{Map, Value};
use std::path::Path;

use crate::analyse::{Truth, TruthLight, TruthNoise, radiance_sh};
use crate::{Error, Result};

/// A normal may be this far from unit length: six digits, and some.
const UNIT: f32 = 1e-3;

/// Whether bytes begin as JSON does that holds an object; a volume begins otherwise.
pub fn is_json(bytes: &[u8]) -> bool {
    bytes.trim_ascii_start().starts_with(b"{")
}

/// Reads every set of a file.
pub fn read_reference(path: &Path) -> Result<Vec<Truth>> {
    parse_reference(path, &std::fs::read(path).map_err(|error| Error::io(path, error))?)
}

/// Reads every set from the bytes of the file at `path`.
pub fn parse_reference(path: &Path, bytes: &[u8]) -> Result<Vec<Truth>> {
    let fields: Map<String, Value> = serde_json::from_slice(bytes)
        .map_err(|error| Error::invalid(path, format!("{error}: expected a JSON object of sets of places")))?;
    let sets = fields.iter().filter_map(|(name, value)| Some((name, value.as_object()?)));
    let truths = sets
        .map(|(name, set)| SetReader { path, name, fields: set, all: &fields }.read())
        .collect::<Result<Vec<Truth>>>()?;
    if truths.is_empty() {
        let message = "holds no set of places: expected objects with 'position', and 'sh' or 'normal' and 'irradiance'";
        return Err(Error::invalid(path, message));
    }
    Ok(truths)
}

/// One set on its way in.
struct SetReader<'a> {
    path: &'a Path,
    name: &'a str,
    fields: &'a Map<String, Value>,
    /// The fields beside the sets.
    all: &'a Map<String, Value>,
}

impl SetReader<'_> {
    fn read(&self) -> Result<Truth> {
        let positions = self.triples("position", None)?;
        let places = positions.len();
        if places == 0 {
            return Err(self.invalid("position", "no place", "at least one"));
        }
        let sure = self.fields.contains_key("standard_error");
        let (normals, light, noise) = if self.fields.contains_key("sh") {
            let radiance = self.radiance("sh", places, None)?;
            let count = sh::coefficient_count(radiance[0].bands);
            let noise = match sure {
                true => TruthNoise::Radiance(self.radiance("standard_error", places, Some(count))?),
                false => TruthNoise::Unknown,
            };
            (Vec::new(), TruthLight::Radiance(radiance), noise)
        } else {
            let light = TruthLight::Irradiance(self.light("irradiance", places)?);
            let noise = match sure {
                true => TruthNoise::Irradiance(self.light("standard_error", places)?),
                false => TruthNoise::Unknown,
            };
            (self.normals(places)?, light, noise)
        };
        let level = self.fields.get("level").or_else(|| self.all.get("level")).and_then(Value::as_str);
        let level = level.unwrap_or_default().to_string();
        Ok(Truth { name: self.name.into(), level, positions, normals, valid: Vec::new(), light, noise })
    }

    fn normals(&self, places: usize) -> Result<Vec<[f32; 3]>> {
        let normals = self.light("normal", places)?;
        let length = |normal: &[f32; 3]| normal.iter().map(|v| v * v).sum::<f32>().sqrt();
        match normals.iter().position(|normal| (length(normal) - 1.0).abs() > UNIT) {
            None => Ok(normals),
            Some(place) => {
                let found = format!("one of length {}", length(&normals[place]));
                Err(self.invalid(&format!("normal of place {place}"), &found, "a unit normal"))
            }
        }
    }

    /// Three single floats per place.
    fn light(&self, field: &str, places: usize) -> Result<Vec<[f32; 3]>> {
        let triples = self.triples(field, Some(places))?;
        triples.iter().enumerate().map(|(i, triple)| self.rgb(&format!("{field} of place {i}"), triple)).collect()
    }

    /// Coefficients per place, `count` of them where that is given.
    fn radiance(&self, field: &str, places: usize, mut count: Option<usize>) -> Result<Vec<RadianceSh>> {
        let mut nodes = Vec::with_capacity(places);
        for (node, value) in self.list(field, Some(places))?.iter().enumerate() {
            let place = format!("{field} of place {node}");
            let values = value.as_array().ok_or_else(|| self.invalid(&place, &describe(value), "a list"))?;
            let bands = (0..=sh::MAX_BANDS).find(|&bands| sh::coefficient_count(bands) == values.len());
            // All places have what the first one has.
            let bands = bands.filter(|_| *count.get_or_insert(values.len()) == values.len()).ok_or_else(|| {
                let expected = count.map_or("1, 4, 9, 16 or 25".into(), |count| count.to_string());
                self.invalid(&place, &format!("{} coefficients", values.len()), &expected)
            })?;
            let mut coefficients = Vec::with_capacity(values.len());
            for (i, value) in values.iter().enumerate() {
                let place = format!("{place}, coefficient {i}");
                coefficients.push(self.rgb(&place, &self.triple(&place, value)?)?);
            }
            nodes.push(radiance_sh(bands, coefficients));
        }
        Ok(nodes)
    }

    fn triples(&self, field: &str, places: Option<usize>) -> Result<Vec<[f64; 3]>> {
        let list = self.list(field, places)?.iter().enumerate();
        list.map(|(i, value)| self.triple(&format!("{field} of place {i}"), value)).collect()
    }

    /// The list of that name, as long as there are places where that is known.
    fn list(&self, field: &str, places: Option<usize>) -> Result<&[Value]> {
        let found = self.fields.get(field);
        let Some(list) = found.and_then(Value::as_array) else {
            return Err(self.invalid(field, &found.map_or("nothing".into(), describe), "a list, one entry per place"));
        };
        match places {
            Some(places) if list.len() != places => Err(self.invalid(
                field,
                &format!("a list of {}", list.len()),
                &format!("one entry for each of {places} places"),
            )),
            _ => Ok(list),
        }
    }

    fn triple(&self, place: &str, value: &Value) -> Result<[f64; 3]> {
        let numbers: Option<Vec<f64>> = value.as_array().and_then(|list| list.iter().map(Value::as_f64).collect());
        let triple = numbers.and_then(|numbers| <[f64; 3]>::try_from(numbers).ok());
        triple.ok_or_else(|| self.invalid(place, &describe(value), "three numbers"))
    }

    /// Three numbers as single floats; an error may not be negative.
    fn rgb(&self, place: &str, triple: &[f64; 3]) -> Result<[f32; 3]> {
        let rgb = triple.map(|v| v as f32);
        if !rgb.iter().all(|v| v.is_finite()) {
            return Err(self.invalid(place, &format!("{triple:?}"), "numbers that a single float holds"));
        }
        if place.starts_with("standard_error") && rgb.iter().any(|v| *v < 0.0) {
            return Err(self.invalid(place, &format!("{triple:?}"), "at least 0"));
        }
        Ok(rgb)
    }

    fn invalid(&self, place: &str, found: &str, expected: &str) -> Error {
        Error::invalid(self.path, format!("set '{}', {place}: found {found}, expected {expected}", self.name))
    }
}

/// A value in a few words.
fn describe(value: &Value) -> String {
    match value {
        Value::Null => "null".into(),
        Value::Array(list) if list.len() <= 4 && !list.iter().any(|v| v.is_array() || v.is_object()) => {
            value.to_string()
        }
        Value::Array(list) => format!("a list of {}", list.len()),
        Value::Object(_) => "an object".into(),
        Value::String(_) => "text".into(),
        Value::Bool(_) | Value::Number(_) => value.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn parse(value: &Value) -> Result<Vec<Truth>> {
        parse_reference(Path::new("truth.json"), value.to_string().as_bytes())
    }

    fn reference() -> Value {
        json!({ "what": "two sets",
                "room": { "position": [[0, 0, 0], [1, 2, 3]], "sh": [[[1, 2, 3]], [[4, 5, 6]]],
                          "standard_error": [[[0, 0.5, 0]], [[0.1, 0, 0]]] },
                "ball": { "position": [[1, 1, 1]], "normal": [[0, 0, 1]], "irradiance": [[7, 8, 9]] } })
    }

    #[test]
    fn sets_are_read_in_order_of_their_names() {
        let truths = parse(&reference()).unwrap();
        assert_eq!(truths.iter().map(|truth| truth.name.as_str()).collect::<Vec<_>>(), ["ball", "room"]);
        assert_eq!(truths[0].normals, [[0.0, 0.0, 1.0]]);
        assert_eq!(truths[0].light, TruthLight::Irradiance(vec![[7.0, 8.0, 9.0]]));
        assert_eq!(truths[0].noise, TruthNoise::Unknown);
        assert_eq!(truths[1].positions, [[0.0; 3], [1.0, 2.0, 3.0]]);
        let nodes = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]].map(|rgb| radiance_sh(0, [rgb]));
        assert_eq!(truths[1].light, TruthLight::Radiance(nodes.into()));
        let errors = [[0.0, 0.5, 0.0], [0.1, 0.0, 0.0]].map(|rgb| radiance_sh(0, [rgb]));
        assert_eq!(truths[1].noise, TruthNoise::Radiance(errors.into()));
    }

    #[test]
    fn level_is_that_of_the_set_or_of_all() {
        let mut named = reference();
        assert!(parse(&named).unwrap().iter().all(|truth| truth.level.is_empty()));
        named["level"] = json!("room.glb");
        named["ball"]["level"] = json!("ball.glb");
        let levels: Vec<String> = parse(&named).unwrap().into_iter().map(|truth| truth.level).collect();
        assert_eq!(levels, ["ball.glb", "room.glb"]);
    }

    #[test]
    fn damage_is_named_with_its_place() {
        let cases: [(&str, Value, &[&str]); 14] = [
            ("/room/position/1", json!([1, 2]), &["'room'", "position of place 1", "[1,2]", "three numbers"]),
            ("/room/position/1/0", Value::Null, &["position of place 1", "three numbers"]),
            ("/room/position", json!([]), &["'room'", "no place"]),
            ("/room/position", json!("here"), &["found text", "a list"]),
            ("/room/sh", json!([[[1, 2, 3]]]), &["sh", "a list of 1", "2 places"]),
            ("/room/sh/1", json!([[1, 2, 3], [1, 2, 3]]), &["sh of place 1", "2 coefficients"]),
            ("/room/sh/1", json!([[1, 2, 3], [1, 2, 3], [1, 2, 3], [1, 2, 3]]), &["4 coefficients", "expected 1"]),
            ("/room/sh/1/0/2", json!(1e99), &["sh of place 1, coefficient 0", "single float"]),
            ("/room/standard_error/0/0/1", json!(-0.5), &["standard_error of place 0", "at least 0"]),
            ("/room/standard_error/0", json!([]), &["standard_error of place 0", "0 coefficients", "expected 1"]),
            ("/ball/normal/0", json!([0, 0, 2]), &["'ball'", "normal of place 0", "length 2", "unit"]),
            ("/ball/normal", json!(null), &["normal", "found null"]),
            ("/ball/irradiance", json!([]), &["irradiance", "a list of 0", "1 places"]),
            ("/ball/irradiance/0/0", json!("red"), &["irradiance of place 0"]),
        ];
        for (pointer, value, words) in cases {
            let mut damaged = reference();
            *damaged.pointer_mut(pointer).expect(pointer) = value;
            let message = parse(&damaged).expect_err(pointer).to_string();
            assert!(message.starts_with("truth.json: "), "{message}");
            words.iter().for_each(|word| assert!(message.contains(word), "{pointer}: no '{word}' in {message}"));
        }
        for text in
            ["{}", r#"{"what": "nothing"}"#, "[]", "{", r#"{"a": {}}"#, "{\"a\": {\"position\": [[NaN,0,0]]}}", ""]
        {
            assert!(parse_reference(Path::new("x"), text.as_bytes()).is_err(), "{text}");
        }
    }

    #[test]
    fn first_bytes_tell_json_from_volumes() {
        assert!(is_json(b"{}") && is_json(b" \r\n\t{"));
        assert!(!is_json(b"\x89GDIBL\n\x1a") && !is_json(b"") && !is_json(b"[1]"));
    }
}
