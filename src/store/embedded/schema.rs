//! The tables, and how a database of an older version becomes one of this. `PRAGMA user_version` counts the steps taken.

use crate::store::StoreError;
use rusqlite::Connection;

/// Steps, each run once, in order, in a transaction of its own; one that was released is never changed.
const STEPS: [&str; 5] = [
    // 1: the key of samples is `start << 24 | tag`, start the first whole second of the chunk: appended in order of time,
    // which fills the pages.
    "CREATE TABLE tags (
        id INTEGER PRIMARY KEY, control_loop TEXT NOT NULL, tag TEXT NOT NULL, source TEXT NOT NULL,
        era INTEGER NOT NULL, unit TEXT NOT NULL, UNIQUE (control_loop, tag, source, era));
    CREATE TABLE journal (seq INTEGER PRIMARY KEY, start INTEGER NOT NULL, frame BLOB NOT NULL);
    CREATE TABLE chunks (key INTEGER PRIMARY KEY, samples BLOB NOT NULL);
    CREATE TABLE trends (key INTEGER PRIMARY KEY, points BLOB NOT NULL);
    CREATE TABLE diagnoses (
        id INTEGER PRIMARY KEY, control_loop TEXT NOT NULL, finished REAL NOT NULL, took_s REAL NOT NULL,
        on_demand INTEGER NOT NULL, outcome TEXT NOT NULL, reason_code TEXT, reason TEXT NOT NULL,
        f REAL, f_low REAL, f_high REAL, f_in_percent INTEGER NOT NULL, delta_aic REAL,
        version TEXT NOT NULL, report BLOB, UNIQUE (control_loop, finished));
    CREATE TABLE models (
        control_loop TEXT NOT NULL, version INTEGER NOT NULL, since REAL NOT NULL, effects TEXT NOT NULL,
        PRIMARY KEY (control_loop, version)) WITHOUT ROWID;
    CREATE TABLE alarms (
        control_loop TEXT PRIMARY KEY, active INTEGER NOT NULL, acknowledged INTEGER NOT NULL, shelved_until REAL,
        votes TEXT NOT NULL, since REAL, raised_at REAL, by_whom TEXT, comment TEXT) WITHOUT ROWID;
    CREATE TABLE transitions (
        id INTEGER PRIMARY KEY, control_loop TEXT NOT NULL, at REAL NOT NULL, before TEXT NOT NULL,
        after TEXT NOT NULL, cause TEXT NOT NULL, by_whom TEXT, comment TEXT,
        UNIQUE (control_loop, at, before, after, cause));
    CREATE INDEX transitions_at ON transitions (at);
    CREATE INDEX diagnoses_finished ON diagnoses (finished);",
    // 2: what a run worked on, for `replay`.
    "ALTER TABLE diagnoses ADD COLUMN basis BLOB;",
    // 3: alarms of several kinds, of loops and of collectors, and all that is a part of their state.
    "ALTER TABLE alarms RENAME TO alarms_before;
    CREATE TABLE alarms (
        control_loop TEXT NOT NULL, kind TEXT NOT NULL, active INTEGER NOT NULL, acknowledged INTEGER NOT NULL,
        latched INTEGER NOT NULL, shelved_until REAL, one_shot INTEGER NOT NULL, suppressed INTEGER NOT NULL,
        out_of_service INTEGER NOT NULL, votes TEXT NOT NULL, pending REAL, raises TEXT NOT NULL, priority TEXT,
        trend TEXT NOT NULL, since REAL, raised_at REAL, detail TEXT NOT NULL, by_whom TEXT, comment TEXT,
        PRIMARY KEY (control_loop, kind)) WITHOUT ROWID;
    INSERT INTO alarms SELECT control_loop, 'stiction', active, acknowledged, 0, shelved_until, 0, 0, 0, votes, NULL, '',
        NULL, '', since, raised_at, '', by_whom, comment FROM alarms_before;
    DROP TABLE alarms_before;
    ALTER TABLE transitions RENAME TO transitions_before;
    DROP INDEX transitions_at;
    CREATE TABLE transitions (
        id INTEGER PRIMARY KEY, control_loop TEXT NOT NULL, kind TEXT NOT NULL, at REAL NOT NULL, before TEXT NOT NULL,
        after TEXT NOT NULL, cause TEXT NOT NULL, priority TEXT, detail TEXT NOT NULL, by_whom TEXT, comment TEXT,
        UNIQUE (control_loop, kind, at, before, after, cause));
    INSERT INTO transitions SELECT id, control_loop, 'stiction', at, before, after, cause, NULL, '', by_whom, comment
        FROM transitions_before;
    DROP TABLE transitions_before;
    CREATE INDEX transitions_at ON transitions (at);",
    // 4: for a store that waits for another: what its eras count from there.
    "CREATE TABLE spool (one INTEGER PRIMARY KEY CHECK (one = 1), base INTEGER NOT NULL);",
    // 5: the states that the other is known to have, for a start without it.
    "CREATE TABLE known_alarms (
        control_loop TEXT NOT NULL, kind TEXT NOT NULL, active INTEGER NOT NULL, acknowledged INTEGER NOT NULL,
        latched INTEGER NOT NULL, shelved_until REAL, one_shot INTEGER NOT NULL, suppressed INTEGER NOT NULL,
        out_of_service INTEGER NOT NULL, votes TEXT NOT NULL, pending REAL, raises TEXT NOT NULL, priority TEXT,
        trend TEXT NOT NULL, since REAL, raised_at REAL, detail TEXT NOT NULL, by_whom TEXT, comment TEXT,
        PRIMARY KEY (control_loop, kind)) WITHOUT ROWID;
    CREATE TABLE known_models (
        control_loop TEXT PRIMARY KEY, version INTEGER NOT NULL, since REAL NOT NULL, effects TEXT NOT NULL) WITHOUT ROWID;",
];

/// Number of this version's tables.
pub const VERSION: i64 = STEPS.len() as i64;

/// Brings a database to this version.
///
/// # Errors
/// [`StoreError::TooNew`] for a database of a later version; nothing is changed then.
pub fn migrate(db: &mut Connection) -> Result<(), StoreError> {
    let version = version(db)?;
    for (at, step) in STEPS.iter().enumerate().skip(usize::try_from(version).unwrap_or(0)) {
        let step_taken = db.transaction()?;
        step_taken.execute_batch(step)?;
        step_taken.pragma_update(None, "user_version", at as i64 + 1)?;
        step_taken.commit()?;
    }
    Ok(())
}

/// The database's version.
///
/// # Errors
/// [`StoreError::TooNew`].
pub fn version(db: &Connection) -> Result<i64, StoreError> {
    let version: i64 = db.pragma_query_value(None, "user_version", |row| row.get(0))?;
    if (0..=VERSION).contains(&version) { Ok(version) } else { Err(StoreError::TooNew(version)) }
}
