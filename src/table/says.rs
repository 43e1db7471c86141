//! How a column says that a value is good: in words, by a flag, by alarms, in the numbers of OPC, or as somebody tells.

use super::error::TableError;
use super::number::{self, Number};
use super::source::Cell;
use super::words::{Words, as_words, word};
use crate::signal::{BadReason, Quality};

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
    /// As OPC DA numbers it: 192 and above is good, 64 to 127 uncertain, and none is from 128 to 191.
    OpcDa,
    /// As OPC UA numbers it: severity in the two highest of 32 bits.
    OpcUa,
}

/// Words of a good value.
const GOOD: [&str; 30] = [
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
    "bonne",
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
    "buona",
    "양호",
];
/// Words of one that is repeated, or of which the source is not sure.
const UNSURE: [&str; 7] = ["stale", "uncertain", "questionable", "substituted", "u", "old", "fair"];
/// Words of a bad one.
const BAD: [&str; 36] = [
    "fault",
    "faulty",
    "defekt",
    "störung",
    "gestört",
    "špatná",
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
    "mauvaise",
    "poor",
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
    "cattiva",
    "불량",
];

/// Words that deny the one behind them.
const NO: [&str; 7] = ["no", "kein", "keine", "ohne", "sans", "sin", "sem"];
/// Words of what is wrong that nobody calls a value by itself.
const FAULTS: [&str; 8] = ["errors", "faults", "failure", "fehler", "erreur", "défaut", "falla", "falha"];

/// Words of a flag that is not set, and of one that is.
const FLAGS: [[&str; 5]; 2] = [["0", "false", "no", "n", "off"], ["1", "true", "yes", "y", "on"]];
/// Names of flags that are set where a value is bad.
const BAD_FLAGS: [&str; 12] = [
    "bad",
    "isbad",
    "badpv",
    "badpvfl",
    "pvbad",
    "opbad",
    "badop",
    "iobad",
    "badquality",
    "questionable",
    "invalid",
    "substituted",
];
/// Names of flags that are set where a value is good.
const GOOD_FLAGS: [&str; 4] = ["good", "isgood", "valid", "isvalid"];
/// Words of flags that say nothing unless the name of a value stands beside them, `PV_FAULT` and `PV_OK`: set where it is bad, and
/// where it is good.
const OF_VALUES: [[&str; 3]; 2] = [["fault", "err", "error"], ["ok", "vld", "healthy"]];

/// The words of a name, in small letters.
fn words_of(name: &str) -> Vec<String> {
    let small = name.to_lowercase();
    let words = small.split(|c: char| !c.is_alphanumeric()).filter(|part| !part.is_empty());
    words.map(str::to_string).collect()
}

/// The last word of a name.
fn last_word(name: &str) -> String {
    words_of(name).pop().unwrap_or_default()
}

/// Whether a name ends with this word and `quality`: `pv_bad_quality`.
fn is_kind_of_quality(words: &[String], kind: &str) -> bool {
    matches!(words, [.., own, quality] if own == kind && quality == "quality")
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
    ["confidence", "conf"].contains(&last_word(name).as_str())
}

/// Whether a column of this name says how much of an average is good, as AVEVA's PI does: all of it, 100, or less.
fn is_percent_good(name: &str) -> bool {
    let small = name.trim().to_lowercase();
    ["percentgood", "percent good", "pctgood", "pct good", "% good"].iter().any(|own| small.ends_with(own))
}

/// Whether a column of this name holds a flag that is set where a value is bad: `PV_BAD`, `Bad_PV`, `Questionable`.
pub fn is_bad_flag(name: &str) -> bool {
    let words = words_of(name);
    let begins = words.len() > 1 && words[0] == "bad";
    let ends = words.last().is_some_and(|word| BAD_FLAGS.contains(&word.as_str()));
    begins || ends || is_kind_of_quality(&words, "bad") || is_of_value(name, false)
}

/// Whether a name has a flag that speaks of the value beside it alone: at its end, or any flag before the value, `Valid_PV`.
pub fn is_of_value(name: &str, good: bool) -> bool {
    let words = words_of(name);
    let of_value = |word: &String| OF_VALUES[usize::from(good)].contains(&word.as_str());
    let flags: &[&str] = if good { &GOOD_FLAGS } else { &BAD_FLAGS };
    let before = |word: &String| of_value(word) || flags.contains(&word.as_str()) && word != "bad";
    words.last().is_some_and(of_value) || words.len() > 1 && words.first().is_some_and(before)
}

/// Whether a column of this name holds a flag that is set where a value is good: `PV_GOOD`, `Valid_PV`, `IsValid`.
pub fn is_good_flag(name: &str) -> bool {
    let words = words_of(name);
    let ends = words.last().is_some_and(|word| GOOD_FLAGS.contains(&word.as_str()));
    ends || is_kind_of_quality(&words, "good") || is_of_value(name, true)
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
/// Other words behind a number that are no unit of it.
const NO_UNITS: [&str; 9] = ["ok", "nok", "fail", "failed", "fault", "stale", "poor", "fair", "error"];
/// Letters by which Emerson's Ovation says that a value is good, and those of what is not: fair, poor and bad. Others have `U` for
/// uncertain. Fair is a value that was entered or taken from elsewhere, so that no transmitter measured it.
const LETTER_OF_GOOD: &str = "g";
/// See [`LETTER_OF_GOOD`].
const LETTERS: [&str; 4] = ["b", "f", "p", "u"];
/// Numbers that OPC DA has for quality: good, uncertain and bad, with and without their reasons.
const OPC_DA: [f64; 15] =
    [0.0, 4.0, 8.0, 12.0, 16.0, 20.0, 24.0, 28.0, 64.0, 68.0, 80.0, 84.0, 88.0, 192.0, 216.0];
/// The least number of OPC UA that is not good.
const OPC_UA: f64 = 1_073_741_824.0;

fn first_word(word: &str) -> &str {
    word.split(|c: char| !c.is_alphanumeric()).find(|part| !part.is_empty()).unwrap_or("")
}

/// Whether a word denies what is bad: `No error`.
fn denies(word: &str) -> bool {
    let mut parts = word.split(|c: char| !c.is_alphanumeric()).filter(|part| !part.is_empty());
    let (no, bad) = (parts.next().unwrap_or(""), parts.next().unwrap_or(""));
    NO.contains(&no) && (BAD.contains(&bad) || FAULTS.contains(&bad)) && parts.next().is_none()
}

fn is_known(word: &str) -> bool {
    let first = first_word(word);
    Quality::named(word).is_some()
        || denies(word)
        || [&GOOD[..], &UNSURE, &BAD].iter().any(|names| names.contains(&first))
        || ["good", "bad", "uncertain"].iter().any(|own| first.starts_with(own))
        || behind_comma(word).is_some()
}

/// A word as a number of quality, also as programs write its bits: `0xC0`, `16#80`.
fn code(word: &str) -> Option<f64> {
    let bits = || word.strip_prefix("0x").or_else(|| word.strip_prefix("16#"));
    let hex = || u32::from_str_radix(bits()?, 16).ok().map(f64::from);
    word.parse().ok().or_else(hex)
}

/// Whether a number of quality has the bits `10`, which OPC DA does not know: they are good in PROFIBUS and FOUNDATION Fieldbus.
fn is_of_a_fieldbus(number: f64) -> bool {
    (128.0..65_536.0).contains(&number) && number as u64 & 0xc0 == 0x80
}

/// A cell of a tag as a number. A word in brackets behind it is no unit, but may say how good it is: `51.8 (Good)`.
pub fn measured(cell: &str) -> Option<Number<'_>> {
    number::scan(cell).or_else(|| {
        let cell = number::bare(cell);
        let (digits, said) = cell.split_at(cell.find(['(', '['])?);
        let is_said = matches!(behind_number(said, false), ("", Some(_)));
        let number = number::scan(digits).filter(|number| is_said && number.unit.is_empty());
        number.map(|number| number.with_unit(said))
    })
}

/// A word without brackets around it; `None` for a part of what stands in brackets, the `good)` of `(not good)`.
fn out_of_brackets(word: &str) -> Option<&str> {
    const BRACKETS: [(char, char); 2] = [('(', ')'), ('[', ']')];
    if BRACKETS.iter().any(|(open, close)| word.contains(*open) != word.contains(*close)) {
        return None;
    }
    let within = BRACKETS.iter().find_map(|(open, close)| word.strip_prefix(*open)?.strip_suffix(*close));
    Some(within.map_or(word, str::trim))
}

/// What stands behind a number, as its unit and the quality that it says: `51.2 Bad`, `51.2 % (Bad)`. Single letters may be units, `g`
/// is one, so that `letters` has to tell that they are none.
pub fn behind_number(unit: &str, letters: bool) -> (&str, Option<Quality>) {
    let says = |word: &str| {
        let small = out_of_brackets(word)?.to_lowercase();
        let letter = letters && (small == LETTER_OF_GOOD || LETTERS.contains(&small.as_str()));
        let plain =
            UNMISTAKABLE.iter().any(|own| small.starts_with(own)) || NO_UNITS.contains(&small.as_str());
        (letter || plain).then(|| quality_of(&small))
    };
    if let Some(quality) = says(unit) {
        return ("", Some(quality));
    }
    let last = unit.rsplit_once(char::is_whitespace);
    match last.and_then(|(own, word)| Some((own.trim_end(), says(word)?))) {
        Some((own, quality)) => (own, Some(quality)),
        None => (unit, None),
    }
}

/// Whether of the units of one tag most are `G` and some another letter of quality: then they are none.
pub fn are_letters<'u>(units: impl Iterator<Item = &'u str>, most: &str) -> bool {
    let mut others = units.map(str::to_lowercase);
    most.to_lowercase() == LETTER_OF_GOOD && others.any(|unit| LETTERS.contains(&unit.as_str()))
}

/// What OPC HDA says behind where a value comes from: `Raw, Good`.
fn behind_comma(word: &str) -> Option<Quality> {
    let (source, said) = word.split_once(',')?;
    let sources = ["raw", "calculated", "interpolated", "extra data"];
    let is_source = sources.contains(&source.trim());
    (is_source && is_known(said.trim())).then(|| quality_of(said.trim()))
}

/// What a word says; one that is not known is not good.
fn quality_of(word: &str) -> Quality {
    let first = first_word(word);
    if let Some(own) = Quality::named(word).or_else(|| behind_comma(word)) {
        own
    } else if GOOD.contains(&first) || first.starts_with("good") || denies(word) {
        Quality::Good
    } else if UNSURE.contains(&first) || first.starts_with("uncertain") {
        Quality::Stale
    } else {
        Quality::Bad(BadReason::DeviceException)
    }
}

impl Words {
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
        if let Some(numbers) = self.codes() {
            let good = rows(&|word| code(word).is_some_and(|n| (192.0..220.0).contains(&n)));
            let zero = rows(&|word| code(word) == Some(0.0));
            let da = numbers.iter().all(|n| OPC_DA.contains(n)) && good * 2 > all && good < all;
            let severe = |n: &f64| *n == 0.0 || (OPC_UA..4.0 * OPC_UA).contains(n) && n.fract() == 0.0;
            return da || numbers.iter().all(severe) && zero * 2 > all && zero < all;
        }
        let plain = rows(&|word| UNMISTAKABLE.iter().any(|own| first_word(word).starts_with(own)));
        plain * 2 > all || plain > 0 && self.counts.iter().all(|(word, _)| is_known(word))
    }

    /// The numbers of quality that they are; `None` where one is none.
    fn codes(&self) -> Option<Vec<f64>> {
        self.counts.iter().map(|(word, _)| code(word)).collect()
    }

    /// Whether they are numbers of 32 bits, written out as such: those of OPC UA, `0x00000000`.
    fn are_of_32_bits(&self) -> bool {
        let digits = |word: &str| word.strip_prefix("0x").or_else(|| word.strip_prefix("16#")).map(str::len);
        !self.counts.is_empty() && self.counts.iter().all(|(word, _)| digits(word) == Some(8))
    }

    /// Whether none of them is bad under this name, so that it does not matter which value they speak of.
    pub fn are_all_good(&self, name: &str) -> bool {
        let good =
            |says: &Says| self.counts.iter().all(|(word, _)| says.quality(&Cell::Text(word)).is_good());
        !self.more && Says::decide(self, None, name).is_ok_and(|says| says.is_some_and(|says| good(&says)))
    }

    /// Whether they may tell good values from others, by words that mean other things as well: all are known, most rows are good and
    /// some are not. Numbers, yes and no, and letters mean anything, and a longer text is a remark.
    pub fn may_speak_of_quality(&self) -> bool {
        let rows = |of: &dyn Fn(&str) -> bool| -> u64 {
            self.counts.iter().filter(|(word, _)| of(word)).map(|(_, count)| *count).sum()
        };
        let is_short = |word: &str| !word.contains(',') && word.split_whitespace().count() <= 3;
        let all_known = self.counts.iter().all(|(word, _)| is_known(word) && is_short(word));
        let means_more = self.are_flags() || self.numbers().is_some() || self.are_marks();
        let good = rows(&|word| quality_of(word).is_good());
        !self.more && all_known && !means_more && good * 2 > self.rows() && good < self.rows()
    }

    /// Whether they are single letters or signs.
    pub fn are_marks(&self) -> bool {
        !self.more
            && self.counts.iter().all(|(word, _)| word.chars().count() == 1)
            && self.numbers().is_none()
    }

    /// Whether there are several in a column of so many rows, or blank cells beside one; numbers are measurements.
    pub fn tell_rows_apart(&self, rows: u64) -> bool {
        let words = self.counts.len();
        !self.more && !self.any_number() && (words > 1 || words == 1 && self.rows() < rows)
    }

    /// Whether they are letters, `G` for good in most rows and others for what is not.
    pub fn are_letters_of_quality(&self) -> bool {
        let good = self.counts.iter().find(|(word, _)| word == LETTER_OF_GOOD).map_or(0, |(_, count)| *count);
        let all: u64 = self.counts.iter().map(|(_, count)| count).sum();
        let is_letter = |word: &str| word.len() == 1 && (is_known(word) || LETTERS.contains(&word));
        let letters = self.counts.iter().all(|(word, _)| is_letter(word));
        !self.more && letters && good * 2 > all
    }

    /// Whether they are all yes or no.
    pub fn are_flags(&self) -> bool {
        !self.counts.is_empty()
            && self.counts.iter().all(|(word, _)| FLAGS.as_flattened().contains(&word.as_str()))
    }

    /// Whether they are a state under some numbering, or yes and no: few whole numbers, one of them in half of the rows or more, as
    /// nothing is that is measured.
    pub fn are_states(&self) -> bool {
        const FEW: usize = 8;
        let is_state = |word: &str| {
            FLAGS.as_flattened().contains(&word) || code(word).is_some_and(|number| number.fract() == 0.0)
        };
        let most = self.counts.iter().map(|(_, count)| *count).max().unwrap_or(0);
        let are_few = !self.more && (1..=FEW).contains(&self.counts.len());
        are_few && most * 2 >= self.rows() && self.counts.iter().all(|(word, _)| is_state(word))
    }

    /// Whether any of them says that an input or output is open.
    pub fn tell_open(&self) -> bool {
        self.counts.iter().any(|(word, _)| OPEN.contains(&word.as_str()))
    }
}

impl Says {
    /// Decides; `None` where the column says nothing of the kind.
    ///
    /// # Errors
    /// Numbers or words that two sources mean in two ways.
    pub fn decide(words: &Words, told: Option<&[String]>, name: &str) -> Result<Option<Self>, TableError> {
        if let Some(told) = told {
            return Ok(Some(Says::Told(as_words(told))));
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
        if let Some(numbers) = words.codes() {
            let da = |n: &f64| n.fract() == 0.0 && (0.0..65_536.0).contains(n);
            // Above 255 a vendor's number may have the bits of good without being so: Ignition's 500 is bad.
            let doubtful = numbers.iter().any(|n| *n > 255.0 && da(n) && *n as u64 & 0xc0 == 0xc0)
                || numbers.iter().any(|n| is_of_a_fieldbus(*n));
            // 0 is bad in one numbering and good in the other: another number has to say which it is.
            return if doubtful {
                doubt()
            } else if last_word(name) == "qc" && numbers.len() == 1 {
                // A code that never changes tells nothing from anything.
                Ok(None)
            } else if is_confidence(name) && numbers.iter().all(|n| [-1.0, 0.0, 100.0].contains(n))
                || is_percent_good(name)
                    && numbers.contains(&100.0)
                    && numbers.iter().all(|n| (0.0..=100.0).contains(n))
            {
                Ok(Some(Says::Told(vec!["100".into()])))
            } else if numbers.iter().any(|n| (192.0..256.0).contains(n)) && numbers.iter().all(da) {
                Ok(Some(Says::OpcDa))
            } else if (numbers.iter().any(|n| *n >= f64::from(0x4000_0000u32)) || words.are_of_32_bits())
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
        let number = || code(&word).filter(|n| *n >= 0.0 && n.fract() == 0.0).map(|n| n as u64);
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
mod tests;
