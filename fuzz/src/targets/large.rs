//! A long input for each target whose bound in the daemon is far above the inputs of `fuzz/corpus`, which is small. The fuzzer makes
//! its inputs longer only slowly, from the longest that it begins with.

use stictiond::bounded::OPCUA;
use stictiond::fleet::message::{Samples, TagSamples};
use stictiond::protobuf::Weighed;

/// Longest payload that a collector takes by default (bytes).
const PAYLOAD: usize = 256 << 10;
/// A block of samples (bytes): with its message it fits into the longest input that `scripts/fuzz` lets this target have.
const BLOCK: usize = 48_000;

/// A notification in the longest chunk that is taken, with zeroes behind the message.
pub fn opcua() -> Vec<u8> {
    let mut chunk = include_bytes!("../../corpus/opcua/publish").to_vec();
    let most = OPCUA.framing.expect("a chunk has a bound").most;
    chunk.resize(most as usize, 0);
    chunk[4..8].copy_from_slice(&(most as u32).to_le_bytes());
    chunk
}

/// A message of one long block of samples.
pub fn fleet() -> Vec<u8> {
    let block = vec![7u8; BLOCK].into();
    let tag = TagSamples { tag: "pv".into(), source: "d 1".into(), block, ..TagSamples::default() };
    bytes(&Samples { tags: vec![tag], ..Samples::default() })
}

fn bytes<M: Weighed>(message: &M) -> Vec<u8> {
    message.encode_to_vec()
}

/// A value beside a long list.
pub fn json() -> Vec<u8> {
    let head = "{\"v\":50.5,\"t\":\"2026-01-01T00:00:00Z\",\"items\":[0";
    let zeroes = (PAYLOAD - head.len() - 2) / 2;
    format!("{head}{}]}}", ",0".repeat(zeroes)).into_bytes()
}

/// A birth that tells one of its metrics again and again, as long as a payload may be.
pub fn sparkplug() -> Vec<u8> {
    let session = include_bytes!("../../corpus/sparkplug/session");
    // Behind the two bytes that say which message it is and how long, and with its last metric by itself.
    let (birth, metric) = (&session[2..0x4e], &session[0x37..0x4c]);
    let again = (PAYLOAD - 2 - birth.len()) / metric.len();
    [&[session[0], super::mqtt::REST][..], birth, &metric.repeat(again)].concat()
}
