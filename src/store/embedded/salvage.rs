//! What can be read of a database that is damaged: every leaf of its tables that is whole, wherever it hangs, row by row, and
//! the states as far as its trees lead to them. What led to a leaf may be gone: then its table is known by what its rows look
//! like; the order of the columns is that of `schema`.

use super::ledger;
use super::pages::Pages;
use super::second::{self, Kept};
use super::tree::{self, Row as Found, Trees};
use super::{schema, start_and_tag, write};
use crate::signal::Sample;
use crate::store::rows::{Row, TagName, TransitionRow};
use crate::store::{StoreError, StoredTag, codec};
use rusqlite::{Connection, ErrorCode, Transaction, params, params_from_iter, types::Value};
use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

/// What came out of it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(in crate::store) struct Loss {
    /// What was found damaged.
    pub damage: String,
    /// Rows that are back, by table.
    pub rows: Vec<(&'static str, u64)>,
    /// Of what some may be lost, beside states; what is not named here is all there.
    pub lacking: Vec<&'static str>,
    /// Records of states that were acknowledged and are lost, unless the database itself still has every state: then none is.
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
        match self.lacking.as_slice() {
            [] => write!(out, "{}: all are back; ", WORDS.map(|(word, _)| word).join(", "))?,
            some => write!(out, "{}: some may be lost; ", some.join(", "))?,
        }
        match self.states {
            0 => out.write_str("states of alarms, their changes and models: all are back"),
            n => write!(out, "states of alarms, their changes and models: {n} records are lost"),
        }
    }
}

/// What people call what lies in some tables.
const WORDS: [(&str, &[&str]); 3] =
    [("samples", &["journal", "chunks"]), ("trends", &["trends"]), ("runs", &["diagnoses"])];

/// Tables whose rows are counted in the end: what was in the journal is in chunks then.
const COUNTED: [&str; 7] = ["tags", "chunks", "trends", "diagnoses", "transitions", "alarms", "models"];

/// What happened is told in the order it happened, from whichever copy it came.
const IN_ORDER: &str = "CREATE TEMP TABLE happened AS SELECT * FROM transitions ORDER BY at, id;
    UPDATE happened SET id = rowid;
    DELETE FROM transitions;
    INSERT INTO transitions SELECT * FROM happened;
    DROP TABLE happened;";

/// Reads all that can be read into a database of its own: one in memory and on disk as there is room, gone when it is closed,
/// or at a path. Pages are read one at a time: memory does not grow with the store.
pub(super) fn salvage(folder: &Path, to: Option<&Path>) -> Result<(Connection, Loss), StoreError> {
    let found = match to {
        // Who makes a new one has the lock: nobody else is at work.
        Some(_) => ledger::examine(folder, u32::MAX)?,
        None => ledger::examine_beside(folder)?,
    };
    let why = ledger::marked(folder).filter(|_| found.faults.is_empty());
    let mut loss = Loss { damage: why.unwrap_or_else(|| found.told()), ..Loss::default() };
    let pages = Pages::of(folder, &found)?;
    let mut db = match to {
        Some(path) => write::fresh(path)?,
        None => Connection::open("")?,
    };
    schema::migrate(&mut db)?;
    let taking = db.transaction()?;
    for page in pages.numbers() {
        tree::rows(&pages, page, |Found { key, values, good, .. }| {
            // Of a page that is not what was written only what has a checksum of its own is believed.
            let believed = |table: &usize| good || SEALED.contains(&TABLES[*table].0);
            if let Some(table) = table_of(&values).filter(believed)
                && !take(&taking, table, key, values)?
            {
                loss.blobs += 1;
            }
            Ok::<_, StoreError>(())
        })?;
    }
    let (kept, lost) = second::read(folder)?;
    restore(&taking, &kept)?;
    let trees = Trees::of(&pages);
    let all_states = put_states(&taking, &trees, &kept, found.log)?;
    loss.states = if all_states && !found.log { 0 } else { lost };
    let is_whole = |tables: &[&str]| !found.log && tables.iter().all(|name| trees.is_whole(name));
    let lacks = |(_, tables): &(&str, &[&str])| {
        !is_whole(tables) || loss.blobs > 0 && tables.iter().any(|name| SEALED.contains(name))
    };
    loss.lacking = WORDS.iter().filter(|own| lacks(own)).map(|(word, _)| *word).collect();
    taking.execute_batch(IN_ORDER)?;
    taking.commit()?;
    for name in COUNTED {
        let count = db.query_row(&format!("SELECT count(*) FROM {name}"), [], |row| row.get::<_, i64>(0))?;
        loss.rows.push((name, count.max(0) as u64));
    }
    Ok((db, loss))
}

/// Puts the states over those of the second copy as the database has them: the copy may be an old one, or cut. Where the log
/// lacks something the database may be the older of the two. Whether everything is there that is in the second copy.
fn put_states(
    into: &Transaction<'_>,
    trees: &Trees<'_>,
    kept: &Kept,
    log_lacks: bool,
) -> Result<bool, StoreError> {
    let changes = trees.newest("transitions");
    let newest = changes.rows.first();
    let copy_is_newer =
        log_lacks && newest.is_none_or(|(_, row)| kept.changes.iter().any(|change| is(change, row)));
    let [alarms, models, known_alarms, known_models] =
        ["alarms", "models", "known_alarms", "known_models"].map(|name| trees.table(name));
    let all = alarms.whole && models.whole && known_alarms.whole && known_models.whole;
    let mut to_known = ["models", "alarms"];
    if all && !copy_is_newer {
        // The second copy does not tell apart what waits to be delivered and what is known elsewhere.
        into.execute_batch("DELETE FROM alarms; DELETE FROM models;")?;
        to_known = ["known_models", "known_alarms"];
    }
    let over = if copy_is_newer { "IGNORE" } else { "REPLACE" };
    let mut fit = put(into, over, "models", 4, models.rows)?;
    fit &= put(into, over, "alarms", 19, alarms.rows)?;
    fit &= put(into, "IGNORE", to_known[0], 4, known_models.rows)?;
    fit &= put(into, "IGNORE", to_known[1], 19, known_alarms.rows)?;
    Ok(fit && all && changes.whole && trees.is_whole("tags"))
}

/// Puts rows of so many columns into a table; false where one does not fit.
fn put(
    into: &Transaction<'_>,
    over: &str,
    table: &str,
    columns: usize,
    rows: Vec<(i64, Vec<Value>)>,
) -> Result<bool, StoreError> {
    let sql = format!("INSERT OR {over} INTO {table} VALUES ({})", places(columns));
    let mut fit = true;
    for (_, row) in rows {
        if row.len() != columns {
            fit = false;
            continue;
        }
        match into.prepare_cached(&sql)?.execute(params_from_iter(row)) {
            Err(error) if error.sqlite_error_code() == Some(ErrorCode::ConstraintViolation) => fit = false,
            Err(error) => return Err(error.into()),
            Ok(_) => {}
        }
    }
    Ok(fit)
}

/// Whether a row is this change.
fn is(change: &TransitionRow, row: &[Value]) -> bool {
    let text = |at: usize, own: &str| matches!(row.get(at), Some(Value::Text(text)) if text == own);
    let at = match row.get(3) {
        Some(Value::Real(at)) => *at,
        Some(Value::Integer(at)) => *at as f64,
        _ => f64::NAN,
    };
    let TransitionRow { control_loop, kind, before, after, cause, .. } = change;
    let texts = [(1, control_loop), (2, kind), (4, before), (5, after), (6, cause)];
    at == change.at && texts.into_iter().all(|(at, own)| text(at, own))
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

fn places(columns: usize) -> String {
    (1..=columns).map(|n| format!("?{n}")).collect::<Vec<_>>().join(", ")
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
            let sql = format!("INSERT OR IGNORE INTO {name} VALUES ({})", places(columns.len()));
            into.prepare_cached(&sql)?.execute(params_from_iter(row))?;
        }
    }
    Ok(true)
}
