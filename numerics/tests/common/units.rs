//! Records as other plants would have written them: other units, signs, offsets and clocks of the same loop.

use stictiond_numerics::diagnosis::{self, Verdict, diagnose};
use stictiond_numerics::residual::{self, trace_record};
use stictiond_numerics::signal::{Record, Sample, Series};

/// How a signal is written elsewhere: `shift + scale * value`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    pub scale: f64,
    pub shift: f64,
}

/// Nothing else.
pub const SAME: Line = Line { scale: 1.0, shift: 0.0 };

/// The same record elsewhere.
#[derive(Clone, Copy, Debug)]
pub struct Change {
    pub name: &'static str,
    pub op: Line,
    pub pv: Line,
    pub time: Line,
}

const fn op(name: &'static str, scale: f64, shift: f64) -> Change {
    Change { name, op: Line { scale, shift }, pv: SAME, time: SAME }
}

const fn pv(name: &'static str, scale: f64, shift: f64) -> Change {
    Change { name, op: SAME, pv: Line { scale, shift }, time: SAME }
}

const fn time(name: &'static str, scale: f64, shift: f64) -> Change {
    Change { name, op: SAME, pv: SAME, time: Line { scale, shift } }
}

/// Of a record whose OP is in per cent.
pub const CHANGES: [Change; 13] = [
    op("OP from 0 to 1", 0.01, 0.0),
    op("OP times 1,000", 1000.0, 0.0),
    op("OP in mA, 4 to 20", 0.16, 4.0),
    op("OP in A", 0.000_16, 0.004),
    op("OP in counts of 27,648", 276.48, 0.0),
    op("OP reversed, 100 less OP", -1.0, 100.0),
    op("OP negated", -1.0, 0.0),
    pv("PV times 1,000", 1000.0, 0.0),
    pv("PV by 100, shifted by 273.15", 0.01, 273.15),
    pv("PV negated", -1.0, 0.0),
    time("stamps in minutes", 1.0 / 60.0, 0.0),
    time("stamps in milliseconds", 1000.0, 0.0),
    time("stamps since 1970", 1.0, 1_700_000_000.0),
];

impl Line {
    fn of(self, series: &Series, stamps: Line) -> Series {
        let at = |s: &Sample| Sample {
            t: stamps.shift + stamps.scale * s.t,
            value: self.shift + self.scale * s.value,
            ..*s
        };
        series.iter().map(at).collect()
    }
}

impl Change {
    /// The record as it would have been written there; `told`: with the span of OP, where the record has one.
    pub fn of(&self, record: &Record, told: bool) -> Record {
        let elsewhere = |series: &Option<Series>, line: Line| series.as_ref().map(|s| line.of(s, self.time));
        let ends = |(low, high): (f64, f64)| {
            let [a, b] = [low, high].map(|end| self.op.shift + self.op.scale * end);
            (a.min(b), a.max(b))
        };
        let mut other = Record {
            op: self.op.of(&record.op, self.time),
            pv: self.pv.of(&record.pv, self.time),
            sp: elsewhere(&record.sp, self.pv),
            mode: elsewhere(&record.mode, SAME),
            mv: elsewhere(&record.mv, self.op),
            tags: record.tags.iter().map(|(name, s)| (name.clone(), SAME.of(s, self.time))).collect(),
            op_limits: record.op_limits.map(ends),
            ..Record::default()
        };
        let span = record.op_span.filter(|_| told).map(|span| span * self.op.scale.abs());
        other.find_span(span, None);
        other
    }
}

/// What is said of a record in the end.
#[derive(Clone, Debug)]
pub struct Said {
    pub verdict: String,
    /// Where something is said of it (OP unit).
    pub f: Option<f64>,
    /// In % of OP's span, where that is known.
    pub percent: Option<f64>,
    pub reason: String,
}

/// Diagnoses and traces, as the daemon does.
pub fn judge(record: &Record, traced: bool) -> Said {
    let settings = diagnosis::Settings::default();
    let found = diagnose(record, &settings);
    let effects = traced.then(|| trace_record(record, &found, &settings, &residual::Settings::default()));
    let decides = effects.flatten().filter(|own| !matches!(own.verdict, Verdict::NotIdentifiable(_)));
    let (verdict, reason, f) = match &decides {
        Some(own) => (&own.verdict, &own.reason, Some(own.friction_after.f)),
        None => (&found.verdict, &found.reason, found.estimate.as_ref().map(|e| e.f)),
    };
    let code = match verdict {
        Verdict::NotIdentifiable(why) => format!("not_identifiable ({})", why.code()),
        other => other.as_str().to_string(),
    };
    let percent = f.zip(record.known_span()).map(|(f, span)| 100.0 * f / span);
    Said { verdict: code, f, percent, reason: reason.clone() }
}

/// By how much f differs from that of the record it was made of, as a share of it; `None` where only one has any.
pub fn off(change: &Change, own: &Said, other: &Said) -> Option<f64> {
    match (own.f, other.f.map(|f| f / change.op.scale.abs())) {
        (Some(a), Some(b)) if a.max(b) > 0.0 => Some((b - a).abs() / a.max(b)),
        (a, b) => (a.is_some() == b.is_some()).then_some(0.0),
    }
}
