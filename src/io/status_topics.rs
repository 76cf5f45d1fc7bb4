//! What daemon and controller tell of themselves, for whoever watches: `demo`, and tests.

use super::error::IpcError;
use super::node::{Ipc, Needs, Registration};
use super::ports::FixedSubscriber;
use super::topics::Topic;
use super::wire::WireType;
use super::wire::message::VelocityCommand;
use super::wire::telemetry::{Cues, Health, PlatformVelocity};

/// Listens to `noctule/health`, `noctule/cues`, `noctule/command` and `noctule/platform`.
#[derive(Debug)]
pub struct StatusTopics {
    health: FixedSubscriber<Health>,
    cues: FixedSubscriber<Cues>,
    command: FixedSubscriber<VelocityCommand>,
    platform: FixedSubscriber<PlatformVelocity>,
    _registration: Registration,
}

impl StatusTopics {
    /// Opens the topics; daemon and controller may start later.
    ///
    /// # Errors
    /// [`IpcError`].
    pub fn open(ipc: &Ipc) -> Result<Self, IpcError> {
        let heard = [Topic::health(), Topic::cues(), Topic::command(), Topic::platform()];
        let needs = heard.iter().fold(Needs::new(), Needs::subscriber);
        let (registration, (health, cues, command, platform)) = ipc.set_up("noctule-status", needs, |session| {
            Ok((
                session.subscriber(&Topic::health())?,
                session.subscriber(&Topic::cues())?,
                session.subscriber(&Topic::command())?,
                session.subscriber(&Topic::platform())?,
            ))
        })?;
        Ok(Self { health, cues, command, platform, _registration: registration })
    }

    /// The newest health since the last call.
    #[must_use]
    pub fn health(&self) -> Option<Health> {
        self.health.newest().filter(WireType::schema_matches)
    }

    /// The newest cues since the last call.
    #[must_use]
    pub fn cues(&self) -> Option<Cues> {
        self.cues.newest().filter(WireType::schema_matches)
    }

    /// The newest command since the last call.
    #[must_use]
    pub fn command(&self) -> Option<VelocityCommand> {
        self.command.newest().filter(WireType::schema_matches)
    }

    /// The next of what the controller told the platform; to be called until `None`, at least every 80 ms to see all.
    #[must_use]
    pub fn next_platform(&self) -> Option<PlatformVelocity> {
        self.platform.next().map(|(velocity, _)| velocity).filter(WireType::schema_matches)
    }
}
