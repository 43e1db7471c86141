//! Blocks of samples as the store keeps them. The checksum is made good, or no change would come behind it.

use stictiond::signal::Sample;
use stictiond::store::{codec, unpack};

/// Takes what stands behind the head of a block.
pub fn run(bytes: &[u8]) {
    let _ = (codec::decode(bytes), codec::decode_frame(bytes));
    let mut block = vec![1];
    block.extend(crc32fast::hash(bytes).to_le_bytes());
    block.extend(bytes);
    if let Some(samples) = codec::decode(&block) {
        assert!(samples.len() <= codec::MAX_SAMPLES);
        let again = codec::decode(&codec::encode(&samples)).expect("what was encoded");
        assert!(same(again.iter(), samples.iter()), "another block than before");
    }
    if let Some(samples) = codec::decode_frame(&block) {
        let again = codec::decode_frame(&codec::encode_frame(&samples)).expect("what was encoded");
        assert_eq!(again.len(), samples.len());
    }
    let _ = unpack(bytes);
}

fn same<'s>(a: impl Iterator<Item = &'s Sample>, b: impl Iterator<Item = &'s Sample>) -> bool {
    let bits = |sample: &Sample| (sample.t.to_bits(), sample.value.to_bits(), sample.quality);
    a.map(bits).eq(b.map(bits))
}
