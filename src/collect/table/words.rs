//! Columns of words: the controller's mode, and whether a value is good. What a word means is decided from the whole column.

use super::error::{TableError, shown};
use super::number;
use super::source::Cell;
use crate::signal::{BadReason, Quality};

/// Different words of a column that are remembered.
const MOST: usize = 64;
/// Words in a message.
const NAMED: usize = 6;

/// The words of a column, and how many rows have each.
#[derive(Clone, Debug, Default)]
pub struct Words {
    counts: Vec<(String, u64)>,
    /// There were more than are remembered.
    more: bool,
    /// The last one and its place: columns of words repeat themselves.
    last: usize,
}

/// A cell as a word: small letters, and numbers without a fraction as such.
fn word(cell: &Cell<'_>) -> String {
    match cell {
        Cell::Number(value) => value.to_string(),
        other => {
            let text = other.shown();
            let bare = number::bare(&text);
            match bare.parse::<f64>() {
                Ok(value) if value.is_finite() => value.to_string(),
                _ => bare.to_lowercase(),
            }
        }
    }
}

impl Words {
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

    /// Whether they tell good values from others beyond doubt: in words of which most, or one beside others that may, mean nothing
    /// else, or in the numbers of OPC, some of them not good.
    pub fn speak_of_quality(&self) -> bool {
        if self.more {
            return false;
        }
        let rows = |of: &dyn Fn(&str) -> bool| -> u64 {
            self.counts.iter().filter(|(word, _)| of(word)).map(|(_, count)| *count).sum()
        };
        let all = rows(&|_| true);
        if let Some(numbers) = self.numbers() {
            let good = rows(&|word| word.parse().is_ok_and(|n: f64| (192.0..220.0).contains(&n)));
            let zero = rows(&|word| word == "0");
            let da = numbers.iter().all(|n| OPC_DA.contains(n)) && good * 2 > all && good < all;
            let severe = |n: &f64| *n == 0.0 || (OPC_UA..4.0 * OPC_UA).contains(n) && n.fract() == 0.0;
            return da || numbers.iter().all(severe) && zero * 2 > all && zero < all;
        }
        let plain = rows(&|word| UNMISTAKABLE.iter().any(|own| first_word(word).starts_with(own)));
        plain * 2 > all || plain > 0 && self.counts.iter().all(|(word, _)| is_known(word))
    }

    /// Whether they are all yes or no.
    pub fn are_flags(&self) -> bool {
        !self.counts.is_empty()
            && self.counts.iter().all(|(word, _)| FLAGS.as_flattened().contains(&word.as_str()))
    }

    /// Whether any of them says that an input or output is open.
    pub fn tell_open(&self) -> bool {
        self.counts.iter().any(|(word, _)| OPEN.contains(&word.as_str()))
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

    /// The numbers among them; `None` where one is none.
    fn numbers(&self) -> Option<Vec<f64>> {
        self.counts.iter().map(|(word, _)| word.parse().ok()).collect()
    }

    /// The most frequent ones, for a message.
    fn listed(&self) -> String {
        let mut counts: Vec<_> = self.counts.iter().collect();
        counts.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
        let one = |(word, count): &&(String, u64)| format!("{:?} ({count} rows)", shown(word));
        let mut out: Vec<String> = counts.iter().take(NAMED).map(one).collect();
        if counts.len() > NAMED || self.more {
            out.push("…".into());
        }
        out.join(", ")
    }
}

/// Words of automatic: the controller moves the valve by itself.
const AUTOMATIC: [&str; 20] = [
    "auto",
    "automatic",
    "aut",
    "cas",
    "casc",
    "cascade",
    "rcas",
    "a",
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
];
/// Words of not automatic.
const NOT_AUTOMATIC: [&str; 20] = [
    "man", "manual", "hand", "m", "rout", "oos", "iman", "lo", "off", "false", "track", "trk", "manuell",
    "init", "local", "override", "none", "out", "hold", "open",
];

/// What the words of a mode column mean.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Modes {
    /// Those that are automatic; `None` where the usual words are.
    automatic: Option<Vec<String>>,
    /// What is remarkable of it.
    pub said: Option<String>,
}

/// Whether a word is automatic; `None` where nobody knows.
fn usual(word: &str) -> Option<bool> {
    match word {
        "1" => return Some(true),
        "0" => return Some(false),
        _ => {}
    }
    let is = |names: &[&str], part: &str| names.contains(&part);
    let parts = || word.split(|c: char| !c.is_alphanumeric()).filter(|part| !part.is_empty());
    // `Remote manual` is manual, whatever else it says.
    if parts().any(|part| is(&NOT_AUTOMATIC, part)) {
        return Some(false);
    }
    parts().any(|part| is(&AUTOMATIC, part)).then_some(true)
}

impl Modes {
    /// Decides; `op_moves` tells whether OP changed from row to row while the mode was what it was.
    ///
    /// # Errors
    /// Words of which none is known.
    pub fn decide(
        words: &Words,
        told: Option<&[String]>,
        op_moves: bool,
        name: &str,
    ) -> Result<Self, TableError> {
        if let Some(told) = told {
            let same =
                |one: &String| one.parse::<f64>().map_or_else(|_| one.clone(), |value| value.to_string());
            let told: Vec<String> = told.iter().map(same).collect();
            let said = Some(format!("automatic is {} by --auto-values", told.join(", ")));
            return Ok(Self { automatic: Some(told), said });
        }
        let doubt = || {
            Err(TableError::refused(format!(
                "column {name}: the mode is {}; say which of them are automatic with --auto-values",
                words.listed()
            )))
        };
        let plain = Self { automatic: None, said: None };
        if let ([(only, _)], None) =
            (words.counts.as_slice(), words.counts.first().and_then(|(w, _)| usual(w)))
        {
            if !op_moves {
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
            Some(own) => Some(f64::from(u8::from(own.contains(&word)))),
            None => usual(&word).map(|on| f64::from(u8::from(on))),
        }
    }
}

/// How a column says that a value is good.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Says {
    /// These are good.
    Told(Vec<String>),
    /// By a loop's alarms as Yokogawa's CENTUM writes them: an open input or output is bad, a limit that is passed is not.
    Alarm,
    /// By a flag; whether it is set where the value is good, or where it is bad.
    Flag(bool),
    /// In words; whether a blank cell is good, as where only what is bad is written.
    Words(bool),
    /// As OPC DA numbers it: 192 and above is good, 64 to 127 uncertain.
    OpcDa,
    /// As OPC UA numbers it: severity in the two highest of 32 bits.
    OpcUa,
}

/// Words of a good value.
const GOOD: [&str; 27] = [
    "good",
    "ok",
    "normal",
    "norm",
    "nr",
    "valid",
    "g",
    "true",
    "goodnoncascade",
    "goodcascade",
    "gut",
    "healthy",
    "192",
    "goodnonspecific",
    "bon",
    "buena",
    "bueno",
    "god",
    "goed",
    "bom",
    "buono",
    "dobry",
    "dobrá",
    "hyvä",
    "iyi",
    "хорошее",
    "良",
];
/// Words of one that is repeated, or of which the source is not sure.
const UNSURE: [&str; 6] = ["stale", "uncertain", "questionable", "substituted", "u", "old"];
/// Words of a bad one.
const BAD: [&str; 26] = [
    "bad",
    "invalid",
    "iop",
    "fail",
    "failed",
    "error",
    "b",
    "false",
    "nok",
    "no",
    "timeout",
    "schlecht",
    "mauvais",
    "mala",
    "malo",
    "dålig",
    "dårlig",
    "slecht",
    "mau",
    "ruim",
    "cattivo",
    "zły",
    "huono",
    "kötü",
    "плохое",
    "不良",
];

/// Words of a flag that is not set, and of one that is.
const FLAGS: [[&str; 4]; 2] = [["0", "false", "no", "n"], ["1", "true", "yes", "y"]];
/// Names of flags that are set where a value is bad.
const BAD_FLAGS: [&str; 5] = ["bad", "isbad", "questionable", "invalid", "substituted"];
/// Names of flags that are set where a value is good.
const GOOD_FLAGS: [&str; 4] = ["good", "isgood", "valid", "isvalid"];

/// The last word of a name.
fn last_word(name: &str) -> String {
    let small = name.trim().to_lowercase();
    small.rsplit(|c: char| !c.is_alphanumeric()).find(|part| !part.is_empty()).unwrap_or("").to_string()
}

/// Names of a loop's alarms.
const ALARMS: [&str; 3] = ["alrm", "alarm", "alst"];
/// Alarms of CENTUM that say of a value that it is none: input open, output open.
const OPEN: [&str; 4] = ["iop", "iop-", "iop+", "oop"];

/// Whether a column of this name holds the alarms of a loop: `FIC101.ALRM`.
pub fn is_alarm(name: &str) -> bool {
    ALARMS.contains(&last_word(name).as_str())
}

/// Whether a column of this name holds the confidence of Honeywell's PHD: 100 is good, 0 and -1 are not.
fn is_confidence(name: &str) -> bool {
    last_word(name) == "confidence"
}

/// Whether a column of this name holds a flag that is set where a value is bad: `PV_BAD`, `Questionable`.
pub fn is_bad_flag(name: &str) -> bool {
    BAD_FLAGS.contains(&last_word(name).as_str())
}

/// Whether a column of this name holds a flag that is set where a value is good: `PV_GOOD`, `IsValid`.
pub fn is_good_flag(name: &str) -> bool {
    GOOD_FLAGS.contains(&last_word(name).as_str())
}

/// How words begin that say nothing but how good a value is.
const UNMISTAKABLE: [&str; 11] = [
    "good",
    "bad",
    "uncertain",
    "questionable",
    "invalid",
    "gut",
    "schlecht",
    "bon",
    "mauvais",
    "buen",
    "良",
];
/// Numbers that OPC DA has for quality: good, uncertain and bad, with and without their reasons.
const OPC_DA: [f64; 15] =
    [0.0, 4.0, 8.0, 12.0, 16.0, 20.0, 24.0, 28.0, 64.0, 68.0, 80.0, 84.0, 88.0, 192.0, 216.0];
/// The least number of OPC UA that is not good.
const OPC_UA: f64 = 1_073_741_824.0;

fn first_word(word: &str) -> &str {
    word.split(|c: char| !c.is_alphanumeric()).find(|part| !part.is_empty()).unwrap_or("")
}

fn is_known(word: &str) -> bool {
    let first = first_word(word);
    Quality::named(word).is_some()
        || [&GOOD[..], &UNSURE, &BAD].iter().any(|names| names.contains(&first))
        || first.starts_with("good")
        || first.starts_with("bad")
        || first.starts_with("uncertain")
}

/// What a word says; one that is not known is not good.
fn quality_of(word: &str) -> Quality {
    let first = first_word(word);
    if let Some(own) = Quality::named(word) {
        own
    } else if GOOD.contains(&first) || first.starts_with("good") {
        Quality::Good
    } else if UNSURE.contains(&first) || first.starts_with("uncertain") {
        Quality::Stale
    } else {
        Quality::Bad(BadReason::DeviceException)
    }
}

impl Says {
    /// Decides; `None` where the column says nothing of the kind.
    ///
    /// # Errors
    /// Numbers or words that two sources mean in two ways.
    pub fn decide(words: &Words, told: Option<&[String]>, name: &str) -> Result<Option<Self>, TableError> {
        if let Some(told) = told {
            let same =
                |one: &String| one.parse::<f64>().map_or_else(|_| one.clone(), |value| value.to_string());
            return Ok(Some(Says::Told(told.iter().map(same).collect())));
        }
        if (is_bad_flag(name) || is_good_flag(name)) && words.are_flags() {
            return Ok(Some(Says::Flag(is_good_flag(name))));
        }
        if is_alarm(name) && words.tell_open() {
            return Ok(Some(Says::Alarm));
        }
        let doubt = || {
            Err(TableError::refused(format!(
                "column {name}: it holds {}; say which of them are good with --good-values",
                words.listed()
            )))
        };
        if words.counts.is_empty() {
            return Ok(None);
        }
        if let Some(numbers) = words.numbers() {
            let da = |n: &f64| n.fract() == 0.0 && (0.0..65_536.0).contains(n);
            // Above 255 a vendor's number may have the bits of good without being so: Ignition's 500 is bad.
            let doubtful = numbers.iter().any(|n| *n > 255.0 && da(n) && *n as u64 & 0xc0 == 0xc0);
            // 0 is bad in one numbering and good in the other: another number has to say which it is.
            return if doubtful {
                doubt()
            } else if is_confidence(name) && numbers.iter().all(|n| [-1.0, 0.0, 100.0].contains(n)) {
                Ok(Some(Says::Told(vec!["100".into()])))
            } else if numbers.iter().any(|n| (192.0..256.0).contains(n)) && numbers.iter().all(da) {
                Ok(Some(Says::OpcDa))
            } else if numbers.iter().any(|n| *n >= f64::from(0x4000_0000u32))
                && numbers.iter().all(|n| *n >= 0.0)
            {
                Ok(Some(Says::OpcUa))
            } else {
                doubt()
            };
        }
        let known = words.counts.iter().filter(|(word, _)| is_known(word)).count();
        // A word that nobody knows may say good: where most of the column is such, it is asked for.
        let rows: u64 = words.counts.iter().map(|(_, count)| *count).sum();
        let strange: u64 =
            words.counts.iter().filter(|(word, _)| !is_known(word)).map(|(_, count)| *count).sum();
        if known == 0 || strange * 2 > rows {
            return doubt();
        }
        let any_good = words.counts.iter().any(|(word, _)| quality_of(word).is_good());
        Ok(Some(Says::Words(!any_good)))
    }

    /// The quality that a cell says; a blank one says nothing good.
    pub fn quality(&self, cell: &Cell<'_>) -> Quality {
        let bad = Quality::Bad(BadReason::DeviceException);
        let word = word(cell);
        let number = || word.parse::<f64>().ok().filter(|n| *n >= 0.0 && n.fract() == 0.0).map(|n| n as u64);
        match self {
            Says::Told(good) if good.contains(&word) => Quality::Good,
            Says::Told(_) => bad,
            Says::Alarm if OPEN.contains(&word.as_str()) => bad,
            Says::Alarm => Quality::Good,
            Says::Flag(good) if FLAGS[1].contains(&word.as_str()) == *good => Quality::Good,
            Says::Flag(_) => bad,
            Says::OpcDa => match number().map(|n| n & 0xc0) {
                Some(0xc0) => Quality::Good,
                Some(0x40) => Quality::Stale,
                _ => bad,
            },
            Says::OpcUa => match number().map(|n| n >> 30) {
                Some(0) => Quality::Good,
                Some(1) => Quality::Stale,
                _ => bad,
            },
            Says::Words(blank_is_good) if word.is_empty() => {
                if *blank_is_good {
                    Quality::Good
                } else {
                    bad
                }
            }
            Says::Words(_) => quality_of(&word),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(cells: &[&str]) -> Words {
        let mut words = Words::default();
        cells.iter().for_each(|cell| words.add(&Cell::Text(cell)));
        words
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
        ] {
            let modes = Modes::decide(&of(&[word, "AUTO", "MAN"]), None, false, "mode").expect(word);
            assert_eq!(modes.value(&Cell::Text(word)), Some(f64::from(u8::from(on))), "{word}");
        }
        let always = Modes::decide(&of(&["16", "16"]), None, true, "mode").expect("OP moves");
        assert_eq!(always.value(&Cell::Text("16")), Some(1.0));
        assert!(always.said.is_some_and(|said| said.contains("always \"16\"")));
        let said = |words: &[&str], moves| {
            Modes::decide(&of(words), None, moves, "mode").expect_err("refused").to_string()
        };
        assert_eq!(
            said(&["16", "8", "16"], true),
            "column mode: the mode is \"16\" (2 rows), \"8\" (1 rows); say which of them are automatic with --auto-values"
        );
        assert!(said(&["16", "16"], false).contains("--auto-values"));
        assert!(said(&["1", "2"], true).contains("--auto-values"), "1 is manual for some");
        let told = Modes::decide(&of(&["16", "8"]), Some(&["16.0".into(), "32".into()]), true, "mode")
            .expect("told");
        assert_eq!((told.value(&Cell::Number(16.0)), told.value(&Cell::Text("8"))), (Some(1.0), Some(0.0)));
    }

    #[test]
    fn qualities_are_those_of_opc_or_words() {
        let bad = Quality::Bad(BadReason::DeviceException);
        let says = |cells: &[&str]| Says::decide(&of(cells), None, "q").map_err(|error| error.to_string());
        let da = says(&["192", "0", "64"]).expect("OPC DA").expect("some");
        assert_eq!(
            ["192", "216", "64", "0"].map(|q| da.quality(&Cell::Text(q))),
            [Quality::Good, Quality::Good, Quality::Stale, bad]
        );
        let ua = says(&["0", "2147483648"]).expect("OPC UA").expect("some");
        assert_eq!([0.0, 2_147_483_648.0].map(|q| ua.quality(&Cell::Number(q))), [Quality::Good, bad]);
        let words = says(&["Good", "Bad - no comm"]).expect("words").expect("some");
        assert_eq!(
            ["Good [192]", "GoodNonCascade", "Uncertain", "Bad - no comm", "I/O Timeout", "bad:timeout"]
                .map(|q| words.quality(&Cell::Text(q))),
            [Quality::Good, Quality::Good, Quality::Stale, bad, bad, Quality::Bad(BadReason::Timeout)]
        );
        assert!(says(&["0", "0"]).expect_err("a doubt").contains("--good-values"));
        assert!(says(&["0", "1"]).expect_err("a doubt").contains("--good-values"));
        assert!(says(&["running"]).expect_err("a doubt").contains("--good-values"));
    }
}
