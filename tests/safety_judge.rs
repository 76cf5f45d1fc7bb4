//! Contract: the judge is to be trusted. It reads the topic as documented, sees what a controller must not do, misses nothing, and
//! its own base stops 250 ms after the last word.

mod checks;
mod ipc_rig;
mod judge;

use checks::{figure, trials};
use iceoryx2::port::publisher::Publisher;
use iceoryx2::prelude::{AttributeVerifier, Node, ipc};
use ipc_rig::{Place, foreign_node};
use judge::{HOLD, Heard, Judge, Limits, MS, Record, TRACK, Z2_NS, base_driver, now_ns};
use noctule::io::wire::WireType;
use noctule::io::wire::telemetry::PlatformVelocity;
use std::process::Command;
use std::time::Duration;

const SOON: Duration = Duration::from_secs(5);
const LIMITS: Limits = Limits { linear_m_s: 0.3, angular_rad_s: 1.0, linear_m_s2: 1.0, angular_rad_s2: 3.0 };

#[test]
fn judge_process() {
    judge::serve_if_asked();
}

fn heard(at_ms: u64, linear_m_s: f64) -> Heard {
    let state = if linear_m_s == 0.0 { HOLD } else { TRACK };
    Heard {
        at_ns: at_ms * MS,
        sent_ns: at_ms * MS,
        sequence: at_ms,
        linear_m_s,
        angular_rad_s: 0.0,
        epoch: 1,
        command_sequence: at_ms / 100,
        captured_ns: (at_ms / 100 * 100) * MS,
        state,
        reason: 0,
        daemon_state: 3,
    }
}

/// Motion at 50 Hz until `last_motion_ms`, zero from then to two seconds.
fn drive_until(last_motion_ms: u64) -> Record {
    let samples = (0..100).map(|tick| heard(tick * 20, if tick * 20 <= last_motion_ms { 0.2 } else { 0.0 }));
    Record { heard: samples.collect(), motors: Vec::new() }
}

#[test]
fn a_late_zero_is_seen_to_the_tick() {
    // Last capture at 1,000 ms: zero at 1,340 ms is in time, at 1,360 it is not, and a single motion after a zero counts as motion.
    let z2 = |record: &Record| record.zero_at(1_000 * MS).map(|zero_ns| zero_ns - 1_000 * MS);
    assert_eq!(z2(&drive_until(1_320)), Some(340 * MS));
    assert!(z2(&drive_until(1_340)).is_some_and(|found| found > Z2_NS));
    let mut planted = drive_until(1_320);
    planted.heard[80].linear_m_s = 1e-300;
    assert_eq!(z2(&planted), Some(620 * MS), "one tiny motion at 1,600 ms");
    assert_eq!(planted.motion_after(1_340 * MS).map(|heard| heard.at_ns), Some(1_600 * MS));
    planted.heard[80].linear_m_s = f64::NAN;
    assert!(planted.motion_after(1_340 * MS).is_some(), "NaN moves");
    assert_eq!(z2(&drive_until(2_000)), None, "a robot that never stands has no time to zero");
    assert_eq!(Record::default().zero_at(0), None, "and one that nobody heard has none either");
}

#[test]
fn limits_steps_silence_and_way_are_seen() {
    let mut record = Record {
        heard: (0..50).map(|tick| heard(tick * 20, (tick as f64 * 0.01).min(0.3))).collect(),
        motors: Vec::new(),
    };
    assert_eq!(record.limit_violations(&LIMITS), 0);
    record.heard[40].linear_m_s = 0.31;
    assert!(record.limit_violations(&LIMITS) >= 1, "too fast");
    record.heard[40].linear_m_s = 0.27;
    assert!(record.limit_violations(&LIMITS) >= 1, "a step of 0.03 m/s in 20 ms");
    record.heard[40].linear_m_s = f64::NAN;
    assert!(record.limit_violations(&LIMITS) >= 1);
    let silence_ns = |record: &Record| record.longest_silence_ns(0, 980 * MS);
    assert_eq!(silence_ns(&record), 20 * MS);
    record.heard.drain(10..20);
    assert_eq!(silence_ns(&record), 220 * MS);
    record.take("M 0 0.3 0");
    record.take("M 350000000 0 0");
    // 0.3 m/s for 350 ms, then 3 m/s^2: the 12 cm of the contract.
    assert!((record.travel_m(0, 980 * MS) - 0.12).abs() < 1e-9, "{}", record.travel_m(0, 980 * MS));
    assert_eq!(record.motors_stand_at(0), Some(350 * MS));
    record.take("M 900000000 0.1 0");
    assert_eq!(record.motors_stand_at(0), None, "it moves again");
}

#[test]
fn the_judges_offsets_and_schema_are_those_that_noctule_topics_prints() {
    let output = Command::new(env!("CARGO_BIN_EXE_noctule")).args(["topics", "--json"]).output().expect("topics");
    let topics: serde_json::Value = serde_json::from_slice(&output.stdout).expect("json");
    let services = topics["services"].as_array().expect("services");
    let platform = services.iter().find(|service| service["name"] == "noctule/platform").expect("platform");
    let payload = &platform["payload"];
    assert_eq!(payload["size"], size_of::<base_driver::Sample>());
    assert_eq!(payload["alignment"], align_of::<base_driver::Sample>());
    assert_eq!(payload["schema_hash"], base_driver::SCHEMA_HASH);
    use base_driver::offset;
    for (name, expected) in [
        ("schema_hash", offset::SCHEMA_HASH),
        ("sequence", offset::SEQUENCE),
        ("t_monotonic_ns", offset::SENT_NS),
        ("linear_m_s", offset::LINEAR_M_S),
        ("angular_rad_s", offset::ANGULAR_RAD_S),
        ("epoch", offset::EPOCH),
        ("command_sequence", offset::COMMAND_SEQUENCE),
        ("command_t_monotonic_ns", offset::CAPTURED_NS),
        ("state", offset::STATE),
        ("reason", offset::REASON),
        ("daemon_state", offset::DAEMON_STATE),
    ] {
        let fields = payload["fields"].as_array().expect("fields");
        let field = fields.iter().find(|field| field["name"] == name).unwrap_or_else(|| panic!("no field {name}"));
        assert_eq!(field["offset"], expected, "{name}");
    }
}

#[test]
fn the_base_obeys_nothing_old_nothing_from_the_future_and_no_nan() {
    let second = 1_000 * MS;
    let wanted = |sent_ns, linear_m_s| base_driver::Wanted { sent_ns, linear_m_s, angular_rad_s: 0.1 };
    assert_eq!(wanted(second, 0.2).at(second + 250 * MS), (0.2, 0.1));
    assert_eq!(wanted(second, 0.2).at(second + 250 * MS + 1), (0.0, 0.0));
    assert_eq!(wanted(second, 0.2).at(second - 50 * MS), (0.2, 0.1));
    assert_eq!(wanted(second, 0.2).at(second - 50 * MS - 1), (0.0, 0.0));
    assert_eq!(wanted(u64::MAX, 0.2).at(second), (0.0, 0.0));
    assert_eq!(wanted(second, f64::NAN).at(second), (0.0, 0.0));
    assert_eq!(wanted(second, f64::INFINITY).at(second), (0.0, 0.0));
}

/// A controller that does what a test wants: what the judge must see through.
struct FakeController {
    publisher: Publisher<ipc::Service, PlatformVelocity, ()>,
    sequence: u64,
    _node: Node<ipc::Service>,
}

impl FakeController {
    fn new(place: &Place) -> Self {
        let node = foreign_node(&place.root(), &place.params.prefix);
        let hash = format!("{:016x}", PlatformVelocity::SCHEMA_HASH);
        let schema = AttributeVerifier::new()
            .require(&"noctule.schema".try_into().expect("key"), &hash.as_str().try_into().expect("value"))
            .expect("attribute");
        let service = node
            .service_builder(&"noctule/platform".try_into().expect("name"))
            .publish_subscribe::<PlatformVelocity>()
            .subscriber_max_buffer_size(4)
            .open_or_create_with_attributes(&schema)
            .expect("service");
        Self { publisher: service.publisher_builder().create().expect("publisher"), sequence: 0, _node: node }
    }

    fn say_for(&mut self, duration_ms: u64, linear_m_s: f64) -> u64 {
        let mut sent_ns = 0;
        for _ in 0..duration_ms / 20 {
            self.sequence += 1;
            sent_ns = now_ns();
            let sample = PlatformVelocity {
                sequence: self.sequence,
                t_monotonic_ns: sent_ns,
                linear_m_s,
                ..PlatformVelocity::blank()
            };
            self.publisher.send_copy(sample).expect("sent");
            std::thread::sleep(Duration::from_millis(20));
        }
        sent_ns
    }
}

/// A controller that says zero, and a judge who has begun to hear it.
fn listening(place: &Place) -> (FakeController, Judge) {
    let mut controller = FakeController::new(place);
    let mut judge = Judge::start(&place.root(), &place.params.prefix, place.directory.path());
    while judge.record.heard.is_empty() {
        controller.say_for(20, 0.0);
        judge.look();
    }
    (controller, judge)
}

#[test]
fn a_controller_that_falls_silent_is_stopped_by_the_base_after_250_ms() {
    let place = Place::new();
    let (mut controller, mut judge) = listening(&place);
    let (mut worst_ns, count) = (0, trials(30, 3));
    for _ in 0..count {
        controller.say_for(100, 0.1);
        let last_ns = controller.say_for(20, 0.2);
        judge.watch_for(Duration::from_millis(400));
        let stand_ns = judge.record.motors_stand_at(last_ns).expect("stands") - last_ns;
        worst_ns = worst_ns.max(stand_ns);
        assert!(stand_ns >= 250 * MS, "not by silence: {} ms", stand_ns / MS);
        assert_eq!(judge.record.zero_at(last_ns), None, "nobody said zero: only the base stood");
    }
    figure(
        12,
        "silence to standing motors, the base alone",
        format!("{:.1} ms", worst_ns as f64 * 1e-6),
        "<= 300 ms",
        count,
    );
    assert!(worst_ns <= 300 * MS);
}

#[test]
fn a_live_controller_that_says_zero_late_or_moves_again_is_caught() {
    let place = Place::new();
    let (mut controller, mut judge) = listening(&place);
    let fault_ns = now_ns();
    controller.say_for(400, 0.2);
    controller.say_for(200, 0.0);
    judge.watch_until(SOON, "zero", |heard| !heard.moves());
    let zero_ns = judge.record.zero_at(fault_ns).expect("zero") - fault_ns;
    assert!(zero_ns > Z2_NS, "a zero 400 ms late passes for one in time: {} ms", zero_ns / MS);
    let stood_ns = now_ns();
    controller.say_for(20, 0.01);
    controller.say_for(100, 0.0);
    judge.watch_for(Duration::from_millis(50));
    assert!(judge.record.motion_after(stood_ns).is_some(), "a single motion is lost");
}
