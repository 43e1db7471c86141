//! Constant reinforcement against its rivals: what each gains, and what it costs the valve.

use super::bench::{
    CASES, Case, Idle, Original, SETTLED_FROM, SETTLED_TO, Trace, WARM_UP, f_of, parallel, reinforcement,
};
use super::report::{Cell, Section, Style, Table};
use super::srinivasan::best_d;
use super::tables::{D_WINDOW, DEAD_BAND, DIAGNOSED, NOISE_SAMPLE_TIME, noisy, op_noise};
use crate::compensation::{BacklashInverse, Compensator, Knocker};
use crate::diagnosis::without_model_error;
use crate::sim::SpecError;

/// Amplitudes searched, in f.
const AMPLITUDES: [f64; 9] = [0.25, 0.5, 0.75, 0.9, 1.0, 1.1, 1.25, 1.5, 2.0];
/// Pulse widths searched [samples].
const WIDTHS: [f64; 4] = [1.0, 2.0, 3.0, 5.0];
/// Pauses between two pulses searched [samples]; a knocker without pause is constant reinforcement.
const PAUSES: [f64; 5] = [1.0, 2.0, 4.0, 8.0, 15.0];
/// The noise of the noisy half, as in Table 5's first row [%² s].
const POWER: f64 = 1e-4;

/// Every rival on the four loops.
///
/// # Errors
/// [`SpecError`] where a loop's number makes no sense.
pub fn contest(noise: bool) -> Result<Section, SpecError> {
    let found = parallel(&CASES, |case| one_loop(case, noise));
    let rows = found.into_iter().collect::<Result<Vec<_>, SpecError>>()?.into_iter().flatten().collect();
    let mut text = vec![
        format!(
            "Over the settled span, samples {SETTLED_FROM} to {SETTLED_TO} after the switch-on. Travel \
             and reversals are the stem's; \
             \"× none\" is travel over that of the loop without a compensator. Settled: the time from the \
             switch-on until |SP - PV| \
             stays within a tenth of the cycle's peak{}; \"–\" when it never does.",
            if noise { " and four sd of the noise" } else { "" }
        ),
        "What it costs: the stem of a cycling loop jumps twice a cycle; with constant reinforcement it \
         moves every sample or two. Nothing \
         here is a cure, and a valve that cycles at every controller execution wears out accordingly."
            .into(),
    ];
    if noise {
        text.push(format!(
            "Band-limited noise of power {POWER:.0e}, sample time {NOISE_SAMPLE_TIME} s, in PV as \
             measured; the ISE cannot fall below the noise's own. The dead band is {DEAD_BAND} sd of OP's noise from \
             sample to sample. \"no f\": not identifiable under this noise, so that a is S/2. The weakly sticky \
             loops show where reinforcement ends: once noise alone moves OP by f, the valve is dithered by its \
             own controller and little is left to gain, and a method with a travel of 0 has only met a loop at rest."
        ));
        text.push(
            "An amplitude a little below S/2 costs far more than one a little above (figure 7: a cliff on \
             one side, a slope on the other). The upper end of f's interval in place of f gains where f came out short, \
             and costs travel where it did not."
                .into(),
        );
    } else {
        text.push(
            "Knocker: width 2 and period 5 samples, the upper ends of Hägglund's ranges, with \
             Srinivasan's d of the same loop as \
             its amplitude, whole and halved, since citations differ; \"own best\" is the least ISE over \
             amplitude, \
             width and pause, at least one sample of pause: without a pause it is constant reinforcement, and that is where the search would \
             end, as the paper found. Backlash inverse: its amplitude is half the dead band, (S - J)/2, \
             which has to be known; \"own \
             best\" by search."
                .into(),
        );
        text.push(
            "The two-move method (Srinivasan & Rengaswamy 2008) was left out: it holds the stem against \
             the controller at an OP that has to be \
             known beforehand, so it controls no load, and is not a term beside a controller at work."
                .into(),
        );
    }
    Ok(Section {
        id: if noise { "rivals_noise" } else { "rivals" },
        title: if noise { "Rivals under measurement noise" } else { "Rivals, noise-free" }.into(),
        text,
        table: Some(Table {
            columns: vec![
                ("case", "loop"),
                ("method", "method"),
                ("settings", "settings"),
                ("ratio", "ISE ratio"),
                ("travel_per_h", "travel [%/h]"),
                ("travel_ratio", "× none"),
                ("reversals_per_h", "reversals [1/h]"),
                ("settled_s", "settled [s]"),
            ],
            rows,
        }),
        ..Section::default()
    })
}

fn one_loop(case: &Case, noise: bool) -> Result<Vec<Vec<Cell>>, SpecError> {
    let spec = if noise { noisy(case, POWER, NOISE_SAMPLE_TIME) } else { case.choudhury() };
    let original = Original::new(spec, 1)?;
    let diagnosis = original.diagnose(DIAGNOSED);
    // Noise can hide the cycle and with it f; the comparison then takes what is true of the valve.
    let found = f_of(&diagnosis).filter(|f| *f > 0.0);
    let f = found.unwrap_or(0.5 * case.s);
    let named = if found.is_some() { "CR, a = f" } else { "CR, a = S/2 (no f)" };
    let window = WARM_UP..WARM_UP + D_WINDOW;
    let d = best_d(&original.trace.op[window.clone()], &original.trace.pv[window]).filter(|d| *d > 0.0);
    let ts = original.spec.ts_s;
    let mut arena = Arena { case, original: &original, rows: Vec::new() };
    arena.enter("none", String::new(), &mut Idle)?;
    arena.enter(named, format!("a {f:.2}"), &mut *reinforcement(f, 0.0))?;
    if noise {
        let band = DEAD_BAND * op_noise(&original.spec);
        let settings = format!("a {f:.2}, dead band {band:.2}");
        arena.enter(&format!("{named}, dead band"), settings, &mut *reinforcement(f, band))?;
        // The paper's valve is one of the models, so f has no error of the models.
        let upper = diagnosis.estimate.as_ref().map(|e| without_model_error(e.f, e.f_ci95)[1]);
        let upper = upper.filter(|_| found.is_some());
        if let Some(upper) = upper {
            let settings = format!("a {upper:.2}");
            arena.enter(
                "CR, a = upper end of the interval of f",
                settings,
                &mut *reinforcement(upper, 0.0),
            )?;
        }
    }
    let amplitudes = AMPLITUDES.map(|share| share * f);
    let a = best(&original, &amplitudes, |a| reinforcement(*a, 0.0))?;
    arena.enter("CR, own best", format!("a {a:.2}"), &mut *reinforcement(a, 0.0))?;
    for (name, a) in d.map_or(Vec::new(), |d| vec![("knocker, d", d), ("knocker, d/2", 0.5 * d)]) {
        arena.enter(name, knock(a, 2.0, 5.0), &mut Knocker::new(a, 2.0 * ts, 5.0 * ts))?;
    }
    let mut knockers = Vec::new();
    for share in AMPLITUDES {
        for width in WIDTHS {
            knockers.extend(PAUSES.map(|pause| (share * f, width, width + pause)));
        }
    }
    let build = |&(a, width, period): &(f64, f64, f64)| -> Box<dyn Compensator> {
        Box::new(Knocker::new(a, width * ts, period * ts))
    };
    let (a, width, period) = best(&original, &knockers, build)?;
    arena.enter("knocker, own best", knock(a, width, period), &mut *build(&(a, width, period)))?;
    let half = 0.5 * (case.s - case.j);
    arena.enter("backlash inverse", format!("a {half:.2}"), &mut BacklashInverse::new(half))?;
    let a = best(&original, &amplitudes, |a| Box::new(BacklashInverse::new(*a)))?;
    arena.enter("backlash inverse, own best", format!("a {a:.2}"), &mut BacklashInverse::new(a))?;
    Ok(arena.rows)
}

fn knock(a: f64, width: f64, period: f64) -> String {
    format!("a {a:.2}, width {width}, period {period}")
}

/// The candidate with the least ISE over the settled span.
fn best<C: Copy + Default>(
    original: &Original,
    candidates: &[C],
    build: impl Fn(&C) -> Box<dyn Compensator>,
) -> Result<C, SpecError> {
    let mut best = (f64::INFINITY, C::default());
    for candidate in candidates {
        let trace = original.with(&mut *build(candidate))?;
        let ise = trace.ise(WARM_UP + SETTLED_FROM, WARM_UP + SETTLED_TO);
        if ise < best.0 {
            best = (ise, *candidate);
        }
    }
    Ok(best.1)
}

/// One loop and what entered on it so far.
struct Arena<'a> {
    case: &'a Case,
    original: &'a Original,
    rows: Vec<Vec<Cell>>,
}

impl Arena<'_> {
    fn enter(
        &mut self,
        name: &str,
        settings: String,
        compensator: &mut dyn Compensator,
    ) -> Result<(), SpecError> {
        let trace = self.original.with(compensator)?;
        let span = |t: &Trace| t.measure(WARM_UP + SETTLED_FROM, WARM_UP + SETTLED_TO);
        let (own, with) = (span(&self.original.trace), span(&trace));
        let peak = self.original.trace.peak(WARM_UP + SETTLED_FROM, WARM_UP + SETTLED_TO);
        let noise_sd =
            self.original.spec.sensor.band_limited.map_or(0.0, |b| (b.power / b.sample_time_s).sqrt());
        self.rows.push(vec![
            Cell::text(self.case.name),
            Cell::text(name),
            Cell::Text(settings),
            Cell::Number(self.original.settled_ratio(&trace), Style::Power),
            Cell::Number(Some(with.travel), Style::Fixed(1)),
            Cell::Number((own.travel > 0.0).then(|| with.travel / own.travel), Style::Fixed(1)),
            Cell::Number(Some(with.reversals), Style::Fixed(1)),
            Cell::Number(trace.settle(WARM_UP, 0.1 * peak + 4.0 * noise_sd), Style::Fixed(0)),
        ]);
        Ok(())
    }
}
