//! Columns that grow sample by sample, as those of a change do while its time goes back: what each explains, without solving again.
//!
//! ```text
//! X = Q R with Q'Q = 1,   e = y - Q Q'y,   V(x) = (e'e - (x'e)^2 / (x'x - |Q'x|^2)) / n
//! ```
//!
//! With Q at hand one more sample of a column x costs a row of Q, not a pass over all samples and a factorisation.

use super::fit::FLOOR;
use super::regress::Quick;
use crate::sysid::least_squares::dot;

/// Share of a column that must not be a combination of others.
const OF_ITS_OWN: f64 = 1e-9;

/// What is left of the target once a base of columns has explained what it can.
pub struct Left<'a> {
    /// Q by rows, each of `p`.
    rows: Vec<f64>,
    p: usize,
    e: Vec<f64>,
    /// Weights of the samples; columns are multiplied by them.
    weight: Option<&'a [f64]>,
    power: f64,
}

/// A column that grows.
pub struct Growing<'a> {
    left: &'a Left<'a>,
    x: Vec<f64>,
    on_base: Vec<f64>,
    power: f64,
    on_e: f64,
}

impl<'a> Left<'a> {
    /// By `quick`'s base.
    pub fn new(quick: &'a Quick) -> Self {
        let (rows, p) = quick.orthonormal();
        let e = quick.residual();
        let power = dot(&e, &e);
        Self { rows, p, e, weight: quick.weight(), power }
    }

    /// A column of nothing yet.
    pub fn column(&self) -> Growing<'_> {
        Growing { left: self, x: vec![0.0; self.e.len()], on_base: vec![0.0; self.p], power: 0.0, on_e: 0.0 }
    }

    fn loss(&self, explained: f64) -> f64 {
        (self.power - explained).max(0.0) / self.e.len() as f64 + FLOOR
    }
}

impl Growing<'_> {
    /// Adds `more` at sample `k` of those that are fitted (others do not count); what was added, weighted.
    pub fn add(&mut self, k: usize, more: f64) -> f64 {
        let Left { rows, p, e, weight, .. } = self.left;
        if k >= self.x.len() {
            return 0.0;
        }
        let more = more * weight.map_or(1.0, |w| w[k]);
        self.power += more * (2.0 * self.x[k] + more);
        self.x[k] += more;
        self.on_e += more * e[k];
        self.on_base.iter_mut().zip(&rows[k * p..]).for_each(|(sum, q)| *sum += more * q);
        more
    }

    /// Its value at sample `k`, weighted.
    pub fn at(&self, k: usize) -> f64 {
        self.x.get(k).copied().unwrap_or(0.0)
    }

    /// What it has of its own, beside the base.
    fn own(&self) -> Option<f64> {
        let own = self.power - dot(&self.on_base, &self.on_base);
        (own > OF_ITS_OWN * self.power).then_some(own)
    }

    /// The loss with it, and its coefficient.
    pub fn alone(&self) -> (f64, f64) {
        let Some(own) = self.own() else { return (self.left.loss(0.0), 0.0) };
        let gamma = self.on_e / own;
        (self.left.loss(gamma * self.on_e), gamma)
    }

    /// The loss with another one, too, and this one's coefficient; `both`: the sum of their products. As [`Self::alone`] where one is
    /// a combination of the rest.
    pub fn beside(&self, other: &Self, both: f64) -> (f64, f64) {
        let (Some(a), Some(c)) = (self.own(), other.own()) else { return self.alone() };
        let b = both - dot(&self.on_base, &other.on_base);
        let det = a * c - b * b;
        if det <= OF_ITS_OWN * a * c {
            return self.alone();
        }
        let gamma = (c * self.on_e - b * other.on_e) / det;
        let others = (a * other.on_e - b * self.on_e) / det;
        (self.left.loss(gamma * self.on_e + others * other.on_e), gamma)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::model::Stage;
    use crate::residual::pose::declared;
    use crate::residual::pose::tests::first_order;

    /// The losses of a step and of a part of OP from each time on are those of [`Quick::with`], samples that do not count or not.
    #[test]
    fn what_grows_is_what_was_built_at_once() {
        let data = first_order(500);
        let spec = declared(&data, 0.0);
        let mut plain = spec.stage(&data).0;
        // Two sines alone leave four lags that are no combination of others.
        plain.z.iter_mut().enumerate().for_each(|(k, z)| *z += (1.3 * (k * k) as f64).sin());
        let mut weight = plain.weight.clone();
        weight[data.first + 40..data.first + 60].fill(0.0);
        for stage in [Stage { weight, ..plain.clone() }, plain] {
            let quick = Quick::long_arx(&data, &stage, spec.orders.nk);
            let left = Left::new(&quick);
            let (mut step, mut part, mut both) = (left.column(), left.column(), 0.0);
            for at in (data.first + 20..data.split).rev() {
                let k = at - data.first;
                both += step.add(k, 1.0) * part.at(k);
                both += part.add(k, data.u[at] * data.u[at]) * step.at(k);
                if at % 17 > 0 {
                    continue;
                }
                let from = |v: &dyn Fn(usize) -> f64| -> Vec<f64> {
                    (0..data.len()).map(|k| if k >= at { v(k) } else { 0.0 }).collect()
                };
                let (of_step, of_part) = (from(&|_| 1.0), from(&|k| data.u[k] * data.u[k]));
                let near = |(loss, gamma): (f64, f64), (all, gammas): (f64, Vec<f64>)| {
                    assert!((loss / all - 1.0).abs() < 1e-9, "{at}: {loss} {all}");
                    assert!(
                        (gamma - gammas[0]).abs() < 1e-6 * (1.0 + gammas[0].abs()),
                        "{at}: {gamma} {gammas:?}"
                    );
                };
                near(step.alone(), quick.with(&[&of_step]));
                near(part.beside(&step, both), quick.with(&[&of_part, &of_step]));
            }
        }
    }

    #[test]
    fn a_column_of_the_base_explains_nothing_more() {
        let data = first_order(500);
        let spec = declared(&data, 0.0);
        let quick = Quick::long_arx(&data, &spec.stage(&data).0, spec.orders.nk);
        let left = Left::new(&quick);
        let mut ones = left.column();
        (0..data.split - data.first).for_each(|k| {
            ones.add(k, 1.0);
        });
        assert_eq!(ones.add(usize::MAX, 1.0), 0.0);
        assert_eq!(ones.alone(), (left.loss(0.0), 0.0));
    }
}
