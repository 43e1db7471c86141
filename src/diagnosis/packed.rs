//! The signals of a diagnosis that is kept only for display: two bytes for a value instead of eight.
//!
//! ```text
//! y = (1 - w) least + w greatest,   w = q / 65534,   q = 0..65534
//! ```
//!
//! * No value is off by more than half a step: 0.0008 % of the range of the signal.
//! * A signal that often repeats its value, such as a set point or the stem of a sticking valve, is kept as runs of equal values.
//! * Two signals that are equal are kept once.

use crate::signal::{Row, Window};
use crate::sysid::stats::range;
use std::sync::Arc;

/// Number of steps from the least to the greatest value: all codes of two bytes but one.
const STEPS: u16 = u16::MAX - 1;
/// The code of a value that is not finite.
const NO_NUMBER: u16 = u16::MAX;

/// A signal in two bytes for each value, or fewer.
#[derive(Clone, Debug, PartialEq)]
pub struct Packed {
    least: f64,
    greatest: f64,
    codes: Codes,
}

/// The codes q of a signal, in the form that takes less memory.
#[derive(Clone, Debug, PartialEq)]
enum Codes {
    /// One for each value.
    Each(Box<[u16]>),
    /// Runs of equal codes.
    Runs(Runs<u16>),
}

/// Runs of equal values: each value, and where its run ends.
#[derive(Clone, Debug, PartialEq)]
struct Runs<T>(Box<[(T, u32)]>);

impl<T: Copy + PartialEq> Runs<T> {
    fn new(values: &[T]) -> Self {
        let mut end = 0;
        let run = |run: &[T]| {
            end += run.len() as u32;
            (run[0], end)
        };
        Self(values.chunk_by(|a, b| a == b).map(run).collect())
    }

    fn len(&self) -> usize {
        self.0.last().map_or(0, |(_, end)| *end as usize)
    }

    fn values(&self) -> Vec<T> {
        let mut out = Vec::with_capacity(self.len());
        self.0.iter().for_each(|(value, end)| out.resize(*end as usize, *value));
        out
    }
}

impl Codes {
    fn new(codes: &[u16]) -> Self {
        let runs = codes.chunk_by(|a, b| a == b).count();
        match runs * size_of::<(u16, u32)>() < size_of_val(codes) {
            true => Self::Runs(Runs::new(codes)),
            false => Self::Each(codes.into()),
        }
    }
}

impl Packed {
    /// Packs a signal.
    pub fn new(values: &[f64]) -> Self {
        let finite = || values.iter().copied().filter(|value| value.is_finite());
        let least = finite().fold(f64::INFINITY, f64::min);
        let greatest = finite().fold(f64::NEG_INFINITY, f64::max);
        // Halves, because the difference of two finite numbers may be infinite.
        let above = |value: f64| value / 2.0 - least / 2.0;
        let code = |value: &f64| match value.is_finite() {
            // 0 for a constant, whose range is 0.
            true => (above(*value) / above(greatest) * f64::from(STEPS)).round() as u16,
            false => NO_NUMBER,
        };
        Self { least, greatest, codes: Codes::new(&values.iter().map(code).collect::<Vec<u16>>()) }
    }

    /// Unpacks the signal; a value that was not finite is NaN.
    pub fn values(&self) -> Vec<f64> {
        let value = |code: &u16| match *code {
            NO_NUMBER => f64::NAN,
            code => {
                let w = f64::from(code) / f64::from(STEPS);
                (1.0 - w) * self.least + w * self.greatest
            }
        };
        match &self.codes {
            Codes::Each(codes) => codes.iter().map(value).collect(),
            Codes::Runs(runs) => runs.values().iter().map(value).collect(),
        }
    }

    /// The number of values.
    pub fn len(&self) -> usize {
        match &self.codes {
            Codes::Each(codes) => codes.len(),
            Codes::Runs(runs) => runs.len(),
        }
    }

    /// Whether there are no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Packs a second signal; it shares the memory of `first` where both are equal.
    pub fn second(first: &Arc<Self>, values: &[f64]) -> Arc<Self> {
        let second = Self::new(values);
        if second == **first { first.clone() } else { Arc::new(second) }
    }
}

/// A packed window, with the stem that the diagnosis implies. Other tags are left out, because nothing displays them.
#[derive(Clone, Debug, PartialEq)]
pub struct PackedWindow {
    t0: f64,
    ts: f64,
    pub(super) op_range: (f64, f64),
    op: Arc<Packed>,
    pv: Packed,
    sp: Option<Packed>,
    mv: Option<Packed>,
    rows: Runs<Row>,
    /// The stem; without friction it is OP, and shares its memory.
    pub(super) stem: Arc<Packed>,
}

impl PackedWindow {
    pub(super) fn new(window: Window, stem: &[f64]) -> Self {
        let packed = |signal: &Option<Vec<f64>>| signal.as_deref().map(Packed::new);
        let op = Arc::new(Packed::new(&window.op));
        Self {
            t0: window.t0,
            ts: window.ts,
            op_range: range(&window.op),
            stem: Packed::second(&op, stem),
            op,
            pv: Packed::new(&window.pv),
            sp: packed(&window.sp),
            mv: packed(&window.mv),
            rows: Runs::new(&window.rows),
        }
    }

    pub(super) fn window(&self) -> Window {
        Window {
            t0: self.t0,
            ts: self.ts,
            op: self.op.values(),
            pv: self.pv.values(),
            sp: self.sp.as_ref().map(Packed::values),
            mv: self.mv.as_ref().map(Packed::values),
            tags: Vec::new(),
            rows: self.rows.values(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::{Diagnosis, NotIdentifiable, Verdict};
    use proptest::prelude::*;

    #[test]
    fn hand_values() {
        let packed = Packed::new(&[10.0, 75.534, f64::NAN, 42.7675, f64::INFINITY]);
        let values = packed.values();
        // A step of 0.001: 42.7675 lies half way between two.
        assert_eq!((packed.len(), values[0], values[1]), (5, 10.0, 75.534));
        assert!((values[3] - 42.7675).abs() < 6e-4 && values[2].is_nan() && values[4].is_nan());
        assert_eq!(Packed::new(&[f64::MIN, 0.0, f64::MAX]).values(), [f64::MIN, 0.0, f64::MAX]);
        assert_eq!(Packed::new(&[50.0; 3]).values(), [50.0; 3], "a constant stays what it is");
        assert!(Packed::new(&[f64::NAN]).values()[0].is_nan());
        assert!(Packed::new(&[]).is_empty());
    }

    #[test]
    fn what_stands_still_takes_little_and_comes_back_the_same() {
        let steps: Vec<f64> = (0..2048).map(|k| f64::from(k / 100)).collect();
        let packed = Packed::new(&steps);
        assert!(matches!(&packed.codes, Codes::Runs(runs) if runs.0.len() == 21), "{packed:?}");
        let each = Packed { codes: Codes::Each(code_of(&packed)), ..packed.clone() };
        assert_eq!((packed.values(), packed.len()), (each.values(), each.len()));
        let moving: Vec<f64> = (0..2048).map(|k| f64::from(k).sin()).collect();
        assert!(matches!(Packed::new(&moving).codes, Codes::Each(_)));
        let first = Arc::new(packed);
        assert!(Arc::ptr_eq(&first, &Packed::second(&first, &steps)));
        assert!(!Arc::ptr_eq(&first, &Packed::second(&first, &moving)));
    }

    fn code_of(packed: &Packed) -> Box<[u16]> {
        match &packed.codes {
            Codes::Each(codes) => codes.clone(),
            Codes::Runs(runs) => runs.values().into(),
        }
    }

    proptest! {
        #[test]
        fn no_value_is_off_by_more_than_half_a_step(values in prop::collection::vec(f64::MIN..f64::MAX, 1..50), scale in -1000..0i32, offset in -1.0..1.0f64) {
            let values: Vec<f64> = values.iter().map(|value| value * 2f64.powi(scale) + offset).collect();
            let (least, most) = range(&values);
            // Half a step, and what is lost where a small range lies far from zero.
            let most_off = (most / 65534.0 - least / 65534.0) * 0.5 + 4.0 * f64::EPSILON * least.abs().max(most.abs());
            for (value, again) in values.iter().zip(Packed::new(&values).values()) {
                prop_assert!((value - again).abs() <= most_off, "{value} {again}");
            }
        }
    }

    #[test]
    fn a_packed_diagnosis_shows_what_it_did_without_its_other_tags() {
        let ramp = |step: f64| (0..400).map(|k| 40.0 + step * f64::from(k)).collect::<Vec<_>>();
        let window = Window {
            t0: 7.0,
            ts: 2.0,
            op: ramp(0.1),
            pv: ramp(-0.2),
            mv: Some(ramp(0.09)),
            tags: vec![("other".into(), ramp(1.0))],
            rows: vec![Row::Missing; 400],
            ..Window::default()
        };
        let whole = Diagnosis {
            window: Some(window.clone()),
            ..Diagnosis::bare(Verdict::NoStiction, "made for a test")
        };
        let mut packed = whole.clone();
        packed.pack();
        assert!(packed.window.is_none() && packed.shown_stem().is_none());
        assert_eq!((packed.op_range(), whole.op_range()), (Some((40.0, 79.9)), Some((40.0, 79.9))));
        let shown = packed.shown_window().expect("a window").into_owned();
        assert_eq!((shown.t0, shown.ts, &shown.sp, &shown.rows), (7.0, 2.0, &None, &window.rows));
        assert!(shown.tags.is_empty());
        let near =
            |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-3) && a.len() == b.len();
        assert!(near(&shown.op, &window.op) && near(&shown.pv, &window.pv));
        assert!(near(&shown.mv.expect("a stem"), &window.mv.expect("a stem")));
        let mut none = Diagnosis::bare(Verdict::NotIdentifiable(NotIdentifiable::FlatPv), "made for a test");
        none.pack();
        assert!(none.shown_window().is_none() && none.op_range().is_none());
    }
}
