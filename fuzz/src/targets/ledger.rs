//! The files of a store: its journal of states with checksums that are made good, and any of its files with some bytes
//! overwritten.

use super::scratch;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use stictiond::signal::Sample;
use stictiond::store::{
    self, AlarmRow, Batch, Config, ModelRow, Reader, Row, Series, Store, TagName, TransitionRow,
};

const FILES: [&str; 5] = ["store.db", "store.db-wal", "states.log", "store.sum", "store.ack"];
/// When the samples begin (s).
const BEGIN: f64 = 1_790_000_000.0;
/// Most records of one input.
const RECORDS: usize = 64;

/// A store that was killed at work, its files in memory, and the folder in which they are laid out.
struct Killed {
    folder: PathBuf,
    files: Vec<(&'static str, Vec<u8>)>,
}

fn killed() -> &'static Killed {
    static KILLED: OnceLock<Killed> = OnceLock::new();
    KILLED.get_or_init(|| {
        let live = scratch("live");
        let mut store = Store::open(&Config::new(&live)).expect("a new store");
        let name = |tag: &str| TagName {
            control_loop: "FIC1".into(),
            tag: tag.into(),
            source: String::new(),
            unit: "%".into(),
        };
        let tags = [Arc::new(name("op")), Arc::new(name("pv"))];
        for k in 0..5 {
            let t = BEGIN + f64::from(k);
            let of = |tag: &Arc<TagName>| Series { tag: tag.clone(), samples: vec![Sample::good(t, 50.0)] };
            let alarm =
                AlarmRow { control_loop: "FIC1".into(), kind: "stiction".into(), ..AlarmRow::default() };
            let change = TransitionRow {
                control_loop: "FIC1".into(),
                kind: "stiction".into(),
                at: t,
                ..TransitionRow::default()
            };
            let model =
                ModelRow { control_loop: "FIC1".into(), version: 1, since: t, effects: "drift\t\n".into() };
            let rows = vec![Row::Alarm(alarm), Row::Transition(change), Row::Model(model)];
            store.write(&Batch { series: tags.iter().map(of).collect(), rows }).expect("written");
        }
        let read = |name: &'static str| (name, fs::read(live.join(name)).unwrap_or_default());
        Killed { files: FILES.into_iter().map(read).collect(), folder: scratch("killed") }
    })
}

impl Killed {
    /// Lays the store out as it was, but for one file.
    fn with(&self, file: usize, bytes: &[u8]) -> &Path {
        for entry in fs::read_dir(&self.folder).expect("there").flatten() {
            let path = entry.path();
            if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) }.expect("removed");
        }
        for (at, (name, whole)) in self.files.iter().enumerate() {
            let content = if at == file { bytes } else { whole };
            fs::write(self.folder.join(name), content).expect("written");
        }
        &self.folder
    }
}

/// Reads everything, then opens it as the daemon would.
fn all(folder: &Path) {
    let _ = store::check(folder);
    let config = Config::new(folder);
    if let Ok(mut reader) = Reader::looked_at(&config) {
        let _ = (
            reader.alarms(),
            reader.transitions(0, 100),
            reader.model("FIC1"),
            reader.tags(),
            reader.states(),
        );
        if let Ok(Some(start)) = reader.next_start(0) {
            let _ = reader.chunk(start, None);
        }
    }
    if let Ok(mut store) = Store::open(&config) {
        let _ = store.tidy(BEGIN + 10.0);
    }
}

/// Records of the journal, a line feed between them, in a store whose database is gone.
pub fn journal(bytes: &[u8]) {
    let killed = killed();
    let (mut log, mut sum) = (Vec::new(), 0u32);
    for (number, text) in bytes.split(|byte| *byte == b'\n').take(RECORDS).enumerate() {
        // Fields end with U+001F; a bar is easier to think of.
        let text: Vec<u8> = text.iter().map(|byte| if *byte == b'|' { 0x1f } else { *byte }).collect();
        let number = number as u64;
        sum = crc32fast::hash(&[&sum.to_le_bytes()[..], &number.to_le_bytes(), &text].concat());
        log.extend((text.len() as u32).to_le_bytes());
        log.extend(number.to_le_bytes());
        log.extend(sum.to_le_bytes());
        log.extend(text);
    }
    let folder = killed.with(2, &log);
    fs::write(folder.join("store.db"), b"no database").expect("written");
    all(folder);
    let _ = store::repair(&Config::new(folder));
}

/// Which file, where, and what stands there instead; from 128 the file ends there.
pub fn files(bytes: &[u8]) {
    let Some(([file, high, low], over)) = bytes.split_first_chunk::<3>() else { return };
    let killed = killed();
    let which = usize::from(file & 0x7f) % FILES.len();
    let mut content = killed.files[which].1.clone();
    let at = (usize::from(u16::from_be_bytes([*high, *low])) * content.len().max(1)) >> 16;
    let end = (at + over.len()).max(content.len());
    content.resize(end, 0);
    content[at..at + over.len()].copy_from_slice(over);
    if file & 0x80 != 0 {
        content.truncate(at + over.len());
    }
    all(killed.with(which, &content));
}
