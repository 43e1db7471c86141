//! Indicators as numbers over time: what is kept of each look at a loop, and what a shift, a day and a week say of it.
//!
//! ```text
//! over a time:   mean of x over the looks in it        error_sd: sqrt(mean of x²)
//!                period_s: that of the look with the largest swing
//! ```
//!
//! A mean of periods is one that nothing has: a loop that swings now at 60 s and now at 3,600 s never swings at 1,830 s.

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
    (
        "period_s",
        "s",
        "period of the largest oscillation; over a shift, a day or a week that of the look with the largest swing",
    ),
    ("travel_a_day", "OP", "way of the valve in a day"),
    ("reversals_a_day", "-", "reversals of the valve in a day"),
    ("stuck", "-", "share of the time in which PV stands still while OP moves"),
    ("noise_share", "-", "share of PV's variance that is noise"),
    ("quantisation", "-", "step of PV over its standard deviation"),
];

/// Which of them is averaged by its square.
const SD: usize = 3;
/// Which of them is taken from one look, and which says from which.
const PERIOD: usize = 7;
const SWING: usize = 6;

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
        if k == PERIOD {
            let known = looks.clone().filter_map(|own| Some((own[SWING].unwrap_or_default(), own[PERIOD]?)));
            // Of equal ones the latest.
            return known.max_by(|a, b| a.0.total_cmp(&b.0)).map(|own| own.1);
        }
        let all: Vec<f64> = looks.clone().filter_map(|values| values[k]).collect();
        let squares = || mean(&all.iter().map(|x| x * x).collect::<Vec<f64>>()).sqrt();
        (!all.is_empty()).then(|| if k == SD { squares() } else { mean(&all) })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_period_of_a_day_is_one_that_the_loop_had() {
        let look = |swing, period_s| {
            let mut own = [None; COUNT];
            (own[SWING], own[PERIOD]) = (swing, period_s);
            own
        };
        let looks = [look(Some(0.2), Some(60.0)), look(Some(0.6), Some(3600.0)), look(Some(0.9), None)];
        let day = over(looks.iter());
        assert_eq!(day[PERIOD], Some(3600.0));
        assert!((day[SWING].expect("known") - 1.7 / 3.0).abs() < 1e-12);
        assert_eq!(over([look(None, Some(60.0))].iter())[PERIOD], Some(60.0));
        assert_eq!(over([look(Some(0.1), None)].iter())[PERIOD], None);
    }

    #[test]
    fn a_mean_of_what_is_known_and_of_squares() {
        let (mut a, mut b) = ([None; COUNT], [None; COUNT]);
        (a[0], b[0], a[SD], b[SD], a[5]) = (Some(80.0), Some(60.0), Some(3.0), Some(4.0), Some(0.5));
        let both = over([a, b].iter());
        assert_eq!((both[0], both[5], both[1]), (Some(70.0), Some(0.5), None));
        assert!((both[SD].expect("known") - 12.5_f64.sqrt()).abs() < 1e-12);
        assert_eq!([SD, SWING, PERIOD].map(|at| NAMED[at].0), ["error_sd", "swing", "period_s"]);
        assert!(NAMED.iter().all(|(name, ..)| name.chars().all(|c| c.is_ascii_lowercase() || c == '_')));
    }
}
