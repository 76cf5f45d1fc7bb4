//! What is known of daemon and controller: the newest of every topic, counts since this process began, a minute of history.
//!
//! Goes in: samples, as the listening thread hears them. Comes out: a [`Moment`], shared by everybody who looks and never
//! changed again. Old values stay, with their times: whoever shows them has to show their age, too.

use crate::io::wire::detections::{Objects, Obstacle, Scan};
use crate::io::wire::message::{EnergyscapeHeader, VelocityCommand};
use crate::io::wire::telemetry::{Cues, Health, PlatformVelocity};
use crate::signal::{LayerName, SENSORS_MAX};
use serde::Serialize;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use tokio::sync::watch;

/// Points of history that are kept: a minute at ten ping sets a second.
pub const HISTORY_MAX: usize = 600;
/// Upper bounds of the latency histogram's buckets.
pub const LATENCY_BOUNDS_S: [f64; 10] = [0.005, 0.01, 0.02, 0.03, 0.05, 0.075, 0.1, 0.2, 0.5, 1.0];

/// A sensor's newest energyscape.
#[derive(Debug, Clone)]
pub struct Image {
    /// Running number within this process; another image has another.
    pub id: u64,
    /// As it was published.
    pub header: EnergyscapeHeader,
    /// The values as they were published, while somebody wants them.
    pub values: Option<Arc<[f32]>>,
    /// The message for the page, while a page is open.
    pub message: Option<axum::body::Bytes>,
    /// Loudest cell.
    pub peak: f32,
}

/// What happened since this process began.
#[derive(Debug, Clone, Default)]
pub struct Counts {
    /// Commands heard, by layer number.
    pub layers: [u64; LayerName::ALL.len()],
    /// Latencies of ping sets heard, in the buckets of [`LATENCY_BOUNDS_S`] and above; not cumulative.
    pub latency: [u64; LATENCY_BOUNDS_S.len() + 1],
    /// Sum of these latencies.
    pub latency_sum_s: f64,
    /// Energyscapes heard, by sensor.
    pub images: [u64; SENSORS_MAX],
    /// Other starts of the daemon heard after the first.
    pub epochs: u64,
}

/// One look at everything.
#[derive(Debug, Clone, Default)]
pub struct Moment {
    /// Running number.
    pub id: u64,
    /// When it was made, CLOCK_BOOTTIME.
    pub made_ns: u64,
    /// Why nothing can be heard, if so.
    pub trouble: Option<String>,
    /// Newest health.
    pub health: Option<Health>,
    /// Newest cues.
    pub cues: Option<Cues>,
    /// Newest command.
    pub command: Option<VelocityCommand>,
    /// Newest word of the controller.
    pub platform: Option<PlatformVelocity>,
    /// Newest scan of the whole robot.
    pub scan: Option<Arc<Scan>>,
    /// Newest word about the planned way.
    pub obstacle: Option<Arc<Obstacle>>,
    /// Newest objects and map.
    pub objects: Option<Arc<Objects>>,
    /// Newest energyscapes, by sensor.
    pub images: [Option<Image>; SENSORS_MAX],
    /// Counts.
    pub counts: Counts,
}

impl Moment {
    /// Age at `now_ns` of what was stamped at `t_ns`.
    #[must_use]
    pub fn age_ns(t_ns: u64, now_ns: u64) -> u64 {
        now_ns.saturating_sub(t_ns)
    }

    /// When the daemon last spoke on any topic.
    #[must_use]
    pub fn daemon_heard_ns(&self) -> Option<u64> {
        let command = self.command.map(|command| command.t_published_ns);
        let health = self.health.map(|health| health.t_monotonic_ns);
        command.max(health)
    }

    /// When the controller last spoke.
    #[must_use]
    pub fn controller_heard_ns(&self) -> Option<u64> {
        self.platform.map(|platform| platform.t_monotonic_ns)
    }
}

/// A point of the curves.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Point {
    /// Time of the command, ms of CLOCK_BOOTTIME.
    pub t_ms: f64,
    /// Commanded forward speed.
    pub linear_m_s: f64,
    /// Commanded turn rate.
    pub angular_rad_s: f64,
    /// What the platform was told, if a controller speaks.
    pub driven_linear_m_s: Option<f64>,
    /// The same, turn rate.
    pub driven_angular_rad_s: Option<f64>,
    /// Latency of the ping set.
    pub latency_ms: Option<f64>,
    /// Number of the layer.
    pub layer: u32,
    /// Ping sets dropped so far.
    pub dropped: Option<u64>,
}

/// How many look, by what they need.
#[derive(Debug, Default)]
pub struct Audience {
    pages: AtomicUsize,
    players: AtomicUsize,
}

impl Audience {
    /// Pages that are open.
    #[must_use]
    pub fn pages(&self) -> usize {
        self.pages.load(Ordering::Relaxed)
    }

    /// Connections of Foxglove, Lichtblick and the like.
    #[must_use]
    pub fn players(&self) -> usize {
        self.players.load(Ordering::Relaxed)
    }

    /// Takes a place for a page, while fewer than `limit` are taken.
    #[must_use]
    pub fn page(self: &Arc<Self>, limit: usize) -> Option<Seat> {
        Seat::take(self, |audience| &audience.pages, limit)
    }

    /// Takes a place for a player, while fewer than `limit` are taken.
    #[must_use]
    pub fn player(self: &Arc<Self>, limit: usize) -> Option<Seat> {
        Seat::take(self, |audience| &audience.players, limit)
    }
}

/// A place in the audience; given back when dropped.
#[derive(Debug)]
pub struct Seat {
    audience: Arc<Audience>,
    row: fn(&Audience) -> &AtomicUsize,
}

impl Seat {
    fn take(audience: &Arc<Audience>, row: fn(&Audience) -> &AtomicUsize, limit: usize) -> Option<Self> {
        let more = |taken: usize| (taken < limit).then_some(taken + 1);
        row(audience).fetch_update(Ordering::Relaxed, Ordering::Relaxed, more).ok()?;
        Some(Self { audience: Arc::clone(audience), row })
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        (self.row)(&self.audience).fetch_sub(1, Ordering::Relaxed);
    }
}

/// The board that the listening thread writes on.
#[derive(Debug)]
pub struct Board {
    now: Moment,
    history: Arc<std::sync::Mutex<VecDeque<Point>>>,
    shown: watch::Sender<Arc<Moment>>,
    images: u64,
}

/// What readers hold: the newest moment, and the minute before it.
#[derive(Debug, Clone)]
pub struct Reader {
    history: Arc<std::sync::Mutex<VecDeque<Point>>>,
    /// The newest moment; an older one that nobody took is forgotten.
    pub moments: watch::Receiver<Arc<Moment>>,
}

impl Reader {
    /// The curves so far, oldest first.
    #[must_use]
    pub fn history(&self) -> Vec<Point> {
        self.history.lock().map(|history| history.iter().copied().collect()).unwrap_or_default()
    }
}

impl Default for Board {
    fn default() -> Self {
        let (shown, _) = watch::channel(Arc::default());
        Self { now: Moment::default(), history: Arc::default(), shown, images: 0 }
    }
}

impl Board {
    /// Another reader.
    #[must_use]
    pub fn reader(&self) -> Reader {
        Reader { history: Arc::clone(&self.history), moments: self.shown.subscribe() }
    }

    /// What is on it.
    #[must_use]
    pub fn now(&self) -> &Moment {
        &self.now
    }

    /// Why nothing can be heard; `None` when all is open.
    pub fn trouble(&mut self, trouble: Option<String>) {
        self.now.trouble = trouble;
    }

    /// Health was heard.
    pub fn health(&mut self, health: Health) {
        let before = self.now.health.filter(|before| before.epoch == health.epoch);
        if health.ping_set_count > before.map_or(0, |before| before.ping_set_count) && health.latency_ms.is_finite() {
            let latency_s = health.latency_ms * 1e-3;
            let bucket = LATENCY_BOUNDS_S.iter().position(|bound| latency_s <= *bound);
            self.now.counts.latency[bucket.unwrap_or(LATENCY_BOUNDS_S.len())] += 1;
            self.now.counts.latency_sum_s += latency_s;
        }
        self.now.health = Some(health);
    }

    /// Cues were heard.
    pub fn cues(&mut self, cues: Cues) {
        self.now.cues = Some(cues);
    }

    /// The controller was heard.
    pub fn platform(&mut self, platform: PlatformVelocity) {
        self.now.platform = Some(platform);
    }

    /// The detectors were heard, those that are some.
    pub fn detections(&mut self, scan: Option<Scan>, obstacle: Option<Obstacle>, objects: Option<Objects>) {
        self.now.scan = scan.map(Arc::new).or(self.now.scan.take());
        self.now.obstacle = obstacle.map(Arc::new).or(self.now.obstacle.take());
        self.now.objects = objects.map(Arc::new).or(self.now.objects.take());
    }

    /// A command was heard.
    pub fn command(&mut self, command: VelocityCommand) {
        if self.now.command.is_some_and(|before| before.epoch != command.epoch) {
            // What another start of the daemon said has no meaning beside the new one's words.
            self.now.counts.epochs += 1;
            (self.now.cues, self.now.images) = (None, Default::default());
            (self.now.scan, self.now.obstacle, self.now.objects) = (None, None, None);
            self.now.health = self.now.health.filter(|health| health.epoch == command.epoch);
        }
        if let Some(count) = self.now.counts.layers.get_mut(command.layer as usize) {
            *count += 1;
        }
        self.now.command = Some(command);
    }

    /// Puts the newest command on the curves, with what else is known by now.
    pub fn remember(&mut self, now_ns: u64) {
        let Some(command) = self.now.command else { return };
        let fresh = |t_ns: u64| Moment::age_ns(t_ns, now_ns) < 500_000_000;
        let platform = self.now.platform.filter(|platform| fresh(platform.t_monotonic_ns));
        let health = self.now.health.filter(|health| fresh(health.t_monotonic_ns));
        let point = Point {
            t_ms: command.t_published_ns as f64 * 1e-6,
            linear_m_s: command.linear_m_s,
            angular_rad_s: command.angular_rad_s,
            driven_linear_m_s: platform.map(|platform| platform.linear_m_s),
            driven_angular_rad_s: platform.map(|platform| platform.angular_rad_s),
            latency_ms: health.map(|health| health.latency_ms),
            layer: command.layer,
            dropped: health.map(|health| health.dropped_count),
        };
        if let Ok(mut history) = self.history.lock() {
            history.push_back(point);
            while history.len() > HISTORY_MAX {
                history.pop_front();
            }
        }
    }

    /// An energyscape was heard.
    pub fn image(&mut self, sensor_index: usize, mut image: Image) {
        let Some(place) = self.now.images.get_mut(sensor_index) else { return };
        self.images += 1;
        image.id = self.images;
        *place = Some(image);
        self.now.counts.images[sensor_index] += 1;
    }

    /// Shows what is on it to all readers. Never waits for one of them.
    pub fn show(&mut self, now_ns: u64) {
        self.now.id += 1;
        self.now.made_ns = now_ns;
        self.shown.send_replace(Arc::new(self.now.clone()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_start_of_the_daemon_takes_the_words_of_the_last_one_away() {
        let mut board = Board::default();
        board.command(VelocityCommand { epoch: 1, layer: 1, ..VelocityCommand::blank() });
        board.health(Health { epoch: 1, ping_set_count: 5, latency_ms: 12.0, ..Health::blank() });
        board.cues(Cues::blank());
        board.command(VelocityCommand { epoch: 2, layer: 1, ..VelocityCommand::blank() });
        let now = board.now();
        assert!(now.health.is_none() && now.cues.is_none());
        assert_eq!((now.counts.layers[1], now.counts.epochs, now.counts.latency[2]), (2, 1, 1));
    }

    #[test]
    fn a_reader_that_looks_seldom_sees_the_newest_and_holds_nobody_up() {
        let mut board = Board::default();
        let mut reader = board.reader();
        for sequence in 1..=100 {
            board.command(VelocityCommand { epoch: 1, sequence, ..VelocityCommand::blank() });
            board.show(sequence);
        }
        let moment = Arc::clone(&reader.moments.borrow_and_update());
        assert_eq!(moment.command.map(|command| command.sequence), Some(100));
        assert!(!reader.moments.has_changed().expect("open"));
    }

    #[test]
    fn seats_are_limited_and_given_back() {
        let audience = Arc::new(Audience::default());
        let seats: Vec<_> = (0..3).map(|_| audience.page(2)).collect();
        assert_eq!(seats.iter().flatten().count(), 2);
        assert_eq!((audience.pages(), audience.players()), (2, 0));
        drop(seats);
        assert!(audience.page(2).is_some());
    }
}
