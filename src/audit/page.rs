//! Reads a log page by page, newest first, without reading all of it: entries are numbered in order, so that the place of
//! one is found by halving.

use super::rotated;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

/// Bytes read at once.
const BLOCK: u64 = 64 * 1024;
/// Longest line that is looked for (bytes); a longer one ends the reading.
const LONGEST: u64 = 1 << 20;

/// One entry, as it was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    /// Number, from 1, through all files.
    pub n: u64,
    /// When, RFC 3339 in UTC.
    pub at: String,
    /// What kind of entry.
    pub event: String,
    /// Keys and values.
    pub fields: Vec<(String, String)>,
    /// SHA-256 of the hash before and of this line.
    pub hash: String,
}

/// Some entries.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Page {
    /// Newest first.
    pub lines: Vec<Line>,
    /// Pass as `before` for the next page; `None` on the last.
    pub next: Option<u64>,
}

/// At most `limit` entries with a number below `before`, newest first, of a log and the rotated files beside it. Entries
/// that begin a file are left out; a last line that is being written is not there yet.
///
/// # Errors
/// When a file cannot be read.
pub fn page(path: &Path, before: Option<u64>, limit: usize) -> io::Result<Page> {
    let mut lines: Vec<Line> = Vec::new();
    let older = (1..).map(|k| rotated(path, k)).take_while(|file| file.exists());
    for file in std::iter::once(path.to_path_buf()).chain(older) {
        let wanted = limit + 1 - lines.len();
        let found = match File::open(&file) {
            Ok(file) => below(file, before, wanted)?,
            Err(error) if error.kind() == io::ErrorKind::NotFound => Vec::new(),
            Err(error) => return Err(error),
        };
        // A rotation between two files shows an entry again.
        let last = lines.last().map(|line| line.n);
        lines.extend(found.into_iter().filter(|line| last.is_none_or(|last| line.n < last)));
        if lines.len() > limit {
            break;
        }
    }
    let more = lines.len() > limit;
    lines.truncate(limit);
    let next = lines.last().map(|line| line.n).filter(|_| more);
    Ok(Page { lines, next })
}

/// The last `wanted` entries of a file below a number, newest first.
fn below(mut file: File, before: Option<u64>, wanted: usize) -> io::Result<Vec<Line>> {
    let size = file.metadata()?.len();
    let mut end = match before {
        Some(before) => first_from(&mut file, size, before)?,
        None => size,
    };
    let (mut found, mut rest) = (Vec::new(), Vec::new());
    while end > 0 && found.len() < wanted && (rest.len() as u64) < LONGEST {
        let start = end.saturating_sub(BLOCK);
        let mut block = read(&mut file, start, (end - start) as usize)?;
        block.append(&mut rest);
        // What stands before the first line break belongs to the block before.
        let whole = match start {
            0 => 0,
            _ => block.iter().position(|&byte| byte == b'\n').map_or(block.len(), |at| at + 1),
        };
        rest = block[..whole].to_vec();
        let text = String::from_utf8_lossy(&block[whole..]);
        let ended = text.rfind('\n').map_or("", |at| &text[..at]);
        found.extend(ended.lines().rev().filter_map(parse).filter(|line| line.event != "file"));
        end = start;
    }
    found.truncate(wanted);
    Ok(found)
}

/// Where the first entry with a number of at least `n` begins; the end when there is none.
fn first_from(file: &mut File, size: u64, n: u64) -> io::Result<u64> {
    let (mut low, mut high) = (0, size);
    while low < high {
        let middle = low + (high - low) / 2;
        match line_after(file, middle, size)? {
            // It begins at or after the middle: the place is before or at it.
            Some((_, number)) if number >= n => high = middle,
            Some((begins, _)) => low = begins + 1,
            None => high = middle,
        }
    }
    Ok(line_after(file, low, size)?.map_or(size, |(begins, _)| begins))
}

/// Where the first line that begins at or after `at` begins, and its number.
fn line_after(file: &mut File, at: u64, size: u64) -> io::Result<Option<(u64, u64)>> {
    let mut begins = at;
    if at > 0 {
        // A line begins behind a line break; the one right before `at` counts.
        let mut from = at - 1;
        loop {
            let block = read(file, from, BLOCK.min(size - from) as usize)?;
            if let Some(found) = block.iter().position(|&byte| byte == b'\n') {
                begins = from + found as u64 + 1;
                break;
            }
            from += block.len() as u64;
            if block.is_empty() || from >= size || from - at > LONGEST {
                return Ok(None);
            }
        }
    }
    let head = read(file, begins, 24.min(size - begins) as usize)?;
    let digits: String =
        head.iter().take_while(|byte| byte.is_ascii_digit()).map(|&b| char::from(b)).collect();
    Ok(digits.parse().ok().map(|number| (begins, number)))
}

fn read(file: &mut File, from: u64, length: usize) -> io::Result<Vec<u8>> {
    file.seek(SeekFrom::Start(from))?;
    let mut bytes = Vec::with_capacity(length);
    file.take(length as u64).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Takes a line apart; `None` for what is none.
fn parse(line: &str) -> Option<Line> {
    let (body, hash) = line.rsplit_once(" #")?;
    let (n, rest) = body.split_once(' ')?;
    let (at, rest) = rest.split_once(' ')?;
    let (event, mut rest) = rest.split_once(' ').unwrap_or((rest, ""));
    let mut fields = Vec::new();
    while !rest.is_empty() {
        let (key, behind) = rest.split_once("=\"")?;
        let (value, after) = unquoted(behind)?;
        fields.push((key.to_string(), value));
        rest = after.strip_prefix(' ').unwrap_or(after);
    }
    let (at, event, hash) = (at.to_string(), event.to_string(), hash.to_string());
    Some(Line { n: n.parse().ok()?, at, event, fields, hash })
}

/// The text up to the closing quote, its escapes undone, and what follows.
fn unquoted(text: &str) -> Option<(String, &str)> {
    let mut value = String::new();
    let mut chars = text.char_indices();
    while let Some((at, c)) = chars.next() {
        match c {
            '"' => return Some((value, &text[at + 1..])),
            '\\' => match chars.next()?.1 {
                'n' => value.push('\n'),
                'r' => value.push('\r'),
                't' => value.push('\t'),
                '0' => value.push('\0'),
                'u' => {
                    let code: String =
                        chars.by_ref().skip(1).map(|(_, c)| c).take_while(|&c| c != '}').collect();
                    value.push(u32::from_str_radix(&code, 16).ok().and_then(char::from_u32)?);
                }
                other => value.push(other),
            },
            other => value.push(other),
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::super::{Bounds, Log};
    use super::*;
    use proptest::prelude::*;
    use std::path::PathBuf;

    fn place(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("stictiond-page-{}-{name}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).expect("a folder");
        folder.join("audit.log")
    }

    fn written(name: &str, entries: u64, bounds: Bounds) -> (PathBuf, Vec<u64>) {
        let path = place(name);
        let mut log = Log::open(&path, bounds, "2026-01-01T00:00:00Z").expect("opened");
        let numbers = (0..entries).map(|k| {
            let padding = "x".repeat((k * 37 % 400) as usize);
            log.append("2026-01-01T00:00:00Z", "change", &[("k", k.to_string()), ("pad", padding)])
                .expect("written");
            log.last().n
        });
        let numbers = numbers.collect();
        log.sync().expect("on disk");
        (path, numbers)
    }

    #[test]
    fn pages_follow_on_each_other_over_all_files_newest_first() {
        let (path, numbers) = written("whole", 900, Bounds { max_bytes: 30_000, keep_files: 50 });
        assert!(rotated(&path, 5).exists(), "several files");
        for limit in [1usize, 7, 100, 5000] {
            let (mut before, mut seen) = (None, Vec::new());
            loop {
                let page = page(&path, before, limit).expect("read");
                assert!(page.lines.len() <= limit);
                seen.extend(page.lines.iter().map(|line| line.n));
                before = page.next;
                if before.is_none() {
                    break;
                }
                if limit == 1 && seen.len() > 40 {
                    break;
                }
            }
            let newest_first: Vec<u64> = numbers.iter().rev().copied().take(seen.len()).collect();
            assert_eq!(seen, newest_first, "{limit}");
            assert!(limit == 1 || seen.len() == 900);
        }
        assert_eq!(page(&path, Some(1), 10).expect("read"), Page::default());
        assert_eq!(page(Path::new("/none/such"), None, 10).expect("nothing"), Page::default());
    }

    #[test]
    fn the_place_of_a_number_is_found_in_one_large_file() {
        let (path, numbers) = written("large", 3000, Bounds { max_bytes: 100_000_000, keep_files: 1 });
        for at in [0, 1, 2, 1499, 2998, 2999] {
            let page = page(&path, Some(numbers[at] + 1), 1).expect("read");
            assert_eq!(page.lines[0].n, numbers[at]);
            assert_eq!(page.lines[0].fields[0], ("k".to_string(), at.to_string()));
        }
    }

    proptest! {
        #[test]
        fn every_value_is_read_as_it_was_written(value in any::<String>(), other in "\\PC*") {
            let body = format!("7 2026-01-01T00:00:00Z change a={value:?} b={other:?} #abc");
            let line = parse(&body).expect("a line");
            prop_assert_eq!(line.n, 7);
            prop_assert_eq!(line.fields, vec![("a".to_string(), value), ("b".to_string(), other)]);
        }
    }
}
