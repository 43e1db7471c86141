//! The ring of one tag: fixed memory, one writer, any number of readers, nobody waits.
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

use crate::signal::{BadReason, Quality, Sample};
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering, fence};

/// Bytes that one sample takes: stamp, value, quality.
pub const BYTES_PER_SAMPLE: usize = 8 + 8 + 1;

/// Slots of a block.
const SLOTS: usize = 60;

/// Slots in 1 KiB, which an allocator gives whole; one array for a ring, of whatever length it is configured, costs up to a
/// quarter more than it holds.
#[derive(Debug)]
struct Block {
    t: [AtomicU64; SLOTS],
    value: [AtomicU64; SLOTS],
    quality: [AtomicU8; SLOTS],
}

/// Blocks of a ring: one slot is to spare.
fn blocks(capacity: usize) -> usize {
    (capacity.max(1) + 1).div_ceil(SLOTS)
}

impl Block {
    fn new() -> Box<Self> {
        Box::new(Self {
            t: [const { AtomicU64::new(0) }; SLOTS],
            value: [const { AtomicU64::new(0) }; SLOTS],
            quality: [const { AtomicU8::new(0) }; SLOTS],
        })
    }
}

/// The last samples of one tag.
#[derive(Debug)]
pub struct Ring {
    blocks: Box<[Box<Block>]>,
    capacity: usize,
    head: AtomicU64,
    writing: AtomicBool,
    refused: AtomicU64,
}

impl Ring {
    /// A ring that keeps the last `capacity` samples (at least one); its memory is taken, and touched, here.
    pub fn new(capacity: usize) -> Self {
        let capacity = capacity.max(1);
        Self {
            blocks: (0..blocks(capacity)).map(|_| Block::new()).collect(),
            capacity,
            head: AtomicU64::new(0),
            writing: AtomicBool::new(false),
            refused: AtomicU64::new(0),
        }
    }

    /// Bytes that a ring of this capacity holds.
    pub fn bytes(capacity: usize) -> usize {
        blocks(capacity) * (size_of::<Block>() + size_of::<Box<Block>>()) + size_of::<Self>()
    }

    /// Samples kept at most.
    pub fn capacity(&self) -> usize {
        self.capacity
    }

    /// The block of sample `i`, and its place there.
    fn slot(&self, i: u64) -> (&Block, usize) {
        let slot = (i % self.slots()) as usize;
        (&self.blocks[slot / SLOTS], slot % SLOTS)
    }

    fn slots(&self) -> u64 {
        (self.blocks.len() * SLOTS) as u64
    }

    /// Bytes held, whatever was pushed.
    pub fn memory_bytes(&self) -> usize {
        self.blocks.len() * (size_of::<Block>() + size_of::<Box<Block>>()) + size_of::<Self>()
    }

    /// Samples ever pushed.
    pub fn pushed(&self) -> u64 {
        self.head.load(Ordering::Acquire)
    }

    /// Samples refused because another writer was in the middle of a push: not zero only by a wiring fault.
    pub fn refused(&self) -> u64 {
        self.refused.load(Ordering::Relaxed)
    }

    /// Appends a sample over the oldest one. Wait-free.
    pub fn push(&self, sample: Sample) {
        if self.writing.swap(true, Ordering::Acquire) {
            self.refused.fetch_add(1, Ordering::Relaxed);
            return;
        }
        let head = self.head.load(Ordering::Relaxed);
        let (block, slot) = self.slot(head);
        fence(Ordering::Release);
        block.t[slot].store(sample.t.to_bits(), Ordering::Relaxed);
        block.value[slot].store(sample.value.to_bits(), Ordering::Relaxed);
        block.quality[slot].store(encode(sample.quality), Ordering::Relaxed);
        self.head.store(head + 1, Ordering::Release);
        self.writing.store(false, Ordering::Release);
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
        let mut copy: Vec<Sample> = (from..to)
            .map(|i| {
                let (block, slot) = self.slot(i);
                Sample {
                    t: f64::from_bits(block.t[slot].load(Ordering::Relaxed)),
                    value: f64::from_bits(block.value[slot].load(Ordering::Relaxed)),
                    quality: decode(block.quality[slot].load(Ordering::Relaxed)),
                }
            })
            .collect();
        fence(Ordering::Acquire);
        let after = self.head.load(Ordering::Relaxed);
        let oldest_whole = (after + 1).saturating_sub(self.slots());
        let lost = oldest_whole.saturating_sub(from).min(copy.len() as u64);
        copy.drain(..lost as usize);
        (from + lost, copy)
    }
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

    #[test]
    fn memory_is_fixed_at_the_start() {
        let ring = Ring::new(100);
        let before = ring.memory_bytes();
        (0..1000).for_each(|i| ring.push(Sample::good(f64::from(i), 0.0)));
        assert_eq!(ring.memory_bytes(), before);
        assert!(before == Ring::bytes(100) && before >= 100 * BYTES_PER_SAMPLE);
    }

    /// The i-th sample of the hammer: every part is a function of i, so that a mixture shows.
    fn made(i: u64) -> Sample {
        Sample { t: i as f64, value: -(i as f64) * 0.5, quality: Quality::ALL[(i % 7) as usize] }
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
                                    assert_eq!(pair[1].t, pair[0].t + 1.0, "samples left out in the middle");
                                }
                                for sample in &copy {
                                    assert_eq!(*sample, made(sample.t as u64), "torn sample");
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
                ring.snapshot().iter().for_each(|s| assert_eq!(*s, made(s.t as u64)));
            }
        });
        assert_eq!(ring.pushed() + ring.refused(), 2 * per_writer, "a sample is stored or counted");
    }
}
