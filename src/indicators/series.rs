//! Indicators as numbers over time: what is kept of each look at a loop, and what a shift, a day and a week say of it.
//!
//! ```text
//! over a time:   mean of x over the looks in it
//!                error_sd: sqrt(mean of (sd² + (m - mean of m)²))      m: error_mean, and without a set point pv_mean
//!                period_s: that of the look with the largest swing
//! ```
//!
//! An error that goes up and down within a day is hardly seen in an hour: a look has the spread about its own mean, and the rest
//! is between the means. A mean of periods is one that nothing has: a loop that swings now at 60 s and now at 3,600 s never swings
//! at 1,830 s.

use crate::sysid::stats::mean;

/// How many there are.
pub const COUNT: usize = 15;

/// Name, unit (`-` for none, `PV` for PV's own) and meaning of each, in the order of every [`Values`]. The store tells them apart by
/// their place: another one comes last.
pub const NAMED: [(&str, &str, &str); COUNT] = [
    (
        "score",
        "-",
        "100 for a loop that does its work, 0 for one that does none of it; of the whole record, a week at most",
    ),
    ("service_factor", "-", "share of the time in automatic"),
    ("at_limits", "-", "share of the time with OP at a limit"),
    (
        "error_sd",
        "PV",
        "standard deviation of the error, of PV where there is no set point; over a shift, a day or a week about the mean of that time",
    ),
    ("iae_per_s", "PV", "mean of the error's size: IAE over time; unknown without a set point"),
    (
        "harris",
        "-",
        "least possible variance of the error over its variance, for a dead time of one sample; of all samples of a record that is not thinned, else of its latest 3,600 samples or its latest hour, whichever is longer",
    ),
    ("swing", "-", "share of the error's variance in oscillations; of the whole record, a week at most"),
    (
        "period_s",
        "s",
        "period of the largest oscillation of the whole record, a week at most; over a shift, a day or a week that of the look with the largest swing",
    ),
    ("travel_a_day", "OP", "way of the valve in a day"),
    ("reversals_a_day", "-", "reversals of the valve in a day"),
    ("stuck", "-", "share of the time in which PV stands still while OP moves"),
    ("noise_share", "-", "share of PV's variance that is noise"),
    ("quantisation", "-", "step of PV over its standard deviation"),
    ("error_mean", "PV", "mean of the error, set point less PV; unknown without a set point"),
    ("pv_mean", "PV", "mean of PV"),
];

/// Which of them is taken together with its mean, and where those of error and PV stand.
const SD: usize = 3;
const MEANS: [usize; 2] = [13, 14];
/// Which of them is taken from one look, and which says from which.
const PERIOD: usize = 7;
const SWING: usize = 6;

/// One value of each; none where it is not known.
pub type Values = [Option<f64>; COUNT];

/// Those that need a record as long as there is, and the one that needs no more than some thousand samples.
const LONG: [&str; 3] = ["score", "swing", "period_s"];
const HARRIS: &str = "harris";

/// The values of the latest hour, with those that need a longer record from all of it, or from the recent part.
pub fn latest(hour: &Values, recent: &Values, whole: &Values) -> Values {
    std::array::from_fn(|k| match NAMED[k].0 {
        HARRIS => recent[k],
        name if LONG.contains(&name) => whole[k],
        _ => hour[k],
    })
}

/// What the looks of some time say together.
pub fn over<'a>(looks: impl Iterator<Item = &'a Values> + Clone) -> Values {
    std::array::from_fn(|k| match k {
        SD => spread(looks.clone()),
        PERIOD => {
            let known = looks.clone().filter_map(|own| Some((own[SWING].unwrap_or_default(), own[PERIOD]?)));
            // Of equal ones the latest.
            known.max_by(|a, b| a.0.total_cmp(&b.0)).map(|own| own.1)
        }
        _ => {
            let all: Vec<f64> = looks.clone().filter_map(|values| values[k]).collect();
            (!all.is_empty()).then(|| mean(&all))
        }
    })
}

/// Standard deviation of the error over some looks: within each and between them. Where one of them has a set point, of those that
/// have.
fn spread<'a>(looks: impl Iterator<Item = &'a Values> + Clone) -> Option<f64> {
    let known = |at: usize| looks.clone().filter_map(move |own| Some((own[SD]?, own[at]?)));
    let mut each = MEANS.into_iter().map(|at| known(at).collect::<Vec<(f64, f64)>>());
    let all = each.find(|all| !all.is_empty())?;
    let level = mean(&all.iter().map(|own| own.1).collect::<Vec<f64>>());
    let squares = all.iter().map(|(sd, m)| sd * sd + (m - level) * (m - level));
    Some(mean(&squares.collect::<Vec<f64>>()).sqrt())
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
    fn a_mean_of_what_is_known() {
        let (mut a, mut b) = ([None; COUNT], [None; COUNT]);
        (a[0], b[0], a[5]) = (Some(80.0), Some(60.0), Some(0.5));
        let both = over([a, b].iter());
        assert_eq!((both[0], both[5], both[1]), (Some(70.0), Some(0.5), None));
        let named = [SD, SWING, PERIOD, MEANS[0], MEANS[1]].map(|at| NAMED[at].0);
        assert_eq!(named, ["error_sd", "swing", "period_s", "error_mean", "pv_mean"]);
        assert!(NAMED.iter().all(|(name, ..)| name.chars().all(|c| c.is_ascii_lowercase() || c == '_')));
        assert!(LONG.iter().chain([&HARRIS]).all(|long| NAMED.iter().any(|(name, ..)| name == long)));
    }

    #[test]
    fn the_error_of_a_day_has_what_its_hours_differ_by() {
        let look = |sd: f64, error_mean: Option<f64>, pv_mean: f64| {
            let mut own = [None; COUNT];
            (own[SD], own[MEANS[0]], own[MEANS[1]]) = (Some(sd), error_mean, Some(pv_mean));
            own
        };
        let sd = |looks: &[Values]| over(looks.iter())[SD].expect("known");
        assert!(
            (sd(&[look(3.0, Some(1.0), 0.0), look(4.0, Some(1.0), 50.0)]) - 12.5_f64.sqrt()).abs() < 1e-12
        );
        assert!(
            (sd(&[look(3.0, Some(0.0), 9.0), look(4.0, Some(2.0), 9.0)]) - 13.5_f64.sqrt()).abs() < 1e-12
        );
        // Without a set point by what PV itself does; with one now and then, while it is there.
        assert!((sd(&[look(3.0, None, 7.0), look(4.0, None, 9.0)]) - 13.5_f64.sqrt()).abs() < 1e-12);
        assert_eq!(sd(&[look(3.0, Some(1.0), 7.0), look(4.0, None, 900.0)]), 3.0);
        // A sine of a day and amplitude 1: within an hour 0.05, over the day sqrt(1/2).
        let error = |minute: u32| (std::f64::consts::TAU * f64::from(minute) / 1440.0).sin();
        let hour = |hour: u32| {
            let e: Vec<f64> = (60 * hour..60 * (hour + 1)).map(error).collect();
            look(crate::sysid::stats::sd(&e), Some(mean(&e)), 0.0)
        };
        let day: Vec<Values> = (0..24).map(hour).collect();
        assert!((sd(&day) - 0.5_f64.sqrt()).abs() < 1e-9, "{}", sd(&day));
    }

    #[test]
    fn what_needs_a_long_record_is_taken_from_one() {
        let of = |x: f64| [Some(x); COUNT];
        let found = latest(&of(1.0), &of(2.0), &of(3.0)).map(|x| x.unwrap_or_default());
        assert_eq!((found[0], found[SWING], found[PERIOD], found[5]), (3.0, 3.0, 3.0, 2.0));
        assert_eq!(found.iter().filter(|x| **x == 1.0).count(), COUNT - 4);
    }
}
