//! The zone that a header says its times are in.

use super::calendar::{is_ambiguous, zone};
use super::header_format::is_format;
use super::options::{self, Unit};

/// Letters for Greenwich.
const UTC: [&str; 3] = ["utc", "gmt", "z"];

/// Words behind the name of times that say no other zone than UTC, or none.
const PLAIN: [&str; 32] = [
    "utc",
    "gmt",
    "z",
    "zulu",
    "coordinated",
    "universal",
    "local",
    "lokal",
    "lokale",
    "locale",
    "time",
    "zeit",
    "times",
    "start",
    "end",
    "begin",
    "stop",
    "date",
    "day",
    "of",
    "iso",
    "rfc",
    "am",
    "pm",
    "server",
    "since",
    "elapsed",
    "excel",
    "serial",
    "unix",
    "epoch",
    "posix",
];
/// Words by which a text speaks of a zone.
const OF_ZONES: [&str; 9] = ["time", "zeit", "utc", "gmt", "hora", "heure", "ora", "zone", "offset"];

/// What the unit of a column of times says of its zone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum HeaderZone {
    /// An offset or a name, as `--tz` has it: `+02:00`, `Europe/Berlin`.
    Offset(String),
    /// Letters, which `--tz` has to say more of.
    Letters(String),
    /// Words that say a zone nobody knows, or nothing of one.
    Words(String),
}

/// The words of a text, in small letters.
fn words(text: &str) -> Vec<String> {
    let words = text.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty());
    words.map(str::to_lowercase).collect()
}

/// Whether a text behind the name of times speaks of a zone: `W. Europe Standard Time`, `(UTC+01:00) Berlin`.
pub fn speaks_of_zone(text: &str) -> bool {
    words(text).iter().any(|word| OF_ZONES.contains(&word.as_str()))
}

/// Whether a text behind the name of times says more than is understood: it is no unit, no format, no zone, and has words that
/// nobody knows, or the number of an offset.
fn is_not_understood(text: &str) -> bool {
    let words = words(text);
    let is_number = |word: &String| word.bytes().all(|byte| byte.is_ascii_digit());
    let is_plain = |word: &String| PLAIN.contains(&word.as_str()) || Unit::of(word).is_some();
    // `UTC 1` is one; `ISO 8601` is none.
    let has_number = speaks_of_zone(text) && words.iter().any(is_number);
    let says_more = has_number || words.iter().any(|word| !is_number(word) && !is_plain(word));
    says_more && !is_format(text) && HeaderZone::of(text).is_none()
}

impl HeaderZone {
    /// What a text behind the name of times says; `None` where it is UTC, a unit, a format, or nothing of the kind.
    pub fn behind_times(text: &str) -> Option<Self> {
        Self::of(text).or_else(|| is_not_understood(text).then(|| Self::Words(text.trim().to_string())))
    }

    /// What a text says that is said to be a zone; `None` for UTC.
    pub fn stated(text: &str) -> Option<Self> {
        /// What is so without them.
        const USUAL: [&str; 6] = ["utc", "gmt", "z", "local", "0", "+0"];
        let text = text.trim();
        if text.is_empty() || USUAL.contains(&text.to_lowercase().as_str()) {
            return None;
        }
        let by_name = || options::zone(text).map(|_| Self::Offset(text.to_string()));
        Self::of(text).or_else(by_name).or_else(|| Some(Self::Words(text.to_string())))
    }

    /// Whether a text behind the name of times says that they are those of UTC.
    pub fn is_utc(text: &str) -> bool {
        words(text).iter().any(|word| UTC.contains(&word.as_str()))
    }

    /// `UTC+02:00`, `GMT-5`, `CEST`; `None` where nothing of the kind stands there, or UTC itself.
    pub fn of(unit: &str) -> Option<Self> {
        let small = unit.trim().to_lowercase();
        // Letters that only one zone has hold for half of a year.
        let of_one = !UTC.contains(&small.as_str()) && zone(&small).is_some();
        if of_one || is_ambiguous(&small) {
            return Some(Self::Letters(unit.trim().to_string()));
        }
        // `Europe/Berlin`; `m3/h` is none.
        if unit.contains('/') && options::zone(unit.trim()).is_some() {
            return Some(Self::Offset(unit.trim().to_string()));
        }
        let rest = small.strip_prefix("utc").or_else(|| small.strip_prefix("gmt")).unwrap_or(&small).trim();
        let digits = rest.strip_prefix(['+', '-'])?;
        let (hours, minutes) = match (digits.split_once(':'), digits.len()) {
            (Some(parts), _) => parts,
            (None, 4) => digits.split_at_checked(2)?,
            (None, _) => (digits, "0"),
        };
        let (hours, minutes): (u8, u8) = (hours.parse().ok()?, minutes.parse().ok()?);
        (hours <= 15 && minutes < 60).then(|| Self::Offset(format!("{}{hours:02}:{minutes:02}", &rest[..1])))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_behind_times_is_a_zone_nothing_of_the_kind_or_asked_for() {
        for text in [
            "UTC",
            "GMT",
            "UTC time",
            "local",
            "local time",
            "s",
            "100 ms",
            "min",
            "-",
            "",
            "hh:mm:ss",
            "2",
            "24 h",
        ] {
            assert!(!is_not_understood(text) && HeaderZone::of(text).is_none(), "{text}");
        }
        for text in ["ISO 8601", "start", "End time", "dd/mm/yyyy hh:mm", "Coordinated Universal Time"] {
            assert!(!is_not_understood(text), "{text}");
        }
        for text in ["+02:00", "UTC+02:00", "GMT-5", "Europe/Berlin"] {
            assert!(matches!(HeaderZone::of(text), Some(HeaderZone::Offset(_))), "{text}");
            assert!(!is_not_understood(text), "{text}");
        }
        for text in [
            "W. Europe Standard Time",
            "UTC+01:00) Amsterdam, Berlin",
            "Central European Time",
            "Eastern Standard Time",
            "GMT Standard Time",
            "Berlin",
            "UTC offset 120",
        ] {
            assert!(is_not_understood(text), "{text}");
        }
    }
}
