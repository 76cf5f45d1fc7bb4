//! What daemon and controller tell of themselves, for whoever watches: `demo`, and tests.

use super::error::IpcError;
use super::node::{Ipc, Needs, Registration};
use super::ports::FixedSubscriber;
use super::topics::{self, Topic};
use super::wire::WireType;
use super::wire::message::{VelocityCommand, VelocityInput};
use super::wire::telemetry::{Cues, Health, PlatformVelocity};

/// Listens to `noctule/health`, `noctule/cues`, `noctule/command` and `noctule/platform`.
#[derive(Debug)]
pub struct StatusTopics {
    health: FixedSubscriber<Health>,
    cues: FixedSubscriber<Cues>,
    command: FixedSubscriber<VelocityCommand>,
    platform: FixedSubscriber<PlatformVelocity>,
    publishers: Vec<(String, Vec<u32>)>,
    _registration: Registration,
}

impl StatusTopics {
    /// Opens the topics; daemon and controller may start later.
    ///
    /// # Errors
    /// [`IpcError`].
    pub fn open(ipc: &Ipc) -> Result<Self, IpcError> {
        let heard = [Topic::health(), Topic::cues(), Topic::command(), Topic::platform(), Topic::input()];
        let needs = heard.iter().fold(Needs::new(), Needs::subscriber);
        let (registration, (publishers, health, cues, command, platform)) =
            ipc.set_up("noctule-status", needs, |session| {
                let publishers = vec![
                    (topics::COMMAND.to_owned(), session.publishers::<VelocityCommand>(&Topic::command())?),
                    (topics::PLATFORM.to_owned(), session.publishers::<PlatformVelocity>(&Topic::platform())?),
                    (topics::INPUT.to_owned(), session.publishers::<VelocityInput>(&Topic::input())?),
                ];
                Ok((
                    publishers,
                    session.subscriber(&Topic::health())?,
                    session.subscriber(&Topic::cues())?,
                    session.subscriber(&Topic::command())?,
                    session.subscriber(&Topic::platform())?,
                ))
            })?;
        Ok(Self { health, cues, command, platform, publishers, _registration: registration })
    }

    /// Processes that published on the topics that lead to motion, when these were opened.
    #[must_use]
    pub fn publishers(&self) -> &[(String, Vec<u32>)] {
        &self.publishers
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
