//! Every effect in words: one sentence that says what it means, what to look at first, and what costs money or a shutdown.

/// An effect in words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Effect {
    /// What it is, as a title and after "the record cannot tell": it does not say that it is there.
    pub name: &'static str,
    /// What it means: a sentence without its first word, which says how sure it is, and without its full stop.
    pub meaning: &'static str,
    /// What to look at first; it costs nothing.
    pub look: &'static str,
    /// What to do where it is sure enough; it costs money or a shutdown.
    pub costly: Option<&'static str>,
}

/// An effect by its kind and, where the kind has more than one, the place where it acts; `None` for a kind that has no words.
pub fn effect(kind: &str, place: Option<&str>) -> Option<Effect> {
    let of = |place: Option<&str>| EFFECTS.iter().find(|(own, at, _)| *own == kind && *at == place);
    of(place).or_else(|| of(None)).map(|(.., effect)| *effect)
}

const fn words(
    name: &'static str,
    meaning: &'static str,
    look: &'static str,
    costly: Option<&'static str>,
) -> Effect {
    Effect { name, meaning, look, costly }
}

/// All of them, by kind and place.
pub const EFFECTS: [(&str, Option<&str>, Effect); 18] = [
    (
        "oscillating_load",
        None,
        words(
            "a load that swings",
            "something outside this loop swings and moves PV",
            "Before any work on this valve, look for another loop or a machine that swings with the same period.",
            None,
        ),
    ),
    (
        "measured_disturbance",
        None,
        words(
            "another measurement that moves PV",
            "PV follows another measurement after a delay",
            "Look at that measurement first.",
            Some("Ask whether a feed-forward from it would help."),
        ),
    ),
    (
        "load_step",
        None,
        words(
            "a load step",
            "the load on this loop changed at one moment and stayed there",
            "Check what was opened, closed or switched at that time.",
            None,
        ),
    ),
    (
        "load_step",
        Some("pv"),
        words(
            "a shift of PV",
            "the reading of PV shifted at one moment and stayed there, without the valve having moved",
            "Compare the transmitter with a second reading, and check which valves or lines downstream were opened or closed at that time.",
            Some("Have the transmitter calibrated."),
        ),
    ),
    (
        "drift",
        None,
        words(
            "a drift",
            "the load on this loop or its sensor moves away slowly and steadily",
            "Compare the transmitter with a second reading, and check the feed.",
            Some("Have the transmitter calibrated, and look for fouling."),
        ),
    ),
    (
        "gain_change",
        None,
        words(
            "a gain change",
            "from some time on the same movement of the valve moves PV more, or less, than before",
            "Check whether the operating point or the feed changed at that time.",
            Some("Retune the controller if it stays so."),
        ),
    ),
    (
        "dead_time_change",
        None,
        words(
            "a change of the dead time",
            "from some time on PV follows the valve later, or earlier, than before",
            "Check the flow rate at that time, and the analyser where PV comes from one.",
            Some("Retune the controller if it stays so."),
        ),
    ),
    (
        "valve_saturation",
        None,
        words(
            "a valve at its stop",
            "the valve moves no further beyond a certain OP",
            "Watch the valve, or its position signal, when OP is near that end.",
            Some("Have the stroke calibrated, and stops, positioner limits and air supply checked."),
        ),
    ),
    (
        "static_nonlinearity",
        Some("valve"),
        words(
            "a valve gain that depends on the opening",
            "the same change of OP changes the flow more at one opening of the valve than at another",
            "Compare how the loop behaves at small and at large openings.",
            Some("Have the valve's characteristic checked."),
        ),
    ),
    (
        "static_nonlinearity",
        Some("process"),
        words(
            "a process gain that depends on PV",
            "the same movement of the valve moves PV more at one level of PV than at another",
            "Before any work on this valve, compare how the loop behaves at high and at low PV.",
            Some("Have another controller gain set for high PV than for low PV."),
        ),
    ),
    (
        "static_nonlinearity",
        None,
        words(
            "a gain that differs over the range",
            "the same change of OP moves PV more in one part of the range than in another",
            "Compare how the loop behaves at both ends of its range.",
            None,
        ),
    ),
    (
        "slip_jump",
        None,
        words(
            "a stem beside OP while it moves",
            "the stem stays behind OP, or ahead of it, while it moves",
            "Watch whether the stem lags while OP turns round, or jumps too far.",
            Some("Have linkage and actuator checked for play, as well as the packing for friction."),
        ),
    ),
    (
        "asymmetric_friction",
        None,
        words(
            "friction that differs by direction",
            "the valve sticks more in one direction than in the other",
            "Check the pressure of the air supply.",
            Some("Have packing, spring and actuator checked."),
        ),
    ),
    (
        "friction_drift",
        None,
        words(
            "friction that changes over time",
            "the valve sticks more, or less, at the end of the record than at its beginning",
            "Watch the next diagnoses.",
            Some("If it sticks more and more, plan packing and actuator for the next shutdown."),
        ),
    ),
    (
        "quantised_pv",
        None,
        words(
            "a PV that moves in steps",
            "PV is recorded in coarse steps",
            "Check range, scaling and compression of PV.",
            None,
        ),
    ),
    (
        "outliers",
        None,
        words(
            "single wild values of PV",
            "single values of PV lie far off and come back at once",
            "Check the data link and the transmitter's own diagnostics.",
            Some("Have transmitter and wiring checked."),
        ),
    ),
    (
        "frozen_pv",
        None,
        words(
            "a PV that stands still at times",
            "PV repeats its value while the process moves",
            "Compare PV with a second reading, and check the data link.",
            Some("Have transmitter and impulse lines checked."),
        ),
    ),
    (
        "clock_skew",
        None,
        words(
            "time stamps that do not fit",
            "PV's time stamps are early or late against those of OP",
            "Compare the clocks of the data sources, and look for a delay on the way of PV.",
            None,
        ),
    ),
];
