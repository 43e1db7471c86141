//! The span of OP, from closed to open: as configured, or derived from OP's limits, unit or values.

use super::{LARGEST_VALUE, Record, Sample, outages};

/// The source of the span of OP.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SpanSource {
    /// It is configured, or given by the user.
    Given,
    /// From the controller's output limits.
    Limits,
    /// From OP's unit: per cent, mA, A.
    Unit,
    /// From OP's values.
    Values,
    /// It is not known.
    #[default]
    Unknown,
}

impl SpanSource {
    /// As reports write it.
    pub fn as_str(self) -> &'static str {
        match self {
            SpanSource::Given => "given",
            SpanSource::Limits => "limits",
            SpanSource::Unit => "unit",
            SpanSource::Values => "values",
            SpanSource::Unknown => "unknown",
        }
    }

    /// The source that a report has written; unknown for any other name.
    pub fn from_name(name: &str) -> Self {
        let all = [SpanSource::Given, SpanSource::Limits, SpanSource::Unit, SpanSource::Values];
        all.into_iter().find(|source| source.as_str() == name).unwrap_or_default()
    }
}

/// What is known of OP's scale beside its samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Scale<'a> {
    /// The span as it is given (OP unit).
    pub given: Option<f64>,
    /// The controller's output limits (OP unit).
    pub limits: Option<(f64, f64)>,
    /// OP's unit.
    pub unit: Option<&'a str>,
}

/// The span of a signal in this unit; `None` where the unit does not tell it.
pub fn span_of_unit(unit: &str) -> Option<f64> {
    match unit.trim().to_lowercase().as_str() {
        "pct" | "percent" | "per cent" | "prozent" => Some(100.0),
        // `% OP`, `% open`.
        unit if unit.starts_with('%') => Some(100.0),
        "ma" => Some(16.0),
        "a" => Some(0.016),
        other => span_of_range(other),
    }
}

/// The width of a range that is written in place of a unit: `0-27648`, `0...100`.
fn span_of_range(unit: &str) -> Option<f64> {
    // A sign at the beginning is that of the lower end.
    let behind = unit.get(1..)?;
    let signs = ["...", "..", "…", "–", " to ", "-"];
    let (at, sign) = signs.into_iter().find_map(|sign| Some((behind.find(sign)? + 1, sign)))?;
    let number = |text: &str| text.trim().parse::<f64>().ok().filter(|value| value.is_finite());
    let (low, high) = (number(unit.get(..at)?)?, number(unit.get(at + sign.len()..)?)?);
    (high > low).then_some(high - low)
}

/// Units of a physical quantity: they do not tell the span.
const PHYSICAL: [&str; 32] = [
    "v", "vdc", "mv", "mm", "cm", "m", "in", "hz", "rpm", "1/min", "bar", "mbar", "barg", "kpa", "mpa", "pa",
    "psi", "psig", "kg/cm2", "m3/h", "l/h", "l/min", "l/s", "gpm", "kg/h", "kg/s", "t/h", "deg", "°", "kw",
    "degc", "°c",
];

/// Whether a unit is that of a physical quantity, so that its values are no share of a span.
fn is_physical(unit: &str) -> bool {
    PHYSICAL.contains(&unit.trim().to_lowercase().as_str())
}

/// The usual span that output limits belong to. They are as wide as the span and begin near its zero, or they reach beyond both of its
/// ends. Limits that are as wide by chance belong to none: `[40, 56]` in per cent is not 4 to 20 mA.
fn usual_span((low, high): (f64, f64)) -> Option<f64> {
    let fits = |(zero, span): &(f64, f64)| {
        let (below, above) = ((zero - low) / span, (high - zero - span) / span);
        let beyond = |share: f64| (1e-6..=OVERTRAVEL).contains(&share);
        let as_wide = ((high - low) / span - 1.0).abs() < 1e-6;
        as_wide && below.abs() <= OVERTRAVEL || beyond(below) && beyond(above)
    };
    USUAL.into_iter().find(fits).map(|(_, span)| span)
}

/// Signals that are recognised by their values: least and largest value, and the span. Values of 4 to 20 may be mA or per cent.
const SIGNALS: [(f64, f64, f64); 3] = [(0.0038, 0.0205, 0.016), (-0.05, 1.05, 1.0), (-5.0, 110.0, 100.0)];
/// Values that may be mA, or per cent of a valve that is nearly closed.
const MILLIAMPERES: (f64, f64) = (3.8, 20.5);
/// Spans of OP that can be computed with.
const SPANS: std::ops::RangeInclusive<f64> = 1e-30..=1e30;
/// The usual spans: their zero, and their width.
const USUAL: [(f64, f64); 4] = [(0.0, 1.0), (4.0, 16.0), (0.004, 0.016), (0.0, 100.0)];
/// Share of the span by which output limits may reach beyond it on each side: -5 % closes a valve tightly.
const OVERTRAVEL: f64 = 0.15;

impl Scale<'_> {
    /// The span of OP (OP unit), with its source. `op`: samples of OP; may be empty.
    pub fn span(&self, op: &[Sample]) -> (Option<f64>, SpanSource) {
        let limits = self.limits.map(|(low, high)| high - low).filter(|span| *span > 0.0);
        let unit = self.unit.and_then(span_of_unit);
        let usual = self.limits.and_then(usual_span);
        let told = [(self.given, SpanSource::Given), (usual, SpanSource::Limits), (unit, SpanSource::Unit)];
        for (span, source) in told.into_iter().chain([(limits, SpanSource::Limits)]) {
            if span.is_some() {
                return (span, source);
            }
        }
        // Values of 20 to 100 kPa are not per cent.
        let physical = self.unit.is_some_and(is_physical);
        match span_of_values(op).filter(|_| !physical) {
            Some(span) => (Some(span), SpanSource::Values),
            None => (None, SpanSource::Unknown),
        }
    }

    /// A message where given span, limits, unit and values contradict each other: what does, and what to write.
    pub fn contradiction(&self, op: &[Sample]) -> Option<String> {
        let limits = self.limits.filter(|(low, high)| low < high);
        let Some(span) = self.given.filter(|span| span.is_finite() && *span > 0.0) else {
            return self.unit_contradicted(limits, op);
        };
        if let Some((low, high)) = limits {
            let wide = high - low;
            if contradict(wide, span) {
                return Some(format!(
                    "op_span = {span} and op_limits = [{low}, {high}] contradict each other: the limits are {wide} apart: \
                     write op_span = {wide}, or correct op_limits; both are in OP's own unit"
                ));
            }
        }
        // The given span decides where the values do not fit the unit.
        if let Some((unit, own)) = self.unit.and_then(|unit| Some((unit, span_of_unit(unit)?)))
            && (own > 4.0 * span || span > 4.0 * own)
            && fits(own, op)
        {
            return Some(format!(
                "op_span = {span} contradicts OP's unit {unit:?}, in which the span is {own}"
            ));
        }
        let (least, most) = extent(op)?;
        // An elevated zero lifts values above the span by a quarter (4..20 mA), never tenfold.
        let beyond = most.abs().max(least.abs()) > 10.0 * span;
        (beyond || most - least > 1.5 * span)
            .then(|| format!("op_span = {span} contradicts the record: OP goes from {least} to {most}"))
    }

    /// A message where limits or values contradict OP's unit, and no span is given.
    fn unit_contradicted(&self, limits: Option<(f64, f64)>, op: &[Sample]) -> Option<String> {
        let unit = self.unit?;
        let own = span_of_unit(unit)?;
        let of_limits = limits.and_then(usual_span);
        // [4, 20] in per cent: milliamperes, or a controller that keeps OP from both of its ends. Limits beyond the unit's span
        // are right where the unit cannot be.
        let other = |(low, high): &(f64, f64)| match of_limits {
            Some(span) => span < own && *low > 0.0 && (low - 0.25 * span).abs() <= OVERTRAVEL * span,
            None => contradict(high - low, own),
        };
        if let Some((low, high)) = limits.filter(other) {
            return Some(format!(
                "op_limits = [{low}, {high}] contradict OP's unit {unit:?}, in which the span is {own}; \
                 both are in OP's own unit: say what is right with op_span = {} or op_span = {own}",
                of_limits.unwrap_or(high - low)
            ));
        }
        if of_limits.is_some() {
            return None;
        }
        let (least, most) = extent(op).filter(|_| !fits(own, op))?;
        // Values far beyond the unit's span cannot be in it, those within a smaller one may.
        let own_may = (most.max(-least) <= 1.5 * own).then_some(own);
        let spans = span_of_values(op).filter(|other| *other != own).into_iter().chain(own_may);
        let spans: Vec<String> = spans.map(|span| format!("op_span = {span}")).collect();
        let say = if spans.is_empty() {
            "op_span = N, its span from closed to open".into()
        } else {
            spans.join(" or ")
        };
        Some(format!(
            "OP's unit is {unit:?}, in which the span is {own}, but its values go from {least} to {most}; \
             say what is right with {say}"
        ))
    }
}

/// Whether limits of this width contradict a span: they may be narrower than it, but not by a factor of 20.
fn contradict(wide: f64, span: f64) -> bool {
    const NARROWER: f64 = 20.0;
    wide > (1.01 + 2.0 * OVERTRAVEL) * span || wide * NARROWER < span
}

/// Whether values can have a unit with this span: none of them is far beyond its ends, and they are not all within a signal of a much
/// smaller span.
fn fits(span: f64, op: &[Sample]) -> bool {
    let Some((least, most)) = extent(op) else { return true };
    // A zero that is lifted by a quarter of the span lies within.
    let beyond = most.max(-least) > 1.5 * span;
    let within = |(low, high, own): &(f64, f64, f64)| *low <= least && most <= *high && own * 4.0 < span;
    !beyond && (most <= 0.0 || !SIGNALS.iter().any(within))
}

impl Record {
    /// Sets the span of OP where it is not known yet, from a given span, OP's limits, its unit and its values.
    pub fn find_span(&mut self, given: Option<f64>, unit: Option<&str>) {
        if self.op_span.is_none() {
            let scale = Scale { given, limits: self.op_limits, unit };
            (self.op_span, self.op_span_source) = scale.span(&self.op);
        }
    }

    /// The span of OP, where it is known and can be computed with (OP unit).
    pub fn known_span(&self) -> Option<f64> {
        self.op_span.filter(|span| SPANS.contains(span))
    }
}

/// The span to which a threshold in per cent refers (OP unit): the known one, otherwise the range of OP, which is no larger.
pub fn span_at_least(known: Option<f64>, op: &[f64]) -> f64 {
    known.unwrap_or_else(|| {
        let finite = op.iter().copied().filter(|u| u.is_finite());
        let (least, most) = finite.fold((f64::MAX, f64::MIN), |(a, b), u| (a.min(u), b.max(u)));
        (most - least).max(0.0)
    })
}

/// The least and the largest of the good values that are measurements; `None` where there is none.
fn extent(op: &[Sample]) -> Option<(f64, f64)> {
    let is_good = |s: &&Sample| s.quality.is_good() && s.value.is_finite() && s.value.abs() < LARGEST_VALUE;
    let good: Vec<Sample> = op.iter().filter(is_good).copied().collect();
    let outages = outages(&good);
    good.iter().map(|s| s.value).filter(|value| !outages.contains(value)).fold(
        None,
        |found: Option<(f64, f64)>, value| {
            let (least, most) = found.unwrap_or((value, value));
            Some((least.min(value), most.max(value)))
        },
    )
}

/// The span that values tell (OP unit); `None` where they may be of several signals, or of none.
fn span_of_values(op: &[Sample]) -> Option<f64> {
    let (least, most) = extent(op)?;
    let within = |(low, high): (f64, f64)| low <= least && most <= high;
    // Zeros alone tell nothing, and values far below zero are deviations from a working point.
    if most <= 0.0 || -least > 0.1 * most || within(MILLIAMPERES) {
        return None;
    }
    SIGNALS.iter().find(|(low, high, _)| within((*low, *high))).map(|(.., span)| *span)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn op(values: &[f64]) -> Vec<Sample> {
        values.iter().enumerate().map(|(k, value)| Sample::good(k as f64, *value)).collect()
    }

    #[test]
    fn the_span_is_given_or_told_by_limits_unit_and_values() {
        let of = |given, limits, unit, values: &[f64]| Scale { given, limits, unit }.span(&op(values));
        assert_eq!(of(Some(50.0), Some((0.0, 100.0)), Some("%"), &[]), (Some(50.0), SpanSource::Given));
        assert_eq!(of(None, Some((0.0, 1.0)), None, &[0.4]), (Some(1.0), SpanSource::Limits));
        assert_eq!(of(None, Some((5.0, 95.0)), Some("%"), &[]), (Some(100.0), SpanSource::Unit));
        for over in [(-5.0, 105.0), (-6.9, 106.9), (-10.0, 110.0)] {
            assert_eq!(of(None, Some(over), None, &[]), (Some(100.0), SpanSource::Limits), "{over:?}");
        }
        assert_eq!(of(None, Some((3.8, 20.5)), None, &[]), (Some(16.0), SpanSource::Limits));
        assert_eq!(of(None, Some((0.0, 110.0)), None, &[]), (Some(110.0), SpanSource::Limits));
        assert_eq!(of(None, Some((0.0, 27_648.0)), None, &[]), (Some(27_648.0), SpanSource::Limits));
        // As wide as a signal, and none: the unit tells.
        for narrow in [(40.0, 56.0), (0.0, 16.0), (52.0, 53.0)] {
            assert_eq!(of(None, Some(narrow), Some("%"), &[]), (Some(100.0), SpanSource::Unit), "{narrow:?}");
        }
        assert_eq!(of(None, Some((-50.0, 50.0)), None, &[]), (Some(100.0), SpanSource::Limits));
        assert_eq!(of(None, None, Some("mA"), &[12.0]), (Some(16.0), SpanSource::Unit));
        assert_eq!(of(None, None, None, &[0.50, 0.52]), (Some(1.0), SpanSource::Values));
        assert_eq!(of(None, None, None, &[0.0121, 0.0123]), (Some(0.016), SpanSource::Values));
        assert_eq!(of(None, None, None, &[50.0, 52.0]), (Some(100.0), SpanSource::Values));
        for (range, span) in [
            ("0-27648", 27_648.0),
            ("0...32767", 32_767.0),
            ("0..1", 1.0),
            ("-100 to 100", 200.0),
            ("-5-105", 110.0),
            ("0.2 – 1.0", 0.8),
        ] {
            let (found, source) = of(None, None, Some(range), &[]);
            assert!(found.is_some_and(|own| (own - span).abs() < 1e-12), "{range}: {found:?}");
            assert_eq!(source, SpanSource::Unit, "{range}");
        }
        for none in ["5", "2-1", "m3/h", "0-", "-", "", "kg-m", "1-2-3"] {
            assert_eq!(of(None, None, Some(none), &[]).0, None, "{none}");
        }
        for unknown in [&[12.0, 12.3][..], &[13_000.0], &[-1.0, 1.0], &[]] {
            assert_eq!(of(None, None, None, unknown), (None, SpanSource::Unknown), "{unknown:?}");
        }
    }

    #[test]
    fn where_the_span_is_not_known_it_is_as_large_as_what_op_covered() {
        let mut record = Record { op: op(&[-1.0, 2.0]), ..Record::default() };
        record.find_span(None, None);
        assert_eq!((record.known_span(), record.op_span_source), (None, SpanSource::Unknown));
        assert_eq!(span_at_least(record.known_span(), &[-1.0, f64::NAN, 2.0]), 3.0);
        record.find_span(None, Some("mA"));
        assert_eq!((record.known_span(), record.op_span_source), (Some(16.0), SpanSource::Unit));
        // What is known already is not looked for again.
        record.find_span(Some(100.0), None);
        assert_eq!(span_at_least(record.known_span(), &[]), 16.0);
        assert_eq!(span_at_least(None, &[]), 0.0);
    }

    #[test]
    fn what_contradicts_each_other_is_said() {
        let of =
            |given, limits, unit, values: &[f64]| Scale { given, limits, unit }.contradiction(&op(values));
        let said = of(Some(1.0), Some((0.0, 100.0)), None, &[]).expect("a hundred times too large");
        assert!(said.starts_with("op_span = 1 and op_limits = [0, 100] contradict each other"), "{said}");
        assert!(of(Some(100.0), Some((0.0, 1.0)), None, &[]).is_some());
        assert!(of(Some(1.0), None, Some("%"), &[]).is_some());
        assert!(of(Some(1.0), None, None, &[49.0, 52.0]).is_some());
        assert_eq!(of(Some(100.0), Some((5.0, 95.0)), Some("%"), &[51.0]), None);
        assert_eq!(of(Some(16.0), Some((4.0, 20.0)), Some("mA"), &[12.0]), None);
        assert_eq!(of(Some(16.0), Some((3.8, 20.5)), Some("mA"), &[12.0]), None);
        assert_eq!(of(Some(100.0), Some((-5.0, 105.0)), Some("%"), &[51.0]), None);
        assert!(of(Some(100.0), Some((0.0, 150.0)), None, &[]).is_some());
        assert_eq!(of(None, Some((0.0, 100.0)), Some("mA"), &[]), None);
        let said = of(None, Some((4.0, 20.0)), Some("%"), &[]).expect("milliamperes");
        assert!(said.ends_with("say what is right with op_span = 16 or op_span = 100"), "{said}");
        let said = of(None, Some((0.0, 32_767.0)), Some("%"), &[]).expect("counts");
        assert!(said.ends_with("say what is right with op_span = 32767 or op_span = 100"), "{said}");
    }

    #[test]
    fn a_unit_that_its_values_contradict_is_doubted_until_a_span_decides() {
        let of = |given, unit, values: &[f64]| {
            Scale { given, limits: None, unit: Some(unit) }.contradiction(&op(values))
        };
        for (unit, values, spans) in [
            ("%", &[0.41, 0.62][..], "op_span = 1 or op_span = 100"),
            ("%", &[14_265.0, 14_325.0], "op_span = N, its span from closed to open"),
            ("mA", &[0.0121, 0.0123], "op_span = 0.016 or op_span = 16"),
            ("mA", &[49.0, 51.8], "op_span = 100"),
            ("A", &[12.1, 12.3], "op_span = N, its span from closed to open"),
        ] {
            let said = of(None, unit, values).expect(unit);
            assert!(said.ends_with(&format!("say what is right with {spans}")), "{said}");
        }
        for (unit, values) in
            [("%", &[0.0, 0.0][..]), ("%", &[-5.0, 105.0]), ("mA", &[3.8, 20.5]), ("A", &[0.004, 0.02])]
        {
            assert_eq!(of(None, unit, values), None, "{unit} {values:?}");
        }
        // What is given decides, as far as the values are possible in it.
        assert_eq!(of(Some(1.0), "%", &[0.41, 0.62]), None);
        assert_eq!(of(Some(100.0), "%", &[0.41, 0.62]), None);
        assert!(of(Some(1.0), "%", &[41.0, 62.0]).is_some());
    }
}
