//! The diagnosis and tracing as a whole: against a slow search, on drawn loops, on the paper's and on measured ones.

#[path = "../common"]
mod common {
    pub mod labelled;
    #[expect(dead_code, reason = "each user takes a part")]
    pub mod measured;
    pub mod parallel;
    pub mod pose;
    #[expect(dead_code, reason = "each user takes a part")]
    pub mod records;
}
mod jumping;
mod paper;
mod rates;
mod reference;
mod robust;
mod search;
mod traced;
