//! Loops, their diagnoses, samples and models.

use super::super::dto::cause::LoopCause;
use super::super::dto::loops::{
    Begun, LoopDetail, LoopDiagnosis, LoopItem, LoopList, LoopModel, Quantity, RunItem, RunList, severity,
};
use super::super::dto::map::PlantMap;
use super::super::dto::params::{LoopsQuery, NoQuery, Order, RunQuery, RunsQuery, SamplesQuery, Sort};
use super::super::dto::samples::{Samples, TagSamples};
use super::super::dto::writeback::WritebackView;
use super::super::dto::{finite, parse_time, rfc3339};
use super::super::extract::{OfLoop, Params, within};
use super::super::problem::Problem;
use super::super::{Context, LoopInfo, Plant};
use super::off_thread;
use crate::results::{Glance, Known, Summary};
use crate::schedule::Refused;
use crate::signal::LoopId;
use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use std::borrow::Cow;
use std::sync::Arc;
use std::time::Duration;

type Shared = State<Arc<Context>>;

/// The loops, by severity unless asked otherwise.
#[utoipa::path(get, path = "/loops", tag = "loops", params(LoopsQuery),
    responses((status = 200, body = LoopList), (status = 400, description = "problem: the field is named")))]
pub async fn list(State(context): Shared, Params(query): Params<LoopsQuery>) -> Result<Response, Problem> {
    off_thread(move || page_of_loops(&context, &query)).await
}

fn page_of_loops(context: &Context, query: &LoopsQuery) -> Result<LoopList, Problem> {
    let limit = within("limit", query.limit.unwrap_or(100), 1..=1000)?;
    let after = query.after.as_deref().map(decode_cursor).transpose()?;
    let now = context.clock.now();
    let plant = context.plant();
    let needle = query.q.as_deref().map(str::to_lowercase);
    // What is known by the configuration alone comes first: of many loops few are looked up.
    let is_meant = |info: &&LoopInfo| {
        query.group.as_ref().is_none_or(|wanted| *wanted == info.group)
            && query.site.as_ref().is_none_or(|site| is_of_site(&info.group, site))
            && needle.as_ref().is_none_or(|needle| {
                let holds = |text: &str| text.to_lowercase().contains(needle);
                holds(info.id.as_str()) || holds(&info.description) || holds(&info.group)
            })
    };
    let infos: Vec<&LoopInfo> = plant.loops().iter().filter(is_meant).collect();
    let seen = context.results.glances(infos.iter().map(|info| &info.id), now);
    let passes = |seen: &Glance| {
        query.verdict.is_none_or(|wanted| wanted.passes(seen.verdict.as_deref()))
            && query.alarm.is_none_or(|wanted| wanted == seen.alarm.into())
    };
    let seen = infos.into_iter().zip(seen).filter_map(|(info, seen)| Some((info, seen.filter(&passes)?)));
    // Of names the first comes first, of scores the worst.
    let usual = match query.sort {
        Sort::Id | Sort::Group | Sort::Score => Order::Asc,
        _ => Order::Desc,
    };
    let ascending = query.order.unwrap_or(usual) == Order::Asc;
    let last = if ascending { f64::INFINITY } else { f64::NEG_INFINITY };
    let standing = |id: &LoopId| {
        let own = context.standing(id);
        let known = if query.sort == Sort::Score { own.score } else { own.cost.map(|(cost, _)| cost) };
        known.unwrap_or(last)
    };
    let mut places: Vec<(Key<'_>, &LoopInfo)> =
        seen.map(|(info, seen)| (Key::new(query.sort, info, &seen, standing), info)).collect();
    let total = places.len();
    // By key in the order asked for, equal keys always by id: a total order, on which a cursor is a cut.
    let compare = |(a, an): (&Key<'_>, &str), (b, bn): (&Key<'_>, &str)| {
        let by_key = a.cmp(b);
        (if ascending { by_key } else { by_key.reverse() }).then_with(|| an.cmp(bn))
    };
    if let Some((key, id)) = &after {
        let key = key.borrowed();
        places.retain(|(own, info)| compare((own, info.id.as_str()), (&key, id)).is_gt());
    }
    let by = |a: &(Key<'_>, &LoopInfo), b: &(Key<'_>, &LoopInfo)| {
        compare((&a.0, a.1.id.as_str()), (&b.0, b.1.id.as_str()))
    };
    let more = places.len() > limit;
    if more {
        places.select_nth_unstable_by(limit, by);
        places.truncate(limit);
    }
    places.sort_unstable_by(by);
    let next = places.last().filter(|_| more).map(|(key, info)| encode_cursor(key, info.id.as_str()));
    let item = |(_, info): (Key<'_>, &LoopInfo)| {
        Some(LoopItem::new(info, &context.results.get(&info.id, now)?, context.standing(&info.id), now))
    };
    let items = places.into_iter().filter_map(item).collect();
    Ok(LoopList { time: rfc3339(now), total, items, next })
}

/// Whether a group is that of a site, or of one of its units.
fn is_of_site(group: &str, site: &str) -> bool {
    group.strip_prefix(site).is_some_and(|rest| rest.is_empty() || rest.starts_with(" / "))
}

/// What a loop is sorted by; parts that are not asked for are equal.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Key<'a> {
    severity: u8,
    number: u64,
    text: Cow<'a, str>,
}

impl<'a> Key<'a> {
    /// The same without a text of its own.
    fn borrowed(&self) -> Key<'_> {
        Key { text: Cow::Borrowed(&self.text), ..*self }
    }

    /// `standing` tells the number of a loop by which those are sorted that the latest look at the plant has one of.
    fn new(sort: Sort, info: &'a LoopInfo, seen: &Glance, standing: impl Fn(&LoopId) -> f64) -> Self {
        let of = |severity, value: Option<f64>, text| Self {
            severity,
            number: ordered(value.unwrap_or(f64::NEG_INFINITY)),
            text: Cow::Borrowed(text),
        };
        match sort {
            Sort::Severity => of(severity(seen.alarm.into(), seen.verdict.as_deref()), seen.f, ""),
            Sort::Id => of(0, None, info.id.as_str()),
            Sort::Group => of(0, None, &info.group),
            Sort::F => of(0, seen.f, ""),
            Sort::DeltaAic => of(0, seen.delta_aic, ""),
            // By time of diagnosis, which unlike the age does not change between two pages.
            Sort::Age => of(0, seen.time.map(|t| -t), ""),
            Sort::Score | Sort::Cost => of(0, Some(standing(&info.id)), ""),
        }
    }
}

/// A number as bits that sort as the numbers do.
fn ordered(value: f64) -> u64 {
    let bits = value.to_bits();
    if bits >> 63 == 1 { !bits } else { bits | 1 << 63 }
}

fn encode_cursor(key: &Key<'_>, id: &str) -> String {
    let text = format!("{:02x}{:016x}{}\0{id}", key.severity, key.number, key.text);
    text.bytes().map(|byte| format!("{byte:02x}")).collect()
}

fn decode_cursor(text: &str) -> Result<(Key<'static>, String), Problem> {
    let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok();
    let key = || {
        let bytes: Vec<u8> = text.as_bytes().chunks(2).map(byte).collect::<Option<_>>()?;
        let decoded = String::from_utf8(bytes).ok()?;
        let (key, id) = decoded.rsplit_once('\0')?;
        let (severity, number, text) = (key.get(..2)?, key.get(2..18)?, key.get(18..)?);
        let severity = u8::from_str_radix(severity, 16).ok()?;
        let number = u64::from_str_radix(number, 16).ok()?;
        Some((Key { severity, number, text: Cow::Owned(text.to_string()) }, id.to_string()))
    };
    key().ok_or_else(not_a_cursor)
}

fn known(context: &Context, id: &LoopId, now: f64) -> Result<Known, Problem> {
    context.results.get(id, now).ok_or_else(|| Problem::unknown_loop(id.as_str()))
}

/// All loops as letters by unit, for a map.
#[utoipa::path(get, path = "/map", tag = "loops", responses((status = 200, body = PlantMap)))]
pub async fn map(State(context): Shared, Params(NoQuery {}): Params<NoQuery>) -> Result<Response, Problem> {
    off_thread(move || {
        let (now, plant) = (context.clock.now(), context.plant());
        let seen = context.results.glances(plant.loops().iter().map(|info| &info.id), now);
        let looks = plant.loops().iter().zip(&seen).filter_map(|(info, seen)| {
            let seen = seen.as_ref()?;
            Some((info.group.as_str(), seen.alarm.into(), seen.verdict.as_deref()))
        });
        Ok(PlantMap::of(looks, now))
    })
    .await
}

/// One loop with its newest values.
#[utoipa::path(get, path = "/loops/{id}", tag = "loops", params(("id" = String, Path, description = "the loop's name")),
    responses((status = 200, body = LoopDetail), (status = 404, description = "problem: no such loop")))]
pub async fn detail(
    State(context): Shared,
    OfLoop(id): OfLoop,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Json<LoopDetail>, Problem> {
    let now = context.clock.now();
    let plant = context.plant();
    let known = known(&context, &id, now)?;
    let info = plant.info(&id).ok_or_else(|| Problem::unknown_loop(id.as_str()))?;
    let tags = plant.history.loops().iter().find(|tags| tags.id == id);
    let op_span = tags.and_then(|tags| tags.op_span).and_then(finite);
    let configured = plant.facts.f_threshold_percent.filter(|_| op_span.is_some());
    let looked = context.plantwide.as_ref().and_then(|port| port.overview());
    Ok(Json(LoopDetail {
        item: LoopItem::new(info, &known, context.standing(&id), now),
        op_span,
        op_limits: tags.and_then(|tags| tags.op_limits).and_then(|(a, b)| Some([finite(a)?, finite(b)?])),
        f_threshold: LoopDetail::f_threshold(&known, configured),
        cause: looked.and_then(|found| LoopCause::of(&found, &id)),
        values: values(&context, &plant, &id),
        writeback: context
            .writeback
            .as_ref()
            .and_then(|writeback| writeback.status(&id))
            .as_ref()
            .map(WritebackView::from),
        last_run: known.last.as_ref().map(RunItem::from),
    }))
}

fn values(context: &Context, plant: &Plant, id: &LoopId) -> Vec<Quantity> {
    let (now, now_s) = (context.clock.now(), context.clock.elapsed().as_secs_f64());
    let newest = plant.history.aged(id, now, now_s).into_iter();
    newest.map(|(tag, newest)| Quantity::new(tag, newest)).collect()
}

/// The latest diagnosis in full.
#[utoipa::path(get, path = "/loops/{id}/diagnosis", tag = "loops",
    params(("id" = String, Path, description = "the loop's name")),
    responses((status = 200, body = LoopDiagnosis), (status = 404, description = "problem: no such loop, or no diagnosis yet")))]
pub async fn diagnosis(
    State(context): Shared,
    OfLoop(id): OfLoop,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Json<LoopDiagnosis>, Problem> {
    let now = context.clock.now();
    let known = known(&context, &id, now)?;
    let report = LoopDiagnosis::latest(&known, now);
    report.map(Json).ok_or_else(|| not_yet(&id, &known))
}

fn not_yet(id: &LoopId, known: &Known) -> Problem {
    Problem::not_diagnosed_yet(id.as_str(), known.last.as_ref().map(|last| last.outcome.as_ref()))
}

/// Diagnoses the loop now.
#[utoipa::path(post, path = "/loops/{id}/diagnosis", tag = "loops",
    params(("id" = String, Path, description = "the loop's name"), RunQuery),
    responses((status = 200, body = LoopDiagnosis, description = "done"),
        (status = 202, body = Begun, description = "begun; Location says where the result will be"),
        (status = 404, description = "problem: no such loop"),
        (status = 409, description = "problem: the loop is diagnosed by another machine"),
        (status = 500, description = "problem: the run failed"),
        (status = 503, description = "problem: too much is waiting already")))]
pub async fn diagnose_now(
    State(context): Shared,
    OfLoop(id): OfLoop,
    Params(query): Params<RunQuery>,
) -> Result<Response, Problem> {
    let wait = Duration::from_secs_f64(within("wait_s", query.wait_s.unwrap_or(5.0), 0.0..=60.0)?);
    let run = context.scheduler.request(&id).map_err(|refused| match refused {
        Refused::UnknownLoop => Problem::unknown_loop(id.as_str()),
        Refused::NotHere => Problem::new(StatusCode::CONFLICT, "not_here", refused.to_string()),
        Refused::Busy => Problem::busy("diagnoses_waiting", refused.to_string()),
        Refused::Overrunning => Problem::busy("diagnosis_overrunning", refused.to_string()),
        Refused::Stopping => Problem::busy("stopping", refused.to_string()),
    })?;
    match tokio::time::timeout(wait, run).await {
        Ok(Ok(run)) => match LoopDiagnosis::new(&run, context.clock.now()) {
            Some(report) => Ok(Json(report).into_response()),
            None => {
                let outcome = run.outcome.as_str();
                let detail = format!("the diagnosis of loop '{id}' ended as {outcome}");
                Err(Problem::new(StatusCode::INTERNAL_SERVER_ERROR, "diagnosis_failed", detail)
                    .with("loop", id.as_str())
                    .with("outcome", outcome))
            }
        },
        Ok(Err(_)) => {
            Err(Problem::busy("stopping", "the run was given up: the loop or the daemon goes away"))
        }
        Err(_) => {
            let plant = context.plant();
            let begun = Begun { r#loop: id.to_string(), state: "running" };
            let name = plant.info(&id).map(|info| percent_encoded(info.id.as_str())).unwrap_or_default();
            let location = [(header::LOCATION, format!("/api/v1/loops/{name}/diagnosis"))];
            Ok((StatusCode::ACCEPTED, location, Json(begun)).into_response())
        }
    }
}

/// A name as one segment of a path.
fn percent_encoded(name: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-._~".contains(&byte);
    name.bytes()
        .map(|byte| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") })
        .collect()
}

/// The runs that are remembered, newest first.
#[utoipa::path(get, path = "/loops/{id}/diagnoses", tag = "loops",
    params(("id" = String, Path, description = "the loop's name"), RunsQuery),
    responses((status = 200, body = RunList), (status = 400, description = "problem: the field is named"), (status = 404, description = "problem: no such loop")))]
pub async fn diagnoses(
    State(context): Shared,
    OfLoop(id): OfLoop,
    Params(query): Params<RunsQuery>,
) -> Result<Response, Problem> {
    let limit = within("limit", query.limit.unwrap_or(100), 1..=10_000)?;
    let after = query.after.as_deref().map(decode_run_cursor).transpose()?;
    off_thread(move || {
        let summaries = context.results.summaries(&id).ok_or_else(|| Problem::unknown_loop(id.as_str()))?;
        let (page, next) = page_of_runs(&summaries, after, limit);
        Ok(RunList { r#loop: id.to_string(), items: page.into_iter().map(RunItem::from).collect(), next })
    })
    .await
}

/// Runs newest first, `limit` of those after a cursor: the time of the last run of the page before, and which of those that ended
/// then it is. Runs that are made meanwhile move no page, and a clock that was set back leaves none out.
fn page_of_runs(
    runs: &[Summary],
    after: Option<(f64, usize)>,
    limit: usize,
) -> (Vec<&Summary>, Option<String>) {
    let newest: Vec<&Summary> = runs.iter().rev().collect();
    let begin = after.map_or(0, |(time, seen)| {
        let mut then = (0..newest.len()).filter(|at| newest[*at].time == time);
        // A run that is no longer remembered was the oldest: what came before it is forgotten as well.
        seen.checked_sub(1).and_then(|nth| then.nth(nth)).map_or(newest.len(), |at| at + 1)
    });
    let end = begin.saturating_add(limit).min(newest.len());
    let page = newest[begin..end].to_vec();
    let next = page.last().filter(|_| end < newest.len()).map(|last| {
        let seen = newest[..end].iter().filter(|run| run.time == last.time).count();
        format!("{:016x}.{seen}", last.time.to_bits())
    });
    (page, next)
}

fn decode_run_cursor(text: &str) -> Result<(f64, usize), Problem> {
    let cut = text.split_once('.').and_then(|(time, seen)| {
        Some((f64::from_bits(u64::from_str_radix(time, 16).ok()?), seen.parse().ok()?))
    });
    cut.ok_or_else(not_a_cursor)
}

fn not_a_cursor() -> Problem {
    Problem::field("after", "after: not a `next` of a page before")
}

/// The trends of all tags.
#[utoipa::path(get, path = "/loops/{id}/samples", tag = "loops",
    params(("id" = String, Path, description = "the loop's name"), SamplesQuery),
    responses((status = 200, body = Samples), (status = 400, description = "problem: the field is named"),
        (status = 404, description = "problem: no such loop")))]
pub async fn samples(
    State(context): Shared,
    OfLoop(id): OfLoop,
    Params(query): Params<SamplesQuery>,
) -> Result<Response, Problem> {
    let points = within("points", query.points.unwrap_or(1000), 3..=20_000)?;
    let from = time("from", query.from.as_deref())?;
    let to = time("to", query.to.as_deref())?;
    if let (Some(from), Some(to)) = (from, to)
        && from > to
    {
        return Err(Problem::field("from", "from: later than to"));
    }
    off_thread(move || {
        let history = context.plant().history.clone();
        let (first, last) = (from.unwrap_or(f64::NEG_INFINITY), to.unwrap_or(f64::INFINITY));
        let trends = history.samples(&id, first, last, points);
        let trends = trends.ok_or_else(|| Problem::unknown_loop(id.as_str()))?;
        Ok(Samples {
            r#loop: id.to_string(),
            from: from.and_then(rfc3339),
            to: to.and_then(rfc3339),
            tags: trends.iter().map(TagSamples::from).collect(),
        })
    })
    .await
}

fn time(field: &str, text: Option<&str>) -> Result<Option<f64>, Problem> {
    let Some(text) = text else { return Ok(None) };
    let wrong =
        || Problem::field(field, format!("{field}: neither RFC 3339 nor seconds since the Unix epoch"));
    parse_time(text).map(Some).ok_or_else(wrong)
}

/// The model behind the latest diagnosis.
#[utoipa::path(get, path = "/loops/{id}/model", tag = "loops",
    params(("id" = String, Path, description = "the loop's name")),
    responses((status = 200, body = LoopModel), (status = 404, description = "problem: no such loop, or no diagnosis yet")))]
pub async fn model(
    State(context): Shared,
    OfLoop(id): OfLoop,
    Params(NoQuery {}): Params<NoQuery>,
) -> Result<Json<LoopModel>, Problem> {
    let known = known(&context, &id, context.clock.now())?;
    let model = LoopModel::latest(&known, context.results.origin(&id));
    model.map(Json).ok_or_else(|| not_yet(&id, &known))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn keys_sort_as_the_numbers_do(a in proptest::num::f64::NORMAL, b in proptest::num::f64::NORMAL) {
            prop_assert_eq!(ordered(a).cmp(&ordered(b)), a.total_cmp(&b));
        }

        #[test]
        fn cursors_come_back_and_anything_else_is_refused(
            severity: u8, number: u64, text in "\\PC{0,20}", id in "\\PC{0,20}", junk in "\\PC{0,40}",
        ) {
            let key = Key { severity, number, text: Cow::Owned(text) };
            prop_assert_eq!(decode_cursor(&encode_cursor(&key, &id)).ok(), Some((key, id)));
            // Whatever it is, it is an answer and no panic.
            let _ = decode_cursor(&junk);
        }
    }

    #[test]
    fn pages_of_runs_join_though_some_ended_at_the_same_time() {
        let at = |time: f64| Summary {
            time,
            took_s: 0.0,
            trigger: crate::results::Trigger::Periodic,
            outcome: "stiction".into(),
            reason_code: None,
            reason: String::new(),
            f_in_percent: true,
            f: None,
            f_ci95: None,
            delta_aic: None,
            compensated: None,
        };
        // In the second the clock was set back.
        for times in [[1.0, 2.0, 2.0, 2.0, 3.0, 3.0], [12.0, 12.5, 11.75, 12.25, 12.0, 12.5]] {
            let runs: Vec<Summary> = times.map(at).into();
            let mut newest = times;
            newest.reverse();
            for limit in 1..7 {
                let (mut joined, mut after) = (Vec::new(), None);
                loop {
                    let (page, next) = page_of_runs(&runs, after, limit);
                    assert!(page.len() <= limit && (next.is_none() || page.len() == limit));
                    joined.extend(page.iter().map(|run| run.time));
                    let Some(next) = next else { break };
                    after = Some(decode_run_cursor(&next).expect("a cursor"));
                }
                assert_eq!(joined, newest, "{limit}");
            }
        }
        for wrong in ["", "1", "x.1", "3ff0000000000000.-1"] {
            assert!(decode_run_cursor(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn names_become_one_segment() {
        assert_eq!(percent_encoded("FIC-101"), "FIC-101");
        assert_eq!(percent_encoded("a/b ü"), "a%2Fb%20%C3%BC");
    }
}
