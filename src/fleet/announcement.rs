//! What an edge is, in parts: a list of many loops is longer than a message may be, and takes more than one may take once it is
//! decoded. Each part has a subject of its own, by its number, so that the stream keeps the last message of each number.
//!
//! A list is taken whole or not at all, because a loop that a list does not have counts as removed. An edge sends the parts in
//! their order, each once the one before it is kept, so that all of them are in the stream when the last one comes. A centre
//! fetches them then, so that it has one list at a time in memory. The parts of one announcement have the digest of the whole.
//! A part of another announcement is of a newer one, whose own last part comes later. Until then the list of before stays in
//! force.

use super::digest::digest;
use super::link::Outgoing;
use super::message::{Hello, HelloPart};
use super::ops::LOG;
use super::subject::{Subject, What};
use super::weights;
use crate::protobuf::{self, Weighed, weigh};
use prost::Message;
use prost::bytes::Bytes;

/// Most bytes of a list in one part: far less than a server takes by default (1 MB), and few enough that a line of 0.5 Mbit/s
/// carries them within half of the time that an edge or a centre waits for the server's answer (5 s). A centre has them as text,
/// a third longer.
const PART: usize = 1 << 17;
/// Most bytes in the first part. An edge asks for this part to see whether the stream still has its announcement, so it is short.
const FIRST: usize = 1 << 10;
/// Most parts of an announcement: 6 MiB together, and the list of 10,000 loops of eight tags is 3.8 MB.
const MOST_PARTS: u32 = 48;
/// Most that a list takes once it is decoded (bytes): with its own 6 MiB it stays below the 32 MiB of a peer, and one of 10,000
/// loops of eight tags takes 19 MB.
pub const MOST_LIST: usize = 22 << 20;
// What is promised: no peer makes us hold more.
const _: () = assert!(PART * (MOST_PARTS as usize) + MOST_LIST < 32 << 20);
/// Bytes of a digest.
const DIGEST: usize = 32;

/// Whether a centre takes the list that has these bytes.
pub fn is_taken(list: &[u8]) -> bool {
    // Beside the first part.
    list.len().saturating_sub(FIRST).div_ceil(PART) < MOST_PARTS as usize
        && weigh(list, Hello::FIELDS, MOST_LIST).is_ok()
}

/// The messages that announce the list that has these bytes, in their order.
pub fn split(own: &Subject, list: &[u8]) -> Vec<Outgoing> {
    cut(own, list, PART)
}

/// The same, with at most so many bytes in each part behind the first.
fn cut(own: &Subject, list: &[u8], most: usize) -> Vec<Outgoing> {
    let whole = digest(&own.to_string(), list).to_vec();
    // An empty list is a part, too.
    let (first, rest) = list.split_at(list.len().min(FIRST));
    let count = 1 + rest.len().div_ceil(most) as u32;
    let bodies = std::iter::once(first).chain(rest.chunks(most));
    let message = |(number, body): (u32, &[u8])| {
        let part = HelloPart { whole: whole.clone(), number, count, body: Bytes::copy_from_slice(body) };
        Outgoing::latest(own.part(number), part.encode_to_vec())
    };
    (0..count).zip(bodies).map(message).collect()
}

/// Reads a message as a part of an announcement, with its edge. One that is none is refused.
fn read(subject: &str, bytes: impl Into<Bytes>) -> Option<(Subject, HelloPart)> {
    let edge = Subject::read(subject).filter(|own| own.what == What::Hello)?;
    let part = weights::read::<HelloPart>(subject, bytes)?;
    let is_part = part.whole.len() == DIGEST
        && part.body.len() <= PART
        && part.number < part.count
        && part.count <= MOST_PARTS
        && edge.part(part.number) == subject;
    if !is_part {
        weights::refuse(subject, "it is no part of an announcement");
        return None;
    }
    Some((edge, part))
}

/// A message of an announcement, as a centre hears it.
#[derive(Debug)]
pub enum Heard {
    /// Another part than the last, of this edge, with the digest of the whole.
    Part(Subject, Vec<u8>),
    /// The last part: all others are in the stream.
    Last(Announcement),
}

impl Heard {
    /// Reads a message that came. One that is no part is refused.
    pub fn read(subject: &str, bytes: impl Into<Bytes>) -> Option<Self> {
        let (edge, part) = read(subject, bytes)?;
        let (whole, count) = (part.whole, part.count);
        Some(match part.number + 1 == count {
            true => Self::Last(Announcement { edge, whole, count, next: 0, list: Vec::new() }),
            false => Self::Part(edge, whole),
        })
    }
}

/// An announcement whose last part has come, and those of its parts that were fetched.
#[derive(Debug)]
pub struct Announcement {
    edge: Subject,
    whole: Vec<u8>,
    count: u32,
    /// Parts that were fetched: all before this number.
    next: u32,
    /// Their bytes.
    list: Vec<u8>,
}

impl Announcement {
    /// Reads a message that came; nothing where it is another part than the last of its announcement. One that is no part is
    /// refused.
    pub fn read(subject: &str, bytes: impl Into<Bytes>) -> Option<Self> {
        match Heard::read(subject, bytes)? {
            Heard::Last(own) => Some(own),
            Heard::Part(..) => None,
        }
    }

    /// Whose list it is.
    pub fn edge(&self) -> &Subject {
        &self.edge
    }

    /// The digest of the list: another list has another.
    pub fn digest(&self) -> &[u8] {
        &self.whole
    }

    /// How many parts were fetched.
    pub fn fetched(&self) -> u32 {
        self.next
    }

    /// Forgets the parts that were fetched.
    pub fn forget(&mut self) {
        (self.next, self.list) = (0, Vec::new());
    }

    /// Where the next part is; nothing where all were fetched.
    pub fn next_subject(&self) -> Option<String> {
        (self.next < self.count).then(|| self.edge.part(self.next))
    }

    /// Takes the last message that the stream has of [`next_subject`](Self::next_subject), if any; whether it is the next part.
    /// Where it is not, the list cannot be had, which is told in the log.
    pub fn push(&mut self, message: Option<Vec<u8>>) -> bool {
        let subject = self.edge.part(self.next);
        let part = message.and_then(|bytes| read(&subject, bytes)).map(|(_, part)| part);
        let Some(part) = part.filter(|part| part.whole == self.whole && part.count == self.count) else {
            tracing::info!(
                target: LOG,
                subject,
                "a list of loops is not taken: this part of it is not there, or is of another announcement, which replaces it"
            );
            return false;
        };
        // At the first part for all of them: grown step by step it would take more than they have.
        self.list.reserve_exact(PART * (self.count - self.next) as usize);
        self.list.extend_from_slice(&part.body);
        self.next += 1;
        true
    }

    /// The list, once all parts were fetched. One that is none, or would take too much, is refused.
    pub fn list(self) -> Option<Hello> {
        let subject = self.edge.to_string();
        if digest(&subject, &self.list)[..] != self.whole[..] {
            weights::refuse(&subject, "the parts of its announcement do not belong together");
            return None;
        }
        match protobuf::read(&self.list[..], MOST_LIST) {
            Ok(hello) => Some(hello),
            Err(why) => {
                weights::refuse(&subject, &why.to_string());
                None
            }
        }
    }
}

#[cfg(test)]
mod tests;
