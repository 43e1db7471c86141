//! The unit of everything that is measured along OP.

use super::super::finite;
use crate::results::{f_unit, op_in_percent};

/// The unit along OP, and what turns OP units into it: per cent of the span where [`op_in_percent`] says that it is known.
pub(super) struct OpUnit {
    pub(super) name: &'static str,
    pub(super) assumed: bool,
    /// `f_unit` per OP unit.
    factor: f64,
}

impl OpUnit {
    pub(super) fn new(op_span: Option<f64>) -> Self {
        let known = op_span.filter(|_| op_in_percent(op_span));
        let name = f_unit(known.is_some());
        Self { name, assumed: known.is_none(), factor: known.map_or(1.0, |span| 100.0 / span) }
    }

    pub(super) fn scale(&self, value: f64) -> Option<f64> {
        finite(value * self.factor)
    }
}
