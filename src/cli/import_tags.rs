//! `stictiond import-tags LIST`: `[[loop]]` sections from the list of tags that a site has: a row for each tag, or a row for
//! each loop with a column for each role.

use super::{Failure, print};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use stictiond::collect::stub::{self, Tag, quoted};
use stictiond::config;
use stictiond::signal::Role;
use stictiond::table::{self, LoopColumns, Options, Source, TextRow};

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
/// Columns that say which tag it is.
const WHICH: [&str; 3] = ["tag", "loop", "role"];
/// What lists of sites call these columns.
const OTHER_WORDS: [(&str, &[&str]); 9] = [
    ("tag", &["tagname", "tag_name", "name", "point", "point_name"]),
    ("loop", &["loop_id", "loop_name"]),
    ("node", &["nodeid", "node_id", "opc_node", "opc_node_id"]),
    ("type", &["datatype", "data_type", "typ", "datentyp"]),
    ("byte_order", &["byteorder", "endianness"]),
    ("unit", &["units", "eu", "uom", "engineering_unit", "engineering_units", "einheit"]),
    ("device", &["plc", "server"]),
    ("register", &["register_type", "function"]),
    ("address", &["register_address", "modbus_address", "adresse"]),
];
/// Columns for readers: the configuration has no such keys.
const FOR_PEOPLE: [&str; 20] = [
    "description",
    "desc",
    "comment",
    "comments",
    "remark",
    "remarks",
    "note",
    "notes",
    "area",
    "plant",
    "service",
    "no",
    "no.",
    "nr",
    "#",
    "p&id",
    "beschreibung",
    "kommentar",
    "bemerkung",
    "bemerkungen",
];

/// Keys that say where a tag is, which is what a role's column of a list by loops may hold.
const PLACES: [&str; 5] = ["node", "path", "topic", "metric", "address"];

#[derive(clap::Args)]
pub struct Args {
    /// The list, as CSV or as a workbook: a row for each tag, with a column `tag` (FIC101.OP) or the columns `loop` and `role`,
    /// and a column for each key of a tag's section: node, topic, register, address, type, scale, …; or a row for each loop, with
    /// the columns `loop`, `op`, `pv` and the like that say where each is, keys for the whole row (`type`), and keys for one role
    /// (`pv.scale`)
    #[arg(value_name = "LIST")]
    list: PathBuf,
    /// What the columns `op`, `pv` and the like of a row for each loop hold; OPC UA node ids and numbers are known without it
    #[arg(long = "as", value_name = "KEY", value_parser = PLACES)]
    place: Option<String>,
    /// The device of tags whose row names none
    #[arg(long)]
    device: Option<String>,
    /// A column to ignore; may be repeated. Descriptions and remarks are ignored without it
    #[arg(long, value_name = "COLUMN")]
    without: Vec<String>,
    /// Sheet of a workbook
    #[arg(long, value_name = "NAME")]
    sheet: Option<String>,
    /// How text is encoded: utf-8, windows-1250, shift_jis, gb18030 [default: guessed]
    #[arg(long, value_name = "LABEL")]
    encoding: Option<String>,
}

/// Prints the sections; what was left out stands in comments.
pub fn run(args: &Args) -> Result<(), Failure> {
    super::table::readable_twice(&args.list)?;
    let refused = |why: String| Failure::in_file(&args.list, why);
    let options =
        Options { sheet: args.sheet.clone(), encoding: args.encoding.clone(), ..Options::default() };
    let rows = table::texts(Source::File(&args.list), &options, MAX_ROWS, is_header);
    let list = List::of(rows.map_err(|error| super::table::failure(&args.list, &error))?, &args.without);
    let list = list.map_err(refused)?;
    let tags = list.tags(args.device.as_deref(), args.place.as_deref()).map_err(refused)?;
    let stub = stub::loops(&tags);
    if stub.loops == 0 {
        let why = stub.left_out.first().cloned().unwrap_or_else(|| "there is no row below the header".into());
        return Err(refused(format!("no loop with an op and a pv: {why}")));
    }
    let passed = match list.passed_over.as_slice() {
        [] => String::new(),
        columns => format!("# columns ignored: {}\n", columns.join(", ").replace(char::is_control, " ")),
    };
    print(&format!(
        "# {} loops, {} left out\n{passed}{}\n{}",
        stub.loops,
        stub.left_out.len(),
        stub.remarks(),
        stub.text
    ))
}

/// The columns of each loop in a table that has those of several, by a list of tags: a row for each loop, whose columns `op`, `pv` and
/// the like name columns of the table, or a row for each of these, with `loop`, `role` and `tag`.
pub fn loop_columns(path: &Path) -> Result<Vec<LoopColumns>, Failure> {
    super::table::readable_twice(path)?;
    let rows = table::texts(Source::File(path), &Options::default(), MAX_ROWS, is_header);
    let rows = rows.map_err(|error| super::table::failure(path, &error))?;
    let loops = List::of(rows, &[]).and_then(|list| list.loop_columns());
    loops.map_err(|why| Failure::in_file(path, why))
}

/// A list of tags, its columns by the names of keys.
struct List {
    /// The name of each column; empty where it is passed over.
    header: Vec<String>,
    rows: Vec<TextRow>,
    /// Columns that say nothing of a tag.
    passed_over: Vec<String>,
    /// The columns of roles, by name and number, where each row is a loop; none where each row is a tag.
    roles: Vec<(String, usize)>,
}

impl List {
    /// Finds the header, and what its columns are.
    fn of(mut rows: Vec<TextRow>, without: &[String]) -> Result<Self, String> {
        let first = rows.iter().take(table::HEADER_WITHIN);
        let at = first.clone().position(|(_, cells)| is_header(cells)).unwrap_or(0);
        if rows.is_empty() {
            return Err("there is no row".into());
        }
        let (line, cells) = rows.remove(at);
        rows.drain(..at);
        let mut header: Vec<String> = cells.iter().map(|cell| key(cell)).collect();
        for wanted in without {
            if !header.contains(&key(wanted)) {
                return Err(format!("--without {wanted:?}: line {line} has no column of that name"));
            }
        }
        // A column is meant by its name as it stands there, and by what that means only where none is called so.
        let as_written = |wanted: &str| cells.iter().any(|cell| cell.eq_ignore_ascii_case(wanted.trim()));
        let is_passed = |name: &str, cell: &str| {
            FOR_PEOPLE.contains(&name)
                || without.iter().any(|own| match as_written(own) {
                    true => cell.eq_ignore_ascii_case(own.trim()),
                    false => key(own) == name,
                })
        };
        let mut passed_over = Vec::new();
        for (name, cell) in header.iter_mut().zip(&cells).filter(|(name, cell)| is_passed(name, cell)) {
            name.clear();
            passed_over.push(cell.clone());
        }
        for (at, name) in header.iter().enumerate().filter(|(_, name)| !name.is_empty()) {
            if let Some(first) = header[..at].iter().position(|other| other == name) {
                let (first, second) = (&cells[first], &cells[at]);
                return Err(format!(
                    "line {line}: columns '{first}' and '{second}' are both '{name}': say --without for one of them"
                ));
            }
        }
        let roles = roles(&header).map_err(|why| format!("line {line}: {why}"))?;
        Ok(Self { header, rows, passed_over, roles })
    }

    /// The tags of all rows.
    fn tags(&self, device: Option<&str>, place: Option<&str>) -> Result<Vec<Tag>, String> {
        let at = |name: &str| self.header.iter().position(|own| own == name);
        let place = match self.roles.is_empty() {
            true => None,
            false => Some(place_of(&self.roles, &self.rows, place)?),
        };
        let mut tags = Vec::new();
        for (line, row) in &self.rows {
            let cell = |name: &str| {
                at(name).and_then(|at| row.get(at)).map(String::as_str).filter(|c| !c.is_empty())
            };
            let wrong = |why: String| format!("line {line}: {why}");
            let Some(place) = place else {
                tags.push(tag(&cell, device).map_err(wrong)?);
                continue;
            };
            cell("loop").ok_or_else(|| wrong("it names no loop".into()))?;
            for (role, _) in self.roles.iter().filter(|(role, _)| cell(role).is_some()) {
                let own = |name: &str| match name {
                    "role" => Some(role.as_str()),
                    name if name == place => cell(role),
                    name => {
                        cell(&format!("{role}.{name}")).or_else(|| cell(name).filter(|_| of_row(name, role)))
                    }
                };
                tags.push(tag(&own, device).map_err(|why| wrong(format!("{role}: {why}")))?);
            }
        }
        Ok(tags)
    }
}

impl List {
    /// The columns of each loop, where the list is one of the columns of a table.
    fn loop_columns(&self) -> Result<Vec<LoopColumns>, String> {
        let at = |name: &str| self.header.iter().position(|own| own == name);
        let mut all: Vec<LoopColumns> = Vec::new();
        let mut places: HashMap<&str, usize> = HashMap::new();
        for (line, row) in &self.rows {
            let filled = |at: usize| row.get(at).map(String::as_str).filter(|cell| !cell.is_empty());
            let cell = |name: &str| at(name).and_then(filled);
            let needed = |name: &str| {
                cell(name).ok_or_else(|| format!("line {line}: it has nothing in column '{name}'"))
            };
            let own = needed("loop")?;
            let named = |(role, at): &(String, usize)| Some((role.clone(), filled(*at)?));
            let mut columns: Vec<(String, &str)> = self.roles.iter().filter_map(named).collect();
            if self.roles.is_empty() {
                columns.push((needed("role")?.to_string(), needed("tag")?));
            }
            let place = *places.entry(own).or_insert_with(|| {
                all.push(LoopColumns { name: own.to_string(), columns: Vec::new() });
                all.len() - 1
            });
            for (word, column) in columns {
                let role = stub::role(&word)
                    .ok_or_else(|| format!("line {line}: '{word}' is none of op, pv, sp, mode, mv"))?;
                let Some(known) = all.get_mut(place) else { continue };
                if known.columns.iter().any(|(other, _)| *other == role) {
                    return Err(format!("line {line}: {own} has two columns for {}", role.as_str()));
                }
                known.columns.push((role, column.to_string()));
            }
        }
        match all.is_empty() {
            true => Err("there is no row below the header".into()),
            false => Ok(all),
        }
    }
}

/// Whether a key of a loop's row is meant for one of its tags: its unit is that of what is controlled, and a mode has no scale.
fn of_row(key: &str, role: &str) -> bool {
    match key {
        "unit" => matches!(stub::role(role), Some(Role::Pv | Role::Sp)),
        "scale" | "offset" => stub::role(role) != Some(Role::Mode),
        _ => true,
    }
}

/// Whether a row names the tags or loops, and something else that is known.
fn is_header(cells: &[String]) -> bool {
    let names: Vec<String> = cells.iter().map(|cell| key(cell)).collect();
    let known = |name: &&String| {
        let name = name.as_str();
        WHICH.contains(&name)
            || TEXTS.contains(&name)
            || NUMBERS.contains(&name)
            || stub::role(name).is_some()
    };
    names.iter().any(|name| name == "tag" || name == "loop") && names.iter().filter(known).count() > 1
}

/// A column's name as a key is written: `Data Type` is `type`.
fn key(name: &str) -> String {
    let name = name.trim().to_lowercase().replace([' ', '-'], "_");
    let own = OTHER_WORDS.iter().find(|(_, others)| others.contains(&name.as_str()));
    own.map_or(name, |(own, _)| (*own).to_string())
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
        name.is_empty() || WHICH.contains(&name) || is_key(name) || is_role(name) || of_role
    };
    if let Some(strange) = header.iter().find(|name| !known(name)) {
        let names = [&WHICH[..], &TEXTS, &NUMBERS].concat().join(", ");
        return Err(format!(
            "no key of a tag is called '{strange}': ignore the column with --without '{strange}', or call it one of {names}"
        ));
    }
    let named = header.iter().enumerate().filter(|(_, name)| is_role(name));
    let roles: Vec<(String, usize)> = named.map(|(at, name)| (name.clone(), at)).collect();
    if !has("tag") && !(has("loop") && (has("role") || !roles.is_empty())) {
        return Err(
            "a column 'tag' is needed, or the columns 'loop' and 'role', or 'loop', 'op' and 'pv'".into()
        );
    }
    Ok(roles)
}

/// Which key the columns of roles hold: as was said, or as every cell of them looks.
fn place_of<'p>(
    roles: &[(String, usize)],
    rows: &[TextRow],
    said: Option<&'p str>,
) -> Result<&'p str, String> {
    if let Some(said) = said {
        return Ok(said);
    }
    let cells = || {
        let all = rows
            .iter()
            .flat_map(|row| roles.iter().filter_map(move |(_, at)| Some((row.0, row.1.get(*at)?))));
        all.filter(|(_, cell)| !cell.is_empty())
    };
    let is_node = |cell: &String| {
        let id = cell
            .split_once(';')
            .filter(|(space, _)| space.starts_with("ns"))
            .map_or(cell.as_str(), |(_, id)| id);
        ["i=", "s=", "g=", "b="].iter().any(|kind| id.starts_with(kind))
    };
    let is_address = |cell: &String| cell.parse::<u32>().is_ok();
    if cells().all(|(_, cell)| is_node(cell)) {
        return Ok("node");
    }
    if cells().all(|(_, cell)| is_address(cell)) {
        return Ok("address");
    }
    let strange = cells().find(|(_, cell)| !is_node(cell));
    let strange = strange.map_or_else(String::new, |(line, cell)| format!("line {line}: what is '{cell}'? "));
    Err(format!("{strange}Say it with --as {}", PLACES.join(", --as ")))
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
    // Lists of servers and brokers have columns of types, which say nothing of a tag that is no register.
    let elsewhere = ["node", "path", "topic", "metric"].iter().any(|key| cell(key).is_some());
    let is_told = |key: &&str| !(elsewhere && config::MODBUS_KEYS.contains(key));
    for key in TEXTS.into_iter().filter(|key| *key != "device").filter(is_told) {
        let own = |value: &str| config::type_meant(value).filter(|_| key == "type").map(str::to_string);
        keys.extend(cell(key).map(|value| (key.to_string(), quoted(&own(value).unwrap_or(value.into())))));
    }
    for key in NUMBERS.into_iter().filter(is_told) {
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

    fn tags(text: &str, device: Option<&str>, place: Option<&str>) -> Result<Vec<Tag>, String> {
        let rows = table::texts(Source::Bytes(text.as_bytes()), &Options::default(), MAX_ROWS, is_header);
        List::of(rows.map_err(|error| error.to_string())?, &[])?.tags(device, place)
    }

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
            ("tag,device,name\nA.OP,d,x\n", "columns 'tag' and 'name' are both 'tag'"),
            ("tag,device,dcs block\nA.OP,d,x\n", "with --without 'dcs_block'"),
        ] {
            let why = tags(text, None, None).unwrap_err();
            assert!(why.contains(part), "{text}: {why}");
        }
    }

    #[test]
    fn a_list_names_the_columns_of_loops() {
        let columns = |text: &str| {
            let rows = table::texts(Source::Bytes(text.as_bytes()), &Options::default(), MAX_ROWS, is_header);
            List::of(rows.map_err(|error| error.to_string())?, &[])?.loop_columns()
        };
        let by_loops =
            columns("Loop;OP;PV;SP;Description\nA;XMV1;XMEAS2;;feed\nB;XMV2;XMEAS3;s;\n").expect("loops");
        let by_tags = "loop,role,tag\nA,op,XMV1\nA,pv,XMEAS2\nB,op,XMV2\nB,pv,XMEAS3\nB,sp,s\n";
        assert_eq!(columns(by_tags).as_ref(), Ok(&by_loops));
        let told: Vec<(&str, usize)> =
            by_loops.iter().map(|own| (own.name.as_str(), own.columns.len())).collect();
        assert_eq!(told, [("A", 2), ("B", 3)]);
        assert_eq!(by_loops[1].columns[2], (Role::Sp, "s".to_string()));
        for (text, part) in [
            ("loop,op,pv\nA,x,y\n,x,y\n", "line 3: it has nothing in column 'loop'"),
            ("loop,op,pv\nA,x,y\nA,x,y\n", "line 3: A has two columns for op"),
            ("loop,role,tag\nA,opp,x\n", "line 2: 'opp' is none of op"),
            ("loop,op,pv\n", "there is no row below the header"),
        ] {
            let why = columns(text).unwrap_err();
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

    #[test]
    fn a_list_of_a_site_needs_no_other_words() {
        let list = "Instrument list\nName;Plant 10\nNo.;Tag Name;Description;Address;Data Type;PLC\n\
                    1;FIC101.OP;feed;1;f32;dcs\n\n2;FIC101.PV;\"feed; flow\";3;REAL;dcs\n";
        let found = tags(list, None, None).unwrap();
        assert_eq!(found.iter().map(|tag| tag.name.as_str()).collect::<Vec<_>>(), ["FIC101.OP", "FIC101.PV"]);
        let keys =
            |tag: &Tag| tag.keys.iter().map(|(key, value)| format!("{key}={value}")).collect::<Vec<_>>();
        assert_eq!(keys(&found[1]), ["device=\"dcs\"", "type=\"f32\"", "address=3"]);
        let german = "Tag;Beschreibung;Register;Adresse;Typ\nFIC101.OP;Ventil;holding;101;f32\n";
        let german = tags(german, Some("dcs"), None).unwrap();
        let expected = ["device=\"dcs\"", "register=\"holding\"", "type=\"f32\"", "address=101"];
        assert_eq!(keys(&german[0]), expected);
        // What a server's own list says of types is nothing for the configuration.
        let nodes = "Tag Name,NodeId,Data Type\nFIC101.OP,i=7,Float\n";
        assert_eq!(keys(&tags(nodes, Some("opc"), None).unwrap()[0]), ["device=\"opc\"", "node=\"i=7\""]);
        let rows =
            table::texts(Source::Bytes(list.as_bytes()), &Options::default(), MAX_ROWS, is_header).unwrap();
        assert_eq!(List::of(rows.clone(), &[]).unwrap().passed_over, ["No.", "Description"]);
        let without = |name: &str| List::of(rows.clone(), &[name.to_string()]);
        assert_eq!(without("Data Type").unwrap().passed_over, ["No.", "Description", "Data Type"]);
        let both = "tag,device,name\nA.OP,d,x\n";
        let both =
            table::texts(Source::Bytes(both.as_bytes()), &Options::default(), MAX_ROWS, is_header).unwrap();
        assert_eq!(List::of(both, &["name".to_string()]).unwrap().header, ["tag", "device", ""]);
        assert!(without("Area").is_err_and(|why| why.contains("--without \"Area\"")));
    }
}
