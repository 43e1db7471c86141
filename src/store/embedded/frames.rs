//! The write-ahead log as it is on disk, read as SQLite reads it: see the SQLite file format, section 4.

use super::DATABASE;
use super::write::PAGE_BYTES;
use std::collections::HashSet;
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Bytes of a frame's head in the log, and of the log's own.
const FRAME_HEAD: usize = 24;
const LOG_HEAD: usize = 32;

/// The database's log.
pub(super) fn log_of(folder: &Path) -> PathBuf {
    folder.join(format!("{DATABASE}-wal"))
}

/// The log as it is on disk.
#[derive(Debug, Default)]
pub(super) struct Log {
    pub salts: [u8; 8],
    /// Frames whose checksums fit, one after the other, up to the last commit.
    pub frames: u32,
    /// Pages in these.
    pub pages: HashSet<u32>,
    /// Pages of the database after the last of them.
    pub size: u32,
}

/// The log's two running sums, as SQLite makes them.
fn running(mut sums: [u32; 2], bytes: &[u8], is_big: bool) -> [u32; 2] {
    let word = |at: &[u8]| {
        let bytes = at.try_into().unwrap_or_default();
        if is_big { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) }
    };
    for pair in bytes.chunks_exact(8) {
        sums[0] = sums[0].wrapping_add(word(&pair[..4])).wrapping_add(sums[1]);
        sums[1] = sums[1].wrapping_add(word(&pair[4..])).wrapping_add(sums[0]);
    }
    sums
}

fn big(bytes: &[u8], at: usize) -> u32 {
    bytes.get(at..at + 4).and_then(|four| four.try_into().ok()).map_or(0, u32::from_be_bytes)
}

/// What a frame holds, by its number from 1 on; `None` where it is of another page by now, because the log was begun anew.
pub(super) fn page_in(log: &File, frame: u32, page: u32, salts: [u8; 8]) -> Option<Vec<u8>> {
    let mut bytes = vec![0; FRAME_HEAD + PAGE_BYTES as usize];
    let at = LOG_HEAD as u64 + u64::from(frame.checked_sub(1)?) * bytes.len() as u64;
    log.read_exact_at(&mut bytes, at).ok()?;
    let is_it = big(&bytes, 0) == page && bytes[8..16] == salts;
    is_it.then(|| bytes.split_off(FRAME_HEAD))
}

impl Log {
    /// Reads the log of a database as SQLite does, up to the first frame that does not fit; an empty one where there is none.
    pub fn read(path: &Path) -> io::Result<Self> {
        Self::frames(path, false, |_, _| ())
    }

    /// The same, or all frames that fit to the one before: its sum is the begin of theirs, whether it was good itself or not.
    /// `each` hears the number of a frame from 1 on, and its page.
    pub fn frames(path: &Path, all: bool, mut each: impl FnMut(u32, u32)) -> io::Result<Self> {
        let file = match File::open(path) {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Self::default()),
            Err(error) => return Err(error),
        };
        let mut head = [0; LOG_HEAD];
        if file.read_exact_at(&mut head, 0).is_err() {
            return Ok(Self::default());
        }
        let is_big = big(&head, 0) & 1 == 1;
        let mut sums = running([0, 0], &head[..24], is_big);
        let is_ours = big(&head, 0) & !1 == 0x377f_0682 && u64::from(big(&head, 8)) == PAGE_BYTES;
        if !is_ours || sums != [big(&head, 24), big(&head, 28)] {
            return Ok(Self::default());
        }
        let mut log = Self { salts: head[16..24].try_into().unwrap_or_default(), ..Self::default() };
        let (mut frame, mut at) = (vec![0; FRAME_HEAD + PAGE_BYTES as usize], LOG_HEAD as u64);
        let (mut frames, mut since) = (0, Vec::new());
        while file.read_exact_at(&mut frame, at).is_ok() && frame[8..16] == log.salts {
            at += frame.len() as u64;
            frames += 1;
            let told = [big(&frame, 16), big(&frame, 20)];
            sums = running(running(sums, &frame[..8], is_big), &frame[FRAME_HEAD..], is_big);
            if sums != told {
                if !all {
                    break;
                }
                sums = told;
                continue;
            }
            each(frames, big(&frame, 0));
            since.push(big(&frame, 0));
            // A frame that ends a commit says how large the database is.
            if big(&frame, 4) > 0 {
                (log.frames, log.size) = (frames, big(&frame, 4));
                log.pages.extend(since.drain(..));
            }
        }
        Ok(log)
    }
}
