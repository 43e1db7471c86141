//! The tables of the benchmark, as Markdown.

use super::judged::Judged;
use std::collections::BTreeMap;
use stictiond_numerics::detectors::tally::{self, Tally};
use stictiond_numerics::detectors::{self, Integrates, Method, Opinion, Says};

/// A share with its 95 % interval by Wilson.
pub fn wilson(hits: usize, of: usize) -> String {
    match tally::wilson(hits, of) {
        Some([low, high]) => {
            format!("{hits} of {of} ({}–{} %)", (100.0 * low).round(), (100.0 * high).round())
        }
        None => "–".into(),
    }
}

/// The value below which a share of them lie.
pub fn quantile(values: &[f64], share: f64) -> f64 {
    tally::quantile(values, share).unwrap_or(f64::NAN)
}

/// One row per method and one for the program; `told` whether the process integrates, or not.
pub fn methods(all: &[&Judged], told: bool) {
    let opinions = |of: &Judged| if told { of.told.clone() } else { of.opinions.clone() };
    println!(
        "| method | sticks: found | missed | cannot tell | sound: cleared | false alarm | cannot tell | right where told | ms, median (largest) |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    let print = |name: &str, says: &dyn Fn(&Judged) -> Says, ms: &dyn Fn(&Judged) -> f64| {
        let mut count = Tally::default();
        all.iter().for_each(|of| count.add(of.sticky, says(of)));
        let ms: Vec<f64> = all.iter().map(|of| ms(of)).collect();
        let (right, told) = (count.right(), count.told());
        println!(
            "| {name} | {} | {} | {} | {} | {} | {} | {} | {:.1} ({:.1}) |",
            wilson(count.found, count.sticky()),
            count.missed,
            count.silent_sticky,
            count.cleared,
            wilson(count.alarms, count.sound()),
            count.silent_sound,
            wilson(right, told),
            quantile(&ms, 0.5),
            quantile(&ms, 1.0),
        );
    };
    for (i, method) in Method::ALL.into_iter().enumerate() {
        print(method.as_str(), &|of| opinions(of)[i].says, &|of| of.ms[i]);
    }
    print("most of those that tell", &|of| majority(&opinions(of), of.regular), &|of| {
        of.shared_ms + of.ms[1..].iter().sum::<f64>()
    });
    print("**the program**", &|of| of.program, &|of| of.program_ms);
}

/// What most of the methods that tell say, the stem not counted.
fn majority(opinions: &[Opinion], regular: bool) -> Says {
    let found = detectors::agreement(opinions, None, regular);
    match (2 * found.sticks).cmp(&found.could_tell) {
        std::cmp::Ordering::Greater => Says::Sticks,
        std::cmp::Ordering::Less => Says::Sound,
        std::cmp::Ordering::Equal => Says::CannotTell,
    }
}

fn mark(of: &Judged, says: Says) -> &'static str {
    match (says, of.sticky) {
        (Says::CannotTell, _) => "·",
        (Says::Sticks, true) | (Says::Sound, false) => "✓",
        _ => "✗",
    }
}

/// One row per record: right ✓, wrong ✗, cannot tell ·.
pub fn loops(all: &[&Judged]) {
    let names: Vec<&str> = Method::ALL.into_iter().map(Method::as_str).collect();
    println!("\n| record | label | {} | program | doubtful |", names.join(" | "));
    println!("|---|---|{}---|---|", "---|".repeat(names.len()));
    for of in all {
        let marks: Vec<&str> = of.opinions.iter().map(|o| mark(of, o.says)).collect();
        let label = if of.sticky { "sticks" } else { "sound" };
        let doubt = if doubtful(of) { "doubtful" } else { "" };
        println!("| {} | {label} | {} | {} | {doubt} |", of.name, marks.join(" | "), mark(of, of.program));
    }
}

fn doubtful(of: &Judged) -> bool {
    detectors::agreement(&of.opinions, verdict(of), of.regular).doubtful
}

fn verdict(of: &Judged) -> Option<bool> {
    match of.program {
        Says::Sticks => Some(true),
        Says::Sound => Some(false),
        Says::CannotTell => None,
    }
}

/// Right, wrong and untold of each method in each scenario.
pub fn scenarios(all: &[&Judged]) {
    let mut by: BTreeMap<(bool, &str), Vec<&Judged>> = BTreeMap::new();
    for of in all {
        for label in &of.scenarios {
            by.entry((!of.sticky, label)).or_default().push(of);
        }
    }
    let names: Vec<&str> = Method::ALL.into_iter().map(Method::as_str).collect();
    println!("\nRight / wrong / cannot tell. A loop that is several things counts in several rows.\n");
    println!("| scenario | loops | {} | program |", names.join(" | "));
    println!("|---|---|{}---|", "---|".repeat(names.len()));
    for ((_, label), of) in &by {
        let cell = |says: &dyn Fn(&Judged) -> Says| {
            let mut count = Tally::default();
            of.iter().for_each(|of| count.add(of.sticky, says(of)));
            let (right, told) = (count.right(), count.told());
            format!("{right} / {} / {}", told - right, of.len() - told)
        };
        let cells: Vec<String> = (0..names.len()).map(|i| cell(&|of| of.opinions[i].says)).collect();
        println!("| {label} | {} | {} | {} |", of.len(), cells.join(" | "), cell(&|of| of.program));
    }
}

/// Estimates of S beside the true one.
pub fn friction(all: &[&Judged]) {
    println!(
        "\nEstimates of S over the true S, of loops that stick: median (10 % to 90 %), and how many were said to stick.\n"
    );
    println!("| estimate | all | where it says that the valve sticks |");
    println!("|---|---|---|");
    let row = |name: &str, of: &dyn Fn(&Judged) -> Option<(f64, bool)>| {
        let ratios: Vec<(f64, bool)> = all
            .iter()
            .filter_map(|judged| {
                let (estimate, sticks) = of(judged)?;
                Some((estimate / judged.s?, sticks))
            })
            .collect();
        let text = |ratios: Vec<f64>| {
            let at = |share| quantile(&ratios, share);
            format!("{:.2} ({:.2}–{:.2}), n {}", at(0.5), at(0.1), at(0.9), ratios.len())
        };
        let told = ratios.iter().filter(|(_, sticks)| *sticks).map(|(ratio, _)| *ratio).collect();
        println!("| {name} | {} | {} |", text(ratios.iter().map(|(ratio, _)| *ratio).collect()), text(told));
    };
    let says = |of: &Judged, method: Method| {
        of.opinions.iter().any(|o| o.method == method && o.says == Says::Sticks)
    };
    row("2 f (the program)", &|of| Some((2.0 * of.f?, of.program == Says::Sticks)));
    row("fS' + fD' (lee_2008)", &|of| of.lee.map(|l| (l.fs + l.fd, says(of, Method::Lee2008))));
    for method in [
        Method::StemLoop,
        Method::Kano2004A,
        Method::Kano2004B,
        Method::Choudhury2006,
        Method::Srinivasan2005D,
    ] {
        row(method.as_str(), &|of| {
            let opinion = of.opinions.iter().find(|o| o.method == method)?;
            Some((opinion.quantity?.value, opinion.says == Says::Sticks))
        });
    }
}

/// Whether the process integrates, against the truth.
pub fn integration(all: &[&Judged]) {
    println!("\nWhether the process integrates, where it was asked:\n");
    println!("| truth | said to integrate | said not to | unknown |");
    println!("|---|---|---|---|");
    type Truth = fn(f64) -> bool;
    let truths: [(&str, Truth); 3] = [
        ("integrates", |lag| lag == 0.0),
        ("follows slowly: 1/(w tau) up to 0.5", |lag| lag > 0.0 && lag <= 0.5),
        ("follows: above 0.5", |lag| lag > 0.5),
    ];
    for sticky in [true, false] {
        for (name, truth) in truths {
            let of: Vec<Integrates> = all
                .iter()
                .filter(|of| of.sticky == sticky && of.regular && of.lag.is_some_and(truth))
                .filter_map(|of| Some(of.integration?.answer))
                .collect();
            let count = |answer| wilson(of.iter().filter(|a| **a == answer).count(), of.len());
            let (yes, no) = (count(Integrates::Yes), count(Integrates::No));
            let valve = if sticky { "sticks" } else { "sound" };
            println!("| {valve}, {name} | {yes} | {no} | {} |", count(Integrates::Unknown));
        }
    }
}

/// How many right verdicts on loops with a regular cycle are doubted, and how many wrong ones.
pub fn agreement_of(all: &[&Judged], doubt: &dyn Fn(&Judged) -> bool) -> [(usize, usize); 2] {
    [true, false].map(|right| {
        let of: Vec<&&Judged> =
            all.iter().filter(|of| of.regular && verdict(of) == Some(of.sticky == right)).collect();
        (of.iter().filter(|of| doubt(of)).count(), of.len())
    })
}

/// How often a verdict is doubted.
pub fn agreement(all: &[&Judged]) {
    println!(
        "\nVerdicts on loops with a regular cycle that the methods make doubtful, the measured stem not asked:\n"
    );
    println!("| the verdict is | doubtful |");
    println!("|---|---|");
    let [right, wrong] = agreement_of(all, &|of| {
        let blind: Vec<_> = of.opinions.iter().filter(|o| o.method != Method::StemLoop).cloned().collect();
        detectors::agreement(&blind, verdict(of), of.regular).doubtful
    });
    println!("| right | {} |", wilson(right.0, right.1));
    println!("| wrong | {} |", wilson(wrong.0, wrong.1));
}

/// Everything said of one record.
pub fn one(of: &Judged) {
    println!(
        "\n{} ({}), program {} f {:?}, integration {:?}",
        of.name,
        of.sticky,
        of.program.as_str(),
        of.f,
        of.integration
    );
    for o in &of.opinions {
        println!("  {:22} {:11} {}", o.method.as_str(), o.says.as_str(), o.why);
    }
}
