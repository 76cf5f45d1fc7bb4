//! From notes and slots to ROS messages on their topics.
//!
//! | topic | type |
//! |---|---|
//! | `/noctule/sonar/<name>/raw` | noctule_msgs/RawPing |
//! | `/noctule/sonar/<name>/energyscape` | sensor_msgs/Image, 32FC1: rows directions, columns ranges |
//! | `/noctule/sonar/<name>/energyscape_info` | noctule_msgs/EnergyscapeHeader: the axes |
//! | `/noctule/sonar/<name>/scan` | sensor_msgs/LaserScan |
//! | `/noctule/command`, `/noctule/cmd_vel` | noctule_msgs/VelocityCommand with its cause, geometry_msgs/TwistStamped |
//! | `/noctule/platform`, `/noctule/platform_vel` | noctule_msgs/PlatformVelocity, geometry_msgs/TwistStamped |
//! | `/noctule/cues`, `/input`, `/operator`, `/odometry`, `/health` | the topics' own types |
//! | `/noctule/scan`, `/noctule/laser_scan` | noctule_msgs/Scan, sensor_msgs/LaserScan of the whole robot |
//! | `/noctule/obstacle` | noctule_msgs/Obstacle |
//! | `/noctule/objects`, `/noctule/map` | noctule_msgs/Objects, nav_msgs/OccupancyGrid |
//! | `/noctule/ego_motion` | noctule_msgs/EgoMotion |
//! | `/noctule/points`, `/noctule/point_cloud` | noctule_msgs/PointCloud3, sensor_msgs/PointCloud2 |
//! | `/noctule/pipeline` | noctule_msgs/PipelineStep: what a replay repeats |
//! | `/diagnostics`, `/tf`, `/tf_static` | diagnostic_msgs/DiagnosticArray, tf2_msgs/TFMessage |
//!
//! A message is logged at the time when it was noted, so a sorted file keeps its order; its own stamp is the publish time.

use super::slots::{Note, Slot};
use super::volume::Volume;
use super::{RecordError, RecordOptions, RecordSubject, ScanMaker};
use crate::io::ros::{self, Header, Message, Octets, RawPingMessage, WireMessage};
use crate::io::wire::message::{RawHeader, format_number};
use crate::io::wire::{HEADER_VERSION, WireType};
use crate::sensor::{RecordingFormat, SensorSetup};
use crate::signal::{RangeScan, Samples};
use crate::time::{Clock, Stamp, SystemClock};
use std::sync::Arc;

/// Topic of what the pipeline was told.
pub(super) const PIPELINE: &str = "/noctule/pipeline";
/// Topic of commands.
pub(super) const COMMAND: &str = "/noctule/command";
/// Topic of wanted velocities.
pub(super) const INPUT: &str = "/noctule/input";
/// Topic of operators' requests.
pub(super) const OPERATOR: &str = "/noctule/operator";
/// Topic of pose and twist.
pub(super) const ODOMETRY: &str = "/noctule/odometry";

/// Writes messages.
pub(super) struct Scribe {
    volume: Volume,
    bytes: Vec<u8>,
    sensors: Vec<SensorSetup>,
    topics: Vec<SensorTopics>,
    format: RecordingFormat,
    period_s: f64,
    scanners: Vec<ScanMaker>,
    scans: Vec<RangeScan>,
    message_count: u64,
}

struct SensorTopics {
    raw: String,
    image: String,
    info: String,
    scan: String,
}

impl SensorTopics {
    fn new(sensor: &str) -> Self {
        let topic = |leaf: &str| ros::sonar_topic(sensor, leaf);
        Self { raw: topic("raw"), image: topic("energyscape"), info: topic("energyscape_info"), scan: topic("scan") }
    }
}

impl Scribe {
    pub fn start(options: &RecordOptions, subject: RecordSubject) -> Result<Self, RecordError> {
        let now = SystemClock.now();
        let scan = |index: usize| RangeScan::unseen(Arc::clone(&subject.grid), index);
        let mut scribe = Self {
            volume: Volume::create(options, subject.config_toml, now.wall_ns)?,
            bytes: Vec::new(),
            topics: subject.sensors.iter().map(|sensor| SensorTopics::new(&sensor.name)).collect(),
            scans: (0..subject.sensors.len()).map(scan).collect(),
            sensors: subject.sensors,
            format: subject.format,
            period_s: subject.period_s,
            scanners: subject.scanners,
            message_count: 0,
        };
        scribe.begin_part(now)?;
        Ok(scribe)
    }

    /// Every part says where the sensors stand.
    fn begin_part(&mut self, now: Stamp) -> Result<(), RecordError> {
        let mounts = ros::mount_transforms(&self.sensors, now);
        self.put(ros::MOUNTS_TOPIC, 0, now, now.wall_ns, &mounts)
    }

    /// Messages and bytes so far.
    pub fn written(&self) -> (u64, u64) {
        (self.message_count, self.volume.written())
    }

    pub fn flush(&mut self) -> Result<(), RecordError> {
        self.volume.flush()
    }

    pub fn finish(&mut self) -> Result<(), RecordError> {
        self.volume.finish()
    }

    /// Writes something small.
    pub fn note(&mut self, now: Stamp, note: &Note) -> Result<(), RecordError> {
        match note {
            Note::Step(step) => self.wire(PIPELINE, "", step.sequence, now, step.t_wall_ns, step)?,
            Note::Command(command) => {
                let sequence = command.sequence;
                self.wire(COMMAND, ros::BASE_FRAME, sequence, now, command.t_wall_ns, command)?;
                let twist = ros::command_twist(command);
                self.put(ros::COMMAND_TWIST_TOPIC, sequence, now, command.t_wall_ns, &twist)?;
            }
            Note::Cues(cues) => self.wire("/noctule/cues", "", cues.sequence, now, cues.t_wall_ns, cues)?,
            Note::Input(input) => {
                self.wire(INPUT, ros::BASE_FRAME, input.sequence, now, input.t_wall_ns, input)?;
            }
            Note::Operator(asked) => {
                self.wire(OPERATOR, "", asked.sequence, now, asked.t_wall_ns, asked)?;
            }
            Note::Odometry(odometry) => {
                let (sequence, at) = (odometry.sequence, odometry.t_wall_ns);
                self.wire(ODOMETRY, ros::ODOMETRY_FRAME, sequence, now, at, odometry)?;
                self.put("/tf", sequence, now, at, &ros::odometry_transform(odometry))?;
            }
            Note::Platform(platform) => {
                let (sequence, at) = (platform.sequence, platform.t_wall_ns);
                self.wire("/noctule/platform", ros::BASE_FRAME, sequence, now, at, platform)?;
                self.put(ros::PLATFORM_TWIST_TOPIC, sequence, now, at, &ros::platform_twist(platform))?;
            }
            Note::Health(health) => {
                self.wire("/noctule/health", "", health.ping_set_count, now, health.t_wall_ns, health)?;
                let diagnostics = ros::health_diagnostics(health);
                self.put(ros::DIAGNOSTICS_TOPIC, health.ping_set_count, now, health.t_wall_ns, &diagnostics)?;
            }
            Note::Scan(_) | Note::Obstacle(_) | Note::Objects(_) | Note::EgoMotion(_) | Note::Points(_) => {
                self.detection(now, note)?;
            }
        }
        self.next_part(now)
    }

    fn detection(&mut self, now: Stamp, note: &Note) -> Result<(), RecordError> {
        match note {
            Note::Scan(scan) => {
                let (sequence, at) = (scan.sequence, scan.t_wall_ns);
                self.wire("/noctule/scan", ros::BASE_FRAME, sequence, now, at, &**scan)?;
                self.put(ros::LASER_SCAN_TOPIC, sequence, now, at, &ros::robot_laser_scan(scan, self.period_s))
            }
            Note::Obstacle(obstacle) => {
                let (sequence, at) = (obstacle.sequence, obstacle.t_wall_ns);
                self.wire("/noctule/obstacle", ros::ODOMETRY_FRAME, sequence, now, at, &**obstacle)
            }
            Note::Objects(objects) => {
                let (sequence, at) = (objects.sequence, objects.t_wall_ns);
                self.wire("/noctule/objects", ros::objects_frame(objects), sequence, now, at, &**objects)?;
                self.put(ros::MAP_TOPIC, sequence, now, at, &ros::occupancy_grid(objects))
            }
            Note::EgoMotion(motion) => {
                let (sequence, at) = (motion.sequence, motion.t_wall_ns);
                self.wire("/noctule/ego_motion", ros::BASE_FRAME, sequence, now, at, &**motion)
            }
            Note::Points(points) => {
                let (sequence, at) = (points.sequence, points.t_wall_ns);
                self.wire("/noctule/points", ros::BASE_FRAME, sequence, now, at, &**points)?;
                self.put(ros::POINT_CLOUD_TOPIC, sequence, now, at, &ros::point_cloud(points))
            }
            _ => Ok(()),
        }
    }

    /// Writes a ping set: raw pings, what the pipeline was told, images, axes and scans.
    pub fn slot(&mut self, now: Stamp, slot: &mut Slot) -> Result<(), RecordError> {
        for index in (0..self.sensors.len()).filter(|index| slot.pings.present[*index]) {
            self.raw_ping(now, slot, index)?;
        }
        if let Some(step) = &slot.step {
            self.wire(PIPELINE, "", step.sequence, now, step.t_wall_ns, step)?;
        }
        for index in (0..self.sensors.len()).filter(|index| slot.imaged[*index]) {
            self.image(now, slot, index)?;
        }
        self.next_part(now)
    }

    fn raw_ping(&mut self, now: Stamp, slot: &Slot, index: usize) -> Result<(), RecordError> {
        let ping = &slot.pings.pings[index];
        let (channel_count, data): (usize, &[u8]) = match &*ping.samples {
            Samples::Pdm(words) => (self.sensors[index].array.channel_count(), bytemuck::cast_slice(words)),
            Samples::PcmI16(values) => (values.len() / self.format.samples.max(1), bytemuck::cast_slice(values)),
            Samples::PcmF32(values) => (values.len() / self.format.samples.max(1), bytemuck::cast_slice(values)),
        };
        let wire = RawHeader {
            version: HEADER_VERSION,
            sensor_index: index as u32,
            sequence: ping.sequence,
            t_monotonic_ns: ping.emitted_at.boottime_ns,
            t_wall_ns: ping.emitted_at.wall_ns,
            sample_rate_hz: self.format.sample_rate_hz,
            channel_count: channel_count as u32,
            sample_count: self.format.samples as u32,
            format: format_number(ping.samples.format()),
            ..RawHeader::blank()
        };
        let header = Header::new(wire.t_wall_ns, ros::sensor_frame(&self.sensors[index].name));
        let message = RawPingMessage { header, wire, data: Octets(data) };
        let topic = std::mem::take(&mut self.topics[index].raw);
        let put = self.put(&topic, ping.sequence, now, ping.emitted_at.wall_ns, &message);
        self.topics[index].raw = topic;
        put
    }

    fn image(&mut self, now: Stamp, slot: &Slot, index: usize) -> Result<(), RecordError> {
        let (image, header, name) = (&slot.images[index], &slot.headers[index], self.sensors[index].name.clone());
        let (sequence, at) = (image.sequence, image.emitted_at.wall_ns);
        let SensorTopics { image: image_topic, info, scan: scan_topic, .. } = &self.topics[index];
        let (image_topic, info, scan_topic) = (image_topic.clone(), info.clone(), scan_topic.clone());
        self.wire(&info, &ros::sensor_frame(&name), sequence, now, at, header)?;
        self.put(&image_topic, sequence, now, at, &ros::energyscape_image(header, &image.values, &name))?;
        if let Some(scanner) = self.scanners.get_mut(index) {
            scanner(image, &mut self.scans[index]);
            if let Some(scan) = ros::laser_scan(&self.scans[index], &name, self.period_s) {
                self.put(&scan_topic, sequence, now, at, &scan)?;
            }
        }
        Ok(())
    }

    fn wire<T: WireType>(
        &mut self,
        topic: &str,
        frame: &str,
        sequence: u64,
        now: Stamp,
        publish_ns: u64,
        wire: &T,
    ) -> Result<(), RecordError> {
        let message = WireMessage { header: Header::new(publish_ns, frame), wire: *wire };
        self.put(topic, sequence, now, publish_ns, &message)
    }

    fn put<M: Message>(
        &mut self,
        topic: &str,
        sequence: u64,
        now: Stamp,
        publish_ns: u64,
        message: &M,
    ) -> Result<(), RecordError> {
        if let Err(error) = ros::encode_into(message, &mut self.bytes) {
            log::warn!("{topic}: {error}");
            return Ok(());
        }
        self.message_count += 1;
        let schema = || (M::type_name(), M::schema());
        self.volume.file().write(topic, schema, sequence, [now.wall_ns, publish_ns], &self.bytes)
    }

    fn next_part(&mut self, now: Stamp) -> Result<(), RecordError> {
        if self.volume.split(now.wall_ns)? { self.begin_part(now) } else { Ok(()) }
    }
}
