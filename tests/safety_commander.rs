//! Contract (check 19): there is one commander. A second one is refused before and after the daemon's start, a squatter makes the daemon end
//! with 69 naming service and holder, and a controller that was armed for one publisher follows no other.

mod checks;
mod ipc_rig;
mod judge;
mod life_rig;

use checks::{figure, trials};
use iceoryx2::port::publisher::PublisherCreateError;
use ipc_rig::{FakeDaemon, MS, Metronome, Place, foreign_node};
use judge::{Judge, LATCHED, now_ns};
use life_rig::{Life, Process, SOON, controller_command, daemon_command, in_ms, said};
use noctule::io::OperatorClient;
use noctule::io::wire::message::{Request, VelocityCommand};
use noctule::signal::Reason;
use std::process::Stdio;
use std::time::Duration;

#[test]
fn judge_process() {
    judge::serve_if_asked();
}

#[test]
fn a_squatter_on_the_command_service_makes_the_daemon_end_with_69_naming_service_and_holder() {
    let count = trials(30, 2);
    let mut refused = 0;
    for _ in 0..count {
        let place = Place::new();
        let _controller = Process::spawn(&mut controller_command(&place));
        let mut judge = Judge::start(&place.root(), &place.params.prefix, place.directory.path());
        judge.watch_until(SOON, "controller", |_| true);
        let mut squatter = FakeDaemon::new(&place.root(), &place.params.prefix, 1);
        let mut daemon = Process::spawn(daemon_command(&place, 1).stderr(Stdio::piped()));
        let status = daemon.wait(SOON);
        let told = said(&mut daemon.child);
        assert_eq!(status.code(), Some(69), "{told}");
        assert!(told.contains("noctule/command") && told.contains(&std::process::id().to_string()), "{told}");
        refused += 1;
        squatter.send(|_| {});
        judge.watch_for(Duration::from_millis(100));
        assert!(judge.record.heard.iter().all(|heard| !heard.moves()), "nobody armed");
    }
    figure(19, "daemons that refused to start beside a squatter, with 69, service and holder", refused, "all", count);
}

#[test]
fn a_second_commander_is_refused_while_the_daemon_drives_and_the_robot_drives_on() {
    let mut life = Life::new();
    life.drive(0);
    let node = foreign_node(&life.place.root(), &life.place.params.prefix);
    let service = node
        .service_builder(&"noctule/command".try_into().expect("name"))
        .publish_subscribe::<VelocityCommand>()
        .open()
        .expect("the service is there");
    let count = trials(100, 20);
    let refused = (0..count)
        .filter(|_| {
            matches!(service.publisher_builder().create(), Err(PublisherCreateError::ExceedsMaxSupportedPublishers))
        })
        .count();
    let begun_ns = now_ns();
    life.judge.watch_for(Duration::from_millis(500));
    figure(19, "second commanders refused after the start", refused, "all", count);
    assert_eq!(refused, count);
    assert!(life.judge.record.since(begun_ns).all(|heard| heard.state == judge::TRACK), "and nobody is disturbed");
}

#[test]
fn a_controller_follows_no_other_publisher_even_with_the_right_epoch() {
    let count = trials(30, 3);
    let mut worst_ns = 0;
    for trial in 0..count {
        let place = Place::new();
        let _controller = Process::spawn(&mut controller_command(&place));
        let mut judge = Judge::start(&place.root(), &place.params.prefix, place.directory.path());
        let operator = OperatorClient::open(&place.ipc).expect("operator");
        let mut daemon = FakeDaemon::new(&place.root(), &place.params.prefix, 19);
        let mut metronome = Metronome::new(Duration::from_millis(100));
        while !judge.newest().is_some_and(|heard| heard.moves()) {
            operator.send(Request::Arm, 19).expect("asked");
            if metronome.due() {
                daemon.send(|_| {});
            }
            judge.watch_for(Duration::from_millis(5));
        }
        let sequence = daemon.sequence;
        drop(daemon);
        // Epoch, publisher's own number and sequence all go on as they should: only the transport knows better. Or the epoch is another.
        let epoch = if trial % 3 == 2 { 20 } else { 19 };
        let mut hostile = FakeDaemon::new(&place.root(), &place.params.prefix, epoch);
        hostile.sequence = sequence + 1;
        // A new connection is seen with one of the first samples.
        let begun_ns = now_ns();
        let mut latched = None;
        while latched.is_none() {
            assert!(now_ns() - begun_ns < 2_000 * MS, "the second commander is followed: {:?}", judge.newest());
            hostile.send(|_| {});
            let sent_ns = now_ns();
            judge.watch_for(Duration::from_millis(30));
            latched =
                judge.newest().filter(|heard| heard.state == LATCHED).map(|heard| heard.at_ns.saturating_sub(sent_ns));
        }
        worst_ns = worst_ns.max(latched.unwrap_or(0));
        let reason = if epoch == 20 { Reason::EpochChanged } else { Reason::PublisherChanged };
        assert_eq!(judge.newest().map(|heard| heard.reason), Some(reason.number()));
        let latched_ns = now_ns();
        for _ in 0..8 {
            hostile.send(|_| {});
            judge.watch_for(Duration::from_millis(50));
        }
        assert!(judge.record.motion_after(latched_ns).is_none());
    }
    figure(19, "first heard command of another publisher to latched zero", in_ms(worst_ns), "<= 50 ms", count);
    assert!(worst_ns <= 50 * MS);
}

/// The mutant "epoch pin removed": a gate that takes every publisher for the armed one follows the second commander.
#[test]
fn a_gate_without_the_pin_would_follow_the_second_commander() {
    use noctule::safety::{
        CommandSample, Gate, GateEvent, GateParams, GateState, MotionLimits, OperatorEvent, SafetyParams,
    };
    use noctule::signal::{DaemonState, Velocity};
    use noctule::time::Stamp;
    let at = |ms: u64| Stamp { boottime_ns: ms * MS, wall_ns: 0 };
    let limits = MotionLimits { linear_m_s: 0.3, angular_rad_s: 1.0, linear_m_s2: 1.0, angular_rad_s2: 3.0 };
    for (pinned, expected) in [(true, GateState::Latched), (false, GateState::Track)] {
        let mut gate = Gate::new(GateParams::new(&SafetyParams::default(), limits), at(10_000));
        let arm = OperatorEvent::Arm { epoch: 19, requested_at_ns: 10_001 * MS };
        gate = gate.step(GateEvent::Operator(arm), at(10_001)).0;
        for number in 0..10 {
            let now_ms = 10_100 + number * 100;
            // From the sixth sample on another publisher speaks; without the pin its identity is not looked at.
            let publisher = if pinned && number >= 6 { (2, 2) } else { (1, 1) };
            let sample = CommandSample {
                schema_matches: true,
                checksum_matches: true,
                epoch: 19,
                publisher,
                sequence: number,
                captured_at_ns: (now_ms - 30) * MS,
                valid_until_ns: (now_ms + 270) * MS,
                velocity: Velocity { linear_m_s: 0.2, angular_rad_s: 0.0 },
                daemon_state: Some(DaemonState::Active),
            };
            gate = gate.step(GateEvent::Command(sample), at(now_ms)).0;
        }
        assert_eq!(gate.state(), expected, "pinned: {pinned}");
    }
}
