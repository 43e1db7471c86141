//! Where samples come from: one source per kind of plant interface, each yielding [`Sample`]s with a quality.
//!
//! A source is planned without I/O (`modbus::Plan`), then run as one task per device. It hands every
//! sample to a [`Sink`], keeps its counters in a [`DeviceHealth`] that anyone may read, and takes the time
//! from a [`Clock`], so a simulated plant may run faster than the wall.

pub mod modbus;
pub mod mqtt;
pub mod opcua;
pub mod stub;

mod backoff;
mod device;
mod frozen;
mod health;
pub(crate) mod pair;
mod scaling;
mod series;
mod text_value;

pub use device::{Collector, Plan};
pub use frozen::Frozen;
pub use health::{DeviceHealth, HealthSnapshot};
pub use scaling::Reading;
pub use text_value::DecimalSign;

use crate::signal::{Role, Sample};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Something wrong in one field; the caller knows where the field stands in the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Issue {
    /// The field, as the file writes it (`poll_ms`, `range`).
    pub field: &'static str,
    /// What is wrong and what would be right.
    pub message: String,
}

impl Issue {
    /// The same with the tag's name before it.
    fn of_tag(self, name: &str) -> Self {
        Self { message: format!("{name}: {}", self.message), ..self }
    }
}

/// A tag as `app` hands it over, with what its kind of device wants to know of it.
#[derive(Clone, Debug)]
pub struct TagSpec<C> {
    /// The number under which the [`Sink`] receives its samples.
    pub index: usize,
    /// Its name in logs (`FIC101.pv`).
    pub name: String,
    /// What it is to its loop; `None` for an extra tag.
    pub role: Option<Role>,
    /// Where it lives.
    pub config: C,
    /// Flag it as stale when its value has not changed for longer than this (s).
    pub frozen_after_s: Option<f64>,
}

/// Where samples go. Called from the polling task: an implementation must not block.
pub trait Sink: Send + Sync + 'static {
    /// One sample of the tag that `app` numbered `tag`, in the order of time unless a clock was set back. A
    /// device that is polled yields exactly one of every tag a poll, bad ones included; one that sends by
    /// itself yields what it sent.
    fn sample(&self, tag: usize, sample: Sample);

    /// The good value of the tag that `app` numbered `tag` came again with its old stamp: its source is there, and nothing has
    /// changed. Only from a broker: what is polled, or subscribed to at a server, is there while it answers.
    fn again(&self, _tag: usize) {}

    /// One poll of the device that `app` numbered `device` has ended; its samples came before.
    fn poll(&self, device: usize, poll: Poll);
}

/// What one poll of one device brought.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Poll {
    /// When it ended (s), by the same clock as the samples.
    pub t: f64,
    /// Tags read well (good or stale).
    pub good: usize,
    /// Tags without a usable value.
    pub bad: usize,
    /// How long it took on the wall clock.
    pub took: Duration,
}

/// The time that samples are stamped with (s since the Unix epoch).
pub trait Clock: Send + Sync + 'static {
    /// Now (s).
    fn now(&self) -> f64;
}

impl<F: Fn() -> f64 + Send + Sync + 'static> Clock for F {
    fn now(&self) -> f64 {
        self()
    }
}

/// The wall clock.
#[derive(Clone, Copy, Debug, Default)]
pub struct SystemClock;

impl Clock for SystemClock {
    fn now(&self) -> f64 {
        SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
    }
}
