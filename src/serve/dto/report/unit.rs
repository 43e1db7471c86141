//! The unit of everything that is measured along OP.

use super::super::finite;
use crate::diagnosis::Diagnosis;
use crate::results::{f_unit, op_in_percent};

/// The unit along OP, and what turns OP units into it.
///
/// Whether OP is in per cent is [`op_in_percent`]'s to say; without a span it is an assumption and is marked.
pub(super) struct OpUnit {
    pub(super) name: &'static str,
    pub(super) assumed: bool,
    /// `f_unit` per OP unit.
    factor: f64,
}

impl OpUnit {
    pub(super) fn new(op_span: Option<f64>, diagnosis: &Diagnosis) -> Self {
        let known = op_span.filter(|span| span.is_finite() && *span > 0.0);
        let name = f_unit(op_in_percent(op_span, diagnosis));
        Self { name, assumed: known.is_none(), factor: known.map_or(1.0, |span| 100.0 / span) }
    }

    pub(super) fn scale(&self, value: f64) -> Option<f64> {
        finite(value * self.factor)
    }
}
