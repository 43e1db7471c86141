//! What is counted of a message, held against what it holds.

use super::super::convert::block;
use super::*;
use crate::protobuf::{Refused, weigh};
use crate::signal::Sample;
use proptest::prelude::*;
use prost::Message;

/// Whether a message is not too large for whoever reads it.
fn is_taken<M: Weighed>(bytes: &[u8]) -> bool {
    weigh(bytes, M::FIELDS, MOST_DECODED).is_ok()
}

/// A field of a message: its number, and a text or another message.
fn field(tag: u32, body: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    for number in [(tag << 3) | 2, u32::try_from(body.len()).expect("short")] {
        let mut rest = number;
        while rest >= 0x80 {
            out.push(rest as u8 | 0x80);
            rest >>= 7;
        }
        out.push(rest as u8);
    }
    [&out[..], body].concat()
}

/// Finds the texts and lists of a kind of message by what it keeps of a long text, or of many empty parts, under each number, in
/// it and in a part of it; each has to be weighed. The `shared` are those whose bytes are not copied, behind the part that they
/// are in, or 0.
fn is_weighed<M: Weighed>(shared: &[(u32, u32)]) {
    const LONG: usize = 1000;
    const MANY: usize = 100;
    let kind = std::any::type_name::<M>();
    let kept = |bytes: &[u8]| M::decode(bytes).map_or(0, |own| own.encoded_len());
    let weight = |bytes: &[u8]| weigh(bytes, M::FIELDS, usize::MAX).expect("it is decoded");
    let look = |place: (u32, u32), text: &[u8], list: &[u8]| {
        if kept(text) >= LONG && !shared.contains(&place) {
            assert!(weight(text) >= LONG, "{kind}: the text {place:?}");
        }
        if kept(list) >= MANY {
            assert!(weight(list) >= MANY * size_of::<String>(), "{kind}: the list {place:?}");
        }
    };
    let (text, list) =
        (|number: u32| field(number, &[b'x'; LONG]), |number: u32| field(number, b"").repeat(MANY));
    for tag in 1..=32 {
        look((0, tag), &text(tag), &list(tag));
        if kept(&text(tag)) >= LONG {
            continue;
        }
        for inner in 1..=32 {
            look((tag, inner), &field(tag, &text(inner)), &field(tag, &list(inner)));
        }
    }
}

#[test]
fn every_text_and_list_of_each_message_is_weighed() {
    is_weighed::<Samples>(&[(1, 3)]);
    is_weighed::<TagSamples>(&[(0, 3)]);
    is_weighed::<Place>(&[]);
    is_weighed::<Window>(&[(3, 3)]);
    is_weighed::<Answer>(&[]);
    is_weighed::<Diagnosis>(&[]);
    is_weighed::<Run>(&[]);
    is_weighed::<Effect>(&[]);
    is_weighed::<Model>(&[]);
    is_weighed::<Alarm>(&[]);
    is_weighed::<States>(&[]);
    is_weighed::<AlarmState>(&[]);
    is_weighed::<AlarmChange>(&[]);
    is_weighed::<Action>(&[]);
    is_weighed::<HelloPart>(&[(0, 4)]);
    is_weighed::<Hello>(&[]);
    is_weighed::<Loop>(&[]);
    is_weighed::<Tag>(&[]);
    is_weighed::<Pulse>(&[]);
    is_weighed::<Cursor>(&[]);
}

#[test]
fn what_decodes_to_a_hundred_times_its_bytes_is_refused_before_that() {
    fn why<M: Weighed>(bytes: &[u8]) -> Option<Refused> {
        assert!(!is_taken::<M>(bytes));
        protobuf::read::<M>(bytes, MOST_DECODED).err()
    }
    let empty = |tag: u32| field(tag, b"").repeat(8_000_000 / field(tag, b"").len());
    let too_much = Some(Refused::TooMuch(MOST_DECODED));
    assert_eq!(why::<Samples>(&empty(1)), too_much);
    assert_eq!(why::<Samples>(&empty(2)), too_much);
    assert_eq!(why::<Window>(&empty(3)), too_much);
    assert_eq!(why::<Answer>(&field(3, &empty(16))), too_much);
    assert_eq!(why::<Diagnosis>(&field(2, &empty(16))), too_much);
    assert_eq!(why::<Hello>(&empty(1)), too_much);
    assert_eq!(why::<Hello>(&empty(2)), too_much);
    for list in [8, 9] {
        assert_eq!(why::<Hello>(&field(1, &empty(list))), too_much);
    }
    let before = refused();
    assert_eq!(read::<Hello>("stictiond.v1.north.e1.hello.0", empty(1)), None);
    assert!(refused() > before);
}

/// An edge of so many loops, each with so many tags.
pub fn hello(loops: usize, tags: usize) -> Hello {
    let tag = |at: usize| Tag {
        name: format!("tag{at}"),
        source: format!("dcs{} holding {} f32", at % 8, 100 + at),
        unit: "%".into(),
        collector: "dcs1".into(),
    };
    let one = |at: usize| Loop {
        id: format!("FIC{at:05}"),
        description: "Feed to the column, north".into(),
        group: "Unit 100".into(),
        period_s: 600.0,
        op_span: Some(100.0),
        tags: (0..tags).map(tag).collect(),
        ..Loop::default()
    };
    Hello { loops: (0..loops).map(one).collect(), collectors: vec!["dcs1".into()] }
}

#[test]
fn a_message_as_long_as_any_is_taken_and_its_block_is_not_copied() {
    let samples: Vec<Sample> = (0..2000).map(|at| Sample::good(f64::from(at), 0.1 * f64::from(at))).collect();
    let tags = vec![block("op", "dcs1 holding 1 f32", &samples); 4];
    let own = Samples { tags, ..Samples::default() };
    let bytes = Bytes::from(own.encode_to_vec());
    let back: Samples = read("a", bytes.clone()).expect("ours");
    for tag in &back.tags {
        assert!(bytes.as_ptr_range().contains(&tag.block.as_ptr()), "it was copied");
    }
    assert_eq!(back, own);
    let long = TagSamples { block: vec![1_u8; 8_000_000].into(), ..TagSamples::default() };
    assert!(is_taken::<Samples>(&Samples { tags: vec![long], ..Samples::default() }.encode_to_vec()));
    let run = Run { report: Some(vec![1_u8; 8_000_000]), ..Run::default() };
    assert!(is_taken::<Diagnosis>(&Diagnosis { run: Some(run), ..Diagnosis::default() }.encode_to_vec()));
}

/// What a message takes beside itself (bytes).
fn held(own: &Hello) -> usize {
    let texts = |all: &Vec<String>| {
        all.capacity() * size_of::<String>() + all.iter().map(String::capacity).sum::<usize>()
    };
    let tag = |own: &Tag| {
        [&own.name, &own.source, &own.unit, &own.collector].into_iter().map(String::capacity).sum::<usize>()
    };
    let one = |own: &Loop| {
        let named = [&own.id, &own.description, &own.group, &own.cost_unit];
        let named = named.into_iter().map(String::capacity).sum::<usize>();
        let tags = own.tags.capacity() * size_of::<Tag>() + own.tags.iter().map(tag).sum::<usize>();
        named + tags + texts(&own.upstream)
    };
    let loops = own.loops.capacity() * size_of::<Loop>() + own.loops.iter().map(one).sum::<usize>();
    loops + texts(&own.collectors)
}

proptest! {
    /// No less than what it holds, and not much more.
    #[test]
    fn a_message_holds_what_was_counted(loops in 0usize..40, tags in 0usize..20, names in 0usize..20) {
        let mut own = hello(loops, tags);
        own.collectors = vec!["dcs".into(); names];
        let bytes = own.encode_to_vec();
        let decoded: Hello = read("a", bytes.clone()).expect("ours");
        let counted = weigh(&bytes, Hello::FIELDS, usize::MAX).expect("ours");
        let held = held(&decoded);
        prop_assert!(held <= counted && counted <= 3 * held, "{held} are held, {counted} counted");
    }
}
