//! System identification, pure: the models and the statistics on which `diagnosis` and `residual` are built.
//!
//! | what | where |
//! |---|---|
//! | the record that is fitted, normalised | [`iddata`] |
//! | the valve: its parameters, and its recursion from OP to the stem | `valve/model.rs`, `valve/recursion.rs` in [`valve`] |
//! | the ARMAX model: prediction errors and maximum likelihood | [`armax`] |
//! | its coefficients, its errors, its errors where samples are missing | `armax/model.rs`, `armax/errors.rs`, `armax/kalman.rs` |
//! | its gradient, its starts | `armax/gradient.rs`, `armax/hannan_rissanen.rs` |
//! | the high-order ARX that ranks hypotheses | [`arx`] |
//! | the distribution of the errors: Student's t | [`student`] |
//! | the model selection criterion: the penalty of a coefficient, a threshold, a change time, a frequency | [`criterion`] |
//! | the sign of the process gain | [`gain_sign`] |
//! | the equation of the controller: whether it holds but for rounding | [`controller`] |
//! | what OP tells of PV beyond its samples | [`unrecorded`] |
//! | whether PV follows the stem or OP | [`encompass`] |
//! | Gram matrices, Cholesky factors, regressions with t values | [`gram`], [`least_squares`], [`ols`] |
//! | zeros of a polynomial, and how they are kept inside a circle | [`zeros`] |
//! | OP and PV where they were not measured | [`missing`] |
//! | free run of a model, whiteness of its residual, power spectra | [`simulate`], [`whiteness`], [`spectrum`] |
//! | mean, standard deviation, median | [`stats`] |
//!
//! Symbols: u OP, y PV, x the stem, e prediction errors, k a sample, N the samples that count.
//! `docs/method.md` has the theory.

pub mod armax;
pub mod arx;
pub mod controller;
pub mod criterion;
pub mod encompass;
pub mod gain_sign;
pub mod gram;
pub mod iddata;
pub mod least_squares;
pub mod missing;
pub mod ols;
pub mod simulate;
pub mod spectrum;
pub mod stats;
pub mod student;
pub mod unrecorded;
pub mod valve;
pub mod whiteness;
pub mod zeros;
