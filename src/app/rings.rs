//! Where one device's samples go.

use crate::collect::{self, Poll};
use crate::history::Ring;
use crate::signal::Sample;
use std::collections::HashMap;
use std::sync::Arc;
use tokio::sync::watch;

/// Where one device's samples go. It holds that device's rings only, so that a device that outlives a reload keeps no
/// memory of loops that are gone.
pub(super) struct Rings {
    pub(super) by_tag: HashMap<usize, Arc<Ring>>,
    /// Polls that have ended; tells write-back that there is news.
    pub(super) polled: watch::Sender<u64>,
}

impl collect::Sink for Rings {
    fn sample(&self, tag: usize, sample: Sample) {
        if let Some(ring) = self.by_tag.get(&tag) {
            ring.push(sample);
        }
    }

    fn poll(&self, _device: usize, _poll: Poll) {
        self.polled.send_modify(|polls| *polls = polls.wrapping_add(1));
    }
}
