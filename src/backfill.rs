//! Diagnoses over the past: a long record cut into windows, each diagnosed as the daemon would have at its end.
//!
//! The effects found in one window are known to the next, and the alarm follows its k-of-n rule, so that the timeline says
//! what the daemon would have said, and when a valve began to stick. Pure: no clock, no file.

mod past;

pub use past::{Part, Past};

use crate::alarm;
use crate::diagnosis::{HistoryFound, Settings};
use crate::results::{Judged, KnownEffect, Outcome, Results, Run, Structure, Summary, Trigger};
use crate::signal::{BadReason, Limits, LoopId, Quality, Record, Sample, are_measured, outages};

/// Most windows of one timeline.
pub const MOST_WINDOWS: usize = 100_000;
/// Samples of a window where its length is not given.
const USUAL_SAMPLES: f64 = 1500.0;
/// Windows that overlap where the step is not given.
const USUAL_OVERLAP: f64 = 4.0;

/// How the past is cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cut {
    /// Length of a window (s).
    pub window_s: f64,
    /// From the end of one window to the end of the next (s).
    pub step_s: f64,
}

/// One window of the past.
#[derive(Clone, Debug, PartialEq)]
pub struct Item {
    /// Begin of the window (s).
    pub from: f64,
    /// Its end, when the diagnosis would have been made (s).
    pub to: f64,
    /// What was said.
    pub summary: Summary,
    /// Effects in the model.
    pub effects: Vec<KnownEffect>,
    /// Good samples of PV over those that its sample period asks for (0..1).
    pub good_share: f64,
    /// What an archive did to its samples, where that shows.
    pub history: Option<HistoryFound>,
}

/// A stretch in which the alarm's condition held.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Raised {
    /// When it was raised (s).
    pub from: f64,
    /// When it was cleared (s); `None` where it held at the end.
    pub to: Option<f64>,
}

/// What the past says of one loop.
#[derive(Clone, Debug, PartialEq)]
pub struct Timeline {
    /// Time of the first sample of PV (s).
    pub begin: f64,
    /// How it was cut.
    pub cut: Cut,
    /// The windows, oldest first.
    pub items: Vec<Item>,
    /// The alarms.
    pub raised: Vec<Raised>,
    /// Samples of OP and of PV that are drop-outs, to zero or to a value that stands for none, marked bad and not fitted.
    pub drop_outs: [usize; 2],
    /// Time without a sample of PV for longer than five sample periods (s).
    pub gaps_s: f64,
}

/// Why a record gives no timeline.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum BackfillError {
    /// Nothing to cut.
    #[error("no two samples of PV with different times")]
    Empty,
    /// The step is too short for the record.
    #[error("{0} windows are more than {MOST_WINDOWS}; take a longer step")]
    TooMany(usize),
    /// Nobody wants it any more.
    #[error("cancelled")]
    Cancelled,
}

/// The function that judges a window, see [`Diagnose`](crate::schedule::Diagnose).
pub type Judge<'f> = &'f dyn Fn(&Record, &Settings, Option<&Structure>) -> Judged;

/// A cut where none, or only a part of one, is given: windows of 1,500 sample periods, each a quarter of that further on.
pub fn usual_cut(past: &Past, window_s: Option<f64>, step_s: Option<f64>) -> Option<Cut> {
    let window_s = window_s.or_else(|| Some(period(past)? * USUAL_SAMPLES))?;
    Some(Cut { window_s, step_s: step_s.unwrap_or(window_s / USUAL_OVERLAP) })
}

/// A past in the order of time, its drop-outs to zero marked bad.
#[derive(Clone, Debug, PartialEq)]
pub struct Marked {
    /// The past.
    pub past: Past,
    /// How many samples of OP and of PV were marked.
    pub drop_outs: [usize; 2],
}

impl From<Past> for Marked {
    fn from(mut past: Past) -> Self {
        let drop_outs = mark_drop_outs(&mut past);
        Self { past, drop_outs }
    }
}

impl From<Record> for Marked {
    fn from(record: Record) -> Self {
        Past::from(record).into()
    }
}

/// Sorts every part by time and marks drop-outs as bad; returns how many there are of OP and of PV.
fn mark_drop_outs(past: &mut Past) -> [usize; 2] {
    let times = past.parts.iter().flat_map(|part| &part.samples).map(|s| s.t).filter(|t| t.is_finite());
    let end = times.fold(f64::NEG_INFINITY, f64::max);
    let limits = [past.known.op_limits.map(|range| Limits { range, end }), None];
    let mut marked = [0, 0];
    for part in &mut past.parts {
        part.samples.sort_by(|a, b| a.t.total_cmp(&b.t));
        let at = match part.tag.as_str() {
            "op" => 0,
            "pv" => 1,
            _ => continue,
        };
        let good: Vec<Sample> = part.samples.iter().filter(|s| s.quality.is_good()).copied().collect();
        let lost: Vec<f64> = part.samples.iter().filter(|s| !s.quality.is_good()).map(|s| s.t).collect();
        let are_measured = are_measured(&good, &outages(&good), limits[at], &lost);
        let good = part.samples.iter_mut().filter(|s| s.quality.is_good());
        for (sample, _) in good.zip(are_measured).filter(|(_, is_measured)| !is_measured) {
            sample.quality = Quality::Bad(BadReason::LinkDown);
            marked[at] += 1;
        }
    }
    marked
}

/// Diagnoses the windows of a past, oldest first; `progress` hears of every one that is done, with how many there are,
/// and ends the work by saying false.
///
/// # Errors
/// [`BackfillError`].
pub fn timeline(
    id: &LoopId,
    marked: Marked,
    cut: Cut,
    settings: &Settings,
    alarm: &alarm::Config,
    judge: Judge<'_>,
    mut progress: impl FnMut(usize, usize) -> bool,
) -> Result<Timeline, BackfillError> {
    let Marked { past, drop_outs } = marked;
    let pv = past.all("pv");
    let (first, last) = pv.first().zip(pv.last()).ok_or(BackfillError::Empty)?;
    let ts = period(&past).ok_or(BackfillError::Empty)?;
    let (begin, end) = (first.t, last.t);
    let count = (((end - begin - cut.window_s) / cut.step_s).max(0.0)).floor() + 1.0;
    if count > MOST_WINDOWS as f64 {
        return Err(BackfillError::TooMany(count.min(1e15) as usize));
    }
    let count = count as usize;
    let results = Results::new(std::slice::from_ref(id), 1, alarm);
    let mut out = Timeline {
        begin,
        cut,
        items: Vec::new(),
        raised: Vec::new(),
        drop_outs,
        gaps_s: gaps(&pv, 5.0 * ts),
    };
    for at in 0..count {
        // The last window ends with the record, whatever the step leaves over.
        let to = end - (count - 1 - at) as f64 * cut.step_s;
        let from = to - cut.window_s;
        let window = past.window(from, to);
        let good = window.pv.iter().filter(|s| s.quality.is_good()).count() as f64;
        let judged = judge(&window, settings, results.structure(id).as_ref());
        let effects = judged.effects();
        let history = judged.diagnosis.preparation.history.as_deref().copied();
        let run = Run {
            id: id.clone(),
            started: to,
            finished: to,
            took_s: 0.0,
            trigger: Trigger::Periodic,
            op_span: past.known.op_span,
            basis: None,
            outcome: Outcome::Diagnosed(Box::new(judged)),
        };
        results.record(run);
        let Some(known) = results.get(id, to) else { continue };
        match (known.alarm.active, out.raised.last_mut().filter(|raised| raised.to.is_none())) {
            (true, None) => out.raised.push(Raised { from: to, to: None }),
            (false, Some(raised)) => raised.to = Some(to),
            _ => {}
        }
        let good_share = (good * ts / cut.window_s.min(end - begin + ts)).min(1.0);
        out.items.extend(known.last.map(|summary| Item { from, to, summary, effects, good_share, history }));
        if !progress(at + 1, count) {
            return Err(BackfillError::Cancelled);
        }
    }
    Ok(out)
}

/// Median time between samples of PV (s).
fn period(past: &Past) -> Option<f64> {
    let steps = past.of("pv").flat_map(|part| part.samples.windows(2)).map(|w| w[1].t - w[0].t);
    let mut steps: Vec<f64> = steps.filter(|step| *step > 0.0).collect();
    let middle = steps.len() / 2;
    (!steps.is_empty()).then(|| *steps.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Time in gaps longer than `longest` (s).
fn gaps(series: &[Sample], longest: f64) -> f64 {
    let steps = series.windows(2).map(|w| w[1].t - w[0].t);
    steps.filter(|step| *step > longest).sum()
}

#[cfg(test)]
mod tests;
