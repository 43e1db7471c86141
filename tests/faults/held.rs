//! Memory that a run holds, as the allocator counts it for the whole process: the daemon's and that of the simulated world. What
//! SQLite and zstd allocate in C is not counted.

use peak_alloc::PeakAlloc;
use std::hint::black_box;
use std::sync::{Mutex, MutexGuard, PoisonError};

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

/// Most that a seed may hold at once (bytes).
pub const MOST_HELD: usize = 32 << 20;
/// Most that may be left behind, by one seed or by many (bytes): lists of the test itself, and what libraries keep.
pub const MOST_LEFT: usize = 1 << 20;

/// Tests one after the other, where one process has them all: what is counted is that of the process.
pub fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    // One that failed leaves nothing behind that another needs.
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What is held at a moment (bytes); what is held at most is counted from then on.
pub struct Held(usize);

impl Held {
    pub fn now() -> Self {
        MEMORY.reset_peak_usage();
        Self(MEMORY.current_usage())
    }
}

/// Memory beyond a moment's (bytes).
#[derive(Clone, Copy, Debug)]
pub struct Memory {
    pub most: usize,
    pub left: usize,
}

pub fn since(begin: &Held) -> Memory {
    Memory {
        most: MEMORY.peak_usage().saturating_sub(begin.0),
        left: MEMORY.current_usage().saturating_sub(begin.0),
    }
}

/// Does something, and what it held.
pub fn held<T>(work: impl FnOnce() -> T) -> (T, Memory) {
    let begin = Held::now();
    let done = work();
    (done, since(&begin))
}

/// A count that cannot grow counts nothing.
#[test]
fn what_is_held_and_what_is_left_is_counted() {
    const BYTES: usize = 3 << 20;
    let _alone = alone();
    let (length, memory) = held(|| black_box(vec![1_u8; BYTES]).len());
    assert_eq!(length, BYTES);
    assert!(memory.most >= BYTES && memory.left < BYTES / 2, "{memory:?}");
    let (kept, memory) = held(|| black_box(vec![1_u8; BYTES]));
    assert!(memory.left >= kept.len(), "{memory:?}");
}
