//! What the stores of an edge and a centre have, and what people were told.

use crate::rig::seconds;
use crate::settle::Mark;
use crate::wire::Made;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::sync::mpsc::Receiver;
use std::time::SystemTime;
use stictiond::serve::dto::parse_time;
use stictiond::store::Reader;

/// A diagnosis as a store has it.
#[derive(Debug)]
pub struct Kept {
    /// Its number there.
    pub number: u64,
    pub outcome: String,
    pub reason_code: Option<String>,
    /// Empty for a run that failed.
    pub report: Vec<u8>,
}

/// Diagnoses of a store by loop and time, those of one site.
pub fn reports(store: &Path, site: &str) -> BTreeMap<Made, Kept> {
    let reader = Reader::open(store).expect("can be read");
    let (mut all, mut after) = (BTreeMap::new(), 0);
    while let Some(rows) = Some(reader.diagnoses(after, 100).expect("reads")).filter(|rows| !rows.is_empty())
    {
        for (number, row) in rows {
            after = number;
            let Some(name) = of_site(&row.control_loop, site) else { continue };
            let number = u64::try_from(number).expect("counted from 1");
            let kept = Kept {
                number,
                outcome: row.outcome,
                reason_code: row.reason_code,
                report: row.report.unwrap_or_default(),
            };
            let known = all.insert((name, row.finished.to_bits()), kept);
            assert!(known.is_none(), "nothing is there twice");
        }
    }
    all
}

/// What happened to an alarm.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Changed {
    pub name: String,
    pub kind: String,
    /// When (s, as bits).
    at: u64,
    pub cause: String,
    before: String,
    after: String,
}

/// What happened to alarms of a site by a store, each with its number there.
pub fn changes(store: &Path, site: &str) -> Vec<(u64, Changed)> {
    let reader = Reader::open(store).expect("can be read");
    let rows = reader.transitions(0, 100_000).expect("reads").into_iter();
    let own = rows.filter_map(|(number, row)| {
        let changed = Changed {
            name: of_site(&row.control_loop, site)?,
            kind: row.kind,
            at: row.at.to_bits(),
            cause: row.cause,
            before: row.before,
            after: row.after,
        };
        Some((u64::try_from(number).expect("counted from 1"), changed))
    });
    own.collect()
}

/// The name of a loop or collector at its site; `None` for one of another site. At the site itself no name has it.
pub fn of_site(name: &str, site: &str) -> Option<String> {
    match name.split_once(':') {
        Some((own, name)) => (own == site).then(|| name.to_string()),
        None => Some(name.to_string()),
    }
}

/// The name of a loop or collector at its site.
pub fn at_site(name: &str) -> String {
    name.split_once(':').map_or(name, |(_, name)| name).to_string()
}

/// By loop and tag the samples: stamps and values as bits.
type Samples = BTreeMap<(String, String), Vec<(u64, u64)>>;

/// Of each tag of a site in a store, its samples.
fn samples(store: &Path, site: &str) -> Samples {
    let mut reader = Reader::open(store).expect("can be read");
    let names: Vec<_> = reader.tags().expect("reads").into_iter().map(|tag| tag.name).collect();
    let mut all = BTreeMap::new();
    for name in names {
        let Some(own) = of_site(&name.control_loop, site) else { continue };
        let found = reader.between(&name.control_loop, &name.tag, 0.0, 1e11).expect("reads");
        let bits = found.iter().map(|sample| (sample.t.to_bits(), sample.value.to_bits())).collect();
        all.insert((own, name.tag.clone()), bits);
    }
    all
}

/// What an edge forwards may be as much younger than what it has on its disk (s).
const AHEAD_S: f64 = 1.0;

/// A centre's store has what a site's edge had at the mark, and of what came later what the edge has: once, to the last bit. An
/// edge that was killed, at the times `killed`, may have forwarded what it had not on its disk yet.
pub fn compare(edge: &Path, centre: &Path, mark: &Mark, loops: usize, killed: &[f64]) {
    let diagnoses = compare_reports(edge, centre, mark, loops);
    let changes = compare_changes(edge, centre, mark);
    let samples = compare_samples(edge, centre, mark, killed);
    let of = |[there, here]: [usize; 2]| format!("{there} of {here}");
    println!(
        "{}: {} diagnoses, {} changes of alarms, {} samples at the centre, the rest of after it was looked at",
        mark.site,
        of(diagnoses),
        of(changes),
        of(samples)
    );
}

/// How many diagnoses a centre has, and the edge.
fn compare_reports(edge: &Path, centre: &Path, mark: &Mark, loops: usize) -> [usize; 2] {
    let (here, there) = (reports(edge, &mark.site), reports(centre, &mark.site));
    for (key, own) in &there {
        let first = here.get(key).unwrap_or_else(|| panic!("the edge has no {key:?}"));
        assert!((&first.outcome, &first.report) == (&own.outcome, &own.report), "{key:?} is another");
    }
    let missing = here.iter().filter(|(key, own)| own.number <= mark.diagnosis && !there.contains_key(*key));
    let missing: Vec<_> = missing.map(|(key, _)| key).collect();
    assert!(there.len() >= loops && missing.is_empty(), "{} and without {missing:?}", there.len());
    [there.len(), here.len()]
}

/// How many changes of alarms a centre has, and the edge; the same one may have happened oftener than once.
fn compare_changes(edge: &Path, centre: &Path, mark: &Mark) -> [usize; 2] {
    let (here, there) = (changes(edge, &mark.site), changes(centre, &mark.site));
    let plain = |all: &[(u64, Changed)], most: u64| -> Vec<Changed> {
        all.iter().filter(|(number, _)| *number <= most).map(|(_, own)| own.clone()).collect()
    };
    let (here, until, there) = (plain(&here, u64::MAX), plain(&here, mark.change), plain(&there, u64::MAX));
    let (missing, more) = (beyond(&until, &there), beyond(&there, &here));
    assert!(!until.is_empty() && missing.is_empty() && more.is_empty(), "without {missing:?}, and {more:?}");
    [there.len(), here.len()]
}

/// What of some is not among others, or not as often.
fn beyond<'a, T: Ord>(some: &'a [T], others: &[T]) -> Vec<&'a T> {
    let mut counts = BTreeMap::<&T, usize>::new();
    others.iter().for_each(|own| *counts.entry(own).or_default() += 1);
    let mut is_left = |own: &T| match counts.get_mut(own) {
        Some(count) if *count > 0 => {
            *count -= 1;
            false
        }
        _ => true,
    };
    some.iter().filter(|own| is_left(own)).collect()
}

/// How many samples a centre has, and the edge.
fn compare_samples(edge: &Path, centre: &Path, mark: &Mark, killed: &[f64]) -> [usize; 2] {
    let (here, there) = (samples(edge, &mark.site), samples(centre, &mark.site));
    assert!(here.keys().eq(there.keys()), "{:?} and {:?}", here.keys(), there.keys());
    let ahead = |t: f64| killed.iter().any(|end| (0.0..AHEAD_S).contains(&(end - t)));
    for (tag, some) in &there {
        let all = &here[tag];
        let on_disk: HashSet<&(u64, u64)> = all.iter().collect();
        let mut some = some.clone();
        some.retain(|sample| on_disk.contains(sample) || !ahead(f64::from_bits(sample.0)));
        let last = some.last().map_or(f64::NAN, |sample| f64::from_bits(sample.0));
        assert!(last >= mark.at, "{tag:?}: up to {last}, and not to {}", mark.at);
        assert!(some.len() <= all.len(), "{tag:?}: {} of {}", some.len(), all.len());
        assert_eq!(all[..some.len()], some[..], "{tag:?}: none is missing, none is twice");
    }
    let count = |of: &Samples| of.values().map(Vec::len).sum::<usize>();
    [count(&there), count(&here)]
}

/// The alarms that people were told of, each with when its letter came (s).
pub fn letters(told: &Receiver<(SystemTime, String)>) -> Vec<(f64, String)> {
    let of_letter = |(came, body): (SystemTime, String)| {
        let at = seconds(came);
        notices(&body).into_iter().map(move |notice| (at, notice))
    };
    told.try_iter().flat_map(of_letter).collect()
}

/// The alarms of letters, each once.
pub fn named_in(letters: &[(f64, String)]) -> Vec<String> {
    let mut all: Vec<String> = letters.iter().map(|(_, notice)| notice.clone()).collect();
    all.sort();
    all.dedup();
    all
}

/// Alarms that people were told of too often. Each of `excuses` is a time (s) in which one who tells them went away, or the line
/// to them: what was told then may be told once more, because nobody may have taken note of it.
///
/// * `happened`: what happened to alarms, once for each site. Loops of two sites may change in the same millisecond.
pub fn too_often(
    letters: &[(f64, String)],
    excuses: &[RangeInclusive<f64>],
    happened: &[String],
) -> Vec<String> {
    let mut all = BTreeMap::<&str, Vec<f64>>::new();
    letters.iter().for_each(|(at, notice)| all.entry(notice).or_default().push(*at));
    let is_too_often = |notice: &str, times: &[f64]| {
        let sites = happened.iter().filter(|own| *own == notice).count().max(1);
        let before = &times[..times.len().saturating_sub(sites)];
        before.len() > excuses.iter().filter(|own| before.iter().any(|at| own.contains(at))).count()
    };
    all.retain(|notice, times| is_too_often(notice, times));
    all.into_iter().map(|(notice, times)| format!("{notice}, told at {times:.3?}")).collect()
}

/// The alarms of a webhook's body, each with the time of the change: the end of a shelving raises an alarm too.
fn notices(body: &str) -> Vec<String> {
    let message: Value = serde_json::from_str(body).expect("JSON");
    let alarms = message["data"]["alarms"].as_array().expect("alarms").iter();
    let text = |own: &Value, key: &str| own[key].as_str().expect("a text").to_string();
    let at = |own: &Value| parse_time(&text(own, "time")).expect("a time");
    alarms.map(|own| named(&at_site(&text(own, "id")), at(own))).collect()
}

/// What waits on the disk of a daemon that tells people, as `notices` has it.
fn unsent(store: &Path) -> Vec<String> {
    let Ok(files) = std::fs::read_dir(store.join("letters/w")) else { return Vec::new() };
    let files = files.map(|file| file.expect("readable").path());
    let letters = files.filter(|path| path.extension().is_some_and(|extension| extension == "json"));
    let body = |path: PathBuf| {
        let text = std::fs::read_to_string(path).expect("readable");
        let letter: Value = serde_json::from_str(&text).expect("JSON");
        notices(letter["body"].as_str().expect("a text"))
    };
    letters.flat_map(body).collect()
}

/// What was raised at a site by a store, and nobody was told of although nothing on the disks of `tellers` has it.
pub fn untold(store: &Path, site: &str, told: &[String], tellers: &[PathBuf]) -> Vec<String> {
    let raised = changes(store, site).into_iter().map(|(_, own)| own).filter(|own| own.cause == "raised");
    let mut waits: Vec<String> = tellers.iter().flat_map(|own| unsent(own)).collect();
    waits.extend_from_slice(told);
    raised.map(|own| notice(&own)).filter(|own| !waits.contains(own)).collect()
}

/// What happened to alarms of a site by a store, as `notices` has it, each once.
pub fn happened(store: &Path, site: &str) -> BTreeSet<String> {
    changes(store, site).iter().map(|(_, own)| notice(own)).collect()
}

/// A change that `changes` has, as `notices` has it.
fn notice(own: &Changed) -> String {
    named(&format!("{}/{}", own.name, own.kind), f64::from_bits(own.at))
}

/// To the millisecond, as a webhook has the time.
fn named(id: &str, at: f64) -> String {
    format!("{id} {:.0}", (at * 1e3).round())
}
