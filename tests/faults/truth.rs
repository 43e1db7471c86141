//! What the store was given and what it acknowledged, held against what is in it.

use crate::plant::{LOOPS, PERIOD_S, POLL_S};
use std::collections::{BTreeMap, BTreeSet};
use std::hash::{DefaultHasher, Hash, Hasher};
use stictiond::serve::dto::BasisText;
use stictiond::signal::Sample;
use stictiond::store::{
    AlarmRow, Batch, DiagnosisRow, ModelRow, Reader, Row, StoredTag, TagName, TransitionRow, unpack,
};

/// Votes that an alarm looks back on, and how many of them must say stiction, as configured.
const VOTES: (usize, usize) = (3, 2);
/// A run whose newest sample is so much newer than that of the run before is a vote (s): half a period, and a poll for each of the
/// two, because what was read at the very moment of a copy is in it or not, and may be bad.
const SURE_S: f64 = 0.5 * PERIOD_S + 2.0 * POLL_S;

/// A sample by everything that it is.
pub type Key = (TagName, u64, u64, &'static str);

fn key(tag: &TagName, sample: &Sample) -> Key {
    let value = if sample.quality.is_good() { sample.value.to_bits() } else { 0 };
    (tag.clone(), sample.t.to_bits(), value, sample.quality.as_str())
}

fn samples(batch: &Batch) -> impl Iterator<Item = Key> {
    batch.series.iter().flat_map(|own| own.samples.iter().map(|sample| key(&own.tag, sample)))
}

/// What a row of a history is known by.
fn history(row: &Row) -> Option<String> {
    match row {
        Row::Diagnosis(run) => Some(format!("run {} {} {}", run.control_loop, run.finished, run.outcome)),
        Row::Transition(t) => Some(format!(
            "change {} {} {} {}->{} {}",
            t.control_loop, t.kind, t.at, t.before, t.after, t.cause
        )),
        Row::Alarm(_) | Row::Model(_) => None,
    }
}

/// The truth about a store.
#[derive(Debug, Default)]
pub struct Truth {
    /// What was acknowledged, or was found there.
    samples: BTreeSet<Key>,
    rows: Vec<Row>,
    known: BTreeSet<String>,
    alarms: BTreeMap<(String, String), AlarmRow>,
    /// What was acknowledged, or found, as a version of a loop's model: the store keeps the first.
    models: BTreeMap<(String, u64), Vec<ModelRow>>,
    /// What was tried since, and nobody knows whether it is there.
    doubts: Vec<Batch>,
    pub acknowledged: u64,
}

/// What is in a store.
pub struct Content {
    pub samples: Vec<(StoredTag, Vec<Sample>)>,
    runs: Vec<Row>,
    pub changes: Vec<TransitionRow>,
    alarms: Vec<AlarmRow>,
    /// Of each loop the latest version.
    models: Vec<ModelRow>,
}

impl Content {
    pub fn of(reader: &mut Reader) -> Result<Self, String> {
        let read = |error: stictiond::store::StoreError| format!("the store cannot be read: {error}");
        let mut samples: BTreeMap<u32, Vec<Sample>> = BTreeMap::new();
        let mut from = 0;
        while let Some(start) = reader.next_start(from).map_err(read)? {
            for (tag, own) in reader.chunk(start, None).map_err(read)? {
                samples.entry(tag).or_default().extend(own);
            }
            from = start + 1;
        }
        let tags = reader.tags().map_err(read)?;
        let of = |tag: StoredTag| {
            let own = samples.remove(&tag.id).unwrap_or_default();
            (tag, own)
        };
        let samples = tags.into_iter().map(of).collect();
        if reader.damaged() > 0 {
            return Err("blobs of the store are damaged".to_string());
        }
        let runs = reader.diagnoses(0, 100_000).map_err(read)?;
        let changes = reader.transitions(0, 100_000).map_err(read)?;
        let models = LOOPS.iter().map(|id| reader.model(id)).collect::<Result<Vec<_>, _>>().map_err(read)?;
        Ok(Self {
            samples,
            runs: runs.into_iter().map(|(_, row)| Row::Diagnosis(row)).collect(),
            changes: changes.into_iter().map(|(_, row)| row).collect(),
            alarms: reader.alarms().map_err(read)?,
            models: models.into_iter().flatten().collect(),
        })
    }
}

impl Truth {
    /// The store said that it has a batch.
    pub fn acknowledge(&mut self, batch: &Batch) {
        self.acknowledged += batch.samples() as u64 + batch.rows.len() as u64;
        self.samples.extend(samples(batch));
        self.take(&batch.rows);
    }

    /// The store was given a batch and did not say that it has it.
    pub fn doubt(&mut self, batch: &Batch) {
        self.doubts.push(batch.clone());
    }

    fn take(&mut self, rows: &[Row]) {
        for row in rows {
            if history(row).is_none_or(|name| self.known.insert(name)) {
                self.rows.push(row.clone());
            }
            match row {
                Row::Alarm(alarm) => {
                    self.alarms.insert((alarm.control_loop.clone(), alarm.kind.clone()), alarm.clone());
                }
                Row::Model(model) => self.take_model(model),
                Row::Diagnosis(_) | Row::Transition(_) => {}
            }
        }
    }

    fn take_model(&mut self, model: &ModelRow) {
        let known = self.models.entry((model.control_loop.clone(), model.version)).or_default();
        if !known.contains(model) {
            known.push(model.clone());
        }
    }

    /// Whether something that somebody did to an alarm was acknowledged.
    pub fn has_act(&self, by: &str) -> bool {
        self.rows.iter().any(|row| matches!(row, Row::Transition(t) if t.by.as_deref() == Some(by)))
    }

    /// A number for all that is known to be there. Which samples a run worked on is not in it: one of the very moment of its
    /// begin is copied or not, as threads fall.
    pub fn print(&self) -> u64 {
        let mut print = DefaultHasher::new();
        format!("{:?} {:?} {:?} {:?}", self.samples, self.known, self.alarms, self.models).hash(&mut print);
        print.finish()
    }

    /// Samples that are known to be there.
    pub fn samples(&self) -> usize {
        self.samples.len()
    }

    /// Holds what is in the store against what is known of it; then what is there is known.
    pub fn hold_against(&mut self, content: &Content) -> Result<(), String> {
        self.hold_samples(content)?;
        self.hold_history(content)?;
        self.hold_alarms(content)?;
        self.hold_models(content)?;
        self.hold_causes()?;
        self.doubts.clear();
        Ok(())
    }

    fn hold_samples(&mut self, content: &Content) -> Result<(), String> {
        let mut there = BTreeSet::new();
        for (tag, own) in &content.samples {
            for sample in own {
                let key = key(&tag.name, sample);
                if !there.insert(key) {
                    return Err(format!("a sample is there twice: {tag:?} {sample:?}"));
                }
            }
        }
        if let Some(lost) = self.samples.difference(&there).next() {
            let t = f64::from_bits(lost.1);
            return Err(format!("an acknowledged sample is lost: {:?} at {t}, {}", lost.0, lost.3));
        }
        let doubted: BTreeSet<Key> = self.doubts.iter().flat_map(samples).collect();
        if let Some(new) = there.difference(&self.samples).find(|key| !doubted.contains(key)) {
            return Err(format!(
                "a sample is there that nobody wrote: {:?} at {}",
                new.0,
                f64::from_bits(new.1)
            ));
        }
        self.samples = there;
        Ok(())
    }

    fn hold_history(&mut self, content: &Content) -> Result<(), String> {
        let changes = content.changes.iter().cloned().map(Row::Transition);
        let rows: Vec<Row> = content.runs.iter().cloned().chain(changes).collect();
        let mut there = BTreeSet::new();
        for name in rows.iter().filter_map(history) {
            if !there.insert(name.clone()) {
                return Err(format!("a row is there twice: {name}"));
            }
        }
        if let Some(lost) = self.known.difference(&there).next() {
            return Err(format!("an acknowledged row is lost: {lost}"));
        }
        // In the order in which they were tried, which is that in which they happened.
        for batch in std::mem::take(&mut self.doubts) {
            let is_there = |row: &&Row| history(row).is_some_and(|name| there.contains(&name));
            let found: Vec<Row> = batch.rows.iter().filter(is_there).cloned().collect();
            self.take(&found);
            self.doubts.push(batch);
        }
        match there.difference(&self.known).next() {
            Some(new) => Err(format!("a row is there that nobody wrote: {new}")),
            None => Ok(()),
        }
    }

    fn hold_alarms(&mut self, content: &Content) -> Result<(), String> {
        let mut there = BTreeMap::new();
        for row in &content.alarms {
            let name = (row.control_loop.clone(), row.kind.clone());
            let doubted = |batch: &Batch| {
                batch.rows.iter().any(|doubted| matches!(doubted, Row::Alarm(own) if own == row))
            };
            if self.alarms.get(&name) != Some(row) && !self.doubts.iter().any(doubted) {
                return Err(format!("an alarm is not as it was acknowledged: {row:?}"));
            }
            there.insert(name, row.clone());
        }
        if let Some(lost) = self.alarms.keys().find(|name| !there.contains_key(*name)) {
            return Err(format!("an acknowledged state is lost: {lost:?}"));
        }
        self.alarms = there;
        Ok(())
    }

    /// The model of each loop is of the latest version that was acknowledged, or of a later one that was under way.
    fn hold_models(&mut self, content: &Content) -> Result<(), String> {
        for row in &content.models {
            let known = self.models.get(&(row.control_loop.clone(), row.version));
            let is = |own: &Row| matches!(own, Row::Model(own) if own == row);
            let doubted = self.doubts.iter().any(|batch| batch.rows.iter().any(is));
            if !doubted && !known.is_some_and(|known| known.contains(row)) {
                return Err(format!("a model is there that nobody wrote: {row:?}"));
            }
        }
        for (control_loop, version) in self.models.keys() {
            let there = content.models.iter().find(|row| row.control_loop == *control_loop);
            if there.is_none_or(|row| row.version < *version) {
                return Err(format!("an acknowledged model is lost: {control_loop} {version}, {there:?}"));
            }
        }
        content.models.iter().for_each(|row| self.take_model(row));
        Ok(())
    }

    /// Every alarm for stiction follows votes that said so, the last of them just before it. Which runs were votes their bases
    /// tell: those on newer samples than the run before, of the valve that the loop has now.
    fn hold_causes(&self) -> Result<(), String> {
        let mut runs: BTreeMap<&str, Vec<Said>> = BTreeMap::new();
        for row in &self.rows {
            match row {
                Row::Diagnosis(run) if ["stiction", "no_stiction"].contains(&run.outcome.as_str()) => {
                    let own = runs.entry(&run.control_loop).or_default();
                    own.push(Said::of(run, own.last()));
                }
                Row::Transition(t) if t.kind == "stiction" && t.cause == "raised" => {
                    let own = runs.get(t.control_loop.as_str()).map(Vec::as_slice).unwrap_or_default();
                    let said = sticking(own);
                    if said < VOTES.1 || !own.last().is_some_and(|last| last.sticks) {
                        let votes = VOTES.0;
                        return Err(format!(
                            "an alarm without a cause: {t:?}, {said} of the last {votes} votes"
                        ));
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }
}

/// A run that said whether the valve sticks.
struct Said {
    sticks: bool,
    /// Whether it was a vote for sure: around half a period it may be one or not, and so may one across a restart.
    is_vote: bool,
    finished: f64,
    /// Stamp of the newest sample of OP and PV (s), and where they were read; `None` where its basis was not kept.
    basis: Option<(f64, Option<u64>)>,
}

impl Said {
    fn of(run: &DiagnosisRow, before: Option<&Said>) -> Self {
        let text = run.basis.as_deref().and_then(unpack);
        let basis = text.and_then(|text| BasisText::read(&text)).and_then(|basis| {
            let measured = basis.extents.iter().filter(|own| ["op", "pv"].contains(&own.tag.as_str()));
            let newest = measured.filter_map(|own| Some(own.span?.1)).reduce(f64::max)?;
            Some((newest, basis.source))
        });
        let is_far = |before: &Said| {
            let newer = basis.zip(before.basis).is_some_and(|(own, last)| own.0 - last.0 >= SURE_S);
            newer && run.finished - before.finished >= SURE_S
        };
        let (sticks, finished) = (run.outcome == "stiction", run.finished);
        Self { sticks, is_vote: before.is_none_or(is_far), finished, basis }
    }
}

/// How many of the latest votes say that the valve sticks, as many as that may be.
fn sticking(runs: &[Said]) -> usize {
    let source = |own: &Said| own.basis.and_then(|(_, source)| source);
    let is_of_valve = |own: &&Said| source(own) == runs.last().and_then(source);
    let votes = runs.iter().rev().filter(is_of_valve).filter(|own| own.sticks || own.is_vote);
    votes.take(VOTES.0).filter(|own| own.sticks).count()
}
