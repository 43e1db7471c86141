//! Least squares for screening: the long ARX with further columns, and the choice of orders.

use super::fit::{FLOOR, errors, minimise_towards};
use super::model::{Data, Linear, Spec, Stage};
use crate::diagnosis::armax::{ORDER, Orders, splits};
use crate::sysid::gram::{Column, lower, products};
use crate::sysid::least_squares::{MOST_COLUMNS, dot, factor, factor_rows, substitute};

/// Lags of y in the long ARX.
pub const LONG_Y: usize = 6;
/// Lags of z before and after the delay.
const BEFORE: usize = 2;
const AFTER: usize = 5;

/// Twice the log-likelihood by which the first estimate of another structure is behind that of the present one where it seldom
/// catches up (-).
const BEHIND: f64 = 3.0;

/// Lags of y in the ARX whose errors stand for those of the model sought.
const LONG_E: usize = 8;

/// Lags of z in the long ARX about the delay `nk`.
pub fn long_lags(data: &Data, nk: usize) -> Vec<usize> {
    (nk.saturating_sub(BEFORE).max(1)..=(nk + AFTER).min(data.max_delay + 4)).collect()
}

/// Least squares on the fitted samples: a base of columns, and more on trial.
pub struct Quick {
    from: usize,
    weight: Option<Vec<f64>>,
    base: Vec<Vec<f64>>,
    target: Vec<f64>,
    gram: Vec<f64>,
    right: Vec<f64>,
    power: f64,
    /// The products factored, and the columns that do not depend on those before them.
    factored: Vec<f64>,
    live: [bool; MOST_COLUMNS],
    /// Loss of the base alone.
    pub loss: f64,
    /// Coefficients of the base alone: y lags, z lags, 1, shapes.
    pub theta: Vec<f64>,
    /// Lags of z in the base.
    pub z_lags: Vec<usize>,
    /// How many lags of y come before them.
    y_lags: usize,
}

impl Quick {
    /// The long ARX about the delay `nk` with the shapes of `stage`.
    pub fn long_arx(data: &Data, stage: &Stage, nk: usize) -> Self {
        Self::new(data, stage, &(1..=LONG_Y).collect::<Vec<_>>(), &long_lags(data, nk))
    }

    /// Chosen lags of y and z, then 1 and the shapes.
    pub fn new(data: &Data, stage: &Stage, y_lags: &[usize], z_lags: &[usize]) -> Self {
        let (from, to) = (data.first, data.split);
        let weight = stage.weight[from..to].contains(&0.0).then(|| stage.weight[from..to].to_vec());
        let masked = |mut v: Vec<f64>| -> Vec<f64> {
            if let Some(w) = &weight {
                v.iter_mut().zip(w).for_each(|(v, w)| *v *= w);
            }
            v
        };
        let ones = vec![1.0; to];
        let mut columns: Vec<Column> = Column::lags(&stage.y, y_lags.iter().copied()).collect();
        columns.extend(Column::lags(&stage.z, z_lags.iter().copied()));
        columns.push(Column::now(&ones));
        columns.extend(stage.columns.iter().map(|c| Column::now(c)));
        columns.truncate(MOST_COLUMNS - 24);
        let base: Vec<Vec<f64>> = columns.iter().map(|c| masked(c.rows(&(from..to)).to_vec())).collect();
        let target = masked(stage.y[from..to].to_vec());
        let p = columns.len();
        let (mut gram, mut right) = (vec![0.0; p * p], vec![0.0; p]);
        let of: Vec<&[f64]> = base.iter().map(Vec::as_slice).collect();
        match weight {
            None => crate::sysid::gram::gram(&columns, &(from..to), &mut gram, p),
            Some(_) => lower(&of, &mut gram, p),
        }
        products(&[&target], &of, |_, i, sum| right[i] = sum);
        let power = dot(&target, &target);
        let mut quick = Self {
            from,
            weight,
            base,
            target,
            gram,
            right,
            power,
            factored: Vec::new(),
            live: [true; MOST_COLUMNS],
            loss: 0.0,
            theta: Vec::new(),
            z_lags: z_lags.to_vec(),
            y_lags: y_lags.len(),
        };
        quick.solve();
        quick
    }

    /// The same with `extra` columns (whole length of the window) at the end of the base.
    fn and(mut self, extra: &[&[f64]]) -> Self {
        let cut = self.cut(extra);
        (self.gram, self.right) = self.joined(&self.gram, &cut);
        self.base.extend(cut);
        self.solve();
        self
    }

    fn solve(&mut self) {
        let p = self.base.len();
        self.factored.clone_from(&self.gram);
        self.live = [true; MOST_COLUMNS];
        factor(&mut self.factored, p, p, &mut self.live);
        self.theta.clone_from(&self.right);
        substitute(&self.factored, p, &self.live, &mut self.theta);
        self.loss = self.mean(&self.right, &self.theta);
    }

    /// Loss with these coefficients, `right` the products of their columns with the target.
    fn mean(&self, right: &[f64], theta: &[f64]) -> f64 {
        (self.power - dot(right, theta)).max(0.0) / self.rows() + FLOOR
    }

    fn rows(&self) -> f64 {
        self.target.len() as f64
    }

    /// Loss and coefficients with a choice of the base's columns; those it was too small for have the coefficient 0.
    pub fn subset(&self, chosen: &[usize]) -> (f64, Vec<f64>) {
        let all = self.base.len();
        let kept: Vec<usize> = chosen.iter().copied().filter(|column| *column < all).collect();
        let p = kept.len();
        let mut g = vec![0.0; p * p];
        let mut theta = vec![0.0; p];
        for (i, &a) in kept.iter().enumerate() {
            for (j, &b) in kept[..=i].iter().enumerate() {
                g[i * p + j] = self.gram[a.max(b) * all + a.min(b)];
            }
            theta[i] = self.right[a];
        }
        let r = theta.clone();
        let mut live = [true; MOST_COLUMNS];
        factor(&mut g, p, p, &mut live);
        substitute(&g, p, &live, &mut theta);
        let loss = self.mean(&r, &theta);
        // Shapes come last, so that what is missing does.
        theta.resize(chosen.len(), 0.0);
        (loss, theta)
    }

    /// Loss and the new columns' coefficients with `extra` columns (whole length of the window).
    pub fn with(&self, extra: &[&[f64]]) -> (f64, Vec<f64>) {
        let (mut g, r) = self.joined(&self.factored, &self.cut(extra));
        let (p, size) = (self.base.len(), r.len());
        let mut theta = r.clone();
        let mut live = self.live;
        factor_rows(&mut g, size, p..size, &mut live);
        substitute(&g, size, &live, &mut theta);
        (self.mean(&r, &theta), theta.split_off(p))
    }

    /// The fitted samples that count of `extra` columns.
    fn cut(&self, extra: &[&[f64]]) -> Vec<Vec<f64>> {
        let cut = extra.iter().map(|v| {
            let mut v = v[self.from..self.from + self.target.len()].to_vec();
            if let Some(w) = &self.weight {
                v.iter_mut().zip(w).for_each(|(v, w)| *v *= w);
            }
            v
        });
        cut.collect()
    }

    /// Those of `cut` after the base's columns: the rows of `base` and their products, lower triangle, and all with the target.
    fn joined(&self, base: &[f64], cut: &[Vec<f64>]) -> (Vec<f64>, Vec<f64>) {
        let p = self.base.len();
        let size = p + cut.len();
        let mut g = vec![0.0; size * size];
        for i in 0..p {
            g[i * size..i * size + i + 1].copy_from_slice(&base[i * p..i * p + i + 1]);
        }
        let mut right = self.right.clone();
        let cut: Vec<&[f64]> = cut.iter().map(Vec::as_slice).collect();
        let base: Vec<&[f64]> = self.base.iter().chain([&self.target]).map(Vec::as_slice).collect();
        right.resize(size, 0.0);
        products(
            &cut,
            &base,
            |i, j, sum| if j < p { g[(p + i) * size + j] = sum } else { right[p + i] = sum },
        );
        if let Some(own) = g.get_mut((size + 1) * p..) {
            lower(&cut, own, size);
        }
        (g, right)
    }

    /// The base's coefficients of z, one for each of its lags.
    pub fn b(&self) -> &[f64] {
        &self.theta[self.y_lags..self.y_lags + self.z_lags.len()]
    }

    /// The base made orthonormal, by rows, and its columns.
    pub fn orthonormal(&self) -> (Vec<f64>, usize) {
        let p = self.base.len();
        let (g, live) = (&self.factored, &self.live);
        let mut rows = vec![0.0; p * self.target.len()];
        for (k, row) in rows.chunks_exact_mut(p).enumerate() {
            for i in (0..p).filter(|i| live[*i]) {
                let of = &g[i * p..i * p + i];
                let partial: f64 = of.iter().zip(&*row).map(|(l, q)| l * q).sum();
                row[i] = (self.base[i][k] - partial) / g[i * p + i];
            }
        }
        (rows, p)
    }

    /// Weights of the fitted samples, where they differ.
    pub fn weight(&self) -> Option<&[f64]> {
        self.weight.as_deref()
    }

    /// The residual of the base on the fitted samples.
    pub fn residual(&self) -> Vec<f64> {
        let mut e = self.target.clone();
        for (theta, column) in self.theta.iter().zip(&self.base) {
            for (e, c) in e.iter_mut().zip(column) {
                *e -= theta * c;
            }
        }
        e
    }
}

/// Chooses orders and delay anew for the model's stage, by Hannan–Rissanen fits of every structure and a full fit of the
/// best `most`; keeps the present one unless another is better.
pub fn restructure(data: &Data, spec: &mut Spec, free_lag: bool, most: usize) {
    let rows = (data.split - data.first) as f64;
    let mut found = structures(data, spec, most);
    let own = found.iter().find(|other| other.orders == spec.orders).map(|own| own.loss);
    // All found are ahead of one that is not among them.
    if let Some(own) = own.filter(|_| spec.loss.is_finite()) {
        found.retain(|other| rows * (other.loss / own).ln() < BEHIND);
    }
    for mut other in found {
        minimise_towards(data, &mut other, free_lag, (0, 12), spec.loss);
        if other.loss < spec.loss {
            *spec = other;
        }
    }
}

/// The best `most` structures by Hannan and Rissanen's estimates, with the losses of those.
pub fn structures(data: &Data, spec: &Spec, most: usize) -> Vec<Spec> {
    let (stage, _) = spec.stage(data);
    let z_lags: Vec<usize> = (1..=data.max_delay + ORDER - 2).collect();
    let long = Quick::new(data, &stage, &(1..=LONG_E).collect::<Vec<_>>(), &z_lags);
    let mut e = vec![0.0; data.len()];
    e[data.first..data.split].copy_from_slice(&long.residual());
    let late: Vec<Vec<f64>> =
        (1..ORDER - 1).map(|lag| [&[0.0; ORDER][..lag], &e[..e.len() - lag]].concat()).collect();
    let late: Vec<&[f64]> = late.iter().map(Vec::as_slice).collect();
    let of_e = long.base.len();
    let all = long.and(&late);
    let (of_z, of_shapes) = (LONG_E, LONG_E + z_lags.len());
    let mut found: Vec<(f64, Orders, Vec<f64>)> = Vec::new();
    let mut chosen = Vec::new();
    for nk in 1..=data.max_delay {
        for orders in splits(nk) {
            chosen.clear();
            chosen.extend(0..orders.na);
            chosen.extend((0..orders.nb).map(|j| of_z + nk - 1 + j));
            chosen.extend((0..orders.nc).map(|l| of_e + l));
            chosen.extend(of_shapes..of_e);
            let (loss, theta) = all.subset(&chosen);
            found.push((loss, orders, theta));
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    let estimated = found.into_iter().take(most).map(|(loss, orders, theta)| {
        let (na, nb, nc) = (orders.na, orders.nb, orders.nc);
        let mut other = spec.clone();
        (other.orders, other.loss) = (orders, loss);
        other.linear = Linear {
            a: theta[..na].iter().map(|a| -a).collect(),
            b: theta[na..na + nb].to_vec(),
            c: theta[na + nb..na + nb + nc].to_vec(),
            c0: theta[ORDER],
            gamma: theta[ORDER + 1..].to_vec(),
        };
        other
    });
    estimated.collect()
}

/// The prediction errors of a model over the whole window.
pub fn all_errors(data: &Data, spec: &Spec) -> (Stage, Vec<f64>) {
    let (stage, _) = spec.stage(data);
    let mut e = Vec::new();
    errors(data, &stage, spec.orders, &spec.linear, &mut e);
    (stage, e)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::pose::declared;
    use crate::residual::pose::tests::{first_order, noise};

    #[test]
    fn more_shapes_than_fit_are_left_out_and_none_is_no_more() {
        let data = first_order(900);
        let spec = declared(&data, 0.0);
        let mut draw = noise(5);
        let mut stage = spec.stage(&data).0;
        stage.columns = (0..100).map(|_| (0..data.len()).map(|_| draw()).collect()).collect();
        let quick = Quick::long_arx(&data, &stage, spec.orders.nk);
        let all: Vec<usize> = (0..LONG_Y + quick.z_lags.len() + 1 + stage.columns.len()).collect();
        let (loss, theta) = quick.subset(&all);
        assert_eq!((loss, theta.len()), (quick.loss, all.len()));
        assert!(theta.ends_with(&[0.0; 5]) && theta[LONG_Y + quick.z_lags.len() + 1] != 0.0);
        assert_eq!(quick.with(&[]), (quick.loss, Vec::new()));
    }
}
