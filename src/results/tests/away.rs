//! A collector that was away for long: what no diagnosis could be made of meanwhile.

use super::*;

const DAY: f64 = 86_400.0;

/// A loop and its collector.
struct Plant(Results);

impl Plant {
    fn new() -> Self {
        let own = results(3);
        own.watch_devices(&[LoopId::new("dcs")], 0.0);
        Self(own)
    }

    /// The collector is there from a time on (d), or is not.
    fn collector(&self, is_there: bool, day: f64) {
        let (devices, loops) = seen(Some((!is_there).then_some("no good sample for 120 s")), None);
        self.0.watch(devices, loops, day * DAY);
    }

    /// No diagnosis could be made on these days.
    fn blind(&self, days: std::ops::Range<u32>) {
        let why = NotIdentifiable::Gaps { share: 0.5 };
        for day in days {
            let verdict = Verdict::NotIdentifiable(why.clone());
            let own = Outcome::Diagnosed(diagnosis(verdict, 0.0, 0.0));
            self.0.record(run(f64::from(day) * DAY, own));
        }
    }

    fn state(&self, day: f64) -> State {
        state(&self.0, "A/not_identifiable", day * DAY)
    }
}

#[test]
fn what_could_not_be_said_while_a_collector_was_away_is_no_alarm() {
    let plant = Plant::new();
    plant.collector(false, 0.5);
    plant.blind(1..10);
    assert_eq!(plant.state(10.0), State::SuppressedByDesign);
    plant.collector(true, 10.0);
    assert_eq!(plant.state(10.0), State::Normal);
    // From now on it counts.
    plant.blind(11..18);
    assert_eq!(plant.state(17.0), State::Normal);
    plant.blind(18..19);
    assert_eq!(plant.state(18.0), State::Unacknowledged);
}

#[test]
fn an_outage_takes_nothing_from_what_held_before_it() {
    let plant = Plant::new();
    plant.blind(0..8);
    assert_eq!(plant.state(7.0), State::Unacknowledged);
    plant.collector(false, 7.5);
    plant.collector(true, 7.6);
    assert_eq!(plant.state(7.6), State::Unacknowledged, "it stands as before");

    // Six days before a day without a collector, and one after it.
    let plant = Plant::new();
    plant.blind(0..7);
    plant.collector(false, 6.0);
    plant.collector(true, 7.0);
    plant.blind(7..8);
    assert_eq!(plant.state(7.0), State::Normal);
    plant.blind(8..9);
    assert_eq!(plant.state(8.0), State::Unacknowledged);
}
