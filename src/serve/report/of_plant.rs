//! The plant as a report.

use super::super::dto::loops::LoopItem;
use super::super::dto::params::AlarmState;
use super::super::words::short;
use super::{document, when};
use crate::plot::escape;
use crate::results::f_unit;
use std::fmt::Write;

/// A bar is full at this f (% OP); in other units nobody knows what is bad, and there is none.
const FULL: f64 = 5.0;

/// All loops, worst first; `to_acknowledge`: alarms of whatever kind that nobody has acknowledged.
pub fn of_plant(items: &[LoopItem], to_acknowledge: usize, now: Option<&str>) -> String {
    let count = |wanted: &dyn Fn(&LoopItem) -> bool| items.iter().filter(|item| wanted(item)).count();
    let verdict = |name: &'static str| count(&move |item| item.verdict.as_deref() == Some(name));
    let facts = [
        ("loops", items.len()),
        ("sticking", verdict("stiction")),
        ("alarms not acknowledged", to_acknowledge),
        ("no sticking shown", verdict("no_stiction")),
        ("cannot be told", verdict("not_identifiable")),
        ("not diagnosed yet", count(&|item| item.verdict.is_none())),
    ];
    let mut body = format!(
        "<h1>Control valves</h1><p class=\"faint\">stictiond {}, {}</p><dl>",
        env!("CARGO_PKG_VERSION"),
        when(now)
    );
    for (name, value) in facts {
        let _ = write!(body, "<div><dt>{name}</dt><dd>{value}</dd></div>");
    }
    body += "</dl><table><thead><tr><th>Loop</th><th>Unit</th><th>Verdict</th><th class=\"number\">f</th><th></th>\
             <th class=\"number\">Evidence</th><th>Alarm</th><th>Diagnosed</th></tr></thead><tbody>";
    items.iter().for_each(|item| row(&mut body, item));
    body += "</tbody></table><p class=\"faint\">f is half the band that OP has to cross on a reversal before the stem follows; \
             in brackets its 95 % interval. \u{201c}Cannot be told\u{201d} is not \u{201c}no sticking\u{201d}.</p>";
    document("Control valves", &body)
}

/// Why nothing can be told of a valve, in a few words; the page has the same in its tiles.
const REASONS: [(&str, &str); 21] = [
    ("too_short", "too little data"),
    ("no_time_base", "no time base"),
    ("gaps", "data missing"),
    ("silent", "the source is silent"),
    ("read_apart", "OP and PV read apart"),
    ("compressed", "compressed by the archive"),
    ("ts_too_short", "ts_s too short"),
    ("flat_op", "OP stands still"),
    ("flat_pv", "PV stands still"),
    ("saturated", "OP at a limit"),
    ("manual", "not in automatic"),
    ("mode_unknown", "mode not readable"),
    ("not_excited", "OP hardly reverses"),
    ("hidden_friction", "sticking not excluded"),
    ("undecided", "may stick, undecided"),
    ("undersampled", "sampled too slowly"),
    ("no_response", "PV hidden by loads"),
    ("stem_not_followed", "sticks, or load jumps"),
    ("compensated", "write-back hides it"),
    ("out_of_scale", "values out of scale"),
    ("deadline_exceeded", "took too long"),
];

fn why_not(code: &str) -> String {
    let known = REASONS.iter().find(|(own, _)| *own == code);
    known.map_or_else(|| code.replace('_', " "), |(_, words)| (*words).to_string())
}

/// The verdict in a word, or why there is none.
pub fn verdict_words(item: &LoopItem) -> String {
    match item.verdict.as_deref() {
        Some("stiction") => "sticks".into(),
        Some("no_stiction") => "no sticking".into(),
        Some(_) => format!("cannot be told: {}", why_not(item.reason_code.as_deref().unwrap_or_default())),
        None => "not diagnosed yet".into(),
    }
}

/// f with its interval; without friction what the record could have hidden.
pub fn friction_words(item: &LoopItem) -> String {
    let unit = item.f_unit.as_deref().unwrap_or_default();
    match (item.f, item.f_ci95) {
        (Some(f), Some([low, high])) if f > 0.0 => {
            format!("{} {unit} ({} … {})", short(f), short(low), short(high))
        }
        (Some(_), Some([_, high])) if high > 0.0 => format!("f up to {} {unit} could be hidden", short(high)),
        (Some(f), _) => format!("{} {unit}", short(f)),
        _ => "–".into(),
    }
}

fn row(out: &mut String, item: &LoopItem) {
    let sticks = item.verdict.as_deref() == Some("stiction");
    let drawn = sticks && item.f_unit.as_deref() == Some(f_unit(true));
    let bar = item.f.filter(|_| drawn).map_or_else(String::new, |f| {
        let width = 100.0 * (f / FULL).clamp(0.0, 1.0);
        format!(
            "<svg class=\"bar\" viewBox=\"0 0 100 10\" preserveAspectRatio=\"none\" aria-hidden=\"true\">\
             <rect width=\"{width:.1}\" height=\"10\"/></svg>"
        )
    });
    let _ = write!(
        out,
        "<tr><td>{}<br><span class=\"faint\">{}</span></td><td>{}</td><td class=\"{}\">{}</td><td class=\"number\">{}</td>\
         <td>{bar}</td><td class=\"number\">{}</td><td>{}</td><td>{}</td></tr>",
        escape(&item.id),
        escape(&item.description),
        escape(&item.group),
        if sticks { "look" } else { "" },
        escape(&verdict_words(item)),
        escape(&friction_words(item)),
        item.delta_aic.map_or_else(|| "–".into(), short),
        if item.alarm == AlarmState::Normal { String::new() } else { item.alarm.words() },
        when(item.time.as_deref()),
    );
}

#[cfg(test)]
mod tests {
    use super::super::of_loop::tests::sticks;
    use super::*;
    use crate::alarm;
    use crate::diagnosis::NotIdentifiable;
    use crate::results::Results;
    use crate::serve::{LoopInfo, Standing};
    use crate::signal::LoopId;

    #[test]
    fn every_reason_has_words_and_the_page_has_the_same() {
        let page = include_str!("../page/assets/js/states.js");
        let (_, list) = page.split_once("const REASONS = {").expect("the page's list");
        for code in NotIdentifiable::CODES {
            let (_, words) = REASONS.iter().find(|(own, _)| *own == code).expect(code);
            assert_eq!(why_not(code), *words);
            assert!(list.contains(&format!("{code}: \"{words}\"")), "{code}");
        }
        assert_eq!(why_not("of_a_later_one"), "of a later one");
    }

    #[test]
    fn a_bar_stands_for_per_cent_and_nothing_else() {
        let id = LoopId::new("FIC101");
        let results = Results::new(std::slice::from_ref(&id), 1, &alarm::Config::default());
        let info =
            LoopInfo { id: id.clone(), description: String::new(), group: String::new(), period_s: 60.0 };
        let bars = |f_in_percent| {
            let mut known = results.get(&id, 0.0).expect("it is there");
            known.summary = Some(sticks(0.0, f_in_percent));
            of_plant(&[LoopItem::new(&info, &known, Standing::default(), 0.0)], 0, None)
                .matches("<svg")
                .count()
        };
        assert_eq!([bars(true), bars(false)], [1, 0]);
    }
}
