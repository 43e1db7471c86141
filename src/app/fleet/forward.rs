//! How an edge forwards: samples from its rings, and from its store what the rings no longer hold; diagnoses and changes of
//! alarms from its store, by their numbers there. How far it has come is known from the streams, so nothing has to be
//! remembered here.

use crate::fleet::convert::{self, block};
use crate::fleet::link::{Link, LinkError, Outgoing};
use crate::fleet::message::{Alarm, Cursor, Diagnosis, Effect, Samples};
use crate::fleet::streams::{LATEST, SAMPLES};
use crate::fleet::subject::{Subject, What};
use crate::history::{History, Ring};
use crate::signal::{LoopId, Sample};
use crate::store::{self, Reader, StoreError, codec};
use futures::{StreamExt, stream};
use prost::Message;
use std::collections::HashMap;
use std::sync::Arc;

/// Samples of one tag in one message.
const MOST_SAMPLES: usize = 2000;
/// Loops that the server is asked about at the same time.
const AT_ONCE: usize = 32;
/// Rows that are read from the store in one go.
const ROWS: usize = 100;
/// Samples of the past that are read from the store in one go are of at most this long (s).
const SLICE_S: f64 = 1800.0;

/// A tag of a loop, by where it is read: another source is another tag.
type TagKey = (LoopId, String, String);

/// How far a tag has been forwarded.
#[derive(Clone)]
struct Place {
    ring: Arc<Ring>,
    /// Number of the first sample in the ring that has not been.
    next: u64,
    /// Stamp of the last that has been (s); NaN before there is one.
    last: f64,
    /// What lies between that and the ring's first may be in the store.
    behind: bool,
}

/// A tag whose samples are to be looked for in the store, later than one stamp and earlier than another; `next` is the number
/// in the ring behind them.
struct Missing {
    key: TagKey,
    last: f64,
    until: f64,
    next: u64,
}

/// How far everything has been forwarded.
#[derive(Default)]
pub(super) struct Forward {
    site: String,
    name: String,
    places: HashMap<TagKey, Place>,
    cursor: Option<Cursor>,
}

/// What is to be sent of one loop, and where its tags are after it.
struct Part {
    message: Outgoing,
    after: Vec<After>,
    /// There is more of it.
    more: bool,
}

/// Changes of alarms of which this edge has told people by itself.
#[derive(Clone, Copy)]
pub(super) struct Told {
    /// Number of the last.
    pub last: u64,
    /// None that happened before this was (s).
    pub since: f64,
}

/// Where a tag is after something: what is to be its `next`, its `last` and whether it is `behind`.
type After = (TagKey, u64, f64, bool);

impl Forward {
    pub(super) fn new(site: &str, name: &str) -> Self {
        Self { site: site.to_string(), name: name.to_string(), ..Self::default() }
    }

    /// The connection was lost, or others may have deleted what was forwarded: how far that came is asked anew.
    pub(super) fn forget(&mut self) {
        self.places.clear();
        self.cursor = None;
    }

    /// Forwards the samples of all loops that are new; whether there is more.
    ///
    /// # Errors
    /// [`LinkError`]; what was kept before it is not sent again.
    pub(super) async fn samples(
        &mut self,
        link: &Link,
        history: &Arc<History>,
        config: &store::Config,
    ) -> Result<bool, LinkError> {
        self.place(link, history).await?;
        let (mut parts, mut missing) = (Vec::new(), Vec::new());
        for own in history.loops() {
            parts.extend(self.part(&own.id, history, &mut missing));
        }
        if !missing.is_empty() {
            // The store first: a centre's rings go forward only.
            let (site, config) = (self.site.clone(), config.clone());
            let read = tokio::task::spawn_blocking(move || from_store(&site, &config, missing)).await;
            match read {
                Ok(Ok((found, nothing))) => {
                    parts = found;
                    self.advance(nothing);
                }
                Ok(Err(error)) => {
                    tracing::warn!(%error, "samples of the past are not forwarded: the store cannot be read");
                    return Ok(false);
                }
                Err(error) => return Err(LinkError::Away(error.to_string())),
            }
        }
        let messages: Vec<Outgoing> = parts.iter().map(|part| part.message.clone()).collect();
        let sent = link.send(&messages).await;
        let kept = sent.as_ref().err().map_or(parts.len(), |(kept, _)| *kept);
        let more = parts.iter().any(|part| part.more) || self.places.values().any(|place| place.behind);
        self.advance(parts.into_iter().take(kept).flat_map(|part| part.after).collect());
        sent.map(|()| more).map_err(|(_, error)| error)
    }

    fn advance(&mut self, after: Vec<After>) {
        for (key, next, last, behind) in after {
            if let Some(place) = self.places.get_mut(&key) {
                (place.next, place.last, place.behind) = (next, last, behind);
            }
        }
    }

    /// Finds where each tag is, by the last message of its loop.
    async fn place(&mut self, link: &Link, history: &Arc<History>) -> Result<(), LinkError> {
        let mut index = 0;
        let (mut new, mut known) = (Vec::<(TagKey, Arc<Ring>)>::new(), HashMap::<TagKey, Place>::new());
        for own in history.loops() {
            for tag in &own.tags {
                let Some(ring) = history.ring(index) else { continue };
                index += 1;
                let key = (own.id.clone(), tag.kind.name().to_string(), tag.source.clone());
                match self.places.get(&key) {
                    Some(place) if Arc::ptr_eq(&place.ring, ring) => drop(known.insert(key, place.clone())),
                    _ => new.push((key, ring.clone())),
                }
            }
        }
        let mut loops: Vec<LoopId> = new.iter().map(|((id, ..), _)| id.clone()).collect();
        loops.dedup();
        let (site, own) = (self.site.clone(), link.clone());
        let ask = move |id: LoopId| last_of(own.clone(), site.clone(), id);
        let last: Vec<_> = stream::iter(loops).map(ask).buffer_unordered(AT_ONCE).collect().await;
        let last: HashMap<LoopId, Samples> = last.into_iter().collect::<Result<_, LinkError>>()?;
        for (key, ring) in new {
            let of_tag = last.get(&key.0).into_iter().flat_map(|message| &message.tags);
            let of_tag = of_tag.filter(|tag| tag.tag == key.1 && tag.source == key.2);
            let stamp =
                of_tag.filter_map(|tag| codec::decode(&tag.block)?.last().map(|sample| sample.t)).next_back();
            let last = stamp.unwrap_or(f64::NAN);
            let (next, behind) = first_after(&ring, last);
            known.insert(key, Place { ring, next, last, behind });
        }
        self.places = known;
        Ok(())
    }

    /// What is new of a loop; what the rings no longer hold of it, instead, in `missing`.
    fn part(&self, id: &LoopId, history: &History, missing: &mut Vec<Missing>) -> Option<Part> {
        let own = history.loops().iter().find(|own| own.id == *id)?;
        let (mut tags, mut after, mut more) = (Vec::new(), Vec::new(), false);
        for tag in &own.tags {
            let key = (id.clone(), tag.kind.name().to_string(), tag.source.clone());
            let Some(place) = self.places.get(&key) else { continue };
            let (first, samples) = place.ring.since(place.next, MOST_SAMPLES);
            let overwritten = first > place.next && place.last.is_finite();
            if (place.behind || overwritten)
                && let Some(sample) = samples.first()
            {
                missing.push(Missing { key, last: place.last, until: sample.t, next: first });
                continue;
            }
            let Some(last) = samples.last() else { continue };
            more |= samples.len() == MOST_SAMPLES;
            after.push((key, first + samples.len() as u64, last.t, false));
            tags.push(block(tag.kind.name(), &tag.source, &samples));
        }
        let body = Samples { tags }.encode_to_vec();
        let subject = Subject::new(&self.site, id.as_str(), What::Samples).to_string();
        (!after.is_empty()).then_some(Part { message: Outgoing { subject, body }, after, more })
    }

    /// Forwards diagnoses and changes of alarms that are new; whether there is more.
    ///
    /// # Errors
    /// [`LinkError`]; what was kept before it may be sent again, under the same id.
    pub(super) async fn events(
        &mut self,
        link: &Link,
        config: &store::Config,
        told: Told,
    ) -> Result<bool, LinkError> {
        let subject = Subject::new(&self.site, &self.name, What::Cursor).to_string();
        let cursor = match self.cursor {
            Some(cursor) => cursor,
            None => {
                let last = link.last(LATEST, &subject).await?;
                last.and_then(|(_, body)| Cursor::decode(&body[..]).ok()).unwrap_or_default()
            }
        };
        let (site, own) = (self.site.clone(), config.clone());
        let read = tokio::task::spawn_blocking(move || news(&site, &own, cursor, told)).await;
        let (messages, after, more) = match read {
            Ok(Ok(read)) => read,
            Ok(Err(error)) => {
                tracing::warn!(%error, "diagnoses and alarms are not forwarded: the store cannot be read");
                return Ok(false);
            }
            Err(error) => return Err(LinkError::Away(error.to_string())),
        };
        link.send(&messages).await.map_err(|(_, error)| error)?;
        if self.cursor != Some(after) {
            let body = after.encode_to_vec();
            link.send(&[Outgoing { subject, body }]).await.map_err(|(_, error)| error)?;
        }
        self.cursor = Some(after);
        Ok(more)
    }

    /// Number of the last change that was forwarded; `None` before that is known.
    pub(super) fn forwarded(&self) -> Option<u64> {
        self.cursor.map(|cursor| cursor.change)
    }
}

/// The last message of samples of a loop.
async fn last_of(link: Link, site: String, id: LoopId) -> Result<(LoopId, Samples), LinkError> {
    let subject = Subject::new(&site, id.as_str(), What::Samples).to_string();
    let last = link.last(SAMPLES, &subject).await?;
    let message = last.and_then(|(_, body)| Samples::decode(&body[..]).ok());
    Ok((id, message.unwrap_or_default()))
}

/// Number of the first sample of a ring that is later than `stamp`, of all where that is NaN; and whether none was as early, so
/// that something may lie between.
fn first_after(ring: &Ring, stamp: f64) -> (u64, bool) {
    let (first, samples) = ring.since(0, ring.capacity());
    let known = samples.iter().rposition(|sample| sample.t <= stamp).map_or(0, |at| at + 1);
    (first + known as u64, known == 0 && stamp.is_finite())
}

/// The next slice of what rings no longer hold, and the tags of which there is nothing in it.
fn from_store(
    site: &str,
    config: &store::Config,
    missing: Vec<Missing>,
) -> Result<(Vec<Part>, Vec<After>), StoreError> {
    let mut reader = Reader::of(config)?;
    let (mut parts, mut nothing) = (Vec::new(), Vec::new());
    for Missing { key, last, until, next } in missing {
        let (id, tag, source) = &key;
        let end = until.min(last + SLICE_S);
        let behind = end < until;
        let mut samples: Vec<Sample> = reader.between(id.as_str(), tag, last, end)?;
        samples.retain(|sample| sample.t > last && sample.t < until);
        if samples.is_empty() {
            nothing.push((key, next, if behind { end } else { last }, behind));
            continue;
        }
        let subject = Subject::new(site, id.as_str(), What::Samples).to_string();
        let some: Vec<&[Sample]> = samples.chunks(MOST_SAMPLES).collect();
        for (at, chunk) in some.iter().enumerate() {
            let stamp = chunk.last().map_or(last, |sample| sample.t);
            let behind = behind || at + 1 < some.len();
            let body = Samples { tags: vec![block(tag, source, chunk)] }.encode_to_vec();
            let message = Outgoing { subject: subject.clone(), body };
            parts.push(Part { message, after: vec![(key.clone(), next, stamp, behind)], more: true });
        }
    }
    Ok((parts, nothing))
}

/// What the store has behind the cursor, the cursor after it, and whether there may be more.
fn news(
    site: &str,
    config: &store::Config,
    before: Cursor,
    told: Told,
) -> Result<(Vec<Outgoing>, Cursor, bool), StoreError> {
    let reader = Reader::of(config)?;
    let (mut messages, mut cursor) = (Vec::new(), before);
    let number = |number: i64| u64::try_from(number).unwrap_or(0);
    let after = |number: u64| i64::try_from(number).unwrap_or(i64::MAX);
    let runs = reader.diagnoses(after(before.diagnosis), ROWS)?;
    let changes = reader.transitions(after(before.change), ROWS)?;
    let more = runs.len() == ROWS || changes.len() == ROWS;
    for (at, row) in runs {
        cursor.diagnosis = number(at);
        let control_loop = row.control_loop.clone();
        let model = reader.model(&control_loop)?;
        let effects = model.iter().flat_map(|model| model.effects.lines());
        let effects = effects.filter_map(|line| line.split_once('\t')).map(|(kind, tag)| Effect {
            kind: kind.to_string(),
            tag: Some(tag.to_string()).filter(|tag| !tag.is_empty()),
        });
        let run = convert::run(row, effects.collect(), None);
        let message =
            Diagnosis { number: cursor.diagnosis, run: Some(run), model: model.map(convert::model) };
        let subject = Subject::new(site, &control_loop, What::Diagnosis).to_string();
        messages.push(Outgoing { subject, body: message.encode_to_vec() });
    }
    for (at, row) in changes {
        cursor.change = number(at);
        let subject = Subject::new(site, &row.control_loop, What::Alarm).to_string();
        let state = reader.alarm(&row.control_loop, &row.kind)?.map(convert::alarm);
        let known = cursor.change <= told.last && row.at >= told.since;
        let change = Some(convert::change(row));
        let message = Alarm { number: cursor.change, state, change, told: known };
        messages.push(Outgoing { subject, body: message.encode_to_vec() });
    }
    Ok((messages, cursor, more))
}
