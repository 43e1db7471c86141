//! Files of one folder that import each other in a circle: none of them can be read, tested or moved without the others.

use crate::source::Source;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Every circle among the files of `folder`, as the shortest way round. `mod` alone is no import; what a file shows of another
/// by `pub use` is, and so is a parent's name.
pub fn circles(folder: &str, sources: &[Source]) -> Vec<String> {
    let root = format!("{folder}.rs");
    let inside = |source: &&Source| source.path == root || source.path.starts_with(&format!("{folder}/"));
    let files: BTreeMap<Vec<String>, &Source> =
        sources.iter().filter(inside).map(|source| (source.module(), source)).collect();
    let imports: BTreeMap<&str, BTreeSet<&str>> =
        files.values().map(|source| (source.path.as_str(), imported(source, &files))).collect();
    let mut told = BTreeSet::new();
    let mut found = Vec::new();
    for file in imports.keys() {
        let Some(round) = shortest_round(file, &imports) else { continue };
        // A circle is met from each of its files.
        let members: BTreeSet<&str> = round.iter().copied().collect();
        if told.insert(members) {
            found.push(format!("{folder}: a circle of imports: {}", round.join(" -> ")));
        }
    }
    found
}

/// The files that one file imports.
fn imported<'f>(source: &Source, files: &BTreeMap<Vec<String>, &'f Source>) -> BTreeSet<&'f str> {
    let own = source.module();
    // The file that a path leads into is the one whose module it names the most of.
    let file = |path: &[String]| (1..=path.len()).rev().find_map(|steps| files.get(&path[..steps]));
    let named = |path: Vec<String>| match path[0].as_str() {
        "crate" => file(&path[1..]),
        // A file may name its own children without saying where they are.
        child => {
            let child = [own.clone(), vec![child.to_string()]].concat();
            files.contains_key(&child).then(|| file(&[own.clone(), path].concat())).flatten()
        }
    };
    let found = source.paths().into_iter().filter_map(named).map(|other| other.path.as_str());
    found.filter(|other| *other != source.path).collect()
}

/// The shortest way from a file by imports back to itself.
fn shortest_round<'f>(
    start: &'f str,
    imports: &BTreeMap<&'f str, BTreeSet<&'f str>>,
) -> Option<Vec<&'f str>> {
    let mut ways = VecDeque::from([vec![start]]);
    let mut seen = BTreeSet::new();
    while let Some(way) = ways.pop_front() {
        for &next in &imports[way[way.len() - 1]] {
            let longer = [way.clone(), vec![next]].concat();
            if next == start {
                return Some(longer);
            }
            if seen.insert(next) {
                ways.push_back(longer);
            }
        }
    }
    None
}
