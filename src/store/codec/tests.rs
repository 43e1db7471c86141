use super::*;
use proptest::prelude::*;

fn same(a: &Sample, b: &Sample) -> bool {
    (a.t.to_bits(), a.value.to_bits(), a.quality) == (b.t.to_bits(), b.value.to_bits(), b.quality)
}

/// Comes back to the last bit; the bytes it took.
fn back(samples: &[Sample]) -> usize {
    let bytes = encode(samples);
    let read = decode(&bytes).expect("its own bytes");
    assert_eq!(read.len(), samples.len());
    for (a, b) in read.iter().zip(samples) {
        assert!(same(a, b), "{a:?} is not {b:?}");
    }
    bytes.len()
}

/// A minute at 1 Hz, stamped with the jitter of a poll (0 to 1 ms, to the resolution of a double).
fn minute(value: impl Fn(u32) -> f64) -> Vec<Sample> {
    let jitter = |i: u32| f64::from(i.wrapping_mul(2_654_435_761) >> 20) * 2.4e-7;
    (0..60).map(|i| Sample::good(1_763_700_000.0 + f64::from(i) + jitter(i), value(i))).collect()
}

#[test]
fn a_minute_takes_a_few_bytes_a_sample() {
    let hash = |i: u32| i.wrapping_mul(0x9E37_79B9) >> 20;
    let constant = back(&minute(|_| 42.5));
    let register = back(&minute(|i| f64::from(500 + hash(i) % 40) * 0.1));
    let single = back(&minute(|i| f64::from(50.0 + hash(i) as f32 / 4096.0)));
    println!("bytes for 60 samples: constant {constant}, register x 0.1 {register}, f32 with noise {single}");
    // Stamps with 4096 levels of jitter: 13 bits and a sign's share. Bounds are the layout's, not the noise's.
    assert!(constant < 60 * 2 + 40);
    assert!(register < 60 * 3 + 40);
    assert!(single < 60 * 5 + 40);
}

#[test]
fn numbers_on_the_edge_come_back() {
    let edge =
        [0.0, -0.0, f64::INFINITY, f64::NEG_INFINITY, f64::MIN_POSITIVE, 5e-324, f64::MAX, 0.1, 1e22, -1e-9];
    let samples: Vec<Sample> = edge
        .iter()
        .enumerate()
        .map(|(i, &value)| Sample { t: edge[(i + 3) % edge.len()], value, quality: Quality::ALL[i % 7] })
        .collect();
    back(&samples);
    back(&[]);
    let other_nan = f64::from_bits(f64::NAN.to_bits() | 5);
    back(&[Sample::good(f64::NAN, f64::NAN), Sample::good(1.0, other_nan), Sample::good(2.0, 3.0)]);
}

fn any_sample() -> impl Strategy<Value = Sample> {
    let t = prop_oneof![
        any::<f64>(),
        (0u32..1000).prop_map(f64::from),
        (1_763_000_000_000u64..1_763_000_100_000).prop_map(|ms| ms as f64 / 1e3),
    ];
    let value = prop_oneof![
        any::<f64>(),
        any::<f32>().prop_map(f64::from),
        (-40_000i32..40_000).prop_map(|raw| f64::from(raw) * 0.01),
        Just(f64::NAN),
    ];
    (t, value, 0usize..7).prop_map(|(t, value, quality)| Sample { t, value, quality: Quality::ALL[quality] })
}

#[test]
fn more_samples_than_are_wanted_are_not_unpacked() {
    let samples: Vec<Sample> = (0..10_000).map(|k| Sample::good(f64::from(k), 50.0)).collect();
    let bytes = encode(&samples);
    assert!(bytes.len() < 1000, "{} bytes", bytes.len());
    assert!(decode_at_most(&bytes, 9_999).is_none());
    assert_eq!(decode_at_most(&bytes, 10_000).map(|samples| samples.len()), Some(10_000));
}

proptest! {
    #[test]
    fn whatever_is_put_in_comes_back(samples in proptest::collection::vec(any_sample(), 0..150)) {
        back(&samples);
    }

    #[test]
    fn a_frame_comes_back(pairs in proptest::collection::vec((any::<u32>(), any_sample()), 0..150)) {
        let bytes = encode_frame(&pairs);
        let read = decode_frame(&bytes).expect("its own bytes");
        let bits = |pairs: &[(u32, Sample)]| {
            let mut all: Vec<_> =
                pairs.iter().map(|(tag, s)| (*tag, s.t.to_bits(), s.value.to_bits(), s.quality.as_str())).collect();
            all.sort_unstable();
            all
        };
        prop_assert_eq!(bits(&read), bits(&pairs));
    }

    #[test]
    fn a_changed_or_cut_blob_is_refused(
        samples in proptest::collection::vec(any_sample(), 1..80), at in any::<prop::sample::Index>(), bit in 0u8..8,
    ) {
        let bytes = encode(&samples);
        let mut changed = bytes.clone();
        changed[at.index(bytes.len())] ^= 1 << bit;
        prop_assert!(decode(&changed).is_none());
        prop_assert!(decode(&bytes[..at.index(bytes.len())]).is_none());
    }

    /// Past the checksum, as somebody might write it who means ill: read or refused, never a panic.
    #[test]
    fn rubbish_behind_a_good_checksum_is_harmless(body in proptest::collection::vec(any::<u8>(), 0..200)) {
        let mut bytes = vec![VERSION, 0, 0, 0, 0];
        bytes.extend(&body);
        let bytes = sealed(bytes);
        let _ = decode(&bytes);
        let _ = decode_frame(&bytes);
        let _ = decode(&body);
    }

    #[test]
    fn one_sample_of_each_stamp_is_left(mut samples in proptest::collection::vec(
        (0u8..20, 0usize..3).prop_map(|(t, q)| Sample { t: f64::from(t), value: 1.0, quality: Quality::ALL[q] }), 0..60,
    )) {
        let before = samples.clone();
        unique(&mut samples);
        prop_assert!(samples.windows(2).all(|pair| pair[0].t < pair[1].t));
        for sample in &before {
            let kept = samples.iter().find(|kept| kept.t == sample.t).expect("a stamp is gone");
            prop_assert!(kept.quality.is_good() || !sample.quality.is_good());
        }
    }
}
