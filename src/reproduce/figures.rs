//! Figures 7 to 11.

use super::bench::{CASES, Case, Original, WARM_UP, f_of, parallel, reinforcement, run};
use super::report::{Cell, Section, Style, Table, spread};
use super::tables::{DIAGNOSED, NOISE_SAMPLE_TIME, noisy};
use crate::plot::{Panel, Plot, Series, thin};
use crate::sim::{LoopSpec, SpecError};

/// Amplitudes tried, in f: steps of 0.05 up to 2.
const STEPS: usize = 40;
/// Points a curve keeps, twice.
const POINTS: usize = 400;

/// Figure 7: ISE ratio against the amplitude, the four loops and Kano's valve.
///
/// # Errors
/// [`SpecError`] where a loop's number makes no sense.
pub fn figure_7() -> Result<Section, SpecError> {
    let loops: Vec<(String, LoopSpec)> = CASES
        .iter()
        .map(|c| (c.name.to_owned(), c.choudhury()))
        .chain([0, 3].iter().map(|&at| (format!("{}, Kano's valve", CASES[at].name), CASES[at].kano())))
        .collect();
    let found = parallel(&loops, |(_, spec)| {
        let original = Original::new(spec.clone(), 1)?;
        let f = f_of(&original.diagnose(DIAGNOSED)).unwrap_or(0.0);
        let mut curve = Vec::with_capacity(STEPS + 1);
        for step in 0..=STEPS {
            let a = f * 2.0 * step as f64 / STEPS as f64;
            curve.push((a, spread(&original.ratios(a)?).unwrap_or([f64::NAN; 3])));
        }
        Ok((f, curve))
    });
    let found = found.into_iter().collect::<Result<Vec<(f64, Vec<(f64, [f64; 3])>)>, SpecError>>()?;
    let mut rows = Vec::new();
    let mut plots = Vec::new();
    for ((name, _), (f, curve)) in loops.iter().zip(found) {
        let column = |of: usize| -> Vec<(f64, f64)> { curve.iter().map(|p| (p.0, p.1[of])).collect() };
        let [low, curve, high] = [0, 1, 2].map(column);
        let least = curve.iter().copied().min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or_default();
        let at = |share: f64| curve.get((share * 0.5 * STEPS as f64).round() as usize).map(|p| p.1);
        rows.push(vec![
            Cell::text(name),
            Cell::Number(Some(f), Style::Fixed(3)),
            Cell::Number(Some(least.0), Style::Fixed(3)),
            Cell::Number(Some(least.0 / f), Style::Fixed(2)),
            Cell::Number(Some(least.1), Style::Power),
            Cell::Number(at(1.0), Style::Power),
            Cell::Number(at(0.9), Style::Power),
            Cell::Number(at(1.1), Style::Power),
            Cell::Number(at(2.0), Style::Power),
        ]);
        plots.push(Plot {
            title: name.clone(),
            x: "amplitude a [% OP]",
            panels: vec![Panel {
                y: "ISE / ISE without [-]",
                log: true,
                series: vec![
                    Series { name: "median".into(), class: "op", points: curve },
                    Series { name: "least, largest".into(), class: "sp", points: low },
                    Series { name: String::new(), class: "sp", points: high },
                ],
            }],
            marks: vec![(f, "f")],
        });
    }
    Ok(Section {
        id: "figure7",
        title: "Figure 7: ISE ratio against the amplitude".into(),
        text: vec![
            "The least ratio lies at a = f = S/2 in every loop: below it a reversal of 2a plus Δu does \
             not cross S and the valve \
             sticks on; above it every reversal overshoots by 2 (a - f). f comes from the diagnosis of the same loop."
                .into(),
            "Median, least and largest over 5 switch-on instants, in steps of 0.05 f: a noise-free flow \
             loop sometimes comes to rest on its set \
             point by accident, at any amplitude, and its ratio is then almost 0; the median shows what \
             the amplitude does."
                .into(),
        ],
        table: Some(Table {
            columns: vec![
                ("case", "loop"),
                ("f", "f [% OP]"),
                ("best_a", "a of the least ratio [% OP]"),
                ("best_a_over_f", "in f"),
                ("least", "least ratio"),
                ("at_f", "ratio at f"),
                ("at_0_9_f", "at 0.9 f"),
                ("at_1_1_f", "at 1.1 f"),
                ("at_2_f", "at 2 f"),
            ],
            rows,
        }),
        plots,
    })
}

/// Valve input and PV over time, constant reinforcement switched on.
struct Picture {
    title: String,
    spec: LoopSpec,
    f: f64,
    switch_s: f64,
    end_s: f64,
}

impl Picture {
    fn plot(&self) -> Result<Plot, SpecError> {
        let samples = |s: f64| (s / self.spec.ts_s).round() as usize;
        let (from, switch) = (WARM_UP, WARM_UP + samples(self.switch_s));
        let to = WARM_UP + samples(self.end_s);
        let trace = run(&self.spec, to, 1, switch, &mut *reinforcement(self.f, 0.0))?;
        let series = |name: &str, class, column: &[f64]| Series {
            name: name.into(),
            class,
            points: thin(&trace.points(column, from, to), POINTS),
        };
        Ok(Plot {
            title: self.title.clone(),
            x: "time [s]",
            panels: vec![
                Panel {
                    y: "valve input [%]",
                    log: false,
                    series: vec![
                        series("stem", "other", &trace.mv),
                        series("valve input", "op", &trace.input),
                    ],
                },
                Panel {
                    y: "PV [%]",
                    log: false,
                    series: vec![series("PV", "pv", &trace.pv), series("SP", "sp", &trace.sp)],
                },
            ],
            marks: vec![(self.switch_s, "CR on")],
        })
    }
}

fn pictures(id: &'static str, title: &str, text: &str, of: &[Picture]) -> Result<Section, SpecError> {
    let plots = parallel(of, Picture::plot).into_iter().collect::<Result<_, SpecError>>()?;
    Ok(Section { id, title: title.into(), text: vec![text.into()], table: None, plots })
}

fn picture(case: &Case, title: String, spec: LoopSpec) -> Picture {
    let (switch_s, end_s) = if case.level { (5000.0, 15_000.0) } else { (600.0, 2400.0) };
    Picture { title, spec, f: 0.5 * case.s, switch_s, end_s }
}

/// Figure 8: the four loops, switched on at 600 s and 5,000 s.
///
/// # Errors
/// [`SpecError`] where a loop's number makes no sense.
pub fn figure_8() -> Result<Section, SpecError> {
    let of: Vec<Picture> = CASES.iter().map(|c| picture(c, c.name.into(), c.choudhury())).collect();
    let text = "Time counts from 1,000 samples after the start, the cycle established. a = f; the flow \
    loops are switched on at \
                600 s, the level loops at 5,000 s, as in the paper. PV's swing collapses, the stem moves far more often: see \
                the comparison below for how much.";
    pictures("figure8", "Figure 8: valve input and PV before and with constant reinforcement", text, &of)
}

/// Figure 9: the strongly sticky level loop at 25 s and 100 s.
///
/// # Errors
/// [`SpecError`] where a loop's number makes no sense.
pub fn figure_9() -> Result<Section, SpecError> {
    let case = &CASES[3];
    let of = [25.0, 100.0].map(|ts_s| {
        picture(case, format!("{}, sample period {ts_s} s", case.name), LoopSpec { ts_s, ..case.choudhury() })
    });
    let text = "Controller and reinforcement both run at the period given; switched on at 5,000 s.";
    pictures("figure9", "Figure 9: sample period", text, &of)
}

/// Figure 10: the strongly sticky level loop under noise.
///
/// # Errors
/// [`SpecError`] where a loop's number makes no sense.
pub fn figure_10() -> Result<Section, SpecError> {
    let case = &CASES[3];
    let of = [1e-4, 2e-4, 3e-4].map(|power| Picture {
        switch_s: 10_000.0,
        end_s: 20_000.0,
        ..picture(
            case,
            format!("{}, noise power {power:.4}", case.name),
            noisy(case, power, NOISE_SAMPLE_TIME),
        )
    });
    let text = "Band-limited white noise in the transmitter, sample time 0.1 s; the paper's rule, no dead \
    band; switched on at \
                10,000 s.";
    pictures("figure10", "Figure 10: measurement noise", text, &of)
}

/// Figure 11: Kano's valve.
///
/// # Errors
/// [`SpecError`] where a loop's number makes no sense.
pub fn figure_11() -> Result<Section, SpecError> {
    let of = [&CASES[0], &CASES[3]].map(|c| picture(c, format!("{}, Kano's valve", c.name), c.kano()));
    let text = "With the same S, J and resolution Kano's forces move the stem as Choudhury's chart does, \
    so these are figure 8's \
                curves: the comparison is one of two descriptions, not of two valves. Choudhury's chart read \
                to the letter does differ: see the open choices.";
    pictures("figure11", "Figure 11: Kano's valve", text, &of)
}
