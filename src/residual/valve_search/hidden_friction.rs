//! The largest friction that a record could hide: the upper end of the interval of f where no friction is needed. Where that is the
//! largest that is tried, the friction below it that the record excludes all the same.

use super::search::{Search, initial_positions, range_of_s};
use crate::residual::hypothesis::Hypothesis;
use crate::sysid::arx::ArxFit;
use crate::sysid::criterion::TEMPERING;
use crate::sysid::iddata::IdData;
use crate::sysid::valve::{StopRule, ValveModel};

/// Ratio of the values of S that are tried, from the largest down: the bound is rounded up by as much.
const HIDDEN: f64 = 0.85;
/// Stop rules and J/S of the valves that are tried at each S.
const HIDING: [(StopRule, f64); 4] =
    [(StopRule::Reversal, 1.0), (StopRule::Reversal, 0.5), (StopRule::Reversal, 0.1), (StopRule::Slip, 0.5)];
/// Positions of the stem at the start that are tried for each of them.
const HIDDEN_PLACES: usize = 12;

/// The largest f that the record does not exclude beside these effects (standard deviations of OP).
///
/// ```text
/// LR(f) = 2 tau (ln L(0) - max over J, stop rule and position at the start of ln L(f)),   the largest f with LR <= bound
/// ```
///
/// The likelihood is tempered as in the verdict, because a model of a valve is only nearly right. The values of S differ by the
/// factor `1 / 0.85`; the result is the next value above the largest that is not excluded.
///
/// * `bound`: the point of the likelihood ratio beyond which an f is excluded (-).
pub fn hidden_friction(data: &IdData, effects: &Hypothesis, bound: f64) -> f64 {
    let (y, shapes) = (effects.pv(data), effects.shapes(data));
    let profile = Profile::new(data, effects, (&y, &shapes), bound);
    let least_excluded = profile.tried().take_while(|tried| tried.1).last();
    least_excluded.map_or(data.f_max, |tried| 0.5 * tried.0).min(data.f_max)
}

/// The friction that the record excludes beside these effects although it does not exclude the largest: the least and the largest f
/// of the longest run of values that are excluded (standard deviations of OP). `None` where the largest is excluded, or nothing is.
///
/// A stem that hardly turns is nearly a constant, which a load can imitate, while less friction may be excluded.
///
/// * `bound`: as in [`hidden_friction`].
pub fn excluded_friction(data: &IdData, effects: &Hypothesis, bound: f64) -> Option<[f64; 2]> {
    let (y, shapes) = (effects.pv(data), effects.shapes(data));
    let profile = Profile::new(data, effects, (&y, &shapes), bound);
    let run = longest_run(profile.tried());
    run.map(|run| run.map(|s| 0.5 * s))
}

/// The least and the largest value of the longest run that is excluded, of values from the largest down. `None` where the first is
/// excluded, or none is; in the former case no other value is asked for.
fn longest_run(mut tried: impl Iterator<Item = (f64, bool)>) -> Option<[f64; 2]> {
    let (_, largest_is_excluded) = tried.next()?;
    if largest_is_excluded {
        return None;
    }
    let rest: Vec<(f64, bool)> = tried.collect();
    let longest = rest.split(|tried| !tried.1).max_by_key(|run| run.len())?;
    Some([longest.last()?.0, longest.first()?.0])
}

/// The likelihood of friction of any size beside given effects, against that of none.
struct Profile<'a> {
    data: &'a IdData,
    search: Search<'a>,
    /// The fit without friction.
    free: ArxFit,
    /// The point of the likelihood ratio beyond which a value is excluded (-).
    bound: f64,
}

impl<'a> Profile<'a> {
    /// The profile beside `effects`, with their PV and the shapes of their loads.
    fn new(
        data: &'a IdData,
        effects: &'a Hypothesis,
        (y, shapes): (&'a [f64], &'a [Vec<f64>]),
        bound: f64,
    ) -> Self {
        let search = Search::new(data, effects, (y, shapes));
        let none = effects.with_valve(None);
        let free = search.arx.fit(&none.to_process(data, none.stem(data).0), None);
        Self { data, search, free, bound }
    }

    /// The values of S from the largest down (standard deviations of OP), each with whether it is excluded.
    fn tried(&self) -> impl Iterator<Item = (f64, bool)> {
        let (least, most) = range_of_s(self.data);
        let values = std::iter::successors(Some(most), |s| Some(s * HIDDEN)).take_while(move |s| *s > least);
        values.map(move |s| (s, self.excludes(s)))
    }

    /// Whether the record excludes every valve of this S (standard deviations of OP).
    fn excludes(&self, s: f64) -> bool {
        let valves = HIDING.iter().flat_map(|(rule, ratio)| {
            let valve = ValveModel { s, j: ratio * s, rule: *rule, ..ValveModel::default() };
            let rests = initial_positions(self.data, &valve).into_iter().take(HIDDEN_PLACES);
            rests.map(move |rest| ValveModel { rest, ..valve })
        });
        let stems = valves.map(|valve| self.search.stem(valve));
        let rated = stems.map(|stem| (self.search.arx.deviance(&stem), stem));
        let best = rated.min_by(|a, b| a.0.total_cmp(&b.0));
        best.is_some_and(|(_, stem)| {
            let fit = self.search.arx.fit(&stem, Some(&self.free));
            2.0 * TEMPERING * (self.free.log_likelihood - fit.log_likelihood) > self.bound
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The values 8, 4, 2, 1 and so on, excluded where the pattern has an x.
    fn pattern(excluded: &str) -> Vec<(f64, bool)> {
        let values = std::iter::successors(Some(8.0_f64), |s| Some(s / 2.0));
        values.zip(excluded.chars()).map(|(s, own)| (s, own == 'x')).collect()
    }

    #[test]
    fn the_longest_run_below_the_largest_value_is_told() {
        for (excluded, run) in [
            ("-xx--", Some([2.0, 4.0])),
            ("-x-xxx-", Some([0.25, 1.0])),
            ("--xxx", Some([0.5, 2.0])),
            ("-x---", Some([4.0, 4.0])),
            ("-----", None),
            ("-", None),
            ("", None),
        ] {
            assert_eq!(longest_run(pattern(excluded).into_iter()), run, "{excluded}");
        }
    }

    #[test]
    fn where_the_largest_is_excluded_no_other_value_is_rated() {
        let mut rated = 0;
        let tried = pattern("xx-xxx-").into_iter().inspect(|_| rated += 1);
        assert_eq!(longest_run(tried), None);
        assert_eq!(rated, 1);
    }
}
