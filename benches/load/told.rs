//! What a run came to, in words: what was measured and what is scaled, the first period and those after it, and what was missed.

use super::daemon::{Asked, Measured};
use super::look::Look;
use super::plant::DEVICES;
use stictiond::residual::LASTS_S;

/// The head of the table.
pub const HEAD: &str = "\
| loops | % of a core, first period | % of a core, following | without a search, following | diagnoses | sticking, sound, not identifiable | memory at most, MiB | store, bytes a loop-hour | polls missed | diagnoses skipped |
|---|---|---|---|---|---|---|---|---|---|";

/// The plant of the aims: loops, the time between two diagnoses of each (s), the share of a core once every loop is known (%),
/// and memory (MiB).
const PLANT: f64 = 10_000.0;
const PERIOD_S: f64 = 3600.0;
const MOST_CPU: f64 = 60.0;
const MOST_MIB: f64 = 1536.0;
/// Time on the wall that the first polls may take (s), and polls of a device that may be under way.
const FIRST_POLLS_S: f64 = 1.0;
const UNDER_WAY: f64 = 2.0;

/// What happened between two looks.
#[derive(Clone, Copy)]
struct Part {
    /// Of a core, in plant time (%).
    cpu: f64,
    diagnosed: f64,
    confirmed: f64,
    skipped: f64,
}

impl Part {
    fn of(before: &Look, after: &Look) -> Self {
        Self {
            cpu: 100.0 * (after.cpu_s - before.cpu_s) / (after.at - before.at),
            diagnosed: after.diagnosed - before.diagnosed,
            confirmed: after.confirmed - before.confirmed,
            skipped: after.skipped - before.skipped,
        }
    }
}

/// A run, with what is computed of it.
pub struct Told {
    run: Measured,
    first: Part,
    /// After the first period; `None` in a run that ends with it.
    following: Option<Part>,
}

impl Told {
    pub fn of(run: Measured) -> Self {
        let (begun, end) = (run.looks[0], run.looks[run.looks.len() - 1]);
        let within = |look: &&Look| look.until <= 1.01 * run.asked.period_s;
        let known = run.looks.iter().rfind(within).copied().unwrap_or(end);
        let following = (known.until < end.until).then(|| Part::of(&known, &end));
        Self { first: Part::of(&begun, &known), following, run }
    }

    /// What must not be, with how much of it there was.
    pub fn faults(&self) -> Vec<(&'static str, f64)> {
        let metrics = &self.run.metrics;
        let unanswered = metrics.device("timeouts") + metrics.device("link_errors");
        let mut counts = vec![
            ("polls missed", metrics.device("missed_polls")),
            ("polls never made", self.polls_lacking()),
            ("requests without an answer", unanswered),
            ("diagnoses skipped", self.skipped()),
            ("diagnoses never begun", self.diagnoses_lacking()),
            ("diagnoses late", metrics.ended("deadline_exceeded")),
            ("diagnoses panicked", metrics.ended("panicked")),
        ];
        if self.run.asked.stores {
            let lost = ["failures", "lost_samples", "refused_samples", "dropped_rows", "damaged_chunks"];
            counts.push(("faults of the store", lost.iter().map(|event| metrics.store(event)).sum()));
            counts.push(("stores that do not work", 1.0 - metrics.sum("stictiond_store_working", "")));
        }
        counts.retain(|(_, count)| *count != 0.0);
        counts
    }

    fn skipped(&self) -> f64 {
        self.run.metrics.sum("stictiond_runs_skipped_total", "")
    }

    /// Polls that were due and are not told of as missed either.
    fn polls_lacking(&self) -> f64 {
        let Asked { speed, .. } = self.run.asked;
        let of_each = self.run.ran_s - FIRST_POLLS_S * speed - UNDER_WAY;
        let (metrics, due) = (&self.run.metrics, of_each.floor() * DEVICES as f64);
        (due - metrics.device("polls") - metrics.device("missed_polls")).max(0.0)
    }

    /// Diagnoses that were due: of m loops the i-th at (i + 1/2) / m of each period.
    fn due(&self) -> f64 {
        let Asked { loops, period_s, .. } = self.run.asked;
        (self.run.ran_s / period_s * loops as f64 + 0.5).floor()
    }

    /// Diagnoses that were due and of which nothing is known. One for each slot may be on its way from the queue, and the
    /// daemon's clock does not begin with a period.
    fn diagnoses_lacking(&self) -> f64 {
        let metrics = &self.run.metrics;
        let waits = metrics.sum("stictiond_runs_queued", "") + metrics.sum("stictiond_runs_running", "");
        let known = metrics.sum("stictiond_runs_total", "") + self.skipped() + waits;
        (self.due() - known - self.run.asked.parallelism as f64 - 1.0).max(0.0)
    }

    /// Bytes that the store's database has in use, for each hour of each loop.
    fn bytes_a_loop_hour(&self) -> f64 {
        self.run.metrics.sum("stictiond_store_used_bytes", "") / self.loop_hours()
    }

    fn loop_hours(&self) -> f64 {
        self.run.ran_s / 3600.0 * self.run.asked.loops as f64
    }

    /// Everything but the row.
    pub fn print(&self) {
        let (run, metrics) = (&self.run, &self.run.metrics);
        self.print_scale();
        self.print_cpu();
        let end = &run.looks[run.looks.len() - 1];
        println!(
            "memory         {:.0} MiB resident, {:.0} MiB at most, {:.0} MiB before the first poll",
            end.kib / 1024.0,
            run.most_kib / 1024.0,
            run.idle_kib / 1024.0
        );
        println!("  history      {:.0} MiB", metrics.sum("stictiond_history_memory_bytes", "") / 1_048_576.0);
        self.print_store();
        println!(
            "polls          {} done, {} missed, {} overran",
            metrics.device("polls"),
            metrics.device("missed_polls"),
            metrics.device("overruns")
        );
        println!(
            "samples        {} good, {} bad",
            metrics.device("good_samples"),
            metrics.device("bad_samples")
        );
        println!(
            "diagnoses      {} due, {} done, {} of them without a search, {} late, {} panicked, {} skipped, \
             {} wait at the end",
            self.due(),
            metrics.ended("diagnosed"),
            metrics.sum("stictiond_runs_confirmed_total", ""),
            metrics.ended("deadline_exceeded"),
            metrics.ended("panicked"),
            self.skipped(),
            metrics.sum("stictiond_runs_queued", "")
        );
        println!(
            "API            scrape {:.1} ms, page of 1000 loops {:.1} ms",
            1e3 * run.scrape_s,
            1e3 * run.list_s
        );
        self.print_aims();
        self.faults().iter().for_each(|(what, count)| println!("FAILED         {what}: {count}"));
    }

    /// What was measured, and what is not as it would be in a plant.
    fn print_scale(&self) {
        let Asked { loops, speed, plant_s, period_s, .. } = self.run.asked;
        let cores = std::thread::available_parallelism().map_or(0, std::num::NonZeroUsize::get);
        println!(
            "measured       {loops} loops x 3 tags at 1 Hz, each diagnosed every {period_s} s: \
             {plant_s} s of plant time in {:.1} s on {cores} cores",
            self.run.ran_s / speed
        );
        if speed == 1.0 {
            println!("scaled         nothing: an hour is an hour");
        } else {
            println!(
                "scaled         time: polls, commits and diagnoses came {speed} x as often; shares of a core \
                 are of plant time, on the wall it was {speed} x as much"
            );
        }
        if plant_s < LASTS_S {
            println!(
                "not measured   a day: after {:.0} h a loop is searched again, so that once a day an hour may \
                 take as much as the first",
                LASTS_S / 3600.0
            );
        }
    }

    /// Processor time, from look to look and as a whole.
    fn print_cpu(&self) {
        let looks = &self.run.looks;
        let (begun, end) = (&looks[0], &looks[looks.len() - 1]);
        let following = self.following.map_or("not run".to_string(), |part| format!("{:.1} %", part.cpu));
        println!(
            "cpu            {:.1} s; of one core, in plant time: first period {:.1} %, following {following}",
            end.cpu_s - begun.cpu_s,
            self.first.cpu
        );
        println!(
            "  diagnoses    {:.1} s on the wall",
            self.run.metrics.sum("stictiond_runs_busy_seconds_total", "")
        );
        println!("  until (s)  % of a core  diagnoses  without a search  skipped  waiting  MiB");
        for pair in looks.windows(2) {
            let (part, after) = (Part::of(&pair[0], &pair[1]), &pair[1]);
            println!(
                "{:>11.0} {:>12.1} {:>10} {:>17} {:>8} {:>8} {:>4.0}",
                after.until,
                part.cpu,
                part.diagnosed,
                part.confirmed,
                part.skipped,
                after.waiting,
                after.kib / 1024.0
            );
        }
    }

    fn print_store(&self) {
        let Some((files, written)) = self.run.stored else {
            return println!("store          none");
        };
        println!(
            "store          {:.0} bytes a loop-hour in use; files of {:.0} MiB at the end, {:.0} MiB written",
            self.bytes_a_loop_hour(),
            files / 1_048_576.0,
            written / 1_048_576.0
        );
        let metrics = &self.run.metrics;
        println!("  made durable {} samples, {} rows", metrics.store("samples"), metrics.store("rows"));
    }

    /// Processor time is scaled by the number of loops, where each is diagnosed as often. Memory is not scaled.
    fn print_aims(&self) {
        let Asked { loops, period_s, speed, .. } = self.run.asked;
        let said = |value: f64, most: f64| if value <= most { "holds" } else { "does not hold" };
        let following = self.following.filter(|_| period_s == PERIOD_S);
        if let Some(part) = following {
            let cpu = part.cpu * PLANT / loops as f64;
            let how = if loops as f64 == PLANT && speed == 1.0 { "measured" } else { "scaled" };
            println!(
                "aim            {cpu:.1} % of a core for {PLANT} loops after the first period ({how}), \
                 at most {MOST_CPU}: {}",
                said(cpu, MOST_CPU)
            );
        } else {
            println!("aim            % of a core: this run has no two periods of {PERIOD_S} s");
        }
        let mib = self.run.most_kib / 1024.0;
        if loops as f64 >= PLANT {
            println!("aim            {mib:.0} MiB, at most {MOST_MIB}: {}", said(mib, MOST_MIB));
        } else {
            println!("aim            memory: this run has fewer than {PLANT} loops");
        }
    }

    /// The row of the table.
    pub fn row(&self) -> String {
        let (run, metrics) = (&self.run, &self.run.metrics);
        let or_none = |text: Option<String>| text.unwrap_or_else(|| "–".to_string());
        let verdicts = ["stiction", "no_stiction", "not_identifiable"];
        let verdicts = verdicts.map(|verdict| metrics.verdict(verdict).to_string());
        let cells = [
            format!("{}, {}", run.asked.loops, run.kind.words()),
            format!("{:.1}", self.first.cpu),
            or_none(self.following.map(|part| format!("{:.1}", part.cpu))),
            or_none(self.following.map(|part| format!("{} of {}", part.confirmed, part.diagnosed))),
            metrics.ended("diagnosed").to_string(),
            verdicts.join(", "),
            format!("{:.0}", run.most_kib / 1024.0),
            or_none(run.asked.stores.then(|| format!("{:.0}", self.bytes_a_loop_hour()))),
            metrics.device("missed_polls").to_string(),
            self.skipped().to_string(),
        ];
        format!("| {} |", cells.join(" | "))
    }
}
