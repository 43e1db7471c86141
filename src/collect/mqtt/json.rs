//! Values, times and qualities out of JSON and plain numbers. Pure; what cannot be read is refused, never guessed.

use super::config::TimeUnit;
use crate::collect::DecimalSign;
use crate::collect::text_value::{self, TextFault};
use crate::signal::{BadReason, Quality};
use crate::table::number::bare;
use serde_json::Value;
use std::fmt;

/// Most steps of a path.
const MAX_STEPS: usize = 32;
/// Longest payload that is taken for a plain value (bytes).
const LONGEST_TEXT: usize = 512;
/// Times before 1980 or after 2200 are no times of measurements (s).
const TIMES: std::ops::RangeInclusive<f64> = 315_532_800.0..=7_258_118_400.0;

/// A path into JSON: `values.op`, `items[0].v`, `['a.b'].v`; a leading `$.` may stand or not.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Path(Vec<Step>);

#[derive(Clone, Debug, PartialEq, Eq)]
enum Step {
    Key(String),
    At(usize),
}

impl Path {
    /// Reads the path that a field gives.
    ///
    /// # Errors
    /// What is wrong with it.
    pub(super) fn parse(field: &str, text: &str) -> Result<Self, String> {
        let wrong = || format!("'{text}' is not a path such as values.op, items[0].v or ['a.b'].v");
        if text.starts_with('/') {
            let dotted = text.trim_matches('/').replace('/', ".");
            return Err(format!("'{text}' has / where a path has points: write {dotted}"));
        }
        if text.trim() != text {
            return Err(format!("'{text}' has a blank before or after it: write '{}'", text.trim()));
        }
        let mut steps = Vec::new();
        let mut rest = text.strip_prefix('$').unwrap_or(text);
        rest = rest.strip_prefix('.').unwrap_or(rest);
        while !rest.is_empty() {
            if let Some(inside) = rest.strip_prefix('[') {
                let quoted = inside.strip_prefix('\'').and_then(|inside| inside.split_once("']"));
                if let Some((key, after)) = quoted {
                    steps.push(Step::Key(key.into()));
                    rest = after;
                } else {
                    let (index, after) = inside.split_once(']').ok_or_else(wrong)?;
                    steps.push(Step::At(index.parse().map_err(|_| wrong())?));
                    rest = after;
                }
            } else {
                let end = rest.find(['.', '[']).unwrap_or(rest.len());
                let (key, after) = rest.split_at(end);
                if key.is_empty() || key.contains([']', '\'']) {
                    return Err(wrong());
                }
                steps.push(Step::Key(key.into()));
                rest = after;
            }
            match rest.strip_prefix('.') {
                Some("") => return Err(wrong()),
                Some(after) => rest = after,
                None if rest.is_empty() || rest.starts_with('[') => {}
                None => return Err(wrong()),
            }
        }
        if steps.is_empty() {
            let (path, without) = match field {
                "time_path" => ("values.t", "has no time"),
                "quality_path" => ("values.quality", "has no quality"),
                _ => ("values.op", "is a plain number"),
            };
            return Err(format!(
                "'{text}' names nothing in the message: write a path such as {path}, or leave the key out where the \
                 message {without}"
            ));
        }
        if (1..=MAX_STEPS).contains(&steps.len()) { Ok(Self(steps)) } else { Err(wrong()) }
    }

    fn find<'v>(&self, value: &'v Value) -> Option<&'v Value> {
        self.0.iter().try_fold(value, |value, step| match step {
            Step::Key(key) => value.as_object()?.get(key),
            Step::At(at) => value.as_array()?.get(*at),
        })
    }
}

/// Why a message gives a tag nothing.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Refused {
    /// Neither JSON nor a number.
    Payload,
    /// Nothing is where the value should be, or it is no number.
    Value,
    /// There is a text, and it is no number.
    Text(TextFault),
    /// The time is missing or none.
    Time,
    /// The time is none in its unit, and would be one in another.
    TimeUnit { told: f64, unit: TimeUnit, fits: TimeUnit },
    /// The time says nothing of its offset from UTC.
    NoOffset(String),
    /// The quality is missing.
    Quality,
}

impl fmt::Display for Refused {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Refused::Payload => out.write_str("the payload is neither JSON nor a number"),
            Refused::Value => out.write_str("there is no number where the value should be"),
            Refused::Text(fault) => fault.fmt(out),
            Refused::Time => out.write_str("there is no time where it should be"),
            Refused::TimeUnit { told, unit, fits } => write!(
                out,
                "the time {told} is of the year {} as time_unit = \"{}\": is time_unit \"{}\"?",
                year(told / unit.per_second()),
                unit.name(),
                fits.name()
            ),
            Refused::NoOffset(text) => write!(
                out,
                "the time '{text}' tells no offset from UTC: have it sent with one, such as Z or +01:00"
            ),
            Refused::Quality => out.write_str("there is no quality where it should be"),
        }
    }
}

/// The year of a time (s since 1970), as near as an error has to say it.
fn year(t: f64) -> f64 {
    1970.0 + (t / 31_556_952.0).floor()
}

/// A value as a message tells it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Told {
    /// The number, before scaling; `None` where the source says it has none.
    pub(super) raw: Option<f64>,
    /// When it held (s), where that is told.
    pub(super) t: Option<f64>,
    /// What the source thinks of it.
    pub(super) quality: Quality,
    /// Whether it comes from a buffer, after later ones.
    pub(super) buffered: bool,
}

/// Where in the payload a tag's value stands.
pub(super) struct Where<'p> {
    pub(super) value: Option<&'p Path>,
    pub(super) decimal: Option<DecimalSign>,
    pub(super) time: Option<&'p Path>,
    pub(super) quality: Option<&'p Path>,
    pub(super) unit: TimeUnit,
    pub(super) good_values: Option<&'p [String]>,
}

/// A payload, read once for all tags of its topic.
pub(super) struct Document {
    json: Option<Value>,
    /// The payload itself, where it is short enough to be a plain value.
    text: Option<String>,
}

/// Reads a payload, which may be a `plain` value where a tag of its topic has no path. Too deep a nesting is refused by the
/// parser.
///
/// # Errors
/// [`Refused::Payload`], when it can be neither JSON nor a plain value.
pub(super) fn parse(payload: &[u8], plain: bool) -> Result<Document, Refused> {
    // A byte order mark before it and the zero byte of a C string behind it belong to no value.
    let payload = payload.strip_prefix(b"\xef\xbb\xbf").unwrap_or(payload);
    let end = payload.iter().rposition(|byte| *byte != 0).map_or(0, |at| at + 1);
    let payload = &payload[..end];
    let json = serde_json::from_slice(payload).ok();
    let text = (plain && payload.len() <= LONGEST_TEXT).then(|| plain_text(payload));
    let text = text.filter(|text| !text.is_empty() && !text.starts_with(['{', '[']));
    if json.is_none() && text.is_none() { Err(Refused::Payload) } else { Ok(Document { json, text }) }
}

/// A short payload as text: UTF-8, and else Latin-1, in which old devices write their degrees.
fn plain_text(payload: &[u8]) -> String {
    let text = std::str::from_utf8(payload).map(str::to_string);
    let text = text.unwrap_or_else(|_| payload.iter().map(|byte| char::from(*byte)).collect());
    bare(&text).to_string()
}

/// What a payload tells of a tag.
pub(super) fn told(document: &Document, place: &Where) -> Result<Told, Refused> {
    let Some(path) = place.value else {
        let raw = plain(document, place.decimal)?;
        return Ok(Told { raw: Some(raw), t: None, quality: Quality::Good, buffered: false });
    };
    let json = document.json.as_ref().ok_or(Refused::Payload)?;
    let quality = match place.quality {
        Some(path) => quality(path.find(json).ok_or(Refused::Quality)?, place.good_values)?,
        None => Quality::Good,
    };
    let t = match place.time {
        Some(path) => Some(time(path.find(json).ok_or(Refused::Time)?, place.unit)?),
        None => None,
    };
    let value = path.find(json).ok_or(Refused::Value)?;
    // null says that there is no value; anything else that is no number says nothing.
    if value.is_null() {
        let reason = match quality {
            Quality::Bad(reason) => reason,
            _ => BadReason::NotANumber,
        };
        return Ok(Told { raw: None, t, quality: Quality::Bad(reason), buffered: false });
    }
    Ok(Told { raw: Some(number(value, place.decimal)?), t, quality, buffered: false })
}

/// The value of a payload that is nothing but one. Its decimal sign is a text's: no JSON is meant.
fn plain(document: &Document, decimal: Option<DecimalSign>) -> Result<f64, Refused> {
    match (&document.json, &document.text) {
        (Some(Value::String(text)), _) => text_value::read(text, decimal).map_err(Refused::Text),
        (_, Some(text)) => text_value::read(text, decimal).map_err(Refused::Text),
        (Some(_), None) => Err(Refused::Value),
        (None, None) => Err(Refused::Payload),
    }
}

/// A finite number, a truth value, or text that is nothing but one of them, with or without its unit.
fn number(value: &Value, decimal: Option<DecimalSign>) -> Result<f64, Refused> {
    match value {
        Value::Number(number) => number.as_f64().filter(|number| number.is_finite()).ok_or(Refused::Value),
        Value::Bool(on) => Ok(f64::from(u8::from(*on))),
        Value::String(text) => text_value::read(text, decimal).map_err(Refused::Text),
        _ => Err(Refused::Value),
    }
}

fn quality(value: &Value, good: Option<&[String]>) -> Result<Quality, Refused> {
    let text = match value {
        Value::String(text) => text.trim().to_lowercase(),
        Value::Number(number) => number.to_string(),
        Value::Bool(on) => on.to_string(),
        _ => return Err(Refused::Quality),
    };
    let is_good = match good {
        Some(values) => values.iter().any(|value| value.to_lowercase() == text),
        None => ["good", "ok", "true", "192"].contains(&text.as_str()),
    };
    Ok(match text.as_str() {
        _ if is_good => Quality::Good,
        "uncertain" | "stale" => Quality::Stale,
        _ => Quality::Bad(BadReason::DeviceException),
    })
}

/// Seconds since 1970: a number in `unit`, or text in ISO 8601 with its offset. Text without an offset is refused: one
/// hour a year it means two times.
fn time(value: &Value, unit: TimeUnit) -> Result<f64, Refused> {
    match value {
        Value::Number(number) => number.as_f64().ok_or(Refused::Time).and_then(|told| counted(told, unit)),
        Value::String(text) => {
            let text = text.trim();
            if let Ok(told) = text.parse() {
                return counted(told, unit);
            }
            if text.parse::<jiff::civil::DateTime>().is_ok() && text.parse::<jiff::Timestamp>().is_err() {
                return Err(Refused::NoOffset(text.into()));
            }
            let stamp: jiff::Timestamp = text.parse().map_err(|_| Refused::Time)?;
            let t = stamp.as_second() as f64 + f64::from(stamp.subsec_nanosecond()) * 1e-9;
            if is_time(t) { Ok(t) } else { Err(Refused::Time) }
        }
        _ => Err(Refused::Time),
    }
}

/// A time that was counted in `unit`; where it cannot be one, the unit in which it could is named.
fn counted(told: f64, unit: TimeUnit) -> Result<f64, Refused> {
    if is_time(told / unit.per_second()) {
        return Ok(told / unit.per_second());
    }
    let fits = TimeUnit::ALL.into_iter().find(|other| is_time(told / other.per_second()));
    Err(fits.map_or(Refused::Time, |fits| Refused::TimeUnit { told, unit, fits }))
}

/// Whether a time (s) can be one of a measurement.
pub(super) fn is_time(t: f64) -> bool {
    TIMES.contains(&t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn of(
        payload: &str,
        value: Option<&str>,
        time: Option<&str>,
        quality: Option<&str>,
    ) -> Result<Told, Refused> {
        let path = |text: Option<&str>| text.map(|text| Path::parse("path", text).unwrap());
        let (value, time, quality) = (path(value), path(time), path(quality));
        let place = Where {
            value: value.as_ref(),
            decimal: None,
            time: time.as_ref(),
            quality: quality.as_ref(),
            unit: TimeUnit::Ms,
            good_values: None,
        };
        told(&parse(payload.as_bytes(), place.value.is_none())?, &place)
    }

    #[test]
    fn values_are_found_by_their_paths() {
        let text = r#"{"v":{"op":41.5,"a.b":[1,{"x":"2.5"}]},"t":1700000000250,"iso":"2023-11-14T23:13:20.5+01:00","q":"Good"}"#;
        let told = of(text, Some("v.op"), Some("t"), Some("q")).unwrap();
        assert_eq!(
            told,
            Told { raw: Some(41.5), t: Some(1_700_000_000.25), quality: Quality::Good, buffered: false }
        );
        let told = of(text, Some("$.v['a.b'][1].x"), Some("iso"), None).unwrap();
        assert_eq!((told.raw, told.t), (Some(2.5), Some(1_700_000_000.5)));
        assert_eq!(of(" 12.5\n", None, None, None).unwrap().raw, Some(12.5));
        assert_eq!(of("true", None, None, None).unwrap().raw, Some(1.0));
        assert_eq!(of("\"7\"", None, None, None).unwrap().raw, Some(7.0));
    }

    #[test]
    fn what_cannot_be_read_is_refused_by_name() {
        let all = |text: &str| of(text, Some("v"), Some("t"), Some("q"));
        assert_eq!(all("{"), Err(Refused::Payload));
        assert_eq!(all(&"[".repeat(100_000)), Err(Refused::Payload));
        assert_eq!(all(r#"{"t":1700000000000,"q":"good"}"#), Err(Refused::Value));
        for value in ["[1]", "{}"] {
            let text = format!(r#"{{"v":{value},"t":1700000000000,"q":"good"}}"#);
            assert_eq!(all(&text), Err(Refused::Value), "{value}");
        }
        for value in ["x", "inf", "nan", ""] {
            let text = format!(r#"{{"v":"{value}","t":1700000000000,"q":"good"}}"#);
            assert_eq!(all(&text), Err(Refused::Text(TextFault::NoNumber(value.into()))), "{value}");
        }
        assert_eq!(all(r#"{"v":1e999,"t":1700000000000,"q":"good"}"#), Err(Refused::Payload));
        for time in ["1", "\"now\"", "null", "-1", "1e300"] {
            assert_eq!(all(&format!(r#"{{"v":1,"t":{time},"q":"good"}}"#)), Err(Refused::Time), "{time}");
        }
        assert_eq!(all(r#"{"v":1,"t":1700000000000}"#), Err(Refused::Quality));
        assert_eq!(of("{\"v\":1}", None, None, None), Err(Refused::Value));
    }

    #[test]
    fn plain_values_are_read_as_devices_write_them() {
        let bytes = |payload: &[u8]| {
            let place = Where {
                value: None,
                decimal: None,
                time: None,
                quality: None,
                unit: TimeUnit::Ms,
                good_values: None,
            };
            told(&parse(payload, true)?, &place).map(|told| told.raw)
        };
        for (payload, value) in [
            (&b"12,5"[..], 12.5),
            ("50.1 °C".as_bytes(), 50.1),
            (b"50.1 \xb0C", 50.1),
            (b"+50.1", 50.1),
            (b"50.1\0", 50.1),
            (b"\xef\xbb\xbf50.1\r\n", 50.1),
            (b"ON", 1.0),
            (b"off", 0.0),
        ] {
            assert_eq!(bytes(payload), Ok(Some(value)), "{payload:?}");
        }
        assert_eq!(bytes(b"1,002"), Err(Refused::Text(TextFault::Doubtful("1,002".into()))));
        assert_eq!(bytes(b"1e999"), Err(Refused::Text(TextFault::NoNumber("1e999".into()))));
        assert_eq!(bytes(b"null"), Err(Refused::Text(TextFault::NoNumber("null".into()))));
        assert_eq!(bytes(b""), Err(Refused::Payload));
        let path = Path::parse("path", "v").unwrap();
        let place = |decimal, value| Where {
            value,
            decimal,
            time: None,
            quality: None,
            unit: TimeUnit::Ms,
            good_values: None,
        };
        let comma = Some(DecimalSign::Comma);
        let document = |text: &str| parse(text.as_bytes(), true).unwrap();
        assert_eq!(told(&document("1,002"), &place(comma, None)).unwrap().raw, Some(1.002));
        assert_eq!(told(&document("1.002"), &place(comma, None)).unwrap().raw, Some(1002.0));
        // A number of JSON is written with a point, whatever a text is.
        assert_eq!(told(&document(r#"{"v":1.002}"#), &place(comma, Some(&path))).unwrap().raw, Some(1.002));
        assert_eq!(told(&document(r#"{"v":"1,002"}"#), &place(comma, Some(&path))).unwrap().raw, Some(1.002));
    }

    #[test]
    fn a_time_in_another_unit_and_one_without_an_offset_are_named() {
        let refused =
            |time: &str| of(&format!(r#"{{"v":1,"t":{time}}}"#), Some("v"), Some("t"), None).unwrap_err();
        let said = refused("1700000000").to_string();
        assert!(said.contains("1970") && said.contains(r#"is time_unit "s"?"#), "{said}");
        assert!(refused("1700000000000000").to_string().contains(r#""us"?"#));
        assert!(refused("\"1700000000\"").to_string().contains(r#""s"?"#));
        let said = refused("\"2023-11-14T23:13:20\"").to_string();
        assert!(said.contains("offset") && said.contains("2023-11-14T23:13:20"), "{said}");
        let text = of(r#"{"v":1,"t":"1700000000250"}"#, Some("v"), Some("t"), None).unwrap();
        assert_eq!(text.t, Some(1_700_000_000.25));
    }

    #[test]
    fn the_sources_quality_is_kept() {
        let quality =
            |q: &str| of(&format!(r#"{{"v":1,"q":{q}}}"#), Some("v"), None, Some("q")).unwrap().quality;
        let bad = Quality::Bad(BadReason::DeviceException);
        for (text, expected) in [
            ("\"GOOD\"", Quality::Good),
            ("192", Quality::Good),
            ("true", Quality::Good),
            ("\"uncertain\"", Quality::Stale),
            ("0", bad),
            ("\"comm failure\"", bad),
        ] {
            assert_eq!(quality(text), expected, "{text}");
        }
        let null = of(r#"{"v":null}"#, Some("v"), None, None).unwrap();
        assert_eq!((null.raw, null.quality), (None, Quality::Bad(BadReason::NotANumber)));
    }

    #[test]
    fn paths_that_are_none_are_refused() {
        for text in ["", "$", ".", "a..b", "a.", "[", "[x]", "a[1", "a]b", "['a", "a[0]b", "a[-1]"] {
            assert!(Path::parse("path", text).is_err(), "{text}");
        }
        assert!(Path::parse("path", &"a.".repeat(40)).is_err());
    }

    proptest! {
        #[test]
        fn any_path_is_read_or_refused(text in "[a-c.$\\[\\]'0-9]{0,20}") {
            let _ = Path::parse("path", &text);
        }

        /// Whatever is sent: no panic, and no number that is not finite or that the payload does not hold.
        #[test]
        fn any_payload_tells_a_finite_number_or_nothing(bytes in prop::collection::vec(any::<u8>(), 0..60)) {
            let text = String::from_utf8_lossy(&bytes);
            if let Ok(told) = of(&text, None, None, None) {
                let raw = told.raw.unwrap();
                prop_assert!(raw.is_finite());
                let word = text.to_lowercase();
                let switch = ["true", "false", "on", "off"].iter().any(|known| word.contains(known));
                prop_assert!(switch || text.contains(|c: char| c.is_ascii_digit()));
            }
        }

        #[test]
        fn numbers_come_back(number in any::<f64>().prop_filter("finite", |x| x.is_finite())) {
            let told = of(&serde_json::json!({"v": number}).to_string(), Some("v"), None, None).unwrap();
            prop_assert_eq!(told.raw, Some(number));
        }
    }
}
