//! Srinivasan, Rengaswamy, Narasimhan & Miller 2005: shapes by dynamic time warping (part 1), and a Hammerstein model with
//! one parameter (part 2).
//!
//! Part 1: each period is warped onto two templates, and has the shape of the nearer one. A sticking valve makes a triangle of OP and
//! a square wave of PV where the process is self-regulating, and a triangle of PV where it integrates. Other causes make sines.
//!
//! ```text
//! D[i][j] = (v_i - t_j)² + min(D[i-1][j], D[i][j-1], D[i-1][j-1])       |i - j| <= W, both of unit variance
//! index = share of the periods with the shape of a sticking valve
//! ```
//!
//! Part 2: the stem jumps to OP whenever OP is more than d away, `x[k] = x[k-1] if |u[k] - x[k-1]| <= d, u[k] otherwise`;
//! d (OP unit) with the least loss of a linear model behind it, as the program reports it (`d`). The index is d as a share of
//! OP's range.
//!
//! Source: Ind. Eng. Chem. Res. 2005, 44, 6708 (part 1) and 6719 (part 2). Chosen here: 40 points a period, W = 2. A valve with d = 0
//! is the authors' sound valve; the other thresholds are not in the papers, and are calibrated on simulated loops by
//! `numerics/examples/opinions -- --calibrate`.
//! Limits: warping makes triangles of noisy sines; loads of these shapes look like a valve; d tells little of S, and is 0 for a pure
//! dead band.

use super::facts::Facts;
use super::half_cycles::{Cycles, sine, triangle};
use super::integration::Integrates;
use super::opinion::{Band, Method, Opinion};
use super::picture::{Layer, Picture, Tone, excerpt};
use crate::diagnosis::{Settings, verdict};
use crate::sysid::stats::{mean, sd};

/// Thresholds of the share of periods, calibrated (-).
pub const BY_SHAPE: Band = Band { sound: 0.09, sticks: 0.83 };
/// Thresholds of d as a share of OP's range (-): 0 is the authors' sound valve, the other is calibrated.
pub const BY_D: Band = Band { sound: 0.0, sticks: 0.58 };
/// Points of a period.
const POINTS: usize = 40;
/// W: how far a point may be warped (points).
const WARP: usize = 2;
/// Fewest periods.
const LEAST_PERIODS: usize = 3;

/// A shape over one period.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// A sine.
    Sine,
    /// A triangle.
    Triangle,
    /// A square wave.
    Square,
}

impl Shape {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Shape::Sine => "sine",
            Shape::Triangle => "triangle",
            Shape::Square => "square wave",
        }
    }

    /// Its points, with zero mean and unit variance, from an upward zero crossing on.
    pub fn points(self) -> Vec<f64> {
        let of = |i: usize| -> f64 {
            let turn = 2.0 * (i as f64 + 0.5) / POINTS as f64;
            let (s, sign) = if turn < 1.0 { (turn, 1.0) } else { (turn - 1.0, -1.0) };
            sign * match self {
                Shape::Sine => sine(s),
                Shape::Triangle => triangle(s, 0.5),
                Shape::Square => 1.0,
            }
        };
        unit((0..POINTS).map(of).collect())
    }
}

/// The values with zero mean and unit variance.
fn unit(v: Vec<f64>) -> Vec<f64> {
    let (m, s) = (mean(&v), sd(&v).max(1e-12));
    v.into_iter().map(|x| (x - m) / s).collect()
}

/// The distance of two periods by dynamic time warping.
pub fn distance(v: &[f64], t: &[f64]) -> f64 {
    let mut above = vec![f64::INFINITY; t.len() + 1];
    above[0] = 0.0;
    for (i, v) in v.iter().enumerate() {
        let mut row = vec![f64::INFINITY; t.len() + 1];
        for j in i.saturating_sub(WARP)..(i + WARP + 1).min(t.len()) {
            row[j + 1] = (v - t[j]).powi(2) + above[j].min(above[j + 1]).min(row[j]);
        }
        above = row;
    }
    above[t.len()]
}

/// The periods of a signal from an upward zero crossing on, each resampled to [`POINTS`] points.
fn periods(cycles: &Cycles) -> Vec<Vec<f64>> {
    let at = |t: f64| -> f64 {
        let k = (t.floor() as usize).min(cycles.centred.len() - 1);
        let next = (k + 1).min(cycles.centred.len() - 1);
        cycles.centred[k] + (t - k as f64) * (cycles.centred[next] - cycles.centred[k])
    };
    let pairs = cycles.halves.windows(2).filter(|pair| pair[0].above && pair[0].to == pair[1].from);
    let points = |from: f64, to: f64| -> Vec<f64> {
        unit((0..POINTS).map(|i| at(from + (to - from) * (i as f64 + 0.5) / POINTS as f64)).collect())
    };
    pairs.map(|pair| points(pair[0].from, pair[1].to)).collect()
}

/// The number of periods that are nearer to `shape` than to a sine.
fn votes(periods: &[Vec<f64>], shape: Shape) -> usize {
    let (shape, sine) = (shape.points(), Shape::Sine.points());
    periods.iter().filter(|v| distance(v, &shape) < distance(v, &sine)).count()
}

/// What part 1 evaluates: the name of a signal, the shape that a sticking valve gives it, and its periods.
type Asked = (&'static str, Shape, Vec<Vec<f64>>);

/// Evaluates part 1.
fn evaluate_shape(facts: &Facts<'_>) -> Result<Vec<Asked>, String> {
    facts.oscillates()?;
    let asked: &[(&'static str, &Cycles, Shape)] = match facts.integration.answer {
        Integrates::No => &[("OP", &facts.op, Shape::Triangle), ("PV", &facts.pv, Shape::Square)],
        Integrates::Yes => &[("PV", &facts.pv, Shape::Triangle)],
        Integrates::Unknown => return Err(facts.integration.why()),
    };
    let asked: Vec<Asked> =
        asked.iter().map(|(name, cycles, shape)| (*name, *shape, periods(cycles))).collect();
    let count: usize = asked.iter().map(|(.., periods)| periods.len()).sum();
    if count < LEAST_PERIODS {
        return Err(format!("{count} whole periods, {LEAST_PERIODS} are needed"));
    }
    Ok(asked)
}

/// The periods of each signal laid over each other, with both templates.
pub(super) fn picture_shape(facts: &Facts<'_>) -> Vec<Picture> {
    let over = |points: &[f64]| -> Vec<(f64, f64)> {
        points.iter().enumerate().map(|(i, v)| ((i as f64 + 0.5) / POINTS as f64, *v)).collect()
    };
    let one = |(name, shape, periods): Asked| {
        let layers = vec![
            Layer::dots(
                format!("periods of {name}"),
                Tone::Data,
                periods.iter().flat_map(|v| over(v)).collect(),
            ),
            Layer::line("sine", Tone::Sound, over(&Shape::Sine.points())),
            Layer::line(shape.name(), Tone::Sticks, over(&shape.points())),
        ];
        let nearer = votes(&periods, shape);
        let title = format!(
            "{nearer} of {} periods of {name} are nearer to a {} than to a sine",
            periods.len(),
            shape.name()
        );
        Picture::new(title, "phase (-)", "standard deviations", layers)
    };
    evaluate_shape(facts).into_iter().flatten().map(one).collect()
}

/// The opinion of part 1.
pub fn opinion_shape(facts: &Facts<'_>) -> Opinion {
    const METHOD: Method = Method::Srinivasan2005Shape;
    let asked = match evaluate_shape(facts) {
        Ok(asked) => asked,
        Err(why) => return Opinion::cannot_tell(METHOD, why),
    };
    let sticking: usize = asked.iter().map(|(_, shape, periods)| votes(periods, *shape)).sum();
    let count: usize = asked.iter().map(|(.., periods)| periods.len()).sum();
    let index = sticking as f64 / count as f64;
    Opinion::of(METHOD, index, BY_SHAPE, format!("{sticking} of {count} periods of a valve's shape"))
}

/// Evaluates part 2: d (OP unit).
fn evaluate_d(facts: &Facts<'_>) -> Result<f64, String> {
    let (problem, scale) =
        verdict::pose(&facts.window, &facts.region, &Settings::default()).map_err(|why| why.to_string())?;
    Ok(verdict::best_d(&problem) * scale.u)
}

/// OP and the simulated stem over time.
pub(super) fn picture_d(facts: &Facts<'_>) -> Vec<Picture> {
    let Ok(d) = evaluate_d(facts) else { return Vec::new() };
    let op = &facts.window.op;
    let mut stem = op.first().copied().unwrap_or(0.0);
    let jumping: Vec<f64> = op
        .iter()
        .map(|u| {
            stem = if (u - stem).abs() <= d { stem } else { *u };
            stem
        })
        .collect();
    let shown = excerpt(facts);
    let at = |k: usize| (k - shown.start) as f64 * facts.window.ts;
    let over = |v: &[f64]| shown.clone().map(|k| (at(k), v[k])).collect();
    let layers = vec![
        Layer::line("OP", Tone::Data, over(op)),
        Layer::line("stem that jumps once OP is d away", Tone::Sticks, over(&jumping)),
    ];
    let title = "A few periods from the middle of the record: OP, and the stem that fits best";
    vec![Picture::new(title, "time (s)", "OP unit", layers)]
}

/// The opinion of part 2.
pub fn opinion_d(facts: &Facts<'_>) -> Opinion {
    const METHOD: Method = Method::Srinivasan2005D;
    let d = match evaluate_d(facts) {
        Ok(d) => d,
        Err(why) => return Opinion::cannot_tell(METHOD, why),
    };
    let index = d / (facts.op_range() * facts.unit);
    Opinion::of(METHOD, index, BY_D, format!("d is {} of OP's range", BY_D.told_in_percent(index)))
        .with(d, "stick band d")
}
