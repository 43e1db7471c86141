//! The store as a spool: what waits for another store is taken out part by part, and goes once it is delivered there.

use super::read::Reader;
use super::room::{beyond, is_beyond};
use super::write::{PAGE_BYTES, Store, put_alarm, put_row};
use super::{MAX_TAG, key, ledger, schema};
use crate::store::backend::{Found, Reads};
use crate::store::{AlarmRow, DiagnosisRow, ModelRow, Row, Series, StoreError, TransitionRow};
use rusqlite::{Connection, OptionalExtension, Transaction, TransactionBehavior, params};
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// Rows that are delivered in one go.
const ROWS: usize = 500;

/// What waits of states is known to be delivered; of a model the latest version.
const STATES_ARE_THERE: &str = "INSERT OR REPLACE INTO known_alarms SELECT * FROM alarms;
    INSERT OR REPLACE INTO known_models SELECT control_loop, version, since, effects FROM models AS own
        WHERE version = (SELECT max(version) FROM models WHERE control_loop = own.control_loop) AND version >=
            coalesce((SELECT version FROM known_models WHERE control_loop = own.control_loop), 0);
    DELETE FROM models; DELETE FROM alarms;";

/// Version of the tables from which on a spool says what its eras count from.
const HAS_BASE: i64 = 4;

/// Something that waits, whole enough to be delivered in one transaction.
#[derive(Clone, Debug, PartialEq)]
pub enum Part {
    /// Runs, by number.
    Diagnoses(Vec<(i64, DiagnosisRow)>),
    /// What happened to alarms, by number.
    Transitions(Vec<(i64, TransitionRow)>),
    /// Versions of models, and the states of alarms.
    States(Vec<ModelRow>, Vec<AlarmRow>),
    /// All samples of one chunk, each series with its era.
    Samples(i64, Vec<(i64, Series)>),
}

impl Part {
    /// Its rows, as they are written.
    pub fn rows(&self) -> Vec<Row> {
        match self {
            Part::Diagnoses(rows) => rows.iter().map(|(_, row)| Row::Diagnosis(row.clone())).collect(),
            Part::Transitions(rows) => rows.iter().map(|(_, row)| Row::Transition(row.clone())).collect(),
            Part::States(models, alarms) => {
                let models = models.iter().cloned().map(Row::Model);
                models.chain(alarms.iter().cloned().map(Row::Alarm)).collect()
            }
            Part::Samples(..) => Vec::new(),
        }
    }

    /// Whether it is of rows; samples come after them.
    pub fn is_rows(&self) -> bool {
        !matches!(self, Part::Samples(..))
    }
}

impl Store {
    /// What comes next of all that waits: rows in the order they happened, then samples, the oldest first.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn part(&mut self) -> Result<Option<Part>, StoreError> {
        let mut reader = Reader::open(&self.config.folder)?;
        let diagnoses = reader.diagnoses(0, ROWS)?;
        if !diagnoses.is_empty() {
            return Ok(Some(Part::Diagnoses(diagnoses)));
        }
        let transitions = reader.transitions(0, ROWS)?;
        if !transitions.is_empty() {
            return Ok(Some(Part::Transitions(transitions)));
        }
        let (models, alarms) = reader.written()?;
        if !models.is_empty() || !alarms.is_empty() {
            return Ok(Some(Part::States(models, alarms)));
        }
        let Some(start) = reader.next_start(i64::MIN)? else { return Ok(None) };
        let tags: HashMap<u32, _> = reader.tags()?.into_iter().map(|tag| (tag.id, tag)).collect();
        let mut series = Vec::new();
        for (id, samples) in reader.chunk(start, None)? {
            if let Some(tag) = tags.get(&id) {
                series.push((tag.era, Series { tag: Arc::new(tag.name.clone()), samples }));
            }
        }
        // What is delivered is deleted here.
        if reader.damaged() > 0 {
            self.damaged += reader.damaged();
            return Err(StoreError::Damaged(format!("chunk {start}: the bytes are damaged")));
        }
        Ok(Some(Part::Samples(start, series)))
    }

    /// Takes away what was delivered.
    ///
    /// # Errors
    /// [`StoreError`]; then all of it is still there.
    pub fn forget(&mut self, part: &Part) -> Result<(), StoreError> {
        if matches!(part, Part::States(..)) {
            return self.states_are_there();
        }
        let forgetting = self.db.transaction_with_behavior(TransactionBehavior::Immediate)?;
        match part {
            Part::Diagnoses(rows) => {
                for (id, _) in rows {
                    forgetting.prepare_cached("DELETE FROM diagnoses WHERE id = ?1")?.execute([id])?;
                }
            }
            Part::Transitions(rows) => {
                for (id, _) in rows {
                    forgetting.prepare_cached("DELETE FROM transitions WHERE id = ?1")?.execute([id])?;
                }
            }
            Part::States(..) => {}
            Part::Samples(start, _) => {
                let all = [key(*start, 0), key(*start, MAX_TAG)];
                forgetting.execute("DELETE FROM chunks WHERE key BETWEEN ?1 AND ?2", all)?;
                forgetting.execute("DELETE FROM journal WHERE start = ?1", [start])?;
            }
        }
        forgetting.commit()?;
        if let Part::Samples(start, _) = part {
            let gone = self.open.remove(start).unwrap_or_default();
            self.open_samples = self.open_samples.saturating_sub(gone.values().map(Vec::len).sum());
        }
        Ok(())
    }

    /// Has the states among some rows wait: whatever becomes of their delivery, they are here.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn hold_states(&mut self, rows: &[Row]) -> Result<(), StoreError> {
        self.beyond(|own| rows.iter().filter(|row| row.is_state()).try_for_each(|row| put_row(own, row)))?;
        self.keep_twice(&[], rows)
    }

    /// The states that wait are where they belong.
    ///
    /// # Errors
    /// [`StoreError`]; then they still wait.
    pub fn states_are_there(&mut self) -> Result<(), StoreError> {
        // One thread writes, and it is the one that asked for the part: nothing has been added since.
        self.beyond(|own| Ok(own.execute_batch(STATES_ARE_THERE)?))
    }

    /// As [`beyond`]: also a spool that is full of samples holds states, and lets them go.
    fn beyond(
        &mut self,
        act: impl FnOnce(&Transaction<'_>) -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        beyond(&mut self.db, self.config.max_mb, act)
    }

    /// Remembers states as those that the store which this one waits for has.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn know(&mut self, models: &[ModelRow], alarms: &[AlarmRow]) -> Result<(), StoreError> {
        if models.is_empty() && alarms.is_empty() {
            return Ok(());
        }
        self.beyond(|own| put_known(own, models, alarms))?;
        let models = models.iter().cloned().map(Row::Model);
        let rows: Vec<Row> = models.chain(alarms.iter().cloned().map(Row::Alarm)).collect();
        self.keep_twice(&[], &rows)
    }

    /// The models and alarms that wait, and those that the other store is known to have.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn states(&self) -> Result<[Found; 2], StoreError> {
        let reader = Reader::open(&self.config.folder)?;
        Ok([reader.written()?, reader.known()?].map(|(models, alarms)| Found { models, alarms }))
    }

    /// Whether nothing waits.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn is_empty(&self) -> Result<bool, StoreError> {
        let sql = "SELECT EXISTS (SELECT 1 FROM chunks) OR EXISTS (SELECT 1 FROM journal)
            OR EXISTS (SELECT 1 FROM diagnoses) OR EXISTS (SELECT 1 FROM transitions)
            OR EXISTS (SELECT 1 FROM models) OR EXISTS (SELECT 1 FROM alarms)";
        Ok(!self.db.query_row(sql, [], |row| row.get::<_, bool>(0))?)
    }

    /// What its eras count from in the store it waits for; `None` before that was ever reached, and of a store of its own.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn base(&self) -> Result<Option<i64>, StoreError> {
        base_of(&self.db)
    }

    /// It waits for no other store any more: what it collects from now on is its own.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn forget_base(&mut self) -> Result<(), StoreError> {
        if self.base()?.is_some() {
            self.db.execute("DELETE FROM spool", [])?;
        }
        Ok(())
    }

    /// Remembers it.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn set_base(&mut self, base: i64) -> Result<(), StoreError> {
        self.db.execute("INSERT OR REPLACE INTO spool (one, base) VALUES (1, ?1)", params![base])?;
        Ok(())
    }

    /// The era of what comes now.
    pub fn era(&self) -> i64 {
        self.era
    }

    /// Samples that were dropped because there was no room for them.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }
}

fn base_of(db: &Connection) -> Result<Option<i64>, StoreError> {
    Ok(db.query_row("SELECT base FROM spool", [], |row| row.get(0)).optional()?)
}

/// Looks at a folder before it is opened as a spool of at most `spool_mb`: a store of its own may hold what would be deleted there
/// instead of delivered. Trends go nowhere, and of what takes more than a spool may the oldest goes. Where the other store was reached
/// since a daemon last had it as one of its own, it is a spool, whatever it holds. Nothing in the folder is changed.
///
/// # Errors
/// [`StoreError::OwnStore`], and any other of reading it.
pub(in crate::store) fn is_spool(folder: &Path, spool_mb: u64) -> Result<(), StoreError> {
    // Who opens it says that it is damaged, or another program's, or ends making it.
    if ledger::marked(folder).is_some() {
        return Ok(());
    }
    let reader = match Reader::open(folder) {
        Err(StoreError::Missing(_) | StoreError::Foreign(_)) => return Ok(()),
        opened => opened?,
    };
    let db = reader.database();
    let version = schema::version(&db)?;
    if version == 0 {
        return Ok(());
    }
    let trends = db.query_row("SELECT EXISTS (SELECT 1 FROM trends)", [], |row| row.get::<_, bool>(0))?;
    if version >= HAS_BASE && base_of(&db)?.is_some() {
        if trends {
            let folder = folder.display();
            tracing::warn!(
                %folder,
                "the folder of what waits for PostgreSQL has trends of an earlier store: they are not delivered"
            );
        }
        return Ok(());
    }
    let own = |what, remedy| Err(StoreError::OwnStore { folder: folder.to_path_buf(), what, remedy });
    if trends {
        return own("trends".to_string(), "name an empty folder in [store]");
    }
    let number = |name: &str| db.pragma_query_value(None, name, |row| row.get::<_, i64>(0));
    let used = (number("page_count")? - number("freelist_count")?).max(0) as u64 * PAGE_BYTES;
    if is_beyond(used, spool_mb) {
        let what = format!("{} MB, where spool_mb = {spool_mb}", used / 1_000_000);
        return own(what, "name an empty folder in [store], or raise spool_mb");
    }
    Ok(())
}

/// Puts states beside those that wait, as known.
fn put_known(into: &Transaction<'_>, models: &[ModelRow], alarms: &[AlarmRow]) -> Result<(), StoreError> {
    for ModelRow { control_loop, version, since, effects } in models {
        let version = i64::try_from(*version).unwrap_or(i64::MAX);
        into.prepare_cached("INSERT OR REPLACE INTO known_models VALUES (?1, ?2, ?3, ?4)")?
            .execute(params![control_loop, version, since, effects])?;
    }
    alarms.iter().try_for_each(|row| put_alarm(into, "known_alarms", row))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::backend::Writes;
    use crate::store::embedded::DATABASE;
    use crate::store::embedded::second::STATES;
    use crate::store::embedded::tests::{Folder, batch, good, tag};
    use crate::store::{self, Batch, Config, Upkeep};
    use std::fs;
    use std::os::unix::fs::MetadataExt;

    const DAY_S: f64 = 86_400.0;

    /// As the folder is opened once a database is named, which is away.
    fn opened(folder: &Folder, spool_mb: u64) -> Result<store::Store, StoreError> {
        let url = Some("postgres://nobody@127.0.0.1:1/none".to_string());
        store::Store::open(&Config { url, spool_mb, ..folder.config() })
    }

    fn refused(folder: &Folder, spool_mb: u64) -> String {
        match opened(folder, spool_mb) {
            Err(error @ StoreError::OwnStore { .. }) => error.to_string(),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_store_of_its_own_that_would_not_be_delivered_whole_is_no_spool() {
        let folder = Folder::new();
        let upkeep = Upkeep { pace: None, ..Upkeep::default() };
        let plain = Config { samples_days: 1.0, upkeep, ..folder.config() };
        let mut own = Store::open(&plain).expect("opens");
        own.write(&batch(&tag("A", "op"), good(0..600))).expect("writes");
        drop(own);
        // All of it fits, and so waits.
        let spool = opened(&folder, 16).expect("opens").spool().expect("there is one");
        assert!(spool.waits && spool.dropped == 0, "{spool:?}");

        let mut own = Store::open(&plain).expect("opens");
        while own.tidy(3.0 * DAY_S).expect("tidies") {}
        drop(own);
        let points = || store::check(&folder.0).expect("can be read").points;
        // Whoever opens it makes the second copy of the states anew.
        let copy = || fs::metadata(folder.0.join(STATES)).expect("there").ino();
        let before = (points(), copy());
        let told = refused(&folder, 16);
        assert!(before.0 > 0 && told.contains("with trends: "), "{before:?}: {told}");
        assert!(told.contains("name an empty folder in [store], see"), "{told}");
        assert_eq!((points(), copy()), before, "nothing is changed");
        // As an older version left them in the folder of a spool.
        Store::open(&plain).and_then(|mut own| own.set_base(0)).expect("writes");
        assert!(opened(&folder, 16).expect("it is a spool").spool().is_some());
        assert_eq!(points(), before.0);
    }

    /// Its database was reached once, then it was a store of its own again.
    #[test]
    fn a_spool_that_became_a_store_of_its_own_is_none_any_more() {
        let folder = Folder::new();
        let report = Some(vec![7; 20_000_000]);
        let run = DiagnosisRow { control_loop: "A".into(), report, ..DiagnosisRow::default() };
        Store::open(&folder.config()).and_then(|mut own| own.set_base(0)).expect("writes");
        // A tool leaves it what it is, as `store import` does.
        drop(store::Store::open(&folder.config()).expect("opens"));
        let base = Store::open(&folder.config()).and_then(|own| own.base());
        assert_eq!(base.expect("can be read"), Some(0));
        let mut own = (store::Driven::default().open)(&folder.config(), true).expect("opens");
        own.write(&Batch { series: Vec::new(), rows: vec![Row::Diagnosis(run)] }).expect("writes");
        drop(own);
        assert!(refused(&folder, 1).contains("20 MB"));
        assert!(opened(&folder, 16).is_ok(), "there is room for it");
    }

    #[test]
    fn a_folder_whose_store_was_never_finished_is_no_store_of_its_own() {
        let folder = Folder::new();
        fs::create_dir_all(&folder.0).expect("writable");
        fs::write(folder.0.join(DATABASE), "").expect("writable");
        assert!(opened(&folder, 16).is_ok());
    }

    #[test]
    fn a_store_of_its_own_that_takes_more_than_waits_is_no_spool() {
        let folder = Folder::new();
        let report = Some(vec![7; 20_000_000]);
        let run = DiagnosisRow { control_loop: "A".into(), report, ..DiagnosisRow::default() };
        let rows = vec![Row::Diagnosis(run)];
        let mut own = Store::open(&folder.config()).expect("opens");
        own.write(&Batch { series: Vec::new(), rows }).expect("writes");
        drop(own);
        let told = refused(&folder, 1);
        assert!(told.contains("with 20 MB, where spool_mb = 1:"), "{told}");
        assert!(told.contains("or raise spool_mb"), "{told}");
        assert!(opened(&folder, 16).is_ok(), "there is room for it");
        // One that has reached its database is a spool, and has an end.
        Store::open(&folder.config()).and_then(|mut own| own.set_base(0)).expect("writes");
        assert!(opened(&folder, 1).is_ok());
    }
}
