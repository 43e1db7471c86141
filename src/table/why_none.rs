//! Why no row of a table is a header: what is missing, and tables that stand another way.

use super::error::{TableError, listed, shown};
use super::layout::{PREAMBLE, Seen, SeenRow, VALUES};
use super::names::{Meaning, Name};
use super::options::Options;
use super::roles::{Trouble, roles, told};
use super::several;
use super::time::WhatKind;
use super::time_columns::times;
use crate::signal::Role;

/// Times in one row from which it is no sample.
const FEW: usize = 3;

/// Why the best row is no header.
pub fn none(line: u64, row: &[Seen], numbers_only: bool, options: &Options, row_name: &str) -> TableError {
    if numbers_only {
        return TableError::refused(format!(
            "{row_name} {line}: numbers where the header should be; put a line such as t,op,pv above them, or say which column is \
             which, such as --time 1 --op 2 --pv 3"
        ));
    }
    let names: Vec<Name> = row.iter().map(|cell| Name::new(&cell.text)).collect();
    if let Some(Err(error)) = options.time.as_ref().map(|time| told(&names, time, "time", true)) {
        return TableError::refused(format!("{row_name} {line}: {error}"));
    }
    let missing = match times(&names, &[], options) {
        Ok(_) => Vec::new(),
        Err(_) => vec!["t"],
    };
    let others = match roles(&names, options, true) {
        Err(Trouble::Missing(missing)) => missing,
        _ => Vec::new(),
    };
    let found = listed(names.iter().map(|name| name.full.as_str()));
    if let (Some(loops), true) = (&options.several, missing.is_empty()) {
        let none = several::none(loops);
        return TableError::refused(format!("{row_name} {line}: {none}; the header has {found}"));
    }
    if let (Some(own), true) = (&options.of_loop, missing.is_empty() && !others.is_empty()) {
        let of_any = Options { of_loop: None, ..options.clone() };
        if !matches!(roles(&names, &of_any, true), Err(Trouble::Missing(_))) {
            return TableError::refused(format!(
                "{row_name} {line}: --loop {own:?}: no column {} is of this loop; there are {found}; if they are its own, name them \
                 with --op and --pv",
                others.join(" or ")
            ));
        }
    }
    let missing = [missing, others].concat().join(", ");
    let has = |part: &str| names.iter().any(|name| name.plain() == part);
    if missing.starts_with('t') && has("year") && (has("month") && has("day") || has("doy")) {
        return TableError::refused(format!(
            "{row_name} {line}: the time stands in columns of year, month and others; join them into one column, such as \
             2026-06-01 06:00:00"
        ));
    }
    if missing.is_empty() {
        return TableError::refused(format!(
            "{row_name} {line}: the header has {found}, and no times stand below it; name columns by their number with --time, \
             --op and --pv"
        ));
    }
    let blocks = match missing.as_str() {
        "op" | "pv" => {
            "; where each tag has a block of its own, save its samples as rows of tag, time and value"
        }
        _ => "",
    };
    TableError::refused(format!(
        "{row_name} {line}: no column {missing} (t the time, op the controller's output, pv the measured value); \
         the header has {found}; name them with --time, --op and --pv, by name or by number from 1, or with --time, --tag and --value where each row is one \
         sample of one tag{blocks}"
    ))
}

/// A table in which times run along a row, and each tag has a row of its own.
pub fn along_a_row(line: u64, row: &[Seen], row_name: &str) -> Option<TableError> {
    let times = row.iter().filter(|cell| matches!(cell.kind, WhatKind::Dated | WhatKind::Clock)).count();
    let filled = row.iter().filter(|cell| cell.kind != WhatKind::Blank).count();
    (times >= FEW && times + 2 >= filled).then(|| {
        TableError::refused(format!(
            "{row_name} {line}: {times} times run along a row; transpose the table, so that each row has one time"
        ))
    })
}

/// A table with a block for each tag: `FIC101.OP` stands alone above `Timestamp, Value`.
pub fn blocks(rows: &[SeenRow], row_name: &str) -> Option<TableError> {
    let name = |cell: &Seen| Name::new(&cell.text);
    let is_tag = |cell: &Seen| {
        let said = name(cell).said();
        said.is_some_and(|said| {
            matches!(said.meaning, Meaning::Role(Role::Op | Role::Pv)) && !said.owner.is_empty()
        })
    };
    let is_time = |cell: &Seen| name(cell).said().is_some_and(|said| said.meaning == Meaning::Time);
    let is_value = |cell: &Seen| VALUES.contains(&name(cell).plain());
    let filled = |row: &[Seen]| row.iter().filter(|cell| cell.kind != WhatKind::Blank).count();
    let first = &rows[..rows.len().min(PREAMBLE)];
    let found = first.windows(2).find_map(|two| {
        let ((line, above), (_, header)) = (&two[0], &two[1]);
        if filled(above) > 2 {
            return None;
        }
        let tag = above.iter().rfind(|cell| cell.kind != WhatKind::Blank).filter(|cell| is_tag(cell))?;
        let one_tag = above.iter().filter(|cell| is_tag(cell)).count() == 1;
        let is_header = header.iter().any(is_time) && header.iter().any(is_value);
        (one_tag && is_header).then_some((*line, &tag.text))
    });
    found.map(|(line, tag)| {
        TableError::refused(format!(
            "{row_name} {line}: {:?} stands above the times and values of this tag: a block for each tag; save each tag's samples as \
             rows of tag, time and value",
            shown(tag)
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::super::{Options, Source, read};

    fn said(text: &str) -> String {
        read(Source::Bytes(text.as_bytes()), &Options::default())
            .err()
            .map(|e| e.to_string())
            .unwrap_or_default()
    }

    #[test]
    fn tables_that_stand_another_way_are_named() {
        let rows = "2026-06-15 06:00:00,51.8\n2026-06-15 06:00:02,51.7\n2026-06-15 06:00:04,51.6\n";
        for above in ["FIC101.OP\nTimestamp,Value", "Tag:,FIC101.OP\nTimestamp,Value"] {
            let said = said(&format!("{above}\n{rows}\nFIC101.PV\nTimestamp,Value\n{rows}"));
            assert!(
                said.contains("a block for each tag; save each tag's samples as rows of tag, time and value"),
                "{said}"
            );
        }
        let other = Options { of_loop: Some("FIC102".into()), ..Options::default() };
        let of_another = read(Source::Bytes(b"Time,FIC101.OP,FIC101.PV\n0,1,2\n1,1,3\n"), &other);
        assert_eq!(
            of_another.map_or_else(|error| error.to_string(), |table| table.found.read_as),
            "line 1: --loop \"FIC102\": no column op or pv is of this loop; there are \"Time\", \"FIC101.OP\", \"FIC101.PV\"; if \
             they are its own, name them with --op and --pv"
        );
        let along = "Time,2026-06-15 06:00:00,2026-06-15 06:00:02,2026-06-15 06:00:04\nOP,1,2,3\nPV,1,2,3\n";
        let said = said(along);
        assert!(said.contains("times run along a row; transpose the table"), "{said}");
    }
}
