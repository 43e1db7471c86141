//! The store in PostgreSQL: samples as rows by time, everything else as in the folder, so that a site's own tools read it.
//!
//! ```text
//! batch --> PostgreSQL                    while it is there and nothing waits
//! batch --> spool --part by part--> PostgreSQL    else: nothing overtakes what waits
//! ```
//!
//! The spool is a store in a folder, so that what waits survives a kill and can be read. A part goes from it when it is
//! committed in PostgreSQL; where nobody knows whether it was, it is delivered again, which changes nothing.

mod client;
mod link;
mod pages;
mod read;
mod retain;
mod schema;
mod unknown;
mod wire;
mod write;

pub use link::said;
pub(super) use read::Reader;

use super::backend::{Beat, Found, Spool, Usage, Writes};
use super::{Batch, Config, Row, StoreError, Upkeep, embedded};
use client::Ask;
use embedded::Part;
use retain::Retention;
use std::time::{Duration, Instant};
use unknown::Unknown;
use write::Link;

/// Shortest and longest pause between attempts to connect.
const PAUSES: (Duration, Duration) = (Duration::from_millis(250), Duration::from_secs(5));
/// Samples wait for this long (days), which is for ever.
const EVER_DAYS: f64 = 36_500.0;

/// The tables, open for writing, and what waits for them.
#[derive(Debug)]
pub(super) struct Store {
    config: Config,
    spool: embedded::Store,
    /// Whether anything is in the spool.
    waits: bool,
    link: Option<Link>,
    /// Why there is no link; `None` also before it was tried.
    away: Option<String>,
    /// Why it was away, as that was told last; `None` once it takes what it is given.
    told: Option<String>,
    /// The next pause between attempts.
    pause: Duration,
    again: Instant,
    /// Counted in the database; as far as that was ever reached.
    era: i64,
    /// What the eras of the spool count from.
    base: Option<i64>,
    retention: Retention,
    unknown: Unknown,
    refused: u64,
    delivered: u64,
    beat: Beat,
}

impl Store {
    /// Opens the spool, and connects. A database that is away is no error. What it has is known to who reads it then, as
    /// `is_read` says, and to nobody else.
    ///
    /// # Errors
    /// [`StoreError`] of the spool, [`StoreError::OwnStore`] where it is none, which then stays as it is; [`StoreError::TooNew`] and
    /// [`StoreError::Foreign`] of the database.
    pub fn open(config: &Config, is_read: bool) -> Result<Self, StoreError> {
        let spooled = Config {
            url: None,
            max_mb: config.spool_mb,
            samples_days: EVER_DAYS,
            trend_days: 0.0,
            diagnoses_days: EVER_DAYS,
            alarms_days: EVER_DAYS,
            // There nothing goes because of its age.
            upkeep: Upkeep { pace: None, ..config.upkeep },
            ..config.clone()
        };
        embedded::is_spool(&config.folder, config.spool_mb)?;
        let spool = embedded::Store::open(&spooled)?;
        let mut store = Self {
            config: config.clone(),
            waits: !spool.is_empty()?,
            base: spool.base()?,
            spool,
            link: None,
            away: None,
            told: None,
            pause: PAUSES.0,
            again: Instant::now(),
            era: 0,
            retention: Retention::of(config),
            unknown: Unknown::default(),
            refused: 0,
            delivered: 0,
            beat: Beat::default(),
        };
        match store.connect(is_read) {
            Err(error @ (StoreError::TooNew(_) | StoreError::Foreign(_))) => return Err(error),
            Err(error) => store.lost(&error),
            Ok(()) => {
                // Who reads now finds everything that was said; samples are looked for in the spool too.
                while store.link.is_some() && store.deliver(true)? {}
            }
        }
        Ok(store)
    }

    fn connect(&mut self, opening: bool) -> Result<(), StoreError> {
        let mut client = link::connect(&self.config, link::WRITES)?;
        client.tell_answers(self.beat.clone());
        let lock = "SELECT pg_try_advisory_lock(hashtext('stictiond'), hashtext($1))";
        if !client.query_one(lock, &[&self.config.schema])?.get::<_, bool>(0) {
            let schema = &self.config.schema;
            return Err(StoreError::Away(format!("another stictiond writes to schema {schema}")));
        }
        schema::migrate(&mut client, &self.config.schema)?;
        let mut link = Link::new(client)?;
        let there = link.era()?;
        let base = match self.base {
            Some(base) if self.waits => base,
            None if self.waits => there,
            _ => {
                self.era.max(there).max(self.base.map_or(0, |base| base + self.spool.era()))
                    - self.spool.era()
            }
        };
        if self.base != Some(base) {
            self.spool.set_base(base)?;
            self.base = Some(base);
        }
        self.era = self.era.max(there).max(base + self.spool.era());
        self.unknown.compare(&mut link.client, &mut self.spool, opening)?;
        // Nothing overtakes what is to be merged, or is to be delivered once more.
        self.waits |= self.unknown.holds() || !self.spool.is_empty()?;
        (self.link, self.away) = (Some(link), None);
        if !self.waits {
            self.works();
        }
        Ok(())
    }

    /// The database takes what it is given. One that only lets us in may refuse that, as a disk that is full does: it is tried no
    /// sooner by that, and nothing is told.
    fn works(&mut self) {
        self.pause = PAUSES.0;
        if self.told.take().is_some() {
            tracing::info!(waits = self.waits, "the database is there again");
        }
    }

    /// Connects where there is no link and it is time to try.
    fn reach(&mut self) -> bool {
        if self.link.is_none()
            && Instant::now() >= self.again
            && let Err(error) = self.connect(false)
        {
            self.lost(&error);
        }
        self.link.is_some()
    }

    fn lost(&mut self, error: &StoreError) {
        let why = error.to_string();
        if self.told.as_ref() != Some(&why) {
            tracing::warn!(error = why, "the database is away: what is new waits on disk");
            self.told = Some(why.clone());
        }
        (self.link, self.away) = (None, Some(why));
        self.again = Instant::now() + self.pause;
        self.pause = (self.pause * 2).min(PAUSES.1);
    }

    /// Into the database, unless something waits that is older; true when it is there. States go by way of the spool, which
    /// knows then what a start without the database begins with.
    fn straight(&mut self, batch: &Batch) -> Result<bool, StoreError> {
        if self.waits || !self.reach() {
            return Ok(false);
        }
        // Who connects may have found something that has to be merged first.
        if self.waits {
            return Ok(false);
        }
        let states = batch.rows.iter().any(Row::is_state);
        if states {
            self.spool.hold_states(&batch.rows)?;
        }
        let Some(link) = &mut self.link else { return Ok(false) };
        match link.write_batch(batch, self.era) {
            Ok(refused) => {
                self.refused += refused;
                self.works();
                if states {
                    self.spool.states_are_there()?;
                }
                Ok(true)
            }
            Err(error) => {
                self.lost(&error);
                Ok(false)
            }
        }
    }

    /// Delivers what has waited longest, or only rows; false when nothing of the kind waits, or the database went away.
    fn deliver(&mut self, only_rows: bool) -> Result<bool, StoreError> {
        let Some(link) = &mut self.link else { return Ok(false) };
        let part = self.spool.part()?;
        let happened = matches!(part, Some(Part::Diagnoses(_) | Part::Transitions(_)));
        if !happened && !self.unknown.settle() {
            return Ok(false);
        }
        let Some(part) = part else {
            self.waits = false;
            self.works();
            return Ok(false);
        };
        if only_rows && !part.is_rows() {
            return Ok(false);
        }
        let base = self.base.unwrap_or(0);
        let series = match &part {
            Part::Samples(_, series) => series.as_slice(),
            _ => &[],
        };
        let series_of = series.iter().map(|(era, own)| (base + era, own));
        let rows = part.rows();
        let written = self.unknown.bridges(&mut link.client, &rows).and_then(|mut bridged| {
            bridged.extend_from_slice(&rows);
            link.write(series_of, &bridged)
        });
        if let Err(error) = written {
            self.lost(&error);
            return Ok(false);
        }
        self.works();
        self.unknown.bridged(&rows);
        self.delivered += series.iter().map(|(_, own)| own.samples.len() as u64).sum::<u64>();
        self.spool.forget(&part)?;
        Ok(true)
    }
}

impl Writes for Store {
    fn write(&mut self, batch: &Batch) -> Result<(), StoreError> {
        if !self.straight(batch)? {
            self.spool.write(batch)?;
            self.waits = true;
        }
        Ok(())
    }

    fn insert(&mut self, batch: &Batch) -> Result<(), StoreError> {
        if !self.straight(batch)? {
            self.spool.insert(batch)?;
            self.waits = true;
        }
        Ok(())
    }

    fn tidy(&mut self, now: f64) -> Result<bool, StoreError> {
        if self.waits {
            self.spool.tidy(now)?;
        } else {
            // States go through the spool also while nothing waits, and nobody else carries its log over.
            self.spool.carry_over_when_due()?;
        }
        if !self.reach() {
            return Ok(false);
        }
        if self.waits {
            return self.deliver(false);
        }
        let Some(link) = &mut self.link else { return Ok(false) };
        match self.retention.step(link, &self.config, now) {
            Ok(more) => Ok(more),
            Err(error) if link.client.is_closed() => {
                self.lost(&error);
                Ok(false)
            }
            Err(error) => {
                tracing::warn!(%error, "what is old stays in the database for now");
                self.retention.put_off(now);
                Ok(false)
            }
        }
    }

    fn make_room(&mut self, now: f64) -> Result<bool, StoreError> {
        self.spool.make_room(now)
    }

    fn begin_era(&mut self) {
        self.era += 1;
        match self.base {
            // What waits is of before, what comes is told apart from it.
            Some(base) if !self.waits => match self.spool.set_base(base + 1) {
                Ok(()) => self.base = Some(base + 1),
                Err(_) => self.spool.begin_era(),
            },
            _ => self.spool.begin_era(),
        }
    }

    fn era(&self) -> i64 {
        self.era
    }

    fn usage(&self) -> Result<Usage, StoreError> {
        let bytes = self.retention.bytes;
        Ok(Usage { used_bytes: bytes, file_bytes: bytes, max_bytes: self.config.max_mb * 1_000_000 })
    }

    fn refused_and_damaged(&self) -> (u64, u64) {
        let (refused, damaged) = self.spool.refused_and_damaged();
        (self.refused + refused, damaged)
    }

    fn thinned_in_doubt_s(&self) -> u64 {
        self.retention.age.in_doubt_s()
    }

    fn checked(&self) -> Option<f64> {
        self.spool.checked()
    }

    fn spool(&self) -> Option<Spool> {
        Some(Spool {
            away: self.away.clone(),
            waits: self.waits,
            bytes: self.spool.usage().map_or(0, |usage| usage.used_bytes) + self.spool.log_bytes(),
            dropped: self.spool.dropped(),
            delivered: self.delivered,
        })
    }

    fn found(&mut self) -> Option<Found> {
        self.unknown.tell()
    }

    fn merged(&mut self) -> Result<(), StoreError> {
        self.unknown.merged(&mut self.spool)
    }

    fn tell_answers(&mut self, to: Beat) {
        if let Some(link) = &mut self.link {
            link.client.tell_answers(to.clone());
        }
        self.beat = to;
    }

    fn disconnect(&mut self) {
        self.link = None;
        self.again = Instant::now();
    }
}
