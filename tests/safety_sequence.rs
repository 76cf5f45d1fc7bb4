//! Contract: whatever order, number or stamp pings arrive with, each is used once and none after a later one; gaps degrade, a
//! restarted driver is believed again; emissions that drift apart are told at exactly their limits.

mod checks;
mod perception_rig;
mod safety_rig;

use checks::{figure, trials};
use noctule::safety::plausibility::{Plausibility, SequenceStep, sequence_step};
use noctule::safety::{DaemonState, SensorFindings};
use noctule::signal::{RawPing, Reason, Samples};
use noctule::sim::SimParams;
use noctule::time::Stamp;
use perception_rig::{MS, PERIOD_NS, Random, Rig, config, hall, recorded};
use safety_rig::DaemonRig;
use std::collections::HashSet;
use std::sync::Arc;

const T0_NS: u64 = 1_000_000 * MS;

fn ping(emission: u64, sequence: u64) -> RawPing {
    RawPing {
        sensor_index: 0,
        sequence,
        emitted_at: Stamp { boottime_ns: T0_NS + emission * PERIOD_NS, wall_ns: 0 },
        samples: Arc::new(Samples::PcmF32(vec![emission as f32, 1.0])),
    }
}

/// Deliveries as a bad network and a bad driver make them: each emission lost, doubled or delayed at random; the driver begins
/// somewhere, often just below the wrap, and again at zero after some hundred emissions.
fn deliveries(count: u64, random: &mut Random) -> Vec<RawPing> {
    let mut base = if random.below(3) == 0 { random.next() } else { u64::MAX - random.below(20) as u64 };
    let mut deliveries: Vec<(u64, RawPing)> = Vec::new();
    for emission in 0..count {
        if random.below(400) == 0 {
            base = 0_u64.wrapping_sub(emission);
        }
        let made = ping(emission, base.wrapping_add(emission));
        let copies = [0, 1, 1, 1, 1, 1, 1, 1, 1, 2][random.below(10)];
        for copy in 0..copies {
            let late = if random.below(8) == 0 { random.below(6) as u64 } else { 0 };
            deliveries.push((10 * (emission + late) + copy, made.clone()));
        }
    }
    deliveries.sort_by_key(|(at, _)| *at);
    deliveries.into_iter().map(|(_, ping)| ping).collect()
}

/// Emissions used twice or after a later one, among those that `uses` takes.
fn misused(pings: &[RawPing], mut uses: impl FnMut(&RawPing) -> bool) -> (usize, usize) {
    let (mut seen, mut latest_ns, mut bad, mut used) = (HashSet::new(), 0, 0, 0);
    for ping in pings {
        if uses(ping) {
            let emitted_ns = ping.emitted_at.boottime_ns;
            bad += usize::from(!seen.insert(emitted_ns) || emitted_ns < latest_ns);
            latest_ns = latest_ns.max(emitted_ns);
            used += 1;
        }
    }
    (bad, used)
}

#[test]
fn no_ping_is_used_twice_or_after_a_later_one_and_a_restarted_driver_is_believed_again() {
    const STREAM: u64 = 1_000;
    let wanted = trials(100_000, 3_000);
    let mut random = Random(22);
    let (mut bad, mut made, mut used, mut silent_longest, mut frozen, mut naive_bad) = (0, 0, 0, 0_usize, 0, 0);
    while made < wanted {
        let pings = deliveries(STREAM, &mut random);
        let mut memory = Plausibility::default();
        let mut silent = 0;
        let (worse, taken) = misused(&pings, |ping| {
            let found = memory.observe(ping);
            frozen += usize::from(found.frozen);
            silent = if found.step.usable() { 0 } else { silent + 1 };
            silent_longest = silent_longest.max(silent);
            found.step.usable()
        });
        bad += worse;
        used += taken;
        made += pings.len();
        // The negative control: numbers alone, believed as they come.
        naive_bad += misused(&pings, |_| true).0;
        let mut last = None;
        let by_difference = |ping: &RawPing| {
            let fresh = sequence_step(last, ping.sequence) != SequenceStep::Duplicate;
            last = Some(ping.sequence);
            fresh
        };
        naive_bad += misused(&pings, by_difference).0;
    }
    let told = format!("{bad} misused, {used} used, longest wait for a restarted driver {silent_longest} deliveries");
    figure(22, "pings used twice or backwards", told, "0", made);
    assert_eq!((bad, frozen), (0, 0));
    // Lost and late pings delay the five in a row that a restart takes.
    assert!(used > made / 2 && silent_longest < 200, "{used} of {made}, {silent_longest}");
    assert!(naive_bad > 100, "a judge that cannot see misuse: {naive_bad}");
}

#[test]
fn three_gaps_in_a_row_degrade_and_two_do_not() {
    let findings = |gaps: usize| {
        let mut memory = Plausibility::default();
        let mut found = SensorFindings::GOOD;
        memory.observe(&ping(0, 0));
        for gap in 1..=gaps as u64 {
            found.gaps_in_a_row = memory.observe(&ping(2 * gap, 2 * gap)).gaps_in_a_row;
        }
        found
    };
    for (gaps, expected) in [(2, DaemonState::Active), (3, DaemonState::Degraded)] {
        let mut rig = DaemonRig::in_state(DaemonState::Active);
        assert_eq!(rig.group(|group| group.sensors[0] = findings(gaps)).state, expected);
    }
}

#[test]
fn a_stamp_from_the_future_does_not_silence_a_sensor_for_ever() {
    let mut memory = Plausibility::default();
    (0..10).for_each(|number| assert!(memory.observe(&ping(number, number)).step.usable()));
    assert!(memory.observe(&ping(1_000_000, 10)).step.usable(), "the daemon judges its age");
    let usable: Vec<bool> = (11..20).map(|number| memory.observe(&ping(number, number)).step.usable()).collect();
    assert_eq!(usable, [false, false, false, false, true, true, true, true, true]);
}

#[test]
fn emissions_apart_are_told_at_exactly_their_limits() {
    let config = config();
    let sets = recorded(&config, hall(), SimParams::default(), 4, &[]);
    let us = 1_000_u64;
    use DaemonState::{Active, Degraded, Fault, Stopped};
    let lost = |reason: Reason| [Reason::SensorLost, Reason::ViewMissing].contains(&reason);
    // Sensor 1 late by so much. The front sensor is the oldest then, and nothing but its age tells it from another trigger.
    let cases = [
        (0, Active),
        (400, Active),
        (2 * us - 1, Active),
        (2 * us, Degraded),
        (2 * us + 1, Degraded),
        (100 * us - 1, Degraded),
        (100 * us, Fault),
        (100 * us + 1, Fault),
        (1_000 * us, Fault),
        (PERIOD_NS - 1, Fault),
    ];
    let mut checked = 0;
    for (apart_ns, expected) in cases {
        let mut rig = Rig::new(&config);
        rig.drive(&sets);
        let outcome = rig.step(&sets[checked % 4], |set| set.pings[1].emitted_at.boottime_ns -= apart_ns);
        assert_eq!(outcome.output.state, expected, "{apart_ns} ns: {}", outcome.output.reason);
        checked += 1;
    }
    for apart_ns in [PERIOD_NS, PERIOD_NS + 1, 7 * PERIOD_NS] {
        let mut rig = Rig::new(&config);
        rig.drive(&sets);
        let outcome = rig.step(&sets[checked % 4], |set| set.pings[1].emitted_at.boottime_ns -= apart_ns);
        let (state, reason) = (outcome.output.state, outcome.output.reason);
        assert!([Degraded, Stopped].contains(&state) && lost(reason), "{apart_ns} ns: {state} {reason}");
        assert!(!outcome.findings[1].present && outcome.findings[0].present, "{apart_ns} ns");
        checked += 1;
    }
    figure(30, "emissions apart judged at -1, 0 and +1 ns of each limit", "all as told", "exact", checked);
}

/// The negative control of the limits: a spread that is not told to the daemon has no consequence.
#[test]
fn a_daemon_that_is_not_told_of_the_spread_drives_on() {
    let mut rig = DaemonRig::in_state(DaemonState::Active);
    assert_eq!(rig.group(|group| group.desync_ns = 0).state, DaemonState::Active);
    assert_eq!(rig.group(|group| group.desync_ns = 1_000_000).state, DaemonState::Fault);
}
