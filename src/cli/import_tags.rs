//! `stictiond import-tags LIST.csv`: `[[loop]]` sections from the list of tags that a site has: a row for each tag, or a row for
//! each loop with a column for each role.

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

/// Keys that say where a tag is, which is what a role's column of a list by loops may hold.
const PLACES: [&str; 5] = ["node", "path", "topic", "metric", "address"];

#[derive(clap::Args)]
pub struct Args {
    /// The list: a row for each tag, with a column `tag` (FIC101.OP) or the columns `loop` and `role`, and a column for each key
    /// of a tag's section: node, topic, register, address, type, scale, …; or a row for each loop, with the columns `loop`, `op`,
    /// `pv` and the like that say where each is, keys for the whole row (`type`), and keys for one role (`pv.scale`)
    #[arg(value_name = "LIST.csv")]
    list: PathBuf,
    /// What the columns `op`, `pv` and the like of a row for each loop hold; OPC UA node ids and numbers are known without it
    #[arg(long = "as", value_name = "KEY", value_parser = PLACES)]
    place: Option<String>,
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
    let tags = tags(&text, args.device.as_deref(), args.place.as_deref())
        .map_err(|why| Failure::in_file(&args.list, why))?;
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

fn tags(text: &str, device: Option<&str>, place: Option<&str>) -> Result<Vec<Tag>, String> {
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
    let at = |name: &str| header.iter().position(|own| own == name);
    let rows: Vec<csv::StringRecord> =
        table.records().collect::<Result<_, _>>().map_err(|error| error.to_string())?;
    let roles = roles(&header)?;
    let place = if roles.is_empty() { None } else { Some(place_of(&roles, &rows, place)?) };
    let mut tags = Vec::new();
    for row in &rows {
        let line = row.position().map_or(0, csv::Position::line);
        let cell = |name: &str| at(name).and_then(|at| row.get(at)).filter(|cell| !cell.is_empty());
        if row.iter().all(str::is_empty) {
            continue;
        }
        if tags.len() >= MAX_ROWS {
            return Err(format!("line {line}: more than {MAX_ROWS} tags"));
        }
        let wrong = |why: String| format!("line {line}: {why}");
        let Some(place) = place else {
            tags.push(tag(&cell, device).map_err(wrong)?);
            continue;
        };
        cell("loop").ok_or_else(|| wrong("it names no loop".into()))?;
        for (role, _) in roles.iter().filter(|(role, _)| cell(role).is_some()) {
            let own = |name: &str| match name {
                "role" => Some(role.as_str()),
                name if name == place => cell(role),
                name => cell(&format!("{role}.{name}")).or_else(|| cell(name)),
            };
            tags.push(tag(&own, device).map_err(|why| wrong(format!("{role}: {why}")))?);
        }
    }
    Ok(tags)
}

/// The columns of roles, by name and number, where each row of the list is a loop; none where each row is a tag.
fn roles(header: &[String]) -> Result<Vec<(String, usize)>, String> {
    let has = |name: &str| header.iter().any(|own| own == name);
    let is_key = |name: &str| TEXTS.contains(&name) || NUMBERS.contains(&name);
    let by_loops = has("loop") && !has("role") && !has("tag");
    let is_role = |name: &str| by_loops && !is_key(name) && stub::role(name).is_some();
    let known = |name: &str| {
        let of_role =
            name.split_once('.').is_some_and(|(role, key)| is_role(role) && has(role) && is_key(key));
        name.is_empty() || ["tag", "loop", "role"].contains(&name) || is_key(name) || is_role(name) || of_role
    };
    if let Some(strange) = header.iter().find(|name| !known(name)) {
        let names = [&["tag", "loop", "role"][..], &TEXTS, &NUMBERS].concat().join(", ");
        return Err(format!(
            "line 1: no key of a tag is called '{strange}': take the column out, or call it one of {names}"
        ));
    }
    let named = header.iter().enumerate().filter(|(_, name)| is_role(name));
    let roles: Vec<(String, usize)> = named.map(|(at, name)| (name.clone(), at)).collect();
    if !has("tag") && !(has("loop") && (has("role") || !roles.is_empty())) {
        return Err(
            "line 1: a column 'tag' is needed, or the columns 'loop' and 'role', or 'loop', 'op' and 'pv'"
                .into(),
        );
    }
    Ok(roles)
}

/// Which key the columns of roles hold: as was said, or as every cell of them looks.
fn place_of<'p>(
    roles: &[(String, usize)],
    rows: &[csv::StringRecord],
    said: Option<&'p str>,
) -> Result<&'p str, String> {
    if let Some(said) = said {
        return Ok(said);
    }
    let cells = || {
        let all =
            rows.iter().flat_map(|row| roles.iter().filter_map(move |(_, at)| Some((row, row.get(*at)?))));
        all.filter(|(_, cell)| !cell.is_empty())
    };
    let is_node = |cell: &str| {
        let id = cell.split_once(';').filter(|(space, _)| space.starts_with("ns")).map_or(cell, |(_, id)| id);
        ["i=", "s=", "g=", "b="].iter().any(|kind| id.starts_with(kind))
    };
    let is_address = |cell: &str| cell.parse::<u32>().is_ok();
    if cells().all(|(_, cell)| is_node(cell)) {
        return Ok("node");
    }
    if cells().all(|(_, cell)| is_address(cell)) {
        return Ok("address");
    }
    let (row, cell) = cells().find(|(_, cell)| !is_node(cell)).unwrap_or((&rows[0], ""));
    let line = row.position().map_or(0, csv::Position::line);
    Err(format!("line {line}: what is '{cell}'? Say it with --as {}", PLACES.join(", --as ")))
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
            ("loop,op,pv,device\nA,i=1,i=2,d\n,i=3,i=4,d\n", "line 3: it names no loop"),
            (
                "loop,op,pv,device\nA,i=1,i=2,d\nB,plant/b/op,i=2,d\n",
                "line 3: what is 'plant/b/op'? Say it with --as node",
            ),
            ("loop,op,pv,device,sp.scale\nA,i=1,i=2,d,2\n", "no key of a tag is called 'sp.scale'"),
            ("loop,op,pv,device,pv.scale\nA,i=1,i=2,d,x\n", "line 2: pv: scale: 'x'"),
            ("loop,device\nA,d\n", "or 'loop', 'op' and 'pv'"),
        ] {
            let why = tags(text, None, None).unwrap_err();
            assert!(why.contains(part), "{text}: {why}");
        }
    }

    #[test]
    fn a_row_for_each_loop_says_the_same_as_a_row_for_each_tag() {
        let by_tags = "loop,role,device,address,register,type,scale\n\
                       A,op,d,0,holding,f32,\nA,pv,d,2,holding,f32,0.1\nB,op,d,4,holding,f32,\nB,pv,d,6,holding,f32,\n";
        let by_loops =
            "Loop;OP;PV;SP;device;register;type;PV.scale\nA;0;2;;d;holding;f32;0.1\nB;4;6;;d;holding;f32;\n";
        let expected = tags(by_tags, None, None).unwrap();
        assert_eq!(tags(by_loops, None, None).unwrap(), expected);
        assert_eq!(expected.len(), 4);
        let topics = "loop,op,pv\nA,plant/a/op,plant/a/pv\n";
        let found = tags(topics, Some("broker"), Some("topic")).unwrap();
        assert_eq!(found[1].keys[1], ("topic".to_string(), "\"plant/a/pv\"".to_string()));
        let nodes = tags("loop,op,pv\nA,ns=2;s=A.OP,nsu=urn:x;s=A.PV\n", Some("opc"), None).unwrap();
        assert_eq!(nodes[0].keys[1], ("node".to_string(), "\"ns=2;s=A.OP\"".to_string()));
    }
}
