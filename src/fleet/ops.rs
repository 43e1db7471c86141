//! What a NATS server may say. The client's library believes every line to end, and every message to be as long as it is
//! announced; here both are counted before the library has them.

/// Longest line (bytes): what a server says of itself, or the names of a message.
pub const MOST_LINE: usize = 1 << 15;
/// Longest message with its head fields (bytes): `max_payload = 8MB` of `deploy/nats` less 64 kB, because the library takes room in
/// powers of two.
pub const MOST_MESSAGE: u64 = (1 << 23) - (1 << 16);
/// Questions whether we are there that wait for an answer. A server asks once in minutes; the library keeps an answer for each
/// until the server takes it.
pub const MOST_PINGS: u32 = 64;
/// All bytes between two of our requests: what several readers have asked for at once.
pub const MOST_ANSWER: u64 = 20 << 20;
/// Target of log lines whose number a peer decides: they are bounded as the lines of a library are.
pub const LOG: &str = "nats";

/// Why a server is not heard any further. It says nothing that the server chooses: what is said once is then the same each time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refused {
    /// A line that does not end.
    #[error("the server sends a line of more than {most} bytes", most = MOST_LINE)]
    Line,
    /// A message that is announced to be too long.
    #[error("the server sends a message of more than {most} bytes", most = MOST_MESSAGE)]
    Message,
    /// A line that the library cannot read, or ends at.
    #[error("the server sends a line that cannot be read")]
    Unreadable,
    /// Too many questions whether we are there.
    #[error("the server asks {most} times whether we are there and takes no answer", most = MOST_PINGS)]
    Pings,
    /// Too many bytes for one request.
    #[error("the server sends more than {most} bytes for one request", most = MOST_ANSWER)]
    Answer,
}

/// What one side says: lines, and the messages that some of them announce.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Side {
    /// The line that has begun.
    line: Vec<u8>,
    /// What is left of the message (bytes), with its end.
    left: u64,
}

impl Side {
    /// Takes bytes as they come, and tells each line without its end.
    fn came(
        &mut self,
        mut bytes: &[u8],
        mut told: impl FnMut(&[u8]) -> Result<(), Refused>,
    ) -> Result<(), Refused> {
        while !bytes.is_empty() {
            if self.left > 0 {
                let taken = bytes.len().min(usize::try_from(self.left).unwrap_or(usize::MAX));
                self.left -= taken as u64;
                bytes = &bytes[taken..];
                continue;
            }
            let end = bytes.iter().position(|byte| *byte == b'\n').map_or(bytes.len(), |at| at + 1);
            self.line.extend_from_slice(&bytes[..end]);
            bytes = &bytes[end..];
            if self.line.len() > MOST_LINE {
                return Err(Refused::Line);
            }
            // An end of another kind is a part of the line to the library, and so to us.
            if let Some(line) = self.line.strip_suffix(b"\r\n") {
                self.left = announced(line)?;
                told(line)?;
                self.line.clear();
            }
        }
        Ok(())
    }
}

/// Bytes behind a line that belong to it: a message and its end. Its length is the last word.
fn announced(line: &[u8]) -> Result<u64, Refused> {
    let verbs: [&[u8]; 4] = [b"MSG ", b"HMSG ", b"PUB ", b"HPUB "];
    if !verbs.iter().any(|verb| line.starts_with(verb)) {
        return Ok(0);
    }
    let text = std::str::from_utf8(line).map_err(|_| Refused::Unreadable)?;
    let length = text.split_whitespace().next_back().and_then(|word| word.parse::<u64>().ok());
    match length {
        None => Err(Refused::Unreadable),
        Some(length) if length > MOST_MESSAGE => Err(Refused::Message),
        Some(length) => Ok(length + 2),
    }
}

/// What a server and our client say to each other on one connection.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Watch {
    server: Side,
    client: Side,
    /// Questions of the server that wait for an answer.
    pings: u32,
    /// Bytes of the server since our last request.
    answered: u64,
}

impl Watch {
    /// The server sent these bytes; whether it answered that it is there, as it does once we are logged in.
    ///
    /// # Errors
    /// [`Refused`]; then nothing of them may be passed on.
    pub fn server(&mut self, bytes: &[u8]) -> Result<bool, Refused> {
        let Self { server, pings, answered, .. } = self;
        let mut is_there = false;
        *answered = answered.saturating_add(bytes.len() as u64);
        server.came(bytes, |line| {
            is_there |= line.starts_with(b"PONG");
            if line.starts_with(b"PING") {
                *pings += 1;
            }
            match line {
                // The library looks behind the word without looking whether there is something, and panics.
                b"-ERR" => Err(Refused::Unreadable),
                _ if *pings > MOST_PINGS => Err(Refused::Pings),
                _ => Ok(()),
            }
        })?;
        if *answered > MOST_ANSWER { Err(Refused::Answer) } else { Ok(is_there) }
    }

    /// Our client sent these bytes. Questions and answers whether somebody is there ask for nothing else.
    ///
    /// # Errors
    /// [`Refused`].
    pub fn client(&mut self, bytes: &[u8]) -> Result<(), Refused> {
        let Self { client, pings, answered, .. } = self;
        client.came(bytes, |line| {
            if line.starts_with(b"PONG") {
                *pings = pings.saturating_sub(1);
            } else if !line.starts_with(b"PING") {
                *answered = 0;
            }
            Ok(())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A message of so many bytes.
    fn message(bytes: usize) -> Vec<u8> {
        [format!("MSG a.b 1 {bytes}\r\n").as_bytes(), &vec![b'x'; bytes], b"\r\n"].concat()
    }

    #[test]
    fn what_servers_say_is_passed_on() {
        let mut watch = Watch::default();
        let said = b"INFO {\"a\":1}\r\n+OK\r\nPING\r\n-ERR 'no'\r\nMSG a 1 r 12\r\nPING\r\n-ERR\r\n\r\n\
                     HMSG a 1 12 17\r\nNATS/1.0\r\n\r\nhello\r\nMSG a 1 0\r\n\r\n";
        assert_eq!(watch.server(said), Ok(false));
        // What is in a message is no question and no line.
        assert_eq!((watch.pings, watch.answered), (1, said.len() as u64));
        assert_eq!(watch.client(b"PING\r\nPONG\r\n"), Ok(()));
        assert_eq!((watch.pings, watch.answered), (0, said.len() as u64));
        assert_eq!(watch.client(b"PUB b 6\r\nPONG\r\n\r\n"), Ok(()));
        assert_eq!((watch.pings, watch.answered), (0, 0));
        assert_eq!(watch.server(b"PONG\r\n"), Ok(true));
        assert_eq!(watch.server(&message(MOST_MESSAGE as usize)), Ok(false));
    }

    #[test]
    fn what_is_without_end_is_refused() {
        let of = |bytes: &[u8]| Watch::default().server(bytes);
        assert_eq!(of(&vec![b'a'; MOST_LINE]), Ok(false));
        assert_eq!(of(&vec![b'a'; MOST_LINE + 1]), Err(Refused::Line));
        assert_eq!(of(&b"a\n".repeat(MOST_LINE)), Err(Refused::Line));
        assert_eq!(of(b"MSG a 1 4000000000\r\n"), Err(Refused::Message));
        assert_eq!(of(b"HMSG a 1 12 8323073\r\n"), Err(Refused::Message));
        for line in
            [&b"MSG a 1 18446744073709551616\r\n"[..], b"MSG a 1 -1\r\n", b"MSG \xff 1 1\r\n", b"-ERR\r\n"]
        {
            assert_eq!(of(line), Err(Refused::Unreadable), "{}", String::from_utf8_lossy(line));
        }
        assert_eq!(of(&b"PING\r\n".repeat(64)), Ok(false));
        assert_eq!(of(&b"PING\r\n".repeat(65)), Err(Refused::Pings));
    }

    #[test]
    fn questions_that_are_answered_go_on_and_no_answer_is_longer_than_its_bound() {
        let mut watch = Watch::default();
        for _ in 0..1000 {
            assert_eq!(watch.server(&b"PING\r\n".repeat(64)), Ok(false));
            assert_eq!(watch.client(&b"PONG\r\n".repeat(64)), Ok(()));
        }
        let (mut watch, mebibyte) = (Watch::default(), message(1 << 20));
        for _ in 0..100 {
            assert_eq!(watch.server(&mebibyte), Ok(false));
            assert_eq!(watch.client(b"SUB a 1\r\n"), Ok(()));
        }
        let ended = (0..20).map(|_| {
            assert_eq!(watch.client(b"PING\r\nPONG\r\n"), Ok(()));
            watch.server(&mebibyte)
        });
        assert_eq!(ended.collect::<Vec<_>>().last(), Some(&Err(Refused::Answer)));
    }

    proptest! {
        /// How the bytes are cut into reads makes no difference.
        #[test]
        fn cuts_make_no_difference(
            lengths in prop::collection::vec(prop::option::of(0usize..200), 0..20),
            cuts in prop::collection::vec(1usize..40, 1..60),
            last in prop::sample::select(vec!["", "PIN", "MSG a 1 9000000\r\n", "-ERR\r\n", "MSG a 1 x\r\n"]),
        ) {
            let said = lengths.iter().map(|length| length.map_or(b"PING\r\n".to_vec(), message));
            let all: Vec<u8> = said.chain([last.as_bytes().to_vec()]).flatten().collect();
            let mut whole = Watch::default();
            let ended = whole.server(&all).map(drop);
            let (mut watch, mut rest, mut so_far) = (Watch::default(), &all[..], Ok(()));
            for cut in cuts.iter().cycle() {
                if rest.is_empty() || so_far.is_err() {
                    break;
                }
                let (now, after) = rest.split_at((*cut).min(rest.len()));
                (so_far, rest) = (watch.server(now).map(drop), after);
            }
            prop_assert_eq!(so_far, ended);
            if ended.is_ok() {
                prop_assert_eq!(watch, whole);
            }
        }

        /// Whatever comes, no more of it is kept than a line.
        #[test]
        fn any_bytes_are_counted_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..3000)) {
            let mut watch = Watch::default();
            let _ = (watch.server(&bytes), watch.client(&bytes));
            prop_assert!(watch.server.line.len() <= MOST_LINE && watch.client.line.len() <= MOST_LINE);
        }
    }
}
