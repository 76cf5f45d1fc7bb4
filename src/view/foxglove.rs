//! The Foxglove WebSocket protocol, for Foxglove and Lichtblick: our nouns as ROS 2 messages, live.
//!
//! Goes in: moments, and what a player subscribes to. Comes out: server info and channels at once, then for each subscription the
//! newest message whenever there is another; a slow player misses what came in between. Energyscapes, scans, twists, diagnostics
//! and mounts only: parameters, services and publishing are refused with a word.

use super::board::{Image, Moment, Seat};
use super::robot::Robot;
use super::server::Shared;
use crate::detect::range_scan::RangeScanner;
use crate::flow::NoiseFloor;
use crate::io::ros::{self, Message as RosMessage};
use crate::io::wire::message::FLAG_EQUAL_DIRECTIONS;
use crate::signal::{Energyscape, PolarGrid, RangeScan, SENSORS_MAX};
use crate::time::{Clock, Stamp, SystemClock};
use axum::extract::State;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::timeout;

/// Names of the protocol that players ask for.
const PROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
/// Players at a time.
const PLAYERS_MAX: usize = 4;
/// Subscriptions of one player.
const SUBSCRIPTIONS_MAX: usize = 64;
/// Longest word of a player.
const WORD_BYTES: usize = 64 * 1024;
/// Time for one message to leave: some hundred kilobytes.
const SEND_LIMIT: Duration = Duration::from_secs(5);
/// Opcode of message data.
const MESSAGE_DATA: u8 = 1;
/// Levels of a status.
const WARNING: u8 = 1;

/// What a channel carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Image(usize),
    Scan(usize),
    Command,
    Platform,
    Diagnostics,
    Mounts,
}

/// All channels of a robot; the number of one is its place plus 1.
fn kinds(robot: &Robot) -> Vec<Kind> {
    let sensors = 0..robot.sensors.len().min(SENSORS_MAX);
    let images = sensors.clone().map(Kind::Image);
    let fixed = [Kind::Command, Kind::Platform, Kind::Diagnostics, Kind::Mounts];
    images.chain(sensors.map(Kind::Scan)).chain(fixed).collect()
}

impl Kind {
    /// The topic, named as in a recording.
    fn topic(self, robot: &Robot) -> String {
        let sonar = |index: usize, leaf: &str| {
            let name = robot.sensors.get(index).map_or("", |sensor| sensor.name.as_str());
            ros::sonar_topic(name, leaf)
        };
        match self {
            Kind::Image(index) => sonar(index, "energyscape"),
            Kind::Scan(index) => sonar(index, "scan"),
            Kind::Command => ros::COMMAND_TWIST_TOPIC.to_owned(),
            Kind::Platform => ros::PLATFORM_TWIST_TOPIC.to_owned(),
            Kind::Diagnostics => ros::DIAGNOSTICS_TOPIC.to_owned(),
            Kind::Mounts => ros::MOUNTS_TOPIC.to_owned(),
        }
    }

    /// Name and text of its schema.
    fn schema(self) -> (String, String) {
        fn of<T: RosMessage>() -> (String, String) {
            (T::type_name(), T::schema())
        }
        match self {
            Kind::Image(_) => of::<ros::Image>(),
            Kind::Scan(_) => of::<ros::LaserScan>(),
            Kind::Command | Kind::Platform => of::<ros::TwistStamped>(),
            Kind::Diagnostics => of::<ros::DiagnosticArray>(),
            Kind::Mounts => of::<ros::TFMessage>(),
        }
    }

    /// What changes when there is another message of it; `None` while there is none.
    fn mark(self, moment: &Moment) -> Option<[u64; 2]> {
        match self {
            Kind::Image(index) | Kind::Scan(index) => {
                let image = moment.images.get(index)?.as_ref()?;
                image.values.as_ref().map(|_| [image.id, 0])
            }
            Kind::Command => moment.command.map(|command| [command.epoch, command.sequence]),
            Kind::Platform => moment.platform.map(|platform| [platform.t_monotonic_ns, platform.sequence]),
            Kind::Diagnostics => moment.health.map(|health| [health.epoch, health.t_monotonic_ns]),
            Kind::Mounts => Some([1, 0]),
        }
    }
}

/// The protocol's socket, at `/` and `/foxglove`.
pub(super) async fn player(
    State(shared): State<Arc<Shared>>,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Response {
    match upgrade {
        Ok(upgrade) => accept(shared, upgrade),
        Err(rejection) => rejection.into_response(),
    }
}

/// Takes a player that asks for one of the protocol's names.
pub(super) fn accept(shared: Arc<Shared>, upgrade: WebSocketUpgrade) -> Response {
    let upgrade = upgrade.protocols(PROTOCOLS);
    if upgrade.selected_protocol().is_none() {
        let allowed = PROTOCOLS.join(" or ");
        return (StatusCode::BAD_REQUEST, format!("this socket speaks the sub-protocol {allowed}\n")).into_response();
    }
    let Some(seat) = shared.audience.player(PLAYERS_MAX) else {
        return (StatusCode::SERVICE_UNAVAILABLE, format!("{PLAYERS_MAX} players are here already\n")).into_response();
    };
    let upgrade = upgrade.max_message_size(WORD_BYTES).max_frame_size(WORD_BYTES).write_buffer_size(0);
    upgrade.on_upgrade(move |socket| async move {
        let mut session = Session::new(socket, shared, seat);
        let _ = session.play().await;
    })
}

struct Subscription {
    id: u32,
    kind: Kind,
    sent: Option<[u64; 2]>,
}

struct Session {
    socket: WebSocket,
    shared: Arc<Shared>,
    kinds: Vec<Kind>,
    subscriptions: Vec<Subscription>,
    scanners: [Option<Scanner>; SENSORS_MAX],
    _seat: Seat,
}

impl Session {
    fn new(socket: WebSocket, shared: Arc<Shared>, seat: Seat) -> Self {
        let kinds = kinds(&shared.robot);
        Self { socket, shared, kinds, subscriptions: Vec::new(), scanners: Default::default(), _seat: seat }
    }

    /// Until the player goes, or does not take what it asked for. `None` when the connection is to be given up.
    async fn play(&mut self) -> Option<()> {
        let mut moments = self.shared.reader.moments.clone();
        self.introduce().await?;
        loop {
            tokio::select! {
                word = self.socket.recv() => match word?.ok()? {
                    Message::Text(word) => self.hear(word.as_str()).await?,
                    Message::Binary(_) => self.status("this server takes no messages and has no services").await?,
                    Message::Close(_) => return None,
                    Message::Ping(_) | Message::Pong(_) => {}
                },
                changed = moments.changed() => {
                    changed.ok()?;
                    let moment = Arc::clone(&moments.borrow_and_update());
                    self.tell(&moment).await?;
                }
            }
        }
    }

    async fn send(&mut self, message: Message) -> Option<()> {
        timeout(SEND_LIMIT, self.socket.send(message)).await.ok()?.ok()
    }

    async fn introduce(&mut self) -> Option<()> {
        let info = json!({
            "op": "serverInfo",
            "name": format!("noctule {}", env!("CARGO_PKG_VERSION")),
            "capabilities": [],
            "supportedEncodings": [],
            "metadata": {},
            "sessionId": self.shared.session.clone(),
        });
        self.send(Message::text(info.to_string())).await?;
        let channel = |(index, kind): (usize, &Kind)| {
            let (name, schema) = kind.schema();
            json!({
                "id": index + 1,
                "topic": kind.topic(&self.shared.robot),
                "encoding": ros::MESSAGE_ENCODING,
                "schemaName": name,
                "schema": schema,
                "schemaEncoding": ros::SCHEMA_ENCODING,
            })
        };
        let channels: Vec<Value> = self.kinds.iter().enumerate().map(channel).collect();
        self.send(Message::text(json!({ "op": "advertise", "channels": channels }).to_string())).await
    }

    async fn status(&mut self, message: &str) -> Option<()> {
        let status = json!({ "op": "status", "level": WARNING, "message": message });
        self.send(Message::text(status.to_string())).await
    }

    async fn hear(&mut self, word: &str) -> Option<()> {
        let Ok(word) = serde_json::from_str::<Value>(word) else {
            return self.status("this is no JSON").await;
        };
        match word["op"].as_str() {
            Some("subscribe") => {
                let asked = word["subscriptions"].as_array().cloned().unwrap_or_default();
                for subscription in &asked {
                    if let Err(why) = self.subscribe(subscription) {
                        self.status(&why).await?;
                    }
                }
                let moment = Arc::clone(&self.shared.reader.moments.borrow());
                self.tell(&moment).await
            }
            Some("unsubscribe") => {
                let gone = |id: u32| word["subscriptionIds"].as_array().is_some_and(|ids| ids.iter().any(|i| *i == id));
                self.subscriptions.retain(|subscription| !gone(subscription.id));
                Some(())
            }
            Some("unadvertise" | "unsubscribeParameterUpdates" | "unsubscribeConnectionGraph") => Some(()),
            Some(op) => {
                let why =
                    format!("{op}: this server only shows; it has no parameters and services and takes no messages");
                self.status(&why).await
            }
            None => self.status("a word without op").await,
        }
    }

    fn subscribe(&mut self, subscription: &Value) -> Result<(), String> {
        let number = |key: &str| subscription[key].as_u64().and_then(|number| u32::try_from(number).ok());
        let (Some(id), Some(channel)) = (number("id"), number("channelId")) else {
            return Err(format!("a subscription without id and channelId: {subscription}"));
        };
        if self.subscriptions.len() >= SUBSCRIPTIONS_MAX || self.subscriptions.iter().any(|had| had.id == id) {
            return Err(format!("subscription {id} exists already, or there are {SUBSCRIPTIONS_MAX}"));
        }
        let kind = (channel as usize).checked_sub(1).and_then(|index| self.kinds.get(index));
        let kind = *kind.ok_or_else(|| format!("there is no channel {channel}"))?;
        self.subscriptions.push(Subscription { id, kind, sent: None });
        Ok(())
    }

    /// For each subscription the newest message, if it has another one.
    async fn tell(&mut self, moment: &Moment) -> Option<()> {
        for index in 0..self.subscriptions.len() {
            let Subscription { id, kind, sent } = self.subscriptions[index];
            let mark = kind.mark(moment).filter(|mark| Some(*mark) != sent);
            let Some(mark) = mark else { continue };
            self.subscriptions[index].sent = Some(mark);
            for (wall_ns, payload) in self.encode(kind, moment) {
                let mut data = Vec::with_capacity(13 + payload.len());
                data.push(MESSAGE_DATA);
                data.extend(id.to_le_bytes());
                data.extend(wall_ns.to_le_bytes());
                data.extend(payload);
                self.send(Message::binary(data)).await?;
            }
        }
        Some(())
    }

    /// The messages of a kind in a moment, each with its time.
    fn encode(&mut self, kind: Kind, moment: &Moment) -> Vec<(u64, Vec<u8>)> {
        let robot = Arc::clone(&self.shared.robot);
        let image = |index: usize| moment.images.get(index).and_then(Option::as_ref);
        let name = |index: usize| robot.sensors.get(index).map_or("", |sensor| sensor.name.as_str());
        let mut found = Vec::new();
        match kind {
            Kind::Image(index) => {
                if let Some((image, values)) = image(index).and_then(|image| Some((image, image.values.as_ref()?))) {
                    let message = ros::energyscape_image(&image.header, values, name(index));
                    put(&mut found, image.header.t_wall_ns, &message);
                }
            }
            Kind::Scan(index) => {
                if let Some(image) = image(index)
                    && let Some(scanner) = self.scanners.get_mut(index)
                    && let Some(scan) = Scanner::scan(scanner, &robot, index, image)
                    && let Some(message) = ros::laser_scan(scan, name(index), robot.period_s)
                {
                    put(&mut found, image.header.t_wall_ns, &message);
                }
            }
            Kind::Command => moment
                .command
                .iter()
                .for_each(|command| put(&mut found, command.t_wall_ns, &ros::command_twist(command))),
            Kind::Platform => moment
                .platform
                .iter()
                .for_each(|platform| put(&mut found, platform.t_wall_ns, &ros::platform_twist(platform))),
            Kind::Diagnostics => {
                if let Some(health) = &moment.health {
                    put(&mut found, health.t_wall_ns, &ros::health_diagnostics(health));
                }
                if let Some(platform) = &moment.platform {
                    put(&mut found, platform.t_wall_ns, &ros::platform_diagnostics(platform));
                }
            }
            Kind::Mounts => {
                let now = SystemClock.now();
                put(&mut found, now.wall_ns, &ros::mount_transforms(&robot.setups, now));
            }
        }
        found
    }
}

fn put<T: RosMessage>(found: &mut Vec<(u64, Vec<u8>)>, wall_ns: u64, message: &T) {
    let mut bytes = Vec::new();
    // What does not fit into CDR, more than 4 GiB, was not sent by the daemon either.
    if ros::encode_into(message, &mut bytes).is_ok() {
        found.push((wall_ns, bytes));
    }
}

/// Nearest echo per direction, of one sensor.
struct Scanner {
    scanner: RangeScanner,
    image: Energyscape,
    scan: RangeScan,
}

impl Scanner {
    /// The scan of an image; `None` for a grid that a scan cannot tell.
    fn scan<'a>(place: &'a mut Option<Self>, robot: &Robot, index: usize, image: &Image) -> Option<&'a RangeScan> {
        let (header, values) = (&image.header, image.values.as_ref()?);
        let fits = |scanner: &Self| {
            let grid = &scanner.scan.grid;
            grid.cell_count() == values.len() && grid.range_count() == header.range_count as usize
        };
        if !place.as_ref().is_some_and(fits) {
            let fitting = header.flags & FLAG_EQUAL_DIRECTIONS != 0
                && robot.directions.len() == header.direction_count as usize
                && header.range_first_m >= 0.0
                && header.range_step_m > 0.0
                && header.range_count > 0;
            if !fitting {
                return None;
            }
            let directions = robot.directions.clone();
            let count = header.range_count as usize;
            let grid = Arc::new(PolarGrid::new(directions, header.range_first_m, header.range_step_m, count));
            let floor = NoiseFloor::configured(robot.energy.noise_floor_dbfs.clone());
            let hidden = &robot.sensors.get(index)?.hidden;
            let scanner = RangeScanner::new(&grid, hidden, |range_m| floor.at(range_m), robot.energy.side_lobe_share());
            let scan = RangeScan::unseen(Arc::clone(&grid), index);
            *place = Some(Self { scanner, image: Energyscape::zeros(grid, index), scan });
        }
        let Self { scanner, image: own, scan } = place.as_mut()?;
        own.values.copy_from_slice(values);
        own.sequence = header.sequence;
        own.emitted_at = Stamp { boottime_ns: header.t_monotonic_ns, wall_ns: header.t_wall_ns };
        scanner.scan(own, scan);
        Some(scan)
    }
}
