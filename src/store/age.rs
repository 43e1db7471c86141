//! The time by which age is measured. What goes because a clock is wrong does not come back when the clock is set right. So this
//! time follows the clock only a few times as fast as time passes by a clock that nobody sets, over restarts too.

use super::{Config, StoreError};
use std::fs::{self, OpenOptions};
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Where it is noted: a number of eight bytes, and their checksum.
const FILE: &str = "store.age";
/// It is noted when it has moved by so much (s): what is old is looked at as often.
const NOTED_S: f64 = 60.0;
/// It may lie so far behind the clock (s) before that is told: a daemon that was off for a night is nothing to tell.
const TOLD_S: f64 = 86_400.0;
/// It skips no more than leaves this much (s) before anything goes: so what lies in one day takes a quarter of a day to go, however
/// little that is.
const LEFT_S: f64 = 86_400.0;

/// The time by which age is measured, of one store.
#[derive(Debug)]
pub(super) struct Age {
    path: PathBuf,
    /// How many times as fast as time it moves at most; `None` where it is the clock.
    pace: Option<u32>,
    /// Where it is (s); `None` where it was never noted and nobody has looked yet.
    at: Option<f64>,
    looked: Instant,
    /// Where it was when it was noted last (s).
    noted: f64,
    /// It lies far behind the clock, and that was told.
    behind: bool,
    in_doubt_s: u64,
}

impl Age {
    /// Goes on from where it was noted in the store's folder. Where it was not, as in a new store, it begins at the clock.
    pub fn of(config: &Config) -> Self {
        let path = config.folder.join(FILE);
        let pace = config.upkeep.pace;
        let at = pace.and_then(|_| read(&path));
        if let Some(fault) = pace.and_then(|_| fault(&config.folder)) {
            tracing::warn!("{fault}; age is measured from the clock on");
        }
        let noted = at.unwrap_or(f64::NEG_INFINITY);
        Self { path, pace, at, looked: Instant::now(), noted, behind: false, in_doubt_s: 0 }
    }

    /// Whether it lies behind the clock, so that [`Age::skip`] may save time.
    pub fn lags(&self, clock: f64) -> bool {
        self.pace.is_some() && self.at.is_some_and(|at| clock - at > NOTED_S)
    }

    /// Skips time in which nothing can go: age takes nothing before `due` (s). A first note of a clock that was years behind would
    /// else hold everything for years.
    pub fn skip(&mut self, clock: f64, due: f64) {
        self.at = self.at.map(|before| skipped(before, clock, due));
    }

    /// The time that age is measured by (s), while the clock says `clock` (s).
    pub fn now(&mut self, clock: f64) -> f64 {
        let Some(pace) = self.pace else { return clock };
        let by = f64::from(pace) * self.looked.elapsed().as_secs_f64();
        self.looked = Instant::now();
        let at = self.at.map_or(clock, |before| followed(before, clock, by));
        self.at = Some(at);
        if (at - self.noted).abs() >= NOTED_S {
            // Where that fails the next start goes on from an earlier time, and more is kept.
            let _ = write(&self.path, at);
            self.noted = at;
        }
        let behind = clock - at > TOLD_S;
        if behind && !self.behind {
            tracing::warn!(
                days = (clock - at) / TOLD_S,
                "the clock is ahead of the time by which the store measures age: nobody wrote to the store for long, or the \
                 clock is wrong; what is old goes slowly until the two meet"
            );
        }
        self.behind = behind;
        at.min(clock)
    }

    /// So many seconds of samples were thinned because of their age.
    pub fn thinned(&mut self, seconds: i64) {
        if self.behind {
            self.in_doubt_s += seconds.unsigned_abs();
        }
    }

    /// Seconds of samples that were thinned while the clock was more than a day ahead: too early, if the clock was wrong.
    pub fn in_doubt_s(&self) -> u64 {
        self.in_doubt_s
    }
}

/// Where the time is next: at the clock, or as near to it as it may come by moving by `by` (s).
fn followed(before: f64, clock: f64, by: f64) -> f64 {
    clock.max(before - by).min(before + by)
}

/// Where the time is once it has skipped that in which nothing can go, as nothing goes before `due` (s).
fn skipped(before: f64, clock: f64, due: f64) -> f64 {
    before.max(clock.min(due - LEFT_S))
}

/// What is damaged of the time that a store in a folder has noted, in words. Nothing where it was never noted, nor where a power
/// failure has left the file without its bytes.
pub(super) fn fault(folder: &Path) -> Option<String> {
    let bytes = fs::read(folder.join(FILE)).unwrap_or_default();
    let is_damaged = bytes.iter().any(|byte| *byte != 0) && of_bytes(&bytes).is_none();
    is_damaged.then(|| format!("{FILE}, the time by which age is measured, is damaged"))
}

/// Removes what a store in a folder has noted, where that is damaged.
///
/// # Errors
/// [`StoreError::Io`].
pub(super) fn drop_damaged(folder: &Path) -> Result<(), StoreError> {
    let path = folder.join(FILE);
    match fault(folder) {
        Some(_) => fs::remove_file(&path).map_err(StoreError::io(&path)),
        None => Ok(()),
    }
}

fn read(path: &Path) -> Option<f64> {
    of_bytes(&fs::read(path).ok()?)
}

fn of_bytes(bytes: &[u8]) -> Option<f64> {
    let (number, sum) = bytes.split_first_chunk::<8>()?;
    let is_whole = *sum == crc32fast::hash(number).to_le_bytes()[..];
    Some(f64::from_le_bytes(*number)).filter(|at| is_whole && at.is_finite())
}

fn write(path: &Path, at: f64) -> io::Result<()> {
    let number = at.to_le_bytes();
    let mut bytes = number.to_vec();
    bytes.extend(crc32fast::hash(&number).to_le_bytes());
    let file = OpenOptions::new().write(true).create(true).truncate(false).open(path)?;
    file.write_all_at(&bytes, 0)
}

#[cfg(test)]
mod tests {
    use super::super::Upkeep;
    use super::*;
    use crate::store::embedded::tests::Folder;
    use std::collections::VecDeque;

    const DAY_S: f64 = 86_400.0;
    /// 2026-01-01T00:00:00Z.
    const NOW: f64 = 1_767_225_600.0;

    /// What is left of samples that come in pieces, as a store keeps them that looks each minute.
    struct Kept {
        /// Begins of the pieces, oldest first.
        begins: VecDeque<f64>,
        piece_s: f64,
        age: f64,
    }

    impl Kept {
        /// As many days as are kept, all at the right time.
        fn full(piece_s: f64) -> Self {
            let pieces = (30.0 * DAY_S / piece_s) as i64;
            let begins = (-pieces..0).map(|piece| NOW + piece as f64 * piece_s).collect();
            Self { begins, piece_s, age: NOW }
        }

        /// Time passes, while clocks show more than that.
        fn pass(&mut self, from: f64, seconds: f64, ahead: f64) {
            let pace = f64::from(Upkeep::default().pace.expect("a bound"));
            for look in 1..=(seconds / 60.0) as i64 {
                let clock = from + ahead + 60.0 * look as f64;
                if self.begins.back().is_none_or(|begin| begin + 2.0 * self.piece_s <= clock) {
                    self.begins.push_back((clock / self.piece_s).floor() * self.piece_s - self.piece_s);
                }
                let due = self.begins.front().map_or(f64::INFINITY, |begin| begin + 30.0 * DAY_S);
                self.age = followed(skipped(self.age, clock, due), clock, 60.0 * pace);
                let edge = self.age.min(clock) - 30.0 * DAY_S;
                while self.begins.front().is_some_and(|begin| begin + self.piece_s < edge) {
                    self.begins.pop_front();
                }
            }
        }

        fn oldest(&self) -> f64 {
            self.begins[0]
        }
    }

    /// Pieces of a store in a folder, and of one in PostgreSQL.
    const PIECES: [f64; 2] = [600.0, 6.0 * 3600.0];

    #[test]
    fn a_clock_that_is_set_forward_takes_a_few_times_as_much_as_it_is_wrong() {
        for piece_s in PIECES {
            for ahead in [30.0 * DAY_S, 730.0 * DAY_S] {
                let mut kept = Kept::full(piece_s);
                kept.pass(NOW, 3.0 * 3600.0, ahead);
                let gone = kept.oldest() - (NOW - 30.0 * DAY_S);
                assert!(gone <= 12.0 * 3600.0 + piece_s, "{gone} s of {piece_s} s each, {ahead} s ahead");
                // Set right again it takes nothing before that is due.
                let oldest = kept.oldest();
                kept.pass(NOW + 3.0 * 3600.0, 3600.0, 0.0);
                assert_eq!(kept.oldest(), oldest);
                assert!(kept.age <= NOW + 12.0 * 3600.0);
            }
        }
    }

    #[test]
    fn after_two_months_off_what_is_old_goes_and_no_more_is_kept_than_before() {
        for piece_s in PIECES {
            let mut kept = Kept::full(piece_s);
            let (most, begin) = (kept.begins.len(), NOW + 60.0 * DAY_S);
            for day in 0..40 {
                kept.pass(begin + f64::from(day) * DAY_S, DAY_S, 0.0);
                assert!(kept.begins.len() <= most + 2, "{} pieces after {day} days", kept.begins.len());
            }
            let edge = begin + 10.0 * DAY_S;
            assert_eq!(kept.age, edge + 30.0 * DAY_S, "it has caught up");
            assert!((edge - 2.0 * piece_s..=edge).contains(&kept.oldest()));
        }
    }

    /// A machine without a battery for its clock, until it has heard of the time.
    #[test]
    fn a_clock_that_is_set_back_for_a_while_is_followed_again_soon() {
        let mut kept = Kept::full(600.0);
        let oldest = kept.oldest();
        kept.pass(NOW, 3600.0, -NOW);
        assert_eq!(kept.oldest(), oldest);
        kept.pass(NOW + 3600.0, 2.0 * 3600.0, 0.0);
        assert_eq!(kept.age, NOW + 3.0 * 3600.0);
    }

    /// As of a machine that is installed before it has heard of the time.
    #[test]
    fn a_first_note_that_is_years_behind_is_left_at_once_as_far_as_nothing_goes() {
        let folder = Folder::new();
        fs::create_dir_all(&folder.0).expect("writable");
        let mut age = Age::of(&Config::new(&folder.0));
        assert!(!age.lags(5.0), "nobody has looked");
        assert_eq!(age.now(5.0), 5.0);
        assert!(age.lags(NOW) && !age.lags(6.0));
        age.skip(NOW, 30.0 * DAY_S);
        let now = age.now(NOW);
        assert!((29.0 * DAY_S..29.1 * DAY_S).contains(&now), "what is of 1970 is to go first: {now}");
        age.skip(NOW, NOW + 2.0 * DAY_S);
        assert_eq!(age.now(NOW), NOW, "never ahead of the clock");
        age.skip(NOW, 0.0);
        assert_eq!(age.now(NOW), NOW, "never back");
        assert_eq!(read(&folder.0.join(FILE)), Some(NOW));
    }

    #[test]
    fn a_restart_makes_no_difference_and_what_is_no_note_is_the_clock() {
        let folder = Folder::new();
        fs::create_dir_all(&folder.0).expect("writable");
        let config = Config::new(&folder.0);
        let mut age = Age::of(&config);
        assert_eq!(age.now(NOW), NOW, "a new store");
        age.thinned(600);
        let began = Instant::now();
        for _ in 0..3 {
            let mut age = Age::of(&config);
            let now = age.now(NOW + 730.0 * DAY_S);
            // Four seconds for each, and a minute that may not have been noted.
            let most = NOW + 4.0 * began.elapsed().as_secs_f64() + 60.0;
            assert!((NOW - 60.0..=most).contains(&now), "{}", now - NOW);
            age.thinned(600);
            assert_eq!(age.in_doubt_s(), 600);
            assert_eq!(age.now(NOW - DAY_S), NOW - DAY_S, "never ahead of the clock");
        }
        assert_eq!(age.in_doubt_s(), 0, "the clock was right");
        assert_eq!(fault(&folder.0), None);
        for (wrong, is_damaged) in [(&b""[..], false), (&[0u8; 12][..], false), (&b"1767225600.0"[..], true)]
        {
            fs::write(folder.0.join(FILE), wrong).expect("written");
            assert_eq!(fault(&folder.0).is_some(), is_damaged, "{wrong:?}");
            drop_damaged(&folder.0).expect("removed");
            assert_eq!(folder.0.join(FILE).exists(), !is_damaged, "{wrong:?}");
            fs::write(folder.0.join(FILE), wrong).expect("written");
            assert_eq!(Age::of(&config).now(NOW + 730.0 * DAY_S), NOW + 730.0 * DAY_S);
            let noted = read(&folder.0.join(FILE));
            assert_eq!(noted, Some(NOW + 730.0 * DAY_S), "the clock is noted in its place");
        }
    }
}
