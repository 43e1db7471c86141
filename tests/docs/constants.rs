//! The constants of diagnosis and tracing: every one stands in the list of them, with its value, sort and reason.

use super::{read, rows, sources};
use std::collections::BTreeSet;

/// `NAME` in a file of the diagnosis, as its source writes the value.
fn constant(file: &str, name: &str) -> Option<String> {
    let text = read(&format!("src/diagnosis/{file}"));
    constants(&text).into_iter().find_map(|(own, value)| (own == name).then_some(value))
}

#[test]
fn the_constants_of_the_method_are_those_of_the_source() {
    let rows = rows("docs/diagnosis.md", "Constants");
    for row in &rows {
        let plain = |cell: &str| cell.trim_matches('`').to_string();
        let (file, name) = (plain(&row[0]), plain(&row[1]));
        assert_eq!(constant(&file, &name), Some(plain(&row[2])), "docs/diagnosis.md: {name} in {file}");
    }
    assert_eq!(constant("evidence.rs", "NO_SUCH_NAME"), None);
}

/// A line that begins a constant, without who sees it, and the constant's name.
fn begins(line: &str) -> Option<(&str, &str)> {
    let seen = ["pub(super) ", "pub(crate) ", "pub "];
    let line = seen.into_iter().find_map(|seen| line.strip_prefix(seen)).unwrap_or(line);
    let (name, _) = line.strip_prefix("const ")?.split_once(": ")?;
    name.chars().all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_').then_some((line, name))
}

/// Name and value of every constant of a text, a value of several lines put on one.
fn constants(text: &str) -> Vec<(String, String)> {
    let mut out = Vec::new();
    let mut lines = text.lines().map(str::trim);
    while let Some(line) = lines.next() {
        let Some((line, name)) = begins(line) else { continue };
        let mut whole = line.to_string();
        while !whole.ends_with(';') {
            whole = format!("{whole} {}", lines.next().expect("a constant ends"));
        }
        let (_, value) = whole.split_once(" = ").expect("a constant has a value");
        out.push((name.to_string(), value.trim_end_matches(';').to_string()));
    }
    out
}

/// The constants of a text that no line of documentation stands above.
fn bare(text: &str) -> Vec<String> {
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    let is_bare = |pair: &&[&str]| !pair[0].starts_with("///") && !pair[0].starts_with("#[");
    lines.windows(2).filter(is_bare).filter_map(|pair| Some(begins(pair[1])?.1.to_string())).collect()
}

/// Enumerations: what there is, and no number that was chosen.
const LISTS: [&str; 2] = ["ALL", "CODES"];

#[test]
fn the_constants_of_diagnosis_and_tracing_are_those_of_the_source() {
    let mut known = BTreeSet::new();
    for (file, text) in ["sysid", "residual", "diagnosis"].into_iter().flat_map(sources) {
        let own = constants(&text).into_iter().filter(|(name, _)| !LISTS.contains(&name.as_str()));
        known.extend(own.map(|(name, value)| [file.clone(), name, value]));
    }
    let plain = |cell: &&str| cell.trim_matches('`').to_string();
    let document = read("docs/constants.md");
    let rows: Vec<Vec<&str>> = document
        .lines()
        .filter(|line| line.starts_with("| `"))
        .map(|line| line.trim_matches('|').trim().split(" | ").map(str::trim).collect())
        .collect();
    assert!(rows.iter().all(|row| row.len() == 5 && row[4].len() > 4), "a row without a reason");
    let told: BTreeSet<[String; 3]> = rows.iter().map(|row| [0, 1, 2].map(|i| plain(&row[i]))).collect();
    let missing: Vec<_> = known.difference(&told).collect();
    let gone: Vec<_> = told.difference(&known).collect();
    assert!(
        missing.is_empty() && gone.is_empty(),
        "docs/constants.md lacks {missing:#?}, the source lacks {gone:#?}"
    );
    assert_eq!(told.len(), rows.len(), "a constant stands there twice");
    let mut sorts = BTreeSet::new();
    for row in
        document.lines().filter(|line| line.starts_with("| ") && line.split(" | ").count() == 3).skip(1)
    {
        let cells: Vec<&str> = row.trim_matches('|').trim().split(" | ").map(str::trim).collect();
        let count = rows.iter().filter(|row| cells[0] == "all" || row[3] == cells[0]).count();
        assert_eq!(cells[2], count.to_string(), "how many are {}", cells[0]);
        sorts.insert(cells[0]);
    }
    let unknown: Vec<_> = rows.iter().filter(|row| !sorts.contains(row[3])).collect();
    assert!(unknown.is_empty(), "no such sort: {unknown:?}");
}

#[test]
fn every_constant_of_the_diagnosis_has_a_line_of_its_own() {
    let found: Vec<String> = ["sysid", "residual", "diagnosis"]
        .into_iter()
        .flat_map(sources)
        .flat_map(|(file, text)| bare(&text).into_iter().map(move |name| format!("{file}: {name}")))
        .collect();
    assert!(found.is_empty(), "without a word on what it is: {found:#?}");
    let text = "/// What.\nconst A: u8 = 1;\nconst B: u8 = 2;\n\n    pub(super) const C: u8 = 3;";
    assert_eq!(bare(text), ["B", "C"]);
}

#[test]
fn a_constant_is_read_as_the_source_writes_it() {
    let text = "/// What.\npub const A: [usize; 2] = [1, 2];\n    const fn b() {}\nconst C_1: f64 =\n    2.0\n    * PI;\npub(super) const D: [(f64, f64); 1] = [\n    (1.0, 2.0),\n];";
    let own = |name: &str, value: &str| (name.to_string(), value.to_string());
    assert_eq!(constants(text), [own("A", "[1, 2]"), own("C_1", "2.0 * PI"), own("D", "[ (1.0, 2.0), ]")]);
}
