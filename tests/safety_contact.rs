//! Contract: no wall met head-on or askew, to the left, to the right or across the way, is ever touched. Simulator, imaging, layers,
//! state machine and gate, in simulated time.

mod checks;

use checks::{figure, trials};
use noctule::config::Config;
use noctule::imaging::params::Prefer;
use noctule::service::proving::{Entrant, Programme, Run};
use noctule::service::trial::TrialRig;
use noctule::signal::SampleFormat;
use noctule::sim::{SimParams, World};
use std::path::Path;

/// Walls across the way: square, with ends to the left and right of the robot's lane, and a corner to drive into.
const WALLS: [&str; 4] = [
    "[[wall]]\npoints = [[1.6, -4.0], [1.6, 4.0]]\n",
    "[[wall]]\npoints = [[1.6, -0.1], [1.6, 4.0]]\n",
    "[[wall]]\npoints = [[1.6, -4.0], [1.6, 0.1]]\n",
    "[[wall]]\npoints = [[0.6, -2.0], [1.8, 0.0], [0.6, 2.0]]\n",
];

fn world(wall: usize) -> World {
    let start = "[start]\ncorner = [-0.1, -0.2]\nsize = [0.2, 0.4]\nheading_spread_deg = 35.0\n";
    let text = format!("guidance = false\ntime_limit_s = 14.0\n{}{start}", WALLS[wall]);
    World::parse(Path::new("wall.toml"), &text).expect("world")
}

fn drive(config: &Config, wall: usize, runs: usize) -> Vec<Run> {
    let mut config = config.clone();
    config.recording.format = SampleFormat::PcmF32;
    let rig = TrialRig::new(config).expect("rig");
    let entrants = [Entrant { name: "robot".to_owned(), rig, losses: Vec::new() }];
    let world = world(wall);
    let programme = Programme {
        world: &world,
        entrants: &entrants,
        acoustics: SimParams::default(),
        prefer: Prefer::Cpu,
        first_seed: 1 + 1_000 * wall as u64,
        runs: runs as u64,
        jobs: 2,
    };
    programme.drive(&mut |_| {}).expect("driven")
}

#[test]
fn two_hundred_walls_head_on_and_askew_are_not_touched() {
    let each = trials(200, 8).div_ceil(WALLS.len());
    let (mut contacts, mut nearest_m, mut driven, mut approached) = (0, f64::INFINITY, 0, 0);
    for wall in 0..WALLS.len() {
        for run in drive(&Config::default(), wall, each) {
            let trial = run.outcome.expect("driven");
            contacts += usize::from(trial.score.collided);
            nearest_m = nearest_m.min(trial.score.min_clearance_m);
            approached += usize::from(trial.score.min_clearance_m < 0.6);
            driven += 1;
        }
    }
    figure(1, "contacts with walls head-on", format!("{contacts}, nearest {nearest_m:.3} m"), "0", driven);
    assert_eq!(contacts, 0);
    assert!(2 * approached > driven, "only {approached} of {driven} came near a wall at all");
}

/// The negative control: what keeps the robot off the wall are CA and OA.
#[test]
fn without_avoidance_the_same_walls_are_touched() {
    let mut config = Config::default();
    config.control.collision_avoidance.enabled = false;
    config.control.obstacle_avoidance.enabled = false;
    config.control.corridor_following.enabled = false;
    config.control.flow_following.enabled = false;
    config.control.stuck.enabled = false;
    let touched =
        drive(&config, 0, 2).iter().filter(|run| run.outcome.as_ref().is_ok_and(|trial| trial.score.collided)).count();
    assert!(touched > 0);
}
