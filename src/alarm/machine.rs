//! The state machine of one alarm, after ISA-18.2 and IEC 62682: the condition and people's actions in, transitions out.

use super::state::{Cause, Refusal, Shelving, State, Transition};

/// Everything that makes up the state: what has to outlive a restart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Flags {
    /// The condition holds, whoever knows of it.
    pub active: bool,
    /// Somebody has seen it.
    pub acknowledged: bool,
    /// The condition went and the alarm stays.
    pub latched: bool,
    /// Until when it is shelved (s).
    pub shelved_until: Option<f64>,
    /// Shelved until the condition goes.
    pub one_shot: bool,
    /// Suppressed by design.
    pub suppressed: bool,
    /// Out of service.
    pub out_of_service: bool,
    /// When the state last changed (s).
    pub since: Option<f64>,
    /// When the condition was last raised (s).
    pub raised_at: Option<f64>,
}

impl Default for Flags {
    fn default() -> Self {
        Self {
            active: false,
            acknowledged: true,
            latched: false,
            shelved_until: None,
            one_shot: false,
            suppressed: false,
            out_of_service: false,
            since: None,
            raised_at: None,
        }
    }
}

impl Flags {
    /// The state as the operator sees it, as of the last call that was given a time.
    pub fn state(&self) -> State {
        if self.out_of_service {
            State::OutOfService
        } else if self.shelved_until.is_some() {
            State::Shelved
        } else if self.suppressed {
            State::SuppressedByDesign
        } else {
            match (self.active, self.latched, self.acknowledged) {
                (true, _, false) => State::Unacknowledged,
                (true, _, true) => State::Acknowledged,
                (false, true, false) => State::LatchedUnacknowledged,
                (false, true, true) => State::LatchedAcknowledged,
                (false, false, false) => State::ReturnedUnacknowledged,
                (false, false, true) => State::Normal,
            }
        }
    }

    /// Lets time pass: a shelving that has run out ends.
    pub fn tick(&mut self, now: f64) -> Option<Transition> {
        let over = self.shelved_until.is_some_and(|until| now >= until);
        over.then(|| self.change(now, Cause::Expired, Self::end_shelving))
    }

    /// Lets no shelving end later than somebody could have it end from now on: a clock that was set back would prolong it.
    pub fn bound_shelving(&mut self, max_s: f64, now: f64) {
        self.shelved_until = self.shelved_until.map(|until| until.min(now + max_s));
    }

    /// The condition comes or goes; while the alarm is silent nobody is told. `latching`: the alarm stays when it goes.
    pub fn condition(&mut self, active: bool, latching: bool, now: f64) -> Option<Transition> {
        if active == self.active {
            return None;
        }
        let from = self.state();
        self.active = active;
        if active {
            (self.acknowledged, self.latched, self.raised_at) = (false, false, Some(now));
        } else {
            self.latched = latching;
        }
        if !active && self.one_shot {
            return Some(self.change(now, Cause::OneShotOver, Self::end_shelving));
        }
        if from.is_silent() {
            return None;
        }
        Some(self.moved(from, now, if active { Cause::Raised } else { Cause::Cleared }))
    }

    /// Somebody has seen the alarm.
    pub fn acknowledge(&mut self, now: f64) -> Result<Transition, Refusal> {
        let state = self.state();
        if !state.wants_acknowledgement() {
            return Err(Refusal::NothingToAcknowledge(state));
        }
        Ok(self.change(now, Cause::Acknowledged, |flags| flags.acknowledged = true))
    }

    /// Somebody lets a latched alarm go.
    pub fn reset(&mut self, now: f64) -> Result<Transition, Refusal> {
        let state = self.state();
        if state != State::LatchedAcknowledged {
            return Err(Refusal::NothingToReset(state));
        }
        Ok(self.change(now, Cause::Reset, |flags| flags.latched = false))
    }

    /// Somebody silences the alarm. Shelving a shelved alarm sets a new end, and is told too: who follows the alarm elsewhere
    /// would not know of it, nor who decides by when somebody acted last.
    pub fn shelve(&mut self, how: Shelving, max_s: f64, now: f64) -> Result<Transition, Refusal> {
        let (duration, one_shot) = match how {
            Shelving::For(duration) => (duration, false),
            Shelving::Once(duration) => (duration, true),
        };
        if self.out_of_service {
            return Err(Refusal::OutOfService);
        }
        if !(duration > 0.0 && duration <= max_s) {
            return Err(Refusal::BadDuration { max_s });
        }
        if one_shot && !self.active {
            return Err(Refusal::NothingToShelve);
        }
        let from = self.state();
        (self.shelved_until, self.one_shot) = (Some(now + duration), one_shot);
        Ok(self.moved(from, now, Cause::Shelved))
    }

    /// Somebody ends the shelving.
    pub fn unshelve(&mut self, now: f64) -> Result<Transition, Refusal> {
        if self.state() != State::Shelved {
            return Err(Refusal::NotShelved(self.state()));
        }
        Ok(self.change(now, Cause::Unshelved, Self::end_shelving))
    }

    /// The design of the plant begins or ceases to suppress the alarm; told only where that is seen.
    pub fn suppress(&mut self, suppressed: bool, now: f64) -> Option<Transition> {
        if suppressed == self.suppressed {
            return None;
        }
        let from = self.state();
        self.suppressed = suppressed;
        self.reveal(from);
        let cause = if suppressed { Cause::Suppressed } else { Cause::Unsuppressed };
        (self.state() != from).then(|| self.moved(from, now, cause))
    }

    /// Somebody takes the alarm out of service, which ends a shelving.
    pub fn take_out(&mut self, now: f64) -> Result<Transition, Refusal> {
        if self.out_of_service {
            return Err(Refusal::OutOfService);
        }
        Ok(self.change(now, Cause::TakenOut, |flags| {
            flags.end_shelving();
            flags.out_of_service = true;
        }))
    }

    /// Somebody gives the alarm back to service.
    pub fn give_back(&mut self, now: f64) -> Result<Transition, Refusal> {
        if !self.out_of_service {
            return Err(Refusal::InService(self.state()));
        }
        Ok(self.change(now, Cause::Returned, |flags| flags.out_of_service = false))
    }

    /// What it is about is there no more, so that nobody has to do anything. What is silent stays so, for when it is there again.
    pub fn forget(&mut self, now: f64) -> Option<Transition> {
        let from = self.state();
        if from == State::Normal || from.is_silent() {
            return None;
        }
        (self.active, self.latched, self.acknowledged) = (false, false, true);
        Some(self.moved(from, now, Cause::Forgotten))
    }

    /// Takes how it was left before a start that did not know it: what people did then still holds, and so does a condition
    /// until it is observed to go. The design is that of now.
    pub fn merge(&mut self, left: Flags, now: f64) -> Option<Transition> {
        let (from, own) = (self.state(), *self);
        self.active = own.active || left.active;
        self.latched = !self.active && (own.latched || left.latched);
        self.acknowledged = match (left.active, own.active) {
            (true, true) => own.acknowledged || left.acknowledged,
            (true, false) => left.acknowledged,
            (false, true) => own.acknowledged,
            (false, false) => own.acknowledged && left.acknowledged,
        };
        if own.shelved_until.is_none() {
            (self.shelved_until, self.one_shot) = (left.shelved_until, left.one_shot);
        }
        self.out_of_service = own.out_of_service || left.out_of_service;
        if self.out_of_service {
            self.end_shelving();
        }
        self.raised_at = if left.active { left.raised_at } else { own.raised_at.or(left.raised_at) };
        self.since = if self.state() == left.state() { left.since.or(own.since) } else { own.since };
        (self.state() != from).then(|| self.moved(from, now, Cause::Restored))
    }

    fn end_shelving(&mut self) {
        (self.shelved_until, self.one_shot) = (None, false);
    }

    fn change(&mut self, now: f64, cause: Cause, act: impl FnOnce(&mut Self)) -> Transition {
        let from = self.state();
        act(self);
        self.reveal(from);
        self.moved(from, now, cause)
    }

    /// What was silent and no longer is wants to be seen again while there is something to see.
    fn reveal(&mut self, from: State) {
        if from.is_silent() && !self.state().is_silent() {
            self.acknowledged = !(self.active || self.latched);
        }
    }

    fn moved(&mut self, from: State, at: f64, cause: Cause) -> Transition {
        self.since = Some(at);
        Transition { from, to: self.state(), at, cause }
    }
}
