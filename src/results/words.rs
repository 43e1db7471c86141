//! What is found, as an operator would say it, and what to do about it: the dashboard, reports, alarms, mails, webhooks and
//! messages say the same, because they all take it from here. `tests/words.txt` has every sentence; read them as a set.

use super::{Compensated, Seen, Summary, f_unit};
use crate::compensation::gate::{Cause, Denial};
use crate::diagnosis::not_identifiable::beyond_samples;
use crate::signal::{self, trimmed};

mod effects;

pub use effects::{EFFECTS, Effect, effect};

/// How sure an effect is, by the least posterior that each word asks for; below the last it is [`POSSIBLY`].
pub const SURE: [(f64, &str); 4] =
    [(0.99, "almost certainly"), (0.9, "very likely"), (0.75, "probably"), (0.5, "more likely than not")];
/// The word for what is less likely than that.
pub const POSSIBLY: &str = "possibly";
/// Least posterior for advice that costs money or a shutdown: below it is said what to look at first, which costs nothing.
pub const COSTLY_FROM: f64 = 0.9;
/// Least posterior of a kind that is told among those between which a record lies.
const TOLD_FROM: f64 = 0.05;

/// An effect in words, as sure as it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Said {
    /// What it is, in a line that does not say that it is there.
    pub title: String,
    /// What it means, in one sentence that says how sure it is.
    pub meaning: String,
    /// What to do.
    pub advice: String,
}

/// How sure a posterior is, in a word or a few.
pub fn sure(posterior: f64) -> &'static str {
    SURE.iter().find(|(least, _)| posterior >= *least).map_or(POSSIBLY, |(_, word)| word)
}

impl Effect {
    /// What is said of it; without a posterior it is not said how sure it is, and nothing that costs is advised.
    pub fn said(&self, posterior: Option<f64>) -> Said {
        let meaning = match posterior {
            Some(posterior) => format!("{} {}.", capital(sure(posterior)), self.meaning),
            None => format!("{}.", capital(self.meaning)),
        };
        let costly = self.costly.filter(|_| posterior.is_some_and(|posterior| posterior >= COSTLY_FROM));
        let advice = [Some(self.look), costly].into_iter().flatten().collect::<Vec<_>>().join(" ");
        Said { title: capital(self.name), meaning, advice }
    }
}

/// Between which kinds a record lies: where neither `none` nor any other of them has more than half. In one clause. `none` is
/// no effect beside those that are named already, so it is not told as no effect at all.
///
/// * `named`: whether effects are named already. A candidate may be of their kind, so the clause says that it comes beside them.
pub fn between(candidates: &[(&str, f64)], named: bool) -> Option<String> {
    if candidates.is_empty() || candidates.iter().any(|(_, posterior)| *posterior > 0.5) {
        return None;
    }
    let name =
        |kind: &str| effect(kind, None).map_or_else(|| kind.replace('_', " "), |own| own.name.to_string());
    // Two places of one kind are one word.
    let mut kinds: Vec<(&str, f64)> = Vec::new();
    for (kind, posterior) in candidates {
        match kinds.iter_mut().find(|(own, _)| own == kind) {
            Some((_, sum)) => *sum += posterior,
            None => kinds.push((kind, *posterior)),
        }
    }
    kinds.retain(|(_, posterior)| *posterior >= TOLD_FROM);
    let told = |(kind, posterior): &(&str, f64)| format!("{} ({})", name(kind), percent(*posterior));
    let (none, kinds): (Vec<_>, Vec<_>) = kinds.into_iter().partition(|(kind, _)| *kind == "none");
    let kinds: Vec<String> = kinds.iter().map(told).collect();
    let none = none.first().map(|(_, posterior)| percent(*posterior));
    let record = if named { "beside the effects named, the record" } else { "the record" };
    match (&kinds[..], none) {
        ([], _) => None,
        ([one], None) => Some(format!("{record} may show {one}")),
        ([one], Some(none)) => Some(format!("{record} cannot tell {one} from none ({none})")),
        ([one, other], None) => Some(format!("{record} cannot tell {one} from {other}")),
        (all, Some(none)) => {
            Some(format!("{record} cannot tell {} and none of them ({none}) apart", all.join(", ")))
        }
        ([others @ .., last], None) => {
            Some(format!("{record} cannot tell {} and {last} apart", others.join(", ")))
        }
    }
}

/// A clause as a sentence.
pub fn sentence(clause: &str) -> String {
    format!("{}.", capital(clause))
}

/// How many times the error of the model without effects the free run of a model may have that is still of use for simulation:
/// twice is four times its squared error.
pub const SIMULATES_TO: f64 = 2.0;

/// What is said where the model with the effects, run freely, is worse than the one without.
///
/// * `times`: its error over that of the one without (-); `None` where it is not known.
pub fn simulates_worse(times: Option<f64>) -> String {
    let compared = times.map_or("follows PV less closely than".to_string(), |times| {
        format!("is {} as far from PV as", times_as(times))
    });
    let then = match times.is_some_and(|times| times > SIMULATES_TO) {
        true => "do not simulate with this model, and take the effects with care",
        false => "take them with care",
    };
    format!("A simulation with these effects {compared} one without them: {then}.")
}

/// A ratio of two errors in words, never rounded to the other side of 1 or of [`SIMULATES_TO`].
pub fn times_as(ratio: f64) -> String {
    let decimals = if ratio < 10.0 { 2 } else { 0 };
    format!("{} times", signal::beside(ratio, &[1.0, SIMULATES_TO], decimals))
}

/// Who contradicts a verdict.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Doubt {
    /// The measured stem.
    Stem,
    /// So many of the other methods that could tell.
    Methods {
        /// That say otherwise.
        against: usize,
        /// That could tell.
        of: usize,
    },
}

/// That a verdict is contradicted, and what to do: `sticks` is what the verdict says.
pub fn doubtful(sticks: bool, by: Doubt) -> String {
    let otherwise = if sticks { "the valve does not stick" } else { "the valve sticks" };
    match by {
        Doubt::Stem => {
            format!(
                "The measured stem says that {otherwise}. Check the stem's signal, and look at the valve."
            )
        }
        Doubt::Methods { against, of } => {
            let who = if against == of { format!("All {of}") } else { format!("{against} of the {of}") };
            format!(
                "{who} other methods that gave a result say that {otherwise}. Look at the loop before you rely on the verdict."
            )
        }
    }
}

/// A verdict, or how a run failed, in numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Verdict<'a> {
    /// `stiction`, `no_stiction`, `not_identifiable`, `deadline_exceeded` or `panicked`.
    pub outcome: &'a str,
    /// Why nothing can be said, for machines.
    pub reason_code: Option<&'a str>,
    /// The verdict in one line, for those who know the method.
    pub reason: &'a str,
    /// Friction (`unit`).
    pub f: Option<f64>,
    /// The upper end of its interval (`unit`).
    pub f_high: Option<f64>,
    /// Unit along OP.
    pub unit: &'a str,
    /// What is left to see while a term of write-back acts, where one does.
    pub compensated: Option<Compensated>,
}

impl Verdict<'_> {
    /// In a sentence or two: what the valve does with a reversal of OP, which is what 2f means.
    pub fn words(&self) -> String {
        let band = |f: Option<f64>| {
            let f = f.filter(|f| f.is_finite() && *f > 0.0)?;
            Some(format!("{} {}", shortest(2.0 * f), self.unit))
        };
        // A term hides friction: beside one a verdict without friction says nothing of the valve either.
        let by_a_term =
            matches!(self.outcome, "stiction" | "no_stiction") || self.reason_code == Some("compensated");
        let compensated = self.compensated.filter(|_| by_a_term);
        if let Some(own) = compensated {
            return "Write-back moved the valve in this record. ".to_string()
                + &match (own.seen, band(self.f), band(own.f_before)) {
                    (Seen::Consistent, Some(now), Some(_)) => {
                        format!("The valve sticks as before: it ignores the first {now} of each reversal.")
                    }
                    (Seen::Changed, Some(now), Some(before)) => {
                        format!(
                            "The valve now ignores the first {now} of each reversal. Before compensation it ignored {before}."
                        )
                    }
                    (Seen::Hidden, _, Some(before)) => format!(
                        "Before compensation the valve ignored the first {before} of each reversal. That is no longer visible."
                    ),
                    (_, Some(now), _) => {
                        format!("The valve sticks: it ignores the first {now} of each reversal.")
                    }
                    _ => "Whether the valve sticks is not visible.".to_string(),
                };
        }
        match self.outcome {
            "stiction" => match band(self.f) {
                Some(band) => format!("The valve sticks: it ignores the first {band} of each reversal."),
                None => "The valve sticks.".to_string(),
            },
            "no_stiction" => {
                let hidden = band(self.f_high).map(|band| {
                    format!(" If the valve sticks at all, it ignores at most {band} of each reversal.")
                });
                // Friction too small to matter may be shown all the same.
                "No sticking that matters is shown.".to_string() + &hidden.unwrap_or_default()
            }
            "deadline_exceeded" => {
                "The diagnosis did not end in time. The machine may be too busy.".to_string()
            }
            "panicked" => "The diagnosis failed. The daemon's log says why.".to_string(),
            _ => {
                let known = self.reason_code.and_then(not_identifiable);
                let (why, check) = known.unwrap_or((self.reason, ""));
                // Which tag and since when stands in the reason alone.
                let silent = self.reason_code == Some("silent");
                let why = self.reason.strip_prefix("silent: ").filter(|_| silent).unwrap_or(why);
                let check = match self.reason.contains(beyond_samples()) {
                    true => {
                        " If the controller acts between the samples, read OP and PV at each of its scans, or change the set point a few times."
                    }
                    false => check,
                };
                let begin = match self.reason_code == Some("undecided") {
                    true => "The valve may stick",
                    false => "Nothing can be said about the valve",
                };
                format!("{begin}: {why}.{check}")
            }
        }
    }
}

impl Summary {
    /// The run in words, as the loop's page says it.
    pub fn words(&self) -> String {
        let verdict = Verdict {
            outcome: &self.outcome,
            reason_code: self.reason_code.as_deref(),
            reason: &self.reason,
            f: self.f,
            f_high: self.f_ci95.map(|[_, high]| high),
            unit: f_unit(self.f_in_percent),
            compensated: self.compensated,
        };
        verdict.words()
    }
}

/// Why nothing can be said, and what to check.
fn not_identifiable(code: &str) -> Option<(&'static str, &'static str)> {
    Some(match code {
        "too_short" => ("there is not enough data yet", " If this lasts, check why samples are missing."),
        "no_time_base" => ("the time stamps give no sampling period", " Check the clock of the source."),
        "gaps" => ("too much of the data is missing or bad", " Check the tags and the connection."),
        // A frozen tag has no good sample either: its repeated value is stale.
        "silent" => (
            "no good sample of OP or PV comes any more",
            " Check the connection, and whether the source repeats one value.",
        ),
        "read_apart" => (
            "OP and PV are not read at the same time",
            " Read both in one request, or export both for the same times.",
        ),
        "compressed" => (
            "the archive left out too much of the data",
            " Export raw values, and keep OP and PV without compression and without a dead band.",
        ),
        "ts_too_short" => (
            "the sample period that was set is shorter than the time between two samples",
            " Set ts_s, or --ts, to that time or more, or leave it out.",
        ),
        "flat_op" => {
            ("OP does not move", " Check whether the loop is in manual, and whether this is its OP.")
        }
        "flat_pv" => (
            "PV stands still, or its source marks it as doubtful",
            " Compare PV with a second reading, and check its quality at the source.",
        ),
        "saturated" => (
            "OP was at a limit for too much of the record",
            " Check whether the valve is shut off or fully open, and op_limits.",
        ),
        "manual" => ("the loop was never in automatic for long enough", ""),
        "mode_unknown" => ("the mode of the loop cannot be read", " Check its tag."),
        "not_excited" => ("OP hardly ever reverses by enough for sticking to show", ""),
        "hidden_friction" => ("this record does not exclude sticking, however strong it is", ""),
        "undecided" => (
            "more speaks for sticking than against it, but not enough for a verdict",
            " A record in which OP reverses more often or by more would decide.",
        ),
        "undersampled" => (
            "the loop swings too fast for the samples",
            " Poll at least ten times in one swing, and keep no means.",
        ),
        "no_response" => (
            "other influences on PV hide whether PV follows OP",
            " If this lasts, check that the valve moves and that it belongs to this loop.",
        ),
        "stem_not_followed" => (
            "PV does not visibly follow it",
            " It may stick, or a load may jump. If this lasts, check that OP and PV belong to one loop.",
        ),
        "compensated" => ("write-back moved the valve in this record and hides any sticking", ""),
        "out_of_scale" => {
            ("the values are too large or too small to compute with", " Check type, byte order and scale.")
        }
        "deadline_exceeded" => ("the analysis took too long", " The machine may be too busy."),
        _ => return None,
    })
}

/// Whether friction rises: by how much f, at least by how much (`unit`), over how long (s). It is said at every diagnosis, also
/// after a repair.
pub fn rising(rise: f64, least: f64, span_s: f64, unit: &str) -> String {
    if least <= 0.0 {
        return "Friction does not rise beyond its noise.".to_string();
    }
    let (rise, least, span) = (shortest(2.0 * rise), shortest(2.0 * least), lasting(span_s));
    format!(
        "Friction rises: over the last {span} the valve came to ignore {rise} {unit} more of each reversal, at least {least} {unit}."
    )
}

/// A time for people: in days, where it is two of them or more.
fn lasting(s: f64) -> String {
    match s {
        s if s >= 172_800.0 => format!("{:.0} days", s / 86_400.0),
        s if s >= 7200.0 => format!("{:.0} h", s / 3600.0),
        s => format!("{:.0} min", (s / 60.0).max(1.0)),
    }
}

/// That a loop may calm down when another is repaired.
pub fn swings_with(source: &str) -> String {
    format!("It swings with {source}, the likeliest source, and may calm down when {source} does.")
}

/// That write-back was closed by a fault, and by which. `cause`: why it closed in the end, once on its way to zero.
pub fn tripped(by: Option<Denial>, cause: Cause) -> String {
    let late = (cause == Cause::NotAtZero)
        .then_some("the term was not at zero within withdraw_limit_s, so the heartbeat was stopped");
    // That it was late is said once.
    let by = by.filter(|by| late.is_none() || *by != Denial::NotAtZero).map(Denial::text);
    let why: Vec<&str> = by.into_iter().chain(late).collect();
    format!("write-back was closed by a fault: {}", why.join("; "))
}

/// That the model leaves this share of PV's standard deviation over: of a free run, which can be further off than PV's mean.
pub fn unexplained(share: f64) -> String {
    if share >= 0.995 {
        return "PV's movement is not explained.".to_string();
    }
    format!("{} of PV's standard deviation is not explained.", signal::share(share, 0))
}

/// What a test of the residual that failed has seen.
pub fn failed_test(name: &str) -> String {
    let said = match name {
        "whiteness" => "it still depends on its own past",
        "input" => "it still follows OP",
        "tags" => "it follows another tag",
        "line_spectrum" => "it swings at one period",
        "change_point" => "its level changes",
        "drift" => "its level drifts",
        "direction" => "it depends on the stem's direction",
        "travel" => "it depends on the stem's position",
        "variance" => "its spread changes",
        "tails" => "it has single wild values",
        other => return other.replace('_', " "),
    };
    said.to_string()
}

/// A probability in whole per cent, and never as certainty.
pub fn percent(probability: f64) -> String {
    match probability {
        p if p > 0.99 => "> 99 %".to_string(),
        p if p < 0.01 => "< 1 %".to_string(),
        p => format!("{:.0} %", 100.0 * p),
    }
}

/// Three significant digits, at least the whole part; a dash for what is no number.
pub fn short(value: f64) -> String {
    if !value.is_finite() {
        return "–".to_string();
    }
    if value == 0.0 {
        return "0".to_string();
    }
    let decimals = (2 - value.abs().log10().floor() as i32).clamp(0, 9) as usize;
    format!("{value:.decimals$}")
}

/// [`short`] without zeros at the end.
fn shortest(value: f64) -> String {
    trimmed(short(value))
}

/// With its first letter large.
fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map(|first| first.to_uppercase().chain(letters).collect()).unwrap_or_default()
}

#[cfg(test)]
mod tests;
