//! The ring of one tag: bounded memory, one writer, any number of readers, nobody waits.
//!
//! # Why a reader never returns a torn sample
//!
//! `head` is the number of samples written so far; sample `i` lives in slot `i % slots`. The writer of
//! sample `k` does, in this order,
//!
//! 1. `fence(Release)`, which puts the earlier store `head = k` before everything that follows,
//! 2. relaxed stores of the slot's stamp, value and quality,
//! 3. `head.store(k + 1, Release)`.
//!
//! A reader loads `head` as `h1` (Acquire), copies the slots of samples `h1 - capacity .. h1` with relaxed
//! loads, does `fence(Acquire)` and loads `head` again as `h2`.
//!
//! - *No sample is half old:* `h1` was read with Acquire from a Release store, so every sample `< h1` is seen whole.
//! - *No sample is half new:* suppose a load of sample `i`'s slot saw a store made for a later sample `k`, `k = i +
//!   m * slots`, `m >= 1`. The writer's release fence precedes that store and the reader's acquire fence follows
//!   the load, so the fences synchronise and the reader's `h2` is at least `k`. The reader keeps only `i` with
//!   `i + slots > h2`; here `i + slots <= k <= h2`, so that sample is dropped.
//!
//! At least one slot more than the capacity is kept, so that a full ring at rest is returned whole. The argument needs one
//! writer at a time; `writing` enforces it without a lock: a second writer that arrives during a push is refused
//! and its sample counted, never mixed in.
//!
//! # How a sample is packed
//!
//! Every bit comes back, in half the memory where 32 bits are enough:
//!
//! - a value that is an `f32` is kept as one: so are most registers of controllers;
//! - a stamp is kept as its distance from a line, `t = (t0 + j step) + d 2^-22 s`, for the `j`-th slot of a block. 2^-22 s is
//!   the resolution of an `f64` that counts seconds since 1970, so `d` is a whole number.
//!
//! What does not fit has its 64 bits in an array that the block gets when it is first needed, and keeps.
//! The line of a block changes with each lap of the ring. Lines of two laps are kept by turns: the line of sample `i` is
//! overwritten two laps later, when `i` itself is gone.

use super::heard::Heard;
use crate::signal::{BadReason, Quality, Sample};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, AtomicU64, Ordering, fence};

/// Bytes that one sample takes where its value is an `f32`: stamp, value, quality and its share of the block.
pub const BYTES_PER_SAMPLE: usize = size_of::<Block>() / SLOTS;

/// Slots of a block.
const SLOTS: usize = 64;

/// Resolution of an `f64` that counts seconds since 1970 (s).
const TICK_S: f64 = 1.0 / 4_194_304.0;

/// Bit of `quality`: all 64 bits of the stamp are in `wide_t`.
const WIDE_T: u8 = 1 << 6;
/// Bit of `quality`: all 64 bits of the value are in `wide_value`.
const WIDE_VALUE: u8 = 1 << 7;

/// 64 bits of each slot.
type Wide = OnceLock<Box<[AtomicU64; SLOTS]>>;

/// Slots in 640 bytes, which is a size class of the allocator: one array for a ring of any length would cost up to a quarter more
/// than it holds.
#[derive(Debug)]
struct Block {
    /// Lines of the stamps, of even and odd laps.
    lines: [Line; 2],
    t: [AtomicU32; SLOTS],
    value: [AtomicU32; SLOTS],
    quality: [AtomicU8; SLOTS],
    wide_t: Wide,
    wide_value: Wide,
}

/// `t0 + j step`, near the stamps of a block.
#[derive(Debug, Default)]
struct Line {
    t0: AtomicU64,
    step: AtomicU64,
}

impl Line {
    fn at(&self, slot: usize) -> f64 {
        let [t0, step] = [&self.t0, &self.step].map(|bits| f64::from_bits(bits.load(Ordering::Relaxed)));
        t0 + slot as f64 * step
    }

    fn begin(&self, t0: f64, step: f64) {
        self.t0.store(t0.to_bits(), Ordering::Relaxed);
        self.step.store(step.to_bits(), Ordering::Relaxed);
    }
}

/// Blocks of a ring: one slot is to spare.
fn blocks(capacity: usize) -> usize {
    (capacity.max(1) + 1).div_ceil(SLOTS)
}

fn put(wide: &Wide, slot: usize, bits: u64) {
    let all = wide.get_or_init(|| Box::new([const { AtomicU64::new(0) }; SLOTS]));
    all[slot].store(bits, Ordering::Relaxed);
}

/// Zero before the array is there: only of a slot that is being overwritten, which is dropped.
fn take(wide: &Wide, slot: usize) -> f64 {
    f64::from_bits(wide.get().map_or(0, |all| all[slot].load(Ordering::Relaxed)))
}

impl Block {
    fn new() -> Box<Self> {
        Box::new(Self {
            lines: [Line::default(), Line::default()],
            t: [const { AtomicU32::new(0) }; SLOTS],
            value: [const { AtomicU32::new(0) }; SLOTS],
            quality: [const { AtomicU8::new(0) }; SLOTS],
            wide_t: OnceLock::new(),
            wide_value: OnceLock::new(),
        })
    }

    fn write(&self, line: &Line, slot: usize, sample: Sample) {
        let mut quality = encode(sample.quality);
        let from_line = line.at(slot);
        // A cast saturates: what is too far away, or no number, does not come back and is kept whole.
        let ticks = ((sample.t - from_line) / TICK_S) as i32;
        if stamp(from_line, ticks).to_bits() == sample.t.to_bits() {
            self.t[slot].store(ticks.cast_unsigned(), Ordering::Relaxed);
        } else {
            quality |= WIDE_T;
            put(&self.wide_t, slot, sample.t.to_bits());
        }
        let value = sample.value as f32;
        if f64::from(value).to_bits() == sample.value.to_bits() {
            self.value[slot].store(value.to_bits(), Ordering::Relaxed);
        } else {
            quality |= WIDE_VALUE;
            put(&self.wide_value, slot, sample.value.to_bits());
        }
        self.quality[slot].store(quality, Ordering::Relaxed);
    }

    fn read(&self, line: &Line, slot: usize) -> Sample {
        let quality = self.quality[slot].load(Ordering::Relaxed);
        let t = if quality & WIDE_T == 0 {
            stamp(line.at(slot), self.t[slot].load(Ordering::Relaxed).cast_signed())
        } else {
            take(&self.wide_t, slot)
        };
        let value = if quality & WIDE_VALUE == 0 {
            f64::from(f32::from_bits(self.value[slot].load(Ordering::Relaxed)))
        } else {
            take(&self.wide_value, slot)
        };
        Sample { t, value, quality: decode(quality & !(WIDE_T | WIDE_VALUE)) }
    }

    /// Bytes of the arrays that were needed so far.
    fn wide_bytes(&self) -> usize {
        let count = [&self.wide_t, &self.wide_value].into_iter().filter(|wide| wide.get().is_some()).count();
        count * size_of::<[AtomicU64; SLOTS]>()
    }
}

fn stamp(from_line: f64, ticks: i32) -> f64 {
    from_line + f64::from(ticks) * TICK_S
}

/// The last samples of one tag.
#[derive(Debug)]
pub struct Ring {
    blocks: Box<[Box<Block>]>,
    capacity: usize,
    head: AtomicU64,
    writing: AtomicBool,
    refused: AtomicU64,
    heard: Heard,
}

impl Ring {
    /// A ring that keeps the last `capacity` samples (at least one); the memory of samples that fit 32 bits is taken, and
    /// touched, here.
    pub fn new(capacity: usize) -> Self {
        let capacity = capacity.max(1);
        Self {
            blocks: (0..blocks(capacity)).map(|_| Block::new()).collect(),
            capacity,
            head: AtomicU64::new(0),
            writing: AtomicBool::new(false),
            refused: AtomicU64::new(0),
            heard: Heard::default(),
        }
    }

    /// When something last came.
    pub fn heard(&self) -> &Heard {
        &self.heard
    }

    /// Bytes that a ring of this capacity holds while every sample fits 32 bits.
    pub fn bytes(capacity: usize) -> usize {
        blocks(capacity) * (size_of::<Block>() + size_of::<Box<Block>>()) + size_of::<Self>()
    }

    /// Bytes that a ring of this capacity holds where no value fits.
    pub fn wide_bytes(capacity: usize) -> usize {
        Self::bytes(capacity) + blocks(capacity) * size_of::<[AtomicU64; SLOTS]>()
    }

    /// Samples kept at most.
    pub fn capacity(&self) -> usize {
        self.capacity
    }

    /// The block of sample `i`, the line of its lap, and its place there.
    fn slot(&self, i: u64) -> (&Block, &Line, usize) {
        let slot = (i % self.slots()) as usize;
        let block = &self.blocks[slot / SLOTS];
        (block, &block.lines[lap(i, self.slots())], slot % SLOTS)
    }

    fn slots(&self) -> u64 {
        (self.blocks.len() * SLOTS) as u64
    }

    /// Bytes held.
    pub fn memory_bytes(&self) -> usize {
        Self::bytes(self.capacity) + self.blocks.iter().map(|block| block.wide_bytes()).sum::<usize>()
    }

    /// Samples ever pushed.
    pub fn pushed(&self) -> u64 {
        self.head.load(Ordering::Acquire)
    }

    /// Samples refused because another writer was in the middle of a push: not zero only by a wiring fault.
    pub fn refused(&self) -> u64 {
        self.refused.load(Ordering::Relaxed)
    }

    /// Appends a sample over the oldest one. Wait-free, but for the memory that a block takes when a sample first does not fit.
    pub fn push(&self, sample: Sample) {
        if self.writing.swap(true, Ordering::Acquire) {
            self.refused.fetch_add(1, Ordering::Relaxed);
            return;
        }
        let head = self.head.load(Ordering::Relaxed);
        let (block, line, slot) = self.slot(head);
        fence(Ordering::Release);
        if slot == 0 {
            line.begin(sample.t, self.step(head));
        }
        block.write(line, slot, sample);
        self.head.store(head + 1, Ordering::Release);
        self.writing.store(false, Ordering::Release);
    }

    /// Mean time between the samples of the block before sample `head` (s).
    fn step(&self, head: u64) -> f64 {
        let Some(first) = head.checked_sub(SLOTS as u64) else { return 0.0 };
        let [first, last] = [first, head - 1].map(|i| self.sample(i).t);
        (last - first) / (SLOTS - 1) as f64
    }

    fn sample(&self, i: u64) -> Sample {
        let (block, line, slot) = self.slot(i);
        block.read(line, slot)
    }

    /// A copy of what is there, oldest first, in order of arrival. Never delays the writer: samples overwritten
    /// during the copy are left out.
    pub fn snapshot(&self) -> Vec<Sample> {
        self.last(self.capacity())
    }

    /// The newest sample; `None` when nothing was pushed (or the writer lapped the whole ring four times during this).
    pub fn latest(&self) -> Option<Sample> {
        (0..4).find_map(|_| self.last(1).pop())
    }

    /// Up to `most` samples from the one with number `from` on (the first ever pushed is 0), oldest first, and the number
    /// of the first of them: larger than `from` where those in between were overwritten. Never delays the writer.
    pub fn since(&self, from: u64, most: usize) -> (u64, Vec<Sample>) {
        let head = self.head.load(Ordering::Acquire);
        let first = from.max(head.saturating_sub(self.capacity() as u64)).min(head);
        self.copy(first, head.min(first.saturating_add(most as u64)))
    }

    fn last(&self, count: usize) -> Vec<Sample> {
        let head = self.head.load(Ordering::Acquire);
        self.copy(head.saturating_sub(count.min(self.capacity()) as u64), head).1
    }

    /// Samples `from..to`, `to` at most a head that was loaded before, less those overwritten meanwhile; and the number of
    /// the first.
    fn copy(&self, from: u64, to: u64) -> (u64, Vec<Sample>) {
        let mut copy: Vec<Sample> = (from..to).map(|i| self.sample(i)).collect();
        fence(Ordering::Acquire);
        let after = self.head.load(Ordering::Relaxed);
        let oldest_whole = (after + 1).saturating_sub(self.slots());
        let lost = oldest_whole.saturating_sub(from).min(copy.len() as u64);
        copy.drain(..lost as usize);
        (from + lost, copy)
    }
}

/// Whether the lap of sample `i` is even or odd.
fn lap(i: u64, slots: u64) -> usize {
    (i / slots % 2) as usize
}

fn encode(quality: Quality) -> u8 {
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

fn decode(code: u8) -> Quality {
    match code {
        0 => Quality::Good,
        1 => Quality::Stale,
        2 => Quality::Bad(BadReason::DeviceException),
        3 => Quality::Bad(BadReason::Timeout),
        4 => Quality::Bad(BadReason::LinkDown),
        5 => Quality::Bad(BadReason::OutOfRange),
        _ => Quality::Bad(BadReason::NotANumber),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keeps_the_last_samples_in_order_of_arrival() {
        let ring = Ring::new(3);
        assert_eq!(ring.snapshot(), vec![]);
        assert_eq!(ring.latest(), None);
        for t in [1.0, 5.0, 5.0, 4.0] {
            ring.push(Sample::good(t, 10.0 * t));
        }
        let kept: Vec<f64> = ring.snapshot().iter().map(|s| s.t).collect();
        assert_eq!(kept, vec![5.0, 5.0, 4.0]);
        assert_eq!(ring.latest(), Some(Sample::good(4.0, 40.0)));
        assert_eq!(ring.pushed(), 4);
    }

    #[test]
    fn a_reader_that_goes_on_misses_nothing_or_knows_what_it_missed() {
        let ring = Ring::new(4);
        let at = |i: u32| Sample::good(f64::from(i), 0.0);
        assert_eq!(ring.since(0, 10), (0, vec![]));
        (0..3).for_each(|i| ring.push(at(i)));
        assert_eq!(ring.since(0, 2), (0, vec![at(0), at(1)]));
        assert_eq!(ring.since(2, 10), (2, vec![at(2)]));
        assert_eq!(ring.since(3, 10), (3, vec![]));
        (3..9).for_each(|i| ring.push(at(i)));
        assert_eq!(ring.since(3, 10), (5, vec![at(5), at(6), at(7), at(8)]), "3 and 4 were overwritten");
        assert_eq!(ring.since(100, 10), (9, vec![]));
    }

    #[test]
    fn every_quality_and_bit_pattern_comes_back() {
        for quality in Quality::ALL {
            let ring = Ring::new(1);
            ring.push(Sample { t: -0.0, value: f64::NAN, quality });
            let back = ring.snapshot()[0];
            assert_eq!(back.t.to_bits(), (-0.0f64).to_bits());
            assert!(back.value.is_nan());
            assert_eq!(back.quality, quality);
        }
    }

    /// Stamps of a collector's clock: seconds since 1970 to the nanosecond, with jitter and a gap.
    fn polled(i: u32, period_s: f64) -> f64 {
        let gap = if i > 500 { 86_400.0 } else { 0.0 };
        1_767_225_600.123_456_7 + gap + f64::from(i) * period_s + f64::from(i * 7919 % 1000) * 1e-5
    }

    #[test]
    fn what_a_controller_sends_takes_half_and_never_more_than_at_the_start() {
        for period_s in [0.1, 1.0, 60.0, 3600.0] {
            let ring = Ring::new(300);
            let before = ring.memory_bytes();
            assert!(before == Ring::bytes(300) && before >= 300 * BYTES_PER_SAMPLE);
            let sample = |i: u32| Sample::good(polled(i, period_s), f64::from(0.1f32 * i as f32));
            (0..1000).for_each(|i| ring.push(sample(i)));
            assert_eq!(ring.snapshot(), (700..1000).map(sample).collect::<Vec<_>>());
            // Three blocks may keep stamps whole: the first has no slope yet, one has the gap, one the slope of that.
            let most = before + 3 * size_of::<[AtomicU64; SLOTS]>();
            assert!(ring.memory_bytes() <= most, "{period_s}: {}", ring.memory_bytes() - before);
        }
        assert!(2 * BYTES_PER_SAMPLE <= 8 + 8 + 4 && size_of::<Block>() == 640);
    }

    #[test]
    fn what_does_not_fit_32_bits_is_kept_whole() {
        let odd = [0.1, f64::MAX, f64::MIN_POSITIVE, 1.0 + f64::EPSILON, -0.0, f64::INFINITY, 16_777_217.0];
        let ring = Ring::new(300);
        let sample = |i: u32| {
            let (t, value) = (f64::from(i) * 0.1, odd[i as usize % odd.len()]);
            Sample::good(if i.is_multiple_of(3) { value } else { t }, value)
        };
        (0..1000).for_each(|i| ring.push(sample(i)));
        let bits = |s: &Sample| (s.t.to_bits(), s.value.to_bits(), s.quality);
        let kept: Vec<_> = ring.snapshot().iter().map(bits).collect();
        assert_eq!(kept, (700..1000).map(|i| bits(&sample(i))).collect::<Vec<_>>());
        assert!(ring.memory_bytes() > Ring::bytes(300));
        assert!(ring.memory_bytes() <= Ring::wide_bytes(300) + blocks(300) * size_of::<[AtomicU64; SLOTS]>());
    }

    /// The i-th sample of the hammer: every part is a function of i, so that a mixture shows. One value
    /// in four and most stamps do not fit 32 bits.
    fn made(i: u64) -> Sample {
        let value = if i.is_multiple_of(4) { i as f64 + 0.1 } else { -(i as f64) * 0.5 };
        Sample { t: i as f64 / 3.0, value, quality: Quality::ALL[(i % 7) as usize] }
    }

    /// Which sample of the hammer has this stamp.
    fn number(t: f64) -> u64 {
        (3.0 * t).round() as u64
    }

    #[test]
    fn no_torn_sample_is_ever_seen_under_a_hammering_writer() {
        // A ring without a slot to spare is lapped thousands of times during the copies; a reader preempted between two
        // loads meets every interleaving. Two sizes: one coprime with the 7 qualities, one not.
        for capacity in [SLOTS - 1, 7 * SLOTS - 1] {
            let ring = Ring::new(capacity);
            let done = AtomicBool::new(false);
            let total = 2_000_000u64;
            let seen = std::thread::scope(|threads| {
                let readers: Vec<_> = (0..2)
                    .map(|_| {
                        threads.spawn(|| {
                            let mut seen = 0u64;
                            while !done.load(Ordering::Acquire) {
                                let copy = ring.snapshot();
                                for pair in copy.windows(2) {
                                    let [before, after] = [0, 1].map(|at| number(pair[at].t));
                                    assert_eq!(after, before + 1, "samples left out in the middle");
                                }
                                for sample in &copy {
                                    assert_eq!(*sample, made(number(sample.t)), "torn sample");
                                    seen += 1;
                                }
                            }
                            seen
                        })
                    })
                    .collect();
                (0..total).for_each(|i| ring.push(made(i)));
                done.store(true, Ordering::Release);
                readers.into_iter().map(|r| r.join().expect("a reader failed")).sum::<u64>()
            });
            assert!(seen > 1000, "the readers saw only {seen} samples: the test proved nothing");
            assert_eq!(ring.refused(), 0);
            assert_eq!(ring.snapshot().len(), capacity);
        }
    }

    #[test]
    fn two_writers_never_mix_a_sample() {
        let ring = Ring::new(8);
        let per_writer = 300_000u64;
        std::thread::scope(|threads| {
            for writer in 0..2 {
                let ring = &ring;
                threads.spawn(move || (0..per_writer).for_each(|i| ring.push(made(2 * i + writer))));
            }
            for _ in 0..10_000 {
                ring.snapshot().iter().for_each(|s| assert_eq!(*s, made(number(s.t))));
            }
        });
        assert_eq!(ring.pushed() + ring.refused(), 2 * per_writer, "a sample is stored or counted");
    }
}
