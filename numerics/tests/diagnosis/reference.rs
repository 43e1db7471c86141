//! The prediction-error variance against a slow reference written here: every split and delay from several random
//! stable starts, its own recursions, its own Levenberg–Marquardt; only the constraint on C is shared.

use super::common::labelled::labelled;
use super::common::measured::{FOLDER, readable};
use super::common::parallel;
use super::common::pose::pose;
use super::common::records::simulated;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use stictiond_numerics::diagnosis::armax::{LOSS_FLOOR, Orders, RHO, draw_inside, splits};
use stictiond_numerics::diagnosis::friction::stick_slip;
use stictiond_numerics::diagnosis::grid::GRID;
use stictiond_numerics::diagnosis::search::{Problem, Refined, Searcher};
use stictiond_numerics::sim::scenarios::{calibration, random_sound, random_sticky};

/// Random starts of each structure.
const STARTS: usize = 4;
const ITERATIONS: usize = 40;
/// a, b, c, c0, lag.
const MOST: usize = 8;

/// One structure at one stem position; the parameters are `a.., b.., c.., c0` and, with friction, the lag.
struct Reference<'a> {
    p: &'a Problem,
    x: &'a [f64],
    dir: &'a [f64],
    orders: Orders,
    most_lag: f64,
}

impl Reference<'_> {
    fn size(&self) -> usize {
        7 + usize::from(self.most_lag > 0.0)
    }

    /// Back inside the constraints.
    fn constrain(&self, theta: &mut [f64; MOST]) {
        let o = self.orders;
        draw_inside(&mut theta[o.na + o.nb..6], RHO);
        theta[7] = theta[7].clamp(0.0, self.most_lag);
    }

    /// The loss, and with `jacobian` the gradient of every counted error.
    // Loops count by hand: barely optimised, as tests are, a range's steps would be most of the time.
    fn evaluate(&self, theta: &[f64; MOST], jacobian: Option<&mut Vec<[f64; MOST]>>) -> (f64, Vec<f64>) {
        let Orders { na, nb, nc, nk } = self.orders;
        let (y, x, dir, n): (&[f64], _, _, _) = (&self.p.y, self.x, self.dir, self.p.y.len());
        let (first_b, first_c, slopes) = (na, na + nb, jacobian.is_some());
        let (mut errors, mut gradients) = (vec![0.0; n], vec![[0.0; MOST]; if slopes { n } else { 0 }]);
        let (e, psi): (&mut [f64], &mut [[f64; MOST]]) = (&mut errors, &mut gradients);
        let mut k = self.p.start.index + 1 + na.max(nk + nb - 1);
        while k < n {
            let (mut value, mut row) = (y[k] - theta[6], [0.0; MOST]);
            row[6] = -1.0;
            let mut i = 0;
            while i < na {
                value += theta[i] * y[k - 1 - i];
                row[i] = y[k - 1 - i];
                i += 1;
            }
            let mut j = 0;
            while j < nb {
                let (at, b) = (k - nk - j, theta[first_b + j]);
                let z = x[at] - theta[7] * dir[at];
                value -= b * z;
                row[first_b + j] = -z;
                row[7] += b * dir[at];
                j += 1;
            }
            let mut l = 0;
            while l < nc && l < k {
                let (c, past) = (theta[first_c + l], k - 1 - l);
                value -= c * e[past];
                row[first_c + l] -= e[past];
                let mut i = 0;
                while slopes && i < MOST {
                    row[i] -= c * psi[past][i];
                    i += 1;
                }
                l += 1;
            }
            e[k] = value;
            if slopes {
                psi[k] = row;
            }
            k += 1;
        }
        if let Some(out) = jacobian {
            *out = gradients.split_off(self.p.first);
        }
        let counted = errors.split_off(self.p.first);
        let loss = counted.iter().map(|e| e * e).sum::<f64>() / counted.len() as f64;
        (if loss.is_finite() { loss } else { f64::INFINITY }, counted)
    }

    fn minimise(&self, mut theta: [f64; MOST]) -> f64 {
        self.constrain(&mut theta);
        let mut jacobian = Vec::new();
        let (mut loss, mut e) = self.evaluate(&theta, Some(&mut jacobian));
        let mut damping = 1e-2;
        for _ in 0..ITERATIONS {
            let (normal, gradient) = normal(&jacobian, &e);
            let before = loss;
            while damping < 1e10 {
                let step = solve(&normal, &gradient, self.size(), damping);
                let mut candidate = theta;
                for (t, s) in candidate.iter_mut().zip(step) {
                    *t -= s;
                }
                self.constrain(&mut candidate);
                if self.evaluate(&candidate, None).0 < loss {
                    theta = candidate;
                    damping *= 0.2;
                    break;
                }
                damping *= 5.0;
            }
            (loss, e) = self.evaluate(&theta, Some(&mut jacobian));
            // A hundredth of what the comparison tells apart.
            if before - loss < 1e-5 * before {
                break;
            }
        }
        loss
    }

    /// Random poles and zeros of C, b and the lag at random.
    fn start(&self, rng: &mut Pcg64Mcg) -> [f64; MOST] {
        let Orders { na, nb, nc, .. } = self.orders;
        let mut theta = [0.0; MOST];
        theta[..na].copy_from_slice(&polynomial(rng, na));
        theta[na + nb..6].copy_from_slice(&polynomial(rng, nc));
        theta[na..na + nb].iter_mut().for_each(|b| *b = 0.4 * rng.random::<f64>() - 0.2);
        theta[7] = self.most_lag * rng.random::<f64>();
        theta
    }
}

/// The coefficients behind the leading 1 of a polynomial with random zeros of modulus below 0.95.
fn polynomial(rng: &mut Pcg64Mcg, order: usize) -> Vec<f64> {
    let mut poly = vec![1.0];
    let mut multiply = |factor: &[f64]| {
        let mut product = vec![0.0; poly.len() + factor.len() - 1];
        for (i, a) in poly.iter().enumerate() {
            for (j, b) in factor.iter().enumerate() {
                product[i + j] += a * b;
            }
        }
        poly = product;
    };
    for _ in 0..order / 2 {
        let (r, phase) = (0.95 * rng.random::<f64>(), std::f64::consts::PI * rng.random::<f64>());
        multiply(&[1.0, -2.0 * r * phase.cos(), r * r]);
    }
    if order % 2 == 1 {
        multiply(&[1.0, 0.95 * (1.0 - 1.5 * rng.random::<f64>())]);
    }
    poly.split_off(1)
}

type Matrix = [[f64; MOST]; MOST];

fn normal(jacobian: &[[f64; MOST]], e: &[f64]) -> (Matrix, [f64; MOST]) {
    let (mut matrix, mut gradient) = ([[0.0; MOST]; MOST], [0.0; MOST]);
    let mut k = 0;
    while k < e.len() {
        let (row, e) = (&jacobian[k], e[k]);
        let mut i = 0;
        while i < MOST {
            gradient[i] += row[i] * e;
            let mut j = 0;
            while j < MOST {
                matrix[i][j] += row[i] * row[j];
                j += 1;
            }
            i += 1;
        }
        k += 1;
    }
    (matrix, gradient)
}

/// Gauss elimination with pivoting of the damped normal equations of the first `n` parameters.
fn solve(normal: &Matrix, gradient: &[f64; MOST], n: usize, damping: f64) -> [f64; MOST] {
    let (mut m, mut r) = (*normal, *gradient);
    for (i, row) in m.iter_mut().enumerate().take(n) {
        row[i] += damping * row[i] + 1e-300;
    }
    for i in 0..n {
        let pivot = (i..n).max_by(|&a, &b| m[a][i].abs().total_cmp(&m[b][i].abs())).unwrap_or(i);
        m.swap(i, pivot);
        r.swap(i, pivot);
        for k in i + 1..n {
            let factor = m[k][i] / m[i][i];
            let above = m[i];
            for (value, above) in m[k][i..n].iter_mut().zip(&above[i..n]) {
                *value -= factor * above;
            }
            r[k] -= factor * r[i];
        }
    }
    let mut step = [0.0; MOST];
    for i in (0..n).rev() {
        let known: f64 = (i + 1..n).map(|j| m[i][j] * step[j]).sum();
        step[i] = (r[i] - known) / m[i][i];
    }
    if step.iter().all(|s| s.is_finite()) { step } else { [0.0; MOST] }
}

/// The least loss over every structure and start at the friction of `refined`, whose it is, and the least of the
/// very structure that the search chose.
fn reference(p: &Problem, refined: &Refined) -> (f64, Orders, f64) {
    let n = p.y.len();
    let (mut x, mut dir) = (vec![0.0; n], vec![0.0; n]);
    stick_slip(&p.u, refined.f, refined.resume, p.start, &mut x, &mut dir);
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let mut best = (f64::INFINITY, refined.fit.orders, f64::INFINITY);
    for orders in (1..=p.max_delay).flat_map(splits) {
        let structure = Reference { p, x: &x, dir: &dir, orders, most_lag: refined.f };
        for _ in 0..STARTS {
            let loss = structure.minimise(structure.start(&mut rng));
            if loss < best.0 {
                (best.0, best.1) = (loss, orders);
            }
            if orders == refined.fit.orders {
                best.2 = best.2.min(loss);
            }
        }
    }
    best
}

/// Models over 0.1 % above the reference today, and the worst ratio: a sinusoidal load whose zeros lie on the bound of C,
/// where the drawn steps stop short. The goal is none.
const MISSED: usize = 1;
const WORST: f64 = 1.03;

#[test]
fn no_random_start_finds_a_model_that_is_better() {
    let records = (0..8)
        .map(calibration)
        .chain((0..6).map(random_sticky))
        .chain((0..12).map(random_sound))
        .map(|scenario| (scenario.truth.kind.clone(), simulated(&scenario)))
        .chain(
            labelled(FOLDER, readable)
                .into_iter()
                .filter(|(row, _)| row[0] == "isdb")
                .map(|(row, r)| (row[1].clone(), r)),
        );
    // A reference on windows of several thousand samples takes minutes and shows nothing more.
    let problems: Vec<(String, Problem)> = records
        .filter_map(|(name, record)| pose(&record).map(|(p, _)| (name, p)))
        .filter(|(_, p)| p.y.len() <= 2000)
        .collect();
    assert!(problems.len() >= 20, "only {} records", problems.len());
    let compared = parallel::each(&problems, |(_, p)| {
        let mut searcher = Searcher::new(p);
        let grid = searcher.grid(GRID);
        let cells = searcher.full_profile();
        let (sound, sticky) = searcher.refine(&grid, &cells);
        [Some(sound), sticky].into_iter().flatten().map(|r| (r, reference(p, &r))).collect::<Vec<_>>()
    });
    let mut worse = Vec::new();
    for ((name, _), models) in problems.iter().zip(&compared) {
        for (r, (least, orders, own)) in models {
            let ratio = (r.fit.loss + LOSS_FLOOR) / (least + LOSS_FLOOR);
            let split = |o: &Orders| format!("{}{}{} nk {:2}", o.na, o.nb, o.nc, o.nk);
            let line = format!(
                "{name:60} f {:.4}: V {:.6e} ({}), reference {least:.6e} ({}): {:+.3} %, by its start {:+.3} %",
                r.f,
                r.fit.loss,
                split(&r.fit.orders),
                split(orders),
                100.0 * (ratio - 1.0),
                100.0 * ((r.fit.loss + LOSS_FLOOR) / (own + LOSS_FLOOR) - 1.0)
            );
            println!("{line}");
            assert!(ratio < WORST, "{line}");
            // The promise of the project.
            if ratio > 1.001 {
                worse.push(line);
            }
        }
    }
    assert!(worse.len() <= MISSED, "{}:\n{}", worse.len(), worse.join("\n"));
}
