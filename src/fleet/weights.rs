//! How messages are read: one that would take too much once it is decoded is refused before that, told and counted. Blocks of
//! samples share the bytes of their message, so they take nothing.

use super::message::{
    Action, Alarm, AlarmChange, AlarmState, Answer, Cursor, Diagnosis, Effect, Hello, HelloPart, Loop, Model,
    Place, Pulse, Run, Samples, States, Tag, TagSamples, Window,
};
use super::ops::LOG;
use crate::protobuf::Field::{self, Text, Texts};
use crate::protobuf::{self, Weighed, many, one};
use prost::bytes::Bytes;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Most that a message takes once it is decoded, beside its own bytes (bytes): a report or its basis may be nearly as long as a
/// message. Together with the longest message in the client's buffers that is less than 32 MiB. The list of an edge's loops comes in
/// parts, and has a bound of its own, [`MOST_LIST`](super::announcement::MOST_LIST).
pub const MOST_DECODED: usize = 15 << 20;

/// Messages that were refused since the start of the process.
static REFUSED: AtomicU64 = AtomicU64::new(0);

/// Messages that were refused since the start.
pub fn refused() -> u64 {
    REFUSED.load(Relaxed)
}

/// Reads a message; nothing where it is refused.
pub fn read<M: Weighed>(subject: &str, bytes: impl Into<Bytes>) -> Option<M> {
    match protobuf::read(bytes.into(), MOST_DECODED) {
        Ok(message) => Some(message),
        Err(why) => {
            refuse(subject, &why.to_string());
            None
        }
    }
}

/// Tells that a message is of no use, and counts it. Who sends it decides how often, so the lines are bounded as those of a
/// library are.
pub fn refuse(subject: &str, why: &str) {
    REFUSED.fetch_add(1, Relaxed);
    tracing::warn!(target: LOG, subject, why, "a message of the fleet is refused");
}

impl Weighed for Samples {
    const FIELDS: &'static [Field] = &[many::<TagSamples>(1), many::<Place>(2), Text(3)];
}

impl Weighed for Place {
    const FIELDS: &'static [Field] = &[Text(1), Text(2)];
}

impl Weighed for TagSamples {
    const FIELDS: &'static [Field] = &[Text(1), Text(2)];
}

impl Weighed for Window {
    const FIELDS: &'static [Field] = &[Text(1), Text(2), many::<TagSamples>(3), Text(7)];
}

impl Weighed for Answer {
    const FIELDS: &'static [Field] = &[Text(1), Text(2), one::<Run>(3), Text(4)];
}

impl Weighed for Diagnosis {
    const FIELDS: &'static [Field] = &[one::<Run>(2), one::<Model>(3), Text(4)];
}

impl Weighed for Run {
    const FIELDS: &'static [Field] =
        &[Text(1), Text(5), Text(6), Text(7), Text(13), Text(14), Text(15), many::<Effect>(16)];
}

impl Weighed for Effect {
    const FIELDS: &'static [Field] = &[Text(1), Text(2)];
}

impl Weighed for Model {
    const FIELDS: &'static [Field] = &[Text(3)];
}

impl Weighed for Alarm {
    const FIELDS: &'static [Field] = &[one::<AlarmState>(2), one::<AlarmChange>(3), Text(5)];
}

impl Weighed for States {
    const FIELDS: &'static [Field] = &[many::<AlarmState>(1), Text(2)];
}

impl Weighed for AlarmState {
    const FIELDS: &'static [Field] =
        &[Text(1), Text(2), Text(10), Text(12), Text(13), Text(14), Text(17), Text(18), Text(19)];
}

impl Weighed for AlarmChange {
    const FIELDS: &'static [Field] = &[Text(2), Text(3), Text(4), Text(5), Text(6), Text(7), Text(8)];
}

impl Weighed for Action {
    const FIELDS: &'static [Field] = &[Text(1), Text(2), Text(3), Text(5), Text(6), Text(11)];
}

impl Weighed for HelloPart {
    const FIELDS: &'static [Field] = &[Text(1)];
}

impl Weighed for Hello {
    const FIELDS: &'static [Field] = &[many::<Loop>(1), Texts(2)];
}

impl Weighed for Loop {
    const FIELDS: &'static [Field] = &[Text(1), Text(2), Text(3), many::<Tag>(8), Texts(9), Text(11)];
}

impl Weighed for Tag {
    const FIELDS: &'static [Field] = &[Text(1), Text(2), Text(3), Text(4)];
}

impl Weighed for Pulse {
    const FIELDS: &'static [Field] = &[Text(1), Text(2), Text(8)];
}

impl Weighed for Cursor {
    const FIELDS: &'static [Field] = &[];
}

#[cfg(test)]
pub(super) mod tests;
