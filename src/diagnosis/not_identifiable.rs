//! Why a record says nothing about the valve: the reasons, their machine-readable codes, and the sentence that an operator reads.

use super::history_kind::HistoryKind;
use crate::signal::{Role, beside, figures, moment, share as told_share};
use std::fmt;

/// Fewest large extrema of OP in the window: those of two periods.
pub(super) const LEAST_EXTREMA: usize = 4;

/// Why friction may hide although the record would exclude it otherwise, in a sentence.
pub fn beyond_samples() -> &'static str {
    "OP tells more of PV than the samples of PV do"
}

/// The reason of the verdict `not_identifiable`.
#[derive(Clone, Debug, PartialEq)]
pub enum NotIdentifiable {
    /// There are fewer usable samples than a diagnosis needs.
    TooShort {
        /// Usable samples.
        n: usize,
        /// Samples needed.
        need: usize,
    },
    /// The stamps give no sample period: they are all equal, or not finite.
    NoTimeBase,
    /// More samples are missing or bad than is allowed, or too few good ones are left together.
    Gaps {
        /// Share missing (0..1).
        share: f64,
    },
    /// OP or PV is silent, so the samples that are kept say nothing of the loop as it is now. The scheduler, which has a clock,
    /// finds it.
    Silent {
        /// Which of the two.
        tag: Role,
        /// Stamp of its last good sample (s).
        since: f64,
    },
    /// OP and PV are read at different times. The controller acts in between, which hides the stem.
    ReadApart {
        /// Share of the rows whose OP and PV were read apart (0..1).
        share: f64,
    },
    /// An archive left too little of the record: the rest was not measured, or OP and PV are not known together.
    Compressed {
        /// What the archive did.
        kind: HistoryKind,
        /// Share that is missing (0..1): of PV where lines were drawn, else of the rows with OP and PV.
        share: f64,
    },
    /// OP answers a PV that is recorded later. The controller's inverse explains PV then, which hides the stem.
    PvLate {
        /// Share of the record in which OP shows it (0..1).
        share: f64,
        /// Time by which PV is recorded late, about (s).
        late_s: f64,
    },
    /// The configured period of the rows is shorter than the interval of the samples, so rows would repeat a measurement.
    TsTooShort {
        /// The configured period (s).
        ts: f64,
        /// The interval of the samples, the longer of OP's and PV's (s).
        samples_s: f64,
    },
    /// OP does not move.
    FlatOp,
    /// PV does not move for most of the window, or its source marks it as stale.
    FlatPv,
    /// OP is at a limit for too much of the window.
    Saturated {
        /// Share at a limit (0..1).
        share: f64,
    },
    /// The loop is never in automatic for long enough at a time.
    Manual {
        /// Share of the time in automatic (0..1).
        share_auto: f64,
    },
    /// The mode cannot be read, so the loop is not known to be in automatic for long enough at a time.
    ModeUnknown {
        /// Share of the time with an unknown mode (0..1).
        share: f64,
    },
    /// OP reverses too seldom, or by too little, for friction to show.
    NotExcited {
        /// Number of reversals of OP that are larger than its noise.
        reversals: usize,
    },
    /// The oscillation has too few samples in a period, so another oscillation is seen in its place (aliasing).
    Undersampled {
        /// Samples in one period; the samples of one running mean count as one.
        samples: f64,
        /// The longest interval of polls that is short enough (s); `None` where only the running mean makes the samples too few.
        poll_s: Option<f64>,
        /// Length of the running mean (s), where PV is one.
        mean_s: Option<f64>,
    },
    /// A term of write-back acted. It hides friction, so friction that does not show may be there.
    Compensated,
    /// Friction up to the largest that was tried could be hidden.
    HiddenFriction {
        /// Largest reversal of OP, in words.
        reversal: String,
        /// Largest S, dead band plus stick band, that was tried, in words; `None` where there is none.
        friction: Option<String>,
        /// Least and largest S that the record excludes all the same, in words: less friction could be hidden, and more.
        excluded: Option<[String; 2]>,
        /// Whether it is hidden because OP tells more of PV than its samples do: OP then predicts PV without moving it.
        unrecorded: bool,
    },
    /// Friction is likelier than not, but its evidence is not enough for a verdict, or samples that were not fitted contradict it, or
    /// its f may be 0.
    Undecided {
        /// Evidence for friction (twice the logarithm of its odds), and how much of it a verdict needs (-).
        evidence: [f64; 2],
        /// Whether the held-out samples are likelier without it.
        contradicted: bool,
        /// The largest f that may be there, in words.
        most: String,
        /// Whether that bound is as large as it is because OP tells of PV beyond its samples.
        unrecorded: bool,
    },
    /// OP moves, and PV does not respond visibly beside its other influences: a large load, a valve that is always stuck, or a
    /// valve of another loop.
    NoResponse,
    /// Friction predicts PV better than no friction does, but PV does not follow the stem significantly, or moves against it
    /// beside OP.
    /// A load that jumps looks like this.
    StemNotFollowed,
    /// Values too large or too small to compute with.
    OutOfScale,
    /// The deadline of the run passed, or the run was asked to stop.
    DeadlineExceeded,
}

impl NotIdentifiable {
    /// Every [`NotIdentifiable::code`].
    pub const CODES: [&str; 21] = [
        "too_short",
        "no_time_base",
        "gaps",
        "silent",
        "read_apart",
        "compressed",
        "ts_too_short",
        "flat_op",
        "flat_pv",
        "saturated",
        "manual",
        "mode_unknown",
        "not_excited",
        "undersampled",
        "compensated",
        "hidden_friction",
        "undecided",
        "no_response",
        "stem_not_followed",
        "out_of_scale",
        "deadline_exceeded",
    ];

    /// The stable, machine-readable name of the reason.
    pub fn code(&self) -> &'static str {
        match self {
            Self::TooShort { .. } => "too_short",
            Self::NoTimeBase => "no_time_base",
            Self::Gaps { .. } => "gaps",
            Self::Silent { .. } => "silent",
            // To whoever counts reasons it is the same: OP and PV of a row are not of one time.
            Self::ReadApart { .. } | Self::PvLate { .. } => "read_apart",
            Self::Compressed { .. } => "compressed",
            Self::TsTooShort { .. } => "ts_too_short",
            Self::FlatOp => "flat_op",
            Self::FlatPv => "flat_pv",
            Self::Saturated { .. } => "saturated",
            Self::Manual { .. } => "manual",
            Self::ModeUnknown { .. } => "mode_unknown",
            Self::NotExcited { .. } => "not_excited",
            Self::Undersampled { .. } => "undersampled",
            Self::Compensated => "compensated",
            Self::HiddenFriction { .. } => "hidden_friction",
            Self::Undecided { .. } => "undecided",
            Self::NoResponse => "no_response",
            Self::StemNotFollowed => "stem_not_followed",
            Self::OutOfScale => "out_of_scale",
            Self::DeadlineExceeded => "deadline_exceeded",
        }
    }
}

impl fmt::Display for NotIdentifiable {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooShort { n, need } => write!(out, "too short: {n} usable samples, {need} needed"),
            Self::NoTimeBase => write!(out, "no time base: the stamps give no sampling period"),
            Self::Gaps { share } => {
                let missing = told_share(*share, 0);
                write!(
                    out,
                    "gaps: {missing} of the samples are missing or bad: too many, or too few are left together"
                )
            }
            Self::Silent { tag, since } => {
                let tag = tag.as_str().to_uppercase();
                write!(out, "silent: no good sample of {tag} since {}", moment(*since))
            }
            Self::ReadApart { share } => write!(
                out,
                "read apart: OP and PV are not read at the same time in {} of the rows, and the controller acts in between: read both in one \
                 request",
                told_share(*share, 0)
            ),
            Self::PvLate { share, late_s } => write!(
                out,
                "read apart: OP answers a PV that is recorded about {} s later, in {} of the record: stamp PV when the controller reads \
                 it",
                figures(*late_s),
                told_share(*share, 0)
            ),
            Self::Compressed { kind, share } => told_compressed(out, *kind, *share),
            Self::TsTooShort { ts, samples_s } => write!(
                out,
                "ts too short: rows every {ts} s were asked for, but there is a sample of both tags only every {samples_s} s, and nothing \
                 is known in between: set ts to {samples_s} or more, or leave it out",
                ts = figures(*ts),
                samples_s = figures(*samples_s)
            ),
            Self::FlatOp => write!(out, "flat OP: the controller output does not move"),
            Self::FlatPv => write!(
                out,
                "flat PV: the process variable stands still for most of the window, or its source marks it as stale"
            ),
            Self::Saturated { share } => {
                write!(out, "saturated: OP at a limit for {} of the window", told_share(*share, 0))
            }
            Self::Manual { share_auto } if *share_auto == 0.0 => write!(out, "manual: never in automatic"),
            Self::Manual { share_auto } => {
                write!(
                    out,
                    "manual: in automatic for {} of the window, and never for long enough at a time",
                    told_share(*share_auto, 0)
                )
            }
            Self::ModeUnknown { share } => write!(
                out,
                "mode unknown: the mode cannot be read for {} of the window, and the loop is not known to be in automatic for long \
                 enough at a time",
                told_share(*share, 0)
            ),
            Self::NotExcited { reversals: 0 } => {
                write!(
                    out,
                    "not excited: OP never reverses by more than its noise, so that friction cannot show"
                )
            }
            Self::NotExcited { reversals } if *reversals < LEAST_EXTREMA => {
                let times = if *reversals == 1 { "once".to_string() } else { format!("{reversals} times") };
                write!(
                    out,
                    "not excited: OP reverses only {times} by more than its noise, too seldom for friction to show"
                )
            }
            Self::NotExcited { reversals } => write!(
                out,
                "not excited: OP reverses {reversals} times by more than its noise, but hardly ever by enough for friction to show"
            ),
            Self::Undersampled { samples, poll_s, mean_s } => {
                write!(out, "undersampled: {samples:.1} samples per period, ten are needed: ")?;
                let poll = poll_s.map(|poll_s| format!("poll at least every {} s", rounded_down(poll_s)));
                let mean = mean_s.map(|mean_s| {
                    let mean_s = figures(mean_s);
                    format!("PV is a running mean over {mean_s} s, which counts as one sample: keep no means")
                });
                write!(out, "{}", poll.into_iter().chain(mean).collect::<Vec<_>>().join("; "))
            }
            Self::Compensated => {
                write!(out, "compensated: a term of write-back acted, and hides the friction that is left")
            }
            Self::HiddenFriction { reversal, friction, excluded, unrecorded } => {
                let which = match (friction, excluded) {
                    (Some(s), Some([low, high])) => format!(
                        "friction of S = {low} to {high} is excluded, but less, or more up to S = {s}, could be hidden"
                    ),
                    (Some(s), None) => {
                        format!("friction of any size that was tried, up to S = {s}, could be hidden")
                    }
                    (None, _) => "friction would not show".to_string(),
                };
                let beside = match unrecorded {
                    true => format!(
                        ", because {}; if the controller acts between them, read OP and PV at each of its scans, or change the set point a few times",
                        beyond_samples()
                    ),
                    false => " beside what else moves PV".to_string(),
                };
                write!(out, "hidden friction: {which}{beside}; OP never reverses by more than {reversal}")
            }
            Self::Undecided { evidence: [evidence, needed], contradicted, most, unrecorded } => {
                let told = beside(*evidence, &[0.0, *needed], 0);
                let lacks = match (evidence > needed, contradicted) {
                    (false, _) => format!("but with evidence {told} of {needed} only"),
                    (true, true) => {
                        format!("evidence {told}, but the last fifth of the samples speaks against it")
                    }
                    (true, false) => format!("evidence {told}, but f may be 0"),
                };
                let beside =
                    if *unrecorded { format!(", because {}", beyond_samples()) } else { String::new() };
                // Each reversal of OP that is larger than S shows the stem once more.
                write!(
                    out,
                    "undecided: friction is likelier than not, {lacks}; f is between 0 and {most}{beside}; a record with more or larger reversals of \
                     OP would decide"
                )
            }
            Self::NoResponse => {
                write!(out, "no response: other influences on PV hide whether PV follows OP")
            }
            Self::StemNotFollowed => write!(
                out,
                "stem not followed: a stem with friction predicts PV better, but PV does not visibly follow that stem; a load that jumps \
                 looks so"
            ),
            Self::OutOfScale => write!(out, "out of scale: values too large or too small to compute with"),
            Self::DeadlineExceeded => write!(out, "deadline exceeded before the fit was done"),
        }
    }
}

/// The sentence of [`NotIdentifiable::Compressed`]: what the archive did, what it leaves, and the remedy.
fn told_compressed(out: &mut fmt::Formatter<'_>, kind: HistoryKind, share: f64) -> fmt::Result {
    let share = told_share(share, 0);
    let (did, remedy) = match kind {
        HistoryKind::Interpolated => {
            return write!(
                out,
                "compressed: an archive drew straight lines between the few samples it kept, and at least {share} of PV was not \
                 measured: export raw values, and keep OP and PV without compression"
            );
        }
        HistoryKind::Exception => (
            "only changes beyond a dead band were kept",
            "set the dead band of both tags to 0, or export raw values",
        ),
        HistoryKind::SwingingDoor | HistoryKind::Held | HistoryKind::Averaged => (
            "an archive dropped the samples that a straight line replaces",
            "keep OP and PV without compression, or export raw values",
        ),
    };
    write!(
        out,
        "compressed: {did}, so that OP and PV are not known at the same time in {share} of the rows: {remedy}"
    )
}

/// A time (s) rounded down to two figures; 0 where it is not positive and finite.
fn rounded_down(seconds: f64) -> f64 {
    if !(seconds.is_finite() && seconds > 0.0) {
        return 0.0;
    }
    let digits = 1 - seconds.log10().floor() as i32;
    // The factor is a whole number, so that two figures stay two.
    let unit = 10_f64.powi(digits.abs());
    if digits >= 0 { (seconds * unit).floor() / unit } else { (seconds / unit).floor() * unit }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_reversals_are_too_seldom_and_many_are_too_small() {
        let said = |reversals| NotIdentifiable::NotExcited { reversals }.to_string();
        let seldom = |times: &str| {
            format!(
                "not excited: OP reverses only {times} by more than its noise, too seldom for friction to show"
            )
        };
        assert_eq!([said(1), said(3)], [seldom("once"), seldom("3 times")]);
        let small = "but hardly ever by enough for friction to show";
        assert_eq!(said(4), format!("not excited: OP reverses 4 times by more than its noise, {small}"));
    }

    #[test]
    fn what_an_undecided_record_lacks_is_told() {
        let by = |evidence: f64, contradicted: bool, unrecorded: bool| {
            let (evidence, most) = ([evidence, 20.0], "3.717 % OP".to_string());
            NotIdentifiable::Undecided { evidence, contradicted, most, unrecorded }.to_string()
        };
        let of = |evidence: f64, contradicted: bool| by(evidence, contradicted, false);
        let said = |evidence: f64| of(evidence, false);
        let lacks = |told: &str| {
            format!(
                "undecided: friction is likelier than not, but with evidence {told} of 20 only; f is between 0 and 3.717 % OP; a record \
                 with more or larger reversals of OP would decide"
            )
        };
        // The evidence is told on its side of 0 and of what is needed.
        assert_eq!([17.1, 19.96, 0.2].map(said), ["17", "19.96", "0.2"].map(lacks));
        assert_eq!(of(17.1, true), lacks("17"));
        assert_eq!(
            said(25.3),
            "undecided: friction is likelier than not, evidence 25, but f may be 0; f is between 0 and 3.717 % OP; a record with more or \
             larger reversals of OP would decide"
        );
        let against = "evidence 25, but the last fifth of the samples speaks against it; f is between";
        assert!(of(25.3, true).contains(against), "{}", of(25.3, true));
        let hidden =
            "f is between 0 and 3.717 % OP, because OP tells more of PV than the samples of PV do; a record";
        assert!(by(25.3, false, true).contains(hidden), "{}", by(25.3, false, true));
    }

    fn hidden(friction: Option<String>, excluded: Option<[String; 2]>, unrecorded: bool) -> String {
        let reversal = "11.5 % OP".to_string();
        NotIdentifiable::HiddenFriction { reversal, friction, excluded, unrecorded }.to_string()
    }

    #[test]
    fn friction_that_hides_beyond_the_samples_has_a_remedy() {
        assert_eq!(
            hidden(Some("0.888 % OP".into()), None, true),
            "hidden friction: friction of any size that was tried, up to S = 0.888 % OP, could be hidden, because OP tells more of PV than \
             the samples of PV do; if the controller acts between them, read OP and PV at each of its scans, or change the set point a few times; OP never reverses by more \
             than 11.5 % OP"
        );
    }

    #[test]
    fn what_was_tried_is_told_apart_from_what_op_did() {
        let said = |friction: Option<&str>, excluded: Option<[&str; 2]>| {
            let (friction, excluded) =
                (friction.map(str::to_string), excluded.map(|ends| ends.map(str::to_string)));
            hidden(friction, excluded, false)
        };
        let end = "beside what else moves PV; OP never reverses by more than 11.5 % OP";
        assert_eq!(
            said(Some("0.888 % OP"), None),
            format!(
                "hidden friction: friction of any size that was tried, up to S = 0.888 % OP, could be hidden {end}"
            )
        );
        assert_eq!(
            said(Some("0.888 % OP"), Some(["0.100 % OP", "0.300 % OP"])),
            format!(
                "hidden friction: friction of S = 0.100 % OP to 0.300 % OP is excluded, but less, or more up to S = 0.888 % OP, could be \
                 hidden {end}"
            )
        );
        assert_eq!(said(None, None), format!("hidden friction: friction would not show {end}"));
    }
}
