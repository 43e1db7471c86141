//! Which measured records oscillate, beside what people said, and how often simulated loops do.
//!
//! `cargo run --release -p stictiond-numerics --example oscillating`.

use clap::Parser;
use std::path::PathBuf;
use stictiond_numerics::indicators::oscillation::{candidates, oscillations};
use stictiond_numerics::sim::scenarios::{SOUND_KINDS, random_sound, random_sticky};
use stictiond_numerics::sysid::spectrum::Transforms;

/// Which measured records oscillate, and how often simulated loops do
#[derive(Parser)]
struct Args {
    /// Folder of the records, with index.csv: file, sample period (s), label
    #[arg(default_value = "../shared/data/isdb_op")]
    folder: PathBuf,
}

fn main() {
    measured(&Args::parse().folder);
    simulated(100);
}

fn measured(folder: &std::path::Path) {
    let Ok(index) = std::fs::read_to_string(folder.join("index.csv")) else {
        println!("skipped: there is no index.csv in {}", folder.display());
        return;
    };
    let mut transforms = Transforms::new();
    let mut count = [[0; 2]; 2];
    println!(
        "| record | label | says | probability | period (s) | r | R | share of what is fast |\n|---|---|---|---|---|---|---|---|"
    );
    for line in index.lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let text = std::fs::read_to_string(folder.join(cells[0])).unwrap_or_default();
        let op: Vec<f64> =
            text.lines().skip(1).filter_map(|l| l.split(',').nth(1)?.trim().parse().ok()).collect();
        let ts = cells[1].parse().unwrap_or(1.0);
        let says = !oscillations(&op, ts, &mut transforms).is_empty();
        let judged = candidates(&op, ts, &mut transforms);
        let best = judged.iter().max_by(|a, b| a.probability().total_cmp(&b.probability()));
        if let Some(best) = best {
            println!(
                "| {} | {} | {} | {:.2} | {:.3} | {:.2} | {:.2} | {:.2} |",
                cells[0],
                cells[2],
                u8::from(says),
                best.probability(),
                best.period_s,
                best.regularity,
                best.lasting,
                best.share_of_fast
            );
        }
        if let Ok(label @ 0..=1) = cells[2].parse::<usize>() {
            count[label][usize::from(says)] += 1;
        }
    }
    println!(
        "label 0: {} right, {} wrong; label 1: {} right, {} wrong",
        count[0][0], count[0][1], count[1][1], count[1][0]
    );
}

fn simulated(each: u64) {
    let mut transforms = Transforms::new();
    let kinds = SOUND_KINDS.len() as u64;
    println!("| simulated | oscillates |\n|---|---|");
    for kind in 0..=kinds {
        let scenario = |i: u64| {
            if kind < kinds { random_sound(kinds * (9_000 + i) + kind) } else { random_sticky(9_000 + i) }
        };
        let runs = (0..each).filter_map(|i| scenario(i).run().ok());
        let yes = runs.filter(|run| !oscillations(&run.op, run.ts, &mut transforms).is_empty()).count();
        println!(
            "| {} | {yes} of {each} |",
            SOUND_KINDS.get(kind as usize).copied().unwrap_or("sticking valve")
        );
    }
}
