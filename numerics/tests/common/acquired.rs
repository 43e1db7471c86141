//! Simulated loops as a historian holds them, and what the daemon says of them.
//!
//! Beside it a user has the modules `generators`.

use super::generators::{Case, GENERATORS, Size};
use stictiond_numerics::diagnosis::{self, diagnose};
use stictiond_numerics::residual::{self, Kind, trace_record};
use stictiond_numerics::signal::{Record, Sample};
use stictiond_numerics::sim::acquisition::{Acquisition, Gaps, Poll, Scans, acquire};

/// Mean length of a burst of lost polls.
pub const BURST: f64 = 8.0;
/// Tags that have nothing to do with the loop.
const TAGS: usize = 2;

/// One loop, at the controller's ticks.
pub struct Loop {
    pub name: String,
    pub record: Record,
    /// S/2 (% OP).
    pub f: f64,
    pub also: Vec<Kind>,
    pub seed: u64,
}

/// What was said of one record.
#[derive(Clone)]
pub struct Said {
    pub verdict: &'static str,
    /// Why nothing can be told, where that is so.
    pub code: &'static str,
    pub f: f64,
    pub ci: [f64; 2],
    /// Evidence for friction.
    pub evidence: f64,
    pub invented: Vec<Kind>,
    pub reason: String,
}

impl Said {
    pub fn sticks(&self) -> bool {
        self.verdict == "stiction"
    }

    pub fn near(&self, f: f64) -> bool {
        (self.f / f - 1.0).abs() < 0.1
    }

    pub fn covers(&self, f: f64) -> bool {
        (self.ci[0]..=self.ci[1]).contains(&f)
    }
}

/// The `i`-th loop: the generators in turn, each with all its classes and valves.
pub fn draw(i: u64, seed: u64) -> Loop {
    let generator = &GENERATORS[i as usize % GENERATORS.len()];
    let variants = (generator.variants)(None);
    // Steps of five meet all variants, but where their number is a multiple of it.
    let step = if variants.is_multiple_of(5) { 7 } else { 5 };
    let variant = i as usize / GENERATORS.len() * step % variants;
    let case = Case { effect: None, size: Size::Medium, variant, seed, tags: TAGS };
    let (record, truth) = (generator.record)(&case);
    Loop {
        name: format!("{} v{variant} {seed} {}", generator.name, truth.name),
        record,
        f: truth.f,
        also: truth.also,
        seed,
    }
}

/// The controller's values of a record that has one sample at each of its ticks.
pub fn scans(record: &Record) -> Option<Scans> {
    let values = |series: &[Sample]| series.iter().map(|s| s.value).collect::<Vec<f64>>();
    Some(Scans {
        t0: record.op.first()?.t,
        scan_s: record.op.get(1)?.t - record.op[0].t,
        op: values(&record.op),
        pv: values(&record.pv),
        sp: record.sp.as_deref().map(values),
        mv: None,
        tags: record.tags.iter().map(|(name, series)| (name.clone(), values(series))).collect(),
    })
}

/// The record of one poll a scan of which some are lost; the loop's own where it has no scans.
pub fn with_gaps(own: &Loop, gaps: Gaps) -> Record {
    let Some(scans) = scans(&own.record) else { return own.record.clone() };
    let poll = Poll { gaps, phase: 0.5, ..Poll::every(scans.scan_s) };
    Record { op_span: Some(100.0), ..acquire(&scans, &Acquisition::Polled(poll), own.seed) }
}

/// Losses of so many per cent at random, in bursts and periodically; 30 % are 3 of 10.
pub fn kinds_of_gaps(percent: usize) -> [(&'static str, Gaps); 3] {
    let share = percent as f64 / 100.0;
    let (every, lost) = if percent > 10 { (10, percent / 10) } else { (100 / percent.max(1), 1) };
    [
        ("at random", Gaps::Random { share }),
        ("in bursts", Gaps::Bursts { share, length: BURST }),
        ("periodic", Gaps::Periodic { every, lost }),
    ]
}

/// What the daemon says of a record.
pub fn judge(own: &Loop, record: &Record) -> Said {
    judge_by(own, record, &diagnosis::Settings::default())
}

/// The same by other settings.
pub fn judge_by(own: &Loop, record: &Record, settings: &diagnosis::Settings) -> Said {
    let d = diagnose(record, settings);
    let found = trace_record(record, &d, settings, &residual::Settings::default());
    let decides = found.as_ref().filter(|f| f.replaces_diagnosis());
    let (verdict, reason) = decides.map_or((&d.verdict, &d.reason), |f| (&f.verdict, &f.reason));
    let declared = d.estimate.as_ref().map(|e| (e.f, e.f_ci95, e.delta_aic));
    let friction = decides.map(|f| &f.friction_after).map(|f| (f.f, f.f_ci95, f.delta_aic));
    let (f, ci, evidence) = friction.or(declared).unwrap_or_default();
    let named = found.iter().flat_map(|f| &f.effects).map(|e| e.kind);
    Said {
        verdict: verdict.as_str(),
        code: if let diagnosis::Verdict::NotIdentifiable(why) = verdict { why.code() } else { "" },
        f,
        ci,
        evidence,
        invented: named.filter(|kind| !own.also.contains(kind)).collect(),
        reason: reason.clone(),
    }
}
