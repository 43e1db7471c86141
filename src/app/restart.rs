//! What a reload cannot change.

use crate::config::Config;
use crate::schedule;

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
