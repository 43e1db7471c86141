//! Which message a reader was given last. A server acknowledges a message before it is on its disk, and may lose those of the last
//! minutes when the power fails, while it keeps the place of their reader. It uses their numbers again, and gives none of them to
//! that reader. So the reader notes in another stream which message it was given last: its number, and when the server took it.

use super::error::{LinkError, away};
use crate::fleet::streams;
use async_nats::Client;
use std::sync::atomic::Ordering::Relaxed;

/// What tells two messages of a stream apart: the number, and when the stream took it (ns since the Unix epoch, by the server's
/// clock). A server that has lost its last messages uses their numbers again, at a later time.
pub type Mark = (u64, i128);

/// How a server has a reader, and its stream.
#[derive(Clone, Copy, Debug)]
pub(super) struct Standing {
    /// Number of the last message that it was given.
    pub(super) delivered: u64,
    /// Number of the last message that it has done, and with it all before.
    pub(super) done: u64,
    /// It was given a message since the server was started.
    pub(super) is_active: bool,
    /// Number of the last message of the stream.
    pub(super) last: u64,
}

/// Behind which number a reader has to begin anew; `None` where it goes on as it is. `noted`: the number of the message that it
/// noted last, and whether the stream may still have that message. Where it did not note the last one, because the server ended
/// meanwhile, those behind the noted one may be lost. Some come again then.
pub(super) fn begins_behind(own: Standing, noted: Option<(u64, bool)>) -> Option<u64> {
    let is_there = own.is_active && own.delivered <= own.last;
    match noted {
        _ if own.delivered == 0 => None,
        Some((_, false)) => Some(0),
        Some((number, true)) if number >= own.delivered || is_there => None,
        Some((number, true)) => Some(number.min(own.done)),
        None => (!is_there).then_some(0),
    }
}

/// Notes which message a reader was given last.
#[derive(Debug)]
pub(super) struct Given {
    client: Client,
    subject: String,
    /// How often the client had connected when the reading began.
    connects: u64,
    /// What was noted by this reading.
    last: Option<Mark>,
}

impl Given {
    pub(super) fn new(client: &Client, stream: &str, reader: &str) -> Self {
        let connects = client.statistics().connects.load(Relaxed);
        Self { client: client.clone(), subject: streams::given(stream, reader), connects, last: None }
    }

    /// Where it is noted.
    pub(super) fn subject(&self) -> &str {
        &self.subject
    }

    /// Whether the connection is the one with which the reading began. After another the stream may have lost messages.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub(super) fn is_connected(&self) -> Result<(), LinkError> {
        match self.client.statistics().connects.load(Relaxed) == self.connects {
            true => Ok(()),
            false => Err(away("the connection was lost meanwhile")),
        }
    }

    /// The reader was given this message. Nothing waits for the note: where it is lost, some messages come again.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub(super) async fn note(&mut self, mark: Mark) -> Result<(), LinkError> {
        if self.last.is_some_and(|(number, _)| number >= mark.0) {
            return Ok(());
        }
        self.last = Some(mark);
        self.client.publish(self.subject.clone(), text(mark).into()).await.map_err(away)
    }
}

/// A note's text: the number, and when the server took the message (ns).
fn text((number, at): Mark) -> String {
    format!("{number} {at}")
}

/// What a note says; `None` for a text that is none.
pub(super) fn read(text: &[u8]) -> Option<Mark> {
    let (number, at) = std::str::from_utf8(text).ok()?.split_once(' ')?;
    let number = number.parse().ok().filter(|number| *number > 0)?;
    Some((number, at.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    const OWN: Standing = Standing { delivered: 9, done: 7, is_active: false, last: 12 };

    #[test]
    fn a_reader_begins_anew_where_its_stream_may_have_lost_what_it_was_given() {
        let begins = |noted| begins_behind(OWN, noted);
        assert_eq!(begins(Some((9, true))), None);
        assert_eq!(begins(Some((9, false))), Some(0), "another message has its number");
        assert_eq!(begins(Some((8, true))), Some(7), "the ninth was not noted");
        assert_eq!(begins(Some((3, true))), Some(3));
        assert_eq!(begins(Some((11, true))), None, "the server has lost the place of the reader alone");
        assert_eq!(begins(None), Some(0));
    }

    #[test]
    fn a_reader_whose_server_was_not_started_again_goes_on() {
        let own = Standing { is_active: true, ..OWN };
        for noted in [None, Some((3, true)), Some((9, true))] {
            assert_eq!(begins_behind(own, noted), None);
        }
        assert_eq!(
            begins_behind(Standing { last: 5, ..own }, None),
            Some(0),
            "it has lost its last messages"
        );
        let new = Standing { delivered: 0, done: 0, ..OWN };
        assert_eq!(begins_behind(new, Some((9, false))), None, "its stream was made anew");
    }

    #[test]
    fn a_note_is_read_as_it_was_written() {
        let mark = (7, 1_767_225_600_000_000_000);
        assert_eq!(read(text(mark).as_bytes()), Some(mark));
        for text in ["", "7", "x 1", "7 x", "-1 1", "0 1"] {
            assert_eq!(read(text.as_bytes()), None, "{text}");
        }
        assert_eq!(read(b"\xff 1"), None);
    }
}
