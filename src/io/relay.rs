//! Copies of what the daemon and the controller publish, on topics that other machines can be given.
//!
//! In: energyscapes, cues, commands, what the platform is told, health. Out: the same samples on `noctule/relay/...`. The transport's own
//! link to other machines opens a publisher in every service that it carries, on both sides. Topics with one publisher refuse it, and the
//! command topic must: so the link carries these copies instead, to which nothing of the robot listens. Never waits for anybody.

use super::error::IpcError;
use super::node::{Ipc, Needs, Registration};
use super::ports::{FixedPublisher, FixedSubscriber, SlicePublisher, SliceSubscriber};
use super::session::Session;
use super::topics::Topic;
use super::wire::WireType;
use super::wire::message::{EnergyscapeHeader, VelocityCommand};
use super::wire::telemetry::{Cues, Health, PlatformVelocity};
use iceoryx2::prelude::ZeroCopySend;
use std::fmt::Debug;

/// A topic of single samples and its copy.
#[derive(Debug)]
struct Reports<T: WireType + ZeroCopySend + Debug> {
    from: FixedSubscriber<T>,
    to: FixedPublisher<T>,
}

impl<T: WireType + ZeroCopySend + Debug> Reports<T> {
    fn open(session: &Session, topic: &Topic) -> Result<Self, IpcError> {
        Ok(Self { from: session.subscriber(topic)?, to: session.publisher(&topic.relayed())? })
    }

    fn pass_on(&self) -> Result<u64, IpcError> {
        let mut passed = 0;
        while let Some((sample, _)) = self.from.next() {
            self.to.send(sample)?;
            passed += 1;
        }
        Ok(passed)
    }
}

/// A sensor's energyscapes and their copy.
#[derive(Debug)]
struct Images {
    from: SliceSubscriber<f32, EnergyscapeHeader>,
    to: SlicePublisher<f32, EnergyscapeHeader>,
}

impl Images {
    fn pass_on(&self) -> Result<u64, IpcError> {
        let mut passed = 0;
        while let Some(sent) = self.from.next(|header, cells| self.to.send(header, cells)) {
            sent?;
            passed += 1;
        }
        Ok(passed)
    }
}

/// The open topics and their copies.
#[derive(Debug)]
pub struct Relay {
    images: Vec<Images>,
    cues: Reports<Cues>,
    command: Reports<VelocityCommand>,
    platform: Reports<PlatformVelocity>,
    health: Reports<Health>,
    _registration: Registration,
}

impl Relay {
    /// Opens everything; `cell_counts` are the cells of the sensors' energyscapes, in the order of `sensors`.
    ///
    /// # Errors
    /// [`IpcError`].
    pub fn open(ipc: &Ipc, sensors: &[String], cell_counts: &[usize]) -> Result<Self, IpcError> {
        let images: Vec<(Topic, usize)> =
            sensors.iter().zip(cell_counts).map(|(sensor, &count)| (Topic::energyscape(sensor), count)).collect();
        let reports = [Topic::cues(), Topic::command(), Topic::platform(), Topic::health()];
        let pairs = images.iter().cloned().chain(reports.map(|topic| (topic, 1)));
        let needs =
            pairs.fold(Needs::new(), |needs, (topic, len)| needs.subscriber(&topic).publisher(&topic.relayed(), len));
        let (registration, (images, cues, command, platform, health)) =
            ipc.set_up("noctule-relay", needs, move |session| {
                let pair = |(topic, len): &(Topic, usize)| {
                    let from = session.slice_subscriber(topic)?;
                    Ok::<_, IpcError>(Images { from, to: session.slice_publisher(&topic.relayed(), *len)? })
                };
                Ok((
                    images.iter().map(pair).collect::<Result<Vec<_>, _>>()?,
                    Reports::open(session, &Topic::cues())?,
                    Reports::open(session, &Topic::command())?,
                    Reports::open(session, &Topic::platform())?,
                    Reports::open(session, &Topic::health())?,
                ))
            })?;
        Ok(Self { images, cues, command, platform, health, _registration: registration })
    }

    /// Passes on what waits; returns how many samples that were.
    ///
    /// # Errors
    /// [`IpcError::Send`].
    pub fn pass_on(&self) -> Result<u64, IpcError> {
        let mut passed = self.command.pass_on()? + self.platform.pass_on()? + self.cues.pass_on()?;
        passed += self.health.pass_on()?;
        for images in &self.images {
            passed += images.pass_on()?;
        }
        Ok(passed)
    }
}
