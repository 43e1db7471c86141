//! A diagnosis bundle: read, put together, and where it is whole replayed. The digests of its samples are made good, or no
//! change would come behind them.

use super::wait;
use stictiond::app::replay::{Options, Record as Replayed, replay};
use stictiond::results::{Basis, basis};
use stictiond::serve::dto::bundle::Bundle;
use stictiond::signal::{Quality, Record, Sample};

/// Longest record that is diagnosed again: longer ones take time and nothing else.
const SAMPLES: usize = 400;

/// Takes the text of a bundle.
pub fn run(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let Ok(mut bundle) = Bundle::read(&text) else { return };
    let _ = bundle.report.as_text();
    let _ = bundle.record();
    if let Some(whole) = made_good(&bundle) {
        bundle.basis = (&whole).into();
    }
    let Ok((basis, record)) = bundle.record() else { return };
    let _ = basis.newest();
    let samples: usize = basis::series(&record).map(|(_, samples)| samples.len()).sum();
    if samples <= SAMPLES {
        let record = Replayed::Bundle(Box::new(bundle));
        let _ = wait(replay(&record, &Options::default(), &mut |_| ()));
    }
}

/// The basis that the samples have.
fn made_good(bundle: &Bundle) -> Option<Basis> {
    let told = bundle.basis.basis().ok()?;
    let mut record = Record {
        op_span: told.op_span,
        op_span_source: told.op_span_source,
        op_limits: told.op_limits,
        integrates: told.integrates,
        ..Record::default()
    };
    for own in &bundle.samples {
        let rows = own.t.iter().zip(&own.value).zip(&own.quality);
        let samples = rows.filter_map(|((t, value), quality)| {
            Some(Sample { t: *t, value: value.unwrap_or(f64::NAN), quality: Quality::named(quality)? })
        });
        basis::put(&mut record, &own.tag, samples.collect());
    }
    Some(Basis::of(&record, &told.settings, told.structure))
}
