//! A column of times of day with points, `06.00.02`, as Italy, Denmark and Finland write them: each cell looks like a date.

use super::layout::SeenRow;
use super::stamp;
use super::time::WhatKind;

/// Whether the cells of a column are such times: each can be one, and some can be no date.
pub fn are_dotted_clocks(below: &[SeenRow], at: usize) -> bool {
    let cells = below.iter().filter_map(|(_, row)| row.get(at)).filter(|cell| cell.kind == WhatKind::Dated);
    let mut proved = false;
    for cell in cells {
        let own = stamp::scan(&cell.text).filter(|own| own.is_dotted() && !own.as_clock().has_date());
        let Some(own) = own else { return false };
        proved |= own.is_no_date();
    }
    proved
}

#[cfg(test)]
mod tests {
    use super::super::layout::Seen;
    use super::*;

    #[test]
    fn times_of_day_with_points_are_told_from_dates() {
        let of = |cells: &[&str]| {
            let seen = |(line, text): (u64, &&str)| {
                (line, vec![Seen { text: (*text).to_string(), kind: WhatKind::Dated }])
            };
            are_dotted_clocks(&(2..).zip(cells).map(seen).collect::<Vec<SeenRow>>(), 0)
        };
        assert!(of(&["06.00.00", "06.00.02"]) && of(&["6.12.58", "6.13.00"]));
        for cells in [
            &["06.05.00", "06.06.00"][..],
            &["06.00.00", "15.06.2026"],
            &["01.06.26", "31.06.26"],
            &["2026-06-01"],
            &[],
        ] {
            assert!(!of(cells), "{cells:?}");
        }
    }
}
