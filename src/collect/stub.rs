//! `[[loop]]` sections for tags that were found on a device or in a list, ready to paste. Pure.
//!
//! Which tag is what is told by its name, as the columns of a table are: `FIC101.OP`, `Unit10/FIC101/PV`.

use crate::signal::Role;
use crate::table::names::{Meaning, Name};
use std::collections::{BTreeMap, HashMap};
use std::fmt::Write;

/// Loops without OP or PV that are named at the end.
const NAMED: usize = 20;

/// A tag that was found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tag {
    /// Its name or path, by which its loop and role are known.
    pub name: String,
    /// The loop, where something says it better than the name.
    pub of_loop: Option<String>,
    /// The role, where something says it better than the name.
    pub role: Option<Role>,
    /// The keys that say where it is, with their values as TOML writes them.
    pub keys: Vec<(String, String)>,
    /// What was seen of it, for people.
    pub note: Option<String>,
}

/// What became of the tags.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stub {
    /// The sections, or an empty text.
    pub text: String,
    /// Loops in it.
    pub loops: usize,
    /// Tags that are of no loop in it, each with why.
    pub left_out: Vec<String>,
}

/// A text as TOML writes it.
pub fn quoted(text: &str) -> String {
    toml::Value::String(text.into()).to_string()
}

/// A role by the word of the configuration or of the field; `None` for any other.
pub fn role(word: &str) -> Option<Role> {
    match Name::new(word).said()?.meaning {
        Meaning::Role(role) => Some(role),
        Meaning::Time => None,
    }
}

/// The sections of the loops that have OP and PV among the tags.
pub fn loops(tags: &[Tag]) -> Stub {
    let mut stub = Stub::default();
    let mut groups: BTreeMap<String, Group> = BTreeMap::new();
    for tag in tags {
        let Some((key, path, role)) = place(tag) else {
            stub.left_out.push(format!("{}: its name tells no role such as .OP or .PV", tag.name));
            continue;
        };
        let group = groups.entry(key).or_insert_with(|| Group { path, tags: BTreeMap::new() });
        if let Some(first) = group.tags.get(role.as_str()) {
            let why = format!("{}: {} is the {} of that loop already", tag.name, first.name, role.as_str());
            stub.left_out.push(why);
        } else {
            group.tags.insert(role.as_str(), tag);
        }
    }
    let ids = ids(groups.values());
    let (mut told, mut incomplete) = (0, Vec::new());
    for (group, id) in groups.values().zip(ids) {
        match ["op", "pv"].into_iter().find(|needed| !group.tags.contains_key(needed)) {
            None => {
                group.write(&id, &mut stub.text);
                told += 1;
            }
            Some(missing) => incomplete.push(format!("{id}: no {missing} was found for it")),
        }
    }
    stub.loops = told;
    stub.left_out.extend(incomplete);
    stub
}

impl Stub {
    /// The first of those that were left out, as lines of a comment.
    pub fn remarks(&self) -> String {
        let mut out = String::new();
        for why in self.left_out.iter().take(NAMED) {
            let _ = writeln!(out, "# left out: {}", why.replace(char::is_control, " "));
        }
        if self.left_out.len() > NAMED {
            let _ = writeln!(out, "# left out: {} more", self.left_out.len() - NAMED);
        }
        out
    }
}

/// The tags of a loop by role.
struct Group<'t> {
    /// The loop's path, as it was written.
    path: Vec<String>,
    tags: BTreeMap<&'static str, &'t Tag>,
}

impl Group<'_> {
    fn write(&self, id: &str, out: &mut String) {
        let _ = writeln!(out, "[[loop]]\nid = {}", quoted(id));
        for role in ["op", "pv", "sp", "mode", "mv"] {
            let Some(tag) = self.tags.get(role) else { continue };
            let _ = writeln!(out, "[loop.{role}]");
            if let Some(note) = &tag.note {
                let _ = writeln!(out, "# {}", note.replace(char::is_control, " "));
            }
            for (key, value) in &tag.keys {
                let _ = writeln!(out, "{key} = {value}");
            }
        }
        out.push('\n');
    }
}

/// The key of a tag's loop, the loop's path as it is written, and the tag's role.
fn place(tag: &Tag) -> Option<(String, Vec<String>, Role)> {
    let said = Name::new(&tag.name).said();
    let by_name = said.as_ref().and_then(|said| match said.meaning {
        Meaning::Role(role) => Some(role),
        Meaning::Time => None,
    });
    let role = tag.role.or(by_name)?;
    if let Some(of_loop) = &tag.of_loop {
        return Some((of_loop.to_lowercase(), vec![of_loop.clone()], role));
    }
    // `OP_B` has its loop behind it.
    let own = Name::new(&tag.name).owner_as_written()?;
    let path: Vec<String> =
        own.split(['/', '.', '\\', '|', ':', ';', '=', '!']).map(str::trim).map(str::to_string).collect();
    let path: Vec<String> = path.into_iter().filter(|part| !part.is_empty()).collect();
    (!path.is_empty()).then(|| (path.join("/").to_lowercase(), path, role))
}

/// A name for each loop: the last part of its path, with as much before it as makes it different.
fn ids<'g>(groups: impl Iterator<Item = &'g Group<'g>>) -> Vec<String> {
    let paths: Vec<&[String]> = groups.map(|group| group.path.as_slice()).collect();
    let end = |path: &[String], parts: usize| path[path.len().saturating_sub(parts)..].join(".");
    let longest = paths.iter().map(|path| path.len()).max().unwrap_or(0);
    let mut parts = vec![1; paths.len()];
    for _ in 1..longest {
        let mut used: HashMap<String, usize> = HashMap::new();
        for (path, parts) in paths.iter().zip(&parts) {
            *used.entry(end(path, *parts)).or_default() += 1;
        }
        for (path, parts) in paths.iter().zip(&mut parts) {
            *parts += usize::from(used[&end(path, *parts)] > 1);
        }
    }
    let plain = |id: String| id.replace(|c: char| c.is_control() || "/\\?#%\"".contains(c), "-");
    paths.iter().zip(&parts).map(|(path, parts)| plain(end(path, *parts))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tag(name: &str) -> Tag {
        Tag { name: name.into(), keys: vec![("node".into(), quoted(name))], ..Tag::default() }
    }

    fn of(names: &[&str]) -> Stub {
        loops(&names.iter().map(|name| tag(name)).collect::<Vec<_>>())
    }

    #[test]
    fn loops_are_told_by_the_names_of_their_tags() {
        let stub = of(&[
            "Plant/FIC-101/OP",
            "Plant/FIC-101/PV",
            "Plant/FIC-101/SP",
            "Plant/TI7/PV",
            "Plant/Running",
        ]);
        assert_eq!(stub.loops, 1);
        assert_eq!(
            stub.text,
            "[[loop]]\nid = \"FIC-101\"\n[loop.op]\nnode = \"Plant/FIC-101/OP\"\n[loop.pv]\nnode = \"Plant/FIC-101/PV\"\n\
             [loop.sp]\nnode = \"Plant/FIC-101/SP\"\n\n"
        );
        assert_eq!(stub.left_out.len(), 2, "{:?}", stub.left_out);
        assert!(stub.remarks().contains("TI7: no op") && stub.remarks().contains("Plant/Running"));
    }

    #[test]
    fn loops_of_one_name_in_two_units_have_two_ids() {
        let stub = of(&["U1/FIC1/OP", "U1/FIC1/PV", "U2/FIC1/OP", "U2/FIC1/PV", "U2/FIC2_OP", "U2/FIC2_PV"]);
        let ids: Vec<&str> = stub.text.lines().filter(|line| line.starts_with("id")).collect();
        assert_eq!(ids, ["id = \"U1.FIC1\"", "id = \"U2.FIC1\"", "id = \"FIC2\""]);
    }

    #[test]
    fn a_letter_or_a_number_behind_a_name_is_its_loop() {
        let stub = of(&["OP_B", "PV_B", "OP_C", "PV_C", "OP_1", "PV_1"]);
        let ids: Vec<&str> = stub.text.lines().filter(|line| line.starts_with("id")).collect();
        assert_eq!(ids, ["id = \"1\"", "id = \"B\"", "id = \"C\""]);
    }

    #[test]
    fn what_a_list_says_outweighs_the_name_and_a_second_of_a_kind_is_left_out() {
        let said = |name: &str, role| Tag { of_loop: Some("FIC9".into()), role: Some(role), ..tag(name) };
        let stub = loops(&[said("a.PV", Role::Op), said("b", Role::Pv), said("c", Role::Pv)]);
        assert_eq!((stub.loops, stub.left_out.len()), (1, 1), "{stub:?}");
        assert!(
            stub.text.contains("[loop.op]\nnode = \"a.PV\"")
                && stub.left_out[0].starts_with("c: b is the pv")
        );
    }
}
