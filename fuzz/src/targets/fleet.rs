//! What a NATS server sends, as it is counted, and what the machines of a fleet say through it.

use stictiond::fleet::announcement::Heard;
use stictiond::fleet::convert;
use stictiond::fleet::message::{
    Action, Alarm, Answer, Cursor, Diagnosis, Hello, HelloPart, Pulse, Run, Samples, States, Window,
};
use stictiond::fleet::ops::Watch;
use stictiond::fleet::subject::{Subject, What};
use stictiond::protobuf::{self, Weighed};

/// Most that a message may take once it is decoded (bytes). An input of 16 kB that is nothing but empty parts would take ten
/// times as much, more than the target's bound: so what is counted too low is found.
const MOST: usize = 256 << 10;

/// What is read says the same again, and takes no more than was counted.
fn read<M: Weighed>(bytes: &[u8]) -> Option<M> {
    let own: M = protobuf::read(bytes, MOST).ok()?;
    let said = own.encode_to_vec();
    let again: M = protobuf::read(&said[..], MOST).expect("what we say can be read");
    assert!(again.encode_to_vec() == said);
    Some(own)
}

fn row(run: &Run) {
    let _ = convert::diagnosis_row(run);
}

/// A part of an announcement by this number, in a stream that has no other.
fn announced(number: u32, part: &[u8]) {
    let subject = Subject::new("north", "e1", What::Hello).part(number);
    let Some(Heard::Last(mut own)) = Heard::read(&subject, part.to_vec()) else { return };
    while let Some(next) = own.next_subject() {
        if !own.push((next == subject).then(|| part.to_vec())) {
            return;
        }
    }
    let _ = own.list();
}

/// Bytes of a server on one connection, in pieces and whole, and the same as each message.
pub fn run(bytes: &[u8]) {
    let (mut whole, mut cut) = (Watch::default(), Watch::default());
    let all = whole.server(bytes).map(drop);
    let pieces = bytes.chunks(7).try_for_each(|piece| cut.server(piece).map(drop));
    assert!(all == pieces, "cuts make a difference: {all:?}, {pieces:?}");
    let _ = whole.client(bytes);
    let _ = read::<Samples>(bytes);
    let _ = read::<Window>(bytes);
    let _ = read::<Action>(bytes);
    let _ = read::<Hello>(bytes);
    if let Some(part) = read::<HelloPart>(bytes) {
        announced(part.number, bytes);
    }
    let _ = read::<Pulse>(bytes);
    let _ = read::<Cursor>(bytes);
    if let Some(run) = read::<Answer>(bytes).and_then(|answer| answer.run) {
        row(&run);
    }
    if let Some(Diagnosis { run: Some(run), model, .. }) = read::<Diagnosis>(bytes) {
        row(&run);
        let _ = model.map(|model| convert::model_row(&run.control_loop, &model));
    }
    let states = read::<States>(bytes).map(|own| own.alarms).unwrap_or_default();
    states.into_iter().for_each(|state| drop(convert::alarm_row(state)));
    if let Some(Alarm { state: Some(state), change, .. }) = read::<Alarm>(bytes) {
        let _ = change.map(|change| convert::change_row(&state.subject, &state.kind, &change));
        let _ = convert::alarm_row(state);
    }
}
