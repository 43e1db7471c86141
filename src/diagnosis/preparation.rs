//! How a record became the window that is fitted.

use super::{Acquisition, Apart, Carried, HistoryFound, NotIdentifiable, ReadingLimits};

/// How the record became the window that was fitted.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Preparation {
    /// Time of the first fitted sample (s).
    pub start: f64,
    /// Time of the last fitted sample (s).
    pub end: f64,
    /// Samples fitted.
    pub n: usize,
    /// Sample period of the fitted window (s).
    pub ts: f64,
    /// Share of the gated record's rows that were missing or bad (0..1).
    pub gap_share: f64,
    /// Share of the fitted window's rows that are missing and do not count (0..1).
    pub missing: f64,
    /// Worst time between an OP sample and the PV sample it is paired with (s).
    pub worst_skew: f64,
    /// How far apart OP and PV of the gated record's rows were read.
    pub read_apart: Apart,
    /// How much closer than the samples the rows of a given period are, if they are.
    pub carried: Option<Carried>,
    /// By which limits that is too far, or too much.
    pub reading: ReadingLimits,
    /// Samples dropped because their stamp repeats an earlier one.
    pub duplicates: usize,
    /// Samples that arrived out of order and were sorted in.
    pub out_of_order: usize,
    /// Low-pass decimation factor (1: none).
    pub decimation: usize,
    /// Whether wavelet denoising was applied, and to how much noise.
    pub denoise: Denoise,
    /// What an archive did to the record before it came here.
    pub history: Option<Box<HistoryFound>>,
    /// Share of the fitted window at which a term of write-back was in force (0..1).
    pub compensated: f64,
    /// Least f that counts as stiction: of the span, or of what OP covered where the span is not known (OP unit).
    pub f_threshold: f64,
    /// How the record was acquired; `None` where its stamps do not say.
    pub acquisition: Option<Box<Acquisition>>,
}

impl Preparation {
    /// Why the record cannot say that a valve does not stick, nor how much it may: OP and PV of too many rows were read apart. What
    /// the controller did in between explains PV without any stem, so that a bound from such rows is too low.
    pub fn apart(&self) -> Option<NotIdentifiable> {
        let Apart { share, .. } = self.read_apart;
        let is_too_far = self.read_apart.is_too_far(self.decimation, self.reading);
        is_too_far.then_some(NotIdentifiable::ReadApart { share })
    }

    /// The quantile of OP's steps by which the interval of f is widened, where the controller may have acted between two samples
    /// that say nothing of it: where its scans are not seen, or OP and PV were read apart. OP at a turn, or at the time of PV, is
    /// then as far from what was read as OP moves from one row to the next where it moves fast.
    pub fn unseen_moves(&self) -> Option<f64> {
        let unseen = self.acquisition.as_ref().is_some_and(|found| found.unseen_scans());
        (unseen || self.apart().is_some()).then_some(self.reading.fast)
    }

    /// Why the record says nothing of the rows that were asked for: too many repeat a reading, and each would count as evidence.
    pub fn too_close(&self) -> Option<NotIdentifiable> {
        let carried = self.carried.filter(|carried| carried.is_too_much(self.decimation, self.reading))?;
        Some(NotIdentifiable::TsTooShort { ts: carried.ts, samples_s: carried.samples_s })
    }
}

/// What the denoising stage did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Denoise {
    /// True when the soft threshold was applied.
    pub applied: bool,
    /// Noise sd of OP as a share of its sd (-).
    pub noise_share: f64,
}
