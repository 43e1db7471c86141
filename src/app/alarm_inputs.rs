//! What collectors and tags are like, told to their alarms; and how far clocks were set, which is no time that has passed.

use super::Running;
use super::device::Device;
use crate::alarm::Kind;
use crate::compensation::gate::State;
use crate::config::LoopConfig;
use crate::history::{History, TagKind};
use crate::results::{DeviceSeen, Results, TagsSeen};
use crate::schedule::Clock;
use crate::serve::WritebackPort;
use crate::signal::LoopId;
use std::collections::BTreeSet;
use std::time::Duration;

/// A clock that is off by less (s) was only corrected.
const SET_S: f64 = 1.0;

/// Notices when the clock is set.
pub(super) struct Watch {
    /// What it showed, and the time that had passed.
    last: (f64, Duration),
}

impl Watch {
    pub(super) fn new(clock: Clock) -> Self {
        Self { last: (clock.now(), clock.elapsed()) }
    }

    /// By how much it was set since this was asked last (s).
    pub(super) fn set(&mut self, now: f64, elapsed: Duration) -> Option<f64> {
        let (showed, before) = std::mem::replace(&mut self.last, (now, elapsed));
        let by = now - showed - elapsed.saturating_sub(before).as_secs_f64();
        (by.abs() > SET_S).then_some(by)
    }
}

/// Tells the alarms what everything is like at `now` (s), `elapsed` after the start.
pub(super) fn observe(
    running: &mut Running,
    results: &Results,
    writeback: &dyn WritebackPort,
    (now, elapsed): (f64, Duration),
) {
    if !running.collecting {
        return;
    }
    let after_s = running.config.alarm.collector_down.after_s;
    let began = running.since;
    let devices = running.devices.iter_mut().map(|device| seen(device, began, after_s, elapsed)).collect();
    let loops = running.config.loops.iter().map(|own| tags(own, &running.history)).collect();
    results.watch(devices, loops, now);
    // A trip of before the restart is over when write-back begins again in shadow.
    for id in results.active(Kind::CompensationTripped) {
        if writeback.status(&id).is_none_or(|status| status.state != State::Tripped) {
            results.watch_trip(&id, None, now);
        }
    }
}

/// A collector by the age of its newest good sample: a connection may be open to a device that says nothing. The age is counted
/// by a clock that nobody sets, from when the sample was first seen here.
fn seen(device: &mut Device, began: Duration, after_s: f64, elapsed: Duration) -> DeviceSeen {
    let name = LoopId::new(device.plan.name());
    let last = device.health.snapshot().last_good;
    if last != device.heard.map(|(stamp, _)| stamp) {
        device.heard = last.map(|stamp| (stamp, elapsed));
    }
    let since = device.heard.map_or(began, |(_, seen)| seen);
    let age = elapsed.saturating_sub(since).as_secs_f64();
    let down = match last {
        _ if age > after_s => Some(Some(match last {
            Some(_) => format!("no good sample for {age:.0} s"),
            None => format!("no good sample since the start, {age:.0} s ago"),
        })),
        Some(_) => Some(None),
        // Nobody knows yet.
        None => None,
    };
    DeviceSeen { name, down }
}

fn tags(own: &LoopConfig, history: &History) -> TagsSeen {
    let id = LoopId::new(own.id.as_str());
    let mut bad = Vec::new();
    for (tag, newest) in history.latest(&id) {
        // Another tag only explains: without it the loop is judged all the same.
        if matches!(tag.kind, TagKind::Role(_))
            && let Some(sample) = newest.filter(|s| !s.quality.is_good())
        {
            bad.push(format!("{} is {}", tag.kind.name(), sample.quality.as_str()));
        }
    }
    let roles = [Some(&own.op), Some(&own.pv), own.sp.as_ref(), own.mode.as_ref(), own.mv.as_ref()];
    let devices: BTreeSet<&str> = roles.into_iter().flatten().map(|tag| tag.device()).collect();
    TagsSeen {
        id,
        bad: (!bad.is_empty()).then(|| bad.join(", ")),
        devices: devices.into_iter().map(LoopId::new).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_that_is_set_is_told_from_one_that_goes() {
        let mut watch = Watch { last: (1000.0, Duration::ZERO) };
        let s = Duration::from_secs;
        assert_eq!(watch.set(1001.0, s(1)), None);
        assert_eq!(watch.set(1002.5, s(2)), None, "corrected");
        assert_eq!(watch.set(4603.5, s(3)), Some(3600.0));
        assert_eq!(watch.set(4604.5, s(4)), None, "told once");
        assert_eq!(watch.set(5.5, s(5)), Some(-4600.0));
        // A machine that slept has lost no time.
        assert_eq!(watch.set(1005.5, s(1005)), None);
    }
}
