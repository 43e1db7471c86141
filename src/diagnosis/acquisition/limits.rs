//! The limits by which OP and PV count as read together. They were set by judgement; the example `read_apart` varies them.

/// Least share of a tag's steps in time that are multiples of one pace, where the tag is read at that pace: changes come at any
/// scan.
const IN_STEP: f64 = 0.95;
/// Least distance of OP and PV of one row that counts as read apart (rows): the controller has most likely acted in between.
const APART: f64 = 0.25;
/// Largest share of rows that may be read apart in a record with the verdict `no_stiction`: with one in four the others still
/// decide.
const MOST_READ_APART: f64 = 0.25;
/// Quantile of OP's steps by which the interval of f is widened where the controller may have acted unseen: OP moves so far in
/// between where it moves fast.
const FAST: f64 = 0.95;

/// The limits by which OP and PV count as read together. Every published result uses the defaults, and no configuration changes
/// them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReadingLimits {
    /// Least share of a tag's steps in time that are multiples of one pace, where the tag is read at that pace (0..1).
    pub in_step: f64,
    /// Least distance of OP and PV of one row that counts as read apart (rows).
    pub apart: f64,
    /// Largest share of rows that may be read apart in a record with the verdict `no_stiction` (0..1).
    pub most_read_apart: f64,
    /// Quantile of OP's steps by which the interval of f is widened where the controller may have acted unseen (0..1).
    pub fast: f64,
}

impl Default for ReadingLimits {
    fn default() -> Self {
        Self { in_step: IN_STEP, apart: APART, most_read_apart: MOST_READ_APART, fast: FAST }
    }
}
