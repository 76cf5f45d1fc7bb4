//! Contract: no stream of commands, requests and late ticks, however hostile, moves the platform outside its limits, on
//! a stale or foreign command, or without an arming; each protection taken away is noticed by the same judge.

mod checks;
mod safety_rig;

use checks::{figure, trials};
use noctule::safety::{CommandSample, DaemonState, GateEvent, GateOutput, GateState, OperatorEvent, Verdict};
use noctule::signal::Velocity;
use proptest::prelude::*;
use safety_rig::{EPOCH, GateRig, LIMITS, MS, START_NS, command};
use std::cell::Cell;

/// One thing that a broken or hostile world does to the gate.
#[derive(Debug, Clone)]
enum Hostile {
    /// A tick after this time.
    Tick(u64),
    /// A command: sequence step, capture offset from now, V, omega, and which field is spoilt.
    Command(i64, i64, f64, f64, u8),
    /// An arming: epoch offset and request offset from now.
    Arm(u64, i64),
    Stop,
}

fn hostile() -> impl Strategy<Value = Hostile> {
    let value = prop_oneof![
        8 => -0.6..0.6_f64,
        1 => prop::num::f64::ANY,
        1 => prop::sample::select(vec![1e9, -1e9, f64::NAN, f64::INFINITY, -0.0, 0.55, -0.55, 1.1]),
    ];
    let capture = prop_oneof![
        8 => -200_000_000..20_000_000_i64,
        1 => -400_000_000..100_000_000_i64,
        1 => prop::num::i64::ANY,
    ];
    prop_oneof![
        6 => (0..45_u64).prop_map(|ms| Hostile::Tick(ms * MS)),
        1 => (0..2_000_u64).prop_map(|ms| Hostile::Tick(ms * MS)),
        10 => (prop_oneof![9 => Just(1_i64), 1 => -3..5_i64], capture, value.clone(), value, prop_oneof![30 => Just(0_u8), 1 => 1..8_u8])
            .prop_map(|(step, capture, v, w, spoilt)| Hostile::Command(step, capture, v, w, spoilt)),
        1 => (0..2_u64, -2_000_000_000..100_000_000_i64).prop_map(|(epoch, offset)| Hostile::Arm(epoch, offset)),
        1 => Just(Hostile::Arm(0, 0)),
        1 => Just(Hostile::Stop),
    ]
}

/// What stands between the world and the gate: nothing, or a mutant that takes one protection away.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Mutant {
    None,
    /// Every command looks as if captured just now.
    AgeTestRemoved,
    /// A command from the future looks as if captured just now.
    OneSidedAgeTest,
    /// Every command looks as if it came from the armed epoch.
    EpochPinRemoved,
    /// The command goes out as it came.
    ClampRemoved,
    /// Any command in LATCHED arms again.
    LatchRemoved,
}

/// Judges outputs against the contract, from what was really sent. Shares no code with the gate.
#[derive(Default)]
struct Judge {
    armed_epoch: Option<u64>,
    disarmed_at_ns: u64,
    last_velocity: (f64, f64),
    last_tick_ns: Option<u64>,
    newest: Option<(u64, u64)>,
    violations: Vec<String>,
}

impl Judge {
    fn operator(&mut self, request: OperatorEvent, now_ns: u64) {
        match request {
            OperatorEvent::Stop => (self.armed_epoch, self.disarmed_at_ns) = (None, now_ns),
            OperatorEvent::Arm { epoch, requested_at_ns } => {
                let age_ns = i128::from(now_ns) - i128::from(requested_at_ns);
                if (-50_000_000..=1_000_000_000).contains(&age_ns) && requested_at_ns > self.disarmed_at_ns {
                    self.armed_epoch = Some(epoch);
                }
            }
            OperatorEvent::Reset => {}
        }
    }

    /// Notes what the gate was truly given; `followed` says that it claims to follow it.
    fn command(&mut self, sample: &CommandSample, followed: bool, now_ns: u64) {
        if followed {
            self.newest = Some((sample.captured_at_ns, sample.epoch));
            if !sample.velocity.is_finite() || !sample.checksum_matches || !sample.schema_matches {
                self.violations.push(format!("follows a spoilt command at {now_ns}"));
            }
        }
    }

    fn output(&mut self, output: &GateOutput, ticked: bool, now_ns: u64) {
        let (v, w) = (output.velocity.linear_m_s, output.velocity.angular_rad_s);
        let mut violation = |what: &str| self.violations.push(format!("{what}: {v} {w} at {now_ns}"));
        if !v.is_finite() || !w.is_finite() || v.abs() > LIMITS.linear_m_s || w.abs() > LIMITS.angular_rad_s {
            violation("outside the limits");
        }
        let moves = v != 0.0 || w != 0.0;
        if moves && output.state != GateState::Track {
            violation("moves outside TRACK");
        }
        if moves && self.armed_epoch.is_none() {
            violation("moves unarmed");
        }
        if moves && ticked {
            match self.newest {
                Some((captured_ns, epoch)) => {
                    let age_ns = i128::from(now_ns) - i128::from(captured_ns);
                    if !(-50_000_000..=300_000_000).contains(&age_ns) {
                        violation("moves on a stale command");
                    }
                    if Some(epoch) != self.armed_epoch {
                        violation("moves for another epoch");
                    }
                }
                None => violation("moves without a command"),
            }
            let elapsed_s = self.last_tick_ns.map_or(f64::INFINITY, |last_ns| (now_ns - last_ns) as f64 * 1e-9);
            // A rounding error of the sums, far below any wheel's resolution.
            let slack = 1e-12;
            if (v - self.last_velocity.0).abs() > LIMITS.linear_m_s2 * elapsed_s + slack
                || (w - self.last_velocity.1).abs() > LIMITS.angular_rad_s2 * elapsed_s + slack
            {
                violation("faster than the rate limits");
            }
        }
        if ticked {
            self.last_tick_ns = Some(now_ns);
        }
        self.last_velocity = (v, w);
        if output.state == GateState::Latched && self.armed_epoch.is_some() {
            (self.armed_epoch, self.disarmed_at_ns) = (None, now_ns);
        }
    }
}

/// Runs a hostile stream through a (mutated) gate and returns what the judge found.
fn violations(stream: &[Hostile], mutant: Mutant) -> Vec<String> {
    let mut rig = GateRig::new();
    let mut judge = Judge { disarmed_at_ns: START_NS, ..Judge::default() };
    rig.now_ns += MS;
    for action in stream {
        let event = match *action {
            Hostile::Tick(after_ns) => {
                rig.now_ns += after_ns;
                GateEvent::Tick
            }
            Hostile::Stop => GateEvent::Operator(OperatorEvent::Stop),
            Hostile::Arm(offset, request_ns) => GateEvent::Operator(OperatorEvent::Arm {
                epoch: EPOCH + offset,
                requested_at_ns: rig.now_ns.saturating_add_signed(request_ns),
            }),
            Hostile::Command(step, capture_ns, v, w, spoilt) => {
                rig.sequence = rig.sequence.wrapping_add_signed(step);
                let mut sample = command(rig.sequence, rig.now_ns.wrapping_add_signed(capture_ns));
                sample.valid_until_ns = u64::MAX;
                sample.velocity = Velocity { linear_m_s: v, angular_rad_s: w };
                match spoilt {
                    1 => sample.epoch += 1,
                    2 => sample.checksum_matches = false,
                    3 => sample.schema_matches = false,
                    4 => sample.publisher.0 += 1,
                    5 => sample.publisher.1 += 1,
                    6 => sample.daemon_state = None,
                    7 => sample.daemon_state = Some(DaemonState::Stopped),
                    _ => {}
                }
                GateEvent::Command(sample)
            }
        };
        if let GateEvent::Operator(request) = event {
            judge.operator(request, rig.now_ns);
        }
        let given = mutate(event, mutant, &mut rig);
        let mut output = rig.send(given);
        if let GateEvent::Command(sample) = event {
            judge.command(&sample, output.verdict == Verdict::Accepted, rig.now_ns);
            if mutant == Mutant::ClampRemoved && output.verdict == Verdict::Accepted {
                output.velocity = sample.velocity;
            }
        }
        judge.output(&output, event == GateEvent::Tick, rig.now_ns);
    }
    judge.violations
}

fn mutate(event: GateEvent, mutant: Mutant, rig: &mut GateRig) -> GateEvent {
    let GateEvent::Command(mut sample) = event else { return event };
    let now_ns = rig.now_ns;
    match mutant {
        Mutant::AgeTestRemoved => sample.captured_at_ns = now_ns,
        Mutant::OneSidedAgeTest if now_ns.wrapping_sub(sample.captured_at_ns).cast_signed() < 0 => {
            sample.captured_at_ns = now_ns;
        }
        Mutant::EpochPinRemoved => sample.epoch = rig.gate.armed_epoch().unwrap_or(sample.epoch),
        Mutant::LatchRemoved if rig.gate.state() == GateState::Latched => {
            rig.now_ns += 1;
            let again = OperatorEvent::Arm { epoch: EPOCH, requested_at_ns: rig.now_ns };
            rig.send(GateEvent::Operator(again));
        }
        _ => {}
    }
    GateEvent::Command(sample)
}

/// A stream in which every protection is needed once: armed, five commands, then the fault.
fn staged(fault: Hostile, repeats: usize) -> Vec<Hostile> {
    let mut stream = vec![Hostile::Arm(0, 0)];
    for _ in 0..12 {
        stream.push(Hostile::Command(1, -40_000_000, 0.3, 0.1, 0));
        stream.extend([Hostile::Tick(20 * MS), Hostile::Tick(20 * MS)]);
    }
    for _ in 0..repeats {
        stream.push(fault.clone());
        stream.push(Hostile::Tick(20 * MS));
    }
    for _ in 0..12 {
        stream.push(Hostile::Command(1, -40_000_000, 0.3, 0.1, 0));
        stream.push(Hostile::Tick(20 * MS));
    }
    stream
}

#[test]
fn each_mutant_is_caught_by_the_judge_and_the_gate_itself_is_not() {
    let cases = [
        (Mutant::AgeTestRemoved, Hostile::Command(1, -900_000_000, 0.3, 0.1, 0)),
        (Mutant::OneSidedAgeTest, Hostile::Command(1, 900_000_000, 0.3, 0.1, 0)),
        (Mutant::EpochPinRemoved, Hostile::Command(1, -40_000_000, 0.3, 0.1, 1)),
        (Mutant::ClampRemoved, Hostile::Command(1, -40_000_000, 0.54, 0.1, 0)),
        (Mutant::LatchRemoved, Hostile::Command(1, -40_000_000, 0.3, 0.1, 2)),
    ];
    for (mutant, fault) in cases {
        let stream = staged(fault, 5);
        assert_eq!(violations(&stream, Mutant::None), Vec::<String>::new(), "{mutant:?}");
        assert!(!violations(&stream, mutant).is_empty(), "{mutant:?} was not caught");
    }
}

#[test]
fn hostile_streams_do_drive_so_that_their_test_means_something() {
    let mut rig = GateRig::new();
    let mut driven = 0;
    rig.now_ns += MS;
    for action in staged(Hostile::Command(1, -40_000_000, 0.54, 1.05, 0), 100) {
        match action {
            Hostile::Tick(after_ns) => {
                rig.now_ns += after_ns;
                driven += u32::from(rig.send(GateEvent::Tick).velocity != Velocity::ZERO);
            }
            Hostile::Command(..) => {
                let sample = rig.next();
                rig.send(GateEvent::Command(sample));
            }
            _ => drop(rig.arm()),
        }
    }
    assert!(driven > 100, "{driven} ticks with motion");
}

/// Half of the streams fall upon a gate that already drives; some 400 outputs a stream are judged.
#[test]
fn no_hostile_stream_moves_the_platform_outside_the_contract() {
    let cases = trials(2_600, 400);
    let outputs = Cell::new(0);
    let config = ProptestConfig { cases: cases as u32, failure_persistence: None, ..ProptestConfig::default() };
    proptest!(config, |(driving in any::<bool>(), hostile in prop::collection::vec(hostile(), 1..800))| {
        let mut stream = if driving { staged(Hostile::Tick(0), 0) } else { Vec::new() };
        stream.extend(hostile);
        outputs.set(outputs.get() + stream.len());
        prop_assert_eq!(violations(&stream, Mutant::None), Vec::<String>::new());
    });
    figure(8, "outputs of the gate outside limits, stale, foreign or unarmed", 0, "0", outputs.get());
    assert!(outputs.get() >= 300 * cases, "{} outputs", outputs.get());
}

#[test]
fn a_spoilt_command_latches_before_the_next_tick() {
    for spoilt in [2, 3, 4, 5] {
        for velocity in [Velocity { linear_m_s: 0.3, angular_rad_s: 0.1 }, Velocity::ZERO] {
            let mut rig = GateRig::in_state(GateState::Track);
            let output = rig.command(|sample| {
                sample.velocity = velocity;
                match spoilt {
                    2 => sample.checksum_matches = false,
                    3 => sample.schema_matches = false,
                    4 => sample.velocity.linear_m_s = f64::NAN,
                    _ => sample.velocity.angular_rad_s = f64::INFINITY,
                }
            });
            assert_eq!((output.state, output.velocity), (GateState::Latched, Velocity::ZERO), "{spoilt}");
            assert_eq!(rig.tick().velocity, Velocity::ZERO);
        }
    }
    figure(8, "spoilt command to LATCHED and zero, ms", 0, "<= 20", 8);
}
