//! What a historian holds of what a controller has: registers are held from scan to scan and read by a poll with a clock of
//! its own, or a server reports changes with the controller's stamps. Pure: the same seed gives the same record.

use crate::signal::{Record, Sample, Series};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;

/// Most of its period by which a poll comes early or late: polls stay in their order.
const MOST_JITTER: f64 = 0.49;
/// How much later a doubled poll comes (share of the poll's period).
const DOUBLED_AFTER: f64 = 0.01;
/// Share of a scan by which a poll at a scan's very instant may come before it by rounding.
const AT_SCAN: f64 = 1e-9;

/// What the controller has at its scans: one value a scan, held until the next.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scans {
    /// Time of the first scan (s).
    pub t0: f64,
    /// Period of the scans (s).
    pub scan_s: f64,
    /// Controller output.
    pub op: Vec<f64>,
    /// Process variable.
    pub pv: Vec<f64>,
    /// Set point, where there is one.
    pub sp: Option<Vec<f64>>,
    /// Measured stem position, where there is one.
    pub mv: Option<Vec<f64>>,
    /// Other tags by name.
    pub tags: Vec<(String, Vec<f64>)>,
}

/// Which polls are lost.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Gaps {
    /// None.
    #[default]
    None,
    /// Each with the same chance.
    Random {
        /// Share lost (0..1).
        share: f64,
    },
    /// Several on end.
    Bursts {
        /// Share lost (0..1).
        share: f64,
        /// Mean length (polls).
        length: f64,
    },
    /// The first `lost` of every `every` polls.
    Periodic {
        /// Polls from one gap to the next.
        every: usize,
        /// Polls lost in each.
        lost: usize,
    },
}

/// A poll that reads all registers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Poll {
    /// Its period (s).
    pub period_s: f64,
    /// When it comes first (share of its period after the first scan).
    pub phase: f64,
    /// Standard deviation of its instants (share of its period).
    pub jitter: f64,
    /// Step of the scaled integers that hold the values; 0 for none.
    pub step: f64,
    /// How much later than OP PV is read (share of a scan); its stamp is the poll's. Below 0: what is read is older than that.
    pub pv_late: f64,
    /// Share of polls without an answer.
    pub dropped: f64,
    /// Share of polls that are answered twice.
    pub doubled: f64,
    /// Gaps.
    pub gaps: Gaps,
}

impl Poll {
    /// A poll every `period_s` from the first scan on, and nothing wrong with it.
    pub fn every(period_s: f64) -> Self {
        Self {
            period_s,
            phase: 0.0,
            jitter: 0.0,
            step: 0.0,
            pv_late: 0.0,
            dropped: 0.0,
            doubled: 0.0,
            gaps: Gaps::None,
        }
    }
}

/// How values come into the historian.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Acquisition {
    /// Read by a poll, stamped by who polls.
    Polled(Poll),
    /// Reported when they change, stamped by the controller (OPC UA).
    OnChange {
        /// Least change that is reported, of any tag (its unit).
        dead_band: f64,
    },
}

/// The record that a historian holds of these scans.
pub fn acquire(scans: &Scans, how: &Acquisition, seed: u64) -> Record {
    match how {
        Acquisition::OnChange { dead_band } => {
            collect(scans, |values, _| on_change(scans, values, *dead_band))
        }
        Acquisition::Polled(poll) => {
            let times = instants(scans, poll, seed);
            collect(scans, |values, is_pv| read(scans, poll, &times, values, is_pv))
        }
    }
}

/// A record of what `series` makes of each tag's values; it is told which is PV.
fn collect(scans: &Scans, series: impl Fn(&[f64], bool) -> Series) -> Record {
    let other = |values: &Option<Vec<f64>>| values.as_ref().map(|values| series(values, false));
    Record {
        op: series(&scans.op, false),
        pv: series(&scans.pv, true),
        sp: other(&scans.sp),
        mv: other(&scans.mv),
        tags: scans.tags.iter().map(|(name, values)| (name.clone(), series(values, false))).collect(),
        ..Record::default()
    }
}

/// When the polls that are answered come (s), in order.
fn instants(scans: &Scans, poll: &Poll, seed: u64) -> Vec<f64> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let period = poll.period_s;
    let end = scans.scan_s * scans.op.len() as f64;
    if !(period > 0.0 && end.is_finite()) {
        return Vec::new();
    }
    let count = ((end - poll.phase * period) / period).ceil().max(0.0) as usize;
    let mut times = Vec::with_capacity(count);
    let mut in_burst = false;
    for j in 0..count {
        let off: f64 = StandardNormal.sample(&mut rng);
        let off = (poll.jitter * off).clamp(-MOST_JITTER, MOST_JITTER);
        let mut chance = |share: f64| rng.random::<f64>() < share;
        let lost = match poll.gaps {
            Gaps::None => false,
            Gaps::Random { share } => chance(share),
            Gaps::Bursts { share, length } => {
                // A chain of two states with this share and mean length.
                let ends = 1.0 / length.max(1.0);
                let begins = ends * share / (1.0 - share).max(ends);
                in_burst = if in_burst { !chance(ends) } else { chance(begins) };
                in_burst
            }
            Gaps::Periodic { every, lost } => j % every.max(1) < lost,
        };
        if chance(poll.dropped) || lost {
            continue;
        }
        let at = scans.t0 + (j as f64 + poll.phase + off) * period;
        times.push(at);
        if chance(poll.doubled) {
            times.push(at + DOUBLED_AFTER * period);
        }
    }
    times.sort_by(f64::total_cmp);
    times
}

/// What a poll reads at these instants.
fn read(scans: &Scans, poll: &Poll, times: &[f64], values: &[f64], is_pv: bool) -> Series {
    let late = if is_pv { poll.pv_late } else { 0.0 };
    let held = |t: f64| {
        let scan = ((t - scans.t0) / scans.scan_s + late + AT_SCAN).floor();
        let scan = (scan.max(0.0) as usize).min(values.len().checked_sub(1)?);
        Some(values[scan])
    };
    let rounded = |v: f64| if poll.step > 0.0 { (v / poll.step).round() * poll.step } else { v };
    times.iter().filter_map(|t| Some(Sample::good(*t, rounded(held(*t)?)))).collect()
}

/// The changes of a tag, by their scans' stamps.
fn on_change(scans: &Scans, values: &[f64], dead_band: f64) -> Series {
    let mut out: Series = Vec::new();
    for (k, v) in values.iter().enumerate() {
        if out.last().is_none_or(|last| *v != last.value && (v - last.value).abs() >= dead_band) {
            out.push(Sample::good(scans.t0 + k as f64 * scans.scan_s, *v));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scans() -> Scans {
        Scans {
            t0: 100.0,
            scan_s: 2.0,
            op: vec![0.0, 1.0, 2.0, 2.0, 4.0],
            pv: vec![10.0, 11.0, 12.0, 13.0, 14.0],
            ..Scans::default()
        }
    }

    fn points(series: &[Sample]) -> Vec<(f64, f64)> {
        series.iter().map(|s| (s.t, s.value)).collect()
    }

    fn polled(poll: Poll) -> Record {
        acquire(&scans(), &Acquisition::Polled(poll), 1)
    }

    #[test]
    fn registers_are_held_between_scans() {
        let same = polled(Poll::every(2.0));
        assert_eq!(points(&same.op), [(100.0, 0.0), (102.0, 1.0), (104.0, 2.0), (106.0, 2.0), (108.0, 4.0)]);
        // Every 3 s from 1.5 s on: scans 0, 2, 3.
        let slow = polled(Poll { phase: 0.5, ..Poll::every(3.0) });
        assert_eq!(points(&slow.pv), [(101.5, 10.0), (104.5, 12.0), (107.5, 13.0)]);
        let twice = polled(Poll { phase: 0.5, ..Poll::every(1.0) });
        let values: Vec<f64> = twice.op.iter().map(|s| s.value).collect();
        assert_eq!(values, [0.0, 0.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 4.0, 4.0]);
    }

    #[test]
    fn pv_read_late_is_of_the_next_scan_where_the_boundary_lies_between() {
        let late = |phase| polled(Poll { phase, pv_late: 0.3, ..Poll::every(2.0) });
        let pv = |record: Record| -> Vec<f64> { record.pv.iter().map(|s| s.value).collect() };
        assert_eq!(pv(late(0.5)), [10.0, 11.0, 12.0, 13.0, 14.0]);
        assert_eq!(pv(late(0.8)), [11.0, 12.0, 13.0, 14.0, 14.0]);
        assert_eq!(points(&late(0.8).op)[0], (101.6, 0.0));
    }

    #[test]
    fn scaled_integers_have_a_step() {
        let coarse = polled(Poll { step: 3.0, ..Poll::every(2.0) });
        let pv: Vec<f64> = coarse.pv.iter().map(|s| s.value).collect();
        assert_eq!(pv, [9.0, 12.0, 12.0, 12.0, 15.0]);
    }

    #[test]
    fn changes_are_reported_with_the_controllers_stamps() {
        let all = acquire(&scans(), &Acquisition::OnChange { dead_band: 0.0 }, 1);
        assert_eq!(points(&all.op), [(100.0, 0.0), (102.0, 1.0), (104.0, 2.0), (108.0, 4.0)]);
        let large = acquire(&scans(), &Acquisition::OnChange { dead_band: 2.0 }, 1);
        assert_eq!(points(&large.pv), [(100.0, 10.0), (104.0, 12.0), (108.0, 14.0)]);
    }

    #[test]
    fn polls_are_lost_and_doubled_as_asked() {
        let lost = polled(Poll { gaps: Gaps::Periodic { every: 2, lost: 1 }, ..Poll::every(2.0) });
        assert_eq!(points(&lost.pv), [(102.0, 11.0), (106.0, 13.0)]);
        let doubled = polled(Poll { doubled: 1.0, ..Poll::every(4.0) });
        assert_eq!(
            points(&doubled.op),
            [(100.0, 0.0), (100.04, 0.0), (104.0, 2.0), (104.04, 2.0), (108.0, 4.0), (108.04, 4.0)]
        );
        let many = Scans { op: vec![0.0; 20_000], pv: vec![0.0; 20_000], ..scans() };
        let left = |poll: Poll| acquire(&many, &Acquisition::Polled(poll), 3).op.len() as f64 / 20_000.0;
        // Three standard errors of a share of 0.7 of 20,000 are 0.01, and of bursts of 5 about twice that.
        assert!((left(Poll { dropped: 0.3, ..Poll::every(2.0) }) - 0.7).abs() < 0.01);
        assert!((left(Poll { gaps: Gaps::Random { share: 0.3 }, ..Poll::every(2.0) }) - 0.7).abs() < 0.01);
        let bursts = Gaps::Bursts { share: 0.3, length: 5.0 };
        assert!((left(Poll { gaps: bursts, ..Poll::every(2.0) }) - 0.7).abs() < 0.03);
    }

    #[test]
    fn jitter_moves_the_instants_and_not_their_mean() {
        let many =
            Scans { op: vec![0.0; 5000], pv: vec![0.0; 5000], t0: 0.0, scan_s: 1.0, ..Scans::default() };
        let poll = Poll { phase: 0.5, jitter: 0.05, ..Poll::every(1.0) };
        let record = acquire(&many, &Acquisition::Polled(poll), 4);
        let off: Vec<f64> = record.op.iter().enumerate().map(|(j, s)| s.t - (j as f64 + 0.5)).collect();
        let mean = off.iter().sum::<f64>() / 5000.0;
        let sd = (off.iter().map(|d| d * d).sum::<f64>() / 5000.0).sqrt();
        assert!(mean.abs() < 0.003 && (sd - 0.05).abs() < 0.003, "{mean} {sd}");
        assert_eq!(record, acquire(&many, &Acquisition::Polled(poll), 4));
    }

    #[test]
    fn nothing_gives_nothing() {
        let none = acquire(&Scans::default(), &Acquisition::Polled(Poll::every(0.0)), 1);
        assert!(none.op.is_empty() && none.pv.is_empty());
        assert!(acquire(&Scans::default(), &Acquisition::OnChange { dead_band: 0.0 }, 1).op.is_empty());
    }
}
