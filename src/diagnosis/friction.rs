//! The friction elements of the declared diagnosis, from OP to a stem position: the paper's one-parameter element, its extension by
//! a slip jump, and Srinivasan's d element.
//!
//! Tracing uses a recursion with more parameters: `sysid/valve/recursion.rs`.
//!
//! Source: Ivan & Lakshminarayanan, Ind. Eng. Chem. Res. 2009, 48, 3474, section 3.2 and figure 3;
//! Srinivasan et al., Ind. Eng. Chem. Res. 2005, 44, 6719, equation 1.

pub use crate::sysid::valve::{Start, largest_reversal, reversals};

/// The range of f, `[lo, hi)`, over which the element gives one and the same stem.
///
/// Sampled data cannot tell the values of f in one cell apart: this is the resolution of f.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Least f of the cell (OP unit).
    pub lo: f64,
    /// First f beyond the cell (OP unit); infinite when the valve never slips back.
    pub hi: f64,
}

/// Runs OP through the one-parameter element, or its extension by a resume threshold. Returns the [`Cell`] of f.
///
/// ```text
/// cum = u_r + (u[k] - u[k-1])
/// |cum| > f :  x[k] = u[k],    u_r = sign(cum) f
/// otherwise :  x[k] = x[k-1],  u_r = cum
/// ```
///
/// The same is computed as follows, because this gives the cell as well: a moving stem follows u without lag; after a reversal it
/// stays until u has come back by more than 2f. A stem that stopped without a reversal goes on in the same direction once u is more
/// than `resume * 2f` ahead. With `resume = 0` this is the paper's element. `resume = J/S` is the two-parameter valve of Choudhury
/// and Kano, which noise on OP stops often.
///
/// * `u`: OP, N values (OP unit).
/// * `f`: friction, S/2 (OP unit).
/// * `resume`: J/S, 0..=1 (-).
/// * `x`: receives OP at the last move of the stem, N values (OP unit); before `start` the stem follows OP.
/// * `dir`: receives the direction of that move, N values, +1 or -1.
///
/// The stem of a valve with a slip jump J is `x - dir (S - J)/2`.
pub fn stick_slip(u: &[f64], f: f64, resume: f64, start: Start, x: &mut [f64], dir: &mut [f64]) -> Cell {
    let n = u.len().min(x.len()).min(dir.len());
    let mut cell = Cell { lo: 0.0, hi: f64::INFINITY };
    if start.index >= n {
        x[..n].copy_from_slice(&u[..n]);
        dir[..n].fill(1.0);
        return cell;
    }
    let mut direction = if start.is_max { 1.0 } else { -1.0 };
    x[..=start.index].copy_from_slice(&u[..=start.index]);
    dir[..=start.index].fill(direction);
    let mut stem = u[start.index];
    let mut moving = resume == 0.0;
    let per_resume = if resume > 0.0 { 0.5 / resume } else { f64::INFINITY };
    let (band, ahead) = (2.0 * f, 2.0 * f * resume);
    for k in start.index + 1..n {
        let onward = direction * (u[k] - stem);
        if onward > 0.0 {
            if moving || onward > ahead {
                if !moving {
                    cell.hi = cell.hi.min(onward * per_resume);
                }
                stem = u[k];
                moving = true;
            } else {
                cell.lo = cell.lo.max(onward * per_resume);
            }
        } else if -onward > band {
            cell.hi = cell.hi.min(-0.5 * onward);
            stem = u[k];
            direction = -direction;
            moving = true;
        } else {
            cell.lo = cell.lo.max(-0.5 * onward);
            moving = resume == 0.0;
        }
        x[k] = stem;
        dir[k] = direction;
    }
    cell
}

/// Runs OP through Srinivasan's element: the stem jumps to OP whenever OP is more than `d` away.
///
/// ```text
/// x[k] = x[k-1]  if |u[k] - x[k-1]| <= d,   u[k] otherwise
/// ```
///
/// * `u`: OP, N values (OP unit).
/// * `d`: stick band (OP unit).
/// * `x`: receives the stem position, N values (OP unit).
pub fn srinivasan(u: &[f64], d: f64, x: &mut [f64]) {
    let Some(&first) = u.first() else { return };
    let mut stem = first;
    for (x, &u) in x.iter_mut().zip(u) {
        if (u - stem).abs() > d {
            stem = u;
        }
        *x = stem;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The element exactly as the paper's figure 3 states it: the oracle.
    fn paper(u: &[f64], f: f64, start: Start) -> Vec<f64> {
        let mut x = u.to_vec();
        let mut residual = if start.is_max { f } else { -f };
        for k in start.index + 1..u.len() {
            let cum = residual + (u[k] - u[k - 1]);
            if cum.abs() > f {
                x[k] = u[k];
                residual = cum.signum() * f;
            } else {
                x[k] = x[k - 1];
                residual = cum;
            }
        }
        x
    }

    fn run(u: &[f64], f: f64, start: Start) -> (Vec<f64>, Vec<f64>, Cell) {
        let (mut x, mut dir) = (vec![0.0; u.len()], vec![0.0; u.len()]);
        let cell = stick_slip(u, f, 0.0, start, &mut x, &mut dir);
        (x, dir, cell)
    }

    #[test]
    fn sticks_for_2f_on_a_reversal_and_then_follows_without_lag() {
        let u = [0.0, 3.0, 2.0, 1.0, 0.5, 0.0, -1.0, -0.5, 0.0, 1.0, 1.5, 2.0];
        let (x, dir, cell) = run(&u, 1.0, Start { index: 1, is_max: true });
        assert_eq!(x, [0.0, 3.0, 3.0, 3.0, 0.5, 0.0, -1.0, -1.0, -1.0, -1.0, 1.5, 2.0]);
        assert_eq!(dir, [1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0, -1.0, -1.0, -1.0, 1.0, 1.0]);
        // Stuck at an excursion of 2, slipped at 2.5: any f in [1, 1.25) gives this very stem.
        assert_eq!(cell, Cell { lo: 1.0, hi: 1.25 });
    }

    #[test]
    fn no_friction_is_no_element() {
        let u = [0.0, 1.0, 0.5, 0.5, 2.0, -1.0];
        assert_eq!(run(&u, 0.0, Start { index: 1, is_max: true }).0, u);
    }

    #[test]
    fn a_stopped_stem_resumes_beyond_its_slip_jump() {
        // S = 2, J = 1: stops at 3, is 0.5 ahead at 3.5, goes on at 4.5.
        let u = [0.0, 3.0, 2.5, 3.5, 4.5, 5.0, 2.5];
        let (mut x, mut dir) = ([0.0; 7], [0.0; 7]);
        let cell = stick_slip(&u, 1.0, 0.5, Start { index: 1, is_max: true }, &mut x, &mut dir);
        assert_eq!(x, [0.0, 3.0, 3.0, 3.0, 4.5, 5.0, 2.5]);
        assert_eq!(reversals(&dir), 1);
        // Stuck 0.5 ahead (f >= 0.5), resumed 1.5 ahead (f < 1.5), reversed at 2.5 (f < 1.25).
        assert_eq!(cell, Cell { lo: 0.5, hi: 1.25 });
    }

    #[test]
    fn srinivasan_jumps_when_further_than_d() {
        let mut x = [0.0; 6];
        srinivasan(&[0.0, 0.5, 1.0, 1.1, 1.5, -1.0], 1.0, &mut x);
        assert_eq!(x, [0.0, 0.0, 0.0, 1.1, 1.1, -1.0]);
    }

    proptest! {
        // Steps of 1/8 keep both statements exact in floating point, so they must agree to the bit.
        #[test]
        fn agrees_with_the_paper(steps in prop::collection::vec(-16i32..=16, 2..200), f in 0i32..40, max: bool) {
            let u: Vec<f64> = steps.iter().scan(0, |s, d| { *s += d; Some(f64::from(*s) / 8.0) }).collect();
            let start = Start { index: 0, is_max: max };
            let f = f64::from(f) / 8.0;
            prop_assert_eq!(run(&u, f, start).0, paper(&u, f, start));
        }

        #[test]
        fn one_cell_is_one_stem(
            steps in prop::collection::vec(-16i32..=16, 2..200), f in 0.0..4.0f64, resume in 0usize..3,
        ) {
            let resume = [0.0, 0.5, 1.0][resume];
            let run = |u: &[f64], f: f64, start: Start| {
                let (mut x, mut dir) = (vec![0.0; u.len()], vec![0.0; u.len()]);
                let cell = stick_slip(u, f, resume, start, &mut x, &mut dir);
                (x, dir, cell)
            };
            let u: Vec<f64> = steps.iter().scan(0, |s, d| { *s += d; Some(f64::from(*s) / 8.0) }).collect();
            let start = Start { index: 0, is_max: true };
            let (x, _, cell) = run(&u, f, start);
            prop_assert!(cell.lo <= f && f < cell.hi);
            let top = if cell.hi.is_finite() { cell.hi } else { cell.lo + 1.0 };
            let (low, _, low_cell) = run(&u, cell.lo, start);
            prop_assert_eq!(low, x.clone());
            prop_assert_eq!(low_cell, cell);
            let (high, _, _) = run(&u, 0.5 * (cell.lo + top), start);
            prop_assert_eq!(high, x.clone());
            if cell.hi.is_finite() {
                prop_assert_ne!(run(&u, cell.hi, start).0, x);
            }
        }
    }
}
