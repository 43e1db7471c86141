//! Pictures of what a method evaluated, as marks over two axes: numbers, without colours and pixels.
//!
//! Each method makes its pictures of the values behind its opinion. A picture is bounded in size: of a long curve at most
//! [`MOST_POINTS`] points are kept, evenly spaced.

use super::facts::Facts;

/// Most points of one layer.
pub const MOST_POINTS: usize = 600;
/// Periods of which a curve over time, or of one signal against another, is drawn.
const PERIODS: f64 = 6.0;

/// A picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// What it shows, in one line.
    pub title: String,
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// The layers from back to front.
    pub layers: Vec<Layer>,
}

/// An axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// What it is, with its unit.
    pub label: String,
    /// Its lower end.
    pub from: f64,
    /// Its upper end, above `from`.
    pub to: f64,
}

/// Marks of one meaning.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// What they are.
    pub name: String,
    /// What they stand for.
    pub tone: Tone,
    /// The marks.
    pub mark: Mark,
}

/// The meaning of marks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tone {
    /// Measured values.
    Data,
    /// Other measured values, drawn beside them.
    Beside,
    /// The shape that a sticking valve would give them.
    Sticks,
    /// The shape that another cause would give them.
    Sound,
    /// A limit or a result.
    Mark,
}

impl Tone {
    /// The stable, machine-readable name.
    pub fn as_str(self) -> &'static str {
        match self {
            Tone::Data => "data",
            Tone::Beside => "beside",
            Tone::Sticks => "sticks",
            Tone::Sound => "sound",
            Tone::Mark => "mark",
        }
    }
}

/// Marks.
#[derive(Clone, Debug, PartialEq)]
pub enum Mark {
    /// A curve through points.
    Line(Vec<(f64, f64)>),
    /// Points on their own.
    Dots(Vec<(f64, f64)>),
    /// Bars of one width from 0 up to points.
    Bars {
        /// Middle and height of each.
        points: Vec<(f64, f64)>,
        /// Width of all.
        width: f64,
    },
    /// A line along x.
    Level(f64),
    /// A line along y.
    Upright(f64),
    /// Values on a grid, none where there is no cell.
    Cells {
        /// The lower left corner of the first cell.
        from: (f64, f64),
        /// Width and height of a cell.
        size: (f64, f64),
        /// Cells in a row.
        columns: usize,
        /// Row by row from below, 0 to 1.
        values: Vec<Option<f64>>,
    },
}

impl Mark {
    /// The machine-readable name of its kind.
    pub fn as_str(&self) -> &'static str {
        match self {
            Mark::Line(_) => "line",
            Mark::Dots(_) => "dots",
            Mark::Bars { .. } => "bars",
            Mark::Level(_) => "level",
            Mark::Upright(_) => "upright",
            Mark::Cells { .. } => "cells",
        }
    }

    /// The corners that have to lie within the axes: those along x, those along y.
    fn reach(&self) -> (Vec<f64>, Vec<f64>) {
        match self {
            Mark::Line(points) | Mark::Dots(points) => points.iter().copied().unzip(),
            Mark::Bars { points, width } => {
                let ends = points.iter().flat_map(|(x, _)| [x - 0.5 * width, x + 0.5 * width]);
                (ends.collect(), points.iter().map(|point| point.1).chain([0.0]).collect())
            }
            Mark::Level(at) => (Vec::new(), vec![*at]),
            Mark::Upright(at) => (vec![*at], Vec::new()),
            Mark::Cells { from, size, columns, values } => {
                let rows = values.len().checked_div(*columns).unwrap_or(0) as f64;
                let (right, top) = (from.0 + size.0 * *columns as f64, from.1 + size.1 * rows);
                (vec![from.0, right], vec![from.1, top])
            }
        }
    }
}

impl Picture {
    /// A picture of layers, its axes as long as they ask for: labels with units, layers from back to front.
    pub fn new(title: impl Into<String>, x: &str, y: &str, layers: Vec<Layer>) -> Self {
        let (mut along_x, mut along_y) = (Vec::new(), Vec::new());
        for layer in &layers {
            let (xs, ys) = layer.mark.reach();
            along_x.extend(xs);
            along_y.extend(ys);
        }
        Self { title: title.into(), x: Axis::over(x, &along_x), y: Axis::over(y, &along_y), layers }
    }
}

impl Axis {
    /// An axis over values; one without length is given one, so that it can be drawn on.
    fn over(label: &str, values: &[f64]) -> Self {
        let finite = || values.iter().copied().filter(|v| v.is_finite());
        let (low, high) =
            (finite().fold(f64::INFINITY, f64::min), finite().fold(f64::NEG_INFINITY, f64::max));
        let (from, to) = match low < high {
            true => (low, high),
            false if low.is_finite() => (low - 0.5, low + 0.5),
            false => (0.0, 1.0),
        };
        Self { label: label.into(), from, to }
    }
}

impl Layer {
    /// A curve, thinned.
    pub fn line(name: impl Into<String>, tone: Tone, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), tone, mark: Mark::Line(thinned(points)) }
    }

    /// Points, thinned.
    pub fn dots(name: impl Into<String>, tone: Tone, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), tone, mark: Mark::Dots(thinned(points)) }
    }

    /// Bars.
    pub fn bars(name: impl Into<String>, tone: Tone, points: Vec<(f64, f64)>, width: f64) -> Self {
        Self { name: name.into(), tone, mark: Mark::Bars { points: thinned(points), width } }
    }

    /// A line along x.
    pub fn level(name: impl Into<String>, tone: Tone, at: f64) -> Self {
        Self { name: name.into(), tone, mark: Mark::Level(at) }
    }

    /// A line along y.
    pub fn upright(name: impl Into<String>, tone: Tone, at: f64) -> Self {
        Self { name: name.into(), tone, mark: Mark::Upright(at) }
    }
}

/// The points that are finite, evenly thinned to at most [`MOST_POINTS`].
fn thinned(mut points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    points.retain(|(x, y)| x.is_finite() && y.is_finite());
    let every = points.len().div_ceil(MOST_POINTS).max(1);
    points.into_iter().step_by(every).collect()
}

/// The samples of which curves over time are drawn: a few periods in the middle of the record, or all without a period.
pub(super) fn excerpt(facts: &Facts<'_>) -> std::ops::Range<usize> {
    let n = facts.len();
    let wanted = facts.oscillates().map_or(n, |period| (PERIODS * period).ceil() as usize).min(n);
    let from = (n - wanted) / 2;
    from..from + wanted
}

/// One period of `shape` over half a period (0..1), drawn from 0 to 1.
pub(super) fn curve(shape: impl Fn(f64) -> f64) -> Vec<(f64, f64)> {
    (0..=60).map(|i| f64::from(i) / 60.0).map(|s| (s, shape(s))).collect()
}
