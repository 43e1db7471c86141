//! The bench: the paper's loops with and without a compensator, and what is measured on them.

use crate::compensation::{Compensator, ConstantReinforcement, CrSettings};
use crate::diagnosis::{Diagnosis, Settings, diagnose};
use crate::signal::{Record, Sample};
use crate::sim::scenarios::table2_loop;
use crate::sim::{Friction, LoopSim, LoopSpec, SpecError};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// The valve's resolution: |Δop| up to this stops the stem [%].
pub const RESOLUTION: f64 = 0.005;
/// Samples before anything is measured or switched on.
pub const WARM_UP: usize = 1000;
/// The settled span: this many samples after the switch-on ...
pub const SETTLED_FROM: usize = 4000;
/// ... to this many.
pub const SETTLED_TO: usize = 8000;
/// Switch-on instants a ratio is the median of: a noise-free flow loop may by accident come to rest on its set point, and
/// then says nothing of the compensator.
pub const INSTANTS: usize = 5;

/// One of the paper's four sticky loops.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// As in the paper's tables.
    pub name: &'static str,
    /// Level or flow.
    pub level: bool,
    /// Dead band plus stick band S [%].
    pub s: f64,
    /// Slip jump J [%].
    pub j: f64,
    /// Table 2: f and d [%].
    pub paper_f: f64,
    /// Table 2: d [%].
    pub paper_d: f64,
    /// Table 3: ISE ratio [-].
    pub paper_ratio: f64,
}

/// In the paper's order.
pub const CASES: [Case; 4] = [
    Case {
        name: "flow, weak",
        level: false,
        s: 1.0,
        j: 0.3,
        paper_f: 0.5,
        paper_d: 0.06,
        paper_ratio: 1.4e-4,
    },
    Case {
        name: "flow, strong",
        level: false,
        s: 5.0,
        j: 1.0,
        paper_f: 2.5,
        paper_d: 4.01,
        paper_ratio: 8.7e-3,
    },
    Case {
        name: "level, weak",
        level: true,
        s: 1.0,
        j: 0.3,
        paper_f: 0.5,
        paper_d: 0.75,
        paper_ratio: 4.5e-3,
    },
    Case {
        name: "level, strong",
        level: true,
        s: 5.0,
        j: 1.0,
        paper_f: 2.5,
        paper_d: 3.78,
        paper_ratio: 3.4e-3,
    },
];

impl Case {
    /// The loop with Choudhury's valve.
    pub fn choudhury(&self) -> LoopSpec {
        table2_loop(self.level, Friction::Choudhury { s: self.s, j: self.j, resolution: RESOLUTION })
    }

    /// The loop with Kano's valve.
    pub fn kano(&self) -> LoopSpec {
        table2_loop(self.level, Friction::Kano { s: self.s, j: self.j, resolution: RESOLUTION })
    }
}

/// What a run recorded, sample by sample.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trace {
    /// Sample period [s].
    pub ts: f64,
    /// Controller output [%].
    pub op: Vec<f64>,
    /// Valve input: OP and the term [%].
    pub input: Vec<f64>,
    /// PV as measured [%].
    pub pv: Vec<f64>,
    /// Set point [%].
    pub sp: Vec<f64>,
    /// Stem [%].
    pub mv: Vec<f64>,
}

/// `n` samples of a loop, the compensator switched on at sample `switch`.
///
/// # Errors
/// [`SpecError`] where a number of the loop makes no sense.
pub fn run(
    spec: &LoopSpec,
    n: usize,
    seed: u64,
    switch: usize,
    compensator: &mut dyn Compensator,
) -> Result<Trace, SpecError> {
    let mut sim = LoopSim::new(spec, seed)?;
    let mut trace = Trace { ts: spec.ts_s, ..Trace::default() };
    for k in 0..n {
        let mut term = 0.0;
        let p = sim.step_by(|op| {
            if k >= switch {
                term = compensator.step(op, spec.ts_s);
            }
            term
        });
        trace.op.push(p.op);
        trace.input.push(p.op + term);
        trace.pv.push(p.pv);
        trace.sp.push(p.sp);
        trace.mv.push(p.mv);
    }
    Ok(trace)
}

/// No compensator.
pub struct Idle;

impl Compensator for Idle {
    fn step(&mut self, _op: f64, _dt_s: f64) -> f64 {
        0.0
    }
}

/// Constant reinforcement of amplitude `a` [%] by the paper's rule, its sign held within `dead_band` [%].
pub fn reinforcement(a: f64, dead_band: f64) -> Box<dyn Compensator> {
    let settings = CrSettings { dead_band, size: 100.0, ..CrSettings::default() };
    match ConstantReinforcement::new(a, [a, a], settings) {
        Ok(cr) => Box::new(cr),
        // Only an amplitude that is no number from 0 gets here: then there is nothing to reinforce with.
        Err(_) => Box::new(Idle),
    }
}

/// What a stretch of a run is judged by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measures {
    /// Mean square of SP - PV [%²]; over one span its ratio is that of the ISE.
    pub ise: f64,
    /// The stem's travel [%/h].
    pub travel: f64,
    /// The stem's changes of direction [1/h].
    pub reversals: f64,
}

impl Trace {
    /// Samples `from..to`.
    pub fn measure(&self, from: usize, to: usize) -> Measures {
        let hours = (to - from) as f64 * self.ts / 3600.0;
        let (mut travel, mut reversals, mut direction) = (0.0, 0.0, 0.0);
        for pair in self.mv[from..to].windows(2) {
            let moved = pair[1] - pair[0];
            travel += moved.abs();
            if moved * direction < 0.0 {
                reversals += 1.0;
            }
            if moved != 0.0 {
                direction = moved;
            }
        }
        Measures { ise: self.ise(from, to), travel: travel / hours, reversals: reversals / hours }
    }

    /// Mean square of SP - PV over samples `from..to` [%²].
    pub fn ise(&self, from: usize, to: usize) -> f64 {
        let square = |(pv, sp): (&f64, &f64)| (sp - pv) * (sp - pv);
        self.pv[from..to].iter().zip(&self.sp[from..to]).map(square).sum::<f64>() / (to - from) as f64
    }

    /// Largest |SP - PV| over samples `from..to` [%].
    pub fn peak(&self, from: usize, to: usize) -> f64 {
        self.pv[from..to].iter().zip(&self.sp[from..to]).fold(0.0, |peak, (pv, sp)| (sp - pv).abs().max(peak))
    }

    /// Time from sample `from` until |SP - PV| stays within `band` [s]; none when it never does.
    pub fn settle(&self, from: usize, band: f64) -> Option<f64> {
        let error = |k: usize| (self.sp[k] - self.pv[k]).abs();
        let outside = (from..self.pv.len()).rev().find(|&k| error(k) > band);
        let samples = outside.map_or(0, |k| k + 1 - from);
        // Settled for the last tenth at least, otherwise it was only passing by.
        (samples < (self.pv.len() - from) * 9 / 10).then_some(samples as f64 * self.ts)
    }

    /// Samples `from..to` as the diagnosis gets them.
    pub fn record(&self, from: usize, to: usize) -> Record {
        let series =
            |v: &[f64]| (from..to).map(|k| Sample::good(k as f64 * self.ts, v[k])).collect::<Vec<_>>();
        Record {
            op: series(&self.op),
            pv: series(&self.pv),
            sp: Some(series(&self.sp)),
            op_limits: Some((0.0, 100.0)),
            op_span: Some(100.0),
            ..Record::default()
        }
    }

    /// (time [s] from sample `from`, value) of one column, for a plot.
    pub fn points(&self, column: &[f64], from: usize, to: usize) -> Vec<(f64, f64)> {
        (from..to).map(|k| ((k - from) as f64 * self.ts, column[k])).collect()
    }
}

/// A loop's cycle without a compensator, which every compensated run is compared with.
pub struct Original {
    /// The loop.
    pub spec: LoopSpec,
    /// Its seed.
    pub seed: u64,
    /// The run.
    pub trace: Trace,
}

impl Original {
    /// Runs to the end of the settled span of the last switch-on instant.
    ///
    /// # Errors
    /// [`SpecError`] where a number of the loop makes no sense.
    pub fn new(spec: LoopSpec, seed: u64) -> Result<Self, SpecError> {
        let n = WARM_UP + INSTANTS * stride(&spec) + SETTLED_TO;
        let trace = run(&spec, n, seed, 0, &mut Idle)?;
        Ok(Self { spec, seed, trace })
    }

    /// The ISE ratio of constant reinforcement by the paper's rule over the settled span, one for each of several
    /// switch-on instants; none where the loop does not cycle on its own.
    ///
    /// # Errors
    /// [`SpecError`] where a number of the loop makes no sense.
    pub fn ratios(&self, a: f64) -> Result<Vec<f64>, SpecError> {
        let mut ratios = Vec::with_capacity(INSTANTS);
        for instant in 0..INSTANTS {
            let switch = WARM_UP + instant * stride(&self.spec);
            let n = switch + SETTLED_TO;
            let with = run(&self.spec, n, self.seed, switch, &mut *reinforcement(a, 0.0))?;
            ratios.extend(self.ratio(&with, switch));
        }
        Ok(ratios)
    }

    /// The same loop, loads and noise with a compensator from the end of the warm-up on.
    ///
    /// # Errors
    /// [`SpecError`] where a number of the loop makes no sense.
    pub fn with(&self, compensator: &mut dyn Compensator) -> Result<Trace, SpecError> {
        run(&self.spec, WARM_UP + SETTLED_TO, self.seed, WARM_UP, compensator)
    }

    /// ISE ratio over the settled span; none where the loop does not cycle on its own: that would divide by nothing.
    pub fn settled_ratio(&self, trace: &Trace) -> Option<f64> {
        self.ratio(trace, WARM_UP)
    }

    fn ratio(&self, trace: &Trace, switch: usize) -> Option<f64> {
        let span = |t: &Trace| t.ise(switch + SETTLED_FROM, switch + SETTLED_TO);
        let own = span(&self.trace);
        // The weakest cycle here has a mean square of 0.003 %²; a loop at rest is left with roundings.
        (own > 1e-9).then(|| span(trace) / own)
    }

    /// The diagnosis of `n` samples from the end of the warm-up on.
    pub fn diagnose(&self, n: usize) -> Diagnosis {
        diagnose(&self.trace.record(WARM_UP, WARM_UP + n), &Settings::default())
    }
}

/// Samples between two switch-on instants: a fraction of a cycle, which is 500 to 1,000 samples long in the flow
/// loops and about 30 in the level loops.
pub fn stride(spec: &LoopSpec) -> usize {
    if spec.process.kind.is_integrating() { 7 } else { 83 }
}

/// f as the diagnosis publishes it: none where the valve is not identifiable.
pub fn f_of(diagnosis: &Diagnosis) -> Option<f64> {
    diagnosis.estimate.as_ref().map(|e| e.f)
}

/// `work` on every item, on every core; results in the items' order.
pub fn parallel<T: Sync, R: Send>(items: &[T], work: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let next = AtomicUsize::new(0);
    let done = Mutex::new(Vec::with_capacity(items.len()));
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(items.len().max(1));
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while let Some(at) = Some(next.fetch_add(1, Ordering::Relaxed)).filter(|at| *at < items.len())
                {
                    let result = work(&items[at]);
                    done.lock().unwrap_or_else(PoisonError::into_inner).push((at, result));
                }
            });
        }
    });
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_by_key(|(at, _)| *at);
    done.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn measures_by_hand() {
        let trace = Trace {
            ts: 36.0,
            pv: vec![0.0, 3.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0],
            sp: vec![1.0; 10],
            mv: vec![0.0, 2.0, 2.0, 1.0, 1.0, 3.0, 3.0, 3.0, 3.0, 3.0],
            ..Trace::default()
        };
        // 10 samples of 36 s are 0.1 h: travel 5, two reversals; squares 1 and 4 over 10.
        let m = trace.measure(0, 10);
        assert_eq!((m.travel, m.reversals, m.ise), (50.0, 20.0, 0.5));
        assert_eq!((trace.peak(0, 10), trace.settle(0, 0.5)), (2.0, Some(72.0)));
        assert_eq!(trace.settle(0, 2.5), Some(0.0));
        let never = Trace { pv: vec![0.0, 3.0, 0.0, 3.0], sp: vec![1.0; 4], ..Trace::default() };
        assert_eq!(never.settle(0, 0.5), None);
    }

    #[test]
    fn parallel_keeps_the_order() {
        let items: Vec<usize> = (0..100).collect();
        assert_eq!(parallel(&items, |i| i * i), items.iter().map(|i| i * i).collect::<Vec<_>>());
    }
}
