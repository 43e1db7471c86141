//! Which of many names are OP, PV and the others of one loop.

use super::error::{TableError, listed, shown};
use super::names::{Meaning, Name, controller};
use super::options::Options;
use crate::signal::Role;
use std::collections::BTreeSet;

/// The roles, those that a record needs first.
pub const ROLES: [Role; 5] = [Role::Op, Role::Pv, Role::Sp, Role::Mode, Role::Mv];

/// The role of each name.
pub type Roles = Vec<Option<Role>>;

/// Why the names are not those of one loop.
pub enum Trouble {
    /// These are not there.
    Missing(Vec<&'static str>),
    /// There is a doubt.
    Refused(TableError),
}

/// A name and what it says of itself.
struct Candidate {
    at: usize,
    role: Role,
    owner: String,
    /// The owner without the letter behind the name: `fic101` of `FIC101.OP_B`; `None` without a letter.
    base: Option<String>,
}

impl Candidate {
    /// Its loop, and the one that it is of where the letter behind its name is none of it.
    fn owners(&self) -> impl Iterator<Item = &str> {
        [Some(self.owner.as_str()), self.named_base()].into_iter().flatten()
    }

    /// What stands before a name with a letter behind it.
    fn named_base(&self) -> Option<&str> {
        self.base.as_deref().filter(|base| !base.is_empty())
    }
}

/// Gives each name its role. `number` is what messages and options count columns from 1 by; a tag of a long table has none.
pub fn roles(names: &[Name], options: &Options, numbered: bool) -> Result<Roles, Trouble> {
    let (found, missing) = as_far_as_there(names, options, numbered)?;
    if missing.is_empty() { Ok(found) } else { Err(Trouble::Missing(missing)) }
}

/// The role of each name, and those that a record needs and that none has.
pub fn as_far_as_there(
    names: &[Name],
    options: &Options,
    numbered: bool,
) -> Result<(Roles, Vec<&'static str>), Trouble> {
    let mut found: Roles = vec![None; names.len()];
    for role in ROLES {
        if let Some(wanted) = options.column(role.as_str()) {
            // `--mode none`: what looks like the mode is something else.
            if role == Role::Mode
                && wanted.eq_ignore_ascii_case("none")
                && !names.iter().any(|name| name.is(wanted))
            {
                continue;
            }
            let at = told(names, wanted, role.as_str(), numbered).map_err(Trouble::Refused)?;
            found[at] = Some(role);
        }
    }
    let wanted = options.of_loop.as_deref().map(|own| Name::new(own).plain().to_string());
    let mut candidates: Vec<Candidate> = names
        .iter()
        .enumerate()
        .filter(|(at, name)| found[*at].is_none() && name.quality_of().is_none())
        .filter_map(|(at, name)| match name.said()? {
            said if wanted.as_ref().is_some_and(|own| is_of_another(name, &said.owner, own)) => None,
            said => match said.meaning {
                // `OP [FIC101]`, `op{loop="FIC101"}`: what stands in brackets is no unit.
                Meaning::Role(role) => {
                    let bracketed = || name.unit.as_deref().map(|unit| Name::new(unit).plain().to_string());
                    let labelled = said.owner.is_empty().then(bracketed).flatten();
                    let owner = labelled.filter(|unit| controller(unit).is_some()).unwrap_or(said.owner);
                    let base = name.lettered().and_then(|(before, _)| Some(before.said()?.owner));
                    let base = base.filter(|base| *base != owner);
                    Some(Candidate { at, role, owner, base })
                }
                Meaning::Time => None,
            },
        })
        .collect();
    candidates.retain(|c| options.column(c.role.as_str()).is_none());
    without_limits(&mut candidates);
    // Where nothing else is the controller's output, a vendor's MV (the manipulated variable) is; a stem's position is not.
    // A CV may be a controlled variable beside it.
    let says = |c: &Candidate, short: &str| names[c.at].plain().split(' ').any(|word| word == short);
    let is_cv = |c: &Candidate| {
        names[c.at].plain().strip_prefix(c.owner.as_str()).is_some_and(|name| name.trim() == "cv")
    };
    let all_cv = candidates.iter().filter(|c| c.role == Role::Op).all(is_cv);
    if options.op.is_none() && options.mv.is_none() && all_cv {
        let is_mv = |c: &&mut Candidate| c.role == Role::Mv && says(c, "mv") && !says(c, "stem");
        candidates.iter_mut().filter(is_mv).for_each(|c| c.role = Role::Op);
    }
    let owner_of = |role: Role| {
        let at = found.iter().position(|own| *own == Some(role))?;
        names[at].said().map(|said| said.owner)
    };
    let told = [owner_of(Role::Op), owner_of(Role::Pv)];
    let told_op = found.contains(&Some(Role::Op)).then(|| told[0].clone().unwrap_or_default());
    without_positions(&mut candidates, told_op);
    let seen = Seen { names, candidates: &candidates, told: &told, numbered, wanted: wanted.is_some() };
    let mut owner = None;
    for role in ROLES {
        if found.contains(&Some(role)) {
            continue;
        }
        let needed = matches!(role, Role::Op | Role::Pv);
        if let Some(at) = choose(&seen, role, needed, &mut owner)? {
            found[at] = Some(role);
        }
    }
    letter_of_op(&seen, &found)?;
    let missing = [Role::Op, Role::Pv].into_iter().filter(|role| !found.contains(&Some(*role)));
    let missing: Vec<&str> = missing.map(Role::as_str).collect();
    Ok((found, missing))
}

/// The letters before the number of a tag: `zt` of `zt101` and of `unit1 zt 101`.
fn letters(owner: &str) -> Option<&str> {
    let mut words = owner.rsplit(' ');
    let last = words.next()?;
    match last.find(|c: char| c.is_ascii_digit())? {
        0 => words.next(),
        at => last.get(..at),
    }
}

/// Takes away each PV of a transmitter or an indicator of position (ISA-5.1: Z), `zt101`: beside an OP of flow or level it measures the
/// valve and not the process. In a position loop, `zt101` or `zic101`, it is PV. `told`: the loop of the OP that an option names.
fn without_positions(candidates: &mut Vec<Candidate>, told: Option<String>) {
    let ops = candidates.iter().filter(|c| c.role == Role::Op).map(|c| c.owner.clone());
    let ops: Vec<String> = ops.chain(told).collect();
    let is_of_position = |op: &String| {
        letters(controller(op).as_deref().unwrap_or(op)).is_some_and(|own| own.starts_with('z'))
    };
    let is_transmitter = |own: &str| letters(own).is_some_and(|own| ["zt", "zi", "zit"].contains(&own));
    let may_be_pv = |own: &str| ops.is_empty() || ops.iter().any(|op| op == own || is_of_position(op));
    candidates.retain(|c| c.role != Role::Pv || !is_transmitter(&c.owner) || may_be_pv(&c.owner));
}

/// Takes away what has a letter behind the name of another: `FIC101.OP_H` beside `FIC101.OP` is something else of the same loop.
fn without_limits(candidates: &mut Vec<Candidate>) {
    let plain = candidates.iter().filter(|c| c.base.is_none());
    let plain: Vec<(Role, String)> = plain.map(|c| (c.role, c.owner.clone())).collect();
    let is_plain = |role: Role, base: &str| plain.iter().any(|(own, owner)| *own == role && owner == base);
    candidates.retain(|c| c.named_base().is_none_or(|base| !is_plain(c.role, base)));
}

/// Refuses an OP with a letter behind its name that its PV has not: it is a loop, or a unit that says how far OP goes.
fn letter_of_op(seen: &Seen<'_>, found: &Roles) -> Result<(), Trouble> {
    let op = seen.candidates.iter().find(|c| c.role == Role::Op && found[c.at] == Some(Role::Op));
    let pv = found.iter().position(|own| *own == Some(Role::Pv)).map(|at| &seen.names[at]);
    let (Some(op), Some(pv)) = (op.filter(|op| op.base.is_some()), pv) else { return Ok(()) };
    if pv.said().is_some_and(|said| said.owner == op.owner) {
        return Ok(());
    }
    Err(Trouble::Refused(TableError::refused(format!(
        "{:?}: the letter behind it is its unit or its loop, and {:?} has another or none; write a unit in brackets, such as \"OP [V]\", \
         or name both with --op and --pv",
        shown(&seen.names[op.at].full),
        shown(&pv.full)
    ))))
}

/// What a role is chosen from.
struct Seen<'s> {
    names: &'s [Name],
    candidates: &'s [Candidate],
    /// The loops of OP and of PV, where options name these.
    told: &'s [Option<String>; 2],
    /// Whether names stand over columns, which have numbers.
    numbered: bool,
    /// Whether somebody wants one loop, so that all candidates are of it.
    wanted: bool,
}

/// Whether a loop's name is that of a path, or its last part: `fic101` of `server fic101`, and of `fic101 pid1`.
pub fn owns(own: &str, path: &str) -> bool {
    path == own
        || path.strip_suffix(own).is_some_and(|p| p.ends_with(' '))
        || path.strip_prefix(own).is_some_and(|p| p.starts_with(' '))
}

/// Whether a name with this owner is of another loop than the wanted one. Where that has more than a letter, a letter behind a name
/// without a loop may be its unit.
fn is_of_another(name: &Name, owner: &str, wanted: &str) -> bool {
    let is_bare = |before: &Name| before.said().is_some_and(|said| said.owner.is_empty());
    let may_be_unit = || wanted.len() > 1 && name.lettered().is_some_and(|(before, _)| is_bare(&before));
    !owner.is_empty() && !owns(wanted, owner) && !may_be_unit()
}

/// Whether two areas are known and not the same.
fn are_apart(a: &str, b: &str) -> bool {
    !a.is_empty() && !b.is_empty() && a != b
}

/// What stands before the tag of a controller in a path: its unit or area.
fn before<'p>(path: &'p str, tag: &str) -> &'p str {
    let compact = |at: usize| path[at..].replace(' ', "").starts_with(tag);
    let begins = path.char_indices().map(|(at, _)| at).filter(|at| *at == 0 || path[..*at].ends_with(' '));
    begins.rev().find(|at| compact(*at)).map_or("", |at| path[..at].trim_end())
}

fn second_column(seen: &Seen<'_>, (first, second): (usize, usize), role: Role) -> Trouble {
    let names = seen.names;
    if !seen.numbered {
        let both = listed([first, second].map(|at| names[at].full.as_str()));
        let role = role.as_str();
        return Trouble::Refused(TableError::refused(format!(
            "{both} may each be {role}; say which with --{role} NAME"
        )));
    }
    Trouble::Refused(TableError::refused(format!(
        "column {0}: {1:?} is the second column for {2} (after column {3}); say which with --{2}",
        second + 1,
        names[second].full,
        role.as_str(),
        first + 1
    )))
}

/// Those of a loop: the set point of another one is none of it. `FIC101.PV C` is of FIC101 where nothing else is.
fn of_loop<'c>(left: &[&'c Candidate], owner: &str) -> Vec<&'c Candidate> {
    let same: Vec<&Candidate> = left.iter().copied().filter(|c| c.owner == owner).collect();
    if !same.is_empty() {
        return same;
    }
    left.iter().copied().filter(|c| c.named_base() == Some(owner)).collect()
}

/// The one candidate for a role, and the loop it belongs to.
fn choose(
    seen: &Seen<'_>,
    role: Role,
    needed: bool,
    owner: &mut Option<String>,
) -> Result<Option<usize>, Trouble> {
    let Seen { names, candidates, told, .. } = *seen;
    let of = |role: Role| candidates.iter().filter(move |c| c.role == role);
    let plain: Vec<&Candidate> = of(role).filter(|c| c.owner.is_empty()).collect();
    if let [first, second, ..] = plain.as_slice() {
        return Err(second_column(seen, (first.at, second.at), role));
    }
    // pandas calls the second of two columns of one name so.
    let copy_of = |at: usize| {
        let copy = format!("{}.1", names[at].full);
        names.iter().position(|name| name.full == copy)
    };
    if let [one] = plain.as_slice() {
        if let Some(second) = copy_of(one.at) {
            return Err(second_column(seen, (one.at, second), role));
        }
        owner.get_or_insert_default();
        return Ok(Some(one.at));
    }
    let mut left: Vec<&Candidate> = of(role).collect();
    // The set point of a controller that has a name is none of a bare OP and PV.
    if !needed && !seen.wanted && owner.as_ref().is_some_and(String::is_empty) {
        let of_another = |c: &Candidate| of(Role::Op).any(|op| op.owner == c.owner);
        left.retain(|c| controller(&c.owner).is_none() && !of_another(c));
    }
    if let Some(owner) = owner.as_ref().filter(|owner| !owner.is_empty()) {
        let same = of_loop(&left, owner);
        if !needed || !same.is_empty() {
            left = same;
        }
    } else if left.len() > 1 {
        // Of several, the loop that has both OP and PV.
        let owners = |role: Role| {
            let place = [Role::Op, Role::Pv].iter().position(|own| *own == role);
            let told = place.and_then(|at| told[at].as_deref());
            of(role).flat_map(Candidate::owners).chain(told).collect::<BTreeSet<_>>()
        };
        let both: Vec<&str> = owners(Role::Op).intersection(&owners(Role::Pv)).copied().collect();
        if let [own] = both.as_slice() {
            left.retain(|c| c.owners().any(|owner| owner == *own));
        }
    }
    if let ([one], Some(owner), true) = (left.as_slice(), owner.as_ref(), needed)
        && let (Some(own), Some(other)) = (controller(&one.owner), controller(owner))
        && (own != other || are_apart(before(&one.owner, &own), before(owner, &other)))
    {
        return Err(Trouble::Refused(TableError::refused(format!(
            "{:?} is of {}, and the other columns are of {}: if they are one loop, name them with --op and --pv",
            names[one.at].full,
            one.owner.to_uppercase(),
            owner.to_uppercase()
        ))));
    }
    match left.as_slice() {
        [] => Ok(None),
        [one] => {
            // In rows of tags such a name may be that of any tag.
            if let Some(second) = copy_of(one.at).filter(|_| seen.numbered) {
                return Err(second_column(seen, (one.at, second), role));
            }
            if needed && owner.as_ref().is_none_or(String::is_empty) {
                // Behind PV alone the letter may be its unit, which the mode has not.
                let base = one.base.as_ref().filter(|_| role == Role::Pv);
                *owner = Some(base.unwrap_or(&one.owner).clone());
            }
            Ok(Some(one.at))
        }
        // A record whose mode is left out has samples in manual.
        _ if !needed && role != Role::Mode => Ok(None),
        several => {
            let of = listed(several.iter().map(|c| names[c.at].full.as_str()));
            let role = role.as_str();
            let or = if needed { "or " } else { "that none is with --mode none, or " };
            let same = |c: &&Candidate| names[c.at].full == names[several[0].at].full;
            Err(Trouble::Refused(TableError::refused(match several.iter().all(same) {
                true => {
                    let columns: Vec<String> = several.iter().map(|c| (c.at + 1).to_string()).collect();
                    format!(
                        "columns {} are all called {:?}; say which is {role} with --{role} and its number",
                        columns.join(", "),
                        names[several[0].at].full
                    )
                }
                false => {
                    format!(
                        "{of} may each be {role}; say which with --{role} NAME, {or}which loop with --loop"
                    )
                }
            })))
        }
    }
}

/// The column that an option names.
pub fn told(names: &[Name], wanted: &str, option: &str, numbered: bool) -> Result<usize, TableError> {
    // Who writes a name as it stands there means no other.
    let exactly = (0..names.len()).filter(|at| names[*at].full == wanted.trim());
    if let [one] = exactly.collect::<Vec<_>>().as_slice() {
        return Ok(*one);
    }
    let mut found = (0..names.len()).filter(|at| names[*at].is(wanted));
    if let Some(at) = found.next() {
        return match found.next() {
            Some(other) => Err(TableError::refused(format!(
                "--{option} {wanted:?}: columns {} and {} are called so; name one by its number",
                at + 1,
                other + 1
            ))),
            None => Ok(at),
        };
    }
    let number = wanted.parse::<usize>().ok().filter(|number| numbered && (1..=names.len()).contains(number));
    number.map(|number| number - 1).ok_or_else(|| {
        let have = listed(names.iter().filter(|name| !name.is_none()).map(|name| name.full.as_str()));
        let of_a_tag = numbered && ROLES.iter().any(|role| role.as_str() == option);
        let or = if of_a_tag {
            "; if it is a tag of a table with one sample a row, also give --tag and --value"
        } else {
            ""
        };
        TableError::refused(format!("--{option} {wanted:?}: no column is called so; there are {have}{or}"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(names: &[&str], options: &Options) -> Result<Vec<(&'static str, String)>, String> {
        let names: Vec<Name> = names.iter().map(|name| Name::new(name)).collect();
        match roles(&names, options, true) {
            Ok(roles) => {
                let some = roles
                    .iter()
                    .zip(&names)
                    .filter_map(|(role, name)| Some((((*role)?).as_str(), name.full.clone())));
                Ok(some.collect())
            }
            Err(Trouble::Missing(missing)) => Err(format!("no {}", missing.join(", "))),
            Err(Trouble::Refused(error)) => Err(error.to_string()),
        }
    }

    #[test]
    fn the_loop_is_found_among_many_names() {
        let plain = Options::default();
        let pairs = |of: Result<Vec<(&'static str, String)>, String>| {
            of.expect("a loop")
                .into_iter()
                .map(|(role, name)| format!("{role}={name}"))
                .collect::<Vec<_>>()
                .join(" ")
        };
        for (names, expected) in [
            (&["t", "op", "pv", "mv"][..], "op=op pv=pv mv=mv"),
            (&["time", "PV", "SV", "MV"], "pv=PV sp=SV op=MV"),
            (&["FIC101.OP", "FIC101.PV", "TI205.PV"], "op=FIC101.OP pv=FIC101.PV"),
            (&["FIC101.OP", "FIC101.PV", "FIC102.SP"], "op=FIC101.OP pv=FIC101.PV"),
            (&["op", "pv", "TI205.PV", "FIC102.OP"], "op=op pv=pv"),
            (&["OP", "PV", "TIC205.SP", "TIC205.MODE"], "op=OP pv=PV"),
            (&["OP", "FIC101.PV", "FIC101.SP"], "op=OP pv=FIC101.PV sp=FIC101.SP"),
            (&["FIC101/PID1/OUT.CV", "FT101/AI1/PV.CV"], "op=FIC101/PID1/OUT.CV pv=FT101/AI1/PV.CV"),
            (&["OP %", "pv_status", "PV degC"], "op=OP % pv=PV degC"),
            (&["FV-101.OP", "FIC-102.PV"], "op=FV-101.OP pv=FIC-102.PV"),
            (&["FIC101A.OP", "PLC01.FIC101A.PV"], "op=FIC101A.OP pv=PLC01.FIC101A.PV"),
            (&["FIC101.PIDA.OP", "FIC101.DACA.PV"], "op=FIC101.PIDA.OP pv=FIC101.DACA.PV"),
            (&["SEC01.FIC101.OP", "SEC01.FT101.PV"], "op=SEC01.FIC101.OP pv=SEC01.FT101.PV"),
            (&["OP_A", "PV_A", "SP_A"], "op=OP_A pv=PV_A sp=SP_A"),
            (&["OP", "PV C", "SP C", "MODE"], "op=OP pv=PV C sp=SP C mode=MODE"),
            (&["OP", "PV", "OP_C", "PV_C", "SP_C"], "op=OP pv=PV"),
            (
                &["TIC101.OP %", "TIC101.PV C", "TIC101.SP C", "TIC101.MODE"],
                "op=TIC101.OP % pv=TIC101.PV C sp=TIC101.SP C mode=TIC101.MODE",
            ),
            (
                &["FIC101.OP", "FIC101.OP_H", "FIC101.PV", "FIC101.PV_H", "FIC101.PV_L"],
                "op=FIC101.OP pv=FIC101.PV",
            ),
            (
                &["FIC101/PID1/OUT.CV", "FIC101/PID1/PV.CV", "mv"],
                "op=FIC101/PID1/OUT.CV pv=FIC101/PID1/PV.CV mv=mv",
            ),
        ] {
            assert_eq!(pairs(of(names, &plain)), expected, "{names:?}");
        }
        let two = ["FIC101.OP", "FIC101.PV", "FIC102.OP", "FIC102.PV"];
        let one = Options { of_loop: Some("FIC102".into()), ..Options::default() };
        assert_eq!(pairs(of(&two, &one)), "op=FIC102.OP pv=FIC102.PV");
        let lettered = ["OP_B", "PV_B", "SP_B", "OP_C", "PV_C", "SP_C"];
        let one_of = |own: &str| Options { of_loop: Some(own.into()), ..Options::default() };
        assert_eq!(pairs(of(&lettered, &one_of("C"))), "op=OP_C pv=PV_C sp=SP_C");
        assert_eq!(pairs(of(&["OP %", "PV C"], &one_of("FIC101"))), "op=OP % pv=PV C");
        assert!(of(&lettered, &one_of("FIC101")).is_err(), "loops B and C");
        // A transmitter of position measures the valve.
        for zt in ["ZT101.PV", "ZI-101.PV", "Unit1/ZIT101A.PV"] {
            assert_eq!(of(&["FIC101.OP", zt], &plain), Err("no pv".into()), "{zt}");
            assert_eq!(pairs(of(&["FIC101.OP", "FT101.PV", zt], &plain)), "op=FIC101.OP pv=FT101.PV", "{zt}");
            let told = Options { pv: Some(zt.into()), ..plain.clone() };
            assert_eq!(pairs(of(&["FIC101.OP", zt], &told)), format!("op=FIC101.OP pv={zt}"));
            // In a loop of position it is the process.
            for op in ["ZIC101.OP", "ZIC-101/PID1/OP"] {
                assert_eq!(pairs(of(&[op, zt], &plain)), format!("op={op} pv={zt}"));
            }
            let own = zt.replace("PV", "OP");
            assert_eq!(pairs(of(&[own.as_str(), zt], &plain)), format!("op={own} pv={zt}"));
        }
        let bare = ["OP", "PV", "FIC102.SP", "TIC205.SP"];
        assert_eq!(pairs(of(&bare, &one)), "op=OP pv=PV sp=FIC102.SP");
        let named = Options { op: Some("valve".into()), pv: Some("2".into()), ..Options::default() };
        assert_eq!(pairs(of(&["Valve", "flow", "pv"], &named)), "op=Valve pv=flow");
        let named = Options { op: Some("FIC102.OP".into()), pv: Some("FIC102.PV".into()), ..plain.clone() };
        let modes = [&two[..], &["FIC101.MODE", "FIC102.MODE"]].concat();
        assert_eq!(pairs(of(&modes, &named)), "op=FIC102.OP pv=FIC102.PV mode=FIC102.MODE");
    }

    #[test]
    fn a_doubt_is_refused_by_name() {
        let plain = Options::default();
        let refused = |names: &[&str], options: &Options| of(names, options).expect_err("refused");
        let two = ["FIC101.OP", "FIC101.PV", "FIC102.OP", "FIC102.PV"];
        assert!(
            refused(&two, &plain)
                .contains("\"FIC101.OP\", \"FIC102.OP\" may each be op; say which with --op NAME")
        );
        assert!(
            refused(&["op", "pv", "OP"], &plain)
                .contains("\"OP\" is the second column for op (after column 1)")
        );
        assert!(
            refused(&["FIC101.OP", "FIC101.PV", "FIC101.PV.1"], &plain)
                .contains("\"FIC101.PV.1\" is the second column for pv (after column 2)")
        );
        assert_eq!(refused(&["flow", "pv"], &plain), "no op");
        for names in [
            &["OP_B", "PV_B", "OP_C", "PV_C"][..],
            &["OP_A", "PV_A", "OP_B", "PV_B"],
            &["OP a", "PV", "OP b"],
        ] {
            let said = refused(names, &plain);
            assert!(
                said.contains("may each be op; say which with --op NAME, or which loop with --loop"),
                "{said}"
            );
        }
        let valves = ["FIC101.OP_A", "FIC101.OP_B", "FIC101.PV"];
        assert!(refused(&valves, &plain).contains("\"FIC101.OP_A\", \"FIC101.OP_B\" may each be op"));
        let two = ["TIC101.OP", "TIC101.PV C", "FIC102.OP", "FIC102.PV"];
        assert!(refused(&two, &plain).contains("\"TIC101.OP\", \"FIC102.OP\" may each be op"));
        for names in [["OP V", "PV"], ["OP_A", "PV_B"], ["FIC101.OP A", "FIC101.PV"]] {
            let said = refused(&names, &plain);
            assert!(said.contains("the letter behind it is its unit or its loop"), "{said}");
            let [op, pv] = names.map(|name| Some(name.to_string()));
            assert!(of(&names, &Options { op, pv, ..plain.clone() }).is_ok(), "{names:?} named");
        }
        let bits = ["FIC101.OP", "FIC101.PV", "FIC101.AUTO", "FIC101.MAN"];
        assert!(refused(&bits, &plain).contains("may each be mode; say which with --mode NAME"));
        for pv in ["FIC102.PV", "TIC-101.PV", "FIC101B.PV", "Unit1/FIC_102/PV"] {
            let said = refused(&["FIC101.OP", pv], &plain);
            assert!(said.contains("the other columns are of FIC101: if they are one loop"), "{said}");
        }
        let named = Options { op: Some("FIC101.OP".into()), pv: Some("FIC102.PV".into()), ..plain.clone() };
        assert!(of(&["FIC101.OP", "FIC102.PV"], &named).is_ok(), "told by name");
        let named = Options { op: Some("valve".into()), ..Options::default() };
        assert!(
            refused(&["a", "pv"], &named)
                .contains("--op \"valve\": no column is called so; there are \"a\", \"pv\"")
        );
    }
}
