//! `stictiond import-tags LIST.csv`: `[[loop]]` sections from the list of tags that a site has.

use super::{Failure, print};
use std::path::PathBuf;
use stictiond::collect::stub::{self, Tag, quoted};

/// Longest list (bytes).
const MAX_BYTES: u64 = 64 << 20;
/// Rows that are read, at most.
const MAX_ROWS: usize = 200_000;
/// Columns whose values are texts of a tag's section.
const TEXTS: [&str; 13] = [
    "device",
    "node",
    "path",
    "topic",
    "time_path",
    "quality_path",
    "sparkplug",
    "metric",
    "register",
    "type",
    "byte_order",
    "unit",
    "decimal",
];
/// Columns whose values are numbers of it.
const NUMBERS: [&str; 9] =
    ["address", "bit", "alias", "element", "scale", "offset", "sampling_ms", "queue_size", "deadband"];

#[derive(clap::Args)]
pub struct Args {
    /// The list: a row for each tag, with a column `tag` (FIC101.OP) or the columns `loop` and `role`, and a column for each key
    /// of a tag's section: node, topic, register, address, type, scale, …
    #[arg(value_name = "LIST.csv")]
    list: PathBuf,
    /// The device of tags whose row names none
    #[arg(long)]
    device: Option<String>,
}

/// Prints the sections; what was left out stands in comments.
pub fn run(args: &Args) -> Result<(), Failure> {
    let size = std::fs::metadata(&args.list).map_err(|error| Failure::in_file(&args.list, error))?.len();
    if size > MAX_BYTES {
        return Err(Failure::in_file(&args.list, format!("larger than {MAX_BYTES} bytes: divide the list")));
    }
    let bytes = std::fs::read(&args.list).map_err(|error| Failure::in_file(&args.list, error))?;
    // Spreadsheets save UTF-8, UTF-16 with its mark, or what Windows had before.
    let text = match std::str::from_utf8(&bytes) {
        Ok(text) => text.into(),
        Err(_) => encoding_rs::WINDOWS_1252.decode(&bytes).0,
    };
    let tags = tags(&text, args.device.as_deref()).map_err(|why| Failure::in_file(&args.list, why))?;
    let stub = stub::loops(&tags);
    if stub.loops == 0 {
        let why = stub.left_out.first().cloned().unwrap_or_else(|| "there is no row below the header".into());
        return Err(Failure::in_file(&args.list, format!("no loop with an op and a pv: {why}")));
    }
    print(&format!(
        "# {} loops, {} left out\n{}\n{}",
        stub.loops,
        stub.left_out.len(),
        stub.remarks(),
        stub.text
    ))
}

fn tags(text: &str, device: Option<&str>) -> Result<Vec<Tag>, String> {
    let text = text.trim_start_matches('\u{feff}');
    let first = text.lines().next().unwrap_or_default();
    let separator =
        [b';', b'\t', b','].into_iter().max_by_key(|sign| first.bytes().filter(|byte| byte == sign).count());
    let mut table = csv::ReaderBuilder::new()
        .delimiter(separator.unwrap_or(b','))
        .flexible(true)
        .trim(csv::Trim::All)
        .from_reader(text.as_bytes());
    let header: Vec<String> =
        table.headers().map_err(|error| error.to_string())?.iter().map(|name| name.to_lowercase()).collect();
    let known = |name: &&String| {
        ["tag", "loop", "role"].contains(&name.as_str())
            || TEXTS.contains(&name.as_str())
            || NUMBERS.contains(&name.as_str())
    };
    if let Some(strange) = header.iter().find(|name| !known(name) && !name.is_empty()) {
        let names = [&["tag", "loop", "role"][..], &TEXTS, &NUMBERS].concat().join(", ");
        return Err(format!(
            "line 1: no key of a tag is called '{strange}': take the column out, or call it one of {names}"
        ));
    }
    let at = |name: &str| header.iter().position(|own| own == name);
    if at("tag").is_none() && (at("loop").is_none() || at("role").is_none()) {
        return Err("line 1: a column 'tag' is needed, or the columns 'loop' and 'role'".into());
    }
    let mut tags = Vec::new();
    for row in table.records() {
        let row = row.map_err(|error| error.to_string())?;
        let line = row.position().map_or(0, csv::Position::line);
        let cell = |name: &str| at(name).and_then(|at| row.get(at)).filter(|cell| !cell.is_empty());
        if row.iter().all(str::is_empty) {
            continue;
        }
        if tags.len() == MAX_ROWS {
            return Err(format!("line {line}: more than {MAX_ROWS} tags"));
        }
        tags.push(tag(&cell, device).map_err(|why| format!("line {line}: {why}"))?);
    }
    Ok(tags)
}

fn tag<'r>(cell: &impl Fn(&str) -> Option<&'r str>, device: Option<&str>) -> Result<Tag, String> {
    let role = match cell("role") {
        Some(word) => {
            Some(stub::role(word).ok_or_else(|| format!("'{word}' is none of op, pv, sp, mode, mv"))?)
        }
        None => None,
    };
    let of_loop = cell("loop").map(str::to_string);
    let name = cell("tag").map(str::to_string);
    let name = name.or_else(|| Some(format!("{}.{}", of_loop.as_deref()?, cell("role")?)));
    let name = name.ok_or("it names neither a tag nor a loop and a role")?;
    let mut keys = Vec::new();
    let own = cell("device").or(device);
    let own = own.ok_or("no device: add a column 'device', or write --device NAME")?;
    keys.push(("device".to_string(), quoted(own)));
    for key in TEXTS.into_iter().filter(|key| *key != "device") {
        keys.extend(cell(key).map(|value| (key.to_string(), quoted(value))));
    }
    for key in NUMBERS {
        let Some(value) = cell(key) else { continue };
        let number: f64 =
            value.parse().map_err(|_| format!("{key}: '{value}' is no number with a decimal point"))?;
        let decimals = ["scale", "offset", "deadband"].contains(&key);
        let whole = number.fract() == 0.0 && number.abs() < 1e15;
        if !number.is_finite() || !decimals && !whole {
            return Err(format!(
                "{key}: '{value}' must be a {} number",
                if decimals { "finite" } else { "whole" }
            ));
        }
        keys.push((key.to_string(), if decimals { format!("{number:?}") } else { format!("{number:.0}") }));
    }
    Ok(Tag { name, of_loop, role, keys, note: None })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_row_is_named_by_its_line() {
        for (text, part) in [
            ("tag,nod\nA.OP,i=1\n", "line 1: no key of a tag is called 'nod'"),
            ("loop,node\nA,i=1\n", "'loop' and 'role'"),
            ("tag,node\nA.OP,i=1\n", "line 2: no device"),
            ("tag,device,address\nA.OP,d,40x\n", "line 2: address: '40x'"),
            ("tag,device,address\nA.OP,d,1.5\n", "must be a whole number"),
            ("loop,role,device\nA,opp,d\n", "'opp' is none of op"),
        ] {
            let why = tags(text, None).unwrap_err();
            assert!(why.contains(part), "{text}: {why}");
        }
    }
}
