//! Reads tables a page at a time, by key: an answer is bounded, and what a table holds is not.
//!
//! Rows differ in size: indicators of more days, a longer report. So the database adds up the bytes of the texts, and sends only
//! as many rows as a page holds.

use super::super::StoreError;
use super::client::{Ask, Values};
use std::time::SystemTime;
use tokio_postgres::Row;
use tokio_postgres::types::ToSql;

/// Bytes of a page, unless its first row alone has more: a fifth of the answer that `bounded::POSTGRES` takes.
const PAGE: usize = 4 << 20;
/// Bytes that a row counts beside its texts: the 256 that `bounded::POSTGRES` adds, numbers, and the lengths of the columns.
const ROW: usize = 512;
/// Rows of a page; more never fit.
const ROWS: usize = PAGE / ROW;

/// What is read of a table, in the order of a key of `N` columns. `$1` and so on are the fixed values of its condition, then the
/// key of the last row that was read.
pub(super) struct Table<K, const N: usize> {
    /// Columns that are read.
    columns: &'static str,
    /// The table.
    from: &'static str,
    /// Which of its rows.
    condition: &'static str,
    /// Which rows come after one.
    after: &'static str,
    /// Columns of the key, as in `ORDER BY`.
    order: &'static str,
    /// Columns of text that are read.
    texts: &'static [&'static str],
    /// The key of a row.
    key: fn(&Row) -> [K; N],
}

/// States of alarms.
pub(super) const ALARMS: Table<String, 2> = Table {
    columns: "*",
    from: "alarms",
    condition: "true",
    after: "(control_loop, kind) > ($1, $2)",
    order: "control_loop, kind",
    texts: &["control_loop", "kind", "votes", "raises", "priority", "trend", "detail", "by_whom", "comment"],
    key: |row| [row.get("control_loop"), row.get("kind")],
};

/// The latest version of each model.
pub(super) const MODELS: Table<String, 1> = Table {
    columns: "control_loop, version, since, effects",
    from: "models AS own",
    condition: "NOT EXISTS (SELECT 1 FROM models AS newer WHERE newer.control_loop = own.control_loop
        AND newer.version > own.version)",
    after: "control_loop > $1",
    order: "control_loop",
    texts: &["control_loop", "effects"],
    key: |row| [row.get("control_loop")],
};

/// Tags.
pub(super) const TAGS: Table<i32, 1> = Table {
    columns: "id, control_loop, tag, source, unit, era",
    from: "tags",
    condition: "true",
    after: "id > $1",
    order: "id",
    texts: &["control_loop", "tag", "source", "unit"],
    key: |row| [row.get("id")],
};

/// Numbers of tags.
pub(super) const IDS: Table<i32, 1> = Table { columns: "id", texts: &[], ..TAGS };

/// Runs, with their reports.
pub(super) const DIAGNOSES: Table<i64, 1> = Table {
    columns: "*",
    from: "diagnoses",
    condition: "true",
    after: "id > $1",
    order: "id",
    texts: &["control_loop", "outcome", "reason_code", "reason", "version", "report", "basis"],
    key: |row| [row.get("id")],
};

/// Runs of the loop `$1`, the latest first, without their reports.
pub(super) const SUMMARIES: Table<f64, 1> = Table {
    columns: "control_loop, finished, took_s, on_demand, outcome, reason_code, reason, f, f_low, f_high, f_in_percent,
        delta_aic, version",
    from: "diagnoses",
    condition: "control_loop = $1",
    after: "finished < $2",
    order: "finished DESC",
    texts: &["control_loop", "outcome", "reason_code", "reason", "version"],
    key: |row| [row.get("finished")],
};

/// What happened to alarms.
pub(super) const TRANSITIONS: Table<i64, 1> = Table {
    columns: "*",
    from: "transitions",
    condition: "true",
    after: "id > $1",
    order: "id",
    texts: &["control_loop", "kind", "before", "after", "cause", "priority", "detail", "by_whom", "comment"],
    key: |row| [row.get("id")],
};

/// The same, the latest first.
pub(super) const LAST_TRANSITIONS: Table<i64, 1> =
    Table { after: "id < $1", order: "id DESC", ..TRANSITIONS };

/// Points of the tag `$1` from `$2` on, until before `$3`.
pub(super) const TRENDS: Table<SystemTime, 1> = Table {
    columns: "at, least, mean, most",
    from: "trends",
    condition: "tag = $1 AND at >= $2 AND at < $3",
    after: "at > $4",
    order: "at",
    texts: &[],
    key: |row| [row.get("at")],
};

impl<K: ToSql + Sync, const N: usize> Table<K, N> {
    /// All rows after the one with a key; from the first on, where there is none. At most so many; `values` are the fixed ones.
    ///
    /// # Errors
    /// [`StoreError`] of any of the questions.
    pub fn read<T>(
        &self,
        client: &mut impl Ask,
        values: Values<'_>,
        mut after: Option<[K; N]>,
        most: usize,
        row: impl Fn(&Row) -> T,
    ) -> Result<Vec<T>, StoreError> {
        let mut found = Vec::new();
        while found.len() < most {
            let sql = self.sql(after.is_some(), ROWS.min(most - found.len()));
            let mut all = values.to_vec();
            all.extend(after.iter().flatten().map(|own| own as &(dyn ToSql + Sync)));
            let rows = client.query(&sql, &all)?;
            let Some(last) = rows.last() else { break };
            after = Some((self.key)(last));
            found.extend(rows.iter().map(&row));
        }
        Ok(found)
    }

    /// Asks for one page. Its first row is sent whatever its size: without it what comes after it would never be read.
    fn sql(&self, goes_on: bool, rows: usize) -> String {
        let Self { columns, from, condition, after, order, texts, .. } = self;
        let after = if goes_on { *after } else { "true" };
        let bytes: String = texts.iter().map(|own| format!(" + coalesce(octet_length({own}), 0)")).collect();
        format!(
            "SELECT * FROM (SELECT {columns}, sum({ROW}{bytes}) OVER counted AS page_bytes,
                row_number() OVER counted AS page_row FROM {from} WHERE {condition} AND {after}
                WINDOW counted AS (ORDER BY {order}) ORDER BY {order} LIMIT {rows}) AS sized
             WHERE page_bytes <= {PAGE} OR page_row = 1 ORDER BY {order}"
        )
    }
}
