//! k of n: how many of the last observations raise or clear a condition.

use std::collections::VecDeque;

/// One observation of a condition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Observation {
    /// It is there.
    Present,
    /// It is not there, and below the threshold to clear.
    Absent,
    /// Not there, yet within the dead-band: takes a place in both counts and a side in neither.
    Between,
    /// Cannot be told: no vote.
    Unknown,
}

/// How many observations it takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rule {
    /// Present, of the last `n`, to raise.
    pub k: usize,
    /// See `k`.
    pub n: usize,
    /// Absent, of the last `clear_n`, to clear.
    pub clear_k: usize,
    /// See `clear_k`.
    pub clear_n: usize,
}

impl Rule {
    fn room(self) -> usize {
        self.n.max(self.clear_n).max(1)
    }
}

/// Observations since the condition last changed, as many as the rule looks back on.
#[derive(Clone, Debug, Default)]
pub struct Votes(VecDeque<Observation>);

impl Votes {
    /// The votes as they were saved; what is no vote is left out.
    pub fn restored(saved: Vec<Observation>, rule: Rule) -> Self {
        let mut votes = Self(saved.into());
        votes.0.retain(|vote| *vote != Observation::Unknown);
        votes.bound(rule);
        votes
    }

    /// Oldest first.
    pub fn saved(&self) -> Vec<Observation> {
        self.0.iter().copied().collect()
    }

    /// Takes an observation; true when the condition, which now is `active`, has to change.
    pub fn take(&mut self, observation: Observation, rule: Rule, active: bool) -> bool {
        if observation == Observation::Unknown {
            return false;
        }
        self.0.push_back(observation);
        self.bound(rule);
        let (wanted, enough, of) = if active {
            (Observation::Absent, rule.clear_k, rule.clear_n)
        } else {
            (Observation::Present, rule.k, rule.n)
        };
        let changes = self.0.iter().rev().take(of).filter(|&&vote| vote == wanted).count() >= enough.max(1);
        if changes {
            // Counting starts afresh, so that the votes that raised an alarm cannot help to raise it again.
            self.0.clear();
        }
        changes
    }

    fn bound(&mut self, rule: Rule) {
        while self.0.len() > rule.room() {
            self.0.pop_front();
        }
    }
}
