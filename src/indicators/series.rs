//! Indicators as numbers over time: what is kept of each look at a loop, and what a shift, a day and a week say of it.
//!
//! ```text
//! over a time:   mean of x over the looks in it
//!                error_sd: sqrt(mean of (sd² + (m - mean of m)²))      m: error_mean, and without a set point pv_mean
//!                period_s, regularity: those of the look with the largest swing
//!                harris, its interval: mean over the looks whose dead time is that of the latest
//! ```
//!
//! An error that goes up and down within a day is hardly seen in an hour: a look has the spread about its own mean, and the rest
//! is between the means. A mean of periods is one that nothing has: a loop that swings now at 60 s and now at 3,600 s never swings
//! at 1,830 s. An index for another dead time is another index, and in no mean with it.

use crate::sysid::stats::mean;

/// How many there are.
pub const COUNT: usize = 22;

/// Name, unit (`-` for none, `PV` for PV's own, `PV²` for its square) and meaning of each, in the order of every [`Values`]. The store tells them apart by
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
        "least possible variance of the error over its variance, for the dead time of the process and one sample, or for one sample where there is no harris_dead_time_s; over a shift, a day or a week of the looks with the latest dead time; of all samples of a record that is not thinned, else of its latest 3,600 samples or its latest hour, whichever is longer",
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
    ("ise_per_s", "PV²", "mean of the error's square: ISE over time; unknown without a set point"),
    (
        "settling_s",
        "s",
        "median time from a step of the set point until PV stays near it; of the whole record, a week at most; unknown where no step settled",
    ),
    (
        "regularity",
        "-",
        "regularity r of the oscillation that period_s is of: mean interval between zero crossings over three of their standard deviations",
    ),
    (
        "compression",
        "-",
        "samples of PV over those that a straight line does not replace: 1 where nothing was left out, above 3 unfit for statistics",
    ),
    ("harris_low", "-", "lower end of the 95 % interval of harris"),
    ("harris_high", "-", "upper end of the 95 % interval of harris"),
    (
        "harris_dead_time_s",
        "s",
        "dead time of the process by the loop's model, which harris is for; unknown where that is for one sample",
    ),
];

/// Which of them is taken together with its mean, and where those of error and PV stand.
const SD: usize = 3;
const MEANS: [usize; 2] = [13, 14];
/// Which of them are taken from one look, and which says from which.
const PERIOD: usize = 7;
const REGULARITY: usize = 17;
const SWING: usize = 6;
/// Which of them are for a dead time, and which says for which.
const INDEX: [usize; 3] = [5, 19, 20];
/// Where the dead time of the Harris index stands.
pub const DEAD: usize = 21;
/// Where the score stands.
pub const SCORE: usize = 0;

/// One value of each; none where it is not known.
pub type Values = [Option<f64>; COUNT];

/// Those that need a record as long as there is, and those that need no more than some thousand samples.
const LONG: [&str; 5] = ["score", "swing", "period_s", "settling_s", "regularity"];
const RECENT: [&str; 4] = ["harris", "harris_low", "harris_high", "harris_dead_time_s"];

/// The values of the latest hour, with those that need a longer record from all of it, or from the recent part.
pub fn latest(hour: &Values, recent: &Values, whole: &Values) -> Values {
    std::array::from_fn(|k| match NAMED[k].0 {
        name if RECENT.contains(&name) => recent[k],
        name if LONG.contains(&name) => whole[k],
        _ => hour[k],
    })
}

/// What the looks of some time, the latest last, say together.
pub fn over<'a>(looks: impl Iterator<Item = &'a Values> + Clone) -> Values {
    let dead = dead_time(looks.clone());
    let of_one = |k: usize| {
        let known = looks.clone().filter_map(|own| Some((own[SWING].unwrap_or_default(), own[k]?)));
        // Of equal ones the latest.
        known.max_by(|a, b| a.0.total_cmp(&b.0)).map(|own| own.1)
    };
    std::array::from_fn(|k| match k {
        SD => spread(looks.clone()),
        PERIOD | REGULARITY => of_one(k),
        DEAD => dead,
        _ => {
            let is_same = |own: &&Values| !INDEX.contains(&k) || is_for(own, dead);
            let all: Vec<f64> = looks.clone().filter(is_same).filter_map(|values| values[k]).collect();
            (!all.is_empty()).then(|| mean(&all))
        }
    })
}

/// The dead time of the latest look that has a Harris index (s).
fn dead_time<'a>(looks: impl Iterator<Item = &'a Values>) -> Option<f64> {
    looks.filter(|own| own[INDEX[0]].is_some()).last().and_then(|own| own[DEAD])
}

/// Whether a look's Harris index is for that dead time (s). No dead time is one of one sample, as where the process has none.
fn is_for(own: &Values, dead: Option<f64>) -> bool {
    let bits = |dead: Option<f64>| dead.unwrap_or(0.0).to_bits();
    bits(own[DEAD]) == bits(dead)
}

/// Leaves out the Harris index of looks that are for another dead time than the latest is, as [`over`] does.
pub fn keep_latest_index(looks: &mut [Values]) {
    let dead = dead_time(looks.iter());
    for own in looks.iter_mut().filter(|own| !is_for(own, dead)) {
        INDEX.iter().for_each(|at| own[*at] = None);
    }
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
            own[REGULARITY] = period_s.map(|period_s| 2.0 * period_s);
            own
        };
        let looks = [look(Some(0.2), Some(60.0)), look(Some(0.6), Some(3600.0)), look(Some(0.9), None)];
        let day = over(looks.iter());
        assert_eq!((day[PERIOD], day[REGULARITY]), (Some(3600.0), Some(7200.0)));
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
        let named = [SD, SWING, PERIOD, REGULARITY, MEANS[0], MEANS[1]].map(|at| NAMED[at].0);
        assert_eq!(named, ["error_sd", "swing", "period_s", "regularity", "error_mean", "pv_mean"]);
        assert_eq!([INDEX[0], INDEX[1], INDEX[2], DEAD].map(|at| NAMED[at].0), RECENT);
        assert_eq!(NAMED[SCORE].0, "score");
        assert!(NAMED.iter().all(|(name, ..)| name.chars().all(|c| c.is_ascii_lowercase() || c == '_')));
        assert!(LONG.iter().chain(&RECENT).all(|long| NAMED.iter().any(|(name, ..)| name == long)));
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
    fn an_index_for_another_dead_time_is_in_no_mean_with_it() {
        let look = |index: f64, dead: Option<f64>| {
            let mut own = [None; COUNT];
            (own[INDEX[0]], own[INDEX[1]], own[DEAD], own[0]) =
                (Some(index), Some(index - 0.125), dead, Some(50.0));
            own
        };
        let told = |looks: &[Values]| {
            let own = over(looks.iter());
            [INDEX[0], INDEX[1], DEAD, 0].map(|at| own[at])
        };
        // The model's dead time became known, and changed.
        let mut looks =
            vec![look(0.25, None), look(0.25, Some(0.0)), look(0.625, Some(20.0)), look(0.875, Some(20.0))];
        assert_eq!(told(&looks), [Some(0.75), Some(0.625), Some(20.0), Some(50.0)]);
        // Without one, and for a process without any, it is of one sample.
        assert_eq!(told(&looks[..2]), [Some(0.25), Some(0.125), Some(0.0), Some(50.0)]);
        // A look that has no index changes nothing.
        looks.push([None; COUNT]);
        assert_eq!(told(&looks)[0], Some(0.75));
        keep_latest_index(&mut looks);
        let left: Vec<Option<f64>> = looks.iter().map(|own| own[INDEX[0]]).collect();
        assert_eq!(left, [None, None, Some(0.625), Some(0.875), None]);
        assert_eq!(looks[0][0], Some(50.0));
    }

    #[test]
    fn what_needs_a_long_record_is_taken_from_one() {
        let of = |x: f64| [Some(x); COUNT];
        let found = latest(&of(1.0), &of(2.0), &of(3.0)).map(|x| x.unwrap_or_default());
        assert_eq!((found[0], found[SWING], found[PERIOD], found[5]), (3.0, 3.0, 3.0, 2.0));
        assert_eq!((found[REGULARITY], found[DEAD]), (3.0, 2.0));
        assert_eq!(found.iter().filter(|x| **x == 1.0).count(), COUNT - LONG.len() - RECENT.len());
    }
}
