//! What leaves the house as JSON. A transfer object is converted from a domain type in one place, here.

pub mod alarms;
pub mod audit;
pub mod backfill;
mod basis;
pub mod benchmark;
pub mod bundle;
pub mod cause;
pub mod events;
pub mod evidence;
pub mod fleet;
pub mod health;
mod kept;
pub mod latest_look;
pub mod loops;
pub mod map;
pub mod notifications;
pub mod opinions;
pub mod params;
pub mod plantwide;
pub mod report;
pub mod samples;
pub mod session;
mod structure;
pub mod system;
pub mod writeback;

pub use basis::BasisText;
pub use report::Report;
pub use structure::Structure;

use jiff::Timestamp;

/// A number as JSON can carry it: `None` (null) for NaN and the infinities, zero without a sign.
pub fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value + 0.0)
}

/// JSON without the blanks and escapes that would make it long; `None` for what is none.
pub fn compact(json: &[u8]) -> Option<String> {
    serde_json::from_slice::<serde_json::Value>(json).ok().map(|value| value.to_string())
}

/// How old something is at `now` (s); 0 for what a clock that was set back has put into the future.
pub fn age(now: f64, at: f64) -> Option<f64> {
    finite((now - at).max(0.0)).filter(|_| at.is_finite())
}

/// Seconds since the Unix epoch as RFC 3339 in UTC, to the microsecond; `None` for what no calendar holds.
pub fn rfc3339(t: f64) -> Option<String> {
    if !t.is_finite() || t.abs() > 4e11 {
        return None;
    }
    Timestamp::from_microsecond((t * 1e6).round() as i64).ok().map(|stamp| stamp.to_string())
}

/// A time as a caller may write it: RFC 3339 with offset, or seconds since the Unix epoch.
pub fn parse_time(text: &str) -> Option<f64> {
    let seconds = text.parse::<f64>().ok().filter(|t| t.is_finite());
    // A query string reads the + of an offset as a blank unless it was encoded.
    let stamp = || text.parse::<Timestamp>().or_else(|_| text.replace(' ', "+").parse());
    seconds.or_else(|| stamp().ok().map(|stamp| stamp.as_microsecond() as f64 * 1e-6))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_younger_than_now() {
        assert_eq!((age(10.0, 4.0), age(10.0, 10.0), age(10.0, 3610.0)), (Some(6.0), Some(0.0), Some(0.0)));
        assert_eq!((age(10.0, f64::NAN), age(f64::INFINITY, 0.0)), (None, None));
    }

    #[test]
    fn times_are_written_in_utc_and_read_back() {
        assert_eq!(rfc3339(0.0).as_deref(), Some("1970-01-01T00:00:00Z"));
        assert_eq!(rfc3339(1_700_000_000.25).as_deref(), Some("2023-11-14T22:13:20.25Z"));
        for silly in [f64::NAN, f64::INFINITY, 1e300, -1e300] {
            assert_eq!(rfc3339(silly), None);
        }
        assert_eq!(parse_time("2023-11-14T22:13:20.25Z"), Some(1_700_000_000.25));
        assert_eq!(parse_time("2023-11-14T23:13:20+01:00"), Some(1_700_000_000.0));
        assert_eq!(parse_time("2023-11-14T23:13:20 01:00"), Some(1_700_000_000.0));
        assert_eq!(parse_time("1700000000.5"), Some(1_700_000_000.5));
        for silly in ["", "yesterday", "NaN", "inf", "2023-11-14"] {
            assert_eq!(parse_time(silly), None, "{silly}");
        }
    }
}
