//! Contract (check 17): the wall clock moves nothing and stops nothing; stamps of CLOCK_BOOTTIME older than MAX_AGE or more than 50 ms ahead, and
//! a machine that slept, stop the robot every time. Both state machines with injected time, and the real processes once.

mod checks;
mod ipc_rig;
mod judge;
mod life_rig;
mod safety_rig;

use checks::{figure, trials};
use judge::TRACK;
use life_rig::{Life, Shim};
use noctule::safety::{DaemonEvent, DaemonState, GateEvent, GateState, Reason};
use noctule::signal::Velocity;
use noctule::time::Stamp;
use rand::RngExt as _;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use safety_rig::{DaemonRig, GateRig, MS, SECOND, at};
use std::time::Duration;
use tempfile::TempDir;

const HOUR_NS: u64 = 3_600 * SECOND;

#[test]
fn judge_process() {
    judge::serve_if_asked();
}

/// A thousand trials: each a tracking gate and an active daemon, and one thing that happens to a clock. `judge` is the gate's own
/// judgement or a mutant of it. Returns spurious and missed stops.
fn trials_of_clocks(judge: impl Fn(u64, Stamp) -> u64) -> (usize, usize) {
    let mut random = ChaCha8Rng::seed_from_u64(17);
    let (mut spurious, mut missed) = (0, 0);
    for trial in 0..1_000 {
        let mut gate = GateRig::in_state(GateState::Track);
        let mut daemon = DaemonRig::in_state(DaemonState::Active);
        // Ahead by more than 50 ms or behind by more than 300 ms must stop; less must not.
        let (offset_ns, must_stop): (i64, bool) = match trial % 6 {
            0 => (0, false),
            1 => (random.random_range(0..=50 * MS).cast_signed(), false),
            2 => (-random.random_range(0..=300 * MS).cast_signed(), false),
            3 => (random.random_range(50 * MS + 1..=HOUR_NS).cast_signed(), true),
            4 => (-random.random_range(300 * MS + 1..=HOUR_NS).cast_signed(), true),
            // Suspended for up to ten seconds and more: the newest command was young before.
            _ => (-random.random_range(301 * MS..=20 * SECOND).cast_signed(), true),
        };
        let suspended = trial % 6 == 5;
        // The wall clock jumps by up to an hour, there and back, at every event.
        let mut now = |now_ns: u64| {
            let wall_ns = 1_700_000_000 * SECOND + random.random_range(0..=2 * HOUR_NS);
            Stamp { boottime_ns: now_ns, wall_ns }
        };
        gate.now_ns += 20 * MS;
        if suspended {
            gate.now_ns += offset_ns.unsigned_abs();
            daemon.now_ns += offset_ns.unsigned_abs() + 300 * MS;
        } else {
            let mut sample = gate.next();
            let captured_at_ns = gate.now_ns.saturating_add_signed(offset_ns);
            sample.captured_at_ns = judge(captured_at_ns, at(gate.now_ns));
            sample.valid_until_ns = u64::MAX;
            (gate.gate, _) = gate.gate.step(GateEvent::Command(sample), now(gate.now_ns));
            let daemons_ns = daemon.now_ns + 100 * MS;
            daemon.group(|group| {
                group.captured_at_ns = judge(daemons_ns.saturating_add_signed(offset_ns), at(daemons_ns))
            });
        }
        let (gate_after, output) = gate.gate.step(GateEvent::Tick, now(gate.now_ns));
        let (_, daemons) = daemon.daemon.step(DaemonEvent::Tick, now(daemon.now_ns));
        let stopped = [gate_after.state() != GateState::Track, !daemons.state.allows_motion()];
        assert!(stopped[0] == (output.state != GateState::Track) && (!stopped[0] || output.velocity == Velocity::ZERO));
        spurious += stopped.iter().filter(|stopped| **stopped && !must_stop).count();
        missed += stopped.iter().filter(|stopped| !**stopped && must_stop).count();
    }
    (spurious, missed)
}

#[test]
fn of_a_thousand_jumps_of_clocks_none_is_missed_and_none_stops_without_need() {
    let (spurious, missed) = trials_of_clocks(|captured_at_ns, _| captured_at_ns);
    figure(17, "spurious and missed stops of gate and daemon", format!("{spurious} and {missed}"), "0 and 0", 1_000);
    assert_eq!((spurious, missed), (0, 0));
}

/// The mutants "one-sided age test" and "age from arrival time": both must be seen by the trials above.
#[test]
fn a_one_sided_age_test_and_one_by_arrival_miss_stops() {
    let (_, missed) = trials_of_clocks(|captured_at_ns, now| captured_at_ns.min(now.boottime_ns));
    assert!(missed > 100, "stamps from the future pass: {missed}");
    let (_, missed) = trials_of_clocks(|_, now| now.boottime_ns);
    assert!(missed > 300, "everything that arrives passes: {missed}");
}

#[test]
fn a_stamp_from_the_future_is_refused_under_its_own_name() {
    for (offset_ns, reason) in
        [(51 * MS.cast_signed(), Reason::CommandFromFuture), (-301 * MS.cast_signed(), Reason::CommandTooOld)]
    {
        let mut gate = GateRig::in_state(GateState::Track);
        let output = gate.command(|sample| {
            sample.captured_at_ns = (sample.captured_at_ns + 40 * MS).saturating_add_signed(offset_ns);
            sample.valid_until_ns = u64::MAX;
        });
        assert_eq!((output.state, output.reason), (GateState::Hold, reason));
    }
}

/// The real daemon and controller while their wall clock jumps an hour forth and back: not one tick out of TRACK.
#[test]
fn the_real_processes_drive_on_while_the_wall_clock_jumps_by_hours() {
    let directory = TempDir::new().expect("directory");
    let shim = Shim::new(directory.path());
    let mut life = Life::with(|command| shim.load(command), |command| shim.load(command));
    life.drive(0);
    life.judge.forget();
    let count = trials(60, 6);
    let mut shifted = 0;
    for jump in 0..count {
        shim.shift_wall_s([3_600, -3_600, 0][jump % 3]);
        life.judge.watch_for(Duration::from_millis(500));
        shifted += 1;
    }
    let heard = &life.judge.record.heard;
    let out_of_track = heard.iter().filter(|heard| heard.state != TRACK).count();
    figure(
        17,
        "samples out of TRACK in the real processes while the wall clock jumps by hours",
        out_of_track,
        "0",
        shifted,
    );
    assert!(heard.len() > 20 * count, "{} samples", heard.len());
    assert_eq!(out_of_track, 0);
}

/// That the shim really shifts what the processes take for the wall clock: the stamps that they publish say so.
#[test]
fn the_shifted_wall_clock_arrives_in_what_the_controller_publishes() {
    let directory = TempDir::new().expect("directory");
    let shim = Shim::new(directory.path());
    shim.shift_wall_s(3_600);
    let life = Life::with(|command| command, |command| shim.load(command));
    let platform = noctule::io::PlatformSubscriber::open(&life.place.ipc).expect("platform");
    let deadline = std::time::Instant::now() + life_rig::SOON;
    let sample = loop {
        if let Some(sample) = platform.newest() {
            break sample;
        }
        assert!(std::time::Instant::now() < deadline);
        std::thread::sleep(Duration::from_millis(5));
    };
    let wall =
        std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).expect("after 1970").as_nanos() as i128;
    let ahead_s = (i128::from(sample.t_wall_ns) - wall) / 1_000_000_000;
    assert!((3_590..=3_600).contains(&ahead_s), "{ahead_s} s");
}
