//! What tracing says of a case, beside what is true.

use super::plant::{Case, Undeclared, record};
use stictiond::diagnosis::{self, Verdict, diagnose};
use stictiond::residual::{self, Findings, Kind, trace_record};

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
            let only = residual::Settings { only: Some(kind), most_effects: 1, ..Default::default() };
            trace(only).map(|t| t.after.free_run_rmse)
        }
        _ => None,
    };
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
        told,
    }
}
