//! Generator A: four classes of loops in discrete time, Choudhury's, He's and one-parameter valves.

pub mod plant;
pub mod valve;

use super::{Case, Generator, Size, Truth};
use plant::{LOOPS, Undeclared, VALVES};
use stictiond_numerics::residual::Kind;
use stictiond_numerics::signal::Record;

/// Generator A.
pub const A: Generator = Generator { name: "A", variants, record, before };

/// Friction that differs or drifts needs friction.
fn needs_friction(effect: Option<Kind>) -> bool {
    matches!(effect, Some(Kind::AsymmetricFriction | Kind::FrictionDrift))
}

fn variants(effect: Option<Kind>) -> usize {
    LOOPS.len() * (VALVES.len() - usize::from(needs_friction(effect)))
}

fn own(case: &Case) -> plant::Case {
    plant::Case {
        class: case.variant % LOOPS.len(),
        valve: case.variant / LOOPS.len() + usize::from(needs_friction(case.effect)),
        undeclared: case.effect.map_or(Undeclared::Nothing, Undeclared::Listed),
        size: match case.size {
            Size::Small => 0,
            Size::Medium => 1,
            Size::Large => 2,
        },
        seed: case.seed,
        tags: case.tags,
    }
}

fn before(case: &Case, friction: f64) -> Record {
    plant::before(&own(case), friction)
}

fn record(case: &Case) -> (Record, Truth) {
    let own = own(case);
    let (record, truth) = plant::record(&own);
    let name = format!("{} {}", LOOPS[own.class], VALVES[own.valve].0);
    // Of the slip jump only that there is one is told.
    let also = if truth.slips { vec![Kind::SlipJump] } else { Vec::new() };
    let j = if truth.slips { f64::NAN } else { 2.0 * truth.f };
    (record, Truth { name, f: truth.f, j, also, load: truth.load })
}
