//! What is left to see of the friction of a valve while a term of write-back acts.

use super::{Judged, Run, f_unit, op_in_percent};
use crate::diagnosis::{NotIdentifiable, Verdict, without_model_error};
use crate::signal::told;

/// Share of f by which two estimates of the same friction may lie apart beside their intervals: an f within a tenth is what a
/// record is expected to tell.
const APART: f64 = 0.1;

/// Friction as the last diagnosis found it before a term acted, in the unit of [`Summary::f`](super::Summary::f).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Before {
    /// f.
    pub f: f64,
    /// Its 95 % interval.
    pub f_ci95: [f64; 2],
}

/// How what is seen now agrees with before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seen {
    /// The valve sticks as it did, or nothing is known of before.
    Consistent,
    /// It sticks, more or less than it did.
    Changed,
    /// The term hides it.
    Hidden,
}

impl Seen {
    /// Every way.
    pub const ALL: [Seen; 3] = [Seen::Consistent, Seen::Changed, Seen::Hidden];

    /// As the report writes it.
    pub fn as_str(self) -> &'static str {
        match self {
            Seen::Consistent => "consistent",
            Seen::Changed => "changed",
            Seen::Hidden => "no_longer_visible",
        }
    }
}

/// What a run says of a compensated valve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Compensated {
    /// f as of before; `None` where no diagnosis of before is known.
    pub f_before: Option<f64>,
    /// How it agrees.
    pub seen: Seen,
}

impl Compensated {
    /// Of a run in whose window a term acted.
    pub fn of(run: &Run) -> Option<Self> {
        let judged = run.judged().filter(|own| is_compensated(own))?;
        let before = run.basis.as_ref().and_then(|basis| basis.before);
        let found = judged.friction().filter(|_| run.sticks());
        let found = found.map(|(f, interval, _)| Before {
            f: f * run.percent(),
            f_ci95: interval.map(|limit| limit * run.percent()),
        });
        let seen = match (found, before) {
            (None, _) => Seen::Hidden,
            (Some(now), Some(before)) if !meet(&now, &before) => Seen::Changed,
            _ => Seen::Consistent,
        };
        Some(Self { f_before: before.map(|before| before.f), seen })
    }

    /// What a reason begins with.
    pub fn reason(&self, run: &Run) -> String {
        let unit = f_unit(op_in_percent(run.op_span));
        let before =
            self.f_before.map(|f| format!("; f {} {unit} as of before", told(f))).unwrap_or_default();
        match (self.seen, self.f_before) {
            (Seen::Consistent, Some(_)) => format!("compensated{before}, still consistent"),
            (Seen::Consistent, None) => "compensated; f of before is not known".to_string(),
            (Seen::Changed, _) => format!("compensated{before}, no longer consistent"),
            (Seen::Hidden, Some(_)) => format!("compensated{before}, no longer visible"),
            (Seen::Hidden, None) => "compensated; friction is not visible".to_string(),
        }
    }
}

/// Whether a term acted in the window of the diagnosis, or hides friction in the longer one that was traced.
fn is_compensated(judged: &Judged) -> bool {
    let hides = Verdict::NotIdentifiable(NotIdentifiable::Compensated);
    judged.diagnosis.preparation.compensated > 0.0 || *judged.verdict() == hides
}

/// Whether two intervals, each widened by a share of its f, overlap. They are compared without the error of the models, which is the
/// same for both.
fn meet(a: &Before, b: &Before) -> bool {
    let wide = |own: &Before| {
        let [low, high] = without_model_error(own.f, own.f_ci95);
        [low.min(own.f) - APART * own.f, high.max(own.f) + APART * own.f]
    };
    let ([a_low, a_high], [b_low, b_high]) = (wide(a), wide(b));
    a_low <= b_high && b_low <= a_high
}
