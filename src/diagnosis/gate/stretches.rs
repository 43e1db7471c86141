//! Stretches of time in which a tag is there, or the loop in automatic.

use crate::signal::Sample;

/// A hole of more than this many sample periods ends a stretch: what the stem did meanwhile nobody knows.
const LONGEST_HOLE: f64 = 60.0;
/// A mode that cannot be read is the last known one for so many sample periods: a few lost polls are no change of mode.
const MODE_LOST: f64 = 6.0;

/// Stretches `[from, to]` of samples without a long hole (s).
pub fn runs(kept: &[Sample], ts: f64) -> Vec<(f64, f64)> {
    let mut found: Vec<(f64, f64)> = Vec::new();
    for s in kept {
        match found.last_mut() {
            Some(last) if s.t - last.1 <= LONGEST_HOLE * ts => last.1 = s.t,
            _ => found.push((s.t, s.t)),
        }
    }
    found
}

/// Stretches in automatic, and the share of samples in automatic. A change of mode takes effect at its stamp; a mode that
/// cannot be read is the last known one for a while.
pub fn automatic(mode: &[Sample], ts: f64) -> (Vec<(f64, f64)>, f64) {
    let mut samples: Vec<Sample> = mode.iter().filter(|s| s.t.is_finite()).copied().collect();
    samples.sort_by(|a, b| a.t.total_cmp(&b.t));
    let known = |s: &Sample| s.quality.is_good() && s.value.is_finite();
    let mut found = Vec::new();
    let mut open: Option<f64> = None;
    let mut lost: Option<f64> = None;
    for s in &samples {
        if !known(s) {
            lost.get_or_insert(s.t);
        }
        let overdue = lost.filter(|since| s.t - since > MODE_LOST * ts);
        let until = if known(s) && s.value < 0.5 { Some(overdue.unwrap_or(s.t)) } else { overdue };
        if let (Some(from), Some(until)) = (open, until) {
            found.push((from, until - 1e-3 * ts));
            open = None;
        }
        if known(s) {
            lost = None;
            if s.value >= 0.5 {
                open = open.or(Some(s.t));
            }
        }
    }
    if let Some(from) = open {
        // The last known mode holds until something else is known.
        found.push((from, f64::INFINITY));
    }
    let in_automatic = samples.iter().filter(|s| known(s) && s.value >= 0.5).count();
    (found, in_automatic as f64 / samples.len().max(1) as f64)
}

/// The overlaps of two ordered lists of stretches.
pub fn intersect(a: &[(f64, f64)], b: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let (mut i, mut j) = (0, 0);
    let mut found = Vec::new();
    while i < a.len() && j < b.len() {
        let (from, to) = (a[i].0.max(b[j].0), a[i].1.min(b[j].1));
        if from <= to {
            found.push((from, to));
        }
        if a[i].1 < b[j].1 { i += 1 } else { j += 1 }
    }
    found
}
