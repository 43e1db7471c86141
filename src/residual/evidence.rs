//! What an effect brings, judged by a model so rich that nothing about dynamics or coloured noise is left to explain.
//!
//! ```text
//! y[k] = sum_{i=1}^{20} a_i y[k-i] + sum_{j=0}^{15} b_j z[k-nk'-j] + c0 + sum gamma_i phi_i + e
//! evidence = n ln(V0 / V1),   V = mean of rho(e),   rho of Huber at 1.345 sd
//! ```
//!
//! An ARMAX of low order leaves coloured errors, and whatever resembles their colour seems to explain something. The same
//! long model with and without the effect, its stem and shapes held as estimated, is fair to both. A stem that jumps a
//! sample early leaves a few huge errors; Huber's loss keeps those few from deciding.

use super::fit::FLOOR;
use super::model::{Data, Stage};
use crate::sysid::gram::{Column, gram, lower};
use crate::sysid::least_squares::{MOST_COLUMNS, dot, factor, substitute};
use crate::sysid::stats::median;
use std::ops::Range;

/// Lags of y and of z.
const LONG: (usize, usize) = (20, 16);
/// Lags of z before the delay.
const BEFORE: usize = 3;
/// Huber's bend in standard deviations: 95 % efficient where errors are normal.
const BEND: f64 = 1.345;
/// Passes of reweighted least squares from nothing, and from weights that are nearly right.
const PASSES: usize = 4;
const MORE: usize = 2;
/// Share of a column's square that has to be left when samples that weigh less are taken away, lest rounding decides.
const CANCELLED: f64 = 1e-2;

/// The model without the effect, with which others are compared.
pub struct Judge {
    loss: f64,
    scale: f64,
    weight: Vec<f64>,
    /// Lags of z that do not follow from PV's: a linear controller at a constant set point leaves one.
    free: usize,
}

impl Judge {
    /// Of the signals of a model with delay `nk`.
    pub fn new(data: &Data, stage: &Stage, nk: usize) -> Self {
        let system = System::new(data, stage, nk, data.len(), LONG);
        let Robust { e, scale, weight, free, .. } = system.robust();
        Self { loss: system.loss(&e, scale), scale, weight, free }
    }

    /// Twice the log-likelihood that the signals of another model with delay `nk` gain over all samples, less what it costs that lags of
    /// another z may be free where those of OP follow from PV: then B, too, has more numbers.
    pub fn gain(&self, data: &Data, stage: &Stage, nk: usize) -> f64 {
        let system = System::new(data, stage, nk, data.len(), LONG);
        let mut weight = self.weight.clone();
        let (mut e, mut free) = (Vec::new(), self.free);
        for _ in 0..MORE {
            let (theta, live) = system.theta(&weight);
            (e, free) = (system.errors(&theta), live);
            system.reweigh(&e, self.scale, &mut weight);
        }
        let more = 2.0 * free.saturating_sub(self.free) as f64;
        system.counted.iter().sum::<f64>() * (self.loss / system.loss(&e, self.scale)).ln() - more
    }
}

/// What a single wrong sample of PV does to the errors of the long model.
pub struct Innovations {
    /// The errors from the first sample that is fitted on; 0 where a sample does not count.
    pub e: Vec<f64>,
    /// Their standard deviation.
    pub scale: f64,
    /// Errors that a PV wrong by 1 makes: at that sample and at the next ones.
    pub print: Vec<f64>,
}

impl Innovations {
    /// Of the signals of a model with delay `nk`.
    pub fn new(data: &Data, stage: &Stage, nk: usize) -> Self {
        let system = System::new(data, stage, nk, data.len(), LONG);
        let Robust { theta, mut e, scale, .. } = system.robust();
        e.iter_mut().zip(system.counted).for_each(|(e, counted)| *e *= counted);
        let print = [1.0].into_iter().chain(theta[..LONG.0].iter().map(|a| -a)).collect();
        Self { e, scale, print }
    }
}

/// Standard deviation of errors of which a few are huge.
pub fn spread(e: &[f64]) -> f64 {
    let sizes: Vec<f64> = e.iter().map(|e| e.abs()).collect();
    median(&sizes) / 0.6745 + FLOOR.sqrt()
}

/// A robust estimate: coefficients, errors, their standard deviation, and the weights that Huber's loss gives.
#[derive(Default)]
pub struct Robust {
    pub theta: Vec<f64>,
    pub e: Vec<f64>,
    pub scale: f64,
    pub weight: Vec<f64>,
    /// Lags of z that are not a combination of other columns.
    pub free: usize,
}

/// A long ARX of a model's signals; column 0 is what it explains, then come the lags of y, 1, the lags of z and the shapes.
pub struct System<'a> {
    rows: Range<usize>,
    y: &'a [f64],
    z: &'a [f64],
    ones: Vec<f64>,
    shapes: &'a [Vec<f64>],
    /// First lag of z.
    pub nearest: usize,
    lags: (usize, usize),
    /// 0 where a sample does not count.
    pub counted: &'a [f64],
    /// Products of the columns over all samples, lower triangle.
    products: Vec<f64>,
}

impl<'a> System<'a> {
    /// Up to sample `to`; `lags` of y and of z about the delay `nk`.
    pub fn new(data: &Data, stage: &'a Stage, nk: usize, to: usize, lags: (usize, usize)) -> Self {
        let rows = data.first..to;
        let most = MOST_COLUMNS - lags.0 - lags.1 - 1;
        let mut system = Self {
            y: &stage.y,
            z: &stage.z,
            ones: vec![1.0; to],
            shapes: &stage.columns[..stage.columns.len().min(most)],
            nearest: nk.saturating_sub(BEFORE).max(1),
            lags,
            counted: &stage.weight[rows.clone()],
            products: Vec::new(),
            rows,
        };
        system.products = system.products();
        system
    }

    /// Estimated so that a few huge errors do not rule.
    pub fn robust(&self) -> Robust {
        let mut found = Robust { weight: self.counted.to_vec(), ..Robust::default() };
        for _ in 0..PASSES {
            (found.theta, found.free) = self.theta(&found.weight);
            found.e = self.errors(&found.theta);
            found.scale = spread(&found.e);
            self.reweigh(&found.e, found.scale, &mut found.weight);
        }
        found
    }

    /// The errors without what z explains, and the coefficients of z from the nearest lag on.
    pub fn without_z(&self, theta: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let of_z = self.of_z();
        let mut others = theta.to_vec();
        others[of_z.clone()].fill(0.0);
        (self.errors(&others), theta[of_z].to_vec())
    }

    /// The coefficients of z.
    fn of_z(&self) -> Range<usize> {
        let first = self.lags.0 + 1;
        first..first + self.lags.1
    }

    fn size(&self) -> usize {
        self.lags.0 + self.lags.1 + 2 + self.shapes.len()
    }

    /// What it explains, then the lags of y, 1, the lags of z and the shapes.
    fn columns(&self) -> Vec<Column<'_>> {
        let (of_y, of_z) = self.lags;
        let mut columns: Vec<Column> = Column::lags(self.y, 0..=of_y).collect();
        // Lags of a smooth z are nearly 1 together: one of them then has no coefficient, and is not free, rather than 1.
        columns.push(Column::now(&self.ones));
        columns.extend(Column::lags(self.z, self.nearest..self.nearest + of_z));
        columns.extend(self.shapes.iter().map(|shape| Column::now(shape)));
        columns
    }

    /// Those in the rows that count.
    fn all(&self) -> Vec<&[f64]> {
        self.columns().iter().map(|column| column.rows(&self.rows)).collect()
    }

    /// Products of the columns with all samples alike.
    fn products(&self) -> Vec<f64> {
        let size = self.size();
        let mut g = vec![0.0; size * size];
        gram(&self.columns(), &self.rows, &mut g, size);
        g
    }

    /// The same where samples have weights, which are at most 1: few weigh less.
    fn weighted_products(&self, weight: &[f64]) -> Vec<f64> {
        let size = self.size();
        let less = weight.iter().enumerate().filter(|(_, weight)| **weight < 1.0);
        let less: Vec<(usize, f64)> = less.map(|(k, weight)| (k, (1.0 - weight).sqrt())).collect();
        let count = less.len();
        let mut few = Vec::with_capacity(size * count);
        for column in self.all() {
            few.extend(less.iter().map(|(k, share)| column[*k] * share));
        }
        let few: Vec<&[f64]> = (0..size).map(|i| &few[i * count..(i + 1) * count]).collect();
        let mut taken = vec![0.0; size * size];
        lower(&few, &mut taken, size);
        let mut g = self.products.clone();
        g.iter_mut().zip(&taken).for_each(|(g, taken)| *g -= taken);
        let cancelled = |i: usize| g[i * size + i] < CANCELLED * self.products[i * size + i];
        if (0..size).any(cancelled) { self.plain_products(weight) } else { g }
    }

    /// The same, term by term.
    fn plain_products(&self, weight: &[f64]) -> Vec<f64> {
        let (size, all) = (self.size(), self.all());
        let mut g = vec![0.0; size * size];
        for (i, column) in all.iter().enumerate() {
            let own: Vec<f64> = column.iter().zip(weight).map(|(c, w)| c * w).collect();
            (0..=i).for_each(|j| g[i * size + j] = dot(&own, all[j]));
        }
        g
    }

    /// Weighted least squares, and how many lags of z are not a combination of other columns.
    fn theta(&self, weight: &[f64]) -> (Vec<f64>, usize) {
        let size = self.size();
        let mut g = self.weighted_products(weight);
        let mut theta: Vec<f64> = (1..size).map(|i| g[i * size]).collect();
        let mut live = [true; MOST_COLUMNS];
        let inner = &mut g[size + 1..];
        factor(inner, size, size - 1, &mut live);
        substitute(inner, size, &live, &mut theta);
        let free = live[self.of_z()].iter().filter(|live| **live).count();
        (theta, free)
    }

    fn errors(&self, theta: &[f64]) -> Vec<f64> {
        let all = self.all();
        let mut e = all[0].to_vec();
        for (theta, column) in theta.iter().zip(&all[1..]) {
            e.iter_mut().zip(*column).for_each(|(e, c)| *e -= theta * c);
        }
        e
    }

    fn reweigh(&self, e: &[f64], scale: f64, weight: &mut [f64]) {
        for ((w, e), counted) in weight.iter_mut().zip(e).zip(self.counted) {
            *w = counted * (BEND * scale / e.abs().max(1e-300)).min(1.0);
        }
    }

    /// Mean of Huber's loss.
    fn loss(&self, e: &[f64], scale: f64) -> f64 {
        let bend = BEND * scale;
        let rho = |e: f64| if e.abs() > bend { bend * (2.0 * e.abs() - bend) } else { e * e };
        let sum: f64 = e.iter().zip(self.counted).map(|(e, w)| w * rho(*e)).sum();
        sum / self.counted.iter().sum::<f64>().max(1.0) + FLOOR
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::pose::pose;
    use crate::signal::Window;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// A first-order process under a load of the first order: an ARMAX, which the long model must whiten. With a step of
    /// `step` in the load and `spikes` huge errors.
    fn stage(step: f64, spikes: usize) -> (Data, Stage) {
        let n = 1500;
        let mut noise = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(5));
        let op: Vec<f64> = (0..n).map(|k| (0.19 * k as f64).sin() + (0.037 * k as f64).cos()).collect();
        let (mut x, mut load) = (0.0, 0.0);
        let pv: Vec<f64> = (0..n)
            .map(|k: usize| {
                let mut draw = || -> f64 { noise.next().unwrap_or(0.0) };
                load = 0.9 * load + 0.1 * draw();
                x = 0.8 * x + 0.3 * op[k.saturating_sub(2)] + 0.1 * load + if k > 700 { step } else { 0.0 };
                let spike = if spikes > 0 && k > 700 && k % (700 / spikes) == 3 { 2.0 } else { 0.0 };
                x + 0.05 * draw() + spike
            })
            .collect();
        let window = Window { t0: 0.0, ts: 1.0, op, pv, sp: None, mv: None, tags: Vec::new() };
        let data = pose(&window).expect("long enough");
        let (y, z) = (data.y.clone(), data.u.clone());
        let stage = Stage { y, z, weight: vec![1.0; n], ..Stage::default() };
        (data, stage)
    }

    fn gain(step: f64, spikes: usize) -> f64 {
        let (data, mut stage) = stage(step, spikes);
        let judge = Judge::new(&data, &stage, 2);
        stage.columns.push((0..data.len()).map(|k| f64::from(u8::from(k > 700))).collect());
        judge.gain(&data, &stage, 2)
    }

    #[test]
    fn a_step_that_is_there_has_evidence_and_one_that_is_not_has_none() {
        // One number: chi squared of one degree stays below 11 but once in a thousand.
        assert!(gain(0.0, 0) < 11.0, "{}", gain(0.0, 0));
        // Twice what none reaches.
        assert!(gain(0.09, 0) > 22.0, "{}", gain(0.09, 0));
    }

    #[test]
    fn shared_products_are_the_plain_ones() {
        let (data, mut stage) = stage(0.2, 4);
        stage.columns.push((0..data.len()).map(|k| f64::from(u8::from(k > 700))).collect());
        stage.weight[40..60].fill(0.0);
        let system = System::new(&data, &stage, 2, data.len(), LONG);
        let Robust { weight, .. } = system.robust();
        assert!(weight.iter().filter(|weight| **weight < 1.0).count() > 100, "few weigh less");
        // One sample that is all of the sum: what is left of it would be rounding.
        let mut huge = stage.clone();
        huge.y[300] = 1e6;
        let alone: Vec<f64> =
            (data.first..data.len()).map(|k| f64::from(u8::from(!(300..=320).contains(&k)))).collect();
        for (stage, weight) in [(&stage, &weight), (&huge, &alone)] {
            let system = System::new(&data, stage, 2, data.len(), LONG);
            let (shared, plain) = (system.weighted_products(weight), system.plain_products(weight));
            let size = system.size();
            for (at, (shared, plain)) in shared.iter().zip(&plain).enumerate() {
                let scale = (system.products[at / size * (size + 1)]
                    * system.products[at % size * (size + 1)])
                    .sqrt();
                // Sums in another order.
                assert!((shared - plain).abs() < 1e-12 * scale.min(1e4), "{at}: {shared} {plain}");
            }
        }
    }

    #[test]
    fn a_few_huge_errors_do_not_make_a_step() {
        assert!(gain(0.0, 4) < 11.0, "{}", gain(0.0, 4));
    }
}
