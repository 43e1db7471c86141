//! How far to trace, and what is known already.

use super::findings::Kind;

/// How far to trace, and what is known already.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Most effects that are added to one model.
    pub most_effects: usize,
    /// Least f that counts as stiction (OP unit).
    pub f_threshold: f64,
    /// Least evidence that counts as stiction (-).
    pub evidence_threshold: f64,
    /// The one effect that is known to be there, as in calibration: it is searched for more thoroughly than the others.
    pub only: Option<Kind>,
    /// The span of OP (OP unit), where it is known: sentences are then in per cent of it.
    pub op_span: Option<f64>,
    /// f = S/2 and J of the valve (OP unit), where they are known, as in calibration: the search starts from them, too.
    pub friction: Option<(f64, Option<f64>)>,
    /// Share of the traced window in which a term of write-back was in force (0..1): such a term hides friction.
    pub compensated: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            most_effects: 3,
            f_threshold: 0.05,
            evidence_threshold: 20.0,
            only: None,
            op_span: None,
            friction: None,
            compensated: 0.0,
        }
    }
}
