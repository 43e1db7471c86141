//! A plant of coupled loops: units of twelve, one feeding the next, the last one's stream recycled to the first.
//!
//! ```text
//! y_i = process_i(flow_i - flow_i0 + load_i + sum_j k_ij lag_ij(flow_j - flow_j0))      sp of a slave = op of its master, scaled
//! ```
//!
//! What is true is known by running the plant again without a source, with the same noise: what a loop does more with it is the
//! source's. Everything in % of span, times in seconds.

use super::controller::{Controller, ControllerSpec};
use super::load::{Load, LoadKind, LoadState};
use super::plant::Run;
use super::process::{Process, ProcessKind, ProcessSpec};
use super::sensor::{Freeze, Sensor, SensorSpec};
use super::valve::{Friction, Valve, ValveSpec};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use std::f64::consts::{PI, TAU};

/// Loops of a unit: name, and the loop of the unit that sets its set point.
const UNIT: [(&str, Option<usize>); 12] = [
    ("FIC01", None),
    ("FIC02", Some(3)),
    ("FIC03", Some(5)),
    ("LIC04", None),
    ("PIC05", None),
    ("TIC06", None),
    ("TIC07", None),
    ("FIC08", None),
    ("LIC09", None),
    ("PIC10", None),
    ("AIC11", None),
    ("FIC12", None),
];
/// Streams inside a unit: from, to.
const STREAMS: [(usize, usize); 14] = [
    (0, 3),
    (0, 4),
    (0, 6),
    (1, 8),
    (1, 9),
    (2, 6),
    (2, 10),
    (4, 9),
    (6, 10),
    (7, 8),
    (7, 5),
    (8, 11),
    (9, 11),
    (11, 4),
];
/// Sample period of controllers and valves (s).
pub const TS_S: f64 = 10.0;
/// Samples before the record begins.
const WARM_UP: usize = 1440;

/// What starts an oscillation, or is wrong with a loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Source {
    /// A valve that sticks.
    Valve,
    /// A controller with nearly the gain at which the loop never comes to rest.
    Tight,
    /// A controller far too slow for its loads.
    Sluggish,
    /// Something outside that swings into the loop's process.
    Load,
    /// A load that walks, faster than the loop can follow.
    RandomLoad,
    /// PV in coarse steps.
    Quantised,
    /// PV with much noise.
    Noisy,
    /// PV that stands still at times.
    Frozen,
    /// A controller at a limit of its output.
    Saturated,
}

/// One loop of the plant.
#[derive(Clone, Debug)]
pub struct UnitLoop {
    /// Its tag.
    pub name: String,
    /// Which loop's output is its set point.
    pub master: Option<usize>,
    /// Period of its record (samples of [`TS_S`]).
    pub every: usize,
    process: ProcessSpec,
    controller: ControllerSpec,
    valve: ValveSpec,
    sensor: SensorSpec,
    load: LoadKind,
    op0: f64,
    pv0: f64,
}

/// Flow of one loop into another's process.
#[derive(Clone, Copy, Debug)]
pub struct Stream {
    /// From which loop.
    pub from: usize,
    /// To which.
    pub to: usize,
    spec: ProcessSpec,
}

/// A plant, and what is wrong with it.
#[derive(Clone, Debug)]
pub struct Plant {
    /// Its loops.
    pub loops: Vec<UnitLoop>,
    /// Its streams.
    pub streams: Vec<Stream>,
    /// What is wrong, and with which loop.
    pub sources: Vec<(Source, usize)>,
    strength: Vec<f64>,
    /// Periods of the loads that swing (s), one a source; only that of a [`Source::Load`] counts.
    pub period_s: Vec<f64>,
    seed: u64,
}

fn uniform(rng: &mut Pcg64Mcg, low: f64, high: f64) -> f64 {
    low + (high - low) * rng.random::<f64>()
}

fn log_uniform(rng: &mut Pcg64Mcg, low: f64, high: f64) -> f64 {
    uniform(rng, low.ln(), high.ln()).exp()
}

fn generator(seed: u64, stream: u128) -> Pcg64Mcg {
    Pcg64Mcg::new((u128::from(seed) << 20 | stream).wrapping_mul(0x9E37_79B9_7F4A_7C15_F39C_C060_5CED_C835))
}

/// A plant of so many units with these sources, each in another loop; a source that is asked of no loop is drawn one.
pub fn plant(seed: u64, units: usize, sources: &[(Source, Option<usize>)]) -> Plant {
    let rng = &mut generator(seed, 1 << 19);
    let mut loops = Vec::new();
    for unit in 0..units {
        for (name, master) in UNIT {
            let mut of = draw_loop(rng, name);
            of.name = format!("{}{}{}", &name[..3], unit + 1, &name[3..]);
            of.master = master.map(|m| m + UNIT.len() * unit);
            loops.push(of);
        }
    }
    // A master waits for its slave.
    let masters: Vec<usize> = loops.iter().filter_map(|of| of.master).collect();
    for master in masters {
        loops[master].controller.gain *= 0.3;
        loops[master].controller.ti_s *= 2.5;
    }
    let streams = draw_streams(rng, units);
    let mut found = Plant { loops, streams, sources: Vec::new(), strength: vec![], period_s: vec![], seed };
    for (source, at) in sources {
        let at = at.unwrap_or_else(|| {
            let free = |i: &usize| {
                let valve = found.loops.iter().all(|other| other.master != Some(*i));
                let taken = found
                    .sources
                    .iter()
                    .any(|s| s.1 == *i || s.1 / UNIT.len() == i / UNIT.len() && units > 2);
                // What starts an oscillation of the plant has to have a stream that carries it.
                let carries = found.streams.iter().any(|stream| stream.from == *i);
                let fast = matches!(&found.loops[*i].name[..1], "F" | "P");
                !taken
                    && match source {
                        Source::Valve => valve && carries && fast,
                        Source::Saturated => valve,
                        Source::Tight | Source::Load => carries,
                        _ => true,
                    }
            };
            let free: Vec<usize> = (0..found.loops.len()).filter(free).collect();
            free[rng.random_range(0..free.len())]
        });
        found.sources.push((*source, at));
        found.strength.push(rng.random::<f64>());
        found.period_s.push(log_uniform(rng, 600.0, 3600.0));
    }
    found
}

fn draw_loop(rng: &mut Pcg64Mcg, name: &str) -> UnitLoop {
    let (kind, dead, gain, lag) = match &name[..1] {
        "F" => {
            let (gain, tau) = (log_uniform(rng, 0.6, 1.8), log_uniform(rng, 20.0, 80.0));
            (ProcessKind::FirstOrder { gain, tau_s: tau }, uniform(rng, 10.0, 40.0), gain, tau)
        }
        "P" => {
            let (gain, tau) = (log_uniform(rng, 0.6, 2.0), log_uniform(rng, 60.0, 240.0));
            (ProcessKind::two_lags(gain, tau, 0.3 * tau), uniform(rng, 10.0, 50.0), gain, tau)
        }
        "L" => {
            let rate = log_uniform(rng, 3e-4, 2e-3);
            (ProcessKind::Integrating { rate }, uniform(rng, 20.0, 80.0), rate, f64::INFINITY)
        }
        _ => {
            let (gain, tau) = (log_uniform(rng, 0.6, 2.0), log_uniform(rng, 200.0, 700.0));
            (ProcessKind::two_lags(gain, tau, 0.3 * tau), uniform(rng, 60.0, 180.0), gain, tau)
        }
    };
    // SIMC, the closed loop 1.2 to 3 times as slow as the effective dead time.
    let effective =
        dead + 0.5 * TS_S + if let ProcessKind::SecondOrder { .. } = kind { 0.15 * lag } else { 0.0 };
    let pace = effective * (1.0 + log_uniform(rng, 1.2, 3.0));
    let controller = if lag.is_infinite() {
        ControllerSpec::pi(1.0 / (gain * pace), 4.0 * pace)
    } else {
        ControllerSpec::pi(lag.max(effective) / (gain * pace), lag.max(effective).min(4.0 * pace))
    };
    UnitLoop {
        name: String::new(),
        master: None,
        every: [6, 6, 6, 3, 12][rng.random_range(0..5)],
        process: ProcessSpec { kind, dead_time_s: dead },
        controller,
        valve: ValveSpec::linear(Friction::Ideal),
        sensor: SensorSpec::noisy(log_uniform(rng, 0.03, 0.2)),
        load: LoadKind::Coloured { sd: log_uniform(rng, 0.2, 1.0), tau_s: log_uniform(rng, 60.0, 3000.0) },
        op0: uniform(rng, 40.0, 60.0),
        pv0: uniform(rng, 40.0, 60.0),
    }
}

fn draw_streams(rng: &mut Pcg64Mcg, units: usize) -> Vec<Stream> {
    let mut streams = Vec::new();
    let mut add = |rng: &mut Pcg64Mcg, from: usize, to: usize, strong: f64, far: f64| {
        let gain = strong * uniform(rng, 0.5, 1.0) * if rng.random::<bool>() { 1.0 } else { -1.0 };
        let kind = ProcessKind::FirstOrder { gain, tau_s: far * log_uniform(rng, 20.0, 120.0) };
        streams.push(Stream {
            from,
            to,
            spec: ProcessSpec { kind, dead_time_s: far * uniform(rng, 10.0, 60.0) },
        });
    };
    for unit in 0..units {
        let base = unit * UNIT.len();
        for (from, to) in STREAMS {
            if rng.random::<f64>() < 0.85 {
                add(rng, base + from, base + to, 0.7, 1.0);
            }
        }
        if unit + 1 < units {
            add(rng, base + 1, base + UNIT.len(), 0.6, 2.0);
            add(rng, base + 9, base + UNIT.len() + 4, 0.5, 2.0);
            add(rng, base + 11, base + UNIT.len() + 3, 0.5, 2.0);
        } else if units > 1 {
            // The recycle, through the first unit's vessel.
            add(rng, base + 1, 3, 0.4, 4.0);
        }
    }
    streams
}

/// Gain and phase of the process at w (rad/s), the held input counted as half a sample of dead time.
fn response(process: &ProcessSpec, w: f64) -> (f64, f64) {
    let wait = -w * (process.dead_time_s + 0.5 * TS_S);
    match process.kind {
        ProcessKind::FirstOrder { gain, tau_s } => {
            (gain / (1.0 + (w * tau_s).powi(2)).sqrt(), wait - (w * tau_s).atan())
        }
        ProcessKind::SecondOrder { gain, tau_s, zeta } => {
            let (re, im) = (1.0 - (w * tau_s).powi(2), 2.0 * zeta * w * tau_s);
            (gain / re.hypot(im), wait - im.atan2(re))
        }
        ProcessKind::Integrating { rate } => (rate / w, wait - 0.5 * PI),
        ProcessKind::IntegratingLag { rate, tau_s } => {
            (rate / w / (1.0 + (w * tau_s).powi(2)).sqrt(), wait - 0.5 * PI - (w * tau_s).atan())
        }
    }
}

/// The controller's gain at which the loop never comes to rest, its integral time kept.
fn ultimate(process: &ProcessSpec, ti_s: f64) -> f64 {
    let phase = |w: f64| response(process, w).1 - (1.0 / (w * ti_s)).atan();
    // An integrating process with a PI begins at -π; it is above that between, and falls through it once.
    let (mut low, mut high) = (1e-5, PI / TS_S);
    let grid = |i: i32| low * (high / low).powf(f64::from(i) / 400.0);
    let above = (0..=400).rev().map(grid).find(|w| phase(*w) > -PI).unwrap_or(low);
    (low, high) = (above, (above * 1.05).min(high));
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if phase(middle) > -PI { low = middle } else { high = middle }
    }
    1.0 / (response(process, low).0 * (1.0 + (1.0 / (low * ti_s)).powi(2)).sqrt())
}

impl Plant {
    /// The loops with the sources that are `on`, before it runs.
    fn spoiled(&self, on: &[bool], hours: f64) -> Vec<UnitLoop> {
        let mut loops = self.loops.clone();
        for (((source, at), strength), _) in
            self.sources.iter().zip(&self.strength).zip(on).filter(|(_, on)| **on)
        {
            let of = &mut loops[*at];
            match source {
                Source::Valve => {
                    let s = 3.0 + 5.0 * strength;
                    of.valve.friction =
                        Friction::Choudhury { s, j: s * (0.3 + 0.5 * strength), resolution: 0.005 };
                }
                Source::Tight => {
                    of.controller.ti_s *= 0.6;
                    of.controller.gain = (0.93 + 0.05 * strength) * ultimate(&of.process, of.controller.ti_s);
                }
                Source::Sluggish => {
                    of.controller.gain *= 0.08;
                    of.controller.ti_s *= 2.0;
                    of.load = LoadKind::Coloured { sd: 2.0, tau_s: 1500.0 };
                }
                Source::RandomLoad => {
                    of.load =
                        LoadKind::Coloured { sd: 4.0 + 4.0 * strength, tau_s: 100.0 + 300.0 * strength };
                }
                Source::Quantised => of.sensor.quantum = 0.8 + strength,
                Source::Noisy => of.sensor.noise_sd = 1.5 + 2.0 * strength,
                Source::Frozen => {
                    let from_s = TS_S * WARM_UP as f64 + 3600.0 * hours * (0.2 + 0.3 * strength);
                    of.sensor.freeze = Some(Freeze { from_s, to_s: from_s + 3600.0 * hours * 0.15 });
                    of.load = LoadKind::Coloured { sd: 2.0, tau_s: 300.0 };
                }
                Source::Saturated => {
                    of.controller.op_limits = (0.0, of.op0 + 1.0 + 2.0 * strength);
                    of.load = LoadKind::Coloured { sd: 3.0, tau_s: 1800.0 };
                }
                Source::Load => {}
            }
        }
        loops
    }

    /// So many hours of every loop with the sources that are `on`, as archives keep them.
    pub fn run(&self, hours: f64, on: &[bool]) -> Vec<Run> {
        let loops = self.spoiled(on, hours);
        let mut work: Vec<AtWork> =
            loops.iter().enumerate().map(|(i, of)| AtWork::new(of, self.seed, i)).collect();
        let mut streams: Vec<Process> = self.streams.iter().map(|s| Process::new(&s.spec, TS_S)).collect();
        let mut swings: Vec<Swing> = self
            .sources
            .iter()
            .enumerate()
            .filter(|(i, (source, _))| *source == Source::Load && on[*i])
            .map(|(i, (_, at))| Swing::new(*at, self.period_s[i], 3.0 + 5.0 * self.strength[i], self.seed))
            .collect();
        let n = (hours * 3600.0 / TS_S) as usize;
        let mut runs: Vec<Run> =
            loops.iter().map(|of| Run { ts: TS_S * of.every as f64, ..Run::default() }).collect();
        let mut into = vec![0.0; loops.len()];
        let mut op: Vec<f64> = loops.iter().map(|of| of.op0).collect();
        // A slave sees the output that its master has just written.
        let mut order: Vec<usize> = (0..loops.len()).collect();
        order.sort_by_key(|i| loops[*i].master.is_some());
        for k in 0..n + WARM_UP {
            into.fill(0.0);
            for (stream, lag) in self.streams.iter().zip(&streams) {
                into[stream.to] += lag.output();
            }
            swings.iter_mut().for_each(|swing| into[swing.at] += swing.step());
            for &i in &order {
                let sp = match loops[i].master {
                    Some(master) => loops[i].pv0 + op[master] - loops[master].op0,
                    None => loops[i].pv0,
                };
                let drives = !loops.iter().any(|other| other.master == Some(i));
                let point = work[i].step(&loops[i], k as f64 * TS_S, sp, into[i], drives.then_some(()));
                op[i] = point.0;
                if k >= WARM_UP && (k - WARM_UP).is_multiple_of(loops[i].every) {
                    let run = &mut runs[i];
                    run.t.push((k - WARM_UP) as f64 * TS_S);
                    run.op.push(point.0);
                    run.pv.push(point.1);
                    run.sp.push(sp);
                    run.mv.push(point.2);
                }
            }
            // A master moves no valve of its own: what its slave lets through acts on its process.
            for i in 0..loops.len() {
                if let Some(slave) = loops.iter().position(|other| other.master == Some(i)) {
                    let flow = work[slave].y - loops[slave].pv0;
                    let pushed = flow + into[i] + work[i].pushed;
                    work[i].process.step(pushed);
                }
            }
            for (stream, lag) in self.streams.iter().zip(&mut streams) {
                lag.step(work[stream.from].flow);
            }
        }
        runs
    }

    /// Of every loop the share of PV's variance that each source brings: with it alone against without any, over both; the
    /// loops' records with all sources first.
    pub fn truth(&self, hours: f64) -> (Vec<Run>, Vec<Vec<f64>>) {
        let all = self.run(hours, &vec![true; self.sources.len()]);
        let none = self.run(hours, &vec![false; self.sources.len()]);
        let mut shares = vec![Vec::new(); all.len()];
        for s in 0..self.sources.len() {
            let on: Vec<bool> = (0..self.sources.len()).map(|i| i == s).collect();
            let with = self.run(hours, &on);
            for (i, share) in shares.iter_mut().enumerate() {
                let more: Vec<f64> = with[i].pv.iter().zip(&none[i].pv).map(|(a, b)| a - b).collect();
                share.push(variance(&more) / variance(&all[i].pv).max(1e-12));
            }
        }
        (all, shares)
    }
}

fn variance(v: &[f64]) -> f64 {
    let m = v.iter().sum::<f64>() / v.len().max(1) as f64;
    v.iter().map(|x| (x - m).powi(2)).sum::<f64>() / v.len().max(1) as f64
}

/// A loop at work.
struct AtWork {
    process: Process,
    controller: Controller,
    valve: Valve,
    load: LoadState,
    sensor: Sensor,
    rng: Pcg64Mcg,
    /// Process variable before the sensor, flow about its rest, and this sample's load.
    y: f64,
    flow: f64,
    pushed: f64,
}

impl AtWork {
    fn new(of: &UnitLoop, seed: u64, at: usize) -> Self {
        let mut rng = generator(seed, at as u128);
        Self {
            process: Process::new(&of.process, TS_S),
            controller: Controller::new(&of.controller, TS_S, of.op0, of.pv0),
            valve: Valve::new(&of.valve, of.op0),
            load: LoadState::new(&Load::input(of.load), TS_S, &mut rng),
            sensor: Sensor::new(&of.sensor, of.pv0),
            rng,
            y: of.pv0,
            flow: 0.0,
            pushed: 0.0,
        }
    }

    /// OP, PV and stem of one sample; `drives`: a valve of its own moves its process.
    fn step(&mut self, of: &UnitLoop, t: f64, sp: f64, into: f64, drives: Option<()>) -> (f64, f64, f64) {
        self.y = of.pv0 + self.process.output();
        let pv = self.sensor.step(t, self.y, &mut self.rng);
        let op = self.controller.step(sp, pv);
        self.pushed = self.load.step(t, &mut self.rng);
        let mv = if drives.is_some() { self.valve.step(op) } else { op };
        self.flow = mv - of.op0;
        if drives.is_some() {
            self.process.step(self.flow + into + self.pushed);
        }
        (op, pv, mv)
    }
}

/// A swing from outside whose period wanders a little.
struct Swing {
    at: usize,
    period_s: f64,
    height: f64,
    phase: f64,
    away: f64,
    rng: Pcg64Mcg,
}

impl Swing {
    fn new(at: usize, period_s: f64, height: f64, seed: u64) -> Self {
        Self { at, period_s, height, phase: 0.0, away: 0.0, rng: generator(seed, (1 << 18) + at as u128) }
    }

    fn step(&mut self) -> f64 {
        // 2 % of the period, over some periods.
        let keep = (-TS_S / (3.0 * self.period_s)).exp();
        let e: f64 = StandardNormal.sample(&mut self.rng);
        self.away = keep * self.away + 0.02 * (1.0 - keep * keep).sqrt() * e;
        self.phase += TS_S / self.period_s * (1.0 + self.away);
        self.height * (TAU * self.phase).sin()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ultimate_gain_is_where_theory_has_it() {
        // 1/(10 s + 1) with 60 s of dead time and slow integral: between -π at w = 0.0288 by bisection elsewhere.
        let process =
            ProcessSpec { kind: ProcessKind::FirstOrder { gain: 2.0, tau_s: 100.0 }, dead_time_s: 45.0 };
        let k = ultimate(&process, 1e9);
        // w tau + atan: 50 w + atan(100 w) = π at w = 0.03673; the gain there is 2 / |1 + 3.673 i|.
        let w = 0.03673_f64;
        assert!((50.0 * w + (100.0 * w).atan() - PI).abs() < 0.02);
        assert!((k - (1.0 + (100.0 * w).powi(2)).sqrt() / 2.0).abs() < 0.03, "{k}");
    }

    #[test]
    fn a_source_swings_its_own_loop_and_some_others_and_none_without_it() {
        let plant = plant(3, 2, &[(Source::Load, None)]);
        let (runs, shares) = plant.truth(8.0);
        assert_eq!(runs.len(), 24);
        let at = plant.sources[0].1;
        assert!(shares[at][0] > 0.3, "{}", shares[at][0]);
        assert!(shares.iter().filter(|s| s[0] < 0.05).count() >= 2);
        assert!(runs.iter().all(|run| run.pv.iter().chain(&run.op).all(|x| x.is_finite())));
        // The same seed gives the same records.
        assert_eq!(plant.run(1.0, &[true]), plant.run(1.0, &[true]));
    }
}
