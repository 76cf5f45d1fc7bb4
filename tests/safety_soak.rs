//! Check 40: a robot of three sensors drives for six minutes, for an hour with `NOCTULE_FULL=1`, while something goes wrong every minute.
//! It stops in time, stands, goes on, never moves when it must not, and runs the same again bit by bit.

mod checks;

use checks::{figure, is_full, trials};
use noctule::config::Config;
use noctule::service::soak::{
    Case, Demand, Footprint, GROWTH_MAX_KIB, Scorer, SoakOptions, Summary, Tick, catalogue, soak, soak_with,
};
use noctule::service::trial::TrialRig;
use noctule::signal::{DaemonState, GateState, SampleFormat, Velocity};
use noctule::sim::World;
use std::sync::{Mutex, MutexGuard, PoisonError};

const TICK_NS: u64 = 20_000_000;

/// Memory and threads are those of the whole process: one soak at a time.
static TURN: Mutex<()> = Mutex::new(());

fn turn() -> MutexGuard<'static, ()> {
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

fn rig() -> TrialRig {
    let mut config = Config::default();
    config.recording.format = SampleFormat::PcmF32;
    TrialRig::new(config).expect("rig")
}

fn world() -> World {
    World::default_world().expect("world")
}

fn tell(summary: &Summary, what: &str) {
    let sets = summary.ping_sets as usize;
    let tell = |name: &str, found: String, bar: &str| figure(40, &format!("{what}: {name}"), found, bar, sets);
    tell("longest time to stop, s", format!("{:.2}", summary.stop_s), "<= 0.35");
    tell("hold", format!("{:.4}", summary.hold), ">= 0.99");
    tell("longest time to resume, s", format!("{:.2}", summary.resume_s), "<= 0.6");
    tell("false stops", format!("{:.4}", summary.false_stop), "<= 0.01");
    tell("contacts and motion that must not be", (summary.contacts + summary.unsafe_ticks).to_string(), "0");
}

#[test]
fn a_robot_that_meets_a_fault_a_minute_stops_in_time_and_never_moves_when_it_must_not() {
    let _turn = turn();
    let minutes = if is_full() { 60.0 } else { 6.0 };
    let options = SoakOptions { minutes, seed: 40, fault_every_s: 60.0 };
    let summary = soak(&rig(), &world(), &options, &mut |_| {}).expect("soaked");
    tell(&summary, "a fault a minute");
    println!("{summary:#?}");
    assert!(summary.findings.is_empty(), "{:?}", summary.findings);
    assert!(summary.ping_sets as f64 >= 590.0 * minutes && summary.troubles as f64 >= minutes, "{summary:?}");
    // It drives: a robot that stands all the time would be safe too.
    assert!(summary.distance_m > 6.0 * minutes, "{} m", summary.distance_m);
    if let (Some(early), Some(late)) = (summary.footprint_early, summary.footprint_late) {
        let grown = late.rss_kib.saturating_sub(early.rss_kib);
        figure(40, "growth of memory, KiB", grown, "<= 4096", summary.ping_sets as usize);
    }
}

#[test]
fn every_trouble_of_the_catalogue_leads_to_what_is_asked_for() {
    let _turn = turn();
    let (rig, all) = (rig(), catalogue(3));
    // All positions of all faults in the full run; otherwise another third of the list for each.
    let stride = all.len() / trials(all.len(), 14);
    let cases: Vec<Case> = all.iter().step_by(stride.max(1)).cloned().collect();
    let options = SoakOptions { minutes: 0.17 * cases.len() as f64, seed: 4, fault_every_s: 4.0 };
    let summary = soak_with(&rig, &world(), &options, &cases, &mut |_| {}).expect("soaked");
    tell(&summary, "every trouble");
    println!("{summary:#?}");
    assert!(summary.findings.is_empty(), "{:?}", summary.findings);
    assert_eq!(summary.of_one.len(), cases.len(), "each was met");
}

#[test]
fn a_run_repeats_itself_bit_by_bit_and_another_seed_gives_another() {
    let _turn = turn();
    let (rig, world) = (rig(), world());
    let run = |seed| {
        let options = SoakOptions { minutes: 0.8, seed, fault_every_s: 6.0 };
        let summary = soak(&rig, &world, &options, &mut |_| {}).expect("soaked");
        (summary.digest, summary.of_one.keys().cloned().collect::<Vec<_>>())
    };
    let first = run(7);
    assert_eq!(run(7), first);
    assert_ne!(run(8).0, first.0);
    figure(40, "runs replayed with other bits", 0, "0", 1);
}

/// What a robot does in ten seconds of which the fourth to sixth are troubled, told to a scorer.
fn scored(demand: Demand, mut robot: impl FnMut(f64) -> Tick) -> Summary {
    let case = catalogue(3).into_iter().find(|case| case.demand == demand).expect("one with this demand");
    let mut scorer = Scorer::default();
    for tick in 0..500_u64 {
        let now_ns = tick * TICK_NS;
        let time_s = now_ns as f64 * 1e-9;
        if now_ns == 4_000_000_000 {
            scorer.begin(&case, now_ns - 100_000_000);
        } else if now_ns == 6_000_000_000 {
            scorer.clear(now_ns);
        }
        let mut tick = robot(time_s);
        tick.now_ns = now_ns;
        scorer.tick(&tick);
    }
    scorer.summary()
}

fn tick(speed_m_s: f64, stopped: bool) -> Tick {
    Tick {
        now_ns: 0,
        velocity: if stopped { Velocity::ZERO } else { Velocity::forward_m_s(speed_m_s) },
        gate: if stopped { GateState::Hold } else { GateState::Track },
        daemon: if stopped { DaemonState::Stopped } else { DaemonState::Active },
        contact: false,
    }
}

/// A robot that stops for the trouble from `from_s` to `to_s`.
fn stops(from_s: f64, to_s: f64) -> impl FnMut(f64) -> Tick {
    move |time_s| tick(0.3, (from_s..to_s).contains(&time_s))
}

#[test]
fn the_scoreboard_is_green_for_a_robot_that_does_right_and_red_for_each_thing_done_wrong() {
    let red = |summary: Summary, word: &str| {
        let found = summary.findings.iter().any(|finding| finding.contains(word));
        assert!(found, "{word}: {:?}", summary.findings);
    };
    let good = scored(Demand::Stop, stops(4.24, 6.5));
    assert!(good.findings.is_empty(), "{:?}", good.findings);
    assert!((good.stop_s - 0.34).abs() < 1e-9 && (good.resume_s - 0.5).abs() < 1e-9, "{good:?}");
    assert_eq!(
        scored(Demand::Slow, |s| tick(if (4.5..6.0).contains(&s) { 0.1 } else { 0.3 }, false)).findings,
        [""; 0]
    );
    // One tick too late, too early, too long, not at all, and without need.
    red(scored(Demand::Stop, stops(4.28, 6.5)), "to stop");
    red(scored(Demand::Stop, stops(4.28, 6.5)), "ticks of motion");
    red(scored(Demand::Stop, |s| tick(0.3, (4.1..6.5).contains(&s) && !(5.0..5.02).contains(&s))), "ticks of motion");
    red(scored(Demand::Stop, stops(4.1, 6.62)), "to resume");
    red(scored(Demand::Stop, stops(9.0, 9.0)), "never stopped");
    red(scored(Demand::Stop, |s| tick(0.3, (4.1..6.5).contains(&s) || (1.0..1.1).contains(&s))), "false stops");
    red(scored(Demand::GoOn, stops(4.5, 5.0)), "false stops");
    // A latched stop that ends by itself.
    red(scored(Demand::Latch { found_in_ns: 0 }, stops(4.1, 6.5)), "ticks of motion");
    red(scored(Demand::Slow, |_| tick(0.3, false)), "too fast");
    red(scored(Demand::Slow, |s| tick(if (5.0..5.1).contains(&s) { -0.05 } else { 0.05 }, false)), "too fast");
    red(scored(Demand::GoOn, |s| Tick { contact: (5.0..5.1).contains(&s), ..tick(0.3, false) }), "contacts");
    let mut grown = scored(Demand::GoOn, |_| tick(0.3, false));
    let small = Footprint { rss_kib: 40_000, descriptors: 5, threads: 3, shared_files: 0 };
    grown.judge_footprint(Some(small), Some(Footprint { rss_kib: 40_000 + GROWTH_MAX_KIB, ..small }));
    assert!(grown.findings.is_empty());
    for bigger in [
        Footprint { rss_kib: 40_001 + GROWTH_MAX_KIB, ..small },
        Footprint { descriptors: 6, ..small },
        Footprint { threads: 4, ..small },
        Footprint { shared_files: 1, ..small },
    ] {
        let mut summary = grown.clone();
        summary.judge_footprint(Some(small), Some(bigger));
        red(summary, "grew");
    }
}
