//! What `stictiond plant` found, as JSON.

use super::skipped::Skipped;
use crate::cli::Failure;
use serde::Serialize;
use stictiond::indicators::distribution::BINS;
use stictiond::plantwide::{Analysis, LoopFound, Task};
use stictiond::serve::dto::latest_look::MarginsItem;

#[derive(Serialize)]
struct Found<'a> {
    loops: Vec<Loop<'a>>,
    groups: Vec<Group<'a>>,
    work: Vec<Line<'a>>,
    skipped: Vec<String>,
}

#[derive(Serialize)]
struct Loop<'a> {
    #[serde(rename = "loop")]
    name: &'a str,
    score: Option<f64>,
    service_factor: Option<f64>,
    at_limits: Option<f64>,
    iae: Option<f64>,
    iae_per_s: Option<f64>,
    ise: Option<f64>,
    error_sd: Option<f64>,
    error_mean: Option<f64>,
    pv_mean: Option<f64>,
    harris: Option<f64>,
    harris_ci95: Option<[f64; 2]>,
    harris_dead_time_s: Option<f64>,
    harris_dead_time_from: Option<&'static str>,
    margins: Option<MarginsItem>,
    swing: Option<f64>,
    settling: Option<Settling>,
    travel_a_day: Option<f64>,
    reversals_a_day: Option<f64>,
    stuck: Option<f64>,
    op_distribution: Option<Distribution>,
    noise_share: Option<f64>,
    quantisation: Option<f64>,
    compression: Option<f64>,
    oscillations: Vec<Oscillation>,
    master: Option<&'a str>,
    group: Option<usize>,
    cause: Option<&'static str>,
    cause_probability: Option<f64>,
    causes: Vec<Likely>,
    why: Option<&'a str>,
    /// Why a diagnosis of its valve had no result.
    reason_code: Option<&'a str>,
    neighbour: Option<&'a str>,
}

/// A cause with its probability.
#[derive(Serialize)]
struct Likely {
    name: &'static str,
    probability: f64,
}

/// How steps of the set point were followed.
#[derive(Serialize)]
struct Settling {
    steps: usize,
    settled: usize,
    time_s: Option<f64>,
    overshoot: f64,
}

/// Where OP stayed between its limits.
#[derive(Serialize)]
struct Distribution {
    q05: f64,
    q50: f64,
    q95: f64,
    histogram: [f64; BINS],
}

#[derive(Serialize)]
struct Oscillation {
    period_s: f64,
    regularity_r: f64,
    lasting: f64,
    share: f64,
    amplitude: f64,
    probability: f64,
}

#[derive(Serialize)]
struct Group<'a> {
    period_s: f64,
    members: Vec<&'a str>,
    suspects: Vec<Suspect<'a>>,
}

#[derive(Serialize)]
struct Suspect<'a> {
    #[serde(rename = "loop")]
    name: &'a str,
    probability: f64,
    evidence: &'a [String],
}

#[derive(Serialize)]
struct Line<'a> {
    #[serde(rename = "loop")]
    name: &'a str,
    part: &'static str,
    cause: &'static str,
    probability: Option<f64>,
    why: &'a str,
    expected_to_calm_down: Vec<&'a str>,
}

/// The whole, with a line end.
pub fn text(found: &Analysis, work: &[Task], skipped: &[Skipped]) -> Result<String, Failure> {
    let name = |i: usize| found.loops[i].name.as_str();
    let groups = found.groups.iter().map(|group| Group {
        period_s: group.period_s,
        members: group.members.iter().map(|i| name(*i)).collect(),
        suspects: group
            .suspects
            .iter()
            .map(|s| Suspect { name: name(s.at), probability: s.probability, evidence: &s.evidence })
            .collect(),
    });
    let lines = work.iter().map(|line| Line {
        name: name(line.at),
        part: line.part().as_str(),
        cause: line.cause.as_str(),
        probability: line.probability,
        why: &line.why,
        expected_to_calm_down: line.victims.iter().map(|i| name(*i)).collect(),
    });
    let loops = found.loops.iter().map(|of| one(of, found));
    let skipped = skipped.iter().map(Skipped::to_string).collect();
    let all = Found { loops: loops.collect(), groups: groups.collect(), work: lines.collect(), skipped };
    let mut json = serde_json::to_string_pretty(&all)
        .map_err(|error| Failure::Failed(format!("cannot write what was found: {error}")))?;
    json.push('\n');
    Ok(json)
}

fn one<'a>(of: &'a LoopFound, found: &'a Analysis) -> Loop<'a> {
    let name = |i: usize| found.loops[i].name.as_str();
    let (i, reason) = (&of.indicators, of.reason.as_ref());
    let measured = |value: f64| i.measured.then_some(value);
    Loop {
        name: &of.name,
        score: i.score,
        service_factor: i.service_factor,
        at_limits: i.at_limits,
        iae: i.error.map(|e| e.iae),
        iae_per_s: i.error.map(|e| e.mean_absolute),
        ise: i.error.map(|e| e.ise),
        error_sd: i.error.map(|e| e.sd),
        error_mean: i.error_mean,
        pv_mean: i.pv_mean,
        harris: i.harris.map(|h| h.index),
        harris_ci95: i.harris.and_then(|h| h.interval).map(|(low, high)| [low, high]),
        harris_dead_time_s: i.dead_time_s,
        harris_dead_time_from: i.harris.map(|_| if i.dead_time_s.is_some() { "model" } else { "one_sample" }),
        margins: of.margins.as_ref().map(MarginsItem::from),
        swing: i.swing,
        settling: i.settling.map(|own| Settling {
            steps: own.steps,
            settled: own.settled,
            time_s: own.time_s,
            overshoot: own.overshoot,
        }),
        travel_a_day: i.travel.map(|travel| travel.a_day),
        reversals_a_day: i.travel.map(|travel| travel.reversals_a_day),
        stuck: i.stuck,
        op_distribution: i.distribution.map(|own| {
            let [q05, q50, q95] = own.quantiles;
            Distribution { q05, q50, q95, histogram: own.histogram }
        }),
        noise_share: measured(i.kept.noise_share),
        quantisation: measured(i.kept.quantisation),
        compression: measured(i.kept.compression),
        oscillations: of
            .oscillations
            .iter()
            .map(|o| Oscillation {
                period_s: o.period_s,
                regularity_r: o.regularity,
                lasting: o.lasting,
                share: o.share,
                amplitude: o.amplitude,
                probability: o.probability(),
            })
            .collect(),
        master: of.master.map(name),
        group: of.group,
        cause: reason.map(|r| r.cause.as_str()),
        cause_probability: reason.and_then(|r| r.probability),
        causes: of
            .causes
            .iter()
            .map(|own| Likely { name: own.as_str(), probability: own.probability })
            .collect(),
        why: reason.map(|r| r.why.as_str()),
        reason_code: of.untold.as_ref().map(|own| own.code.as_str()),
        neighbour: reason.and_then(|r| r.neighbour).map(name),
    }
}
