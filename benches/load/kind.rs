//! The kinds of loops that a run may have.

use super::plant::excited;
use stictiond::sim::scenarios::{Scenario, random_sound, random_sticky};

/// Records of the loops that are drawn at random.
const RECORDS: u64 = 32;

/// The loops of a plant.
#[derive(Clone, Copy)]
pub enum Kind {
    /// Drawn at random, half of them sticking. A record has 1,500 samples and is repeated, so that a window has seams and hardly
    /// any loop is identifiable.
    Random,
    /// A third cycle, a third stick, a third are at rest.
    Excited,
}

impl Kind {
    pub const ALL: [Self; 2] = [Self::Random, Self::Excited];

    /// As `--kind` has it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Random => "random",
            Self::Excited => "excited",
        }
    }

    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Random => "drawn at random, half sticking, with seams",
            Self::Excited => "a third cycling, a third sticking, a third at rest",
        }
    }

    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// What the loops replay.
    pub fn scenarios(self) -> Vec<Scenario> {
        let random = |seed: u64| {
            if seed.is_multiple_of(2) { random_sticky(seed) } else { random_sound(seed) }
        };
        match self {
            Self::Random => (0..RECORDS).map(random).collect(),
            Self::Excited => excited(),
        }
    }
}
