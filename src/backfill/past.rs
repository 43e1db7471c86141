//! Which samples a window of the past may hold: those of one era of the clock, and of each tag those of one source.
//!
//! Where the clock was set back a stamp came twice, and where a tag is read elsewhere than before its values are another
//! signal's. Sorted into each other they would be a record of something that never happened.

use crate::results::basis;
use crate::signal::{Record, Sample, Series};
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::mem::take;

/// Samples of one tag that belong together: read in one place, stamped between two settings back of the clock.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// The tag, as a record names it: `op`, `pv`, `mode`, …, or another tag's own name.
    pub tag: String,
    /// How often the clock was set back before.
    pub era: i64,
    /// Whether the configuration has the tag read there.
    pub configured: bool,
    /// Its samples, by time.
    pub samples: Series,
}

/// The past of a loop.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Past {
    /// What is known beside the samples: OP's limits and span. Its own series are empty.
    pub known: Record,
    /// The samples.
    pub parts: Vec<Part>,
}

impl From<Record> for Past {
    /// A record that is of one source and one era.
    fn from(mut known: Record) -> Self {
        let roles = [
            ("op", Some(take(&mut known.op))),
            ("pv", Some(take(&mut known.pv))),
            ("sp", known.sp.take()),
            ("mode", known.mode.take()),
            ("mv", known.mv.take()),
            ("term", known.term.take()),
        ];
        let roles = roles.into_iter().filter_map(|(tag, samples)| Some((tag.to_string(), samples?)));
        let others = take(&mut known.tags);
        let part = |(tag, samples)| Part { tag, era: 0, configured: true, samples };
        let parts = roles.chain(others).map(part).collect();
        Self { known, parts }
    }
}

impl Past {
    /// The parts of a tag.
    pub fn of(&self, tag: &str) -> impl Iterator<Item = &Part> {
        self.parts.iter().filter(move |part| part.tag == tag)
    }

    /// Every sample of a tag by time, whatever its source and era: for what is asked of the whole past.
    pub fn all(&self, tag: &str) -> Cow<'_, [Sample]> {
        let mut parts = self.of(tag).filter(|part| !part.samples.is_empty());
        match (parts.next(), parts.next()) {
            (None, _) => Cow::Borrowed(&[]),
            (Some(only), None) => Cow::Borrowed(&only.samples),
            _ => {
                let mut all: Series = self.of(tag).flat_map(|part| part.samples.iter().copied()).collect();
                all.sort_by(|a, b| a.t.total_cmp(&b.t));
                Cow::Owned(all)
            }
        }
    }

    /// What was recorded in `from..=to`, in the era that most of it is of. OP and PV are what was measured then; every other
    /// tag may be reported only when it changes, and so has what was in force at the beginning too, under its own stamp.
    pub fn window(&self, from: f64, to: f64) -> Record {
        let era = self.era(from, to);
        let mut tags: Vec<&str> = Vec::new();
        for part in &self.parts {
            if !tags.contains(&part.tag.as_str()) {
                tags.push(&part.tag);
            }
        }
        let mut record = self.known.clone();
        for tag in tags {
            let own = self.part(tag, era, from, to).map_or(&[][..], |part| &part.samples[..]);
            let measured = within(own, from, to);
            let samples = match tag {
                "op" | "pv" => measured.to_vec(),
                _ => {
                    let before = before(own, from);
                    // A tag that has not changed since the clock was set back is what it was before that.
                    let left = if before.is_empty() { self.left(tag, era, from) } else { None };
                    left.into_iter().chain(before.iter().chain(measured).copied()).collect()
                }
            };
            basis::put(&mut record, tag, samples);
        }
        record
    }

    /// The era that most samples of OP and PV in `from..=to` are of; of several the newest.
    fn era(&self, from: f64, to: f64) -> i64 {
        let eras: BTreeSet<i64> = self.of("op").chain(self.of("pv")).map(|part| part.era).collect();
        let count = |tag: &str, era: i64| -> usize {
            self.part(tag, era, from, to).map_or(0, |part| part.rank(from, to).1)
        };
        eras.into_iter().max_by_key(|era| count("op", *era) + count("pv", *era)).unwrap_or(0)
    }

    /// The part of a tag that a window takes: where it is read by the configuration, else the one that it has most of, and of
    /// several without a sample in it the one that was in force last.
    fn part(&self, tag: &str, era: i64, from: f64, to: f64) -> Option<&Part> {
        let latest = |part: &Part| before(&part.samples, from).first().map_or(f64::NEG_INFINITY, |s| s.t);
        let own = self.of(tag).filter(|part| part.era == era);
        own.max_by(|a, b| a.rank(from, to).cmp(&b.rank(from, to)).then(latest(a).total_cmp(&latest(b))))
    }

    /// What a tag was when an era began, stamped no later than `from`.
    fn left(&self, tag: &str, era: i64, from: f64) -> Option<Sample> {
        let earlier = self.of(tag).filter(|part| part.era < era && !part.samples.is_empty());
        let last = earlier.max_by_key(|part| (part.era, part.configured))?.samples.last()?;
        is_known(last).then(|| Sample { t: last.t.min(from), ..*last })
    }
}

impl Part {
    /// Whether the configuration has it and there is something of it in `from..=to`, and how many samples.
    fn rank(&self, from: f64, to: f64) -> (bool, usize) {
        let count = within(&self.samples, from, to).len();
        (self.configured && count > 0, count)
    }
}

fn is_known(sample: &Sample) -> bool {
    sample.quality.is_good() && sample.value.is_finite()
}

/// The samples in `from..=to`.
fn within(samples: &[Sample], from: f64, to: f64) -> &[Sample] {
    let begin = samples.partition_point(|s| s.t < from);
    let end = samples.partition_point(|s| s.t <= to);
    &samples[begin..end.max(begin)]
}

/// The last known sample before a time, and the one after it there, since when nothing is known; empty where none is known.
fn before(samples: &[Sample], from: f64) -> &[Sample] {
    let earlier = &samples[..samples.partition_point(|s| s.t < from)];
    match earlier.iter().rposition(is_known) {
        Some(at) => &earlier[at..earlier.len().min(at + 2)],
        None => &[],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::{BadReason, Quality};

    fn part(tag: &str, era: i64, samples: &[(f64, f64)]) -> Part {
        let samples = samples.iter().map(|&(t, value)| Sample::good(t, value)).collect();
        Part { tag: tag.into(), era, configured: false, samples }
    }

    /// A sample a second, all of one value.
    fn polled(tag: &str, era: i64, stamps: std::ops::Range<u32>, value: f64) -> Part {
        let samples: Vec<(f64, f64)> = stamps.map(|t| (f64::from(t), value)).collect();
        part(tag, era, &samples)
    }

    fn values(samples: &[Sample]) -> Vec<(f64, f64)> {
        samples.iter().map(|s| (s.t, s.value)).collect()
    }

    #[test]
    fn what_is_in_force_at_the_beginning_is_there_under_its_own_stamp() {
        let mut mode = part("mode", 0, &[(5.0, 0.0), (10.0, 1.0), (150.0, 0.0)]);
        let (op, pv) = (polled("op", 0, 0..200, 1.0), polled("pv", 0, 0..200, 2.0));
        let (sp, mv) = (part("sp", 0, &[(20.0, 50.0)]), part("mv", 0, &[(30.0, 40.0)]));
        let parts = vec![op, pv, mode.clone(), sp, mv, part("upstream", 0, &[(40.0, 3.0)])];
        let window = Past { known: Record::default(), parts: parts.clone() }.window(100.0, 180.0);
        assert_eq!((window.op.len(), window.op[0].t, window.pv[0].t), (81, 100.0, 100.0), "as measured");
        assert_eq!(window.mode.as_deref().map(values), Some(vec![(10.0, 1.0), (150.0, 0.0)]));
        assert_eq!(window.sp.as_deref().map(values), Some(vec![(20.0, 50.0)]));
        assert_eq!(window.mv.as_deref().map(values), Some(vec![(30.0, 40.0)]));
        assert_eq!(values(&window.tags[0].1), [(40.0, 3.0)]);

        // A mode that could not be read since is not known to be what it was: that is there too.
        let bad = |t| Sample { t, value: f64::NAN, quality: Quality::Bad(BadReason::Timeout) };
        mode.samples = vec![Sample::good(10.0, 1.0), bad(60.0), bad(61.0), bad(120.0)];
        let mut parts = parts;
        parts[2] = mode;
        let mode = Past { known: Record::default(), parts }.window(100.0, 180.0).mode.unwrap();
        assert_eq!(mode.iter().map(|s| s.t).collect::<Vec<_>>(), [10.0, 60.0, 120.0]);
    }

    #[test]
    fn a_mode_of_which_nothing_is_known_yet_is_there_and_empty() {
        let parts = vec![polled("pv", 0, 0..200, 2.0), part("mode", 0, &[(150.0, 1.0)])];
        let past = Past { known: Record::default(), parts };
        assert_eq!(past.window(0.0, 100.0).mode, Some(vec![]));
        assert_eq!(past.window(0.0, 100.0).sp, None);
    }

    #[test]
    fn a_window_holds_samples_of_one_era() {
        // The clock was set back from 1000 to 400; the mode was set before that and has not changed since.
        let both = |era: i64, stamps: std::ops::Range<u32>| {
            ["op", "pv"].map(|tag| polled(tag, era, stamps.clone(), era as f64))
        };
        let mut parts = [both(0, 0..1000), both(1, 400..2000)].concat();
        parts.push(part("mode", 0, &[(10.0, 0.0), (700.0, 1.0)]));
        let past = Past { known: Record::default(), parts };
        for (from, to, era, n) in
            [(100.0, 500.0, 0.0, 401), (500.0, 900.0, 1.0, 401), (800.0, 1200.0, 1.0, 401)]
        {
            let window = past.window(from, to);
            assert!(window.pv.iter().chain(&window.op).all(|s| s.value == era), "{from} to {to}");
            assert_eq!((window.pv.len(), window.op.len()), (n, n), "{from} to {to}");
        }
        assert_eq!(past.window(100.0, 500.0).mode.as_deref().map(values), Some(vec![(10.0, 0.0)]));
        assert_eq!(past.window(500.0, 600.0).mode.as_deref().map(values), Some(vec![(500.0, 1.0)]));
        assert_eq!(past.all("pv").len(), 2600);
    }

    #[test]
    fn a_window_holds_samples_of_one_source() {
        let (old, mut new) = (polled("pv", 0, 0..1000, 1.0), polled("pv", 0, 700..2000, 2.0));
        let pv = |new: &Part, from, to| {
            let parts = vec![polled("op", 0, 0..2000, 0.0), old.clone(), new.clone()];
            Past { known: Record::default(), parts }.window(from, to).pv
        };
        let all = |pv: &[Sample], value: f64| !pv.is_empty() && pv.iter().all(|s| s.value == value);
        assert!(all(&pv(&new, 400.0, 800.0), 1.0), "it has most of the old one");
        assert!(all(&pv(&new, 900.0, 1300.0), 2.0));
        new.configured = true;
        assert!(all(&pv(&new, 400.0, 800.0), 2.0), "it is read there now");
        assert!(all(&pv(&new, 100.0, 500.0), 1.0), "there is nothing else of then");
    }
}
