//! What collectors and tags are like, told to their alarms.

use super::Running;
use super::device::Device;
use crate::alarm::Kind;
use crate::compensation::gate::State;
use crate::config::LoopConfig;
use crate::history::{History, TagKind};
use crate::results::{DeviceSeen, Results, TagsSeen};
use crate::serve::WritebackPort;
use crate::signal::LoopId;
use std::collections::BTreeSet;

/// Tells the alarms what everything is like at `now` (s).
pub(super) fn observe(running: &Running, results: &Results, writeback: &dyn WritebackPort, now: f64) {
    if !running.collecting {
        return;
    }
    let after_s = running.config.alarm.collector_down.after_s;
    let devices = running.devices.iter().map(|device| seen(device, running.since, after_s, now)).collect();
    let loops = running.config.loops.iter().map(|own| tags(own, &running.history)).collect();
    results.watch(devices, loops, now);
    // A trip of before the restart is over when write-back begins again in shadow.
    for id in results.active(Kind::CompensationTripped) {
        if writeback.status(&id).is_none_or(|status| status.state != State::Tripped) {
            results.watch_trip(&id, None, now);
        }
    }
}

/// A collector by the age of its newest good sample: a connection may be open to a device that says nothing.
fn seen(device: &Device, began: f64, after_s: f64, now: f64) -> DeviceSeen {
    let name = LoopId::new(device.plan.name());
    let last = device.health.snapshot().last_good;
    let age = now - last.unwrap_or(began);
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
