//! Messages there and back, whole and damaged.

use super::*;
use proptest::prelude::*;

/// Reads bytes as a message, and says whether they are one. What was read says the same again.
fn is_read<M: Message + Default>(bytes: &[u8]) -> bool {
    let Ok(read) = M::decode(bytes) else { return false };
    let said = read.encode_to_vec();
    // By its bytes: a number that is none is not equal to itself.
    let again = M::decode(&said[..]).expect("what we say can be read");
    assert_eq!(again.encode_to_vec(), said);
    true
}

/// As every kind of message, in the order of the file.
fn as_each(bytes: &[u8]) -> [bool; 11] {
    [
        is_read::<Samples>(bytes),
        is_read::<Window>(bytes),
        is_read::<Answer>(bytes),
        is_read::<Diagnosis>(bytes),
        is_read::<Alarm>(bytes),
        is_read::<States>(bytes),
        is_read::<Action>(bytes),
        is_read::<HelloPart>(bytes),
        is_read::<Hello>(bytes),
        is_read::<Pulse>(bytes),
        is_read::<Cursor>(bytes),
    ]
}

fn hello(names: &[String]) -> Hello {
    let tag = |name: &String| Tag { name: name.clone(), source: "d 1".into(), ..Tag::default() };
    let own = |id: &String| Loop {
        id: id.clone(),
        period_s: 60.0,
        op_span: Some(100.0),
        tags: names.iter().map(tag).collect(),
        ..Loop::default()
    };
    Hello { loops: names.iter().map(own).collect(), collectors: names.to_vec() }
}

#[test]
fn what_is_cut_or_of_another_kind_is_refused() {
    let whole = hello(&["FIC1".into(), "op".into()]).encode_to_vec();
    assert!(is_read::<Hello>(&whole) && !is_read::<Hello>(&whole[..whole.len() - 1]));
    // A length of 4 GB, a group that nobody knows how to end, and a field without a number.
    for bytes in [&b"\x0a\xff\xff\xff\xff\x0f"[..], b"\x0b\x0b\x0b", b"\x02\x00", b"\xff"] {
        assert_eq!(as_each(bytes), [false; 11], "{bytes:?}");
    }
    assert_eq!(as_each(b""), [true; 11], "a message of defaults");
    // A field of a later version.
    assert_eq!(as_each(b"\xfa\x7f\x02hi"), [true; 11]);
}

proptest! {
    /// Whole it comes back as it was; with a byte changed, or cut, it is another message or none.
    #[test]
    fn messages_come_back_whole_or_not_at_all(
        names in prop::collection::vec("\\PC{0,12}", 0..6),
        at in any::<prop::sample::Index>(),
        flip in 1u8..,
    ) {
        let own = hello(&names);
        let mut bytes = own.encode_to_vec();
        prop_assert_eq!(Hello::decode(&bytes[..]).expect("ours"), own);
        if !bytes.is_empty() {
            let at = at.index(bytes.len());
            let _ = as_each(&bytes[..at]);
            bytes[at] ^= flip;
            let _ = as_each(&bytes);
        }
    }

    #[test]
    fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let _ = as_each(&bytes);
    }
}
