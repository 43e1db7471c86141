//! Orders that come too late: what the DCS has dropped must not come back.

use super::*;

#[test]
fn after_a_silence_the_rest_of_the_ramp_is_not_written() {
    // A process that was frozen, and a machine that slept, whose steady clock stood still meanwhile.
    for (dt, jump) in [(10.0, 0.0), (0.0, 10.0)] {
        let mut world = World::opened();
        (0..3).for_each(|_| world.tick(1.0, 0.0));
        assert_eq!(world.dcs.held, 2.0);
        world.gate.limits.withdraw_rate = 0.1;
        world.tick(dt, jump);
        assert_eq!((world.gate.state(), world.dcs.held), (State::Tripped, 0.0));
    }
}

#[test]
fn a_link_that_comes_back_after_the_time_out_gets_zero() {
    let mut world = World::opened();
    (0..3).for_each(|_| world.tick(1.0, 0.0));
    world.gate.limits.withdraw_rate = 0.1;
    world.outcome = Err(WriteFault::Failed);
    (0..6).for_each(|_| world.tick(0.5, 0.0));
    assert_eq!((world.gate.state(), world.dcs.held), (State::Withdrawing, 2.0));
    world.outcome = Ok(());
    world.tick(0.5, 0.0);
    assert_eq!((world.gate.state(), world.dcs.held), (State::Tripped, 0.0));
}

#[test]
fn an_order_holds_for_a_step_by_both_clocks() {
    let order = Order::of_test(1.0, 1, &LIMITS);
    let holds = |(mono, wall)| order.holds(Time { mono, wall });
    assert!([(0.0, 0.0), (2.0, 2.0), (2.0, 2.9), (0.5, -0.4)].into_iter().all(holds));
    let late = [(2.1, 2.1), (0.1, 1.5), (0.1, -1.5), (-0.1, -0.1), (f64::NAN, 1.0), (1.0, f64::NAN)];
    assert!(!late.into_iter().any(holds));
}

#[test]
fn an_order_that_was_withheld_is_no_fault_of_the_device() {
    let mut world = World::opened();
    (0..3).for_each(|_| world.tick(1.0, 0.0));
    world.gate.withdraw("Cid", world.time).expect("active");
    world.outcome = Err(WriteFault::Withheld);
    world.tick(0.5, 0.0);
    assert_eq!((world.gate.state(), world.dcs.held), (State::Withdrawing, 2.0));
    world.outcome = Ok(());
    world.until_out();
    assert_eq!((world.gate.state(), world.dcs.held), (State::Shadow, 0.0));
}
