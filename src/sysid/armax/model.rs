//! The ARMAX model: its orders, its coefficients, and the hypothesis whose signals drive it.

/// `na = nb = nc` of every model.
pub const ORDER: usize = 3;
/// Longest delay nk (samples).
pub const LONGEST_DELAY: usize = 12;
/// Largest modulus of a zero of C: beyond it the start of the record is never forgotten.
pub const RHO: f64 = 0.98;

/// The input signals of a model at one value of the parameters `theta` of its hypothesis, one value for each sample.
#[derive(Clone, Debug, Default)]
pub struct Signals {
    /// The stem `x` as it acts on the process (standard deviations of OP).
    pub x: Vec<f64>,
    /// The shapes `phi` of the loads (-).
    pub shapes: Vec<Vec<f64>>,
    /// The offset `o` that is subtracted from PV (standard deviations of PV); empty for none.
    pub offset: Vec<f64>,
}

/// A parameter of a hypothesis in which the likelihood is smooth, so that it is estimated by its gradient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Smooth {
    /// Its value.
    pub value: f64,
    /// Step of the difference quotient by which its gradient is taken.
    pub step: f64,
    /// Least and largest value.
    pub bounds: (f64, f64),
}

/// A hypothesis as the fit sees it: input signals that may depend on smooth parameters.
pub trait Input {
    /// The smooth parameters `theta`, with the values that a fit starts from.
    fn smooth(&self) -> Vec<Smooth>;
    /// The input signals at these values of `theta`.
    fn signals(&self, theta: &[f64]) -> Signals;
}

/// The coefficients of a model, and its likelihood. All are of normalised signals.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Armax {
    /// Dead time (samples).
    pub nk: usize,
    /// `a1..a3`.
    pub a: [f64; ORDER],
    /// `b1..b3`.
    pub b: [f64; ORDER],
    /// `c1..c3`.
    pub c: [f64; ORDER],
    /// The constant.
    pub c0: f64,
    /// Coefficients of the shapes of loads.
    pub gamma: Vec<f64>,
    /// Smooth parameters of the hypothesis.
    pub theta: Vec<f64>,
    /// Scale s of the errors (standard deviations of PV).
    pub scale: f64,
    /// Degrees of freedom nu of the errors (-).
    pub nu: f64,
    /// Log-likelihood of the fitted rows.
    pub log_likelihood: f64,
}
