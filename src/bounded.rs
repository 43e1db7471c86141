//! A stream that counts what a peer sends, under clients whose library believes the peer: no frame, line or answer may be
//! longer than a protocol has use for. What is too long ends the connection before it is kept.

use std::fmt;
use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

/// Longest head of a message that says its length (bytes).
const HEAD: usize = 8;

/// How a protocol says how long a message is.
#[derive(Clone, Copy, Debug)]
pub struct Framing {
    /// Bytes until the length is known, at most 8.
    pub head: usize,
    /// Whole length of the message (bytes) that begins so.
    pub length: fn(&[u8]) -> u64,
    /// Longest message that is taken (bytes).
    pub most: u64,
}

/// What a peer may send.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Of one message, where the protocol says its length first.
    pub framing: Option<Framing>,
    /// Between two of our own writes: an answer, however it is divided (bytes).
    pub answer: u64,
    /// What a message counts in an answer beside its bytes: what the library keeps for it (bytes).
    pub keeps: u64,
}

/// OPC UA, part 6: a chunk says its length in bytes 4 to 8, little endian. We announce chunks of 64 KiB at most, and the
/// library bounds how many make a message.
pub const OPCUA: Limits = Limits {
    framing: Some(Framing { head: 8, length: opcua_length, most: 1 << 17 }),
    answer: 1 << 23,
    keeps: 0,
};

/// SMTP: RFC 5321 has lines of 512 bytes; a chain of certificates is the longest thing that comes before we write again. The
/// library reads an answer anew at each of its lines, so a longer one would cost time too.
pub const SMTP: Limits = Limits { framing: None, answer: 1 << 15, keeps: 0 };

/// HTTP: the library bounds a head and we the body; neither bounds how many heads come before the answer.
pub const HTTP: Limits = Limits { framing: None, answer: 1 << 20, keeps: 0 };

/// PostgreSQL: a type, then the length of the rest, big endian. A row costs the library about 200 bytes beside its own.
pub const POSTGRES: Limits = Limits {
    framing: Some(Framing { head: 5, length: postgres_length, most: 1 << 22 }),
    answer: 20 << 20,
    keeps: 256,
};

fn opcua_length(head: &[u8]) -> u64 {
    head.get(4..8)
        .and_then(|bytes| bytes.try_into().ok())
        .map_or(0, |bytes| u64::from(u32::from_le_bytes(bytes)))
}

fn postgres_length(head: &[u8]) -> u64 {
    let length = head.get(1..5).and_then(|bytes| bytes.try_into().ok()).map_or(0, u32::from_be_bytes);
    1 + u64::from(length)
}

/// A peer sent more than it may.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TooMuch {
    /// One message.
    #[error("the peer sends a message of {0} bytes; {1} are taken")]
    Message(u64, u64),
    /// All of an answer.
    #[error("the peer's answer is longer than {0} bytes")]
    Answer(u64),
}

/// Where in the stream of a peer we are.
#[derive(Clone, Debug)]
struct Count {
    limits: Limits,
    /// Begin of a message whose length is not known yet.
    head: [u8; HEAD],
    seen: usize,
    /// What is left of the message (bytes).
    left: u64,
    /// Of the answer (bytes).
    answered: u64,
}

impl Count {
    fn new(limits: Limits) -> Self {
        Self { limits, head: [0; HEAD], seen: 0, left: 0, answered: 0 }
    }

    /// We asked something else.
    fn asked(&mut self) {
        self.answered = 0;
    }

    /// These bytes came.
    fn came(&mut self, mut bytes: &[u8]) -> Result<(), TooMuch> {
        self.answered = self.answered.saturating_add(bytes.len() as u64);
        if let Some(framing) = self.limits.framing {
            while !bytes.is_empty() {
                bytes = self.step(framing, bytes)?;
            }
        }
        if self.answered > self.limits.answer { Err(TooMuch::Answer(self.limits.answer)) } else { Ok(()) }
    }

    /// Takes what belongs to the message that has begun; gives the rest back.
    fn step<'b>(&mut self, framing: Framing, bytes: &'b [u8]) -> Result<&'b [u8], TooMuch> {
        if self.left > 0 {
            let taken = bytes.len().min(usize::try_from(self.left).unwrap_or(usize::MAX));
            self.left -= taken as u64;
            return Ok(&bytes[taken..]);
        }
        let head = framing.head.min(HEAD);
        let taken = bytes.len().min(head - self.seen);
        self.head[self.seen..self.seen + taken].copy_from_slice(&bytes[..taken]);
        self.seen += taken;
        if self.seen == head {
            let length = (framing.length)(&self.head[..head]);
            if length > framing.most {
                return Err(TooMuch::Message(length, framing.most));
            }
            // One that says it is shorter than its head is left to the library, which refuses it.
            (self.left, self.seen) = (length.saturating_sub(head as u64), 0);
            self.answered = self.answered.saturating_add(self.limits.keeps);
        }
        Ok(&bytes[taken..])
    }
}

/// A stream on which a peer may send only so much.
pub struct Bounded<S> {
    stream: S,
    count: Count,
}

impl<S: fmt::Debug> fmt::Debug for Bounded<S> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_tuple("Bounded").field(&self.stream).finish()
    }
}

impl<S> Bounded<S> {
    /// Counts what comes out of `stream`.
    pub fn new(stream: S, limits: Limits) -> Self {
        Self { stream, count: Count::new(limits) }
    }

    /// What is below.
    pub fn below(&self) -> &S {
        &self.stream
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Bounded<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buf.filled().len();
        ready!(Pin::new(&mut self.stream).poll_read(cx, buf))?;
        let counted = self.count.came(&buf.filled()[before..]);
        Poll::Ready(counted.map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error)))
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Bounded<S> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        let written = ready!(Pin::new(&mut self.stream).poll_write(cx, buf))?;
        self.count.asked();
        Poll::Ready(Ok(written))
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SMALL: Limits = Limits {
        framing: Some(Framing { head: 8, length: opcua_length, most: 100 }),
        answer: 1000,
        keeps: 50,
    };

    fn message(length: u32) -> Vec<u8> {
        let mut bytes = [&b"MSGF"[..], &length.to_le_bytes()].concat();
        bytes.resize((length as usize).max(8), 0xff);
        bytes
    }

    #[test]
    fn what_is_measured_by_hand() {
        let mut count = Count::new(SMALL);
        assert_eq!(count.came(&message(100)), Ok(()));
        // A hundred bytes and fifty beside it, then 75 times as much.
        assert_eq!(count.answered, 150);
        assert_eq!(count.came(&message(101)[..8]), Err(TooMuch::Message(101, 100)));
        let mut count = Count::new(SMALL);
        assert!((0..6).all(|_| count.came(&message(100)).is_ok()));
        assert_eq!(count.came(&message(100)), Err(TooMuch::Answer(1000)));
        let mut count = Count::new(SMALL);
        for _ in 0..100 {
            assert_eq!(count.came(&message(100)), Ok(()));
            count.asked();
        }
        assert_eq!(
            Count::new(OPCUA).came(b"ACKF\xf0\xff\xff\xff"),
            Err(TooMuch::Message(0xffff_fff0, 1 << 17))
        );
        assert_eq!(
            Count::new(POSTGRES).came(b"R\x7f\xff\xff\xf0"),
            Err(TooMuch::Message(0x7fff_fff1, 1 << 22))
        );
    }

    proptest! {
        /// How the bytes are cut into reads makes no difference, and no stream is taken beyond its bounds.
        #[test]
        fn cuts_make_no_difference(lengths in prop::collection::vec(0u32..130, 0..20), cuts in prop::collection::vec(1usize..40, 1..60)) {
            let all: Vec<u8> = lengths.iter().flat_map(|length| message(*length)).collect();
            let whole = Count::new(SMALL).came(&all);
            let (mut count, mut rest, mut ended) = (Count::new(SMALL), &all[..], Ok(()));
            for cut in cuts.iter().cycle() {
                if rest.is_empty() || ended.is_err() {
                    break;
                }
                let (now, after) = rest.split_at((*cut).min(rest.len()));
                (ended, rest) = (count.came(now), after);
            }
            // Both may be too much at once; then either is told first.
            prop_assert_eq!(ended.is_ok(), whole.is_ok());
        }

        #[test]
        fn any_bytes_are_counted_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..3000)) {
            for limits in [SMALL, OPCUA, SMTP, POSTGRES] {
                let _ = Count::new(limits).came(&bytes);
            }
        }
    }
}
