//! What a run worked on: enough to find the same samples again, and to know that they are the same.

use super::Before;
use crate::diagnosis::Settings;
use crate::residual::Structure;
use crate::signal::{Record, Role, Sample, Series, SpanSource, fnv1a};

/// Which of OP and PV was silent when a run began, and since when: nothing was diagnosed then.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Silent {
    /// Which of the two.
    pub tag: Role,
    /// Stamp of its last good sample (s).
    pub since: f64,
}

/// What a run worked on, beside the samples themselves.
#[derive(Clone, Debug, PartialEq)]
pub struct Basis {
    /// Settings of the diagnosis.
    pub settings: Settings,
    /// What the last run found and this one may take as given; `None` where everything is searched for.
    pub structure: Option<Structure>,
    /// Friction as it was found last while no term of write-back acted.
    pub before: Option<Before>,
    /// The span of OP (OP unit).
    pub op_span: Option<f64>,
    /// Where that is known from.
    pub op_span_source: SpanSource,
    /// The controller's output limits (OP unit).
    pub op_limits: Option<(f64, f64)>,
    /// Whether the process integrates, where that was known.
    pub integrates: Option<bool>,
    /// Which tag was silent; `None` where both spoke, or nobody asked.
    pub silent: Option<Silent>,
    /// What stands for where OP and PV were read; `None` where nobody said.
    pub source: Option<u64>,
    /// Which samples of each tag, in the record's order.
    pub extents: Vec<Extent>,
}

/// Which samples of one tag: all between two stamps. A record's series never falls in time, so this names them all.
#[derive(Clone, Debug, PartialEq)]
pub struct Extent {
    /// The tag's name in the record: `op`, `pv`, `sp`, `mode`, `mv`, `term`, or another tag's.
    pub tag: String,
    /// Samples.
    pub n: usize,
    /// Stamps of the first and the last (s); `None` when there is none.
    pub span: Option<(f64, f64)>,
    /// FNV-1a over stamps, values and qualities: the same samples have the same.
    pub digest: u64,
}

impl Basis {
    /// What a run on `record` works on.
    pub fn of(record: &Record, settings: &Settings, structure: Option<Structure>) -> Self {
        Self {
            settings: settings.clone(),
            structure,
            before: None,
            op_span: record.op_span,
            op_span_source: record.op_span_source,
            op_limits: record.op_limits,
            integrates: record.integrates,
            silent: None,
            source: record.source,
            extents: series(record).map(|(tag, samples)| Extent::of(tag, samples)).collect(),
        }
    }

    /// With the friction of before a term acted.
    pub fn after(self, before: Option<Before>) -> Self {
        Self { before, ..self }
    }

    /// With the tag that is silent.
    pub fn silent(self, silent: Option<Silent>) -> Self {
        Self { silent, ..self }
    }

    /// Stamp of the newest sample of all (s).
    pub fn newest(&self) -> Option<f64> {
        self.extents.iter().filter_map(|extent| Some(extent.span?.1)).reduce(f64::max)
    }

    /// Samples of all tags.
    pub fn samples(&self) -> usize {
        self.extents.iter().map(|extent| extent.n).sum()
    }

    /// The part of a record that the run worked on, and the names of tags whose samples are no longer the same.
    pub fn cut(&self, mut record: Record) -> (Record, Vec<String>) {
        let mut part = Record {
            op_span: self.op_span,
            op_span_source: self.op_span_source,
            op_limits: self.op_limits,
            integrates: self.integrates,
            source: self.source,
            ..Record::default()
        };
        let mut lost = Vec::new();
        for extent in &self.extents {
            let from = take(&mut record, &extent.tag).unwrap_or_default();
            let samples = extent.cut(from);
            if Extent::of(&extent.tag, &samples) != *extent {
                lost.push(extent.tag.clone());
            }
            put(&mut part, &extent.tag, samples);
        }
        (part, lost)
    }
}

impl Extent {
    fn of(tag: &str, samples: &[Sample]) -> Self {
        let span = samples.first().zip(samples.last()).map(|(first, last)| (first.t, last.t));
        Self { tag: tag.to_string(), n: samples.len(), span, digest: digest(samples) }
    }

    /// Those of the samples that lie within.
    pub fn cut(&self, mut samples: Series) -> Series {
        match self.span {
            Some((first, last)) => samples.retain(|s| s.t >= first && s.t <= last),
            None => samples.clear(),
        }
        // A stamp at the edge may have come more than once; the newest are those that were there.
        samples.drain(..samples.len().saturating_sub(self.n));
        samples
    }
}

const ROLES: [&str; 6] = ["op", "pv", "sp", "mode", "mv", "term"];

/// The series of a record by name.
pub fn series(record: &Record) -> impl Iterator<Item = (&str, &Series)> {
    let others = [&record.sp, &record.mode, &record.mv, &record.term].map(Option::as_ref);
    let roles = [Some(&record.op), Some(&record.pv)].into_iter().chain(others);
    let named = ROLES.into_iter().zip(roles).filter_map(|(name, own)| Some((name, own?)));
    named.chain(record.tags.iter().map(|(name, own)| (name.as_str(), own)))
}

/// Puts a series where its name says.
pub fn put(record: &mut Record, tag: &str, samples: Series) {
    match tag {
        "op" => record.op = samples,
        "pv" => record.pv = samples,
        "sp" => record.sp = Some(samples),
        "mode" => record.mode = Some(samples),
        "mv" => record.mv = Some(samples),
        "term" => record.term = Some(samples),
        _ => record.tags.push((tag.to_string(), samples)),
    }
}

fn take(record: &mut Record, tag: &str) -> Option<Series> {
    match tag {
        "op" => Some(std::mem::take(&mut record.op)),
        "pv" => Some(std::mem::take(&mut record.pv)),
        "sp" => record.sp.take(),
        "mode" => record.mode.take(),
        "mv" => record.mv.take(),
        "term" => record.term.take(),
        _ => {
            let at = record.tags.iter().position(|(name, _)| name == tag)?;
            Some(record.tags.swap_remove(at).1)
        }
    }
}

/// A value that is no number is the same whatever its bits: no record keeps them.
fn digest(samples: &[Sample]) -> u64 {
    let value = |s: &Sample| if s.value.is_finite() { s.value.to_bits() } else { u64::MAX };
    fnv1a(samples.iter().flat_map(|s| {
        let numbers = s.t.to_bits().to_le_bytes().into_iter().chain(value(s).to_le_bytes());
        numbers.chain(s.quality.as_str().bytes())
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::{BadReason, Quality};

    fn record(n: usize) -> Record {
        let of = |k: f64| (0..n).map(|i| Sample::good(i as f64, k * i as f64)).collect::<Series>();
        Record {
            op: of(1.0),
            pv: of(2.0),
            sp: Some(Series::new()),
            tags: vec![("a".into(), of(3.0)), ("b".into(), of(4.0))],
            op_span: Some(100.0),
            ..Record::default()
        }
    }

    #[test]
    fn the_part_that_a_run_worked_on_is_found_in_a_longer_record() {
        let basis = Basis::of(&record(50), &Settings::default(), None);
        assert_eq!((basis.newest(), basis.samples()), (Some(49.0), 200));
        assert_eq!(basis.cut(record(80)), (record(50), vec![]));
    }

    #[test]
    fn whatever_is_not_the_same_is_named() {
        let basis = Basis::of(&record(50), &Settings::default(), None);
        assert_eq!(basis.cut(record(49)).1, ["op", "pv", "a", "b"], "one sample is missing");
        let mut other = record(50);
        other.pv[7].value += 1e-13;
        other.tags[1].1[3].quality = Quality::Stale;
        assert_eq!(basis.cut(other).1, ["pv", "b"]);
        let gone = Record { tags: vec![], ..record(50) };
        assert_eq!(basis.cut(gone).1, ["a", "b"]);
    }

    #[test]
    fn no_number_is_like_any_other_that_is_none() {
        let bad = |value| [Sample { t: 1.0, value, quality: Quality::Bad(BadReason::NotANumber) }];
        assert_eq!(digest(&bad(f64::NAN)), digest(&bad(f64::INFINITY)));
        assert_ne!(digest(&bad(f64::NAN)), digest(&bad(0.0)));
        // FNV-1a of nothing is its offset.
        assert_eq!(digest(&[]), 0xcbf2_9ce4_8422_2325);
    }
}
