//! The window that is traced, and the settings for it.

use super::settings::Settings;
use crate::diagnosis::gate::{Gated, gate};
use crate::diagnosis::{self, Diagnosis, NotIdentifiable, Verdict, prepare};
use crate::signal::{Record, Window, span_at_least};

/// Most samples traced: longer records are cut to the stretch around the diagnosed window.
const MOST_SAMPLES: usize = 2000;

/// The window to trace. It is the whole gated record at the sample period of the diagnosis, or 2,000 samples around the diagnosed
/// window where there are more. The diagnosis looks at the most regular stretch only, but a change outside that stretch is an
/// effect, too.
///
/// `None` where the gate refuses the record, or where its rows are not samples of the moving loop.
pub fn window(record: &Record, diagnosis: &Diagnosis, settings: &diagnosis::Settings) -> Option<Window> {
    window_of(&gate(record, settings), diagnosis)
}

/// The [`window()`] of a record that is gated already.
pub(super) fn window_of(gated: &Gated, diagnosis: &Diagnosis) -> Option<Window> {
    use NotIdentifiable::{TsTooShort, Undersampled};
    // Repeated readings would count as evidence, and an oscillation that is too fast is aliased: no model of such rows is valid.
    if let Verdict::NotIdentifiable(TsTooShort { .. } | Undersampled { .. }) = &diagnosis.verdict {
        return None;
    }
    // An archive that drew lines chose their ends, and nothing else was measured. They may show friction, and are not enough for any
    // other effect.
    if diagnosis.preparation.is_drawn() && diagnosis.verdict != Verdict::Stiction {
        return None;
    }
    let (gated, _) = gated.as_ref().ok()?;
    let factor = diagnosis.preparation.decimation.max(1);
    let whole = if factor > 1 { prepare::decimate(gated, factor) } else { gated.clone() };
    let n = whole.len();
    if n <= MOST_SAMPLES {
        return Some(whole);
    }
    let p = &diagnosis.preparation;
    let middle = (0.5 * (p.start + p.end) - whole.t0) / whole.ts;
    let middle = if middle.is_finite() { middle.clamp(0.0, n as f64) as usize } else { n };
    let from = middle.saturating_sub(MOST_SAMPLES / 2).min(n - MOST_SAMPLES);
    Some(whole.slice(from, from + MOST_SAMPLES))
}

/// The settings for tracing one window of a record. The threshold of f is converted from per cent of OP's span, as the diagnosis has
/// it, to OP units. It is the same for every window of a record.
///
/// * `traced`, `covered`: the windows that are traced, and that the diagnosis looked at.
pub(super) fn settings_of(
    record: &Record,
    [traced, covered]: [&Window; 2],
    diagnosed: &diagnosis::Settings,
    settings: &Settings,
) -> Settings {
    let op_span = record.known_span();
    Settings {
        f_threshold: 0.01 * diagnosed.f_threshold * span_at_least(op_span, &covered.op),
        op_span,
        evidence_threshold: diagnosed.evidence_threshold,
        compensated: record.compensated(traced),
        ..settings.clone()
    }
}
