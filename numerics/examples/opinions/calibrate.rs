//! What the thresholds that no author gives are taken from, on seeds that the benchmark does not use.
//!
//! The indices are those of methods that are told whether the process integrates: otherwise few sound loops would be left.
//! An index sticks above the value that 5 % of the sound loops pass, and is sound up to the value that 10 % of the sticking
//! ones do not reach, or up to the first where that is lower; where more than 10 % of the sticking ones have an index of 0, nothing is cleared.

use super::judged::Judged;
use super::simulated::{CALIBRATION, random};
use super::tables::{agreement_of, quantile};
use stictiond_numerics::detectors::integration::LEAST_FIT;
use stictiond_numerics::detectors::{Method, Opinion, Says};

/// Methods whose thresholds are calibrated.
const CALIBRATED: [Method; 6] = [
    Method::StemLoop,
    Method::Kano2004A,
    Method::Kano2004B,
    Method::Srinivasan2005Shape,
    Method::Srinivasan2005D,
    Method::Lee2008,
];

/// Prints them.
pub fn print(loops: u64, threads: usize) {
    let judged = random(CALIBRATION, loops, threads);
    println!("\n### Calibration on {} loops from seed {CALIBRATION}\n", judged.len());
    println!(
        "| method | sound: n, 50 %, 90 %, 95 % | sticks: n, at 0, 5 %, 10 %, 50 % | sound up to | sticks above |"
    );
    println!("|---|---|---|---|---|");
    for method in Method::ALL {
        let of = |sticky: bool| -> Vec<f64> {
            let opinions = judged.iter().filter(|j| j.sticky == sticky).flat_map(|j| &j.told);
            opinions.filter(|o| o.method == method).filter_map(|o: &Opinion| o.index).collect()
        };
        let (sound, sticky) = (of(false), of(true));
        let at = |v: &[f64], share| quantile(v, share);
        let sticks = at(&sound, 0.95);
        let note = if CALIBRATED.contains(&method) {
            format!("{:.3} | {sticks:.3}", sticks.min(at(&sticky, 0.1)))
        } else {
            "the author's | the author's".into()
        };
        let zero = sticky.iter().filter(|index| **index <= 0.0).count();
        println!(
            "| {} | {}: {:.3}, {:.3}, {:.3} | {}, {zero}: {:.3}, {:.3}, {:.3} | {note} |",
            method.as_str(),
            sound.len(),
            at(&sound, 0.5),
            at(&sound, 0.9),
            at(&sound, 0.95),
            sticky.len(),
            at(&sticky, 0.05),
            at(&sticky, 0.1),
            at(&sticky, 0.5),
        );
    }
    lags(&judged);
    doubts(&judged);
}

fn lags(judged: &[Judged]) {
    println!("\nMeasured 1/(w tau), fit at least {LEAST_FIT}, regular cycle:\n");
    println!("| loops | n | 5 % | 10 % | 25 % | 50 % | 75 % | 90 % | 95 % |");
    println!("|---|---|---|---|---|---|---|---|---|");
    type Truth = fn(&Judged) -> bool;
    let truths: [(&str, Truth); 4] = [
        ("stick, integrates", |j| j.sticky && j.integrates),
        ("stick, true value 0 to 0.5", |j| j.sticky && j.lag.is_some_and(|lag| lag > 0.0 && lag <= 0.5)),
        ("stick, above 0.5", |j| j.sticky && j.lag.is_some_and(|lag| lag > 0.5)),
        ("sound", |j| !j.sticky),
    ];
    for (name, truth) in truths {
        let of = judged.iter().filter(|j| j.regular && truth(j)).filter_map(|j| j.integration);
        let v: Vec<f64> = of.filter(|i| i.fit >= LEAST_FIT).filter_map(|i| i.lag).collect();
        let at = [0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95].map(|q| format!("{:.2}", quantile(&v, q)));
        println!("| {name} | {} | {} |", v.len(), at.join(" | "));
    }
}

/// Rules for doubt: how many right and wrong verdicts each would doubt.
fn doubts(judged: &[Judged]) {
    println!("\n| contradicting, at least | share, at least | right verdicts doubted | wrong ones doubted |");
    println!("|---|---|---|---|");
    let all: Vec<&Judged> = judged.iter().collect();
    for least in 2..=7 {
        for share in [0.5, 0.6, 0.7, 0.75, 0.8, 0.9, 1.0] {
            let doubt = |of: &Judged| {
                let told = || {
                    of.opinions.iter().filter(|o| o.method != Method::StemLoop && o.says != Says::CannotTell)
                };
                let against = told().filter(|o| o.says != of.program).count();
                of.regular && against >= least && against as f64 >= share * told().count() as f64
            };
            let [right, wrong] = agreement_of(&all, &doubt);
            println!("| {least} | {share} | {} of {} | {} of {} |", right.0, right.1, wrong.0, wrong.1);
        }
    }
}
