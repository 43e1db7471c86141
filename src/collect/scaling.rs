//! From the number a device sends to the value of a tag: scale, offset, believable range, and what a mode means.

use crate::signal::{BadReason, Quality};

/// A value and whether to believe it; the value is NaN when there is none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// In the tag's unit.
    pub value: f64,
    /// Good, or bad and why.
    pub quality: Quality,
}

impl Reading {
    /// No value, and why.
    pub fn bad(reason: BadReason) -> Self {
        Self { value: f64::NAN, quality: Quality::Bad(reason) }
    }
}

/// What a raw number means.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Scaling {
    pub(super) scale: f64,
    pub(super) offset: f64,
    pub(super) range: Option<[f64; 2]>,
    /// Of a mode tag: the raw values that mean automatic; empty for anything but 0.
    pub(super) auto_values: Option<Vec<i64>>,
}

impl Scaling {
    /// value = scale * raw + offset. `bad:not_a_number` when that is not finite, `bad:out_of_range` (with
    /// the value) when it lies outside the range. A mode is 1 in automatic, else 0.
    pub(super) fn read(&self, raw: f64) -> Reading {
        if let Some(auto_values) = &self.auto_values {
            return mode(raw, auto_values);
        }
        let value = raw * self.scale + self.offset;
        if !value.is_finite() {
            return Reading::bad(BadReason::NotANumber);
        }
        let outside = self.range.is_some_and(|[least, greatest]| value < least || value > greatest);
        let quality = if outside { Quality::Bad(BadReason::OutOfRange) } else { Quality::Good };
        Reading { value, quality }
    }
}

fn mode(raw: f64, auto_values: &[i64]) -> Reading {
    if !raw.is_finite() {
        return Reading::bad(BadReason::NotANumber);
    }
    let auto = match auto_values {
        [] => raw != 0.0,
        values => values.iter().any(|value| *value as f64 == raw),
    };
    Reading { value: f64::from(u8::from(auto)), quality: Quality::Good }
}
