//! Protobuf from peers: what a message will take once it is decoded is counted over its bytes before that. A part of a list
//! takes two bytes on the wire and up to two hundred in memory, so a bound on the bytes alone bounds little. Pure.

use prost::Message;
use prost::bytes::Buf;

/// Room that a list takes for its first part (parts). It takes as much again each time it is full.
const FIRST: usize = 4;
/// Texts take room in multiples of this (bytes), as allocators give it.
const GRAIN: usize = 16;
/// Most fields of one kind of message that take memory of their own: how often each comes is counted.
const MOST_FIELDS: usize = 16;

/// A field that takes memory of its own once it is decoded. All others lie in the message itself, share its bytes, or are not
/// known and skipped.
#[derive(Clone, Copy, Debug)]
pub enum Field {
    /// A text, or bytes that are copied.
    Text(u32),
    /// A list of texts.
    Texts(u32),
    /// A message in the message, with its own fields.
    One(u32, &'static [Field]),
    /// A list of messages: the size of each in memory (bytes), and its own fields.
    Many(u32, usize, &'static [Field]),
}

impl Field {
    fn tag(&self) -> u32 {
        match *self {
            Self::Text(tag) | Self::Texts(tag) | Self::One(tag, _) | Self::Many(tag, ..) => tag,
        }
    }
}

/// A kind of message whose memory can be told from its bytes.
pub trait Weighed: Message + Default {
    /// Its fields that take memory of their own.
    const FIELDS: &'static [Field];
}

/// A message in a message.
pub const fn one<M: Weighed>(tag: u32) -> Field {
    Field::One(tag, M::FIELDS)
}

/// A list of messages.
pub const fn many<M: Weighed>(tag: u32) -> Field {
    Field::Many(tag, size_of::<M>(), M::FIELDS)
}

/// Why a message is not decoded. It says nothing that the peer chooses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refused {
    /// It is no such message.
    #[error("it is no such message")]
    Unreadable,
    /// It is small on the wire and large in memory.
    #[error("it would take more than {0} bytes once it is decoded")]
    TooMuch(usize),
}

/// Decodes a message that takes at most so many bytes then.
///
/// # Errors
/// [`Refused`]; one that would take more is not begun.
pub fn read<M: Weighed>(bytes: impl Buf + AsRef<[u8]>, most: usize) -> Result<M, Refused> {
    weigh(bytes.as_ref(), M::FIELDS, most)?;
    M::decode(bytes).map_err(|_| Refused::Unreadable)
}

/// What a message with such fields takes once it is decoded, beside itself, at the moment when it takes most (bytes).
///
/// # Errors
/// [`Refused`]; it stops at the part that is too much.
pub fn weigh(bytes: &[u8], fields: &'static [Field], most: usize) -> Result<usize, Refused> {
    let mut scale = Scale { most, taken: 0, moving: 0 };
    walk(bytes, fields, &mut scale)?;
    Ok(scale.weight())
}

/// What has been counted.
struct Scale {
    most: usize,
    /// Bytes that lists and texts take.
    taken: usize,
    /// Bytes of the largest list that was moved to a larger place: for a moment both places are taken.
    moving: usize,
}

impl Scale {
    fn weight(&self) -> usize {
        self.taken.saturating_add(self.moving)
    }

    fn add(&mut self, bytes: usize) -> Result<(), Refused> {
        self.taken = self.taken.saturating_add(bytes);
        if self.weight() > self.most { Err(Refused::TooMuch(self.most)) } else { Ok(()) }
    }

    fn text(&mut self, bytes: usize) -> Result<(), Refused> {
        self.add(bytes.next_multiple_of(GRAIN))
    }

    /// A list of `count` parts of `size` bytes gets one more.
    fn part(&mut self, count: usize, size: usize) -> Result<(), Refused> {
        match count {
            0 => self.add(FIRST * size),
            _ if count >= FIRST && count.is_power_of_two() => {
                self.moving = self.moving.max(count * size);
                self.add(count * size)
            }
            _ => Ok(()),
        }
    }
}

/// Walks over the fields of a message as the decoder would.
fn walk(mut rest: &[u8], fields: &'static [Field], scale: &mut Scale) -> Result<(), Refused> {
    let mut counts = [0_usize; MOST_FIELDS];
    while !rest.is_empty() {
        let key = u32::try_from(varint(&mut rest)?).map_err(|_| Refused::Unreadable)?;
        let (tag, kind) = (key >> 3, key & 7);
        let body = match kind {
            _ if tag == 0 => return Err(Refused::Unreadable),
            0 => {
                varint(&mut rest)?;
                continue;
            }
            1 => {
                take(&mut rest, 8)?;
                continue;
            }
            2 => {
                let length = varint(&mut rest)?;
                take(&mut rest, length)?
            }
            5 => {
                take(&mut rest, 4)?;
                continue;
            }
            // Groups, which nobody writes any more: they would have to be walked to their end.
            _ => return Err(Refused::Unreadable),
        };
        let Some(at) = fields.iter().position(|own| own.tag() == tag) else { continue };
        let count = counts.get_mut(at).ok_or(Refused::Unreadable)?;
        match fields[at] {
            Field::Text(_) => scale.text(body.len())?,
            Field::Texts(_) => {
                scale.part(*count, size_of::<String>())?;
                scale.text(body.len())?;
            }
            // The decoder would go on with the lists of the first, so they could not be counted by themselves.
            Field::One(..) if *count > 0 => return Err(Refused::Unreadable),
            Field::One(_, own) => walk(body, own, scale)?,
            Field::Many(_, size, own) => {
                scale.part(*count, size)?;
                walk(body, own, scale)?;
            }
        }
        *count += 1;
    }
    Ok(())
}

/// A number of up to 64 bits, seven in a byte.
fn varint(rest: &mut &[u8]) -> Result<u64, Refused> {
    let mut value = 0_u64;
    for shift in (0..64).step_by(7) {
        let (&byte, behind) = rest.split_first().ok_or(Refused::Unreadable)?;
        *rest = behind;
        if shift == 63 && byte > 1 {
            break;
        }
        value |= u64::from(byte & 0x7f) << shift;
        if byte < 0x80 {
            return Ok(value);
        }
    }
    Err(Refused::Unreadable)
}

/// The next bytes.
fn take<'b>(rest: &mut &'b [u8], length: u64) -> Result<&'b [u8], Refused> {
    let length = usize::try_from(length).map_err(|_| Refused::Unreadable)?;
    let (taken, behind) = rest.split_at_checked(length).ok_or(Refused::Unreadable)?;
    *rest = behind;
    Ok(taken)
}

#[cfg(test)]
mod tests {
    use super::*;
    use prost::bytes::Bytes;

    #[derive(Clone, PartialEq, Message)]
    struct Part {
        #[prost(string, tag = "1")]
        name: String,
        #[prost(double, tag = "2")]
        value: f64,
    }

    #[derive(Clone, PartialEq, Message)]
    struct Whole {
        #[prost(message, repeated, tag = "1")]
        parts: Vec<Part>,
        #[prost(string, repeated, tag = "2")]
        names: Vec<String>,
        #[prost(message, optional, tag = "3")]
        one: Option<Part>,
        #[prost(bytes = "bytes", tag = "4")]
        shared: Bytes,
    }

    impl Weighed for Part {
        const FIELDS: &'static [Field] = &[Field::Text(1)];
    }

    impl Weighed for Whole {
        const FIELDS: &'static [Field] = &[many::<Part>(1), Field::Texts(2), one::<Part>(3)];
    }

    const PART: usize = size_of::<Part>();
    const TEXT: usize = size_of::<String>();

    fn weight(bytes: &[u8]) -> Result<usize, Refused> {
        weigh(bytes, Whole::FIELDS, usize::MAX)
    }

    #[test]
    fn what_is_counted_by_hand() {
        assert_eq!(weight(b""), Ok(0));
        let of = |count: usize| weight(&b"\x0a\x00".repeat(count));
        assert_eq!([of(1), of(4)], [Ok(4 * PART); 2]);
        // Eight places, and for a moment the four before them.
        assert_eq!([of(5), of(8)], [Ok(12 * PART); 2]);
        assert_eq!(of(9), Ok(24 * PART));
        assert_eq!(weight(b"\x12\x00"), Ok(4 * TEXT));
        assert_eq!(weight(b"\x12\x11aaaaaaaaaaaaaaaaa"), Ok(4 * TEXT + 32));
        assert_eq!(weight(b"\x1a\x03\x0a\x01a"), Ok(16));
        // Not known, or not copied.
        assert_eq!(weight(b"\x22\x01a\x2a\x01a\x30\x07\x39\0\0\0\0\0\0\0\0\x3d\0\0\0\0"), Ok(0));
    }

    #[test]
    fn a_list_holds_no_more_than_was_counted() {
        for count in (0..70).chain([1000, 1024, 1025]) {
            let parts = vec![Part { name: "a".into(), value: 1.0 }; count];
            let bytes = Whole { parts, ..Whole::default() }.encode_to_vec();
            let own: Whole = read(&bytes[..], usize::MAX).expect("ours");
            let held = own.parts.capacity() * PART
                + own.parts.iter().map(|part| part.name.capacity()).sum::<usize>();
            let counted = weight(&bytes).expect("ours");
            assert!(held <= counted && counted <= 2 * held + GRAIN * count, "{count}: {held}, {counted}");
        }
    }

    #[test]
    fn what_takes_too_much_or_is_no_message_is_refused() {
        let bytes = b"\x0a\x00".repeat(1000);
        let most = weight(&bytes).expect("ours");
        assert!(read::<Whole>(&bytes[..], most).is_ok());
        assert_eq!(read::<Whole>(&bytes[..], most - 1), Err(Refused::TooMuch(most - 1)));
        let unreadable = [
            &b"\x0a"[..],
            b"\x0a\x01",
            b"\x02\x00",
            b"\x0b\x0c",
            b"\x08\xff\xff\xff\xff\xff\xff\xff\xff\xff\x02",
            b"\xff\xff\xff\xff\x7f\x00",
            // A message in the message twice, and a part that goes beyond its own end.
            b"\x1a\x00\x1a\x00",
            b"\x0a\x02\x0a\x05aaaaa",
        ];
        for bytes in unreadable {
            assert_eq!(read::<Whole>(bytes, usize::MAX), Err(Refused::Unreadable), "{bytes:?}");
        }
    }
}
