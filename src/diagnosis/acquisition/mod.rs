//! How a record was acquired: the period of the controller's scans, the period of the polls, and the rows of the samples.
//!
//! Registers are held from scan to scan. A poll with a new value comes after a scan; a poll with the old value, of a tag that else
//! changes at every scan, comes before the next one. So the times of changes show the period and the phase of the scans.
//! Where they do, the samples are put on the controller's ticks, else on the polls.
//! Nothing is interpolated: several polls of one scan are one sample, and a scan between two polls is a missing row.
//!
//! | what | where |
//! |---|---|
//! | equal rows from stamps, their jitter; sources that report only changes | `lattice.rs` |
//! | the period and the phase of the controller's scans | `scan.rs` |
//! | which sample gives the value of a row; how far apart OP and PV were read | `place.rs` |
//! | by how many rows PV is recorded late | `late.rs` |
//! | whether OP answers a PV that is recorded later, at stamps that no move puts right | `later.rs` |
//! | whether OP was computed from PV, or PV was drawn | `computed.rs` |
//! | limits | `limits.rs` |

pub(super) mod computed;
mod late;
mod later;
pub(super) mod lattice;
mod limits;
mod place;
mod scan;

pub use late::{Answer, answer};
pub use later::Later;
pub use lattice::period;
pub use limits::ReadingLimits;
pub use place::{Apart, Carried, Placed};

use super::history_kind::{HistoryFound, HistoryKind};
use crate::signal::Sample;
use lattice::{EXACT, Lattice};

/// Fewest samples of a tag from which scans are sought.
const LEAST: usize = 50;
/// Largest standard deviation of stamps about equal rows (share of the period): three of them are half of it.
const ON_LATTICE: f64 = 0.17;

/// How a record was acquired.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Acquisition {
    /// Period of the controller's scans (s), where the changes of held values show it, or the stamps are those of the scans.
    pub scan_s: Option<f64>,
    /// Period of the polls (s).
    pub poll_s: Option<f64>,
    /// Standard deviation of the stamps of the polls about equal rows (s).
    pub jitter_s: Option<f64>,
    /// Number of polls in one scan.
    pub polls_per_scan: Option<f64>,
    /// Whether the samples were put on the controller's ticks.
    pub recovered: bool,
    /// Whether the period of the rows was given: the scans are not sought then.
    pub ts_given: bool,
    /// Time by which PV is recorded later than the controller read it (s), where OP shows it; PV was moved back by it.
    pub pv_late_s: f64,
}

impl Acquisition {
    /// Whether the controller may have scanned unseen between two samples: the polls have a clock of their own, and its ticks are
    /// not known.
    pub fn unseen_scans(&self) -> bool {
        let jitter = self.jitter_s.zip(self.poll_s).is_some_and(|(jitter, poll)| jitter > EXACT * poll);
        !self.recovered && jitter
    }

    /// The sentence for an operator; `None` where there is nothing to say.
    pub fn sentence(&self) -> Option<String> {
        let told: Vec<String> =
            self.scans().or_else(|| self.unseen()).into_iter().chain(self.late()).collect();
        (!told.is_empty()).then(|| told.join("; "))
    }

    /// How often a scan was polled, where that is not once.
    fn scans(&self) -> Option<String> {
        let (scan, polls) = (self.scan_s?, self.polls_per_scan?);
        (self.recovered && !(0.9..1.1).contains(&polls)).then(|| {
            let scan = seconds(scan);
            if polls < 1.0 {
                return format!(
                    "about {:.1} controller scans of {scan} s pass per poll; diagnosed at the controller's ticks, of which those \
                     between polls are missing; poll at least once per scan",
                    1.0 / polls
                );
            }
            let often = if (polls - 2.0).abs() < 0.05 { "twice".into() } else { format!("{polls:.1} times") };
            format!("polled {often} per controller scan of {scan} s; diagnosed at the controller's ticks")
        })
    }

    /// That scans may be unseen, and what shows them. Their period is not known then.
    fn unseen(&self) -> Option<String> {
        let first = if self.ts_given { "give no sample period and " } else { "" };
        self.unseen_scans().then(|| {
            format!(
                "the controller may act between two samples: for a narrower interval of f {first}take at least two \
                 samples per scan"
            )
        })
    }

    /// By how much PV is recorded late.
    fn late(&self) -> Option<String> {
        let late = seconds(self.pv_late_s);
        (self.pv_late_s > 0.0).then(|| {
            format!("PV is recorded {late} s late: OP reacts before PV shows the change; diagnosed with PV moved back")
        })
    }
}

/// A time (s) with three decimals, as many as jitter leaves.
fn seconds(seconds: f64) -> String {
    format!("{seconds:.3}").trim_end_matches('0').trim_end_matches('.').to_string()
}

/// How OP and PV were acquired, and the rows of their samples; `None` where the stamps of PV give no period.
///
/// * `op`, `pv`: good samples in the order of time, no stamp twice.
/// * `ts`: the configured period of the rows (s); with it the scans are not sought.
/// * `history`: what an archive did to the record.
/// * `limits`: the limits by which OP and PV count as read together.
pub fn recognise(
    op: &[Sample],
    pv: &[Sample],
    ts: Option<f64>,
    history: Option<&HistoryFound>,
    limits: ReadingLimits,
) -> Option<(Acquisition, Placed)> {
    let polled = Lattice::of(pv)?;
    let mut found =
        Acquisition { poll_s: Some(polled.period), jitter_s: Some(polled.jitter), ..Acquisition::default() };
    if let Some(ts) = ts {
        found.ts_given = true;
        return Some((found, Placed::on(Lattice { period: ts, ..polled }, op, pv, limits)));
    }
    let enough = op.len().min(pv.len()) >= LEAST && polled.jitter < ON_LATTICE * polled.period;
    if let Some(scan) = scan::recognise(op, pv, &polled).filter(|_| enough) {
        found.scan_s = Some(scan.period);
        found.polls_per_scan = Some(scan.period / polled.period);
        found.recovered = true;
        return Some((found, Placed::on_ticks(&scan, limits)));
    }
    // Where an archive left out changes within a dead band, a value does not hold until the next sample.
    let all_changes = history.is_none_or(|found| found.kind != HistoryKind::Exception);
    if let Some(source) = lattice::of_source(op, pv, limits).filter(|_| all_changes) {
        found.scan_s = Some(source.period);
        found.recovered = true;
        return Some((found, Placed::on_source(source, limits)));
    }
    Some((found, Placed::on(polled, op, pv, limits)))
}

#[cfg(test)]
mod tests;
