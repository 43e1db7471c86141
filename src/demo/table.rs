//! The table that the terminal shows: what is true of each loop beside what the diagnosis says.

use crate::results::Summary;
use crate::sim::{DemoLoop, Expected};
use std::fmt::Write as _;

const HEADER: &str =
    "loop    what it is                        S/2       f  95 % interval  evidence  verdict           right";

/// Of a sound loop: its record would not show friction, however strong.
const HIDDEN: &str = "hidden_friction";
/// Of a sticking loop: a term of write-back hides its friction.
const COMPENSATED: &str = "compensated";

/// How the latest diagnosis agrees with what is true.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mark {
    /// There was none.
    Waiting,
    /// It has the verdict to expect.
    Right,
    /// It says that friction could not show, which is true: it is neither right nor wrong.
    Abstains,
    /// It has another verdict, and so far none has said that the valve sticks, or that it does not.
    NotYet,
    /// It has another verdict.
    Wrong,
}

impl Mark {
    fn as_str(self) -> &'static str {
        match self {
            Mark::Waiting => "",
            Mark::Right => "yes",
            Mark::Abstains => "abstains",
            Mark::NotYet => "not yet",
            Mark::Wrong => "no",
        }
    }
}

/// Whether a diagnosis said that the valve sticks, or that it does not.
pub(super) fn tells(said: &Summary) -> bool {
    [Expected::Stiction, Expected::NoStiction].iter().any(|own| said.outcome == own.as_str())
}

/// One loop, and its latest diagnosis if there was one.
pub(super) struct Row<'a> {
    /// What is true.
    pub(super) demo: &'a DemoLoop,
    /// What the diagnosis said last.
    pub(super) said: Option<&'a Summary>,
    /// Whether one has told so far, see [`tells`].
    pub(super) has_told: bool,
}

impl Row<'_> {
    fn mark(&self) -> Mark {
        let Some(said) = self.said else { return Mark::Waiting };
        let expected = self.demo.expected;
        match (said.reason_code.as_deref(), expected) {
            _ if said.outcome == expected.as_str() => Mark::Right,
            (Some(HIDDEN), Expected::NoStiction) | (Some(COMPENSATED), Expected::Stiction) => Mark::Abstains,
            _ if self.has_told => Mark::Wrong,
            _ => Mark::NotYet,
        }
    }

    /// The verdict and its mark; `None` before the first diagnosis.
    pub(super) fn verdict(&self) -> Option<String> {
        self.said.map(|said| format!("{} {}", said.outcome, self.mark().as_str()))
    }

    fn line(&self) -> String {
        let Row { demo, said, .. } = self;
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
        format!(
            "{:7} {what:30} {truth:>6} {:>7}  {interval:>13}  {:>8}  {verdict:16}  {}",
            demo.id,
            number(said.and_then(|said| said.f), 2),
            number(said.and_then(|said| said.delta_aic), 0),
            self.mark().as_str(),
        )
    }
}

/// The whole table, a line per element; S/2 and f in % of OP span, evidence in AIC.
pub(super) fn lines(rows: &[Row<'_>]) -> Vec<String> {
    let count = |mark: Mark| rows.iter().filter(|row| row.mark() == mark).count();
    let abstain = match count(Mark::Abstains) {
        0 => String::new(),
        1 => ", 1 abstains: friction could not show".to_owned(),
        n => format!(", {n} abstain: friction could not show"),
    };
    let mut lines = vec![HEADER.to_owned()];
    lines.extend(rows.iter().map(Row::line));
    lines.push(format!("{} of {} loops have the right verdict{abstain}", count(Mark::Right), rows.len()));
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

    fn said(outcome: &'static str, reason_code: Option<&'static str>) -> Summary {
        let sticks = outcome == "stiction";
        Summary {
            time: 0.0,
            took_s: 0.1,
            trigger: Trigger::Periodic,
            outcome: outcome.into(),
            reason_code: reason_code.map(Into::into),
            reason: String::new(),
            f: sticks.then_some(2.512),
            f_ci95: sticks.then_some([2.4, 2.6]),
            f_in_percent: true,
            delta_aic: sticks.then_some(446.2),
            compensated: None,
        }
    }

    #[test]
    fn truth_and_verdict_stand_side_by_side() {
        let plant = demo_plant(1);
        let said = said("stiction", None);
        let row = |at: usize, said: Option<_>| Row { demo: &plant[at], said, has_told: said.is_some() };
        let lines = lines(&[row(0, None), row(1, Some(&said)), row(5, Some(&said))]);
        assert_eq!(
            lines[1..],
            [
                "FIC101  flow, sound                      0.00       -              -         -  waiting for data  ",
                "FIC102  flow, strong stiction            2.50    2.51     2.40..2.60       446  stiction          yes",
                "FIC106  flow, saturated                     -    2.51     2.40..2.60       446  stiction          no",
                "1 of 3 loops have the right verdict",
            ]
        );
        assert!(redrawn(&lines).starts_with("\x1b[Hloop "));
    }

    #[test]
    fn friction_that_could_not_show_is_neither_right_nor_wrong() {
        let plant = demo_plant(1);
        let gaps = said("not_identifiable", Some("gaps"));
        let hidden = said("not_identifiable", Some("hidden_friction"));
        let compensated = said("not_identifiable", Some("compensated"));
        let row = |at: usize, said, has_told| Row { demo: &plant[at], said: Some(said), has_told };
        // FIC101 is sound, FIC102 sticks, FIC106 stands at its limit.
        let marks = [
            (row(0, &hidden, true), Mark::Abstains),
            (row(0, &hidden, false), Mark::Abstains),
            (row(0, &gaps, false), Mark::NotYet),
            (row(0, &gaps, true), Mark::Wrong),
            (row(1, &hidden, false), Mark::NotYet),
            (row(1, &hidden, true), Mark::Wrong),
            (row(1, &compensated, true), Mark::Abstains),
            (row(5, &hidden, true), Mark::Right),
        ];
        for (row, mark) in &marks {
            assert_eq!(row.mark(), *mark, "{}, {:?}", row.demo.id, row.said);
        }
        let foot = |rows: &[Row<'_>]| lines(rows).pop();
        let sound = said("no_stiction", None);
        assert_eq!(
            foot(&[row(0, &sound, true), row(3, &hidden, true)]).as_deref(),
            Some("1 of 2 loops have the right verdict, 1 abstains: friction could not show")
        );
        assert_eq!(
            foot(&[row(0, &hidden, true), row(3, &hidden, true)]).as_deref(),
            Some("0 of 2 loops have the right verdict, 2 abstain: friction could not show")
        );
        assert_eq!(
            lines(&[row(0, &hidden, true)])[1],
            "FIC101  flow, sound                      0.00       -              -         -  not_identifiable  abstains"
        );
    }
}
