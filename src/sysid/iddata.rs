//! The record that a model is fitted on: one window, normalised, with a weight for each sample.

use super::gain_sign::gain_sign;
use super::least_squares::total;
use super::stats::{mean, normalised, sd};
use super::valve::{Start, largest_reversal};
use crate::signal::{Row, Window, along_op};

/// Longest lag of PV or the stem in any regression (samples); another tag may have a longer one.
pub const LONGEST_LAG: usize = 16;
/// Rows between the start of the stem and the first fitted row: no lag reaches before that start, where the stem is a guess.
const LEAD: usize = 2 * LONGEST_LAG;
/// Share of the rows that is fitted; the rest is read after the selection has ended, to reject effects and for the published
/// errors.
pub const FITTED_SHARE: f64 = 0.8;
/// Fewest rows that are fitted.
const LEAST_FITTED: usize = 120;

/// A window, normalised: deviations from the means, in standard deviations.
#[derive(Clone, Debug, Default)]
pub struct IdData {
    /// OP (standard deviations of OP).
    pub u: Vec<f64>,
    /// PV (standard deviations of PV).
    pub y: Vec<f64>,
    /// 1 where PV counts, 0 where it is missing or doubtful.
    pub weight: Vec<f64>,
    /// Whether PV is right although its weight is 0; then its prediction does not take its place.
    pub known: Vec<bool>,
    /// Set point, normalised as PV is.
    pub sp: Option<Vec<f64>>,
    /// Other tags by name, each normalised by its own mean and standard deviation.
    pub tags: Vec<(String, Vec<f64>)>,
    /// Whether OP is a second input, `D(q) u`, beside a stem that sticks. With a feed-forward or a slow controller, OP reacts to
    /// loads before PV shows them. A stem without friction is OP itself and needs no such term.
    pub direct: bool,
    /// What OP tells of PV beyond its samples ([`super::unrecorded`]): inputs beside the stem, each with one value a row.
    pub unrecorded: Vec<Vec<f64>>,
    /// Sign of the process gain, +1 or -1, where OP shows it ([`super::gain_sign`]).
    pub gain_sign: Option<f64>,
    /// The extremum of OP at which stems start.
    pub start: Start,
    /// First fitted row.
    pub first: usize,
    /// First row after the fitted ones: from here on samples are held out.
    pub split: usize,
    /// Largest f at which the stem turns (standard deviations of OP): half the largest reversal of OP.
    pub f_max: f64,
    /// Least scale of the errors (standard deviations of PV): that of rounding PV to its steps; 0 where PV has none.
    pub least_scale: f64,
    /// How a PV that was recorded late was moved back in this record; `None` where it was not.
    pub pv_moved: Option<PvMoved>,
    /// Means and standard deviations, to convert back to the plant's units.
    pub units: Units,
}

/// How a PV that was recorded late was moved back.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PvMoved {
    /// The time by which it was recorded late at most (s).
    pub late_s: f64,
    /// Whether OP follows exactly from the moved PV of its row and before. Else OP may still tell of a PV that is to come.
    pub is_right: bool,
    /// Whether it may be later than any lateness that was tried.
    pub perhaps_later: bool,
}

/// Means and scales of a normalised window.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Units {
    /// Time of the first sample (s).
    pub t0: f64,
    /// Sample period (s).
    pub ts: f64,
    /// Mean of OP (OP unit).
    pub u0: f64,
    /// Standard deviation of OP (OP unit).
    pub u: f64,
    /// Mean of PV (PV unit).
    pub y0: f64,
    /// Standard deviation of PV (PV unit).
    pub y: f64,
    /// The span of OP, where it is known (OP unit).
    pub span: Option<f64>,
}

impl Units {
    /// A distance along OP (OP unit) as sentences for operators say it: in per cent of the span, where that is known.
    pub fn along_op(&self, distance: f64) -> String {
        along_op(distance, self.span)
    }
}

impl IdData {
    /// Normalises a window whose stems start at `start`.
    ///
    /// `None` where OP or PV does not move, or where fewer than `LEAST_FITTED` rows would be fitted.
    pub fn new(window: &Window, start: Start) -> Option<Self> {
        let n = window.len();
        let units = Units {
            t0: window.t0,
            ts: window.ts,
            u0: mean(&window.op),
            u: sd(&window.op),
            y0: mean(&window.pv),
            y: sd(&window.pv),
            span: None,
        };
        let usable = |x: f64| x.is_finite() && x > 0.0;
        let first = start.index + LEAD;
        let split = first + ((n.checked_sub(first)?) as f64 * FITTED_SHARE) as usize;
        if !(usable(units.u) && usable(units.y)) || split < first + LEAST_FITTED {
            return None;
        }
        let tags = window.tags.iter().filter_map(|(name, v)| {
            let spread = sd(v);
            (v.len() == n && usable(spread)).then(|| (name.clone(), normalised(v, mean(v), spread)))
        });
        let u = normalised(&window.op, units.u0, units.u);
        let sp = window.sp.as_ref().filter(|sp| sp.len() == n).map(|sp| normalised(sp, units.y0, units.y));
        let y = normalised(&window.pv, units.y0, units.y);
        Some(Self {
            weight: (0..n).map(|k| f64::from(u8::from(window.row(k) == Row::Counts))).collect(),
            known: (0..n).map(|k| window.row(k) == Row::Silent).collect(),
            gain_sign: gain_sign(&u, &y, sp.as_deref(), |k| window.row(k) == Row::Counts),
            y,
            sp,
            tags: tags.collect(),
            direct: false,
            unrecorded: Vec::new(),
            start,
            first,
            split,
            f_max: largest_reversal(&u, start),
            least_scale: 0.0,
            pv_moved: None,
            units,
            u,
        })
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.y.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.y.is_empty()
    }

    /// The fitted rows.
    pub fn rows(&self) -> std::ops::Range<usize> {
        self.first..self.split
    }

    /// The number of fitted rows that count.
    pub fn counted(&self) -> f64 {
        total(&self.weight[self.rows()])
    }

    /// The time of sample `k` (s).
    pub fn time(&self, k: f64) -> f64 {
        self.units.t0 + k * self.units.ts
    }
}
