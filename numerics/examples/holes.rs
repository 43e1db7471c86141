//! What a diagnosis says of sticking loops of whose samples some are lost, at random, in bursts and periodically:
//! `cargo run --release -p stictiond-numerics --example holes -- --records 100 --first-seed 8000`.

#[path = "../tests/common/acquired.rs"]
mod acquired;
#[path = "../tests/common/generators/mod.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod generators;
#[path = "../tests/common/parallel.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod parallel;

use acquired::{Loop, Said, draw, judge, kinds_of_gaps, with_gaps};
use clap::Parser;
use std::collections::BTreeMap;
use stictiond_numerics::detectors::tally;
use stictiond_numerics::diagnosis;
use stictiond_numerics::signal::Record;
use stictiond_numerics::sim::acquisition::Gaps;

/// What a diagnosis says of sticking loops of whose samples some are lost
#[derive(Parser)]
struct Args {
    /// Sticking loops of three generators that share no code
    #[arg(long, default_value_t = 100)]
    records: usize,
    /// First seed
    #[arg(long, default_value_t = 8000)]
    first_seed: u64,
    /// Loops judged at once
    #[arg(long, default_value_t = std::thread::available_parallelism().map_or(1, usize::from))]
    threads: usize,
    /// Shares of the samples that are lost (%), separated by commas
    #[arg(long, value_delimiter = ',', default_values_t = [2, 5, 10, 20, 30])]
    shares: Vec<usize>,
    /// Only holes whose names contain one of these words, separated by commas
    #[arg(long, value_delimiter = ',')]
    kinds: Vec<String>,
    /// Only this tag has holes
    #[arg(long, value_parser = ["op", "pv"])]
    of: Option<String>,
    /// Print the loops whose verdict differs from that without holes
    #[arg(long)]
    each: bool,
}

fn main() {
    let Args { records: count, first_seed: first, threads, shares, kinds, of, each } = Args::parse();
    let threads = threads.max(1);
    let loops: Vec<Loop> = (0..).map(|i| draw(i, first + i)).filter(|own| own.f > 0.0).take(count).collect();
    let whole = parallel::on(threads, &loops, |own| judge(own, &with_gaps(own, Gaps::None)));
    println!("{count} sticking loops, seeds from {first}; Wilson 95 % intervals in brackets\n");
    println!(
        "| missing | same verdict | sticking found | of those without holes | f within 10 % | interval covers S/2 | right or not identifiable | no stiction, in its bound | not identifiable |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    show("0 %", &loops, &whole, &whole, false);
    for percent in shares {
        let wanted = |how: &str| kinds.is_empty() || kinds.iter().any(|kind| how.contains(kind));
        for (how, gaps) in kinds_of_gaps(percent).into_iter().filter(|(how, _)| wanted(how)) {
            let said = parallel::on(threads, &loops, |own| {
                let (whole, holes) = (with_gaps(own, Gaps::None), with_gaps(own, gaps));
                let record = match of.as_deref() {
                    Some("pv") => Record { pv: holes.pv, ..whole },
                    Some("op") => Record { op: holes.op, ..whole },
                    _ => holes,
                };
                judge(own, &record)
            });
            show(&format!("{percent} % {how}"), &loops, &whole, &said, each);
        }
    }
}

fn show(name: &str, loops: &[Loop], whole: &[Said], said: &[Said], each: bool) {
    let all: Vec<(&Loop, &Said, &Said)> =
        loops.iter().zip(whole).zip(said).map(|((own, whole), said)| (own, whole, said)).collect();
    let of = |wanted: &dyn Fn(&Loop, &Said, &Said) -> bool| {
        all.iter().filter(|(own, whole, said)| wanted(own, whole, said)).count()
    };
    let found = of(&|_, _, said| said.sticks());
    let sound = of(&|_, _, said| said.verdict == "no_stiction");
    let mut reasons: BTreeMap<&str, usize> = BTreeMap::new();
    said.iter()
        .filter(|said| !said.code.is_empty())
        .for_each(|said| *reasons.entry(said.code).or_default() += 1);
    let reasons: Vec<String> = reasons.iter().map(|(code, count)| format!("{count} {code}")).collect();
    println!(
        "| {name} | {} | {found} | {} | {} | {} | {} | {} | {} |",
        wilson(of(&|_, whole, said| whole.verdict == said.verdict), all.len()),
        wilson(
            of(&|_, whole, said| whole.sticks() && said.sticks()),
            whole.iter().filter(|own| own.sticks()).count()
        ),
        wilson(of(&|own, _, said| said.sticks() && said.near(own.f)), found),
        wilson(of(&|own, _, said| said.sticks() && said.covers(own.f)), found),
        wilson(of(&|_, _, said| said.verdict != "no_stiction"), all.len()),
        wilson(of(&|own, _, said| said.verdict == "no_stiction" && said.covers(own.f)), sound),
        if reasons.is_empty() { "-".into() } else { reasons.join(", ") }
    );
    for (own, whole, said) in all.iter().filter(|(_, whole, said)| each && whole.verdict != said.verdict) {
        println!("    {}: f {:.3}", own.name, own.f);
        for (how, said) in [("whole", whole), ("holes", said)] {
            println!(
                "        {how}: {} {:.3} [{:.3}, {:.3}], evidence {:.1}, {:?}; {}",
                said.verdict, said.f, said.ci[0], said.ci[1], said.evidence, said.invented, said.reason
            );
        }
    }
    if each {
        let limit = diagnosis::Settings::default().evidence_threshold;
        let near = |said: &Said| (said.evidence - limit).abs() < 0.5 * limit;
        let changed = of(&|_, whole, said| whole.verdict != said.verdict);
        let marginal = of(&|_, whole, said| whole.verdict != said.verdict && near(whole));
        println!(
            "    {changed} changed, of them {marginal} whose evidence without holes lies within half of the limit of it"
        );
    }
}

/// Hits, and the Wilson 95 % interval of their share, in per cent.
fn wilson(hits: usize, of: usize) -> String {
    match tally::wilson(hits, of) {
        Some([low, high]) => format!("{hits} of {of} [{:.0}, {:.0}]", 100.0 * low, 100.0 * high),
        None => "-".into(),
    }
}
