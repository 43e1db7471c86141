//! Fits the weights that stand in the sources, on simulated signals alone; prints them, and how right they are on others.
//!
//! `cargo run --release -p stictiond-numerics --example calibrate -- oscillation`.

mod logistic;
mod posterior;
mod waves;

use clap::Parser;
use std::path::{Path, PathBuf};
use stictiond_numerics::indicators::oscillation::candidates;
use stictiond_numerics::sim::scenarios::{SOUND_KINDS, random_sound};
use stictiond_numerics::sysid::spectrum::Transforms;

/// Fits the weights that stand in the sources, on simulated signals alone
#[derive(Parser)]
enum Asked {
    /// Fit the weights by which an oscillation is told from noise
    Oscillation,
    /// Fit the weights by which the members of a group are ranked
    Rank {
        /// File with what `plantwide_rates --signs` has printed of plants of other seeds
        file: PathBuf,
    },
    /// Fit how often an effect is there for which so much speaks
    Posterior {
        /// Files with what `tracing_rates --evidence` has printed of loops of other seeds
        #[arg(required = true)]
        files: Vec<PathBuf>,
    },
}

fn main() {
    match Asked::parse() {
        Asked::Oscillation => oscillation(),
        Asked::Rank { file } => rank(&file),
        Asked::Posterior { files } => posterior::posterior(&files),
    }
}

/// Candidates of signals: those at the wave's period, and the largest of signals without one.
fn rows(seeds: std::ops::Range<u64>) -> (Vec<Vec<f64>>, Vec<usize>) {
    let mut transforms = Transforms::new();
    let (first, quiet) = (seeds.start, (seeds.end - seeds.start) / 2);
    let (mut x, mut y) = (Vec::new(), Vec::new());
    for wave in seeds.map(waves::draw) {
        if wave.period.is_some() && wave.clear < 0.5 {
            continue;
        }
        let found = candidates(&wave.x, 1.0, &mut transforms);
        let at = found.iter().find(|c| wave.period.is_some_and(|p| (c.period_s / p - 1.0).abs() < 0.15));
        for candidate in
            at.into_iter().chain(found.iter().take(if wave.period.is_none() { found.len() } else { 0 }))
        {
            x.push(candidate.signs().to_vec());
            y.push(usize::from(wave.period.is_some()));
        }
    }
    // Controllers that answer loads, noise and set points, and oscillate by none of them.
    for seed in first..first + quiet {
        let kind = SOUND_KINDS[(seed % SOUND_KINDS.len() as u64) as usize];
        if !["noise only", "coloured load", "random walk load", "set-point changes", "load steps"]
            .contains(&kind)
        {
            continue;
        }
        let Ok(run) = random_sound(seed).run() else { continue };
        for candidate in candidates(&run.op, 1.0, &mut transforms) {
            x.push(candidate.signs().to_vec());
            y.push(0);
        }
    }
    (x, y)
}

fn oscillation() {
    let (x, y) = rows(1..3001);
    let w = logistic::fit(&x, &y, 2, 1e-4, false);
    let weights: Vec<f64> = w[1].iter().zip(&w[0]).map(|(a, b)| a - b).collect();
    println!(
        "{weights:.3?} from {} and {} candidates",
        y.iter().sum::<usize>(),
        y.iter().filter(|y| **y == 0).count()
    );
    let (x, y) = rows(100_001..101_001);
    let said = |row: &[f64]| row.iter().chain([&1.0]).zip(&weights).map(|(x, w)| x * w).sum::<f64>() > 0.0;
    let mut count = [[0; 2]; 2];
    x.iter().zip(&y).for_each(|(row, y)| count[*y][usize::from(said(row))] += 1);
    println!("of others: {count:?} (truth, said)");
}

/// A conditional logit over the members of each group, by gradient ascent with momentum.
fn rank(file: &Path) {
    let text = std::fs::read_to_string(file).unwrap_or_default();
    let mut groups: Vec<(Vec<Vec<f64>>, usize)> = Vec::new();
    let (mut members, mut source) = (Vec::new(), 0);
    for line in text.lines() {
        let cells: Vec<&str> = line.split_whitespace().collect();
        match cells.first() {
            Some(&"sign") => {
                if cells[2] == "1" {
                    source = members.len();
                }
                members.push(cells[3..].iter().filter_map(|x| x.parse().ok()).collect());
            }
            Some(&"end") => groups.push((std::mem::take(&mut members), source)),
            _ => {}
        }
    }
    let width = groups.first().map_or(0, |g| g.0[0].len());
    let (mut w, mut speed) = (vec![0.0; width], vec![0.0; width]);
    for _ in 0..4000 {
        let mut gradient: Vec<f64> = w.iter().map(|w| -0.01 * w).collect();
        for (members, source) in &groups {
            let scores: Vec<f64> =
                members.iter().map(|x| x.iter().zip(&w).map(|(x, w)| x * w).sum::<f64>().exp()).collect();
            let sum: f64 = scores.iter().sum();
            for (i, x) in members.iter().enumerate() {
                let error = f64::from(u8::from(i == *source)) - scores[i] / sum;
                gradient.iter_mut().zip(x).for_each(|(g, x)| *g += error * x / groups.len() as f64);
            }
        }
        for k in 0..width {
            speed[k] = 0.9 * speed[k] + 0.1 * gradient[k];
            w[k] += speed[k];
        }
    }
    println!("{w:.3?} from {} groups", groups.len());
}
