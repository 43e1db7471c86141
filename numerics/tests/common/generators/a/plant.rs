//! Loops with an undeclared effect of known kind and size: an own small simulator, because effects such as a gain or a dead
//! time that changes are not in the project's. Everything about a loop is drawn from wide ranges by its seed.

use super::valve::{self, Valve};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use std::collections::VecDeque;
use std::f64::consts::TAU;
use stictiond_numerics::residual::Kind;
use stictiond_numerics::signal::{Record, Sample};

/// Samples before the record.
const WARM: usize = 300;
/// Loop classes.
pub const LOOPS: [&str; 4] = ["flow", "level", "pressure", "temperature"];
/// Valves and the range of S (% OP).
pub const VALVES: [(&str, f64, f64); 3] = [("none", 0.0, 0.0), ("weak", 0.7, 1.5), ("strong", 3.0, 7.0)];
/// Sizes of an effect.
pub const SIZES: [&str; 3] = ["small", "medium", "large"];

/// What is wrong with a loop beside its friction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Undeclared {
    Nothing,
    Listed(Kind),
    /// Outside the list: bursts of noise at the process input.
    Bursts,
    /// Outside the list: the sensor has a hysteresis.
    SensorBacklash,
}

/// One case.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    pub class: usize,
    pub valve: usize,
    pub undeclared: Undeclared,
    /// 0 small, 1 medium, 2 large.
    pub size: usize,
    pub seed: u64,
    /// Irrelevant tags.
    pub tags: usize,
}

impl Case {
    fn number(&self) -> u64 {
        let kind = match self.undeclared {
            Undeclared::Nothing => 90,
            Undeclared::Bursts => 91,
            Undeclared::SensorBacklash => 92,
            Undeclared::Listed(kind) => Kind::ALL.iter().position(|k| *k == kind).unwrap_or(99) as u64,
        };
        ((self.seed * 100 + kind) * 10 + self.class as u64) * 10 + self.valve as u64
    }
    fn is(&self, kind: Kind) -> bool {
        self.undeclared == Undeclared::Listed(kind)
    }
    fn pick<T: Copy>(&self, values: [T; 3]) -> T {
        values[self.size]
    }
}

/// All cases of one effect and size: every class and valve it has a meaning on, and `seeds`.
pub fn cases(undeclared: Undeclared, size: usize, seeds: std::ops::Range<u64>) -> Vec<Case> {
    // Friction that differs or drifts needs friction.
    let needs = matches!(undeclared, Undeclared::Listed(Kind::AsymmetricFriction | Kind::FrictionDrift));
    let mut out = Vec::new();
    for seed in seeds {
        for class in 0..LOOPS.len() {
            for valve in usize::from(needs)..VALVES.len() {
                out.push(Case { class, valve, undeclared, size, seed, tags: 3 });
            }
        }
    }
    out
}

/// Records with nothing hidden: every class and valve, up to 50 tags that have nothing to do with the loop.
pub fn clean(count: u64, first_seed: u64) -> Vec<Case> {
    let case = |i: u64| Case {
        class: i as usize % 4,
        valve: i as usize / 4 % 3,
        undeclared: Undeclared::Nothing,
        size: 1,
        seed: first_seed + i,
        tags: [0, 5, 20, 50][i as usize / 12 % 4],
    };
    (0..count).map(case).collect()
}

/// What the seed draws.
struct Draw(Pcg64Mcg);

impl Draw {
    fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }
    fn log_within(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.0.random::<f64>())
    }
    fn chance(&mut self, share: f64) -> bool {
        self.0.random::<f64>() < share
    }
    fn sign(&mut self) -> f64 {
        if self.chance(0.5) { 1.0 } else { -1.0 }
    }
    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }
}

/// A process and its PI controller; times in samples.
struct Loop {
    gain: f64,
    tau: f64,
    second: f64,
    integrating: bool,
    delay: usize,
    ts: f64,
    kc: f64,
    ti: f64,
}

impl Loop {
    fn draw(class: usize, d: &mut Draw) -> Self {
        // Gain, time constants, delay, sample period, closed-loop time constant.
        let (gain, tau, second, delay, ts) = match class {
            0 => (d.within(0.7, 1.8), d.log_within(1.5, 6.0), 0.0, d.within(1.0, 3.0), 1.0),
            1 => (d.log_within(0.006, 0.03), 0.0, 0.0, d.within(1.0, 3.0), 10.0),
            2 => (d.within(0.8, 2.0), d.log_within(4.0, 15.0), d.within(0.1, 0.25), d.within(1.0, 4.0), 2.0),
            _ => {
                (d.within(0.6, 1.6), d.log_within(10.0, 40.0), d.within(0.1, 0.25), d.within(2.0, 7.0), 10.0)
            }
        };
        let (second, delay) = (second * tau, delay as usize);
        let theta = delay as f64 + 0.5 + 0.5 * second;
        let integrating = class == 1;
        let closed = match class {
            0 => d.within(1.0, 3.0) * (theta + 0.4 * tau),
            1 => d.within(8.0, 25.0),
            _ => d.within(1.0, 3.0) * theta,
        };
        // Skogestad's rules.
        let kc = if integrating { 1.0 } else { tau } / (gain * (closed + theta));
        let ti = if integrating { 4.0 * (closed + theta) } else { tau.min(4.0 * (closed + theta)) };
        Self { gain, tau, second, integrating, delay, ts, kc, ti }
    }
}

/// What a simulation leaves, warm-up included.
#[derive(Default)]
struct Traces {
    op: Vec<f64>,
    pv: Vec<f64>,
    sp: Vec<f64>,
    tag: Vec<f64>,
    stem: Vec<f64>,
}

/// What is true of a case.
#[derive(Clone, Copy, Debug)]
pub struct Truth {
    /// S/2 (% OP).
    pub f: f64,
    /// Whether S and J differ.
    pub slips: bool,
    /// What a load at the valve is worth (% OP): the size of a step, the amplitude of a wave, the rise of a ramp over the record, the
    /// standard deviation of a tag.
    pub load: Option<f64>,
}

/// A record of the case, and what is true of it.
pub fn record(case: &Case) -> (Record, Truth) {
    drawn(case, None)
}

/// A record of the same loop without what is undeclared, and with this share of its friction.
pub fn before(case: &Case, friction: f64) -> Record {
    drawn(case, Some(friction)).0
}

/// `before`: the share of friction where the loop is as it was, without what is undeclared.
fn drawn(case: &Case, before: Option<f64>) -> (Record, Truth) {
    let is = |kind: Kind| before.is_none() && case.is(kind);
    // A level to clip at is taken from the stem of the same loop unclipped: OP of a valve that sticks goes where its stem never is.
    let clip = is(Kind::ValveSaturation).then(|| {
        let low = case.number().is_multiple_of(3);
        let mut stem = run(case, None, None).0.stem.split_off(WARM);
        stem.sort_by(f64::total_cmp);
        if low {
            stem.reverse();
        }
        let last = (stem.len() as f64 * case.pick([0.93, 0.85, 0.75])) as usize;
        // Where it rests for long, the next level inside: beyond it the stem is for that share of the time at least.
        let at = stem[..last].iter().rev().find(|level| **level != stem[last]).copied();
        (at.unwrap_or(stem[last]), low)
    });
    let (mut t, truth, ts, mut d) = run(case, clip, before);
    let mut total = t.op.len();
    if is(Kind::ClockSkew) && case.seed % 3 == 1 {
        t.pv = parting(&t.pv, case);
        total = t.pv.len();
    } else if is(Kind::ClockSkew) {
        let by = case.pick([3, 5, 9]);
        t.pv = if case.seed.is_multiple_of(2) {
            (0..total).map(|k| t.pv[k.saturating_sub(by)]).collect()
        } else {
            // The record ends where its last PV does.
            total -= by;
            t.pv.split_off(by)
        };
    }
    let series = |v: &[f64]| -> Vec<Sample> {
        v[WARM..total].iter().enumerate().map(|(k, x)| Sample::good(k as f64 * ts, *x)).collect()
    };
    let mut record = Record {
        op: series(&t.op),
        pv: series(&t.pv),
        sp: Some(series(&t.sp)),
        op_span: Some(100.0),
        ..Record::default()
    };
    if case.is(Kind::MeasuredDisturbance) {
        record.tags.push(("upstream".into(), series(&t.tag)));
    }
    for i in 0..case.tags {
        record.tags.push((format!("tag {i}"), series(&irrelevant(i, &t.pv, &mut d))));
    }
    (record, truth)
}

/// White, coloured, wandering, periodic and stepping tags in turn, and some that follow PV.
fn irrelevant(i: usize, pv: &[f64], d: &mut Draw) -> Vec<f64> {
    let w = d.log_within(0.01, 0.6);
    let keep = [0.0, 0.9, 1.0, 0.0, 0.97, 0.0, 0.0][i % 7];
    let (mut state, mut level, mut follower) = (0.0, 0.0, pv[0]);
    (0..pv.len())
        .map(|k| {
            state = keep * state + d.normal();
            if d.chance(0.01) {
                level += d.normal();
            }
            follower += 0.1 * (pv[k] - follower);
            match i % 7 {
                3 => (w * k as f64).sin() + 0.1 * state,
                5 => level + 0.05 * state,
                6 => follower + 0.3 * state,
                _ => state,
            }
        })
        .collect()
}

/// PV stamped by a clock that parts from OP's, one way or the other; the record ends where its last PV does.
fn parting(pv: &[f64], case: &Case) -> Vec<f64> {
    let by = case.pick([2.0, 4.0, 8.0]) * if case.seed.is_multiple_of(2) { 1.0 } else { -1.0 };
    let at = |k: usize| {
        let since = k.saturating_sub(WARM) as f64 / (pv.len() - WARM) as f64;
        let origin = k as f64 - by * since;
        let (before, share) = (origin as usize, origin.fract());
        Some(pv[before] + share * (pv.get(before + 1)? - pv[before]))
    };
    (0..pv.len()).map_while(at).collect()
}

/// Whether PV stands still at sample `k`: once from `at` on, or, for every third seed, eight times.
fn frozen(case: &Case, at: usize, n: usize, k: usize) -> bool {
    let once = case.seed % 3 != 2;
    let (runs, length) = if once { (1, case.pick([20, 50, 120])) } else { (8, case.pick([10, 20, 40])) };
    (0..runs).map(|run| at + run * n / 20).any(|from| (from..from + length).contains(&k))
}

fn run(case: &Case, clip: Option<(f64, bool)>, before: Option<f64>) -> (Traces, Truth, f64, Draw) {
    let mut d = Draw(Pcg64Mcg::seed_from_u64(case.number()));
    let mut p = Loop::draw(case.class, &mut d);
    if case.is(Kind::DeadTimeChange) || case.is(Kind::GainChange) {
        // Tuned with the reserve that such a loop needs to stay stable.
        p.kc *= 0.6;
    }
    let n = d.within(1200.0, 2000.0) as usize;
    let share = |k: usize| (k as f64 - WARM as f64) / n as f64;
    // The valve.
    let (_, low, high) = VALVES[case.valve];
    let mut s = if high > 0.0 { d.log_within(low, high) } else { 0.0 };
    let mut j = if d.chance(0.5) { s } else { s * d.within(0.1, 0.6) };
    let mut kind = match d.within(0.0, 10.0) as usize {
        0..5 => valve::Kind::Choudhury,
        5..7 => valve::Kind::He,
        _ => valve::Kind::OneParameter,
    };
    if case.is(Kind::SlipJump) {
        s = if s == 0.0 { d.within(2.0, 4.0) } else { s };
        j = s * case.pick([0.6, 0.3, 0.0]);
        kind = valve::Kind::Choudhury;
    }
    if kind == valve::Kind::OneParameter {
        j = s;
    }
    if let Some(friction) = before {
        j = if case.is(Kind::SlipJump) { s } else { j };
        (s, j) = (friction * s, friction * j);
    }
    let mut valve = Valve::new(kind, 50.0, s, j);
    // Loads, noise, set point.
    let noise = d.log_within(0.02, 0.08);
    let (load_sd, keep) = (d.within(0.15, 0.4), (-1.0 / d.log_within(8.0, 60.0)).exp());
    let sp_every = d.within(80.0, 200.0) as usize;
    // A level is not stepped as far as a flow.
    let sp_size = d.within(3.0, 6.0) * if p.integrating { 0.4 } else { 1.0 };
    // A gain, a delay or a curve that nothing moves over leaves no trace.
    let needs_motion =
        [Kind::GainChange, Kind::DeadTimeChange, Kind::StaticNonlinearity].iter().any(|k| case.is(*k));
    let sp_moves = needs_motion || !d.chance(0.12);
    // The effect.
    let at = WARM + (n as f64 * d.within(0.15, 0.6)) as usize;
    let vary = d.within(0.85, 1.2);
    let (sign, alike) = (d.sign(), d.chance(0.5));
    let early = d.chance(0.6);
    let period = [37.0, 160.0, 90.0, 210.0][case.class] * d.log_within(0.6, 1.5);
    let (phase, from) = (TAU * d.within(0.0, 1.0), if early { 0.0 } else { d.within(0.0, 0.35) });
    let (tag_keep, tag_lag) = (d.within(0.8, 0.97), d.within(1.0, 8.0) as usize);
    let rate = d.within(0.005, 0.02);
    let at_output = !p.integrating && alike;
    let worth = vary
        * match case.undeclared {
            Undeclared::Listed(Kind::OscillatingLoad) => case.pick([1.0, 2.0, 4.0]),
            Undeclared::Listed(Kind::LoadStep) => sign * case.pick([2.0, 4.0, 8.0]),
            Undeclared::Listed(Kind::Drift) => sign * case.pick([4.0, 8.0, 16.0]),
            Undeclared::Listed(Kind::MeasuredDisturbance) => sign * case.pick([0.6, 1.2, 2.4]),
            _ => 0.0,
        };
    let mut t = Traces::default();
    let (mut x1, mut x2, mut op, mut last_error, mut load, mut tag, mut backlash) =
        (0.0, 0.0, 50.0, 0.0, 0.0, 0.0, 0.0);
    let more_delay = case.pick([2, if case.class == 0 { 3 } else { 4 }, if case.class == 0 { 5 } else { 7 }]);
    let mut line = VecDeque::from(vec![0.0; p.delay + 24]);
    let (mut sp, mut shown) = (50.0, 50.0);
    // All is drawn by now as the case has it.
    let case = &Case { undeclared: before.map_or(case.undeclared, |_| Undeclared::Nothing), ..*case };
    for k in 0..n + WARM {
        if sp_moves && k % sp_every == sp_every - 20 {
            sp = 50.0 + sp_size * d.within(-1.0, 1.0);
        }
        load = keep * load + load_sd * (1.0 - keep * keep).sqrt() * d.normal();
        tag = tag_keep * tag + (1.0 - tag_keep * tag_keep).sqrt() * d.normal();
        let (mut output, mut input) = (0.0, load);
        match case.undeclared {
            Undeclared::Listed(Kind::OscillatingLoad) => {
                let wave = worth * (TAU * k as f64 / period + phase).sin();
                if at_output { output = 0.6 * wave } else { input += wave }
            }
            Undeclared::Listed(Kind::LoadStep) if k >= at => input += worth,
            Undeclared::Listed(Kind::Drift) if share(k) > from => {
                // A level hides a drifting sensor behind its integrator: there the load drifts.
                let ramp = worth * (share(k) - from);
                if at_output { output = 0.75 * ramp } else { input += ramp }
            }
            Undeclared::Listed(Kind::MeasuredDisturbance) => {
                let past = t.tag.get(k.wrapping_sub(tag_lag)).copied().unwrap_or(0.0);
                input += worth * past;
            }
            Undeclared::Bursts if k % 300 > 230 => input += 3.0 * d.normal(),
            _ => {}
        }
        t.tag.push(tag);
        // The sensor.
        let mut pv = 50.0 + x1 + output + noise * d.normal();
        if case.undeclared == Undeclared::SensorBacklash {
            backlash = f64::max(f64::min(backlash, pv + 0.8), pv - 0.8);
            pv = backlash;
        }
        if case.is(Kind::Outliers) && d.chance(rate) {
            pv += d.sign() * vary * case.pick([1.5, 3.0, 6.0]);
        }
        if case.is(Kind::QuantisedPv) {
            let q = noise * vary * case.pick([2.5, 5.0, 10.0]);
            pv = (pv / q).round() * q;
        }
        if !(case.is(Kind::FrozenPv) && frozen(case, at, n, k)) {
            shown = pv;
        }
        // The controller sees the frozen value, or only the record is frozen.
        let seen = if alike { shown } else { pv };
        let error = sp - seen;
        op += p.kc * (error - last_error + error / p.ti);
        op = op.clamp(0.0, 100.0);
        last_error = error;
        // The valve.
        let (mut bands, mut jump) = ([s, s], j);
        if case.is(Kind::AsymmetricFriction) {
            let skew = sign * case.pick([0.25, 0.45, 0.7]);
            bands = [s * (1.0 + skew), s * (1.0 - skew)];
        }
        if case.is(Kind::FrictionDrift) {
            let grown = 1.0 + sign * case.pick([0.3, 0.55, 0.85]) * (2.0 * share(k).clamp(0.0, 1.0) - 1.0);
            bands = [s * grown, s * grown];
            jump = j * grown;
        }
        let mut mv = valve.step(op, bands, jump);
        if let Some((level, low)) = clip {
            mv = if low { mv.max(level) } else { mv.min(level) };
        }
        t.stem.push(mv);
        let mut flow = mv - 50.0;
        if case.is(Kind::StaticNonlinearity) {
            let bend = sign * vary * case.pick([0.04, 0.08, 0.16]);
            // An equal-percentage valve, or a gain that differs to both sides of the working point.
            flow = if alike {
                ((bend * flow).exp() - 1.0) / bend
            } else {
                let (width, more) = (8.0, (8.0 * bend).clamp(-0.85, 0.85));
                flow + more * width * ((1.0 + (flow / width).powi(2)).sqrt() - 1.0)
            };
        }
        if case.is(Kind::GainChange) && k >= at {
            let factor = case.pick([1.35, 1.7, 2.3]);
            flow *= if sign > 0.0 { factor } else { 1.0 / factor };
        }
        let longer = case.is(Kind::DeadTimeChange) && (k >= at) == (sign > 0.0 || early);
        line.push_front(flow);
        let drive = line[p.delay + if longer { more_delay } else { 0 }] + input;
        line.pop_back();
        // The process.
        if p.integrating {
            x1 += p.gain * drive;
        } else if p.second > 0.0 {
            x2 += (p.gain * drive - x2) * (1.0 - (-1.0 / p.tau).exp());
            x1 += (x2 - x1) * (1.0 - (-1.0 / p.second).exp());
        } else {
            x1 += (p.gain * drive - x1) * (1.0 - (-1.0 / p.tau).exp());
        }
        t.op.push(op);
        t.pv.push(shown);
        t.sp.push(sp);
    }
    let may_be_at_output = case.is(Kind::OscillatingLoad) || case.is(Kind::Drift);
    let load = (worth != 0.0 && !(may_be_at_output && at_output)).then_some(worth);
    (t, Truth { f: 0.5 * s, slips: j < s, load }, p.ts, d)
}
