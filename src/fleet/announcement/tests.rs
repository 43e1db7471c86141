//! Lists that are cut, kept by a stream and put together again, and whatever may come in between.

use super::*;
use crate::fleet::message::Loop;
use crate::fleet::weights::refused;
use crate::fleet::weights::tests::hello as list;
use proptest::prelude::*;

fn edge(name: &str) -> Subject {
    Subject::new("north", name, What::Hello)
}

/// A list of so many loops, and its announcement by the edge `e1` in parts of at most 500 bytes behind the first.
fn announced(loops: usize) -> (Hello, Vec<Outgoing>) {
    let list = list(loops, 2);
    let messages = cut(&edge("e1"), &list.encode_to_vec(), 500);
    assert!(messages.len() > 4, "{}", messages.len());
    (list, messages)
}

/// The last message of each subject, in the order in which they came.
#[derive(Default)]
struct Stream(Vec<Outgoing>);

impl Stream {
    fn keep(&mut self, message: &Outgoing) {
        self.0.retain(|own| own.subject != message.subject);
        self.0.push(message.clone());
    }

    /// The list that a centre takes when it hears a message.
    fn heard(&self, message: &Outgoing) -> Option<Hello> {
        let Heard::Last(mut announcement) = Heard::read(&message.subject, message.body.clone())? else {
            return None;
        };
        while let Some(subject) = announcement.next_subject() {
            let last = self.0.iter().find(|own| own.subject == subject);
            if !announcement.push(last.map(|own| own.body.clone())) {
                return None;
            }
        }
        announcement.list()
    }

    /// The lists that a centre takes of messages which come one after the other.
    fn taken(&mut self, messages: &[Outgoing]) -> Vec<Hello> {
        let take = |message: &Outgoing| {
            self.keep(message);
            self.heard(message)
        };
        messages.iter().filter_map(take).collect()
    }

    /// The lists that a centre takes which follows anew.
    fn found(&self) -> Vec<Hello> {
        self.0.iter().filter_map(|message| self.heard(message)).collect()
    }
}

#[test]
fn a_list_is_taken_with_its_last_part_and_not_before() {
    let (list, messages) = announced(30);
    let (last, others) = messages.split_last().expect("there are parts");
    let mut stream = Stream::default();
    assert!(stream.taken(others).is_empty() && stream.found().is_empty());
    assert_eq!(stream.taken(std::slice::from_ref(last)), std::slice::from_ref(&list));
    assert_eq!(stream.found(), std::slice::from_ref(&list));
    // An edge says the same again after its connection was lost.
    assert_eq!(stream.taken(&messages), [list]);
}

#[test]
fn a_list_of_which_a_part_is_gone_is_not_taken() {
    let (list, messages) = announced(30);
    for missing in 0..messages.len() {
        let mut stream = Stream(messages.clone());
        stream.0.remove(missing);
        assert!(stream.found().is_empty(), "{missing}");
        assert_eq!(stream.taken(&messages), std::slice::from_ref(&list), "{missing}");
    }
}

#[test]
fn an_edge_without_anything_is_a_list_of_one_part() {
    let messages = split(&edge("e1"), &[]);
    assert_eq!(messages[0].subject, "stictiond.v1.north.e1.hello.0");
    assert_eq!(Stream::default().taken(&messages), [Hello::default()]);
}

#[test]
fn parts_of_two_announcements_are_no_list() {
    for (old, new) in [(40, 30), (30, 40)] {
        let ((_, old), (list, new)) = (announced(old), announced(new));
        for sent in 1..new.len() {
            // As a centre finds it in the stream if an edge was stopped while it announced itself.
            let mut stream = Stream(old.clone());
            assert!(stream.taken(&new[..sent]).is_empty() && stream.found().is_empty(), "{sent}");
            assert_eq!(stream.taken(&new[sent..]), std::slice::from_ref(&list), "{sent}");
            // Parts of an older and longer one are still behind the last.
            assert_eq!(stream.found(), std::slice::from_ref(&list), "{sent}");
            assert_eq!(stream.0.len(), old.len().max(new.len()));
        }
    }
}

#[test]
fn parts_that_do_not_belong_together_are_refused() {
    let (list, messages) = announced(30);
    let mut damaged = messages.clone();
    let mut part = HelloPart::decode(&messages[1].body[..]).expect("ours");
    part.body = part.body.iter().rev().copied().collect::<Vec<u8>>().into();
    damaged[1].body = part.encode_to_vec();
    // What one edge says is no announcement of another.
    let move_to =
        |(number, own): (u32, &Outgoing)| Outgoing::latest(edge("e2").part(number), own.body.clone());
    let moved = (0..).zip(&messages).map(move_to);
    for wrong in [damaged, moved.collect()] {
        let before = refused();
        assert!(Stream::default().taken(&wrong).is_empty());
        assert!(refused() > before);
    }
    assert_eq!(Stream::default().taken(&messages), [list]);
}

#[test]
fn what_is_no_part_is_refused() {
    let subject = edge("e1").part(1);
    let read = |part: &HelloPart| Heard::read(&subject, part.encode_to_vec());
    let good = HelloPart { whole: vec![0; DIGEST], number: 1, count: 2, body: Bytes::new() };
    let bad = [
        HelloPart { whole: vec![0; DIGEST - 1], ..good.clone() },
        HelloPart { whole: vec![0; 1 << 20], ..good.clone() },
        HelloPart { number: 2, ..good.clone() },
        HelloPart { number: 0, count: 0, ..good.clone() },
        HelloPart { count: MOST_PARTS + 1, ..good.clone() },
        HelloPart { body: vec![0; PART + 1].into(), ..good.clone() },
        // Of another number than its subject.
        HelloPart { number: 0, count: 1, ..good.clone() },
    ];
    for bad in bad {
        let before = refused();
        assert!(read(&bad).is_none() && refused() > before, "{} of {}", bad.number, bad.count);
    }
    let Some(Heard::Last(own)) = read(&good) else { panic!("it is the last part") };
    assert_eq!((own.edge(), own.digest()), (&edge("e1"), &[0; DIGEST][..]));
    assert_eq!(own.next_subject(), Some(edge("e1").part(0)));
    let heard = read(&HelloPart { count: 3, ..good.clone() });
    assert!(matches!(heard, Some(Heard::Part(own, _)) if own == edge("e1")), "it is not the last");
    // A name that is written otherwise would be fetched elsewhere.
    let body = HelloPart { number: 0, count: 1, ..good }.encode_to_vec();
    assert!(Heard::read(&edge("e1").part(0), body.clone()).is_some());
    for other in ["stictiond.v1.north.%651.hello.0", "stictiond.v1.north.e1.hello.00"] {
        assert!(Heard::read(other, body.clone()).is_none(), "{other}");
    }
    assert!(Heard::read("stictiond.v1.north.e1.pulse", body).is_none());
}

#[test]
fn an_announcement_takes_no_more_than_its_parts() {
    let part = |number: u32, bytes: usize| {
        let body = vec![b'x'; bytes].into();
        HelloPart { whole: vec![0; DIGEST], number, count: MOST_PARTS, body }.encode_to_vec()
    };
    let last = MOST_PARTS - 1;
    let heard = Heard::read(&edge("e1").part(last), part(last, 1));
    let Some(Heard::Last(mut own)) = heard else { panic!("it is the last part") };
    // Parts that grow would have a list take room that it does not need.
    for number in 0..MOST_PARTS {
        assert!(own.push(Some(part(number, if number == 0 { 1 } else { PART }))));
        assert!(own.list.capacity() <= PART * MOST_PARTS as usize, "{} bytes", own.list.capacity());
    }
    assert_eq!(own.next_subject(), None);
    assert!(own.list().is_none(), "they have another digest");
}

#[test]
fn an_edge_of_ten_thousand_loops_of_eight_tags_is_heard() {
    let own = list(10_000, 8);
    let bytes = own.encode_to_vec();
    let counted = weigh(&bytes, Hello::FIELDS, MOST_LIST).expect("it is taken");
    assert!((19_500_000..20_500_000).contains(&counted), "{counted} bytes");
    assert!(is_taken(&bytes) && (3_750_000..3_850_000).contains(&bytes.len()), "{} bytes", bytes.len());
    let messages = split(&edge("e1"), &bytes);
    // The stream takes 512 KiB, and a server 1 MB by default.
    assert!(messages.iter().all(|own| own.body.len() <= PART + 100));
    assert_eq!(messages.len(), 30);
    assert!(Stream::default().taken(&messages) == [own]);
}

#[test]
fn a_list_that_no_centre_takes_is_known_to_its_edge() {
    assert!(!is_taken(&list(15_000, 8).encode_to_vec()), "it takes too much once it is decoded");
    let of = |bytes: usize| {
        let own = Loop { description: "x".repeat(bytes), ..Loop::default() };
        Hello { loops: vec![own], ..Hello::default() }.encode_to_vec()
    };
    let most = FIRST + PART * (MOST_PARTS as usize - 1);
    assert_eq!(split(&edge("e1"), &vec![0_u8; most]).len(), MOST_PARTS as usize);
    assert!(is_taken(&of(most - 100)) && !is_taken(&of(most)), "it is of too many parts");
    // Of empty loops a few bytes are enough, and a centre refuses them when they are together.
    let empty = b"\x0a\x00".repeat(1 << 19);
    let before = refused();
    assert!(!is_taken(&empty) && Stream::default().taken(&split(&edge("e1"), &empty)).is_empty());
    assert!(refused() > before);
}

proptest! {
    /// However long lists and their parts are, and wherever an edge is stopped: a centre that hears everything takes each list
    /// that is announced to its end, once; one that is started then takes the last of them, or none where another has begun. It
    /// takes the one that has begun if it was announced before: its other parts may still be there, and have its digest.
    #[test]
    fn what_is_taken_was_announced_whole(
        turns in prop::collection::vec(
            (0usize..40, 0usize..4, 400usize..3000, any::<prop::sample::Index>()),
            1..5,
        ),
    ) {
        let (mut stream, mut last, mut announced) = (Stream::default(), Vec::new(), Vec::new());
        for (loops, tags, most, end) in turns {
            let own = list(loops, tags);
            let messages = cut(&edge("e1"), &own.encode_to_vec(), most);
            let sent = 1 + end.index(messages.len());
            let is_whole = sent == messages.len();
            let begun_again = announced.contains(&own);
            let begun = vec![own.clone()];
            let expected: Vec<Hello> = is_whole.then_some(own).into_iter().collect();
            prop_assert_eq!(stream.taken(&messages[..sent]), &expected[..]);
            if is_whole {
                announced.extend(expected.clone());
                last = expected;
            }
            let found = stream.found();
            let is_begun = !is_whole && (found.is_empty() || (begun_again && found == begun));
            prop_assert!(found == last || is_begun, "{} lists", found.len());
        }
    }
}
