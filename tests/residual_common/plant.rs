//! Loops with an undeclared effect of known kind and size: an own small simulator, because effects such as a gain or a dead
//! time that changes are not in the project's.

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use std::f64::consts::TAU;
use stictiond::residual::Kind;
use stictiond::signal::{Record, Sample};

/// Samples recorded, and before them.
pub const N: usize = 1500;
const WARM: usize = 300;

/// Loop classes.
pub const LOOPS: [&str; 4] = ["flow", "level", "pressure", "temperature"];
/// Valves: S and J (% OP).
pub const VALVES: [(&str, f64, f64); 3] = [("none", 0.0, 0.0), ("weak", 1.0, 0.3), ("strong", 5.0, 1.0)];

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

struct Process {
    gain: f64,
    tau: f64,
    second: f64,
    integrating: bool,
    delay: usize,
    ts: f64,
    kc: f64,
    ti: f64,
}

fn process(class: usize, rng: &mut Pcg64Mcg) -> Process {
    let mut vary = |x: f64| x * (1.0 + 0.25 * (rng.random::<f64>() - 0.5));
    match class {
        0 => Process {
            gain: vary(1.2),
            tau: vary(3.0),
            second: 0.0,
            integrating: false,
            delay: 1,
            ts: 1.0,
            kc: 0.45,
            ti: 4.0,
        },
        1 => Process {
            gain: vary(0.02),
            tau: 0.0,
            second: 0.0,
            integrating: true,
            delay: 1,
            ts: 10.0,
            kc: 7.0,
            ti: 50.0,
        },
        2 => Process {
            gain: vary(1.5),
            tau: vary(12.0),
            second: vary(2.5),
            integrating: false,
            delay: 2,
            ts: 2.0,
            kc: 1.0,
            ti: 13.0,
        },
        _ => Process {
            gain: vary(1.0),
            tau: vary(25.0),
            second: vary(5.0),
            integrating: false,
            delay: 4,
            ts: 10.0,
            kc: 1.6,
            ti: 28.0,
        },
    }
}

fn normal(rng: &mut Pcg64Mcg) -> f64 {
    StandardNormal.sample(rng)
}

/// Sticky stem with its own S for each direction.
struct Valve {
    mv: f64,
    held: f64,
    dir: f64,
    moving: bool,
    op: f64,
}

impl Valve {
    fn step(&mut self, op: f64, s: [f64; 2], j: f64) -> f64 {
        let mean = 0.5 * (s[0] + s[1]);
        if mean <= 0.0 {
            self.mv = op;
            return op;
        }
        if self.moving && (op - self.op) * self.dir <= 0.005 {
            self.moving = false;
            self.held = self.op;
        }
        if !self.moving {
            let ahead = (op - self.held) * self.dir;
            let band = if self.dir > 0.0 { s[0] } else { s[1] };
            if -ahead > band {
                self.dir = -self.dir;
                self.moving = true;
            } else if ahead > j {
                self.moving = true;
            }
        }
        if self.moving {
            self.mv = op - self.dir * 0.5 * (mean - j);
        }
        self.op = op;
        self.mv
    }
}

/// A record of the case, and the true f (% OP).
pub fn record(case: &Case) -> (Record, f64) {
    // A level to clip at is taken from the same loop unclipped.
    let clip = if case.undeclared == Undeclared::Listed(Kind::ValveSaturation) {
        let (plain, _) = run(&Case { undeclared: Undeclared::Nothing, ..*case }, None);
        let mut op: Vec<f64> = plain.op.iter().map(|s| s.value).collect();
        op.sort_by(f64::total_cmp);
        Some(op[(op.len() as f64 * [0.93, 0.85, 0.75][case.size]) as usize])
    } else {
        None
    };
    run(case, clip)
}

fn run(case: &Case, clip: Option<f64>) -> (Record, f64) {
    let listed = |kind: Kind| case.undeclared == Undeclared::Listed(kind);
    let pick = |values: [f64; 3]| values[case.size];
    let mut rng = Pcg64Mcg::seed_from_u64(case.seed * 1000 + (case.class * 10 + case.valve) as u64);
    let p = process(case.class, &mut rng);
    let (_, mut s, mut j) = VALVES[case.valve];
    if listed(Kind::SlipJump) {
        s = if s == 0.0 { 3.0 } else { s };
        j = s * pick([0.6, 0.3, 0.0]);
    } else if s > 0.0 && !listed(Kind::MeasuredDisturbance) && case.seed.is_multiple_of(2) {
        j = s;
    }
    let total = N + WARM;
    let at = WARM + (N as f64 * (0.25 + 0.3 * rng.random::<f64>())) as usize;
    let noise = [0.03, 0.05, 0.03, 0.03][case.class] * if case.valve == 2 { 1.5 } else { 1.0 };
    let period = [37.0, 160.0, 90.0, 210.0][case.class] * (0.7 + 0.6 * rng.random::<f64>());
    let phase = TAU * rng.random::<f64>();
    let (keep, load_sd) = ((-1.0 / [12.0f64, 30.0, 30.0, 50.0][case.class]).exp(), 0.25);
    let (mut valve, mut x1, mut x2) =
        (Valve { mv: 50.0, held: 50.0 + 0.5 * (s - j), dir: 1.0, moving: false, op: 50.0 }, 0.0, 0.0);
    let (mut op, mut last_error, mut load, mut tag, mut backlash) = (50.0, 0.0, 0.0, 0.0, 0.0);
    let mut line = std::collections::VecDeque::from(vec![0.0; p.delay + 24]);
    let mut sp: f64 = 50.0;
    let (mut ops, mut pvs, mut sps, mut tags, mut mvs) = (vec![], vec![], vec![], vec![], vec![]);
    let mut shown = 50.0;
    let mut sp_rng = Pcg64Mcg::seed_from_u64(case.seed + 77);
    for k in 0..total {
        if k % 130 == 100 {
            sp = 50.0 + 10.0 * (sp_rng.random::<f64>() - 0.5);
        }
        load = keep * load + load_sd * (1.0 - keep * keep).sqrt() * normal(&mut rng);
        let tag_keep: f64 = 0.9;
        tag = tag_keep * tag + (1.0 - tag_keep * tag_keep).sqrt() * normal(&mut rng);
        let share = (k as f64 - WARM as f64) / N as f64;
        let mut output = 0.0;
        let mut input = load;
        match case.undeclared {
            Undeclared::Listed(Kind::OscillatingLoad) => {
                input += pick([1.0, 2.0, 4.0]) * (TAU * k as f64 / period + phase).sin();
            }
            Undeclared::Listed(Kind::LoadStep) if k >= at => input += pick([2.0, 4.0, 8.0]),
            Undeclared::Listed(Kind::Drift) if share > 0.0 => {
                // A level hides a drifting sensor behind its integrator: there the load drifts.
                if p.integrating {
                    input += pick([4.0, 8.0, 16.0]) * share
                } else {
                    output = pick([3.0, 6.0, 12.0]) * share
                }
            }
            Undeclared::Bursts if k % 300 > 230 => input += 3.0 * normal(&mut rng),
            _ => {}
        }
        if listed(Kind::MeasuredDisturbance) {
            input += pick([0.6, 1.2, 2.4]) * tags.get(k.wrapping_sub(3)).copied().unwrap_or(0.0);
        }
        tags.push(tag);
        // The sensor.
        let mut pv = 50.0 + x1 + output + noise * normal(&mut rng);
        if case.undeclared == Undeclared::SensorBacklash {
            backlash = f64::max(f64::min(backlash, pv + 0.8), pv - 0.8);
            pv = backlash;
        }
        if listed(Kind::Outliers) && rng.random::<f64>() < 0.01 {
            pv += pick([1.5, 3.0, 6.0]) * if rng.random::<bool>() { 1.0 } else { -1.0 };
        }
        if listed(Kind::QuantisedPv) {
            let q = noise * pick([2.5, 5.0, 10.0]);
            pv = (pv / q).round() * q;
        }
        let frozen = listed(Kind::FrozenPv) && k >= at && k < at + pick([20.0, 50.0, 120.0]) as usize;
        if !frozen {
            shown = pv;
        }
        let pv = shown;
        // The controller.
        let error = sp - pv;
        op += p.kc * (error - last_error + error / p.ti);
        op = op.clamp(0.0, 100.0);
        last_error = error;
        // The valve.
        let mut bands = [s, s];
        if listed(Kind::AsymmetricFriction) {
            let skew = pick([0.25, 0.45, 0.7]);
            bands = [s * (1.0 + skew), s * (1.0 - skew)];
        }
        let mut jump = j;
        if listed(Kind::FrictionDrift) {
            let grown = 1.0 + pick([0.3, 0.55, 0.85]) * (2.0 * share.clamp(0.0, 1.0) - 1.0);
            bands = [s * grown, s * grown];
            jump = j * grown;
        }
        let mut mv = valve.step(op, bands, jump);
        if let Some(level) = clip {
            mv = mv.min(level);
        }
        mvs.push(mv);
        let mut flow = mv - 50.0;
        if listed(Kind::StaticNonlinearity) {
            let bend = pick([0.04, 0.08, 0.16]);
            flow = ((bend * flow).exp() - 1.0) / bend;
        }
        if listed(Kind::GainChange) && k >= at {
            flow *= pick([1.35, 1.7, 2.3]);
        }
        let more = if listed(Kind::DeadTimeChange) && k >= at { pick([2.0, 4.0, 7.0]) as usize } else { 0 };
        line.push_front(flow);
        let drive = line[p.delay + more - 1 + 1] + input;
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
        ops.push(op);
        pvs.push(pv);
        sps.push(sp);
    }
    if listed(Kind::ClockSkew) {
        let by = pick([3.0, 5.0, 9.0]) as usize;
        if case.seed.is_multiple_of(2) {
            pvs = (0..total).map(|k| pvs[k.saturating_sub(by)]).collect();
        } else {
            pvs = (0..total).map(|k| pvs[(k + by).min(total - 1)]).collect();
        }
    }
    let series = |v: &[f64]| -> Vec<Sample> {
        v[WARM..].iter().enumerate().map(|(k, x)| Sample::good(k as f64 * p.ts, *x)).collect()
    };
    let mut record = Record {
        op: series(&ops),
        pv: series(&pvs),
        sp: Some(series(&sps)),
        op_span: Some(100.0),
        ..Record::default()
    };
    if listed(Kind::MeasuredDisturbance) {
        record.tags.push(("upstream".into(), series(&tags)));
    }
    for i in 0..case.tags {
        // White, coloured, wandering and periodic tags in turn.
        let mut state = 0.0;
        let keep = [0.0, 0.9, 1.0, 0.0][i % 4];
        let w = 0.02 + 0.5 * rng.random::<f64>();
        let v: Vec<f64> = (0..total)
            .map(|k| {
                state = keep * state + normal(&mut rng);
                if i % 4 == 3 { (w * k as f64).sin() + 0.1 * state } else { state }
            })
            .collect();
        record.tags.push((format!("tag {i}"), series(&v)));
    }
    (record, 0.5 * s)
}
