//! The gate: who may add a term to OP, when, and why not. Pure: time is an argument, what is seen is an argument, and
//! what may be written comes out as an [`Order`] that nobody else can make.
//!
//! ```text
//!              enable              grant + approval              every condition holds
//!  +----------+ ----> +--------+ -----------------> +-------+ ------------------------> +--------+
//!  | disabled |       | shadow | <----------------- | armed |                           | active |
//!  +----------+       +--------+  expired, revoked  +-------+                           +--------+
//!       ^               ^    ^                                                              |
//!       |               |    |        at zero, and                                          | a denial, an operator,
//!       |               |    +------- expired or by an operator ------+                     | the grant's end, stop
//!       |         reset |                                             |                     v
//!       |               |    at zero after a fault, or       +-------------------------------------+
//!       |          +---------+  not at zero in time          |             withdrawing             |
//!       |          | tripped | <---------------------------- |       ramps to zero, heart beats    |
//!       |          +---------+                               +-------------------------------------+
//!       |                                                             |
//!       +-------- stop, from everywhere; from withdrawing once at zero or out of time --------+
//! ```
//!
//! | from | to | when |
//! |---|---|---|
//! | disabled | shadow | [`Gate::enable`] |
//! | shadow | armed | [`Gate::grant`] by one person and [`Gate::approve`] by another, before it expires |
//! | armed | shadow | the grant expires, or [`Gate::withdraw`] |
//! | armed | active | a step finds no [`Denial`] |
//! | active | withdrawing | a step finds a denial, a write fails, the grant expires, [`Gate::withdraw`], [`Gate::stop`] |
//! | withdrawing | shadow | zero is written and read back, after an expiry or an operator's withdrawal |
//! | withdrawing | tripped | zero is written and read back after a fault; or it is not, in `withdraw_limit_s` |
//! | withdrawing | disabled | zero is written and read back, or time is up, after a stop |
//! | tripped | shadow | [`Gate::reset`] by an operator |
//! | shadow, armed, tripped | disabled | [`Gate::stop`] |
//!
//! An order exists in *active* and *withdrawing* only, and each carries another heartbeat: leaving both stops the
//! heartbeat, so that the DCS drops the term even where zero could not be written. An order does not hold for longer than
//! `max_step_s`. After a silence in which the DCS may have dropped the term, the way to zero is one step. A grant is good for one
//! activation.

mod conditions;
mod reinforcer;
mod watch;
mod words;

pub use conditions::{Denial, Evidence, Inputs, Limits, Time};
pub use words::{Action, Cause, Event, Grant, News, Order, Refusal, State, Status, WriteFault};

use super::measure::{Baseline, Point, Trial};
use conditions::believed;
use reinforcer::Reinforcer;
use watch::{Polls, SetPoint};

/// The gate of one loop.
#[derive(Clone, Debug)]
pub struct Gate {
    limits: Limits,
    state: State,
    since: Option<f64>,
    grant: Option<Grant>,
    news: Vec<News>,
    denials: Vec<Denial>,
    clock: Option<Time>,
    set_point: SetPoint,
    polls: Polls,
    baseline: Baseline,
    cr: Option<Reinforcer>,
    trial: Option<Trial>,
    term: f64,
    heartbeat: u16,
    /// When the last order was made that is known to have reached the DCS.
    beat: Option<Time>,
    leaving: Option<Leaving>,
    outstanding: bool,
    fault: Option<Denial>,
    tripped_by: Option<Denial>,
}

/// On the way to zero.
#[derive(Clone, Copy, Debug)]
struct Leaving {
    since: f64,
    to: State,
}

impl Gate {
    /// A gate in `disabled`.
    pub fn new(limits: Limits) -> Self {
        Self {
            limits,
            state: State::Disabled,
            since: None,
            grant: None,
            news: Vec::new(),
            denials: Vec::new(),
            clock: None,
            set_point: SetPoint::default(),
            polls: Polls::default(),
            baseline: Baseline::new(limits.criteria.length_s, limits.max_sample_age_s),
            cr: None,
            trial: None,
            term: 0.0,
            heartbeat: 0,
            beat: None,
            leaving: None,
            outstanding: false,
            fault: None,
            tripped_by: None,
        }
    }

    /// Where it is.
    pub fn state(&self) -> State {
        self.state
    }

    /// What has happened since the last call, oldest first.
    pub fn take_news(&mut self) -> Vec<News> {
        std::mem::take(&mut self.news)
    }

    /// The term in force at the valve, as far as the gate knows [%].
    pub fn in_force(&self) -> f64 {
        if self.state.writes() { self.term } else { 0.0 }
    }

    /// Everything to show.
    pub fn status(&self) -> Status {
        Status {
            state: self.state,
            since: self.since,
            term: self.term,
            in_force: self.in_force(),
            denials: self.denials.clone(),
            grant: self.grant.clone(),
            tripped_by: self.tripped_by,
            baseline_s: self.baseline.have_s(),
            before: self.trial.as_ref().map(Trial::before),
            with: self.trial.as_ref().and_then(Trial::with),
            running: self.trial.as_ref().map(Trial::running),
            proven: self.trial.as_ref().is_some_and(Trial::proven),
        }
    }

    /// disabled -> shadow.
    pub fn enable(&mut self, now: Time) {
        if self.state == State::Disabled {
            self.go(State::Shadow, Cause::Enabled, None, now);
        }
    }

    /// An operator allows it, for `duration_s`; a second person has to approve.
    ///
    /// # Errors
    /// [`Refusal`] in another state than shadow, for a nameless user or a time out of bounds.
    pub fn grant(&mut self, by: &str, duration_s: f64, now: Time) -> Result<(), Refusal> {
        self.expire(now);
        self.only_in(State::Shadow)?;
        let by = named(by)?;
        let max_s = self.limits.grant_max_s;
        if !(duration_s > 0.0 && duration_s <= max_s) {
            return Err(Refusal::BadDuration { max_s });
        }
        let grant = Grant {
            by: by.clone(),
            approved_by: None,
            until: Time { mono: now.mono + duration_s, wall: now.wall + duration_s },
        };
        self.tell(Event::Granted { by, until: grant.until.wall }, now);
        self.grant = Some(grant);
        Ok(())
    }

    /// shadow -> armed: a second person agrees to the grant.
    ///
    /// # Errors
    /// [`Refusal`] without a grant that waits for it, or from the person who granted.
    pub fn approve(&mut self, by: &str, now: Time) -> Result<(), Refusal> {
        self.expire(now);
        self.only_in(State::Shadow)?;
        let by = named(by)?;
        let Some(grant) = &mut self.grant else { return Err(Refusal::NothingGranted) };
        if grant.by.to_lowercase() == by.to_lowercase() {
            return Err(Refusal::SamePerson);
        }
        grant.approved_by = Some(by.clone());
        self.tell(Event::Approved { by: by.clone() }, now);
        self.go(State::Armed, Cause::Approved, Some(by), now);
        Ok(())
    }

    /// armed -> shadow, active -> withdrawing; a grant that waits for approval is dropped.
    ///
    /// # Errors
    /// [`Refusal::NothingToWithdraw`].
    pub fn withdraw(&mut self, by: &str, now: Time) -> Result<(), Refusal> {
        let by = named(by)?;
        match self.state {
            State::Active => self.leave(State::Shadow, Cause::Operator, Some(by), now),
            State::Armed => self.revoked(Cause::Operator, Some(by), now),
            State::Shadow if self.grant.is_some() => {
                self.grant = None;
                self.tell(Event::GrantDropped { by }, now);
            }
            _ => return Err(Refusal::NothingToWithdraw(self.state)),
        }
        Ok(())
    }

    /// tripped -> shadow.
    ///
    /// # Errors
    /// [`Refusal::NotIn`] unless it is tripped.
    pub fn reset(&mut self, by: &str, now: Time) -> Result<(), Refusal> {
        self.only_in(State::Tripped)?;
        let by = named(by)?;
        self.tripped_by = None;
        self.go(State::Shadow, Cause::Reset, Some(by), now);
        Ok(())
    }

    /// Shutdown: active -> withdrawing -> disabled; from elsewhere at once.
    pub fn stop(&mut self, now: Time) {
        match (self.state, &mut self.leaving) {
            (State::Disabled, _) => {}
            (State::Withdrawing, Some(leaving)) => leaving.to = State::Disabled,
            (State::Active, _) => self.leave(State::Disabled, Cause::Stopped, None, now),
            _ => self.go(State::Disabled, Cause::Stopped, None, now),
        }
    }

    /// Looks at the loop and says what to write now, if anything. Whatever became of the order has to be said with
    /// [`Gate::report`] before the next step.
    pub fn step(&mut self, now: Time, inputs: &Inputs) -> Option<Order> {
        let passed = self.pass(now);
        if std::mem::take(&mut self.outstanding) {
            self.fault = Some(Denial::WriteFailed);
        }
        self.expire(now);
        let mut denials = passed.denial.into_iter().collect::<Vec<_>>();
        conditions::data(inputs, now.wall, &self.limits, &mut denials);
        denials.extend(self.polls.missed(inputs, now, &self.limits));
        let moving = self.set_point.moves(inputs, now, &self.limits);
        let failure = self.measure(inputs, now);
        self.reinforce(inputs, now);
        denials.extend(failure);
        if self.state == State::Active {
            denials.extend(self.fault.take());
            denials.extend(self.f_left(inputs));
        } else {
            denials.extend(moving.then_some(Denial::SpMoving));
            denials.extend(conditions::evidence(inputs, now.wall, &self.limits));
            denials.extend(self.nobody());
            if self.baseline.have_s() < self.limits.criteria.length_s {
                denials.push(Denial::BaselineShort);
            }
        }
        self.denials = denials;
        let first = self.denials.first().copied();
        match (self.state, first) {
            (State::Armed, None) => {
                let denied = self.open(inputs, now).err();
                self.denials.extend(denied);
            }
            (State::Active, Some(denial)) => self.leave(State::Tripped, Cause::Denied(denial), None, now),
            (State::Withdrawing, _) => self.withdrawing(now),
            _ => {}
        }
        self.approach(passed.dt, now);
        self.order(now)
    }

    /// What became of an order.
    pub fn report(&mut self, order: Order, outcome: Result<(), WriteFault>, now: Time) {
        self.outstanding = false;
        let Err(fault) = outcome else {
            self.beat = Some(order.made());
            if let (State::Withdrawing, Some(leaving)) = (self.state, self.leaving)
                && order.term() == 0.0
            {
                self.go(leaving.to, Cause::AtZero, None, now);
            }
            return;
        };
        let denial = match fault {
            WriteFault::Failed => Denial::WriteFailed,
            WriteFault::ReadBack => Denial::ReadBack,
            WriteFault::Audit => Denial::AuditFailed,
            WriteFault::Withheld => {
                // The next step finds what it was, or this.
                self.fault = self.fault.or(Some(Denial::Late).filter(|_| self.state == State::Active));
                return;
            }
        };
        match (self.state, &mut self.leaving) {
            (State::Active, _) => self.leave(State::Tripped, Cause::Denied(denial), None, now),
            // A withdrawal that was asked for and cannot be carried out is a fault after all.
            (State::Withdrawing, Some(leaving)) if leaving.to == State::Shadow => {
                leaving.to = State::Tripped;
                self.tripped_by = Some(denial);
            }
            _ => {}
        }
    }

    fn pass(&mut self, now: Time) -> Passed {
        let Some(last) = self.clock.replace(now) else {
            return Passed { dt: 0.0, denial: None };
        };
        let (mono, wall) = (now.mono - last.mono, now.wall - last.wall);
        // Comparisons that a NaN fails too.
        let steady = (wall - mono).abs() <= self.limits.clock_tolerance_s && mono >= 0.0;
        let in_time = mono <= self.limits.max_step_s;
        let denial = match (steady, in_time) {
            (false, _) => Some(Denial::ClockJump),
            (true, false) => Some(Denial::Late),
            _ => None,
        };
        Passed { dt: mono.max(0.0).min(self.limits.max_step_s), denial }
    }

    /// A grant ends by the steady clock or by the wall, whichever comes first: a clock set back prolongs nothing.
    fn expire(&mut self, now: Time) {
        let Some(grant) = &self.grant else { return };
        if now.mono < grant.until.mono && now.wall < grant.until.wall {
            return;
        }
        let expired = Cause::Denied(Denial::GrantExpired);
        match self.state {
            State::Active => self.leave(State::Shadow, expired, None, now),
            State::Armed => self.revoked(expired, None, now),
            _ => {
                self.grant = None;
                self.tell(Event::GrantExpired, now);
            }
        }
    }

    fn nobody(&self) -> Option<Denial> {
        match &self.grant {
            None => Some(Denial::NotGranted),
            Some(grant) => grant.approved_by.is_none().then_some(Denial::NotApproved),
        }
    }

    /// Feeds the measurement: the time before while not active, the trial while active.
    fn measure(&mut self, inputs: &Inputs, now: Time) -> Option<Denial> {
        let limits = self.limits;
        let value = |sample| believed(sample, now.wall, &limits);
        let percent = 100.0 / limits.op_span;
        let automatic = value(inputs.mode) == Some(1.0);
        let (Some(op), Some(pv), Some(sp), true) =
            (value(inputs.op), value(inputs.pv), value(inputs.sp), automatic)
        else {
            self.baseline.clear();
            return None;
        };
        let t = inputs.pv.map_or(f64::NAN, |pv| pv.t);
        let mv = value(inputs.mv).map(|mv| mv * percent);
        let point = Point { t, pv, sp, input: op * percent + self.in_force(), mv };
        if self.state.writes() {
            self.baseline.clear();
            let trial = self.trial.as_mut().filter(|_| self.state == State::Active)?;
            return trial.push(&point).map(Denial::from);
        }
        self.baseline.push(point);
        None
    }

    fn open(&mut self, inputs: &Inputs, now: Time) -> Result<(), Denial> {
        let criteria = self.limits.criteria;
        let evidence = inputs.evidence.ok_or(Denial::NoEvidence)?;
        let before =
            self.baseline.measured(evidence.f, criteria.reversal_band).ok_or(Denial::BaselineShort)?;
        // Any movement is more than a multiple of none: such a trial would trip on its first step.
        if before.travel == 0.0 {
            return Err(Denial::BaselineAtRest);
        }
        self.cr = self.reinforcer(evidence);
        self.trial = Some(Trial::new(before, evidence.f, criteria));
        self.term = 0.0;
        self.fault = None;
        self.tripped_by = None;
        self.go(State::Active, Cause::Opened, None, now);
        Ok(())
    }

    fn leave(&mut self, to: State, cause: Cause, by: Option<String>, now: Time) {
        self.leaving = Some(Leaving { since: now.mono, to });
        if let (State::Tripped, Cause::Denied(denial)) = (to, cause) {
            self.tripped_by = Some(denial);
        }
        self.go(State::Withdrawing, cause, by, now);
    }

    fn withdrawing(&mut self, now: Time) {
        let Some(leaving) = self.leaving else { return };
        // False for what is no number, too.
        let in_time = now.mono - leaving.since <= self.limits.withdraw_limit_s;
        if !in_time {
            let to = if leaving.to == State::Disabled { leaving.to } else { State::Tripped };
            if to == State::Tripped {
                // Where no write failed either the ramp was too slow, or the steps came too late.
                self.tripped_by = self.tripped_by.or(self.fault).or(Some(Denial::NotAtZero));
            }
            self.go(to, Cause::NotAtZero, None, now);
        }
    }

    fn revoked(&mut self, cause: Cause, by: Option<String>, now: Time) {
        self.grant = None;
        self.go(State::Shadow, cause, by, now);
    }

    /// The term on its way to what it should be, at the rate of the state. Where the DCS may have dropped it, the rest of the ramp
    /// would come back in one step: there it is 0 at once.
    fn approach(&mut self, dt: f64, now: Time) {
        let Limits { clamp, rate, withdraw_rate, .. } = self.limits;
        let asked = self.cr.as_ref().map_or(0.0, |own| own.target);
        let is_dropped = self.state == State::Withdrawing && self.is_silent(now);
        let (target, rate) = match self.state {
            State::Withdrawing if !is_dropped => (0.0, withdraw_rate),
            State::Disabled | State::Tripped | State::Withdrawing => {
                self.term = 0.0;
                return;
            }
            _ => (asked, rate),
        };
        let reach = rate * dt;
        self.term = target.clamp(-clamp, clamp).max(self.term - reach).min(self.term + reach);
    }

    /// Whether the last heartbeat is so long ago, by either clock, that the DCS may have dropped the term. The steady clock of a
    /// machine that was suspended may have stood still. A wall clock that was set ahead looks the same, and ends the term in one
    /// step, too: that is the safe side.
    fn is_silent(&self, now: Time) -> bool {
        let short = |silence: f64| silence <= self.limits.silence_s;
        self.beat.is_some_and(|beat| !(short(now.mono - beat.mono) && short(now.wall - beat.wall)))
    }

    fn order(&mut self, now: Time) -> Option<Order> {
        if !self.state.writes() {
            return None;
        }
        self.heartbeat = self.heartbeat.wrapping_add(1);
        self.outstanding = true;
        Some(Order::new(self.term, self.heartbeat, now, &self.limits))
    }

    fn only_in(&self, wanted: State) -> Result<(), Refusal> {
        if self.state == wanted { Ok(()) } else { Err(Refusal::NotIn { is: self.state, wanted }) }
    }

    /// Every transition passes here. A grant ends where its activation does.
    fn go(&mut self, to: State, cause: Cause, by: Option<String>, now: Time) {
        let from = std::mem::replace(&mut self.state, to);
        self.since = Some(now.wall);
        if matches!(to, State::Withdrawing | State::Tripped | State::Disabled) {
            self.grant = None;
        }
        if from.writes() && !to.writes() {
            (self.leaving, self.outstanding, self.fault) = (None, false, None);
            (self.term, self.cr, self.beat) = (0.0, None, None);
        }
        self.tell(Event::Moved { from, to, cause, by }, now);
    }

    fn tell(&mut self, event: Event, now: Time) {
        let tripped_by = self.tripped_by.filter(|_| self.state == State::Tripped);
        self.news.push(News { at: now.wall, event, tripped_by });
    }
}

/// What one step's time brought.
struct Passed {
    dt: f64,
    denial: Option<Denial>,
}

fn named(by: &str) -> Result<String, Refusal> {
    let name = by.trim();
    if name.is_empty() { Err(Refusal::Nameless) } else { Ok(name.to_string()) }
}

#[cfg(test)]
mod tests;
