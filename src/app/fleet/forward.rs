//! How an edge forwards: samples from its rings, and from its store what the rings no longer hold; diagnoses and changes of
//! alarms from its store, by their numbers there. How far it has come is known from the streams, so nothing has to be
//! remembered here.

use super::alone::{Told, known_by};
use super::teller::Key;
use crate::fleet::convert::{self, block};
use crate::fleet::link::{Link, LinkError, Outgoing};
use crate::fleet::message::{self, Alarm, Cursor, Diagnosis, Samples, TagSamples};
use crate::fleet::streams::{LATEST, SAMPLES};
use crate::fleet::subject::{Subject, What};
use crate::fleet::weights;
use crate::history::{History, LoopTags, Ring};
use crate::signal::{LoopId, Sample};
use crate::store::{self, Reader, StoreError};
use futures::{StreamExt, stream};
use prost::Message;
use std::collections::HashMap;
use std::sync::Arc;

/// A stamp that falls by less (s) is only late.
const SET_BACK_S: f64 = 1.0;
/// Of a message beside its report or its samples (bytes).
const HEAD_BYTES: usize = 64 * 1024;
/// Samples of one tag in one message.
pub(super) const MOST_SAMPLES: usize = 2000;
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
    /// Stamp of the last that has been (s); where the store had nothing, the end of what was looked through. NaN before there
    /// is one.
    last: f64,
    /// Stamp of the last that has been (s); NaN before there is one.
    sent: f64,
    /// What lies between that and the ring's first may be in the store.
    behind: bool,
}

impl Place {
    /// Whether there is something behind it to be looked for: what lies before a ring that is empty is told by its first sample.
    fn is_behind(&self) -> bool {
        self.behind && self.ring.pushed() > self.next
    }
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
    /// Changes of alarms that were forwarded since they were asked for.
    changes: Vec<Key>,
    /// The store could not be read for diagnoses and alarms.
    unread: bool,
}

/// What is to be sent of one loop, and where its tags are after it.
struct Part {
    id: LoopId,
    tags: Vec<TagSamples>,
    after: Vec<After>,
    /// There is more of it.
    more: bool,
}

/// Where a tag is once a part was sent, or once the store was found to have nothing of it: see [`Place`].
struct After {
    key: TagKey,
    next: u64,
    last: f64,
    behind: bool,
}

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
        let most = link.max_bytes().saturating_sub(HEAD_BYTES);
        let (mut parts, mut missing) = (Vec::new(), Vec::new());
        for own in history.loops() {
            let (part, not_in_ring) = self.part(own, most);
            parts.extend(part);
            missing.extend(not_in_ring);
        }
        if !missing.is_empty() {
            // The store first: a centre's rings go forward only.
            let config = config.clone();
            let read = tokio::task::spawn_blocking(move || {
                from_store(&config, missing, most).inspect_err(|error| store::heed(&config, error))
            })
            .await;
            match read {
                Ok(Ok((found, nothing))) => {
                    parts = found;
                    self.advance(nothing, false);
                }
                Ok(Err(error)) => {
                    tracing::warn!(%error, "samples of the past are not forwarded: the store cannot be read");
                    return Ok(false);
                }
                Err(error) => return Err(LinkError::Away(error.to_string())),
            }
        }
        let mut places: HashMap<&LoopId, Vec<(&TagKey, &Place)>> = HashMap::new();
        for (key, place) in &self.places {
            places.entry(&key.0).or_default().push((key, place));
        }
        let messages: Vec<Outgoing> =
            parts.iter_mut().map(|part| message(&self.site, part, &places)).collect();
        let sent = link.send(&messages).await;
        let kept = sent.as_ref().err().map_or(parts.len(), |(kept, _)| *kept);
        let more = parts.iter().any(|part| part.more) || self.places.values().any(Place::is_behind);
        self.advance(parts.into_iter().take(kept).flat_map(|part| part.after).collect(), true);
        sent.map(|()| more).map_err(|(_, error)| error)
    }

    /// `sent`: the last stamps are those of samples.
    fn advance(&mut self, after: Vec<After>, sent: bool) {
        for After { key, next, last, behind } in after {
            if let Some(place) = self.places.get_mut(&key) {
                (place.next, place.last, place.behind) = (next, last, behind);
                place.sent = if sent { last } else { place.sent };
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
            let places = last.get(&key.0).into_iter().flat_map(|message| &message.places);
            let place = places.into_iter().find(|place| place.tag == key.1 && place.source == key.2);
            let last = place.map_or(f64::NAN, |place| place.last);
            let (next, behind) = first_after(&ring, last);
            known.insert(key, Place { ring, next, last, sent: last, behind });
        }
        self.places = known;
        Ok(())
    }

    /// What is new of a loop, of at most so many bytes, and the tags of which the ring no longer holds all that is new.
    fn part(&self, own: &LoopTags, most: usize) -> (Option<Part>, Vec<Missing>) {
        let (id, mut missing) = (&own.id, Vec::new());
        let (mut tags, mut after, mut more) = (Vec::<TagSamples>::new(), Vec::new(), false);
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
            // A sample from after the clock was set back begins a message of its own, which says so.
            let (set_back, end) = match (first_fall(&samples, place.last), samples.first()) {
                (Some(0), Some(own)) => (true, first_fall(&samples, own.t)),
                (fall, _) => (false, fall),
            };
            let end = end.unwrap_or(samples.len());
            let some = &samples[..end];
            let Some(last) = some.last() else { continue };
            let own = TagSamples { set_back, ..block(tag.kind.name(), &tag.source, some) };
            if !has_room(&tags, &own, most) {
                more = true;
                continue;
            }
            more |= samples.len() == MOST_SAMPLES || end < samples.len();
            after.push(After { key, next: first + some.len() as u64, last: last.t, behind: false });
            tags.push(own);
        }
        let part = (!after.is_empty()).then(|| Part { id: id.clone(), tags, after, more });
        (part, missing)
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
                last.and_then(|(_, body)| weights::read::<Cursor>(&subject, body)).unwrap_or_default()
            }
        };
        let (site, own) = (self.site.clone(), config.clone());
        let most = link.max_bytes().saturating_sub(HEAD_BYTES);
        let read = tokio::task::spawn_blocking(move || {
            news(&site, &own, cursor, (&told, most)).inspect_err(|error| store::heed(&own, error))
        })
        .await;
        let News { messages, changes, after, more } = match read {
            Ok(Ok(read)) => read,
            Ok(Err(error)) => {
                tracing::warn!(%error, "diagnoses and alarms are not forwarded: the store cannot be read");
                self.unread = true;
                return Ok(false);
            }
            Err(error) => return Err(LinkError::Away(error.to_string())),
        };
        self.unread = false;
        link.send(&messages).await.map_err(|(_, error)| error)?;
        self.changes.extend(changes);
        if self.cursor != Some(after) {
            let body = after.encode_to_vec();
            link.send(&[Outgoing::latest(subject, body)]).await.map_err(|(_, error)| error)?;
        }
        self.cursor = Some(after);
        Ok(more)
    }

    /// The changes of alarms that were forwarded since this was asked last.
    pub(super) fn forwarded(&mut self) -> Vec<Key> {
        std::mem::take(&mut self.changes)
    }

    /// Whether the store could not be read when alarms were to be forwarded last.
    pub(super) fn is_unread(&self) -> bool {
        self.unread
    }
}

/// What the store has that is new.
struct News {
    messages: Vec<Outgoing>,
    /// The changes of alarms among them.
    changes: Vec<Key>,
    /// The cursor behind them.
    after: Cursor,
    /// There may be more.
    more: bool,
}

/// The message of a part, with where every tag of its loop is after it.
fn message(site: &str, part: &mut Part, places: &HashMap<&LoopId, Vec<(&TagKey, &Place)>>) -> Outgoing {
    let own = || places.get(&part.id).into_iter().flatten();
    for tag in &mut part.tags {
        let place = own().find(|(key, _)| (&key.1, &key.2) == (&tag.tag, &tag.source));
        tag.after = place.map(|(_, place)| place.sent).filter(|sent| sent.is_finite());
    }
    let places = own().map(|(key, before)| {
        let after = part.after.iter().find(|after| after.key == **key);
        let last = after.map_or(before.last, |after| after.last);
        message::Place { tag: key.1.clone(), source: key.2.clone(), last }
    });
    let places = places.filter(|place| place.last.is_finite()).collect();
    let body = Samples { tags: std::mem::take(&mut part.tags), places }.encode_to_vec();
    Outgoing::once(Subject::new(site, part.id.as_str(), What::Samples).to_string(), body)
}

/// The last message of samples of a loop.
async fn last_of(link: Link, site: String, id: LoopId) -> Result<(LoopId, Samples), LinkError> {
    let subject = Subject::new(&site, id.as_str(), What::Samples).to_string();
    let last = link.last(SAMPLES, &subject).await?;
    let message = last.and_then(|(_, body)| weights::read::<Samples>(&subject, body));
    Ok((id, message.unwrap_or_default()))
}

/// Number of the first sample of a ring that is later than `stamp`, of all where that is NaN; and whether none was as early, so
/// that something may lie between.
fn first_after(ring: &Ring, stamp: f64) -> (u64, bool) {
    let (first, samples) = ring.since(0, ring.capacity());
    // A clock that was set back puts later samples before that stamp: the sample itself is looked for first.
    let same = samples.iter().rposition(|sample| sample.t == stamp);
    let known = same.or_else(|| samples.iter().rposition(|sample| sample.t <= stamp)).map_or(0, |at| at + 1);
    (first + known as u64, known == 0 && stamp.is_finite())
}

/// Where the clock was set back among samples: the first that is stamped well before the one in front of it. In front of all of
/// them is one that is stamped `before` (s).
fn first_fall(samples: &[Sample], mut before: f64) -> Option<usize> {
    let falls = |own: &Sample| own.t < std::mem::replace(&mut before, own.t) - SET_BACK_S;
    samples.iter().position(falls)
}

/// Whether a message of at most so many bytes takes one tag more; the first always goes.
fn has_room(tags: &[TagSamples], own: &TagSamples, most: usize) -> bool {
    let bytes: usize = tags.iter().map(Message::encoded_len).sum();
    tags.is_empty() || bytes + own.encoded_len() <= most
}

/// The next slice of what rings no longer hold, each message of at most so many bytes, and the tags of which there is nothing
/// in it.
fn from_store(
    config: &store::Config,
    missing: Vec<Missing>,
    most: usize,
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
            nothing.push(After { key, next, last: if behind { end } else { last }, behind });
            continue;
        }
        // One message of a tag at a time: of two under way the second may arrive and the first not.
        let some = &samples[..samples.len().min(MOST_SAMPLES)];
        let last = some.last().map_or(last, |sample| sample.t);
        let after = After { key: key.clone(), next, last, behind: behind || some.len() < samples.len() };
        let tag = block(tag, source, some);
        match parts.iter_mut().find(|part: &&mut Part| part.id == *id) {
            // It comes with the next message of its loop.
            Some(part) if !has_room(&part.tags, &tag, most) => {}
            Some(part) => {
                part.tags.push(tag);
                part.after.push(after);
            }
            None => parts.push(Part { id: id.clone(), tags: vec![tag], after: vec![after], more: true }),
        }
    }
    Ok((parts, nothing))
}

/// What the store has behind the cursor, each message of at most so many bytes.
fn news(
    site: &str,
    config: &store::Config,
    before: Cursor,
    (told, most): (&Told, usize),
) -> Result<News, StoreError> {
    let reader = Reader::of(config)?;
    let number = |number: i64| u64::try_from(number).unwrap_or(0);
    let after = |number: u64| i64::try_from(number).unwrap_or(i64::MAX);
    // A store that was made anew numbers from 1 again: what it has is sent from the first on. What is known is known by its time.
    let mut cursor = before;
    if cursor.diagnosis > 0 && reader.diagnoses(after(cursor.diagnosis) - 1, 1)?.is_empty() {
        cursor.diagnosis = 0;
    }
    if cursor.change > 0 && reader.transitions(after(cursor.change) - 1, 1)?.is_empty() {
        cursor.change = 0;
    }
    let (before, mut messages) = (cursor, Vec::new());
    let runs = reader.diagnoses(after(before.diagnosis), ROWS)?;
    let mut changes = reader.transitions(after(before.change), ROWS)?;
    let free = changes.iter().take_while(|(_, row)| !told.is_held(row)).count();
    changes.truncate(free);
    // Older ones are not told here, and a store that is sent from the first on would push out those that are.
    let of_now = changes.iter().filter(|(_, row)| told.is_of_now(row));
    let known = of_now.filter_map(|(_, row)| known_by(row)).collect();
    let more = runs.len() == ROWS || changes.len() == ROWS;
    for (at, row) in runs {
        cursor.diagnosis = number(at);
        let control_loop = row.control_loop.clone();
        let model = reader.model(&control_loop)?;
        // The model beside it has the effects, and alarms are the edge's own.
        let mut run = convert::run(row, Vec::new(), None);
        if run.encoded_len() > most {
            tracing::warn!(
                control_loop,
                bytes = run.encoded_len(),
                "a report is too large to be forwarded: it stays at the edge"
            );
            (run.report, run.basis) = (None, None);
        }
        let message =
            Diagnosis { number: cursor.diagnosis, run: Some(run), model: model.map(convert::model) };
        let subject = Subject::new(site, &control_loop, What::Diagnosis).to_string();
        messages.push(Outgoing::once(subject, message.encode_to_vec()));
    }
    for (at, row) in changes {
        cursor.change = number(at);
        let subject = Subject::new(site, &row.control_loop, What::Alarm).to_string();
        let state = reader.alarm(&row.control_loop, &row.kind)?.map(convert::alarm);
        let told = told.is_told(&row);
        let change = Some(convert::change(row));
        let message = Alarm { number: cursor.change, state, change, told };
        messages.push(Outgoing::once(subject, message.encode_to_vec()));
    }
    Ok(News { messages, changes: known, after: cursor, more })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring(stamps: &[f64]) -> Ring {
        let ring = Ring::new(8);
        stamps.iter().for_each(|t| ring.push(Sample::good(*t, 0.0)));
        ring
    }

    #[test]
    fn what_was_sent_last_is_found_though_the_clock_was_set_back_after_it() {
        // 12 was sent; 13 came, then the clock was set back by 10 s.
        assert_eq!(first_after(&ring(&[10.0, 11.0, 12.0, 13.0, 4.0, 5.0]), 12.0), (3, false));
        // It is no longer there: the last one before it tells.
        assert_eq!(first_after(&ring(&[10.0, 11.0, 13.0]), 12.0), (2, false));
        assert_eq!(first_after(&ring(&[13.0, 14.0]), 12.0), (0, true));
    }

    #[test]
    fn a_clock_that_was_set_back_is_found_and_a_sample_that_is_only_late_is_not() {
        let fall = |stamps: &[f64], before: f64| {
            let samples: Vec<Sample> = stamps.iter().map(|t| Sample::good(*t, 0.0)).collect();
            first_fall(&samples, before)
        };
        assert_eq!(fall(&[10.0, 9.5, 4.0, 5.0, 1.0], f64::NAN), Some(2));
        assert_eq!(fall(&[4.0, 5.0], 12.0), Some(0));
        assert_eq!(fall(&[4.0, 5.0], 4.5), None);
        assert_eq!(fall(&[], 12.0), None);
    }

    #[test]
    fn a_message_takes_no_more_tags_than_the_servers_take_bytes() {
        let own = block("op", "d1", &[Sample::good(1.0, 2.0), Sample::good(2.0, 2.5)]);
        let bytes = own.encoded_len();
        assert!(has_room(&[], &own, bytes / 2), "the first always goes");
        assert!(has_room(std::slice::from_ref(&own), &own, 2 * bytes));
        assert!(!has_room(std::slice::from_ref(&own), &own, 2 * bytes - 1));
    }

    #[test]
    fn nothing_is_looked_for_behind_a_ring_that_is_empty() {
        let place = |stamps: &[f64]| {
            let (next, behind) = first_after(&ring(stamps), 12.0);
            Place { ring: Arc::new(ring(stamps)), next, last: 12.0, sent: 12.0, behind }
        };
        assert!(!place(&[]).is_behind(), "its first sample tells how far to look");
        assert!(place(&[20.0]).is_behind());
    }
}
