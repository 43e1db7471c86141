//! The daemon itself as JSON: what it is, how it is, and what it was told. Never a secret: facts are chosen one by one.

use super::{age, finite, rfc3339};
use crate::schedule::Counters;
use crate::serve::{DeviceState, Setting};
use serde::Serialize;
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// The daemon.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct System {
    /// Version.
    pub version: &'static str,
    /// The version, and behind a `+` the identity of the build: daemons with the same find the same in the same samples.
    pub build: &'static str,
    /// Whether the code that writes to the plant is built in.
    pub writeback_built_in: bool,
    /// Plant time.
    pub time: Option<String>,
    /// Since when it runs.
    pub started: Option<String>,
    /// Memory of the process (bytes); null where the system does not tell.
    pub memory_bytes: Option<u64>,
    /// Of it, the samples of all tags (bytes).
    pub history_bytes: usize,
    /// Loops watched.
    pub loops: usize,
    /// Tags polled.
    pub tags: usize,
    /// Clients that may still begin to listen to events.
    pub event_places_left: usize,
    /// Longest time that an alarm may be shelved, until its condition clears too (s).
    pub max_shelve_s: f64,
    /// The scheduler.
    pub scheduler: SchedulerItem,
    /// What it was told.
    pub settings: Vec<SettingItem>,
}

/// How the diagnoses go.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct SchedulerItem {
    /// Runs waiting, now.
    pub queued: u64,
    /// Runs under way, now.
    pub running: u64,
    /// Runs that ended with a diagnosis.
    pub diagnosed: u64,
    /// Those of them that searched for nothing, because the last model still fits.
    pub confirmed: u64,
    /// Runs that passed their deadline.
    pub deadline_exceeded: u64,
    /// Runs that failed inside.
    pub panicked: u64,
    /// Runs that were due and skipped, for whatever reason.
    pub skipped: u64,
    /// Time spent in diagnoses (s on the wall clock).
    pub busy_s: Option<f64>,
}

impl From<Counters> for SchedulerItem {
    fn from(c: Counters) -> Self {
        Self {
            queued: c.queued,
            running: c.running,
            diagnosed: c.diagnosed,
            deadline_exceeded: c.deadline_exceeded,
            panicked: c.panicked,
            confirmed: c.confirmed,
            skipped: c.skipped_waiting + c.skipped_late,
            busy_s: finite(c.busy_s),
        }
    }
}

/// One line of the configuration in force.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct SettingItem {
    /// Section of the file.
    pub section: &'static str,
    /// Key.
    pub key: &'static str,
    /// Value as text.
    pub value: String,
}

impl From<&Setting> for SettingItem {
    fn from(setting: &Setting) -> Self {
        Self { section: setting.section, key: setting.key, value: setting.value.clone() }
    }
}

/// Where data comes from.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct CollectorList {
    /// When.
    pub time: Option<String>,
    /// Devices on all pages.
    pub total: usize,
    /// The devices of this page, by name.
    pub items: Vec<CollectorItem>,
    /// `after` of the next page; null on the last.
    pub next: Option<String>,
}

/// One device.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct CollectorItem {
    /// Its name.
    pub name: String,
    /// Whether a connection is open.
    pub connected: bool,
    /// Whether the condition of its alarm `collector_down` holds: no good sample for so long that it counts as down, be a connection
    /// open or not. False where that alarm is switched off.
    pub down: bool,
    /// When the last good sample came.
    pub last_good: Option<String>,
    /// How long ago that is (s of plant time).
    pub age_s: Option<f64>,
    /// Counters since the start, by name.
    pub counters: BTreeMap<&'static str, u64>,
}

impl CollectorItem {
    /// A device as it is at `now` (s); `down` as its alarm says.
    pub fn new(device: &DeviceState, down: bool, now: f64) -> Self {
        Self {
            name: device.name.clone(),
            connected: device.connected,
            down,
            last_good: device.last_good.and_then(rfc3339),
            age_s: device.last_good.and_then(|t| age(now, t)),
            counters: device.counters.iter().copied().collect(),
        }
    }
}
