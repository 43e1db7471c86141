//! Which loop each tag belongs to and what it is to it, where a store takes every tag of a table.
//!
//! A table with a column for each tag is that of one loop: its roles are decided, and the other columns are its tags. Where each
//! row is a sample of one tag there may be many loops: each is decided by itself, as if its tags were the whole table.

use super::by_words;
use super::channel::Channel;
use super::error::{TableError, listed};
use super::layout::Long;
use super::names::{Meaning, Name, controller};
use super::options::Options;
use super::roles::{ROLES, Trouble, as_far_as_there, owns, roles, told};
use super::words::Words;
use crate::signal::Role;
use std::collections::{BTreeSet, HashMap};

/// Which tags of a long table are those of the loop that is read; the others belong to other loops. `columns` are the names of all
/// columns.
///
/// # Errors
/// Several loops of which nobody says which is wanted, none of its tags, and what [`roles`] says of them.
pub fn of_wanted(
    channels: &mut [Channel],
    options: &Options,
    columns: &[Name],
    long: &Long,
) -> Result<(), TableError> {
    let owners: BTreeSet<&str> = channels.iter().map(|channel| channel.tag.owner.as_str()).collect();
    let wanted = options.of_loop.as_deref();
    // A plant or a server that all rows have says nothing of the loop.
    let says_loop = long.owner.is_some_and(|at| columns[at].plain().starts_with("loop"));
    let of_all = owners.len() == 1 && !says_loop && wanted.is_some_and(|own| !owners.contains(own));
    let owned = !of_all && owners.iter().any(|own| !own.is_empty());
    if owned && wanted.is_none() && owners.len() > 1 {
        return Err(TableError::refused(format!("several loops, {}: say which with --loop", listed(owners))));
    }
    let of_loop = |channel: &Channel| !owned || wanted.is_none_or(|own| own == channel.tag.owner);
    let names: Vec<Name> = channels
        .iter()
        .map(|channel| if of_loop(channel) { Name::new(&channel.tag.name) } else { Name::new("") })
        .collect();
    if names.iter().all(Name::is_none) {
        return Err(TableError::refused(format!("no samples of loop {:?}", wanted.unwrap_or_default())));
    }
    let without_loop = Options { of_loop: None, ..options.clone() };
    let options = if owned { &without_loop } else { options };
    let found = roles(&names, options, false).map_err(|trouble| match trouble {
        Trouble::Refused(error) => error,
        Trouble::Missing(missing) => {
            let tags = listed(names.iter().filter(|name| !name.is_none()).map(|name| name.full.as_str()));
            let options: Vec<String> = missing.iter().map(|role| format!("--{role}")).collect();
            TableError::refused(format!(
                "no tag for {}; the table has {tags}; name it with {}, or another column of tags with --tag",
                missing.join(", "),
                options.join(" and ")
            ))
        }
    })?;
    for ((channel, role), name) in channels.iter_mut().zip(found).zip(&names) {
        channel.role = role;
        // Words that are not the mode are nothing that is measured.
        let is_word = |words: &Words| words.numbers().is_none();
        if role.is_none() && options.mode.is_some() && channel.words.as_ref().is_some_and(is_word) {
            channel.words = None;
        }
        if name.is_none() {
            channel.tag.name.clear();
        }
    }
    Ok(())
}

/// By what tags belong together.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Key {
    /// The loop that `--loop` names.
    Wanted,
    /// The loop that a column names.
    Column(String),
    /// The loop in the name of the tag, in small letters.
    Name(String),
}

/// The tags of one loop.
struct Group {
    control_loop: String,
    /// What [`Options::of_loop`] is for them.
    of_loop: Option<String>,
    members: Vec<usize>,
}

/// Gives every channel of a wide table its loop: that of OP, or of PV, or of what there is.
pub fn of_one(channels: &mut [Channel], options: &Options) {
    let by_name = |role: Role| {
        let own = channels.iter().find(|own| own.role == Some(role))?;
        Name::new(&own.tag.name).owner_as_written()
    };
    let own = options.of_loop.clone().or_else(|| by_name(Role::Op)).or_else(|| by_name(Role::Pv));
    let is_part = !channels.iter().any(|own| matches!(own.role, Some(Role::Op | Role::Pv)));
    let own = own.or_else(|| ROLES.into_iter().filter(|_| is_part).find_map(by_name));
    channels.iter_mut().for_each(|channel| channel.control_loop.clone_from(&own));
}

/// Gives every tag of a long table its loop, as far as it is known, and its role.
///
/// # Errors
/// A loop with two tags for one role, a tag that an option names and that is not there, and no tag of the loop that is wanted.
pub fn of_many(channels: &mut [Channel], options: &Options) -> Result<(), TableError> {
    let names: Vec<Name> = channels.iter().map(|channel| Name::new(&channel.tag.name)).collect();
    for role in ROLES {
        let wanted = options.column(role.as_str()).filter(|own| !is_none(role, own));
        if let Some(wanted) = wanted.filter(|own| !names.iter().any(|name| name.is(own))) {
            told(&names, wanted, role.as_str(), false)?;
        }
    }
    let groups = grouped(channels, &names, options)?;
    let is_told =
        |name: &Name| ROLES.iter().any(|role| options.column(role.as_str()).is_some_and(|own| name.is(own)));
    let of_no_loop = |(channel, name): &(&Channel, &Name)| channel.control_loop.is_none() && is_told(name);
    if let Some((channel, _)) = channels.iter().zip(&names).find(of_no_loop) {
        return Err(TableError::refused(format!(
            "{:?} names no loop; say which with --loop",
            channel.tag.name
        )));
    }
    for group in &groups {
        roles_of(group, channels, &names, options)?;
        if options.mode.is_none() {
            by_words::find_mode(channels, &group.members, None)?;
        }
    }
    Ok(())
}

/// Whether an option says that nothing has this role.
fn is_none(role: Role, told: &str) -> bool {
    role == Role::Mode && told.eq_ignore_ascii_case("none")
}

/// The loops in names that no letter stands behind.
fn named_owners(names: &[Name]) -> BTreeSet<String> {
    let without_letter = names.iter().filter(|name| name.lettered().is_none());
    let owners = without_letter.filter_map(|name| Some(name.said()?.owner));
    owners.filter(|owner| !owner.is_empty()).collect()
}

/// The tags of each loop.
fn grouped(channels: &mut [Channel], names: &[Name], options: &Options) -> Result<Vec<Group>, TableError> {
    let wanted = options.of_loop.as_ref().map(|own| (own, Name::new(own).plain().to_string()));
    let is_told =
        |name: &Name| ROLES.iter().any(|role| options.column(role.as_str()).is_some_and(|own| name.is(own)));
    let mut groups: Vec<Group> = Vec::new();
    let mut places: HashMap<Key, usize> = HashMap::new();
    let mut nameless = Vec::new();
    let mut others = Vec::new();
    let owners = named_owners(names);
    // Whether any tag may be one of the loop that is wanted, and not only beside it.
    let mut any_wanted = wanted.is_none();
    for (at, (channel, name)) in channels.iter().zip(names).enumerate() {
        if name.is_none() {
            continue;
        }
        // `TIC101.PV C` is of TIC101 where other tags are.
        let before = name.lettered().map(|(before, _)| before);
        let before = before.filter(|own| own.said().is_some_and(|said| owners.contains(&said.owner)));
        let own = before.as_ref().unwrap_or(name);
        let said = own.said();
        let meaning = said.as_ref().map(|said| said.meaning);
        let owner = said.map(|said| said.owner);
        let written = own.owner_as_written();
        // `OP [FIC101]` has its loop in brackets.
        let owner = owner.map(|own| match &written {
            Some(written) if own.is_empty() => Name::new(written).plain().to_string(),
            _ => own,
        });
        let (key, control_loop) = match (&wanted, owner.filter(|own| !own.is_empty())) {
            _ if !channel.tag.owner.is_empty() => {
                let own = channel.tag.owner.clone();
                (Key::Column(own.clone()), own)
            }
            (Some((own, plain)), owner) => {
                let of_another = |other: &String| !is_told(name) && !owns(plain, other);
                match owner.filter(of_another) {
                    // The tag of another controller is that of its own loop, and any other one explains the loop that is wanted.
                    Some(other) if controller(&other).is_some() => {
                        others.push(name.full.as_str());
                        (Key::Name(other), written.unwrap_or_default())
                    }
                    other => {
                        // A measurement beside the loop may be all that there is.
                        if other.is_none() {
                            any_wanted |= meaning.is_some() || is_told(name);
                        } else if meaning != Some(Meaning::Role(Role::Pv)) {
                            others.push(name.full.as_str());
                        }
                        (Key::Wanted, (*own).clone())
                    }
                }
            }
            (None, Some(owner)) => (Key::Name(owner), written.unwrap_or_default()),
            (None, None) => {
                nameless.push(at);
                continue;
            }
        };
        any_wanted |= matches!(key, Key::Column(_));
        let of_loop = match &key {
            Key::Name(_) => None,
            _ => Some(control_loop.clone()),
        };
        let place = *places.entry(key).or_insert_with(|| {
            groups.push(Group { control_loop, of_loop, members: Vec::new() });
            groups.len() - 1
        });
        groups[place].members.push(at);
    }
    if let Some((own, _)) = wanted.filter(|_| !any_wanted && !others.is_empty()) {
        return Err(TableError::refused(format!(
            "--loop {own:?}: no tag is of this loop; there are {}; if they are its own, name them with --op and --pv",
            listed(others)
        )));
    }
    // `FIC101.ALRM` says nothing that is known, and has the loop of `FIC101.PV`.
    for at in nameless {
        let plain = names[at].plain();
        let mut ends = plain.match_indices(' ').map(|(end, _)| end).rev();
        if let Some(place) = ends.find_map(|end| places.get(&Key::Name(plain[..end].to_string()))) {
            groups[*place].members.push(at);
        }
    }
    for group in &mut groups {
        group.members.sort_unstable();
        for at in &group.members {
            channels[*at].control_loop = Some(group.control_loop.clone());
        }
    }
    Ok(groups)
}

/// Gives the tags of one loop their roles.
fn roles_of(
    group: &Group,
    channels: &mut [Channel],
    names: &[Name],
    options: &Options,
) -> Result<(), TableError> {
    // One tag may have had several sources and units.
    let mut places: HashMap<&str, usize> = HashMap::new();
    let mut own: Vec<Name> = Vec::new();
    for at in &group.members {
        places.entry(names[*at].full.as_str()).or_insert_with(|| {
            own.push(names[*at].clone());
            own.len() - 1
        });
    }
    let here = |told: &Option<String>| told.clone().filter(|told| own.iter().any(|name| name.is(told)));
    let mut options = Options {
        op: here(&options.op),
        pv: here(&options.pv),
        sp: here(&options.sp),
        mv: here(&options.mv),
        mode: here(&options.mode).or_else(|| options.mode.clone().filter(|told| is_none(Role::Mode, told))),
        of_loop: group.of_loop.clone(),
        ..Options::default()
    };
    // Where a column names the loops, `mv` is as a store calls a position.
    let of_column = group.members.first().is_some_and(|at| !channels[*at].tag.owner.is_empty());
    let ours = Role::Mv.as_str();
    if of_column && options.op.is_none() && own.iter().any(|name| name.full == ours) {
        options.mv.get_or_insert_with(|| ours.to_string());
    }
    let found = as_far_as_there(&own, &options, false).map_err(|trouble| match trouble {
        Trouble::Refused(TableError::Refused(said)) => {
            TableError::refused(format!("loop {:?}: {said}", group.control_loop))
        }
        Trouble::Refused(error) => error,
        Trouble::Missing(missing) => TableError::refused(format!("no tag for {}", missing.join(", "))),
    });
    let (mut found, missing) = found?;
    // Without a PV beside it, an MV may be the position of a valve.
    if options.op.is_none() && missing.contains(&Role::Pv.as_str()) {
        let is_mv = |name: &Name| name.said().is_some_and(|said| said.meaning == Meaning::Role(Role::Mv));
        for (role, _) in
            found.iter_mut().zip(&own).filter(|(role, name)| **role == Some(Role::Op) && is_mv(name))
        {
            *role = Some(Role::Mv);
        }
    }
    for at in &group.members {
        let place = places.get(names[*at].full.as_str());
        channels[*at].role = place.and_then(|place| found.get(*place).copied().flatten());
    }
    Ok(())
}
