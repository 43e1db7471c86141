//! What keeps a gate shut.

use super::*;

#[test]
fn a_loop_whose_valve_rested_is_not_opened_until_it_moves() {
    let mut world = World::new();
    world.turn = 0.0;
    (0..8).for_each(|_| world.tick(1.0, 0.0));
    world.grant("Ann", 60.0);
    world.approve("Bob");
    (0..3).for_each(|_| world.tick(1.0, 0.0));
    assert_eq!(world.gate.state(), State::Armed);
    assert_eq!(world.gate.status().denials, [Denial::BaselineAtRest]);
    // OP has to leave the friction f = 2 % behind.
    world.turn = 0.5;
    (0..4).for_each(|_| world.tick(1.0, 0.0));
    assert_eq!(world.gate.status().denials, [Denial::BaselineAtRest]);
    world.tick(1.0, 0.0);
    assert_eq!(world.gate.state(), State::Active, "{:?}", world.gate.status().denials);
}

#[test]
fn evidence_is_as_old_as_its_data_however_often_that_is_judged() {
    let mut world = World::new();
    (0..8).for_each(|_| world.tick(1.0, 0.0));
    let denials = |world: &mut World, age: f64| {
        let wall = world.time.wall;
        // Made just now, and another than the one before.
        world.evidence = Evidence { at: wall, data_end: wall + 1.0 - age, ..world.evidence };
        world.tick(1.0, 0.0);
        world.gate.status().denials
    };
    assert_eq!(denials(&mut world, 999.0), [Denial::NotGranted]);
    assert_eq!(denials(&mut world, 1001.0), [Denial::EvidenceOld, Denial::NotGranted]);
    // From the future, as of a clock that is ahead.
    assert_eq!(denials(&mut world, -2.0), [Denial::EvidenceOld, Denial::NotGranted]);
}
