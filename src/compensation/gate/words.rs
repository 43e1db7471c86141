//! The gate's words: its states, what happens to it, what it hands out.

use super::conditions::{Denial, Limits, Time};
use crate::compensation::measure::Measured;

/// Where a gate is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum State {
    /// Off, or stopped.
    Disabled,
    /// Computes and records, writes nothing.
    Shadow,
    /// Granted and approved; opens when every condition holds.
    Armed,
    /// Writes the term.
    Active,
    /// Writes the term on its way to zero.
    Withdrawing,
    /// Closed by a fault; an operator has to reset it.
    Tripped,
}

impl State {
    /// Every state.
    pub const ALL: [State; 6] =
        [State::Disabled, State::Shadow, State::Armed, State::Active, State::Withdrawing, State::Tripped];

    /// The state as the API writes it.
    pub fn as_str(self) -> &'static str {
        match self {
            State::Disabled => "disabled",
            State::Shadow => "shadow",
            State::Armed => "armed",
            State::Active => "active",
            State::Withdrawing => "withdrawing",
            State::Tripped => "tripped",
        }
    }

    /// Whether anything is written in it.
    pub fn writes(self) -> bool {
        matches!(self, State::Active | State::Withdrawing)
    }
}

/// Why the state changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The configuration enables it.
    Enabled,
    /// A second person approved the grant.
    Approved,
    /// Every condition holds.
    Opened,
    /// Something speaks against it.
    Denied(Denial),
    /// An operator.
    Operator,
    /// Zero was written and read back.
    AtZero,
    /// Zero could not be written in time; the heartbeat is stopped instead.
    NotAtZero,
    /// An operator has reset the trip.
    Reset,
    /// The daemon stops, or takes another configuration.
    Stopped,
}

impl Cause {
    /// The cause for machines.
    pub fn code(self) -> &'static str {
        match self {
            Cause::Enabled => "enabled",
            Cause::Approved => "approved",
            Cause::Opened => "opened",
            Cause::Denied(denial) => denial.code(),
            Cause::Operator => "operator",
            Cause::AtZero => "at_zero",
            Cause::NotAtZero => "not_at_zero_in_time",
            Cause::Reset => "reset",
            Cause::Stopped => "stopped",
        }
    }
}

/// Something that happened, and when (s, wall).
#[derive(Clone, Debug, PartialEq)]
pub struct News {
    /// When.
    pub at: f64,
    /// What.
    pub event: Event,
    /// What tripped it, while it is tripped: the move there says only how the term came to zero.
    pub tripped_by: Option<Denial>,
}

/// What can happen.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// One arrow of the diagram.
    Moved {
        /// State before.
        from: State,
        /// State after.
        to: State,
        /// Why.
        cause: Cause,
        /// Who, where somebody did.
        by: Option<String>,
    },
    /// A grant was given.
    Granted {
        /// By whom.
        by: String,
        /// Until when (s, wall).
        until: f64,
    },
    /// A grant was approved.
    Approved {
        /// By whom.
        by: String,
    },
    /// A grant ran out before anything came of it.
    GrantExpired,
    /// A grant was taken back before it was approved.
    GrantDropped {
        /// By whom.
        by: String,
    },
}

/// An operator's permission for one activation.
#[derive(Clone, Debug, PartialEq)]
pub struct Grant {
    /// Who gave it.
    pub by: String,
    /// Who approved it.
    pub approved_by: Option<String>,
    /// Until when, on both clocks.
    pub until: Time,
}

/// What may be written now. Only a gate makes one.
#[derive(Debug, PartialEq)]
#[must_use]
pub struct Order {
    term: f64,
    heartbeat: u16,
    made: Time,
    /// Longest time after which it may still be sent (s).
    lasts_s: f64,
    /// The two clocks may differ by this since it was made (s).
    clock_tolerance_s: f64,
}

impl Order {
    pub(super) fn new(term: f64, heartbeat: u16, made: Time, limits: &Limits) -> Self {
        let Limits { max_step_s: lasts_s, clock_tolerance_s, .. } = *limits;
        Self { term, heartbeat, made, lasts_s, clock_tolerance_s }
    }

    /// An order that no gate made.
    #[cfg(test)]
    pub(super) fn of_test(term: f64, heartbeat: u16, limits: &Limits) -> Self {
        Self::new(term, heartbeat, Time { mono: 0.0, wall: 0.0 }, limits)
    }

    /// When it was made.
    pub(super) fn made(&self) -> Time {
        self.made
    }

    /// Whether it may still be sent. A process that was frozen, or a machine that slept, has an order of before, while the DCS
    /// has dropped the term.
    pub fn holds(&self, now: Time) -> bool {
        let (mono, wall) = (now.mono - self.made.mono, now.wall - self.made.wall);
        // Comparisons that a NaN fails too.
        (0.0..=self.lasts_s).contains(&mono) && (wall - mono).abs() <= self.clock_tolerance_s
    }

    /// The term [% of OP span].
    pub fn term(&self) -> f64 {
        self.term
    }

    /// A number that differs from the last order's.
    pub fn heartbeat(&self) -> u16 {
        self.heartbeat
    }
}

/// How a write failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WriteFault {
    /// Refused, unanswered, or the link broke.
    Failed,
    /// Acknowledged, but the device holds something else.
    ReadBack,
    /// Not written, because it could not be put on record first.
    Audit,
    /// Not sent, or not whole: it had become too old, or somebody acted meanwhile. What that means the next step finds.
    Withheld,
}

/// What an operator does.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Allows it for this long (s).
    Grant(f64),
    /// Agrees, as a second person.
    Approve,
    /// Takes it back.
    Withdraw,
    /// Resets a trip.
    Reset,
}

/// Why an action was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// The state does not allow it.
    #[error("write-back is {}; this is possible in {} only", is.as_str(), wanted.as_str())]
    NotIn {
        /// Where it is.
        is: State,
        /// Where it would have to be.
        wanted: State,
    },
    /// Nobody is named.
    #[error("an operator's name is needed")]
    Nameless,
    /// The time is out of bounds.
    #[error("a grant lasts more than 0 s and at most {max_s} s")]
    BadDuration {
        /// Longest (s).
        max_s: f64,
    },
    /// There is no grant to approve.
    #[error("there is no grant that waits for approval")]
    NothingGranted,
    /// One person cannot do both.
    #[error("the person who granted cannot approve")]
    SamePerson,
    /// There is nothing to withdraw.
    #[error("there is nothing to withdraw: write-back is {}", .0.as_str())]
    NothingToWithdraw(State),
    /// The audit log took no entry, or not in time.
    #[error(
        "it could not be put on record: a grant or an approval counts as not given; the daemon's log says why"
    )]
    Unrecorded,
}

/// A gate at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct Status {
    /// Where it is.
    pub state: State,
    /// Since when (s, wall).
    pub since: Option<f64>,
    /// The term [%]; in shadow and armed what it would be.
    pub term: f64,
    /// The term in force [%].
    pub in_force: f64,
    /// What speaks against it at the latest step.
    pub denials: Vec<Denial>,
    /// The grant.
    pub grant: Option<Grant>,
    /// What tripped it.
    pub tripped_by: Option<Denial>,
    /// How much of the time before is measured (s).
    pub baseline_s: f64,
    /// Measured before the latest activation.
    pub before: Option<Measured>,
    /// Measured over the latest whole stretch with the term.
    pub with: Option<Measured>,
    /// The stretch under way.
    pub running: Option<Measured>,
    /// Whether a whole stretch has shown the gain asked for.
    pub proven: bool,
}
