//! Where the fit starts: Hannan–Rissanen, the errors of the high-order ARX in place of those nobody knows yet.

use super::{Armax, LONGEST_DELAY, ORDER, Signals};
use crate::sysid::arx::ArxFit;
use crate::sysid::gram::{lower, products};
use crate::sysid::iddata::IdData;
use crate::sysid::least_squares::{MOST_COLUMNS, dot, factor, substitute};

/// A model to start from, and the weighted mean square that its regression leaves.
#[derive(Clone, Debug)]
pub struct Start {
    /// The model.
    pub model: Armax,
    /// Mean square of the regression.
    pub loss: f64,
}

/// A start for every delay, the best first.
///
/// * `long`: the high-order ARX of the same signals, whose weights are used.
pub fn hannan_rissanen(
    data: &IdData,
    y: &[f64],
    signals: &Signals,
    long: &ArxFit,
    theta: &[f64],
) -> Vec<Start> {
    let rows = data.rows();
    let mut e = vec![0.0; data.split];
    e[rows.clone()].copy_from_slice(&long.e);
    let root: Vec<f64> = long.omega.iter().map(|omega| omega.sqrt()).collect();
    let late = |v: &[f64], lag: usize, sign: f64| -> Vec<f64> {
        rows.clone().zip(&root).map(|(k, root)| sign * root * v[k - lag]).collect()
    };
    let mut columns: Vec<Vec<f64>> = (1..=ORDER).map(|lag| late(y, lag, -1.0)).collect();
    columns.extend((1..=ORDER).map(|lag| late(&e, lag, 1.0)));
    columns.push(root.clone());
    columns.extend(signals.shapes.iter().map(|shape| late(shape, 0, 1.0)));
    let fixed = columns.len();
    columns.extend((1..LONGEST_DELAY + ORDER).map(|lag| late(&signals.x, lag, 1.0)));
    columns.push(late(y, 0, 1.0));
    let all: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
    let size = all.len() - 1;
    let (mut g, mut right) = (vec![0.0; size * size], vec![0.0; size]);
    lower(&all[..fixed], &mut g, size);
    // A model has three neighbouring lags of x, so products of lags farther apart are not needed.
    for (at, few) in all[fixed..size].chunks(4).enumerate() {
        let at = fixed + 4 * at;
        products(few, &all[..fixed], |i, j, sum| g[(at + i) * size + j] = sum);
        let near = fixed.max(at - (ORDER - 1).min(at));
        products(few, &all[near..at + few.len()], |i, j, sum| g[(at + i) * size + near + j] = sum);
    }
    products(&all[size..], &all[..size], |_, i, sum| right[i] = sum);
    let power = dot(all[size], all[size]);
    let count: f64 = long.omega.iter().sum::<f64>().max(1.0);
    let start = |nk: usize| -> Start {
        let which: Vec<usize> = (0..fixed).chain((0..ORDER).map(|j| fixed + nk - 1 + j)).collect();
        let order = which.len();
        let mut part = vec![0.0; order * order];
        for (i, &row) in which.iter().enumerate() {
            for (j, &column) in which[..=i].iter().enumerate() {
                part[i * order + j] = g[row * size + column];
            }
        }
        let own: Vec<f64> = which.iter().map(|i| right[*i]).collect();
        let mut found = own.clone();
        let mut live = [true; MOST_COLUMNS];
        factor(&mut part, order, order, &mut live);
        substitute(&part, order, &live, &mut found);
        let loss = (power - dot(&own, &found)).max(0.0) / count;
        let three = |from: usize| [found[from], found[from + 1], found[from + 2]];
        let model = Armax {
            nk,
            a: three(0),
            c: three(ORDER),
            c0: found[2 * ORDER],
            gamma: found[2 * ORDER + 1..fixed].to_vec(),
            b: three(fixed),
            theta: theta.to_vec(),
            scale: long.scale,
            nu: long.nu,
            log_likelihood: f64::NEG_INFINITY,
        };
        Start { model, loss }
    };
    let mut starts: Vec<Start> = (1..=LONGEST_DELAY).map(start).collect();
    starts.sort_by(|a, b| a.loss.total_cmp(&b.loss));
    starts
}
