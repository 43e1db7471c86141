//! The library of noise models C: starts of the prediction-error fit, each with the A and B that are best for its C.
//!
//! ```text
//! A(q) y' = B(q) z' + c0 1' + e,    y' = y/C,  z' = z/C,  1' = 1/C
//! ```
//!
//! * Given C, the model is linear in a, b and c0, and least squares gives them (variable projection).
//! * So only the zeros of C are searched. The library has them dense where loops have them: slow loads near 1, oscillating loads
//!   near the unit circle at low angles, ripple near -1.
//! * One Gram matrix of y' and z' serves every split of the orders and every delay of one C.
//!
//! The loss has several minima. The Hannan–Rissanen start ([`super::screen`]), which takes the errors of a long ARX for e, misses
//! those with zeros of C near the circle. Random starts find them at a hundred times the cost.
//!
//! Source: Golub & Pereyra, SIAM J. Numer. Anal. 1973, 10, 413 (variable projection).

use super::armax::{ORDER, Orders, Signals, Theta, Workspace};
use super::lagged_products::{Lags, products, sums};
use super::screen::Candidate;
use crate::sysid::least_squares::{MOST_COLUMNS, dot, factor, substitute};

/// Single real zeros for C of order 1: dense near 1, where slow loads put them, and near -1, where ripple does.
const REAL: [f64; 12] = [0.97, 0.93, 0.85, 0.7, 0.5, 0.25, -0.2, -0.5, -0.7, -0.83, -0.91, -0.96];
/// Real zeros that are combined with others: fewer, because the products are many.
const REAL_TOGETHER: [f64; 6] = [0.96, 0.8, 0.45, -0.2, -0.65, -0.93];
/// Complex pairs, modulus and angle (rad): dense near the circle at low angles, where oscillating loads put them.
const PAIRS: [(f64, f64); 18] = [
    (0.94, 0.07),
    (0.94, 0.13),
    (0.94, 0.2),
    (0.94, 0.32),
    (0.94, 0.5),
    (0.94, 0.85),
    (0.94, 1.3),
    (0.94, 1.8),
    (0.94, 2.3),
    (0.94, 2.75),
    (0.8, 0.12),
    (0.8, 0.35),
    (0.8, 0.8),
    (0.8, 1.6),
    (0.8, 2.4),
    (0.5, 0.5),
    (0.5, 1.3),
    (0.5, 2.2),
];
/// Pairs almost on the circle, where a sinusoidal load puts them: alone, as C of order 2.
const SHARP: [(f64, f64); 10] = [
    (0.975, 0.04),
    (0.975, 0.08),
    (0.975, 0.12),
    (0.975, 0.17),
    (0.975, 0.23),
    (0.975, 0.3),
    (0.975, 0.4),
    (0.975, 0.55),
    (0.975, 0.75),
    (0.975, 1.0),
];
/// Of so many real zeros and pairs one goes into C of order 4, which serves a single split.
const THINNED: usize = 2;

/// The library and its buffers, allocated once for a record.
#[derive(Clone, Debug)]
pub struct Library {
    models: Vec<NoiseModel>,
    /// Gram matrix of the lags of y' and z', lower triangle.
    gram: Vec<f64>,
    /// Sums of the columns.
    sums: Vec<f64>,
    /// The best model of each structure, those with a smaller nc first.
    best: Vec<Candidate>,
    max_delay: usize,
}

/// One polynomial C.
#[derive(Clone, Copy, Debug)]
struct NoiseModel {
    nc: usize,
    c: [f64; ORDER],
}

/// Room for the lags of y' of the longest A, with lag 0.
const Y_COLUMNS: usize = ORDER;

impl Library {
    /// The library, with buffers for delays `1..=max_delay`.
    pub fn new(max_delay: usize) -> Self {
        let size = Y_COLUMNS + max_delay + ORDER - 2;
        Self {
            models: noise_models(),
            gram: vec![0.0; size * size],
            sums: vec![0.0; size],
            best: Vec::with_capacity(10 * max_delay),
            max_delay,
        }
    }

    /// The best model for every structure with `nc >= 1`, at the stem position `x - lag dir`.
    ///
    /// Losses are exact, except that 1/C of the constant is taken as constant from its first sample on.
    pub fn best_models(&mut self, work: &mut Workspace, s: &Signals<'_>, lag: f64) -> &[Candidate] {
        self.best.clear();
        work.load_stem(s, lag);
        for at in 0..self.models.len() {
            let noise = self.models[at];
            let base = self.base(noise.nc);
            if base == self.best.len() {
                self.add_structures(noise.nc);
            }
            self.multiply(work, s, noise);
            for i in base..base + (ORDER - 1 - noise.nc) * self.max_delay {
                let (theta, loss) = self.solve(self.best[i].orders, s.counted().rows(s.y.len()));
                let slot = &mut self.best[i];
                if loss < slot.loss {
                    *slot = Candidate { theta: Theta { c: noise.c, lag, ..theta }, loss, ..*slot };
                }
            }
        }
        &self.best
    }

    /// Index of the first structure with this `nc` in `best`.
    fn base(&self, nc: usize) -> usize {
        (1..nc).map(|nc| (ORDER - 1 - nc) * self.max_delay).sum()
    }

    /// Adds the structures with this `nc` to `best`, without a model yet.
    fn add_structures(&mut self, nc: usize) {
        for nk in 1..=self.max_delay {
            for na in 1..ORDER - nc {
                let orders = Orders { na, nb: ORDER - nc - na, nc, nk };
                self.best.push(Candidate { orders, theta: Theta::default(), loss: f64::INFINITY });
            }
        }
    }

    /// Computes the Gram matrix of the lags of y' and z' that the structures with this C have.
    fn multiply(&mut self, work: &mut Workspace, s: &Signals<'_>, noise: NoiseModel) {
        let [y, z] = work.divide_by_c(s, &noise.c[..noise.nc]);
        let y = Lags { v: y, from: 0, count: ORDER - noise.nc };
        let z = Lags { v: z, from: 1, count: self.max_delay + ORDER - noise.nc - 2 };
        let size = self.sums.len();
        products(y, y, s.counted(), true, &mut self.gram, size);
        products(z, y, s.counted(), false, &mut self.gram[Y_COLUMNS * size..], size);
        products(z, z, s.counted(), true, &mut self.gram[Y_COLUMNS * size + Y_COLUMNS..], size);
        sums(y, s.counted(), &mut self.sums[..y.count]);
        sums(z, s.counted(), &mut self.sums[Y_COLUMNS..]);
    }

    /// Least squares of y' on its lags, those of z' and a constant: a and b, and the mean square of the residual.
    fn solve(&self, orders: Orders, rows: usize) -> (Theta, f64) {
        /// Room for the coefficients of A and B, which C leaves fewer than all.
        const MOST: usize = ORDER;
        let size = self.sums.len();
        let n = orders.na + orders.nb;
        let per_row = 1.0 / rows as f64;
        let column = |i: usize| {
            if i < orders.na { 1 + i } else { Y_COLUMNS + orders.nk - 1 + i - orders.na }
        };
        let (mut g, mut right) = ([0.0; MOST * MOST], [0.0; MOST]);
        for i in 0..n {
            let ci = column(i);
            let centre = self.sums[ci] * per_row;
            for j in 0..=i {
                let cj = column(j);
                g[i * MOST + j] = self.gram[ci * size + cj] - centre * self.sums[cj];
            }
            right[i] = self.gram[ci * size] - centre * self.sums[0];
        }
        let mut solution = right;
        let mut live = [true; MOST_COLUMNS];
        factor(&mut g, MOST, n, &mut live);
        substitute(&g, MOST, &live, &mut solution[..n]);
        let total = self.gram[0] - self.sums[0] * self.sums[0] * per_row;
        let loss = (total - dot(&solution[..n], &right[..n])).max(0.0) * per_row;
        let mut theta = Theta::default();
        for (a, s) in theta.a[..orders.na].iter_mut().zip(&solution) {
            *a = -s;
        }
        theta.b[..orders.nb].copy_from_slice(&solution[orders.na..n]);
        // c0 stays 0: the minimisation finds it in its first step.
        (theta, if loss.is_finite() { loss } else { f64::INFINITY })
    }
}

/// Every C of the library, lower orders first.
fn noise_models() -> Vec<NoiseModel> {
    let real = |zero: f64| vec![1.0, -zero];
    let pair = |&(modulus, angle): &(f64, f64)| vec![1.0, -2.0 * modulus * angle.cos(), modulus * modulus];
    let together: Vec<Vec<f64>> = REAL_TOGETHER.map(real).into();
    let doubles = multisets(&together, 2);
    let pairs: Vec<Vec<f64>> = PAIRS.iter().map(pair).collect();
    let few_reals: Vec<Vec<f64>> = together.iter().step_by(THINNED).cloned().collect();
    let few: Vec<Vec<f64>> = pairs.iter().skip(1).step_by(THINNED).cloned().collect();
    let mut polynomials: Vec<Vec<f64>> = REAL.map(real).into();
    polynomials.extend(doubles.iter().chain(&pairs).cloned());
    polynomials.extend(SHARP.iter().map(pair));
    polynomials.extend(multisets(&together, 3));
    polynomials.extend(products_of(&together, &pairs));
    polynomials.extend(multisets(&few, 2));
    polynomials.extend(products_of(&multisets(&few_reals, 2), &few));
    let model = |polynomial: Vec<f64>| {
        let mut c = [0.0; ORDER];
        c[..polynomial.len() - 1].copy_from_slice(&polynomial[1..]);
        NoiseModel { nc: polynomial.len() - 1, c }
    };
    polynomials.into_iter().map(model).collect()
}

/// The products of every `size` factors, repetition allowed, order not.
fn multisets(factors: &[Vec<f64>], size: usize) -> Vec<Vec<f64>> {
    if size == 0 {
        return vec![vec![1.0]];
    }
    (0..factors.len())
        .flat_map(|i| products_of(&factors[i..=i], &multisets(&factors[..=i], size - 1)))
        .collect()
}

/// The products of every polynomial of `a` with every one of `b`.
fn products_of(a: &[Vec<f64>], b: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let product = |a: &[f64], b: &[f64]| {
        let mut product = vec![0.0; a.len() + b.len() - 1];
        for (i, x) in a.iter().enumerate() {
            for (j, y) in b.iter().enumerate() {
                product[i + j] += x * y;
            }
        }
        product
    };
    a.iter().flat_map(|a| b.iter().map(|b| product(a, b))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::armax::{RHO, is_inside};
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    #[test]
    fn the_library_has_no_duplicates_and_only_stable_models() {
        let library = noise_models();
        assert!(library.is_sorted_by_key(|model| model.nc));
        for (i, model) in library.iter().enumerate() {
            assert!((1..=ORDER - 2).contains(&model.nc) && is_inside(&model.c[..model.nc], RHO), "{model:?}");
            let same = |other: &NoiseModel| {
                other.nc == model.nc && other.c.iter().zip(&model.c).all(|(a, b)| (a - b).abs() < 1e-9)
            };
            assert!(!library[..i].iter().any(same), "{model:?} is there twice");
        }
    }

    /// A model whose C is in the library is found with its very C, and A and B to what noise allows.
    #[test]
    fn a_noise_model_of_the_library_is_recognised() {
        let (n, mut rng) = (3000, Pcg64Mcg::seed_from_u64(3));
        let mut uniform = || rng.random::<f64>() - 0.5;
        let model = noise_models()[20];
        assert_eq!(model.nc, 2);
        let x: Vec<f64> = (0..n).map(|k| (k as f64 * 0.05).sin() + uniform()).collect();
        let e: Vec<f64> = (0..n).map(|_| 0.1 * uniform()).collect();
        let mut y = vec![0.0; n];
        for k in 3..n {
            let noise = e[k] + model.c[0] * e[k - 1] + model.c[1] * e[k - 2];
            y[k] = 1.2 * y[k - 1] - 0.4 * y[k - 2] + 0.3 * x[k - 2] + 0.1 * x[k - 3] + noise;
        }
        let dir = vec![1.0; n];
        let s = Signals { y: &y, x: &x, dir: &dir, start: 0, first: 40, rows: Default::default() };
        let mut work = Workspace::new(n);
        let mut library = Library::new(4);
        let best = library.best_models(&mut work, &s, 0.0);
        let orders = Orders { na: 2, nb: 2, nc: 2, nk: 2 };
        let found = best.iter().find(|c| c.orders == orders).expect("every structure is there");
        assert_eq!(found.theta.c, model.c);
        // The standard error of a coefficient is about 0.1/sqrt(12 N) over the spread of its column, below 0.01.
        for (got, wanted) in found.theta.a.iter().zip([-1.2, 0.4]).chain(found.theta.b.iter().zip([0.3, 0.1]))
        {
            assert!((got - wanted).abs() < 0.02, "{got} {wanted}");
        }
        // The noise's variance is 0.1²/12, known to 1/sqrt(N / 2) = 3 %.
        assert!((found.loss * 1200.0 - 1.0).abs() < 0.1, "{}", found.loss);
        // All five splits with one, three with two, two with three and one with four coefficients in C, at each delay.
        assert_eq!(best.len(), 4 * (4 + 3 + 2 + 1));
    }
}
