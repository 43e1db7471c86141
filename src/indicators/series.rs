//! Indicators as numbers over time: what is kept of each look at a loop, and what a shift, a day and a week say of it.
//!
//! ```text
//! over a time:   mean of x over the looks in it        error_sd: sqrt(mean of x²)
//! ```

use crate::sysid::stats::mean;

/// How many there are.
pub const COUNT: usize = 13;

/// Name, unit (`-` for none, `PV` for PV's own) and meaning of each, in the order of every [`Values`].
pub const NAMED: [(&str, &str, &str); COUNT] = [
    ("score", "-", "100 for a loop that does its work, 0 for one that does none of it"),
    ("service_factor", "-", "share of the time in automatic"),
    ("at_limits", "-", "share of the time with OP at a limit"),
    ("error_sd", "PV", "standard deviation of the error"),
    ("iae_per_s", "PV", "mean of the error's size: IAE over time"),
    (
        "harris",
        "-",
        "least possible variance of the error over its variance; that of one sample where the dead time is not known",
    ),
    ("swing", "-", "share of the error's variance in oscillations"),
    ("period_s", "s", "period of the largest oscillation"),
    ("travel_a_day", "OP", "way of the valve in a day"),
    ("reversals_a_day", "-", "reversals of the valve in a day"),
    ("stuck", "-", "share of the time in which PV stands still while OP moves"),
    ("noise_share", "-", "share of PV's variance that is noise"),
    ("quantisation", "-", "step of PV over its standard deviation"),
];

/// Which of them is averaged by its square.
const SD: usize = 3;

/// One value of each; none where it is not known.
pub type Values = [Option<f64>; COUNT];

/// Those that need a longer record than an hour.
const LONG: [&str; 4] = ["score", "harris", "swing", "period_s"];

/// The values of the latest hour, with those that need a longer record from all of it.
pub fn latest(hour: &Values, whole: &Values) -> Values {
    std::array::from_fn(|k| if LONG.contains(&NAMED[k].0) { whole[k] } else { hour[k] })
}

/// What the looks of some time say together.
pub fn over<'a>(looks: impl Iterator<Item = &'a Values> + Clone) -> Values {
    std::array::from_fn(|k| {
        let all: Vec<f64> = looks.clone().filter_map(|values| values[k]).collect();
        let squares = || mean(&all.iter().map(|x| x * x).collect::<Vec<f64>>()).sqrt();
        (!all.is_empty()).then(|| if k == SD { squares() } else { mean(&all) })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mean_of_what_is_known_and_of_squares() {
        let (mut a, mut b) = ([None; COUNT], [None; COUNT]);
        (a[0], b[0], a[SD], b[SD], a[5]) = (Some(80.0), Some(60.0), Some(3.0), Some(4.0), Some(0.5));
        let both = over([a, b].iter());
        assert_eq!((both[0], both[5], both[1]), (Some(70.0), Some(0.5), None));
        assert!((both[SD].expect("known") - 12.5_f64.sqrt()).abs() < 1e-12);
        assert_eq!(NAMED[SD].0, "error_sd");
        assert!(NAMED.iter().all(|(name, ..)| name.chars().all(|c| c.is_ascii_lowercase() || c == '_')));
    }
}
