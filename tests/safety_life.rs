//! Contract (checks 4, 5, 6): the real daemon killed, hung or stopped at any moment is followed by zero within Z2, by the judge's record,
//! and nothing that a dead daemon left or a new one says moves the robot before it is armed again.

mod checks;
mod ipc_rig;
mod judge;
mod life_rig;

use checks::{figure, trials};
use ipc_rig::{FakeDaemon, MS, Metronome, Place};
use judge::{Judge, LATCHED, Z2_NS, now_ns};
use life_rig::{Fate, Life, Process, SOON, Shim, assert_z2, child_with, controller_command, in_ms, stopped};
use noctule::io::OperatorClient;
use noctule::io::wire::message::Request;
use rustix::process::{Pid, Signal};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Time after which every silent fault must have been answered.
const AFTERMATH: Duration = Duration::from_millis(450);
const BAR: &str = "<= 350 ms, every trial";

#[test]
fn judge_process() {
    judge::serve_if_asked();
}

// ------------------------------------------------------------------------------------------------ check 4: killed

#[test]
fn a_killed_daemon_is_followed_by_zero_within_z2_and_its_successor_moves_nothing_unarmed() {
    let count = trials(300, 8);
    let mut life = Life::new();
    let (mut worst_ns, mut unarmed, mut way_m) = (0, 0, 0.0_f64);
    for trial in 0..count {
        life.drive(trial);
        let killed_ns = life.daemon.kill();
        life.judge.watch_for(AFTERMATH);
        let stop = stopped(&life.judge.record, killed_ns);
        way_m = way_m.max(life.judge.record.travel_m(killed_ns, now_ns()));
        assert_z2(&stop, trial);
        worst_ns = worst_ns.max(stop.after_capture_ns);
        life.start_daemon();
        life.wait_ready();
        life.judge.watch_for(Duration::from_millis(300));
        unarmed += usize::from(life.judge.record.motion_after(stop.zero_ns).is_some());
        assert_eq!(life.judge.newest().expect("heard").state, LATCHED, "another daemon than the one that was armed");
        life.judge.forget();
    }
    figure(4, "last capture to zero, daemon killed", in_ms(worst_ns), BAR, count);
    figure(4, "way after the kill", format!("{:.1} cm", way_m * 100.0), "<= 12 cm", count);
    figure(4, "restarts with motion before arming", unarmed, "0", count);
    assert_eq!(unarmed, 0);
    assert!(way_m <= 0.12);
}

/// The mutant of checks 4 and 5, "heartbeat from a timer": a daemon that goes on sending its last decision, freshly stamped, although no ping
/// set is behind it any more. The judgement of those checks must go red.
#[test]
fn a_daemon_that_repeats_old_decisions_by_a_timer_fails_z2() {
    let place = Place::new();
    let _controller = Process::spawn(&mut controller_command(&place));
    let mut judge = Judge::start(&place.root(), &place.params.prefix, place.directory.path());
    let mut daemon = FakeDaemon::new(&place.root(), &place.params.prefix, 77);
    let operator = OperatorClient::open(&place.ipc).expect("operator");
    let mut metronome = Metronome::new(Duration::from_millis(100));
    let deadline = Instant::now() + SOON;
    while !judge.newest().is_some_and(|heard| heard.moves()) {
        assert!(Instant::now() < deadline);
        operator.send(Request::Arm, 77).expect("asked");
        if metronome.due() {
            daemon.send(|_| {});
        }
        std::thread::sleep(Duration::from_millis(5));
        judge.look();
    }
    let died_ns = now_ns();
    for _ in 0..5 {
        daemon.send(|_| {});
        std::thread::sleep(Duration::from_millis(100));
    }
    judge.watch_for(AFTERMATH);
    let stop = stopped(&judge.record, died_ns);
    assert!(stop.after_fault_ns > Z2_NS, "the judge passes a robot that drove on: {}", in_ms(stop.after_fault_ns));
}

// ------------------------------------------------------------------------------------ check 5: hung or stopped

#[test]
fn a_daemon_whose_deciding_or_acquiring_thread_hangs_is_followed_by_zero_within_z2_and_ends_with_70() {
    let count = trials(50, 4);
    let (mut worst_ns, mut latest_end_ns) = (0, 0);
    for trial in 0..count {
        let thread = ["noctule-decide", "noctule-acquire"][trial % 2];
        let directory = TempDir::new().expect("directory");
        let shim = Shim::new(directory.path());
        let mut life = Life::with(|command| shim.load(command), |command| command);
        life.drive(trial);
        shim.strike(thread, Fate::Hang);
        let hung_ns = shim.struck_at(SOON);
        life.judge.watch_for(AFTERMATH);
        assert!(life.daemon.is_alive(), "the other threads live on until the hang is certain");
        let stop = stopped(&life.judge.record, hung_ns);
        // What was captured before a source hung may still be decided on: the robot stands Z2 after that.
        worst_ns = worst_ns.max(stop.after_capture_ns);
        assert!(stop.after_capture_ns <= Z2_NS, "{thread}, trial {trial}: {}", in_ms(stop.after_capture_ns));
        let (ended_ns, status) = life.daemon.ended_at(SOON);
        assert_eq!(status.code(), Some(70), "{thread}");
        latest_end_ns = latest_end_ns.max(ended_ns - hung_ns);
    }
    figure(5, "last capture to zero, a thread hangs", in_ms(worst_ns), BAR, count);
    figure(5, "hang of a thread to the end of the process", in_ms(latest_end_ns), "<= 2 s", count);
    assert!(latest_end_ns <= 2_000 * MS);
}

/// `noctule demo` in a place of its own: the supervisor of the contract where there is no systemd.
fn start_demo(place: &Place) -> Process {
    let mut command = Command::new(env!("CARGO_BIN_EXE_noctule"));
    command.args(["--quiet", "demo", "--headless", "--backend", "cpu", "--config"]).arg(place.config_file());
    let mut demo = Process::spawn(command.stdout(Stdio::null()).stderr(Stdio::null()));
    demo.has_children = true;
    demo
}

#[test]
fn a_stopped_daemon_is_followed_by_zero_within_z2_killed_by_its_supervisor_and_replaced_by_one_that_stands() {
    let count = trials(50, 2);
    let (mut worst_ns, mut latest_kill_ns) = (0, 0);
    for trial in 0..count {
        let place = Place::new();
        let mut demo = start_demo(&place);
        let mut judge = Judge::start(&place.root(), &place.params.prefix, place.directory.path());
        judge.watch_until(SOON, "motion", |heard| heard.moves());
        judge.watch_for(Duration::from_millis((trial * 37 % 100) as u64));
        let daemon = child_with(demo.id(), "run").expect("daemon");
        let id = Pid::from_raw(daemon.cast_signed()).expect("number");
        let stopped_ns = now_ns();
        rustix::process::kill_process(id, Signal::STOP).expect("stopped");
        let limit = Instant::now() + Duration::from_secs(4);
        while child_with(demo.id(), "run") == Some(daemon) {
            assert!(Instant::now() < limit, "the supervisor lets a stopped daemon be");
            std::thread::sleep(Duration::from_millis(2));
        }
        latest_kill_ns = latest_kill_ns.max(now_ns() - stopped_ns);
        judge.look();
        let stop = stopped(&judge.record, stopped_ns);
        assert_z2(&stop, trial);
        worst_ns = worst_ns.max(stop.after_capture_ns);
        judge.watch_until(SOON, "the next daemon", |heard| heard.daemon_state == life_rig::READY);
        assert!(judge.record.motion_after(stop.zero_ns).is_none(), "moved unarmed");
        demo.signal(Signal::TERM);
        assert_eq!(demo.wait(SOON).code(), Some(0));
        drop(judge);
    }
    figure(5, "last capture to zero, daemon stopped", in_ms(worst_ns), BAR, count);
    figure(5, "daemon stopped to killed by its supervisor", in_ms(latest_kill_ns), "<= 2 s", count);
    assert!(latest_kill_ns <= 2_000 * MS);
}

// ------------------------------------------------------------------------------------------ check 6: left-overs

/// Not a test of its own: a daemon of 10 Hz that is killed with unread samples.
#[test]
fn daemon_process() {
    let (Some(root), Ok(prefix)) = (std::env::var_os("NOCTULE_TEST_ROOT"), std::env::var("NOCTULE_TEST_PREFIX")) else {
        return;
    };
    let mut daemon = FakeDaemon::new(root.as_ref(), &prefix, 99);
    loop {
        daemon.send(|_| {});
        std::thread::sleep(Duration::from_millis(100));
    }
}

#[test]
fn what_a_dead_daemon_left_unread_moves_nothing_when_the_controller_wakes_or_starts_late() {
    let count = trials(200, 6);
    let mut non_zero = 0;
    for trial in 0..count {
        let place = Place::new();
        let mut controller = Process::spawn(&mut controller_command(&place));
        let mut judge = Judge::start(&place.root(), &place.params.prefix, place.directory.path());
        judge.watch_until(SOON, "controller", |_| true);
        let mut daemon = Process::spawn(
            Command::new(std::env::current_exe().expect("this program"))
                .args(["--exact", "daemon_process", "--test-threads", "1", "--quiet"])
                .env("NOCTULE_TEST_ROOT", place.root())
                .env("NOCTULE_TEST_PREFIX", &place.params.prefix)
                .stdout(Stdio::null()),
        );
        let operator = OperatorClient::open(&place.ipc).expect("operator");
        let deadline = Instant::now() + SOON;
        while !judge.newest().is_some_and(|heard| heard.moves()) {
            assert!(Instant::now() < deadline);
            operator.send(Request::Arm, 99).expect("asked");
            judge.watch_for(Duration::from_millis(50));
        }
        // The controller sleeps, the daemon speaks on, then dies with one sample that nobody read.
        controller.signal(Signal::STOP);
        std::thread::sleep(Duration::from_millis(150 + (trial * 37 % 100) as u64));
        daemon.kill();
        std::thread::sleep(Duration::from_millis(1_500));
        judge.look();
        let woken_ns = now_ns();
        if trial.is_multiple_of(2) {
            controller.signal(Signal::CONT);
        } else {
            controller.kill();
            controller = Process::spawn(&mut controller_command(&place));
        }
        judge.watch_until(SOON, "controller", |heard| heard.at_ns > woken_ns);
        // Even an operator who arms the dead daemon's epoch moves nothing.
        operator.send(Request::Arm, 99).expect("asked");
        judge.watch_for(Duration::from_millis(500));
        // What was decided before the sleep and had only to be sent comes out with its old stamp, which the base refuses: hence by the
        // stamp, and by what the motors were told.
        non_zero += judge.record.since(woken_ns).filter(|heard| heard.moves() && heard.sent_ns > woken_ns).count();
        non_zero += judge.record.motors.iter().filter(|motors| motors.at_ns > woken_ns && motors.moves()).count();
        let deadline = Instant::now() + SOON;
        while judge.record.since(woken_ns).count() <= 10 {
            assert!(Instant::now() < deadline, "the controller speaks");
            judge.watch_for(Duration::from_millis(50));
        }
    }
    figure(6, "non-zero outputs from a dead daemon's samples", non_zero, "0", count);
    assert_eq!(non_zero, 0);
}

/// The mutant of check 6, "age from arrival time": the same left-over, judged by when it arrived, is followed.
#[test]
fn a_gate_that_judged_left_overs_by_their_arrival_would_move() {
    use noctule::safety::{
        CommandSample, Gate, GateEvent, GateParams, GateState, MotionLimits, OperatorEvent, SafetyParams,
    };
    use noctule::signal::{DaemonState, Velocity};
    use noctule::time::Stamp;
    let at = |ms: u64| Stamp { boottime_ns: ms * MS, wall_ns: 0 };
    let limits = MotionLimits { linear_m_s: 0.3, angular_rad_s: 1.0, linear_m_s2: 1.0, angular_rad_s2: 3.0 };
    for (by_arrival, expected) in [(false, GateState::Wait), (true, GateState::Track)] {
        let mut gate = Gate::new(GateParams::new(&SafetyParams::default(), limits), at(10_000));
        let arm = OperatorEvent::Arm { epoch: 99, requested_at_ns: 10_001 * MS };
        gate = gate.step(GateEvent::Operator(arm), at(10_001)).0;
        for number in 0..6 {
            let arrived_ms = 10_100 + number * 100;
            let captured_at_ns = if by_arrival { arrived_ms } else { arrived_ms - 1_500 } * MS;
            let sample = CommandSample {
                schema_matches: true,
                checksum_matches: true,
                epoch: 99,
                publisher: (1, 1),
                sequence: number,
                captured_at_ns,
                valid_until_ns: captured_at_ns + 300 * MS,
                velocity: Velocity { linear_m_s: 0.2, angular_rad_s: 0.0 },
                daemon_state: Some(DaemonState::Active),
            };
            gate = gate.step(GateEvent::Command(sample), at(arrived_ms)).0;
        }
        assert_eq!(gate.state(), expected, "judged by arrival: {by_arrival}");
    }
}
