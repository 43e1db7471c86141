//! Times that contradict each other: how often is measured, how long is kept, how much a diagnosis needs.

use super::super::section::Parts;
use super::super::source::Step;
use super::super::{LoopConfig, TagConfig};
use super::Rules;
use crate::collect::opcua::Mode;

impl Rules<'_, '_, '_> {
    /// Whether the memory can ever hold what a diagnosis needs.
    pub(super) fn history(&mut self, parts: &Parts) {
        let (Some(history), Some(diagnosis)) = (&parts.history, &parts.diagnosis) else { return };
        let (kept, least) = (history.samples_per_tag, diagnosis.min_samples);
        // What cannot be a number of samples at all is told already.
        if !history.validate().is_empty() || !diagnosis.validate().is_empty() {
            return;
        }
        let (holds, needs) = (path!["history", "samples_per_tag"], path!["diagnosis", "min_samples"]);
        // The default stands in no file, so what the file has is told.
        let place = if self.source.has(&holds) { &holds } else { &needs };
        self.unless(kept >= least, place, || {
            format!(
                "samples_per_tag: {kept} is fewer than [diagnosis] min_samples = {least}: write [history] samples_per_tag = \
                 {least} or more"
            )
        });
        let Some(ts) = diagnosis.ts_s else { return };
        // Between two polls nothing is known: what is drawn there would count as evidence.
        let polls = parts.loops.iter().flatten().filter_map(|own| {
            let both = [&own.op, &own.pv].map(|tag| polled_ms(tag, parts));
            let ms = both.into_iter().flatten().map(|(_, ms)| ms).max()?;
            Some((own.id.clone(), ms as f64 / 1000.0))
        });
        let fastest = polls.min_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((id, poll)) = fastest.filter(|(_, poll)| ts < *poll) {
            let message = format!(
                "ts_s: {ts} is shorter than the time between two polls of every loop, {poll} s of {id}: between them nothing is \
                 known; write {poll} or more, or leave it out"
            );
            self.wrong(&path!["diagnosis", "ts_s"], message);
            return;
        }
        let needed = ts * least as f64;
        let held = |own: &LoopConfig| Some((own.id.clone(), self.period_s(own, parts)? * kept as f64));
        // One loop that is polled faster than the others is told of by its own diagnoses.
        let longest = parts.loops.iter().flatten().filter_map(held).max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((id, held)) = longest.filter(|(_, held)| kept >= least && *held < needed) {
            let more = (needed / held * kept as f64).ceil();
            let message = format!(
                "ts_s: min_samples = {least} of {ts} s take {needed} s, and samples_per_tag = {kept} hold {held} s of {id}: \
                 no diagnosis is possible; write samples_per_tag = {more} or more, or a smaller ts_s"
            );
            self.wrong(&path!["diagnosis", "ts_s"], message);
        }
    }

    /// A PV cannot change between two polls.
    pub(super) fn frozen(&mut self, at: usize, control_loop: &LoopConfig, parts: &Parts) {
        let Some(frozen) = control_loop.frozen_pv_s.filter(|frozen| *frozen > 0.0) else { return };
        let Some((key, ms)) = polled_ms(&control_loop.pv, parts) else { return };
        self.unless(1000.0 * frozen >= ms as f64, &path!["loop", at, "frozen_pv_s"], || {
            let least = 3.0 * ms as f64 / 1000.0;
            format!(
                "frozen_pv_s: {frozen} is shorter than {key} = {ms}: PV would be stale at every poll; write {least} or more"
            )
        });
    }

    /// Time between two samples of a loop (s), the shorter of OP's and PV's; `None` where they come by themselves.
    fn period_s(&self, control_loop: &LoopConfig, parts: &Parts) -> Option<f64> {
        let (_, op) = polled_ms(&control_loop.op, parts)?;
        let (_, pv) = polled_ms(&control_loop.pv, parts)?;
        Some(op.min(pv) as f64 / 1000.0)
    }
}

/// How often a tag is asked for (ms), and by which key; `None` where it comes by itself.
fn polled_ms(tag: &TagConfig, parts: &Parts) -> Option<(&'static str, u64)> {
    match tag {
        TagConfig::Modbus(own) => {
            let device = parts.modbus.iter().flatten().find(|device| device.name == own.device)?;
            Some(("poll_ms", device.poll_ms))
        }
        TagConfig::Opcua(own) => {
            let server = parts.opcua.iter().flatten().find(|server| server.name == own.device)?;
            (server.mode == Mode::Poll).then_some(("sampling_ms", server.sampling_ms))
        }
        TagConfig::Mqtt(_) | TagConfig::Forwarded(_) => None,
    }
}
