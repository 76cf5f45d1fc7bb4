//! The other ends of the topics: the controller process, operators, planners, and whoever reads what the platform is told.
//!
//! Every client opens what it needs in one set-up and never waits for a peer, but for [`OperatorClient::request`], which
//! waits for the effect of a request within a limit.

use super::error::IpcError;
use super::fresh_id;
use super::node::{Ipc, Needs, Registration};
use super::ports::{FixedPublisher, FixedSubscriber};
use super::topics::{self, Topic};
use super::wire::message::{Odometry, OperatorRequest, Request, VelocityCommand, VelocityInput};
use super::wire::telemetry::PlatformVelocity;
use super::wire::{Checked, WireType};
use crate::geometry::Pose2;
use crate::signal::{DaemonState, GateState, Velocity};
use crate::time::{Clock, Stamp, SystemClock};
use std::time::{Duration, Instant};

/// Pause between two looks at what a request did.
const LOOK_PAUSE: Duration = Duration::from_millis(10);

/// What the controller process listens to and publishes.
#[derive(Debug)]
pub struct ControllerTopics {
    command: FixedSubscriber<VelocityCommand>,
    operator: FixedSubscriber<OperatorRequest>,
    requests: FixedPublisher<OperatorRequest>,
    platform: FixedPublisher<PlatformVelocity>,
    registration: Registration,
}

impl ControllerTopics {
    /// Opens everything. A second controller is refused: the platform has one.
    ///
    /// # Errors
    /// [`IpcError`]: 69 another controller, 73 too little shared memory, 75 stuck, 77 not ours.
    pub fn open(ipc: &Ipc) -> Result<Self, IpcError> {
        let needs = Needs::new().publisher(&Topic::platform(), 1).publisher(&Topic::operator(), 1);
        let needs = needs.subscriber(&Topic::command()).subscriber(&Topic::operator());
        let (registration, (platform, command, operator, requests)) =
            ipc.set_up("noctule-controller", needs, |session| {
                Ok((
                    session.publisher(&Topic::platform())?,
                    session.subscriber(&Topic::command())?,
                    session.subscriber(&Topic::operator())?,
                    session.publisher(&Topic::operator())?,
                ))
            })?;
        Ok(Self { command, operator, requests, platform, registration })
    }

    /// A file of these topics that somebody deleted under us, looked for anew at each call. Whoever comes after that cannot
    /// be heard: stop, exit 75.
    ///
    /// # Errors
    /// [`IpcError::TakenAway`] naming the file.
    pub fn check_intact(&self) -> Result<(), IpcError> {
        self.registration.lost().map_or(Ok(()), |path| Err(IpcError::TakenAway { path: path.to_owned() }))
    }

    /// The next command, with the transport's number of its publisher; to be called until `None`.
    #[must_use]
    pub fn next_command(&self) -> Option<(VelocityCommand, u128)> {
        self.command.next()
    }

    /// The next operator request; to be called until `None`. The controller's own come back, too.
    #[must_use]
    pub fn next_operator(&self) -> Option<OperatorRequest> {
        self.operator.next().map(|(request, _)| request)
    }

    /// Asks the daemon for something.
    ///
    /// # Errors
    /// [`IpcError::Send`].
    pub fn publish_operator(&self, request: OperatorRequest) -> Result<(), IpcError> {
        self.requests.send(request)
    }

    /// Publishes what the platform is to do.
    ///
    /// # Errors
    /// [`IpcError::Send`].
    pub fn publish_platform(&self, velocity: PlatformVelocity) -> Result<(), IpcError> {
        self.platform.send(velocity)
    }
}

/// Arms, stops and resets.
#[derive(Debug)]
pub struct OperatorClient {
    root: std::path::PathBuf,
    prefix: String,
    requests: FixedPublisher<OperatorRequest>,
    command: FixedSubscriber<VelocityCommand>,
    platform: FixedSubscriber<PlatformVelocity>,
    _registration: Registration,
}

/// What is known of the two processes.
#[derive(Debug, Clone, Copy, Default)]
struct Seen {
    command: Option<VelocityCommand>,
    platform: Option<PlatformVelocity>,
}

impl Seen {
    fn daemon_state(&self) -> Option<DaemonState> {
        self.command.and_then(|command| command.daemon_state())
    }

    fn gate_state(&self) -> Option<GateState> {
        self.platform.and_then(|platform| GateState::from_number(platform.state))
    }

    /// Whether `request` shows its effect.
    fn shows(&self, request: Request) -> bool {
        let moving = self.daemon_state().is_some_and(DaemonState::allows_motion);
        match request {
            Request::Arm => {
                let armed = self.command.zip(self.platform).is_some_and(|(c, p)| c.epoch == p.epoch);
                moving && armed
            }
            Request::Stop => self.gate_state() == Some(GateState::Latched) && !moving,
            Request::Reset => self.daemon_state().is_some_and(|state| state != DaemonState::Fault),
        }
    }

    fn describe(&self) -> String {
        let daemon = self.daemon_state().map_or("absent", DaemonState::as_str);
        let controller = self.gate_state().map_or("absent", GateState::as_str);
        format!("daemon {daemon}, controller {controller}")
    }
}

impl OperatorClient {
    /// Opens the topics that an operator needs.
    ///
    /// # Errors
    /// [`IpcError`].
    pub fn open(ipc: &Ipc) -> Result<Self, IpcError> {
        let needs = Needs::new().publisher(&Topic::operator(), 1);
        let needs = needs.subscriber(&Topic::command()).subscriber(&Topic::platform());
        let (registration, (requests, command, platform)) = ipc.set_up("noctule-operator", needs, |session| {
            Ok((
                session.publisher(&Topic::operator())?,
                session.subscriber(&Topic::command())?,
                session.subscriber(&Topic::platform())?,
            ))
        })?;
        let (root, prefix) = (ipc.root().to_owned(), ipc.prefix().to_owned());
        Ok(Self { root, prefix, requests, command, platform, _registration: registration })
    }

    /// Sends `request` once, without looking at its effect. `epoch` is read for arm only.
    ///
    /// # Errors
    /// [`IpcError::Send`].
    pub fn send(&self, request: Request, epoch: u64) -> Result<(), IpcError> {
        self.requests.send(OperatorRequest::new(request, epoch, fresh_id(), SystemClock.now()))
    }

    /// Sends `request` until its effect shows, at most for `limit`. The epoch to arm is learnt from the daemon's commands.
    /// Returns the states of daemon and controller in words.
    ///
    /// # Errors
    /// [`IpcError::NoPeer`] when no daemon speaks, [`IpcError::NoEffect`] naming the states when nothing changes.
    pub fn request(&self, request: Request, limit: Duration) -> Result<String, IpcError> {
        let deadline = Instant::now() + limit;
        let mut seen = Seen::default();
        let mut made: Option<OperatorRequest> = None;
        loop {
            self.look(&mut seen);
            if made.is_some() && seen.shows(request) {
                return Ok(seen.describe());
            }
            if Instant::now() >= deadline {
                break;
            }
            // A stop must not wait until somebody can be heard; only arming needs the daemon's epoch.
            let epoch = match request {
                Request::Arm => seen.command.map(|command| command.epoch),
                Request::Stop | Request::Reset => Some(0),
            };
            if made.is_none() {
                made = epoch.map(|epoch| OperatorRequest::new(request, epoch, fresh_id(), SystemClock.now()));
            }
            if let Some(made) = made {
                // Copies of one request are one request: receivers judge it by the time it was made.
                self.requests.send(made)?;
            }
            std::thread::sleep(LOOK_PAUSE);
        }
        if seen.command.is_none() && seen.platform.is_none() {
            let service = topics::COMMAND.to_owned();
            return Err(IpcError::NoPeer { service, root: self.root.clone(), prefix: self.prefix.clone() });
        }
        Err(IpcError::NoEffect(format!("{} had no effect: {}", request.as_str(), seen.describe())))
    }

    fn look(&self, seen: &mut Seen) {
        let sound = |command: &VelocityCommand| command.schema_matches() && command.checksum_matches();
        seen.command = self.command.newest().filter(sound).or(seen.command);
        seen.platform = self.platform.newest().filter(WireType::schema_matches).or(seen.platform);
    }
}

/// Reads what the controller really commands: a platform driver's or a simulated robot's end.
#[derive(Debug)]
pub struct PlatformSubscriber {
    port: FixedSubscriber<PlatformVelocity>,
    _registration: Registration,
}

impl PlatformSubscriber {
    /// Opens `noctule/platform`.
    ///
    /// # Errors
    /// [`IpcError`].
    pub fn open(ipc: &Ipc) -> Result<Self, IpcError> {
        let (registration, port) =
            ipc.set_up("noctule-platform", Needs::new().subscriber(&Topic::platform()), |session| {
                session.subscriber(&Topic::platform())
            })?;
        Ok(Self { port, _registration: registration })
    }

    /// The newest that arrived since the last call. A platform that hears nothing for 250 ms stops by itself.
    #[must_use]
    pub fn newest(&self) -> Option<PlatformVelocity> {
        self.port.newest().filter(WireType::schema_matches)
    }

    /// The next; to be called until `None`. Four are kept.
    #[must_use]
    pub fn next_velocity(&self) -> Option<PlatformVelocity> {
        self.port.next().map(|(velocity, _)| velocity).filter(WireType::schema_matches)
    }
}

/// Publishes a wanted velocity and odometry: a planner's or a platform's end.
#[derive(Debug)]
pub struct InputPublisher {
    input: FixedPublisher<VelocityInput>,
    odometry: Option<FixedPublisher<Odometry>>,
    sequence: u64,
    _registration: Registration,
}

impl InputPublisher {
    /// Opens `noctule/input`, and `noctule/odometry` if wanted (it takes one publisher).
    ///
    /// # Errors
    /// [`IpcError`].
    pub fn open(ipc: &Ipc, with_odometry: bool) -> Result<Self, IpcError> {
        let needs = Needs::new().publisher(&Topic::input(), 1);
        let needs = if with_odometry { needs.publisher(&Topic::odometry(), 1) } else { needs };
        let (registration, (input, odometry)) = ipc.set_up("noctule-input", needs, move |session| {
            let input = session.publisher(&Topic::input())?;
            let odometry = if with_odometry { Some(session.publisher(&Topic::odometry())?) } else { None };
            Ok((input, odometry))
        })?;
        Ok(Self { input, odometry, sequence: 0, _registration: registration })
    }

    /// Wants `velocity` from now on, for 500 ms.
    ///
    /// # Errors
    /// [`IpcError::Send`].
    pub fn want(&mut self, velocity: Velocity, now: Stamp) -> Result<(), IpcError> {
        self.sequence += 1;
        self.input.send(VelocityInput::new(self.sequence, now, velocity))
    }

    /// Tells pose and twist at `at`.
    ///
    /// # Errors
    /// [`IpcError::Send`]; also when odometry was not opened.
    pub fn tell(&mut self, pose: Pose2, twist: Velocity, at: Stamp) -> Result<(), IpcError> {
        let Some(odometry) = &self.odometry else {
            return Err(IpcError::Send {
                service: topics::ODOMETRY.to_owned(),
                reason: "it was not opened".to_owned(),
            });
        };
        self.sequence += 1;
        odometry.send(Odometry::new(self.sequence, at, pose, twist))
    }
}
