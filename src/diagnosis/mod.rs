//! The diagnosis of one loop, pure: `gate -> region -> denoise -> search over f (friction + armax) ->
//! evidence -> verdict`. No clock, no files, no randomness: the same record gives the same diagnosis.

pub mod acquisition;
pub mod armax;
mod config;
pub mod confirmed;
pub mod denoise;
pub mod evidence;
pub mod explore;
pub mod friction;
pub mod gate;
pub mod grid;
pub mod history_kind;
pub mod packed;
mod preparation;
pub mod prepare;
pub mod region;
pub mod rivals;
pub mod screen;
pub mod search;
mod undersampling;
pub mod validation;
pub mod verdict;

pub use acquisition::{Acquisition, Apart, Carried, ReadingLimits};
pub use config::Config;
pub use history_kind::{HistoryFound, HistoryKind};
pub use preparation::{Denoise, Preparation};
pub use verdict::diagnose;

pub use crate::sysid::valve::model_error::{with_model_error, without_model_error};

use crate::signal::{Role, Window, figures, moment};
use rivals::Rival;
use std::fmt;

/// Thresholds and sizes of a diagnosis; the defaults are what every published result uses.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Least f that counts as stiction (% of OP span).
    pub f_threshold: f64,
    /// Least evidence `delta_aic` that counts as stiction (-).
    pub evidence_threshold: f64,
    /// Samples taken from the most regular stretch.
    pub window_samples: usize,
    /// Fewest samples a diagnosis is tried on.
    pub min_samples: usize,
    /// Largest share of samples that may be missing or bad (0..1).
    pub max_gap_share: f64,
    /// Sample period to resample to (s); `None` takes the controller's scan where the record shows it, else the period of the
    /// stamps.
    pub ts: Option<f64>,
    /// Longest process delay searched (samples).
    pub max_delay: usize,
    /// By which limits OP and PV count as read together.
    pub reading: ReadingLimits,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            f_threshold: 0.05,
            evidence_threshold: 20.0,
            window_samples: 1000,
            min_samples: 200,
            max_gap_share: 0.5,
            ts: None,
            max_delay: 10,
            reading: ReadingLimits::default(),
        }
    }
}

/// Why nothing can be said about the valve.
#[derive(Clone, Debug, PartialEq)]
pub enum NotIdentifiable {
    /// Fewer usable samples than the settings ask for.
    TooShort {
        /// Usable samples.
        n: usize,
        /// Samples needed.
        need: usize,
    },
    /// The stamps give no sampling period (all equal, or not finite).
    NoTimeBase,
    /// More missing or bad samples than allowed, or too few good ones left together.
    Gaps {
        /// Share missing (0..1).
        share: f64,
    },
    /// OP or PV is silent: what is remembered says nothing of the loop as it is now. The scheduler finds it, which has a clock.
    Silent {
        /// Which of the two.
        tag: Role,
        /// Stamp of its last good sample (s).
        since: f64,
    },
    /// OP and PV are not read together: the controller acts between the two, and no stem can be told beside that.
    ReadApart {
        /// Share of the rows that are no reading of both (0..1).
        share: f64,
    },
    /// Rows closer than the samples were asked for: what stands between two samples is no measurement.
    TsTooShort {
        /// The sample period that was asked for (s).
        ts: f64,
        /// The interval of the samples, of OP's or PV's the longer (s).
        samples_s: f64,
    },
    /// OP does not move.
    FlatOp,
    /// PV stands still for most of the window, or its source marks it as stale.
    FlatPv,
    /// OP sits at a limit for too much of the window.
    Saturated {
        /// Share at a limit (0..1).
        share: f64,
    },
    /// The loop is never in automatic for long enough at a time.
    Manual {
        /// Share of the time in automatic (0..1).
        share_auto: f64,
    },
    /// The mode cannot be read, so that the loop is not known to be in automatic for long enough at a time.
    ModeUnknown {
        /// Share of the time at which the mode is not known (0..1).
        share: f64,
    },
    /// OP reverses too seldom or by too little to say anything about friction.
    NotExcited {
        /// Reversals of OP larger than its noise.
        reversals: usize,
    },
    /// The oscillation has too few samples a period: another one is seen in its place.
    Undersampled {
        /// Samples in one period; those of a running mean count as one.
        samples: f64,
        /// The slowest poll that would do (s); `None` where a running mean alone leaves too few.
        poll_s: Option<f64>,
        /// Over how much time the running mean is, where PV is one (s).
        mean_s: Option<f64>,
    },
    /// A term of write-back acted: it hides the friction, so that none to be seen says nothing.
    Compensated,
    /// Friction would not have shown, whatever its size.
    HiddenFriction {
        /// Largest reversal of OP, as sentences say it.
        reversal: String,
    },
    /// OP moves, and no response of PV shows beside what else moves it: a large load, a valve that is stuck throughout, or not
    /// this loop's valve.
    NoResponse,
    /// Friction predicts PV better than none, but PV is not seen to follow the stem that it would give, or moves against it beside
    /// OP: a load that jumps looks so.
    StemNotFollowed,
    /// Values too large or too small to compute with.
    OutOfScale,
    /// The run's deadline passed or it was asked to stop.
    DeadlineExceeded,
}

impl NotIdentifiable {
    /// Every [`NotIdentifiable::code`].
    pub const CODES: [&str; 19] = [
        "too_short",
        "no_time_base",
        "gaps",
        "silent",
        "read_apart",
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
            Self::ReadApart { .. } => "read_apart",
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
                let share = share * 100.0;
                write!(
                    out,
                    "gaps: {share:.0} % of the samples are missing or bad: too many, or too few are left together"
                )
            }
            Self::Silent { tag, since } => {
                let tag = tag.as_str().to_uppercase();
                write!(out, "silent: no good sample of {tag} since {}", moment(*since))
            }
            Self::ReadApart { share } => write!(
                out,
                "read apart: OP and PV are not read at the same time in {:.0} % of the rows, and the controller acts in between: read both \
                 in one request",
                share * 100.0
            ),
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
                write!(out, "saturated: OP at a limit for {:.0} % of the window", share * 100.0)
            }
            Self::Manual { share_auto } if *share_auto == 0.0 => write!(out, "manual: never in automatic"),
            Self::Manual { share_auto } => {
                write!(
                    out,
                    "manual: in automatic for {:.0} % of the window, and never for long enough at a time",
                    share_auto * 100.0
                )
            }
            Self::ModeUnknown { share } => write!(
                out,
                "mode unknown: the mode cannot be read for {:.0} % of the window, and the loop is not known to be in automatic for long \
                 enough at a time",
                share * 100.0
            ),
            Self::NotExcited { reversals } => {
                let times = if *reversals == 1 { "time" } else { "times" };
                write!(
                    out,
                    "not excited: OP reverses {reversals} {times} by more than its noise, but hardly ever by enough for friction to show"
                )
            }
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
            Self::HiddenFriction { reversal } => write!(
                out,
                "hidden friction: OP never reverses by more than {reversal}, and friction would not show beside what \
                 else moves PV"
            ),
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

/// To two figures, never upwards.
fn rounded_down(seconds: f64) -> f64 {
    if !(seconds.is_finite() && seconds > 0.0) {
        return 0.0;
    }
    let digits = 1 - seconds.log10().floor() as i32;
    // Multiplied or divided by a whole number, so that two figures stay two.
    let unit = 10_f64.powi(digits.abs());
    if digits >= 0 { (seconds * unit).floor() / unit } else { (seconds / unit).floor() * unit }
}

/// What the data says about the valve.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// f above its threshold, evidence above its own, and 0 outside the interval of f. The diagnosis also asks for a steady gain,
    /// tracing also that PV follows the stem.
    Stiction,
    /// OP moved enough for friction to show, and stiction is not told: no friction is needed, or f is too small to matter, or its
    /// interval reaches 0. Evidence for friction may still be large.
    NoStiction,
    /// The data cannot tell, and why: never the same as healthy.
    NotIdentifiable(NotIdentifiable),
}

impl Verdict {
    /// The verdict as the report writes it.
    pub fn as_str(&self) -> &'static str {
        match self {
            Self::Stiction => "stiction",
            Self::NoStiction => "no_stiction",
            Self::NotIdentifiable(_) => "not_identifiable",
        }
    }
}

/// The most regular oscillation found in OP.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Oscillation {
    /// Mean period (s).
    pub period: f64,
    /// `r = mean(T) / (3 sd(T))` (-); above 1 is regular.
    pub regularity_r: f64,
    /// Half the mean peak-to-trough height of OP (OP unit).
    pub op_amplitude: f64,
}

/// The linear part `A(q) y = B(q) x + C(q) e` at the estimate.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// Order of A.
    pub na: usize,
    /// Number of coefficients in B.
    pub nb: usize,
    /// Order of C.
    pub nc: usize,
    /// Delay (samples): `B(q) = b1 q^-nk + … + b_nb q^-(nk+nb-1)`.
    pub nk: usize,
    /// `a1..a_na`.
    pub a: Vec<f64>,
    /// `b1..b_nb`.
    pub b: Vec<f64>,
    /// `c1..c_nc`.
    pub c: Vec<f64>,
    /// Root mean square of the prediction error (PV unit).
    pub rmse: f64,
}

/// One point of the profile over f.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurvePoint {
    /// Friction (OP unit).
    pub f: f64,
    /// AIC at that f, less the AIC at the estimate (-).
    pub aic: f64,
}

/// f and how sure it is.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// Friction parameter, S/2 (OP unit).
    pub f: f64,
    /// 95 % interval of f: that of the profile likelihood, with the error of the valve models (OP unit).
    pub f_ci95: [f64; 2],
    /// f as a share of OP's range in the window (-).
    pub f_of_op_range: f64,
    /// Evidence against the best explanation without friction (-).
    pub delta_aic: f64,
    /// That explanation.
    pub rival: Rival,
    /// How evenly the record shares the gain: its block mean in standard errors (-).
    pub steadiness: f64,
    /// Largest f tried (OP unit).
    pub f_max: f64,
    /// Srinivasan's d of the same window, for comparison (OP unit).
    pub d: f64,
    /// AIC over f, by increasing f.
    pub curve: Vec<CurvePoint>,
    /// The linear part at f.
    pub model: Model,
    /// The valve position that f implies, one value per window sample (OP unit).
    pub mv: Vec<f64>,
}

/// How well a model predicts PV (PV unit). Both errors are of samples that no coefficient was fitted to: the last 30 % of the window
/// in a diagnosis, whose f, orders and delay come from the whole of it, and the last 20 % of the fitted record in tracing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// Ljung–Box does not reject whiteness, of the residual of all samples that count, fitted ones too.
    pub white: bool,
    /// Root mean square one-step-ahead error on held-out data.
    pub one_step_rmse: f64,
    /// Root mean square free-run (simulation) error on held-out data.
    pub free_run_rmse: f64,
}

/// Everything a diagnosis found.
#[derive(Clone, Debug, PartialEq)]
pub struct Diagnosis {
    /// The verdict.
    pub verdict: Verdict,
    /// The verdict in one line, with the numbers it rests on.
    pub reason: String,
    /// How the record was prepared; default when it never became a window.
    pub preparation: Preparation,
    /// The oscillation of OP, where one was found.
    pub oscillation: Option<Oscillation>,
    /// f and its evidence; `None` only when not identifiable.
    pub estimate: Option<Estimate>,
    /// The residual of the model; `None` when not identifiable.
    pub residual: Option<Residual>,
    /// The window that was fitted; `None` when the record never became one.
    pub window: Option<Window>,
    /// That window, once the diagnosis is kept only to be looked at; see [`Diagnosis::pack`].
    pub packed: Option<Box<packed::PackedWindow>>,
}

impl Diagnosis {
    /// A verdict and its reason, with nothing behind it: no window was fitted.
    pub fn bare(verdict: Verdict, reason: impl Into<String>) -> Self {
        Self {
            verdict,
            reason: reason.into(),
            preparation: Preparation::default(),
            oscillation: None,
            estimate: None,
            residual: None,
            window: None,
            packed: None,
        }
    }
}
