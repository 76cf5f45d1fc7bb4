//! Contract: the virtual sonar ring finds round things where they stand and tells honestly how well it knows: the paper's
//! experiment, and random scenes (a few; all hundred with `NOCTULE_FULL=1`). Simulated sound, imaging, scan and detector are the
//! program's own.

use crate::checks;
use assert_cmd::Command;
use noctule::detect::tracks::Track;
use noctule::geometry::Pose2;
use noctule::service::ring_scenes::score::{score, things};
use noctule::service::ring_scenes::{self, Method, RingScenes, Scene, Score, Scores, Told};
use noctule::sim::World;
use serde_json::Value;

fn harness() -> RingScenes {
    RingScenes::new(ring_scenes::config().expect("built in")).expect("a robot")
}

fn of(scores: &Scores, method: Method) -> &Score {
    let index = Method::ALL.iter().position(|other| *other == method).expect("all are there");
    &scores[index]
}

#[test]
fn an_empty_map_is_silent_all_around() {
    let harness = harness();
    let mut worker = harness.worker().expect("a thread");
    let empty = Scene { world: World::default(), start: Pose2::default(), seed: 1 };
    let run = worker.run(&empty).expect("a run");
    for (method, score) in Method::ALL.iter().zip(&run.scores) {
        assert_eq!((score.hits, score.ghosts), (0, 0), "{}", method.as_str());
    }
    assert_eq!(run.report.object_count, 0);
    assert!(run.report.grid.percent.iter().all(|percent| *percent == 255 || *percent < 50));
}

#[test]
fn the_papers_five_things_are_found_each_in_its_cell() {
    let harness = harness();
    let mut worker = harness.worker().expect("a thread");
    let runs = checks::trials(30, 2) as u64;
    let mut sums = Scores::default();
    for seed in 1..=runs {
        let scene = Scene::paper(seed);
        let run = worker.run(&scene).expect("a run");
        sums = ring_scenes::sum([&sums, &run.scores].into_iter());
        // The planted fault: things that stand a cell farther to the left are not the ones found.
        let mut other = scene.world.pillars.clone();
        other.iter_mut().for_each(|pillar| pillar.centre[1] += 0.25);
        let others = things(&other, &run.poses[0], &run.poses[1]);
        let told = |track: &Track| Told { position_m: track.position_m, covariance_m2: track.covariance_m2 };
        let told: Vec<Told> = run.report.objects().iter().map(told).collect();
        assert!(score(&others, &told, |_| false).hits <= 1, "a score that forgives everything");
    }
    for method in [Method::All, Method::Fused] {
        let score = of(&sums, method);
        let things = 5 * runs as usize;
        assert_eq!((score.hits, score.cells_right, score.ghosts), (things, things, 0), "{}", method.as_str());
    }
}

/// Whether covariances hold what they promise: two degrees of freedom would be a mean square of 2, 86 and 99 % within two and three
/// deviations. Measured: 2.2 at most, 93 and 97 % at least; a few scenes vary. They may promise less than they hold.
fn is_honest(score: &Score) -> bool {
    let [_, two, three] = score.shares_within();
    score.mean_square().is_some_and(|square| square < 3.0) && two > 0.82 && three > 0.94
}

#[test]
fn random_scenes_are_found_with_few_ghosts_and_honest_covariances() {
    let runs = checks::trials(100, 12) as u64;
    let scored = harness().run(1, runs, 2, &mut |_| {}).expect("runs");
    assert_eq!(scored.iter().map(|(seed, _)| *seed).collect::<Vec<_>>(), (1..=runs).collect::<Vec<_>>());
    let sums = ring_scenes::sum(scored.iter().map(|(_, scores)| scores));
    for (method, score) in Method::ALL.iter().zip(&sums) {
        println!(
            "{}: {} things, {} hits, {} ghosts, {} doubles, {} cells, {:?} m median, mean square {:?}, within {:?}",
            method.as_str(),
            score.things,
            score.hits,
            score.ghosts,
            score.doubles,
            score.cells_right,
            score.error_quantile_m(0.5),
            score.mean_square(),
            score.shares_within()
        );
    }
    // Measured on a hundred: 97 and 98 % hits, 3 ghosts and none, 3 and 4 mm median; a few scenes vary by some per cent.
    for (method, hits, ghosts) in [(Method::All, 0.93, 0.03), (Method::Fused, 0.94, 0.02)] {
        let score = of(&sums, method);
        let things = score.things as f64;
        assert!(score.hits as f64 >= hits * things, "{}: {} of {things}", method.as_str(), score.hits);
        assert!(score.ghosts as f64 <= ghosts * things, "{}: {} ghosts", method.as_str(), score.ghosts);
        assert!(score.error_quantile_m(0.5).is_some_and(|error_m| error_m < 0.01));
        assert!(is_honest(score), "{}: {:?} {:?}", method.as_str(), score.mean_square(), score.shares_within());
        let tenth = Score { squares: score.squares.iter().map(|square| 10.0 * square).collect(), ..score.clone() };
        assert!(!is_honest(&tenth), "covariances ten times too small must be found out");
    }
    let [gyro, wheels, filter] = [Method::Gyro, Method::Wheels, Method::Filter].map(|method| of(&sums, method));
    assert!(is_honest(wheels) && is_honest(filter), "{:?} {:?}", wheels.shares_within(), filter.shares_within());
    assert!(filter.error_quantile_m(0.5) < gyro.error_quantile_m(0.5), "the drift of the gyro costs accuracy");
    assert!(gyro.mean_square() > filter.mean_square(), "and what it does not know of it, honesty");
    // Where plain sonars stay behind: of two things in one cone they hear the nearer.
    let all = of(&sums, Method::All);
    assert!((filter.hits as f64) < 0.8 * all.hits as f64 && filter.error_quantile_m(0.5) > all.error_quantile_m(0.5));
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let harness = harness();
    let one = harness.run(5, 2, 1, &mut |_| {}).expect("runs");
    let two = harness.run(5, 2, 2, &mut |_| {}).expect("runs");
    assert_eq!(one, two);
}

#[test]
fn the_command_prints_a_table_writes_json_and_draws_the_grid() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let mut command = Command::cargo_bin("noctule").expect("built");
    command.args(["detect", "scenes", "--runs", "2", "--seed", "3", "--json"]).arg(at("t.json"));
    let output = command.arg("--plot").arg(at("g.png")).output().expect("runs");
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let table = String::from_utf8(output.stdout).expect("text");
    assert!(Method::ALL.iter().all(|method| table.contains(method.as_str())), "{table}");
    let json: Value = serde_json::from_slice(&std::fs::read(at("t.json")).expect("written")).expect("JSON");
    assert_eq!(json["summary"].as_array().map(Vec::len), Some(6));
    assert_eq!(json["scenes"][1]["seed"], 4);
    assert!(json["summary"][1]["hits"].as_u64().is_some_and(|hits| hits > 0));
    assert!(std::fs::read(at("g.png")).expect("drawn").starts_with(b"\x89PNG"));
}

#[test]
fn what_cannot_be_is_refused_by_name_with_its_code() {
    for (arguments, code, named) in [
        (&["--runs", "0"][..], 2, "--runs"),
        (&["--seed", "18446744073709551615", "--runs", "2"], 2, "--seed"),
        (&["--runs", "1", "--json", "/no/such/folder/t.json"], 73, "/no/such/folder"),
        (&["--config", "no_such.toml"], 78, "no_such.toml"),
    ] {
        let mut command = Command::cargo_bin("noctule").expect("built");
        let output = command.args(["detect", "scenes"]).args(arguments).output().expect("runs");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(code) && said.contains(named), "{arguments:?}: {said}");
    }
}
