//! From the number a device sends to the value of a tag: scale, offset, believable range, and what a mode means.

use super::Issue;
use crate::signal::{BadReason, Quality, Role};

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

/// The scale where the file has none.
pub(super) fn unscaled() -> f64 {
    1.0
}

impl Scaling {
    /// Everything wrong with it as the file has it, for a tag in this role (`None` for an extra tag).
    pub(super) fn validate(&self, role: Option<Role>) -> Vec<Issue> {
        let mut issues = Vec::new();
        let mut unless = |ok: bool, field: &'static str, message: String| {
            if !ok {
                issues.push(Issue { field, message });
            }
        };
        let mode = role == Some(Role::Mode);
        let ok = self.scale.is_finite() && self.scale != 0.0;
        unless(ok, "scale", format!("{} must be a number other than 0", self.scale));
        unless(self.offset.is_finite(), "offset", format!("{} must be a number", self.offset));
        if let Some([least, greatest]) = self.range {
            let ordered = least.is_finite() && greatest.is_finite() && least < greatest;
            let message = format!("[{least}, {greatest}] must be the least, then the greatest value");
            unless(ordered, "range", message);
        }
        if let Some(values) = &self.auto_values {
            unless(mode, "auto_values", "only a mode tag has them".into());
            unless(!values.is_empty(), "auto_values", "name at least one value".into());
        }
        for (field, plain) in
            [("scale", self.scale == 1.0), ("offset", self.offset == 0.0), ("range", self.range.is_none())]
        {
            unless(!mode || plain, field, "a mode is compared raw; write the raw auto_values".into());
        }
        issues
    }

    /// As the file has it, ready for a tag in this role.
    pub(super) fn in_role(self, role: Option<Role>) -> Self {
        let auto_values = (role == Some(Role::Mode)).then(|| self.auto_values.unwrap_or_default());
        Self { auto_values, ..self }
    }

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
