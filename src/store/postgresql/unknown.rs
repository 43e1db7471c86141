//! What the database has and nobody here knew: alarms and models of before the spool, or of another daemon. A daemon that began
//! without the database began without them, and what it made since must not take their place.
//!
//! Until the daemon has merged them into what it has, nothing but what happened is delivered. An alarm whose history here
//! begins anew is given the step from where it was left there.

use super::super::backend::Found;
use super::super::rows::{AlarmRow, ModelRow, Row, TransitionRow};
use super::super::{StoreError, embedded};
use super::client::{Ask, Client};
use super::read;
use super::write::text;
use std::collections::{BTreeMap, BTreeSet};

/// Cause of the step from where an alarm was left to where it began without knowing.
const FORGOTTEN: &str = "forgotten";

type Key = (String, String);

/// What is not merged yet.
#[derive(Debug, Default)]
pub(super) struct Unknown {
    found: Found,
    told: bool,
    merged: bool,
    /// Alarms whose first delivered change is looked at.
    begun: BTreeSet<Key>,
}

fn key(row: &AlarmRow) -> Key {
    (row.control_loop.clone(), row.kind.clone())
}

/// The row as the database gives it back.
fn plain(row: &AlarmRow) -> AlarmRow {
    let maybe = |own: &Option<String>| own.as_deref().map(text);
    AlarmRow {
        control_loop: text(&row.control_loop),
        kind: text(&row.kind),
        votes: text(&row.votes),
        raises: text(&row.raises),
        priority: maybe(&row.priority),
        trend: text(&row.trend),
        detail: text(&row.detail),
        by: maybe(&row.by),
        comment: maybe(&row.comment),
        ..row.clone()
    }
}

fn plain_model(row: &ModelRow) -> ModelRow {
    ModelRow { control_loop: text(&row.control_loop), effects: text(&row.effects), ..row.clone() }
}

impl Unknown {
    /// Compares what the database has with what it is known to have and what waits for it. Where the store is `opening` what is
    /// not contradicted by something that waits is simply known: whoever opens reads it. What it is known to have and has no more,
    /// as one that was begun anew or is an older copy, waits for it again.
    pub fn compare(
        &mut self,
        client: &mut Client,
        spool: &mut embedded::Store,
        opening: bool,
    ) -> Result<(), StoreError> {
        let (models, alarms) = read::states(client)?;
        let [waits, known] = spool.states()?;
        let alarm_map = |rows: Vec<AlarmRow>| -> BTreeMap<Key, AlarmRow> {
            rows.iter().map(plain).map(|row| (key(&row), row)).collect()
        };
        // Of the versions that wait the last one stays.
        let model_map = |rows: Vec<ModelRow>| -> BTreeMap<String, ModelRow> {
            rows.iter().map(plain_model).map(|row| (row.control_loop.clone(), row)).collect()
        };
        let (waiting, known_alarms) = (alarm_map(waits.alarms), alarm_map(known.alarms));
        let (waiting_models, known_models) = (model_map(waits.models), model_map(known.models));
        // Merged and not delivered yet: its history may still lack the step from where it was left.
        let differs = |row: &&AlarmRow| waiting.get(&key(row)).is_some_and(|own| own != *row);
        self.begun.extend(alarms.iter().filter(differs).map(key));
        let there: BTreeSet<Key> = alarms.iter().map(key).collect();
        let is_lost = |own: &&AlarmRow| !there.contains(&key(own)) && !waiting.contains_key(&key(own));
        let lost_alarms = known_alarms.values().filter(is_lost).cloned().map(Row::Alarm);
        let there: BTreeSet<&str> = models.iter().map(|row| row.control_loop.as_str()).collect();
        let is_lost = |own: &&ModelRow| {
            let of = own.control_loop.as_str();
            !there.contains(of) && !waiting_models.contains_key(of)
        };
        let lost_models = known_models.values().filter(is_lost).cloned().map(Row::Model);
        let mut lost: Vec<Row> = lost_models.chain(lost_alarms).collect();
        let mut news = Found::default();
        let mut ours = Found::default();
        for row in alarms {
            let own = waiting.get(&key(&row));
            let known = known_alarms.get(&key(&row));
            if known == Some(&row) || own == Some(&row) {
                continue;
            }
            let is_older =
                |known: &&AlarmRow| known.since.zip(row.since).is_some_and(|(own, there)| own > there);
            if let Some(known) = known.filter(is_older) {
                self.begun.insert(key(&row));
                lost.extend(own.is_none().then(|| Row::Alarm(known.clone())));
                continue;
            }
            let simply = opening && own.is_none();
            if simply { &mut ours } else { &mut news }.alarms.push(row);
        }
        for row in models {
            let own = waiting_models.get(&row.control_loop);
            let known = known_models.get(&row.control_loop);
            if known == Some(&row) || own == Some(&row) {
                continue;
            }
            if let Some(known) = known.filter(|known| known.version > row.version) {
                lost.extend(own.is_none().then(|| Row::Model(known.clone())));
                continue;
            }
            let simply = opening && own.is_none();
            if simply { &mut ours } else { &mut news }.models.push(row);
        }
        if !lost.is_empty() {
            let states = lost.len();
            tracing::warn!(states, "the database lacks states that it had: they are delivered once more");
            spool.hold_states(&lost)?;
        }
        spool.know(&ours.models, &ours.alarms)?;
        if !news.alarms.is_empty() || !news.models.is_empty() {
            tracing::info!(
                alarms = news.alarms.len(),
                models = news.models.len(),
                "the database has what this start did not know: it is merged"
            );
        }
        self.begun.extend(news.alarms.iter().map(key));
        (self.found, self.told, self.merged) = (news, false, false);
        Ok(())
    }

    /// Whether states may not be delivered yet.
    pub fn holds(&self) -> bool {
        !self.found.alarms.is_empty() || !self.found.models.is_empty()
    }

    /// What there is to merge, once.
    pub fn tell(&mut self) -> Option<Found> {
        (self.holds() && !std::mem::replace(&mut self.told, true)).then(|| self.found.clone())
    }

    /// It is a part of what waits now, and known: merged once more it would undo what people do from here on.
    pub fn merged(&mut self, spool: &mut embedded::Store) -> Result<(), StoreError> {
        if self.told {
            spool.know(&self.found.models, &self.found.alarms)?;
        }
        self.merged = self.told;
        Ok(())
    }

    /// Everything that happened is delivered: nothing is held any more, once it is merged. True when nothing is.
    pub fn settle(&mut self) -> bool {
        if self.merged {
            self.found = Found::default();
        }
        !self.holds()
    }

    /// Steps that rows of a part need before them, as [`Row`]s; who delivers them calls [`Unknown::bridged`] then.
    pub fn bridges(&self, client: &mut Client, rows: &[Row]) -> Result<Vec<Row>, StoreError> {
        let (mut open, mut bridges) = (self.begun.clone(), Vec::new());
        for row in rows {
            let Row::Transition(row) = row else { continue };
            if open.remove(&(text(&row.control_loop), text(&row.kind))) {
                bridges.extend(bridge(client, row)?.map(Row::Transition));
            }
        }
        Ok(bridges)
    }

    /// Rows are delivered, with what they needed before them.
    pub fn bridged(&mut self, rows: &[Row]) {
        for row in rows {
            if let Row::Transition(row) = row {
                self.begun.remove(&(text(&row.control_loop), text(&row.kind)));
            }
        }
    }
}

/// The step from where an alarm was left to where a change goes on; `None` where that is the same, or the change is there.
fn bridge(client: &mut Client, next: &TransitionRow) -> Result<Option<TransitionRow>, StoreError> {
    let [own, kind, before] = [&next.control_loop, &next.kind, &next.before].map(|own| text(own));
    let left =
        "SELECT after, EXISTS (SELECT 1 FROM transitions WHERE control_loop = $1 AND kind = $2 AND at = $3
            AND before = $4 AND after = $5 AND cause = $6)
        FROM transitions WHERE control_loop = $1 AND kind = $2 ORDER BY id DESC LIMIT 1";
    let rows =
        client.query(left, &[&own, &kind, &next.at, &before, &text(&next.after), &text(&next.cause)])?;
    let Some((left, there)) = rows.first().map(|row| (row.get::<_, String>(0), row.get::<_, bool>(1))) else {
        return Ok(None);
    };
    Ok((left != before && !there).then(|| TransitionRow {
        control_loop: own,
        kind,
        at: next.at,
        before: left,
        after: before,
        cause: FORGOTTEN.to_string(),
        ..TransitionRow::default()
    }))
}
