//! One record, judged by every method and by the program.

use stictiond_numerics::detectors::{Facts, Integration, Method, Opinion, Says, lee2008, opinion};
use stictiond_numerics::diagnosis::{Diagnosis, Settings, Verdict, diagnose};
use stictiond_numerics::signal::{Record, Window};

/// What was said of a record, and the truth.
pub struct Judged {
    pub name: String,
    /// Whether the valve sticks.
    pub sticky: bool,
    /// What the scenario is like, in words.
    pub scenarios: Vec<String>,
    /// S (OP unit), where known.
    pub s: Option<f64>,
    /// Whether the process integrates.
    pub integrates: bool,
    /// `1/(w tau)` of the process at the cycle's frequency, where both are known; 0 where it integrates.
    pub lag: Option<f64>,
    /// Period of OP's oscillation (s).
    pub period_s: Option<f64>,
    pub integration: Option<Integration>,
    /// r of the oscillation of OP.
    pub regular: bool,
    pub opinions: Vec<Opinion>,
    /// The same, told whether the process integrates.
    pub told: Vec<Opinion>,
    /// What each took (ms of one core).
    pub ms: Vec<f64>,
    /// What all share took (ms).
    pub shared_ms: f64,
    pub program: Says,
    pub program_ms: f64,
    pub f: Option<f64>,
    pub lee: Option<lee2008::Estimate>,
}

/// Judges a record; the measured stem, where there is one, is shown to the method of that name alone: the others are told
/// as if it were not measured, as in nearly all plants.
pub fn judge(name: String, sticky: bool, integrates: bool, record: &Record) -> Judged {
    let settings = Settings::default();
    let start = cpu();
    let diagnosis = diagnose(record, &settings);
    let program_ms = cpu() - start;
    let program = match diagnosis.verdict {
        Verdict::Stiction => Says::Sticks,
        Verdict::NoStiction => Says::Sound,
        Verdict::NotIdentifiable(_) => Says::CannotTell,
    };
    let mut judged = Judged {
        name,
        sticky,
        scenarios: Vec::new(),
        s: None,
        integrates,
        lag: None,
        period_s: None,
        integration: None,
        regular: false,
        opinions: Vec::new(),
        told: Vec::new(),
        ms: vec![0.0; Method::ALL.len()],
        shared_ms: 0.0,
        program,
        program_ms,
        f: diagnosis.estimate.as_ref().map(|e| e.f),
        lee: None,
    };
    match &diagnosis.window {
        Some(window) => by_methods(&mut judged, window),
        None => refused(&mut judged, &diagnosis),
    }
    judged
}

fn by_methods(judged: &mut Judged, window: &Window) {
    let blind = Window { mv: None, ..window.clone() };
    let start = cpu();
    let facts = Facts::new(&blind, None);
    judged.shared_ms = cpu() - start;
    let seen = Facts::new(window, None);
    let (Ok(facts), Ok(seen)) = (facts, seen) else {
        judged.opinions = Method::ALL.map(|m| Opinion::cannot_tell(m, "no facts")).to_vec();
        judged.told = judged.opinions.clone();
        return;
    };
    if let Ok(told) = Facts::new(&blind, Some(judged.integrates)) {
        let facts = |m| if m == Method::StemLoop { &seen } else { &told };
        judged.told = Method::ALL.into_iter().map(|method| opinion(method, facts(method))).collect();
    }
    judged.integration = Some(facts.integration);
    judged.regular = facts.oscillates().is_ok();
    judged.period_s = facts.oscillation.map(|found| found.period * window.ts);
    judged.lee = lee2008::estimate(&facts);
    for (method, ms) in Method::ALL.into_iter().zip(&mut judged.ms) {
        let start = cpu();
        let facts = if method == Method::StemLoop { &seen } else { &facts };
        judged.opinions.push(opinion(method, facts));
        *ms = cpu() - start;
    }
}

fn refused(judged: &mut Judged, diagnosis: &Diagnosis) {
    judged.opinions = Method::ALL.map(|m| Opinion::cannot_tell(m, diagnosis.reason.clone())).to_vec();
    judged.told = judged.opinions.clone();
}

/// Time of the processor that this thread has had (ms): others may keep it busy.
pub fn cpu() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").expect("Linux tells it");
    text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).expect("a number") / 1e6
}
