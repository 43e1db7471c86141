//! Samples as bytes, exactly: stamps, values and qualities as columns of whole numbers, behind a checksum.
//!
//! ```text
//! version 1 B | CRC-32 of the rest 4 B | count | stamps | values | qualities
//! ```
//!
//! A frame of several tags is such a head and then, for each kind of values, a count, the tags and the three columns.
//!
//! A stamp is a multiple of a second, a millisecond, a microsecond or 2^-22 s (the resolution of a double today), a value a
//! decimal number of few digits, wherever every one of a column is so to the last bit; else the bits themselves are the
//! numbers. Nothing is rounded. A value that is NaN because there is none takes no room.

use super::bits::{Reader, put_ints, put_varint};
use crate::signal::{BadReason, Quality, Sample};
use std::collections::BTreeMap;

/// Version of the layout.
const VERSION: u8 = 1;
/// Most samples in one blob.
pub const MAX_SAMPLES: usize = 1 << 22;
/// Added to the code of a quality where the value is the plain NaN.
const NO_VALUE: u8 = 0x80;
/// Stamps per second, by mode; the mode after them is the bits themselves.
const STAMP_SCALES: [f64; 4] = [1.0, 1e3, 1e6, 4_194_304.0];
const STAMP_BITS: u8 = STAMP_SCALES.len() as u8;
/// Decimal places that values are tried with.
const PLACES: u8 = 6;
/// Values whose bits are the numbers; the shift follows.
const VALUE_BITS: u8 = 0xff;
/// Whole numbers below this are exact as doubles.
const EXACT: f64 = 9_007_199_254_740_992.0;

/// The samples of one tag.
pub fn encode(samples: &[Sample]) -> Vec<u8> {
    let mut out = head(samples.len());
    put_columns(&mut out, samples.iter().copied());
    sealed(out)
}

/// The samples of [`encode`]; `None` when these are not its bytes.
pub fn decode(bytes: &[u8]) -> Option<Vec<Sample>> {
    decode_at_most(bytes, MAX_SAMPLES)
}

/// The same of bytes that somebody sent: where they are of more samples than that, none is unpacked. A sample like those before
/// it takes next to nothing in them.
pub fn decode_at_most(bytes: &[u8], most: usize) -> Option<Vec<Sample>> {
    let (mut reader, count) = opened(bytes)?;
    if count > most {
        return None;
    }
    let samples = columns(&mut reader, count)?;
    reader.rest().is_empty().then_some(samples)
}

/// Samples of several tags: those whose values are alike side by side, so that each kind finds its own few bits.
pub fn encode_frame(samples: &[(u32, Sample)]) -> Vec<u8> {
    let mut alike: BTreeMap<u8, Vec<(u32, Sample)>> = BTreeMap::new();
    for &(tag, sample) in samples {
        alike.entry(likeness(&sample)).or_default().push((tag, sample));
    }
    let mut out = head(samples.len());
    for part in alike.values() {
        put_varint(&mut out, part.len() as u64);
        put_ints(&mut out, &part.iter().map(|(tag, _)| i64::from(*tag)).collect::<Vec<_>>());
        put_columns(&mut out, part.iter().map(|(_, sample)| *sample));
    }
    sealed(out)
}

/// The samples of [`encode_frame`], each tag's in their order as far as their values are alike.
pub fn decode_frame(bytes: &[u8]) -> Option<Vec<(u32, Sample)>> {
    let (mut reader, count) = opened(bytes)?;
    let mut samples = Vec::new();
    while samples.len() < count {
        let part = usize::try_from(reader.varint()?).ok()?;
        if part == 0 || part > count - samples.len() {
            return None;
        }
        let tags = reader.ints(part)?;
        for (tag, sample) in tags.into_iter().zip(columns(&mut reader, part)?) {
            samples.push((u32::try_from(tag).ok()?, sample));
        }
    }
    reader.rest().is_empty().then_some(samples)
}

/// The fewest decimal places that hold the value exactly, as a mode of a column; all others are alike.
fn likeness(sample: &Sample) -> u8 {
    let exact = |mode: &u8| {
        let scale = 10f64.powi(i32::from(mode / 2));
        whole(sample.value, |k| placed(k, *mode), sample.value * scale).is_some()
    };
    if is_no_value(sample) { 0 } else { (0..=7).find(exact).unwrap_or(VALUE_BITS) }
}

/// Orders samples by time and leaves one of each stamp: a good one before any other, else the first that came.
pub fn unique(samples: &mut Vec<Sample>) {
    samples.sort_by(|a, b| a.t.total_cmp(&b.t).then(b.quality.is_good().cmp(&a.quality.is_good())));
    samples.dedup_by(|later, first| later.t.to_bits() == first.t.to_bits());
}

fn head(count: usize) -> Vec<u8> {
    let mut out = vec![VERSION, 0, 0, 0, 0];
    put_varint(&mut out, count as u64);
    out
}

fn sealed(mut out: Vec<u8>) -> Vec<u8> {
    let sum = crc32fast::hash(&out[5..]);
    out[1..5].copy_from_slice(&sum.to_le_bytes());
    out
}

fn opened(bytes: &[u8]) -> Option<(Reader<'_>, usize)> {
    let (head, body) = bytes.split_at_checked(5)?;
    let sum = u32::from_le_bytes(head[1..].try_into().ok()?);
    if head[0] != VERSION || sum != crc32fast::hash(body) {
        return None;
    }
    let mut reader = Reader::new(body);
    let count = usize::try_from(reader.varint()?).ok().filter(|count| *count <= MAX_SAMPLES)?;
    Some((reader, count))
}

fn put_columns(out: &mut Vec<u8>, samples: impl Iterator<Item = Sample> + Clone) {
    put_stamps(out, &samples.clone().map(|s| s.t).collect::<Vec<_>>());
    let there: Vec<f64> = samples.clone().filter(|s| !is_no_value(s)).map(|s| s.value).collect();
    put_values(out, &there);
    put_qualities(out, samples);
}

fn columns(reader: &mut Reader<'_>, count: usize) -> Option<Vec<Sample>> {
    let stamps = stamps(reader, count)?;
    let there = usize::try_from(reader.varint()?).ok().filter(|there| *there <= count)?;
    let mut values = values(reader, there)?.into_iter();
    let mut samples = Vec::with_capacity(count);
    while samples.len() < count {
        let code = reader.byte()?;
        let run = usize::try_from(reader.varint()?).ok()?;
        if run == 0 || run > count - samples.len() {
            return None;
        }
        let quality = quality(code & !NO_VALUE)?;
        for _ in 0..run {
            let value = if code & NO_VALUE == 0 { values.next()? } else { f64::NAN };
            samples.push(Sample { t: stamps[samples.len()], value, quality });
        }
    }
    values.next().is_none().then_some(samples)
}

fn is_no_value(sample: &Sample) -> bool {
    sample.value.to_bits() == f64::NAN.to_bits()
}

/// Every number as a multiple of `1 / scale`, where that is exact for all.
fn multiples(values: &[f64], exact: impl Fn(f64) -> Option<i64>) -> Option<Vec<i64>> {
    values.iter().map(|&value| exact(value)).collect()
}

fn whole(value: f64, back: impl Fn(f64) -> f64, scaled: f64) -> Option<i64> {
    // By way of the whole number, which unlike the rounded one has no negative zero.
    let k = Some(scaled.round()).filter(|rounded| rounded.abs() < EXACT)? as i64;
    (back(k as f64).to_bits() == value.to_bits()).then_some(k)
}

fn put_stamps(out: &mut Vec<u8>, stamps: &[f64]) {
    for (mode, scale) in STAMP_SCALES.into_iter().enumerate() {
        if let Some(whole) = multiples(stamps, |t| whole(t, |k| k / scale, t * scale)) {
            out.push(mode as u8);
            return put_ints(out, &whole);
        }
    }
    out.push(STAMP_BITS);
    put_ints(out, &stamps.iter().map(|t| t.to_bits() as i64).collect::<Vec<_>>());
}

fn stamps(reader: &mut Reader<'_>, count: usize) -> Option<Vec<f64>> {
    let mode = reader.byte()?;
    let whole = reader.ints(count)?.into_iter();
    Some(match STAMP_SCALES.get(usize::from(mode)) {
        Some(scale) => whole.map(|k| k as f64 / scale).collect(),
        None if mode == STAMP_BITS => whole.map(|bits| f64::from_bits(bits as u64)).collect(),
        None => return None,
    })
}

/// Mode `2 e` is `k / 10^e`, mode `2 e + 1` is `k · 10^-e`: what a register times a scale of 0.1 gives is the latter.
fn put_values(out: &mut Vec<u8>, values: &[f64]) {
    put_varint(out, values.len() as u64);
    if values.is_empty() {
        return;
    }
    let mut best = bits_column(values);
    for mode in 0..=2 * PLACES + 1 {
        let scale = 10f64.powi(i32::from(mode / 2));
        let whole = multiples(values, |value| whole(value, |k| placed(k, mode), value * scale));
        if let Some(whole) = whole {
            let mut column = vec![mode];
            put_ints(&mut column, &whole);
            if column.len() < best.len() {
                best = column;
            }
            // More places make the same numbers longer.
            break;
        }
    }
    out.extend(best);
}

fn placed(k: f64, mode: u8) -> f64 {
    let places = i32::from(mode / 2);
    if mode.is_multiple_of(2) { k / 10f64.powi(places) } else { k * 10f64.powi(-places) }
}

fn bits_column(values: &[f64]) -> Vec<u8> {
    let all = values.iter().fold(0, |all, value| all | value.to_bits());
    let shift = if all == 0 { 0 } else { all.trailing_zeros() };
    let mut column = vec![VALUE_BITS, shift as u8];
    put_ints(&mut column, &values.iter().map(|value| (value.to_bits() >> shift) as i64).collect::<Vec<_>>());
    column
}

fn values(reader: &mut Reader<'_>, count: usize) -> Option<Vec<f64>> {
    if count == 0 {
        return Some(Vec::new());
    }
    let mode = reader.byte()?;
    if mode == VALUE_BITS {
        let shift = u32::from(reader.byte()?);
        let whole = reader.ints(count)?.into_iter();
        return whole.map(|k| Some(f64::from_bits((k as u64).checked_shl(shift)?))).collect();
    }
    if mode > 2 * PLACES + 1 {
        return None;
    }
    Some(reader.ints(count)?.into_iter().map(|k| placed(k as f64, mode)).collect())
}

fn put_qualities(out: &mut Vec<u8>, samples: impl Iterator<Item = Sample>) {
    let codes = samples.map(|s| code(s.quality) | if is_no_value(&s) { NO_VALUE } else { 0 });
    let mut run: Option<(u8, u64)> = None;
    for code in codes {
        run = Some(match run {
            Some((same, length)) if same == code => (code, length + 1),
            Some((other, length)) => {
                out.push(other);
                put_varint(out, length);
                (code, 1)
            }
            None => (code, 1),
        });
    }
    if let Some((code, length)) = run {
        out.push(code);
        put_varint(out, length);
    }
}

/// Codes on disk: never to be given another meaning.
pub(super) fn code(quality: Quality) -> u8 {
    match quality {
        Quality::Good => 0,
        Quality::Stale => 1,
        Quality::Bad(BadReason::DeviceException) => 2,
        Quality::Bad(BadReason::Timeout) => 3,
        Quality::Bad(BadReason::LinkDown) => 4,
        Quality::Bad(BadReason::OutOfRange) => 5,
        Quality::Bad(BadReason::NotANumber) => 6,
    }
}

/// The quality of a code; `None` where there is none.
pub(super) fn quality(of: u8) -> Option<Quality> {
    Quality::ALL.into_iter().find(|quality| code(*quality) == of)
}

#[cfg(test)]
mod tests;
