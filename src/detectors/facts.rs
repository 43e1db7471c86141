//! The properties of a window that every method needs, computed once.

use super::half_cycles::Cycles;
use super::integration::{Integrates, Integration, Signals, integration};
use super::oscillation::{Cycle, REGULAR, cycle};
use crate::diagnosis::region::{self, Region};
use crate::diagnosis::{NotIdentifiable, Verdict};
use crate::signal::{Window, beside, share_beside};
use crate::sysid::stats::{mean, normalised, sd};
use crate::sysid::valve::Start;

/// Fewest samples of a window.
const LEAST_SAMPLES: usize = 100;
/// Most samples: of a longer window the stretch with the most regular oscillation is used.
const MOST_SAMPLES: usize = 4000;
/// Shortest period whose shape can be recognised (samples).
const SHORTEST_PERIOD: f64 = 10.0;
/// Largest share of rows that were not measured at which the shape of a cycle can be recognised (-). Their values come from a linear
/// model, which makes sines of all shapes. A tenth of them moves He's index, which is 0 for a sine and 1 for a triangle, by at most
/// half of the distance between his thresholds.
const MOST_MISSING: f64 = 0.1;

/// A window with its normalised signals and the properties that all methods use.
#[derive(Clone, Debug)]
pub struct Facts<'a> {
    /// The window, or its most regular stretch.
    pub window: std::borrow::Cow<'a, Window>,
    /// OP as deviation from its mean, in its standard deviations.
    pub u: Vec<f64>,
    /// PV, normalised likewise.
    pub y: Vec<f64>,
    /// The measured stem, normalised likewise, where there is one that moves.
    pub stem: Option<Vec<f64>>,
    /// Standard deviation of OP (OP unit).
    pub unit: f64,
    /// The extrema and zero crossings of OP.
    pub region: Region,
    /// The extremum of OP from which a stem is simulated.
    pub start: Start,
    /// The oscillation of OP, where there is one; it may be irregular.
    pub oscillation: Option<Cycle>,
    /// Whether the process integrates.
    pub integration: Integration,
    /// Half cycles of OP; none where OP does not oscillate regularly.
    pub op: Cycles,
    /// Half cycles of PV; likewise.
    pub pv: Cycles,
    /// The reason of the diagnosis, where it found the oscillation undersampled.
    pub undersampled: Option<String>,
}

impl<'a> Facts<'a> {
    /// The properties of a window. `integrates`: whether the process integrates, where that is known.
    ///
    /// # Errors
    /// The reason why no method can be used: the window is too short, its values are not finite or do not move, or it has no time base.
    pub fn new(window: &'a Window, integrates: Option<bool>) -> Result<Self, String> {
        let window = usable(window)?;
        let (u, unit) = normal(&window.op).ok_or("OP does not move")?;
        let (y, _) = normal(&window.pv).ok_or("PV does not move")?;
        let n = u.len();
        let stem = window.mv.as_ref().filter(|mv| mv.len() == n).and_then(|mv| Some(normal(mv)?.0));
        let region = region::analyse(&u);
        let start = region::start_of(&region, &u, 0, n / 2).unwrap_or_default();
        // Noise spoils the zero crossings of OP, and few periods those of its autocovariance: the more regular ones are used.
        let by_op = region.oscillation(0, n, 1.0);
        let by_op = by_op.map(|found| Cycle { period: found.period, regularity: found.regularity_r });
        let by_covariance = region.typical_period().and_then(|typical| cycle(&u, typical));
        let oscillation =
            by_op.into_iter().chain(by_covariance).max_by(|a, b| a.regularity.total_cmp(&b.regularity));
        let mut facts = Self {
            window,
            u,
            y,
            stem,
            unit,
            region,
            start,
            oscillation,
            integration: Integration::default(),
            op: Cycles::default(),
            pv: Cycles::default(),
            undersampled: None,
        };
        let signals = Signals {
            u: &facts.u,
            y: &facts.y,
            stem: facts.stem.as_deref(),
            start: facts.start,
            period: facts.oscillates().ok(),
        };
        facts.integration = integration(&signals, integrates);
        if let Ok(period) = facts.oscillates() {
            (facts.op, facts.pv) = (Cycles::new(&facts.u, period), Cycles::new(&facts.y, period));
        }
        Ok(facts)
    }

    /// The same with what the diagnosis found: in an undersampled window OP has no shape, whatever its samples look like.
    #[must_use]
    pub fn with_verdict(mut self, verdict: &Verdict) -> Self {
        if let Verdict::NotIdentifiable(why @ NotIdentifiable::Undersampled { .. }) = verdict {
            self.undersampled = Some(why.to_string());
        }
        self
    }

    /// The period of a regular oscillation (samples).
    ///
    /// # Errors
    /// The reason why there is none: no oscillation, an irregular one, or one with too few samples in a period.
    pub fn oscillates(&self) -> Result<f64, String> {
        let Some(found) = self.oscillation else { return Err("OP does not oscillate".into()) };
        let Cycle { period, regularity } = found;
        if regularity <= REGULAR {
            return Err(format!(
                "OP oscillates irregularly: r is {} at best, and more than {REGULAR} is regular",
                beside(regularity, &[REGULAR], 2)
            ));
        }
        if period < SHORTEST_PERIOD {
            return Err(format!("a period is {period:.1} samples, too few to see a shape"));
        }
        Ok(period)
    }

    /// Whether enough rows were measured for a method that cannot leave rows out.
    ///
    /// # Errors
    /// The reason, with the share of rows that are missing.
    pub fn measured(&self) -> Result<(), String> {
        let missing = self.window.missing();
        if missing > MOST_MISSING {
            return Err(format!(
                "{} of the samples are missing, and this method cannot leave them out",
                share_beside(missing, &[MOST_MISSING], 0)
            ));
        }
        Ok(())
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.u.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.u.is_empty()
    }

    /// The name and the values of the measured stem, or of PV in place of it (standard deviations). PV takes its place where the process
    /// does not integrate, as in flow loops.
    ///
    /// # Errors
    /// The reason why PV cannot take the place of a stem that is not measured.
    pub fn stem_or_pv(&self) -> Result<(&'static str, &[f64]), String> {
        match (&self.stem, self.integration.answer) {
            (Some(stem), _) => Ok(("the measured stem", stem)),
            (None, Integrates::No) => Ok(("PV", &self.y)),
            (None, Integrates::Yes) => Err("the process integrates: PV does not stand for the stem".into()),
            (None, Integrates::Unknown) => Err(self.integration.why()),
        }
    }

    /// Range of OP (standard deviations of OP).
    pub fn op_range(&self) -> f64 {
        let (low, high) = crate::sysid::stats::range(&self.u);
        high - low
    }
}

/// The window, or its most regular stretch.
fn usable(window: &Window) -> Result<std::borrow::Cow<'_, Window>, String> {
    use std::borrow::Cow::{Borrowed, Owned};
    let n = window.op.len();
    if n < LEAST_SAMPLES || window.pv.len() != n {
        return Err(format!("{n} samples, {LEAST_SAMPLES} are needed"));
    }
    let finite = |v: &[f64]| v.iter().all(|x| x.is_finite());
    if !(window.ts.is_finite() && window.ts > 0.0) {
        return Err("no time base".into());
    }
    let measured = window.mv.as_deref().unwrap_or_default();
    if !finite(&window.op) || !finite(&window.pv) || !finite(measured) {
        return Err("values that are not finite".into());
    }
    let whole = |v: &Option<Vec<f64>>| v.as_ref().is_none_or(|v| v.len() == n);
    if !whole(&window.sp) || !whole(&window.mv) || window.tags.iter().any(|(_, v)| v.len() != n) {
        return Err("tags of unequal length".into());
    }
    if n <= MOST_SAMPLES {
        return Ok(Borrowed(window));
    }
    let from = region::analyse(&window.op).most_regular(n, MOST_SAMPLES);
    Ok(Owned(window.slice(from, from + MOST_SAMPLES)))
}

/// A signal with zero mean and unit variance, and its standard deviation; `None` where it does not move.
fn normal(v: &[f64]) -> Option<(Vec<f64>, f64)> {
    let (m, s) = (mean(v), sd(v));
    // A spread as small as rounding is no movement.
    let moves = s.is_finite() && s > 1e-12 * m.abs().max(f64::MIN_POSITIVE);
    moves.then(|| (normalised(v, m, s), s))
}

#[cfg(test)]
mod tests {
    use super::super::{Method, Says, opinion, picture};
    use super::*;
    use crate::signal::Row;
    use std::f64::consts::TAU;

    #[test]
    fn what_was_not_measured_has_no_shape() {
        let wave = |phase: f64| -> Vec<f64> {
            (0..960).map(|k| (TAU * f64::from(k) / 60.0 + phase).sin()).collect()
        };
        let lost = |every: usize| -> Vec<Row> {
            (0..960).map(|k| if k % every == 0 { Row::Missing } else { Row::Counts }).collect()
        };
        let says = |method, rows| {
            let window = Window { ts: 1.0, op: wave(0.0), pv: wave(3.0), rows, ..Window::default() };
            let facts = Facts::new(&window, Some(false)).expect("both move");
            assert!(facts.measured().is_ok() || picture(Method::He2007, &facts).is_empty());
            opinion(method, &facts)
        };
        // One row in twelve, and one in six.
        assert_eq!(says(Method::He2007, lost(12)).says, Says::Sound);
        let found = says(Method::He2007, lost(6));
        assert_eq!(found.says, Says::CannotTell);
        assert!(found.why.starts_with("17 % of the samples are missing"), "{found:?}");
        // The program's own fit of d leaves such rows out.
        assert!(!says(Method::Srinivasan2005D, lost(6)).why.contains("missing"));
    }

    #[test]
    fn an_irregular_swing_is_told_beside_what_is_regular() {
        let wave = |phase: f64| -> Vec<f64> {
            (0..960).map(|k| (TAU * f64::from(k) / 60.0 + phase).sin()).collect()
        };
        let window = Window { ts: 1.0, op: wave(0.0), pv: wave(3.0), ..Window::default() };
        let mut facts = Facts::new(&window, Some(false)).expect("both move");
        facts.oscillation = Some(Cycle { period: 60.0, regularity: 0.594 });
        let said = "OP oscillates irregularly: r is 0.59 at best, and more than 1 is regular";
        assert_eq!(facts.oscillates(), Err(said.to_string()));
        facts.oscillation = Some(Cycle { period: 60.0, regularity: 0.998 });
        let said = "OP oscillates irregularly: r is 0.998 at best, and more than 1 is regular";
        assert_eq!(facts.oscillates(), Err(said.to_string()));
    }

    #[test]
    fn in_an_undersampled_window_only_a_measured_stem_is_compared() {
        let wave = |phase: f64| -> Vec<f64> {
            (0..960).map(|k| (TAU * f64::from(k) / 60.0 + phase).sin()).collect()
        };
        let window =
            Window { ts: 1.0, op: wave(0.0), pv: wave(3.0), mv: Some(wave(0.0)), ..Window::default() };
        let facts = Facts::new(&window, Some(false)).expect("both move");
        let why = NotIdentifiable::Undersampled { samples: 2.2, poll_s: Some(39.0), mean_s: None };
        let said = why.to_string();
        let undersampled = facts.clone().with_verdict(&Verdict::NotIdentifiable(why));
        for method in Method::ALL {
            let found = opinion(method, &undersampled);
            if method == Method::StemLoop {
                assert_eq!(found, opinion(method, &facts));
                continue;
            }
            assert_eq!((found.says, &found.why), (Says::CannotTell, &said), "{method:?}");
            assert!(picture(method, &undersampled).is_empty(), "{method:?}");
        }
        // Other verdicts change nothing.
        let other = facts.clone().with_verdict(&Verdict::NotIdentifiable(NotIdentifiable::FlatPv));
        assert_eq!(opinion(Method::He2007, &other), opinion(Method::He2007, &facts));
        assert_eq!(opinion(Method::He2007, &facts).says, Says::Sound);
    }
}
