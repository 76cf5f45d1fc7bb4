//! The daemon's side of the topics: what it publishes and what it listens to. One daemon per root and prefix.
//!
//! Opening takes the lock, checks that shared memory suffices, opens every port and reserves every page; afterwards
//! nothing here allocates, and no call waits. Dropping it removes what it made.

use super::error::IpcError;
use super::node::{Ipc, Needs, Registration};
use super::ports::{FixedPublisher, FixedSubscriber, SlicePublisher};
use super::root::DaemonLock;
use super::topics::Topic;
use super::wire::message::{EnergyscapeHeader, Odometry, OperatorRequest, VelocityCommand, VelocityInput};
use super::wire::telemetry::{Cues, Health, PlatformVelocity};
use super::{fresh_id, wire::WireType};
use crate::time::Stamp;
use std::sync::{Arc, Mutex, PoisonError};

/// Room for the small topics' management files and for the connections of late subscribers.
const SPARE_BYTES: u64 = 4 * 1024 * 1024;

/// Everything that the daemon publishes and listens to.
#[derive(Debug)]
pub struct DaemonTopics {
    ports: Ports,
    command: Arc<CommandPort>,
    registration: Registration,
    lock: DaemonLock,
}

/// Where commands leave, one after the other, whichever thread speaks. The lock is held for one sending, some microseconds.
#[derive(Debug)]
struct CommandPort {
    port: FixedPublisher<VelocityCommand>,
    epoch: u64,
    publisher_id: u64,
    said: Mutex<Said>,
}

#[derive(Debug, Default)]
struct Said {
    sequence: u64,
    /// The last word was spoken: nothing but zero leaves from now on.
    over: bool,
}

impl CommandPort {
    fn publish(&self, command: VelocityCommand, now: Stamp, last: bool) -> Result<u64, IpcError> {
        let mut said = self.said.lock().unwrap_or_else(PoisonError::into_inner);
        said.over |= last;
        let stands = command.linear_m_s == 0.0 && command.angular_rad_s == 0.0;
        if said.over && !stands {
            return Ok(said.sequence);
        }
        said.sequence += 1;
        let command = VelocityCommand {
            schema_hash: VelocityCommand::SCHEMA_HASH,
            epoch: self.epoch,
            publisher_id: self.publisher_id,
            sequence: said.sequence,
            t_published_ns: now.boottime_ns,
            ..command
        };
        self.port.send(command.sealed())?;
        Ok(said.sequence)
    }
}

/// A second hand on the commands, for whoever watches the thread that publishes them.
#[derive(Debug, Clone)]
pub struct LastWord(Arc<CommandPort>);

impl LastWord {
    /// Publishes `command`; afterwards nothing but zero is published, whoever tries.
    ///
    /// # Errors
    /// [`IpcError::Send`].
    pub fn say(&self, command: VelocityCommand, now: Stamp) -> Result<u64, IpcError> {
        self.0.publish(command, now, true)
    }
}

#[derive(Debug)]
struct Ports {
    energyscapes: Vec<SlicePublisher<f32, EnergyscapeHeader>>,
    cues: FixedPublisher<Cues>,
    health: FixedPublisher<Health>,
    input: FixedSubscriber<VelocityInput>,
    operator: FixedSubscriber<OperatorRequest>,
    odometry: FixedSubscriber<Odometry>,
    platform: FixedSubscriber<PlatformVelocity>,
}

impl DaemonTopics {
    /// Shared memory that [`DaemonTopics::open`] needs, in bytes.
    #[must_use]
    pub fn needed_bytes(sensors: &[String], cell_counts: &[usize]) -> u64 {
        Self::needs(sensors, cell_counts).bytes()
    }

    /// Descriptors of open files that [`DaemonTopics::open`] needs.
    #[must_use]
    pub fn needed_descriptors(sensors: &[String], cell_counts: &[usize]) -> u64 {
        Self::needs(sensors, cell_counts).descriptors()
    }

    fn needs(sensors: &[String], cell_counts: &[usize]) -> Needs {
        let mut needs = Needs::new().spare(SPARE_BYTES);
        for (sensor, &cell_count) in sensors.iter().zip(cell_counts) {
            needs = needs.publisher(&Topic::energyscape(sensor), cell_count);
        }
        for topic in [Topic::cues(), Topic::command(), Topic::health()] {
            needs = needs.publisher(&topic, 1);
        }
        let heard = [Topic::input(), Topic::operator(), Topic::odometry(), Topic::platform()];
        heard.iter().fold(needs, Needs::subscriber)
    }

    /// Opens everything, for sensors named `sensors` whose energyscapes have `cell_counts` cells.
    ///
    /// # Errors
    /// [`IpcError`]: 69 another daemon or commander, 73 too little shared memory, 75 stuck, 77 not ours.
    pub fn open(ipc: &Ipc, sensors: &[String], cell_counts: &[usize]) -> Result<Self, IpcError> {
        let lock = ipc.lock_daemon()?;
        let needs = Self::needs(sensors, cell_counts);
        let images: Vec<(Topic, usize)> =
            sensors.iter().zip(cell_counts).map(|(sensor, &count)| (Topic::energyscape(sensor), count)).collect();
        let (registration, (port, ports)) = ipc.set_up("noctule-daemon", needs, move |session| {
            // First, so that a second commander is refused before anything else is there.
            let command = session.publisher(&Topic::command())?;
            let ports = Ports {
                energyscapes: images
                    .iter()
                    .map(|(topic, cell_count)| session.slice_publisher(topic, *cell_count))
                    .collect::<Result<_, _>>()?,
                cues: session.publisher(&Topic::cues())?,
                health: session.publisher(&Topic::health())?,
                input: session.subscriber(&Topic::input())?,
                operator: session.subscriber(&Topic::operator())?,
                odometry: session.subscriber(&Topic::odometry())?,
                platform: session.subscriber(&Topic::platform())?,
            };
            Ok((command, ports))
        })?;
        let (epoch, publisher_id) = (fresh_id(), fresh_id());
        let command = Arc::new(CommandPort { port, epoch, publisher_id, said: Mutex::default() });
        Ok(Self { ports, command, registration, lock })
    }

    /// Random number of this start of the daemon: what an arm request must carry.
    #[must_use]
    pub fn epoch(&self) -> u64 {
        self.command.epoch
    }

    /// A second hand on the commands.
    #[must_use]
    pub fn last_word(&self) -> LastWord {
        LastWord(Arc::clone(&self.command))
    }

    /// Whether root and shared memory still hold what was opened. False means that somebody removed it under us: stop, exit 75.
    #[must_use]
    pub fn is_intact(&self) -> bool {
        self.lock.is_ours() && self.registration.lost().is_none()
    }

    /// Publishes a sensor's energyscape, written straight into shared memory.
    ///
    /// # Errors
    /// [`IpcError::Send`] for an unknown sensor, more cells than were announced, or a failing transport.
    pub fn publish_energyscape(
        &self,
        sensor_index: usize,
        header: &EnergyscapeHeader,
        values: &[f32],
    ) -> Result<(), IpcError> {
        match self.ports.energyscapes.get(sensor_index) {
            Some(port) => port.send(header, values),
            None => Err(IpcError::Send {
                service: "noctule/sonar".to_owned(),
                reason: format!("there is no sensor {sensor_index}"),
            }),
        }
    }

    /// Gives subscribers that came since the last ping set the newest energyscapes. Publishing does it, too; this is for
    /// the time between, or when no pings come.
    ///
    /// # Errors
    /// [`IpcError::Send`].
    pub fn connect_latecomers(&self) -> Result<(), IpcError> {
        self.ports.energyscapes.iter().try_for_each(SlicePublisher::connect_latecomers)
    }

    /// Publishes cues.
    ///
    /// # Errors
    /// [`IpcError::Send`].
    pub fn publish_cues(&self, cues: Cues) -> Result<(), IpcError> {
        self.ports.cues.send(cues)
    }

    /// Publishes a command with this daemon's epoch, the next sequence number, the time and the checksum; returns the number.
    ///
    /// # Errors
    /// [`IpcError::Send`].
    pub fn publish_command(&mut self, command: VelocityCommand, now: Stamp) -> Result<u64, IpcError> {
        self.command.publish(command, now, false)
    }

    /// Publishes health, with this daemon's epoch.
    ///
    /// # Errors
    /// [`IpcError::Send`].
    pub fn publish_health(&self, health: Health) -> Result<(), IpcError> {
        self.ports.health.send(Health { epoch: self.command.epoch, ..health })
    }

    /// The newest wanted velocity of all senders that arrived since the last call; judge it by [`VelocityInput::wanted`].
    #[must_use]
    pub fn poll_input(&self) -> Option<VelocityInput> {
        let arrived = std::iter::from_fn(|| self.ports.input.next()).map(|(input, _)| input);
        arrived.filter(WireType::schema_matches).max_by_key(|input| input.t_monotonic_ns)
    }

    /// The next operator request; to be called until `None`.
    #[must_use]
    pub fn poll_operator(&self) -> Option<OperatorRequest> {
        self.ports.operator.next().map(|(request, _)| request)
    }

    /// The newest odometry that arrived since the last call.
    #[must_use]
    pub fn poll_odometry(&self) -> Option<Odometry> {
        self.ports.odometry.newest().filter(WireType::schema_matches)
    }

    /// The newest of what the controller commanded since the last call.
    #[must_use]
    pub fn poll_platform(&self) -> Option<PlatformVelocity> {
        self.ports.platform.newest().filter(WireType::schema_matches)
    }

    /// The next of what the controller commanded; to be called until `None`. Four are kept: to see every one, call it at
    /// least every 80 ms.
    #[must_use]
    pub fn next_platform(&self) -> Option<PlatformVelocity> {
        self.ports.platform.next().map(|(velocity, _)| velocity).filter(WireType::schema_matches)
    }
}
