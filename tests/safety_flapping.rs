//! Contract (check 16): a sensor that comes and goes at 5 Hz, a fault that clears, a daemon that restarts: none of it moves the robot by itself out
//! of a latched state, and a process that dies five times in a minute stays down.

mod checks;
mod safety_rig;

use checks::figure;
use noctule::safety::{DaemonEvent, DaemonState, GateEvent, GateState, OperatorEvent, Reason};
use noctule::service::supervisor::{CONTROLLER_TERMS, DAEMON_TERMS, Restarts};
use noctule::signal::Velocity;
use safety_rig::{DaemonRig, EPOCH, GateRig, MS, SECOND};
use std::time::Duration;

/// Five changes a second: two ping sets in a row lack a view, or have a sensor lost, then one or three are good.
#[test]
fn a_sensor_that_flaps_at_5_hz_is_stopped_then_latched_and_never_drives_in_between() {
    let (mut resumes, mut rounds) = (0, 0);
    for phase in 0..4 {
        let mut rig = DaemonRig::in_state(DaemonState::Active);
        let mut stopped = false;
        for set in 0..600 {
            let output = rig.group(|group| group.view_missing = (set + phase) % 4 < 2);
            stopped |= output.state == DaemonState::Stopped;
            // Two good sets in a row are not five.
            resumes += usize::from(stopped && output.state.allows_motion());
            rounds += 1;
        }
        assert_eq!(rig.daemon.state(), DaemonState::Stopped, "it waits for five good sets");
    }
    figure(16, "ping sets with motion after the first stop, sensor flapping at 5 Hz", resumes, "0", rounds);
    assert_eq!(resumes, 0);
}

/// Slow flapping: each time just long enough to resume. The fifth stop within a minute is a fault, which stays.
#[test]
fn the_fifth_stop_of_a_slowly_flapping_sensor_is_a_fault_that_no_good_ping_set_clears() {
    let mut rig = DaemonRig::in_state(DaemonState::Active);
    let mut stops = 0;
    while rig.daemon.state() != DaemonState::Fault {
        rig.group(|group| group.view_missing = true);
        stops += 1;
        for _ in 0..5 {
            rig.group(|_| {});
        }
        assert!(stops <= 5, "{stops} stops in a minute");
    }
    assert_eq!(stops, 5);
    let mut resumes = 0;
    for _ in 0..6_000 {
        resumes += usize::from(rig.group(|_| {}).state.allows_motion());
        rig.arm();
        assert_eq!(rig.daemon.state(), DaemonState::Fault, "arming is no reset");
    }
    figure(16, "resumes by itself out of FAULT in ten minutes of good ping sets and arming", resumes, "0", 6_000);
    assert_eq!(resumes, 0);
    // The counterpart: the operator's way out exists.
    rig.send(DaemonEvent::Operator(OperatorEvent::Reset));
    rig.send(DaemonEvent::BackendVerified);
    for _ in 0..6 {
        rig.group(|_| {});
    }
    assert_eq!(rig.arm().state, DaemonState::Active);
}

#[test]
fn a_restarted_daemon_is_another_epoch_and_moves_nothing_until_armed_again() {
    let (mut unarmed, mut restarts) = (0, 0);
    let mut rig = GateRig::in_state(GateState::Track);
    for restart in 1..=300 {
        let output = rig.command(|sample| sample.epoch = EPOCH + restart);
        assert_eq!((output.state, output.reason), (GateState::Latched, Reason::EpochChanged));
        for _ in 0..20 {
            let output = rig.command(|sample| sample.epoch = EPOCH + restart);
            unarmed += usize::from(output.velocity != Velocity::ZERO || output.state != GateState::Latched);
        }
        // Armed for the old epoch it stays where it is with the new one; armed for the new one it follows.
        rig.now_ns += MS;
        let arm = OperatorEvent::Arm { epoch: EPOCH + restart, requested_at_ns: rig.now_ns };
        rig.send(GateEvent::Operator(arm));
        for _ in 0..6 {
            rig.command(|sample| sample.epoch = EPOCH + restart);
        }
        assert_eq!(rig.gate.state(), GateState::Track);
        restarts += 1;
    }
    figure(16, "ticks with motion after a change of epoch, before arming", unarmed, "0", restarts * 20);
    assert_eq!(unarmed, 0);
}

#[test]
fn a_restart_storm_ends_with_the_process_down_and_rare_deaths_never_do() {
    for terms in [DAEMON_TERMS, CONTROLLER_TERMS] {
        // It dies as soon as it starts: the pauses alone decide.
        let mut restarts = Restarts::new(terms.first_pause);
        let (mut now, mut starts) = (Duration::ZERO, 0);
        while let Some(pause) = restarts.after_death(now) {
            now += pause + Duration::from_millis(50);
            starts += 1;
            assert!(starts < 10, "it is started for ever");
        }
        figure(
            16,
            "restarts of a process that dies at once, before it stays down",
            starts,
            "4: the fifth death is the last",
            1,
        );
        assert_eq!(starts, 4);
        assert!(now <= Duration::from_secs(60));
        // The counterpart: once in twenty seconds, for a day.
        let mut restarts = Restarts::new(terms.first_pause);
        assert!((0..4_320).all(|death| restarts.after_death(Duration::from_secs(20 * death)).is_some()));
    }
}

/// The mutant "latch removed": a gate that is armed anew for whatever epoch comes, as one without a latch would behave, moves. The count of
/// the test above sees it.
#[test]
fn a_gate_that_takes_every_epoch_for_the_armed_one_is_seen_to_move() {
    let mut rig = GateRig::in_state(GateState::Track);
    let mut unarmed = 0;
    for _ in 0..20 {
        // The protection removed: the new daemon's epoch is taken for the armed one.
        let output = rig.command(|sample| sample.epoch = EPOCH);
        unarmed += usize::from(output.state != GateState::Latched);
        rig.tick();
    }
    assert!(unarmed > 0 && rig.now_ns > SECOND);
}
