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
use crate::signal::{BadReason, LoopId, Quality, Role};
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
        if writeback.status(&id).is_none_or(|status| !holds_a_trip(status.state)) {
            results.watch_trip(&id, None, now);
        }
    }
}

/// Whether a trip that was told stands in this state: it is told when a fault begins to close the gate.
fn holds_a_trip(state: State) -> bool {
    matches!(state, State::Withdrawing | State::Tripped)
}

/// A collector by the age of its newest good sample: a connection may be open to a device that says nothing. The age is counted
/// by a clock that nobody sets, from when the sample was first seen here.
fn seen(device: &mut Device, began: Duration, after_s: f64, elapsed: Duration) -> DeviceSeen {
    let name = LoopId::new(device.plan.name());
    if device.rings.by_tag.is_empty() {
        // Nothing is read from it, as where write-back alone has to do with it, so nothing ever comes.
        return DeviceSeen { name, down: Some(None) };
    }
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
        let TagKind::Role(role) = &tag.kind else { continue };
        match newest {
            Some(sample) if !sample.quality.is_good() => bad.push(said(*role, wrong(sample.quality))),
            // Without the two nothing can be said; a start takes no longer than the alarm waits.
            None if matches!(role, Role::Op | Role::Pv) => bad.push(said(*role, "nothing has come yet")),
            _ => {}
        }
    }
    let roles = [Some(&own.op), Some(&own.pv), own.sp.as_ref(), own.mode.as_ref(), own.mv.as_ref()];
    let devices: BTreeSet<&str> = roles.into_iter().flatten().map(|tag| tag.device()).collect();
    TagsSeen {
        id,
        bad: (!bad.is_empty()).then(|| bad.join("; ")),
        devices: devices.into_iter().map(LoopId::new).collect(),
    }
}

/// A tag and what is wrong with it, for people.
fn said(role: Role, what: &str) -> String {
    let name = if role == Role::Mode { "mode".to_string() } else { role.as_str().to_uppercase() };
    format!("{name}: {what}")
}

/// What a quality means.
fn wrong(quality: Quality) -> &'static str {
    match quality {
        Quality::Good => "good",
        Quality::Stale => "frozen, or marked as doubtful by its source",
        Quality::Bad(BadReason::DeviceException) => {
            "the device refuses the address, or the source marks it as bad"
        }
        Quality::Bad(BadReason::Timeout) => "no answer in time",
        Quality::Bad(BadReason::LinkDown) => "no connection",
        Quality::Bad(BadReason::OutOfRange) => "out of range",
        Quality::Bad(BadReason::NotANumber) => "no number",
    }
}

#[cfg(test)]
mod tests {
    use super::super::writeback::tests::config;
    use super::*;
    use crate::collect::{modbus, opcua};
    use crate::signal::Sample;
    use std::sync::Arc;

    /// A loop, the device that it is read from, and one that no tag is read from.
    fn parts() -> (LoopConfig, Arc<History>, Vec<Device>) {
        let mut config = config();
        let mut other = config.modbus[0].clone();
        other.name = "written".to_string();
        config.modbus.push(other);
        let wired = config.plant().expect("it was checked");
        let history = Arc::new(History::new(&wired.loops, &config.history));
        let (dial, pinned) = (modbus::sockets(), opcua::Pinned::default());
        let device = |plan| Device::new(plan, Clock::wall(), (&dial, &pinned), &history);
        let devices = wired.into_plans().map(device).collect();
        (config.loops.swap_remove(0), history, devices)
    }

    #[test]
    fn a_device_that_no_tag_is_read_from_is_not_down() {
        let (_, _, mut devices) = parts();
        let mut down = |at: usize, elapsed_s| {
            seen(&mut devices[at], Duration::ZERO, 120.0, Duration::from_secs(elapsed_s)).down
        };
        assert_eq!(down(0, 60), None, "nobody knows yet");
        assert!(down(0, 121).flatten().is_some());
        assert_eq!([down(1, 60), down(1, 1000)], [Some(None), Some(None)]);
    }

    #[test]
    fn a_device_that_no_tag_is_read_from_is_shown_as_no_collector() {
        let (_, history, devices) = parts();
        assert_eq!(devices.len(), 2);
        let plant = super::super::shown(&config(), &config(), &history, &devices);
        let names: Vec<String> = (plant.devices)().into_iter().map(|own| own.name).collect();
        assert_eq!(names, ["d"]);
    }

    #[test]
    fn op_and_pv_that_never_come_are_told_and_what_may_be_left_out_is_not() {
        let (own, history, _) = parts();
        let bad = || tags(&own, &history).bad;
        assert_eq!(bad().as_deref(), Some("OP: nothing has come yet; PV: nothing has come yet"));
        history.push(0, Sample::good(1.0, 50.0));
        let value = Sample { t: 1.0, value: f64::NAN, quality: Quality::Bad(BadReason::LinkDown) };
        history.push(1, value);
        assert_eq!(bad().as_deref(), Some("PV: no connection"));
        history.push(1, Sample::good(2.0, 50.0));
        assert_eq!(bad(), None);
    }

    #[test]
    fn what_is_wrong_with_a_tag_is_said_in_words() {
        assert_eq!(said(Role::Mode, wrong(Quality::Bad(BadReason::Timeout))), "mode: no answer in time");
        for quality in Quality::ALL {
            assert!(!wrong(quality).contains(['_', ':']), "{quality:?}");
        }
    }

    #[test]
    fn a_trip_stands_from_the_fault_on() {
        let holding: Vec<State> = State::ALL.into_iter().filter(|state| holds_a_trip(*state)).collect();
        assert_eq!(holding, [State::Withdrawing, State::Tripped]);
    }

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
