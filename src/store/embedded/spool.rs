//! The store as a spool: what waits for another store is taken out part by part, and goes once it is delivered there.

use super::read::Reader;
use super::room::beyond;
use super::write::{Store, put_alarm, put_row};
use super::{MAX_TAG, key};
use crate::store::backend::{Found, Reads};
use crate::store::{AlarmRow, DiagnosisRow, ModelRow, Row, Series, StoreError, TransitionRow};
use rusqlite::{OptionalExtension, Transaction, TransactionBehavior, params};
use std::collections::HashMap;
use std::sync::Arc;

/// Rows that are delivered in one go.
const ROWS: usize = 500;

/// What waits of states is known to be delivered; of a model the latest version.
const STATES_ARE_THERE: &str = "INSERT OR REPLACE INTO known_alarms SELECT * FROM alarms;
    INSERT OR REPLACE INTO known_models SELECT control_loop, version, since, effects FROM models AS own
        WHERE version = (SELECT max(version) FROM models WHERE control_loop = own.control_loop) AND version >=
            coalesce((SELECT version FROM known_models WHERE control_loop = own.control_loop), 0);
    DELETE FROM models; DELETE FROM alarms;";

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

    /// What its eras count from in the store it waits for; `None` before that was ever reached.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn base(&self) -> Result<Option<i64>, StoreError> {
        Ok(self.db.query_row("SELECT base FROM spool", [], |row| row.get(0)).optional()?)
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

/// Puts states beside those that wait, as known.
fn put_known(into: &Transaction<'_>, models: &[ModelRow], alarms: &[AlarmRow]) -> Result<(), StoreError> {
    for ModelRow { control_loop, version, since, effects } in models {
        let version = i64::try_from(*version).unwrap_or(i64::MAX);
        into.prepare_cached("INSERT OR REPLACE INTO known_models VALUES (?1, ?2, ?3, ?4)")?
            .execute(params![control_loop, version, since, effects])?;
    }
    alarms.iter().try_for_each(|row| put_alarm(into, "known_alarms", row))
}
