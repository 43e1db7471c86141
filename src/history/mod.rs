//! The last samples of every tag of every loop, in bounded memory.
//! That of samples whose values are 32-bit floats is taken at start-up, the rest once, when other values first come.
//!
//! A `History` does not change its shape: a new configuration makes a [`History::successor`] that shares the rings of
//! all tags that read the same thing as before.

mod decimate;
mod past_terms;
mod ring;
mod set_back;

pub use decimate::decimate;
pub use ring::{BYTES_PER_SAMPLE, Ring};

use crate::signal::{LoopId, Record, Role, Sample, Series, SpanSource};
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

/// The samples of one tag for a screen.
#[derive(Clone, Debug, PartialEq)]
pub struct Trend {
    /// Which tag.
    pub tag: TagSpec,
    /// Samples that lay between the limits, before thinning.
    pub found: usize,
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
            let same = spec.source == tag.source && ring.capacity() == config.samples_per_tag.max(1);
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
                    .unwrap_or_else(|| Arc::new(Ring::new(config.samples_per_tag)))
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
                (None, Some(ring), _) => self.keep_terms(id, ring.snapshot(), lasts),
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
            ..Record::default()
        };
        let tags: Vec<_> = self.tags(id).map(|(tag, ring)| (tag, Since::of(ring.snapshot()))).collect();
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
                TagKind::Role(Role::Term) => record.term = Some(series).filter(|terms| !terms.is_empty()),
                TagKind::Extra(name) => record.tags.push((name.clone(), series)),
            }
        }
        // While there was write-back, the valve got OP plus these.
        if let Some(past) = self.past_terms.of(id) {
            record.term = Some(across(Since::of(past), false)).filter(|terms| !terms.is_empty());
        }
        // What the configuration does not tell OP's values may.
        record.find_span(None, None);
        Some(record)
    }

    /// Everything remembered of one tag; `None` for a tag that is not there.
    pub fn series(&self, id: &LoopId, kind: &TagKind) -> Option<Series> {
        let (_, ring) = self.tags(id).find(|(tag, _)| tag.kind == *kind)?;
        Some(since_set_back(ring.snapshot()))
    }

    /// The newest sample of each tag of a loop.
    pub fn latest(&self, id: &LoopId) -> Vec<(&TagSpec, Option<Sample>)> {
        self.tags(id).map(|(tag, ring)| (tag, ring.latest())).collect()
    }

    /// The trends of a loop between two times (s, inclusive), each thinned to `points` so that peaks and gaps survive;
    /// `None` for a loop that is not there.
    pub fn samples(&self, id: &LoopId, from: f64, to: f64, points: usize) -> Option<Vec<Trend>> {
        self.by_id.get(id)?;
        let trend = |(tag, ring): (&TagSpec, &Arc<Ring>)| {
            let mut samples = since_set_back(ring.snapshot());
            samples.retain(|s| s.t >= from && s.t <= to);
            Trend { tag: tag.clone(), found: samples.len(), samples: decimate(&samples, points) }
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

/// Whether a tag is OP or PV, whose samples a window is made of.
fn is_measured(kind: &TagKind) -> bool {
    matches!(kind, TagKind::Role(Role::Op | Role::Pv))
}

#[cfg(test)]
mod tests;
