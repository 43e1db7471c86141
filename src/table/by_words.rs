//! The controller's mode under a name that nobody lists: it is known by its words.

use super::channel::Channel;
use super::error::{TableError, listed, shown};
use super::names::{Name, controller};
use super::words::Words;
use crate::signal::Role;

/// Makes that one of these channels the mode which is nothing else, speaks of a mode, and belongs to the loop of OP by its name,
/// unless there is a mode already. `rows` are those of a table with a column for each tag, of which a mode has most.
///
/// # Errors
/// Several such channels.
pub fn find_mode(channels: &mut [Channel], of_loop: &[usize], rows: Option<u64>) -> Result<(), TableError> {
    let has = |role: Role| of_loop.iter().map(|at| &channels[*at]).find(|own| own.role == Some(role));
    let (Some(op), None) = (has(Role::Op), has(Role::Mode)) else { return Ok(()) };
    let loop_name = Name::new(&op.tag.name).said().map(|said| said.owner).unwrap_or_default();
    let owner = op.tag.owner.clone();
    let speaks = |own: &Channel| {
        let name = Name::new(&own.tag.name);
        own.role.is_none()
            && own.numbers == 0
            && rows.is_none_or(|rows| own.cells * 2 > rows)
            && own.tag.owner == owner
            && !name.is_none()
            && is_of_loop(&name, &loop_name)
            && own.texts.speak_of_mode()
    };
    let places: Vec<usize> = of_loop.iter().copied().filter(|at| speaks(&channels[*at])).collect();
    let found: Vec<&Channel> = places.iter().map(|at| &channels[*at]).collect();
    // Several that are always automatic leave nothing to decide.
    if found.len() > 1 && !found.iter().any(|own| own.texts.say_manual()) {
        return Ok(());
    }
    if let [first, second, ..] = found.as_slice() {
        return Err(TableError::refused(format!(
            "{} each hold words of a mode, the first {} and the second {}: say which is the controller's with --mode, or --mode none",
            listed(found.iter().map(|own| own.tag.name.as_str())),
            first.texts.listed(),
            second.texts.listed()
        )));
    }
    if let Some(at) = places.first() {
        let own = &mut channels[*at];
        own.role = Some(Role::Mode);
        own.words = Some(std::mem::take(&mut own.texts));
    }
    Ok(())
}

/// What is asked of a column that is called a quality and holds the words of a mode, such as `Status`; `None` where it holds others.
pub fn under_quality(words: &Words, name: &str) -> Option<TableError> {
    let name = shown(name);
    words.speak_of_mode().then(|| {
        TableError::refused(format!(
            "column {name}: it holds {}, as the controller's mode does; say so with --mode {name:?}, or which of them are good values \
             with --good-values",
            words.listed()
        ))
    })
}

/// Whether a name may belong to a loop: it has no number and no path of its own, or the tag of the loop. `A/M` is no path.
pub fn is_of_loop(name: &Name, loop_name: &str) -> bool {
    let plain = name.plain();
    let tag = controller(loop_name);
    let begins =
        !loop_name.is_empty() && plain.strip_prefix(loop_name).is_some_and(|rest| rest.starts_with(' '));
    let of_a_path = !loop_name.is_empty() && name.full.contains(['.', '\\', ':', '!']);
    !of_a_path && !plain.bytes().any(|byte| byte.is_ascii_digit())
        || tag.is_some() && controller(plain) == tag
        || begins
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_without_a_number_or_with_the_tag_of_the_loop_belongs_to_it() {
        for (name, loop_name, is) in [
            ("Zustand", "fic101", true),
            ("FIC101.Betrieb", "fic101", true),
            ("FIC-101 state", "fic 101", true),
            ("FIC102.Betrieb", "fic101", false),
            ("P101 selector", "fic101", false),
            ("Agitator.Selector", "fic101", false),
            ("Loop 1 state", "loop 1", true),
            ("Pump 7", "", false),
        ] {
            assert_eq!(is_of_loop(&Name::new(name), loop_name), is, "{name} of {loop_name}");
        }
    }
}
