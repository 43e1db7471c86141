//! Cascades: a set point that is another loop's output, but for scale and offset.
//!
//! ```text
//! r² = (sum of s o)² / (sum of s² · sum of o²)      0 where the sum of s o is below 0
//! ```
//!
//! s, o: set point and output at up to 200 common times, as deviations from their means. r² is computed once for the values, and once
//! for their changes from each of these times to the next; the smaller one counts. The values of two unrelated ramps, or of two slow
//! oscillations, are proportional, but their changes are not. A master and its set point never move against each other.
//!
//! To compare every set point with every output takes a time that grows with the square of the number of loops. So each signal has a
//! sketch, a vector of 128 means. The 32 outputs whose sketches are most like that of a set point are found by one product each, and
//! only those are compared at the times of their samples.

use super::{LoopFound, Plant};
use crate::signal::Window;
use crate::sysid::least_squares::dot;
use crate::sysid::stats::mean;

/// Times at which two signals are compared.
const COMPARED: usize = 200;
/// Least r² of a set point and its master's output (-): they have the same values but for rounding and sampling.
const SAME: f64 = 0.95;
/// Means in a sketch.
const MEANS: usize = 128;
/// Outputs that are compared with a set point.
const LIKELY: usize = 32;

/// Whether a set point moves as often as an output does: one that is set by hand moves seldom.
pub fn is_moved(sp: &[f64]) -> bool {
    /// Changes, as a share of the samples.
    const MOVES: f64 = 0.2;
    sp.windows(2).filter(|w| w[0] != w[1]).count() as f64 > MOVES * sp.len() as f64
}

/// A signal with its times, in single precision, because those of all loops are kept at once.
#[derive(Clone, Debug)]
pub struct Track {
    t0: f64,
    ts: f64,
    x: Vec<f32>,
}

impl Track {
    /// A signal `x` of a window.
    pub fn of(w: &Window, x: &[f64]) -> Self {
        Self { t0: w.t0, ts: w.ts, x: x.iter().map(|x| *x as f32).collect() }
    }

    fn end(&self) -> f64 {
        self.t0 + self.ts * self.x.len() as f64
    }

    /// Number of the sample at time `t`, or of the last one before it.
    fn index(&self, t: f64) -> usize {
        (((t - self.t0) / self.ts + 1e-6).max(0.0) as usize).min(self.x.len() - 1)
    }

    fn at(&self, t: f64) -> f64 {
        f64::from(self.x[self.index(t)])
    }
}

/// Finds the masters, and sets them in `found`.
///
/// * `slaves`: the loops whose set point moves.
/// * `outputs`: the output of every loop.
/// * `time`: the time that most of them cover (s).
pub fn masters(
    plant: &dyn Plant,
    slaves: &[usize],
    outputs: &[Track],
    time: (f64, f64),
    found: &mut [LoopFound],
) {
    let sketches: Vec<Option<Vec<f64>>> = outputs.iter().map(|output| sketch(output, time)).collect();
    for &slave in slaves {
        let of = plant.get(slave);
        let Some(sp) = &of.window.sp else { continue };
        let sp = Track::of(&of.window, sp);
        let best = likely(slave, sketch(&sp, time), &sketches)
            .into_iter()
            .map(|i| (i, correlation(&sp, &outputs[i])))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        found[slave].master = best.filter(|best| best.1 > SAME).map(|best| best.0);
    }
}

/// The outputs that may be the master's, in their order: those most like the set point, and those without a sketch.
fn likely(slave: usize, sp: Option<Vec<f64>>, sketches: &[Option<Vec<f64>>]) -> Vec<usize> {
    // A set point that does not move in that time has no sketch.
    let sp = sp.filter(|sp| sp.iter().any(|x| *x != 0.0));
    let like = |output: &Option<Vec<f64>>| match (&sp, output) {
        (Some(sp), Some(output)) => dot(sp, output).abs(),
        _ => f64::INFINITY,
    };
    let mut all: Vec<(f64, usize)> = sketches
        .iter()
        .enumerate()
        .filter(|(i, _)| *i != slave)
        .map(|(i, output)| (like(output), i))
        .collect();
    let most = LIKELY + all.iter().filter(|own| own.0.is_infinite()).count();
    if all.len() > most {
        all.select_nth_unstable_by(most, |a, b| b.0.total_cmp(&a.0));
        all.truncate(most);
    }
    let mut likely: Vec<usize> = all.into_iter().map(|own| own.1).collect();
    likely.sort_unstable();
    likely
}

/// The sketch of a signal over a time (s): [`MEANS`] means, as deviations from their own mean, scaled to length 1; none where the signal
/// does not cover that time.
///
/// It has means and not samples, because samples of two fast signals at different times are not correlated.
fn sketch(of: &Track, (from, to): (f64, f64)) -> Option<Vec<f64>> {
    if of.x.is_empty() || to <= from || of.t0 > from || of.end() < to {
        return None;
    }
    let edge = |k: usize| of.index(from + (to - from) * k as f64 / MEANS as f64);
    let cell = |k: usize| {
        let cell = &of.x[edge(k)..edge(k + 1).max(edge(k) + 1)];
        cell.iter().map(|x| f64::from(*x)).sum::<f64>() / cell.len() as f64
    };
    let means: Vec<f64> = (0..MEANS).map(cell).collect();
    let level = mean(&means);
    let about: Vec<f64> = means.iter().map(|x| x - level).collect();
    let length = dot(&about, &about).sqrt();
    let is_moving = length.is_finite() && length > 0.0;
    Some(about.iter().map(|x| if is_moving { x / length } else { 0.0 }).collect())
}

/// r² of two signals (-): the smaller of those of their values and of their changes; 0 where they have too little time in common.
pub fn correlation(a: &Track, b: &Track) -> f64 {
    let (from, to) = (a.t0.max(b.t0), a.end().min(b.end()));
    if to <= from || a.x.is_empty() || b.x.is_empty() {
        return 0.0;
    }
    // They are compared at the stamps of the signal with the longer sample period.
    let coarse = if a.ts >= b.ts { a } else { b };
    let first = coarse.t0 + ((from - coarse.t0) / coarse.ts).ceil() * coarse.ts;
    let step = ((to - from) / (COMPARED as f64 * coarse.ts)).ceil().max(1.0) * coarse.ts;
    let times = (0..).map(|k| first + f64::from(k) * step).take_while(|t| *t < to);
    let (a, b): (Vec<f64>, Vec<f64>) = times.map(|t| (a.at(t), b.at(t))).unzip();
    if a.len() <= 20 {
        return 0.0;
    }
    let changes = |x: &[f64]| -> Vec<f64> { x.windows(2).map(|w| w[1] - w[0]).collect() };
    squared_correlation(&a, &b).min(squared_correlation(&changes(&a), &changes(&b)))
}

/// r² of two series of equal length (-); 0 where one does not move, or where they move against each other.
fn squared_correlation(a: &[f64], b: &[f64]) -> f64 {
    let (ma, mb) = (mean(a), mean(b));
    let sum = |f: &dyn Fn(f64, f64) -> f64| a.iter().zip(b).map(|(a, b)| f(a - ma, b - mb)).sum::<f64>();
    let (aa, bb, ab) = (sum(&|a, _| a * a), sum(&|_, b| b * b), sum(&|a, b| a * b));
    if aa > 0.0 && bb > 0.0 && ab > 0.0 { ab * ab / (aa * bb) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plantwide::PlantLoop;

    fn of(ts: f64, op: Vec<f64>) -> PlantLoop {
        PlantLoop { window: Window { ts, pv: op.clone(), op, ..Window::default() }, ..PlantLoop::default() }
    }

    /// Never the same twice, and as fast as it is sampled.
    fn jagged(k: usize) -> f64 {
        ((k * k) as f64 * 0.37).sin()
    }

    #[test]
    fn a_set_point_is_its_masters_output_in_any_sampling() {
        let fine: Vec<f64> = (0..2000).map(jagged).collect();
        let coarse: Vec<f64> = (0..500).map(|k| 3.0 + 0.5 * jagged(4 * k)).collect();
        let (w, v) = (of(30.0, fine.clone()).window, of(120.0, coarse.clone()).window);
        let (fine, coarse) = (Track::of(&w, &fine), Track::of(&v, &coarse));
        assert!(correlation(&fine, &coarse) > 0.999 && correlation(&coarse, &fine) > 0.999);
        let other: Vec<f64> = (0..500).map(|k| jagged(3 * k + 7)).collect();
        assert!(correlation(&fine, &Track::of(&v, &other)) < 0.2);
        let track = |x: &[f64]| Track::of(&w, x);
        assert_eq!(correlation(&track(&[]), &track(&[1.0])), 0.0);
    }

    #[test]
    fn what_ramps_or_swings_as_another_does_is_not_its_slave() {
        let signal = |of: fn(f64) -> f64, own: usize| -> Vec<f64> {
            (0..2000_usize).map(|k| of(k as f64) + 0.4 * jagged(3 * k + own)).collect()
        };
        let w = of(30.0, Vec::new()).window;
        let r2 = |a: &[f64], b: &[f64]| correlation(&Track::of(&w, a), &Track::of(&w, b));
        let (ramp, swing) = (|k: f64| 0.01 * k, |k: f64| 5.0 * (std::f64::consts::TAU * k / 500.0).sin());
        for shape in [ramp as fn(f64) -> f64, swing] {
            let (own, other) = (signal(shape, 7), signal(shape, 500));
            assert!(squared_correlation(&own, &other) > SAME, "their values are alike");
            assert!(r2(&own, &other) < 0.5, "{}", r2(&own, &other));
            let against: Vec<f64> = own.iter().map(|x| 50.0 - x).collect();
            assert_eq!(r2(&own, &against), 0.0);
            // A set point in tenths is its master's output all the same.
            let rounded: Vec<f64> = own.iter().map(|x| (3.0 + 5.0 * x).round() / 10.0).collect();
            assert!(r2(&rounded, &own) > SAME, "{}", r2(&rounded, &own));
        }
    }

    #[test]
    fn a_master_is_found_among_many_outputs() {
        // Each output wanders by itself.
        let output = |i: usize| -> Vec<f64> {
            let steps =
                (0..2000).map(|k| jagged(k + 31 * i) * (1.0 + (i as f64 * 0.7 + k as f64 * 0.003).sin()));
            let sum = |x: &mut f64, step: f64| {
                *x = 0.98 * *x + step;
                Some(*x)
            };
            steps.scan(0.0, sum).collect()
        };
        let mut plant: Vec<PlantLoop> = (0..100).map(|i| of(30.0, output(i))).collect();
        // One of another sampling, and one of which only the last quarter was recorded.
        let mut slow = of(120.0, output(100).into_iter().step_by(4).collect());
        slow.window.sp = Some(output(57).iter().step_by(4).map(|u| 3.0 + 0.5 * u).collect());
        let mut late = of(30.0, output(101).split_off(1500));
        late.window.t0 = 45_000.0;
        late.window.sp = Some(output(8).split_off(1500));
        plant.extend([slow, late]);
        let outputs: Vec<Track> = plant.iter().map(|of| Track::of(&of.window, &of.window.op)).collect();
        let mut found = vec![LoopFound::default(); plant.len()];
        masters(&plant, &[100, 101], &outputs, (6000.0, 54_000.0), &mut found);
        assert_eq!((found[100].master, found[101].master), (Some(57), Some(8)));
        assert_eq!(found.iter().filter(|of| of.master.is_some()).count(), 2);
        // Not every output was compared with the first: that is what it is for.
        let sketches: Vec<_> = outputs.iter().map(|of| sketch(of, (6000.0, 54_000.0))).collect();
        let sp = sketches[57].clone();
        assert_eq!(likely(100, sp, &sketches).len(), LIKELY + 1);
    }

    #[test]
    fn who_stands_still_has_no_master() {
        let still = vec![5.0; 2000];
        let mut plant = vec![of(30.0, still.clone()), of(30.0, (0..2000).map(jagged).collect())];
        plant[1].window.sp = Some(still);
        let outputs: Vec<Track> = plant.iter().map(|of| Track::of(&of.window, &of.window.op)).collect();
        let mut found = vec![LoopFound::default(); 2];
        masters(&plant, &[1], &outputs, (6000.0, 54_000.0), &mut found);
        assert_eq!(found[1].master, None);
    }
}
