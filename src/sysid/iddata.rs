//! The record that a model is fitted on: one window, normalised, with a weight for each sample.

use super::gain_sign::gain_sign;
use super::stats::{mean, normalised, sd};
use super::valve::{Start, largest_reversal};
use crate::signal::{Row, Window, along_op};

/// Longest lag of PV or the stem in any regression (samples); a tag may be later.
pub const LONGEST_LAG: usize = 16;
/// Rows before the first that is fitted: no lag reaches before the start of the stem, whose first samples are guessed.
const LEAD: usize = 2 * LONGEST_LAG;
/// Share of the rows that is fitted on; the rest is read after a selection has ended, to reject effects and for the published errors.
pub const FITTED_SHARE: f64 = 0.8;
/// Fewest rows that are fitted on.
const LEAST_FITTED: usize = 120;

/// A window as deviations from its means, in units of its standard deviations.
#[derive(Clone, Debug, Default)]
pub struct IdData {
    /// OP.
    pub u: Vec<f64>,
    /// PV.
    pub y: Vec<f64>,
    /// 1 where PV counts, 0 where it is missing or doubtful.
    pub weight: Vec<f64>,
    /// Where PV is right although its weight is 0: its prediction does not take its place.
    pub known: Vec<bool>,
    /// Set point, scaled as PV is.
    pub sp: Option<Vec<f64>>,
    /// Other tags by name, each normalised.
    pub tags: Vec<(String, Vec<f64>)>,
    /// Whether OP acts beside a stem that sticks, `D(q) u`: with a feed-forward or a slow controller, OP tells of loads before
    /// PV shows them. A stem that follows OP needs no such term: it is OP.
    pub direct: bool,
    /// Sign of the process gain, where the controller tells it (see [`super::gain_sign`]).
    pub gain_sign: Option<f64>,
    /// Where stems start.
    pub start: Start,
    /// First row of a fit.
    pub first: usize,
    /// First row that no fit sees.
    pub split: usize,
    /// Half the largest reversal of OP: with a larger f the stem never turns.
    pub f_max: f64,
    /// Least scale of errors: that of rounding PV to its steps; 0 where it has none.
    pub least_scale: f64,
    /// What turns normalised numbers into those of the plant.
    pub units: Units,
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
    /// OP units in one.
    pub u: f64,
    /// Mean of PV (PV unit).
    pub y0: f64,
    /// PV units in one.
    pub y: f64,
    /// The span of OP, where it is known (OP unit).
    pub span: Option<f64>,
}

impl Units {
    /// A distance along OP as sentences say it: in per cent of the span where that is known.
    pub fn along_op(&self, distance: f64) -> String {
        along_op(distance, self.span)
    }
}

impl IdData {
    /// Normalises a window whose stems start at `start`; `None` where OP or PV do not move or too few rows are left.
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
            start,
            first,
            split,
            f_max: largest_reversal(&u, start),
            least_scale: 0.0,
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

    /// Rows that are fitted on.
    pub fn rows(&self) -> std::ops::Range<usize> {
        self.first..self.split
    }

    /// How many of them count.
    pub fn counted(&self) -> f64 {
        self.weight[self.rows()].iter().sum()
    }

    /// The time of sample `k` (s).
    pub fn time(&self, k: f64) -> f64 {
        self.units.t0 + k * self.units.ts
    }
}
