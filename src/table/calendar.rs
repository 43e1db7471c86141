//! The words in stamps: names of months and days, halves of a day, letters for time zones.

/// Names of months by their first letters: English, German, French, Spanish, Italian, Dutch.
const MONTHS: [&[&str]; 12] = [
    &["jan", "jän", "ene", "gen"],
    &["feb", "fév", "fev"],
    &["mar", "mär", "mrz", "maa", "mrt"],
    &["apr", "avr", "abr"],
    &["may", "mai", "mei", "mag"],
    &["jun", "juin", "giu"],
    &["jul", "juil", "lug"],
    &["aug", "aoû", "aou", "ago"],
    &["sep", "set"],
    &["oct", "okt", "ott"],
    &["nov"],
    &["dec", "dez", "déc", "dic"],
];
/// Further ones, each as it is abbreviated and as whole names begin: Polish, Portuguese, Russian, Scandinavian, Hungarian, Turkish,
/// Finnish. Polish and Croatian have names in common for different months (`lip`, `lis`, `srp`); those are none.
const FURTHER: [(&[&str], &[&str]); 12] = [
    (&["sty", "янв", "oca"], &["stycz", "январ", "ocak", "tammi"]),
    (&["lut", "фев", "şub"], &["luty", "lutego", "феврал", "şubat", "helmi"]),
    (&["már", "márc", "мар"], &["márci", "март", "maalis"]),
    (&["kwi", "ápr", "апр", "nis"], &["kwie", "április", "апрел", "nisan", "huhti"]),
    (&["maj", "máj", "май", "мая"], &["maja", "május", "touko"]),
    (&["cze", "jún", "июн", "haz"], &["czerw", "június", "июня", "haziran", "kesä"]),
    (&["júl", "июл", "tem"], &["lipca", "lipiec", "július", "июля", "temmuz", "heinä"]),
    (&["sie", "авг", "ağu"], &["sierp", "август", "ağustos", "elokuu"]),
    (&["wrz", "szept", "сен", "eyl"], &["wrześ", "szeptember", "сентяб", "eylül", "syys"]),
    (&["paź", "paz", "out", "окт", "eki"], &["paździer", "outubro", "октяб", "ekim", "loka"]),
    (&["ноя", "kas"], &["ноябр", "kasım", "marras"]),
    (&["gru", "des", "дек", "ara"], &["grudn", "grudz", "desember", "декаб", "aralık", "joulu"]),
];
/// Days of the week say nothing that the date does not.
const WEEKDAYS: [&str; 56] = [
    "mon", "tue", "wed", "thu", "fri", "sat", "sun", "mo", "di", "mi", "do", "fr", "sa", "so", "tues",
    "thur", "lun", "mer", "jeu", "ven", "sam", "dim", "mié", "jue", "vie", "sáb", "dom", "ma", "wo", "пн",
    "вт", "ср", "чт", "пт", "сб", "вс", "za", "vr", "zo", "gio", "sab", "seg", "ter", "qua", "qui", "sex",
    "mån", "tis", "ons", "tor", "tors", "fre", "lör", "lør", "sön", "søn",
];
/// Their whole names, but for those that end as in the languages of Germany, England and Scandinavia: French, Spanish, Italian,
/// Portuguese, Russian, Polish, Czech, Finnish.
const WHOLE_WEEKDAYS: [&str; 55] = [
    "mittwoch",
    "sonnabend",
    "lundi",
    "mardi",
    "mercredi",
    "jeudi",
    "vendredi",
    "samedi",
    "dimanche",
    "lunes",
    "martes",
    "miércoles",
    "miercoles",
    "jueves",
    "viernes",
    "sábado",
    "sabado",
    "domingo",
    "lunedì",
    "martedì",
    "mercoledì",
    "giovedì",
    "venerdì",
    "sabato",
    "domenica",
    "segunda",
    "terça",
    "quarta",
    "quinta",
    "sexta",
    "понедельник",
    "вторник",
    "среда",
    "четверг",
    "пятница",
    "суббота",
    "воскресенье",
    "poniedziałek",
    "wtorek",
    "czwartek",
    "piątek",
    "sobota",
    "niedziela",
    "pondělí",
    "úterý",
    "středa",
    "čtvrtek",
    "pátek",
    "neděle",
    "maanantai",
    "tiistai",
    "keskiviikko",
    "torstai",
    "perjantai",
    "lauantai",
];
/// Words between date and time of day that say nothing: `at`, `kl.`, `à`, and `г.` for the year.
const FILLERS: [&str; 17] =
    ["at", "klo", "kl", "à", "um", "om", "alle", "às", "o", "ob", "u", "v", "в", "г", "года", "lúc", "ora"];
/// Words within a date with the name of its month that say nothing: `15 de junio de 2026`, `June 15th`, `1er juin`.
const OF_DATE: [&str; 10] = ["de", "del", "of", "st", "nd", "rd", "th", "er", "г", "года"];
/// Time zones whose letters are those of one zone only, and their offset (s).
const ZONES: [(&str, i32); 13] = [
    ("z", 0),
    ("utc", 0),
    ("gmt", 0),
    ("wet", 0),
    ("west", 3600),
    ("cet", 3600),
    ("cest", 7200),
    ("mez", 3600),
    ("mesz", 7200),
    ("eet", 7200),
    ("eest", 10_800),
    ("jst", 32_400),
    ("kst", 32_400),
];

/// The month of a name, from 1.
pub fn month(word: &str) -> Option<u32> {
    let word = word.to_lowercase();
    let begins = |names: &[&str]| names.iter().any(|name| word.starts_with(name));
    let further = |(short, whole): &(&[&str], &[&str])| short.contains(&word.as_str()) || begins(whole);
    let at = FURTHER.iter().position(further).or_else(|| MONTHS.iter().position(|names| begins(names)));
    at.map(|at| at as u32 + 1)
}

/// Whether a word is a day of the week.
pub fn is_weekday(word: &str) -> bool {
    let word = word.to_lowercase();
    let ends = ["day", "tag", "dag"].iter().any(|end| word.ends_with(end));
    ends || WEEKDAYS.contains(&word.as_str()) || WHOLE_WEEKDAYS.contains(&word.as_str())
}

/// Whether a word between date and time of day says nothing.
pub fn is_filler(word: &str) -> bool {
    FILLERS.contains(&word.to_lowercase().as_str())
}

/// Whether a word within a date says nothing.
pub fn is_of_date(word: &str) -> bool {
    OF_DATE.contains(&word.to_lowercase().as_str())
}

/// The offset of a zone's letters (s east of Greenwich); `None` where several zones have them, as CST.
pub fn zone(word: &str) -> Option<i32> {
    let word = word.to_lowercase();
    ZONES.iter().find(|(name, _)| *name == word).map(|(_, offset)| *offset)
}

/// Letters of zones that more than one country has.
const AMBIGUOUS: [&str; 13] =
    ["est", "edt", "cst", "cdt", "mst", "mdt", "pst", "pdt", "bst", "ist", "msk", "ast", "akst"];

/// Whether a word is letters of a zone that do not say which.
pub fn is_ambiguous(word: &str) -> bool {
    AMBIGUOUS.contains(&word.to_lowercase().as_str())
}

/// Whether a word behind a time of day, `am` or `pm`, says that it is past noon; also in Greek, Vietnamese (`SA`, `CH`), Turkish
/// and Swedish.
pub fn half(word: &str) -> Option<bool> {
    match word {
        "a" | "A" | "am" | "AM" | "Am" | "π" | "πμ" | "ΠΜ" | "SA" | "ÖÖ" | "fm" => Some(false),
        "p" | "P" | "pm" | "PM" | "Pm" | "μ" | "μμ" | "ΜΜ" | "CH" | "ÖS" | "em" => Some(true),
        _ => None,
    }
}

/// The same of a word before it, as East Asia writes it.
pub fn half_before(word: &str) -> Option<bool> {
    match word {
        "上午" | "오전" | "午前" => Some(false),
        "下午" | "오후" | "午後" => Some(true),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn months_of_many_languages() {
        for (word, number) in [
            ("January", 1),
            ("März", 3),
            ("mars", 3),
            ("maart", 3),
            ("maj", 5),
            ("мая", 5),
            ("czerwca", 6),
            ("junio", 6),
            ("июл", 7),
            ("août", 8),
            ("sierpnia", 8),
            ("settembre", 9),
            ("październik", 10),
            ("marraskuuta", 11),
            ("desember", 12),
            ("márc", 3),
        ] {
            assert_eq!(month(word), Some(number), "{word}");
        }
        // Each week of Dutch, Italian, Portuguese and Swedish, as it is abbreviated.
        for week in ["ma di wo do vr za zo", "lun mar mer gio ven sab dom", "seg ter qua qui sex sáb dom"] {
            assert!(week.split(' ').all(|day| day == "mar" || is_weekday(day)), "{week}");
        }
        assert!("mån tis ons tors fre lör sön".split(' ').all(is_weekday));
        for word in ["Average", "Output", "Process", "LED", "lip", "listopad", "srp", "Test"] {
            assert_eq!(month(word), None, "{word}");
        }
        assert_eq!((zone("CEST"), zone("CST"), zone("utc")), (Some(7200), None, Some(0)));
    }
}
