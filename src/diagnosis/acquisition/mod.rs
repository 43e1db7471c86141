//! How a record was acquired: at which period the controller scans, how it was polled, and on which rows its samples lie.
//!
//! Registers are held from scan to scan. A poll that finds a new value comes after a scan, one that finds the old value
//! of a tag that else changes at every scan comes before the next: so the instants of changes tell the scans' period and
//! phase (`scan`). Where they do, the samples are put on the controller's ticks; else they stay on the polls. Nothing is
//! interpolated: several polls of one scan are one sample, and a scan that fell between two polls is missing.

mod late;
mod lattice;
mod limits;
mod place;
mod scan;

pub use late::{Answer, answer};
pub use lattice::period;
pub use limits::ReadingLimits;
pub use place::{Apart, Carried, Placed};

use super::history_kind::{HistoryFound, HistoryKind};
use crate::signal::Sample;
use lattice::Lattice;

/// Fewest samples of a tag that say anything.
const LEAST: usize = 50;
/// Largest deviation of stamps that are the controller's own (share of its period).
const EXACT: f64 = 1e-3;
/// Largest standard deviation of stamps that lie on a lattice at all (share of its period): three of them are half of it.
const ON_LATTICE: f64 = 0.17;

/// How a record was acquired.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Acquisition {
    /// Period of the controller's scans (s), where the changes of held values tell it or stamps are its own.
    pub scan_s: Option<f64>,
    /// Period of the polls (s).
    pub poll_s: Option<f64>,
    /// Standard deviation of the polls' instants (s).
    pub jitter_s: Option<f64>,
    /// Polls in one scan.
    pub polls_per_scan: Option<f64>,
    /// Whether the samples were put on the controller's ticks.
    pub recovered: bool,
    /// By how much later than OP PV is recorded (s), where OP tells that the controller had it before; it was moved back.
    pub pv_late_s: f64,
}

impl Acquisition {
    /// Whether the controller may have scanned between two samples: polls of a clock of their own that do not tell its ticks.
    pub fn unseen_scans(&self) -> bool {
        let jitter = self.jitter_s.zip(self.poll_s).is_some_and(|(jitter, poll)| jitter > EXACT * poll);
        !self.recovered && jitter
    }

    /// What it means, where it is worth a sentence.
    pub fn sentence(&self) -> Option<String> {
        let told: Vec<String> = self.scans().into_iter().chain(self.late()).collect();
        (!told.is_empty()).then(|| told.join("; "))
    }

    /// How often a scan was polled, where that is not once: then the ticks are the polls, whether or not some were missed.
    fn scans(&self) -> Option<String> {
        let (scan, polls) = (self.scan_s?, self.polls_per_scan?);
        (self.recovered && !(0.9..1.1).contains(&polls)).then(|| {
            let often = if (polls - 2.0).abs() < 0.05 { "twice".into() } else { format!("{polls:.1} times") };
            let scan = seconds(scan);
            format!("polled {often} per controller scan of {scan} s; diagnosed at the controller's ticks")
        })
    }

    fn late(&self) -> Option<String> {
        let late = seconds(self.pv_late_s);
        (self.pv_late_s > 0.0).then(|| {
            format!("PV is recorded {late} s late: OP reacts before PV shows the change; diagnosed with PV moved back")
        })
    }
}

/// Four digits of a period are as many as jitter leaves.
fn seconds(seconds: f64) -> String {
    format!("{seconds:.3}").trim_end_matches('0').trim_end_matches('.').to_string()
}

/// How OP and PV were acquired and where their samples lie; good samples in the order of time, no stamp twice.
///
/// `ts`: the period of the rows, where it is given; then no scan is looked for.
/// `history`: what an archive did to the record.
/// `limits`: those by which OP and PV count as read together.
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
        return Some((found, Placed::on(Lattice { period: ts, ..polled }, op, pv, limits)));
    }
    let enough = op.len().min(pv.len()) >= LEAST && polled.jitter < ON_LATTICE * polled.period;
    if let Some(scan) = scan::recognise(op, pv, &polled).filter(|_| enough) {
        found.scan_s = Some(scan.period);
        found.polls_per_scan = Some(scan.period / polled.period);
        found.recovered = true;
        return Some((found, Placed::on_ticks(&scan, limits)));
    }
    // What a dead band left out may have changed by as much: those rows are missing.
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
