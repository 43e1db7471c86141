//! One order and its states.
//!
//! ```text
//!                 seen for persist_s              ordered by somebody          done, says somebody
//!     watched ------------------------> open ------------------------> ordered ------------------> repaired
//!        |                               ^ |                                                         |   |
//!        | not seen                      | | not seen for persist_s                                  |   |
//!        v                               | v                                not seen for persist_s   |   |
//!     (forgotten)                        | calmed                     verified <--------------------+   |
//!                                        +--------------------------------------------------------------+
//!                                                            still seen for persist_s
//! ```
//!
//! An order is opened only for a cause that is known. Where the cause of a suspicion that lasts, or of what begins anew, is `unknown`, it
//! is `unexplained` instead:
//!
//! ```text
//!     watched, calmed, verified ---seen, cause unknown---> unexplained ---seen, cause known---> open
//!                                                               +---------not seen------------> calmed
//! ```
//!
//! Somebody may say that a watched, unexplained or open order is not wanted (`dismissed`), and open one again that is over.
//! "Seen for `persist_s`" means in at least [`MOSTLY`] of the looks of the last `persist_s`; "not seen" in at most [`HARDLY`].
//!
//! Which loops are expected to calm down with it is said of how the plant swings now: by the latest look alone.
//!
//! A window reaches back for hours or days. So a repair is judged only by looks whose windows begin after it: where they are long,
//! that takes as long as they are, and half of `persist_s` more. An earlier look would see the swing that the repair has ended.

use super::config::Config;
use crate::plantwide::{Cause, Part};
use crate::signal::LoopId;
use std::collections::VecDeque;

/// Share of the looks that is most of them.
pub const MOSTLY: f64 = 0.8;
/// Share of the looks that is hardly any.
pub const HARDLY: f64 = 0.2;
/// Share of the looks of `persist_s` that have to be there before they count: a daemon may have stood still.
const THERE: f64 = 0.5;
/// Looks that are remembered of an order.
const LOOKS: usize = 240;
/// An order that is over is forgotten when its loop was not suspected for so long (s): a quarter of a year.
const FORGOTTEN_S: f64 = 7_776_000.0;

/// Where an order stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum State {
    /// Suspected, and not for long.
    Watched,
    /// Not at rest for long, for a cause that is not known: there is nothing to order yet.
    Unexplained,
    /// Somebody should order the work.
    Open,
    /// Somebody has.
    Ordered,
    /// Somebody says that it is done; what is measured has to bear it out.
    Repaired,
    /// What is measured bears it out.
    Verified,
    /// The loop has calmed down by itself.
    Calmed,
    /// Somebody does not want it.
    Dismissed,
}

impl State {
    /// Every state.
    pub const ALL: [State; 8] = [
        State::Watched,
        State::Unexplained,
        State::Open,
        State::Ordered,
        State::Repaired,
        State::Verified,
        State::Calmed,
        State::Dismissed,
    ];

    /// As reports write it.
    pub fn as_str(self) -> &'static str {
        match self {
            State::Watched => "watched",
            State::Unexplained => "unexplained",
            State::Open => "open",
            State::Ordered => "ordered",
            State::Repaired => "repaired",
            State::Verified => "verified",
            State::Calmed => "calmed",
            State::Dismissed => "dismissed",
        }
    }

    /// The state of a name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.as_str() == name)
    }

    /// Whether nothing is left to do.
    pub fn is_over(self) -> bool {
        matches!(self, State::Verified | State::Calmed | State::Dismissed)
    }

    /// Whether somebody has something to do.
    pub fn is_standing(self) -> bool {
        matches!(self, State::Open | State::Ordered | State::Repaired)
    }
}

/// What somebody does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Act {
    /// Orders the work.
    Order,
    /// Says that it is done.
    Repaired,
    /// Does not want it.
    Dismiss,
    /// Opens it again.
    Reopen,
}

/// Why somebody's act is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("an order that is {0} cannot be {1}")]
pub struct Refusal(pub &'static str, pub &'static str);

/// What a look at the plant said of a loop that it suspects.
#[derive(Clone, Debug, PartialEq)]
pub struct Seen {
    /// Why it is not at rest.
    pub cause: Cause,
    /// Probability of the cause (0..1); none of an unknown one.
    pub probability: Option<f64>,
    /// Loops that are expected to be calmer with it, in the mean.
    pub worth: f64,
    /// One sentence.
    pub why: String,
    /// Whether nothing is gained by removing the cause.
    pub gains_nothing: bool,
    /// Loops that are expected to calm down with it.
    pub victims: Vec<LoopId>,
}

/// How a loop was when it was looked at.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measure {
    /// Standard deviation of the error (PV unit).
    pub error_sd: Option<f64>,
    /// Share of the error's variance in oscillations (0..1).
    pub swing: Option<f64>,
    /// Friction (% of OP span, or OP units).
    pub f: Option<f64>,
}

/// One look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// When (s).
    pub at: f64,
    /// Since when there were samples in it (s); minus infinity where that was not kept.
    pub from: f64,
    /// The cause that was suspected and its probability, where it has one; none where nothing was.
    pub cause: Option<(Cause, Option<f64>)>,
    /// Loops that were expected to be calmer with it, in the mean; 0 where nothing was suspected.
    pub worth: f64,
    /// How the loop was.
    pub measure: Measure,
}

/// A change of the state.
#[derive(Clone, Debug, PartialEq)]
pub struct Move {
    /// State before.
    pub from: State,
    /// State after.
    pub to: State,
    /// When (s).
    pub at: f64,
    /// Who acted; none where the measurements did.
    pub by: Option<String>,
    /// What they said.
    pub note: Option<String>,
}

/// One order.
#[derive(Clone, Debug, PartialEq)]
pub struct Order {
    /// The loop to look at.
    pub id: LoopId,
    /// Where it stands.
    pub state: State,
    /// Since when (s).
    pub since: f64,
    /// When the loop was first suspected (s).
    pub first: f64,
    /// When it was last suspected (s).
    pub suspected: f64,
    /// What was said last of the cause that is shown: that cause and a sentence.
    pub why: Option<(Cause, String)>,
    /// Whether nothing is gained by removing that cause, as was said with the sentence.
    pub gains_nothing: bool,
    /// Loops that are expected to calm down with it, by the latest look; none where that suspected nothing or could not judge it.
    pub victims: Vec<LoopId>,
    /// The latest looks, oldest first.
    pub looks: VecDeque<Look>,
    /// How the loop was before it was repaired, in the mean of the looks that suspected it, and when somebody said that it was
    /// repaired (s).
    pub before: Option<(Measure, f64)>,
    /// How it is since then, in the mean, once that is decided.
    pub after: Option<Measure>,
    /// Who acted last.
    pub by: Option<String>,
    /// What they said.
    pub note: Option<String>,
    /// How often a repair did not help.
    pub reopened: u32,
}

impl Order {
    /// An order for a loop that is suspected for the first time.
    pub fn new(id: LoopId, now: f64) -> Self {
        Self {
            id,
            state: State::Watched,
            since: now,
            first: now,
            suspected: now,
            why: None,
            gains_nothing: false,
            victims: Vec::new(),
            looks: VecDeque::new(),
            before: None,
            after: None,
            by: None,
            note: None,
            reopened: 0,
        }
    }

    /// The cause that was suspected most often and the mean of its probability (0..1; none of an unknown one), over the looks that
    /// are remembered. Of causes that were suspected as often a known one, and of those the one that was suspected last.
    pub fn cause(&self) -> Option<(Cause, Option<f64>)> {
        let mut tallies = Cause::ALL.map(|cause| Tally { cause, ..Tally::NONE });
        for (at, (cause, probability)) in self.looks.iter().filter_map(|look| look.cause).enumerate() {
            let Some(own) = tallies.iter_mut().find(|own| own.cause == cause) else { continue };
            (own.looks, own.last) = (own.looks + 1, at);
            if let Some(p) = probability {
                (own.known, own.sum) = (own.known + 1, own.sum + p);
            }
        }
        let suspected = tallies.into_iter().filter(|own| own.looks > 0);
        let most = suspected.max_by_key(|own| (own.looks, own.cause != Cause::Unknown, own.last))?;
        Some((most.cause, (most.known > 0).then(|| most.sum / f64::from(most.known))))
    }

    /// Whether its cause is known.
    fn is_explained(&self) -> bool {
        self.cause().is_some_and(|(cause, _)| cause != Cause::Unknown)
    }

    /// The part of the work list that it belongs to; none of a suspicion that has not lasted yet and of what is over. What people have
    /// ordered is to be done, whatever the cause.
    pub fn part(&self) -> Option<Part> {
        match self.state {
            State::Ordered | State::Repaired => Some(Part::First),
            State::Open => {
                let part = |(cause, probability)| Part::of(cause, probability, self.gains_nothing);
                Some(self.cause().map_or(Part::Unknown, part))
            }
            State::Unexplained => Some(Part::Unknown),
            State::Watched | State::Verified | State::Calmed | State::Dismissed => None,
        }
    }

    /// Loops that are expected to be calmer with it, in the mean over the looks that are remembered and suspected it.
    pub fn worth(&self) -> f64 {
        let own = self.looks.iter().filter(|look| look.cause.is_some());
        let (count, sum) = own.fold((0_u32, 0.0), |(count, sum), look| (count + 1, sum + look.worth));
        if count > 0 { sum / f64::from(count) } else { 0.0 }
    }

    /// Whether it is over, and its loop at rest, for so long that nobody asks. Somebody who does not want it has said so of this
    /// suspicion: for as long as that lasts it does not begin anew.
    pub fn is_forgotten(&self, now: f64) -> bool {
        match self.state {
            State::Watched => self.looks.iter().rev().take(3).all(|look| look.cause.is_none()),
            state => state.is_over() && now - self.since.max(self.suspected) > FORGOTTEN_S,
        }
    }

    /// Takes a look at the loop, by samples since `from`.
    pub fn take(
        &mut self,
        seen: Option<&Seen>,
        measure: Measure,
        from: f64,
        now: f64,
        config: &Config,
    ) -> Option<Move> {
        let set_back = self.looks.back().is_some_and(|last| last.at >= now);
        if set_back {
            // A clock that was set back: what was seen "later" says nothing of now.
            self.looks.clear();
        }
        // Nor has anything stood since then: it would stand still until the clock comes there again. Who acts while a look is made
        // acts later than that, and sets no clock.
        if set_back || self.first.max(self.since) > now + config.period_s {
            (self.first, self.since) = (self.first.min(now), self.since.min(now));
        }
        let cause = seen.map(|seen| (seen.cause, seen.probability));
        let worth = seen.map_or(0.0, |seen| seen.worth);
        self.looks.push_back(Look { at: now, from, cause, worth, measure });
        if self.looks.len() > LOOKS {
            self.looks.pop_front();
        }
        self.suspected = if seen.is_some() { now } else { self.suspected.min(now) };
        self.victims = seen.map(|seen| seen.victims.clone()).unwrap_or_default();
        // The sentence is that of the cause which is shown.
        let shown = self.cause().map(|(cause, _)| cause);
        if let Some(seen) = seen
            && (shown == Some(seen.cause) || self.why.as_ref().map(|own| own.0) != shown)
        {
            self.why = Some((seen.cause, seen.why.clone()));
            self.gains_nothing = seen.gains_nothing;
        }
        self.moved(now, config)
    }

    /// The clock was set by so much (s): what it stamped between two times (s) is as long ago as before. Whether anything was.
    pub fn clock_was_set(&mut self, [from, until]: [f64; 2], by: f64) -> bool {
        let looks = self.looks.iter_mut().flat_map(|look| [&mut look.at, &mut look.from]);
        let repaired = self.before.iter_mut().map(|(_, at)| at);
        let own = [&mut self.first, &mut self.since, &mut self.suspected];
        let mut any = false;
        for t in own.into_iter().chain(looks).chain(repaired).filter(|t| (from..=until).contains(&**t)) {
            *t += by;
            any = true;
        }
        any
    }

    fn moved(&mut self, now: f64, config: &Config) -> Option<Move> {
        let share = self.share(now, config);
        let begun = if self.is_explained() { State::Open } else { State::Unexplained };
        let to = match (self.state, share?) {
            (State::Watched, share) if share >= MOSTLY => begun,
            (State::Unexplained, share) if share >= MOSTLY && begun == State::Open => State::Open,
            (State::Unexplained | State::Open, share) if share <= HARDLY => State::Calmed,
            (State::Repaired, share) if share <= HARDLY => State::Verified,
            (State::Repaired, share) if share >= MOSTLY => State::Open,
            // What was over begins anew: as a suspicion, and by the next look as an order.
            (State::Calmed | State::Verified, share) if share >= MOSTLY => begun,
            _ => return None,
        };
        if self.state == State::Repaired {
            self.after = Some(self.mean(|look| look.from >= self.since));
            self.reopened += u32::from(to == State::Open);
        }
        Some(self.go(to, None, None, now))
    }

    /// Share of the looks of the last `persist_s` that suspected it; none where there are not enough of this state yet.
    fn share(&self, now: f64, config: &Config) -> Option<f64> {
        let from = now - config.persist_s;
        // A suspicion counts from its first look, every other state from when it began.
        let is_suspicion = matches!(self.state, State::Watched | State::Unexplained);
        let begun = if is_suspicion { self.first } else { self.since };
        if begun > from + 0.5 * config.period_s {
            return None;
        }
        let own: Vec<bool> = self
            .looks
            .iter()
            .filter(|look| look.at >= from && look.at >= begun)
            .filter(|look| self.state != State::Repaired || look.from >= begun)
            .map(|look| look.cause.is_some())
            .collect();
        let enough = THERE * config.persist_s / config.period_s;
        let seen = own.iter().filter(|seen| **seen).count();
        (own.len() as f64 >= enough).then(|| seen as f64 / own.len() as f64)
    }

    /// The mean of what was measured in some of the looks; standard deviations as the root of the mean square.
    fn mean(&self, counts: impl Fn(&Look) -> bool) -> Measure {
        let over = |of: &dyn Fn(&Measure) -> Option<f64>| {
            let own = self.looks.iter().filter(|look| counts(look));
            let all: Vec<f64> = own.filter_map(|look| of(&look.measure)).collect();
            (!all.is_empty()).then(|| all.iter().sum::<f64>() / all.len() as f64)
        };
        Measure {
            error_sd: over(&|m| m.error_sd.map(|sd| sd * sd)).map(f64::sqrt),
            swing: over(&|m| m.swing),
            f: over(&|m| m.f),
        }
    }

    /// Somebody acts.
    ///
    /// # Errors
    /// [`Refusal`], where its state does not allow it.
    pub fn act(
        &mut self,
        act: Act,
        by: Option<String>,
        note: Option<String>,
        now: f64,
    ) -> Result<Move, Refusal> {
        let to = match (act, self.state) {
            (Act::Order, State::Watched | State::Unexplained | State::Open) => State::Ordered,
            (Act::Order, state) => return Err(Refusal(state.as_str(), "ordered")),
            (Act::Repaired, State::Watched | State::Unexplained | State::Open | State::Ordered) => {
                State::Repaired
            }
            (Act::Repaired, state) => return Err(Refusal(state.as_str(), "repaired")),
            (Act::Dismiss, State::Watched | State::Unexplained | State::Open | State::Ordered) => {
                State::Dismissed
            }
            (Act::Dismiss, state) => return Err(Refusal(state.as_str(), "dismissed")),
            (Act::Reopen, State::Watched | State::Unexplained | State::Open) => {
                return Err(Refusal(self.state.as_str(), "reopened"));
            }
            (Act::Reopen, _) => State::Open,
        };
        if to == State::Repaired {
            self.before = Some((self.mean(|look| look.cause.is_some()), now));
            self.after = None;
        }
        (self.by, self.note) = (by.clone(), note.clone());
        Ok(self.go(to, by, note, now))
    }

    fn go(&mut self, to: State, by: Option<String>, note: Option<String>, now: f64) -> Move {
        let from = std::mem::replace(&mut self.state, to);
        self.since = now;
        Move { from, to, at: now, by, note }
    }
}

/// How often a cause was suspected.
#[derive(Clone, Copy)]
struct Tally {
    cause: Cause,
    looks: u32,
    /// The last of the looks that suspected anything which suspected it.
    last: usize,
    /// Looks in which it had a probability, and the sum of those.
    known: u32,
    sum: f64,
}

impl Tally {
    const NONE: Self = Self { cause: Cause::Unknown, looks: 0, last: 0, known: 0, sum: 0.0 };
}
