use super::*;
use crate::compensation::measure::Criteria;
use crate::signal::{BadReason, Quality, Sample};
use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};
use std::cell::Cell;

mod opening;
mod silence;

/// A heartbeat that stands still for longer drops the term (s).
const DCS_TIMEOUT_S: f64 = 3.0;

const LIMITS: Limits = Limits {
    clamp: 3.0,
    rate: 2.0,
    withdraw_rate: 1.0,
    withdraw_limit_s: 8.0,
    dead_band: 0.0,
    rest_s: 5.0,
    max_step_s: 2.0,
    silence_s: 2.6,
    clock_tolerance_s: 1.0,
    max_sample_age_s: 3.0,
    max_missed_polls: 1,
    op_span: 100.0,
    op_limits: [0.0, 100.0],
    op_margin: 5.0,
    sp_rate: 0.1,
    sp_settle_s: 3.0,
    evidence_max_age_s: 1000.0,
    f_margin: 0.1,
    grant_max_s: 100.0,
    criteria: Criteria {
        length_s: 5.0,
        prove_s: 50.0,
        ise_gain: 1.1,
        ise_limit: 100.0,
        travel_limit: 1e6,
        reversal_band: 0.1,
    },
};

/// A loop, two clocks and a DCS that the gate is run against.
struct World {
    gate: Gate,
    time: Time,
    op: f64,
    turn: f64,
    pv: f64,
    sp: f64,
    quality: [Quality; 2],
    mode: f64,
    old_s: f64,
    evidence: Evidence,
    missed: u64,
    audited: bool,
    /// What becomes of writes.
    outcome: Result<(), WriteFault>,
    dcs: Dcs,
}

/// What an observer outside knows.
#[derive(Default)]
struct Dcs {
    ordered: f64,
    last_beat: u16,
    /// The last term that was written and read back, and when its heartbeat came.
    held: f64,
    beat: Option<Time>,
    granted: Option<(String, f64, f64)>,
    approved: bool,
    leaving_since: Option<f64>,
    orders: usize,
    seen: [bool; 6],
}

impl Dcs {
    /// A term and its heartbeat arrive: what was dropped meanwhile must not come back in one step.
    fn take(&mut self, order: &Order, now: Time) {
        if !self.beat.is_some_and(|beat| now.mono - beat.mono <= DCS_TIMEOUT_S) {
            assert_eq!(order.term(), 0.0, "the DCS had dropped the term");
        }
        (self.held, self.beat) = (order.term(), Some(now));
    }

    /// Whether it may have dropped the term by the time that a heartbeat comes.
    fn is_silent(&self, now: Time) -> bool {
        let long =
            |beat: Time| now.mono - beat.mono > LIMITS.silence_s || now.wall - beat.wall > LIMITS.silence_s;
        self.beat.is_some_and(long)
    }
}

impl World {
    fn new() -> Self {
        let begin = 1_000_000.0;
        let evidence = Evidence { sticky: true, f: 2.0, f_ci95: [1.9, 2.1], at: begin, data_end: begin };
        let mut gate = Gate::new(LIMITS);
        let time = Time { mono: 0.0, wall: begin };
        gate.enable(time);
        Self {
            gate,
            time,
            op: 50.0,
            turn: 0.5,
            pv: 50.0,
            sp: 50.0,
            quality: [Quality::Good; 2],
            mode: 1.0,
            old_s: 0.0,
            evidence,
            missed: 0,
            audited: true,
            outcome: Ok(()),
            dcs: Dcs::default(),
        }
    }

    fn inputs(&self) -> Inputs {
        let sample = |value, quality| Some(Sample { t: self.time.wall - self.old_s, value, quality });
        Inputs {
            op: sample(self.op, self.quality[0]),
            pv: sample(self.pv, self.quality[1]),
            sp: sample(self.sp, Quality::Good),
            mode: sample(self.mode, Quality::Good),
            mv: None,
            evidence: Some(self.evidence),
            missed_polls: self.missed,
            audited: self.audited,
        }
    }

    fn tick(&mut self, dt: f64, jump: f64) {
        self.time = Time { mono: self.time.mono + dt, wall: self.time.wall + dt + jump };
        self.op += self.turn;
        if !(20.0..=80.0).contains(&self.op) {
            self.turn = -self.turn;
        }
        // An error that is never 0, so that there is an ISE to compare with.
        self.pv = self.sp + if self.turn > 0.0 { 1.0 } else { -1.0 };
        let before = self.gate.state();
        let order = self.gate.step(self.time, &self.inputs());
        self.check(order.as_ref(), dt);
        if let Some(order) = order {
            if self.outcome.is_ok() {
                self.dcs.take(&order, self.time);
            }
            self.gate.report(order, self.outcome, self.time);
        }
        self.left(before);
    }

    /// What must hold of every order, and of there being none.
    fn check(&mut self, order: Option<&Order>, dt: f64) {
        let state = self.gate.state();
        assert_eq!(order.is_some(), state.writes(), "orders and states disagree in {state:?}");
        let Some(order) = order else {
            self.dcs.ordered = 0.0;
            return;
        };
        self.dcs.orders += 1;
        let term = order.term();
        assert!(term.is_finite() && term.abs() <= LIMITS.clamp, "{term} beyond the clamp");
        let rate = if state == State::Active { LIMITS.rate } else { LIMITS.withdraw_rate };
        let reach = rate * dt.clamp(0.0, LIMITS.max_step_s);
        let at_once = state == State::Withdrawing && term == 0.0 && self.dcs.is_silent(self.time);
        // 1e-12: a rounding of a sum of order 1.
        let in_reach = (term - self.dcs.ordered).abs() <= reach + 1e-12;
        assert!(in_reach || at_once, "{} to {term} in {dt} s", self.dcs.ordered);
        if state == State::Withdrawing {
            assert!(term.abs() <= self.dcs.ordered.abs() && term * self.dcs.ordered >= 0.0, "not towards 0");
        }
        assert_ne!(order.heartbeat(), self.dcs.last_beat, "a heart that stands still");
        (self.dcs.ordered, self.dcs.last_beat) = (term, order.heartbeat());
        if state == State::Active {
            let (by, mono, wall) = self.dcs.granted.clone().expect("active without a grant");
            assert!(!by.is_empty() && self.dcs.approved, "active without two persons");
            assert!(self.time.mono < mono && self.time.wall < wall, "a grant outlived its expiry");
        }
    }

    /// What must hold of the way out, and how long it may take.
    fn left(&mut self, before: State) {
        let state = self.gate.state();
        self.dcs.seen[state as usize] = true;
        if state == State::Withdrawing {
            self.dcs.seen[State::Withdrawing as usize] = true;
            let since = *self.dcs.leaving_since.get_or_insert(self.time.mono);
            assert!(self.time.mono - since <= LIMITS.withdraw_limit_s, "withdrawing for too long");
        } else {
            self.dcs.leaving_since = None;
        }
        if before.writes() && !state.writes() {
            for news in self.gate.take_news() {
                if let Event::Moved { from: State::Withdrawing, to, cause, .. } = news.event {
                    assert_eq!(news.tripped_by.is_some(), to == State::Tripped, "why it is {to:?}");
                    match cause {
                        Cause::AtZero => {
                            assert_eq!(self.dcs.held, 0.0, "left for {to:?} with a term in force")
                        }
                        // The heart stands still from here on: `check` sees that no order comes.
                        cause => assert_eq!(cause, Cause::NotAtZero),
                    }
                }
            }
            (self.dcs.granted, self.dcs.approved) = (None, false);
        }
    }

    fn grant(&mut self, by: &str, duration_s: f64) {
        if self.gate.grant(by, duration_s, self.time).is_ok() {
            assert!(duration_s > 0.0 && duration_s <= LIMITS.grant_max_s);
            let until = (self.time.mono + duration_s, self.time.wall + duration_s);
            (self.dcs.granted, self.dcs.approved) = (Some((by.into(), until.0, until.1)), false);
        }
    }

    fn approve(&mut self, by: &str) {
        if self.gate.approve(by, self.time).is_ok() {
            let first = self.dcs.granted.as_ref().map(|(first, _, _)| first.to_lowercase());
            assert!(first.is_some_and(|first| first != by.to_lowercase()), "one person did both");
            self.dcs.approved = true;
        }
    }

    /// Everything as it should be, up to `active`.
    fn opened() -> Self {
        Self::opened_for(60.0)
    }

    fn opened_for(duration_s: f64) -> Self {
        let mut world = Self::new();
        (0..8).for_each(|_| world.tick(1.0, 0.0));
        world.grant("Ann", duration_s);
        world.approve("Bob");
        (0..3).for_each(|_| world.tick(1.0, 0.0));
        assert_eq!(world.gate.state(), State::Active, "{:?}", world.gate.status().denials);
        world
    }

    /// Ticks until nothing is written any more; how long that took (s).
    fn until_out(&mut self) -> f64 {
        let began = self.time.mono;
        while self.gate.state().writes() {
            self.tick(0.5, 0.0);
        }
        self.time.mono - began
    }
}

#[derive(Clone, Debug)]
enum Happens {
    Tick(f64, f64),
    Turn(f64),
    Sp(f64),
    Marked(usize, Quality),
    Mode(f64),
    Old(f64),
    Evidence(bool, f64, f64),
    Missed(u64),
    Audited(bool),
    Writes(Result<(), WriteFault>),
    Grant(&'static str, f64),
    Approve(&'static str),
    Withdraw,
    Reset,
    Stop,
    Enable,
    Heal,
}

const FAULTS: [WriteFault; 4] =
    [WriteFault::Failed, WriteFault::ReadBack, WriteFault::Audit, WriteFault::Withheld];

/// One event of three draws: which of 100 shares, and two numbers in 0..1. A union of strategies says the same and takes
/// ten times as long.
fn happens((share, a, b): (u8, f64, f64)) -> Happens {
    use Happens::*;
    let who = ["Ann", "Bob", " ann ", ""][(4.0 * a) as usize];
    match share {
        0..60 => Tick(1.9 * a, 0.0),
        60..62 => Tick(20.0 * a, 200.0 * (b - 0.5)),
        62..65 => Turn(6.0 * (a - 0.5)),
        65 => Sp(20.0 + 60.0 * a),
        66 => Marked(0, if a < 0.5 { Quality::Stale } else { Quality::Bad(BadReason::Timeout) }),
        67 => Marked(1, if a < 0.5 { Quality::Stale } else { Quality::Bad(BadReason::Timeout) }),
        68 => Mode(0.0),
        69 => Old(10.0 * a),
        70 => Evidence(b < 0.9, 9.0 * a, -2000.0 * (1.0 - b)),
        71 => Evidence(b < 0.9, 1.5 + a, if b < 0.5 { 0.0 } else { f64::NAN }),
        72 => Missed((4.0 * a) as u64),
        73 => Audited(false),
        74 => Writes(Err(FAULTS[(4.0 * a) as usize])),
        75..79 => Grant(who, 120.0 * b - 1.0),
        79..83 => Approve(who),
        83 => Withdraw,
        84..87 => Reset,
        87 => Stop,
        88..91 => Enable,
        _ => Heal,
    }
}

fn play(world: &mut World, events: Vec<Happens>) {
    for event in events {
        let time = world.time;
        match event {
            Happens::Tick(dt, jump) => world.tick(dt, jump),
            Happens::Turn(turn) => world.turn = turn,
            Happens::Sp(sp) => world.sp = sp,
            Happens::Marked(at, quality) => world.quality[at] = quality,
            Happens::Mode(mode) => world.mode = mode,
            Happens::Old(old_s) => world.old_s = old_s,
            Happens::Evidence(sticky, f, at) => {
                let at = time.wall + at;
                world.evidence = Evidence { sticky, f, f_ci95: [f - 0.1, f + 0.1], at, data_end: at };
            }
            Happens::Missed(more) => world.missed += more,
            Happens::Audited(audited) => world.audited = audited,
            Happens::Writes(outcome) => world.outcome = outcome,
            Happens::Grant(by, duration_s) => world.grant(by, duration_s),
            Happens::Approve(by) => world.approve(by),
            Happens::Withdraw => drop(world.gate.withdraw("Ann", time)),
            Happens::Reset => drop(world.gate.reset("Ann", time)),
            Happens::Stop => world.gate.stop(time),
            Happens::Enable => world.gate.enable(time),
            Happens::Heal => {
                (world.quality, world.mode, world.old_s) = ([Quality::Good; 2], 1.0, 0.0);
                (world.audited, world.outcome) = (true, Ok(()));
                let at = time.wall;
                world.evidence = Evidence { sticky: true, f: 2.0, f_ci95: [1.9, 2.1], at, data_end: at };
            }
        }
        world.gate.take_news();
    }
}

/// The property that write-back stands on, over 12,000 random sequences of up to 80 events; half of them begin open.
#[test]
fn whatever_happens_nothing_is_written_that_must_not_be() {
    let sequences =
        Config { cases: 12_000, failure_persistence: None, max_shrink_iters: 5_000, ..Config::default() };
    let (active, tripped, orders) = (Cell::new(0), Cell::new(0), Cell::new(0));
    let draws = prop::collection::vec((0u8..100, 0.0..1.0f64, 0.0..1.0f64), 1..80);
    let strategy = (any::<bool>(), draws.prop_map(|all| all.into_iter().map(happens).collect::<Vec<_>>()));
    let run = TestRunner::new(sequences).run(&strategy, |(open, events)| {
        let mut world = if open { World::opened() } else { World::new() };
        play(&mut world, events);
        // And out, whatever it was doing.
        world.gate.stop(world.time);
        // The limit, and the step that finds it passed.
        let took = world.until_out();
        assert!(took <= LIMITS.withdraw_limit_s + 1.0, "{took} s to leave");
        active.set(active.get() + usize::from(world.dcs.seen[State::Active as usize]));
        tripped.set(tripped.get() + usize::from(world.dcs.seen[State::Tripped as usize]));
        orders.set(orders.get() + world.dcs.orders);
        Ok(())
    });
    run.expect("holds for every sequence");
    println!("12000 sequences: {} active, {} tripped, {} orders", active.get(), tripped.get(), orders.get());
    // A property over gates that never open would hold of anything.
    assert!(active.get() > 5_000 && tripped.get() > 1_500 && orders.get() > 50_000);
}

#[test]
fn the_way_in_and_out_by_hand() {
    let mut world = World::new();
    (0..8).for_each(|_| world.tick(1.0, 0.0));
    assert_eq!(world.gate.status().denials, [Denial::NotGranted]);
    // The reinforcement is computed in shadow and nothing is in force.
    assert_eq!((world.gate.status().term, world.gate.in_force()), (2.0, 0.0));
    world.grant("Ann", 60.0);
    assert_eq!(world.gate.approve("ANN", world.time), Err(Refusal::SamePerson));
    world.tick(1.0, 0.0);
    assert_eq!(world.gate.status().denials, [Denial::NotApproved]);
    world.approve("Bob");
    let mut terms = Vec::new();
    for _ in 0..5 {
        world.tick(1.0, 0.0);
        terms.push(world.dcs.held);
    }
    // Opened with 0; f = 2 at 2 %/s from the second OP it sees.
    assert_eq!(terms, [0.0, 0.0, 2.0, 2.0, 2.0]);
    world.gate.withdraw("Cid", world.time).expect("active");
    // 2 % at 1 %/s in steps of 0.5 s.
    assert_eq!(world.until_out(), 2.0);
    assert_eq!((world.gate.state(), world.dcs.held), (State::Shadow, 0.0));
    assert_eq!(world.gate.status().grant, None, "a grant is good once");
}

#[test]
fn every_fault_trips_and_only_an_operator_resets() {
    type Fault = (Denial, fn(&mut World));
    let faults: [Fault; 17] = [
        (Denial::OpBad, |w| w.quality[0] = Quality::Bad(BadReason::LinkDown)),
        (Denial::PvBad, |w| w.quality[1] = Quality::Stale),
        (Denial::OpBad, |w| w.old_s = 3.5),
        (Denial::NotAutomatic, |w| w.mode = 0.0),
        (Denial::OpNearLimit, |w| w.op = 97.0),
        (Denial::PollOverrun, |w| w.missed += 2),
        (Denial::AuditFailed, |w| w.audited = false),
        (Denial::ClockJump, |w| w.time.wall += 5.0),
        (Denial::ClockJump, |w| w.time.wall -= 5.0),
        (Denial::Late, |w| w.tick(2.5, 0.0)),
        (Denial::FOutsideInterval, |w| {
            w.evidence = Evidence { f: 2.3, f_ci95: [2.25, 2.35], at: w.time.wall, ..w.evidence };
        }),
        (Denial::WriteFailed, |w| w.outcome = Err(WriteFault::Failed)),
        (Denial::ReadBack, |w| w.outcome = Err(WriteFault::ReadBack)),
        (Denial::AuditFailed, |w| w.outcome = Err(WriteFault::Audit)),
        (Denial::Late, |w| w.outcome = Err(WriteFault::Withheld)),
        (Denial::IseWorse, |w| (w.sp, w.gate.limits.criteria.ise_limit) = (w.sp, 0.0)),
        (Denial::NoImprovement, |_| ()),
    ];
    for (denial, fault) in faults {
        let mut world = World::opened();
        (0..3).for_each(|_| world.tick(0.5, 0.0));
        fault(&mut world);
        if denial == Denial::IseWorse {
            // A trial keeps the criteria it began with: begin one whose limit is 0.
            let before = world.gate.trial.as_ref().expect("active").before();
            world.gate.trial = Some(Trial::new(before, 2.0, world.gate.limits.criteria));
        }
        if denial == Denial::NoImprovement {
            // The simulated error is the same with the term: no gain of 1.1 within 50 s.
            while world.gate.state() == State::Active {
                world.tick(1.0, 0.0);
            }
        }
        world.tick(0.5, 0.0);
        world.until_out();
        let status = world.gate.status();
        assert_eq!((status.state, status.tripped_by), (State::Tripped, Some(denial)));
        let refused = world.gate.grant("Ann", 10.0, world.time);
        assert!(matches!(refused, Err(Refusal::NotIn { is: State::Tripped, .. })));
        world.gate.enable(world.time);
        assert_eq!(world.gate.state(), State::Tripped);
        world.gate.reset("Ann", world.time).expect("tripped");
        assert_eq!((world.gate.state(), world.gate.status().tripped_by), (State::Shadow, None));
    }
}

#[test]
fn a_device_that_takes_nothing_gets_no_heartbeat_after_the_limit() {
    let mut world = World::opened();
    (0..4).for_each(|_| world.tick(1.0, 0.0));
    world.outcome = Err(WriteFault::Failed);
    let took = world.until_out();
    assert!((LIMITS.withdraw_limit_s..LIMITS.withdraw_limit_s + 1.1).contains(&took), "{took}");
    assert_eq!(world.gate.state(), State::Tripped);
}

#[test]
fn a_ramp_that_takes_too_long_is_no_write_that_failed() {
    let mut world = World::opened();
    (0..3).for_each(|_| world.tick(1.0, 0.0));
    assert_eq!(world.dcs.held, 2.0);
    // 2 % at 0.1 %/s take 20 s, of which 8 s are allowed.
    world.gate.limits.withdraw_rate = 0.1;
    world.gate.withdraw("Cid", world.time).expect("active");
    world.until_out();
    let status = world.gate.status();
    assert_eq!((status.state, status.tripped_by), (State::Tripped, Some(Denial::NotAtZero)));
}

#[test]
fn a_grant_ends_by_either_clock() {
    // Slewed within the tolerance, so that neither is a jump: a wall that stands still, and one that runs at double speed.
    for (slew, longest) in [(-0.9, 21), (0.9, 11)] {
        let mut world = World::opened_for(20.0);
        let mut ticks = 3;
        while world.gate.state() == State::Active {
            world.tick(1.0, slew);
            ticks += 1;
        }
        assert!(ticks <= longest + 3, "{ticks} s of 20 s");
        world.until_out();
        // Asked for by nobody, a fault of nobody: back to shadow.
        assert_eq!(world.gate.state(), State::Shadow);
    }
}

#[test]
fn polls_missed_within_any_minute_are_counted_together() {
    let limits = Limits { max_missed_polls: 5, ..LIMITS };
    let mut polls = Polls::default();
    let mut at = |mono: f64, missed_polls: u64| {
        let inputs = Inputs { missed_polls, ..Inputs::default() };
        polls.missed(&inputs, Time { mono, wall: mono }, &limits)
    };
    // What was missed before the first look is nobody's; ten within 2 s, on both sides of the first minute's end.
    assert_eq!([at(0.0, 3), at(59.0, 8), at(60.0, 8)], [None; 3]);
    assert_eq!(at(61.0, 13), Some(Denial::PollOverrun));
    assert_eq!(
        [at(118.9, 13), at(119.1, 13)],
        [Some(Denial::PollOverrun), None],
        "a minute after the first five"
    );
    // One every 12 s is as many as are allowed.
    assert!((0..20u32).all(|k| at(200.0 + 12.0 * f64::from(k), 14 + u64::from(k)).is_none()));
}

#[test]
fn every_denial_has_a_code_of_its_own() {
    let codes: std::collections::BTreeSet<_> = Denial::ALL.iter().map(|denial| denial.code()).collect();
    assert_eq!(codes.len(), Denial::ALL.len());
}
