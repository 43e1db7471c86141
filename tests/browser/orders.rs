//! A work list in which every loop has an order, for how fast the page is.

use std::sync::Arc;
use stictiond::indicators::distribution::distribution;
use stictiond::indicators::harris::Harris;
use stictiond::indicators::margins::Margins;
use stictiond::indicators::oscillation::Oscillation;
use stictiond::indicators::series::{COUNT, Values};
use stictiond::indicators::settling::Settling;
use stictiond::plantwide::Cause;
use stictiond::serve::{Health, LoopLook, Overview, PlantwidePort, Standing, WorkLine};
use stictiond::signal::LoopId;
use stictiond::work::order::Look;
use stictiond::work::{Act, Measure, Order, Refusal, State};

/// An order for each of these loops, five victims each.
pub struct Orders(pub Vec<LoopId>);

impl PlantwidePort for Orders {
    fn overview(&self) -> Option<Arc<Overview>> {
        None
    }

    fn look(&self) -> bool {
        false
    }

    fn work(&self) -> Vec<WorkLine> {
        let line = |(at, id): (usize, &LoopId)| {
            let victims = self.0.iter().cycle().skip(at + 1).take(5).cloned().collect();
            let why = "it swings with five others at 41 s, and its valve sticks".to_string();
            let why = Some((Cause::Valve, why));
            let (cause, measure) = (Some((Cause::Valve, Some(0.9))), Measure::default());
            let looks = [Look { at: 0.0, from: 0.0, cause, worth: 1.0, measure }].into();
            let order = Order { state: State::Open, why, victims, looks, ..Order::new(id.clone(), 0.0) };
            WorkLine { order, cost: Some((at as f64, "EUR/day".into())) }
        };
        self.0.iter().enumerate().map(line).collect()
    }

    fn act(
        &self,
        _: &LoopId,
        _: Act,
        _: Option<String>,
        _: Option<String>,
    ) -> Option<Result<WorkLine, Refusal>> {
        None
    }

    fn latest(&self, _: &LoopId) -> Option<Values> {
        None
    }

    /// One loop was looked at once.
    fn health(&self, id: &LoopId) -> Option<Health> {
        let looks = vec![(0.0, [Some(0.75); COUNT])];
        let swing = |period_s| Oscillation {
            period_s,
            regularity: 2.5,
            lasting: 0.75,
            share: 0.5,
            share_of_fast: 0.5,
            steadiness: 1.0,
            periods: 20.0,
            amplitude: 1.5,
        };
        let last = LoopLook {
            at: 0.0,
            harris: Some(Harris { index: 0.75, interval: Some((0.5, 0.875)) }),
            dead_time_s: Some(20.0),
            settling: Some(Settling { steps: 4, settled: 3, time_s: Some(42.0), overshoot: 0.125 }),
            oscillations: vec![swing(60.0), swing(600.0)],
            distribution: distribution(&[40.0, 50.0, 60.0], (0.0, 100.0)),
            margins: Some(Margins {
                gain: Some(1.3),
                phase_deg: Some(17.0),
                phase_crossover_s: Some(50.0),
                gain_crossover_s: Some(60.0),
            }),
        };
        let is_own = id.as_str() == "FIC00008";
        is_own.then(|| Health { looks, days: Vec::new(), last: Some(last) })
    }

    /// The loop number n scores 5 n, the seventh is not judged, and the swing of every fourth costs 10 n.
    fn standing(&self, id: &LoopId) -> Standing {
        let number = id.as_str().trim_start_matches(|c: char| !c.is_ascii_digit()).parse::<u32>();
        let n = number.unwrap_or(0) % 20;
        let score = (n != 7).then(|| f64::from(5 * n));
        Standing { score, cost: (n % 4 == 0).then(|| (f64::from(10 * n), "EUR/day".into())) }
    }
}
