//! The thread that listens: polls the topics, opens them anew when they were taken away, and shows the board once a ping set is
//! complete, and a few times a second without one, so that ages are told.
//!
//! Goes in: the topics. Comes out: a [`Board`] that is shown. What costs something, copies and pictures, is made only while
//! somebody looks. Waits for nobody and ends within a pause when asked to.

use super::board::{Audience, Board, Image};
use super::robot::Robot;
use super::screen::{Codes, ScreenMap};
use crate::io::{Ipc, IpcError, ViewTopics};
use crate::signal::SENSORS_MAX;
use crate::time::{Clock, SystemClock};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Pause between two looks: commands come every 100 ms, what the platform is told every 20 ms with room for four.
const LOOK_PAUSE: Duration = Duration::from_millis(10);
/// What belongs to one ping set comes within this time.
const SETTLE: Duration = Duration::from_millis(12);
/// Longest time between two moments.
const QUIET: Duration = Duration::from_millis(200);
/// Pause between two attempts to open the topics, and two looks whether they are still there.
const REOPEN: Duration = Duration::from_secs(1);

/// What the thread works with.
pub(super) struct Listener {
    pub(super) ipc: Ipc,
    pub(super) robot: Arc<Robot>,
    pub(super) audience: Arc<Audience>,
    pub(super) board: Board,
    codes: Codes,
    maps: [Option<ScreenMap>; SENSORS_MAX],
}

impl Listener {
    pub(super) fn new(ipc: Ipc, robot: Arc<Robot>, audience: Arc<Audience>) -> Self {
        Self { ipc, robot, audience, board: Board::default(), codes: Codes::default(), maps: Default::default() }
    }

    /// Listens until `stop`.
    pub(super) fn run(mut self, stop: &AtomicBool) {
        let mut topics: Option<ViewTopics> = None;
        let mut looked_after: Option<Instant> = None;
        let mut shown = Instant::now();
        let mut news: Option<Instant> = None;
        let mut command_is_new = false;
        while !stop.load(Ordering::Relaxed) {
            if looked_after.is_none_or(|at| at.elapsed() >= REOPEN) {
                looked_after = Some(Instant::now());
                topics = self.look_after(topics);
            }
            if let Some(topics) = &topics {
                let heard = self.listen(topics);
                command_is_new |= heard.command;
                if heard.anything {
                    news.get_or_insert_with(Instant::now);
                }
            }
            if news.is_some_and(|at| at.elapsed() >= SETTLE) || shown.elapsed() >= QUIET {
                let now_ns = SystemClock.now().boottime_ns;
                if std::mem::take(&mut command_is_new) {
                    self.board.remember(now_ns);
                }
                self.board.show(now_ns);
                (news, shown) = (None, Instant::now());
            }
            std::thread::sleep(LOOK_PAUSE);
        }
    }

    /// Opens what is not open, and lets go of what was taken away.
    fn look_after(&mut self, topics: Option<ViewTopics>) -> Option<ViewTopics> {
        if let Some(topics) = topics {
            if topics.is_intact() {
                return Some(topics);
            }
            // Its end would take away the files that others made anew under the same names.
            std::mem::forget(topics);
        }
        let opened = ViewTopics::open(&self.ipc, &self.robot.sensor_names());
        self.board.trouble(opened.as_ref().err().map(IpcError::to_string));
        opened.ok()
    }

    fn listen(&mut self, topics: &ViewTopics) -> Heard {
        let mut heard = Heard::default();
        // What the platform is told comes five times as often and rides along.
        while let Some(platform) = topics.next_platform() {
            self.board.platform(platform);
        }
        while let Some(command) = topics.next_command() {
            self.board.command(command);
            (heard.command, heard.anything) = (true, true);
        }
        while let Some(cues) = topics.next_cues() {
            self.board.cues(cues);
            heard.anything = true;
        }
        while let Some(health) = topics.next_health() {
            self.board.health(health);
            heard.anything = true;
        }
        // They ride along, too: without an image there are none.
        self.board.detections(topics.scan(), topics.obstacle(), topics.objects());
        for sensor_index in 0..self.robot.sensors.len().min(SENSORS_MAX) {
            if let Some(image) = self.image(topics, sensor_index) {
                self.board.image(sensor_index, image);
                heard.anything = true;
            }
        }
        heard
    }

    fn image(&mut self, topics: &ViewTopics, sensor_index: usize) -> Option<Image> {
        let (pages, players) = (self.audience.pages() > 0, self.audience.players() > 0);
        let (robot, codes) = (&self.robot, &self.codes);
        let map = &mut self.maps[sensor_index];
        topics.energyscape(sensor_index, |header, values| {
            let mut message = None;
            if pages {
                let sensor = &robot.sensors[sensor_index];
                let map = match map.take().filter(|map| map.fits(header)) {
                    Some(fitting) => map.insert(fitting),
                    None => map.insert(ScreenMap::new(header, &robot.directions, &sensor.hidden)),
                };
                let mut header = *header;
                header.sensor_index = sensor_index as u32;
                message = Some(map.message(&header, values, codes).into());
            }
            Image {
                id: 0,
                header: *header,
                values: players.then(|| values.into()),
                message,
                // A NaN must not pass for silence.
                peak: values
                    .iter()
                    .fold(0.0f32, |most, value| if most.is_nan() || *value <= most { most } else { *value }),
            }
        })
    }
}

/// What one look brought.
#[derive(Debug, Default)]
struct Heard {
    command: bool,
    anything: bool,
}
