//! JSON as exporters write it, where a strict parser refuses what others read: names that are no UTF-8, halves of
//! surrogate pairs, integers as `24.0`, `null` for what is absent.

use std::borrow::Cow;

use serde_json::{Number, Value};

use super::findings::Findings;

/// Parses JSON. Bytes that are no UTF-8 are taken as Latin-1, and lone halves of surrogate pairs become U+FFFD, each with a
/// finding: they stand in names, where they change no light.
pub(super) fn parse(bytes: &[u8], findings: &mut Findings) -> serde_json::Result<Value> {
    let (text, foreign) = decode(bytes);
    findings.add("json-not-utf8", foreign, || {
        "Bytes of the JSON that are no UTF-8 were read as Latin-1: names with them may look wrong".into()
    });
    match serde_json::from_str(&text) {
        Ok(value) => Ok(value),
        Err(error) => {
            let (mended, lone) = mend_surrogates(&text);
            if lone == 0 {
                return Err(error);
            }
            let value = serde_json::from_str(&mended)?;
            findings.add("json-lone-surrogates", lone, || {
                "Halves of surrogate pairs in the JSON were replaced: names with them may look wrong".into()
            });
            Ok(value)
        }
    }
}

/// Makes one of what means the same: numbers without a fraction become integers (as JSON Schema, by which glTF is
/// specified, has it), and members that are `null` are absent.
pub(super) fn simplify(value: &mut Value) {
    match value {
        Value::Object(object) => {
            object.retain(|_, member| !member.is_null());
            object.values_mut().for_each(simplify);
        }
        Value::Array(elements) => elements.iter_mut().for_each(simplify),
        Value::Number(number) if number.is_f64() => {
            // Beyond 2^53 not every integer is a double.
            let whole = number.as_f64().filter(|n| n.fract() == 0.0 && n.abs() <= 9_007_199_254_740_992.0);
            if let Some(whole) = whole {
                *number = Number::from(whole as i64);
            }
        }
        _ => {}
    }
}

/// The text, and how many bytes of it were no UTF-8.
fn decode(bytes: &[u8]) -> (Cow<'_, str>, u64) {
    if let Ok(text) = std::str::from_utf8(bytes) {
        return (text.into(), 0);
    }
    let mut text = String::with_capacity(bytes.len() + 16);
    let mut foreign = 0;
    for chunk in bytes.utf8_chunks() {
        text.push_str(chunk.valid());
        text.extend(chunk.invalid().iter().map(|byte| char::from(*byte)));
        foreign += chunk.invalid().len() as u64;
    }
    (text.into(), foreign)
}

/// Replaces `\uD800` to `\uDFFF` that are not a high half before a low one; returns how many there were.
fn mend_surrogates(text: &str) -> (String, u64) {
    let bytes = text.as_bytes();
    let unit = |at: usize| -> Option<u32> {
        let digits = bytes.get(at..at + 6)?.strip_prefix(b"\\u")?;
        let digits = std::str::from_utf8(digits).ok().filter(|d| d.bytes().all(|b| b.is_ascii_hexdigit()))?;
        u32::from_str_radix(digits, 16).ok()
    };
    let mut mended = String::with_capacity(text.len());
    let (mut at, mut copied, mut lone) = (0, 0, 0);
    while at < bytes.len() {
        // Only an escape matters, and what it escapes is no escape itself.
        at += match (bytes[at], unit(at)) {
            (b'\\', Some(0xD800..=0xDBFF)) if matches!(unit(at + 6), Some(0xDC00..=0xDFFF)) => 12,
            (b'\\', Some(0xD800..=0xDFFF)) => {
                mended.push_str(&text[copied..at]);
                mended.push_str("\\ufffd");
                copied = at + 6;
                lone += 1;
                6
            }
            (b'\\', _) => 2,
            _ => 1,
        };
    }
    mended.push_str(&text[copied..]);
    (mended, lone)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn parsed(bytes: &[u8]) -> (Value, Vec<(String, u64)>) {
        let mut findings = Findings::default();
        let mut value = parse(bytes, &mut findings).unwrap();
        simplify(&mut value);
        (value, findings.into_vec().into_iter().map(|finding| (finding.id, finding.count)).collect())
    }

    #[test]
    fn whole_numbers_become_integers_and_nulls_absent() {
        let text = br#"{"a":24.0,"b":[1e1,-0.0,0.5,1e300],"c":null,"d":{"e":null,"f":[null]}}"#;
        let (value, findings) = parsed(text);
        assert_eq!(value, json!({ "a": 24, "b": [10, 0, 0.5, 1e300], "d": { "f": [null] } }));
        assert!(value["a"].is_u64() && findings.is_empty());
    }

    #[test]
    fn bytes_that_are_no_utf8_are_latin_1() {
        let (value, findings) = parsed(b"{\"name\":\"Stra\xDFe \xC3\xA4\"}");
        assert_eq!(value["name"], "Stra\u{DF}e \u{E4}");
        assert_eq!(findings, [("json-not-utf8".to_owned(), 1)]);
    }

    #[test]
    fn lone_surrogates_are_replaced_and_pairs_kept() {
        let text = br#"{"a":"\ud83d\ude00","b":"x\ud83dy","c":"\ude00","d":"\ud83d\ud83d\ude00","e":"\\ud83d"}"#;
        let (value, findings) = parsed(text);
        let emoji = "\u{1F600}";
        let expected = json!({
            "a": emoji, "b": "x\u{FFFD}y", "c": "\u{FFFD}", "d": format!("\u{FFFD}{emoji}"), "e": "\\ud83d",
        });
        assert_eq!(value, expected);
        assert_eq!(findings, [("json-lone-surrogates".to_owned(), 3)]);
    }

    #[test]
    fn damaged_json_stays_damaged() {
        for text in [&b"{\"a\":"[..], b"{\"a\":\"\\ud8\"}", b"\xFF", b"{\"a\":\"\\ud800\"", b"{}\0{}"] {
            assert!(parse(text, &mut Findings::default()).is_err(), "{}", text.escape_ascii());
        }
    }
}
