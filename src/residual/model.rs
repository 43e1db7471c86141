//! The model under construction: a friction element, a linear part, and terms that effects add to it.

use super::{Kind, Parameter};
use crate::diagnosis::armax::Orders;
use crate::diagnosis::friction::Start;
use std::fmt::Debug;

/// A window, normalised: OP and PV with zero mean and unit variance.
#[derive(Clone, Debug)]
pub struct Data {
    /// OP.
    pub u: Vec<f64>,
    /// PV.
    pub y: Vec<f64>,
    /// Where the friction element starts.
    pub start: Start,
    /// First sample that counts.
    pub first: usize,
    /// First sample that no fit sees.
    pub split: usize,
    /// Longest delay (samples).
    pub max_delay: usize,
    /// Largest f at which the stem still reverses.
    pub f_top: f64,
    /// Units.
    pub scale: Scale,
    /// Set point, normalised as PV is.
    pub sp: Option<Vec<f64>>,
    /// Other tags, each with zero mean and unit variance.
    pub tags: Vec<(String, Vec<f64>)>,
}

/// What turns normalised numbers into those of the plant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
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
}

impl Data {
    /// Number of samples.
    pub fn len(&self) -> usize {
        self.y.len()
    }

    /// Samples of one free run: a quarter of what is held out.
    pub fn stretch(&self) -> usize {
        (self.len() - self.split).div_ceil(4).max(1)
    }
}

/// The one-parameter element with a kinetic lag, a resume threshold, and what effects change about it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Element {
    /// Friction, S/2.
    pub f: f64,
    /// Kinetic lag (S - J)/2 as a share of f; below 0 where the stem slips beyond OP (-).
    pub lag: f64,
    /// Resume threshold J/S (-).
    pub resume: f64,
    /// Each move is a slip of its own (He's valve): the threshold holds while the stem moves, too.
    pub slips: bool,
    /// Whether the stem's last move before the start was the other way than the extremum of OP there says.
    pub turned: bool,
    /// How far the stem was beyond OP at the start, in the direction of that move, as a share of 2f (-).
    pub rest: f64,
    /// The band to cross on turning down is `1 + skew` times 2f, on turning up `1 - skew` times (-).
    pub skew: f64,
    /// f grows from `1 - growth` to `1 + growth` times itself over the fitted samples (-).
    pub growth: f64,
}

impl Element {
    /// Kinetic lags there are: J from 0 to twice S.
    pub const LAGS: (f64, f64) = (-1.0, 1.0);

    /// Whether its kinetic lag, its resume threshold and its place at the start are a valve's.
    pub fn is_valve(&self) -> bool {
        let (least, most) = Self::LAGS;
        (least..=most).contains(&self.lag)
            && (0.0..=1.0 - least).contains(&self.resume)
            && (0.0..=1.0).contains(&self.rest)
    }

    /// Runs OP through the element: `z = x - lag f dir`, and the stem's direction.
    pub fn run(&self, u: &[f64], start: Start, span: usize, z: &mut Vec<f64>, dir: &mut Vec<f64>) {
        z.clear();
        z.extend_from_slice(u);
        dir.clear();
        let mut direction: f64 = if start.is_max != self.turned { 1.0 } else { -1.0 };
        dir.resize(u.len(), direction);
        if self.f <= 0.0 || start.index >= u.len() {
            return;
        }
        let mut stem = u[start.index];
        let mut moving = self.resume == 0.0;
        let (rate, mut f) = (2.0 / span as f64, self.f);
        for k in 0..u.len() {
            if self.growth != 0.0 {
                f = self.f * (1.0 + self.growth * ((k as f64 * rate).min(3.0) - 1.0)).max(0.0);
            }
            if k > start.index {
                let onward = direction * (u[k] - stem);
                let band = 2.0 * f * (1.0 + self.skew * direction);
                if onward > 0.0 {
                    if moving || onward > 2.0 * f * self.resume {
                        stem = u[k];
                        moving = !self.slips;
                    }
                } else if -onward > band {
                    stem = u[k];
                    direction = -direction;
                    moving = !self.slips;
                } else {
                    moving = self.resume == 0.0;
                }
            } else {
                let beyond = if k == start.index { 2.0 * f * self.rest } else { 0.0 };
                stem = u[k] + direction * beyond;
            }
            z[k] = stem - self.lag * f * direction;
            dir[k] = direction;
        }
    }
}

/// A nonlinear number of a term.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Knob {
    /// Its value.
    pub value: f64,
    /// How far a first try goes.
    pub step: f64,
    /// Whether the error is smooth in it: then it is estimated with the linear part, else by trying.
    pub smooth: bool,
    /// Bounds.
    pub bounds: (f64, f64),
}

/// The signals a model is fitted on.
#[derive(Clone, Debug, Default)]
pub struct Stage {
    /// OP.
    pub u: Vec<f64>,
    /// PV, repaired where a term says so.
    pub y: Vec<f64>,
    /// 0 where a sample does not count.
    pub weight: Vec<f64>,
    /// Input of the linear part.
    pub z: Vec<f64>,
    /// Direction of the stem.
    pub dir: Vec<f64>,
    /// Shapes of loads.
    pub columns: Vec<Vec<f64>>,
}

/// What an effect adds to the model; what it does not touch stays as it is.
pub trait Term: Debug + Send + Sync {
    /// Its effect.
    fn kind(&self) -> Kind;
    /// A copy.
    fn boxed(&self) -> Box<dyn Term>;
    /// The tag it takes.
    fn tag(&self) -> Option<&str> {
        None
    }
    /// Its nonlinear numbers.
    fn knobs(&self) -> Vec<Knob> {
        Vec::new()
    }
    /// Sets one of them.
    fn set(&mut self, _at: usize, _value: f64) {}
    /// Repairs the signals.
    fn data(&self, _stage: &mut Stage) {}
    /// Changes the friction element.
    fn element(&self, _element: &mut Element) {}
    /// Changes the stem on its way to the process.
    fn stem(&self, _data: &Data, _z: &mut [f64]) {}
    /// Whether it does.
    fn changes_stem(&self) -> bool {
        false
    }
    /// Where all it does to the stem is to delay it: from which sample on, and by how many samples before and from there on.
    fn delays(&self) -> Option<(usize, [usize; 2])> {
        None
    }
    /// Angular frequencies, where its shapes are a sine and a cosine of each (rad/sample).
    fn waves(&self) -> Vec<f64> {
        Vec::new()
    }
    /// Adds shapes.
    fn columns(&self, _data: &Data, _stage: &Stage, _out: &mut Vec<Vec<f64>>) {}
    /// How its shapes, these and each times its `gamma`, change together with one of its numbers, where that is known without a
    /// difference.
    fn slope(&self, _at: usize, _gamma: &[f64], _shapes: &[Vec<f64>]) -> Option<Vec<f64>> {
        None
    }
    /// Its numbers and its sentence, with the linear part it is in and the coefficients of its own shapes.
    fn describe(&self, data: &Data, gamma: &[f64], linear: &Linear) -> (Vec<Parameter>, String);
}

/// Coefficients of the linear part.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Linear {
    /// `a1..`.
    pub a: Vec<f64>,
    /// `b1..`, from delay nk on.
    pub b: Vec<f64>,
    /// `c1..`.
    pub c: Vec<f64>,
    /// Constant.
    pub c0: f64,
    /// Coefficients of the shapes.
    pub gamma: Vec<f64>,
}

/// Least `|A|` and `|B|` that a load is divided by: where PV integrates, or does not answer at all, its size has no end.
const LEAST: [f64; 2] = [1e-3, 1e-6];

impl Linear {
    /// What a load of 1 in the equation is worth at the stem, once it has settled: `1 / B(1)`.
    pub fn in_op(&self) -> f64 {
        settled(self.b.iter().sum(), LEAST[1])
    }

    /// What it does to PV if nothing controls it: `1 / A(1)`, of an integrating process in its first thousand samples.
    pub fn in_pv(&self) -> f64 {
        settled(1.0 + self.a.iter().sum::<f64>(), LEAST[0])
    }

    /// The same of the amplitude of a wave (rad/sample): `1/|A|` and `1/|B|`.
    pub fn of_wave(&self, w: f64) -> [f64; 2] {
        let of = |numbers: &mut dyn Iterator<Item = f64>, least: f64| {
            let (mut re, mut im) = (0.0, 0.0);
            for (lag, number) in numbers.enumerate() {
                let (s, c) = (w * lag as f64).sin_cos();
                (re, im) = (re + number * c, im - number * s);
            }
            settled(re.hypot(im), least)
        };
        let a = &mut [1.0].into_iter().chain(self.a.iter().copied());
        [of(a, LEAST[0]), of(&mut self.b.iter().copied(), LEAST[1])]
    }
}

/// The inverse of what is left once all has settled.
fn settled(left: f64, least: f64) -> f64 {
    1.0 / if left.abs() < least { least.copysign(left) } else { left }
}

/// A model: what it is made of and its coefficients.
#[derive(Debug)]
pub struct Spec {
    /// Friction.
    pub element: Element,
    /// Terms in the order they were added.
    pub terms: Vec<Box<dyn Term>>,
    /// Orders of the linear part.
    pub orders: Orders,
    /// Its coefficients.
    pub linear: Linear,
    /// The model that runs free in its place, where its own dynamics are right one step ahead only.
    pub free: Option<Box<Spec>>,
    /// Loss on the fitted samples.
    pub loss: f64,
}

impl Clone for Spec {
    fn clone(&self) -> Self {
        Self {
            element: self.element,
            terms: self.terms.iter().map(|t| t.boxed()).collect(),
            orders: self.orders,
            linear: self.linear.clone(),
            free: self.free.clone(),
            loss: self.loss,
        }
    }
}

impl Spec {
    /// The element with what the terms change about it.
    pub fn full_element(&self) -> Element {
        let mut element = self.element;
        for term in &self.terms {
            term.element(&mut element);
        }
        element
    }

    /// The signals the linear part sees; returns how many shapes each term has.
    pub fn stage(&self, data: &Data) -> (Stage, Vec<usize>) {
        let mut stage =
            Stage { u: data.u.clone(), y: data.y.clone(), weight: vec![1.0; data.len()], ..Stage::default() };
        for term in &self.terms {
            term.data(&mut stage);
        }
        let counts = self.restage(data, &mut stage);
        (stage, counts)
    }

    /// Stem and shapes anew, the repaired signals kept.
    pub fn restage(&self, data: &Data, stage: &mut Stage) -> Vec<usize> {
        let (mut z, mut dir) = (std::mem::take(&mut stage.z), std::mem::take(&mut stage.dir));
        self.restem(data, &stage.u, &mut z, &mut dir);
        stage.z = z;
        stage.dir = dir;
        self.reshape(data, stage)
    }

    /// The shapes anew; returns how many each term has.
    pub fn reshape(&self, data: &Data, stage: &mut Stage) -> Vec<usize> {
        let mut columns = std::mem::take(&mut stage.columns);
        columns.clear();
        let mut counts = Vec::with_capacity(self.terms.len());
        for term in &self.terms {
            let before = columns.len();
            term.columns(data, stage, &mut columns);
            counts.push(columns.len() - before);
        }
        stage.columns = columns;
        counts
    }

    /// The input of the linear part and the stem's direction.
    pub fn restem(&self, data: &Data, u: &[f64], z: &mut Vec<f64>, dir: &mut Vec<f64>) {
        self.full_element().run(u, data.start, data.split, z, dir);
        for term in &self.terms {
            term.stem(data, z);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::friction::stick_slip;

    fn wave(n: usize) -> Vec<f64> {
        (0..n).map(|k| (0.21 * k as f64).sin() + 0.4 * (0.05 * k as f64).cos()).collect()
    }

    #[test]
    fn the_plain_element_is_the_diagnosis_own() {
        let u = wave(400);
        let start = Start { index: 7, is_max: true };
        let (mut x, mut d) = (vec![0.0; 400], vec![0.0; 400]);
        for (f, resume) in [(0.0, 0.0), (0.2, 0.0), (0.3, 0.4), (0.5, 1.0)] {
            let (mut z, mut dir) = (Vec::new(), Vec::new());
            Element { f, resume, ..Element::default() }.run(&u, start, 300, &mut z, &mut dir);
            stick_slip(&u, f, resume, start, &mut x, &mut d);
            assert_eq!(z, x);
            assert!(f == 0.0 || dir == d);
        }
    }

    #[test]
    fn a_load_is_worth_what_does_the_same() {
        let of = |a: f64, b: [f64; 2]| Linear { a: vec![a], b: b.to_vec(), ..Linear::default() };
        let process = of(-0.75, [0.25, 0.25]);
        assert_eq!((process.in_op(), process.in_pv()), (2.0, 4.0));
        assert_eq!(process.of_wave(0.0), [4.0, 2.0]);
        // Half a turn a sample: 1 + 0.75, and b that cancel.
        let [a, b] = process.of_wave(std::f64::consts::PI);
        assert!((a - 1.0 / 1.75).abs() < 1e-12 && b > 1e5, "{a} {b}");
        assert_eq!(of(-1.0, [0.0, 0.0]).in_pv(), 1000.0);
    }

    #[test]
    fn the_lag_moves_the_stem_behind_op() {
        let u = [0.0, 2.0, 1.0, 0.0, -1.0];
        let (mut z, mut dir) = (Vec::new(), Vec::new());
        let element = Element { f: 1.0, lag: 0.5, ..Element::default() };
        element.run(&u, Start { index: 1, is_max: true }, 5, &mut z, &mut dir);
        // Up until 2 with a lag of 0.5; stuck; the band of 2 is crossed at -1, from where the stem lies above OP.
        assert_eq!(z, [-0.5, 1.5, 1.5, 1.5, -0.5]);
    }

    #[test]
    fn a_skewed_band_is_wider_on_one_side() {
        let u = [0.0, 4.0, 1.5, 0.5, 2.0, 3.6];
        let (mut z, mut dir) = (Vec::new(), Vec::new());
        let element = Element { f: 1.0, skew: 0.5, ..Element::default() };
        element.run(&u, Start { index: 1, is_max: true }, 6, &mut z, &mut dir);
        // Down takes more than 3, up more than 1.
        assert_eq!(z, [0.0, 4.0, 4.0, 0.5, 2.0, 3.6]);
    }
}
