//! Contract: the controller's gate does exactly what the safe-state contract says for every (state, event) pair, to the
//! nanosecond at its time limits; zero is immediate outside TRACK, and LATCHED is left by a new arming only.

mod checks;
mod safety_rig;

use noctule::safety::{
    DaemonState, Gate, GateEvent, GateParams, GateState, MotionLimits, OperatorEvent, Reason, Verdict,
};
use noctule::signal::Velocity;
use safety_rig::{EPOCH, GateRig, MS, START_NS, at, command, gate_params};

/// Name of an event, how to make it, and the state after it in WAIT, TRACK, HOLD and LATCHED.
type GateRow = (&'static str, fn(&mut GateRig) -> GateEvent, [GateState; 4]);

/// The whole contract of the gate: an event, and the state that WAIT (armed), TRACK, HOLD, LATCHED go to.
fn gate_table() -> Vec<GateRow> {
    use GateState::{Hold as H, Latched as L, Track as T, Wait as W};
    vec![
        ("good command", |r| GateEvent::Command(r.next()), [W, T, H, L]),
        ("tick", |_| GateEvent::Tick, [W, T, H, L]),
        (
            "repeated number",
            |r| {
                r.sequence -= 1;
                GateEvent::Command(r.next())
            },
            [W, T, H, L],
        ),
        (
            "number gone back",
            |r| {
                r.sequence -= 3;
                GateEvent::Command(r.next())
            },
            [W, T, H, L],
        ),
        (
            "300 ms old",
            |r| {
                let mut c = r.next();
                c.captured_at_ns = r.now_ns - 300 * MS;
                GateEvent::Command(c)
            },
            [W, T, H, L],
        ),
        (
            "older than 300 ms",
            |r| {
                let mut c = r.next();
                c.captured_at_ns = r.now_ns - 300 * MS - 1;
                GateEvent::Command(c)
            },
            [W, H, H, L],
        ),
        (
            "50 ms ahead",
            |r| {
                let mut c = r.next();
                c.captured_at_ns = r.now_ns + 50 * MS;
                GateEvent::Command(c)
            },
            [W, T, H, L],
        ),
        (
            "more than 50 ms ahead",
            |r| {
                let mut c = r.next();
                c.captured_at_ns = r.now_ns + 50 * MS + 1;
                GateEvent::Command(c)
            },
            [W, H, H, L],
        ),
        (
            "validity ended",
            |r| {
                let mut c = r.next();
                c.valid_until_ns = r.now_ns - 1;
                GateEvent::Command(c)
            },
            [W, H, H, L],
        ),
        (
            "daemon READY",
            |r| {
                let mut c = r.next();
                c.daemon_state = Some(DaemonState::Ready);
                GateEvent::Command(c)
            },
            [W, H, H, L],
        ),
        (
            "daemon SHUTDOWN",
            |r| {
                let mut c = r.next();
                c.daemon_state = Some(DaemonState::Shutdown);
                GateEvent::Command(c)
            },
            [W, H, H, L],
        ),
        (
            "unknown state",
            |r| {
                let mut c = r.next();
                c.daemon_state = None;
                GateEvent::Command(c)
            },
            [W, H, H, L],
        ),
        (
            "daemon DEGRADED",
            |r| {
                let mut c = r.next();
                c.daemon_state = Some(DaemonState::Degraded);
                GateEvent::Command(c)
            },
            [W, T, H, L],
        ),
        (
            "other epoch",
            |r| {
                let mut c = r.next();
                c.epoch += 1;
                GateEvent::Command(c)
            },
            [W, L, L, L],
        ),
        (
            "other publisher",
            |r| {
                let mut c = r.next();
                c.publisher.0 += 1;
                GateEvent::Command(c)
            },
            [W, L, L, L],
        ),
        (
            "other transport",
            |r| {
                let mut c = r.next();
                c.publisher.1 += 1;
                GateEvent::Command(c)
            },
            [W, L, L, L],
        ),
        (
            "bad checksum",
            |r| {
                let mut c = r.next();
                c.checksum_matches = false;
                GateEvent::Command(c)
            },
            [W, L, L, L],
        ),
        (
            "bad schema",
            |r| {
                let mut c = r.next();
                c.schema_matches = false;
                GateEvent::Command(c)
            },
            [W, L, L, L],
        ),
        (
            "NaN",
            |r| {
                let mut c = r.next();
                c.velocity.linear_m_s = f64::NAN;
                GateEvent::Command(c)
            },
            [W, L, L, L],
        ),
        (
            "infinity",
            |r| {
                let mut c = r.next();
                c.velocity.angular_rad_s = f64::NEG_INFINITY;
                GateEvent::Command(c)
            },
            [W, L, L, L],
        ),
        (
            "10 % too fast",
            |r| {
                let mut c = r.next();
                c.velocity.linear_m_s = -0.55;
                GateEvent::Command(c)
            },
            [W, T, H, L],
        ),
        (
            "more than 10 % too fast",
            |r| {
                let mut c = r.next();
                c.velocity.linear_m_s = -0.551;
                GateEvent::Command(c)
            },
            [W, L, L, L],
        ),
        (
            "turns too fast",
            |r| {
                let mut c = r.next();
                c.velocity.angular_rad_s = 1.101;
                GateEvent::Command(c)
            },
            [W, L, L, L],
        ),
        ("operator stop", |_| GateEvent::Operator(OperatorEvent::Stop), [L, L, L, L]),
        ("operator reset", |_| GateEvent::Operator(OperatorEvent::Reset), [W, T, H, L]),
        (
            "arm, same epoch",
            |r| GateEvent::Operator(OperatorEvent::Arm { epoch: EPOCH, requested_at_ns: r.now_ns }),
            [W, T, H, W],
        ),
        (
            "arm, other epoch",
            |r| GateEvent::Operator(OperatorEvent::Arm { epoch: EPOCH + 1, requested_at_ns: r.now_ns }),
            [W, W, W, W],
        ),
        (
            "arm, outdated",
            |_| GateEvent::Operator(OperatorEvent::Arm { epoch: EPOCH + 1, requested_at_ns: START_NS }),
            [W, T, H, L],
        ),
    ]
}

/// Number of a kind of event. A new kind does not compile until it has a number, and the table below then lacks it.
fn kind(event: &GateEvent) -> usize {
    match event {
        GateEvent::Tick => 0,
        GateEvent::Command(_) => 1,
        GateEvent::Operator(OperatorEvent::Arm { .. }) => 2,
        GateEvent::Operator(OperatorEvent::Stop) => 3,
        GateEvent::Operator(OperatorEvent::Reset) => 4,
    }
}

#[test]
fn every_state_and_event_of_the_gate_goes_where_the_contract_says() {
    let (mut pairs, mut kinds) = (0, std::collections::BTreeSet::new());
    let asked = gate_table().len() * GateState::ALL.len();
    for (name, event, after) in gate_table() {
        for (&state, &expected) in GateState::ALL.iter().zip(&after) {
            let mut rig = GateRig::in_state(state);
            if state == GateState::Wait {
                // A publisher to compare with.
                rig.command(|_| {});
            }
            rig.now_ns += 10 * MS;
            let event = event(&mut rig);
            kinds.insert(kind(&event));
            pairs += 1;
            let output = rig.send(event);
            assert_eq!(output.state, expected, "{name} in {state}: {:?}", output.verdict);
            assert_eq!(output.transition.is_some(), state != expected, "{name} in {state} is told once");
            if expected != GateState::Track {
                assert_eq!(output.velocity, Velocity::ZERO, "{name} in {state}: zero is immediate");
            }
        }
    }
    let told = format!("{pairs}, {} of 5", kinds.len());
    checks::figure(16, "pairs of state and event of the controller, kinds of events in them", told, "100 %", asked);
    assert_eq!((pairs, kinds.len()), (asked, 5));
}

#[test]
fn track_needs_arming_and_five_fresh_commands_in_a_row() {
    let mut rig = GateRig::new();
    for _ in 0..50 {
        assert_eq!(rig.command(|_| {}).state, GateState::Wait, "not armed");
    }
    rig.arm();
    for _ in 0..4 {
        assert_eq!(rig.command(|_| {}).state, GateState::Wait);
    }
    rig.command(|sample| sample.captured_at_ns -= 300 * MS);
    for _ in 0..4 {
        assert_eq!(rig.command(|_| {}).state, GateState::Wait, "counted again from the beginning");
    }
    let output = rig.command(|_| {});
    assert_eq!((output.state, output.verdict), (GateState::Track, Verdict::Accepted));
    assert_eq!(output.velocity, Velocity::ZERO, "moves from the next tick on");
    assert!(rig.tick().velocity.linear_m_s > 0.0);
}

#[test]
fn hold_ends_after_five_fresh_commands_of_the_same_epoch() {
    let mut rig = GateRig::in_state(GateState::Hold);
    for _ in 0..4 {
        assert_eq!(rig.command(|_| {}).state, GateState::Hold);
    }
    assert_eq!(rig.command(|_| {}).state, GateState::Track);
}

#[test]
fn commands_of_a_stopped_daemon_are_fresh_but_do_not_end_hold() {
    let mut rig = GateRig::in_state(GateState::Hold);
    for _ in 0..10 {
        assert_eq!(rig.command(|sample| sample.daemon_state = Some(DaemonState::Stopped)).state, GateState::Hold);
    }
    assert_eq!(rig.command(|_| {}).state, GateState::Track, "the first command of the recovered daemon");
}

#[test]
fn a_daemon_that_dies_is_held_within_age_and_one_tick_and_latched_after_ten_seconds() {
    let mut rig = GateRig::in_state(GateState::Track);
    let captured_ns = rig.now_ns - 40 * MS;
    let mut output = rig.tick();
    while output.velocity != Velocity::ZERO || output.state == GateState::Track {
        output = rig.tick();
    }
    assert!(rig.now_ns - captured_ns <= 320 * MS, "{} ms", (rig.now_ns - captured_ns) / MS);
    let held_ns = rig.now_ns;
    while output.state == GateState::Hold {
        output = rig.tick();
        assert_eq!(output.velocity, Velocity::ZERO);
    }
    assert_eq!((output.state, output.reason), (GateState::Latched, Reason::HoldTooLong));
    assert!((10_000 * MS..=10_020 * MS).contains(&(rig.now_ns - held_ns)));
}

#[test]
fn a_sequence_that_stands_still_is_held_after_300_ms_even_with_new_stamps() {
    let mut rig = GateRig::in_state(GateState::Track);
    let sequence = rig.sequence;
    let since_ns = rig.now_ns;
    while rig.gate.state() == GateState::Track {
        rig.tick();
        let sample = command(sequence, rig.now_ns);
        rig.send(GateEvent::Command(sample));
        assert!(rig.now_ns - since_ns <= 320 * MS);
    }
    assert_eq!(rig.gate.state(), GateState::Hold);
}

#[test]
fn the_earlier_of_validity_and_age_ends_tracking() {
    let mut rig = GateRig::in_state(GateState::Track);
    rig.command(|sample| sample.valid_until_ns = sample.captured_at_ns + 100 * MS);
    let captured_ns = rig.now_ns - 40 * MS;
    while rig.tick().state == GateState::Track {}
    assert!(rig.now_ns - captured_ns <= 120 * MS);
}

#[test]
fn latched_never_resumes_by_itself_and_a_copy_of_the_old_arming_does_not_help() {
    let mut rig = GateRig::new();
    rig.arm();
    let armed_ns = rig.now_ns;
    for _ in 0..5 {
        rig.command(|_| {});
    }
    rig.command(|sample| sample.checksum_matches = false);
    for _ in 0..200 {
        rig.send(GateEvent::Operator(OperatorEvent::Arm { epoch: EPOCH, requested_at_ns: armed_ns }));
        let output = rig.command(|_| {});
        assert_eq!((output.state, output.velocity), (GateState::Latched, Velocity::ZERO));
    }
    rig.arm();
    for _ in 0..5 {
        rig.command(|_| {});
    }
    assert_eq!(rig.gate.state(), GateState::Track);
}

#[test]
fn a_new_gate_refuses_an_arming_from_before_its_start() {
    let mut rig = GateRig::new();
    rig.now_ns += 100 * MS;
    let output = rig.send(GateEvent::Operator(OperatorEvent::Arm { epoch: EPOCH, requested_at_ns: START_NS - MS }));
    assert_eq!(output.verdict, Verdict::Refused(Reason::ArmOutdated));
}

#[test]
fn limits_that_are_nan_or_zero_mean_standing_still() {
    for bad in [f64::NAN, 0.0, -1.0] {
        let limits = MotionLimits { linear_m_s: bad, angular_rad_s: bad, linear_m_s2: bad, angular_rad_s2: bad };
        let mut rig = GateRig::new();
        rig.gate = Gate::new(GateParams { limits, ..gate_params() }, at(START_NS));
        rig.arm();
        for _ in 0..10 {
            let output = rig.command(|sample| sample.velocity = Velocity { linear_m_s: 1e-9, angular_rad_s: 1e-9 });
            assert_eq!(output.velocity, Velocity::ZERO);
        }
    }
}
