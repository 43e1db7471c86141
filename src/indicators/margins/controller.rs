//! The controller of a loop, identified from what it made of the error.
//!
//! ```text
//! OP[k] - OP[k-1] = q0 e[k] + q1 e[k-1] + q2 e[k-2],   e = SP - PV        by least squares
//! ```
//!
//! It is the velocity form of a PI or PID controller at its own sample period: with the gain K, the integral time Ti, the derivative
//! time Td and the sample period ts, q0 = K (1 + ts/Ti + Td/ts), q1 = -K (1 + 2 Td/ts) and q2 = K Td/ts. Rows that were filled in, and
//! those at a limit of OP, do not count.
//!
//! Source: Åström & Hägglund, Advanced PID Control, 2006 (velocity form).

use crate::signal::{Row, Window};
use crate::sysid::least_squares::{MOST_COLUMNS, dot, factor, substitute};

/// Least share of OP's moves that the controller must explain (-): what is left is then at most a third as large as what is explained.
const EXPLAINED: f64 = 0.9;
/// Fewest rows: three coefficients do not explain so many by chance.
const LEAST_ROWS: usize = 100;
/// Distance from a limit of OP that counts as at the limit, as a part of the span between both: OP may be rounded there.
const AT: f64 = 1e-3;

/// `q0`, `q1` and `q2` (OP unit per PV unit); none without a set point, and where they do not explain how OP moves, as in manual.
pub fn controller(window: &Window, op_limits: Option<(f64, f64)>) -> Option<[f64; 3]> {
    let (op, pv) = (&window.op, &window.pv);
    let sp = window.sp.as_ref().filter(|sp| sp.len() == op.len() && pv.len() == op.len())?;
    let e = |k: usize| sp[k] - pv[k];
    let is_at_limit = |k: usize| {
        op_limits.is_some_and(|(low, high)| {
            let near = AT * (high - low);
            op[k] <= low + near || op[k] >= high - near
        })
    };
    let is_free = |k: usize| window.row(k) == Row::Counts && !is_at_limit(k);
    let counts = |k: &usize| is_free(*k) && is_free(k - 1) && window.row(k - 2) != Row::Missing;
    let (mut columns, mut moves) = ([const { Vec::new() }; 3], Vec::new());
    for k in (2..op.len()).filter(counts) {
        let [now, last, before] = [e(k), e(k - 1), e(k - 2)];
        // Differences of neighbours, because the values themselves are nearly collinear.
        let row = [now, now - last, now - 2.0 * last + before];
        columns.iter_mut().zip(row).for_each(|(column, value)| column.push(value));
        moves.push(op[k] - op[k - 1]);
    }
    if moves.len() < LEAST_ROWS {
        return None;
    }
    let mut gram: Vec<f64> = (0..9).map(|at| dot(&columns[at / 3], &columns[at % 3])).collect();
    let mut theta = columns.each_ref().map(|column| dot(column, &moves));
    let mut live = [true; MOST_COLUMNS];
    factor(&mut gram, 3, 3, &mut live);
    substitute(&gram, 3, &live, &mut theta);
    let left: f64 = moves
        .iter()
        .enumerate()
        .map(|(k, moved)| moved - columns.iter().zip(&theta).map(|(column, q)| q * column[k]).sum::<f64>())
        .map(|left| left * left)
        .sum();
    let [integral, gain, derivative] = theta;
    let is_explained = left <= (1.0 - EXPLAINED) * dot(&moves, &moves) && theta.iter().any(|q| *q != 0.0);
    is_explained.then_some([integral + gain + derivative, -gain - 2.0 * derivative, derivative])
}
