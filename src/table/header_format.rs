//! The format of times that a header states: `Timestamp (dd/mm/yyyy hh:mm:ss)`.

use super::stamp::Order;

/// Letters of formats in the languages in which programs show them: d, t, j and g for days, m for months and minutes, y, j, a and
/// r for years, h, u and g for hours, s and f for seconds and their fraction.
const LETTERS: &str = "dtjgmyarhusf";
/// Halves of a day, which are no runs of one letter.
const HALVES: [&str; 3] = ["am", "pm", "ampm"];

/// Letters of one kind: which, and how many.
type Run = (char, usize);

/// The runs of letters of a text; `None` for one that is no format: letters in it are of another kind, or stand alone beside
/// others, as in words.
fn runs(text: &str) -> Option<Vec<Run>> {
    let small = text.to_lowercase();
    let mut all = Vec::new();
    for word in small.split(|c: char| !c.is_alphabetic()).filter(|word| !word.is_empty()) {
        if HALVES.contains(&word) {
            continue;
        }
        let begin = all.len();
        for c in word.chars() {
            match all.get_mut(begin..).and_then(<[Run]>::last_mut) {
                Some((own, n)) if *own == c => *n += 1,
                _ => all.push((c, 1)),
            }
        }
        let own = &all[begin..];
        // `yyyy-mm-ddThh:mm:ss`.
        let is_alone = |(c, n): &Run| *n == 1 && *c != 't';
        if own.iter().any(|(c, _)| !LETTERS.contains(*c)) || own.len() > 1 && own.iter().any(is_alone) {
            return None;
        }
    }
    Some(all)
}

/// Whether a text is the format of times: `hh:mm:ss`, `dd/mm/yyyy`, `%d/%m/%Y %H:%M:%S`.
pub fn is_format(text: &str) -> bool {
    runs(text).is_some_and(|runs| runs.len() > 1)
}

/// The order of day, month and year in a format; `None` where they are not all in it.
pub fn order(text: &str) -> Option<Order> {
    let small = text.to_lowercase();
    let is_year = |(c, n): &Run| *c == 'y' || *n == 4 && matches!(c, 'j' | 'a' | 'r');
    let date = |part: &str| {
        let runs = runs(part)?;
        let [a, b, c] = runs.as_slice() else { return None };
        let kind = |own: &Run| match own {
            own if is_year(own) => 'y',
            ('m', _) => 'm',
            _ => 'd',
        };
        match [kind(a), kind(b), kind(c)] {
            ['d', 'm', 'y'] => Some(Order::Dmy),
            ['m', 'd', 'y'] => Some(Order::Mdy),
            ['y', 'm', 'd'] => Some(Order::Ymd),
            _ => None,
        }
    };
    is_format(text).then(|| small.split_whitespace().find_map(date))?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_are_told_from_words() {
        for text in [
            "hh:mm:ss",
            "HH:MM",
            "dd/mm/yyyy hh:mm:ss",
            "DD/MM/YYYY",
            "yyyy-MM-ddTHH:mm:ss.fff",
            "%d/%m/%Y %H:%M:%S",
            "TT.MM.JJJJ hh:mm:ss",
            "ddmmyy",
            "h:mm:ss am/pm",
        ] {
            assert!(is_format(text), "{text}");
        }
        for text in
            ["", "s", "ms", "min", "day", "UTC", "local", "start", "Europe/Berlin", "W. Europe", "h", "mm"]
        {
            assert!(!is_format(text), "{text}");
        }
    }

    #[test]
    fn a_format_says_the_order_of_day_and_month() {
        for (text, expected) in [
            ("dd/mm/yyyy hh:mm:ss", Some(Order::Dmy)),
            ("MM/DD/YY", Some(Order::Mdy)),
            ("yy/mm/dd hh:mm", Some(Order::Ymd)),
            ("hh:mm:ss dd.mm.yyyy", Some(Order::Dmy)),
            ("TT.MM.JJJJ", Some(Order::Dmy)),
            ("jj/mm/aaaa", Some(Order::Dmy)),
            ("%m/%d/%Y %H:%M:%S", Some(Order::Mdy)),
            ("hh:mm:ss", None),
            ("local time", None),
        ] {
            assert_eq!(order(text), expected, "{text}");
        }
    }
}
