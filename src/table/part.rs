//! Files that hold a part of a loop's tags, as historians export them: OP in one file, PV in another. A store takes each by itself.

use super::error::{TableError, shown};
use super::layout::SeenRow;
use super::names::{Meaning, Name};
use super::options::Options;
use super::qualities::speaks;
use super::roles::{Roles, Trouble, as_far_as_there};
use super::time::WhatKind;
use crate::signal::Role;

/// The roles of a header without OP or PV, where every column is known: a value is one of the loop by its name or by an option, any
/// other says how good it is, and what has no name holds nothing. Of others OP or PV may have a name that nobody knows. `times` are the
/// columns of times.
///
/// # Errors
/// What is `missing` where a column is not known, and an MV or a CV that may be the output or something else.
pub fn of_part(
    names: &[Name],
    times: [Option<usize>; 3],
    below: &[SeenRow],
    options: &Options,
    missing: Vec<&'static str>,
) -> Result<Roles, Trouble> {
    let (found, _) = as_far_as_there(names, options, true)?;
    let holds =
        |at: usize| below.iter().filter_map(|(_, row)| row.get(at)).any(|cell| cell.kind != WhatKind::Blank);
    let is_known = |at: usize| {
        found[at].is_some()
            || times.contains(&Some(at))
            || if names[at].is_none() { !holds(at) } else { speaks(names, at) }
    };
    if !found.iter().any(Option::is_some) || !(0..names.len()).all(is_known) {
        return Err(Trouble::Missing(missing));
    }
    let op = found.iter().position(|role| *role == Some(Role::Op));
    let is_alone = options.op.is_none() && !found.contains(&Some(Role::Pv));
    match op.map(|at| &names[at]).filter(|name| is_alone && is_either(name)) {
        Some(name) => Err(Trouble::Refused(TableError::refused(format!(
            "{:?} may be the controller's output or another value, and no PV stands beside it; say which it is with --op, --pv or --mv",
            shown(&name.full)
        )))),
        None => Ok(found),
    }
}

/// Whether a name is that of an output only beside others: MV is a valve's position as well, and CV a controlled variable.
fn is_either(name: &Name) -> bool {
    let Some(said) = name.said() else { return false };
    let of_loop = name.plain().strip_prefix(said.owner.as_str()).map(str::trim);
    said.meaning == Meaning::Role(Role::Mv) || of_loop == Some("cv")
}

#[cfg(test)]
mod tests {
    use super::super::{Options, Source, TableError, Tag, read, stream};
    use crate::signal::Sample;

    /// Three rows with these cells behind their times.
    fn rows(header: &str, sign: char, cells: &str) -> String {
        let row = |at: usize| format!("2026-06-15 06:00:0{at}{sign}{cells}\n");
        format!("{header}\n{}", (0..3).map(row).collect::<String>())
    }

    /// What an import takes: loop, tag and value of each sample.
    fn imported(text: &str, options: &Options) -> Result<Vec<(String, String, f64)>, String> {
        let mut all = Vec::new();
        let mut take = |tag: &Tag, sample: Sample| {
            all.push((tag.owner.clone(), tag.name.clone(), sample.value));
            Ok::<(), TableError>(())
        };
        stream(Source::Bytes(text.as_bytes()), options, &mut take).map_err(|error| error.to_string())?;
        Ok(all)
    }

    #[test]
    fn a_file_of_one_tag_is_imported_and_is_no_record() {
        let told = |op: Option<&str>, mv: Option<&str>| Options {
            op: op.map(str::to_string),
            mv: mv.map(str::to_string),
            of_loop: op.or(mv).map(|_| "FIC101".into()),
            ..Options::default()
        };
        let plain = Options::default();
        for (header, sign, cells, options, tags) in [
            ("Timestamp,FIC101.OP", ',', "51.8", &plain, &["op"][..]),
            ("Timestamp,FIC101.PV,FIC101.PV.Quality", ',', "51.8,Good", &plain, &["pv"]),
            ("Timestamp;FIC101.SP;", ';', "51,8;", &plain, &["sp"]),
            ("Timestamp,FIC101.OP,FIC101.SP", ',', "51.8,51.8", &plain, &["op", "sp"]),
            ("Timestamp,FIC101/PID1/OUT.CV", ',', "51.8", &plain, &["op"]),
            ("Timestamp,Value", ',', "51.8", &told(Some("Value"), None), &["op"]),
            ("Timestamp,FIC101.MV", ',', "51.8", &told(None, Some("FIC101.MV")), &["mv"]),
            ("Timestamp,FIC101.CV", ',', "51.8", &told(Some("FIC101.CV"), None), &["op"]),
        ] {
            let text = rows(header, sign, cells);
            let taken = imported(&text, options).unwrap_or_else(|said| panic!("{header}: {said}"));
            let owns = |own: &(String, String, f64)| own.0.starts_with("FIC101") && own.2 == 51.8;
            assert!(taken.len() == 3 * tags.len() && taken.iter().all(owns), "{header}: {taken:?}");
            for tag in tags {
                assert_eq!(taken.iter().filter(|own| own.1 == *tag).count(), 3, "{header}: {taken:?}");
            }
            let said = read(Source::Bytes(text.as_bytes()), options).err().map(|error| error.to_string());
            assert!(said.is_some_and(|said| said.contains("no column ")), "{header} is no record");
        }
    }

    #[test]
    fn where_a_column_is_not_known_it_may_be_the_one_that_is_missing() {
        for (header, cells, by) in [
            ("Timestamp,FIC101.OP,Flow", "51.8,20.5", "no column pv"),
            ("Timestamp,FIC101.OP,", "51.8,20.5", "no column pv"),
            ("Timestamp,FIC101.PV,Valve", "51.8,20.5", "no column op"),
            ("Timestamp,Value", "51.8", "no column op, pv"),
            ("Timestamp,FIC101.MV", "51.8", "say which it is with --op, --pv or --mv"),
            ("Timestamp,FIC101.CV", "51.8", "say which it is with --op, --pv or --mv"),
            ("Timestamp,OP", "51.8", "\"OP\" names no loop; say which with --loop"),
            ("Timestamp,FIC101.OP,FIC102.OP", "51.8,20.5", "may each be op"),
        ] {
            let said = imported(&rows(header, ',', cells), &Options::default()).err().unwrap_or_default();
            assert!(said.contains(by), "{header}: {said}");
        }
    }
}
