//! The table that the terminal shows: what is true of each loop beside what the diagnosis says.

use crate::results::Summary;
use crate::sim::{DemoLoop, Expected};
use std::fmt::Write as _;

const HEADER: &str =
    "loop    what it is                        S/2       f  95 % interval  evidence  verdict           right";

/// One loop, and its latest diagnosis if there was one.
pub(super) struct Row<'a> {
    /// What is true.
    pub(super) demo: &'a DemoLoop,
    /// What the diagnosis said last.
    pub(super) said: Option<&'a Summary>,
}

impl Row<'_> {
    /// Whether the latest verdict is the one to expect.
    pub(super) fn is_right(&self) -> bool {
        self.said.is_some_and(|said| said.outcome == self.demo.expected.as_str())
    }

    fn line(&self) -> String {
        let Row { demo, said } = self;
        let what = format!("{}, {}", demo.class.as_str(), demo.truth.kind);
        let truth = match demo.expected {
            Expected::NotIdentifiable => "-".to_owned(),
            _ => format!("{:.2}", 0.5 * demo.truth.s),
        };
        let number = |value: Option<f64>, digits: usize| {
            value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
        };
        let interval = said
            .and_then(|said| said.f_ci95)
            .map_or_else(|| "-".to_owned(), |[low, high]| format!("{low:.2}..{high:.2}"));
        let verdict = match said {
            None => "waiting for data",
            Some(said) => said.outcome.as_ref(),
        };
        let mark = match (said, self.is_right()) {
            (None, _) => "",
            (_, true) => "yes",
            (_, false) => "not yet",
        };
        format!(
            "{:7} {what:30} {truth:>6} {:>7}  {interval:>13}  {:>8}  {verdict:16}  {mark}",
            demo.id,
            number(said.and_then(|said| said.f), 2),
            number(said.and_then(|said| said.delta_aic), 0),
        )
    }
}

/// The whole table, a line per element; S/2 and f in % of OP span, evidence in AIC.
pub(super) fn lines(rows: &[Row<'_>]) -> Vec<String> {
    let right = rows.iter().filter(|row| row.is_right()).count();
    let mut lines = vec![HEADER.to_owned()];
    lines.extend(rows.iter().map(Row::line));
    lines.push(format!("{right} of {} loops have the right verdict", rows.len()));
    lines
}

/// The lines drawn over what the screen shows: from the top, each line and all below it cleared.
pub(super) fn redrawn(lines: &[String]) -> String {
    let mut text = String::from("\x1b[H");
    for line in lines {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{line}\x1b[K");
    }
    text + "\x1b[J"
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::results::Trigger;
    use crate::sim::demo_plant;

    #[test]
    fn truth_and_verdict_stand_side_by_side() {
        let plant = demo_plant(1);
        let said = Summary {
            time: 0.0,
            took_s: 0.1,
            trigger: Trigger::Periodic,
            outcome: "stiction".into(),
            reason_code: None,
            reason: String::new(),
            f: Some(2.512),
            f_ci95: Some([2.4, 2.6]),
            f_in_percent: true,
            delta_aic: Some(446.2),
            compensated: None,
        };
        let row = |at: usize, said| Row { demo: &plant[at], said };
        let lines = lines(&[row(0, None), row(1, Some(&said)), row(5, Some(&said))]);
        assert_eq!(
            lines[1..],
            [
                "FIC101  flow, sound                      0.00       -              -         -  waiting for data  ",
                "FIC102  flow, strong stiction            2.50    2.51     2.40..2.60       446  stiction          yes",
                "FIC106  flow, saturated                     -    2.51     2.40..2.60       446  stiction          not yet",
                "1 of 3 loops have the right verdict",
            ]
        );
        assert!(redrawn(&lines).starts_with("\x1b[Hloop "));
    }
}
