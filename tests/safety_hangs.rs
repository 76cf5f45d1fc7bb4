//! Contract (check 10, the living side): a peer killed between two file-system calls silences nobody. The controller goes on telling
//! the platform what to do within the platform's own 250 ms, and ends in time, although the transport waits for what is half made.

mod checks;
mod crash_rig;
mod ipc_rig;
mod namespace;

use crash_rig::{Killed, Shim, appears, this_program, wait_at_most, was_killed};
use ipc_rig::{Controller, MS, Place, foreign_node};
use namespace::isolated;
use noctule::io::wire::message::Request;
use noctule::io::{DaemonTopics, Ipc, IpcParams, OperatorClient, PlatformSubscriber};
use noctule::time::{Clock, SystemClock};
use std::fs;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// After this silence a platform stops by itself.
const SILENCE_LIMIT_NS: u64 = 250 * MS;
const SOON: Duration = Duration::from_secs(5);
/// A process that is asked to end does so within this time.
const END_LIMIT: Duration = Duration::from_secs(1);
const LISTENING: Duration = Duration::from_millis(500);

fn place_of_a_child() -> Option<(PathBuf, IpcParams)> {
    let root = PathBuf::from(std::env::var_os("NOCTULE_TEST_ROOT")?);
    let prefix = std::env::var("NOCTULE_TEST_PREFIX").ok()?;
    Some((root.clone(), IpcParams { root: Some(root), prefix }))
}

/// Not a test of its own: a daemon that starts and ends.
#[test]
fn daemon_life() {
    let Some((_, params)) = place_of_a_child() else { return };
    let ipc = Ipc::open(&params).expect("opened");
    drop(DaemonTopics::open(&ipc, &["front".to_owned()], &[35]).expect("daemon"));
}

/// Not a test of its own: an operator that asks and ends.
#[test]
fn operator_life() {
    let Some((_, params)) = place_of_a_child() else { return };
    let operator = OperatorClient::open(&Ipc::open(&params).expect("opened")).expect("operator");
    operator.send(Request::Stop, 0).expect("sent");
}

/// Not a test of its own: the transport alone, listening until it is told to end.
#[test]
fn bare_listener() {
    let Some((root, params)) = place_of_a_child() else { return };
    let node = foreign_node(&root, &params.prefix);
    let builder = node.service_builder(&"bare".try_into().expect("name"));
    let service = builder.publish_subscribe::<u64>().open_or_create().expect("service");
    let subscriber = service.subscriber_builder().create().expect("subscriber");
    fs::write(root.with_extension("ready"), "").expect("told");
    while !root.with_extension("stop").exists() {
        let _ = subscriber.receive();
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Not a test of its own: the transport alone, sending.
#[test]
fn bare_sender() {
    let Some((root, params)) = place_of_a_child() else { return };
    let node = foreign_node(&root, &params.prefix);
    let builder = node.service_builder(&"bare".try_into().expect("name"));
    let service = builder.publish_subscribe::<u64>().open_or_create().expect("service");
    service.publisher_builder().create().expect("publisher").send_copy(1).expect("sent");
}

/// The numbers of the calls of `victim`, beside what `peer` starts, that make a connection without a size.
fn half_made_connections(shim: &Shim, victim: &str, peer: impl Fn(&Place) -> Box<dyn std::any::Any>) -> Vec<usize> {
    let place = Place::new();
    let _peer = peer(&place);
    let log = place.directory.path().join("calls");
    let mut command = this_program(&place, victim);
    let child = shim.listing(&mut command, &place, &log).spawn().expect("started");
    assert!(wait_at_most(&mut Killed(child), SOON).is_some_and(|status| status.success()), "{victim}");
    let calls = fs::read_to_string(&log).expect("calls");
    let half_made = |call: &&str| call.starts_with("shm_open") && call.ends_with(".connection");
    calls.lines().enumerate().filter(|(_, call)| half_made(call)).map(|(index, _)| index + 1).collect()
}

fn kill_at(shim: &Shim, place: &Place, victim: &str, at: usize) {
    let mut command = this_program(place, victim);
    let child = shim.killing(&mut command, place, at).spawn().expect("started");
    let status = wait_at_most(&mut Killed(child), SOON);
    assert!(status.is_some_and(was_killed), "{victim} at call {at}: {status:?}");
}

/// A controller with all of its ports.
fn controller(place: &Place) -> Controller {
    let controller = Controller::start(place, &[]);
    let deadline = Instant::now() + SOON;
    while place.left_behind().iter().filter(|name| name.ends_with("port_tag")).count() < 4 {
        assert!(Instant::now() < deadline, "the controller does not start");
        std::thread::sleep(Duration::from_millis(2));
    }
    controller
}

/// The longest silence of a controller's output after the death of `victim`, and how long its end took when asked for then.
fn silence_and_end(shim: &Shim, victim: &str, at: usize) -> (u64, Duration) {
    let place = Place::new();
    let mut controller = controller(&place);
    let platform = PlatformSubscriber::open(&place.ipc).expect("platform");
    let begun = Instant::now();
    while platform.next_velocity().is_none() {
        assert!(begun.elapsed() < SOON, "the controller says nothing");
        std::thread::sleep(Duration::from_millis(1));
    }
    kill_at(shim, &place, victim, at);
    let mut heard = vec![SystemClock.now().boottime_ns];
    let begun = Instant::now();
    while begun.elapsed() < LISTENING {
        let newest = *heard.last().expect("one");
        let arrived = std::iter::from_fn(|| platform.next_velocity()).map(|sample| sample.t_monotonic_ns);
        heard.extend(arrived.filter(|&sent_ns| sent_ns > newest));
        std::thread::sleep(Duration::from_millis(2));
    }
    heard.push(SystemClock.now().boottime_ns);
    let begun = Instant::now();
    controller.signal(rustix::process::Signal::TERM);
    assert!(controller.wait(SOON).success(), "{victim} at call {at}");
    let longest = heard.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap_or(u64::MAX);
    (longest, begun.elapsed())
}

#[test]
fn a_controller_never_falls_silent_for_a_peer_that_was_killed_while_it_connected() {
    isolated("a_controller_never_falls_silent_for_a_peer_that_was_killed_while_it_connected", "256m", || {
        let Some(shim) = Shim::build() else { return };
        let (mut worst_ns, mut worst_end) = (0, Duration::ZERO);
        let mut trials = 0;
        for victim in ["daemon_life", "operator_life"] {
            let points = half_made_connections(&shim, victim, |place| Box::new(controller(place)));
            assert!(points.len() >= 2, "{victim} makes connections with the controller: {points:?}");
            for at in points {
                let (silence_ns, end) = silence_and_end(&shim, victim, at);
                (worst_ns, worst_end) = (worst_ns.max(silence_ns), worst_end.max(end));
                trials += 1;
            }
        }
        let found = format!("{} ms", worst_ns / MS);
        checks::figure(10, "longest silence of a living controller", found, "<= 250 ms", trials);
        checks::figure(
            10,
            "end of that controller on SIGTERM",
            format!("{} ms", worst_end.as_millis()),
            "<= 1 s",
            trials,
        );
        assert!(worst_ns <= SILENCE_LIMIT_NS, "{worst_ns} ns");
        assert!(worst_end <= END_LIMIT, "{worst_end:?}");
    });
}

/// Negative control: the transport alone waits for ever as soon as it has to do with the half-made file, here when it ends.
#[test]
fn without_our_sweep_a_listener_of_the_transport_hangs_at_its_end_for_the_same_reason() {
    isolated("without_our_sweep_a_listener_of_the_transport_hangs_at_its_end_for_the_same_reason", "64m", || {
        let Some(shim) = Shim::build() else { return };
        let listener = |place: &Place| {
            let child = Killed(this_program(place, "bare_listener").spawn().expect("started"));
            assert!(appears(&place.root().with_extension("ready"), SOON), "the listener does not start");
            child
        };
        let points = half_made_connections(&shim, "bare_sender", |place| Box::new(listener(place)));
        let place = Place::new();
        let mut listener = listener(&place);
        kill_at(&shim, &place, "bare_sender", *points.first().expect("a connection"));
        fs::write(place.root().with_extension("stop"), "").expect("told");
        let hangs = wait_at_most(&mut listener, 2 * END_LIMIT).is_none();
        checks::figure(
            10,
            "negative control: a listener of the transport alone",
            format!("hangs: {hangs}"),
            "hangs",
            1,
        );
        assert!(hangs);
    });
}
