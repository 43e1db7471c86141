//! What tracing says of a case, beside what is true.

use super::plant::{Case, Undeclared, record};
use stictiond_numerics::diagnosis::{self, Verdict, diagnose};
use stictiond_numerics::residual::{self, Findings, Kind, trace_record};

/// Effects that are worth something at the valve.
pub const LOADS: [Kind; 4] = [Kind::OscillatingLoad, Kind::MeasuredDisturbance, Kind::LoadStep, Kind::Drift];

/// What was found on one case.
pub struct Judged {
    pub case: Case,
    /// Effects in the order they were added.
    pub named: Vec<Kind>,
    /// Whether anything could be traced at all.
    pub traced: bool,
    pub unexplained: bool,
    /// Whether the valve's S and J differ.
    pub slips: bool,
    /// Whether the verdict is stiction: the diagnosis' and that with the effects.
    pub sticks: [bool; 2],
    /// True f (% OP), the diagnosis' and that with the effects.
    pub f: [f64; 3],
    /// Held-out errors one step ahead before and after.
    pub one: [f64; 2],
    /// Held-out free-run errors before and after.
    pub free: [f64; 2],
    /// Free-run error of the fit that was told the effect, where asked for.
    pub told: Option<f64>,
    /// The size of a load at the valve as that fit has it, as a share of the true one.
    pub size: Option<f64>,
}

impl Judged {
    pub fn first(&self) -> Option<Kind> {
        self.named.first().copied()
    }
    /// What was named beside the true effect; a slip jump of a valve with S ≠ J is true.
    pub fn invented(&self) -> Vec<Kind> {
        let is_true =
            |k: Kind| (k == Kind::SlipJump && self.slips) || self.case.undeclared == Undeclared::Listed(k);
        self.named.iter().copied().filter(|k| !is_true(*k)).collect()
    }
}

/// Diagnoses and traces a case; `told`: also by a fit that knows the effect.
pub fn judge(case: &Case, told: bool) -> Judged {
    let (record, truth) = record(case);
    let settings = diagnosis::Settings::default();
    let d = diagnose(&record, &settings);
    let trace = |of: residual::Settings| trace_record(&record, &d, &settings, &of);
    let found = trace(residual::Settings::default());
    let told = match case.undeclared {
        Undeclared::Listed(kind) if told => {
            trace(residual::Settings { only: Some(kind), most_effects: 1, ..Default::default() })
        }
        _ => None,
    };
    let seconds =
        record.op.last().map_or(0.0, |last| last.t) - record.op.first().map_or(0.0, |first| first.t);
    let size = told.as_ref().and_then(|t| size(t, seconds)).zip(truth.load);
    let before = d.estimate.as_ref().map_or(0.0, |e| e.f);
    let read = |get: &dyn Fn(&Findings) -> [f64; 2]| found.as_ref().map_or([f64::NAN; 2], get);
    let after = found.as_ref().map_or(&d.verdict, |f| &f.verdict);
    Judged {
        case: *case,
        named: found.iter().flat_map(|f| &f.effects).map(|e| e.kind).collect(),
        traced: found.is_some(),
        unexplained: found.as_ref().is_some_and(|f| f.unexplained),
        slips: truth.slips,
        sticks: [&d.verdict, after].map(|verdict| *verdict == Verdict::Stiction),
        f: [truth.f, before, found.as_ref().map_or(before, |t| t.friction_after.f)],
        one: read(&|t| [t.before.one_step_rmse, t.after.one_step_rmse]),
        free: read(&|t| [t.before.free_run_rmse, t.after.free_run_rmse]),
        told: told.map(|t| t.after.free_run_rmse),
        size: size.map(|(told, load)| told / load),
    }
}

/// What the first effect, a load, is worth at the valve (OP): as the plant counts it, of a ramp its rise over the record.
fn size(found: &Findings, seconds: f64) -> Option<f64> {
    let effect = found.effects.first()?;
    let (parameter, times) = match effect.kind {
        Kind::LoadStep => ("size_op", 1.0),
        Kind::OscillatingLoad => ("amplitude_op", 1.0),
        Kind::MeasuredDisturbance => ("op_per_sd", 1.0),
        Kind::Drift => ("rate_op_per_s", seconds),
        _ => return None,
    };
    effect.parameters.iter().find(|p| p.name == parameter).map(|p| p.value * times)
}
