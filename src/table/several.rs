//! The loops of a table that has a column for each tag of several, as historians export a unit.
//!
//! Which columns are a loop's a list says, or their names do (`FIC101.OP`, `FIC101.PV`), as [`super::loops`] reads them. The table is
//! surveyed once for all loops, and read once more for as many of them as fit into memory together.

use super::channel::{Channel, Tag};
use super::error::{TableError, shown};
use super::found::Found;
use super::layout::Layout;
use super::loops;
use super::names::Name;
use super::options::Options;
use super::roles::{Roles, Trouble, told};
use super::source::Source;
use super::survey::{Plan, survey};
use super::take::{ready, samples, twice};
use super::{MAX_VALUES, Table};
use crate::signal::{Record, Role, Series};
use std::collections::{HashMap, HashSet};

/// Most samples of loops that are read together: 200 MB.
const TOGETHER: u64 = 1 << 23;

/// The columns of one loop, each by its name or by its number from 1.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LoopColumns {
    /// The loop.
    pub name: String,
    /// What each column is to it.
    pub columns: Vec<(Role, String)>,
}

/// A loop of a table that has several.
#[derive(Debug)]
pub struct OneOf {
    /// Its name.
    pub name: String,
    /// How many loops the table has.
    pub of: usize,
    /// Its record, or why there is none.
    pub table: Result<Table, TableError>,
}

/// A loop and its columns from 0, or why it has none.
struct Placed {
    name: String,
    columns: Result<Vec<(Role, usize)>, String>,
}

/// The columns of times, of times of day beside dates, and of parts of seconds.
type Times = [Option<usize>; 3];

fn times(layout: &Layout) -> Times {
    [Some(layout.time), layout.clock, layout.millis]
}

/// Hands on those loops of a table that are `wanted`, one after the other, in bounded memory. [`Options::several`] says which loops the
/// table has.
///
/// A loop whose columns are missing, or hold no numbers, is handed on with the reason.
///
/// # Errors
/// [`TableError`] for what is no table of a column for each tag, or leaves a doubt that concerns all of it.
pub fn each_of_several(
    source: Source<'_>,
    options: &Options,
    wanted: &dyn Fn(&str) -> bool,
    take: &mut dyn FnMut(OneOf),
) -> Result<(), TableError> {
    let listed = options.several.as_deref().unwrap_or_default();
    let mut plan = survey(source, options, true)?;
    let mut all = placed(&plan.layout.names, times(&plan.layout), listed)?;
    let of = all.len();
    all.retain(|own| wanted(&own.name));
    // Times that are recorded twice in another loop take nothing away from these.
    let kept = all.iter().filter_map(|own| own.columns.as_ref().ok()).flatten();
    let needed: HashSet<usize> =
        kept.filter(|(role, _)| matches!(role, Role::Op | Role::Pv)).map(|(_, column)| column + 1).collect();
    let checked: Vec<bool> = plan.channels.iter().map(|own| needed.contains(&own.column)).collect();
    ready(source, &mut plan, &checked)?;
    let mut rest = all.as_slice();
    while !rest.is_empty() {
        let (now, later) = rest.split_at(fitting(rest, &plan));
        rest = later;
        let mut series: Vec<Option<Series>> = vec![None; plan.channels.len()];
        let columns = now.iter().filter(|own| size(own, &plan) <= MAX_VALUES as u64);
        for (_, column) in columns.filter_map(|own| own.columns.as_ref().ok()).flatten() {
            if let Some(own) = channel(&plan, *column).and_then(|at| series.get_mut(at)) {
                own.get_or_insert_default();
            }
        }
        let counted = samples(source, &mut plan, &mut |at, sample| {
            if let Some(Some(own)) = series.get_mut(at) {
                own.push(sample);
            }
            Ok(())
        })?;
        let read_as = Found::new(&plan, &counted).read_as;
        for own in now {
            take(OneOf { name: own.name.clone(), of, table: record(own, &plan, &series, &read_as) });
        }
    }
    Ok(())
}

/// Why a header is that of none of the loops.
pub(super) fn none(listed: &[LoopColumns]) -> String {
    let said = |(role, column): &(Role, String)| format!("{} {:?}", role.as_str(), shown(column));
    match listed.first() {
        Some(first) => {
            let columns = first.columns.iter().map(said).collect::<Vec<_>>().join(", ");
            format!("it has the columns of no loop of the list, such as those of {:?}, {columns}", first.name)
        }
        None => "no loop has columns of OP and PV by their names, such as FIC101.OP and FIC101.PV".into(),
    }
}

/// How many samples a loop has at most.
fn size(own: &Placed, plan: &Plan) -> u64 {
    let columns = own.columns.iter().flatten();
    columns.filter_map(|(_, column)| Some(plan.channels.get(channel(plan, *column)?)?.cells)).sum()
}

/// How many of the first loops are read together: one at least.
fn fitting(loops: &[Placed], plan: &Plan) -> usize {
    let mut sum = 0;
    let fits = |own: &&Placed| {
        sum += size(own, plan);
        sum <= TOGETHER
    };
    loops.iter().take_while(fits).count().max(1)
}

/// The place of the channel of a column.
fn channel(plan: &Plan, column: usize) -> Option<usize> {
    plan.channels.iter().position(|own| own.column == column + 1)
}

/// The record of a loop out of the series of its columns.
fn record(own: &Placed, plan: &Plan, series: &[Option<Series>], read_as: &str) -> Result<Table, TableError> {
    let columns = own.columns.as_ref().map_err(|why| TableError::refused(why.as_str()))?;
    if size(own, plan) > MAX_VALUES as u64 {
        return Err(TableError::refused(format!("more than {MAX_VALUES} values: cut it into shorter files")));
    }
    let (mut record, mut op_unit) = (Record::default(), None);
    for (role, column) in columns {
        let is_needed = matches!(role, Role::Op | Role::Pv);
        let (at, own) = match channel(plan, *column).and_then(|at| Some((at, plan.channels.get(at)?))) {
            Some(found) => found,
            None if is_needed => {
                let name = plan.layout.names.get(*column).map_or("", |name| name.full.as_str());
                return Err(TableError::refused(format!(
                    "column {} ({}), {}: no tag is read from it",
                    column + 1,
                    shown(name),
                    role.as_str()
                )));
            }
            None => continue,
        };
        let samples = series.get(at).cloned().flatten().unwrap_or_default();
        // Words alone are a mode, and nothing that is measured.
        let is_recorded =
            own.numbers > 0 || own.words.is_some() && *role == Role::Mode && !samples.is_empty();
        match role {
            _ if !is_recorded && is_needed => {
                let (name, role) = (shown(&own.tag.name), role.as_str());
                return Err(TableError::refused(format!(
                    "column {} ({name}), {role}: no number in the whole column",
                    column + 1
                )));
            }
            _ if !is_recorded => {}
            Role::Op => {
                let beside = plan.units.get(at).filter(|unit| !unit.is_empty()).cloned();
                op_unit = own.tag.unit.clone().or(beside).filter(|unit| unit != "-");
                record.op = samples;
            }
            Role::Pv => record.pv = samples,
            Role::Sp => record.sp = Some(samples),
            Role::Mode => record.mode = Some(samples),
            Role::Mv => record.mv = Some(samples),
            Role::Term => record.term = Some(samples),
        }
    }
    twice(Role::Op, &record.op)?;
    twice(Role::Pv, &record.pv)?;
    record.find_span(None, op_unit.as_deref());
    Ok(Table { record, found: Found { read_as: read_as.to_string(), op_unit } })
}

/// The role of each column, that of the first loop that has it; a record needs OP and PV of one of the loops.
pub(super) fn roles(names: &[Name], times: Times, listed: &[LoopColumns]) -> Result<Roles, Trouble> {
    let mut roles: Roles = vec![None; names.len()];
    for own in placed(names, times, listed).map_err(Trouble::Refused)? {
        for (role, at) in own.columns.into_iter().flatten() {
            if let Some(known) = roles.get_mut(at) {
                known.get_or_insert(role);
            }
        }
    }
    match roles.iter().any(Option::is_some) {
        true => Ok(roles),
        false => Err(Trouble::Missing(vec![Role::Op.as_str(), Role::Pv.as_str()])),
    }
}

/// Tells each channel of a table its loop, that of the first that has it: what a mode means is told by its own OP.
pub(super) fn owned(
    channels: &mut [Channel],
    layout: &Layout,
    listed: &[LoopColumns],
) -> Result<(), TableError> {
    let mut owners: HashMap<usize, String> = HashMap::new();
    for own in placed(&layout.names, times(layout), listed)? {
        for (_, at) in own.columns.into_iter().flatten() {
            owners.entry(at + 1).or_insert_with(|| own.name.clone());
        }
    }
    channels.iter_mut().for_each(|channel| channel.control_loop = owners.get(&channel.column).cloned());
    Ok(())
}

/// The loops and where their columns are: those of a list, or those that the names tell. The columns of times are of none.
fn placed(names: &[Name], times: Times, listed: &[LoopColumns]) -> Result<Vec<Placed>, TableError> {
    let is_time = |at: usize| times.contains(&Some(at));
    let masked = |(at, name): (usize, &Name)| if is_time(at) { Name::new("") } else { name.clone() };
    let mut all = match listed {
        [] => by_names(&names.iter().enumerate().map(masked).collect::<Vec<Name>>())?,
        listed => listed.iter().map(|own| by_list(names, times, own)).collect(),
    };
    // What stands in a column is a mode or is measured.
    let mut modes: HashMap<usize, bool> = HashMap::new();
    for own in &mut all {
        let Ok(columns) = &own.columns else { continue };
        let differs =
            |(role, at): &&(Role, usize)| modes.get(at).is_some_and(|own| *own != (*role == Role::Mode));
        if let Some((role, at)) = columns.iter().find(differs) {
            let why = format!(
                "column {} is the mode of one loop, and cannot be {} of another",
                at + 1,
                role.as_str()
            );
            own.columns = Err(why);
            continue;
        }
        modes.extend(columns.iter().map(|(role, at)| (*at, *role == Role::Mode)));
    }
    Ok(all)
}

fn by_list(names: &[Name], times: Times, own: &LoopColumns) -> Placed {
    let place = |(role, column): &(Role, String)| {
        let at = told(names, column, role.as_str(), true);
        let at = at.map_err(|error| error.to_string().trim_start_matches('-').to_string())?;
        if times.contains(&Some(at)) {
            return Err(format!("{} {column:?}: column {} holds the times", role.as_str(), at + 1));
        }
        Ok((*role, at))
    };
    let columns: Result<Vec<(Role, usize)>, String> = own.columns.iter().map(place).collect();
    let needed = |columns: Vec<(Role, usize)>| {
        let lacks = |role: &Role| !columns.iter().any(|(own, _)| own == role);
        match [Role::Op, Role::Pv].iter().find(|role| lacks(role)) {
            Some(role) => Err(format!("the list names no column for {}", role.as_str())),
            None => Ok(columns),
        }
    };
    Placed { name: own.name.clone(), columns: columns.and_then(needed) }
}

/// The loops that have OP and PV by the names of columns.
fn by_names(names: &[Name]) -> Result<Vec<Placed>, TableError> {
    let channel = |(at, name): (usize, &Name)| {
        Channel::new(Tag { name: name.full.clone(), ..Tag::default() }, None, at + 1)
    };
    let mut channels: Vec<Channel> = names.iter().enumerate().map(channel).collect();
    loops::of_many(&mut channels, &Options::default())?;
    let mut all: Vec<Placed> = Vec::new();
    let mut places: HashMap<String, usize> = HashMap::new();
    for channel in channels {
        let (Some(own), Some(role)) = (channel.control_loop, channel.role) else { continue };
        let place = *places.entry(own.clone()).or_insert_with(|| {
            all.push(Placed { name: own, columns: Ok(Vec::new()) });
            all.len() - 1
        });
        let Some(placed) = all.get_mut(place) else { continue };
        let Ok(columns) = &mut placed.columns else { continue };
        let known = columns.iter().find(|(other, _)| *other == role).map(|(_, first)| first + 1);
        match known {
            Some(first) => {
                let (second, role) = (channel.column, role.as_str());
                placed.columns = Err(format!("columns {first} and {second} are both {role}"));
            }
            None => columns.push((role, channel.column - 1)),
        }
    }
    let has = |own: &Placed, role: Role| own.columns.iter().flatten().any(|(other, _)| *other == role);
    all.retain(|own| own.columns.is_err() || has(own, Role::Op) && has(own, Role::Pv));
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::Sample;

    fn named(name: &str, columns: &[(Role, &str)]) -> LoopColumns {
        let own = |(role, column): &(Role, &str)| (*role, (*column).to_string());
        LoopColumns { name: name.into(), columns: columns.iter().map(own).collect() }
    }

    /// Ten rows; the cells of a row are its number times 1, 2, 3, …, and what stands behind them.
    fn table(header: &str, numbers: usize, behind: impl Fn(u32) -> String) -> String {
        let row = |k: u32| {
            let cells: Vec<String> = (1..=numbers as u32).map(|n| (k * n).to_string()).collect();
            format!("{},{}{}\n", 60 * k, cells.join(","), behind(k))
        };
        format!("{header}\n{}", (0..10).map(row).collect::<String>())
    }

    type Read = Vec<(String, usize, Result<Record, String>)>;

    fn read(text: &str, listed: &[LoopColumns], wanted: &dyn Fn(&str) -> bool) -> Result<Read, String> {
        let options = Options { several: Some(listed.to_vec()), ..Options::default() };
        let mut all = Vec::new();
        let mut take = |own: OneOf| {
            let record = own.table.map(|table| table.record).map_err(|error| error.to_string());
            all.push((own.name, own.of, record));
        };
        each_of_several(Source::Bytes(text.as_bytes()), &options, wanted, &mut take)
            .map_err(|error| error.to_string())?;
        Ok(all)
    }

    fn last(series: &[Sample]) -> f64 {
        series.last().map_or(f64::NAN, |sample| sample.value)
    }

    #[test]
    fn the_names_of_columns_tell_the_loops() {
        let text = table("t,FIC101.OP,FIC101.PV,TI7.PV,LIC2.OP,LIC2.PV,LIC2.SP", 6, |_| String::new());
        let all = read(&text, &[], &|_| true).expect("two loops");
        let told: Vec<(&str, usize)> = all.iter().map(|(name, of, _)| (name.as_str(), *of)).collect();
        assert_eq!(told, [("FIC101", 2), ("LIC2", 2)]);
        let record = all[1].2.as_ref().expect("a record");
        assert_eq!((last(&record.op), last(&record.pv)), (36.0, 45.0));
        assert_eq!(record.sp.as_deref().map(last), Some(54.0));
        let one = read(&text, &[], &|name| name == "LIC2").expect("one loop");
        assert_eq!(one.len(), 1);
        assert_eq!((one[0].1, one[0].2.as_ref().map(|own| own.op.len())), (2, Ok(10)));
    }

    #[test]
    fn a_list_tells_the_loops_and_one_column_may_be_of_two() {
        let text = table("t,XMV1,XMEAS2,XMEAS9", 3, |_| String::new());
        let listed = [
            named("FIC1", &[(Role::Op, "XMV1"), (Role::Pv, "xmeas2"), (Role::Sp, "XMEAS9")]),
            named("TIC2", &[(Role::Op, "XMEAS9"), (Role::Pv, "2")]),
            named("LIC3", &[(Role::Op, "XMV3"), (Role::Pv, "XMEAS2")]),
            named("PIC4", &[(Role::Op, "XMV1")]),
        ];
        let all = read(&text, &listed, &|_| true).expect("loops");
        let first = all[0].2.as_ref().expect("a record");
        assert_eq!((last(&first.op), last(&first.pv)), (9.0, 18.0));
        // The set point of the first is the output of the second.
        let second = all[1].2.as_ref().expect("a record");
        assert_eq!((first.sp.as_ref(), last(&second.pv)), (Some(&second.op), 9.0));
        let why = |at: usize| all[at].2.clone().expect_err("no record");
        assert!(why(2).starts_with("op \"XMV3\": no column is called so; there are "), "{}", why(2));
        assert_eq!(why(3), "the list names no column for pv");
    }

    #[test]
    fn a_mode_is_read_by_the_words_of_its_own_column() {
        let mode = |k: u32| format!(",{},AUTO", if k < 5 { "MAN" } else { "AUTO" });
        let text = table("t,FIC1.OP,FIC1.PV,FIC2.OP,FIC2.PV,FIC1.MODE,FIC2.MODE", 4, mode);
        let all = read(&text, &[], &|_| true).expect("two loops");
        let automatic = |at: usize| -> f64 {
            let record = all[at].2.as_ref().expect("a record");
            record.mode.as_ref().expect("a mode").iter().map(|sample| sample.value).sum()
        };
        assert_eq!((automatic(0), automatic(1)), (5.0, 10.0));
    }

    #[test]
    fn a_loop_without_numbers_leaves_the_others() {
        let text = table("t,FIC1.OP,FIC1.PV,FIC2.OP,FIC2.PV", 3, |_| ",----".into());
        let all = read(&text, &[], &|_| true).expect("two loops");
        assert!(all[0].2.is_ok(), "{:?}", all[0].2);
        assert_eq!(
            all[1].2.clone().expect_err("no PV"),
            "column 5 (FIC2.PV), pv: no number in the whole column"
        );
    }

    #[test]
    fn a_list_that_takes_the_times_for_a_value_is_told() {
        let text = table("t,XMV1,XMEAS2", 2, |_| String::new());
        let good = named("FIC1", &[(Role::Op, "XMV1"), (Role::Pv, "XMEAS2")]);
        let by_name = ("t", "XMEAS2", "op \"t\": column 1 holds the times");
        for (op, pv, said) in [by_name, ("XMV1", "1", "pv \"1\": column 1 holds the times")] {
            let wrong = named("FIC2", &[(Role::Op, op), (Role::Pv, pv)]);
            let all = read(&text, &[good.clone(), wrong], &|_| true).expect("one loop");
            assert!(all[0].2.is_ok(), "{:?}", all[0].2);
            assert_eq!(all[1].2.clone().expect_err("no tag"), said);
        }
    }

    #[test]
    fn times_that_another_loop_has_twice_are_none_of_this_one() {
        // The second loop was recorded in two tables that lie within each other, the first only in one of them.
        let row = |k: u32, first: &str| format!("{},{first},{},{}\n", 60 * k, k % 7, k % 5);
        let once: String = (0..300).map(|k| row(2 * k, &format!("{k},{k}"))).collect();
        let twice: String = (160..360).map(|k| row(2 * k + 1, ",")).collect();
        let text = format!("t,FIC1.OP,FIC1.PV,FIC2.OP,FIC2.PV\n{once}{twice}");
        let all = read(&text, &[], &|name| name == "FIC1").expect("the first");
        assert_eq!(all[0].2.as_ref().map(|own| own.op.len()), Ok(300));
        let why = read(&text, &[], &|_| true).expect_err("the second, too");
        assert!(why.contains("recorded already"), "{why}");
    }

    #[test]
    fn a_table_without_any_of_the_loops_is_refused() {
        let text = table("t,a,b", 2, |_| String::new());
        let listed = [named("FIC1", &[(Role::Op, "XMV1"), (Role::Pv, "XMEAS2")])];
        let why = read(&text, &listed, &|_| true).expect_err("none");
        let own = "it has the columns of no loop of the list, such as those of \"FIC1\", op \"XMV1\", pv ";
        assert!(why.contains(own) && why.ends_with("the header has \"t\", \"a\", \"b\""), "{why}");
        let why = read(&text, &[], &|_| true).expect_err("no names");
        assert!(why.contains("no loop has columns of OP and PV by their names"), "{why}");
        let long = "tag,t,value\nFIC1.OP,0,1\nFIC1.PV,0,2\nFIC1.OP,1,1\nFIC1.PV,1,2\n";
        let why = read(long, &[], &|_| true).expect_err("a row for each sample");
        assert!(why.contains("stictiond store import"), "{why}");
    }
}
