//! How an edge forwards what it found: what happened to its alarms, how they stand, and its diagnoses, from its store and by their
//! numbers there. How far that has come is in a stream, with the place of the last message, see [`progress`](super::progress).

use super::alone::{Told, known_of};
use super::forward::{Came, HEAD_BYTES, ROUND_BYTES, of_store};
use super::progress::{Place, Way};
use super::teller::Key;
use crate::fleet::convert;
use crate::fleet::link::{Link, LinkError, Outgoing, StreamState};
use crate::fleet::message::{Alarm, AlarmState, Cursor, Diagnosis, States};
use crate::fleet::streams::{ALARMS, DIAGNOSES, LATEST, STATE_MESSAGE, STATES};
use crate::fleet::subject::{Subject, What};
use crate::fleet::weights;
use crate::store::{self, AlarmRow, Reader, StoreError};
use prost::Message;
use std::collections::{BTreeSet, HashMap, VecDeque};
use std::time::Duration;

/// Rows that are read from the store in one go.
const ROWS: usize = 100;
/// Loops and collectors whose alarms are told anew in one round.
const STATES_AT_ONCE: usize = 200;
/// Of a message of how alarms stand beside its body (bytes).
const STATE_HEAD: usize = 1024;

/// Whose findings they are.
#[derive(Clone, Debug, Default)]
struct Edge {
    site: String,
    name: String,
}

impl Edge {
    fn subject(&self, name: &str, what: What) -> String {
        Subject::new(&self.site, name, what).to_string()
    }

    /// The subject of how the alarms of a loop or collector stand here.
    fn state_of(&self, name: &str) -> String {
        Subject::new(&self.site, name, What::State).of_edge(&self.name)
    }

    /// Whether a message is what this edge has sent of the diagnosis or change with this number.
    fn has_sent(&self, subject: &str, body: Vec<u8>, number: u64) -> bool {
        let what = Subject::read(subject).map(|own| own.what);
        let sent = match what {
            Some(What::Alarm) => weights::read::<Alarm>(subject, body).map(|own| (own.edge, own.number)),
            Some(What::Diagnosis) => {
                weights::read::<Diagnosis>(subject, body).map(|own| (own.edge, own.number))
            }
            _ => None,
        };
        sent.is_some_and(|(edge, own)| edge == self.name && own == number)
    }
}

/// How far what was found has been forwarded.
#[derive(Default)]
pub(super) struct Found {
    edge: Edge,
    changes: Way,
    diagnoses: Way,
    /// The cursor as the stream has it, once that was asked for.
    noted: Option<Cursor>,
    /// Whether the streams of alarms surely have what they had acknowledged, and whether that of diagnoses has.
    are_sure: (bool, bool),
    /// The loops and collectors that are watched.
    subjects: Vec<String>,
    /// Those of them whose states the stream may not have.
    due: VecDeque<String>,
    /// When the stream of states was made (ns since the Unix epoch), and the last message that it has of ours.
    states: (i128, Option<(String, u64)>),
    /// Changes of alarms that were forwarded since they were asked for.
    known: Vec<Key>,
    /// The store could not be read for alarms.
    is_unread: bool,
}

/// What the store has that is new.
#[derive(Default)]
struct News {
    /// How the alarms stand that changed, to be sent before that.
    states: Vec<Outgoing>,
    messages: Vec<Outgoing>,
    /// The changes of alarms among them that may be told here.
    known: Vec<Key>,
    /// Number of the last.
    last: u64,
    /// There may be more.
    more: bool,
}

impl News {
    fn came(&self) -> Came {
        if self.more { Came::Part } else { Came::Whole }
    }
}

impl Found {
    pub(super) fn new(site: &str, name: &str) -> Self {
        Self { edge: Edge { site: site.to_string(), name: name.to_string() }, ..Self::default() }
    }

    /// These loops and collectors are watched from now on: how the alarms of each stand is sent anew. It takes the place of what an
    /// edge with another disk has said of them.
    pub(super) fn watch(&mut self, subjects: Vec<String>) {
        self.due = subjects.iter().cloned().collect();
        self.subjects = subjects;
    }

    /// The server was away, and may have lost what it had acknowledged: it is asked before anything else is sent.
    pub(super) fn doubt(&mut self) {
        self.are_sure = (false, false);
    }

    /// Forwards changes of alarms that are new.
    ///
    /// # Errors
    /// [`LinkError`]; what was kept before it may be sent again, under the same id.
    pub(super) async fn alarms(
        &mut self,
        link: &Link,
        config: &store::Config,
        told: Told,
        now: Duration,
    ) -> Result<Came, LinkError> {
        self.look_at_alarms(link).await?;
        let (edge, from) = (self.edge.clone(), self.changes.number());
        let read = of_store(config, "alarms", move |config| changes(&edge, config, from, &told)).await?;
        self.is_unread = read.is_none();
        let Some(news) = read else { return Ok(Came::Unread) };
        let came = news.came();
        // A centre that begins anew takes the states alone, so they are never older than a change that was deleted.
        self.send_states(link, &news.states).await?;
        let sequence = link.keep(&news.messages).await.map_err(|(_, error)| error)?;
        self.known.extend(news.known);
        if !news.messages.is_empty() || news.last != from {
            self.changes.kept(news.last, sequence, now);
        }
        self.note(link).await?;
        Ok(came)
    }

    /// Forwards diagnoses that are new, as many as there is room for in one round.
    ///
    /// # Errors
    /// As [`Found::alarms`].
    pub(super) async fn diagnoses(
        &mut self,
        link: &Link,
        config: &store::Config,
        now: Duration,
    ) -> Result<Came, LinkError> {
        self.look_at_diagnoses(link).await?;
        let (edge, from) = (self.edge.clone(), self.diagnoses.number());
        let most = link.max_bytes().saturating_sub(HEAD_BYTES);
        let read = of_store(config, "diagnoses", move |config| diagnoses(&edge, config, from, most)).await?;
        let Some(news) = read else { return Ok(Came::Unread) };
        let sequence = link.keep(&news.messages).await.map_err(|(_, error)| error)?;
        if !news.messages.is_empty() || news.last != from {
            self.diagnoses.kept(news.last, sequence, now);
        }
        self.note(link).await?;
        Ok(news.came())
    }

    /// Forwards how alarms stand, of some loops and collectors of which the stream may not have it.
    ///
    /// # Errors
    /// [`LinkError`].
    pub(super) async fn states(&mut self, link: &Link, config: &store::Config) -> Result<Came, LinkError> {
        self.look_at_alarms(link).await?;
        let some: Vec<String> = self.due.iter().take(STATES_AT_ONCE).cloned().collect();
        if some.is_empty() {
            return Ok(Came::Whole);
        }
        let (edge, count) = (self.edge.clone(), some.len());
        let read = move |config: &store::Config| -> Result<Vec<Outgoing>, StoreError> {
            let rows = Reader::of(config)?.alarms()?;
            Ok(states_of(&edge, some, &rows))
        };
        let Some(messages) = of_store(config, "how alarms stand", read).await? else {
            return Ok(Came::Unread);
        };
        self.send_states(link, &messages).await?;
        self.due.drain(..count);
        Ok(if self.due.is_empty() { Came::Whole } else { Came::Part })
    }

    /// The changes of alarms that were forwarded since this was asked last.
    pub(super) fn forwarded(&mut self) -> Vec<Key> {
        std::mem::take(&mut self.known)
    }

    /// Whether the store could not be read when alarms were to be forwarded last.
    pub(super) fn is_unread(&self) -> bool {
        self.is_unread
    }

    async fn send_states(&mut self, link: &Link, messages: &[Outgoing]) -> Result<(), LinkError> {
        let Some(last) = messages.last() else { return Ok(()) };
        let sequence = link.keep(messages).await.map_err(|(_, error)| error)?;
        self.states.1 = Some((last.subject.clone(), sequence));
        Ok(())
    }

    /// Where that is in doubt, asks the streams of alarms for what they had acknowledged. What they have lost is sent again.
    async fn look_at_alarms(&mut self, streams: &impl Ask) -> Result<(), LinkError> {
        if !self.are_sure.0 {
            self.take_cursor(streams).await?;
            look_at(streams, ALARMS, &self.edge, &mut self.changes).await?;
            self.look_at_states(streams).await?;
            self.are_sure.0 = true;
        }
        Ok(())
    }

    /// The same of diagnoses: the last of them is fetched for that, which may be long, and no alarm waits for it.
    async fn look_at_diagnoses(&mut self, streams: &impl Ask) -> Result<(), LinkError> {
        if !self.are_sure.1 {
            self.take_cursor(streams).await?;
            look_at(streams, DIAGNOSES, &self.edge, &mut self.diagnoses).await?;
            self.are_sure.1 = true;
        }
        Ok(())
    }

    /// Asks how far everything had come before the start, once.
    async fn take_cursor(&mut self, streams: &impl Ask) -> Result<(), LinkError> {
        if self.noted.is_none() {
            let subject = self.edge.subject(&self.edge.name, What::Cursor);
            let last = streams.last(LATEST, &subject).await?;
            let noted = last.and_then(|(_, body)| weights::read::<Cursor>(&subject, body));
            let cursor = noted.unwrap_or_default();
            (self.changes, self.diagnoses) = (Way::from(cursor.changes), Way::from(cursor.diagnoses));
            self.noted = Some(cursor);
        }
        Ok(())
    }

    /// Each message of states stays until this edge sends another of the same loop. So where the last is gone others may be, too.
    async fn look_at_states(&mut self, streams: &impl Ask) -> Result<(), LinkError> {
        let made = streams.state(STATES).await?.made;
        if let (before, Some((subject, sequence))) = &self.states {
            let there = streams.at(STATES, *sequence).await?;
            if *before != made || there.is_none_or(|(own, _)| own != *subject) {
                self.due = self.subjects.iter().cloned().collect();
            }
        }
        self.states.0 = made;
        Ok(())
    }

    /// Notes in a stream how far everything has come.
    async fn note(&mut self, link: &Link) -> Result<(), LinkError> {
        let (changes, diagnoses) = (Some(self.changes.progress()), Some(self.diagnoses.progress()));
        let cursor = Cursor { diagnoses, changes };
        if self.noted == Some(cursor) {
            return Ok(());
        }
        let subject = self.edge.subject(&self.edge.name, What::Cursor);
        let message = [Outgoing::latest(subject, cursor.encode_to_vec())];
        link.send(&message).await.map_err(|(_, error)| error)?;
        self.noted = Some(cursor);
        Ok(())
    }
}

/// What streams are asked about what they had acknowledged, as [`Link`] asks it.
trait Ask: Sync {
    fn last(
        &self,
        stream: &str,
        subject: &str,
    ) -> impl Future<Output = Result<Option<(u64, Vec<u8>)>, LinkError>> + Send;
    fn state(&self, stream: &str) -> impl Future<Output = Result<StreamState, LinkError>> + Send;
    fn at(
        &self,
        stream: &str,
        sequence: u64,
    ) -> impl Future<Output = Result<Option<(String, Vec<u8>)>, LinkError>> + Send;
}

impl Ask for Link {
    async fn last(&self, stream: &str, subject: &str) -> Result<Option<(u64, Vec<u8>)>, LinkError> {
        Link::last(self, stream, subject).await
    }

    async fn state(&self, stream: &str) -> Result<StreamState, LinkError> {
        Link::state(self, stream).await
    }

    async fn at(&self, stream: &str, sequence: u64) -> Result<Option<(String, Vec<u8>)>, LinkError> {
        Link::at(self, stream, sequence).await
    }
}

/// Asks a stream for what it had acknowledged.
async fn look_at(streams: &impl Ask, stream: &str, edge: &Edge, way: &mut Way) -> Result<(), LinkError> {
    let state = streams.state(stream).await?;
    let there = match way.sequence().filter(|sequence| *sequence <= state.last) {
        Some(sequence) => streams.at(stream, sequence).await?,
        None => None,
    };
    let is_ours = there.map(|(subject, body)| edge.has_sent(&subject, body, way.number()));
    let before = way.number();
    match way.look(state, is_ours) {
        Place::Kept => {}
        place => tracing::warn!(
            stream,
            ?place,
            before,
            from = way.number(),
            "the server has lost messages that it had acknowledged: they are forwarded again"
        ),
    }
    Ok(())
}

/// Number of the row behind which a table is read: 0 where the store was made anew, which numbers from 1 again. What is sent again
/// then is known by its time.
fn begin<T>(
    from: u64,
    rows: impl Fn(i64, usize) -> Result<Vec<(i64, T)>, StoreError>,
) -> Result<u64, StoreError> {
    let before = i64::try_from(from).unwrap_or(i64::MAX) - 1;
    Ok(if from > 0 && rows(before, 1)?.is_empty() { 0 } else { from })
}

/// The changes of alarms that the store has behind a number.
fn changes(edge: &Edge, config: &store::Config, from: u64, told: &Told) -> Result<News, StoreError> {
    let reader = Reader::of(config)?;
    let mut news =
        News { last: begin(from, |after, most| reader.transitions(after, most))?, ..News::default() };
    let mut rows = reader.transitions(i64::try_from(news.last).unwrap_or(i64::MAX), ROWS)?;
    if rows.is_empty() {
        return Ok(news);
    }
    let own = told.own();
    let free = rows.iter().take_while(|(_, row)| !told.is_held(row, &own)).count();
    rows.truncate(free);
    if rows.is_empty() {
        return Ok(news);
    }
    news.more = rows.len() == ROWS;
    news.known = known_of(&rows, &own);
    // Asked after the changes: a state is never older than the change beside it.
    let states = reader.alarms()?;
    let changed: BTreeSet<String> = rows.iter().map(|(_, row)| row.control_loop.clone()).collect();
    news.states = states_of(edge, changed, &states);
    let by_name: HashMap<(String, String), AlarmRow> =
        states.into_iter().map(|row| ((row.control_loop.clone(), row.kind.clone()), row)).collect();
    for (number, row) in rows {
        news.last = u64::try_from(number).unwrap_or(0);
        let subject = edge.subject(&row.control_loop, What::Alarm);
        let state = by_name.get(&(row.control_loop.clone(), row.kind.clone()));
        let message = Alarm {
            number: news.last,
            state: state.cloned().map(convert::alarm),
            told: told.is_told(&row),
            change: Some(convert::change(row)),
            edge: edge.name.clone(),
        };
        news.messages.push(Outgoing::once(subject, message.encode_to_vec()));
    }
    Ok(news)
}

/// The diagnoses that the store has behind a number, of about as many bytes as a round takes, each message of at most `most`.
fn diagnoses(edge: &Edge, config: &store::Config, from: u64, most: usize) -> Result<News, StoreError> {
    let reader = Reader::of(config)?;
    let mut news =
        News { last: begin(from, |after, most| reader.diagnoses(after, most))?, ..News::default() };
    let runs = reader.diagnoses(i64::try_from(news.last).unwrap_or(i64::MAX), ROWS)?;
    news.more = runs.len() == ROWS;
    let mut bytes = 0;
    for (number, row) in runs {
        if bytes >= ROUND_BYTES {
            news.more = true;
            break;
        }
        news.last = u64::try_from(number).unwrap_or(0);
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
        let message = Diagnosis {
            number: news.last,
            run: Some(run),
            model: model.map(convert::model),
            edge: edge.name.clone(),
        };
        let subject = edge.subject(&control_loop, What::Diagnosis);
        let message = Outgoing::once(subject, message.encode_to_vec());
        bytes += message.body.len();
        news.messages.push(message);
    }
    Ok(news)
}

/// How all alarms of some loops and collectors stand, by the rows of the store; of one that has no row that all are normal.
fn states_of(edge: &Edge, subjects: impl IntoIterator<Item = String>, rows: &[AlarmRow]) -> Vec<Outgoing> {
    let mut by_subject: HashMap<&str, Vec<AlarmState>> = HashMap::new();
    for row in rows {
        by_subject.entry(&row.control_loop).or_default().push(convert::alarm(row.clone()));
    }
    let mut messages = Vec::new();
    for name in subjects {
        let alarms = by_subject.remove(name.as_str()).unwrap_or_default();
        let body = States { alarms, edge: edge.name.clone() }.encode_to_vec();
        if body.len() + STATE_HEAD > STATE_MESSAGE as usize {
            // Else nothing behind it would ever be forwarded.
            tracing::error!(
                control_loop = name,
                bytes = body.len(),
                "how the alarms of a loop stand is too long to be forwarded: a centre that begins anew does not know them"
            );
            continue;
        }
        messages.push(Outgoing::latest(edge.state_of(&name), body));
    }
    messages
}

#[cfg(test)]
mod tests;
