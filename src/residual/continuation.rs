//! The one-step errors behind the end of a record, on samples that chose nothing.
//!
//! The held-out samples of a record also reject effects ([`super::rejection`]), so that the errors published on them are those of
//! a model that they helped to choose. Where the same loop was recorded for longer, the samples behind the end of the record
//! neither fitted nor chose anything:
//!
//! ```text
//! | record                                       | continuation
//! | fitted, first 80 %        | held out, 20 %   | predicted only
//! ```
//!
//! The models go on as they say: a load that stepped stays, a wave and a drift go on, and so does friction that changes.

use super::findings::Findings;
use super::fit::Fitted;
use super::held_out::one_step_rmse;
use super::report::Report;
use super::settings::Settings;
use super::trace::trace;
use super::window::{settings_of, window_of};
use crate::diagnosis::gate::gate;
use crate::diagnosis::{self, Diagnosis};
use crate::signal::{Record, Row, Window};
use crate::sysid::iddata::IdData;
use crate::sysid::stats::{mean, normalised, sd};

/// What tracing finds on a record, and the errors of its models behind the end of the record.
#[derive(Clone, Debug, PartialEq)]
pub struct Continuation {
    /// The findings on the record alone, as [`super::trace_record`] has them.
    pub findings: Findings,
    /// Root mean square one-step error on the continuation (PV unit): of the declared model, and of the model with the effects.
    pub one_step_rmse: [f64; 2],
}

/// Traces a record, and predicts what the same loop did afterwards with the models before and after.
///
/// Faults of the data are looked for in the record alone: a wrong sample of the continuation counts in its errors.
///
/// * `record`: what is diagnosed and traced.
/// * `longer`: a record that begins with the samples of `record` and goes on.
/// * `diagnosis`: the diagnosis of `record`.
///
/// `None` where nothing can be traced, and where the window of `longer` does not begin with that of `record`: a record of more
/// than 2,000 rows is cut to a stretch.
pub fn trace_continued(
    record: &Record,
    longer: &Record,
    diagnosis: &Diagnosis,
    diagnosed: &diagnosis::Settings,
    settings: &Settings,
) -> Option<Continuation> {
    let of = |record: &Record| window_of(&gate(record, diagnosed), diagnosis);
    let (traced, whole) = (of(record)?, of(longer)?);
    if !goes_on(&traced, &whole) {
        return None;
    }
    let covered = diagnosis.window.as_ref().unwrap_or(&traced);
    let settings = settings_of(record, [&traced, covered], diagnosed, settings);
    let Report { findings, before, after } = trace(&traced, diagnosis, &settings)?;
    let error = |(data, fitted): &(IdData, Fitted)| {
        let longer = continued(data, &whole)?;
        Some(one_step_rmse(&longer, fitted, data.len()..longer.len()))
    };
    Some(Continuation { findings, one_step_rmse: [error(&before)?, error(&after)?] })
}

/// Whether a longer window begins with the rows of this one. The last rows of a thinned-out window are not compared: its filter
/// ends there.
fn goes_on(window: &Window, longer: &Window) -> bool {
    let half = window.len() / 2;
    longer.len() > window.len()
        && (longer.t0 - window.t0).abs() < 0.5 * window.ts
        && longer.op.starts_with(&window.op[..half])
        && longer.pv.starts_with(&window.pv[..half])
}

/// The record that was fitted, with the rows behind its end appended in its own units; `None` where `longer` lacks one of its
/// tags. Its rows stay as they are, repaired ones too. The set point is left out, because no model predicts PV from it.
fn continued(data: &IdData, longer: &Window) -> Option<IdData> {
    let (n, units) = (data.len(), &data.units);
    let append = |own: &[f64], whole: &[f64], [centre, spread]: [f64; 2]| -> Option<Vec<f64>> {
        let rest = normalised(whole.get(n..)?, centre, spread);
        Some(own.iter().copied().chain(rest).collect())
    };
    let tag = |(name, own): &(String, Vec<f64>)| {
        let (_, whole) = longer.tags.iter().find(|tag| tag.0 == *name)?;
        let recorded = whole.get(..n)?;
        Some((name.clone(), append(own, whole, [mean(recorded), sd(recorded)])?))
    };
    let rest: Vec<Row> = (n..longer.len()).map(|k| longer.row(k)).collect();
    let weight = rest.iter().map(|row| f64::from(u8::from(*row == Row::Counts)));
    let known = rest.iter().map(|row| *row == Row::Silent);
    Some(IdData {
        u: append(&data.u, &longer.op, [units.u0, units.u])?,
        y: append(&data.y, &longer.pv, [units.y0, units.y])?,
        weight: data.weight.iter().copied().chain(weight).collect(),
        known: data.known.iter().copied().chain(known).collect(),
        tags: data.tags.iter().map(tag).collect::<Option<_>>()?,
        sp: None,
        ..data.clone()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::diagnose;
    use crate::residual::findings::Kind;
    use crate::residual::fit::{fit_base, fit_near};
    use crate::residual::hypotheses::ALL;
    use crate::residual::hypothesis::Hypothesis;
    use crate::residual::screening::Screen;
    use crate::residual::tests::sticking;
    use crate::residual::trace_record;
    use crate::sysid::valve::{Start, ValveModel};
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// A lag behind a dead band of 2, whose PV a tag drives, too.
    fn window(n: usize) -> Window {
        let mut draw = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(5));
        let mut next = || -> f64 { draw.next().unwrap_or(0.0) };
        let swing = |k: usize| 3.0 * (0.055 * k as f64).sin() + 2.0 * (0.0215 * k as f64).cos();
        let op: Vec<f64> = (0..n).map(|k| 50.0 + swing(k) + 0.02 * next()).collect();
        let tag: Vec<f64> = (0..n).map(|_| 7.0 + 3.0 * next()).collect();
        let (mut y, mut stem, mut pv) = (0.0, 0.0f64, vec![20.0; n]);
        for k in 3..n {
            stem = stem.clamp(op[k - 1] - 51.0, op[k - 1] - 49.0);
            y = 0.8 * y + 0.2 * stem + 0.02 * (tag[k - 3] - 7.0);
            pv[k] = 20.0 + y + 0.1 * next();
        }
        Window { t0: 0.0, ts: 1.0, op, pv, tags: vec![("upstream".to_string(), tag)], ..Window::default() }
    }

    /// So many of the first samples of a record.
    fn first(record: &Record, n: usize) -> Record {
        Record { op: record.op[..n].to_vec(), pv: record.pv[..n].to_vec(), ..record.clone() }
    }

    #[test]
    fn no_effect_is_another_where_the_record_goes_on() {
        let longer = window(900);
        let data = IdData::new(&longer.slice(0, 700), Start { index: 0, is_max: true }).expect("long enough");
        let whole = continued(&data, &longer).expect("it has the tag");
        assert_eq!((whole.len(), whole.split, whole.units), (900, data.split, data.units));
        assert_eq!((&whole.u[..700], &whole.y[..700]), (&data.u[..], &data.y[..]));
        let s = 2.0 / data.units.u;
        let valve = Some(ValveModel { s, j: s, ..ValveModel::default() });
        let base = fit_base(&data, Hypothesis { valve, effects: Vec::new() });
        let screen = Screen::new(&data, &base);
        let mut kinds = Vec::new();
        for proposal in ALL.iter().flat_map(|kind| kind.propose(&screen)) {
            let hypothesis = base.hypothesis.with(proposal.effect);
            kinds.extend(hypothesis.effects.iter().map(|effect| effect.kind()));
            let (own, on) = (hypothesis.signals(&data), hypothesis.signals(&whole));
            assert!(on.x.len() == 900 && on.x.starts_with(&own.x), "{hypothesis:?}");
            assert!(on.offset.starts_with(&own.offset), "{hypothesis:?}");
            assert_eq!(on.shapes.len(), own.shapes.len());
            for (on, own) in on.shapes.iter().zip(&own.shapes) {
                assert!(on.len() == 900 && on.starts_with(own), "{hypothesis:?}");
            }
            let fitted = fit_near(&data, hypothesis, &base.model, 2);
            let held_out = data.split..data.len();
            let [short, long] = [&data, &whole].map(|data| one_step_rmse(data, &fitted, held_out.clone()));
            assert_eq!(short.to_bits(), long.to_bits(), "{:?}", fitted.hypothesis);
        }
        for kind in [Kind::Drift, Kind::LoadStep, Kind::MeasuredDisturbance, Kind::OscillatingLoad] {
            assert!(kinds.contains(&kind), "{kind} is not proposed: {kinds:?}");
        }
    }

    #[test]
    fn an_error_behind_the_record_counts_there_only() {
        let mut longer = window(900);
        let data = IdData::new(&longer.slice(0, 700), Start { index: 0, is_max: true }).expect("long enough");
        let fitted = fit_base(&data, Hypothesis::default());
        let errors = |longer: &Window| {
            let whole = continued(&data, longer).expect("it has the tag");
            [data.split..700, 700..900].map(|rows| one_step_rmse(&whole, &fitted, rows))
        };
        let [held_out, behind] = errors(&longer);
        longer.pv[800] += 50.0;
        let [same, worse] = errors(&longer);
        assert!(same == held_out && worse > 2.0 * behind, "{held_out} {same}, {behind} {worse}");
    }

    #[test]
    fn a_window_that_begins_otherwise_is_no_continuation() {
        let longer = window(900);
        let record = longer.slice(0, 700);
        assert!(goes_on(&record, &longer));
        assert!(!goes_on(&longer, &longer) && !goes_on(&longer, &record), "there is nothing behind it");
        assert!(!goes_on(&longer.slice(1, 701), &longer), "it begins later");
        let mut other = longer.clone();
        other.pv[10] += 1.0;
        assert!(!goes_on(&record, &other));
        let data = IdData::new(&record, Start { index: 0, is_max: true }).expect("long enough");
        assert!(continued(&data, &Window { tags: Vec::new(), ..longer }).is_none(), "its tag is missing");
    }

    #[test]
    fn the_findings_are_those_of_the_record_and_the_errors_those_behind_it() {
        let longer = sticking(840, 1.0);
        let record = first(&longer, 700);
        let (diagnosed, settings) = (diagnosis::Settings::default(), Settings::default());
        let found = diagnose(&record, &diagnosed);
        let alone = trace_record(&record, &found, &diagnosed, &settings).expect("it is traced");
        let on = |longer: &Record| trace_continued(&record, longer, &found, &diagnosed, &settings);
        let continued = on(&longer).expect("it goes on");
        assert_eq!((&continued.findings.before, &continued.findings.after), (&alone.before, &alone.after));
        let [before, after] = continued.one_step_rmse;
        let published = [alone.before.one_step_rmse, alone.after.one_step_rmse];
        for (behind, published) in [before, after].iter().zip(published) {
            assert!((0.5..2.0).contains(&(behind / published)), "{behind} {published}");
        }
        assert_eq!(on(&record), None, "nothing is behind its end");
    }
}
