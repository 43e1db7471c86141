//! Columns of whole numbers in few bits: the deltas from number to number, less their median, packed in blocks that each
//! have a width of their own. Reading never trusts what it reads.

/// Numbers that share a width.
const BLOCK: usize = 32;

/// Appends a count, seven bits a byte.
pub fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// Appends numbers; how many there are is for the caller to remember.
pub fn put_ints(out: &mut Vec<u8>, values: &[i64]) {
    let Some((&first, rest)) = values.split_first() else { return };
    put_varint(out, zigzag(first));
    if rest.is_empty() {
        return;
    }
    let deltas: Vec<i64> = values.windows(2).map(|pair| pair[1].wrapping_sub(pair[0])).collect();
    let mut sorted = deltas.clone();
    let middle = sorted.len() / 2;
    let (_, &mut median, _) = sorted.select_nth_unstable(middle);
    put_varint(out, zigzag(median));
    let residuals: Vec<u64> = deltas.iter().map(|delta| zigzag(delta.wrapping_sub(median))).collect();
    residuals.chunks(BLOCK).for_each(|block| put_block(out, block));
}

fn put_block(out: &mut Vec<u8>, block: &[u64]) {
    let width = 64 - block.iter().fold(0, |all, value| all | value).leading_zeros();
    out.push(width as u8);
    let (mut held, mut bits) = (0u128, 0);
    for &value in block {
        held |= u128::from(value) << bits;
        bits += width;
        while bits >= 8 {
            out.push(held as u8);
            held >>= 8;
            bits -= 8;
        }
    }
    if bits > 0 {
        out.push(held as u8);
    }
}

fn zigzag(value: i64) -> u64 {
    ((value << 1) ^ (value >> 63)) as u64
}

fn unzigzag(value: u64) -> i64 {
    (value >> 1) as i64 ^ -((value & 1) as i64)
}

/// Reads what was put; `None` where the bytes end too soon or cannot have been put.
pub struct Reader<'a> {
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    /// From the beginning of some bytes.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes }
    }

    /// Bytes not read yet.
    pub fn rest(&self) -> &'a [u8] {
        self.rest
    }

    /// The next bytes.
    pub fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.rest.split_at_checked(count)?;
        self.rest = rest;
        Some(taken)
    }

    /// The next byte.
    pub fn byte(&mut self) -> Option<u8> {
        Some(self.take(1)?[0])
    }

    /// A count.
    pub fn varint(&mut self) -> Option<u64> {
        let mut value = 0u64;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            let part = u64::from(byte & 0x7f);
            if shift == 63 && part > 1 {
                return None;
            }
            value |= part << shift;
            if byte & 0x80 == 0 {
                return Some(value);
            }
        }
        None
    }

    /// `count` numbers. Memory is taken only as far as the bytes can hold that many: a block is at least one byte.
    pub fn ints(&mut self, count: usize) -> Option<Vec<i64>> {
        if count == 0 {
            return Some(Vec::new());
        }
        let first = unzigzag(self.varint()?);
        let median = if count > 1 { unzigzag(self.varint()?) } else { 0 };
        if (count - 1).div_ceil(BLOCK) > self.rest.len() {
            return None;
        }
        let mut values = Vec::with_capacity(count);
        let mut last = first;
        values.push(last);
        while values.len() < count {
            let block = BLOCK.min(count - values.len());
            let width = u32::from(self.byte()?);
            if width > 64 {
                return None;
            }
            let mut bytes = self.take((block * width as usize).div_ceil(8))?.iter();
            let (mut held, mut bits) = (0u128, 0);
            for _ in 0..block {
                while bits < width {
                    held |= u128::from(*bytes.next()?) << bits;
                    bits += 8;
                }
                let residual = (held & ((1u128 << width) - 1)) as u64;
                held >>= width;
                bits -= width;
                last = last.wrapping_add(median).wrapping_add(unzigzag(residual));
                values.push(last);
            }
        }
        Some(values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn back(values: &[i64]) -> usize {
        let mut out = Vec::new();
        put_ints(&mut out, values);
        let mut reader = Reader::new(&out);
        assert_eq!(reader.ints(values.len()).as_deref(), Some(values));
        assert!(reader.rest().is_empty(), "bytes are left over");
        out.len()
    }

    #[test]
    fn an_even_clock_takes_next_to_nothing() {
        let even: Vec<i64> = (0..60).map(|i| 1_700_000_000 + i).collect();
        // Five bytes for the first, one for the period, one a block of 32.
        assert_eq!(back(&even), 8);
        assert_eq!(back(&[]), 0);
        assert_eq!(back(&[-1]), 1);
    }

    proptest! {
        #[test]
        fn every_number_comes_back(values in proptest::collection::vec(any::<i64>(), 0..200)) {
            back(&values);
        }

        #[test]
        fn small_steps_come_back(values in proptest::collection::vec(-300i64..300, 0..200)) {
            back(&values);
        }

        #[test]
        fn rubbish_is_read_without_a_panic(bytes in proptest::collection::vec(any::<u8>(), 0..100), count in 0usize..10_000) {
            let mut reader = Reader::new(&bytes);
            if let Some(values) = reader.ints(count) {
                prop_assert_eq!(values.len(), count);
            }
            let mut reader = Reader::new(&bytes);
            while reader.varint().is_some() {}
        }
    }
}
