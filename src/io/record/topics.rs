//! What passes on the topics, for a recorder in a process of its own.
//!
//! In: the topics of a robot whose daemon, drivers and controller run elsewhere. Out: notes and slots. Raw pings are there only
//! where drivers publish them: those of a simulated source never leave the daemon. Of what a topic keeps one sample, the newest,
//! it must be asked every few milliseconds.

use super::slots::{Note, Tap};
use crate::io::error::IpcError;
use crate::io::node::{Ipc, Needs, Registration};
use crate::io::ports::{FixedSubscriber, SliceSubscriber};
use crate::io::raw_topics::{LiveTopics, RawShape};
use crate::io::topics::Topic;
use crate::io::wire::WireType;
use crate::io::wire::detections::{Objects, Obstacle, Scan};
use crate::io::wire::message::{EnergyscapeHeader, Odometry, OperatorRequest, VelocityCommand, VelocityInput};
use crate::io::wire::motion::EgoMotion;
use crate::io::wire::points::PointCloud3;
use crate::io::wire::telemetry::{Cues, Health, PlatformVelocity};
use crate::signal::{PingSet, SENSORS_MAX};
use crate::time::Stamp;

/// Open ears on everything.
pub struct RecordTopics {
    images: Vec<SliceSubscriber<f32, EnergyscapeHeader>>,
    command: FixedSubscriber<VelocityCommand>,
    platform: FixedSubscriber<PlatformVelocity>,
    health: FixedSubscriber<Health>,
    cues: FixedSubscriber<Cues>,
    input: FixedSubscriber<VelocityInput>,
    operator: FixedSubscriber<OperatorRequest>,
    odometry: FixedSubscriber<Odometry>,
    scan: FixedSubscriber<Scan>,
    obstacle: FixedSubscriber<Obstacle>,
    objects: FixedSubscriber<Objects>,
    ego_motion: FixedSubscriber<EgoMotion>,
    points: FixedSubscriber<PointCloud3>,
    raw: Option<LiveTopics>,
    pings: PingSet,
    refused: u64,
    _registration: Registration,
}

impl RecordTopics {
    /// Opens the topics of `sensors`; whoever publishes may come later. `pings` are buffers as the raw pings need them; without
    /// `raw` those are left alone.
    ///
    /// # Errors
    /// [`IpcError`].
    pub fn open(ipc: &Ipc, sensors: &[(String, RawShape)], pings: PingSet, raw: bool) -> Result<Self, IpcError> {
        let images: Vec<Topic> = sensors.iter().map(|(name, _)| Topic::energyscape(name)).collect();
        let small = [
            Topic::command(),
            Topic::platform(),
            Topic::health(),
            Topic::cues(),
            Topic::input(),
            Topic::operator(),
            Topic::odometry(),
            Topic::scan(),
            Topic::obstacle(),
            Topic::objects(),
            Topic::ego_motion(),
            Topic::points(),
        ];
        let needs = images.iter().chain(&small).fold(Needs::new(), Needs::subscriber);
        let raw = if raw { Some(LiveTopics::open(ipc, sensors)?) } else { None };
        let (registration, mut topics) = ipc.set_up("noctule-record", needs, move |session| {
            let images = images.iter().map(|topic| session.slice_subscriber(topic)).collect::<Result<_, _>>()?;
            Ok((
                images,
                session.subscriber(&Topic::command())?,
                session.subscriber(&Topic::platform())?,
                session.subscriber(&Topic::health())?,
                session.subscriber(&Topic::cues())?,
                session.subscriber(&Topic::input())?,
                session.subscriber(&Topic::operator())?,
                session.subscriber(&Topic::odometry())?,
                session.subscriber(&Topic::scan())?,
                session.subscriber(&Topic::obstacle())?,
                session.subscriber(&Topic::objects())?,
                session.subscriber(&Topic::ego_motion())?,
                session.subscriber(&Topic::points())?,
            ))
        })?;
        Ok(Self {
            images: std::mem::take(&mut topics.0),
            command: topics.1,
            platform: topics.2,
            health: topics.3,
            cues: topics.4,
            input: topics.5,
            operator: topics.6,
            odometry: topics.7,
            scan: topics.8,
            obstacle: topics.9,
            objects: topics.10,
            ego_motion: topics.11,
            points: topics.12,
            raw,
            pings,
            refused: 0,
            _registration: registration,
        })
    }

    /// Gives everything that waits to `tap`.
    pub fn poll(&mut self, now: Stamp, tap: &mut Tap) {
        if let Some(raw) = &self.raw {
            for index in 0..self.pings.pings.len() {
                while let Some(taken) = raw.poll(index, &mut self.pings.pings[index], now) {
                    match taken {
                        Ok(()) => {
                            let mut present = [false; SENSORS_MAX];
                            present[index] = true;
                            tap.ping_set(now, None, |slot, _| slot.copy_pings(&self.pings, present));
                        }
                        Err(refusal) => {
                            self.refused += 1;
                            if self.refused.is_power_of_two() {
                                log::warn!("raw ping not recorded: {refusal} ({} times)", self.refused);
                            }
                        }
                    }
                }
            }
        }
        for image in &self.images {
            let mut copy = |header: &EnergyscapeHeader, values: &[f32]| {
                if header.describes(values.len()) {
                    tap.ping_set(now, None, |slot, _| slot.copy_image(header, values));
                }
            };
            while image.next(&mut copy).is_some() {}
        }
        notes(&self.command, now, tap, Note::Command);
        notes(&self.platform, now, tap, Note::Platform);
        notes(&self.health, now, tap, Note::Health);
        notes(&self.cues, now, tap, Note::Cues);
        notes(&self.input, now, tap, Note::Input);
        notes(&self.operator, now, tap, Note::Operator);
        notes(&self.odometry, now, tap, Note::Odometry);
        notes(&self.scan, now, tap, |scan| Note::Scan(Box::new(scan)));
        notes(&self.obstacle, now, tap, |obstacle| Note::Obstacle(Box::new(obstacle)));
        notes(&self.objects, now, tap, |objects| Note::Objects(Box::new(objects)));
        notes(&self.ego_motion, now, tap, |motion| Note::EgoMotion(Box::new(motion)));
        notes(&self.points, now, tap, |points| Note::Points(Box::new(points)));
    }
}

fn notes<T>(port: &FixedSubscriber<T>, now: Stamp, tap: &mut Tap, note: impl Fn(T) -> Note)
where
    T: WireType + iceoryx2::prelude::ZeroCopySend + std::fmt::Debug,
{
    while let Some((sample, _)) = port.next() {
        if sample.schema_matches() {
            tap.note(now, note(sample));
        }
    }
}
