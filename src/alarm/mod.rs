//! Alarms after ISA-18.2 and IEC 62682, pure: observations and people's actions in, transitions out; time is an argument.
//!
//! ```text
//!                 raise                      ack
//!   +--------+ ----------> +--------------+ ----------> +------------+
//!   | normal | <----+      |    unack-    |             |   acknow-  |
//!   +--------+      |      |   nowledged  | <-- raise --|   ledged   |
//!     ^    ^        |      +--------------+   (it went  +------------+
//!     |    |        | ack    |   ^  | clear    before)      |     | clear,
//!     |    |        |  clear v   |  | latching             |     | latching
//!     |    |  +--------------+   |  v                      |     v
//!     |    |  |  returned-   |-->+  +-----------+  ack  +-----------+
//!     |    |  | unacknowl.   |raise | latched-  | ----> | latched-  |
//!     |    |  +--------------+      | unacknow. |       | acknow.   |
//!     |    |                        +-----------+       +-----------+
//!     |    +--------------------------------- clear -------+     | reset
//!     +----------------------------------------------------------+
//!
//!   any of these --> shelved               by an operator, until a time or until the condition goes
//!   any of these --> suppressed-by-design  by the configuration, or while what it would say follows from another alarm
//!   any of these --> out-of-service        by an engineer, until given back
//!   back again   --> unacknowledged where the condition holds, latched-unacknowledged where it is latched, else normal
//! ```
//!
//! A latched alarm that is raised again is unacknowledged. Of the three silent states out-of-service hides shelved, and
//! shelved hides suppressed-by-design. In all of them the condition is followed, silently.
//!
//! A priority that rises while the condition holds is told as a transition from the state to itself: seen stays seen.
//!
//! *raise* and *clear* come from observations: `k` of the last `n` raise, `clear_k` of the last `clear_n` clear. Between the
//! two thresholds an observation takes a place in both counts and a side in neither; what cannot be told is no vote at all:
//! a loop in manual is not a repaired valve. Conditions that are there or not have a delay instead.

mod config;
mod flood;
mod id;
mod machine;
mod rising;
mod state;
mod votes;

pub use config::{
    CollectorDownConfig, Config, Kind, NotIdentifiableConfig, Priority, RisingConfig, TagBadConfig,
    TrippedConfig, UnexplainedConfig, Wrong,
};
pub use flood::{Flood, FloodView};
pub use id::AlarmId;
pub use machine::Flags;
pub use rising::{Line, Point, Trend};
pub use state::{Cause, Refusal, Shelving, State, Transition};
pub use votes::Observation;

use std::collections::VecDeque;
use votes::Votes;

/// Everything an alarm is beside its settings: what has to outlive a restart.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Saved {
    /// What makes up the state.
    pub flags: Flags,
    /// Votes since the condition last changed, oldest first.
    pub votes: Vec<Observation>,
    /// Since when a condition holds that has to hold for longer (s).
    pub pending: Option<f64>,
    /// The last times it was raised (s), oldest first.
    pub raises: Vec<f64>,
    /// The highest priority since it was raised.
    pub priority: Option<Priority>,
    /// f over time, for the kind that looks at it.
    pub trend: Vec<Point>,
}

/// What an operator does about an alarm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Action {
    /// Seen.
    Acknowledge,
    /// Let go what is latched.
    Reset,
    /// Silence.
    Shelve(Shelving),
    /// End the silence.
    Unshelve,
    /// Out of service.
    TakeOut,
    /// Back to service.
    GiveBack,
}

/// One alarm.
#[derive(Clone, Debug)]
pub struct Alarm {
    kind: Kind,
    flags: Flags,
    votes: Votes,
    pending: Option<f64>,
    raises: VecDeque<f64>,
    priority: Option<Priority>,
    trend: Trend,
}

impl Alarm {
    /// An alarm in `normal`.
    pub fn new(kind: Kind) -> Self {
        Self::restored(kind, &Config::default(), Saved::default())
    }

    /// The alarm as it was saved, under settings that may be others; nobody is told of anything again.
    pub fn restored(kind: Kind, config: &Config, saved: Saved) -> Self {
        let Saved { flags, votes, pending, raises, priority, trend } = saved;
        let votes = Votes::restored(votes, config.rule(kind));
        let mut alarm = Self {
            kind,
            flags,
            votes,
            pending,
            raises: raises.into(),
            priority,
            trend: Trend::restored(trend),
        };
        alarm.bound(config);
        alarm
    }

    /// What has to outlive a restart.
    pub fn saved(&self) -> Saved {
        Saved {
            flags: self.flags,
            votes: self.votes.saved(),
            pending: self.pending,
            raises: self.raises.iter().copied().collect(),
            priority: self.priority,
            trend: self.trend.saved(),
        }
    }

    /// The state as the operator sees it, as of the last call that was given a time.
    pub fn state(&self) -> State {
        self.flags.state()
    }

    /// What makes up the state.
    pub fn flags(&self) -> &Flags {
        &self.flags
    }

    /// The highest priority since the condition was raised; `None` before it ever was.
    pub fn priority(&self) -> Option<Priority> {
        self.priority
    }

    /// Whether it was raised so often lately that it says nothing any more.
    pub fn chatters(&self, now: f64, config: &Config) -> bool {
        // What is of later than now was stamped by a clock that was set back, and is not known to be recent.
        let recent = self.raises.iter().filter(|&&at| (0.0..=config.chatter_s).contains(&(now - at))).count();
        recent >= config.chatter_raises
    }

    /// Whether its condition has held for so long that nobody seems to want to do anything about it.
    pub fn is_stale(&self, now: f64, config: &Config) -> bool {
        self.flags.active && self.flags.raised_at.is_some_and(|at| now - at > config.stale_s)
    }

    /// Whether it is what it was made as: there is nothing to keep of it.
    pub fn is_blank(&self) -> bool {
        self.saved() == Saved::default()
    }

    /// Lets time pass: a shelving that has run out ends.
    pub fn tick(&mut self, now: f64) -> Vec<Transition> {
        self.flags.tick(now).into_iter().collect()
    }

    /// Lets no shelving end later than somebody could have it end from now on.
    pub fn bound_shelving(&mut self, now: f64, config: &Config) {
        self.flags.bound_shelving(config.max_shelve_s, now);
    }

    /// Takes an observation made at `now`, `priority` being what it would be raised with.
    pub fn observe(
        &mut self,
        seen: Observation,
        priority: Priority,
        now: f64,
        config: &Config,
    ) -> Vec<Transition> {
        let mut taken = self.tick(now);
        if self.votes.take(seen, config.rule(self.kind), self.flags.active) {
            taken.extend(self.flip(now, config));
        }
        let (before, state) = (self.priority, self.state());
        if seen == Observation::Present && self.flags.active {
            self.priority = self.priority.max(Some(priority));
        }
        let rose = before.is_some() && self.priority > before;
        // What is told already is told with the new priority, and so is the end of a silence.
        if rose && taken.is_empty() && !state.is_silent() {
            taken.push(Transition { from: state, to: state, at: now, cause: Cause::MoreUrgent });
        }
        taken
    }

    /// Takes a condition that is there or not; it counts once it has been there for the delay of its kind.
    pub fn level(&mut self, present: bool, now: f64, config: &Config) -> Vec<Transition> {
        if !present {
            self.pending = None;
        }
        if present == self.flags.active {
            return self.tick(now);
        }
        let seen = if present {
            // A clock that was set back begins the delay anew.
            let since = *self.pending.insert(self.pending.filter(|since| *since <= now).unwrap_or(now));
            if now - since < config.delay_s(self.kind) {
                return self.tick(now);
            }
            Observation::Present
        } else {
            Observation::Absent
        };
        self.observe(seen, config.priority(self.kind, None), now, config)
    }

    /// The clock was set by so much (s): a condition that has to hold for longer has held for as long as before.
    pub fn clock_was_set(&mut self, by: f64) {
        self.pending = self.pending.map(|since| since + by);
    }

    /// Takes f and its interval (% of OP span), for the alarm on friction that grows.
    pub fn estimate(&mut self, f: f64, interval: [f64; 2], now: f64, config: &Config) -> Vec<Transition> {
        let seen = self.trend.take(f, interval, now, &config.f_rising);
        self.observe(seen, config.priority(self.kind, None), now, config)
    }

    /// The line through f over time; `None` while there are too few points.
    pub fn line(&self, config: &Config) -> Option<Line> {
        self.trend.line(&config.f_rising)
    }

    /// An operator acts.
    ///
    /// # Errors
    /// [`Refusal`], when the state does not allow it. A shelving that has run out has ended all the same.
    pub fn act(
        &mut self,
        action: Action,
        now: f64,
        config: &Config,
    ) -> (Vec<Transition>, Result<(), Refusal>) {
        let mut taken = self.tick(now);
        let acted = match action {
            Action::Acknowledge => self.flags.acknowledge(now).map(Some),
            Action::Reset => self.flags.reset(now).map(Some),
            Action::Shelve(how) => self.flags.shelve(how, config.max_shelve_s, now).map(Some),
            Action::Unshelve => self.flags.unshelve(now).map(Some),
            Action::TakeOut => self.flags.take_out(now).map(Some),
            Action::GiveBack => self.flags.give_back(now).map(Some),
        };
        let acted = acted.map(|transition| taken.extend(transition));
        (taken, acted)
    }

    /// The design of the plant begins or ceases to suppress it; what the configuration suppresses stays so.
    pub fn suppress(
        &mut self,
        suppressed: bool,
        subject: &str,
        now: f64,
        config: &Config,
    ) -> Vec<Transition> {
        let suppressed = suppressed || config.suppresses(subject, self.kind);
        let mut taken = self.tick(now);
        taken.extend(self.flags.suppress(suppressed, now));
        taken
    }

    /// The time of its state, which ends at `now`, says nothing of the condition: what began in it has not been, and what held
    /// before has held for as long as then. Nobody was told of it.
    pub fn leave_out(&mut self, now: f64) -> Vec<Transition> {
        let since = self.flags.since.unwrap_or(now);
        if self.flags.active && self.flags.raised_at.is_some_and(|at| at > since) {
            (self.flags.active, self.flags.latched) = (false, false);
            self.votes = Votes::default();
        }
        self.pending = self.pending.filter(|begun| *begun <= since).map(|begun| begun + (now - since));
        self.tick(now)
    }

    /// Its subject or kind is there no more: what stands does so no longer.
    pub fn forget(&mut self, now: f64) -> Vec<Transition> {
        let mut taken = self.tick(now);
        taken.extend(self.flags.forget(now));
        if self.state() == State::Normal {
            // They spoke for what was there.
            (self.votes, self.pending) = (Votes::default(), None);
        }
        taken
    }

    /// What was observed until `now` was of something else, whose place its subject has taken: it counts no more. A condition that
    /// holds does so until it is observed to be gone; of friction that grows nothing is left to observe, so it is over.
    pub fn forget_evidence(&mut self, now: f64, config: &Config) -> Vec<Transition> {
        let mut taken = self.tick(now);
        (self.votes, self.pending, self.trend) = (Votes::default(), None, Trend::default());
        if self.kind == Kind::FRising && self.flags.active {
            taken.extend(self.flip(now, config));
        }
        taken
    }

    /// Takes how it was left before a start that did not know it into what it has become since.
    pub fn merge(&mut self, left: Saved, now: f64, config: &Config) -> Vec<Transition> {
        let own = self.saved();
        let mut taken = self.tick(now);
        taken.extend(self.flags.merge(left.flags, now));
        let is_as_own = self.flags.active == own.flags.active && !own.votes.is_empty();
        let votes = if is_as_own || left.flags.active != self.flags.active { own.votes } else { left.votes };
        self.votes = Votes::restored(votes, config.rule(self.kind));
        self.raises = left.raises.into_iter().chain(own.raises).collect();
        self.raises.make_contiguous().sort_unstable_by(f64::total_cmp);
        self.raises = self.raises.drain(..).fold(VecDeque::new(), |mut all, at| {
            if all.back() != Some(&at) {
                all.push_back(at);
            }
            all
        });
        self.bound(config);
        self.priority = own.priority.max(left.priority.filter(|_| left.flags.active));
        let begun = own.trend.first().map_or(f64::INFINITY, |point| point.t);
        let before = left.trend.into_iter().filter(|point| point.t < begun);
        self.trend = Trend::restored(before.chain(own.trend).collect());
        taken.extend(self.tick(now));
        taken
    }

    fn flip(&mut self, now: f64, config: &Config) -> Option<Transition> {
        let active = !self.flags.active;
        if active {
            self.priority = None;
            self.raises.push_back(now);
            self.bound(config);
        }
        self.flags.condition(active, config.latch.contains(&self.kind), now)
    }

    fn bound(&mut self, config: &Config) {
        while self.raises.len() > config.chatter_raises {
            self.raises.pop_front();
        }
    }
}

#[cfg(test)]
mod tests;
