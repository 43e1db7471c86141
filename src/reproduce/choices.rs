//! What the paper leaves open, and how far each choice moves the numbers.

use super::bench::{CASES, Case, Original, RESOLUTION, SETTLED_FROM, SETTLED_TO, f_of, parallel};
use super::report::{Cell, Section, Style, Table, spread};
use super::tables::{DIAGNOSED, LONGEST, from_switch_on, noisy};
use crate::sim::scenarios::table2_loop;
use crate::sim::{Friction, LoopSpec, SpecError};

/// f and the ISE ratio of one loop, where they exist.
type Found = [Option<f64>; 2];

/// A choice, one option of it, and the loop built accordingly.
struct Choice {
    name: &'static str,
    option: &'static str,
    build: Box<dyn Fn(&Case) -> LoopSpec + Sync>,
}

fn choice(
    name: &'static str,
    option: &'static str,
    build: impl Fn(&Case) -> LoopSpec + Sync + 'static,
) -> Choice {
    Choice { name, option, build: Box::new(build) }
}

fn choices() -> Vec<Choice> {
    let chart = |resolution: f64| {
        move |c: &Case| table2_loop(c.level, Friction::Choudhury { s: c.s, j: c.j, resolution })
    };
    let letter = |c: &Case| {
        let friction = Friction::ChoudhuryChart { s: c.s, j: c.j, resolution: RESOLUTION };
        table2_loop(c.level, friction)
    };
    let sp = |step: f64| move |c: &Case| LoopSpec { sp: 50.0 + step, ..c.choudhury() };
    let he = |c: &Case| {
        let friction = Friction::He { fs: 0.5 * (c.s + c.j), fd: 0.5 * (c.s - c.j) };
        table2_loop(c.level, friction)
    };
    let noise = |sample_time: f64| move |c: &Case| noisy(c, 1e-4, sample_time);
    vec![
        choice("as used", "stop at 0.005 %, SP step 10 %, backward Euler PI, no noise", Case::choudhury),
        choice("stop rule", "Δu = 0 exactly", chart(0.0)),
        choice("stop rule", "|Δu| up to 0.003 %", chart(0.003)),
        choice("stop rule", "|Δu| up to 0.01 %", chart(0.01)),
        choice("set point", "step of 1 %", sp(1.0)),
        choice("set point", "step of 0.1 %", sp(0.1)),
        choice("controller", "forward Euler PI", forward_euler),
        choice("controller", "parallel form, Kc + 1/(Ti s)", parallel_form),
        choice("valve", "Choudhury's chart to the letter", letter),
        choice("valve", "Kano", Case::kano),
        choice("valve", "He, fs and fd", he),
        choice("noise", "power 1e-4, sample time 0.1 s", noise(0.1)),
        choice("noise", "power 1e-4, sample time 1 s", noise(1.0)),
        choice("noise", "power 1e-4, sample time 6 s (0.1 min)", noise(6.0)),
    ]
}

/// f and the settled ISE ratio of the four loops, one choice changed at a time, and the ratio over other spans.
///
/// # Errors
/// [`SpecError`] where a loop's number makes no sense.
pub fn open_choices() -> Result<Section, SpecError> {
    let choices = choices();
    let jobs: Vec<(usize, usize)> = (0..choices.len()).flat_map(|o| (0..4).map(move |c| (o, c))).collect();
    let found = parallel(&jobs, |&(o, c)| {
        let original = Original::new((choices[o].build)(&CASES[c]), 1)?;
        let f = f_of(&original.diagnose(DIAGNOSED));
        // Without an f the ratio at S/2 still says what the choice does to the compensation.
        let ratios = original.ratios(f.unwrap_or(0.5 * CASES[c].s))?;
        Ok([f, spread(&ratios).map(|s| s[1])])
    });
    let found = found.into_iter().collect::<Result<Vec<Found>, SpecError>>()?;
    let as_used = &found[..4];
    let mut rows = Vec::new();
    for (choice, loops) in choices.iter().zip(found.chunks(4)) {
        rows.push(row(choice.name, choice.option, loops, as_used));
        if rows.len() == 1 {
            for (option, loops) in spans(as_used)? {
                rows.push(row("ISE span", option, &loops, as_used));
            }
        }
    }
    Ok(Section {
        id: "choices",
        title: "Open choices: what the paper leaves open, and how far it moves the numbers".into(),
        text: vec![
            format!(
                "f and the ISE ratio at a = f over the settled span (samples {SETTLED_FROM} to \
                 {SETTLED_TO} after the switch-on) of each loop, one choice changed at a time; \"moved by\": the \
                 largest change against the first row over the loops that have both numbers. \"–\": not identifiable, or a loop \
                 that does not cycle, whose ratio would divide by nothing. Where f is missing the ratio is that at S/2."
            ),
            format!(
                "Sine in radians or degrees: two rows of Table 2, f is 0 in both. Noise sample time: it moves the noise sd \
                 from 0.004 to 0.032 %. The operating point (50 %) moves nothing: valve and process are the \
                 same at every one. The resolution is {RESOLUTION} % where not varied. Span of the ISE: medians over the \
                 instants of Table 3."
            ),
        ],
        table: Some(Table {
            columns: vec![
                ("choice", "choice"),
                ("option", "option"),
                ("f_flow_weak", "f, flow weak"),
                ("f_flow_strong", "f, flow strong"),
                ("f_level_weak", "f, level weak"),
                ("f_level_strong", "f, level strong"),
                ("f_moved_percent", "f moved by [%]"),
                ("ratio_flow_weak", "ratio, flow weak"),
                ("ratio_flow_strong", "ratio, flow strong"),
                ("ratio_level_weak", "ratio, level weak"),
                ("ratio_level_strong", "ratio, level strong"),
                ("ratio_moved_times", "ratio moved by [×]"),
            ],
            rows,
        }),
        ..Section::default()
    })
}

fn row(name: &str, option: &str, loops: &[Found], as_used: &[Found]) -> Vec<Cell> {
    let moved = |of: usize, by: fn(f64, f64) -> f64| {
        let both = loops.iter().zip(as_used).filter_map(|(l, u)| Some(by(l[of]?, u[of]?)));
        both.reduce(f64::max)
    };
    let mut row = vec![Cell::text(name), Cell::text(option)];
    row.extend(loops.iter().map(|l| Cell::Number(l[0], Style::Fixed(3))));
    row.push(Cell::Number(moved(0, |f, used| 100.0 * (f / used - 1.0).abs()), Style::Fixed(1)));
    row.extend(loops.iter().map(|l| Cell::Number(l[1], Style::Power)));
    row.push(Cell::Number(moved(1, |r, used| (r / used).max(used / r)), Style::Fixed(1)));
    row
}

/// The ratio at the same f over spans that begin at the switch-on.
fn spans(as_used: &[Found]) -> Result<Vec<(&'static str, Vec<Found>)>, SpecError> {
    let jobs: Vec<usize> = (0..as_used.len()).collect();
    let curves = parallel(&jobs, |&c| {
        let a = as_used[c][0].unwrap_or(0.5 * CASES[c].s);
        from_switch_on(&CASES[c].choudhury(), a, LONGEST)
    });
    let curves = curves.into_iter().collect::<Result<Vec<_>, SpecError>>()?;
    let over = |samples: usize| -> Vec<Found> {
        let median = |c: usize| {
            let at: Vec<f64> = curves[c].iter().map(|curve| curve[samples - 1]).collect();
            spread(&at).map(|s| s[1])
        };
        (0..as_used.len()).map(|c| [as_used[c][0], median(c)]).collect()
    };
    Ok(vec![
        ("first 1,000 samples", over(1000)),
        ("first 8,000 samples", over(SETTLED_TO)),
        ("first 20,000 samples", over(LONGEST)),
    ])
}

/// `Δu = Kc (e[k] - (1 - h) e[k-1])`, h = ts/Ti: the velocity form here with `Kc (1 - h)` and `h / (1 - h)`.
fn forward_euler(case: &Case) -> LoopSpec {
    let mut spec = case.choudhury();
    let h = spec.ts_s / spec.controller.ti_s;
    spec.controller.gain *= 1.0 - h;
    spec.controller.ti_s = spec.ts_s * (1.0 - h) / h;
    spec
}

/// `Kc + 1/(Ti s)` is `Kc (1 + 1/(Kc Ti s))`.
fn parallel_form(case: &Case) -> LoopSpec {
    let mut spec = case.choudhury();
    spec.controller.ti_s *= spec.controller.gain;
    spec
}
