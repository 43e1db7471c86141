//! What tracing says of a case, beside what is true.

use super::generators::{Case, Generator};
use stictiond_numerics::diagnosis::{self, Verdict, diagnose};
use stictiond_numerics::residual::{self, Effect, Evidence, Findings, Kind, trace_record};

/// What was found on one case.
pub struct Judged {
    pub case: Case,
    /// The loop in words, and where it comes from.
    pub name: String,
    /// Effects in the order they were added, with their posteriors.
    pub named: Vec<(Kind, f64)>,
    /// Twice the log odds of each against none.
    pub evidence: Vec<f64>,
    /// The numbers of each.
    pub numbers: Vec<String>,
    /// Effects that are no facts of the signals, named or rejected, with what speaks for them.
    pub weighed: Vec<(Kind, Evidence, String)>,
    /// The kinds at the last step, none among them, with their posteriors.
    pub candidates: Vec<(Option<Kind>, f64)>,
    /// Whether the record was traced.
    pub is_traced: bool,
    /// Effects that are there beside the one asked for.
    pub also: Vec<Kind>,
    /// Whether a fit that is told the effect and the true friction names it, among whatever else it names; asked of every effect,
    /// found or missed.
    pub identifiable: Option<bool>,
    /// Whether the verdict with the effects is stiction.
    pub sticks: bool,
    /// Whether it is none.
    pub denied: bool,
    /// True f, and that with the effects with its interval (% OP).
    pub f_true: f64,
    pub f: f64,
    pub ci: [f64; 2],
    /// J/S that is estimated with the effects; not a number without friction.
    pub ratio: f64,
    /// The published posterior of friction.
    pub friction: f64,
    /// Held-out errors one step ahead and free, before and after.
    pub one: [f64; 2],
    pub free: [f64; 2],
    pub simulates_worse: bool,
    /// What the load that was named is worth at the valve, as a share of what it truly is.
    pub size: Option<f64>,
}

/// How the first effect was named.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Naming {
    /// The one that is there; nothing, where nothing is.
    Right,
    /// Another.
    Wrong,
    /// Nothing although something is there, and surely so.
    None,
    /// Nothing, and no kind is likelier than not.
    Abstained,
}

impl Judged {
    /// The first effect named that is no slip jump of a valve that has one.
    pub fn first(&self) -> Option<Kind> {
        let own = |kind: &Kind| !self.also.contains(kind) || self.case.effect == Some(*kind);
        self.named.iter().map(|named| named.0).find(own)
    }

    pub fn naming(&self) -> Naming {
        match self.first() {
            first if first == self.case.effect => Naming::Right,
            Some(_) => Naming::Wrong,
            None if self.candidates.first().is_some_and(|c| c.1 <= 0.5) => Naming::Abstained,
            None => Naming::None,
        }
    }

    /// Whether the effect is among those that are named, first or not.
    pub fn recalled(&self) -> bool {
        self.named.iter().any(|named| Some(named.0) == self.case.effect)
    }

    /// Whether the record counts for a share of what can be found: a fit that is told the effect finds it, or something else was
    /// named in its place, which is wrong whatever the record holds.
    pub fn counts(&self) -> bool {
        self.identifiable == Some(true) || self.naming() == Naming::Wrong
    }

    /// What was named beside what is there.
    pub fn beside(&self) -> Vec<Kind> {
        self.named.iter().map(|named| named.0).filter(|kind| !self.is_there(*kind)).collect()
    }

    fn is_there(&self, kind: Kind) -> bool {
        self.case.effect == Some(kind) || self.also.contains(&kind)
    }

    /// The effects named, with their posteriors and whether they are there.
    pub fn competing(&self) -> Vec<(f64, bool)> {
        self.named.iter().map(|(kind, p)| (*p, self.is_there(*kind))).collect()
    }

    /// Each effect that was named or rejected: generator, true effect, seed, kind, log odds against all else and against none, what
    /// held-out samples say, whether it is there, whether the valve is told to stick beside it, its numbers and the loop in words.
    /// The last line has J/S where it is not 1, and whether there is a slip jump.
    pub fn evidence_lines(&self) -> Vec<String> {
        let generator = self.name.chars().next().unwrap_or('?');
        let truth = self.case.effect.map_or("clean", Kind::as_str);
        let line = |(kind, Evidence { log_odds, over_none, held_out, beside_friction }, numbers): &(
            Kind,
            Evidence,
            String,
        )| {
            let [there, sticks] = [self.is_there(*kind), *beside_friction].map(u8::from);
            format!(
                "evidence {generator} {truth} {} {kind} {log_odds:.3} {over_none:.3} {held_out:.3} {there} {sticks}{numbers} of {}",
                self.case.seed, self.name
            )
        };
        let mut lines: Vec<String> = self.weighed.iter().map(line).collect();
        // Whatever J is, as long as it is not S itself.
        if self.sticks && self.ratio.is_finite() && self.ratio != 1.0 {
            let there = u8::from(self.is_there(Kind::SlipJump));
            lines.push(format!("ratio {generator} {truth} {} {:.3} {there}", self.case.seed, self.ratio));
        }
        lines
    }

    /// The case in a line.
    pub fn line(&self) -> String {
        let names: Vec<String> = self
            .named
            .iter()
            .zip(&self.evidence)
            .zip(&self.numbers)
            .map(|(((kind, p), e), numbers)| format!("{kind}{numbers} {p:.2} ({e:.0})"))
            .collect();
        let of = |c: &(Option<Kind>, f64)| format!("{} {:.2}", c.0.map_or("none", Kind::as_str), c.1);
        let candidates: Vec<String> = self.candidates.iter().map(of).collect();
        format!(
            "{} [{}] then {}; told {:?}; f {:.3} -> {:.3} [{:.3}, {:.3}] friction {:.2}; one {:.4?} free {:.4?}",
            self.name,
            names.join(", "),
            candidates.join(", "),
            self.identifiable,
            self.f_true,
            self.f,
            self.ci[0],
            self.ci[1],
            self.friction,
            self.one,
            self.free
        )
    }
}

/// Diagnoses and traces a case; `told`: one with an effect also by a fit that knows it.
pub fn judge(generator: &Generator, case: &Case, told: bool) -> Judged {
    let (record, truth) = (generator.record)(case);
    let settings = diagnosis::Settings::default();
    let d = diagnose(&record, &settings);
    let trace = |of: residual::Settings| trace_record(&record, &d, &settings, &of);
    let found = trace(residual::Settings::default());
    let read = |get: &dyn Fn(&Findings) -> [f64; 2]| found.as_ref().map_or([f64::NAN; 2], get);
    let after = found.as_ref().map_or(&d.verdict, |f| &f.verdict);
    let friction = found.as_ref().map(|f| f.friction_after).unwrap_or_default();
    let kind = case.effect.map_or("clean", Kind::as_str);
    let mut judged = Judged {
        case: *case,
        name: format!("{} {kind} v{} seed {} {}", generator.name, case.variant, case.seed, truth.name),
        named: found.iter().flat_map(|f| &f.effects).map(|e| (e.kind, e.posterior)).collect(),
        evidence: found.iter().flat_map(|f| &f.effects).map(|e| e.delta_aic).collect(),
        numbers: found.iter().flat_map(|f| &f.effects).map(numbers).collect(),
        weighed: found.as_ref().map(weighed).unwrap_or_default(),
        candidates: found.as_ref().map(|f| f.candidates.clone()).unwrap_or_default(),
        is_traced: found.is_some(),
        also: truth.also,
        identifiable: None,
        sticks: *after == Verdict::Stiction,
        denied: *after == Verdict::NoStiction,
        f_true: truth.f,
        f: friction.f,
        ci: friction.f_ci95,
        ratio: 1.0 - friction.lag / friction.f,
        friction: friction.posterior,
        one: read(&|t| [t.before.one_step_rmse, t.after.one_step_rmse]),
        free: read(&|t| [t.before.free_run_rmse, t.after.free_run_rmse]),
        simulates_worse: found.as_ref().is_some_and(|f| f.simulates_worse),
        size: found
            .as_ref()
            .and_then(|f| size(f, case.effect?))
            .zip(truth.load)
            .map(|(told, load)| told / load),
    };
    if let Some(kind) = case.effect.filter(|_| told) {
        let informed = residual::Settings {
            only: Some(kind),
            friction: Some((truth.f, truth.j.is_finite().then_some(truth.j))),
            ..Default::default()
        };
        // What the signals alone show stands first, whatever else is found.
        let found = trace(informed).is_some_and(|t| t.effects.iter().any(|e| e.kind == kind));
        judged.identifiable = Some(found);
    }
    judged
}

/// What speaks for the effects that were named or rejected.
fn weighed(found: &Findings) -> Vec<(Kind, Evidence, String)> {
    let named = found.effects.iter().filter_map(|e| Some((e.kind, e.evidence?, numbers(e))));
    let rejected = found.rejected.iter().map(|(kind, evidence)| (*kind, *evidence, String::new()));
    named.chain(rejected).collect()
}

/// The numbers of an effect.
fn numbers(effect: &Effect) -> String {
    effect.parameters.iter().map(|p| format!(" {} {:.3}", p.name, p.value)).collect()
}

/// What a load of this kind is worth at the valve (OP): as the generators count it, of a ramp its rise over the record.
fn size(found: &Findings, kind: Kind) -> Option<f64> {
    let seconds = found.curves.pv.len() as f64 * found.curves.ts;
    let (parameter, times) = match kind {
        Kind::LoadStep => ("size_op", 1.0),
        Kind::OscillatingLoad => ("amplitude_op", 1.0),
        Kind::MeasuredDisturbance => ("op_per_sd", 1.0),
        Kind::Drift => ("rate_op_per_s", seconds),
        _ => return None,
    };
    let effect = found.effects.iter().find(|effect| effect.kind == kind)?;
    effect.parameters.iter().find(|p| p.name == parameter).map(|p| p.value * times)
}
