//! Everything that the live page shows, heard by one client: health, cues, commands, what the platform is told, energyscapes,
//! what the detectors found.
//!
//! In: the topics. Out: sound samples only (layout and checksum are judged here), copied or shown where they lie. Listens only:
//! never publishes, never holds a sample, and tells when its files were taken away, so that its owner opens it anew.

use super::error::IpcError;
use super::node::{Ipc, Needs, Registration};
use super::ports::{FixedSubscriber, SliceSubscriber};
use super::topics::Topic;
use super::wire::detections::{Objects, Obstacle, Scan};
use super::wire::message::{EnergyscapeHeader, VelocityCommand};
use super::wire::telemetry::{Cues, Health, PlatformVelocity};
use super::wire::{Checked, WireType};

/// Listens to all that daemon and controller tell.
#[derive(Debug)]
pub struct ViewTopics {
    health: FixedSubscriber<Health>,
    cues: FixedSubscriber<Cues>,
    command: FixedSubscriber<VelocityCommand>,
    platform: FixedSubscriber<PlatformVelocity>,
    scan: FixedSubscriber<Scan>,
    obstacle: FixedSubscriber<Obstacle>,
    objects: FixedSubscriber<Objects>,
    energyscapes: Vec<SliceSubscriber<f32, EnergyscapeHeader>>,
    registration: Registration,
}

impl ViewTopics {
    /// Opens the topics of a robot with these sensors; daemon and controller may start later, and again.
    ///
    /// # Errors
    /// [`IpcError`].
    pub fn open(ipc: &Ipc, sensors: &[String]) -> Result<Self, IpcError> {
        let images: Vec<Topic> = sensors.iter().map(|sensor| Topic::energyscape(sensor)).collect();
        let heard = [
            Topic::health(),
            Topic::cues(),
            Topic::command(),
            Topic::platform(),
            Topic::scan(),
            Topic::obstacle(),
            Topic::objects(),
        ];
        let needs = heard.iter().chain(&images).fold(Needs::new(), Needs::subscriber);
        let (registration, (health, cues, command, platform, scan, obstacle, objects, energyscapes)) =
            ipc.set_up("noctule-view", needs, move |session| {
                let energyscapes: Result<Vec<_>, IpcError> =
                    images.iter().map(|topic| session.slice_subscriber(topic)).collect();
                Ok((
                    session.subscriber(&Topic::health())?,
                    session.subscriber(&Topic::cues())?,
                    session.subscriber(&Topic::command())?,
                    session.subscriber(&Topic::platform())?,
                    session.subscriber(&Topic::scan())?,
                    session.subscriber(&Topic::obstacle())?,
                    session.subscriber(&Topic::objects())?,
                    energyscapes?,
                ))
            })?;
        Ok(Self { health, cues, command, platform, scan, obstacle, objects, energyscapes, registration })
    }

    /// Whether the files of these topics are still those that were opened. Whoever publishes after they were taken away is not
    /// heard: open anew.
    #[must_use]
    pub fn is_intact(&self) -> bool {
        self.registration.lost().is_none()
    }

    /// The next health; to be called until `None`.
    #[must_use]
    pub fn next_health(&self) -> Option<Health> {
        self.health.next().map(|(health, _)| health).filter(WireType::schema_matches)
    }

    /// The next cues; to be called until `None`.
    #[must_use]
    pub fn next_cues(&self) -> Option<Cues> {
        self.cues.next().map(|(cues, _)| cues).filter(WireType::schema_matches)
    }

    /// The next command; to be called until `None`.
    #[must_use]
    pub fn next_command(&self) -> Option<VelocityCommand> {
        let sound = |command: &VelocityCommand| command.schema_matches() && command.checksum_matches();
        self.command.next().map(|(command, _)| command).filter(sound)
    }

    /// The next of what the controller told the platform; to be called until `None`, at least every 80 ms to see all.
    #[must_use]
    pub fn next_platform(&self) -> Option<PlatformVelocity> {
        self.platform.next().map(|(velocity, _)| velocity).filter(WireType::schema_matches)
    }

    /// The newest scan since the last call.
    #[must_use]
    pub fn scan(&self) -> Option<Scan> {
        self.scan.newest().filter(WireType::schema_matches)
    }

    /// The newest word about the planned way since the last call.
    #[must_use]
    pub fn obstacle(&self) -> Option<Obstacle> {
        self.obstacle.newest().filter(WireType::schema_matches)
    }

    /// The newest objects and map since the last call.
    #[must_use]
    pub fn objects(&self) -> Option<Objects> {
        self.objects.newest().filter(WireType::schema_matches)
    }

    /// Shows the newest energyscape of a sensor since the last call, in shared memory; `None` without one, for a sensor that
    /// is not there, and for a sample whose header does not describe it.
    pub fn energyscape<R>(&self, sensor_index: usize, read: impl FnOnce(&EnergyscapeHeader, &[f32]) -> R) -> Option<R> {
        self.energyscapes
            .get(sensor_index)?
            .next(|header, values| header.describes(values.len()).then(|| read(header, values)))?
    }
}
