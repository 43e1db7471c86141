//! What was found, in one line.

use super::blanks::Blanks;
use super::channel::Channel;
use super::error::{listed, shown};
use super::layout::Body;
use super::source::Kind;
use super::survey::Plan;
use super::take::Counted;
use super::time_columns::parts_said;
use crate::signal::{Role, many};
use std::fmt::Write;

/// Columns and tags of quality that are named.
const NAMED: usize = 8;

/// Tags with a role that are named: a table may have those of many loops.
const ROLES: usize = 12;

/// How a table was read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Found {
    /// In one line: `; separated, decimal comma, time dd.mm.yyyy (UTC), op from "FIC101.OP" [%]`.
    pub read_as: String,
    /// The unit of OP, where header, tag or cells tell it.
    pub op_unit: Option<String>,
}

impl Found {
    pub(super) fn new(plan: &Plan, counted: &Counted) -> Self {
        let mut parts = vec![file(plan)];
        if plan.layout.pairs.is_some() {
            parts.push("each tag by its own times".into());
        } else if matches!(plan.layout.body, Body::Long(_)) {
            parts.push("a row for each sample".into());
        }
        if plan.signs {
            parts.push(plan.decimal.name().into());
        }
        parts.push(plan.reading.said.clone());
        if let Some(at) = plan.layout.millis {
            let name = &plan.layout.names[at];
            let from = if name.is_none() {
                format!("column {}", at + 1)
            } else {
                format!("{:?}", shown(&name.full))
            };
            parts.push(format!("{} from {from}", parts_said(name)));
        }
        let mut op_unit = None;
        let mut roles = 0;
        for (at, channel) in plan.channels.iter().enumerate() {
            let Some(role) = channel.role else { continue };
            roles += 1;
            if roles > ROLES {
                continue;
            }
            let beside = Some(&plan.units[at]).filter(|unit| !unit.is_empty()).cloned();
            let unit = channel.tag.unit.clone().or(beside).filter(|unit| unit != "-");
            let mut part =
                format!("{} from {:?}", super::take::role_of(channel.role), shown(&channel.tag.name));
            if let Some(unit) = &unit {
                // Writing into a String cannot fail.
                let _ = write!(part, " [{unit}]");
            }
            parts.push(part);
            if role == Role::Op {
                op_unit = unit;
            }
        }
        if roles > ROLES {
            parts.push(format!("and {} more", roles - ROLES));
        }
        parts.extend(others(plan));
        parts.extend(plan.modes.iter().flatten().filter_map(|modes| modes.said.clone()));
        parts.extend(remarks(plan, counted));
        Self { read_as: parts.join(", "), op_unit }
    }
}

/// What divides the cells, or which kind of file it is.
fn file(plan: &Plan) -> String {
    let separated = |encoding: Option<&str>| {
        let encoding = encoding.map(|name| format!("{name}, ")).unwrap_or_default();
        match plan.separator {
            b'\t' => format!("{encoding}tab separated"),
            sign if Blanks::of(sign) == Some(Blanks::Ruled) => {
                format!("{encoding}columns as the ruler has them")
            }
            sign if Blanks::of(sign).is_some() => format!("{encoding}separated by blanks"),
            sign => format!("{encoding}{} separated", char::from(sign)),
        }
    };
    match &plan.kind {
        Kind::Text(encoding) => separated(encoding.unusual()),
        Kind::Sheet(sheet) if sheet.one_of_many => format!("sheet {:?}", sheet.name),
        Kind::Sheet(_) => "workbook".into(),
        Kind::Parquet => "Parquet".into(),
    }
}

/// What the other columns of a table are: tags that may explain PV, and text, which nothing is made of.
fn others(plan: &Plan) -> Vec<String> {
    let values = plan.channels.iter().filter(|own| !own.says_of_another);
    let others = values.filter(|own| own.role.is_none() && own.cells > 0 && !own.tag.name.is_empty());
    let (tags, texts): (Vec<&Channel>, Vec<&Channel>) = others.partition(|own| own.numbers > 0);
    let columns = plan.unused.iter().map(|at| plan.layout.names[*at].full.as_str());
    let not_used: Vec<&str> = names_of(&texts).into_iter().chain(columns).collect();
    let said = |what: &str, all: Vec<&str>| (!all.is_empty()).then(|| format!("{what} {}", listed(all)));
    said("other tags", names_of(&tags)).into_iter().chain(said("not used", not_used)).collect()
}

fn names_of<'c>(all: &[&'c Channel]) -> Vec<&'c str> {
    all.iter().map(|own| own.tag.name.as_str()).collect()
}

/// What was not used.
fn remarks(plan: &Plan, counted: &Counted) -> Vec<String> {
    let mut out = Vec::new();
    let [all, manual, unknown] = counted.modes;
    if manual > 0 {
        out.push(format!("{manual} of {} not in automatic", many(all, "row")));
    }
    if unknown > 0 {
        out.push(format!("{} of an unknown mode (--auto-values)", many(unknown, "row")));
    }
    if counted.not_good > 0 {
        let name = |at: usize| match &plan.layout.names[at] {
            name if name.is_none() => format!("column {}", at + 1),
            name => name.full.clone(),
        };
        let columns = plan.qualities.iter().map(|(at, ..)| name(*at));
        let tags = plan.joined.iter().map(|own| plan.channels[own.by].tag.name.clone());
        let behind = plan.channels.iter().filter(|own| own.has_qualities(plan.letters));
        let behind = behind.map(|own| format!("the words behind {}", own.tag.name));
        let names: Vec<String> = columns.chain(tags).chain(behind).take(NAMED).collect();
        out.push(format!("{} not good by {}", many(counted.not_good, "sample"), names.join(", ")));
    }
    if counted.no_number > 0 {
        out.push(format!("{} without a number", many(counted.no_number, "sample")));
    }
    let (lines, n) = &counted.left_out;
    if *n > 0 {
        let named: Vec<String> = lines.iter().map(u64::to_string).collect();
        let more = if *n > lines.len() as u64 { ", …" } else { "" };
        let line = if *n == 1 { "line" } else { "lines" };
        out.push(format!("{} left out: {line} {}{more}", many(*n, "row"), named.join(", ")));
    }
    out
}
