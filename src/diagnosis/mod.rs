//! The diagnosis of one loop, pure: no clock, no files, no random numbers. The same record gives the same diagnosis.
//!
//! | step | where |
//! |---|---|
//! | 1. a record becomes a window on equal rows, or is refused | [`gate`], `gate/refuse.rs` |
//! | on which rows its samples lie, how it was acquired, by how much PV is late | [`acquisition`] |
//! | what an archive did to the record, and which samples it measured | [`history_kind`], [`lines`] |
//! | 2. the oscillation of OP, denoised OP, the stretch that is fitted | [`region`], [`denoise`], [`prepare`] |
//! | 3. friction: from OP to a stem | [`friction`] |
//! | 4. the ARMAX model, its gradient, its filters | [`armax`], `armax/normal_equations.rs`, `armax/filters.rs` |
//! | its starts: Hannan–Rissanen, and the library of noise models | [`screen`], [`noise_models`] |
//! | 5. the search over f | [`search`], [`grid`] |
//! | 6. the explanations without friction, the evidence against them, the interval of f | [`rivals`], [`evidence`] |
//! | 7. the verdict, and its reason in one line | [`verdict`] |
//! | thresholds and sizes; what a diagnosis says, in numbers | `settings.rs`, `result.rs` |
//! | why a record says nothing, as a sentence | [`not_identifiable`] |
//! | errors on samples that were not fitted, whiteness | [`validation`] |
//!
//! Beside these: [`confirmed`] makes a diagnosis of a model that is known already, [`packed`] keeps its signals in little memory.
//! `docs/diagnosis.md` explains the method.

pub mod acquisition;
pub mod armax;
mod config;
pub mod confirmed;
pub mod denoise;
pub mod evidence;
pub mod friction;
pub mod gate;
pub mod grid;
pub mod history_kind;
pub mod lagged_products;
pub mod lines;
pub mod noise_models;
pub mod not_identifiable;
pub mod packed;
mod preparation;
pub mod prepare;
pub mod region;
mod result;
pub mod rivals;
pub mod screen;
pub mod search;
mod settings;
mod undersampling;
pub mod validation;
pub mod verdict;

pub use acquisition::{Acquisition, Apart, Carried, ReadingLimits};
pub use config::Config;
pub use history_kind::{HistoryFound, HistoryKind};
pub use not_identifiable::NotIdentifiable;
pub use preparation::{Denoise, Preparation};
pub use result::{CurvePoint, Diagnosis, Estimate, Model, Oscillation, Residual, Verdict};
pub use settings::Settings;
pub use verdict::{diagnose, diagnose_gated};

pub use crate::sysid::valve::model_error::{with_model_error, without_model_error};
