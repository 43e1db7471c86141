//! From registers to a value with a quality. Never panics, whatever the registers.

use super::config::TagConfig;
use super::kinds::{ByteOrder, ValueType};
use crate::collect::scaling::{Reading, Scaling};
use crate::signal::Role;

/// How the registers of one tag become a value.
#[derive(Clone, Debug, PartialEq)]
pub struct Decoder {
    value_type: ValueType,
    order: ByteOrder,
    bit: u8,
    scaling: Scaling,
}

impl Decoder {
    /// The decoder of a tag whose configuration was found valid in this role.
    pub(super) fn new(tag: &TagConfig, value_type: ValueType, order: ByteOrder, role: Option<Role>) -> Self {
        Self { value_type, order, bit: tag.bit.unwrap_or(0), scaling: tag.scaling().in_role(role) }
    }

    /// Makes the value of `words`, which begin at the tag's first register (for a coil: one word, 0 or 1).
    /// `None` when there are fewer than the type takes.
    ///
    /// value = scale * raw + offset. `bad:not_a_number` when that is not finite, `bad:out_of_range` (with
    /// the value) when it lies outside the range. A mode is 1 in automatic, else 0.
    pub fn decode(&self, words: &[u16]) -> Option<Reading> {
        Some(self.scaling.read(self.raw(words)?))
    }

    fn raw(&self, words: &[u16]) -> Option<f64> {
        let order = self.order;
        Some(match self.value_type {
            ValueType::U16 => f64::from(u16::from_be_bytes(bytes(words, order)?)),
            ValueType::I16 => f64::from(i16::from_be_bytes(bytes(words, order)?)),
            ValueType::U32 => f64::from(u32::from_be_bytes(bytes(words, order)?)),
            ValueType::I32 => f64::from(i32::from_be_bytes(bytes(words, order)?)),
            ValueType::U64 => u64::from_be_bytes(bytes(words, order)?) as f64,
            ValueType::I64 => i64::from_be_bytes(bytes(words, order)?) as f64,
            ValueType::F32 => f64::from(f32::from_be_bytes(bytes(words, order)?)),
            ValueType::F64 => f64::from_be_bytes(bytes(words, order)?),
            ValueType::Bit => f64::from((u16::from_be_bytes(bytes(words, order)?) >> (self.bit & 15)) & 1),
        })
    }
}

/// The first N bytes of a value, most significant first, from registers in the given order.
pub(super) fn bytes<const N: usize>(words: &[u16], order: ByteOrder) -> Option<[u8; N]> {
    let words = words.get(..N / 2)?;
    let mut out = [0u8; N];
    for (at, pair) in out.chunks_exact_mut(2).enumerate() {
        let word = match order {
            ByteOrder::Abcd => words[at],
            ByteOrder::Cdab => words[words.len() - 1 - at],
            ByteOrder::Badc => words[at].swap_bytes(),
            ByteOrder::Dcba => words[words.len() - 1 - at].swap_bytes(),
        };
        pair.copy_from_slice(&word.to_be_bytes());
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::{BadReason, Quality};
    use proptest::prelude::*;

    const PLAIN: Scaling = Scaling { scale: 1.0, offset: 0.0, range: None, auto_values: None };

    fn decoder(value_type: ValueType, order: ByteOrder) -> Decoder {
        Decoder { value_type, order, bit: 0, scaling: PLAIN }
    }

    fn value(value_type: ValueType, order: ByteOrder, words: &[u16]) -> f64 {
        decoder(value_type, order).decode(words).unwrap().value
    }

    /// The documented table, bytes by name: A = 0x0A … H = 0x1F.
    #[test]
    fn byte_orders_are_those_of_the_documented_table() {
        let word = |text: &str| u16::from_str_radix(text, 16).unwrap();
        let cases = [
            (ByteOrder::Abcd, "0A0B", ["0A0B", "0C0D"], ["0A0B", "0C0D", "0E0F", "1A1F"]),
            (ByteOrder::Cdab, "0A0B", ["0C0D", "0A0B"], ["1A1F", "0E0F", "0C0D", "0A0B"]),
            (ByteOrder::Badc, "0B0A", ["0B0A", "0D0C"], ["0B0A", "0D0C", "0F0E", "1F1A"]),
            (ByteOrder::Dcba, "0B0A", ["0D0C", "0B0A"], ["1F1A", "0F0E", "0D0C", "0B0A"]),
        ];
        for (order, one, two, four) in cases {
            assert_eq!(bytes(&[word(one)], order), Some([0x0A, 0x0B]), "{order:?}");
            assert_eq!(bytes(&two.map(word), order), Some([0x0A, 0x0B, 0x0C, 0x0D]), "{order:?}");
            let eight = [0x0A, 0x0B, 0x0C, 0x0D, 0x0E, 0x0F, 0x1A, 0x1F];
            assert_eq!(bytes(&four.map(word), order), Some(eight), "{order:?}");
        }
    }

    #[test]
    fn hand_values() {
        use ValueType::*;
        assert_eq!(value(U16, ByteOrder::Abcd, &[0xFFFF]), 65535.0);
        assert_eq!(value(I16, ByteOrder::Abcd, &[0xFFFF]), -1.0);
        assert_eq!(value(U32, ByteOrder::Abcd, &[0x0001, 0x0000]), 65536.0);
        assert_eq!(value(I32, ByteOrder::Cdab, &[0xFFFE, 0xFFFF]), -2.0);
        assert_eq!(value(F32, ByteOrder::Abcd, &[0x42F6, 0xE979]), f64::from(123.456_f32));
        assert_eq!(value(F64, ByteOrder::Abcd, &[0x3FF8, 0, 0, 0]), 1.5);
        assert_eq!(value(U64, ByteOrder::Abcd, &[0, 1, 0, 0]), 4_294_967_296.0);
        assert_eq!(value(I64, ByteOrder::Cdab, &[0xFFFE, 0xFFFF, 0xFFFF, 0xFFFF]), -2.0);
    }

    #[test]
    fn what_is_not_a_number_is_never_a_value() {
        for bits in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY].map(f32::to_bits) {
            let words = [(bits >> 16) as u16, bits as u16];
            let reading = decoder(ValueType::F32, ByteOrder::Abcd).decode(&words).unwrap();
            assert_eq!(reading.quality, Quality::Bad(BadReason::NotANumber));
            assert!(reading.value.is_nan());
        }
        let overflow =
            Decoder { scaling: Scaling { scale: 10.0, ..PLAIN }, ..decoder(ValueType::F64, ByteOrder::Abcd) };
        let reading = overflow.decode(&[0x7FEF, 0xFFFF, 0xFFFF, 0xFFFF]).unwrap();
        assert_eq!(reading.quality, Quality::Bad(BadReason::NotANumber));
    }

    #[test]
    fn the_range_holds_after_scaling_and_includes_its_ends() {
        let percent = Decoder {
            scaling: Scaling { scale: 0.5, offset: -10.0, range: Some([0.0, 100.0]), ..PLAIN },
            ..decoder(ValueType::U16, ByteOrder::Abcd)
        };
        let quality = |raw| percent.decode(&[raw]).unwrap().quality;
        assert_eq!(quality(19), Quality::Bad(BadReason::OutOfRange));
        assert_eq!(quality(20), Quality::Good);
        assert_eq!(quality(220), Quality::Good);
        assert_eq!(quality(221), Quality::Bad(BadReason::OutOfRange));
        assert_eq!(percent.decode(&[221]).unwrap().value, 100.5);
    }

    #[test]
    fn bits_and_modes() {
        let bit = Decoder { bit: 9, ..decoder(ValueType::Bit, ByteOrder::Abcd) };
        assert_eq!(bit.decode(&[0x0200]).unwrap().value, 1.0);
        assert_eq!(bit.decode(&[0xFDFF]).unwrap().value, 0.0);
        let swapped = Decoder { order: ByteOrder::Badc, ..bit };
        assert_eq!(swapped.decode(&[0x0002]).unwrap().value, 1.0);
        let mode = |auto: &[i64], raw| {
            let scaling = Scaling { auto_values: Some(auto.to_vec()), ..PLAIN };
            let with = Decoder { scaling, ..decoder(ValueType::U16, ByteOrder::Abcd) };
            with.decode(&[raw]).unwrap().value
        };
        assert_eq!([0, 1, 2, 3].map(|raw| mode(&[1, 2], raw)), [0.0, 1.0, 1.0, 0.0]);
        assert_eq!([0, 1, 7].map(|raw| mode(&[], raw)), [0.0, 1.0, 1.0]);
    }

    fn any_order() -> impl Strategy<Value = ByteOrder> {
        prop::sample::select(ByteOrder::ALL.to_vec())
    }

    fn any_type() -> impl Strategy<Value = ValueType> {
        use ValueType::*;
        prop::sample::select(vec![U16, I16, U32, I32, F32, F64, Bit])
    }

    /// Lays big-endian bytes into registers by the documented letters, independently of `bytes`.
    fn encode(big_endian: &[u8], order: ByteOrder) -> Vec<u16> {
        let mut laid = big_endian.to_vec();
        if matches!(order, ByteOrder::Dcba | ByteOrder::Cdab) {
            laid.reverse();
        }
        if matches!(order, ByteOrder::Badc | ByteOrder::Cdab) {
            laid.chunks_exact_mut(2).for_each(|pair| pair.swap(0, 1));
        }
        laid.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect()
    }

    proptest! {
        #[test]
        fn what_is_encoded_is_decoded(order in any_order(), u in any::<u32>(), d in any::<f64>()) {
            use ValueType::*;
            prop_assert_eq!(value(U16, order, &encode(&(u as u16).to_be_bytes(), order)), f64::from(u as u16));
            prop_assert_eq!(value(I16, order, &encode(&(u as i16).to_be_bytes(), order)), f64::from(u as i16));
            prop_assert_eq!(value(U32, order, &encode(&u.to_be_bytes(), order)), f64::from(u));
            prop_assert_eq!(value(I32, order, &encode(&u.to_be_bytes(), order)), f64::from(u as i32));
            let f = f32::from_bits(u);
            let single = value(F32, order, &encode(&f.to_be_bytes(), order));
            prop_assert!(single == f64::from(f) || (!f.is_finite() && single.is_nan()));
            prop_assert_eq!(value(F64, order, &encode(&d.to_be_bytes(), order)), d);
        }

        #[test]
        fn short_answers_give_nothing_and_long_ones_never_panic(
            value_type in any_type(), order in any_order(), bit in any::<u8>(),
            scale in any::<f64>(), words in prop::collection::vec(any::<u16>(), 0..8),
        ) {
            let decoder = Decoder { bit, scaling: Scaling { scale, ..PLAIN }, ..decoder(value_type, order) };
            let reading = decoder.decode(&words);
            prop_assert_eq!(reading.is_some(), words.len() >= usize::from(value_type.width()));
            if let Some(reading) = reading {
                prop_assert_eq!(reading.quality.is_good(), reading.value.is_finite());
            }
        }
    }
}
