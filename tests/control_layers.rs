//! Contract: given cues, the controller gives the velocity of the highest triggered layer, within every limit, for any cues
//! and any input, NaN and infinities included. Cues are made by hand here; images come in control_energies.rs.

mod control_bench;

use control_bench::{Bench, FORWARD, PERIOD_NS, cue, near, walls};
use noctule::signal::{CoverageCue, LayerCue, LayerName, SENSORS_MAX, Velocity, WallPeaks};
use noctule::time::Stamp;

/// GIVEN silence, WHEN motion is wanted, THEN it passes through.
#[test]
fn an_empty_room_triggers_nothing() {
    let mut bench = Bench::new(|_| {});
    let wanted = Velocity { linear_m_s: 0.25, angular_rad_s: -0.4 };
    let decision = bench.settle(wanted);
    assert_eq!((decision.velocity, decision.layer, decision.stuck), (wanted, LayerName::PassThrough, false));
}

/// GIVEN every layer triggered, WHEN the upper ones fall silent one by one, THEN the next below acts.
#[test]
fn the_order_is_collision_obstacle_flow_corridor() {
    let mut bench = Bench::new(|_| {});
    bench.cues.collision = cue(1.0, 0.0, 0.1, 1);
    bench.cues.obstacle = cue(1.0, 0.5, 0.1, 1);
    bench.cues.walls = walls(&[(1.0, 1.0)]);
    bench.cues.corridor = cue(1.0, 0.5, 0.1, 1);
    assert_eq!(bench.settle(FORWARD).layer, LayerName::CollisionAvoidance);
    bench.cues.collision = LayerCue::default();
    assert_eq!(bench.settle(FORWARD).layer, LayerName::ObstacleAvoidance);
    bench.cues.obstacle = LayerCue::default();
    assert_eq!(bench.settle(FORWARD).layer, LayerName::FlowFollowing);
    bench.cues.walls = WallPeaks::default();
    assert_eq!(bench.settle(FORWARD).layer, LayerName::CorridorFollowing);
    bench.cues.corridor = LayerCue::default();
    assert_eq!(bench.settle(FORWARD).layer, LayerName::PassThrough);
}

/// GIVEN a layer whose table says enabled = false, WHEN its region is loud, THEN it does not act.
#[test]
fn a_layer_that_is_off_never_acts() {
    let mut bench = Bench::new(|params| {
        params.obstacle_avoidance.enabled = false;
        params.flow_following.enabled = false;
    });
    bench.cues.obstacle = cue(1.0, 0.5, 0.1, 1);
    bench.cues.walls = walls(&[(1.0, 1.0)]);
    bench.cues.corridor = cue(1.0, 0.0, 0.1, 1);
    assert_eq!(bench.settle(FORWARD).layer, LayerName::CorridorFollowing);
}

/// GIVEN something in the CA region, WHEN it is on one side, THEN the robot stops at once and turns to the other, and says why.
#[test]
fn collision_avoidance_stops_and_turns_away_from_the_nearest() {
    for side in [1, -1] {
        let mut bench = Bench::new(|_| {});
        bench.settle(FORWARD);
        bench.cues.collision = cue(1.0, 0.0, 0.1, side);
        let decision = bench.step(FORWARD);
        assert_eq!((decision.layer, decision.velocity.linear_m_s), (LayerName::CollisionAvoidance, 0.0));
        let cause = decision.cause;
        assert_eq!((cause.sensor_index, cause.range_m, cause.bearing_rad), (Some(1), 0.5, 0.3));
        assert_eq!((cause.energy, cause.threshold), (1.0, 0.3));
        near((0..5).map(|_| bench.step(FORWARD)).last().unwrap().velocity.angular_rad_s, -0.5 * f64::from(side));
    }
}

/// GIVEN left and right equally near, WHEN CA fires, THEN omega_i decides, else the last side, else left.
#[test]
fn a_tie_follows_the_wanted_turn_then_the_last_side_then_left() {
    let turn = |bench: &mut Bench, wanted: Velocity| bench.settle(wanted).velocity.angular_rad_s;
    let mut bench = Bench::new(|_| {});
    bench.cues.collision = cue(1.0, 0.0, 0.1, 0);
    near(turn(&mut bench, FORWARD), 0.5);
    bench.cues.collision = LayerCue::default();
    bench.settle(FORWARD);
    bench.cues.collision = cue(1.0, 0.0, 0.1, 0);
    near(turn(&mut bench, Velocity { linear_m_s: 0.3, angular_rad_s: -0.1 }), -0.5);
    bench.cues.collision = LayerCue::default();
    bench.settle(FORWARD);
    bench.cues.collision = cue(1.0, 0.0, 0.1, 0);
    near(turn(&mut bench, FORWARD), -0.5);
}

/// GIVEN CA turning right, WHEN the nearest reflection changes sides, THEN it goes on turning right until the region is clear.
#[test]
fn the_side_is_held_until_the_region_is_clear() {
    let mut bench = Bench::new(|_| {});
    bench.cues.collision = cue(1.0, 0.0, 0.1, 1);
    let steps = |bench: &mut Bench| (0..9).map(|_| bench.step(FORWARD)).last().unwrap();
    steps(&mut bench);
    bench.cues.collision = cue(1.0, 0.0, 0.1, -1);
    near(steps(&mut bench).velocity.angular_rad_s, -0.5);
    bench.cues.collision = cue(0.2, 0.0, 0.1, -1);
    near(steps(&mut bench).velocity.angular_rad_s, -0.5); // between release and threshold
    bench.cues.collision = LayerCue::default();
    assert_eq!(bench.settle(FORWARD).layer, LayerName::PassThrough);
    bench.cues.collision = cue(1.0, 0.0, 0.1, -1);
    near(bench.settle(FORWARD).velocity.angular_rad_s, 0.5);
}

/// GIVEN counts of 2 and 3, WHEN energies come and go, THEN OA fires on the second and lets go on the third in a row.
#[test]
fn layers_wait_for_their_counts() {
    let mut bench = Bench::new(|params| {
        params.obstacle_avoidance.trigger_count = 2;
        params.obstacle_avoidance.release_count = 3;
    });
    let (loud, hold, quiet) = (cue(1.0, 0.0, 0.02, 1), cue(1.0, 0.0, 0.006, 1), cue(1.0, 0.0, 0.001, 1));
    let seen: String = [loud, quiet, loud, loud, hold, quiet, quiet, hold, quiet, quiet, quiet, hold]
        .map(|cue| {
            bench.cues.obstacle = cue;
            if bench.step(FORWARD).layer == LayerName::ObstacleAvoidance { 'O' } else { '.' }
        })
        .iter()
        .collect();
    assert_eq!(seen, "...OOOOOOO..");
}

/// GIVEN CA firing, WHEN it is the fourth time in a row, THEN it backs off at 0.1 m/s, for at most 0.5 m or 5 s in all.
#[test]
fn reverse_begins_with_the_fourth_trigger_and_ends_within_its_budget() {
    for (max_m, max_s) in [(0.5, 5.0), (0.2, 5.0), (0.5, 1.5)] {
        let mut bench = Bench::new(|params| {
            params.collision_avoidance.reverse_max_m = max_m;
            params.collision_avoidance.reverse_max_s = max_s;
            params.stuck.enabled = false;
        });
        bench.cues.collision = cue(1.0, 0.0, 0.1, 1);
        let speeds: Vec<f64> = (0..200).map(|_| bench.step(FORWARD).velocity.linear_m_s).collect();
        assert!(speeds[..3].iter().all(|speed| *speed == 0.0) && speeds[3] == -0.1, "{:?}", &speeds[..5]);
        let reversed_s = 0.1 * speeds.iter().filter(|speed| **speed < 0.0).count() as f64;
        // The last command of 0.1 s might have lived for 0.3 s.
        near(reversed_s, (max_m / 0.1).min(max_s) - 0.2);
        assert!(speeds[60..].iter().all(|speed| *speed == 0.0), "then it stands");
        // The budget is for one stay in the region.
        bench.cues.collision = LayerCue::default();
        bench.settle(FORWARD);
        bench.cues.collision = cue(1.0, 0.0, 0.1, 1);
        assert!(bench.settle(FORWARD).velocity.linear_m_s < 0.0);
    }
}

/// GIVEN ping sets that come late, WHEN CA reverses, THEN the way counts with its real time.
#[test]
fn late_ping_sets_count_against_the_reverse_budget() {
    let mut bench = Bench::new(|params| params.stuck.enabled = false);
    bench.cues.collision = cue(1.0, 0.0, 0.1, 1);
    let mut reversed_m = 0.0;
    let mut speed_m_s = 0.0f64;
    for _ in 0..100 {
        bench.now = bench.now.plus_ns(PERIOD_NS / 2);
        reversed_m += -0.15 * speed_m_s.min(0.0);
        speed_m_s = bench.step(FORWARD).velocity.linear_m_s;
    }
    assert!(reversed_m > 0.4 && reversed_m <= 0.5, "{reversed_m}");
}

/// GIVEN nothing that sees behind, WHEN CA is held for ever, THEN V is never below zero.
#[test]
fn there_is_no_reverse_where_nothing_is_seen() {
    for behind_m in [0.0, 0.1, f64::NAN, f64::NEG_INFINITY] {
        let mut bench = Bench::new(|_| {});
        bench.cues.coverage.behind_m = behind_m;
        bench.cues.collision = cue(1.0, 0.0, 0.1, 1);
        assert!((0..300).all(|_| bench.step(FORWARD).velocity.linear_m_s >= 0.0));
    }
}

/// GIVEN an obstacle ahead on the left, WHEN OA acts, THEN it slows and turns right by the law, and never speeds up.
#[test]
fn obstacle_avoidance_follows_its_law() {
    let mut bench = Bench::new(|params| params.obstacle_avoidance.energy_reference = 10.0);
    bench.cues.obstacle = cue(4.0, 2.0, 0.1, 1);
    let decision = bench.settle(Velocity { linear_m_s: 0.2, angular_rad_s: 0.1 });
    assert_eq!(decision.layer, LayerName::ObstacleAvoidance);
    near(decision.velocity.linear_m_s, 0.2 * 0.6);
    near(decision.velocity.angular_rad_s, 0.1 - 0.5);
    near(decision.cause.energy, f64::from(0.1f32));
    bench.cues.obstacle = cue(40.0, -20.0, 0.1, -1);
    let decision = bench.settle(Velocity { linear_m_s: 0.2, angular_rad_s: 0.1 });
    near(decision.velocity.linear_m_s, 0.0);
    near(decision.velocity.angular_rad_s, 0.6);
}

/// GIVEN more energy on one side, WHEN RCF acts, THEN it turns to the other and keeps V.
#[test]
fn corridor_following_balances_the_sides() {
    let mut bench = Bench::new(|params| params.corridor_following.lambda = 0.5);
    bench.cues.corridor = cue(5.0, 2.0, 0.1, 1);
    let decision = bench.settle(FORWARD);
    near(decision.velocity.linear_m_s, 0.3);
    near(decision.velocity.angular_rad_s, -0.2);
}

/// GIVEN one wall, WHEN its distance changes between activations, THEN the robot turns after it; not in the first ping set, nor
/// after a break, nor when the wall is on the other side.
#[test]
fn a_single_wall_is_followed_from_its_previous_distance() {
    let mut bench = Bench::new(|params| params.corridor_following.enabled = false);
    let turn = |bench: &mut Bench, lateral_m: f64| {
        bench.cues.walls = walls(&[(lateral_m, 1.0)]);
        bench.step(FORWARD).velocity.angular_rad_s
    };
    near(turn(&mut bench, 1.00), 0.0);
    near(turn(&mut bench, 1.05), 0.05);
    near(turn(&mut bench, 1.02), -0.03);
    near(turn(&mut bench, -1.00), 0.0);
    near(turn(&mut bench, -1.05), -0.05);
    bench.cues.obstacle = cue(1.0, 0.0, 0.1, 1);
    bench.settle(FORWARD);
    bench.cues.obstacle = LayerCue::default();
    bench.step(FORWARD); // OA's release count
    bench.step(FORWARD);
    near(turn(&mut bench, -1.20), 0.0);
    near(turn(&mut bench, -1.21), -0.01);
}

/// GIVEN a set distance, WHEN the wall is farther, THEN the robot turns towards it on either side.
#[test]
fn a_set_distance_pulls_the_robot_to_it() {
    for side in [1.0, -1.0] {
        let mut bench = Bench::new(|params| params.flow_following.set_distance_m = Some(0.8));
        bench.cues.walls = walls(&[(side, 1.0)]);
        near(bench.settle(FORWARD).velocity.angular_rad_s, 0.2 * side);
    }
}

/// GIVEN two walls, WHEN the robot is off the middle, THEN it turns to the farther wall, damped by the rate of the offset.
#[test]
fn a_corridor_is_followed_in_its_middle_with_damping() {
    let mut bench = Bench::new(|params| params.flow_following.derivative_filter_s = 0.1);
    bench.cues.walls = walls(&[(1.1, 1.0), (-0.9, 0.9)]);
    near(bench.step(FORWARD).velocity.angular_rad_s, 0.2);
    near(bench.step(FORWARD).velocity.angular_rad_s, 0.2);
    bench.cues.walls = walls(&[(1.08, 1.0), (-0.92, 0.9)]);
    // e = 0.16; de/dt = -0.4, half of it passes the filter; lambda_d = 0.7 sqrt(2 / 0.3).
    near(bench.step(FORWARD).velocity.angular_rad_s, 0.16 - 0.2 * 0.7 * (2.0f64 / 0.3).sqrt());
    bench.cues.walls = walls(&[(1.0, 1.0), (-1.0, 0.9)]);
    bench.settle(FORWARD);
    assert!(bench.settle(FORWARD).velocity.angular_rad_s.abs() < 1e-3);
}

/// GIVEN a ping delay of 0.2 s, WHEN a corridor is followed for 60 s from 0.28 m off the middle, THEN the robot comes to rest in
/// the middle with the damping, and swings ever wider without (the negative control: the paper's eq. 16).
#[test]
fn damping_keeps_the_corridor_law_from_swinging() {
    let final_swing_m = |law: &mut dyn FnMut(f64) -> f64| {
        let (mut y, mut heading, mut swing) = (0.28f64, 0.0f64, 0.0f64);
        let mut delayed = std::collections::VecDeque::from([y, y]);
        for step in 0..600 {
            delayed.push_back(y);
            let omega = law(delayed.pop_front().unwrap());
            for _ in 0..10 {
                heading += omega * 0.01;
                y += 0.3 * heading.sin() * 0.01;
            }
            swing = if step >= 500 { swing.max(y.abs()) } else { 0.0 };
        }
        swing
    };
    let mut bench = Bench::new(|_| {});
    let ours = final_swing_m(&mut |y| {
        bench.cues.walls = walls(&[(1.5 - y, 1.0), (-1.5 - y, 0.9)]);
        bench.step(FORWARD).velocity.angular_rad_s
    });
    let undamped = final_swing_m(&mut |y| -2.0 * y);
    assert!(ours < 0.02, "damped: {ours} m");
    assert!(undamped > 0.28, "undamped: {undamped} m");
}

/// GIVEN flow lines that hear a wall only where it is square to the sensor, WHEN a corridor is begun far off its middle, THEN the
/// robot does not turn so far askew that a wall is lost, and comes to the middle; the unbounded law loses one (the negative control).
#[test]
fn the_way_to_the_middle_is_no_steeper_than_both_walls_are_heard() {
    const HALF_WIDTH_M: f64 = 1.2;
    const ABEAM_M: f64 = 0.35;
    // A ping later; greatest x of a wall's echo, and where the robot is after 30 s.
    let farthest_echo_m = |law: &mut dyn FnMut(f64, f64) -> f64| {
        let (mut y, mut heading, mut omega, mut echo_m) = (-0.4f64, 0.0f64, 0.0f64, 0.0f64);
        for _ in 0..300 {
            let next = law(y, heading);
            for _ in 0..10 {
                heading += omega * 0.01;
                y += 0.3 * heading.sin() * 0.01;
            }
            omega = next;
            echo_m = echo_m.max((HALF_WIDTH_M + y.abs()) * heading.sin().abs());
        }
        (echo_m, y)
    };
    let mut bench = Bench::new(|_| {});
    let (echo_m, y) = farthest_echo_m(&mut |y, heading| {
        let heard = |wall_m: f64| (wall_m * heading.sin()).abs() <= ABEAM_M;
        let both = [(HALF_WIDTH_M - y, 1.0), (-HALF_WIDTH_M - y, 0.9)];
        let found: Vec<_> = both.into_iter().filter(|wall| heard(wall.0)).collect();
        bench.cues.walls = walls(&found);
        bench.step(FORWARD).velocity.angular_rad_s
    });
    assert!(echo_m < ABEAM_M, "heard up to {echo_m} m ahead of abeam");
    assert!(y.abs() < 0.02, "{y} m off the middle");
    let (mut before, damping) = (-0.4, 0.7 * (2.0f64 / 0.3).sqrt());
    let (unbounded_m, _) = farthest_echo_m(&mut |y, _| {
        let rate_m_s = (y - std::mem::replace(&mut before, y)) / 0.1;
        -2.0 * (y + damping * rate_m_s)
    });
    assert!(unbounded_m > ABEAM_M, "{unbounded_m}");
}

/// GIVEN a corridor, WHEN one wall falls silent, THEN the other and the width go on telling the middle, for 3 m of way or until a
/// turn is wanted.
#[test]
fn one_wall_and_the_width_tell_the_middle_for_a_while() {
    let corridor = || {
        let mut bench = Bench::new(|_| {});
        bench.cues.walls = walls(&[(1.2, 1.0), (-1.2, 0.9)]);
        bench.settle(FORWARD);
        bench.cues.walls = walls(&[(1.28, 1.0)]);
        bench
    };
    let mut bench = corridor();
    bench.settle(FORWARD);
    near(bench.step(FORWARD).velocity.angular_rad_s, 0.16);
    // 16 steps of 3 cm are driven.
    let steps = (0..200).take_while(|_| bench.step(FORWARD).velocity.angular_rad_s > 0.1).count();
    assert!((80..=88).contains(&steps), "{steps}");
    let turn = Velocity { angular_rad_s: 0.2, ..FORWARD };
    near(corridor().settle(turn).velocity.angular_rad_s, 0.2);
    let mut bench = corridor();
    bench.cues.walls = walls(&[(1.7, 1.0)]);
    assert!(bench.settle(FORWARD).velocity.angular_rad_s.abs() < 1e-9, "another wall");
}

/// GIVEN a reflection line within the robot's own width, WHEN it peaks, THEN it is no wall to follow.
#[test]
fn what_is_in_the_way_is_no_wall() {
    let mut bench = Bench::new(|_| {});
    bench.cues.walls = walls(&[(0.1, 1.0), (-1.0, 0.00001)]);
    assert_eq!(bench.settle(FORWARD).layer, LayerName::PassThrough);
}

/// GIVEN a short stretch of seen way, WHEN full speed is wanted, THEN the robot could stop within it; none, and it stands.
#[test]
fn speed_is_limited_by_what_is_seen() {
    let mut bench = Bench::new(|_| {});
    bench.cues.coverage.ahead_m = 0.06;
    let decision = bench.settle(FORWARD);
    let v = decision.velocity.linear_m_s;
    near(v, decision.speed_limit_m_s);
    near(0.35 * v + v * v / 2.0, 0.06);
    for ahead_m in [0.0, -1.0, f64::NAN, f64::NEG_INFINITY] {
        bench.cues.coverage.ahead_m = ahead_m;
        assert_eq!(bench.step(FORWARD).velocity.linear_m_s, 0.0);
    }
    bench.cues.coverage = CoverageCue { ahead_m: 3.0, behind_m: 0.0 };
    assert_eq!(bench.settle(Velocity::forward_m_s(-0.2)).velocity.linear_m_s, 0.0);
}

/// GIVEN cues too old, from the future, of no sensor, or an input that is no number, WHEN asked, THEN the answer is zero at once.
#[test]
fn stale_future_blind_and_senseless_inputs_stop_the_robot() {
    let moving = || {
        let mut bench = Bench::new(|_| {});
        assert!(bench.settle(FORWARD).velocity.linear_m_s > 0.0);
        bench
    };
    for (age_ns, stops) in
        [(299_000_000, false), (301_000_000, true), (-49_000_000, false), (-51_000_000, true), (i64::MIN, true)]
    {
        let mut bench = moving();
        bench.now = bench.now.plus_ns(PERIOD_NS);
        bench.cues.emitted_at =
            Stamp { boottime_ns: bench.now.boottime_ns.wrapping_sub(age_ns.cast_unsigned()), wall_ns: 0 };
        let decision = bench.controller.step(bench.now, &bench.cues, FORWARD);
        assert_eq!(decision.velocity == Velocity::ZERO, stops, "age {age_ns} ns");
        assert_eq!(decision.layer == LayerName::Stopped, stops);
    }
    let mut bench = moving();
    bench.cues.sensors_used = [false; SENSORS_MAX];
    assert_eq!(bench.step(FORWARD).velocity, Velocity::ZERO);
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        assert_eq!(moving().step(Velocity::forward_m_s(bad)).velocity, Velocity::ZERO);
        assert_eq!(moving().step(Velocity { linear_m_s: 0.1, angular_rad_s: bad }).velocity, Velocity::ZERO);
    }
}

/// GIVEN energies that are no numbers, WHEN asked, THEN CA fires and nothing moves forward (negative control: `>` would not fire).
#[test]
fn an_energy_that_is_no_number_is_an_obstacle() {
    for bad in [f32::NAN, f32::INFINITY, 1e38] {
        let mut bench = Bench::new(|_| {});
        bench.settle(FORWARD);
        bench.cues.collision.energy = bad;
        let decision = bench.step(FORWARD);
        assert_eq!((decision.layer, decision.velocity.linear_m_s), (LayerName::CollisionAvoidance, 0.0));
        let mut bench = Bench::new(|params| params.collision_avoidance.enabled = false);
        bench.cues.obstacle = LayerCue { energy: bad, peak: bad, turn: bad, ..LayerCue::default() };
        assert_eq!(bench.settle(FORWARD).velocity.linear_m_s, 0.0);
    }
    assert_ne!(f32::NAN.partial_cmp(&0.3), Some(std::cmp::Ordering::Greater), "`>` calls NaN free space");
}

/// GIVEN a controller with a past, WHEN it is reset, THEN it answers like a new one.
#[test]
fn reset_forgets_everything() {
    let mut used = Bench::new(|_| {});
    used.cues.collision = cue(1.0, 0.0, 0.1, 1);
    used.cues.walls = walls(&[(1.0, 1.0)]);
    used.settle(FORWARD);
    used.controller.reset();
    let mut fresh = Bench::new(|_| {});
    for bench in [&mut used, &mut fresh] {
        bench.cues.collision = LayerCue::default();
        bench.cues.walls = walls(&[(1.2, 1.0)]);
    }
    for _ in 0..5 {
        assert_eq!(used.step(FORWARD).velocity, fresh.step(FORWARD).velocity);
    }
}
