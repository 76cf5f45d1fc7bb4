//! Opening of typed ports during set-up, with a ladder against what dead processes left.
//!
//! In: [`Topic`]s. Out: publishers that never wait and subscribers that never allocate, or an [`IpcError`]. Every service
//! carries the schema hash of its type as an attribute; a peer with another layout is refused here.

use super::error::IpcError;
use super::files;
use super::node::{Ipc, Transport};
use super::ports::{FixedPublisher, FixedSubscriber, SlicePublisher, SliceSubscriber};
use super::topics::{SCHEMA_ATTRIBUTE, Topic};
use super::watch::Calls;
use super::wire::{WireType, force_remove_service};
use iceoryx2::port::publisher::PublisherCreateError;
use iceoryx2::port::subscriber::SubscriberCreateError;
use iceoryx2::prelude::{
    AllocationStrategy, AttributeVerifier, BackpressureStrategy, CallbackProgression, Config, MessagingPattern, Node,
    NodeState, PortFactory as _, Service, ServiceName, ZeroCopySend,
};
use iceoryx2::service::builder::publish_subscribe::{
    PublishSubscribeCreateError, PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError,
};
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use iceoryx2::service::service_hash::ServiceHash;
use std::cell::RefCell;
use std::fmt::Debug;
use std::time::Duration;

/// Longest wait for another process that cleans up the same dead node.
const CLEANUP_LIMIT: Duration = Duration::from_millis(100);
/// A service that its last user is just leaving needs a moment.
const LEAVING_PAUSE: Duration = Duration::from_millis(50);

/// A set-up in progress.
pub(super) struct Session<'a> {
    ipc: &'a Ipc,
    config: &'a Config,
    node: &'a Node<Transport>,
    ports: RefCell<Vec<Calls>>,
}

/// Whether cleaning up can help.
enum Failure {
    Final(IpcError),
    Retry(IpcError),
}

/// Opens the service of a topic, or makes it with the topic's limits. The builder's type differs for slices, its calls do not.
macro_rules! open_service {
    ($session:expr, $topic:expr, $builder:expr) => {
        $builder
            .max_publishers($topic.qos.publishers_max)
            .max_subscribers($topic.qos.subscribers_max)
            .max_nodes($topic.nodes_max())
            .subscriber_max_buffer_size($topic.qos.buffer)
            .subscriber_max_borrowed_samples($topic.qos.borrowed)
            .history_size($topic.qos.history)
            .enable_safe_overflow(true)
            .open_or_create_with_attributes(&schema_attribute($topic).map_err(Failure::Final)?)
            .map_err(|error| $session.service_failure($topic, error))
            .and_then(|service| $session.with_our_limits($topic, service))?
    };
}

impl<'a> Session<'a> {
    pub(super) fn new(ipc: &'a Ipc, config: &'a Config, node: &'a Node<Transport>) -> Self {
        Self { ipc, config, node, ports: RefCell::default() }
    }

    /// The calls of all ports that were made, to be watched.
    pub(super) fn into_calls(self) -> Vec<Calls> {
        self.ports.into_inner()
    }

    /// Of one more port.
    fn calls(&self) -> Calls {
        let calls = Calls::default();
        self.ports.borrow_mut().push(calls.clone());
        calls
    }

    /// Publisher of a topic without header. The service is made if it does not exist.
    pub(super) fn publisher<T>(&self, topic: &Topic) -> Result<FixedPublisher<T>, IpcError>
    where
        T: WireType + ZeroCopySend + Debug,
    {
        let port = self.climb(topic, |name| {
            let service = open_service!(self, topic, self.node.service_builder(name).publish_subscribe::<T>());
            service
                .publisher_builder()
                .max_loaned_samples(1)
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .create()
                .map_err(|error| publisher_failure(self.ipc, topic, &service, error))
        })?;
        Ok(FixedPublisher::new(port, topic, self.calls()))
    }

    /// Processes that publish on a topic without header, now. The service is made if it does not exist.
    pub(super) fn publishers<T>(&self, topic: &Topic) -> Result<Vec<u32>, IpcError>
    where
        T: WireType + ZeroCopySend + Debug,
    {
        self.climb(topic, |name| {
            let service = open_service!(self, topic, self.node.service_builder(name).publish_subscribe::<T>());
            let mut found = Vec::new();
            service.dynamic_config().list_publishers(|publisher| {
                let process = publisher.node_id.pid::<Transport>().ok();
                found.extend(process.and_then(|process| u32::try_from(process.value()).ok()));
                CallbackProgression::Continue
            });
            Ok(found)
        })
    }

    /// Subscriber of a topic without header. The service is made if it does not exist.
    pub(super) fn subscriber<T>(&self, topic: &Topic) -> Result<FixedSubscriber<T>, IpcError>
    where
        T: WireType + ZeroCopySend + Debug,
    {
        let port = self.climb(topic, |name| {
            let service = open_service!(self, topic, self.node.service_builder(name).publish_subscribe::<T>());
            let builder = service.subscriber_builder().buffer_size(topic.qos.buffer);
            builder.create().map_err(|error| subscriber_failure(self.ipc, topic, error))
        })?;
        Ok(FixedSubscriber::new(port, self.calls()))
    }

    /// Publisher of a topic with header `H` and samples of up to `len` elements.
    pub(super) fn slice_publisher<E, H>(&self, topic: &Topic, len: usize) -> Result<SlicePublisher<E, H>, IpcError>
    where
        E: ZeroCopySend + Debug + Copy + Default + 'static,
        H: WireType + ZeroCopySend + Debug,
    {
        let port = self.climb(topic, |name| {
            let builder = self.node.service_builder(name).publish_subscribe::<[E]>().user_header::<H>();
            let service = open_service!(self, topic, builder);
            service
                .publisher_builder()
                .max_loaned_samples(1)
                .initial_max_slice_len(len)
                .allocation_strategy(AllocationStrategy::Static)
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .create()
                .map_err(|error| publisher_failure(self.ipc, topic, &service, error))
        })?;
        Ok(SlicePublisher::new(port, topic, self.calls()))
    }

    /// Subscriber of a topic with header `H`.
    pub(super) fn slice_subscriber<E, H>(&self, topic: &Topic) -> Result<SliceSubscriber<E, H>, IpcError>
    where
        E: ZeroCopySend + Debug + Copy + Default + 'static,
        H: WireType + ZeroCopySend + Debug,
    {
        let port = self.climb(topic, |name| {
            let builder = self.node.service_builder(name).publish_subscribe::<[E]>().user_header::<H>();
            let service = open_service!(self, topic, builder);
            let builder = service.subscriber_builder().buffer_size(topic.qos.buffer).history_request(topic.qos.history);
            builder.create().map_err(|error| subscriber_failure(self.ipc, topic, error))
        })?;
        Ok(SliceSubscriber::new(port, self.calls()))
    }

    /// The ladder: try; clean dead nodes, take away a service that cannot be opened and that nobody alive uses, and try; wait a
    /// moment and try; where nobody else lives, remove the service by force and try.
    fn climb<T>(&self, topic: &Topic, attempt: impl Fn(&ServiceName) -> Result<T, Failure>) -> Result<T, IpcError> {
        let name = ServiceName::new(&topic.name)
            .map_err(|error| IpcError::Internal(format!("service name {}: {error:?}", topic.name)))?;
        for step in 0.. {
            let error = match attempt(&name) {
                Ok(made) => return Ok(made),
                Err(Failure::Final(error)) => return Err(error),
                Err(Failure::Retry(error)) => error,
            };
            match step {
                0 => {
                    let _ = self.node.blocking_cleanup_dead_nodes(CLEANUP_LIMIT);
                    if matches!(error, IpcError::Stuck { .. }) {
                        self.take_away_unused(&name);
                    }
                }
                1 => std::thread::sleep(LEAVING_PAUSE),
                2 if matches!(error, IpcError::Stuck { .. } | IpcError::Incompatible { .. }) && self.alone() => {
                    force_remove_service(self.node, &name);
                }
                _ => return Err(error),
            }
        }
        Err(self.ipc.stuck(topic.name.clone()))
    }

    /// Takes away the file that announces a service, unless a living process uses it. It may be half written, or announce
    /// what is gone: the transport waits a second for it at each opening, and does not remove it when asked to.
    fn take_away_unused(&self, name: &ServiceName) {
        let hash =
            ServiceHash::new::<<Transport as Service>::ServiceNameHasher>(name, MessagingPattern::PublishSubscribe);
        let mut used = false;
        let listed = Node::<Transport>::list(self.config, |state| {
            if matches!(&state, NodeState::Alive(_) | NodeState::Inaccessible(_)) {
                let node = state.node_id().value();
                used |= files::service_tag(self.ipc.root(), self.ipc.prefix(), node, hash.as_str()).exists();
            }
            CallbackProgression::Continue
        });
        if listed.is_ok() && !used && files::remove_service_file(self.ipc.root(), self.ipc.prefix(), hash.as_str()) {
            log::warn!("service {name} was left unusable by a dead process and is made again");
        }
    }

    /// Whether no other living process is registered under our root and prefix. What is registered by halves was left so
    /// by a process that died: whoever sets up holds the root's lock, and we do.
    fn alone(&self) -> bool {
        living_others(self.config, Some(self.node)) == Some(0)
    }

    /// Refuses a service that admits more than the topic does. The transport takes the limits that it is given as the least
    /// that must be: a squatter's service with room for two publishers would make the daemon one commander of two.
    fn with_our_limits<P, H>(
        &self,
        topic: &Topic,
        service: PortFactory<Transport, P, H>,
    ) -> Result<PortFactory<Transport, P, H>, Failure>
    where
        P: Debug + iceoryx2::prelude::IceoryxSend + ?Sized + 'static,
        H: Debug + ZeroCopySend,
    {
        let found = service.static_config();
        let (publishers, history) = (found.max_publishers(), found.history_size());
        if publishers <= topic.qos.publishers_max && history <= topic.qos.history {
            return Ok(service);
        }
        Err(self.incompatible(topic, &format!("room for {publishers} publishers, history {history}")))
    }

    /// What is there, made by whom, against what we expect.
    fn incompatible(&self, topic: &Topic, why: &str) -> Failure {
        let layout = topic.header.unwrap_or(topic.payload);
        Failure::Retry(IpcError::Incompatible {
            service: topic.name.clone(),
            found: self.describe_found(topic).map_or_else(|| why.to_owned(), |found| format!("{found} ({why})")),
            expected: describe(
                &format!("{:016x}", topic.schema_hash()),
                layout.type_name,
                layout.size,
                topic.qos.publishers_max,
                topic.qos.history,
            ),
        })
    }

    fn describe_found(&self, topic: &Topic) -> Option<String> {
        let name = ServiceName::new(&topic.name).ok()?;
        let details = Transport::details(&name, self.config, MessagingPattern::PublishSubscribe).ok()??;
        let found = &details.static_details;
        let key = SCHEMA_ATTRIBUTE.try_into().ok()?;
        let schema = found.attributes().key_value(&key, 0).map_or("none".to_owned(), ToString::to_string);
        let limits = found.publish_subscribe();
        let types = limits.message_type_details();
        let layout = if topic.header.is_some() { &types.user_header } else { &types.payload };
        let (publishers, history) = (limits.max_publishers(), limits.history_size());
        let mut text = describe(&schema, &layout.type_name().to_string(), layout.size(), publishers, history);
        let nodes = details.dynamic_details.map_or_else(Vec::new, |dynamic| dynamic.nodes);
        let holders: Vec<String> = nodes
            .iter()
            .filter(|node| node.node_id() != self.node.id())
            .filter_map(|node| node.node_id().pid::<Transport>().ok())
            .map(|pid| pid.value().to_string())
            .collect();
        if !holders.is_empty() {
            text.push_str(&format!(", held by process {}", holders.join(", ")));
        }
        Some(text)
    }

    fn service_failure(&self, topic: &Topic, error: PublishSubscribeOpenOrCreateError) -> Failure {
        use PublishSubscribeOpenError as Open;
        use PublishSubscribeOpenOrCreateError::{
            PublishSubscribeCreateError as Created, PublishSubscribeOpenError as Opened,
        };
        let incompatible = || self.incompatible(topic, &format!("{error:?}"));
        match error {
            Opened(
                Open::IncompatibleTypes
                | Open::IncompatibleAttributes
                | Open::IncompatibleMessagingPattern
                | Open::IncompatibleOverflowBehavior
                | Open::DoesNotSupportRequestedMinBufferSize
                | Open::DoesNotSupportRequestedMinHistorySize
                | Open::DoesNotSupportRequestedMinSubscriberBorrowedSamples
                | Open::DoesNotSupportRequestedAmountOfPublishers
                | Open::DoesNotSupportRequestedAmountOfSubscribers
                | Open::DoesNotSupportRequestedAmountOfNodes,
            ) => incompatible(),
            // Another version of the transport has living users; without one the file is spoilt.
            Opened(Open::VersionMismatch) if !self.alone() => incompatible(),
            Opened(Open::InsufficientPermissions) | Created(PublishSubscribeCreateError::InsufficientPermissions) => {
                Failure::Final(IpcError::Permission {
                    path: self.ipc.root().to_owned(),
                    found: format!("files of service {} that this user may not use", topic.name),
                    allowed: "files of this user",
                })
            }
            error => Failure::Retry(self.ipc.stuck(format!("service {} cannot be opened ({error:?})", topic.name))),
        }
    }
}

/// Living nodes under the root and prefix of `config` but for `ours`; `None` when they cannot be listed.
pub(super) fn living_others(config: &Config, ours: Option<&Node<Transport>>) -> Option<usize> {
    let mut others = 0;
    let listed = Node::<Transport>::list(config, |state| {
        let alive = matches!(&state, NodeState::Alive(_) | NodeState::Inaccessible(_));
        if alive && Some(state.node_id()) != ours.map(Node::id) {
            others += 1;
        }
        CallbackProgression::Continue
    });
    listed.is_ok().then_some(others)
}

fn describe(schema: &str, type_name: &str, size: usize, publishers: usize, history: usize) -> String {
    format!("schema {schema} of {type_name} ({size} bytes), publishers {publishers}, history {history}")
}

fn schema_attribute(topic: &Topic) -> Result<AttributeVerifier, IpcError> {
    if !topic.is_attributed() {
        return Ok(AttributeVerifier::new());
    }
    let invalid = |error: &dyn Debug| IpcError::Internal(format!("attribute of {}: {error:?}", topic.name));
    let key = SCHEMA_ATTRIBUTE.try_into().map_err(|error| invalid(&error))?;
    let value = format!("{:016x}", topic.schema_hash());
    let value = value.as_str().try_into().map_err(|error| invalid(&error))?;
    AttributeVerifier::new().require(&key, &value).map_err(|error| invalid(&error))
}

fn publisher_failure<P, H>(
    ipc: &Ipc,
    topic: &Topic,
    service: &PortFactory<Transport, P, H>,
    error: PublisherCreateError,
) -> Failure
where
    P: Debug + iceoryx2::prelude::IceoryxSend + ?Sized + 'static,
    H: Debug + ZeroCopySend,
{
    match error {
        PublisherCreateError::ExceedsMaxSupportedPublishers if topic.qos.publishers_max == 1 => {
            let mut holders = Vec::new();
            service.dynamic_config().list_publishers(|publisher| {
                holders.extend(publisher.node_id.pid::<Transport>().map(|pid| pid.value()).ok());
                CallbackProgression::Continue
            });
            Failure::Retry(if holders.iter().any(|&pid| process_exists(pid)) {
                let holder = holders.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
                IpcError::PublisherPresent { service: topic.name.clone(), holder }
            } else {
                ipc.stuck(format!("service {} is held by a process that is gone", topic.name))
            })
        }
        PublisherCreateError::ExceedsMaxSupportedPublishers => Failure::Retry(IpcError::Crowded {
            service: topic.name.clone(),
            what: "too many publishers",
            allowed: topic.qos.publishers_max,
        }),
        error => Failure::Retry(ipc.stuck(format!("service {} takes no publisher ({error:?})", topic.name))),
    }
}

/// Whether a process with this id runs, be it another user's.
fn process_exists(pid: i32) -> bool {
    rustix::process::Pid::from_raw(pid)
        .is_some_and(|pid| rustix::process::test_kill_process(pid) != Err(rustix::io::Errno::SRCH))
}

fn subscriber_failure(ipc: &Ipc, topic: &Topic, error: SubscriberCreateError) -> Failure {
    match error {
        SubscriberCreateError::ExceedsMaxSupportedSubscribers => Failure::Retry(IpcError::Crowded {
            service: topic.name.clone(),
            what: "too many subscribers",
            allowed: topic.qos.subscribers_max,
        }),
        error => Failure::Retry(ipc.stuck(format!("service {} takes no subscriber ({error:?})", topic.name))),
    }
}
