//! How an edge forwards samples: from its rings, and from its store what the rings no longer hold. How far it has come is known
//! from the stream, so nothing has to be remembered here.

use crate::fleet::convert::block;
use crate::fleet::link::{Link, LinkError, Outgoing};
use crate::fleet::message::{self, Samples, TagSamples};
use crate::fleet::streams::SAMPLES;
use crate::fleet::subject::{Subject, What};
use crate::fleet::weights;
use crate::history::{History, LoopTags, Ring, TagKind};
use crate::signal::{LoopId, Role, Sample};
use crate::store::{self, Reader, StoreError};
use futures::{StreamExt, TryStreamExt, stream};
use prost::Message;
use std::collections::HashMap;
use std::sync::Arc;

/// A stamp that falls by less (s) is only late.
const SET_BACK_S: f64 = 1.0;
/// Of a message beside its report or its samples (bytes).
pub(super) const HEAD_BYTES: usize = 64 * 1024;
/// Of samples, of diagnoses and of a list no message more is begun behind so many bytes, before the lease and alarms are looked at
/// again: 4 s of a line of 0.5 Mbit/s.
pub(super) const ROUND_BYTES: usize = 250_000;
/// Samples of one tag in one message.
pub(super) const MOST_SAMPLES: usize = 2000;
/// Loops that the server is asked about at the same time: few, because all answers have 5 s together on a slow line.
const AT_ONCE: usize = 8;
/// Samples of the past that are read from the store in one go are of at most this long (s).
const SLICE_S: f64 = 1800.0;

/// How far a round has come with one kind of what an edge forwards.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Came {
    /// All that is new is forwarded.
    Whole,
    /// There is more.
    Part,
    /// The store cannot be read, so that what is new waits.
    Unread,
}

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

/// How far samples have been forwarded.
#[derive(Default)]
pub(super) struct Forward {
    site: String,
    name: String,
    places: HashMap<TagKey, Place>,
    /// The loop that the next round begins with, by its number among all.
    turn: usize,
}

/// What a round sends, from the rings.
#[derive(Default)]
struct Gathered {
    parts: Vec<Part>,
    /// Tags whose samples are no longer in their rings.
    missing: Vec<Missing>,
    /// There was no room for more loops.
    is_cut: bool,
}

/// What is to be sent of one loop, and where its tags are after it.
struct Part {
    id: LoopId,
    tags: Vec<TagSamples>,
    after: Vec<After>,
    /// There is more of it.
    more: bool,
}

impl Part {
    fn bytes(&self) -> usize {
        self.tags.iter().map(Message::encoded_len).sum()
    }
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

    /// The server was away, or others may have deleted what was forwarded: how far that came is asked anew.
    pub(super) fn forget(&mut self) {
        self.places.clear();
    }

    /// Forwards samples that are new, of as many loops as there is room for in one round.
    ///
    /// # Errors
    /// [`LinkError`]; what was kept before it is not sent again.
    pub(super) async fn samples(
        &mut self,
        link: &Link,
        history: &Arc<History>,
        config: &store::Config,
    ) -> Result<Came, LinkError> {
        self.place(link, history).await?;
        let most = link.max_bytes().saturating_sub(HEAD_BYTES);
        let Gathered { mut parts, missing, mut is_cut } = self.gather(history.loops(), most);
        if !missing.is_empty() {
            // The store first: a centre's rings go forward only.
            let own = move |config: &store::Config| from_store(config, missing, most);
            let Some(found) = of_store(config, "samples of the past", own).await? else {
                return Ok(Came::Unread);
            };
            parts = found.parts;
            if let Some(id) = found.cut_at {
                is_cut = true;
                self.turn = history.loops().iter().position(|own| own.id == id).unwrap_or(0);
            }
            self.advance(found.nothing, false);
        }
        let mut places: HashMap<&LoopId, Vec<(&TagKey, &Place)>> = HashMap::new();
        for (key, place) in &self.places {
            places.entry(&key.0).or_default().push((key, place));
        }
        let own = (self.site.as_str(), self.name.as_str());
        let messages: Vec<Outgoing> = parts.iter_mut().map(|part| message(own, part, &places)).collect();
        let sent = link.send(&messages).await;
        let kept = sent.as_ref().err().map_or(parts.len(), |(kept, _)| *kept);
        let more = is_cut || parts.iter().any(|part| part.more) || self.places.values().any(Place::is_behind);
        self.advance(parts.into_iter().take(kept).flat_map(|part| part.after).collect(), true);
        sent.inspect_err(|_| self.forget()).map_err(|(_, error)| error)?;
        Ok(if more { Came::Part } else { Came::Whole })
    }

    /// What is new of the loops whose turn it is, of about as many bytes as a round takes, each message of at most `most`. Where it
    /// is cut the next round goes on there, so that no loop waits for others that always have more.
    fn gather(&mut self, loops: &[LoopTags], most: usize) -> Gathered {
        let (mut own, mut bytes, from) = (Gathered::default(), 0, self.turn);
        for at in (0..loops.len()).map(|at| (from + at) % loops.len()) {
            self.turn = at;
            if bytes >= ROUND_BYTES {
                own.is_cut = true;
                break;
            }
            let (part, missing) = self.part(&loops[at], most.min(ROUND_BYTES));
            bytes += part.as_ref().map_or(0, Part::bytes);
            own.parts.extend(part);
            own.missing.extend(missing);
        }
        own
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

    /// Finds where each tag is, by the last message of its loop. What was answered before a question fails is kept.
    async fn place(&mut self, link: &Link, history: &Arc<History>) -> Result<(), LinkError> {
        let new = self.keep(history);
        let mut loops: Vec<LoopId> = new.iter().map(|((id, ..), _)| id.clone()).collect();
        loops.dedup();
        let (site, own) = (self.site.clone(), link.clone());
        let ask = move |id: LoopId| last_of(own.clone(), site.clone(), id);
        let (asked, mut last) = (stream::iter(loops).map(ask).buffer_unordered(AT_ONCE), HashMap::new());
        let take = |(id, message): (LoopId, Samples)| {
            last.insert(id, message);
            std::future::ready(Ok::<(), LinkError>(()))
        };
        let asked: Result<(), LinkError> = asked.try_for_each(take).await;
        for (key, ring) in new {
            let Some(message) = last.get(&key.0) else { continue };
            let place = message.places.iter().find(|place| place.tag == key.1 && place.source == key.2);
            let last = place.map_or(f64::NAN, |place| place.last);
            let (next, behind) = first_after(&ring, last);
            self.places.insert(key, Place { ring, next, last, sent: last, behind });
        }
        asked
    }

    /// Keeps the places of tags that are still there; the tags that are new, with their rings.
    fn keep(&mut self, history: &History) -> Vec<(TagKey, Arc<Ring>)> {
        let mut before = std::mem::take(&mut self.places);
        let (mut index, mut new) = (0, Vec::new());
        for own in history.loops() {
            for tag in &own.tags {
                let Some(ring) = history.ring(index) else { continue };
                index += 1;
                if is_term(&tag.kind) {
                    continue;
                }
                let key = (own.id.clone(), tag.kind.name().to_string(), tag.source.clone());
                match before.remove(&key).filter(|place| Arc::ptr_eq(&place.ring, ring)) {
                    Some(place) => drop(self.places.insert(key, place)),
                    None => new.push((key, ring.clone())),
                }
            }
        }
        new
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
}

/// Whether a tag is the term of write-back, which never leaves the edge.
fn is_term(kind: &TagKind) -> bool {
    *kind == TagKind::Role(Role::Term)
}

/// The message of a part, with where every tag of its loop is after it.
fn message(
    (site, edge): (&str, &str),
    part: &mut Part,
    places: &HashMap<&LoopId, Vec<(&TagKey, &Place)>>,
) -> Outgoing {
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
    let own = Samples { tags: std::mem::take(&mut part.tags), places, edge: edge.to_string() };
    Outgoing::once(Subject::new(site, part.id.as_str(), What::Samples).to_string(), own.encode_to_vec())
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

/// What the store has of the past.
#[derive(Default)]
struct Found {
    parts: Vec<Part>,
    /// Tags of which it has nothing.
    nothing: Vec<After>,
    /// The loop from which on there was no room, where there was not.
    cut_at: Option<LoopId>,
}

/// The next slice of what rings no longer hold, of about as many bytes as a round takes, each message of at most `most`.
fn from_store(config: &store::Config, missing: Vec<Missing>, most: usize) -> Result<Found, StoreError> {
    let mut reader = Reader::of(config)?;
    let (Found { mut parts, mut nothing, mut cut_at }, mut bytes) = (Found::default(), 0);
    for Missing { key, last, until, next } in missing {
        if bytes >= ROUND_BYTES {
            cut_at = Some(key.0);
            break;
        }
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
        bytes += tag.encoded_len();
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
    Ok(Found { parts, nothing, cut_at })
}

/// What is read of the store on a thread that may block; `None`, told, where the store cannot be read.
pub(super) async fn of_store<T: Send + 'static>(
    config: &store::Config,
    what: &'static str,
    read: impl FnOnce(&store::Config) -> Result<T, StoreError> + Send + 'static,
) -> Result<Option<T>, LinkError> {
    let config = config.clone();
    let read = move || read(&config).inspect_err(|error| store::heed(&config, error));
    match tokio::task::spawn_blocking(read).await {
        Ok(Ok(read)) => Ok(Some(read)),
        Ok(Err(error)) => {
            tracing::warn!(%error, what, "the store cannot be read, so that this is not forwarded");
            Ok(None)
        }
        Err(error) => Err(LinkError::Away(error.to_string())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::history::TagSpec;
    use crate::signal::SpanSource;

    fn ring(stamps: &[f64]) -> Ring {
        let ring = Ring::new(8);
        stamps.iter().for_each(|t| ring.push(Sample::good(*t, 0.0)));
        ring
    }

    /// A loop with these tags, each with as many samples as a message takes.
    fn full(id: &str, tags: &[&str]) -> (LoopTags, Vec<(TagKey, Place)>) {
        let id = LoopId::new(id);
        let spec = |tag: &&str| TagSpec {
            kind: TagKind::named(tag),
            unit: String::new(),
            source: (*tag).to_string(),
        };
        let place = |tag: &&str| {
            let ring = Ring::new(MOST_SAMPLES);
            (0..MOST_SAMPLES).for_each(|at| ring.push(Sample::good(at as f64, (0.7 * at as f64).sin())));
            let place =
                Place { ring: Arc::new(ring), next: 0, last: f64::NAN, sent: f64::NAN, behind: false };
            ((id.clone(), (*tag).to_string(), (*tag).to_string()), place)
        };
        let places = tags.iter().map(place).collect();
        let tags = tags.iter().map(spec).collect();
        let span = SpanSource::Unknown;
        (LoopTags { id: id.clone(), tags, op_limits: None, op_span: None, op_span_source: span }, places)
    }

    #[test]
    fn a_round_is_bounded_and_no_loop_waits_for_others_that_always_have_more() {
        let mut own = Forward::new("north", "e1");
        let mut loops = Vec::new();
        for at in 0..60 {
            let (tags, places) = full(&format!("FIC{at}"), &["op", "pv"]);
            loops.push(tags);
            own.places.extend(places);
        }
        let most = own.gather(&loops[..1], usize::MAX).parts[0].bytes();
        let (mut served, mut rounds) = (Vec::new(), 0);
        own.turn = 0;
        // Nothing is noted as sent, so that each loop has as much in every round.
        while served.len() < loops.len() {
            let round = own.gather(&loops, usize::MAX);
            let bytes: usize = round.parts.iter().map(Part::bytes).sum();
            assert!(round.is_cut && bytes < ROUND_BYTES + most, "{bytes} bytes in one round");
            served.extend(round.parts.into_iter().map(|part| part.id));
            rounds += 1;
        }
        assert!(rounds > 3, "{most} bytes of a loop");
        let first: Vec<LoopId> = loops.iter().map(|own| own.id.clone()).collect();
        assert_eq!(served[..loops.len()], first, "each once, before the first comes again");
    }

    #[test]
    fn the_term_of_write_back_never_leaves_the_edge() {
        let (control_loop, _) = full("FIC1", &["op", "pv", "term"]);
        let config = crate::history::Config::default();
        let history = Arc::new(History::new(&[control_loop], &config));
        let mut own = Forward::new("north", "e1");
        // As where all of them were known before.
        for (tag, ring) in ["op", "pv", "term"].iter().zip(0..) {
            let key = (LoopId::new("FIC1"), (*tag).to_string(), (*tag).to_string());
            let ring = history.ring(ring).expect("there is one").clone();
            ring.push(Sample::good(1.0, 2.0));
            own.places.insert(key, Place { ring, next: 0, last: f64::NAN, sent: f64::NAN, behind: false });
        }
        own.keep(&history);
        let gathered = own.gather(history.loops(), usize::MAX);
        let tags = gathered.parts.iter().flat_map(|part| &part.tags).map(|tag| tag.tag.as_str());
        assert_eq!(tags.collect::<Vec<_>>(), ["op", "pv"]);
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
