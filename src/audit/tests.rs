use super::*;
use std::sync::atomic::{AtomicUsize, Ordering};

const NOW: &str = "2026-11-21T06:00:00Z";
const WIDE: Bounds = Bounds { max_bytes: 1 << 20, keep_files: 3 };

/// A folder of its own for each test, gone afterwards.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Self {
        static NEXT: AtomicUsize = AtomicUsize::new(0);
        let name = format!("stictiond-audit-{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
        let path = std::env::temp_dir().join(name);
        fs::create_dir_all(&path).expect("the temporary folder is writable");
        Self(path)
    }

    fn log(&self) -> PathBuf {
        self.0.join("audit.log")
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn write(path: &Path, bounds: Bounds, entries: usize) {
    let mut log = Log::open(path, bounds, NOW).expect("opens");
    for k in 0..entries {
        let fields = [("loop", "FIC101".to_string()), ("by", format!("Ann \"{k}\"\n"))];
        log.append(NOW, "write", &fields).expect("appends");
    }
    log.sync().expect("synchronises");
}

fn broken(path: &Path) -> (usize, String) {
    let broken = verify(path).expect_err("broken");
    (broken.line, broken.what)
}

#[test]
fn a_log_goes_on_where_it_was() {
    let folder = Folder::new();
    write(&folder.log(), WIDE, 3);
    write(&folder.log(), WIDE, 2);
    let verified = verify(&folder.log()).expect("whole");
    assert_eq!((verified.files, verified.entries, verified.first, verified.has_head), (1, 6, 1, true));
    let text = fs::read_to_string(folder.log()).expect("text");
    assert_eq!(text.lines().count(), 6, "a line break in a value ends no line");
    // sha256 of 64 zeros and the first line, by hand with sha256sum.
    let first = "1 2026-11-21T06:00:00Z file previous=\"0000000000000000000000000000000000000000000000000000000000000000\"";
    assert_eq!(text.lines().next(), Some(format!("{first} #{}", hash(GENESIS, first)).as_str()));
    assert_eq!(hash("", "abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

#[test]
fn any_byte_changed_is_found_in_its_line() {
    let folder = Folder::new();
    write(&folder.log(), WIDE, 4);
    let good = fs::read(folder.log()).expect("there");
    let mut line = 1;
    for at in 0..good.len() {
        for flip in [1u8, 0x20, 0x80] {
            let mut bad = good.clone();
            bad[at] ^= flip;
            fs::write(folder.log(), &bad).expect("written");
            let (found, what) = broken(&folder.log());
            // A byte that becomes a line break cuts its line: that is still the line.
            assert_eq!(found, line, "byte {at} of {}: {what}", good.len());
        }
        line += usize::from(good[at] == b'\n');
    }
}

#[test]
fn lines_dropped_swapped_repeated_or_put_in_are_found() {
    let folder = Folder::new();
    write(&folder.log(), WIDE, 6);
    let text = fs::read_to_string(folder.log()).expect("text");
    let lines: Vec<&str> = text.lines().collect();
    let found = |lines: &[&str]| {
        fs::write(folder.log(), lines.iter().map(|line| format!("{line}\n")).collect::<String>())
            .expect("written");
        broken(&folder.log()).0
    };
    for k in 0..lines.len() {
        let mut dropped = lines.clone();
        dropped.remove(k);
        // Without its first line a file begins with another: that is line 1 too.
        assert_eq!(found(&dropped), k + 1, "dropped {k}");
        assert_eq!(found(&lines[..k]), k + 1, "cut off after {k}");
        let mut twice = lines.clone();
        twice.insert(k, lines[k]);
        assert_eq!(found(&twice), k + 2, "repeated {k}");
        for other in k + 1..lines.len() {
            let mut swapped = lines.clone();
            swapped.swap(k, other);
            assert_eq!(found(&swapped), k + 1, "swapped {k} and {other}");
        }
    }
    let mut forged = lines.clone();
    let line = format!("4 {NOW} write loop=\"FIC101\" #{}", hash("", "anything"));
    forged[3] = &line;
    assert_eq!(found(&forged), 4);
}

/// A chain computed anew by somebody who has no access to the head.
#[test]
fn a_chain_computed_anew_meets_the_head() {
    let (folder, forged) = (Folder::new(), Folder::new());
    write(&folder.log(), WIDE, 3);
    let mut log = Log::open(&forged.log(), WIDE, NOW).expect("opens");
    (0..3).for_each(|_| log.append(NOW, "write", &[]).expect("appends"));
    fs::copy(forged.log(), folder.log()).expect("copied");
    assert_eq!(broken(&folder.log()).0, 4);
}

/// As a program does that rotates logs, or somebody who tidies up.
#[test]
fn a_log_that_is_moved_deleted_or_cut_while_it_is_written_takes_no_entries() {
    let cut = |log: &Path| fs::write(log, "").expect("writable");
    let moved = |log: &Path| fs::rename(log, with_suffix(log, ".old")).expect("writable");
    let replaced = |log: &Path| {
        moved(log);
        fs::copy(with_suffix(log, ".old"), log).expect("writable");
    };
    let deleted = |log: &Path| fs::remove_file(log).expect("there");
    let gone = "something else has moved";
    type Way<'a> = &'a dyn Fn(&Path);
    let ways: [(Way<'_>, &str); 4] =
        [(&cut, "bytes where"), (&moved, gone), (&replaced, gone), (&deleted, gone)];
    for (way, says) in ways {
        let folder = Folder::new();
        let mut log = Log::open(&folder.log(), WIDE, NOW).expect("opens");
        let mut put = || log.append(NOW, "write", &[]).and_then(|()| log.sync());
        put().expect("it is there");
        way(&folder.log());
        let error = put().expect_err("it is not there").to_string();
        assert!(error.contains("audit.log: ") && error.contains(says), "{error}");
    }
}

/// As a disk does that is full.
#[test]
fn of_a_line_that_was_written_in_part_both_lengths_are_told() {
    let folder = Folder::new();
    let mut log = Log::open(&folder.log(), WIDE, NOW).expect("opens");
    let whole = fs::metadata(folder.log()).expect("there").len();
    let mut part = OpenOptions::new().append(true).open(folder.log()).expect("opens");
    part.write_all(b"2 2026").expect("writable");
    let error = log.sync().expect_err("it is not whole").to_string();
    assert!(error.contains(&format!("it has {} bytes where {whole} were written", whole + 6)), "{error}");
    drop(log);
    // What the text says of a restart.
    let log = Log::open(&folder.log(), WIDE, NOW).expect("opens");
    assert_eq!(log.last().n, 2, "the entry of the bytes that were taken out");
}

/// As a file system over a network does after its server was started anew: the same file has another number.
#[test]
fn a_log_that_only_has_another_number_goes_on() {
    let folder = Folder::new();
    let mut log = Log::open(&folder.log(), WIDE, NOW).expect("opens");
    log.append(NOW, "write", &[]).expect("appends");
    let other = folder.0.join("other");
    fs::copy(folder.log(), &other).expect("copied");
    fs::rename(&other, folder.log()).expect("writable");
    log.sync().expect("it is there");
}

#[test]
fn rotation_is_bounded_and_keeps_the_chain() {
    let folder = Folder::new();
    let bounds = Bounds { max_bytes: 1000, keep_files: 2 };
    write(&folder.log(), bounds, 100);
    write(&folder.log(), bounds, 30);
    let verified = verify(&folder.log()).expect("whole");
    assert_eq!(verified.files, 3);
    assert!(verified.first > 1 && verified.last.n > 130);
    assert!(!rotated(&folder.log(), 3).exists());
    for k in 1..=2 {
        // One line beyond the bound, none longer than 200 bytes.
        assert!(fs::metadata(rotated(&folder.log(), k)).expect("there").len() <= 1200);
    }
    // A file between two others is gone, or another's.
    fs::rename(rotated(&folder.log(), 2), rotated(&folder.log(), 1)).expect("renamed");
    assert_eq!(broken(&folder.log()), (1, "it does not follow the last line of the file before".into()));
}

#[test]
fn a_crash_in_the_middle_costs_nothing_acknowledged() {
    let folder = Folder::new();
    write(&folder.log(), WIDE, 3);
    let mut file = OpenOptions::new().append(true).open(folder.log()).expect("there");
    file.write_all(b"5 2026-11-21T06:0").expect("written");
    write(&folder.log(), WIDE, 1);
    verify(&folder.log()).expect("whole again");
    let text = fs::read_to_string(folder.log()).expect("text");
    assert!(text.contains("recovered torn_bytes=\"17\""), "{text}");
    // Between the renaming and the first line of the new file.
    fs::rename(folder.log(), rotated(&folder.log(), 1)).expect("renamed");
    write(&folder.log(), WIDE, 1);
    assert_eq!(verify(&folder.log()).expect("whole").files, 2);
    // In the middle of that first line, or before it.
    for begun in ["", "7 2026-11"] {
        let before = verify(&folder.log()).expect("whole").files;
        for k in (1..before).rev() {
            fs::rename(rotated(&folder.log(), k), rotated(&folder.log(), k + 1)).expect("renamed");
        }
        fs::rename(folder.log(), rotated(&folder.log(), 1)).expect("renamed");
        fs::write(folder.log(), begun).expect("written");
        write(&folder.log(), WIDE, 1);
        assert_eq!(verify(&folder.log()).expect("whole").files, before + 1);
    }
}

#[test]
fn fewer_files_kept_leave_no_gap_behind() {
    let folder = Folder::new();
    write(&folder.log(), Bounds { max_bytes: 1000, keep_files: 4 }, 100);
    assert!(rotated(&folder.log(), 4).exists());
    write(&folder.log(), Bounds { max_bytes: 1000, keep_files: 2 }, 30);
    assert_eq!(verify(&folder.log()).expect("whole").files, 3);
}

#[test]
fn a_log_has_one_writer() {
    let folder = Folder::new();
    let log = Log::open(&folder.log(), WIDE, NOW).expect("opens");
    let error = Log::open(&folder.log(), WIDE, NOW).expect_err("in use").to_string();
    assert!(error.contains("another process"), "{error}");
    drop(log);
    Log::open(&folder.log(), WIDE, NOW).expect("opens again");
}

/// Every file of a folder, by its name.
fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let entries = fs::read_dir(folder).expect("there").map(|entry| entry.expect("read"));
    let files = entries.filter(|entry| entry.path().is_file());
    let read = |entry: fs::DirEntry| {
        (entry.file_name().to_string_lossy().into_owned(), fs::read(entry.path()).expect("read"))
    };
    let mut files: Vec<_> = files.map(read).collect();
    files.sort();
    files
}

/// A log of several files, one bit of the oldest of which is another.
fn rotten(folder: &Folder) -> PathBuf {
    let bounds = Bounds { max_bytes: 1000, keep_files: 3 };
    write(&folder.log(), bounds, 100);
    let old = rotated(&folder.log(), 3);
    let mut bytes = fs::read(&old).expect("there");
    bytes[200] ^= 1;
    fs::write(&old, bytes).expect("written");
    old
}

#[test]
fn nothing_is_written_behind_a_broken_chain_and_nothing_is_taken_away() {
    let folder = Folder::new();
    write(&folder.log(), WIDE, 3);
    // The line that a crash cut off stays, too: nobody can say what happened to such a log.
    let text = fs::read_to_string(folder.log()).expect("text").replace("FIC101", "FIC102") + "5 2026";
    fs::write(folder.log(), text).expect("written");
    let before = files(&folder.0);
    let error = Log::open(&folder.log(), WIDE, NOW).expect_err("broken").to_string();
    assert!(error.contains("line 2: changed"), "{error}");
    let remedy = format!("`stictiond audit renew {}`", folder.log().display());
    assert!(error.contains(&remedy) && error.contains("rotated files"), "{error}");
    assert_eq!(files(&folder.0), before);
}

#[test]
fn a_log_that_is_gone_is_missed_by_its_head() {
    let folder = Folder::new();
    write(&folder.log(), WIDE, 3);
    let head = fs::read(head_path(&folder.log())).expect("there");
    for left in [None, Some("")] {
        fs::remove_file(folder.log()).expect("there");
        if let Some(left) = left {
            fs::write(folder.log(), left).expect("written");
        }
        let error = Log::open(&folder.log(), WIDE, NOW).expect_err("missing").to_string();
        assert!(error.contains("entries 1 to 4 were written and are no longer there"), "{error}");
        assert_eq!(fs::read(head_path(&folder.log())).expect("there"), head);
        fs::write(folder.log(), "").expect("written");
    }
}

#[test]
fn a_recorder_of_a_damaged_log_holds_it_and_refuses() {
    let folder = Folder::new();
    let old = rotten(&folder);
    let before = files(&folder.0);
    let recorder = Recorder::start(&folder.log(), WIDE, 0.0).expect("it begins all the same");
    let fault = recorder.fault().expect("it does not work");
    assert!(!recorder.works() && fault.is_damaged);
    for part in [old.display().to_string().as_str(), "changed", "stictiond audit renew"] {
        assert!(fault.reason.contains(part), "{part}: {}", fault.reason);
    }
    assert!(!recorder.put(1.0, "change", Vec::new()));
    assert!(recorder.follow(1.0, "change", Vec::new()).blocking_recv().is_err(), "nobody waits in vain");
    let in_use = renew(&folder.log(), NOW).expect_err("in use").to_string();
    assert!(in_use.contains("another process"), "{in_use}");
    assert!(matches!(Recorder::start(&folder.log(), WIDE, 0.0), Err(AuditError::InUse(_))));
    drop(recorder);
    assert_eq!(files(&folder.0), before);
}

#[test]
fn a_damaged_log_is_put_aside_whole_and_the_new_one_says_so() {
    let folder = Folder::new();
    rotten(&folder);
    // Names that are nearly its own.
    for other in ["audit.log.old", "audit.log.1x", "audit.log2", "xaudit.log"] {
        fs::write(folder.0.join(other), other).expect("written");
    }
    // Behind a gap, where nobody looks for it.
    fs::write(rotated(&folder.log(), 7), "old").expect("written");
    let before = files(&folder.0);
    let renewed = renew(&folder.log(), NOW).expect("renewed").expect("it was damaged");
    assert!(renewed.damage.what.contains("changed"), "{}", renewed.damage);
    assert_eq!(renewed.aside, folder.0.join("audit.log.damaged-1"));
    let names = ["audit.log", "audit.log.1", "audit.log.2", "audit.log.3", "audit.log.7", "audit.log.head"];
    let own: Vec<_> = before.into_iter().filter(|(name, _)| names.contains(&name.as_str())).collect();
    assert_eq!(own.len(), names.len());
    assert_eq!(files(&renewed.aside), own);

    let verified = verify(&folder.log()).expect("whole");
    assert_eq!((verified.files, verified.first, verified.last.n, verified.has_head), (1, 1, 2, true));
    let text = fs::read_to_string(folder.log()).expect("text");
    assert!(text.contains(" renewed damage=\"audit log ") && text.contains("audit.log.damaged-1"), "{text}");
    let old = files(&renewed.aside);
    let head = old.iter().find(|(name, _)| name == "audit.log.head").expect("copied");
    let head = String::from_utf8_lossy(&head.1).trim_end().to_string();
    assert!(head.len() == 85 && text.contains(&format!(" head=\"{head}\"")), "{text}");
    let hashes = old.iter().filter(|(name, _)| name != "audit.log.head");
    let hashes: Vec<String> =
        hashes.map(|(name, bytes)| format!("{name}={}", hex(Sha256::digest(bytes).iter()))).collect();
    assert!(text.contains(&format!(" sha256=\"{}\"", hashes.join(" "))), "{text}");
    let left: Vec<String> = files(&folder.0).into_iter().map(|(name, _)| name).collect();
    assert_eq!(
        left,
        ["audit.log", "audit.log.1x", "audit.log.head", "audit.log.old", "audit.log2", "xaudit.log"]
    );

    assert_eq!(renew(&folder.log(), NOW).expect("looked at"), None, "a log that is whole stays");
    write(&folder.log(), WIDE, 2);
    assert_eq!(verify(&folder.log()).expect("whole").last.n, 4);
}

#[test]
fn a_renewal_that_is_broken_off_leaves_a_log_that_is_damaged() {
    let folder = Folder::new();
    rotten(&folder);
    let head = fs::read(head_path(&folder.log())).expect("there");
    let renewed = renew(&folder.log(), NOW).expect("renewed").expect("it was damaged");
    // As before its last step: the lines are there, and the head is still the old one.
    fs::write(head_path(&folder.log()), head).expect("written");
    let error = Log::open(&folder.log(), WIDE, NOW).expect_err("damaged").to_string();
    assert!(error.contains("are no longer there"), "{error}");
    let again = renew(&folder.log(), NOW).expect("renewed").expect("it was damaged");
    assert_ne!(again.aside, renewed.aside);
    verify(&folder.log()).expect("whole");
}

#[test]
fn a_log_that_is_being_renewed_is_damaged_whatever_its_head_was() {
    let folder = Folder::new();
    // As where nothing was ever synchronised and all files are moved: an empty head alone would count as new.
    for old in [String::new(), format!("{:020} {GENESIS}\n", 7)] {
        fs::write(head_path(&folder.log()), &old).expect("written");
        let mut head = open_head(&folder.log()).expect("there");
        renew::mark(&mut head).expect("written");
        drop(head);
        let error = Log::open(&folder.log(), WIDE, NOW).expect_err("damaged").to_string();
        assert!(error.contains("a renewal was broken off"), "{error}");
        let marked = fs::read_to_string(head_path(&folder.log())).expect("there");
        assert_eq!(marked.get(8..), Some(old.get(8..).unwrap_or_default()), "the number is kept");
        renew(&folder.log(), NOW).expect("renewed").expect("it was damaged");
        assert_eq!(verify(&folder.log()).expect("whole").last.n, 2);
        fs::remove_file(folder.log()).expect("there");
    }
}

#[test]
fn no_link_is_followed_in_the_place_of_the_head() {
    let folder = Folder::new();
    rotten(&folder);
    let other = folder.0.join("other");
    fs::write(&other, "of somebody else").expect("written");
    fs::remove_file(head_path(&folder.log())).expect("there");
    std::os::unix::fs::symlink(&other, head_path(&folder.log())).expect("linked");
    let before = files(&folder.0);
    assert!(matches!(renew(&folder.log(), NOW), Err(AuditError::Io { .. })));
    assert!(matches!(Log::open(&folder.log(), WIDE, NOW), Err(AuditError::Io { .. })));
    assert_eq!(files(&folder.0), before);
    // A folder is no file either.
    fs::remove_file(head_path(&folder.log())).expect("there");
    fs::create_dir(head_path(&folder.log())).expect("made");
    assert!(matches!(renew(&folder.log(), NOW), Err(AuditError::Io { .. })));
}
