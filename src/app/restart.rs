//! What a reload cannot change.

use crate::config::Config;
use crate::schedule;

/// Loops whose samples outlive the series of their terms.
fn without_term<'c>(old: &'c Config, new: &Config) -> Vec<&'c str> {
    let written = old.loops.iter().filter(|own| own.writeback.is_some()).map(|own| own.id.as_str());
    let lost = |id: &&str| new.loops.iter().any(|own| own.id == *id && own.writeback.is_none());
    written.filter(lost).collect()
}

/// Says in the log which changes take effect at the next start only.
pub(super) fn warn_of_what_needs_one(old: &Config, new: &Config) {
    if old.server != new.server {
        tracing::warn!("[server] has changed: that takes effect at the next start");
    }
    if (&old.access, &old.audit) != (&new.access, &new.audit) {
        tracing::warn!("[access] or [audit] has changed: that takes effect at the next start");
    }
    if old.writeback != new.writeback {
        tracing::warn!(
            "[writeback] has changed: an audit log that is open stays as it is until the next start"
        );
    }
    for id in without_term(old, new) {
        tracing::warn!(
            id,
            "[loop.writeback] was taken out: the next diagnoses treat past samples as if no term had acted; put the section back with enabled = false"
        );
    }
    if old.fleet != new.fleet {
        tracing::warn!("[fleet] has changed: that takes effect at the next start");
    }
    if old.store != new.store {
        tracing::warn!("[store] has changed: that takes effect at the next start");
    }
    if old.notify.mqtt != new.notify.mqtt {
        tracing::warn!("[notify.mqtt] has changed: that takes effect at the next start");
    }
    let sizes = |c: &schedule::Config| (c.parallelism, c.deadline_s.to_bits(), c.queue, c.keep_results);
    if sizes(&old.schedule) != sizes(&new.schedule) {
        tracing::warn!("sizes in [schedule] have changed: they take effect at the next start");
    }
}

#[cfg(test)]
mod tests {
    use super::super::writeback::tests::config;
    use super::*;

    #[test]
    fn a_loop_that_loses_the_series_of_its_terms_is_told() {
        let old = config();
        let mut new = old.clone();
        assert!(without_term(&old, &new).is_empty());
        new.loops[0].writeback = None;
        assert_eq!(without_term(&old, &new), ["A"]);
        // Without the loop there is nothing to diagnose.
        new.loops.clear();
        assert!(without_term(&old, &new).is_empty());
    }
}
