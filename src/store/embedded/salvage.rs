//! What can be read of a database that is damaged: every leaf of its tables that is whole, wherever it hangs, row by row.
//! What led there may be gone. A table's leaves are known by what their rows look like; the order of the columns is that of
//! `schema`. See the SQLite file format, sections 1.6 and 2.

use super::ledger::{self, Page};
use super::second::{self, Kept};
use super::write::{self, PAGE_BYTES};
use super::{DATABASE, schema, spool, start_and_tag};
use crate::signal::Sample;
use crate::store::rows::{Row, TagName};
use crate::store::{StoreError, StoredTag, codec};
use rusqlite::{Connection, Transaction, params, params_from_iter, types::Value};
use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

const LEAF: u8 = 0x0d;
/// Longest row that is put together (bytes): a blob of the store is far shorter.
const LONGEST: usize = 1 << 24;

/// What came out of it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(in crate::store) struct Loss {
    /// What was found damaged.
    pub damage: String,
    /// Rows that were read, by table.
    pub rows: Vec<(&'static str, u64)>,
    /// Records of states that were acknowledged and are in neither copy.
    pub states: u64,
    /// Blobs that were damaged.
    pub blobs: u64,
}

impl fmt::Display for Loss {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("what can be read:")?;
        for (table, rows) in &self.rows {
            write!(out, " {table} {rows},")?;
        }
        write!(out, " {} blobs damaged; ", self.blobs)?;
        match self.states {
            0 => out.write_str("states of alarms, their changes and models: all are back"),
            n => write!(out, "states of alarms, their changes and models: {n} records are lost"),
        }
    }
}

/// What happened is told in the order it happened, from whichever copy it came.
const IN_ORDER: &str = "CREATE TEMP TABLE happened AS SELECT * FROM transitions ORDER BY at, id;
    UPDATE happened SET id = rowid;
    DELETE FROM transitions;
    INSERT INTO transitions SELECT * FROM happened;
    DROP TABLE happened;";

/// Reads all that can be read into a database of its own: one in memory and on disk as there is room, gone when it is closed,
/// or at a path.
pub(super) fn salvage(folder: &Path, to: Option<&Path>) -> Result<(Connection, Loss), StoreError> {
    let found = match to {
        // Who makes a new one has the lock: nobody else is at work.
        Some(_) => ledger::examine(folder, u32::MAX)?,
        None => ledger::examine_beside(folder)?,
    };
    let why = ledger::marked(folder).filter(|_| found.faults.is_empty());
    let mut loss = Loss { damage: why.unwrap_or_else(|| found.told()), ..Loss::default() };
    let pages = ledger::pages(folder)?;
    let mut db = match to {
        Some(path) => write::fresh(path)?,
        None => Connection::open("")?,
    };
    schema::migrate(&mut db)?;
    let taking = db.transaction()?;
    let mut counts = [0; TABLES.len()];
    for page in 0..pages.len() {
        for (key, row, good) in rows(&pages, page) {
            // Of a page that is not what was written only what has a checksum of its own is believed.
            let believed = |table: &usize| good || SEALED.contains(&TABLES[*table].0);
            if let Some(table) = table_of(&row).filter(believed) {
                match take(&taking, table, key, row)? {
                    true => counts[table] += 1,
                    false => loss.blobs += 1,
                }
            }
        }
    }
    let (kept, lost) = second::read(folder);
    // A damaged second copy costs nothing where the database is whole.
    let is_whole = found.pages.is_empty()
        && found.faults.iter().all(|fault| !fault.contains(DATABASE) && !fault.contains("the log"));
    loss.states = lost;
    restore(&taking, &kept)?;
    if is_whole {
        loss.states = 0;
        // Put over it: the second copy may be an old one.
        whole_tables(folder, &taking)?;
    }
    taking.execute_batch(IN_ORDER)?;
    taking.commit()?;
    loss.rows = TABLES.iter().zip(counts).map(|((name, _), count)| (*name, count)).collect();
    Ok((db, loss))
}

/// What is known elsewhere does not wait to be delivered, though the second copy does not tell the two apart.
const KNOWN_DO_NOT_WAIT: &str = "DELETE FROM alarms WHERE EXISTS (SELECT 1 FROM known_alarms AS own
        WHERE own.control_loop = alarms.control_loop AND own.kind = alarms.kind);
    DELETE FROM models WHERE EXISTS (SELECT 1 FROM known_models AS own
        WHERE own.control_loop = models.control_loop AND own.version >= models.version);";

/// States from the database itself, which SQLite can still read.
fn whole_tables(folder: &Path, into: &Transaction<'_>) -> Result<(), StoreError> {
    let from = super::read::Reader::as_it_is(folder)?;
    let ((models, alarms), (known_models, known_alarms)) = (from.written()?, from.known()?);
    spool::put_known(into, &known_models, &known_alarms)?;
    into.execute_batch(KNOWN_DO_NOT_WAIT)?;
    let rows = models.into_iter().map(Row::Model).chain(alarms.into_iter().map(Row::Alarm));
    for row in rows {
        write::put_row(into, &row)?;
    }
    Ok(())
}

fn restore(into: &Transaction<'_>, kept: &Kept) -> Result<(), StoreError> {
    for tag in &kept.tags {
        let StoredTag { id, name: TagName { control_loop, tag, source, unit }, era } = tag;
        let sql = "INSERT OR IGNORE INTO tags (id, control_loop, tag, source, era, unit) VALUES (?1, ?2, ?3, ?4, ?5, ?6)";
        into.prepare_cached(sql)?.execute(params![id, control_loop, tag, source, era, unit])?;
    }
    let alarms = kept.alarms.iter().cloned().map(Row::Alarm);
    let models = kept.models.iter().cloned().map(Row::Model);
    let changes = kept.changes.iter().cloned().map(Row::Transition);
    alarms.chain(models).chain(changes).try_for_each(|row| write::put_row(into, &row))
}

/// What a column holds, as far as it tells tables apart.
#[derive(Clone, Copy, PartialEq)]
enum Holds {
    Key,
    Text,
    Number,
    Blob,
    Maybe,
}

use Holds::{Blob, Key, Maybe, Number, Text};

/// Tables of rows by number; those by name have no leaves of this kind, and are in the second copy.
const TABLES: [(&str, &[Holds]); 6] = [
    ("tags", &[Key, Text, Text, Text, Number, Text]),
    ("journal", &[Key, Number, Blob]),
    ("chunks", &[Key, Blob]),
    ("trends", &[Key, Blob]),
    (
        "diagnoses",
        &[
            Key, Text, Number, Number, Number, Text, Maybe, Text, Maybe, Maybe, Maybe, Number, Maybe, Text,
            Maybe, Maybe,
        ],
    ),
    ("transitions", &[Key, Text, Text, Number, Text, Text, Text, Maybe, Text, Maybe, Maybe]),
];

/// Tables whose rows have a checksum of their own.
const SEALED: [&str; 3] = ["journal", "chunks", "trends"];

fn table_of(row: &[Value]) -> Option<usize> {
    let fits = |(value, holds): (&Value, &Holds)| match holds {
        Key => *value == Value::Null,
        Text => matches!(value, Value::Text(_)),
        Number => matches!(value, Value::Integer(_) | Value::Real(_)),
        Blob => matches!(value, Value::Blob(_)),
        Maybe => true,
    };
    let least =
        |columns: &[Holds]| columns.len() - columns.iter().rev().take_while(|holds| **holds == Maybe).count();
    let found = TABLES.iter().position(|(_, columns)| {
        (least(columns)..=columns.len()).contains(&row.len()) && row.iter().zip(*columns).all(fits)
    })?;
    // Chunks and trends look alike but for what is in them.
    let is_trend = |blob: &[u8]| codec::decode(blob).is_none() && super::read::decode_points(blob).is_some();
    match (TABLES[found].0, row.get(1)) {
        ("chunks", Some(Value::Blob(blob))) if is_trend(blob) => Some(found + 1),
        _ => Some(found),
    }
}

/// Puts a row into its table; false where its blob is damaged. A page that was left may hold what was there before: rows
/// give way to what is there already, samples are put beside each other.
fn take(into: &Transaction<'_>, table: usize, key: i64, mut row: Vec<Value>) -> Result<bool, StoreError> {
    let (name, columns) = TABLES[table];
    match (name, row.as_slice()) {
        ("chunks", [_, Value::Blob(blob)]) => {
            let Some(samples) = codec::decode(blob) else { return Ok(false) };
            let (start, tag) = start_and_tag(key);
            write::merge(into, start, tag, &samples)?;
        }
        // Numbers of the journal are used again, so a frame goes to where it would have gone.
        ("journal", [_, Value::Integer(start), Value::Blob(frame)]) => {
            let Some(samples) = codec::decode_frame(frame) else { return Ok(false) };
            let mut tags: BTreeMap<u32, Vec<Sample>> = BTreeMap::new();
            samples.into_iter().for_each(|(tag, sample)| tags.entry(tag).or_default().push(sample));
            for (tag, samples) in tags {
                write::merge(into, *start, tag, &samples)?;
            }
        }
        _ => {
            row[0] = Value::Integer(key);
            row.resize(columns.len(), Value::Null);
            let places = (1..=columns.len()).map(|n| format!("?{n}")).collect::<Vec<_>>().join(", ");
            let sql = format!("INSERT OR IGNORE INTO {name} VALUES ({places})");
            into.prepare_cached(&sql)?.execute(params_from_iter(row))?;
        }
    }
    Ok(true)
}

/// The rows of a leaf, with their numbers and whether all they lie on is what was written.
fn rows(pages: &[Option<Page>], at: usize) -> Vec<(i64, Vec<Value>, bool)> {
    let Some(page) = pages[at].as_ref() else { return Vec::new() };
    let (good, page) = (page.good, page.bytes.as_slice());
    let start = if at == 0 { 100 } else { 0 };
    if page.get(start) != Some(&LEAF) {
        return Vec::new();
    }
    let count = usize::from(short(page, start + 3));
    let cells = (0..count).map(|n| usize::from(short(page, start + 8 + 2 * n)));
    let found = cells.filter_map(|cell| row(pages, page, cell));
    found.map(|(key, row, whole)| (key, row, whole && good)).collect()
}

fn short(page: &[u8], at: usize) -> u16 {
    page.get(at..at + 2).and_then(|two| two.try_into().ok()).map_or(0, u16::from_be_bytes)
}

fn row(pages: &[Option<Page>], page: &[u8], cell: usize) -> Option<(i64, Vec<Value>, bool)> {
    let mut at = cell;
    let length = usize::try_from(varint(page, &mut at)?).ok().filter(|length| *length <= LONGEST)?;
    let key = varint(page, &mut at)?;
    let (payload, good) = payload(pages, page, at, length)?;
    values(&payload).map(|values| (key, values, good))
}

/// A row's bytes: some in its leaf, the rest on pages of their own, and whether those are what was written.
fn payload(pages: &[Option<Page>], page: &[u8], at: usize, length: usize) -> Option<(Vec<u8>, bool)> {
    let usable = PAGE_BYTES as usize;
    let (most, least) = (usable - 35, (usable - 12) * 32 / 255 - 23);
    if length <= most {
        return page.get(at..at + length).map(|bytes| (bytes.to_vec(), true));
    }
    let fits = least + (length - least) % (usable - 4);
    let own = if fits <= most { fits } else { least };
    let mut bytes = page.get(at..at + own)?.to_vec();
    let number = |page: &[u8], at: usize| Some(u32::from_be_bytes(page.get(at..at + 4)?.try_into().ok()?));
    let (mut next, mut good) = (number(page, at + own)?, true);
    while bytes.len() < length {
        let over = pages.get((next as usize).checked_sub(1)?)?.as_ref()?;
        good &= over.good;
        let over = over.bytes.as_slice();
        let more = (length - bytes.len()).min(usable - 4);
        bytes.extend_from_slice(over.get(4..4 + more)?);
        next = number(over, 0)?;
    }
    Some((bytes, good))
}

fn varint(bytes: &[u8], at: &mut usize) -> Option<i64> {
    let mut value: u64 = 0;
    for n in 0..9 {
        let byte = *bytes.get(*at)?;
        *at += 1;
        if n == 8 {
            return Some((value << 8 | u64::from(byte)) as i64);
        }
        value = value << 7 | u64::from(byte & 0x7f);
        if byte < 0x80 {
            break;
        }
    }
    Some(value as i64)
}

/// A record's columns.
fn values(record: &[u8]) -> Option<Vec<Value>> {
    let mut at = 0;
    let head = usize::try_from(varint(record, &mut at)?).ok()?;
    let mut body = head;
    let mut values = Vec::new();
    while at < head {
        let kind = varint(record, &mut at)?;
        let length = match kind {
            0 | 8 | 9 => 0,
            1..=4 => kind as usize,
            5 => 6,
            6 | 7 => 8,
            12.. => usize::try_from((kind - 12) / 2).ok()?,
            _ => return None,
        };
        let bytes = record.get(body..body.checked_add(length)?)?;
        body += length;
        let whole = || {
            let sign = if bytes.first().is_some_and(|first| *first >= 0x80) { -1 } else { 0 };
            bytes.iter().fold(sign, |value: i64, byte| value << 8 | i64::from(*byte))
        };
        values.push(match kind {
            0 => Value::Null,
            1..=6 => Value::Integer(whole()),
            7 => Value::Real(f64::from_bits(whole() as u64)),
            8 | 9 => Value::Integer(kind - 8),
            _ if kind % 2 == 0 => Value::Blob(bytes.to_vec()),
            _ => Value::Text(String::from_utf8(bytes.to_vec()).ok()?),
        });
    }
    (body == record.len()).then_some(values)
}
