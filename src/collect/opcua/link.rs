//! One session with one server, and the only place that talks to it. It can only read.
//!
//! A session that is lost is never revived: after the client's own reconnect subscriptions exist but nobody asks
//! for what they publish. Reconnects are switched off, and a new link is opened instead.

use super::config::{Config, MAX_ARRAY, SecurityPolicy};
use super::listener::{Events, listener};
use super::plan::{Deadband, Sampling};
use super::security::{explain, identity, message_mode, own_files, policy_uri};
use super::value::Meaning;
use opcua::client::{Client, ClientBuilder, Session};
use opcua::types::{
    AttributeId, ByteString, DataChangeFilter, DataChangeTrigger, DataValue, EndpointDescription, Error,
    ExtensionObject, MonitoredItemCreateRequest, MonitoringMode, MonitoringParameters, NodeId, ReadValueId,
    StatusCode, TimestampsToReturn, UserTokenPolicy, VariableId,
};
use std::fmt;
use std::future::Future;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::AbortHandle;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

mod browse;
mod history;
mod resolve;
mod wire;

pub(super) use history::{Historian, Progress};

/// The server is told goodbye for no longer than this.
const GOODBYE: Duration = Duration::from_secs(2);

/// Why there is no session (any more).
#[derive(Debug)]
pub(super) enum Lost {
    /// No answer in time.
    Timeout(String),
    /// Refused, broken, ended, or not believed any more.
    Broken(String),
    /// Refused for a certificate, an identity or the security asked for, by us or by the server.
    Untrusted(String),
}

impl fmt::Display for Lost {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Lost::Timeout(what) => write!(out, "no answer in time: {what}"),
            Lost::Broken(why) | Lost::Untrusted(why) => out.write_str(why),
        }
    }
}

/// Most nodes in one request, by service; lowered when the server refuses more.
#[derive(Clone, Copy, Debug)]
struct Limits {
    read: usize,
    monitor: usize,
    translate: usize,
    history: usize,
}

/// One node's page of history, and where the next begins.
pub(super) struct Page {
    pub(super) values: Vec<DataValue>,
    pub(super) status: StatusCode,
    pub(super) next: ByteString,
}

/// The task of a session that is not linked yet: whoever stops waiting for the link ends it too.
struct Started {
    task: AbortHandle,
    linked: bool,
}

impl Drop for Started {
    fn drop(&mut self) {
        if !self.linked {
            self.task.abort();
        }
    }
}

/// An open session. Dropped, it says goodbye on a task of its own.
pub(super) struct Link {
    config: Arc<Config>,
    session: Arc<Session>,
    limits: Limits,
    ended: CancellationToken,
    task: AbortHandle,
}

impl Drop for Link {
    fn drop(&mut self) {
        self.session.disable_reconnects();
        let (session, task) = (self.session.clone(), self.task.clone());
        match tokio::runtime::Handle::try_current() {
            Ok(runtime) if !self.ended.is_cancelled() => {
                runtime.spawn(async move {
                    // It is gone either way; the goodbye only spares the server a session that times out.
                    let _ = timeout(GOODBYE, session.disconnect()).await;
                    task.abort();
                });
            }
            _ => task.abort(),
        }
    }
}

impl Link {
    /// Connects, within the configured time-out for each step, and reads the server's limits.
    pub(super) async fn open(config: Arc<Config>) -> Result<Link, Lost> {
        own_files(&config).map_err(Lost::Untrusted)?;
        let token = identity(&config).map_err(Lost::Untrusted)?;
        let limit = Duration::from_millis(config.timeout_ms);
        let client = client(&config).map_err(Lost::Broken)?;
        let endpoint: EndpointDescription = (
            config.url.as_str(),
            policy_uri(config.security_policy),
            message_mode(config.effective_mode()),
            UserTokenPolicy::anonymous(),
        )
            .into();
        let connecting = async {
            let endpoints = client.get_server_endpoints_from_url(wire::to(&config.url)?).await?;
            let asked = client.session_builder().with_endpoints(endpoints);
            let asked = asked.connect_to_matching_endpoint(endpoint)?.user_identity_token(token);
            asked.with_connector(wire::Wire).build(client.certificate_store().clone())
        };
        let (session, events) = match timeout(limit, connecting).await {
            Err(_) => return Err(Lost::Timeout(format!("{} does not list its endpoints", config.url))),
            Ok(Err(error)) => return Err(unopened(error.status(), &config)),
            Ok(Ok(connected)) => connected,
        };
        let (ended, over) = (CancellationToken::new(), CancellationToken::new());
        let (guard, finished) = (ended.clone(), over.clone());
        let task = tokio::spawn(async move {
            let _over = finished.drop_guard();
            let status = events.run().await;
            guard.cancel();
            status
        });
        let mut started = Started { task: task.abort_handle(), linked: false };
        // Waiting alone would hang for ever once the loop has given up.
        let connected = tokio::select! {
            status = task => Err(status.unwrap_or(StatusCode::BadUnexpectedError)),
            waited = timeout(limit, session.wait_for_connection()) => Ok(waited.unwrap_or(false)),
        };
        match connected {
            Ok(true) => {}
            Ok(false) => return Err(Lost::Timeout(format!("{} opens no session", config.url))),
            Err(status) => return Err(unopened(status, &config)),
        }
        session.disable_reconnects();
        let most = config.max_nodes_per_request;
        let limits = Limits { read: most, monitor: most, translate: most, history: most };
        started.linked = true;
        let task = started.task.clone();
        let mut link = Link { config, session, limits, ended: over, task };
        link.read_limits().await?;
        Ok(link)
    }

    /// Ends when the session has.
    pub(super) async fn ended(&self) {
        self.ended.cancelled().await;
    }

    /// Waits for an answer as long as the session lives, and not much longer than the time-out.
    async fn answer<T>(
        &self,
        what: &str,
        asked: impl Future<Output = Result<T, Error>>,
    ) -> Result<T, Refused> {
        let limit = Duration::from_millis(self.config.timeout_ms).saturating_mul(2);
        let answered = tokio::select! {
            () = self.ended() => return Err(Refused::Lost(Lost::Broken("the server ended the session".into()))),
            answered = timeout(limit, asked) => answered,
        };
        match answered {
            Err(_) => Err(Refused::Lost(Lost::Timeout(what.into()))),
            Ok(Ok(answer)) => Ok(answer),
            Ok(Err(error)) => Err(refused(what, error.status())),
        }
    }

    /// What the server says it can take at once; what it does not say is not limited by it.
    async fn read_limits(&mut self) -> Result<(), Lost> {
        let ids = [
            VariableId::Server_ServerCapabilities_OperationLimits_MaxNodesPerRead,
            VariableId::Server_ServerCapabilities_OperationLimits_MaxMonitoredItemsPerCall,
            VariableId::Server_ServerCapabilities_OperationLimits_MaxNodesPerTranslateBrowsePathsToNodeIds,
            VariableId::Server_ServerCapabilities_OperationLimits_MaxNodesPerHistoryReadData,
        ];
        let nodes: Vec<NodeId> = ids.into_iter().map(NodeId::from).collect();
        let said: Vec<Option<usize>> = self
            .read(&nodes)
            .await?
            .iter()
            .map(|value| value.value.as_ref()?.as_f64().filter(|most| *most >= 1.0).map(|most| most as usize))
            .collect();
        let least = |at: usize, own: usize| said.get(at).copied().flatten().map_or(own, |most| most.min(own));
        let Limits { read, monitor, translate, history } = self.limits;
        self.limits = Limits {
            read: least(0, read),
            monitor: least(1, monitor),
            translate: least(2, translate),
            history: least(3, history),
        };
        Ok(())
    }

    /// The values of the nodes, in their order. All are held at once, so it is for few nodes, and for `probe`.
    pub(super) async fn read(&mut self, nodes: &[NodeId]) -> Result<Vec<DataValue>, Lost> {
        let mut values = Vec::with_capacity(nodes.len());
        self.read_each(nodes, |value| values.push(value)).await?;
        Ok(values)
    }

    /// Gives the value of each node to `take`, in their order, in as many requests as the server's limit asks for. Only one
    /// answer is held at a time, since a value may be of any size.
    pub(super) async fn read_each(
        &mut self,
        nodes: &[NodeId],
        mut take: impl FnMut(DataValue),
    ) -> Result<(), Lost> {
        let mut done = 0;
        while done < nodes.len() {
            let batch: Vec<ReadValueId> =
                nodes[done..].iter().take(self.limits.read).map(|node| value_of(node.clone())).collect();
            let asked = self.session.read(&batch, TimestampsToReturn::Both, 0.0);
            match self.answer("read", asked).await {
                Ok(answer) if answer.len() == batch.len() => {
                    done += batch.len();
                    answer.into_iter().for_each(&mut take);
                }
                Ok(answer) => return Err(wrong_count("read", batch.len(), answer.len())),
                Err(Refused::TooMany) if batch.len() > 1 => self.limits.read = batch.len() / 2,
                Err(refused) => return Err(refused.into()),
            }
        }
        Ok(())
    }

    /// Opens an empty subscription for tags of these meanings, by position, and what it brings.
    pub(super) async fn subscribe(&self, meanings: Vec<Meaning>) -> Result<(u32, Events), Lost> {
        let (listener, events) = listener(meanings);
        let publishing = Duration::from_millis(self.config.publishing_ms);
        // A sign of life at least three times within the silence allowed.
        let keep_alive = (self.config.silent_s / 3.0 / publishing.as_secs_f64()).clamp(1.0, 1000.0) as u32;
        let created =
            self.session.create_subscription(publishing, 10 * keep_alive, keep_alive, 0, 0, true, listener);
        let id = self.answer("create a subscription", created).await?;
        Ok((id, events))
    }

    /// Has the nodes monitored, each under its tag's position and as its sampling says. Says how each was taken.
    pub(super) async fn monitor(
        &mut self,
        subscription: u32,
        nodes: &[(usize, NodeId, Sampling)],
    ) -> Result<Vec<StatusCode>, Lost> {
        let mut taken = Vec::with_capacity(nodes.len());
        while taken.len() < nodes.len() {
            let batch = &nodes[taken.len()..][..self.limits.monitor.min(nodes.len() - taken.len())];
            let items = batch.iter().map(item).collect();
            match self.create(subscription, items).await {
                Ok(answer) if answer.len() == batch.len() => taken.extend(answer),
                Ok(answer) => return Err(wrong_count("monitored items", batch.len(), answer.len())),
                Err(Refused::TooMany) if batch.len() > 1 => self.limits.monitor = batch.len() / 2,
                Err(refused) => return Err(refused.into()),
            }
        }
        // A node without an EURange, and a server without filters, still have values: without a dead band.
        let refused = |status: &StatusCode| {
            *status == StatusCode::BadMonitoredItemFilterUnsupported
                || *status == StatusCode::BadMonitoredItemFilterInvalid
                || *status == StatusCode::BadDeadbandFilterInvalid
                || *status == StatusCode::BadFilterNotAllowed
        };
        let plain: Vec<usize> = (0..taken.len()).filter(|at| refused(&taken[*at])).collect();
        for batch in plain.chunks(self.limits.monitor.max(1)) {
            let items = batch.iter().map(|at| unfiltered(item(&nodes[*at]))).collect();
            for (at, status) in batch.iter().zip(self.create(subscription, items).await?) {
                taken[*at] = status;
            }
        }
        Ok(taken)
    }

    async fn create(
        &self,
        subscription: u32,
        items: Vec<MonitoredItemCreateRequest>,
    ) -> Result<Vec<StatusCode>, Refused> {
        let created = self.session.create_monitored_items(subscription, TimestampsToReturn::Both, items);
        let answer = self.answer("monitored items", created).await?;
        Ok(answer.into_iter().map(|item| item.result.status_code).collect())
    }
}

/// Why one request brought nothing.
enum Refused {
    /// The session is gone.
    Lost(Lost),
    /// More than the server takes at once.
    TooMany,
    /// The server is alive and says no.
    Service(String),
}

impl From<Refused> for Lost {
    fn from(refused: Refused) -> Self {
        match refused {
            Refused::Lost(lost) => lost,
            Refused::TooMany => Lost::Broken("the server takes not even one node at once".into()),
            Refused::Service(why) => Lost::Broken(why),
        }
    }
}

fn refused(what: &str, status: StatusCode) -> Refused {
    let is = |codes: &[StatusCode]| codes.contains(&status);
    if is(&[
        StatusCode::BadTooManyOperations,
        StatusCode::BadResponseTooLarge,
        StatusCode::BadRequestTooLarge,
        StatusCode::BadEncodingLimitsExceeded,
    ]) {
        Refused::TooMany
    } else if is(&[StatusCode::BadTimeout, StatusCode::BadRequestTimeout]) {
        Refused::Lost(Lost::Timeout(what.into()))
    } else if is(&[
        StatusCode::BadServiceUnsupported,
        StatusCode::BadNotImplemented,
        StatusCode::BadHistoryOperationUnsupported,
        StatusCode::BadHistoryOperationInvalid,
        StatusCode::BadUserAccessDenied,
        StatusCode::BadInternalError,
    ]) {
        Refused::Service(format!("{what}: {status}"))
    } else {
        Refused::Lost(Lost::Broken(format!("{what}: {status}")))
    }
}

fn unopened(status: StatusCode, config: &Config) -> Lost {
    explain(status, config).map_or_else(|| Lost::Broken(status.to_string()), Lost::Untrusted)
}

fn wrong_count(what: &str, asked: usize, came: usize) -> Lost {
    Lost::Broken(format!("{what}: asked for {asked}, answered {came}"))
}

fn value_of(node_id: NodeId) -> ReadValueId {
    ReadValueId { node_id, attribute_id: AttributeId::Value as u32, ..Default::default() }
}

fn item((at, node, sampling): &(usize, NodeId, Sampling)) -> MonitoredItemCreateRequest {
    let (trigger, deadband_type, deadband_value) = match sampling.deadband {
        // A value that was measured again is a sample, even when it is the same.
        Deadband::None => (DataChangeTrigger::StatusValueTimestamp, 0, 0.0),
        // With a new time stamp alone as a reason a dead band would hide nothing.
        Deadband::Absolute(band) => (DataChangeTrigger::StatusValue, 1, band),
        Deadband::Percent(band) => (DataChangeTrigger::StatusValue, 2, band),
    };
    let filter = DataChangeFilter { trigger, deadband_type, deadband_value };
    MonitoredItemCreateRequest {
        item_to_monitor: value_of(node.clone()),
        monitoring_mode: MonitoringMode::Reporting,
        requested_parameters: MonitoringParameters {
            // 0 would have the library choose.
            client_handle: u32::try_from(at + 1).unwrap_or(u32::MAX),
            sampling_interval: sampling.every_ms as f64,
            filter: ExtensionObject::from_message(filter),
            queue_size: sampling.queue,
            discard_oldest: true,
        },
    }
}

fn unfiltered(mut item: MonitoredItemCreateRequest) -> MonitoredItemCreateRequest {
    item.requested_parameters.filter = ExtensionObject::null();
    item
}

/// A client that never reconnects by itself and trusts nobody unasked.
fn client(config: &Config) -> Result<Client, String> {
    let timeout = Duration::from_millis(config.timeout_ms);
    // A subscription that is slow has nothing to say for long.
    let silence_s = config.silent_s.max(3.0 * (config.sampling_ms + config.publishing_ms) as f64 / 1e3);
    // Without security no folder is needed, and none is made: nothing can be below a device.
    let none = PathBuf::from("/dev/null/pki");
    let secure = config.security_policy != SecurityPolicy::None;
    let folder = config.pki_dir.clone().filter(|_| secure).unwrap_or(none);
    let built = ClientBuilder::new()
        .application_name("stictiond")
        .application_uri(config.application_uri.clone())
        .product_uri("urn:stictiond")
        .session_name("stictiond")
        .pki_dir(folder)
        .certificate_path("own/cert.der")
        .private_key_path("private/private.pem")
        .create_sample_keypair(false)
        .trust_server_certs(false)
        .verify_server_certs(true)
        .session_retry_limit(0)
        .request_timeout(timeout)
        .publish_timeout(timeout.saturating_mul(2).max(Duration::from_secs_f64(silence_s)))
        .keep_alive_interval(Duration::from_secs_f64(config.silent_s / 3.0))
        .max_failed_keep_alive_count(2)
        .recreate_subscriptions(false)
        .max_array_length(MAX_ARRAY);
    // The library complains of a missing folder, also where none is needed; what is needed was looked for before.
    let quiet = tracing::subscriber::NoSubscriber::default();
    tracing::subscriber::with_default(quiet, || built.client()).map_err(|errors| errors.join("; "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_session_that_nobody_waits_for_any_more_is_ended() {
        let unlinked = tokio::spawn(std::future::pending::<()>());
        drop(Started { task: unlinked.abort_handle(), linked: false });
        assert!(unlinked.await.is_err_and(|error| error.is_cancelled()));
        let linked = tokio::spawn(std::future::ready(()));
        drop(Started { task: linked.abort_handle(), linked: true });
        assert!(linked.await.is_ok());
    }
}
