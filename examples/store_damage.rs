//! Damages a store at random and says what came of it: `cargo run --example store_damage [CASES] [SEED]`.

#[path = "../tests/store_damage/damage.rs"]
mod damage;

use std::collections::BTreeMap;

fn main() {
    let mut arguments = std::env::args().skip(1).filter_map(|argument| argument.parse().ok());
    let (cases, seed) = (arguments.next().unwrap_or(200), arguments.next().unwrap_or(20));
    for sets in [&damage::FILES[..], &damage::PAIRS[..]] {
        one_sweep(sets, cases as usize, seed);
    }
}

/// One table: so many cases of these files.
fn one_sweep(sets: &[&[&str]], cases: usize, seed: u64) {
    let place = std::env::temp_dir().join(format!("store-damage-{}", std::process::id()));
    // Cases, working, working with something gone, states back, states, mistold, samples back, samples, failing though a
    // check finds nothing, runs back, runs.
    let mut table: BTreeMap<(String, String), [usize; 11]> = BTreeMap::new();
    damage::sweep(&place, sets, cases, seed, |file, kind, found| {
        let row = table.entry((file.to_string(), kind.to_string())).or_default();
        let gone = found.missing > 0 || found.samples.0 < found.samples.1 || found.runs.0 < found.runs.1;
        let counts = [
            1,
            usize::from(found.working),
            usize::from(found.working && gone),
            found.states.0,
            found.states.1,
            usize::from(found.mistold()),
            found.samples.0,
            found.samples.1,
            usize::from(!found.working && found.checked_good),
            found.runs.0,
            found.runs.1,
        ];
        row.iter_mut().zip(counts).for_each(|(sum, count)| *sum += count);
    });
    println!(
        "file                      kind    cases  working  with data gone  alarm states back  mistold loss  samples back  runs back  failing and checked good"
    );
    let mut all = [0; 11];
    let percent = |part: usize, of: usize| 100.0 * part as f64 / of.max(1) as f64;
    let line = |file: &str, kind: &str, row: [usize; 11]| {
        println!(
            "{file:24}  {kind:6}  {:5}  {:7}  {:14}  {:15.1} %  {:12}  {:10.1} %  {:7.1} %  {:24}",
            row[0],
            row[1],
            row[2],
            percent(row[3], row[4]),
            row[5],
            percent(row[6], row[7]),
            percent(row[9], row[10]),
            row[8]
        );
    };
    for ((file, kind), row) in &table {
        line(file, kind, *row);
        all.iter_mut().zip(row).for_each(|(sum, count)| *sum += count);
    }
    line("all", "", all);
    let _ = std::fs::remove_dir_all(place);
}
