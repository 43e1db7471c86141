//! Telling others what was found. It only speaks: nothing here listens to a plant or writes to one.
//!
//! ```text
//!            event             notices          letters
//! results ---------> source ----------> batch ----------> webhook, smtp    what happened: grouped, at a bounded rate, tried
//!            |                                  |                          again for a bounded time, then a dead letter
//!            |                                  +-> dead letters -> replay
//!            +------> all alarms as they stand ---------> alertmanager     what stands: sent again until it is over
//!            +------> the latest of each loop ----------> mqtt
//! ```
//! A receiver that is dead costs a bounded number of notices and letters, and stops nobody.

pub mod alertmanager;
mod batch;
mod config;
mod http;
mod letters;
pub mod mqtt;
mod notice;
mod payload;
mod postman;
mod secret;
pub mod smtp;
mod state;
pub mod webhook;

pub use config::{Config, Filter, Pace, Retry, What, Wrong};
pub use letters::{Letter, Letters};
pub use notice::{Places, Source};
pub use postman::{Carrier, Fault, Postman};
pub use state::{Snapshot, State};

use std::time::{SystemTime, UNIX_EPOCH};

/// Seconds since the Unix epoch as RFC 3339 in UTC, to the millisecond; empty for what no calendar holds.
fn iso(t: f64) -> String {
    let milliseconds = (t * 1e3).round() as i64;
    jiff::Timestamp::from_millisecond(milliseconds).map_or_else(|_| String::new(), |stamp| stamp.to_string())
}

/// The wall clock (s): what is signed and resent is judged by the receiver's clock, not by the plant's.
fn wall() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}
