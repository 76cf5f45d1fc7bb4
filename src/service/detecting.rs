//! The detecting thread: from the daemon's own energyscapes to scan, obstacle, objects, ego-motion and,
//! on a grid with elevations, points in space.
//!
//! Goes in: what the daemon publishes, read where it lies in shared memory like any other reader, and odometry. Comes out: their
//! topics, and notes for a recording. The deciding thread knows nothing of it: it never waits for it, and if it hangs nothing else
//! does. Runs at the priority of ordinary threads.

use super::ServiceError;
use super::wiring::SensingSetup;
use super::{detections, scanning};
use crate::config::Config;
use crate::detect::ego_tracks::arc;
use crate::detect::{EgoMotion, ProjectionDetector, RingDetector, ScanFuser, SpaceDetector};
use crate::geometry::Pose2;
use crate::io::record::{Note, NoteTap};
use crate::io::wire::detections::{Objects, Obstacle, Scan};
use crate::io::wire::message::FLAG_NO_WITNESS;
use crate::io::wire::motion;
use crate::io::wire::points::PointCloud3;
use crate::io::{DetectorTopics, InputPublisher, Ipc, IpcError};
use crate::signal::{PointCloud, RobotScan, Velocity};
use crate::time::{Clock, Stamp, SystemClock};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Pause between two looks at the topics.
const LOOK_PAUSE: Duration = Duration::from_millis(4);
/// The images of one ping set are published within this time.
const SETTLE: Duration = Duration::from_millis(4);
/// Longest wait for the thread at the end.
const END_LIMIT: Duration = Duration::from_millis(200);

/// A detecting thread under way.
pub(super) struct Detecting {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl Detecting {
    /// Opens the topics and starts the thread; `None` where the configuration wants no detectors.
    ///
    /// # Errors
    /// What the transport or the system refuses.
    pub fn start(
        config: &Config,
        setup: &SensingSetup,
        ipc: &Ipc,
        notes: Option<NoteTap>,
    ) -> Result<Option<Self>, ServiceError> {
        if !config.detect.enabled {
            return Ok(None);
        }
        let topics = DetectorTopics::open(ipc, &setup.sensor_names())?;
        let planner = config.detect.drive_path.then(|| InputPublisher::open(ipc, false)).transpose()?;
        let detectors = Detectors { planner, ..Detectors::new(config, setup, topics, notes) };
        let stop = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&stop);
        let thread = std::thread::Builder::new()
            .name("noctule-detect".to_owned())
            .spawn(move || detectors.run(&flag))
            .map_err(|error| ServiceError::Internal(format!("no thread: {error}")))?;
        Ok(Some(Self { stop, thread }))
    }

    /// Ends the thread. One that does not come back is left behind.
    pub fn end(self) {
        self.stop.store(true, Ordering::Relaxed);
        let since = Instant::now();
        while !self.thread.is_finished() {
            if since.elapsed() > END_LIMIT {
                log::warn!("the detecting thread does not end: it is left behind");
                return;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        // A panic was told by its hook.
        let _ = self.thread.join();
    }
}

/// Everything of the thread.
struct Detectors {
    topics: DetectorTopics,
    notes: Option<NoteTap>,
    /// Where the follower of the planned path says what it wishes, as any planner does: the layers have the last word.
    planner: Option<InputPublisher>,
    sensor_count: usize,
    fuser: ScanFuser,
    projection: ProjectionDetector,
    ring: RingDetector,
    ego_motion: Box<EgoMotion>,
    /// With what it makes; `None` on a level grid.
    space: Option<Box<(SpaceDetector, PointCloud, PointCloud3)>>,
    twist: Velocity,
    pose: Option<(Pose2, Stamp)>,
    pose_max_age_ns: u64,
    had_pose: bool,
    scan: RobotScan,
    wire: Box<(Scan, Obstacle, Objects, motion::EgoMotion)>,
    complained: bool,
}

impl Detectors {
    fn new(config: &Config, setup: &SensingSetup, topics: DetectorTopics, notes: Option<NoteTap>) -> Self {
        Self {
            topics,
            notes,
            planner: None,
            sensor_count: setup.sensors.len(),
            fuser: scanning::fuser(config, setup),
            projection: ProjectionDetector::new(&config.detect.projection),
            ring: RingDetector::new(&config.detect.ring),
            ego_motion: Box::new(scanning::estimator(config, setup)),
            space: scanning::space(config, setup)
                .map(|detector| Box::new((detector, PointCloud::empty(), PointCloud3::blank()))),
            twist: Velocity::ZERO,
            pose: None,
            pose_max_age_ns: config.safety.input_max_age_ns(),
            had_pose: false,
            scan: RobotScan::unseen(),
            wire: Box::new((Scan::blank(), Obstacle::blank(), Objects::blank(), motion::EgoMotion::blank())),
            complained: false,
        }
    }

    fn run(mut self, stop: &AtomicBool) {
        let mut news: Option<Instant> = None;
        while !stop.load(Ordering::Relaxed) {
            if let Some(odometry) = self.topics.odometry() {
                self.pose = odometry.dated_pose();
                self.twist = odometry.twist();
            }
            if self.listen() {
                news.get_or_insert_with(Instant::now);
            }
            if news.is_some_and(|at| at.elapsed() >= SETTLE) {
                news = None;
                self.detect();
            }
            std::thread::sleep(LOOK_PAUSE);
        }
    }

    /// Takes the images that came; whether any did.
    fn listen(&mut self) -> bool {
        let mut heard = false;
        for sensor in 0..self.sensor_count {
            let (fuser, ego_motion, space) = (&mut self.fuser, &mut self.ego_motion, &mut self.space);
            let read = self.topics.energyscape(sensor, |header, cells| {
                let emitted_at = Stamp { boottime_ns: header.t_monotonic_ns, wall_ns: header.t_wall_ns };
                // A silent world is never a free one: what such a sensor alone sees is unseen.
                if header.flags & FLAG_NO_WITNESS == 0 {
                    fuser.hear(sensor, header.sequence, emitted_at, cells);
                    ego_motion.hear(sensor, cells);
                    if let Some(space) = space {
                        space.0.hear(sensor, header.sequence, emitted_at, cells);
                    }
                } else {
                    fuser.pass(header.sequence, emitted_at);
                }
            });
            heard |= read.is_some();
        }
        heard
    }

    fn detect(&mut self) {
        self.fuser.fuse(&mut self.scan);
        let emitted_at = self.scan.emitted_at;
        let near = |(_, at): &(Pose2, Stamp)| emitted_at.since_ns(*at).unsigned_abs() <= self.pose_max_age_ns;
        let dated = self.pose.filter(near);
        let pose = dated.map(|(pose, _)| pose);
        if pose.is_none() || !self.had_pose {
            // Another frame than that of the places remembered.
            self.ring.reset();
            self.projection.reset();
        }
        self.had_pose = pose.is_some();
        let (scan, obstacle, objects, motion) = &mut *self.wire;
        // Odometry comes when it likes; the flow is that between two emissions.
        let then = dated.map(|(pose, at)| pose.compose(&arc(self.twist, emitted_at.since_ns(at) as f64 * 1e-9)));
        let moved = self.ego_motion.update(self.scan.sequence, emitted_at, then);
        let ring = self.ring.update(&self.scan, &pose.unwrap_or_default());
        detections::fill_objects(objects, &self.scan, ring, pose);
        let projected = pose.map(|pose| self.projection.update(&self.scan, &pose, emitted_at));
        detections::fill_obstacle(obstacle, &self.scan, projected.as_ref());
        let now = SystemClock.now();
        scan.fill(&self.scan, now.boottime_ns);
        *motion = motion::EgoMotion::new(moved, now.boottime_ns);
        (obstacle.t_completed_ns, objects.t_completed_ns) = (now.boottime_ns, now.boottime_ns);
        let sent = self
            .topics
            .publish_scan(scan)
            .and_then(|()| self.topics.publish_obstacle(obstacle))
            .and_then(|()| self.topics.publish_objects(objects))
            .and_then(|()| self.topics.publish_ego_motion(motion));
        self.complain(sent);
        self.publish_points(now);
        if let (Some(planner), Some(projected)) = (&mut self.planner, projected) {
            let wished = planner.want(projected.wish, now);
            self.complain(wished);
        }
        self.record(now);
    }

    /// Makes and publishes the points of the ping set, where the grid has elevations.
    fn publish_points(&mut self, now: Stamp) {
        let Some(space) = &mut self.space else { return };
        let (detector, cloud, wire) = &mut **space;
        detector.update(cloud);
        wire.fill(cloud, now.boottime_ns);
        if let Some(notes) = &self.notes {
            notes.note(now, Note::Points(Box::new(*wire)));
        }
        let sent = self.topics.publish_points(wire);
        self.complain(sent);
    }

    fn complain(&mut self, sent: Result<(), IpcError>) {
        if let Err(error) = sent
            && !std::mem::replace(&mut self.complained, true)
        {
            log::error!("{error}");
        }
    }

    fn record(&self, now: Stamp) {
        let Some(notes) = &self.notes else { return };
        let (scan, obstacle, objects, motion) = &*self.wire;
        notes.note(now, Note::Scan(Box::new(*scan)));
        notes.note(now, Note::Obstacle(Box::new(*obstacle)));
        notes.note(now, Note::Objects(Box::new(*objects)));
        notes.note(now, Note::EgoMotion(Box::new(*motion)));
    }
}
