//! What a server kept, page by page.

use super::{Link, Lost, Page, Refused, wrong_count};
use crate::collect::opcua::value::date_time;
use opcua::client::HistoryReadAction;
use opcua::types::{
    AggregateConfiguration, ByteString, HistoryData, HistoryReadResult, HistoryReadValueId, NodeId, ObjectId,
    ReadProcessedDetails, ReadRawModifiedDetails, TimestampsToReturn,
};
use std::future::Future;
use std::time::Duration;
use tokio::time::timeout;
use tracing::debug;

/// Values of one node asked of the history at once.
const VALUES_PER_PAGE: u32 = 1000;
/// A session that has ended says so within this time of a request that failed for it.
const AFTERMATH: Duration = Duration::from_secs(1);
/// Pages in a row that a node may have without anything newer: a historian may answer so while it searches.
const MOST_IDLE: u32 = 100;

/// Whoever keeps history: a server, or what stands for one in a test.
pub(in crate::collect::opcua) trait Historian: Send {
    /// Most nodes of one request.
    fn batch(&self) -> usize;

    /// One answer: a page, from `from` to `to` (s), oldest first, of each of the first nodes, at least one and as many as it takes
    /// at once; `None` when it gives none. A node given with a continuation goes on from there.
    fn ask(
        &mut self,
        nodes: &[(NodeId, ByteString)],
        from: f64,
        to: f64,
    ) -> impl Future<Output = Result<Option<Vec<Page>>, Lost>> + Send;
}

/// For a session that has more to do: whatever a historian says, or leaves unsaid, is no reason to end it.
impl Historian for Link {
    fn batch(&self) -> usize {
        self.limits.history
    }

    /// `None` too when a request failed, while the session lives.
    async fn ask(
        &mut self,
        nodes: &[(NodeId, ByteString)],
        from: f64,
        to: f64,
    ) -> Result<Option<Vec<Page>>, Lost> {
        let lost = match self.history(nodes, from, to).await {
            Err(lost) => lost,
            answered => return answered,
        };
        if timeout(AFTERMATH, self.ended()).await.is_ok() {
            return Err(lost);
        }
        debug!(device = %self.config.name, "history: {lost}");
        Ok(None)
    }
}

/// Whether the pages of a node lead on: a server may give pages without a value, and a continuation with each, for ever.
#[derive(Clone, Copy, Debug)]
pub(in crate::collect::opcua) struct Progress {
    /// Time of the newest value so far (s).
    pub(in crate::collect::opcua) newest: f64,
    /// Pages since then.
    idle: u32,
}

impl Default for Progress {
    fn default() -> Self {
        Self { newest: f64::NEG_INFINITY, idle: 0 }
    }
}

impl Progress {
    /// A page came whose newest value is of this time (s). Whether the next is worth asking for.
    pub(in crate::collect::opcua) fn leads_on(&mut self, newest: f64) -> bool {
        if newest > self.newest {
            *self = Self { newest, idle: 0 };
        } else {
            self.idle += 1;
        }
        self.idle < MOST_IDLE
    }
}

impl Link {
    /// An answer of raw history, as [`Historian::ask`] says; `None` when the server refuses the service.
    pub(in crate::collect::opcua) async fn history(
        &mut self,
        nodes: &[(NodeId, ByteString)],
        from: f64,
        to: f64,
    ) -> Result<Option<Vec<Page>>, Lost> {
        let details = ReadRawModifiedDetails {
            is_read_modified: false,
            start_time: date_time(from),
            end_time: date_time(to),
            num_values_per_node: VALUES_PER_PAGE,
            return_bounds: false,
        };
        self.pages(nodes, &HistoryReadAction::ReadRawModifiedDetails(details)).await
    }

    /// A page of the server's means over every `every_s` for the first of the nodes, where it makes any: a request has a function
    /// for each of its nodes, so they are asked for one by one.
    pub(in crate::collect::opcua) async fn means(
        &mut self,
        nodes: &[(NodeId, ByteString)],
        from: f64,
        to: f64,
        every_s: f64,
    ) -> Result<Option<Vec<Page>>, Lost> {
        let details = ReadProcessedDetails {
            start_time: date_time(from),
            end_time: date_time(to),
            processing_interval: every_s * 1e3,
            aggregate_type: Some(vec![ObjectId::AggregateFunction_Average.into()]),
            aggregate_configuration: AggregateConfiguration {
                use_server_capabilities_defaults: true,
                ..Default::default()
            },
        };
        let first = &nodes[..nodes.len().min(1)];
        self.pages(first, &HistoryReadAction::ReadProcessedDetails(details)).await
    }

    /// One answer, for as many of the nodes as the server takes at once.
    async fn pages(
        &mut self,
        nodes: &[(NodeId, ByteString)],
        action: &HistoryReadAction,
    ) -> Result<Option<Vec<Page>>, Lost> {
        let ask = |(node, next): &(NodeId, ByteString)| HistoryReadValueId {
            node_id: node.clone(),
            continuation_point: next.clone(),
            ..Default::default()
        };
        loop {
            let batch: Vec<HistoryReadValueId> = nodes.iter().take(self.limits.history).map(ask).collect();
            let asked = self.session.history_read(action.clone(), TimestampsToReturn::Both, false, &batch);
            match self.answer("history", asked).await {
                Ok(answer) if answer.len() == batch.len() => {
                    return Ok(Some(answer.into_iter().map(Page::from).collect()));
                }
                Ok(answer) => return Err(wrong_count("history", batch.len(), answer.len())),
                // What takes too long for many may be in time for few.
                Err(Refused::TooMany | Refused::Lost(Lost::Timeout(_))) if batch.len() > 1 => {
                    self.limits.history = batch.len() / 2;
                }
                Err(Refused::Service(_) | Refused::TooMany) => return Ok(None),
                Err(Refused::Lost(lost)) => return Err(lost),
            }
        }
    }
}

impl From<HistoryReadResult> for Page {
    fn from(result: HistoryReadResult) -> Self {
        Page {
            status: result.status_code,
            next: result.continuation_point,
            values: result
                .history_data
                .into_inner_as::<HistoryData>()
                .and_then(|data| data.data_values)
                .unwrap_or_default(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_without_anything_newer_lead_on_for_a_while() {
        let mut progress = Progress::default();
        let idle =
            |progress: &mut Progress| (0..1000).take_while(|_| progress.leads_on(f64::NEG_INFINITY)).count();
        assert_eq!(idle(&mut progress), 99);
        // A value ends the search, and the same value again is nothing new.
        assert!(progress.leads_on(5.0));
        assert_eq!((0..1000).take_while(|_| progress.leads_on(5.0)).count(), 99);
        assert_eq!(progress.newest, 5.0);
    }
}
