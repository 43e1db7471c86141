//! The alarm of one loop, pure: diagnoses and operators' actions in, transitions out; time is an argument.
//!
//! ```text
//!                  raise                       ack
//!   +--------+ -----------> +----------------+ -----------> +--------------+
//!   | normal |              | unacknowledged |              | acknowledged |
//!   +--------+ <---+        +----------------+              +--------------+
//!       ^          |          |          ^                      |
//!       |          | ack      | clear    | raise                | clear
//!       |          |          v          |                      |
//!       |        +--------------------------+                   |
//!       |        | returned-unacknowledged  |                   |
//!       |        +--------------------------+                   |
//!       +-------------------------------------------------------+
//!
//!   any of the four -- shelve(until) --> shelved
//!   shelved -- unshelve, or `until` passed --> unacknowledged where the condition holds, else normal
//! ```
//!
//! *raise*: `k` of the last `n` identifiable diagnoses since the last change say stiction. *clear*: `clear_k` of the last
//! `clear_n` are clean. Between the two thresholds a diagnosis takes a place in both counts and a side in neither; one
//! that is not identifiable is no vote at all: a loop in manual is not a repaired valve. While shelved the condition is
//! followed, silently.

use serde::Deserialize;
use std::collections::VecDeque;

/// `[alarm]`: how many diagnoses raise and clear, and the hysteresis between.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Sticky diagnoses, of the last `n`, that raise the alarm.
    pub k: usize,
    /// Identifiable diagnoses looked back on to raise.
    pub n: usize,
    /// Clean diagnoses, of the last `clear_n`, that clear the alarm.
    pub clear_k: usize,
    /// Identifiable diagnoses looked back on to clear.
    pub clear_n: usize,
    /// A diagnosis without stiction is clean when f is at most this (% of OP span) …
    pub clear_f_percent: f64,
    /// … or when its evidence `delta_aic` is at most this (-).
    pub clear_evidence: f64,
    /// Longest time an alarm may be shelved (s).
    pub max_shelve_s: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            k: 2,
            n: 3,
            clear_k: 3,
            clear_n: 4,
            clear_f_percent: 0.04,
            clear_evidence: 10.0,
            max_shelve_s: 7.0 * 86_400.0,
        }
    }
}

impl Config {
    /// Everything wrong with it, by field; empty when it can be used.
    pub fn validate(&self) -> Vec<(&'static str, String)> {
        let mut wrong = Vec::new();
        let mut unless = |ok: bool, field, message: String| {
            if !ok {
                wrong.push((field, message));
            }
        };
        let counts = [("n", self.n, "k", self.k), ("clear_n", self.clear_n, "clear_k", self.clear_k)];
        for (of, n, field, k) in counts {
            unless((1..=100).contains(&n), of, format!("{n} must be 1 to 100"));
            unless(k >= 1 && k <= n, field, format!("{k} must be 1 to {of} = {n}"));
        }
        let (f, evidence, shelve) = (self.clear_f_percent, self.clear_evidence, self.max_shelve_s);
        unless((0.0..=100.0).contains(&f), "clear_f_percent", format!("{f} must be 0 to 100"));
        unless(evidence.is_finite(), "clear_evidence", format!("{evidence} must be a number"));
        unless(
            (1.0..=365.0 * 86_400.0).contains(&shelve),
            "max_shelve_s",
            format!("{shelve} must be 1 to 31536000"),
        );
        wrong
    }

    /// What a diagnosis says to the alarm: `sticky` is its verdict, `f` in % of OP span, `delta_aic` its evidence.
    pub fn judge(&self, sticky: bool, f_percent: f64, delta_aic: f64) -> Observation {
        if sticky {
            Observation::Sticky
        } else if f_percent <= self.clear_f_percent || delta_aic <= self.clear_evidence {
            Observation::Clean
        } else {
            Observation::Between
        }
    }
}

/// One diagnosis as the alarm sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Observation {
    /// Stiction.
    Sticky,
    /// No stiction, below the clear threshold.
    Clean,
    /// No stiction, yet within the hysteresis band.
    Between,
    /// Not identifiable: no vote.
    Unknown,
}

/// What the operator sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum State {
    /// No condition, nothing to do.
    Normal,
    /// The condition holds and nobody has seen it.
    Unacknowledged,
    /// The condition holds and somebody has seen it.
    Acknowledged,
    /// The condition went away before anybody saw it.
    ReturnedUnacknowledged,
    /// Silenced by an operator until a time.
    Shelved,
}

impl State {
    /// Every state, for metrics and schemas.
    pub const ALL: [State; 5] = [
        State::Normal,
        State::Unacknowledged,
        State::Acknowledged,
        State::ReturnedUnacknowledged,
        State::Shelved,
    ];

    /// The state as the API writes it.
    pub fn as_str(self) -> &'static str {
        match self {
            State::Normal => "normal",
            State::Unacknowledged => "unacknowledged",
            State::Acknowledged => "acknowledged",
            State::ReturnedUnacknowledged => "returned-unacknowledged",
            State::Shelved => "shelved",
        }
    }
}

/// Why the state changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// k of n diagnoses were sticky.
    Raised,
    /// The diagnoses came back clean.
    Cleared,
    /// An operator acknowledged.
    Acknowledged,
    /// An operator shelved.
    Shelved,
    /// An operator ended the shelving.
    Unshelved,
    /// The shelving ran out.
    Expired,
}

impl Cause {
    /// The cause as the API writes it.
    pub fn as_str(self) -> &'static str {
        match self {
            Cause::Raised => "raised",
            Cause::Cleared => "cleared",
            Cause::Acknowledged => "acknowledged",
            Cause::Shelved => "shelved",
            Cause::Unshelved => "unshelved",
            Cause::Expired => "shelving_expired",
        }
    }
}

/// One arrow of the diagram, taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transition {
    /// State before.
    pub from: State,
    /// State after.
    pub to: State,
    /// When (s).
    pub at: f64,
    /// Why.
    pub cause: Cause,
}

/// Why an action was refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// Only an unacknowledged alarm can be acknowledged.
    #[error("there is nothing to acknowledge: the alarm is {}", .0.as_str())]
    NothingToAcknowledge(State),
    /// Only a shelved alarm can be unshelved.
    #[error("the alarm is not shelved: it is {}", .0.as_str())]
    NotShelved(State),
    /// Shelving needs a positive, bounded time.
    #[error("an alarm can be shelved for more than 0 s and at most {max_s} s")]
    BadDuration {
        /// The longest time allowed (s).
        max_s: f64,
    },
}

/// Everything an alarm is beside its settings: what has to outlive a restart.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Saved {
    /// The condition holds.
    pub active: bool,
    /// Somebody has seen it.
    pub acknowledged: bool,
    /// Until when it is shelved (s).
    pub shelved_until: Option<f64>,
    /// Identifiable diagnoses since the condition last changed, oldest first.
    pub votes: Vec<Observation>,
    /// When the state last changed (s).
    pub since: Option<f64>,
    /// When the condition was last raised (s).
    pub raised_at: Option<f64>,
}

/// The alarm of one loop.
#[derive(Clone, Debug)]
pub struct Alarm {
    config: Config,
    /// The condition, whoever knows of it.
    active: bool,
    acknowledged: bool,
    shelved_until: Option<f64>,
    /// Identifiable diagnoses since the condition last changed, the last `max(n, clear_n)` of them.
    votes: VecDeque<Observation>,
    since: Option<f64>,
    raised_at: Option<f64>,
}

impl Alarm {
    /// An alarm in `normal`.
    pub fn new(config: Config) -> Self {
        Self {
            config,
            active: false,
            acknowledged: true,
            shelved_until: None,
            votes: VecDeque::new(),
            since: None,
            raised_at: None,
        }
    }

    /// The alarm as it was saved, under settings that may be others; nobody is told of anything again.
    pub fn restored(config: Config, saved: Saved) -> Self {
        let Saved { active, acknowledged, shelved_until, votes, since, raised_at } = saved;
        let mut votes: VecDeque<Observation> = votes.into();
        votes.retain(|vote| *vote != Observation::Unknown);
        while votes.len() > config.n.max(config.clear_n).max(1) {
            votes.pop_front();
        }
        Self { config, active, acknowledged, shelved_until, votes, since, raised_at }
    }

    /// What has to outlive a restart.
    pub fn saved(&self) -> Saved {
        Saved {
            active: self.active,
            acknowledged: self.acknowledged,
            shelved_until: self.shelved_until,
            votes: self.votes.iter().copied().collect(),
            since: self.since,
            raised_at: self.raised_at,
        }
    }

    /// Takes new settings and keeps the state and the votes.
    pub fn reconfigure(&mut self, config: Config) {
        self.config = config;
    }

    /// The state as the operator sees it, as of the last call that was given a time.
    pub fn state(&self) -> State {
        match (self.shelved_until, self.active, self.acknowledged) {
            (Some(_), _, _) => State::Shelved,
            (None, true, false) => State::Unacknowledged,
            (None, true, true) => State::Acknowledged,
            (None, false, false) => State::ReturnedUnacknowledged,
            (None, false, true) => State::Normal,
        }
    }

    /// Whether the condition holds, shelved or not.
    pub fn is_active(&self) -> bool {
        self.active
    }

    /// When the state last changed (s); `None` when it never did.
    pub fn since(&self) -> Option<f64> {
        self.since
    }

    /// When the condition was last raised (s).
    pub fn raised_at(&self) -> Option<f64> {
        self.raised_at
    }

    /// Until when it is shelved (s).
    pub fn shelved_until(&self) -> Option<f64> {
        self.shelved_until
    }

    /// Lets time pass: a shelving that has run out ends.
    pub fn tick(&mut self, now: f64) -> Vec<Transition> {
        match self.shelved_until {
            Some(until) if now >= until => vec![self.end_shelving(now, Cause::Expired)],
            _ => Vec::new(),
        }
    }

    /// Takes a diagnosis made at `now`.
    pub fn observe(&mut self, observation: Observation, now: f64) -> Vec<Transition> {
        let mut taken = self.tick(now);
        if observation == Observation::Unknown {
            return taken;
        }
        self.votes.push_back(observation);
        while self.votes.len() > self.config.n.max(self.config.clear_n).max(1) {
            self.votes.pop_front();
        }
        let (wanted, enough, of) = if self.active {
            (Observation::Clean, self.config.clear_k, self.config.clear_n)
        } else {
            (Observation::Sticky, self.config.k, self.config.n)
        };
        let votes = self.votes.iter().rev().take(of).filter(|&&vote| vote == wanted).count();
        if votes >= enough.max(1) {
            taken.extend(self.flip(now));
        }
        taken
    }

    /// An operator has seen the alarm.
    ///
    /// # Errors
    /// [`Refusal::NothingToAcknowledge`] unless the alarm waits for it.
    pub fn acknowledge(&mut self, now: f64) -> Result<Vec<Transition>, Refusal> {
        let mut taken = self.tick(now);
        let from = self.state();
        if !matches!(from, State::Unacknowledged | State::ReturnedUnacknowledged) {
            return Err(Refusal::NothingToAcknowledge(from));
        }
        self.acknowledged = true;
        taken.push(self.moved(from, now, Cause::Acknowledged));
        Ok(taken)
    }

    /// An operator silences the alarm for `duration` seconds; shelving a shelved alarm sets a new end.
    ///
    /// # Errors
    /// [`Refusal::BadDuration`] for a time that is not positive or longer than allowed.
    pub fn shelve(&mut self, duration: f64, now: f64) -> Result<Vec<Transition>, Refusal> {
        let max_s = self.config.max_shelve_s;
        if !(duration > 0.0 && duration <= max_s) {
            return Err(Refusal::BadDuration { max_s });
        }
        let mut taken = self.tick(now);
        let from = self.state();
        self.shelved_until = Some(now + duration);
        if from != State::Shelved {
            taken.push(self.moved(from, now, Cause::Shelved));
        }
        Ok(taken)
    }

    /// An operator ends the shelving.
    ///
    /// # Errors
    /// [`Refusal::NotShelved`] when it is not, or no longer, shelved.
    pub fn unshelve(&mut self, now: f64) -> Result<Vec<Transition>, Refusal> {
        let taken = self.tick(now);
        if self.shelved_until.is_none() {
            return if taken.is_empty() { Err(Refusal::NotShelved(self.state())) } else { Ok(taken) };
        }
        Ok(vec![self.end_shelving(now, Cause::Unshelved)])
    }

    /// The condition changes; shelved, nobody is told.
    fn flip(&mut self, now: f64) -> Option<Transition> {
        let from = self.state();
        self.active = !self.active;
        // Counting starts afresh, so that the votes that raised an alarm cannot help to raise it again.
        self.votes.clear();
        let cause = if self.active { Cause::Raised } else { Cause::Cleared };
        if self.active {
            self.acknowledged = false;
            self.raised_at = Some(now);
        }
        (from != State::Shelved).then(|| self.moved(from, now, cause))
    }

    fn end_shelving(&mut self, now: f64, cause: Cause) -> Transition {
        self.shelved_until = None;
        self.acknowledged = !self.active;
        self.moved(State::Shelved, now, cause)
    }

    fn moved(&mut self, from: State, at: f64, cause: Cause) -> Transition {
        self.since = Some(at);
        Transition { from, to: self.state(), at, cause }
    }
}

#[cfg(test)]
mod tests;
