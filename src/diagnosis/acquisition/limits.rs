//! The limits by which OP and PV count as read together. They are judged; the example `read_apart` sweeps them.

/// Share of the steps from sample to sample that are multiples of one pace, where a tag is read at that pace: a change comes at any
/// scan.
const IN_STEP: f64 = 0.95;
/// Part of a row's period by which OP and PV of one row are read apart: the controller has most likely acted in between.
const APART: f64 = 0.25;
/// Share of the rows that may be read apart in a record that says no: with one in four the others still decide.
const MOST_READ_APART: f64 = 0.25;
/// The quantile of OP's steps by which the interval of f is widened where the controller's scans are not seen, or where OP and PV
/// were read apart: OP moves so far in between where it moves fast.
const FAST: f64 = 0.95;

/// The limits by which OP and PV count as read together; the defaults are what every published result uses, and no configuration
/// has others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReadingLimits {
    /// Share of the steps from sample to sample that are multiples of one pace, where a tag is read at that pace (0..1).
    pub in_step: f64,
    /// Distance from which OP and PV of one row are read apart (rows).
    pub apart: f64,
    /// Share of the rows that may be read apart in a record that says no (0..1).
    pub most_read_apart: f64,
    /// Quantile of OP's steps by which the interval of f is widened where the controller may have acted unseen (0..1).
    pub fast: f64,
}

impl Default for ReadingLimits {
    fn default() -> Self {
        Self { in_step: IN_STEP, apart: APART, most_read_apart: MOST_READ_APART, fast: FAST }
    }
}
