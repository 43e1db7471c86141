//! What the stores of an edge and a centre have, and what people were told.

use serde_json::Value;
use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};
use stictiond::serve::dto::parse_time;
use stictiond::store::Reader;

/// Reports of a store by loop and time, those of one site.
pub fn reports(store: &Path, site: &str) -> BTreeMap<(String, u64), Vec<u8>> {
    let reader = Reader::open(store).expect("can be read");
    let (mut all, mut after) = (BTreeMap::new(), 0);
    while let Some(rows) = Some(reader.diagnoses(after, 100).expect("reads")).filter(|rows| !rows.is_empty())
    {
        for (number, row) in rows {
            after = number;
            let Some(name) = of_site(&row.control_loop, site) else { continue };
            let known = all.insert((name, row.finished.to_bits()), row.report.unwrap_or_default());
            assert!(known.is_none(), "nothing is there twice");
        }
    }
    all
}

/// What happened to alarms of a site by a store: subject, kind, when, cause.
pub fn changes(store: &Path, site: &str) -> Vec<(String, String, u64, String)> {
    let reader = Reader::open(store).expect("can be read");
    let rows = reader.transitions(0, 100_000).expect("reads").into_iter();
    let own = rows.filter_map(|(_, row)| {
        Some((of_site(&row.control_loop, site)?, row.kind, row.at.to_bits(), row.cause))
    });
    let mut all: Vec<_> = own.collect();
    all.sort();
    all
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

/// Of each tag of a site in a store, its samples: stamps and values as bits.
pub fn samples(store: &Path, site: &str) -> BTreeMap<(String, String), Vec<(u64, u64)>> {
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

/// A centre's store has what a site's edge has, but for the end: once, to the last bit. An edge that was killed, at the times
/// `killed`, may have forwarded what it had not on its disk yet.
pub fn compare(edge: &Path, centre: &Path, site: &str, loops: usize, killed: &[f64]) {
    let (here, there) = (reports(edge, site), reports(centre, site));
    assert!(there.iter().all(|(key, report)| here.get(key) == Some(report)), "bit for bit");
    // What an edge finds as it stops it forwards at its next start; what every centre had before this one was there is gone
    // from the streams.
    let first = there.keys().map(|(_, finished)| *finished).min().expect("there are some");
    let missing: Vec<_> = here.keys().filter(|key| key.1 >= first && !there.contains_key(key)).collect();
    assert!(there.len() >= loops && missing.len() <= 20, "{} and without {missing:?}", there.len());
    let (own, known) = (changes(edge, site), changes(centre, site));
    assert!(!known.is_empty() && known.iter().all(|change| own.contains(change)), "{known:?}");
    let mut once = known.clone();
    once.dedup();
    assert_eq!(once, known);
    let (own, known_samples) = (samples(edge, site), samples(centre, site));
    assert_eq!(own.len(), known_samples.len());
    let ahead = |t: f64| killed.iter().any(|end| (0.0..AHEAD_S).contains(&(end - t)));
    for (tag, some) in &known_samples {
        let all = &own[tag];
        let on_disk: HashSet<&(u64, u64)> = all.iter().collect();
        let mut some = some.clone();
        some.retain(|sample| on_disk.contains(sample) || !ahead(f64::from_bits(sample.0)));
        assert!(some.len() > 200 && some.len() <= all.len(), "{tag:?}: {} of {}", some.len(), all.len());
        assert_eq!(all[..some.len()], some[..], "{tag:?}: none is missing, none is twice");
    }
    let count = |of: &BTreeMap<_, Vec<_>>| of.values().map(Vec::len).sum::<usize>();
    let bytes = there.values().map(Vec::len).sum::<usize>() / there.len();
    println!(
        "{site}: reports of {bytes} bytes; {} of {} diagnoses, {} of {} changes of alarms, {} of {} samples at the centre, the rest of its last seconds",
        there.len(),
        here.len(),
        once.len(),
        changes(edge, site).len(),
        count(&known_samples),
        count(&own)
    );
}

/// The alarms of a webhook's body, each with the time of the change: the end of a shelving raises an alarm too.
pub fn notices(body: &str) -> Vec<String> {
    let message: Value = serde_json::from_str(body).expect("JSON");
    let alarms = message["data"]["alarms"].as_array().expect("alarms").iter();
    let text = |own: &Value, key: &str| own[key].as_str().expect("a text").to_string();
    let at = |own: &Value| parse_time(&text(own, "time")).expect("a time");
    alarms.map(|own| named(&at_site(&text(own, "id")), at(own))).collect()
}

/// What waits on the disk of a daemon that tells people, as `notices` has it.
pub fn unsent(store: &Path) -> Vec<String> {
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
    let raised = changes(store, site).into_iter().filter(|own| own.3 == "raised");
    let mut waits: Vec<String> = tellers.iter().flat_map(|own| unsent(own)).collect();
    waits.extend_from_slice(told);
    raised.map(|own| notice(&own)).filter(|own| !waits.contains(own)).collect()
}

/// A change that `changes` has, as `notices` has it.
fn notice((name, kind, at, _): &(String, String, u64, String)) -> String {
    named(&format!("{name}/{kind}"), f64::from_bits(*at))
}

/// To the millisecond, as a webhook has the time.
fn named(id: &str, at: f64) -> String {
    format!("{id} {:.0}", (at * 1e3).round())
}
