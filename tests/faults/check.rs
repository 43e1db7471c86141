//! Samples, and alarms on bad tags, held against what the devices said.

use crate::network::{Network, TIMEOUT_S, Value};
use crate::plant::{TAG_BAD_AFTER_S, TICK_S, devices};
use crate::time::TimeLine;
use crate::truth::Content;
use stictiond::signal::Sample;
use stictiond::store::StoredTag;

/// Every good sample is one that a device said, at the time of its stamp, to be believed, once; and within one era samples are
/// in the order in which they were measured.
pub fn samples(content: &Content, network: &Network, time: &TimeLine) -> Result<(), String> {
    let mut numbers = std::collections::BTreeSet::new();
    for (tag, own) in &content.samples {
        let (mut pair, mut before) = (None, None);
        let mut own: Vec<&Sample> = own.iter().filter(|sample| sample.quality.is_good()).collect();
        own.sort_by(|a, b| a.t.total_cmp(&b.t));
        for sample in own {
            let invented = |why: &str| Err(format!("{why}: {} {sample:?}", name(tag)));
            let Some(value) = Value::of(sample.value) else { return invented("no device says so") };
            let Some(said) = network.said(value) else { return invented("no device said so") };
            if !said.sound {
                return invented("a device said so in an answer that is not to be believed");
            }
            if !time.showed(sample.t, said.asked, said.asked + TIMEOUT_S) {
                return invented(&format!("it was asked for at {} s, and not at its stamp", said.asked));
            }
            if *pair.get_or_insert(value.tag) != value.tag {
                return invented("it is another register's");
            }
            if !numbers.insert(value.number) {
                return invented("one answer is there twice");
            }
            if before.replace(value.number).is_some_and(|before| before > value.number) {
                return invented(&format!(
                    "it was asked for at {} s, before the sample before it",
                    said.asked
                ));
            }
        }
    }
    Ok(())
}

/// No alarm on bad tags was raised though the devices of its loop answered every poll for nearly as long as a tag has to be bad;
/// `steady` has the moments from which on the same daemon with the same configuration looked at them.
pub fn causes(content: &Content, network: &Network, time: &TimeLine, steady: &[f64]) -> Result<(), String> {
    let raised = |kind: &str, cause: &str| kind == "tag_bad" && cause == "raised";
    for change in content.changes.iter().filter(|change| raised(&change.kind, &change.cause)) {
        // A stamp that clocks showed more than once says nothing.
        let moments = time.moments(change.at);
        let &[at] = moments.as_slice() else { continue };
        let from = at - (TAG_BAD_AFTER_S - TICK_S);
        let begun = steady.iter().rev().find(|begun| **begun <= at);
        if begun.is_none_or(|begun| from < begun + TICK_S) {
            continue;
        }
        // What was asked for in this very moment may not have been looked at.
        let to = at - 0.1 * TICK_S;
        if devices(&change.control_loop).iter().all(|device| network.was_sound(*device, from, to)) {
            return Err(format!(
                "an alarm without a cause: {change:?}; its devices answered every poll from {from:.1} s on"
            ));
        }
    }
    Ok(())
}

fn name(tag: &StoredTag) -> String {
    format!("{}.{} of era {}", tag.name.control_loop, tag.name.tag, tag.era)
}
