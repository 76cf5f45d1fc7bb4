//! Contract: for any cues and inputs whatever, in any order, every command is finite, within the platform's limits and rates, and
//! never faster than wanted outside collision avoidance's reverse; mirrored cues give mirrored commands.

mod checks;

use checks::{figure, trials};
use noctule::control::{ControlParams, Controller, PlatformLimits};
use noctule::geometry::Pose2;
use noctule::signal::{
    CoverageCue, Cues, Decision, LayerCue, LayerName, NearestReflection, SENSORS_MAX, SensorSums, Velocity,
    WALL_PEAKS_MAX, WallPeak, WallPeaks,
};
use noctule::time::Stamp;
use proptest::prelude::*;
use std::cell::Cell;

const START: Stamp = Stamp { boottime_ns: 1_000_000_000_000, wall_ns: 0 };
const PERIOD_NS: u64 = 100_000_000;

fn any_f32() -> impl Strategy<Value = f32> {
    prop_oneof![
        4 => -2.0..20.0f32,
        2 => Just(0.0f32),
        1 => prop::sample::select(vec![f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e38, -1e38, 1e-42, -0.0, f32::MIN_POSITIVE]),
        1 => any::<f32>(),
    ]
}

fn any_f64() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => -3.0..3.0f64,
        1 => prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e308, -1e38, 5e-324, -0.0, 0.0]),
        1 => any::<f64>(),
    ]
}

fn any_region() -> impl Strategy<Value = LayerCue> {
    let place = (any_f64(), any_f64());
    let nearest = (0..5usize, any_f64(), any_f64(), any_f64(), any_f32(), -1..=1i8, place).prop_map(
        |(sensor_index, range_m, bearing_rad, distance_m, energy, side, place)| NearestReflection {
            sensor_index,
            range_m,
            bearing_rad,
            distance_m,
            place_m: place.into(),
            energy,
            side,
            lead_m: f64::INFINITY,
        },
    );
    (any_f32(), any_f32(), any_f32(), prop::option::of(nearest)).prop_map(|(energy, turn, peak, nearest)| LayerCue {
        energy,
        turn,
        peak,
        sensors: [SensorSums::default(); SENSORS_MAX],
        nearest,
    })
}

fn any_cues() -> impl Strategy<Value = Cues> {
    let walls = (0..=WALL_PEAKS_MAX + 1, prop::array::uniform8((any_f64(), any_f64()))).prop_map(|(count, peaks)| {
        WallPeaks { count, peaks: peaks.map(|(lateral_m, strength)| WallPeak { lateral_m, strength }) }
    });
    let coverage = (any_f64(), any_f64()).prop_map(|(ahead_m, behind_m)| CoverageCue { ahead_m, behind_m });
    (any_region(), any_region(), any_region(), walls, coverage, prop::array::uniform3(prop::bool::weighted(0.8)))
        .prop_map(|(collision, obstacle, corridor, walls, coverage, sensors_used)| Cues {
            sensors_used,
            collision,
            obstacle,
            corridor,
            walls,
            coverage,
            ..Cues::default()
        })
}

#[derive(Debug, Clone)]
struct Input {
    cues: Cues,
    wanted: Velocity,
    pose: Option<Pose2>,
    step_ns: u64,
    age_ns: i64,
}

fn any_input() -> impl Strategy<Value = Input> {
    let pose = (any_f64(), any_f64(), any_f64()).prop_map(|(x_m, y_m, heading_rad)| Pose2 { x_m, y_m, heading_rad });
    let step_ns = prop_oneof![4 => Just(PERIOD_NS), 1 => 0..2_000_000_000u64];
    let age_ns = prop_oneof![4 => 0..200_000_000i64, 1 => -100_000_000..500_000_000i64];
    (any_cues(), (any_f64(), any_f64()), prop::option::of(pose), step_ns, age_ns).prop_map(
        |(cues, (linear_m_s, angular_rad_s), pose, step_ns, age_ns)| Input {
            cues,
            wanted: Velocity { linear_m_s, angular_rad_s },
            pose,
            step_ns,
            age_ns,
        },
    )
}

/// What is wrong with a decision, if anything; `before` is the velocity before it.
fn fault(input: &Input, decision: &Decision, before: Velocity, limits: &PlatformLimits) -> Option<&'static str> {
    let (v, w) = (decision.velocity.linear_m_s, decision.velocity.angular_rad_s);
    let growth_s = 0.2 + 1e-9;
    let reverse = decision.layer == LayerName::CollisionAvoidance && v < 0.0;
    let stale = !(-50_000_000..=300_000_000).contains(&input.age_ns);
    let seen_m = if v >= 0.0 { input.cues.coverage.ahead_m } else { input.cues.coverage.behind_m };
    let stopping_m = v.abs() * 0.35 + v * v / (2.0 * limits.max_linear_accel_m_s2);
    let check = [
        (v.is_finite() && w.is_finite() && decision.speed_limit_m_s.is_finite(), "not finite"),
        (v.abs() <= limits.max_linear_m_s && w.abs() <= limits.max_angular_rad_s, "beyond the platform's limits"),
        (reverse || v == 0.0 || v.abs() <= input.wanted.linear_m_s.abs(), "faster than wanted"),
        (reverse || v == 0.0 || v.signum() == input.wanted.linear_m_s.signum(), "against the wanted direction"),
        (!reverse || v >= -0.1 - 1e-12, "reverse too fast"),
        (v == 0.0 || stopping_m <= seen_m + 1e-9, "faster than the way is seen"),
        (v.abs() <= before.linear_m_s.abs() + limits.max_linear_accel_m_s2 * growth_s, "speeds up too fast"),
        (w.abs() <= before.angular_rad_s.abs() + limits.max_angular_accel_rad_s2 * growth_s, "turns faster too fast"),
        (!stale || decision.velocity == Velocity::ZERO, "moves on stale cues"),
        (input.wanted.is_finite() || decision.velocity == Velocity::ZERO, "moves on an input that is no number"),
        (input.cues.collision.energy <= 0.3 || v <= 0.0, "drives on into the CA region"),
        (decision.emitted_at == input.cues.emitted_at, "loses the emission time"),
    ];
    check.into_iter().find(|(holds, _)| !holds).map(|(_, fault)| fault)
}

fn run(mut inputs: Vec<Input>, spoil: impl Fn(&Input, &mut Decision)) -> Option<&'static str> {
    let limits = PlatformLimits::default();
    let mut controller = Controller::new(&ControlParams::default(), &limits);
    let (mut now, mut before) = (START, Velocity::ZERO);
    for input in &mut inputs {
        now = now.plus_ns(input.step_ns);
        input.cues.emitted_at.boottime_ns = now.boottime_ns.wrapping_sub(input.age_ns.cast_unsigned());
        let mut decision = controller.step_with_odometry(now, &input.cues, input.wanted, input.pose);
        spoil(input, &mut decision);
        if let Some(fault) = fault(input, &decision, before, &limits) {
            return Some(fault);
        }
        before = decision.velocity;
    }
    None
}

/// A region as heard by a robot mirrored at its x axis.
fn mirrored_region(region: &LayerCue) -> LayerCue {
    let mirrored = |nearest: NearestReflection| NearestReflection {
        bearing_rad: -nearest.bearing_rad,
        place_m: [nearest.place_m[0], -nearest.place_m[1]],
        side: -nearest.side,
        ..nearest
    };
    LayerCue { turn: -region.turn, nearest: region.nearest.map(mirrored), ..*region }
}

fn mirrored(cues: &Cues) -> Cues {
    let mut mirror = Cues {
        collision: mirrored_region(&cues.collision),
        obstacle: mirrored_region(&cues.obstacle),
        corridor: mirrored_region(&cues.corridor),
        ..*cues
    };
    mirror.walls.peaks.iter_mut().for_each(|wall| wall.lateral_m = -wall.lateral_m);
    mirror
}

/// Cues of a sound image in which the nearest reflection has a side, in pieces: silence, obstacles, walls.
fn sound_cues() -> impl Strategy<Value = Cues> {
    let region = |scale: f32| {
        (prop::bool::ANY, 0.0..1.0f32, -1.0..1.0f32, any::<bool>()).prop_map(move |(loud, energy, turn, left)| {
            let energy = if loud { scale * energy } else { 0.0 };
            let nearest = NearestReflection {
                sensor_index: 0,
                range_m: 0.5,
                bearing_rad: 0.2,
                distance_m: 0.3,
                place_m: [0.5, if left { 0.1 } else { -0.1 }],
                energy,
                side: if left { 1 } else { -1 },
                lead_m: f64::INFINITY,
            };
            let nearest = (energy > 0.0).then_some(nearest);
            LayerCue { energy, turn: turn * energy, peak: 0.1 * energy, sensors: Default::default(), nearest }
        })
    };
    let walls = (0..4usize, prop::array::uniform8((-2.0..2.0f64, 0.0..1e-3f64))).prop_map(|(count, peaks)| WallPeaks {
        count,
        peaks: peaks.map(|(lateral_m, strength)| WallPeak { lateral_m, strength }),
    });
    (region(0.4), region(5.0), region(5.0), walls, 0.0..3.0f64, 0.0..3.0f64).prop_map(
        |(collision, obstacle, corridor, walls, ahead_m, behind_m)| Cues {
            sensors_used: [true; SENSORS_MAX],
            collision,
            obstacle,
            corridor,
            walls,
            coverage: CoverageCue { ahead_m, behind_m },
            ..Cues::default()
        },
    )
}

/// Runs of some twelve decisions each, of each of the two properties: a million decisions of both in all.
fn cases() -> ProptestConfig {
    ProptestConfig::with_cases(trials(42_000, 2_048) as u32)
}

#[test]
fn no_cues_and_no_input_break_a_limit() {
    let decisions = Cell::new(0);
    proptest!(cases(), |(inputs in prop::collection::vec(any_input(), 1..24))| {
        decisions.set(decisions.get() + inputs.len());
        prop_assert_eq!(run(inputs, |_, _| {}), None);
    });
    let told = format!("0 in {} decisions", decisions.get());
    figure(1, "violations of limits, CA and finiteness", told, "0", cases().cases as usize);
}

#[test]
fn mirrored_cues_give_mirrored_commands() {
    let scene = prop::collection::vec((sound_cues(), -0.3..0.3f64, -1.0..1.0f64, 1..4usize), 1..16);
    proptest!(cases(), |(scene in scene)| {
        let make = || Controller::new(&ControlParams::default(), &PlatformLimits::default());
        let (mut straight, mut mirror) = (make(), make());
        let mut now = START;
        for (mut cues, linear_m_s, angular_rad_s, repeat) in scene {
            for _ in 0..repeat {
                now = now.plus_ns(PERIOD_NS);
                cues.emitted_at = now;
                let a = straight.step(now, &cues, Velocity { linear_m_s, angular_rad_s });
                let b = mirror.step(now, &mirrored(&cues), Velocity { linear_m_s, angular_rad_s: -angular_rad_s });
                prop_assert_eq!(a.layer, b.layer);
                prop_assert_eq!(a.velocity.linear_m_s, b.velocity.linear_m_s);
                prop_assert!((a.velocity.angular_rad_s + b.velocity.angular_rad_s).abs() < 1e-12, "{:?} {:?}", a, b);
            }
        }
    });
    figure(1, "mirrored scenes without the mirrored command", 0, "0", cases().cases as usize);
}

/// Inputs from a fixed seed, for planted faults.
fn some_inputs() -> Vec<Vec<Input>> {
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let strategy = prop::collection::vec(any_input(), 1..24);
    (0..300).map(|_| strategy.new_tree(&mut runner).unwrap().current()).collect()
}

use proptest::strategy::ValueTree;

// Negative controls: each planted fault is one that a careless controller would have.
#[test]
fn planted_faults_are_found() {
    type Spoil = fn(&Input, &mut Decision);
    let faults: [(&str, Spoil); 5] = [
        ("faster than wanted", |_, decision| decision.velocity.linear_m_s *= 1.5),
        ("moves on stale cues", |input, decision| {
            if decision.layer == LayerName::Stopped && input.wanted.is_finite() {
                decision.velocity.angular_rad_s = 0.1;
            }
        }),
        ("drives on into the CA region", |input, decision| {
            if input.cues.collision.energy.is_nan() && input.cues.coverage.ahead_m > 1.0 {
                decision.velocity.linear_m_s = input.wanted.linear_m_s.clamp(0.0, 0.1);
            }
        }),
        ("not finite", |input, decision| {
            if decision.layer == LayerName::ObstacleAvoidance {
                decision.velocity.angular_rad_s -= f64::from(input.cues.obstacle.turn / input.cues.obstacle.energy);
            }
        }),
        ("beyond the platform's limits", |_, decision| decision.velocity.angular_rad_s *= 3.0),
    ];
    let all = some_inputs();
    for (name, spoil) in faults {
        assert!(all.iter().any(|inputs| run(inputs.clone(), spoil) == Some(name)), "{name} goes unnoticed");
    }
    assert!(all.into_iter().all(|inputs| run(inputs, |_, _| {}).is_none()));
}
