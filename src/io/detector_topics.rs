//! The detectors' side of the topics: energyscapes and odometry in, scan, obstacle, objects, ego-motion and points out.
//!
//! A client of the daemon's own topics like any other: it reads the images where they lie, and nobody waits for it. Opened by the
//! daemon, in a thread of its own.

use super::error::IpcError;
use super::node::{Ipc, Needs, Registration};
use super::ports::{FixedPublisher, FixedSubscriber, SliceSubscriber};
use super::topics::Topic;
use super::wire::WireType;
use super::wire::detections::{Objects, Obstacle, Scan};
use super::wire::message::{EnergyscapeHeader, Odometry};
use super::wire::motion::EgoMotion;
use super::wire::points::PointCloud3;

/// Everything that the detectors publish and listen to.
#[derive(Debug)]
pub struct DetectorTopics {
    images: Vec<SliceSubscriber<f32, EnergyscapeHeader>>,
    odometry: FixedSubscriber<Odometry>,
    scan: FixedPublisher<Scan>,
    obstacle: FixedPublisher<Obstacle>,
    objects: FixedPublisher<Objects>,
    ego_motion: FixedPublisher<EgoMotion>,
    points: FixedPublisher<PointCloud3>,
    _registration: Registration,
}

impl DetectorTopics {
    fn needs(sensors: &[String]) -> Needs {
        let images = sensors.iter().map(|sensor| Topic::energyscape(sensor));
        let needs = images.chain([Topic::odometry()]).fold(Needs::new(), |needs, topic| needs.subscriber(&topic));
        [Topic::scan(), Topic::obstacle(), Topic::objects(), Topic::ego_motion(), Topic::points()]
            .iter()
            .fold(needs, |needs, topic| needs.publisher(topic, 1))
    }

    /// Shared memory that [`DetectorTopics::open`] needs, in bytes.
    #[must_use]
    pub fn needed_bytes(sensors: &[String]) -> u64 {
        Self::needs(sensors).bytes()
    }

    /// Descriptors of open files that [`DetectorTopics::open`] needs.
    #[must_use]
    pub fn needed_descriptors(sensors: &[String]) -> u64 {
        Self::needs(sensors).descriptors()
    }

    /// Opens everything for the sensors of these names.
    ///
    /// # Errors
    /// [`IpcError`].
    pub fn open(ipc: &Ipc, sensors: &[String]) -> Result<Self, IpcError> {
        let images: Vec<Topic> = sensors.iter().map(|sensor| Topic::energyscape(sensor)).collect();
        let (registration, (images, odometry, scan, obstacle, objects, ego_motion, points)) =
            ipc.set_up("noctule-detectors", Self::needs(sensors), move |session| {
                let images: Result<Vec<_>, IpcError> =
                    images.iter().map(|topic| session.slice_subscriber(topic)).collect();
                Ok((
                    images?,
                    session.subscriber(&Topic::odometry())?,
                    session.publisher(&Topic::scan())?,
                    session.publisher(&Topic::obstacle())?,
                    session.publisher(&Topic::objects())?,
                    session.publisher(&Topic::ego_motion())?,
                    session.publisher(&Topic::points())?,
                ))
            })?;
        Ok(Self { images, odometry, scan, obstacle, objects, ego_motion, points, _registration: registration })
    }

    /// Shows the newest energyscape of a sensor since the last call, in shared memory; `None` without one, for a sensor that is not
    /// there, and for a sample whose header does not describe it.
    pub fn energyscape<R>(&self, sensor_index: usize, read: impl FnOnce(&EnergyscapeHeader, &[f32]) -> R) -> Option<R> {
        self.images
            .get(sensor_index)?
            .next(|header, values| header.describes(values.len()).then(|| read(header, values)))?
    }

    /// The newest odometry that arrived since the last call.
    #[must_use]
    pub fn odometry(&self) -> Option<Odometry> {
        self.odometry.newest().filter(WireType::schema_matches)
    }

    /// Publishes a scan.
    ///
    /// # Errors
    /// [`IpcError::Send`].
    pub fn publish_scan(&self, scan: &Scan) -> Result<(), IpcError> {
        self.scan.send(*scan)
    }

    /// Publishes what stands on the planned way.
    ///
    /// # Errors
    /// [`IpcError::Send`].
    pub fn publish_obstacle(&self, obstacle: &Obstacle) -> Result<(), IpcError> {
        self.obstacle.send(*obstacle)
    }

    /// Publishes the objects and the map.
    ///
    /// # Errors
    /// [`IpcError::Send`].
    pub fn publish_objects(&self, objects: &Objects) -> Result<(), IpcError> {
        self.objects.send(*objects)
    }

    /// Publishes how the robot and what is around it move.
    ///
    /// # Errors
    /// [`IpcError::Send`].
    pub fn publish_ego_motion(&self, ego_motion: &EgoMotion) -> Result<(), IpcError> {
        self.ego_motion.send(*ego_motion)
    }

    /// Publishes the points in space.
    ///
    /// # Errors
    /// [`IpcError::Send`].
    pub fn publish_points(&self, points: &PointCloud3) -> Result<(), IpcError> {
        self.points.send(*points)
    }
}
