//! The explanations without friction that friction has to beat by AIC. Each is the long ARX at f = 0 with more columns, fitted to
//! the same samples as the sticky model, and pays for each of its parameters.
//!
//! * *Oscillating load*: `sum over h of s_h sin(h w k) + c_h cos(h w k)`. Its frequency w is that of a comb of lines in the
//!   spectrum of the residual. A square or triangular load in a sound loop looks like friction otherwise.
//! * *Recurring load*: lags of y and u about one period: a load that repeats, with a shape or period that drifts.
//! * *Clipped valve*: `z = clip(u)` at the two levels that fit best.

use super::armax::LOSS_FLOOR;
use super::screen::{LONG_Y, Screen};
use super::search::Problem;
use crate::sysid::least_squares::{MOST_COLUMNS, dot, dot_long, factor, substitute};
use crate::sysid::spectrum;
use crate::sysid::stats::range;
use std::f64::consts::TAU;

/// Numbers of harmonics that are tried for a periodic load: from a sine to a wave with corners.
const HARMONICS: [usize; 8] = [1, 2, 3, 5, 8, 14, 24, 40];
/// Lags to each side of one period in the recurring load, whose period drifts.
const REACH: usize = 3;
/// Clip levels that are tried on each side and pass; each pass is finer.
const LEVELS: usize = 12;

/// An explanation without friction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rival {
    /// A linear loop.
    Linear,
    /// A linear loop with a periodic load.
    OscillatingLoad {
        /// Period (samples).
        period: f64,
        /// Number of harmonics, the fundamental included.
        harmonics: usize,
    },
    /// A linear loop with a load that repeats after about a period.
    RecurringLoad {
        /// Period (samples).
        period: usize,
    },
    /// A valve that is clipped.
    ClippedValve,
}

impl Rival {
    /// The rival as an operator reads it.
    pub fn name(&self) -> &'static str {
        match self {
            Rival::Linear => "a linear loop",
            Rival::OscillatingLoad { .. } => "an oscillating load",
            Rival::RecurringLoad { .. } => "a recurring load",
            Rival::ClippedValve => "a clipped valve",
        }
    }
}

/// A rival, compared with the sticky model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rated {
    /// The rival.
    pub rival: Rival,
    /// `AIC(rival) - AIC(sticky)`, without the penalty of the parameters of friction (-).
    pub gain: f64,
}

/// Compares the sticky model with every explanation without friction, at its best parameters.
///
/// * `element`: the friction element of the sticky model, from OP to the stem position.
/// * `period_hint`: period of OP's oscillation (samples).
pub fn rate(p: &Problem, element: &dyn Fn(&[f64]) -> Vec<f64>, period_hint: Option<f64>) -> Vec<Rated> {
    let stem = element(&p.u);
    let n = p.rows();
    let sticky = Fitter::new(p, &stem).loss(Vec::new());
    let mut sound = Fitter::new(p, &p.u);
    let gain = |loss: f64, parameters: usize| {
        n * ((loss + LOSS_FLOOR) / (sticky + LOSS_FLOOR)).ln() + 2.0 * parameters as f64
    };
    let mut rated = vec![Rated { rival: Rival::Linear, gain: gain(sound.loss(Vec::new()), 0) }];
    let found = combs(&sound.residual(), period_hint);
    let mut at = |(period, harmonics): (f64, usize)| -> Comb {
        let loss = sound.loss(harmonic_columns(p, TAU / period, harmonics));
        Comb { period, harmonics, gain: gain(loss, 2 * harmonics + 1) }
    };
    let mut combs: Vec<Comb> = found.iter().map(|&comb| at(comb)).collect();
    combs.sort_by(|a, b| a.gain.total_cmp(&b.gain));
    let refined = combs.into_iter().take(2).map(|start| refine_frequency(start, &mut at, n));
    if let Some(best) = refined.min_by(|a, b| a.gain.total_cmp(&b.gain)) {
        let rival = Rival::OscillatingLoad { period: best.period, harmonics: best.harmonics };
        rated.push(Rated { rival, gain: best.gain });
    }
    let mut periods: Vec<usize> = found.iter().map(|(period, _)| period.round() as usize).collect();
    periods.sort_unstable();
    periods.dedup();
    periods.retain(|period| *period > LONG_Y + REACH && period + REACH < p.y.len() / 3);
    rated.extend(periods.into_iter().map(|period| {
        let columns = recurring_columns(p, period);
        let many = columns.len();
        Rated { rival: Rival::RecurringLoad { period }, gain: gain(sound.loss(columns), many) }
    }));
    let (loss, bounds) = clipped(p);
    let clipped_op: Vec<f64> = p.u.iter().map(|u| u.max(bounds[0]).min(bounds[1])).collect();
    // A valve may stick and run into its stop as well, so friction behind the same clip is compared, too.
    let both = Fitter::new(p, &element(&clipped_op)).loss(Vec::new());
    rated.push(Rated { rival: Rival::ClippedValve, gain: gain(loss, 2).max(gain(loss, 0) - gain(both, 0)) });
    rated
}

/// A periodic load with its `AIC - AIC(sticky)`.
#[derive(Clone, Copy)]
struct Comb {
    /// Period (samples).
    period: f64,
    harmonics: usize,
    gain: f64,
}

/// Refines the frequency of a periodic load by golden section, within the resolution of the spectrum.
///
/// * `at`: the periodic load at a period and a number of harmonics.
/// * `n`: number of samples that count.
fn refine_frequency(start: Comb, at: &mut impl FnMut((f64, usize)) -> Comb, n: f64) -> Comb {
    /// Share of the interval that a golden section keeps: `(sqrt 5 - 1)/2`.
    const GOLDEN: f64 = 0.618_033_988_75;
    let w = TAU / start.period;
    let mut at = |w: f64| at((TAU / w, start.harmonics));
    let (mut low, mut high) = (w - 0.3 * TAU / n, w + 0.3 * TAU / n);
    let mut inner = [high - GOLDEN * (high - low), low + GOLDEN * (high - low)];
    let mut rated = inner.map(&mut at);
    let mut best = start;
    for _ in 0..14 {
        for r in rated {
            if r.gain < best.gain {
                best = r;
            }
        }
        if rated[0].gain < rated[1].gain {
            high = inner[1];
            inner = [high - GOLDEN * (high - low), inner[0]];
            rated = [at(inner[0]), rated[0]];
        } else {
            low = inner[0];
            inner = [inner[1], low + GOLDEN * (high - low)];
            rated = [rated[1], at(inner[1])];
        }
    }
    best
}

/// The long ARX at one stem position, to which columns can be added.
struct Fitter<'a> {
    p: &'a Problem,
    /// Number of rows that count.
    rows: usize,
    /// The columns of the long ARX without the constant, 0 where a row does not count.
    base: Vec<Vec<f64>>,
    /// PV, 0 where a row does not count.
    y: Vec<f64>,
    /// Gram matrix of the constant and the base columns, lower triangle.
    base_gram: Vec<f64>,
    /// Cholesky factor of the last fit.
    gram: Vec<f64>,
    /// Coefficients of the last fit.
    right: [f64; MOST_COLUMNS],
}

impl<'a> Fitter<'a> {
    fn new(p: &'a Problem, stem: &[f64]) -> Self {
        let n = p.y.len();
        let nx = Screen::input_lags(p.max_delay);
        let lagged = |v: &[f64], lag: usize| {
            let mut column = v[p.first - lag..n - lag].to_vec();
            p.blank(&mut column);
            column
        };
        let base: Vec<Vec<f64>> =
            (1..=LONG_Y).map(|l| lagged(&p.y, l)).chain((1..=nx).map(|l| lagged(stem, l))).collect();
        let mut base_gram = vec![0.0; MOST_COLUMNS * MOST_COLUMNS];
        let rows = p.counted().rows(n);
        // The constant is the first column.
        base_gram[0] = rows as f64;
        for (i, a) in base.iter().enumerate() {
            base_gram[(i + 1) * MOST_COLUMNS] = a.iter().sum();
            for (j, b) in base[..=i].iter().enumerate() {
                base_gram[(i + 1) * MOST_COLUMNS + j + 1] = dot_long(a, b);
            }
        }
        Self {
            p,
            rows,
            y: lagged(&p.y, 0),
            base,
            base_gram,
            gram: vec![0.0; MOST_COLUMNS * MOST_COLUMNS],
            right: [0.0; MOST_COLUMNS],
        }
    }

    /// Mean square of the residual with `extra` columns (PV unit²); each has one value for each sample from [`Problem::first`] on.
    fn loss(&mut self, mut extra: Vec<Vec<f64>>) -> f64 {
        extra.iter_mut().for_each(|column| self.p.blank(column));
        let y = &self.y;
        let count = 1 + self.base.len();
        let size = (count + extra.len()).min(MOST_COLUMNS);
        let extra = &extra[..size - count];
        self.gram[..count * MOST_COLUMNS].copy_from_slice(&self.base_gram[..count * MOST_COLUMNS]);
        self.right[0] = y.iter().sum();
        for (r, a) in self.right[1..].iter_mut().zip(&self.base) {
            *r = dot_long(a, y);
        }
        for (i, a) in extra.iter().enumerate() {
            let row = &mut self.gram[(count + i) * MOST_COLUMNS..(count + i + 1) * MOST_COLUMNS];
            row[0] = a.iter().sum();
            for (g, b) in row[1..].iter_mut().zip(&self.base) {
                *g = dot_long(a, b);
            }
            for (g, b) in row[count..].iter_mut().zip(&extra[..=i]) {
                *g = dot_long(a, b);
            }
            self.right[count + i] = dot_long(a, y);
        }
        let mut live = [true; MOST_COLUMNS];
        factor(&mut self.gram, MOST_COLUMNS, size, &mut live);
        let right = self.right;
        substitute(&self.gram, MOST_COLUMNS, &live, &mut self.right[..size]);
        ((dot_long(y, y) - dot(&right[..size], &self.right[..size])) / self.rows as f64).max(0.0)
    }

    /// The residual of the long ARX without further columns.
    fn residual(&mut self) -> Vec<f64> {
        self.loss(Vec::new());
        let mut e: Vec<f64> = self.y.iter().map(|y| y - self.right[0]).collect();
        for (a, c) in self.base.iter().zip(&self.right[1..]) {
            for (e, a) in e.iter_mut().zip(a) {
                *e -= c * a;
            }
        }
        self.p.blank(&mut e);
        e
    }
}

/// The periods (samples) and numbers of harmonics of the strongest combs of lines in the spectrum of a residual: two for each
/// number of harmonics, and `hint`.
pub fn combs(residual: &[f64], hint: Option<f64>) -> Vec<(f64, usize)> {
    let n = residual.len();
    let size = (4 * n).next_power_of_two();
    let mut padded = vec![0.0; size];
    padded[..n].copy_from_slice(residual);
    let power = spectrum::power(&mut padded);
    let floor = power.iter().sum::<f64>() / power.len() as f64;
    // The record has at least four periods, and a period at least four samples.
    let (low, high) = (4 * size / n, size / 4);
    let mut found = Vec::new();
    for harmonics in HARMONICS {
        let score = |i: usize| -> f64 {
            (1..=harmonics)
                .map(|h| h * i)
                .take_while(|at| *at < power.len())
                .map(|at| power[at] - floor)
                .sum()
        };
        let fits = |i: usize| harmonics == 1 || harmonics * i < size / 2 + i;
        let mut best: Vec<(f64, usize)> = (low..high).filter(|&i| fits(i)).map(|i| (score(i), i)).collect();
        best.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut kept: Vec<usize> = Vec::new();
        for (_, i) in best {
            // Bins of the padded transform that are closer than its resolution belong to one line.
            if kept.iter().all(|k| k.abs_diff(i) > size / n) {
                kept.push(i);
            }
            if kept.len() == 2 {
                break;
            }
        }
        found.extend(kept.into_iter().map(|i| (size as f64 / i as f64, harmonics)));
        if let Some(period) = hint.filter(|p| *p > 2.0 * harmonics as f64) {
            found.push((period, harmonics));
        }
    }
    found
}

/// `sin(h w k)` and `cos(h w k)` for h = 1..=harmonics, one value for each sample from the first that counts on.
fn harmonic_columns(p: &Problem, w: f64, harmonics: usize) -> Vec<Vec<f64>> {
    let (first, n) = (p.first, p.y.len());
    (1..=harmonics)
        .flat_map(|h| {
            let w = w * h as f64;
            let (sines, cosines): (Vec<f64>, Vec<f64>) = (first..n).map(|k| (w * k as f64).sin_cos()).unzip();
            [sines, cosines]
        })
        .collect()
}

/// Lags of y and u about one period; before the record begins they are 0, the mean of the record.
fn recurring_columns(p: &Problem, period: usize) -> Vec<Vec<f64>> {
    let lagged = |v: &[f64], lag: usize| -> Vec<f64> {
        (p.first..v.len()).map(|k| k.checked_sub(lag).map_or(0.0, |at| v[at])).collect()
    };
    (period - REACH..=period + REACH).flat_map(|lag| [lagged(&p.y, lag), lagged(&p.u, lag)]).collect()
}

/// The least loss of the long ARX over the lower and the upper clip level of OP, and these levels (unit of the problem's OP).
///
/// Both are searched together on a grid, then each in turn on finer and finer grids.
fn clipped(p: &Problem) -> (f64, [f64; 2]) {
    let (low, high) = range(&p.u);
    let mut screen = Screen::new(&p.y, p.counted(), p.max_delay);
    let still = vec![1.0; p.u.len()];
    let mut z = vec![0.0; p.u.len()];
    let mut loss_at = |bounds: [f64; 2]| -> f64 {
        for (z, u) in z.iter_mut().zip(&p.u) {
            *z = u.max(bounds[0]).min(bounds[1]);
        }
        screen.load(&p.signals(&z, &still), false);
        screen.fit_lag(0.0, 0.0).loss
    };
    let mut best = (f64::INFINITY, [low, high]);
    let mut reach = high - low;
    // Both levels together: while one is wrong, the other shows no gain.
    for lower in 0..LEVELS {
        for upper in 0..LEVELS - 1 {
            let share = |i: usize| 0.5 * i as f64 / LEVELS as f64;
            let bounds = [low + reach * share(lower), high - reach * share(upper)];
            let loss = loss_at(bounds);
            if loss < best.0 {
                best = (loss, bounds);
            }
        }
    }
    reach /= LEVELS as f64;
    for _ in 0..3 {
        for side in [1, 0, 1, 0] {
            let centre = best.1;
            for level in 0..=LEVELS {
                let mut bounds = centre;
                bounds[side] += reach * (level as f64 / LEVELS as f64 - 0.5);
                if bounds[0] < bounds[1] {
                    let loss = loss_at(bounds);
                    if loss < best.0 {
                        best = (loss, bounds);
                    }
                }
            }
        }
        reach *= 2.0 / LEVELS as f64;
    }
    best
}

#[cfg(test)]
mod tests;
