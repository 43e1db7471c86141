//! The result of a diagnosis: the types that other modules read.

use super::not_identifiable::NotIdentifiable;
use super::packed::PackedWindow;
use super::preparation::Preparation;
use super::rivals::Rival;
use crate::signal::Window;
use crate::sysid::stats::range;
use std::borrow::Cow;

/// What the record says about the valve.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// f and its evidence are above their thresholds, and 0 lies outside the interval of f. The diagnosis also asks that the
    /// evidence is steady, tracing also that PV follows the stem.
    Stiction,
    /// OP moved enough for friction to show, and one of the conditions of stiction does not hold: no friction is needed, or f is
    /// too small to matter. By the diagnosis alone, also where its interval reaches 0. The evidence for friction may still be large.
    NoStiction,
    /// The record cannot tell, for this reason. It does not mean that the valve is sound.
    NotIdentifiable(NotIdentifiable),
}

impl Verdict {
    /// The verdict as the report writes it.
    pub fn as_str(&self) -> &'static str {
        match self {
            Self::Stiction => "stiction",
            Self::NoStiction => "no_stiction",
            Self::NotIdentifiable(_) => "not_identifiable",
        }
    }

    /// Whether friction is likelier than not, without enough evidence for a verdict.
    pub fn is_undecided(&self) -> bool {
        matches!(self, Self::NotIdentifiable(NotIdentifiable::Undecided { .. }))
    }
}

/// The most regular oscillation found in OP.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Oscillation {
    /// Mean period (s).
    pub period: f64,
    /// `r = mean(T) / (3 sd(T))` (-); above 1 the oscillation is regular.
    pub regularity_r: f64,
    /// Half the mean peak-to-trough height of OP (OP unit).
    pub op_amplitude: f64,
}

/// The ARMAX model `A(q) y = B(q) x + C(q) e` at the estimate, with OP in its unit and PV in its own.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// Order of A.
    pub na: usize,
    /// Number of coefficients in B.
    pub nb: usize,
    /// Order of C.
    pub nc: usize,
    /// Delay (samples): `B(q) = b1 q^-nk + … + b_nb q^-(nk+nb-1)`.
    pub nk: usize,
    /// `a1..a_na`.
    pub a: Vec<f64>,
    /// `b1..b_nb`.
    pub b: Vec<f64>,
    /// `c1..c_nc`.
    pub c: Vec<f64>,
    /// Root mean square of the prediction error (PV unit).
    pub rmse: f64,
}

/// One point of the AIC curve over f.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurvePoint {
    /// Friction (OP unit).
    pub f: f64,
    /// AIC at that f, less the AIC at the estimate (-).
    pub aic: f64,
}

/// The estimate of f and its uncertainty.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// Friction parameter, S/2 (OP unit).
    pub f: f64,
    /// 95 % interval of f: that of the profile likelihood, with the error of the valve models (OP unit).
    pub f_ci95: [f64; 2],
    /// f as a share of OP's range in the window (-).
    pub f_of_op_range: f64,
    /// Evidence against the best explanation without friction (-).
    pub delta_aic: f64,
    /// The best explanation without friction.
    pub rival: Rival,
    /// Whether all of the record shares the evidence: the mean gain of a block in standard errors (-).
    pub steadiness: f64,
    /// Largest f that was tried (OP unit).
    pub f_max: f64,
    /// Srinivasan's d of the same window, for comparison (OP unit).
    pub d: f64,
    /// AIC over f, by increasing f.
    pub curve: Vec<CurvePoint>,
    /// The ARMAX model at f.
    pub model: Model,
    /// The stem position that f implies, one value for each sample of the window (OP unit).
    pub mv: Vec<f64>,
}

/// How well a model predicts PV (PV unit).
///
/// Both errors are of held-out samples, to which no coefficient was fitted: the last 30 % of the window in a diagnosis, whose f,
/// orders and delay come from the whole window, and the last 20 % of the record in tracing, where they also reject effects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// Whether Ljung–Box does not reject that the residual of all samples that count, fitted ones too, is white.
    pub white: bool,
    /// Root mean square one-step-ahead error on held-out data.
    pub one_step_rmse: f64,
    /// Root mean square free-run (simulation) error on held-out data.
    pub free_run_rmse: f64,
}

/// The result of a diagnosis.
#[derive(Clone, Debug, PartialEq)]
pub struct Diagnosis {
    /// The verdict.
    pub verdict: Verdict,
    /// The verdict in one line for an operator, with its numbers.
    pub reason: String,
    /// How the record was prepared; the default where it did not become a window.
    pub preparation: Preparation,
    /// The oscillation of OP, where one was found.
    pub oscillation: Option<Oscillation>,
    /// f and its evidence; `None` only where not identifiable.
    pub estimate: Option<Estimate>,
    /// The errors of the model; `None` where not identifiable.
    pub residual: Option<Residual>,
    /// The window that was fitted; `None` where the record did not become one, or where it is packed.
    pub window: Option<Window>,
    /// The window in little memory, once the diagnosis is kept only for display ([`Diagnosis::pack`]).
    pub packed: Option<Box<PackedWindow>>,
}

impl Diagnosis {
    /// A verdict and its reason alone, where no window was fitted.
    pub fn bare(verdict: Verdict, reason: impl Into<String>) -> Self {
        Self {
            verdict,
            reason: reason.into(),
            preparation: Preparation::default(),
            oscillation: None,
            estimate: None,
            residual: None,
            window: None,
            packed: None,
        }
    }

    /// Packs the window and the stem of a diagnosis that is kept only for display.
    pub fn pack(&mut self) {
        if let Some(window) = self.window.take() {
            let stem = self.estimate.as_mut().map(|estimate| std::mem::take(&mut estimate.mv));
            self.packed = Some(Box::new(PackedWindow::new(window, &stem.unwrap_or_default())));
        }
    }

    /// The window that was fitted, packed or not; `None` where the record did not become one.
    pub fn shown_window(&self) -> Option<Cow<'_, Window>> {
        let packed = || self.packed.as_ref().map(|packed| Cow::Owned(packed.window()));
        self.window.as_ref().map(Cow::Borrowed).or_else(packed)
    }

    /// The stem position that the f of the declared model implies, packed or not, one value for each sample of the window (OP
    /// unit).
    pub fn shown_stem(&self) -> Option<Cow<'_, [f64]>> {
        let estimate = self.estimate.as_ref()?;
        Some(match &self.packed {
            Some(packed) => Cow::Owned(packed.stem.values()),
            None => Cow::Borrowed(&estimate.mv),
        })
    }

    /// The least and the greatest OP of the window (OP unit); `None` without a window.
    pub fn op_range(&self) -> Option<(f64, f64)> {
        let packed = || self.packed.as_ref().map(|packed| packed.op_range);
        self.window.as_ref().map(|window| range(&window.op)).or_else(packed)
    }
}
