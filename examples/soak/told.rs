//! What came of it: the slope of memory, bounds, and the picture.

use super::sampled::Sample;
use super::slope::{Judged, Slope, median};
use stictiond::plot::{Panel, Plot, Series, sheet, thin};

/// Memory that rings do not take may grow by so much (MB an hour). It is too much where that is proven: where the lower end of the
/// slope's interval is.
const MOST_MB_AN_HOUR: f64 = 1.0;
/// Handles and threads may be so many more at the end than after the first part.
const MOST_MORE: f64 = 8.0;
/// One poll in so many may be missed.
const MISSED: f64 = 1e-3;
/// Longest time between two samples of a tag in the database (s): a reload that changes a device connects to it anew.
const LONGEST_S: f64 = 10.0;
/// Memory is told as medians over so long (s).
const MEDIAN_S: f64 = 600.0;
/// Points of a curve.
const POINTS: usize = 400;

/// What rings of so many samples hold by then, at one a second (MB): their memory is taken as they fill.
fn filled(sample: &Sample, ring: f64) -> f64 {
    sample.rings * (sample.t / ring).min(1.0)
}

/// Resident memory beyond that (MB).
fn resident(sample: &Sample, ring: f64) -> f64 {
    sample.memory - filled(sample, ring)
}

/// Memory that is allocated beside the rings, which are whole from the start on (MB).
fn allocated(sample: &Sample) -> f64 {
    sample.allocated - sample.rings
}

/// What came of what was written.
pub struct Kept {
    /// Whether the store works at the end and nothing waits.
    pub settled: bool,
    /// Longest time between two samples of a tag in the database (s).
    pub gap: f64,
    /// Looks that were not answered.
    pub unanswered: f64,
}

/// The result.
pub struct Told {
    /// Of what is allocated beside the rings, and of resident memory beyond what rings fill (MB an hour). A leak is in both;
    /// pages that the allocator keeps are in the second only.
    allocated: Slope,
    resident: Slope,
    /// Handles and threads more than after the first part.
    handles: f64,
    threads: f64,
    first_part: f64,
    /// The same memory, each the medians of [`MEDIAN_S`] (MB).
    medians: [Vec<f64>; 2],
}

impl Told {
    pub fn of(samples: &[Sample], first_part: f64, ring: f64, recurs: f64) -> Self {
        let later: Vec<&Sample> = samples.iter().filter(|sample| sample.t >= first_part).collect();
        let slope = |of: &dyn Fn(&Sample) -> f64| {
            let points: Vec<(f64, f64)> = later.iter().map(|sample| (sample.t, of(sample))).collect();
            Slope::of(&points, recurs)
        };
        let more = |of: fn(&Sample) -> f64| {
            let first = later.first().map_or(f64::NAN, |sample| of(sample));
            later.last().map_or(f64::NAN, |sample| of(sample)) - first
        };
        let medians = |of: &dyn Fn(&Sample) -> f64| {
            let parts = samples.chunk_by(|a, b| (a.t / MEDIAN_S).floor() == (b.t / MEDIAN_S).floor());
            parts.map(|part| median(part.iter().map(of))).collect::<Vec<f64>>()
        };
        let beyond = |sample: &Sample| resident(sample, ring);
        Self {
            medians: [medians(&allocated), medians(&beyond)],
            allocated: slope(&allocated),
            resident: slope(&beyond),
            handles: more(|s| s.handles),
            threads: more(|s| s.threads),
            first_part,
        }
    }

    /// Says it, with each bound; whether all of them hold. One that the run was too short to judge does not.
    pub fn print(&self, samples: &[Sample], kept: &Kept) -> bool {
        let last = samples.last().copied().unwrap_or_default();
        let of = |part: fn(&Sample) -> f64| {
            let mut values: Vec<f64> = samples.iter().map(part).collect();
            values.sort_by(f64::total_cmp);
            let at = |share: f64| {
                values.get(((values.len() - 1) as f64 * share) as usize).copied().unwrap_or(f64::NAN)
            };
            format!("p50 {:.1} ms, p99 {:.1} ms, worst {:.1} ms", at(0.5), at(0.99), at(1.0))
        };
        println!("page of loops  {}", of(|sample| sample.list));
        println!("one loop       {}", of(|sample| sample.one));
        println!("metrics        {}", of(|sample| sample.metrics));
        println!(
            "memory         {:.0} MB resident at the end, {:.0} MB allocated, {:.0} MB of them rings",
            last.memory, last.allocated, last.rings
        );
        for (what, medians) in ["allocated", "resident"].into_iter().zip(&self.medians) {
            let medians: Vec<String> = medians.iter().map(|mb| format!("{mb:.0}")).collect();
            let minutes = MEDIAN_S / 60.0;
            println!("  {what} beyond the rings, medians of {minutes:.0} min: {} MB", medians.join(", "));
        }
        println!("disk           {:.0} MB at the end", last.disk);
        let part = self.first_part / 60.0;
        let mut good = true;
        let mut say = |what: &str, value: f64, most: f64, judged: Judged| {
            good &= judged == Judged::Holds;
            println!("{what}: {value:.3}, at most {most}: {judged}");
        };
        for (what, slope) in [("allocated", self.allocated), ("resident", self.resident)] {
            let (own, [low, high]) = (slope.per_hour, slope.interval());
            println!(
                "{what} memory beyond the rings after {part:.0} min: estimate {own:.2} MB/h, 95 % interval {low:.2} to {high:.2} MB/h"
            );
            println!("  {}", slope.meaning(MOST_MB_AN_HOUR, "MB/h"));
            let what = format!("lower end of that interval, {what} (MB/h)");
            say(&what, low, MOST_MB_AN_HOUR, slope.judged(MOST_MB_AN_HOUR));
        }
        let mut bound = |what: &str, value: f64, most: f64| {
            say(what, value, most, if value <= most { Judged::Holds } else { Judged::Broken });
        };
        bound(&format!("handles more than after {part:.0} min"), self.handles, MOST_MORE);
        bound(&format!("threads more than after {part:.0} min"), self.threads, MOST_MORE);
        bound("looks without an answer", kept.unanswered, 0.0);
        bound(
            "polls missed for each that was due",
            last.missed / (last.polls + last.missed).max(1.0),
            MISSED,
        );
        let panics = (last.panicked - last.meant).abs();
        bound("diagnoses that panicked, less those of the one loop", panics, 0.0);
        bound("samples, rows and states lost", last.lost, 0.0);
        bound("waits for the database at the end (MB)", last.waits, 0.0);
        bound("stores that do not work at the end", f64::from(u8::from(!kept.settled)), 0.0);
        bound("longest time between two samples in the database (s)", kept.gap, LONGEST_S);
        good
    }
}

/// Everything over time.
pub fn picture(samples: &[Sample], reloads: &[f64], first_part: f64, ring: f64) -> String {
    let curve = |name: &str, class: &'static str, of: &dyn Fn(&Sample) -> f64| Series {
        name: name.into(),
        class,
        points: thin(&samples.iter().map(|s| (s.t / 60.0, of(s))).collect::<Vec<_>>(), POINTS),
    };
    let panel = |y, log, series| Panel { y, log, series };
    let missed: Vec<f64> = samples.iter().map(|sample| sample.missed).collect();
    let new = |at: usize| missed[at] - if at == 0 { 0.0 } else { missed[at - 1] };
    let missed = Series {
        name: "polls missed".into(),
        class: "other",
        points: samples.iter().enumerate().map(|(at, sample)| (sample.t / 60.0, new(at))).collect(),
    };
    let marks = reloads.iter().map(|t| (t / 60.0, "")).chain([(first_part / 60.0, "slope from here")]);
    let plot = Plot {
        title: "A daemon at work: what it takes, and how fast it answers; lines are reloads".into(),
        x: "time since the start (min)",
        panels: vec![
            panel(
                "memory (MB)",
                false,
                vec![
                    curve("resident", "pv", &|s| s.memory),
                    curve("beyond what rings fill", "op", &|s| resident(s, ring)),
                    curve("allocated beside the rings", "other", &allocated),
                ],
            ),
            panel(
                "number",
                false,
                vec![
                    curve("handles", "pv", &|s| s.handles),
                    curve("threads", "op", &|s| s.threads),
                    curve("alarms", "other", &|s| s.alarms),
                ],
            ),
            panel(
                "disk (MB)",
                false,
                vec![
                    curve("folder of the store", "pv", &|s| s.disk),
                    curve("waits for the database", "op", &|s| s.waits),
                ],
            ),
            panel(
                "answer after (ms)",
                true,
                vec![
                    curve("metrics", "other", &|s| s.metrics),
                    curve("page of 100 loops", "pv", &|s| s.list),
                    curve("one loop", "op", &|s| s.one),
                ],
            ),
            panel("missed (1/10 s)", false, vec![missed]),
        ],
        marks: marks.collect(),
    };
    sheet(&[plot])
}
