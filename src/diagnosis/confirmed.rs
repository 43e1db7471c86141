//! A diagnosis without a search, for a record whose model is known: tracing confirmed that the model of the last run still fits.

use super::friction::stick_slip;
use super::result::{CurvePoint, Diagnosis, Estimate, Model, Residual, Verdict};
use super::rivals::Rival;
use super::search::{CellPoint, Problem, Searcher};
use super::verdict::{Prepared, best_d};
use crate::sysid::stats::range;

/// Number of points of the AIC curve over f: as many as the paper's grid has.
const POINTS: usize = super::grid::GRID;

/// The results that are known, in the plant's units.
#[derive(Clone, Debug)]
pub struct Known {
    /// The verdict.
    pub verdict: Verdict,
    /// The verdict in one line for an operator, with what an archive did to the data.
    pub reason: String,
    /// Friction f (OP unit).
    pub f: f64,
    /// 95 % interval of f (OP unit).
    pub f_ci95: [f64; 2],
    /// Evidence for friction (-).
    pub delta_aic: f64,
    /// The model.
    pub model: Model,
    /// Its errors on held-out samples.
    pub residual: Residual,
}

/// The diagnosis of a prepared record with known results.
///
/// The AIC curve over f is that of the long ARX. The steadiness is NaN, because only the search computes it.
pub fn confirmed(prepared: Prepared, known: Known) -> Diagnosis {
    let Prepared { window, preparation, oscillation, problem, scale, .. } = prepared;
    let (low, high) = range(&window.op);
    let estimate = Estimate {
        f: known.f,
        f_ci95: known.f_ci95,
        f_of_op_range: known.f / (high - low),
        delta_aic: known.delta_aic,
        rival: Rival::Linear,
        steadiness: f64::NAN,
        f_max: problem.f_top * scale.u,
        d: best_d(&problem) * scale.u,
        curve: curve(&problem, scale.u),
        model: known.model,
        mv: stem(&problem, known.f / scale.u).iter().map(|x| x * scale.u + scale.u0).collect(),
    };
    Diagnosis {
        verdict: known.verdict,
        reason: known.reason,
        preparation,
        oscillation,
        estimate: Some(estimate),
        residual: Some(known.residual),
        window: Some(window),
        packed: None,
    }
}

/// The stem of the paper's element at f (unit of the problem's OP).
fn stem(p: &Problem, f: f64) -> Vec<f64> {
    let (mut x, mut dir) = (p.u.clone(), vec![0.0; p.u.len()]);
    stick_slip(&p.u, f, 0.0, p.start, &mut x, &mut dir);
    x
}

/// The AIC curve over f; `unit` is the standard deviation of OP (OP unit).
fn curve(p: &Problem, unit: f64) -> Vec<CurvePoint> {
    let cells = Searcher::new(p).profile(0.0, 0.0, p.f_top, POINTS);
    let least = cells.iter().map(|cell| cell.loss).fold(f64::INFINITY, f64::min);
    let point =
        |cell: &CellPoint| CurvePoint { f: cell.f() * unit, aic: p.rows() * (cell.loss / least).ln() };
    cells.iter().map(point).collect()
}
