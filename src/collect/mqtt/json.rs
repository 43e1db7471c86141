//! Values, times and qualities out of JSON and plain numbers. Pure; what cannot be read is refused, never guessed.

use super::config::TimeUnit;
use crate::signal::{BadReason, Quality};
use serde_json::Value;

/// Most steps of a path.
const MAX_STEPS: usize = 32;
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
    /// Reads a path.
    ///
    /// # Errors
    /// What is wrong with it.
    pub(super) fn parse(text: &str) -> Result<Self, String> {
        let wrong = || format!("'{text}' is not a path such as values.op, items[0].v or ['a.b'].v");
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
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Refused {
    /// Neither JSON nor a number.
    Payload,
    /// Nothing is where the value should be, or it is no number.
    Value,
    /// The time is missing or none.
    Time,
    /// The quality is missing.
    Quality,
}

impl Refused {
    pub(super) fn as_str(self) -> &'static str {
        match self {
            Refused::Payload => "the payload is neither JSON nor a number",
            Refused::Value => "there is no number where the value should be",
            Refused::Time => "there is no time where it should be",
            Refused::Quality => "there is no quality where it should be",
        }
    }
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
}

/// Where in the payload a tag's value stands.
pub(super) struct Where<'p> {
    pub(super) value: Option<&'p Path>,
    pub(super) time: Option<&'p Path>,
    pub(super) quality: Option<&'p Path>,
    pub(super) unit: TimeUnit,
    pub(super) good_values: Option<&'p [String]>,
}

/// A payload, read once for all tags of its topic. Too deep a nesting is refused by the parser.
pub(super) fn parse(payload: &[u8]) -> Result<Value, Refused> {
    serde_json::from_slice(payload).map_err(|_| Refused::Payload)
}

/// What a payload tells of a tag.
pub(super) fn told(document: &Value, place: &Where) -> Result<Told, Refused> {
    let Some(path) = place.value else {
        let raw = number(document).ok_or(Refused::Value)?;
        return Ok(Told { raw: Some(raw), t: None, quality: Quality::Good });
    };
    let quality = match place.quality {
        Some(path) => quality(path.find(document).ok_or(Refused::Quality)?, place.good_values)?,
        None => Quality::Good,
    };
    let t = match place.time {
        Some(path) => {
            Some(path.find(document).and_then(|value| time(value, place.unit)).ok_or(Refused::Time)?)
        }
        None => None,
    };
    let value = path.find(document).ok_or(Refused::Value)?;
    match (number(value), quality) {
        (Some(raw), _) => Ok(Told { raw: Some(raw), t, quality }),
        // null says that there is no value; anything else that is no number says nothing.
        (None, _) if value.is_null() => {
            let reason = match quality {
                Quality::Bad(reason) => reason,
                _ => BadReason::NotANumber,
            };
            Ok(Told { raw: None, t, quality: Quality::Bad(reason) })
        }
        (None, _) => Err(Refused::Value),
    }
}

/// A finite number, a truth value, or text that is nothing but a number.
fn number(value: &Value) -> Option<f64> {
    let number = match value {
        Value::Number(number) => number.as_f64(),
        Value::Bool(on) => Some(f64::from(u8::from(*on))),
        Value::String(text) => text.trim().parse().ok(),
        _ => None,
    };
    number.filter(|number| number.is_finite())
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
fn time(value: &Value, unit: TimeUnit) -> Option<f64> {
    let t = match value {
        Value::Number(number) => number.as_f64()? / unit.per_second(),
        Value::String(text) => {
            let stamp: jiff::Timestamp = text.trim().parse().ok()?;
            stamp.as_second() as f64 + f64::from(stamp.subsec_nanosecond()) * 1e-9
        }
        _ => return None,
    };
    TIMES.contains(&t).then_some(t)
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
        let path = |text: Option<&str>| text.map(|text| Path::parse(text).unwrap());
        let (value, time, quality) = (path(value), path(time), path(quality));
        let place = Where {
            value: value.as_ref(),
            time: time.as_ref(),
            quality: quality.as_ref(),
            unit: TimeUnit::Ms,
            good_values: None,
        };
        told(&parse(payload.as_bytes())?, &place)
    }

    #[test]
    fn values_are_found_by_their_paths() {
        let text = r#"{"v":{"op":41.5,"a.b":[1,{"x":"2.5"}]},"t":1700000000250,"iso":"2023-11-14T23:13:20.5+01:00","q":"Good"}"#;
        let told = of(text, Some("v.op"), Some("t"), Some("q")).unwrap();
        assert_eq!(told, Told { raw: Some(41.5), t: Some(1_700_000_000.25), quality: Quality::Good });
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
        for value in ["\"x\"", "[1]", "{}", "\"inf\"", "\"nan\"", "\"\""] {
            let text = format!(r#"{{"v":{value},"t":1700000000000,"q":"good"}}"#);
            assert_eq!(all(&text), Err(Refused::Value), "{value}");
        }
        assert_eq!(all(r#"{"v":1e999,"t":1700000000000,"q":"good"}"#), Err(Refused::Payload));
        for time in ["1", "\"2023-11-14T23:13:20\"", "\"now\"", "null", "-1", "1e300"] {
            assert_eq!(all(&format!(r#"{{"v":1,"t":{time},"q":"good"}}"#)), Err(Refused::Time), "{time}");
        }
        assert_eq!(all(r#"{"v":1,"t":1700000000000}"#), Err(Refused::Quality));
        assert_eq!(of("{\"v\":1}", None, None, None), Err(Refused::Value));
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
            assert!(Path::parse(text).is_err(), "{text}");
        }
        assert!(Path::parse(&"a.".repeat(40)).is_err());
    }

    proptest! {
        #[test]
        fn any_path_is_read_or_refused(text in "[a-c.$\\[\\]'0-9]{0,20}") {
            let _ = Path::parse(&text);
        }

        /// Whatever is sent: no panic, and no number that is not finite or that the payload does not hold.
        #[test]
        fn any_payload_tells_a_finite_number_or_nothing(bytes in prop::collection::vec(any::<u8>(), 0..60)) {
            let text = String::from_utf8_lossy(&bytes);
            if let Ok(told) = of(&text, None, None, None) {
                let raw = told.raw.unwrap();
                prop_assert!(raw.is_finite());
                prop_assert!(text.contains(|c: char| c.is_ascii_digit()) || text.contains("true") || text.contains("false"));
            }
        }

        #[test]
        fn numbers_come_back(number in any::<f64>().prop_filter("finite", |x| x.is_finite())) {
            let told = of(&serde_json::json!({"v": number}).to_string(), Some("v"), None, None).unwrap();
            prop_assert_eq!(told.raw, Some(number));
        }
    }
}
