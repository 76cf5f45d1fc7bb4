//! Contract: from the ping on its topic to the platform's command nothing is allocated, in none of the threads of daemon and
//! controller, whoever reads along and however slowly. The transport takes and gives back one small block for each sample sent.

mod checks;
mod ipc_rig;

use checks::{figure, is_the_test_runner, trials};
use ipc_rig::{Base, Metronome, Place, is};
use noctule::config::Config;
use noctule::controller_process::{self, ControllerParams};
use noctule::imaging::params::Prefer;
use noctule::io::{InputPublisher, RawPublisher, StatusTopics};
use noctule::service::{self, SourceChoice, simulator, wiring};
use noctule::signal::{GateState, PingSet, SampleFormat, Velocity};
use noctule::sim::{SimParams, World};
use noctule::time::{Clock, Stamp, SystemClock};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, AtomicUsize, Ordering};
use std::time::Duration;

static COUNTED: AtomicU64 = AtomicU64::new(0);
static LARGEST: AtomicUsize = AtomicUsize::new(0);
static LIVE_BYTES: AtomicI64 = AtomicI64::new(0);

thread_local! {
    /// The test's own thread is driver, platform and judge, and none of the path.
    static BESIDE: Cell<bool> = const { Cell::new(false) };
}

/// Counts the allocations of all threads but those that stand beside.
struct Counting;

fn counts() -> bool {
    !BESIDE.try_with(Cell::get).unwrap_or(true) && !is_the_test_runner()
}

// SAFETY: every call goes unchanged to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        if counts() {
            COUNTED.fetch_add(1, Ordering::Relaxed);
            LARGEST.fetch_max(layout.size(), Ordering::Relaxed);
            LIVE_BYTES.fetch_add(layout.size() as i64, Ordering::Relaxed);
        }
        // SAFETY: as above.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        if counts() {
            LIVE_BYTES.fetch_sub(layout.size() as i64, Ordering::Relaxed);
        }
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Publishes simulated pings of all sensors, ten sets a second.
struct Driver {
    publishers: Vec<RawPublisher>,
    input: InputPublisher,
    sets: Vec<PingSet>,
    recording_ns: u64,
    sent: u64,
    metronome: Metronome,
}

impl Driver {
    fn new(config: &Config, place: &Place) -> Self {
        let setup = wiring::sensing(config).expect("setup");
        let world = World::default_world().expect("world");
        let mut simulator = simulator(config, &setup, world, SimParams::default(), 1).expect("simulator");
        let sets = (0..4).map(|_| {
            let mut pings = simulator.empty_ping_set();
            simulator.ping_set(Stamp::default(), &mut pings);
            pings
        });
        let sensors = setup.raw_shapes().into_iter();
        Self {
            publishers: sensors
                .map(|(sensor, shape)| RawPublisher::open(&place.ipc, &sensor, shape).expect("driver"))
                .collect(),
            input: InputPublisher::open(&place.ipc, false).expect("input"),
            sets: sets.collect(),
            recording_ns: (setup.recording.duration_s() * 1e9) as u64,
            sent: 0,
            metronome: Metronome::new(Duration::from_millis(100)),
        }
    }

    fn drive(&mut self) {
        if !self.metronome.due() {
            return;
        }
        let now = SystemClock.now();
        let set = &mut self.sets[self.sent as usize % 4];
        self.sent += 1;
        for (publisher, ping) in self.publishers.iter().zip(&mut set.pings) {
            ping.sequence = self.sent;
            ping.emitted_at = Stamp { boottime_ns: now.boottime_ns - self.recording_ns, wall_ns: 0 };
            publisher.publish(ping).expect("published");
        }
        self.input.want(Velocity::forward_m_s(0.1), now).expect("wanted");
    }
}

/// Where the counters stood, and what had been sent: by the controller, and in commands by the daemon.
#[derive(Debug, Clone, Copy)]
struct Mark {
    counted: u64,
    live_bytes: i64,
    platform: u64,
    commands: u64,
}

impl Mark {
    fn take(base: &mut Base) -> Self {
        base.listen();
        let newest = base.heard.last().expect("the platform is told something");
        Self {
            counted: COUNTED.load(Ordering::Relaxed),
            live_bytes: LIVE_BYTES.load(Ordering::Relaxed),
            platform: newest.sequence,
            commands: newest.command_sequence,
        }
    }
}

/// Allocations that no sample sent accounts for. After a ping set of three sensors the daemon sends a command, three energyscapes, cues
/// and health, its detecting thread scan, obstacle, objects and ego-motion.
fn unaccounted(before: Mark, after: Mark) -> i64 {
    let sent = after.platform - before.platform + 10 * (after.commands - before.commands);
    (after.counted - before.counted).cast_signed() - sent.cast_signed()
}

#[test]
fn nothing_is_allocated_from_the_ping_on_its_topic_to_the_platforms_command() {
    BESIDE.with(|beside| beside.set(true));
    let place = Place::new();
    let mut config = Config { ipc: place.params.clone(), ..Config::default() };
    config.recording.format = SampleFormat::PcmF32;
    let stop = Arc::new(AtomicBool::new(false));
    let mut driver = Driver::new(&config, &place);
    // Readers that never read: every queue to them is full before the counting begins.
    let _asleep = [0; 2].map(|_| StatusTopics::open(&place.ipc).expect("reader"));
    let mut base = Base::new(&place);
    let (params, stopping) = (ControllerParams::from_config(&config), Arc::clone(&stop));
    let controller = std::thread::spawn(move || controller_process::run(&params, true, &stopping).expect("controller"));
    let stopping = Arc::clone(&stop);
    let daemon = std::thread::spawn(move || {
        service::run(&config, &SourceChoice::Live, Prefer::Cpu, None, &stopping.into()).expect("daemon");
    });
    base.listen_until(Duration::from_secs(20), || driver.drive(), |sample| is(sample, GateState::Track));
    base.listen_for(Duration::from_secs(2), || driver.drive());

    LARGEST.store(0, Ordering::Relaxed);
    let before = Mark::take(&mut base);
    let sets = trials(3_000, 50);
    base.listen_for(Duration::from_millis(100 * sets as u64), || driver.drive());
    let after = Mark::take(&mut base);
    let largest = LARGEST.load(Ordering::Relaxed);
    assert!(is(base.heard.last().expect("heard"), GateState::Track), "driving all the time");
    let commands = after.commands - before.commands;
    let (extra, grown_bytes) = (unaccounted(before, after), after.live_bytes - before.live_bytes);

    // The same measure sees a single block a ping set, taken by any thread.
    let before = Mark::take(&mut base);
    let planted = Arc::clone(&stop);
    let fault = std::thread::spawn(move || {
        while !planted.load(Ordering::Relaxed) {
            std::hint::black_box(Vec::<u8>::with_capacity(16));
            std::thread::sleep(Duration::from_millis(100));
        }
    });
    base.listen_for(Duration::from_secs(5), || driver.drive());
    let seen = unaccounted(before, Mark::take(&mut base));
    stop.store(true, Ordering::Relaxed);
    [daemon, controller, fault].into_iter().for_each(|thread| thread.join().expect("ended"));

    figure(
        39,
        "allocations from ping to platform beside the transport's sample guards",
        extra,
        "0, +-20 at the ends",
        sets,
    );
    figure(39, "bytes held more than before", grown_bytes, "<= 2048", sets);
    assert!(commands as usize >= sets * 9 / 10, "{commands} commands after {sets} ping sets");
    // Measured: none. A mark may fall between the ten samples that a ping set and a tick send, at either end.
    assert!(extra.abs() <= 20, "{extra} allocations that no sample sent accounts for");
    // Measured: 104, the transport's guard of a sample.
    assert!(largest <= 256, "a block of {largest} bytes");
    assert!(grown_bytes.abs() <= 2048, "{grown_bytes} bytes more than before");
    assert!(seen >= 30, "the planted block a ping set shows as {seen} only");
}
