//! One device of the plant: its plan, the rings it fills, and the task that polls it.

use super::rings::Rings;
use crate::collect::{self, Collector, DeviceHealth, Plan, modbus, opcua};
use crate::history::{History, Ring};
use crate::schedule::Clock;
use crate::serve::DeviceState;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

/// One device and, once the daemon runs, the task that polls it.
pub(super) struct Device {
    pub(super) plan: Plan,
    pub(super) rings: Arc<Rings>,
    pub(super) health: Arc<DeviceHealth>,
    /// Stamp of the newest good sample (s), and how long after the start it was first seen.
    pub(super) heard: Option<(f64, Duration)>,
    collector: Option<Collector>,
    task: Option<(CancellationToken, JoinHandle<()>)>,
}

impl Device {
    /// A device that is polled by `dial`, or whose namespaces are those of `pinned`.
    pub(super) fn new(
        plan: Plan,
        clock: Clock,
        (dial, pinned): (&modbus::Dial, &opcua::Pinned),
        history: &Arc<History>,
    ) -> Self {
        let now: Arc<dyn collect::Clock> = Arc::new(move || clock.now());
        let collector = Collector::new(plan.clone(), now, plan.device() as u64);
        let collector = collector.dialling(dial.clone()).pinning(pinned);
        let ring = |tag: usize| Some((tag, history.ring(tag)?.clone()));
        let by_tag = plan.tags().into_iter().filter_map(ring).collect();
        // A subscription brings what has changed, and so does reading what keeps its stamp. A broker cannot tell a source that says
        // nothing from one that is gone: its tags are there one by one, when each is told again.
        let tells_changes = matches!(plan, Plan::Opcua(_));
        let rings = Arc::new(Rings { by_tag, polled: watch::Sender::new(0), clock, tells_changes });
        let health = collector.health();
        Self { plan, rings, health, heard: None, collector: Some(collector), task: None }
    }

    pub(super) fn start(&mut self, stop: &CancellationToken) {
        if let Some(mut collector) = self.collector.take() {
            collector.resume(&|tag| self.rings.by_tag.get(&tag)?.latest());
            let stop = stop.child_token();
            let task = tokio::spawn(collector.run(self.rings.clone(), stop.clone()));
            self.task = Some((stop, task));
        }
    }

    pub(super) async fn end(&mut self) {
        if let Some((stop, task)) = self.task.take() {
            stop.cancel();
            if let Err(error) = task.await {
                tracing::error!(device = self.plan.name(), %error, "a collector failed");
            }
        }
    }

    /// Whether this device would be polled the same under a new plan, into the same rings: then its collector need
    /// not notice.
    pub(super) fn carries_on(&self, plan: &Plan, history: &History) -> bool {
        let alive = self.task.as_ref().is_none_or(|(_, task)| !task.is_finished());
        let same = |(old, new): (usize, usize)| same_ring(self.rings.by_tag.get(&old), history.ring(new));
        alive && self.plan.asks_the_same(plan) && self.plan.tags().into_iter().zip(plan.tags()).all(same)
    }

    pub(super) fn state(name: &str, health: &DeviceHealth) -> DeviceState {
        let h = health.snapshot();
        let counters = vec![
            ("polls", h.polls),
            ("missed_polls", h.missed_polls),
            ("overruns", h.overruns),
            ("timeouts", h.timeouts),
            ("exceptions", h.exceptions),
            ("link_errors", h.link_errors),
            ("reconnects", h.reconnects),
            ("good_samples", h.good_samples),
            ("bad_samples", h.bad_samples),
            ("filled_samples", h.filled_samples),
            ("discarded_samples", h.discarded_samples),
            ("clock_jumps", h.clock_jumps),
            ("security_errors", h.security_errors),
            ("refused_payloads", h.refused_payloads),
            ("sequence_gaps", h.sequence_gaps),
        ];
        DeviceState { name: name.to_string(), connected: h.connected, last_good: h.last_good, counters }
    }
}

fn same_ring(a: Option<&Arc<Ring>>, b: Option<&Arc<Ring>>) -> bool {
    a.zip(b).is_some_and(|(a, b)| Arc::ptr_eq(a, b))
}
