//! Whether OP's values can be in the span that is told of it: f is in per cent of that span, and as wrong as the span is.

use crate::config::{Config, LoopConfig};
use crate::schedule::Snapshot;
use crate::signal::{LoopId, Record, Sample, Scale, SpanSource, span_of_unit};
use std::collections::{HashMap, HashSet};
use std::sync::{Arc, Mutex, PoisonError};

/// A span so many times larger than the one that values look like is doubted.
const LARGER: f64 = 4.0;
/// Fewer live values of OP say little: a plant that starts has its valves closed.
const LEAST: usize = 200;

/// What contradicts what among OP's span, its limits, its unit and its values, as [`Scale::contradiction`] has it. Limits that tell
/// another span than the unit does are held against the values as a given span is.
pub fn span_contradiction(scale: &Scale<'_>, op: &[Sample]) -> Option<String> {
    if let Some(why) = scale.contradiction(op) {
        return Some(why);
    }
    scale.unit.and_then(span_of_unit)?;
    let (Some(span), SpanSource::Limits) = scale.span(&[]) else { return None };
    let why = Scale { given: Some(span), ..*scale }.contradiction(op)?;
    Some(why.replacen(&format!("op_span = {span}"), &format!("the span of op_limits, {span},"), 1))
}

/// The span that values look like, where the one that is told is far larger. Those of 0.41 to 0.62 are a share, or per cent of a
/// valve that is nearly closed.
fn smaller(told: Option<f64>, op: &[Sample]) -> Option<(f64, f64)> {
    let (told, looks) = (told?, Scale::default().span(op).0?);
    (told > LARGER * looks).then_some((told, looks))
}

/// Where OP's samples are from.
#[derive(Clone, Copy, Debug)]
pub(super) enum Origin<'u> {
    /// The loop's own tag, of which the configuration speaks.
    Tag,
    /// A file, with OP's unit as the file tells it.
    File(Option<&'u str>),
}

/// Finds the span of OP of a loop's past, by the loop's configuration and by what a file says of its own OP. The file's unit goes
/// before that of the configuration, which speaks of the device.
///
/// # Errors
/// What contradicts what, and what to do.
pub(super) fn find_span(
    record: &mut Record,
    own: Option<&LoopConfig>,
    origin: Origin<'_>,
) -> Result<(), String> {
    let limits = own.and_then(|own| own.op_limits).map(|[low, high]| (low, high));
    record.op_limits = limits.or(record.op_limits);
    let (given, configured) = (own.and_then(|own| own.op_span), own.and_then(|own| own.op.unit()));
    let of_file = match origin {
        Origin::File(unit) => unit,
        Origin::Tag => None,
    };
    let scale = Scale { given, limits: record.op_limits, unit: of_file.or(configured) };
    if let Some(why) = span_contradiction(&scale, &record.op) {
        return Err(match origin {
            Origin::Tag => format!("OP in the store: {why}"),
            Origin::File(_) => format!(
                "OP in the file: {why}; the configuration speaks of OP as the device sends it, so save the file with OP in that unit"
            ),
        });
    }
    if let (Origin::File(None), Some((told, looks))) = (origin, smaller(scale.span(&[]).0, &record.op)) {
        return Err(format!(
            "OP in the file: it names no unit and its values look like a span of {looks}, and the configuration tells a span of \
             {told}: save the file with OP in that unit, or write the unit into its header, such as OP [%]"
        ));
    }
    record.op_span = None;
    record.find_span(given, scale.unit);
    Ok(())
}

/// What is configured of a loop's OP.
struct Told {
    given: Option<f64>,
    limits: Option<(f64, f64)>,
    unit: Option<String>,
}

/// Loops whose live OP does not fit what is configured of it.
struct Doubts {
    loops: HashMap<LoopId, Told>,
    said: Mutex<HashSet<LoopId>>,
}

impl Doubts {
    fn new(config: &Config) -> Self {
        let told = |own: &LoopConfig| Told {
            given: own.op_span,
            limits: own.op_limits.map(|[low, high]| (low, high)),
            unit: own.op.unit().map(str::to_string),
        };
        let loops = config.loops.iter().map(|own| (LoopId::new(own.id.as_str()), told(own)));
        Self { loops: loops.collect(), said: Mutex::default() }
    }

    /// What speaks against a loop's span, once.
    fn news(&self, id: &LoopId, op: &[Sample]) -> Option<String> {
        let was_said = || self.said.lock().unwrap_or_else(PoisonError::into_inner).contains(id);
        if op.len() < LEAST || was_said() {
            return None;
        }
        let Told { given, limits, unit } = self.loops.get(id)?;
        let scale = Scale { given: *given, limits: *limits, unit: unit.as_deref() };
        let why = span_contradiction(&scale, op).or_else(|| {
            let (told, looks) = smaller(scale.span(&[]).0, op)?;
            Some(format!("OP's values look like a span of {looks}, and a span of {told} is configured"))
        })?;
        let is_news = self.said.lock().unwrap_or_else(PoisonError::into_inner).insert(id.clone());
        is_news.then_some(why)
    }
}

/// The same records. Of each loop whose OP does not fit its span the log says so once: a valve may be nearly closed, so it is
/// diagnosed all the same.
pub(super) fn watched(config: &Config, snapshot: Snapshot) -> Snapshot {
    let doubts = Doubts::new(config);
    Arc::new(move |id| {
        let record = snapshot(id)?;
        if let Some(why) = doubts.news(id, &record.op) {
            tracing::warn!(
                control_loop = %id,
                "f may be wrong by a factor: {why}; look at op_span, op_limits, and unit and scale of [loop.op]"
            );
        }
        Some(record)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A loop with this said of it, and with this unit of OP.
    fn config(own: &str, unit: &str) -> Config {
        let tag = |role: &str, address: u8, more: &str| {
            format!(
                "[loop.{role}]\ndevice = 'd'\nregister = 'holding'\naddress = {address}\ntype = 'f32'\n{more}\n"
            )
        };
        let unit = if unit.is_empty() { String::new() } else { format!("unit = '{unit}'") };
        let text = format!(
            "[[modbus]]\nname = 'd'\naddress = '10.0.0.5:502'\naddress_base = 0\n[[loop]]\nid = 'A'\n{own}\n{}{}",
            tag("op", 0, &unit),
            tag("pv", 2, "")
        );
        crate::config::parse("plant.toml", &text).unwrap_or_else(|errors| panic!("{text}\n{errors:?}"))
    }

    /// OP of a valve between 41 and 62 %, in another unit.
    fn op(scale: f64, offset: f64) -> Vec<Sample> {
        let value = |k: u32| offset + scale * (41.0 + f64::from(k % 22));
        (0..300).map(|k| Sample::good(f64::from(k), value(k))).collect()
    }

    /// The span that is found, or why there is none.
    fn found(config: &Config, op: Vec<Sample>, origin: Origin<'_>) -> Result<Option<f64>, String> {
        let mut record = Record { op, ..Record::default() };
        find_span(&mut record, config.loops.first(), origin).map(|()| record.op_span)
    }

    const SHARE: (f64, f64) = (0.01, 0.0);
    const MILLI: (f64, f64) = (0.16, 4.0);
    const PERCENT: (f64, f64) = (1.0, 0.0);

    #[test]
    fn a_file_whose_op_is_in_another_unit_than_the_configured_span_is_refused() {
        for (own, (scale, offset), unit, said) in [
            (
                "op_span = 100.0",
                SHARE,
                None,
                "look like a span of 1, and the configuration tells a span of 100",
            ),
            ("op_limits = [0, 100]", SHARE, None, "a span of 100: save the file with OP in that unit"),
            ("op_span = 100.0", MILLI, Some("mA"), "op_span = 100 contradicts OP's unit \"mA\""),
            ("op_limits = [0, 100]", MILLI, Some("mA"), "the span of op_limits, 100, contradicts OP's unit"),
            ("op_span = 1.0", PERCENT, None, "op_span = 1 contradicts the record"),
            ("op_span = 16.0", PERCENT, Some("%"), "op_span = 16 contradicts OP's unit \"%\""),
            ("", SHARE, Some("%"), "say what is right with op_span = 1 or op_span = 100"),
        ] {
            let why = found(&config(own, ""), op(scale, offset), Origin::File(unit)).expect_err(own);
            assert!(why.starts_with("OP in the file: ") && why.contains(said), "{own}: {why}");
        }
        let why = found(&config("", "%"), op(0.01, 0.0), Origin::File(None)).expect_err("a share");
        assert!(why.contains("op_span = 1 or op_span = 100"), "{why}");
    }

    #[test]
    fn a_file_in_the_configured_unit_or_with_one_of_its_own_is_taken() {
        for (own, unit, (scale, offset), of_file, span) in [
            ("op_span = 100.0", "%", PERCENT, None, 100.0),
            ("op_span = 16.0", "mA", MILLI, Some("mA"), 16.0),
            ("op_span = 16.0", "", MILLI, None, 16.0),
            ("op_span = 1.0", "", SHARE, None, 1.0),
            ("op_limits = [0, 100]", "", PERCENT, Some("%"), 100.0),
            // The file's own unit goes before the one of the device.
            ("", "%", MILLI, Some("mA"), 16.0),
            ("", "", SHARE, None, 1.0),
            // Said twice, so the valve is nearly closed.
            ("op_span = 100.0", "", SHARE, Some("%"), 100.0),
        ] {
            let found = found(&config(own, unit), op(scale, offset), Origin::File(of_file));
            assert_eq!(found, Ok(Some(span)), "{own} {unit} {of_file:?}");
        }
    }

    #[test]
    fn what_the_store_has_of_op_is_held_against_the_configuration() {
        assert_eq!(found(&config("op_span = 100.0", "%"), op(1.0, 0.0), Origin::Tag), Ok(Some(100.0)));
        let why = found(&config("op_span = 1.0", ""), op(1.0, 0.0), Origin::Tag).expect_err("per cent");
        assert!(why.starts_with("OP in the store: op_span = 1 contradicts the record"), "{why}");
        // A valve may be nearly closed for as long as the store has it.
        assert_eq!(found(&config("op_span = 100.0", "%"), op(0.01, 0.0), Origin::Tag), Ok(Some(100.0)));
    }

    #[test]
    fn a_live_op_that_does_not_fit_its_span_is_told_of_once() {
        let id = LoopId::new("A");
        for (own, unit, (scale, offset), said) in [
            ("op_span = 100.0", "", SHARE, Some("look like a span of 1, and a span of 100 is configured")),
            ("op_span = 1.0", "", PERCENT, Some("op_span = 1 contradicts the record")),
            ("", "%", SHARE, Some("OP's unit is \"%\"")),
            ("op_span = 100.0", "%", PERCENT, None),
            ("op_span = 16.0", "mA", MILLI, None),
        ] {
            let doubts = Doubts::new(&config(own, unit));
            let values = op(scale, offset);
            assert_eq!(doubts.news(&id, &values[..LEAST - 1]), None, "{own}: too few");
            match (doubts.news(&id, &values), said) {
                (Some(why), Some(said)) => assert!(why.contains(said), "{own}: {why}"),
                (news, said) => assert_eq!(news.as_deref(), said, "{own}"),
            }
            assert_eq!(doubts.news(&id, &values), None, "{own}: it was said");
        }
        assert_eq!(Doubts::new(&config("", "%")).news(&LoopId::new("B"), &op(0.01, 0.0)), None);
    }
}
