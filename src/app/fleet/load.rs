//! How full the streams are, and how this machine is: for metrics, so that what backs up is seen before anything is lost.

use super::{Fleet, NO_SITE, lock};
use crate::fleet::link::{Fill, Link, LinkError};
use crate::fleet::streams::ALL;
use crate::serve::Machine;
use crate::version::BUILD;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

/// How often the streams are looked at: twice between two scrapes of `deploy/prometheus`.
const LOOK: Duration = Duration::from_secs(15);

/// A stream as it was looked at last.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct StreamLoad {
    pub name: &'static str,
    pub fill: Fill,
}

impl Fleet {
    /// Looks at the streams from time to time. What cannot be asked for is not known any more: an old number would pass for a good
    /// one.
    pub(super) async fn measuring(&self, link: &Link) {
        loop {
            let found = look(link).await.unwrap_or_else(|error| {
                tracing::debug!(%error, "how full the streams are is not known");
                Vec::new()
            });
            *lock(&self.streams) = found;
            tokio::time::sleep(LOOK).await;
        }
    }

    /// This machine, as it says of itself.
    pub(super) fn machine(&self) -> Machine {
        let certificate = lock(&self.ends).clone();
        Machine {
            role: self.role.as_str().to_string(),
            site: Some(self.site.clone()).filter(|site| site != NO_SITE).unwrap_or_default(),
            name: self.name.clone(),
            version: BUILD.to_string(),
            heard_at: self.clock.now(),
            clock_offset_s: self.clock.now() - self.server_now(),
            since: self.since,
            lag_s: self.lag_ms.load(Relaxed) as f64 * 1e-3,
            diagnosed: self.diagnosed.load(Relaxed),
            loops: self.scene.borrow().config.loops.len() as u64,
            certificate: certificate.map(|own| (own.of, own.until)),
        }
    }
}

async fn look(link: &Link) -> Result<Vec<StreamLoad>, LinkError> {
    let mut found = Vec::with_capacity(ALL.len());
    for name in ALL {
        found.push(StreamLoad { name, fill: link.fill(name).await? });
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::fleet::certificates::Ends;
    use crate::app::fleet::tests::{centre, edge};
    use crate::fleet::streams::{ALARMS, WINDOWS};
    use crate::serve::FleetPort;

    #[test]
    fn what_waits_is_told_by_who_knows_it() {
        let (edge, _results) = edge("FIC1");
        edge.lag(2.5);
        *lock(&edge.ends) = Some(Ends { of: "[fleet] certificate_file".into(), until: 1e9 });
        let load = edge.load();
        assert_eq!((load.windows, load.streams), (Some(0), Vec::new()));
        assert_eq!((load.own.role.as_str(), load.own.site.as_str(), load.own.lag_s), ("edge", "north", 2.5));
        assert_eq!(load.own.certificate.map(|(_, until)| until), Some(1e9));

        let (centre, _results) = centre("north:FIC1");
        assert_eq!((centre.load().windows, centre.load().own.site), (None, String::new()));
        let stream = |name, bytes, room| StreamLoad { name, fill: Fill { messages: 7, bytes, room } };
        *lock(&centre.streams) = vec![stream(WINDOWS, 5, None), stream(ALARMS, 60, Some(80))];
        let load = centre.load();
        // A stream without a bound is never full.
        assert_eq!((load.windows, load.streams), (Some(7), vec![(ALARMS, 0.75)]));
        assert_eq!(Fill { messages: 1, bytes: 90, room: Some(80) }.share(), Some(1.0));
    }
}
