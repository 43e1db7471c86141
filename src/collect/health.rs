//! The counters of one device, written by its polling task and read by metrics, readiness and logs.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};

/// Live counters of one device; lock-free, so that reading them never delays a poll.
#[derive(Debug)]
pub struct DeviceHealth {
    polls: AtomicU64,
    missed_polls: AtomicU64,
    overruns: AtomicU64,
    timeouts: AtomicU64,
    exceptions: AtomicU64,
    link_errors: AtomicU64,
    connects: AtomicU64,
    good_samples: AtomicU64,
    bad_samples: AtomicU64,
    filled_samples: AtomicU64,
    discarded_samples: AtomicU64,
    clock_jumps: AtomicU64,
    security_errors: AtomicU64,
    refused_payloads: AtomicU64,
    sequence_gaps: AtomicU64,
    last_good: AtomicU64,
    connected: AtomicBool,
}

/// [`DeviceHealth`] at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HealthSnapshot {
    /// Polls done.
    pub polls: u64,
    /// Polls that never began because the one before took too long.
    pub missed_polls: u64,
    /// Polls that took longer than the poll period.
    pub overruns: u64,
    /// Requests without an answer in time.
    pub timeouts: u64,
    /// Requests or nodes that the device refused, or answered with the wrong number of values.
    pub exceptions: u64,
    /// Connections that could not be made, broke, or carried something that is not the protocol.
    pub link_errors: u64,
    /// Connections made again after the first.
    pub reconnects: u64,
    /// Samples with a usable value (good or stale).
    pub good_samples: u64,
    /// Samples without.
    pub bad_samples: u64,
    /// Samples read from the device's history after a gap; they count as good or bad too.
    pub filled_samples: u64,
    /// Samples not handed on, because they were older than the newest one.
    pub discarded_samples: u64,
    /// How often the source's clock was set back, or forward past ours.
    pub clock_jumps: u64,
    /// Sessions refused for a certificate, an identity or the security asked for, by us or by the device.
    pub security_errors: u64,
    /// Messages, or values in them, that could not be read and became no sample.
    pub refused_payloads: u64,
    /// Messages of an edge node that were missed, told by their numbers.
    pub sequence_gaps: u64,
    /// When the last good value came (s), a new one or the same again; none yet when `None`.
    pub last_good: Option<f64>,
    /// Whether a connection is open. It says little: judge a device by [`HealthSnapshot::age_s`].
    pub connected: bool,
}

impl HealthSnapshot {
    /// Time since the last good value (s) at time `now` (s): the measure of liveness.
    pub fn age_s(&self, now: f64) -> Option<f64> {
        self.last_good.map(|t| now - t)
    }
}

impl Default for DeviceHealth {
    fn default() -> Self {
        Self {
            polls: AtomicU64::new(0),
            missed_polls: AtomicU64::new(0),
            overruns: AtomicU64::new(0),
            timeouts: AtomicU64::new(0),
            exceptions: AtomicU64::new(0),
            link_errors: AtomicU64::new(0),
            connects: AtomicU64::new(0),
            good_samples: AtomicU64::new(0),
            bad_samples: AtomicU64::new(0),
            filled_samples: AtomicU64::new(0),
            discarded_samples: AtomicU64::new(0),
            clock_jumps: AtomicU64::new(0),
            security_errors: AtomicU64::new(0),
            refused_payloads: AtomicU64::new(0),
            sequence_gaps: AtomicU64::new(0),
            last_good: AtomicU64::new(f64::NAN.to_bits()),
            connected: AtomicBool::new(false),
        }
    }
}

impl DeviceHealth {
    /// The counters now. Each is exact; together they may straddle a poll in progress.
    pub fn snapshot(&self) -> HealthSnapshot {
        let last_good = f64::from_bits(self.last_good.load(Relaxed));
        HealthSnapshot {
            polls: self.polls.load(Relaxed),
            missed_polls: self.missed_polls.load(Relaxed),
            overruns: self.overruns.load(Relaxed),
            timeouts: self.timeouts.load(Relaxed),
            exceptions: self.exceptions.load(Relaxed),
            link_errors: self.link_errors.load(Relaxed),
            reconnects: self.connects.load(Relaxed).saturating_sub(1),
            good_samples: self.good_samples.load(Relaxed),
            bad_samples: self.bad_samples.load(Relaxed),
            filled_samples: self.filled_samples.load(Relaxed),
            discarded_samples: self.discarded_samples.load(Relaxed),
            clock_jumps: self.clock_jumps.load(Relaxed),
            security_errors: self.security_errors.load(Relaxed),
            refused_payloads: self.refused_payloads.load(Relaxed),
            sequence_gaps: self.sequence_gaps.load(Relaxed),
            last_good: (!last_good.is_nan()).then_some(last_good),
            connected: self.connected.load(Relaxed),
        }
    }

    pub(super) fn poll_done(&self, overran: bool) {
        self.polls.fetch_add(1, Relaxed);
        self.overruns.fetch_add(u64::from(overran), Relaxed);
    }

    pub(super) fn missed(&self, polls: u64) {
        self.missed_polls.fetch_add(polls, Relaxed);
    }

    pub(super) fn timed_out(&self) {
        self.timeouts.fetch_add(1, Relaxed);
    }

    pub(super) fn refused(&self) {
        self.exceptions.fetch_add(1, Relaxed);
    }

    pub(super) fn link_failed(&self) {
        self.link_errors.fetch_add(1, Relaxed);
    }

    pub(super) fn connected(&self) {
        self.connects.fetch_add(1, Relaxed);
        self.connected.store(true, Relaxed);
    }

    /// An answer came on a connection, whoever opened it.
    pub(super) fn reached(&self) {
        self.connected.store(true, Relaxed);
    }

    pub(super) fn disconnected(&self) {
        self.connected.store(false, Relaxed);
    }

    /// A usable value, at time `t` (s) when it is good.
    pub(super) fn usable(&self, good_at: Option<f64>) {
        self.good_samples.fetch_add(1, Relaxed);
        if let Some(t) = good_at {
            self.last_good.store(t.to_bits(), Relaxed);
        }
    }

    /// A good value came at time `t` (s) that is no news: its source lives, though nothing of it changes.
    pub(super) fn still_good(&self, t: f64) {
        self.last_good.store(t.to_bits(), Relaxed);
    }

    /// Samples that came from the device's history.
    pub(super) fn filled(&self, samples: u64) {
        self.filled_samples.fetch_add(samples, Relaxed);
    }

    pub(super) fn discarded(&self) {
        self.discarded_samples.fetch_add(1, Relaxed);
    }

    pub(super) fn clock_jumped(&self) {
        self.clock_jumps.fetch_add(1, Relaxed);
    }

    pub(super) fn untrusted(&self) {
        self.security_errors.fetch_add(1, Relaxed);
    }

    pub(super) fn unreadable(&self, count: u64) {
        self.refused_payloads.fetch_add(count, Relaxed);
    }

    pub(super) fn missed_messages(&self) {
        self.sequence_gaps.fetch_add(1, Relaxed);
    }

    pub(super) fn unusable(&self) {
        self.bad_samples.fetch_add(1, Relaxed);
    }
}
