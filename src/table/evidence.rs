//! Which decimal sign a whole file has: what its cells prove together.
//!
//! A point or a comma with three digits behind it may mark thousands. Such a cell is never read before another one, or the
//! nature of OP, has proved what the sign means; otherwise the file is refused.

use super::error::{TableError, shown};
use super::number::{Decimal, Form, Number};

/// A cell and where it stands.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// Its line.
    pub line: u64,
    /// The name of its column, or of its tag.
    pub name: String,
    /// Whether it is a tag's, in a table with a row for each sample.
    pub of_tag: bool,
    /// What stands there.
    pub cell: String,
}

impl std::fmt::Display for Place {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { line, name, of_tag, cell } = self;
        match of_tag {
            true => write!(out, "line {line}, tag {name:?}: {cell:?}"),
            false => write!(out, "line {line}, column {name}: {cell:?}"),
        }
    }
}

/// What the cells of one column say of the signs; index 0 is the point, 1 the comma.
#[derive(Clone, Debug, Default)]
pub struct Evidence {
    /// Cells by which this sign is the decimal one.
    proves: [u64; 2],
    proved_at: [Option<Place>; 2],
    /// Cells with this sign that prove nothing.
    either: [u64; 2],
    either_at: [Option<Place>; 2],
    /// Cells without a sign, other than zero.
    whole: u64,
    /// Cells with thousands beyond doubt.
    thousands: u64,
}

fn at(decimal: Decimal) -> usize {
    usize::from(decimal == Decimal::Comma)
}

impl Evidence {
    /// One more cell of a column.
    pub fn add(&mut self, number: &Number<'_>, line: u64, column: &str, cell: &str) {
        self.count(number, || Place { line, name: column.to_string(), of_tag: false, cell: shown(cell) });
    }

    /// One more cell of a tag, in a table with a row for each sample.
    pub fn add_of_tag(&mut self, number: &Number<'_>, line: u64, tag: &str, cell: &str) {
        self.count(number, || Place { line, name: tag.to_string(), of_tag: true, cell: shown(cell) });
    }

    fn count(&mut self, number: &Number<'_>, place: impl Fn() -> Place) {
        let proved = match number.form {
            // `1E+30`: an exponent is no sign of whole numbers.
            Form::Plain if number.has_exponent() => return,
            Form::Plain => {
                self.whole += u64::from(number.value(Decimal::Point) != Some(0.0));
                return;
            }
            Form::Either(sign) => {
                self.either[at(sign)] += 1;
                self.either_at[at(sign)].get_or_insert_with(place);
                return;
            }
            Form::Decimal(sign) => sign,
            Form::Both(sign) => {
                self.thousands += 1;
                sign
            }
            Form::Grouped(sign) => {
                self.thousands += 1;
                sign.other()
            }
        };
        self.proves[at(proved)] += 1;
        self.proved_at[at(proved)].get_or_insert_with(place);
    }

    /// The two together.
    pub fn join(&mut self, other: &Evidence) {
        for k in 0..2 {
            self.proves[k] += other.proves[k];
            self.either[k] += other.either[k];
            if self.proved_at[k].is_none() {
                self.proved_at[k].clone_from(&other.proved_at[k]);
            }
            if self.either_at[k].is_none() {
                self.either_at[k].clone_from(&other.either_at[k]);
            }
        }
        self.whole += other.whole;
        self.thousands += other.thousands;
    }

    /// Refuses a column in which some cells have a point before three digits and others a comma, `51.227` and `51,227` or `51,23`: by
    /// the one sign the others are a thousand times too large. A column with thousands has cells with both, `1,051.227`.
    ///
    /// # Errors
    /// One cell of each.
    pub fn one_sign(&self) -> Result<(), TableError> {
        if self.thousands > 0 {
            return Ok(());
        }
        let with = |sign: Decimal| self.proved_at[at(sign)].as_ref().or(self.either_at[at(sign)].as_ref());
        // Cells before three digits of the one sign, and any of the other.
        let mixed = [Decimal::Point, Decimal::Comma].into_iter().find_map(|sign| {
            let may_group = self.either_at[at(sign)].as_ref()?;
            Some((sign, may_group, with(sign.other())?))
        });
        let Some((sign, may_group, other)) = mixed else { return Ok(()) };
        let (own, another) = if sign == Decimal::Point { ("point", "comma") } else { ("comma", "point") };
        Err(TableError::refused(format!(
            "{may_group} has a {own} before three digits, and {other} a {another}: two ways to write numbers in one column, or \
             thousands; say which sign is decimal with --decimal, or make them one"
        )))
    }

    /// Refuses a decimal sign that an option tells where most of the column's numbers have the other one.
    ///
    /// # Errors
    /// The first of them.
    pub fn allows(&self, told: Decimal, numbers: u64) -> Result<(), TableError> {
        let other = at(told.other());
        match &self.proved_at[other] {
            Some(place) if self.proves[other] * 2 > numbers => Err(TableError::refused(format!(
                "{place} is no number with a {}, which --decimal tells; say --decimal {}",
                told.name(),
                char::from(told.other().sign())
            ))),
            _ => Ok(()),
        }
    }

    /// What it proves by itself.
    pub fn alone(&self) -> Option<Decimal> {
        match self.proves {
            [0, 0] => None,
            [_, 0] => Some(Decimal::Point),
            [0, _] => Some(Decimal::Comma),
            _ => None,
        }
    }

    /// Whether every number has this sign before three digits, and no other one.
    fn uniform(&self, sign: Decimal) -> bool {
        let (own, other) = (at(sign), at(sign.other()));
        self.whole == 0
            && self.either[own] > 0
            && self.either[other] + self.proves[own] + self.proves[other] == 0
    }

    /// Whether there is any sign at all.
    pub fn any(&self) -> bool {
        self.proves != [0, 0] || self.either != [0, 0]
    }
}

/// Cells of OP that make a sign strange.
const FEW: u64 = 10;
/// Cells that contradict all others and are taken for mistakes: one in so many.
const MISTAKES: u64 = 200;

/// The decimal sign of the values: of all columns, among which is OP's; times may prove it where values do not.
///
/// # Errors
/// A cell that can be read in two ways, with the option that decides.
pub fn decide(
    columns: &[&Evidence],
    op: Option<&Evidence>,
    times: &Evidence,
    separator: Option<u8>,
) -> Result<Decimal, TableError> {
    let mut all = Evidence::default();
    columns.iter().for_each(|column| all.join(column));
    // Every value of OP has the other sign before three digits: thousands in each of them, or a fraction.
    let strange =
        |sign: Decimal| op.filter(|op| op.uniform(sign.other()) && op.either[at(sign.other())] >= FEW);
    let refused = |op: &Evidence, proved: Decimal| {
        let told = |place: &Option<Place>| place.as_ref().map(ToString::to_string).unwrap_or_default();
        TableError::refused(format!(
            "{} has a decimal {}, and in every cell of OP, {}, the other sign stands before three digits; say which is \
             decimal with --decimal . or --decimal ,",
            told(&all.proved_at[at(proved)]),
            if proved == Decimal::Point { "point" } else { "comma" },
            told(&op.either_at[at(proved.other())]),
        ))
    };
    match all.proves {
        [0, 0] => {}
        [_, 0] | [0, _] => {
            let proved = if all.proves[1] == 0 { Decimal::Point } else { Decimal::Comma };
            return strange(proved).map_or(Ok(proved), |op| Err(refused(op, proved)));
        }
        [point, comma] if comma * MISTAKES < point => return Ok(Decimal::Point),
        [point, comma] if point * MISTAKES < comma => return Ok(Decimal::Comma),
        _ => {
            let [point, comma] = all.proved_at.map(|place| place.map(|p| p.to_string()).unwrap_or_default());
            return Err(TableError::refused(format!(
                "{point} has a decimal point, and {comma} a decimal comma; say which is right with --decimal"
            )));
        }
    }
    if let Some(decimal) = times.alone() {
        return Ok(decimal);
    }
    if all.either == [0, 0] {
        return Ok(Decimal::Point);
    }
    // An output of a controller has no thousands, in per cent as in mA: three digits behind its sign are a fraction.
    for sign in [Decimal::Point, Decimal::Comma] {
        // Where commas divide cells, one within a cell is as likely to mark thousands.
        if sign == Decimal::Comma && separator == Some(b',') {
            continue;
        }
        let mixed = columns.iter().any(|column| column.any() && !column.uniform(sign));
        // A tab or a bar says nothing of the sign, and counts of a converter have thousands in every column: `14,325`.
        let is_open = sign == Decimal::Comma && matches!(separator, Some(b'\t' | b'|'));
        let is_share = |place: &Place| [&place.name, &place.cell].iter().any(|text| text.contains('%'));
        let may_count = is_open
            && columns.iter().all(|column| column.uniform(sign))
            && op.is_some_and(|op| !op.either_at[at(sign)].as_ref().is_some_and(is_share));
        if op.is_some_and(|op| op.uniform(sign)) && !mixed && !may_count {
            return Ok(sign);
        }
    }
    let [point, comma] = all.either_at;
    // There is one, as some cells have a sign.
    let Some(place) = comma.or(point) else { return Ok(Decimal::Point) };
    let read = |decimal: Decimal| {
        super::number::scan(&place.cell).and_then(|number| number.value(decimal)).unwrap_or(f64::NAN)
    };
    Err(TableError::refused(format!(
        "{place} may be {} or {}; say --decimal . or --decimal ,",
        read(Decimal::Comma),
        read(Decimal::Point),
    )))
}

#[cfg(test)]
mod tests {
    use super::super::number::scan;
    use super::*;

    fn of(cells: &[&str]) -> Evidence {
        let mut evidence = Evidence::default();
        for (line, cell) in cells.iter().enumerate() {
            evidence.add(&scan(cell).expect("a number"), line as u64 + 2, "pv", cell);
        }
        evidence
    }

    fn decided(op: &[&str], pv: &[&str]) -> Result<Decimal, String> {
        let (op, pv) = (of(op), of(pv));
        decide(&[&op, &pv], Some(&op), &Evidence::default(), Some(b';')).map_err(|error| error.to_string())
    }

    #[test]
    fn a_sign_is_decimal_where_a_cell_proves_it() {
        use Decimal::{Comma, Point};
        assert_eq!(decided(&["51.8"], &["999", "1,002"]), Ok(Point));
        assert_eq!(decided(&["51,8"], &["1.002"]), Ok(Comma));
        assert_eq!(decided(&["51"], &["1,234.5"]), Ok(Point));
        assert_eq!(decided(&["51"], &["1.234.567"]), Ok(Comma));
        assert_eq!(decided(&["51"], &["52"]), Ok(Point));
        assert_eq!(decided(&["51.812", "51.717"], &["1.002", "1.004"]), Ok(Point));
        assert_eq!(decided(&["51,812", "51,717"], &["51,227"]), Ok(Comma));
        assert!(
            decided(&["51.812", "51.717"], &["1,002", "1,004"]).is_err(),
            "thousands, or two ways to write"
        );
        let (op, pv) = (["14,325"; 10], ["51.23", "51.38"]);
        assert!(decided(&op, &pv).is_err_and(|said| said.contains("every cell of OP")));
    }

    #[test]
    fn a_few_cells_with_the_other_sign_are_no_thousands() {
        for (cells, told) in [
            (&["51,23", "51.227", "51,38"][..], "\"51.227\" has a point before three digits, and line 2"),
            (&["51.23", "51,227"], "\"51,227\" has a comma before three digits, and line 2"),
            (&["51.227", "51,227"], "\"51.227\" has a point before three digits, and line 3"),
            (&["51.227", "51.228", "51,2"], "\"51.227\" has a point before three digits, and line 4"),
        ] {
            let said = of(cells).one_sign().expect_err("two ways to write").to_string();
            assert!(said.contains(told) && said.contains("--decimal"), "{cells:?}: {said}");
        }
        for cells in [
            &["1.234,5", "1.281", "999,5"][..],
            &["1,234.5", "1,281", "51.2"],
            &["1.234.567", "1.281", "51,2"],
            &["51,23", "51,227", "52"],
            &["51.227", "51.228"],
        ] {
            assert!(of(cells).one_sign().is_ok(), "{cells:?}");
        }
    }

    #[test]
    fn a_sign_that_is_told_is_that_of_most_numbers() {
        let column = of(&["51,23", "51,3", "52", "51.227"]);
        assert!(column.allows(Decimal::Comma, 4).is_ok() && column.allows(Decimal::Point, 4).is_ok());
        let said =
            of(&["51,23", "51,3"]).allows(Decimal::Point, 2).expect_err("none is a number").to_string();
        assert_eq!(
            said,
            "line 2, column pv: \"51,23\" is no number with a decimal point, which --decimal tells; say --decimal ,"
        );
    }

    #[test]
    fn a_cell_of_a_tag_is_told_by_its_tag() {
        let mut tag = Evidence::default();
        tag.add_of_tag(&scan("51.812").expect("a number"), 2, "1", "51.812");
        let said = decide(&[&tag], None, &Evidence::default(), Some(b',')).expect_err("a doubt").to_string();
        assert_eq!(
            said,
            "line 2, tag \"1\": \"51.812\" may be 51812 or 51.812; say --decimal . or --decimal ,"
        );
    }

    #[test]
    fn whole_counts_with_thousands_are_asked_for() {
        let (op, pv) = (of(&["14,325", "14,299"]), of(&["14,163", "14,204"]));
        let by = |separator: u8| decide(&[&op, &pv], Some(&op), &Evidence::default(), Some(separator));
        let said = by(b'\t').expect_err("a doubt").to_string();
        assert!(said.contains("\"14,325\" may be 14.325 or 14325; say --decimal"), "{said}");
        assert_eq!(by(b';').ok(), Some(Decimal::Comma), "semicolons divide where the comma is decimal");
        let mut share = Evidence::default();
        share.add(&scan("51,812").expect("a number"), 2, "OP [%]", "51,812");
        let told = decide(&[&share, &pv], Some(&share), &Evidence::default(), Some(b'\t'));
        assert_eq!(told.ok(), Some(Decimal::Comma), "no share is a thousand times the whole");
    }

    #[test]
    fn what_proves_nothing_is_refused() {
        let said = decided(&["51", "52"], &["999", "1,002"]).expect_err("refused");
        assert_eq!(said, "line 3, column pv: \"1,002\" may be 1.002 or 1002; say --decimal . or --decimal ,");
        assert!(decided(&["51", "52"], &["1,002", "1,004"]).is_err());
        assert!(decided(&["51", "52"], &["999", "1.002"]).is_err());
        assert!(decided(&["51", "52"], &["9.995", "9.996"]).is_err(), "three decimals, or thousands");
        assert!(
            decided(&["51,812", "51,717"], &["999", "1,002"]).is_err(),
            "thousands, or a whole number among fractions"
        );
        assert!(decided(&["51.8", "51.7"], &["51,8", "51,9"]).is_err(), "both signs");
    }
}
