//! Every fast sum against the plain one: columns built one by one, least squares by QR.

use super::*;
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;

const MAX_DELAY: usize = 4;

/// A stuck-and-slipping x with its direction, and a y that answers `x - 0.3 dir` with noise.
struct Case {
    y: Vec<f64>,
    x: Vec<f64>,
    dir: Vec<f64>,
    first: usize,
}

const LAG: f64 = 0.3;

impl Case {
    fn new(seed: u64, noise: f64) -> Self {
        let n = 400;
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let (mut x, mut dir, mut y) = (vec![0.0; n], vec![1.0; n], vec![0.0; n]);
        for k in 2..n {
            // Up for 15 samples, then down, stuck for a random few of them.
            let up = (k / 15) % 2 == 0;
            let moves = rng.random::<f64>() < 0.6;
            let step = if up { 0.2 } else { -0.2 };
            x[k] = if moves { x[k - 1] + step * (0.5 + rng.random::<f64>()) } else { x[k - 1] };
            dir[k] = if moves { step.signum() } else { dir[k - 1] };
            let e: f64 = StandardNormal.sample(&mut rng);
            y[k] = 1.2 * y[k - 1] - 0.4 * y[k - 2] + 0.5 * (x[k - 2] - LAG * dir[k - 2]) + noise * e + 0.1;
        }
        Self { y, x, dir, first: Screen::lead(MAX_DELAY) }
    }

    fn signals(&self) -> Signals<'_> {
        Signals {
            y: &self.y,
            x: &self.x,
            dir: &self.dir,
            start: 0,
            first: self.first,
            rows: Default::default(),
        }
    }

    fn z(&self, lag: f64) -> Vec<f64> {
        self.x.iter().zip(&self.dir).map(|(x, d)| x - lag * d).collect()
    }

    fn column(&self, v: &[f64], lag: usize) -> DVector<f64> {
        DVector::from_iterator(self.y.len() - self.first, (self.first..self.y.len()).map(|k| v[k - lag]))
    }

    /// Lags 1.. of y and of z, and the constant.
    fn long_columns(&self, lag: f64) -> Vec<DVector<f64>> {
        let z = self.z(lag);
        let nx = Screen::input_lags(MAX_DELAY);
        (1..=LONG_Y)
            .map(|l| self.column(&self.y, l))
            .chain((1..=nx).map(|l| self.column(&z, l)))
            .chain([DVector::repeat(self.y.len() - self.first, 1.0)])
            .collect()
    }

    /// Least squares of y on the columns by QR: coefficients and residual.
    fn least_squares(&self, columns: &[DVector<f64>]) -> (DVector<f64>, DVector<f64>) {
        let matrix = DMatrix::from_columns(columns);
        let y = self.column(&self.y, 0);
        let qr = matrix.clone().qr();
        let right = qr.q().transpose() * &y;
        let theta = qr.r().solve_upper_triangular(&right).expect("the columns are independent");
        let residual = y - matrix * &theta;
        (theta, residual)
    }

    fn long_loss(&self, lag: f64) -> f64 {
        let (_, e) = self.least_squares(&self.long_columns(lag));
        e.norm_squared() / e.len() as f64
    }

    fn loaded(&self) -> Screen {
        let mut screen = Screen::new(&self.y, Counted { first: self.first, left_out: &[] }, MAX_DELAY);
        screen.load(&self.signals(), true);
        screen
    }
}

/// Rounding in sums of 400 products of order 1, and through normal equations of condition 1e5.
const EXACT: f64 = 1e-9;

#[test]
fn the_gram_matrix_is_the_naive_one() {
    let case = Case::new(1, 0.05);
    let mut screen = case.loaded();
    let lag = 0.17;
    screen.load_errors(&case.signals(), lag);
    // ê from outside: the residual of the long ARX, over the E_LAGS samples before `first` too.
    let (theta, _) = case.least_squares(&case.long_columns(lag));
    let (z, nx) = (case.z(lag), Screen::input_lags(MAX_DELAY));
    let mut e = vec![0.0; case.y.len()];
    for k in case.first - E_LAGS..case.y.len() {
        let by_y: f64 = (0..LONG_Y).map(|l| theta[l] * case.y[k - 1 - l]).sum();
        let by_z: f64 = (0..nx).map(|l| theta[LONG_Y + l] * z[k - 1 - l]).sum();
        e[k] = case.y[k] - by_y - by_z - theta[LONG_Y + nx];
    }
    let columns: Vec<DVector<f64>> = (0..=LONG_Y)
        .map(|l| case.column(&case.y, l))
        .chain((1..=nx).map(|l| case.column(&z, l)))
        .chain((1..=E_LAGS).map(|l| case.column(&e, l)))
        .collect();
    assert_eq!(screen.size, columns.len());
    for (i, a) in columns.iter().enumerate() {
        assert!((screen.sums[i] - a.sum()).abs() < EXACT * a.len() as f64, "sum {i}");
        for (j, b) in columns[..=i].iter().enumerate() {
            let got = screen.gram[i * screen.size + j];
            let bound = EXACT * (a.norm() * b.norm() + 1.0);
            assert!((got - a.dot(b)).abs() < bound, "{i} {j}: {got} {}", a.dot(b));
        }
    }
}

#[test]
fn the_long_arx_is_least_squares_at_any_lag() {
    for seed in 0..5 {
        let case = Case::new(seed, 0.05);
        let mut screen = case.loaded();
        for lag in [0.0, 0.1, LAG, 0.8] {
            screen.set_lag(lag);
            let (got, wanted) = (screen.long_arx(), case.long_loss(lag));
            assert!((got / wanted - 1.0).abs() < EXACT, "{seed} {lag}: {got} {wanted}");
            let (theta, _) = case.least_squares(&case.long_columns(lag));
            for (got, wanted) in screen.solution.iter().zip(theta.iter().take(LONG_Y + screen.nx)) {
                assert!((got - wanted).abs() < 1e-7, "{seed} {lag}: {got} {wanted}");
            }
        }
        let columns: Vec<DVector<f64>> = (1..=LONG_Y)
            .map(|l| case.column(&case.y, l))
            .chain([DVector::repeat(case.y.len() - case.first, 1.0)])
            .collect();
        let (_, e) = case.least_squares(&columns);
        let wanted = e.norm_squared() / e.len() as f64;
        assert!((screen.without_input() / wanted - 1.0).abs() < EXACT);
    }
}

#[test]
fn hannan_rissanen_is_least_squares_on_the_long_residual() {
    let case = Case::new(7, 0.05);
    let lag = 0.2;
    let mut screen = case.loaded();
    screen.load_errors(&case.signals(), lag);
    let e = screen.e.clone();
    let z = case.z(lag);
    let mut count = 0;
    screen.clone().fit_all(|got| {
        let o = got.orders;
        let columns: Vec<DVector<f64>> = (1..=o.na)
            .map(|l| case.column(&case.y, l))
            .chain((0..o.nb).map(|j| case.column(&z, o.nk + j)))
            .chain((1..=o.nc).map(|l| case.column(&e, l)))
            .chain([DVector::repeat(case.y.len() - case.first, 1.0)])
            .collect();
        let (theta, residual) = case.least_squares(&columns);
        let wanted = residual.norm_squared() / residual.len() as f64;
        assert!((got.loss / wanted - 1.0).abs() < EXACT, "{o:?}: {} {wanted}", got.loss);
        let t = got.theta;
        let list = t.a[..o.na].iter().map(|a| -a).chain(t.b[..o.nb].iter().copied());
        let list = list.chain(t.c[..o.nc].iter().copied()).chain([t.c0]);
        for (got, wanted) in list.zip(theta.iter()) {
            assert!((got - wanted).abs() < 1e-7, "{o:?}: {got} {wanted}");
        }
        count += 1;
    });
    assert_eq!(count, 15 * MAX_DELAY);
}

#[test]
fn the_lag_is_the_best_of_a_fine_grid() {
    for seed in 0..10 {
        let case = Case::new(20 + seed, 0.05);
        let max = 1.0;
        let found = case.loaded().fit_lag(0.5, max);
        let grid = (0..=1000).map(|i| max * f64::from(i) / 1000.0);
        let (best, at) = grid
            .map(|lag| (case.long_loss(lag), lag))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .expect("a grid has points");
        // The grid itself is 1e-3 wide, as is the rule at which the steps stop.
        assert!((found.lag - at).abs() <= 3e-3, "{seed}: {} {at}", found.lag);
        assert!((found.loss / best - 1.0).abs() < 1e-4, "{seed}: {} {best}", found.loss);
    }
}

#[test]
fn without_noise_the_lag_and_the_model_are_exact() {
    let case = Case::new(3, 0.0);
    let mut screen = case.loaded();
    let found = screen.fit_lag(0.1, 1.0);
    // The steps stop within 1e-3 of the largest lag; Gauss–Newton is far closer by then.
    assert!((found.lag - LAG).abs() < 1e-3, "{}", found.lag);
    screen.load_errors(&case.signals(), LAG);
    let got = screen.fit(Orders { na: 2, nb: 4, nc: 0, nk: 1 }).theta;
    for (got, wanted) in [(got.a[0], -1.2), (got.a[1], 0.4), (got.b[1], 0.5), (got.b[0], 0.0), (got.c0, 0.1)]
    {
        assert!((got - wanted).abs() < 1e-6, "{got} {wanted}");
    }
}

#[test]
fn the_lag_stays_within_its_bounds() {
    let case = Case::new(4, 0.05);
    let mut screen = case.loaded();
    assert!(screen.fit_lag(0.0, 0.1).lag <= 0.1);
    assert_eq!(screen.fit_lag(0.5, 0.0).lag, 0.0);
    screen.load(&case.signals(), false);
    assert_eq!(screen.fit_lag(0.5, 1.0).lag, 0.0);
}

#[test]
fn ranking_gives_the_losses_of_the_fits() {
    let case = Case::new(5, 0.05);
    let s = case.signals();
    let mut screen = Screen::new(&case.y, s.counted(), MAX_DELAY);
    screen.load(&s, true);
    screen.load_errors(&s, LAG);
    let mut fitted = Vec::new();
    screen.fit_all(|c| fitted.push((c.orders, c.loss)));
    let mut ranked = Vec::new();
    screen.rank_all(|orders, loss| ranked.push((orders, loss)));
    fitted.sort_by_key(|(orders, _)| *orders);
    ranked.sort_by_key(|(orders, _)| *orders);
    assert_eq!(fitted.len(), ranked.len());
    for ((a, fit), (b, rank)) in fitted.iter().zip(&ranked) {
        // The same Cholesky factor in another order of operations.
        assert!(a == b && (fit - rank).abs() < 1e-9 * fit, "{a:?} {fit} {rank}");
    }
}

#[test]
fn rows_that_are_left_out_are_in_no_product() {
    let case = Case::new(5, 0.05);
    let left_out: Vec<usize> = (case.first + 3..case.y.len()).filter(|k| k % 9 < 2).collect();
    let counted = Counted { first: case.first, left_out: &left_out };
    let (y, x) = (Lags { v: &case.y, from: 0, count: 4 }, Lags { v: &case.x, from: 1, count: 3 });
    let rows: Vec<usize> = (case.first..case.y.len()).filter(|k| !left_out.contains(k)).collect();
    assert_eq!(rows.len(), counted.rows(case.y.len()));
    let mut out = [0.0; 12];
    products(x, y, counted, false, &mut out, 4);
    let mut of_x = [0.0; 3];
    sums(x, counted, &mut of_x);
    for i in 0..3 {
        let sum: f64 = rows.iter().map(|k| case.x[k - 1 - i]).sum();
        assert!((of_x[i] - sum).abs() < EXACT);
        for j in 0..4 {
            let product: f64 = rows.iter().map(|k| case.x[k - 1 - i] * case.y[k - j]).sum();
            assert!((out[i * 4 + j] - product).abs() < EXACT, "{i} {j}");
        }
    }
}
