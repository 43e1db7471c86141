//! How often an effect is there for which so much speaks.

use std::collections::HashMap;
use std::path::PathBuf;
use stictiond_numerics::residual::Kind;

/// Limits of the logarithm of the odds.
const ODDS: [f64; 6] = [0.0, 2.5, 5.0, 10.0, 20.0, f64::INFINITY];
/// Limits of what held-out samples say (standard deviations).
const HELD_OUT: [f64; 4] = [f64::NEG_INFINITY, -1.0, 1.0, f64::INFINITY];

/// Values tried of the two limits that the program has: of the odds, and of what held-out samples say.
const LIKELY: [f64; 6] = [1.0, 2.5, 4.0, 5.0, 7.5, 10.0];
const SPEAKS: [f64; 6] = [0.5, 0.75, 1.0, 1.5, 2.0, 2.5];
/// Values tried of the limit of the odds against none, for changes beside friction.
const LIKELY_CHANGE: [f64; 6] = [5.0, 7.5, 10.0, 12.5, 15.0, 20.0];
/// Limits of the distance of J/S from 1.
const APART: [f64; 8] = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, f64::INFINITY];
/// The program's own limits: of the odds, of what held-out samples say, and of the odds of a change against none.
const OWN: Limits = Limits { likely: 5.0, speaks: 1.0, likely_change: 10.0 };

/// Limits of the evidence.
#[derive(Clone, Copy)]
struct Limits {
    likely: f64,
    speaks: f64,
    likely_change: f64,
}

/// The rows of the program's table.
const GROUPS: [&str; 8] = [
    "changes",
    "changes beside friction",
    "slip jumps",
    "bends",
    "stops",
    "stops beside friction",
    "others",
    "others beside friction",
];

/// An effect that was named or rejected.
struct Weighed {
    kind: Kind,
    log_odds: f64,
    /// Against the model without it.
    over_none: f64,
    held_out: f64,
    there: bool,
    /// Whether the valve is told to stick beside it.
    sticks: bool,
}

/// Prints how many were there, of how many, by the odds and by what held-out samples say, and how good other limits are.
pub fn posterior(files: &[PathBuf]) {
    let text: String = files.iter().map(|file| std::fs::read_to_string(file).unwrap_or_default()).collect();
    let rows: Vec<Weighed> = text.lines().filter_map(weighed).collect();
    println!("| | log odds | z < -1 | -1 to 1 | from 1 |");
    println!("|---|---|---|---|---|");
    for group in GROUPS {
        for odds in ODDS.windows(2) {
            let cell = |held_out: &[f64]| {
                let own = rows.iter().filter(|row| {
                    group_of(row) == group
                        && (odds[0]..odds[1]).contains(&row.told_by(group))
                        && (held_out[0]..held_out[1]).contains(&row.held_out)
                });
                let (there, of) =
                    own.fold((0, 0), |(there, of), row| (there + usize::from(row.there), of + 1));
                format!("{there} of {of}")
            };
            let cells: Vec<String> = HELD_OUT.windows(2).map(cell).collect();
            println!("| {group} | {} to {} | {} |", odds[0], odds[1], cells.join(" | "));
        }
    }
    println!("\nmean log score of each effect by the share among the others, for each limit of z");
    println!("| limit of the log odds | {} |", SPEAKS.map(|speaks| speaks.to_string()).join(" | "));
    println!("|---|{}", "---|".repeat(SPEAKS.len()));
    for likely in LIKELY {
        let scores = SPEAKS.map(|speaks| format!("{:.4}", score(&rows, Limits { likely, speaks, ..OWN })));
        println!("| {likely} | {} |", scores.join(" | "));
    }
    println!("\nthe same for each limit of the log odds of a change beside friction, against none");
    for likely_change in LIKELY_CHANGE {
        println!("{likely_change}: {:.4}", score(&rows, Limits { likely_change, ..OWN }));
    }
    println!("\nslip jumps that were there, by how far J/S is told to be from 1");
    let ratios: Vec<(f64, bool)> = text.lines().filter_map(ratio).collect();
    for apart in APART.windows(2) {
        let own = ratios.iter().filter(|own| (apart[0]..apart[1]).contains(&(own.0 - 1.0).abs()));
        let (there, of) = own.fold((0, 0), |(there, of), own| (there + usize::from(own.1), of + 1));
        println!("{} to {}: {there} of {of}", apart[0], apart[1]);
    }
}

impl Weighed {
    /// The log odds by which a group is told.
    fn told_by(&self, group: &str) -> f64 {
        if group == "changes beside friction" { self.over_none } else { self.log_odds }
    }
}

/// The cell of the program's table that an effect counts in.
fn cell(row: &Weighed, limits: Limits) -> (&'static str, bool, usize) {
    let Limits { likely, speaks, likely_change } = limits;
    let (group, is_likely) = (group_of(row), row.log_odds >= likely);
    let said = usize::from(row.held_out >= -speaks) + usize::from(row.held_out >= speaks);
    match group {
        "changes" => (group, true, said),
        "changes beside friction" => (group, row.over_none >= likely_change, said),
        "slip jumps" => (group, is_likely, 0),
        _ if is_likely => (group, true, said),
        _ => (group, false, said.min(1)),
    }
}

/// The mean logarithmic score, each effect left out of its own share.
fn score(rows: &[Weighed], limits: Limits) -> f64 {
    let mut counts: HashMap<(&str, bool, usize), (f64, f64)> = HashMap::new();
    for row in rows {
        let count = counts.entry(cell(row, limits)).or_default();
        *count = (count.0 + f64::from(u8::from(row.there)), count.1 + 1.0);
    }
    let of = |row: &Weighed| {
        let (there, of) = counts[&cell(row, limits)];
        let own = f64::from(u8::from(row.there));
        let p = (there - own + 0.5) / of;
        if row.there { p.ln() } else { (1.0 - p).ln() }
    };
    rows.iter().map(of).sum::<f64>() / rows.len().max(1) as f64
}

/// The row of the table that an effect counts in.
fn group_of(row: &Weighed) -> &'static str {
    match row.kind {
        Kind::ValveSaturation if row.sticks => "stops beside friction",
        Kind::ValveSaturation => "stops",
        Kind::SlipJump => "slip jumps",
        Kind::StaticNonlinearity => "bends",
        kind if kind.is_change() && row.sticks => "changes beside friction",
        kind if kind.is_change() => "changes",
        _ if row.sticks => "others beside friction",
        _ => "others",
    }
}

/// A line as `evidence C clean 301 slip_jump 6.205 6.205 -0.310 0 1 ...`.
fn weighed(line: &str) -> Option<Weighed> {
    let cells: Vec<&str> = line.split_whitespace().collect();
    let ["evidence", _, _, _, kind, log_odds, over_none, held_out, there, sticks, ..] = cells[..] else {
        return None;
    };
    let kind = Kind::ALL.into_iter().find(|own| own.as_str() == kind)?;
    let [log_odds, over_none, held_out] = [log_odds, over_none, held_out].map(|cell| cell.parse().ok());
    Some(Weighed {
        kind,
        log_odds: log_odds?,
        over_none: over_none?,
        held_out: held_out?,
        there: there == "1",
        sticks: sticks == "1",
    })
}

/// J/S and whether there is a slip jump, of a line as `ratio C clean 301 0.620 1`.
fn ratio(line: &str) -> Option<(f64, bool)> {
    let cells: Vec<&str> = line.split_whitespace().collect();
    let ["ratio", _, _, _, ratio, there] = cells[..] else { return None };
    Some((ratio.parse().ok()?, there == "1"))
}
