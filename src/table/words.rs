//! Columns of words, and what those of the controller's mode mean: decided from the whole column.

use super::error::{TableError, shown};
use super::number;
use super::source::{Cell, NOTHING};
use crate::signal::many;

/// Different words of a column that are remembered.
const MOST: usize = 64;
/// Words in a message.
const NAMED: usize = 6;

/// The words of a column, and how many rows have each.
#[derive(Clone, Debug, Default)]
pub struct Words {
    pub(super) counts: Vec<(String, u64)>,
    /// There were more than are remembered.
    pub(super) more: bool,
    /// The last one and its place: columns of words repeat themselves.
    last: usize,
}

/// A cell as a word: small letters, and numbers without a fraction as such.
pub(super) fn word(cell: &Cell<'_>) -> String {
    match cell {
        Cell::Number(value) => value.to_string(),
        other => {
            let text = other.shown();
            let bare = number::bare(&text);
            match bare.parse::<f64>() {
                Ok(value) if value.is_finite() => value.to_string(),
                // The dot of a Turkish İ is a sign of its own in small letters.
                _ => bare.to_lowercase().replace('\u{307}', ""),
            }
        }
    }
}

/// The state of a mode that has two, 1 and 0 under their names; `None` for a mode with a name of its own.
pub(super) fn two_state(word: &str) -> Option<bool> {
    match word {
        "1" | "true" | "on" | "yes" => Some(true),
        "0" | "false" | "off" | "no" => Some(false),
        _ => None,
    }
}

/// A blank cell, in an option.
const BLANK: &str = "blank";

/// Whether a word of an option means a blank cell: it says so, or is a word for nothing, which a cell has for it.
fn is_blank(own: &str) -> bool {
    own == BLANK || NOTHING.iter().any(|word| word.eq_ignore_ascii_case(own))
}

/// Whether an option lists blank cells.
pub(super) fn means_blank(told: &[String]) -> bool {
    told.iter().any(|own| is_blank(own))
}

/// What an option lists, as [`word`] has it: `1.0` is `1`, and `blank` is nothing.
pub(super) fn as_words(told: &[String]) -> Vec<String> {
    let word = |one: &String| match one.parse::<f64>() {
        _ if is_blank(one) => String::new(),
        Ok(value) => value.to_string(),
        Err(_) => one.clone(),
    };
    told.iter().map(word).collect()
}

impl Words {
    /// Words that are counted already.
    pub(super) fn of(counts: Vec<(String, u64)>) -> Self {
        Self { counts, more: false, last: 0 }
    }

    /// One more cell.
    pub fn add(&mut self, cell: &Cell<'_>) {
        let word = word(cell);
        let at = match self.counts.get(self.last) {
            Some((own, _)) if *own == word => Some(self.last),
            _ => self.counts.iter().position(|(own, _)| *own == word),
        };
        match at {
            Some(at) => {
                self.counts[at].1 += 1;
                self.last = at;
            }
            None if self.counts.len() < MOST => self.counts.push((word, 1)),
            None => self.more = true,
        }
    }

    /// Whether one of them is not automatic.
    pub(super) fn say_manual(&self) -> bool {
        self.counts.iter().any(|(word, _)| usual(word) == Some(false))
    }

    /// Rows that have any.
    pub(super) fn rows(&self) -> u64 {
        self.counts.iter().map(|(_, count)| count).sum()
    }

    /// Whether any of them is one of these; measurements, of which there are many, are none.
    pub fn any_of(&self, told: &[String]) -> bool {
        !self.more
            && told.iter().any(|own| {
                let same = |word: &str| match (own.parse::<f64>(), word.parse::<f64>()) {
                    (Ok(own), Ok(word)) => own == word,
                    _ => own == word,
                };
                self.counts.iter().any(|(word, _)| same(word))
            })
    }

    /// Whether one of these may be among them: not all are remembered, there are none, or a blank cell is meant.
    pub fn may_hold(&self, told: &[String]) -> bool {
        self.more || self.counts.is_empty() || means_blank(told) || self.any_of(told)
    }

    /// Whether they are those of a controller's mode, whatever their column is called: nearly all rows have one that is known, one is
    /// automatic, and one is what nothing else is called. A remark such as `back to manual at six` is longer.
    pub fn speak_of_mode(&self) -> bool {
        let parts =
            |word: &str| word.split(|c: char| !c.is_alphanumeric()).filter(|part| !part.is_empty()).count();
        let known = || self.counts.iter().filter(|(word, _)| usual(word).is_some() && parts(word) <= 2);
        let any = |of: &dyn Fn(&str) -> bool| known().any(|(word, _)| of(word));
        let of_a_mode = |word: &str| word.split(|c: char| !c.is_alphanumeric()).any(is_of_a_mode);
        // A historian writes `I/O Timeout` where it had no mode.
        let nearly_all = known().map(|(_, count)| *count).sum::<u64>() * 10 >= self.rows() * 9;
        !self.more && nearly_all && any(&|word| usual(word) == Some(true)) && any(&of_a_mode)
    }

    /// Whether any of them is a number, whatever its decimal sign and its unit.
    pub(super) fn any_number(&self) -> bool {
        self.counts.iter().any(|(word, _)| number::scan(word).is_some())
    }

    /// The numbers among them; `None` where one is none.
    pub(super) fn numbers(&self) -> Option<Vec<f64>> {
        self.counts.iter().map(|(word, _)| word.parse().ok()).collect()
    }

    /// The most frequent ones, for a message.
    pub(super) fn listed(&self) -> String {
        let mut counts: Vec<_> = self.counts.iter().collect();
        counts.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
        let one = |(word, count): &&(String, u64)| format!("{:?} ({})", shown(word), many(*count, "row"));
        let mut out: Vec<String> = counts.iter().take(NAMED).map(one).collect();
        if counts.len() > NAMED || self.more {
            out.push("…".into());
        }
        out.join(", ")
    }
}

/// Words of automatic: the controller moves the valve by itself.
const AUTOMATIC: [&str; 30] = [
    "auto",
    "automatic",
    "aut",
    "cas",
    "casc",
    "cascade",
    "rcas",
    "a",
    // Beside `A` and `M` it is cascade.
    "c",
    "on",
    "true",
    "automatik",
    "automatisch",
    "pid",
    "closed",
    "lauto",
    "kaskade",
    "automático",
    "automatico",
    "automatique",
    "cascada",
    "autom",
    "automatikbetrieb",
    "automatyczny",
    "авт",
    "авто",
    "автомат",
    "автоматический",
    "自动",
    "自動",
];
/// Those of them that are automatic with the set point of another controller: what is not in cascade may be in automatic.
const CASCADE: [&str; 7] = ["cas", "casc", "cascade", "rcas", "c", "kaskade", "cascada"];
/// Words of manual: a person moves the valve.
const MANUAL: [&str; 18] = [
    "man",
    "manual",
    "hand",
    "m",
    "manuell",
    "manu",
    "manuale",
    "manuel",
    "manuelle",
    "handbetrieb",
    "ręczny",
    "reczny",
    "ręczna",
    "руч",
    "ручн",
    "ручной",
    "手动",
    "手動",
];
/// Words of not automatic that nothing but a mode is called: remote output, and initialisation in manual.
const NOT_AUTOMATIC_MODES: [&str; 2] = ["rout", "iman"];
/// Other words of not automatic.
const NOT_AUTOMATIC: [&str; 12] =
    ["oos", "lo", "off", "false", "track", "trk", "init", "override", "none", "out", "hold", "open"];
/// Words that deny the one beside them: `Not auto`.
const DENIALS: [&str; 3] = ["not", "non", "nicht"];
/// It says where the set point or the output comes from: `Auto-Local` is automatic, and by itself it is not.
const LOCAL: &str = "local";
/// Words of automatic in the name of a bit, beside which manual is its other state.
const AUTO_IN_NAMES: [&str; 4] = ["auto", "aut", "automatic", "automatik"];
/// Words in the name of a bit that is set in manual.
const MANUAL_BITS: [&str; 4] = ["man", "manual", "hand", "manact"];
/// Words of automatic and of manual that something else may be called, too: a switch, a contact, a unit.
const NOT_MODES_ALONE: [&str; 8] = ["a", "c", "on", "true", "pid", "closed", "hand", "m"];

/// What the words of a mode column mean.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Modes {
    /// Those that are automatic; `None` where the usual words are.
    automatic: Option<Vec<String>>,
    /// What is remarkable of it.
    pub said: Option<String>,
}

/// How OP moves.
#[derive(Clone, Copy, Debug, Default)]
pub struct Moving {
    /// It changes by itself.
    pub at_all: bool,
    /// It does so while the mode is 0, and rests while it is 1.
    pub in_zero: bool,
    /// It does so while the mode is 1, and rests while it is 0.
    pub in_one: bool,
}

/// Whether nothing but a mode is called so.
fn is_of_a_mode(part: &str) -> bool {
    let known = AUTOMATIC.contains(&part) || MANUAL.contains(&part);
    known && !NOT_MODES_ALONE.contains(&part) || NOT_AUTOMATIC_MODES.contains(&part)
}

/// Whether a word is automatic; `None` where nobody knows.
fn usual(word: &str) -> Option<bool> {
    match word {
        "1" | "yes" => return Some(true),
        "0" | "no" => return Some(false),
        // There was no answer: its letters are no modes.
        "n/a" | "n.a." | "n.a" => return None,
        _ => {}
    }
    let is = |names: &[&str], part: &str| names.contains(&part);
    let parts = || word.split(|c: char| !c.is_alphanumeric()).filter(|part| !part.is_empty());
    let (automatic, manual) =
        (parts().any(|part| is(&AUTOMATIC, part)), parts().any(|part| is(&MANUAL, part)));
    // `Auto (manual setpoint)` may be either, and `no auto` is not automatic in Spanish and `in automatic` in Portuguese.
    if automatic && manual || parts().any(|part| part == "no") {
        return None;
    }
    if parts().any(|part| is(&DENIALS, part)) {
        return (automatic && !parts().any(|part| is(&CASCADE, part))).then_some(false);
    }
    // `Remote manual` is manual, whatever else it says.
    let is_not = |part: &str| is(&NOT_AUTOMATIC, part) || is(&NOT_AUTOMATIC_MODES, part);
    let not = parts().any(|part| is_not(part) || part == LOCAL && !automatic);
    if manual || not { Some(false) } else { automatic.then_some(true) }
}

/// Whether a bit of this name is set in manual: `FIC101.MAN`, `Manual mode`. `AUTO_MAN` has both and says nothing of it.
fn says_manual(name: &str) -> bool {
    let small = name.to_lowercase();
    let words: Vec<&str> =
        small.split(|c: char| !c.is_alphanumeric()).filter(|part| !part.is_empty()).collect();
    let of_state = |word: &&&str| ["mode", "act"].contains(*word);
    let behind = words.iter().rev().take_while(of_state).count();
    let Some((last, before)) = words[..words.len() - behind].split_last() else { return false };
    // An area may be called `A`, so that the letter counts beside the word alone: `A/Man`.
    let automatic = words.iter().any(|word| AUTO_IN_NAMES.contains(word)) || before.last() == Some(&"a");
    MANUAL_BITS.contains(last) && !automatic
}

impl Modes {
    /// Decides.
    ///
    /// # Errors
    /// Words of which none is known, and a 0 in which OP moves as in automatic.
    pub fn decide(
        words: &Words,
        told: Option<&[String]>,
        op: Moving,
        name: &str,
    ) -> Result<Self, TableError> {
        if let Some(told) = told {
            let told = as_words(told);
            let said = Some(format!("automatic is {} by --auto-values", told.join(", ")));
            return Ok(Self { automatic: Some(told), said });
        }
        let doubt = || {
            Err(TableError::refused(format!(
                "column {name}: the mode is {}; say which of them are automatic with --auto-values",
                words.listed()
            )))
        };
        // A bit that is called so says manual, and 0 is automatic.
        let states: Option<Vec<bool>> = words.counts.iter().map(|(word, _)| two_state(word)).collect();
        if let Some(states) = states.filter(|own| says_manual(name) && !own.is_empty()) {
            if op.in_one {
                return Err(TableError::refused(format!(
                    "column {name}: OP moves by itself only while it is 1, and by its name 1 means manual; it is {}; say which of \
                     these values are automatic with --auto-values",
                    words.listed()
                )));
            }
            let zeros = words.counts.iter().zip(states).filter(|(_, state)| !state);
            let automatic = zeros.map(|((word, _), _)| word.clone()).collect();
            return Ok(Self { automatic: Some(automatic), said: None });
        }
        // On others the bit says manual without a name that tells.
        if op.in_zero && words.counts.iter().all(|(word, _)| two_state(word).is_some()) {
            return Err(TableError::refused(format!(
                "column {name}: OP moves by itself only while the mode is 0, and 0 usually means manual; the mode is {}; say which of \
                 these values are automatic with --auto-values",
                words.listed()
            )));
        }
        let plain = Self { automatic: None, said: None };
        if let ([(only, _)], None) =
            (words.counts.as_slice(), words.counts.first().and_then(|(w, _)| usual(w)))
        {
            if !op.at_all {
                return doubt();
            }
            // A controller whose output moves by itself through the whole record is not in manual.
            let said = Some(format!("the mode is always {:?}, taken for automatic as OP moves", shown(only)));
            return Ok(Self { automatic: Some(vec![only.clone()]), said });
        }
        // Numbers other than 0 and 1 are numbered by every vendor in another way.
        if words.numbers().is_some_and(|numbers| numbers.iter().any(|n| *n != 0.0 && *n != 1.0)) {
            return doubt();
        }
        // A word that nobody knows may say automatic: where most of the column is such, it is asked for.
        let rows = |known: bool| -> u64 {
            let of = words.counts.iter().filter(|(word, _)| usual(word).is_some() == known);
            of.map(|(_, count)| *count).sum()
        };
        if rows(false) > rows(true) { doubt() } else { Ok(plain) }
    }

    /// 1 in automatic, 0 otherwise; `None` for a word that cannot be told.
    pub fn value(&self, cell: &Cell<'_>) -> Option<f64> {
        let word = word(cell);
        match &self.automatic {
            // Where nothing stands the mode is unknown, and not manual.
            Some(own) if word.is_empty() && !own.contains(&word) => None,
            Some(own) => Some(f64::from(u8::from(own.contains(&word)))),
            None => usual(&word).map(|on| f64::from(u8::from(on))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOVES: Moving = Moving { at_all: true, in_zero: false, in_one: false };

    fn of(cells: &[&str]) -> Words {
        let mut words = Words::default();
        cells.iter().for_each(|cell| words.add(&Cell::Text(cell)));
        words
    }

    #[test]
    fn a_name_with_both_states_says_nothing_of_the_bit_and_one_that_op_contradicts_is_asked_about() {
        let value = |name: &str, moves: Moving, cells: &[&str]| {
            Modes::decide(&of(cells), None, moves, name).map(|modes| modes.value(&Cell::Text("1")))
        };
        for name in ["AUTO_MAN", "Auto/Man", "Auto/Manual", "FIC101.A/MAN"] {
            assert_eq!(value(name, MOVES, &["1", "0"]).ok(), Some(Some(1.0)), "{name}");
            assert_eq!(value(name, MOVES, &["1", "1"]).ok(), Some(Some(1.0)), "{name}, always");
            let in_zero = Moving { in_zero: true, ..MOVES };
            assert!(value(name, in_zero, &["1", "0"]).is_err(), "{name}");
        }
        for name in ["MAN", "FIC101.ManAct", "Manual mode", "Hand", "A.FIC101.MAN"] {
            assert_eq!(value(name, MOVES, &["1", "0"]).ok(), Some(Some(0.0)), "{name}");
            let said = value(name, Moving { in_one: true, ..MOVES }, &["1", "0"]).expect_err("it moves in 1");
            assert!(said.to_string().contains("by its name 1 means manual"), "{name}: {said}");
        }
        // Nobody knows which of the two words counts.
        let both = of(&["Auto (manual setpoint)", "Auto (manual setpoint)", "Manual"]);
        assert!(Modes::decide(&both, None, MOVES, "mode").is_err());
    }

    #[test]
    fn words_speak_of_a_mode_where_one_of_them_is_called_nothing_else() {
        for (cells, speaks) in [
            (["AUTO", "MAN"], true),
            (["on", "IMan"], true),
            (["Automatico", "Manuale"], true),
            (["автоматический", "ручной"], true),
            (["on", "off"], false),
            (["closed", "open"], false),
            (["A", "M"], false),
            (["MAN", "off"], false),
            (["AUTO", "back to manual at six"], false),
        ] {
            assert_eq!(of(&cells).speak_of_mode(), speaks, "{cells:?}");
        }
        // What a historian has where nothing was stands in few rows.
        let beside = |odd: usize| of(&[&["AUTO", "MAN"].repeat(9)[..], &vec!["I/O Timeout"; odd]].concat());
        assert!(beside(2).speak_of_mode() && !beside(3).speak_of_mode());
    }

    #[test]
    fn what_is_denied_and_what_is_no_answer_is_not_automatic() {
        for (word, on) in [
            ("Not Auto", Some(0.0)),
            ("NON-AUTO", Some(0.0)),
            ("Nicht Automatik", Some(0.0)),
            ("Not manual", None),
            ("Not Cascade", None),
            ("NOT CAS", None),
            ("Nicht Kaskade", None),
            ("No auto", None),
            ("N/A", None),
            ("n.a.", None),
            ("No", Some(0.0)),
        ] {
            let modes = Modes::decide(&of(&["AUTO", "AUTO", "MAN", word]), None, MOVES, "mode").expect(word);
            assert_eq!(modes.value(&Cell::Text(word)), on, "{word}");
        }
    }

    #[test]
    fn modes_of_vendors_are_known_and_others_asked_for() {
        for (word, on) in [
            ("AUTO", true),
            ("Auto Mode", true),
            ("CASC", true),
            ("RCAS", true),
            ("1", true),
            ("HAND", false),
            ("Manual", false),
            ("MAN", false),
            ("0", false),
            ("Remote Manual", false),
            ("Auto-Local", true),
            ("Local Auto", true),
            ("Local", false),
            ("自动", true),
            ("手動", false),
            ("АВТ", true),
            ("РУЧ", false),
            ("Automatico", true),
            ("Manuale", false),
            ("Manuel", false),
            ("Ręczny", false),
            ("Automatyczny", true),
            ("Handbetrieb", false),
            ("Automatikbetrieb", true),
        ] {
            let modes =
                Modes::decide(&of(&[word, "AUTO", "MAN"]), None, Moving::default(), "mode").expect(word);
            assert_eq!(modes.value(&Cell::Text(word)), Some(f64::from(u8::from(on))), "{word}");
        }
        let always = Modes::decide(&of(&["16", "16"]), None, MOVES, "mode").expect("OP moves");
        assert_eq!(always.value(&Cell::Text("16")), Some(1.0));
        assert!(always.said.is_some_and(|said| said.contains("always \"16\"")));
        let said = |words: &[&str], moves: Moving| {
            Modes::decide(&of(words), None, moves, "mode").expect_err("refused").to_string()
        };
        assert_eq!(
            said(&["16", "8", "16"], MOVES),
            "column mode: the mode is \"16\" (2 rows), \"8\" (1 row); say which of them are automatic with --auto-values"
        );
        assert!(said(&["16", "16"], Moving::default()).contains("--auto-values"));
        assert!(said(&["1", "2"], MOVES).contains("--auto-values"), "1 is manual for some");
        let manual = Modes::decide(&of(&["1", "0", "0"]), None, MOVES, "FIC101.Manual").expect("a bit");
        assert_eq!((manual.value(&Cell::Text("0")), manual.value(&Cell::Text("1"))), (Some(1.0), Some(0.0)));
        let words = Modes::decide(&of(&["MAN", "AUTO"]), None, MOVES, "Auto/Manual").expect("words");
        assert_eq!(words.value(&Cell::Text("AUTO")), Some(1.0));
        let in_zero = Moving { at_all: true, in_zero: true, in_one: false };
        assert!(said(&["0", "1", "0"], in_zero).contains("OP moves by itself only while the mode is 0"));
        let reversed = Modes::decide(&of(&["0", "1"]), Some(&["0".into()]), in_zero, "mode").expect("told");
        assert_eq!(
            (reversed.value(&Cell::Text("0")), reversed.value(&Cell::Text("1"))),
            (Some(1.0), Some(0.0))
        );
        let told = Modes::decide(&of(&["16", "8"]), Some(&["16.0".into(), "32".into()]), MOVES, "mode")
            .expect("told");
        assert_eq!((told.value(&Cell::Number(16.0)), told.value(&Cell::Text("8"))), (Some(1.0), Some(0.0)));
        assert_eq!(told.value(&Cell::Blank), None, "nobody knows");
        assert_eq!(as_words(&["null", "\\n", "blank", "1.0"].map(String::from)), ["", "", "", "1"]);
    }
}
