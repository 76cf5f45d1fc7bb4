//! Contract: what the controller remembers beyond one ping set gets a robot round an obstacle, out of a corner and away from who is too
//! near to be heard, and is forgotten when it no longer holds; it never drives faster than wanted.

mod control_bench;

use control_bench::{Bench, FORWARD, cue};
use noctule::geometry::Pose2;
use noctule::signal::{LayerCue, LayerName, NearestReflection, SensorSums, Velocity};
use std::f64::consts::PI;

/// GIVEN somebody who comes nearer in the CA zone, WHEN he is too near to be heard, THEN the robot stands and turns until he is
/// abeam; one who fell silent without having come nearer is forgotten at once (the negative control).
#[test]
fn what_comes_too_near_to_be_heard_is_still_there() {
    let unheard_steps = |last_m: f64, range_m: f64| {
        let mut bench = Bench::new(|params| params.stuck.enabled = false);
        // The robot stands: what it hears coming nearer walks.
        bench.cues.collision = cue(1.0, 0.0, 0.1, 1);
        for _ in 0..10 {
            bench.step(FORWARD);
        }
        for distance_m in [0.40, 0.5 * (0.40 + last_m), last_m] {
            bench.cues.collision = cue(1.0, 0.0, 0.1, 1);
            bench.cues.collision.nearest =
                bench.cues.collision.nearest.map(|n| NearestReflection { distance_m, range_m, ..n });
            bench.step(FORWARD);
        }
        bench.cues.collision = LayerCue::default();
        (0..100).take_while(|_| bench.step(FORWARD).velocity.linear_m_s <= 0.0).count()
    };
    // 60 deg at 0.5 rad/s take 21 steps.
    assert!((21..=26).contains(&unheard_steps(0.27, 0.35)), "{}", unheard_steps(0.27, 0.35));
    assert!(unheard_steps(0.38, 0.35) <= 3, "{}", unheard_steps(0.38, 0.35));
    assert!(unheard_steps(0.27, 0.6) <= 3, "heard far from where the sensors are deaf");
}

/// GIVEN a robot that gets nowhere, WHEN the configured time is over, THEN it says so, turns on the spot, and goes on.
#[test]
fn a_stuck_robot_says_so_and_turns_away() {
    let mut bench = Bench::new(|params| params.stuck.time_s = 8.0);
    let here = Pose2::default();
    let blocked_steps = (0..200).take_while(|_| !bench.step_with(FORWARD, Some(here)).stuck).count();
    assert!((78..=82).contains(&blocked_steps), "{blocked_steps} steps of 0.1 s for 8 s");
    let mut pose = here;
    let mut turning_steps = 0;
    loop {
        let decision = bench.step_with(FORWARD, Some(pose));
        if !decision.stuck {
            break;
        }
        assert_eq!(decision.velocity.linear_m_s, 0.0, "the way out is a turn on the spot");
        pose.heading_rad += decision.velocity.angular_rad_s * 0.1;
        turning_steps += 1;
        assert!(turning_steps < 100);
    }
    assert!((pose.heading_rad.abs() - PI / 2.0).abs() < 0.1, "a quarter turn, not {}", pose.heading_rad);
    assert_eq!(bench.step_with(FORWARD, Some(pose)).layer, LayerName::PassThrough);
}

/// GIVEN OA that turns back what a turn wants, WHEN the robot is stuck, THEN the wanted velocity passes for a while, but under CA.
#[test]
fn a_robot_stuck_between_two_turns_first_does_what_is_wanted() {
    let here = Some(Pose2::default());
    let wanted = Velocity { linear_m_s: 0.05, angular_rad_s: 0.5 };
    let mut bench = Bench::new(|_| {});
    bench.cues.obstacle = cue(1.0, 0.5, 0.1, 1);
    let first = (0..100).map(|_| bench.step_with(wanted, here)).find(|decision| decision.stuck).unwrap();
    assert_eq!((first.layer, first.velocity.linear_m_s), (LayerName::PassThrough, 0.05));
    bench.cues.collision = cue(1.0, 0.5, 0.1, 1);
    assert_eq!(bench.step_with(wanted, here).layer, LayerName::CollisionAvoidance);
    bench.cues.collision = LayerCue::default();
    let turn = (0..100).map(|_| bench.step_with(wanted, here)).find(|decision| decision.velocity.linear_m_s == 0.0);
    assert_eq!(turn.map(|decision| decision.layer), Some(LayerName::CollisionAvoidance), "then it turns on the spot");
}

/// GIVEN a robot that moves, or that is not asked to, WHEN time passes, THEN it is not stuck.
#[test]
fn progress_and_rest_are_not_stuck() {
    let mut bench = Bench::new(|_| {});
    assert!((0..300).all(|_| !bench.step(FORWARD).stuck), "the commands themselves are progress");
    let turn = Velocity { linear_m_s: 0.0, angular_rad_s: 0.5 };
    let mut bench = Bench::new(|_| {});
    assert!((0..300).all(|_| !bench.step(turn).stuck), "turning is progress when only that is asked for");
    let (mut bench, still) = (Bench::new(|_| {}), Some(Pose2::default()));
    assert!((0..300).all(|_| !bench.step_with(Velocity::ZERO, still).stuck), "nothing was asked for");
    assert!((0..300).any(|_| bench.step_with(turn, still).stuck), "the turn that was asked for does not come");
    let mut bench = Bench::new(|_| {});
    bench.cues.coverage.ahead_m = 0.0;
    assert!((0..300).any(|_| bench.step(FORWARD).stuck), "without odometry standing still is noticed too");
}

/// Steps with odometry that obeys every command.
fn drive(bench: &mut Bench, pose: &mut Pose2, wanted: Velocity) -> noctule::signal::Decision {
    let decision = bench.step_with(wanted, Some(*pose));
    pose.heading_rad += decision.velocity.angular_rad_s * 0.1;
    pose.x_m += decision.velocity.linear_m_s * 0.1 * pose.heading_rad.cos();
    pose.y_m += decision.velocity.linear_m_s * 0.1 * pose.heading_rad.sin();
    decision
}

/// GIVEN something that CA turned away from, WHEN the wanted velocity turns back to it, THEN the robot passes it at the width of the CA
/// zone; without CA having acted the turn is obeyed and leads into it (the negative control).
#[test]
fn the_way_does_not_lead_back_to_what_was_avoided() {
    // 0.5 m ahead of where the robot stands; a footprint of 0.2 m.
    let place_m = nalgebra::Vector2::new(0.5, 0.0);
    let nearest_m = |avoided: bool| {
        // Reversing is another claim.
        let mut bench = Bench::new(|params| params.collision_avoidance.reverse_m_s = 0.0);
        let mut pose = Pose2::default();
        while avoided && pose.heading_rad < 1.05 {
            bench.cues.collision = cue(1.0, 0.0, 0.1, -1);
            let heard_m = pose.local_from_parent(place_m);
            let nearest = bench.cues.collision.nearest;
            bench.cues.collision.nearest =
                nearest.map(|nearest| NearestReflection { place_m: heard_m.into(), ..nearest });
            drive(&mut bench, &mut pose, FORWARD);
        }
        pose.heading_rad = 1.05;
        bench.cues.collision = LayerCue::default();
        let distances_m = (0..40).map(|_| {
            let towards = pose.local_from_parent(place_m);
            let back = Velocity { linear_m_s: 0.2, angular_rad_s: towards.y.atan2(towards.x).clamp(-0.5, 0.5) };
            drive(&mut bench, &mut pose, back);
            (pose.position_m() - place_m).norm()
        });
        distances_m.fold(f64::INFINITY, f64::min)
    };
    assert!(nearest_m(true) > 0.35, "{}", nearest_m(true));
    assert!(nearest_m(false) < 0.2, "inside the footprint: {}", nearest_m(false));
}

/// GIVEN a corner in which CA turns right again and again and the wanted turn leads back, WHEN that happened three times without
/// progress, THEN the robot turns the other way, and goes on until nothing is near.
#[test]
fn out_of_a_corner_it_turns_the_other_way_until_nothing_is_near() {
    let (mut bench, mut pose) = (Bench::new(|_| {}), Pose2::default());
    // Loud from 20 deg right to 80 deg left, nearest on the left.
    let loud = |heading_rad: f64| (-0.35..1.4).contains(&heading_rad);
    let (mut turned_left, mut cornered) = (false, false);
    for _ in 0..200 {
        bench.cues.collision = if loud(pose.heading_rad) { cue(1.0, 0.5, 0.1, 1) } else { LayerCue::default() };
        let wanted = Velocity { linear_m_s: 0.02, angular_rad_s: if pose.heading_rad < 0.2 { 0.6 } else { -0.6 } };
        let decision = drive(&mut bench, &mut pose, wanted);
        cornered |= decision.stuck;
        turned_left |= decision.stuck && decision.velocity.angular_rad_s > 0.0;
        if pose.heading_rad > 1.4 {
            break;
        }
    }
    assert!(cornered && turned_left && pose.heading_rad > 1.4, "{pose:?}");
}

/// GIVEN one obstacle heard by one sensor or by three, WHEN OA acts, THEN it slows down as much.
#[test]
fn three_sensors_slow_down_as_one_does() {
    let speed_m_s = |sensors: usize| {
        let mut bench = Bench::new(|_| {});
        bench.cues.obstacle = cue(6.0 * sensors as f32, 0.0, 0.1, 1);
        bench.cues.obstacle.sensors[..sensors].fill(SensorSums { energy: 6.0, turn: 0.0, peak: 0.1 });
        bench.settle(FORWARD).velocity.linear_m_s
    };
    assert!((speed_m_s(1) - 0.15).abs() < 1e-9, "half of E_ref: {}", speed_m_s(1));
    assert!((speed_m_s(3) - speed_m_s(1)).abs() < 1e-9);
}

/// GIVEN CA that was right to turn right, WHEN it fires again with both sides equally near but for a rounding, THEN it does not turn
/// back to what it has just avoided, although that is wanted; without a memory of it the wanted side decides.
#[test]
fn a_near_tie_is_not_turned_back_to_what_was_avoided() {
    let second_turn = |avoided: bool| {
        let mut bench = Bench::new(|_| {});
        let wanted = Velocity { linear_m_s: 0.3, angular_rad_s: 0.5 };
        let here = Some(Pose2::default());
        if avoided {
            bench.cues.collision = cue(1.0, 0.0, 0.1, 1);
            let aside = |nearest| NearestReflection { place_m: [0.05, 0.38], ..nearest };
            bench.cues.collision.nearest = bench.cues.collision.nearest.map(aside);
            assert!(bench.step_with(wanted, here).velocity.angular_rad_s < 0.0);
            bench.step_with(wanted, here);
            bench.cues.collision = LayerCue::default();
            for _ in 0..4 {
                bench.step_with(wanted, here);
            }
        }
        bench.cues.collision = cue(1.0, 0.0, 0.1, -1);
        bench.cues.collision.nearest =
            bench.cues.collision.nearest.map(|nearest| NearestReflection { lead_m: 0.004, ..nearest });
        bench.step_with(wanted, here).velocity.angular_rad_s.signum()
    };
    assert_eq!([second_turn(true), second_turn(false)], [-1.0, 1.0]);
}

/// GIVEN CA that has turned by more than a quarter turn and still hears something, WHEN it goes on, THEN the robot counts as stuck and
/// turns out twice as fast.
#[test]
fn a_turn_away_that_finds_no_end_is_a_corner() {
    let mut bench = Bench::new(|params| params.collision_avoidance.reverse_m_s = 0.0);
    let mut pose = Pose2::default();
    bench.cues.collision = cue(1.0, 0.0, 0.1, 1);
    let turning = (0..100).take_while(|_| !drive(&mut bench, &mut pose, FORWARD).stuck).count();
    // 1.6 rad at 0.5 rad/s, and one step to speed up.
    assert!((32..=35).contains(&turning), "{turning} steps");
    for _ in 0..3 {
        drive(&mut bench, &mut pose, FORWARD);
    }
    let decision = drive(&mut bench, &mut pose, FORWARD);
    assert_eq!((decision.velocity.linear_m_s, decision.velocity.angular_rad_s.abs()), (0.0, 1.0));
}
