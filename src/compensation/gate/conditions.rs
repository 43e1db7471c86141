//! What the gate sees, the bounds it keeps, and why it says no.

use crate::compensation::measure::{Criteria, Failure};
use crate::signal::Sample;

/// A moment on two clocks: one that never jumps, and the one that stamps samples and that people read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Time {
    /// Steady (s), from anywhere.
    pub mono: f64,
    /// Since the Unix epoch (s); may jump.
    pub wall: f64,
}

/// What the latest diagnosis says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evidence {
    /// Whether its verdict is stiction.
    pub sticky: bool,
    /// Friction f [% of OP span].
    pub f: f64,
    /// Its 95 % interval [%].
    pub f_ci95: [f64; 2],
    /// When the diagnosis was made (s, wall).
    pub at: f64,
    /// When the stretch of data ended that it is about (s, wall).
    pub data_end: f64,
}

/// What is known of the loop at one step: the newest sample of each tag, with its quality.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Inputs {
    /// Controller output (OP unit).
    pub op: Option<Sample>,
    /// Process variable.
    pub pv: Option<Sample>,
    /// Set point.
    pub sp: Option<Sample>,
    /// 1 in automatic.
    pub mode: Option<Sample>,
    /// Measured stem position (OP unit), where there is one.
    pub mv: Option<Sample>,
    /// The latest diagnosis.
    pub evidence: Option<Evidence>,
    /// Polls of the loop's devices that overran or never began, since the start.
    pub missed_polls: u64,
    /// False while the audit log cannot be written.
    pub audited: bool,
}

/// Every bound, none of them with a default.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// The term is never larger than this [%].
    pub clamp: f64,
    /// The term never changes faster than this while active [%/s].
    pub rate: f64,
    /// The ramp to zero [%/s].
    pub withdraw_rate: f64,
    /// Longest time a withdrawal may take before the heartbeat is stopped (s).
    pub withdraw_limit_s: f64,
    /// OP turns back by more than this before the term changes its sign [%].
    pub dead_band: f64,
    /// OP counts as constant after this long (s).
    pub rest_s: f64,
    /// Longest time between two steps, and from an order to its heartbeat (s).
    pub max_step_s: f64,
    /// After a longer silence the DCS may have dropped the term by the time that a heartbeat reaches it (s).
    pub silence_s: f64,
    /// The two clocks may differ by this from one step to the next (s).
    pub clock_tolerance_s: f64,
    /// Oldest sample that is believed (s).
    pub max_sample_age_s: f64,
    /// Polls that may be missed within a minute.
    pub max_missed_polls: u64,
    /// Span of OP (OP unit).
    pub op_span: f64,
    /// OP's limits (OP unit).
    pub op_limits: [f64; 2],
    /// OP stays this far from its limits [%].
    pub op_margin: f64,
    /// SP is slow up to this (SP unit/s).
    pub sp_rate: f64,
    /// … and steady once it has been slow for this long (s).
    pub sp_settle_s: f64,
    /// Oldest data of a diagnosis that opens (s).
    pub evidence_max_age_s: f64,
    /// Later estimates of f may leave the interval granted by this [%].
    pub f_margin: f64,
    /// Longest grant (s).
    pub grant_max_s: f64,
    /// What has to be shown.
    pub criteria: Criteria,
}

macro_rules! denials {
    ($($(#[$doc:meta])+ $name:ident = $code:literal, $text:literal;)+) => {
        /// Why the gate does not open, or closes.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum Denial { $($(#[$doc])+ $name,)+ }

        impl Denial {
            /// All of them.
            pub const ALL: &[Denial] = &[$(Denial::$name,)+];

            /// The reason for machines.
            pub fn code(self) -> &'static str {
                match self { $(Denial::$name => $code,)+ }
            }

            /// The reason for people.
            pub fn text(self) -> &'static str {
                match self { $(Denial::$name => $text,)+ }
            }
        }
    };
}

denials! {
    /// Never diagnosed.
    NoEvidence = "no_evidence", "the loop has not been diagnosed";
    /// The verdict is another.
    NotSticky = "not_sticky", "the latest verdict is not stiction";
    /// Of data of too long ago, however lately it was made.
    EvidenceOld = "evidence_old", "the data of the latest diagnosis is older than evidence_max_age_s";
    /// f does not fit under the clamp.
    FAboveClamp = "f_above_clamp", "f is larger than clamp_percent: the valve needs more than the term may be";
    /// A later interval of f is apart from the one granted.
    FOutsideInterval = "f_outside_interval", "a later interval of f has no value in common with the one it was granted for";
    /// OP is not there, bad, stale or old.
    OpBad = "op_bad", "OP is bad, stale or too old";
    /// PV is not there, bad, stale or old.
    PvBad = "pv_bad", "PV is bad, stale or too old";
    /// SP is not there, bad, stale or old.
    SpBad = "sp_bad", "SP is bad, stale or too old";
    /// The mode is not there, bad or old.
    ModeBad = "mode_bad", "the mode is bad, stale or too old";
    /// Not in automatic.
    NotAutomatic = "not_automatic", "the loop is not in automatic";
    /// OP is near a limit.
    OpNearLimit = "op_near_limit", "OP is within op_margin_percent of a limit";
    /// SP moves.
    SpMoving = "sp_moving", "SP has moved faster than sp_rate_per_s within sp_settle_s";
    /// No grant.
    NotGranted = "not_granted", "no operator has granted it";
    /// No second person.
    NotApproved = "not_approved", "no second person has approved it";
    /// The grant ran out.
    GrantExpired = "grant_expired", "the grant has expired";
    /// The clock jumped.
    ClockJump = "clock_jump", "the clock has jumped";
    /// A step came late.
    Late = "late", "a step came later than max_step_ms";
    /// Polls were missed.
    PollOverrun = "poll_overrun", "more polls overran or were missed than max_missed_polls_per_minute";
    /// Not yet measured.
    BaselineShort = "baseline_short", "the loop has not been measured for measure_s yet";
    /// Measured while the stem rested: there is no travel to compare with.
    BaselineAtRest = "baseline_at_rest", "the valve has not moved in the measure_s before: there is no travel to compare with";
    /// A write did not come through.
    WriteFailed = "write_failed", "a write was refused or not answered";
    /// The device holds another value than was written.
    ReadBack = "read_back_mismatch", "the device holds another value than was written";
    /// The audit log cannot be written.
    AuditFailed = "audit_failed", "the audit log cannot be written";
    /// A withdrawal took too long, and no write failed.
    NotAtZero = "not_at_zero", "the term was not at zero within withdraw_limit_s";
    /// ISE is worse.
    IseWorse = "ise_worse", "ISE exceeds what it was before, times ise_limit";
    /// Travel is worse.
    TravelWorse = "travel_worse", "the valve travels more than before, times travel_limit";
    /// No gain in time.
    NoImprovement = "no_improvement", "ISE has not improved by ise_gain within prove_s";
}

impl From<Failure> for Denial {
    fn from(failure: Failure) -> Self {
        match failure {
            Failure::Ise => Denial::IseWorse,
            Failure::Travel => Denial::TravelWorse,
            Failure::NoGain => Denial::NoImprovement,
        }
    }
}

/// The newest sample's value when it may be believed at `wall`: good, not older than allowed, not from the future.
pub(super) fn believed(sample: Option<Sample>, wall: f64, limits: &Limits) -> Option<f64> {
    let sample = sample?;
    let age = wall - sample.t;
    let fresh = age <= limits.max_sample_age_s && age >= -limits.clock_tolerance_s;
    (sample.quality.is_good() && sample.value.is_finite() && fresh).then_some(sample.value)
}

/// What is wrong with the loop's data at this moment: it keeps the gate shut, and closes it.
pub(super) fn data(inputs: &Inputs, wall: f64, limits: &Limits, out: &mut Vec<Denial>) {
    let value = |sample| believed(sample, wall, limits);
    match value(inputs.op) {
        None => out.push(Denial::OpBad),
        Some(op) => {
            let margin = 0.01 * limits.op_margin * limits.op_span;
            let [low, high] = limits.op_limits;
            if !(op >= low + margin && op <= high - margin) {
                out.push(Denial::OpNearLimit);
            }
        }
    }
    match value(inputs.mode) {
        None => out.push(Denial::ModeBad),
        Some(mode) if mode != 1.0 => out.push(Denial::NotAutomatic),
        Some(_) => {}
    }
    for (sample, denial) in [(inputs.pv, Denial::PvBad), (inputs.sp, Denial::SpBad)] {
        if value(sample).is_none() {
            out.push(denial);
        }
    }
    if !inputs.audited {
        out.push(Denial::AuditFailed);
    }
}

/// What is wrong with the evidence for opening now.
pub(super) fn evidence(inputs: &Inputs, wall: f64, limits: &Limits) -> Option<Denial> {
    let Some(evidence) = inputs.evidence else {
        return Some(Denial::NoEvidence);
    };
    let [low, high] = evidence.f_ci95;
    // Also false where one of them is no number.
    let usable = low <= evidence.f && evidence.f <= high && evidence.f > 0.0;
    if !evidence.sticky || !usable {
        return Some(Denial::NotSticky);
    }
    let age = wall - evidence.data_end;
    if !(age <= limits.evidence_max_age_s && age >= -limits.clock_tolerance_s) {
        return Some(Denial::EvidenceOld);
    }
    (evidence.f > limits.clamp).then_some(Denial::FAboveClamp)
}
