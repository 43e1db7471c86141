//! Times as others read them.

use std::time::{SystemTime, UNIX_EPOCH};

/// Seconds since the Unix epoch as RFC 3339 in UTC, to the millisecond; empty for what no calendar holds.
pub(super) fn iso(t: f64) -> String {
    let milliseconds = (t * 1e3).round() as i64;
    jiff::Timestamp::from_millisecond(milliseconds).map_or_else(|_| String::new(), |stamp| stamp.to_string())
}

/// The wall clock (s): what is signed and resent is judged by the receiver's clock, not by the plant's.
pub(super) fn wall() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}
