//! What a server kept, page by page.

use super::{Link, Lost, Page, Refused, wrong_count};
use crate::collect::opcua::value::date_time;
use opcua::client::HistoryReadAction;
use opcua::types::{
    AggregateConfiguration, ByteString, HistoryData, HistoryReadValueId, NodeId, ObjectId,
    ReadProcessedDetails, ReadRawModifiedDetails, TimestampsToReturn,
};
use std::time::Duration;
use tokio::time::timeout;
use tracing::debug;

/// Values of one node asked of the history at once.
const VALUES_PER_PAGE: u32 = 1000;
/// A session that has ended says so within this time of a request that failed for it.
const AFTERMATH: Duration = Duration::from_secs(1);

impl Link {
    /// One page of raw history of each node, from `from` to `to` (s), oldest first; `None` when the server refuses
    /// the service. A node given with a continuation goes on from there.
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

    /// The same for a session that has more to do: whatever a historian says, or leaves unsaid, is no reason to end it.
    /// `None` too when a request failed, while the session lives.
    pub(in crate::collect::opcua) async fn history_if_any(
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

    /// A page of the server's means over every `every_s` for each node, where it makes any.
    pub(in crate::collect::opcua) async fn means(
        &mut self,
        nodes: &[(NodeId, ByteString)],
        from: f64,
        to: f64,
        every_s: f64,
    ) -> Result<Option<Vec<Page>>, Lost> {
        let mut pages = Vec::with_capacity(nodes.len());
        // A request has a function for each of its nodes: one by one, whatever the server's limit.
        for node in nodes {
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
            let action = HistoryReadAction::ReadProcessedDetails(details);
            match self.pages(std::slice::from_ref(node), &action).await? {
                Some(page) => pages.extend(page),
                None => return Ok(None),
            }
        }
        Ok(Some(pages))
    }

    async fn pages(
        &mut self,
        nodes: &[(NodeId, ByteString)],
        action: &HistoryReadAction,
    ) -> Result<Option<Vec<Page>>, Lost> {
        let mut pages = Vec::with_capacity(nodes.len());
        while pages.len() < nodes.len() {
            let ask = |(node, next): &(NodeId, ByteString)| HistoryReadValueId {
                node_id: node.clone(),
                continuation_point: next.clone(),
                ..Default::default()
            };
            let batch: Vec<HistoryReadValueId> =
                nodes[pages.len()..].iter().take(self.limits.history).map(ask).collect();
            let asked = self.session.history_read(action.clone(), TimestampsToReturn::Both, false, &batch);
            match self.answer("history", asked).await {
                Ok(answer) if answer.len() == batch.len() => {
                    pages.extend(answer.into_iter().map(|result| {
                        Page {
                            status: result.status_code,
                            next: result.continuation_point,
                            values: result
                                .history_data
                                .into_inner_as::<HistoryData>()
                                .and_then(|data| data.data_values)
                                .unwrap_or_default(),
                        }
                    }));
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
        Ok(Some(pages))
    }
}
