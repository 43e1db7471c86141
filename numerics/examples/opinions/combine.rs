//! Whether a probability made of the verdict and the votes is better than the verdict alone.
//!
//! ```text
//! p = 1 / (1 + exp(-w'x))     w: most likely on the calibration's loops, less |w|²/2 but for the constant
//! ```
//!
//! x: 1, and for each that is asked whether it says `sticks` (1 or 0) and whether it says `sound` (1 or 0). Without the methods
//! p is the share of sticking loops among those with that verdict, nearly. Both are fitted on simulated loops alone, and
//! judged on others and on measured records by the log score `-ln p(label)` and Brier's `(p - label)²`, smaller is better.

use super::judged::Judged;
use super::simulated::{BENCHMARK, CALIBRATION, random};
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use stictiond_numerics::detectors::{Method, Says};

/// Steps of Newton's method; it is quadratic, and the penalty makes it converge.
const STEPS: usize = 30;
/// Resamples of the records for the interval of a difference.
const RESAMPLES: usize = 10_000;

/// What is told of a loop: by the verdict alone, or by everybody.
fn features(of: &Judged, votes: bool) -> Vec<f64> {
    let all = of.opinions.iter().filter(|o| votes && o.method != Method::StemLoop).map(|o| o.says);
    let each = all.chain([of.program]);
    let told = each.flat_map(|says| [says == Says::Sticks, says == Says::Sound]);
    std::iter::once(1.0).chain(told.map(f64::from)).collect()
}

/// The weights, by Newton's method.
fn fit(of: &[Judged], votes: bool) -> DVector<f64> {
    let rows: Vec<Vec<f64>> = of.iter().map(|j| features(j, votes)).collect();
    let (n, m) = (rows.len(), rows[0].len());
    let x = DMatrix::from_fn(n, m, |r, c| rows[r][c]);
    let label = DVector::from_fn(n, |r, _| f64::from(of[r].sticky));
    let penalty = DMatrix::from_diagonal(&DVector::from_fn(m, |c, _| f64::from(c > 0)));
    let mut w = DVector::zeros(m);
    for _ in 0..STEPS {
        let p = (&x * &w).map(|z: f64| 1.0 / (1.0 + (-z).exp()));
        let slope = x.tr_mul(&(&label - &p)) - &penalty * &w;
        let weight = DMatrix::from_diagonal(&p.map(|p| p * (1.0 - p)));
        let bend = x.tr_mul(&(weight * &x)) + &penalty;
        w += bend.cholesky().expect("the penalty makes it so").solve(&slope);
    }
    w
}

/// Log score and Brier's of each loop.
fn scores(of: &[Judged], w: &DVector<f64>, votes: bool) -> Vec<[f64; 2]> {
    let score = |j: &Judged| {
        let z: f64 = features(j, votes).iter().zip(w.iter()).map(|(x, w)| x * w).sum();
        let (p, label) = (1.0 / (1.0 + (-z).exp()), f64::from(j.sticky));
        [-(label * p + (1.0 - label) * (1.0 - p)).ln(), (p - label).powi(2)]
    };
    of.iter().map(score).collect()
}

/// The middle 95 % of the mean of a sample that is drawn anew.
fn interval(differences: &[f64]) -> [f64; 2] {
    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(1);
    let n = differences.len();
    let mean = |_| (0..n).map(|_| differences[random.random_range(0..n)]).sum::<f64>() / n as f64;
    let mut means: Vec<f64> = (0..RESAMPLES).map(mean).collect();
    means.sort_by(f64::total_cmp);
    [means[RESAMPLES / 40], means[RESAMPLES - 1 - RESAMPLES / 40]]
}

/// Prints both scores on loops that were not fitted, and what the votes change.
pub fn print(loops: u64, measured: &[(String, Vec<Judged>)], threads: usize) {
    let fitted = random(CALIBRATION, loops, threads);
    let (alone, voted) = (fit(&fitted, false), fit(&fitted, true));
    println!("\n### Combined: fitted on {} simulated loops from seed {CALIBRATION}\n", fitted.len());
    println!(
        "| judged on | log score: verdict alone | with the votes | difference, 95 % | Brier: verdict alone | with the votes | difference, 95 % |"
    );
    println!("|---|---|---|---|---|---|---|");
    let others = [("other simulated loops".to_string(), random(BENCHMARK, loops, threads))];
    for (name, of) in others.iter().chain(measured) {
        let (first, second) = (scores(of, &alone, false), scores(of, &voted, true));
        let cell = |at: usize| {
            let mean = |of: &[[f64; 2]]| of.iter().map(|s| s[at]).sum::<f64>() / of.len() as f64;
            let differences: Vec<f64> = first.iter().zip(&second).map(|(a, b)| b[at] - a[at]).collect();
            let [low, high] = interval(&differences);
            format!("{:.3} | {:.3} | {low:+.3} to {high:+.3}", mean(&first), mean(&second))
        };
        println!("| {name}, n {} | {} | {} |", of.len(), cell(0), cell(1));
    }
    reliability(&others[0].1, &voted);
}

/// How often loops stick, by the probability that the votes give them.
fn reliability(of: &[Judged], w: &DVector<f64>) {
    println!("\n| p with the votes | other simulated loops | of these stick |");
    println!("|---|---|---|");
    let p = |j: &Judged| {
        let z: f64 = features(j, true).iter().zip(w.iter()).map(|(x, w)| x * w).sum();
        1.0 / (1.0 + (-z).exp())
    };
    for tenth in 0..10 {
        let within = |j: &&Judged| (p(j) * 10.0).floor().min(9.0) as usize == tenth;
        let (n, stick) =
            of.iter().filter(within).fold((0, 0), |(n, stick), j| (n + 1, stick + usize::from(j.sticky)));
        println!("| {:.1} to {:.1} | {n} | {stick} |", tenth as f64 / 10.0, (tenth + 1) as f64 / 10.0);
    }
}
