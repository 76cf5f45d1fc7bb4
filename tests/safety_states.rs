//! Contract: the daemon's state machine does exactly what the safe-state contract says for every (state, event) pair:
//! motion only in ACTIVE and DEGRADED, only after arming, FAULT left by an operator only.

mod checks;
mod safety_rig;

use noctule::safety::daemon::{DEGRADED_SPEED_M_S, DESYNC_FAULT_NS, DESYNC_WARNING_NS};
use noctule::safety::{DaemonEvent, DaemonState, GroupFindings, OperatorEvent, Reason, SensorFindings};
use noctule::signal::Velocity;
use proptest::prelude::*;
use safety_rig::{DaemonRig, EPOCH, MS, SECOND, START_NS, good_group};

fn changed(change: impl FnOnce(&mut GroupFindings)) -> GroupFindings {
    let mut group = good_group(0);
    change(&mut group);
    group
}

/// The whole contract of the daemon as a table: an event, and the state that each of the eight states goes to.
#[rustfmt::skip]
fn daemon_table() -> Vec<(&'static str, DaemonEvent, [DaemonState; 8])> {
    use DaemonState::{Active as A, Boot as B, Degraded as D, Fault as F, Ready as R, SelfTest as T, Shutdown as X, Stopped as S};
    let group = |change: fn(&mut GroupFindings)| DaemonEvent::Group(changed(change));
    let operator = DaemonEvent::Operator;
    let stays = [B, T, R, A, D, S, F, X];
    let faults = [B, F, F, F, F, F, F, X];
    let stops = [B, T, R, S, S, S, F, X];
    let slows = [B, T, R, D, D, S, F, X];
    vec![
        //                                                                                 B  T  R  A  D  S  F  X
        ("started",               DaemonEvent::Started,                                   [T, T, R, A, D, S, F, X]),
        ("backend verified",      DaemonEvent::BackendVerified,                           stays),
        ("backend mismatch",      DaemonEvent::BackendMismatch,                           [F, F, F, F, F, F, F, X]),
        ("internal error",        DaemonEvent::InternalError,                             [F, F, F, F, F, F, F, X]),
        ("terminate",             DaemonEvent::Terminate,                                 [X, X, X, X, X, X, X, X]),
        ("tick",                  DaemonEvent::Tick,                                      stays),
        ("one deadline missed",   DaemonEvent::DeadlineMissed,                            stays),
        ("arm",                   operator(OperatorEvent::Arm { epoch: EPOCH, requested_at_ns: 0 }),     [B, T, A, A, D, S, F, X]),
        ("arm of another epoch",  operator(OperatorEvent::Arm { epoch: EPOCH + 1, requested_at_ns: 0 }), stays),
        ("operator stop",         operator(OperatorEvent::Stop),                          [B, T, R, R, R, R, F, X]),
        ("operator reset",        operator(OperatorEvent::Reset),                         [B, T, R, A, D, S, T, X]),
        ("good set",              group(|_| {}),                                          stays),
        ("sensor lost",           group(|g| g.sensors[0] = SensorFindings::ABSENT),       slows),
        ("3 channels lost",       group(|g| g.sensors[2].bad_channels = 3),               slows),
        ("8 channels lost",       group(|g| g.sensors[2].bad_channels = 8),               slows),
        ("2 channels lost",       group(|g| g.sensors[2].bad_channels = 2),               stays),
        ("9 channels lost",       group(|g| g.sensors[2].bad_channels = 9),               stops),
        ("2 channels clipped",    group(|g| { g.sensors[1].clipped_channels = 2; g.sensors[1].bad_channels = 2; }), stays),
        ("3 channels clipped",    group(|g| { g.sensors[1].clipped_channels = 3; g.sensors[1].bad_channels = 3; }), stops),
        ("GPU fallback in time",  group(|g| g.backend_fallback = true),                   slows),
        ("desync warning",        group(|g| g.desync_ns = DESYNC_WARNING_NS),             slows),
        ("desync below warning",  group(|g| g.desync_ns = DESYNC_WARNING_NS - 1),         stays),
        ("desync below fault",    group(|g| g.desync_ns = DESYNC_FAULT_NS - 1),           slows),
        ("desync",                group(|g| g.desync_ns = DESYNC_FAULT_NS),               faults),
        ("3 gaps in a row",       group(|g| g.sensors[1].gaps_in_a_row = 3),              slows),
        ("2 gaps in a row",       group(|g| g.sensors[1].gaps_in_a_row = 2),              stays),
        ("view missing",          group(|g| g.view_missing = true),                       stops),
        ("every sensor lost",     group(|g| g.sensors = [SensorFindings::ABSENT; 3]),     stops),
        ("ping rejected",         group(|g| g.sensors[0].rejected = true),                stops),
        ("no direct path",        group(|g| g.sensors[0].direct_path = false),            faults),
        ("frozen ping",           group(|g| g.sensors[2].frozen = true),                  faults),
        ("channel map wrong",     group(|g| g.sensors[1].channel_map_fits = false),       faults),
    ]
}

/// Number of a kind of event. A new kind does not compile until it has a number, and the table below then lacks it.
fn kind(event: &DaemonEvent) -> usize {
    match event {
        DaemonEvent::Started => 0,
        DaemonEvent::BackendVerified => 1,
        DaemonEvent::BackendMismatch => 2,
        DaemonEvent::Group(_) => 3,
        DaemonEvent::DeadlineMissed => 4,
        DaemonEvent::Tick => 5,
        DaemonEvent::Operator(OperatorEvent::Arm { .. }) => 6,
        DaemonEvent::Operator(OperatorEvent::Stop) => 7,
        DaemonEvent::Operator(OperatorEvent::Reset) => 8,
        DaemonEvent::InternalError => 9,
        DaemonEvent::Terminate => 10,
    }
}

#[test]
fn every_state_and_event_of_the_daemon_goes_where_the_contract_says() {
    let table = daemon_table();
    let (mut pairs, kinds) =
        (0, (0..=10).filter(|number| table.iter().any(|(_, event, _)| kind(event) == *number)).count());
    let asked = table.len() * DaemonState::ALL.len();
    for (name, event, after) in table {
        for (&state, &expected) in DaemonState::ALL.iter().zip(&after) {
            let mut rig = DaemonRig::in_state(state);
            rig.now_ns += 50 * MS;
            // Stamps in the table stand for "just now".
            let event = match event {
                DaemonEvent::Group(mut group) => {
                    group.captured_at_ns = rig.now_ns - 40 * MS;
                    DaemonEvent::Group(group)
                }
                DaemonEvent::Operator(OperatorEvent::Arm { epoch, .. }) => {
                    DaemonEvent::Operator(OperatorEvent::Arm { epoch, requested_at_ns: rig.now_ns })
                }
                other => other,
            };
            let output = rig.send(event);
            assert_eq!(output.state, expected, "{name} in {state}");
            assert_eq!(output.transition.is_some(), state != expected, "{name} in {state} is told once");
            let wanted = Velocity { linear_m_s: 0.3, angular_rad_s: 0.4 };
            if !matches!(expected, DaemonState::Active | DaemonState::Degraded) {
                assert_eq!(output.limit(wanted), Velocity::ZERO, "{name} in {state}");
            }
            pairs += 1;
        }
    }
    checks::figure(
        16,
        "pairs of state and event of the daemon, kinds of events in them",
        format!("{pairs}, {kinds} of 11"),
        "100 %",
        asked,
    );
    assert_eq!((pairs, kinds), (asked, 11));
}

#[test]
fn degraded_is_slow_and_never_backward_and_nan_is_zero() {
    let output = DaemonRig::in_state(DaemonState::Degraded).send(DaemonEvent::Tick);
    let limited = output.limit(Velocity { linear_m_s: 0.3, angular_rad_s: 0.4 });
    assert_eq!(limited, Velocity { linear_m_s: DEGRADED_SPEED_M_S, angular_rad_s: 0.4 });
    assert_eq!(output.limit(Velocity { linear_m_s: -0.1, angular_rad_s: 0.0 }).linear_m_s, 0.0);
    for state in [DaemonState::Active, DaemonState::Degraded] {
        let output = DaemonRig::in_state(state).send(DaemonEvent::Tick);
        assert_eq!(output.limit(Velocity { linear_m_s: f64::NAN, angular_rad_s: 0.1 }), Velocity::ZERO);
        assert_eq!(output.limit(Velocity { linear_m_s: 0.1, angular_rad_s: f64::INFINITY }), Velocity::ZERO);
    }
}

#[test]
fn ready_needs_five_usable_sets_of_every_sensor_and_the_backend() {
    let mut rig = DaemonRig::new();
    rig.send(DaemonEvent::Started);
    assert!(rig.daemon.wants_backend_check());
    for _ in 0..4 {
        rig.group(|_| {});
    }
    rig.group(|group| group.sensors[1] = SensorFindings::ABSENT);
    for _ in 0..5 {
        assert_eq!(rig.daemon.state(), DaemonState::SelfTest);
        rig.group(|_| {});
    }
    assert_eq!(rig.daemon.state(), DaemonState::SelfTest, "the backend was not verified");
    rig.send(DaemonEvent::BackendVerified);
    assert_eq!(rig.group(|_| {}).state, DaemonState::Ready);
    assert!(!rig.daemon.wants_backend_check());
}

#[test]
fn a_start_that_takes_more_than_ten_seconds_ends_the_process() {
    let mut rig = DaemonRig::new();
    rig.send(DaemonEvent::Started);
    rig.now_ns = START_NS + 10 * SECOND;
    assert_eq!(rig.send(DaemonEvent::Tick).exit_code, None);
    rig.now_ns += 1;
    assert_eq!(rig.send(DaemonEvent::Tick).exit_code, Some(69));
    // Once ready, a later self-test after an operator's reset is not a start.
    let mut rig = DaemonRig::in_state(DaemonState::Fault);
    rig.now_ns += 60 * SECOND;
    rig.send(DaemonEvent::Operator(OperatorEvent::Reset));
    assert_eq!(rig.send(DaemonEvent::Tick).exit_code, None);
}

#[test]
fn stopped_ends_after_five_good_sets_in_a_row_and_a_bad_one_starts_the_count_again() {
    let mut rig = DaemonRig::in_state(DaemonState::Stopped);
    for _ in 0..4 {
        assert_eq!(rig.group(|_| {}).state, DaemonState::Stopped);
    }
    rig.group(|group| group.sensors[0].rejected = true);
    for _ in 0..4 {
        assert_eq!(rig.group(|_| {}).state, DaemonState::Stopped);
    }
    assert_eq!(rig.group(|_| {}).state, DaemonState::Active);
}

#[test]
fn stopped_ends_in_degraded_while_a_sensor_is_lost() {
    let mut rig = DaemonRig::in_state(DaemonState::Stopped);
    for _ in 0..5 {
        rig.group(|group| group.sensors[0] = SensorFindings::ABSENT);
    }
    assert_eq!((rig.daemon.state(), rig.daemon.reason()), (DaemonState::Degraded, Reason::SensorLost));
    for _ in 0..4 {
        assert_eq!(rig.group(|_| {}).state, DaemonState::Degraded);
    }
    assert_eq!(rig.group(|_| {}).state, DaemonState::Active);
}

#[test]
fn the_fifth_stop_within_a_minute_is_a_fault_and_spread_over_more_it_is_not() {
    for (pause_s, expected) in [(0, DaemonState::Fault), (15, DaemonState::Stopped)] {
        let mut rig = DaemonRig::in_state(DaemonState::Active);
        let mut state = rig.daemon.state();
        for _ in 0..5 {
            rig.now_ns += pause_s * SECOND;
            state = rig.group(|group| group.view_missing = true).state;
            for _ in 0..5 {
                rig.group(|_| {});
            }
        }
        assert_eq!(state, expected, "{pause_s} s between stops");
    }
}

#[test]
fn a_flapping_sensor_never_moves_the_robot_between_its_failures() {
    let mut rig = DaemonRig::in_state(DaemonState::Stopped);
    for round in 0..500 {
        let output = rig.group(|group| group.view_missing = round % 2 == 0);
        assert_eq!(output.state, DaemonState::Stopped);
    }
}

#[test]
fn silence_and_two_missed_deadlines_stop_a_moving_daemon() {
    for state in [DaemonState::Active, DaemonState::Degraded] {
        let mut rig = DaemonRig::in_state(state);
        rig.group(|group| {
            group.sensors[1] = if state == DaemonState::Active { SensorFindings::GOOD } else { SensorFindings::ABSENT }
        });
        rig.now_ns += 260 * MS;
        assert_eq!(rig.send(DaemonEvent::Tick).state, state, "captured exactly 300 ms ago");
        rig.now_ns += 1;
        let output = rig.send(DaemonEvent::Tick);
        assert_eq!((output.state, output.reason), (DaemonState::Stopped, Reason::PingTooOld));

        let mut rig = DaemonRig::in_state(state);
        rig.send(DaemonEvent::DeadlineMissed);
        let output = rig.send(DaemonEvent::DeadlineMissed);
        assert_eq!((output.state, output.reason), (DaemonState::Stopped, Reason::DeadlineMissed));

        let mut rig = DaemonRig::in_state(state);
        rig.send(DaemonEvent::DeadlineMissed);
        rig.group(|group| {
            group.sensors[1] = if state == DaemonState::Active { SensorFindings::GOOD } else { SensorFindings::ABSENT }
        });
        assert_eq!(rig.send(DaemonEvent::DeadlineMissed).state, state, "not in a row");
    }
}

#[test]
fn sets_from_the_past_and_from_the_future_stop_at_their_limits() {
    for (offset_ns, expected) in [
        (-(300 * MS).cast_signed(), DaemonState::Active),
        (-(300 * MS).cast_signed() - 1, DaemonState::Stopped),
        ((50 * MS).cast_signed(), DaemonState::Active),
        ((50 * MS).cast_signed() + 1, DaemonState::Stopped),
        (i64::MAX, DaemonState::Stopped),
        (i64::MIN, DaemonState::Stopped),
    ] {
        let mut rig = DaemonRig::in_state(DaemonState::Active);
        let now_ns = rig.now_ns + 100 * MS;
        let output = rig.group(|group| group.captured_at_ns = now_ns.wrapping_add_signed(offset_ns));
        assert_eq!(output.state, expected, "{offset_ns} ns");
    }
}

#[test]
fn nine_dead_channels_stop_at_once_and_are_a_fault_at_the_fifth_set() {
    let mut rig = DaemonRig::in_state(DaemonState::Active);
    for _ in 0..4 {
        assert_eq!(rig.group(|group| group.sensors[0].bad_channels = 9).state, DaemonState::Stopped);
    }
    let output = rig.group(|group| group.sensors[0].bad_channels = 9);
    assert_eq!((output.state, output.reason), (DaemonState::Fault, Reason::ChannelsDead));
}

#[test]
fn a_fault_is_left_by_reset_then_self_test_then_arm_only() {
    let mut rig = DaemonRig::in_state(DaemonState::Fault);
    for _ in 0..100 {
        rig.group(|_| {});
    }
    assert_eq!(rig.arm().refusal, Some(Reason::ArmNotReady));
    assert_eq!(rig.daemon.state(), DaemonState::Fault);
    rig.send(DaemonEvent::Operator(OperatorEvent::Reset));
    assert!(rig.daemon.wants_backend_check());
    rig.send(DaemonEvent::BackendVerified);
    for _ in 0..20 {
        rig.group(|_| {});
    }
    assert_eq!(rig.daemon.state(), DaemonState::Ready, "never moves by itself");
    assert_eq!(rig.arm().state, DaemonState::Active);
}

#[test]
fn an_arm_request_from_before_a_stop_or_from_another_time_is_refused() {
    let mut rig = DaemonRig::in_state(DaemonState::Active);
    let asked_ns = rig.now_ns;
    rig.now_ns += 10 * MS;
    rig.send(DaemonEvent::Operator(OperatorEvent::Stop));
    rig.now_ns += 10 * MS;
    for requested_at_ns in [asked_ns, rig.now_ns + 51 * MS, rig.now_ns - SECOND - 1, 0, u64::MAX] {
        let output = rig.send(DaemonEvent::Operator(OperatorEvent::Arm { epoch: EPOCH, requested_at_ns }));
        assert_eq!((output.state, output.refusal), (DaemonState::Ready, Some(Reason::ArmOutdated)));
    }
    assert_eq!(rig.arm().state, DaemonState::Active);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2_000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_daemon_never_moves_without_arming_and_never_resumes_from_a_fault(
        events in prop::collection::vec(0..12_u8, 1..300),
    ) {
        let mut rig = DaemonRig::new();
        let mut armed = false;
        for event in events {
            let output = match event {
                0 => rig.send(DaemonEvent::Started),
                1 => rig.send(DaemonEvent::BackendVerified),
                2 => rig.group(|group| group.view_missing = true),
                3 => rig.group(|group| group.sensors[0].frozen = true),
                4 => rig.group(|group| group.sensors[0] = SensorFindings::ABSENT),
                5 => rig.send(DaemonEvent::Operator(OperatorEvent::Stop)),
                6 => rig.send(DaemonEvent::Operator(OperatorEvent::Reset)),
                7 => {
                    armed = armed || rig.daemon.state() == DaemonState::Ready;
                    rig.arm()
                }
                8 => rig.send(DaemonEvent::DeadlineMissed),
                _ => rig.group(|_| {}),
            };
            if event == 5 || output.state == DaemonState::Fault {
                armed = false;
            }
            prop_assert!(armed || !output.state.allows_motion(), "{:?}", output);
        }
    }
}
