//! The announcement of an edge: the list of its loops, cut into parts. A list of many loops is longer than a message may be, and
//! takes more memory once it is decoded than a message may take. Each part has a subject of its own, by its number, so that the
//! stream keeps the last message of each number.
//!
//! A centre takes a list whole or not at all, because a loop that is missing from a list counts as removed. An edge sends the parts
//! in order, each once the stream has the one before it. So the stream has all parts when the last one comes. The centre fetches
//! them only then, so that it has one list at a time in memory. All parts of one announcement have the digest of the whole list. A
//! part with another digest is of a newer announcement, whose last part is still to come. Until it comes, the previous list stays
//! in force.

use super::digest::digest;
use super::link::Outgoing;
use super::message::{Hello, HelloPart};
use super::ops::LOG;
use super::subject::{Subject, What};
use super::weights;
use crate::protobuf::{self, Weighed, weigh};
use prost::Message;
use prost::bytes::Bytes;

/// Most bytes of a list in one part. A server takes far more by default (1 MB). A line of 0.5 Mbit/s carries a part within half of
/// the time that an edge or a centre waits for the server's answer (5 s). A centre gets a part as Base64, which is a third longer.
const PART: usize = 1 << 17;
/// Most bytes of a list in the first part. It is short because an edge fetches it to see whether the stream still has its parts.
const FIRST: usize = 1 << 10;
/// Most parts of an announcement: 6 MiB together. The list of 10,000 loops of eight tags each is 3.8 MB.
const MOST_PARTS: u32 = 48;
/// Most memory that a list takes once it is decoded (bytes). With the 6 MiB of its parts it stays below the 32 MiB that a peer may
/// make us hold. The list of 10,000 loops of eight tags each takes 20 MB.
pub const MOST_LIST: usize = 22 << 20;
// What is promised: no peer makes us hold more.
const _: () = assert!(PART * (MOST_PARTS as usize) + MOST_LIST < 32 << 20);
/// Bytes of a digest: SHA-256.
const DIGEST: usize = 32;

/// Whether a centre takes the list that has these bytes.
pub fn is_taken(list: &[u8]) -> bool {
    // The first part takes FIRST bytes, so one part fewer is left for the rest.
    list.len().saturating_sub(FIRST).div_ceil(PART) < MOST_PARTS as usize
        && weigh(list, Hello::FIELDS, MOST_LIST).is_ok()
}

/// The messages that announce the list that has these bytes, in their order.
pub fn split(own: &Subject, list: &[u8]) -> Vec<Outgoing> {
    cut(own, list, PART)
}

/// The same, with at most `most` bytes in each part after the first.
fn cut(own: &Subject, list: &[u8], most: usize) -> Vec<Outgoing> {
    let whole = digest(&own.to_string(), list).to_vec();
    // An empty list has one part, which is empty.
    let (first, rest) = list.split_at(list.len().min(FIRST));
    let count = 1 + rest.len().div_ceil(most) as u32;
    let bodies = std::iter::once(first).chain(rest.chunks(most));
    let message = |(number, body): (u32, &[u8])| {
        let part = HelloPart { whole: whole.clone(), number, count, body: Bytes::copy_from_slice(body) };
        Outgoing::latest(own.part(number), part.encode_to_vec())
    };
    (0..count).zip(bodies).map(message).collect()
}

/// Reads a message as a part of an announcement, with its edge. Refuses any other message.
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
    /// A part before the last, of this edge, with the digest of the whole list.
    Part(Subject, Vec<u8>),
    /// The last part: the stream has all others.
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
    /// The number of the next part: all before it were fetched.
    next: u32,
    /// The bytes of the parts that were fetched.
    list: Vec<u8>,
}

impl Announcement {
    /// Whose list it is.
    pub fn edge(&self) -> &Subject {
        &self.edge
    }

    /// The digest of the whole list.
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

    /// The subject of the next part; `None` if all were fetched.
    pub fn next_subject(&self) -> Option<String> {
        (self.next < self.count).then(|| self.edge.part(self.next))
    }

    /// Takes the last message that the stream has of [`next_subject`](Self::next_subject), if any. Returns whether it is the next
    /// part. If it is not, this list cannot be taken, which is logged.
    pub fn push(&mut self, message: Option<Vec<u8>>) -> bool {
        let subject = self.edge.part(self.next);
        let part = message.and_then(|bytes| read(&subject, bytes)).map(|(_, part)| part);
        let Some(part) = part.filter(|part| part.whole == self.whole && part.count == self.count) else {
            tracing::info!(
                target: LOG,
                subject,
                "a list of loops is not taken: this part is missing, or belongs to a newer announcement"
            );
            return false;
        };
        // Room for all parts is made at the first one: a vector that grows step by step would take more.
        self.list.reserve_exact(PART * (self.count - self.next) as usize);
        self.list.extend_from_slice(&part.body);
        self.next += 1;
        true
    }

    /// The list, once all parts were fetched. `None` if it is refused: the digest is wrong, or it would take too much memory.
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
