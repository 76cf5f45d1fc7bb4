//! The ports: senders that never wait, receivers that never allocate, of single samples and of slices with a header.
//!
//! In: ports that [`super::session`] opened. Out: samples, or an [`IpcError`]. Every call is under the eyes of [`super::watch`].

use super::error::IpcError;
use super::node::Transport;
use super::topics::Topic;
use super::watch::Calls;
use super::wire::WireType;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections as _;
use iceoryx2::prelude::ZeroCopySend;
use std::fmt::Debug;

/// Sends samples of one type.
#[derive(Debug)]
pub(super) struct FixedPublisher<T: WireType + ZeroCopySend + Debug> {
    port: Publisher<Transport, T, ()>,
    service: String,
    calls: Calls,
}

impl<T: WireType + ZeroCopySend + Debug> FixedPublisher<T> {
    pub(super) fn new(port: Publisher<Transport, T, ()>, topic: &Topic, calls: Calls) -> Self {
        Self { port, service: topic.name.clone(), calls }
    }

    /// Sends `value` to all; never waits.
    pub(super) fn send(&self, value: T) -> Result<(), IpcError> {
        let sent = self.calls.during(|| self.port.send_copy(value));
        sent.map(drop).map_err(|error| IpcError::Send { service: self.service.clone(), reason: format!("{error:?}") })
    }
}

/// Receives samples of one type.
#[derive(Debug)]
pub(super) struct FixedSubscriber<T: WireType + ZeroCopySend + Debug> {
    port: Subscriber<Transport, T, ()>,
    calls: Calls,
}

impl<T: WireType + ZeroCopySend + Debug> FixedSubscriber<T> {
    pub(super) fn new(port: Subscriber<Transport, T, ()>, calls: Calls) -> Self {
        Self { port, calls }
    }

    /// The next sample and the transport's number of its publisher. A failing connection counts as silence: whoever
    /// waits for a sample judges by age.
    pub(super) fn next(&self) -> Option<(T, u128)> {
        let sample = self.calls.during(|| self.port.receive()).ok()??;
        Some((*sample.payload(), sample.header().publisher_id().value()))
    }

    /// The last of all samples that wait.
    pub(super) fn newest(&self) -> Option<T> {
        std::iter::from_fn(|| self.next()).last().map(|(sample, _)| sample)
    }
}

/// Sends slices with a header.
#[derive(Debug)]
pub(super) struct SlicePublisher<E, H>
where
    E: ZeroCopySend + Debug + Copy + 'static,
    H: WireType + ZeroCopySend + Debug,
{
    port: Publisher<Transport, [E], H>,
    service: String,
    calls: Calls,
}

impl<E, H> SlicePublisher<E, H>
where
    E: ZeroCopySend + Debug + Copy + Default + 'static,
    H: WireType + ZeroCopySend + Debug,
{
    pub(super) fn new(port: Publisher<Transport, [E], H>, topic: &Topic, calls: Calls) -> Self {
        Self { port, service: topic.name.clone(), calls }
    }

    /// Writes `values` straight into shared memory and sends them; never waits.
    pub(super) fn send(&self, header: &H, values: &[E]) -> Result<(), IpcError> {
        let failure = |reason: String| IpcError::Send { service: self.service.clone(), reason };
        let mut loan = self.port.loan_slice_uninit(values.len()).map_err(|error| failure(format!("{error:?}")))?;
        *loan.user_header_mut() = *header;
        let filled = loan.write_from_slice(values);
        self.calls.during(|| filled.send()).map(drop).map_err(|error| failure(format!("{error:?}")))
    }

    /// Gives subscribers that came since the last sample the newest one. Sending does it, too.
    pub(super) fn connect_latecomers(&self) -> Result<(), IpcError> {
        let connected = self.calls.during(|| self.port.update_connections());
        connected.map_err(|error| IpcError::Send { service: self.service.clone(), reason: format!("{error:?}") })
    }
}

/// Receives slices with a header.
#[derive(Debug)]
pub(super) struct SliceSubscriber<E, H>
where
    E: ZeroCopySend + Debug + Copy + 'static,
    H: WireType + ZeroCopySend + Debug,
{
    port: Subscriber<Transport, [E], H>,
    calls: Calls,
}

impl<E, H> SliceSubscriber<E, H>
where
    E: ZeroCopySend + Debug + Copy + 'static,
    H: WireType + ZeroCopySend + Debug,
{
    pub(super) fn new(port: Subscriber<Transport, [E], H>, calls: Calls) -> Self {
        Self { port, calls }
    }

    /// Shows the next sample to `read`, in shared memory.
    pub(super) fn next<R>(&self, read: impl FnOnce(&H, &[E]) -> R) -> Option<R> {
        let sample = self.calls.during(|| self.port.receive()).ok()??;
        Some(read(sample.user_header(), sample.payload()))
    }
}
