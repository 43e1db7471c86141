//! One ARMAX model of the declared diagnosis: its orders and its coefficients.

/// Most coefficients in one fit: six of A, B and C, then c0 and the lag.
pub const MAX_PARAMETERS: usize = 8;
/// `na + nb + nc` of every model, the paper's choice.
pub const ORDER: usize = 6;

/// The orders of one ARMAX model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Orders {
    /// Order of A.
    pub na: usize,
    /// Number of coefficients of B.
    pub nb: usize,
    /// Order of C.
    pub nc: usize,
    /// Delay (samples), at least 1.
    pub nk: usize,
}

/// Every split `na + nb + nc = 6` with `na, nb >= 1`, for one delay: fifteen of them.
pub fn splits(nk: usize) -> impl Iterator<Item = Orders> {
    (1..ORDER).flat_map(move |na| (1..=ORDER - na).map(move |nb| Orders { na, nb, nc: ORDER - na - nb, nk }))
}

/// The coefficients of one model; those beyond its orders are 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Theta {
    /// `a1..`.
    pub a: [f64; ORDER],
    /// `b1..`.
    pub b: [f64; ORDER],
    /// `c1..`.
    pub c: [f64; ORDER],
    /// The constant.
    pub c0: f64,
    /// Kinetic lag (S - J)/2 by which a moving stem trails OP (OP unit).
    pub lag: f64,
}

/// Whether the kinetic lag is estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lag {
    /// It keeps its start value.
    Fixed,
    /// It is estimated in `0..=max`.
    Free {
        /// Upper bound, f (OP unit).
        max: f64,
    },
}
