//! Every topic: its name, what lies on it, who may be how many, and how deep it queues. The one place that names topics.
//!
//! Out of the same table come the services that are opened ([`super::node`]), `noctule topics` and the memory needed. Opens nothing.

use super::params::IpcParams;
use super::wire::detections::{Objects, Obstacle, Scan};
use super::wire::message::{
    EnergyscapeHeader, Odometry, OperatorRequest, RawHeader, VelocityCommand, VelocityInput, format_name,
};
use super::wire::motion::EgoMotion;
use super::wire::telemetry::{Cues, Health, PlatformVelocity};
use super::wire::{Field, Primitive, WireType};
use crate::signal::SampleFormat;
use serde_json::{Value, json};
use std::fmt::Write as _;

/// Velocity commands, daemon to controller.
pub const COMMAND: &str = "noctule/command";
/// Wanted velocity, planner or operator to daemon.
pub const INPUT: &str = "noctule/input";
/// Arm, stop, reset, operator to daemon and controller.
pub const OPERATOR: &str = "noctule/operator";
/// Pose and twist, platform to daemon.
pub const ODOMETRY: &str = "noctule/odometry";
/// What the controller really commands.
pub const PLATFORM: &str = "noctule/platform";
/// The sums behind the decisions.
pub const CUES: &str = "noctule/cues";
/// The range scan of the whole robot.
pub const SCAN: &str = "noctule/scan";
/// What stands on the planned way.
pub const OBSTACLE: &str = "noctule/obstacle";
/// Objects around the robot and the map of them.
pub const OBJECTS: &str = "noctule/objects";
/// How the robot moves by its echoes, and what moves beside it.
pub const EGO_MOTION: &str = "noctule/ego_motion";
/// The points in space that the echoes came from.
pub const POINTS: &str = "noctule/points";
/// How the daemon is.
pub const HEALTH: &str = "noctule/health";
/// Attribute of every service: the schema hash of its payload, or of its header where it has one, in 16 hex digits.
pub const SCHEMA_ATTRIBUTE: &str = "noctule.schema";

/// What the names of copies for other machines begin with, instead of `noctule/`.
const RELAYED: &str = "noctule/relay/";

/// Nodes that may open a service: the daemon, the controller and some thirty tools.
const NODES_MAX: usize = 32;
/// And one of a copy for other machines: the transport's default there.
const RELAYED_NODES_MAX: usize = 20;
/// Size of the transport's own header of a sample, with room for its growth.
const TRANSPORT_HEADER_BYTES: usize = 64;
/// Management data of a publisher's memory, and of its connections, per sample of its pool.
const POOL_ENTRY_BYTES: usize = 64;
/// Shared memory is taken by the page.
const PAGE_BYTES: usize = 4096;
/// Fixed part of a service's and a publisher's management files.
const SERVICE_BYTES: usize = 48 * 1024;

/// Name of a sensor's raw topic.
#[must_use]
pub fn raw(sensor: &str, format: SampleFormat) -> String {
    let leaf = match format {
        SampleFormat::Pdm => "pdm",
        SampleFormat::PcmI16 => "pcm",
        SampleFormat::PcmF32 => "pcm_f32",
    };
    format!("noctule/sonar/{sensor}/{leaf}")
}

/// Name of a sensor's energyscape topic.
#[must_use]
pub fn energyscape(sensor: &str) -> String {
    format!("noctule/sonar/{sensor}/energyscape")
}

/// How many may take part, and how much is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Qos {
    /// Publishers at a time.
    pub publishers_max: usize,
    /// Subscribers at a time.
    pub subscribers_max: usize,
    /// Samples kept for each subscriber; the oldest is dropped for a newer one, so a publisher never waits.
    pub buffer: usize,
    /// Samples that a subscriber may hold at a time.
    pub borrowed: usize,
    /// Samples that a late subscriber gets at once.
    pub history: usize,
}

/// Only the newest counts, from one publisher; nothing old for latecomers.
const NEWEST: Qos = Qos { publishers_max: 1, subscribers_max: 8, buffer: 1, borrowed: 1, history: 0 };
/// As [`NEWEST`], with two samples held, for readers that take the next before they let go of the last.
const REPORT: Qos = Qos { borrowed: 2, buffer: 4, ..NEWEST };
/// Several may ask; nothing asked for shall be lost.
const REQUESTS: Qos = Qos { publishers_max: 8, subscribers_max: 8, buffer: 8, borrowed: 1, history: 0 };
/// Large; a latecomer gets the newest at once. One of the subscribers is the daemon's own, for the detectors.
const IMAGE: Qos = Qos { publishers_max: 1, subscribers_max: 7, buffer: 1, borrowed: 2, history: 1 };
/// Large; two emissions may wait.
const RAW: Qos = Qos { publishers_max: 1, subscribers_max: 4, buffer: 2, borrowed: 1, history: 0 };

/// What a type looks like in memory.
#[derive(Debug, Clone, Copy)]
pub struct Layout {
    /// Name under which every language knows it.
    pub type_name: &'static str,
    /// Size in bytes; of one element for a slice.
    pub size: usize,
    /// Alignment in bytes.
    pub alignment: usize,
    /// Whether a sample holds any number of them.
    pub slice: bool,
    /// Its fields; none for a primitive.
    pub fields: &'static [Field],
    /// Its schema hash; none for a primitive.
    pub schema_hash: Option<u64>,
}

impl Layout {
    fn of<T: WireType>() -> Self {
        Self {
            type_name: T::TYPE_NAME,
            size: size_of::<T>(),
            alignment: align_of::<T>(),
            slice: false,
            fields: T::FIELDS,
            schema_hash: Some(T::SCHEMA_HASH),
        }
    }

    const fn slice(primitive: Primitive) -> Self {
        Self {
            type_name: primitive.name(),
            size: primitive.size(),
            alignment: primitive.size(),
            slice: true,
            fields: &[],
            schema_hash: None,
        }
    }

    fn json(&self) -> Value {
        let fields: Vec<Value> = self.fields.iter().map(field_json).collect();
        let mut layout =
            json!({ "type_name": self.type_name, "size": self.size, "alignment": self.alignment, "fields": fields });
        if let Some(hash) = self.schema_hash {
            layout["schema_hash"] = json!(hash);
        }
        layout
    }
}

fn field_json(field: &Field) -> Value {
    let mut described = json!({
        "name": field.name,
        "offset": field.offset,
        "type": field.primitive.name(),
        "count": field.count,
        "doc": field.doc,
    });
    if let Some(name) = field.value_name {
        described["values"] = (0..=u32::from(u8::MAX))
            .filter_map(|number| Some((number.to_string(), Value::from(name(number)?))))
            .collect();
    }
    described
}

/// One topic.
#[derive(Debug, Clone)]
pub struct Topic {
    /// Name of the service.
    pub name: String,
    /// Payload.
    pub payload: Layout,
    /// Header, where the payload is a slice.
    pub header: Option<Layout>,
    /// How many and how much.
    pub qos: Qos,
    /// From whom to whom.
    pub route: &'static str,
}

impl Topic {
    fn fixed<T: WireType>(name: &str, qos: Qos, route: &'static str) -> Self {
        Self { name: name.to_owned(), payload: Layout::of::<T>(), header: None, qos, route }
    }

    /// `noctule/command`.
    #[must_use]
    pub fn command() -> Self {
        Self::fixed::<VelocityCommand>(COMMAND, NEWEST, "daemon to controller")
    }

    /// `noctule/input`.
    #[must_use]
    pub fn input() -> Self {
        Self::fixed::<VelocityInput>(INPUT, Qos { publishers_max: 4, ..NEWEST }, "planner or operator to daemon")
    }

    /// `noctule/operator`.
    #[must_use]
    pub fn operator() -> Self {
        Self::fixed::<OperatorRequest>(OPERATOR, REQUESTS, "operator to daemon and controller")
    }

    /// `noctule/odometry`.
    #[must_use]
    pub fn odometry() -> Self {
        Self::fixed::<Odometry>(ODOMETRY, REPORT, "platform to daemon")
    }

    /// `noctule/platform`.
    #[must_use]
    pub fn platform() -> Self {
        Self::fixed::<PlatformVelocity>(PLATFORM, REPORT, "controller to platform, anybody")
    }

    /// `noctule/cues`.
    #[must_use]
    pub fn cues() -> Self {
        Self::fixed::<Cues>(CUES, REPORT, "daemon to anybody")
    }

    /// `noctule/scan`.
    #[must_use]
    pub fn scan() -> Self {
        Self::fixed::<Scan>(SCAN, NEWEST, "daemon to anybody")
    }

    /// `noctule/obstacle`.
    #[must_use]
    pub fn obstacle() -> Self {
        Self::fixed::<Obstacle>(OBSTACLE, NEWEST, "daemon to anybody")
    }

    /// `noctule/objects`.
    #[must_use]
    pub fn objects() -> Self {
        Self::fixed::<Objects>(OBJECTS, NEWEST, "daemon to anybody")
    }

    /// `noctule/ego_motion`.
    #[must_use]
    pub fn ego_motion() -> Self {
        Self::fixed::<EgoMotion>(EGO_MOTION, NEWEST, "daemon to anybody")
    }

    /// `noctule/points`.
    #[must_use]
    pub fn points() -> Self {
        Self::fixed::<super::wire::points::PointCloud3>(POINTS, NEWEST, "daemon to anybody")
    }

    /// `noctule/health`.
    #[must_use]
    pub fn health() -> Self {
        Self::fixed::<Health>(HEALTH, REPORT, "daemon to anybody")
    }

    /// A sensor's energyscapes.
    #[must_use]
    pub fn energyscape(sensor: &str) -> Self {
        Self {
            name: energyscape(sensor),
            payload: Layout::slice(Primitive::F32),
            header: Some(Layout::of::<EnergyscapeHeader>()),
            qos: IMAGE,
            route: "daemon to anybody",
        }
    }

    /// A sensor's raw pings.
    #[must_use]
    pub fn raw(sensor: &str, format: SampleFormat) -> Self {
        let element = match format {
            SampleFormat::Pdm => Primitive::U32,
            SampleFormat::PcmI16 => Primitive::I16,
            SampleFormat::PcmF32 => Primitive::F32,
        };
        Self {
            name: raw(sensor, format),
            payload: Layout::slice(element),
            header: Some(Layout::of::<RawHeader>()),
            qos: RAW,
            route: "driver or simulator to daemon",
        }
    }

    /// All topics of a robot with these sensors and this raw format, in the order of the signal path.
    #[must_use]
    pub fn all(sensors: &[String], format: SampleFormat) -> Vec<Topic> {
        let mut topics: Vec<Topic> = sensors.iter().map(|sensor| Topic::raw(sensor, format)).collect();
        topics.extend(sensors.iter().map(|sensor| Topic::energyscape(sensor)));
        topics.extend([
            Topic::cues(),
            Topic::command(),
            Topic::input(),
            Topic::operator(),
            Topic::odometry(),
            Topic::platform(),
            Topic::scan(),
            Topic::obstacle(),
            Topic::objects(),
            Topic::ego_motion(),
            Topic::points(),
            Topic::health(),
        ]);
        topics
    }

    /// The copy of this topic that is made for other machines ([`super::relay`]): room for a second publisher, the link's own.
    #[must_use]
    pub fn relayed(&self) -> Self {
        let name = self.name.replacen("noctule/", RELAYED, 1);
        // On the other machine the link makes the service with the transport's default limits: none here may be larger.
        let qos = Qos { publishers_max: 2, buffer: self.qos.buffer.min(2), history: 0, ..self.qos };
        Self { name, qos, route: "noctule relay to other machines", ..self.clone() }
    }

    /// The topic that a copy is of; its own name for all others.
    #[must_use]
    pub fn original_name(&self) -> String {
        self.name.replacen(RELAYED, "noctule/", 1)
    }

    /// Whether its services carry the schema hash as an attribute. Those that the link makes on another machine carry none; the hash in
    /// every sample stays.
    #[must_use]
    pub fn is_attributed(&self) -> bool {
        !self.name.starts_with(RELAYED)
    }

    /// Nodes that may open its service.
    #[must_use]
    pub(super) fn nodes_max(&self) -> usize {
        if self.is_attributed() { NODES_MAX } else { RELAYED_NODES_MAX }
    }

    /// The copies that [`super::relay`] makes.
    #[must_use]
    pub fn all_relayed(sensors: &[String]) -> Vec<Topic> {
        let images = sensors.iter().map(|sensor| Topic::energyscape(sensor));
        let all = images.chain([Topic::cues(), Topic::command(), Topic::platform(), Topic::health()]);
        all.map(|topic| topic.relayed()).collect()
    }

    /// The hash that stands in the service's attributes: of the header, else of the payload.
    #[must_use]
    pub fn schema_hash(&self) -> u64 {
        self.header.and_then(|header| header.schema_hash).or(self.payload.schema_hash).unwrap_or(0)
    }

    /// Samples that one publisher's memory holds.
    #[must_use]
    pub fn pool(&self) -> usize {
        self.qos.subscribers_max * (self.qos.buffer + self.qos.borrowed) + self.qos.history + 1
    }

    /// Upper bound of the shared memory that a publisher reserves, with samples of up to `len` elements.
    #[must_use]
    pub fn publisher_bytes(&self, len: usize) -> u64 {
        let header = self.header.map_or(0, |header| header.size + header.alignment);
        let sample = TRANSPORT_HEADER_BYTES + header + self.payload.size * len + self.payload.alignment;
        (self.pool() * (sample + POOL_ENTRY_BYTES) + SERVICE_BYTES) as u64
    }

    /// Upper bound of the shared memory that a subscriber's service and connections take, in whole pages.
    #[must_use]
    pub fn subscriber_bytes(&self) -> u64 {
        let connection = POOL_ENTRY_BYTES * (self.qos.buffer + self.qos.borrowed + self.pool()) + PAGE_BYTES;
        (2 * PAGE_BYTES + self.qos.publishers_max * connection.next_multiple_of(PAGE_BYTES)) as u64
    }

    fn json(&self) -> Value {
        let mut payload = self.payload.json();
        payload["slice"] = json!(self.payload.slice);
        json!({
            "name": self.name,
            "payload": payload,
            "header": self.header.map(|header| header.json()),
            "route": self.route,
        })
    }
}

/// What `noctule topics --json` writes.
#[must_use]
pub fn topics_json(params: &IpcParams, sensors: &[String], format: SampleFormat) -> Value {
    listed_json(params, &Topic::all(sensors, format), format)
}

/// The same of the copies that `noctule relay` makes: what a client on another machine needs.
#[must_use]
pub fn relayed_json(params: &IpcParams, sensors: &[String], format: SampleFormat) -> Value {
    listed_json(params, &Topic::all_relayed(sensors), format)
}

fn listed_json(params: &IpcParams, topics: &[Topic], format: SampleFormat) -> Value {
    json!({
        "root": params.root_path(),
        "prefix": params.prefix,
        "schema_attribute": SCHEMA_ATTRIBUTE,
        "raw_format": format_name(super::wire::message::format_number(format)),
        "services": topics.iter().map(Topic::json).collect::<Vec<_>>(),
    })
}

/// The types on these topics, each once, by name.
#[must_use]
pub fn layouts(topics: &[Topic]) -> Vec<Layout> {
    let all = topics.iter().flat_map(|topic| [topic.header, Some(topic.payload)]).flatten();
    let mut layouts: Vec<Layout> = all.filter(|layout| !layout.slice).collect();
    layouts.sort_by_key(|layout| layout.type_name);
    layouts.dedup_by_key(|layout| layout.type_name);
    layouts
}

/// What `noctule topics` writes for people: every service, then every type with its fields.
#[must_use]
pub fn topics_table(params: &IpcParams, sensors: &[String], format: SampleFormat) -> String {
    let topics = Topic::all(sensors, format);
    let mut text = format!("root    {}\nprefix  {}\n\n", params.root_path().display(), params.prefix);
    let width = topics.iter().map(|topic| topic.name.len()).max().unwrap_or(0);
    for topic in &topics {
        let payload = match topic.payload.slice {
            true => format!("[{}]", topic.payload.type_name),
            false => topic.payload.type_name.to_owned(),
        };
        let header = topic.header.map_or(String::new(), |header| format!(", header {}", header.type_name));
        let _ = writeln!(text, "{:width$}  {payload}{header}; {}", topic.name, topic.route);
    }
    for layout in layouts(&topics) {
        let hash = layout.schema_hash.unwrap_or(0);
        let _ = writeln!(
            text,
            "\n{}  ({} bytes, alignment {}, schema {hash:016x})\n  offset  type      field",
            layout.type_name, layout.size, layout.alignment
        );
        for field in layout.fields {
            let kind = match field.count {
                1 => field.primitive.name().to_owned(),
                count => format!("[{}; {count}]", field.primitive.name()),
            };
            let _ = writeln!(text, "  {:>6}  {kind:8}  {}: {}", field.offset, field.name, field.doc);
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sensors() -> Vec<String> {
        vec!["front".to_owned(), "left".to_owned()]
    }

    #[test]
    fn the_services_are_those_of_the_specification() {
        let names: Vec<String> =
            Topic::all(&sensors(), SampleFormat::PcmI16).into_iter().map(|topic| topic.name).collect();
        let expected = "sonar/front/pcm sonar/left/pcm sonar/front/energyscape sonar/left/energyscape cues command input operator \
                        odometry platform scan obstacle objects ego_motion points health";
        let expected: Vec<String> = expected.split(' ').map(|leaf| format!("noctule/{leaf}")).collect();
        assert_eq!(names, expected);
        assert_eq!(raw("x", SampleFormat::Pdm), "noctule/sonar/x/pdm");
        assert_eq!(raw("x", SampleFormat::PcmF32), "noctule/sonar/x/pcm_f32");
    }

    #[test]
    fn one_commander_and_no_old_command() {
        let Qos { publishers_max, buffer, history, subscribers_max, .. } = Topic::command().qos;
        assert_eq!((publishers_max, buffer, history, subscribers_max), (1, 1, 0, 8));
        assert_eq!(Topic::energyscape("front").qos.history, 1);
        assert_eq!(Topic::platform().qos.publishers_max, 1);
    }

    #[test]
    fn the_table_tells_every_field_and_the_json_its_offset() {
        let params = IpcParams::default();
        let table = topics_table(&params, &sensors(), SampleFormat::Pdm);
        let json = topics_json(&params, &sensors(), SampleFormat::Pdm);
        for service in json["services"].as_array().expect("services") {
            assert!(table.contains(service["name"].as_str().expect("name")));
            for part in [&service["payload"], &service["header"]] {
                for field in part["fields"].as_array().into_iter().flatten() {
                    assert!(field["offset"].is_u64() && field["count"].is_u64(), "{field}");
                    assert!(table.contains(&format!("{}: ", field["name"].as_str().expect("name"))));
                }
            }
        }
        let command = &json["services"].as_array().expect("services")[5];
        assert_eq!(command["name"], COMMAND);
        assert_eq!(command["header"], Value::Null);
        let state = command["payload"]["fields"].as_array().expect("fields").iter().find(|f| f["name"] == "state");
        assert_eq!(state.expect("there")["values"]["3"], "ACTIVE");
    }
}
