//! How a record became the window that is fitted: what the gate and the preparation note for the report.

use super::acquisition::{Acquisition, Apart, Carried, Later, ReadingLimits};
use super::history_kind::{HistoryFound, HistoryKind};
use super::not_identifiable::NotIdentifiable;

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
    /// How far apart OP and PV of one row were read.
    pub read_apart: Apart,
    /// The configured period of the rows and the interval of the samples, where the rows are closer.
    pub carried: Option<Carried>,
    /// The limits for both.
    pub reading: ReadingLimits,
    /// Number of samples that were dropped because their stamp repeats an earlier one.
    pub duplicates: usize,
    /// Number of samples that were out of order.
    pub out_of_order: usize,
    /// Factor of the decimation behind a low pass (1: none).
    pub decimation: usize,
    /// Whether OP was denoised for its extrema, and how much noise it has.
    pub denoise: Denoise,
    /// What an archive did to the record.
    pub history: Option<Box<HistoryFound>>,
    /// Share of the fitted window at which a term of write-back was in force (0..1).
    pub compensated: f64,
    /// Least f that counts as stiction (OP unit): a share of OP's span, or of the range of OP where the span is not known.
    pub f_threshold: f64,
    /// How the record was acquired; `None` where its stamps do not say.
    pub acquisition: Option<Box<Acquisition>>,
}

impl Preparation {
    /// The reason [`NotIdentifiable::ReadApart`] where OP and PV of too many rows were read apart, [`NotIdentifiable::Compressed`] where
    /// that is an archive's doing or where it drew lines, or [`NotIdentifiable::PvLate`] where OP answers a PV that is recorded later.
    ///
    /// Such a record cannot say that a valve does not stick, nor bound f: what the controller did in between explains PV without
    /// any stem, so that a bound would be too low.
    pub fn apart(&self) -> Option<NotIdentifiable> {
        let by_values = || {
            let Later { share, rows } = self.read_apart.later;
            let is_often = share > self.reading.most_read_apart;
            let is_far = rows >= self.reading.apart * self.decimation.max(1) as f64;
            // A fitted row is `decimation` rows.
            let late_s = rows * self.ts / self.decimation.max(1) as f64;
            (is_often && is_far).then_some(NotIdentifiable::PvLate { share, late_s })
        };
        self.apart_by_stamps().or_else(by_values)
    }

    /// [`Self::apart`], as far as the stamps tell.
    pub fn apart_by_stamps(&self) -> Option<NotIdentifiable> {
        let Apart { share, .. } = self.read_apart;
        let is_too_far = self.is_drawn() || self.read_apart.is_too_far(self.decimation, self.reading);
        is_too_far.then_some(self.by_archive(NotIdentifiable::ReadApart { share }))
    }

    /// Whether an archive drew lines, so that only their ends were measured.
    pub fn is_drawn(&self) -> bool {
        self.history.as_ref().is_some_and(|found| found.kind == HistoryKind::Interpolated)
    }

    /// The reason why a record cannot be judged: [`NotIdentifiable::Compressed`] in place of missing samples that an archive left out.
    /// Other polls or another connection would not bring them back.
    pub fn by_archive(&self, reason: NotIdentifiable) -> NotIdentifiable {
        let Some(HistoryFound { kind, evidence, .. }) = self.history.as_deref().copied() else {
            return reason;
        };
        let (NotIdentifiable::Gaps { share } | NotIdentifiable::ReadApart { share }) = reason else {
            return reason;
        };
        match kind {
            HistoryKind::Interpolated => NotIdentifiable::Compressed { kind, share: evidence[0] },
            HistoryKind::Exception | HistoryKind::SwingingDoor => NotIdentifiable::Compressed { kind, share },
            HistoryKind::Held | HistoryKind::Averaged => reason,
        }
    }

    /// The quantile (0..1) of OP's steps by which the interval of f is widened, where the controller may have acted unseen
    /// between two samples: where its scans are not seen, or OP and PV were read apart.
    ///
    /// OP at a turn, or at the time of PV, may then differ from what was read by a step of OP where it moves fast.
    pub fn unseen_moves(&self) -> Option<f64> {
        let unseen = self.acquisition.as_ref().is_some_and(|found| found.unseen_scans());
        (unseen || self.apart().is_some()).then_some(self.reading.fast)
    }

    /// The reason [`NotIdentifiable::TsTooShort`] where too many rows of the configured period repeat a measurement, and each would
    /// count as evidence.
    pub fn too_close(&self) -> Option<NotIdentifiable> {
        let carried = self.carried.filter(|carried| carried.is_too_much(self.decimation, self.reading))?;
        Some(NotIdentifiable::TsTooShort { ts: carried.ts, samples_s: carried.samples_s })
    }
}

/// The result of the denoising of OP.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Denoise {
    /// Whether the soft threshold was applied.
    pub applied: bool,
    /// Noise sd of OP as a share of its sd (-).
    pub noise_share: f64,
}
