//! The room that a database may take, and a little more for what lets go of some.

use super::write::PAGE_BYTES;
use crate::store::StoreError;
use rusqlite::{Connection, Transaction, TransactionBehavior};

/// Pages beyond the room there is, for states and for trends of what goes: a database that is full must still be able to let go.
const RESERVE: i64 = 1024;

/// Pages that fit into so many MB.
pub(super) fn pages_of(max_mb: u64) -> i64 {
    (max_mb * 1_000_000 / PAGE_BYTES) as i64
}

/// Whether so many bytes are more than a database that is kept within so many MB ever takes.
pub(super) fn is_beyond(bytes: u64, max_mb: u64) -> bool {
    bytes > max_mb * 1_000_000 + 2 * RESERVE as u64 * PAGE_BYTES
}

/// A transaction that has a little more room than there is. Where the database takes far more than it may, because `max_mb` was
/// lowered, it has a little more than that.
pub(super) fn beyond<T>(
    db: &mut Connection,
    max_mb: u64,
    act: impl FnOnce(&Transaction<'_>) -> Result<T, StoreError>,
) -> Result<T, StoreError> {
    let pages = pages_of(max_mb);
    let taken: i64 = db.pragma_query_value(None, "page_count", |row| row.get(0))?;
    let most = if taken > pages + RESERVE { taken } else { pages };
    db.pragma_update(None, "max_page_count", most + RESERVE)?;
    let acted = (|| -> Result<T, StoreError> {
        let acting = db.transaction_with_behavior(TransactionBehavior::Immediate)?;
        let done = act(&acting)?;
        acting.commit()?;
        Ok(done)
    })();
    db.pragma_update(None, "max_page_count", pages)?;
    acted
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_takes_more_than_it_may_still_has_a_reserve_to_let_go_with() {
        let put = |db: &Connection, pages: i64| -> Result<(), StoreError> {
            db.execute("INSERT INTO t VALUES (zeroblob(?1))", [pages * PAGE_BYTES as i64])?;
            Ok(())
        };
        let full = |done: Result<(), StoreError>| done.is_err_and(|error| error.is_full());
        for taken in [100, RESERVE + 200] {
            let mut db = Connection::open_in_memory().expect("opens");
            db.pragma_update(None, "page_size", PAGE_BYTES as i64).expect("set");
            db.execute_batch("CREATE TABLE t (blob)").expect("writes");
            put(&db, taken).expect("there is room");
            db.pragma_update(None, "max_page_count", pages_of(1)).expect("set");
            assert!(full(put(&db, RESERVE / 2)), "more than 1 MB");
            assert!(full(beyond(&mut db, 1, |own| put(own, 2 * RESERVE))), "more than the reserve");
            beyond(&mut db, 1, |own| put(own, RESERVE / 2)).expect("within the reserve");
            assert!(full(put(&db, RESERVE / 2)), "only for that");
        }
    }
}
