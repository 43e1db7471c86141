//! States, what moves an alarm from one to another, and why an action is refused.

/// What the operator sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum State {
    /// No condition, nothing to do.
    Normal,
    /// The condition holds and nobody has seen it.
    Unacknowledged,
    /// The condition holds and somebody has seen it.
    Acknowledged,
    /// The condition went away before anybody saw it.
    ReturnedUnacknowledged,
    /// The condition went away, the alarm stays, and nobody has seen it.
    LatchedUnacknowledged,
    /// The condition went away, somebody has seen it, and the alarm stays until it is reset.
    LatchedAcknowledged,
    /// Silenced by an operator until a time, or until the condition goes.
    Shelved,
    /// Silenced by the design of the plant: it says nothing new, or is not wanted here.
    SuppressedByDesign,
    /// Taken out of service by hand, until it is given back.
    OutOfService,
}

impl State {
    /// Every state, for metrics and schemas.
    pub const ALL: [State; 9] = [
        State::Normal,
        State::Unacknowledged,
        State::Acknowledged,
        State::ReturnedUnacknowledged,
        State::LatchedUnacknowledged,
        State::LatchedAcknowledged,
        State::Shelved,
        State::SuppressedByDesign,
        State::OutOfService,
    ];

    /// The state as the API writes it.
    pub fn as_str(self) -> &'static str {
        match self {
            State::Normal => "normal",
            State::Unacknowledged => "unacknowledged",
            State::Acknowledged => "acknowledged",
            State::ReturnedUnacknowledged => "returned-unacknowledged",
            State::LatchedUnacknowledged => "latched-unacknowledged",
            State::LatchedAcknowledged => "latched-acknowledged",
            State::Shelved => "shelved",
            State::SuppressedByDesign => "suppressed-by-design",
            State::OutOfService => "out-of-service",
        }
    }

    /// The state of this name.
    pub fn named(name: &str) -> Option<State> {
        State::ALL.into_iter().find(|state| state.as_str() == name)
    }

    /// Whether it waits for somebody to see it.
    pub fn wants_acknowledgement(self) -> bool {
        matches!(self, State::Unacknowledged | State::ReturnedUnacknowledged | State::LatchedUnacknowledged)
    }

    /// Whether nobody is told of what happens in it.
    pub fn is_silent(self) -> bool {
        matches!(self, State::Shelved | State::SuppressedByDesign | State::OutOfService)
    }
}

/// Why the state changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The condition came.
    Raised,
    /// The condition holds, and its priority rose: the state stays.
    MoreUrgent,
    /// The condition went.
    Cleared,
    /// An operator acknowledged.
    Acknowledged,
    /// Somebody reset what was latched.
    Reset,
    /// An operator shelved.
    Shelved,
    /// An operator ended the shelving.
    Unshelved,
    /// The shelving ran out.
    Expired,
    /// The condition that was shelved once has gone.
    OneShotOver,
    /// The design began to suppress it.
    Suppressed,
    /// The design no longer suppresses it.
    Unsuppressed,
    /// Taken out of service.
    TakenOut,
    /// Given back to service.
    Returned,
    /// A start did not know how it was left, or the configuration has it no more.
    Forgotten,
    /// How it was left before the start became known.
    Restored,
}

impl Cause {
    /// Every cause.
    pub const ALL: [Cause; 15] = [
        Cause::Raised,
        Cause::MoreUrgent,
        Cause::Cleared,
        Cause::Acknowledged,
        Cause::Reset,
        Cause::Shelved,
        Cause::Unshelved,
        Cause::Expired,
        Cause::OneShotOver,
        Cause::Suppressed,
        Cause::Unsuppressed,
        Cause::TakenOut,
        Cause::Returned,
        Cause::Forgotten,
        Cause::Restored,
    ];

    /// The cause as the API writes it.
    pub fn as_str(self) -> &'static str {
        match self {
            Cause::Raised => "raised",
            Cause::MoreUrgent => "more_urgent",
            Cause::Cleared => "cleared",
            Cause::Acknowledged => "acknowledged",
            Cause::Reset => "reset",
            Cause::Shelved => "shelved",
            Cause::Unshelved => "unshelved",
            Cause::Expired => "shelving_expired",
            Cause::OneShotOver => "shelving_over",
            Cause::Suppressed => "suppressed",
            Cause::Unsuppressed => "unsuppressed",
            Cause::TakenOut => "out_of_service",
            Cause::Returned => "in_service",
            Cause::Forgotten => "forgotten",
            Cause::Restored => "restored",
        }
    }

    /// The cause of this name.
    pub fn named(name: &str) -> Option<Cause> {
        Cause::ALL.into_iter().find(|cause| cause.as_str() == name)
    }
}

/// One arrow of the diagram, taken; or what is to be told of a state that stays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transition {
    /// State before.
    pub from: State,
    /// State after.
    pub to: State,
    /// When (s).
    pub at: f64,
    /// Why.
    pub cause: Cause,
}

/// How long an alarm is shelved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shelving {
    /// For this long (s).
    For(f64),
    /// Until its condition goes, and at most this long (s).
    Once(f64),
}

/// Why an action was refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// Only an unacknowledged alarm can be acknowledged.
    #[error("there is nothing to acknowledge: the alarm is {}", .0.as_str())]
    NothingToAcknowledge(State),
    /// Only a latched alarm that somebody has seen can be reset.
    #[error("there is nothing to reset: the alarm is {}", .0.as_str())]
    NothingToReset(State),
    /// Only a shelved alarm can be unshelved.
    #[error("the alarm is not shelved: it is {}", .0.as_str())]
    NotShelved(State),
    /// Only an alarm whose condition holds can be shelved until it goes.
    #[error("the condition does not hold, so there is nothing to shelve once: shelve for a time")]
    NothingToShelve,
    /// An alarm out of service cannot be shelved.
    #[error("the alarm is out of service")]
    OutOfService,
    /// Only an alarm out of service can be given back.
    #[error("the alarm is in service: it is {}", .0.as_str())]
    InService(State),
    /// Shelving needs a positive, bounded time.
    #[error("an alarm can be shelved for more than 0 s and at most {max_s} s{}", in_days(*max_s))]
    BadDuration {
        /// The longest time allowed (s).
        max_s: f64,
    },
    /// The alarm is another machine's, and another centre gives the orders.
    #[error("another centre acts for the fleet at present: do it there")]
    NotLeading,
}

/// So many seconds in days, where it is one or more.
fn in_days(s: f64) -> String {
    let days = (10.0 * s / 86_400.0).round() / 10.0;
    match days {
        days if days < 1.0 => String::new(),
        1.0 => " (1 day)".to_string(),
        days => format!(" ({days} days)"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_shelving_is_told_in_days_too() {
        let told = |max_s| Refusal::BadDuration { max_s }.to_string();
        let begins = "an alarm can be shelved for more than 0 s and at most ";
        assert_eq!(told(604_800.0), format!("{begins}604800 s (7 days)"));
        assert_eq!(told(86_400.0), format!("{begins}86400 s (1 day)"));
        assert_eq!(told(129_600.0), format!("{begins}129600 s (1.5 days)"));
        assert_eq!(told(3600.0), format!("{begins}3600 s"));
    }
}
