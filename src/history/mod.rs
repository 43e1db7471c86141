//! The last samples of every tag of every loop, in bounded memory.
//! That of samples whose values are 32-bit floats is taken at start-up, the rest once, when other values first come.
//!
//! A `History` does not change its shape: a new configuration makes a [`History::successor`] that shares the rings of
//! all tags that read the same thing as before.

mod decimate;
mod heard;
mod past_terms;
mod ring;
mod set_back;

pub use decimate::decimate;
pub use heard::Heard;
pub use ring::{BYTES_PER_SAMPLE, Ring};

use crate::signal::{BadReason, LoopId, Quality, Record, Role, Sample, Series, SpanSource, fnv1a};
use past_terms::PastTerms;
use serde::Deserialize;
use set_back::{SetBack, Since, since_set_back};
use std::collections::HashMap;
use std::sync::Arc;

/// `[history]`: how much is remembered.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Samples kept of each tag, at 10 bytes each where values are 32-bit floats, 18 where they are not. The diagnosis uses about `window_samples` of them.
    /// Of a term of write-back four times as many are kept.
    pub samples_per_tag: usize,
}

impl Default for Config {
    fn default() -> Self {
        Self { samples_per_tag: 4096 }
    }
}

impl Config {
    /// Everything wrong with it, by field; empty when it can be used.
    pub fn validate(&self) -> Vec<(&'static str, String)> {
        let n = self.samples_per_tag;
        let ok = (200..=10_000_000).contains(&n);
        let problem = ("samples_per_tag", format!("{n} must be 200 to 10000000"));
        if ok { Vec::new() } else { vec![problem] }
    }

    /// Samples kept of a tag of this kind.
    pub fn samples_of(&self, kind: &TagKind) -> usize {
        let samples = self.samples_per_tag.max(1);
        if *kind == TERM { TERMS_A_SAMPLE * samples } else { samples }
    }
}

/// What a tag is to its loop: one of the roles, or another measurement by name.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum TagKind {
    /// OP, PV, SP, mode, valve position or the term of write-back.
    Role(Role),
    /// Any other tag, by its name.
    Extra(String),
}

impl TagKind {
    /// The name the API uses: `op`, `pv`, `sp`, `mode`, `mv`, `term`, or the extra tag's own.
    pub fn name(&self) -> &str {
        match self {
            TagKind::Role(Role::Op) => "op",
            TagKind::Role(Role::Pv) => "pv",
            TagKind::Role(Role::Sp) => "sp",
            TagKind::Role(Role::Mode) => "mode",
            TagKind::Role(Role::Mv) => "mv",
            TagKind::Role(Role::Term) => "term",
            TagKind::Extra(name) => name,
        }
    }

    /// The kind with this name: a role, or else another tag.
    pub fn named(name: &str) -> Self {
        let roles = [Role::Op, Role::Pv, Role::Sp, Role::Mode, Role::Mv, Role::Term].map(TagKind::Role);
        let role = roles.into_iter().find(|role| role.name() == name);
        role.unwrap_or_else(|| TagKind::Extra(name.to_string()))
    }
}

/// One tag of a loop.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct TagSpec {
    /// What it is to the loop.
    pub kind: TagKind,
    /// Engineering unit of its values, for people; may be empty.
    pub unit: String,
    /// Where it is read and how it is decoded, as text: tags with equal sources carry the same numbers.
    pub source: String,
}

/// One loop and its tags. Tags are numbered through all loops in this order; that number is the `tag` of
/// [`History::push`].
#[derive(Clone, Debug, PartialEq)]
pub struct LoopTags {
    /// The loop's name.
    pub id: LoopId,
    /// Its tags.
    pub tags: Vec<TagSpec>,
    /// Controller output limits (OP unit).
    pub op_limits: Option<(f64, f64)>,
    /// Span of OP as the configuration tells it; where it does not, a record's values may (OP unit).
    pub op_span: Option<f64>,
    /// Where that is known from.
    pub op_span_source: SpanSource,
}

/// The rings of all loops.
#[derive(Debug)]
pub struct History {
    loops: Vec<LoopTags>,
    /// Number of the first tag of each loop.
    first: Vec<usize>,
    rings: Vec<Arc<Ring>>,
    by_id: HashMap<LoopId, usize>,
    past_terms: PastTerms,
}

/// The tag of the terms of write-back.
const TERM: TagKind = TagKind::Role(Role::Term);
/// Terms that are kept for each sample of OP: one that ramps changes at each step, and there are several steps to a sample.
const TERMS_A_SAMPLE: usize = 4;

/// The samples of one tag for a screen.
#[derive(Clone, Debug, PartialEq)]
pub struct Trend {
    /// Which tag.
    pub tag: TagSpec,
    /// Samples that lay between the limits, before thinning.
    pub found: usize,
    /// The last sample before them: a value that is reported only when it changes holds until the next.
    pub before: Option<Sample>,
    /// Whether no value was repeated in all that is remembered: the source may send changes only.
    pub by_changes: bool,
    /// At most as many samples as asked for, by time; bad ones kept visible.
    pub samples: Vec<Sample>,
}

impl History {
    /// Takes the memory for all loops; afterwards nothing grows.
    pub fn new(loops: &[LoopTags], config: &Config) -> Self {
        Self::build(loops, config, |_, _| None)
    }

    /// A history for a new configuration. A tag whose loop, role, source and capacity are unchanged keeps its ring,
    /// and with it its data; the others start empty.
    pub fn successor(&self, loops: &[LoopTags], config: &Config) -> Self {
        Self::build(loops, config, |id, tag| {
            let (spec, ring) = self.tags(id).find(|(spec, _)| *spec == tag)?;
            let same = spec.source == tag.source && ring.capacity() == config.samples_of(&tag.kind);
            same.then(|| ring.clone())
        })
    }

    fn build(
        loops: &[LoopTags],
        config: &Config,
        inherited: impl Fn(&LoopId, &TagSpec) -> Option<Arc<Ring>>,
    ) -> Self {
        let mut first = Vec::with_capacity(loops.len());
        let mut rings = Vec::new();
        for control_loop in loops {
            first.push(rings.len());
            rings.extend(control_loop.tags.iter().map(|tag| {
                inherited(&control_loop.id, tag)
                    .unwrap_or_else(|| Arc::new(Ring::new(config.samples_of(&tag.kind))))
            }));
        }
        let by_id = loops.iter().enumerate().map(|(at, l)| (l.id.clone(), at)).collect();
        Self { loops: loops.to_vec(), first, rings, by_id, past_terms: PastTerms::default() }
    }

    /// Takes over the terms of `before` for loops whose write-back was removed, and returns them to the ring of a loop that has it
    /// again. A term that was never ended counts for `lasts` (s) after its last sample.
    pub fn keep_terms_of(&self, before: &History, lasts: f64) {
        fn term_ring<'h>(history: &'h History, id: &LoopId) -> Option<&'h Arc<Ring>> {
            history.tag_index(id, &TERM).and_then(|tag| history.ring(tag))
        }
        for id in self.loops.iter().map(|own| &own.id) {
            match (term_ring(self, id), term_ring(before, id), before.past_terms.of(id)) {
                (None, Some(ring), _) => self.keep_terms(id, terms_of(ring), lasts),
                (None, None, Some(past)) => self.keep_terms(id, past, lasts),
                (Some(ring), None, Some(past)) => past.into_iter().for_each(|own| ring.push(own)),
                _ => {}
            }
        }
    }

    /// Keeps the terms of a loop whose write-back was removed, if they acted on OP that is still in its ring. A term that was never
    /// ended counts for `lasts` (s) after its last sample.
    pub fn keep_terms(&self, id: &LoopId, terms: Series, lasts: f64) {
        let op = self.series(id, &TagKind::Role(Role::Op));
        if let Some(op) = op.filter(|_| self.lacks_terms(id)) {
            self.past_terms.keep(id, terms, &op, lasts);
        }
    }

    /// Whether a loop has no ring for terms: it has no write-back.
    pub fn lacks_terms(&self, id: &LoopId) -> bool {
        self.tag_index(id, &TERM).is_none()
    }

    /// The loops, in the order that numbers their tags.
    pub fn loops(&self) -> &[LoopTags] {
        &self.loops
    }

    /// Number of tags.
    pub fn tag_count(&self) -> usize {
        self.rings.len()
    }

    /// Bytes that one sample takes where its value is an `f32`.
    pub fn bytes_per_sample(&self) -> usize {
        BYTES_PER_SAMPLE
    }

    /// Bytes all rings take together.
    pub fn memory_bytes(&self) -> usize {
        self.rings.iter().map(|ring| ring.memory_bytes()).sum()
    }

    /// Stores a sample of the tag with this number. Each tag has one writer; a number out of range is ignored, and
    /// reported by the return value.
    pub fn push(&self, tag: usize, sample: Sample) -> bool {
        self.rings.get(tag).map(|ring| ring.push(sample)).is_some()
    }

    /// The number of a loop's tag.
    pub fn tag_index(&self, id: &LoopId, kind: &TagKind) -> Option<usize> {
        let at = *self.by_id.get(id)?;
        let within = self.loops[at].tags.iter().position(|tag| tag.kind == *kind)?;
        Some(self.first[at] + within)
    }

    /// The ring of the tag with this number, for its one writer.
    pub fn ring(&self, tag: usize) -> Option<&Arc<Ring>> {
        self.rings.get(tag)
    }

    /// Everything remembered of a loop, for the diagnosis; `None` for a loop that is not there.
    pub fn snapshot(&self, id: &LoopId) -> Option<Record> {
        let control_loop = &self.loops[*self.by_id.get(id)?];
        let mut record = Record {
            op_limits: control_loop.op_limits,
            op_span: control_loop.op_span,
            op_span_source: control_loop.op_span_source,
            source: self.source(id),
            ..Record::default()
        };
        let held = |tag: &TagSpec, ring: &Ring| match tag.kind == TERM {
            true => terms_of(ring),
            false => ring.snapshot(),
        };
        let tags: Vec<_> = self.tags(id).map(|(tag, ring)| (tag, Since::of(held(tag, ring)))).collect();
        let measured = tags.iter().filter(|(tag, _)| is_measured(&tag.kind)).map(|(_, since)| since);
        let set_back = SetBack::of(measured);
        let across = |since: Since, of_window: bool| match &set_back {
            Some(set_back) => set_back.across(since, of_window),
            None => since.samples,
        };
        for (tag, since) in tags {
            let series = across(since, is_measured(&tag.kind));
            match &tag.kind {
                TagKind::Role(Role::Op) => record.op = series,
                TagKind::Role(Role::Pv) => record.pv = series,
                TagKind::Role(Role::Sp) => record.sp = Some(series),
                TagKind::Role(Role::Mode) => record.mode = Some(series),
                TagKind::Role(Role::Mv) => record.mv = Some(series),
                TagKind::Role(Role::Term) => record.term = Some(series),
                TagKind::Extra(name) => record.tags.push((name.clone(), series)),
            }
        }
        // While there was write-back, the valve got OP plus these.
        if let Some(past) = self.past_terms.of(id) {
            record.term = Some(across(Since::of(past), false));
        }
        cut_to_known_terms(&mut record);
        // What the configuration does not tell OP's values may, unless they are those of a physical quantity.
        let op = self.tags(id).find(|(tag, _)| tag.kind == TagKind::Role(Role::Op));
        record.find_span(None, op.map(|(tag, _)| tag.unit.as_str()));
        Some(record)
    }

    /// Everything remembered of one tag; `None` for a tag that is not there.
    pub fn series(&self, id: &LoopId, kind: &TagKind) -> Option<Series> {
        let (_, ring) = self.tags(id).find(|(tag, _)| tag.kind == *kind)?;
        Some(since_set_back(ring.snapshot()))
    }

    /// What stands for where OP and PV of a loop are read: an FNV-1a of their sources. `None` for a loop that is not there. A stem
    /// that is measured from now on, or elsewhere, is no other valve.
    pub fn source(&self, id: &LoopId) -> Option<u64> {
        self.by_id.get(id)?;
        let is_of_valve = |tag: &&TagSpec| is_measured(&tag.kind);
        let tags = self.tags(id).map(|(tag, _)| tag).filter(is_of_valve);
        // No text has a zero in it, so two sources do not run together.
        let bytes = |tag: &TagSpec| format!("{}\0{}\0", tag.kind.name(), tag.source).into_bytes();
        Some(fnv1a(tags.flat_map(bytes)))
    }

    /// What the clock shows that stamps a tag of a loop, so long after the start (s), as far as its newest good sample tells; `None`
    /// where none has come since.
    pub fn stamps_show(&self, id: &LoopId, kind: &TagKind, now_s: f64) -> Option<f64> {
        self.tags(id).find(|(tag, _)| tag.kind == *kind)?.1.heard().shows(now_s)
    }

    /// Whether the source of a loop's tag tells every change and was there within so long before the time `now_s` after the start
    /// (s).
    pub fn was_there(&self, id: &LoopId, kind: &TagKind, now_s: f64, within_s: f64) -> bool {
        let ring = self.tags(id).find(|(tag, _)| tag.kind == *kind);
        ring.is_some_and(|(_, ring)| ring.heard().was_there(now_s, within_s))
    }

    /// Whether a term of write-back acted on a loop since a time (s), or may have: what acted before the terms that are known is not
    /// known.
    pub fn term_acted(&self, id: &LoopId, from: f64) -> bool {
        let own = self.tags(id).find(|(tag, _)| tag.kind == TERM).map(|(_, ring)| terms_of(ring));
        let past = self.past_terms.of(id);
        own.into_iter().chain(past).any(|terms| {
            let in_force = terms.partition_point(|own| own.t <= from).saturating_sub(1);
            // One that is not known is not 0 either.
            terms.iter().skip(in_force).any(|own| own.value != 0.0)
        })
    }

    /// The newest sample of each tag of a loop.
    pub fn latest(&self, id: &LoopId) -> Vec<(&TagSpec, Option<Sample>)> {
        self.tags(id).map(|(tag, ring)| (tag, ring.latest())).collect()
    }

    /// The same, each with how long ago it was last known to hold (s), at the time `now_s` after the start, when our own clock shows
    /// `now` (s): since it came, whatever its stamp says, or since its source was last there, where that sends changes only and tells
    /// all of them.
    pub fn aged(&self, id: &LoopId, now: f64, now_s: f64) -> Vec<(&TagSpec, Option<(Sample, f64)>)> {
        let aged = |ring: &Ring| {
            let newest = ring.latest()?;
            // Where nothing has come since the start, our own clock is all there is.
            let came_s = ring.heard().shows(now_s).unwrap_or(now) - newest.t;
            let only_changes = || sends_changes(&since_set_back(ring.snapshot()));
            let away_s = ring.heard().away(now_s).filter(|_| only_changes());
            Some((newest, away_s.map_or(came_s, |away_s| came_s.min(away_s)).max(0.0)))
        };
        self.tags(id).map(|(tag, ring)| (tag, aged(ring))).collect()
    }

    /// The trends of a loop between two times (s, inclusive), each thinned to `points` so that peaks and gaps survive;
    /// `None` for a loop that is not there.
    pub fn samples(&self, id: &LoopId, from: f64, to: f64, points: usize) -> Option<Vec<Trend>> {
        self.by_id.get(id)?;
        let trend = |(tag, ring): (&TagSpec, &Arc<Ring>)| {
            let mut samples = since_set_back(ring.snapshot());
            let before = samples.iter().rfind(|s| s.t < from).copied();
            let by_changes = sends_changes(&samples);
            samples.retain(|s| s.t >= from && s.t <= to);
            let found = samples.len();
            Trend { tag: tag.clone(), found, before, by_changes, samples: decimate(&samples, points) }
        };
        Some(self.tags(id).map(trend).collect())
    }

    /// Samples ever stored, over all tags.
    pub fn pushed(&self) -> u64 {
        self.rings.iter().map(|ring| ring.pushed()).sum()
    }

    /// Samples refused for want of a single writer, over all tags: zero unless wired wrongly.
    pub fn refused(&self) -> u64 {
        self.rings.iter().map(|ring| ring.refused()).sum()
    }

    fn tags(&self, id: &LoopId) -> impl Iterator<Item = (&TagSpec, &Arc<Ring>)> {
        let at = self.by_id.get(id).copied();
        at.into_iter().flat_map(|at| {
            let tags = &self.loops[at].tags;
            tags.iter().zip(&self.rings[self.first[at]..self.first[at] + tags.len()])
        })
    }
}

/// Whether no value was repeated: the source may send changes only.
fn sends_changes(samples: &[Sample]) -> bool {
    !samples.windows(2).any(|pair| is_repeated(pair[0], pair[1]))
}

/// Whether a value was reported again though it had not changed: a source that sends changes only does that after a bad sample alone.
fn is_repeated(a: Sample, b: Sample) -> bool {
    a.quality.is_good() && b.quality.is_good() && a.value == b.value && a.t < b.t
}

/// The terms that a ring holds. Where older ones were overwritten they begin with one that is not good: what acted before is not
/// known.
fn terms_of(ring: &Ring) -> Series {
    let mut terms = ring.snapshot();
    let is_full = ring.pushed() >= ring.capacity() as u64;
    if let Some(first) = terms.first().copied().filter(|_| is_full) {
        terms.insert(0, Sample { value: f64::NAN, quality: Quality::Bad(BadReason::NotANumber), ..first });
    }
    terms
}

/// Takes away the OP of before the terms are known: as if nothing had been added to it then, it would tell of another valve.
fn cut_to_known_terms(record: &mut Record) {
    let Some(terms) = &mut record.term else { return };
    if let Some(first) = terms.first().copied().filter(|first| !first.quality.is_good()) {
        terms.remove(0);
        record.op.retain(|own| own.t >= first.t);
    }
    record.term.take_if(|terms| terms.is_empty());
}

/// Whether a tag is OP or PV, whose samples a window is made of.
fn is_measured(kind: &TagKind) -> bool {
    matches!(kind, TagKind::Role(Role::Op | Role::Pv))
}

#[cfg(test)]
mod tests;
