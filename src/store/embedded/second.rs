//! A second copy of what nobody could measure again: the states of alarms, what happened to them, the models, and
//! the names of tags. Records
//! are appended, each with a checksum that goes on from the one before; so a record that is missing, changed or cut is
//! known, and everything before it is good.
//!
//! A record: length of the text (u32), its number (u64), CRC-32 over the checksum before, number and text (u32), the text.
//! The text has a letter for the kind, and then its fields, each ended by U+001F.

use super::ledger;
use crate::store::rows::{AlarmRow, ModelRow, Row, TagName, TransitionRow};
use crate::store::{StoreError, StoredTag};
use std::collections::{BTreeMap, HashSet};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

pub(super) const STATES: &str = "states.log";
const NEW: &str = "states.new";
const HEAD: usize = 16;
/// Between two fields; it is no text that anybody types.
const END: char = '\u{1f}';
/// Longest record (bytes): a history of f over time is the longest field.
const LONGEST: usize = 1 << 20;
/// Bytes after which it is written anew with what still counts, unless that alone takes more than half of them.
const LARGE: u64 = 16_000_000;
/// Changes of alarms that are kept when it is written anew.
pub(super) const CHANGES: usize = 20_000;

/// The second copy, open for writing.
#[derive(Debug)]
pub(super) struct Second {
    folder: PathBuf,
    file: File,
    length: u64,
    /// What it took when it was begun: that still counted then (bytes).
    begun: u64,
    /// Records in it, and the checksum of the last.
    records: u64,
    sum: u32,
}

/// What it gives back.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Kept {
    pub alarms: Vec<AlarmRow>,
    pub models: Vec<ModelRow>,
    pub changes: Vec<TransitionRow>,
    pub tags: Vec<StoredTag>,
    /// Records that were good.
    pub records: u64,
    /// Whether nothing follows that is not.
    pub whole: bool,
}

impl Second {
    /// Writes it anew with what the store holds, in place of what there is.
    pub fn begin<'r>(
        folder: &Path,
        tags: &[StoredTag],
        rows: impl Iterator<Item = &'r Row>,
    ) -> Result<Self, StoreError> {
        let path = folder.join(NEW);
        let made = || -> io::Result<(File, u64, u64, u32)> {
            let file = OpenOptions::new().read(true).write(true).create(true).truncate(true).open(&path)?;
            let (mut out, mut records, mut sum) = (io::BufWriter::new(&file), 0, 0);
            let mut length = 0;
            for text in tags.iter().map(text_of).chain(rows.filter_map(text)) {
                let record = record(&text, records, &mut sum);
                out.write_all(&record)?;
                (length, records) = (length + record.len() as u64, records + 1);
            }
            out.flush()?;
            drop(out);
            file.sync_all()?;
            fs::rename(&path, folder.join(STATES))?;
            File::open(folder)?.sync_all()?;
            Ok((file, length, records, sum))
        };
        let (file, length, records, sum) = made().map_err(StoreError::io(&path))?;
        Ok(Self { folder: folder.to_path_buf(), file, length, begun: length, records, sum })
    }

    /// Adds what is a state, or happened to one; durable when this returns. How many records there are then.
    pub fn add<'r>(
        &mut self,
        tags: &[StoredTag],
        rows: impl Iterator<Item = &'r Row>,
    ) -> Result<Option<u64>, StoreError> {
        let (mut bytes, mut records, mut sum) = (Vec::new(), self.records, self.sum);
        for text in tags.iter().map(text_of).chain(rows.filter_map(text)) {
            bytes.extend(record(&text, records, &mut sum));
            records += 1;
        }
        if bytes.is_empty() {
            return Ok(None);
        }
        let added = self.file.write_all_at(&bytes, self.length).and_then(|()| self.file.sync_data());
        added.map_err(StoreError::io(&self.folder.join(STATES)))?;
        (self.length, self.records, self.sum) = (self.length + bytes.len() as u64, records, sum);
        Ok(Some(records))
    }

    /// Records in it.
    pub fn records(&self) -> u64 {
        self.records
    }

    /// Whether it is time to write it anew: as much was added as has to be written for it, so that a plant with more states
    /// than that does not write all of them for each.
    pub fn is_large(&self) -> bool {
        self.length > LARGE.max(2 * self.begun)
    }
}

fn record(text: &str, number: u64, sum: &mut u32) -> Vec<u8> {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&sum.to_le_bytes());
    hasher.update(&number.to_le_bytes());
    hasher.update(text.as_bytes());
    *sum = hasher.finalize();
    let mut bytes = Vec::with_capacity(HEAD + text.len());
    bytes.extend((text.len() as u32).to_le_bytes());
    bytes.extend(number.to_le_bytes());
    bytes.extend(sum.to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes
}

/// Reads what is good of it, and whether that is all that was acknowledged: how many records are missing.
///
/// # Errors
/// [`StoreError::Io`] where a file that is there cannot be opened.
pub(super) fn read(folder: &Path) -> Result<(Kept, u64), StoreError> {
    let kept = decode(&ledger::contents(&folder.join(STATES))?);
    let told = ledger::states_acknowledged(folder)?.unwrap_or(kept.records);
    let lost = told.saturating_sub(kept.records).max(u64::from(!kept.whole));
    Ok((kept, lost))
}

/// What the copy lacks of the records that were acknowledged, in words; `None` where it has all of them. What comes behind them
/// may be torn by a power failure: nobody was told that it is there.
///
/// # Errors
/// [`StoreError::Io`] where a file that is there cannot be opened.
pub(super) fn lacking(folder: &Path) -> Result<Option<String>, StoreError> {
    // A writer adds records before it acknowledges them: so what was acknowledged is read first.
    let told = ledger::states_acknowledged(folder)?.unwrap_or(0);
    let path = folder.join(STATES);
    let lost = told.saturating_sub(good(&ledger::contents(&path)?));
    let what = if path.exists() { "cannot be read" } else { "are gone with the file" };
    let says = || format!("{STATES}, the second copy of the states: {lost} of {told} records {what}");
    Ok((lost > 0).then(says))
}

/// Says in the log what the copy lacks before it is written anew: the disk may be failing.
pub(super) fn tell_lacking(folder: &Path) {
    match lacking(folder) {
        Ok(None) => {}
        Ok(Some(lacking)) => {
            tracing::warn!("{lacking}; no state is lost, it is written anew from the database")
        }
        Err(error) => {
            tracing::warn!(%error, "the second copy of the states cannot be read, and is written anew from the database");
        }
    }
}

/// Records that are good, from the first on.
fn good(bytes: &[u8]) -> u64 {
    let (mut rest, mut count, mut sum) = (bytes, 0, 0);
    while let Some((_, after)) = next(rest, count, &mut sum) {
        (rest, count) = (after, count + 1);
    }
    count
}

fn decode(bytes: &[u8]) -> Kept {
    let mut kept = Kept::default();
    let (mut alarms, mut models) = (BTreeMap::new(), BTreeMap::new());
    let (mut rest, mut sum) = (bytes, 0);
    let mut seen = HashSet::new();
    while let Some((text, after)) = next(rest, kept.records, &mut sum) {
        let mut fields = text.split(END);
        match fields.next() {
            Some("a") => alarm(&mut fields)
                .map(|row| alarms.insert((row.control_loop.clone(), row.kind.clone()), row))
                .map(drop),
            Some("g") => stored(&mut fields).map(|tag| kept.tags.push(tag)),
            Some("m") => model(&mut fields).map(|row| models.insert(row.control_loop.clone(), row)).map(drop),
            _ => change(&mut fields).map(|row| {
                if seen.insert(text.clone()) {
                    kept.changes.push(row);
                }
            }),
        };
        kept.records += 1;
        rest = after;
    }
    (kept.alarms, kept.models) = (alarms.into_values().collect(), models.into_values().collect());
    kept.whole = rest.is_empty();
    kept
}

fn next<'b>(bytes: &'b [u8], number: u64, sum: &mut u32) -> Option<(String, &'b [u8])> {
    let length = u32::from_le_bytes(bytes.get(..4)?.try_into().ok()?) as usize;
    let text = bytes.get(HEAD..HEAD.checked_add(length)?).filter(|_| length <= LONGEST)?;
    let text = std::str::from_utf8(text).ok()?;
    let mut own = *sum;
    let made = record(text, number, &mut own);
    (made == bytes[..HEAD + length]).then(|| {
        *sum = own;
        (text.to_string(), &bytes[HEAD + length..])
    })
}

/// A tag as text: without its name samples are nobody's.
fn text_of(StoredTag { id, name, era }: &StoredTag) -> String {
    let (id, era) = (id.to_string(), era.to_string());
    let fields = ["g", &id, &era, &name.control_loop, &name.tag, &name.source, &name.unit];
    fields.iter().flat_map(|field| field.chars().filter(|c| *c != END).chain([END])).collect()
}

/// A row as text; `None` for what can be said again, or is too long to be a state.
fn text(row: &Row) -> Option<String> {
    let mut out = String::new();
    let mut put = |field: &str| {
        out.extend(field.chars().filter(|c| *c != END));
        out.push(END);
    };
    let number = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
    // A text that is there has a mark before it.
    let maybe = |value: &Option<String>| value.as_ref().map(|value| format!("+{value}")).unwrap_or_default();
    match row {
        Row::Diagnosis(_) => return None,
        Row::Model(row) => {
            let (version, since) = (row.version.to_string(), row.since.to_string());
            ["m", &row.control_loop, &version, &since, &row.effects].into_iter().for_each(put);
        }
        Row::Alarm(row) => {
            put("a");
            put(&row.control_loop);
            put(&row.kind);
            let flags =
                [row.active, row.acknowledged, row.latched, row.one_shot, row.suppressed, row.out_of_service];
            put(&flags.map(|flag| if flag { 'y' } else { 'n' }).iter().collect::<String>());
            [row.shelved_until, row.pending, row.since, row.raised_at]
                .map(number)
                .iter()
                .for_each(|n| put(n));
            [&row.votes, &row.raises, &row.trend, &row.detail].into_iter().for_each(|text| put(text));
            [&row.priority, &row.by, &row.comment].map(maybe).iter().for_each(|text| put(text));
        }
        Row::Transition(row) => {
            put("t");
            put(&row.control_loop);
            put(&row.kind);
            put(&row.at.to_string());
            [&row.before, &row.after, &row.cause, &row.detail].into_iter().for_each(|text| put(text));
            [&row.priority, &row.by, &row.comment].map(maybe).iter().for_each(|text| put(text));
        }
    }
    Some(out).filter(|text| text.len() <= LONGEST)
}

type Fields<'t, 'f> = &'f mut std::str::Split<'t, char>;

fn own(fields: Fields<'_, '_>) -> Option<String> {
    fields.next().map(str::to_string)
}

fn maybe(fields: Fields<'_, '_>) -> Option<Option<String>> {
    fields.next().map(|text| text.strip_prefix('+').map(str::to_string))
}

fn number(fields: Fields<'_, '_>) -> Option<Option<f64>> {
    fields.next().map(|text| text.parse().ok())
}

fn alarm(fields: Fields<'_, '_>) -> Option<AlarmRow> {
    let (control_loop, kind) = (own(fields)?, own(fields)?);
    let flags = own(fields)?;
    let flag = |at: usize| flags.as_bytes().get(at) == Some(&b'y');
    let (shelved_until, pending) = (number(fields)?, number(fields)?);
    let (since, raised_at) = (number(fields)?, number(fields)?);
    let (votes, raises, trend, detail) = (own(fields)?, own(fields)?, own(fields)?, own(fields)?);
    let (priority, by, comment) = (maybe(fields)?, maybe(fields)?, maybe(fields)?);
    Some(AlarmRow {
        active: flag(0),
        acknowledged: flag(1),
        latched: flag(2),
        one_shot: flag(3),
        suppressed: flag(4),
        out_of_service: flag(5),
        control_loop,
        kind,
        shelved_until,
        pending,
        since,
        raised_at,
        votes,
        raises,
        trend,
        detail,
        priority,
        by,
        comment,
    })
}

fn stored(fields: Fields<'_, '_>) -> Option<StoredTag> {
    let (id, era) = (own(fields)?.parse().ok()?, own(fields)?.parse().ok()?);
    let (control_loop, tag, source, unit) = (own(fields)?, own(fields)?, own(fields)?, own(fields)?);
    Some(StoredTag { id, name: TagName { control_loop, tag, source, unit }, era })
}

fn model(fields: Fields<'_, '_>) -> Option<ModelRow> {
    let control_loop = own(fields)?;
    let (version, since) = (own(fields)?.parse().ok()?, number(fields)??);
    Some(ModelRow { control_loop, version, since, effects: own(fields)? })
}

fn change(fields: Fields<'_, '_>) -> Option<TransitionRow> {
    let (control_loop, kind, at) = (own(fields)?, own(fields)?, number(fields)??);
    let (before, after, cause, detail) = (own(fields)?, own(fields)?, own(fields)?, own(fields)?);
    let (priority, by, comment) = (maybe(fields)?, maybe(fields)?, maybe(fields)?);
    Some(TransitionRow { control_loop, kind, at, before, after, cause, detail, priority, by, comment })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::embedded::tests::Folder;
    use proptest::prelude::*;

    fn rows(n: usize) -> Vec<Row> {
        let own = |n: usize| format!("FIC{n}");
        (0..n)
            .map(|n| match n % 3 {
                0 => Row::Alarm(AlarmRow {
                    control_loop: own(n),
                    kind: "stiction".into(),
                    active: n % 2 == 0,
                    shelved_until: Some(n as f64 + 0.1),
                    trend: "1 2 3 4 5\n6 7 8 9 10\n".into(),
                    by: Some(String::new()),
                    ..AlarmRow::default()
                }),
                1 => Row::Transition(TransitionRow {
                    control_loop: own(n),
                    at: n as f64,
                    comment: Some("fitter +called\n".into()),
                    ..TransitionRow::default()
                }),
                _ => Row::Model(ModelRow {
                    control_loop: own(n),
                    version: 3,
                    since: 1e9,
                    effects: "a\tb\n".into(),
                }),
            })
            .collect()
    }

    fn bytes(rows: &[Row]) -> Vec<u8> {
        let mut sum = 0;
        rows.iter()
            .filter_map(text)
            .enumerate()
            .flat_map(|(at, text)| record(&text, at as u64, &mut sum))
            .collect()
    }

    #[test]
    fn what_is_written_comes_back() {
        let (rows, kept) = (rows(30), decode(&bytes(&rows(30))));
        assert!(kept.whole);
        assert_eq!(
            (kept.records, kept.alarms.len(), kept.changes.len(), kept.models.len()),
            (30, 10, 10, 10)
        );
        for row in rows {
            assert!(match &row {
                Row::Alarm(row) => kept.alarms.contains(row),
                Row::Model(row) => kept.models.contains(row),
                Row::Transition(row) => kept.changes.contains(row),
                Row::Diagnosis(_) => false,
            });
        }
    }

    #[test]
    fn it_is_written_anew_when_as_much_was_added_as_it_began_with() {
        let folder = Folder::new();
        fs::create_dir_all(&folder.0).expect("writable");
        let mut second = Second::begin(&folder.0, &[], rows(30).iter()).expect("written");
        assert_eq!((second.begun, second.is_large()), (second.length, false));
        for (begun, length, large) in [
            (1000, LARGE, false),
            (1000, LARGE + 1, true),
            (LARGE + 1, LARGE + 2, false),
            (LARGE + 1, 2 * LARGE + 2, false),
            (LARGE + 1, 2 * LARGE + 3, true),
        ] {
            (second.begun, second.length) = (begun, length);
            assert_eq!(second.is_large(), large, "{length} bytes, {begun} at its begin");
        }
    }

    #[test]
    fn of_two_records_one_is_good_if_the_second_is_cut() {
        let whole = bytes(&rows(2));
        assert_eq!([good(&whole), good(&whole[..whole.len() - 1]), good(&[])], [2, 1, 0]);
    }

    proptest! {
        /// Whatever is cut or flipped: what comes back was written, and that something is missing is known.
        #[test]
        fn damage_is_known(cut in 0usize..2000, flip in prop::option::of((0usize..2000, 0u8..8))) {
            let whole = bytes(&rows(12));
            let mut bytes = whole[..cut.min(whole.len())].to_vec();
            if let Some((at, bit)) = flip.filter(|(at, _)| *at < bytes.len()) {
                bytes[at] ^= 1 << bit;
            }
            let (kept, all) = (decode(&bytes), decode(&whole));
            prop_assert_eq!(kept.records, good(&bytes));
            prop_assert!(kept.alarms.iter().all(|row| all.alarms.contains(row)));
            prop_assert!(kept.changes.iter().all(|row| all.changes.contains(row)));
            prop_assert_eq!(bytes == whole, kept.whole && kept.records == 12);
        }
    }
}
