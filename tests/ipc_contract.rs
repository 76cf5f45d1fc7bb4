//! Contract: the services hold to their promises: one commander, no old command, the newest image for latecomers, no peer
//! with another layout, no start without memory, nothing left behind.

mod ipc_rig;

use iceoryx2::prelude::{AttributeSpecifier, ZeroCopySend};
use ipc_rig::{Place, foreign_node};
use noctule::io::wire::message::{
    EnergyscapeHeader, FLAG_EQUAL_DIRECTIONS, OperatorRequest, Request, VelocityCommand, VelocityInput,
};
use noctule::io::wire::telemetry::{CueThresholds, Cues, Health, PlatformVelocity};
use noctule::io::wire::{Checked, WireType};
use noctule::io::{
    ControllerTopics, DaemonTopics, InputPublisher, IpcError, LiveTopics, RawPublisher, RawRefusal, RawShape,
};
use noctule::signal::{
    Cause, DaemonState, Decision, Direction, LayerName, PolarGrid, RawPing, Reason, SampleFormat, Samples, Velocity,
};
use noctule::time::{Clock, Stamp, SystemClock};

fn sensors() -> Vec<String> {
    vec!["front".to_owned(), "left".to_owned()]
}

fn grid() -> PolarGrid {
    let directions = (0..5).map(|index| Direction::horizontal(-0.4 + 0.2 * f64::from(index))).collect();
    PolarGrid::new(directions, 0.3, 0.005, 7)
}

fn daemon(place: &Place) -> DaemonTopics {
    DaemonTopics::open(&place.ipc, &sensors(), &[35, 35]).expect("daemon")
}

fn decision(now: Stamp) -> Decision {
    Decision {
        emitted_at: now,
        velocity: Velocity { linear_m_s: 0.25, angular_rad_s: -0.5 },
        layer: LayerName::ObstacleAvoidance,
        cause: Cause { sensor_index: Some(1), range_m: 1.5, bearing_rad: 0.3, energy: 2.0, threshold: 1.0 },
        speed_limit_m_s: 0.3,
        stuck: true,
    }
}

#[test]
fn a_command_arrives_whole_and_a_changed_bit_is_noticed() {
    let place = Place::new();
    let mut daemon = daemon(&place);
    let controller = ControllerTopics::open(&place.ipc).expect("controller");
    let now = SystemClock.now();
    let sent = VelocityCommand::from_decision(
        &decision(now),
        Velocity { linear_m_s: 0.1, angular_rad_s: -0.5 },
        DaemonState::Degraded,
        Reason::SensorLost,
    );
    assert_eq!(daemon.publish_command(sent, now).expect("sent"), 1);
    let (command, transport) = controller.next_command().expect("arrived");
    assert!(controller.next_command().is_none());
    assert!(command.schema_matches() && command.checksum_matches() && transport != 0);
    assert_eq!((command.epoch, command.sequence), (daemon.epoch(), 1));
    assert_eq!(command.velocity(), Velocity { linear_m_s: 0.1, angular_rad_s: -0.5 });
    assert_eq!(command.daemon_state(), Some(DaemonState::Degraded));
    assert_eq!((command.t_monotonic_ns, command.t_wall_ns), (now.boottime_ns, now.wall_ns));
    assert_eq!((command.cause_sensor, command.layer, command.stuck), (1, 2, 1));
    let bytes = bytemuck::bytes_of(&command);
    for bit in 0..VelocityCommand::CHECKSUM_OFFSET * 8 + 32 {
        let mut changed = bytes.to_vec();
        changed[bit / 8] ^= 1 << (bit % 8);
        let changed: VelocityCommand = bytemuck::pod_read_unaligned(&changed);
        assert!(!changed.checksum_matches(), "bit {bit}");
    }
}

#[test]
fn a_late_controller_never_gets_an_old_command_and_a_slow_one_gets_the_newest_only() {
    let place = Place::new();
    let mut daemon = daemon(&place);
    let now = SystemClock.now();
    let send = |daemon: &mut DaemonTopics| {
        let command = VelocityCommand::standstill(now, DaemonState::Ready, Reason::NotArmed);
        daemon.publish_command(command, now).expect("sent")
    };
    send(&mut daemon);
    let controller = ControllerTopics::open(&place.ipc).expect("controller");
    assert!(controller.next_command().is_none(), "sent before it listened");
    for _ in 0..20 {
        send(&mut daemon);
    }
    let (command, _) = controller.next_command().expect("arrived");
    assert_eq!(command.sequence, 21, "one is kept: the newest");
    assert!(controller.next_command().is_none());
}

#[test]
fn a_latecomer_gets_the_newest_energyscape_at_once() {
    let place = Place::new();
    let daemon = daemon(&place);
    let header = EnergyscapeHeader::for_grid(&grid(), 1, 343.0);
    for sequence in 1..=3 {
        let values: Vec<f32> = (0..35).map(|cell| cell as f32 + sequence as f32 * 100.0).collect();
        let header = EnergyscapeHeader { sequence, t_monotonic_ns: sequence * 10, ..header };
        daemon.publish_energyscape(1, &header, &values).expect("sent");
    }
    let node = foreign_node(&place.root(), &place.params.prefix);
    let service = node
        .service_builder(&"noctule/sonar/left/energyscape".try_into().expect("name"))
        .publish_subscribe::<[f32]>()
        .user_header::<EnergyscapeHeader>()
        .open()
        .expect("opened as any program would");
    let subscriber = service.subscriber_builder().create().expect("subscriber");
    daemon.connect_latecomers().expect("connects");
    let sample = subscriber.receive().expect("receives").expect("at once");
    let header = sample.user_header();
    assert_eq!((header.sequence, header.direction_count, header.range_count, header.sensor_index), (3, 5, 7, 1));
    assert_eq!(header.flags & FLAG_EQUAL_DIRECTIONS, 1);
    assert!((header.direction_first_rad + 0.4).abs() < 1e-12 && (header.direction_step_rad - 0.2).abs() < 1e-12);
    assert_eq!(sample.payload().len(), 35);
    assert_eq!(sample.payload()[34], 334.0);
    assert!(subscriber.receive().expect("receives").is_none(), "the newest only");
    drop(sample);
    assert!(daemon.publish_energyscape(2, &EnergyscapeHeader::blank(), &[0.0]).is_err(), "no such sensor");
    assert!(daemon.publish_energyscape(0, &EnergyscapeHeader::blank(), &[0.0; 36]).is_err(), "too many cells");
}

#[test]
fn cues_health_input_operator_and_odometry_travel() {
    let place = Place::new();
    let daemon = daemon(&place);
    let controller = ControllerTopics::open(&place.ipc).expect("controller");
    let mut planner = InputPublisher::open(&place.ipc, true).expect("planner");
    let now = SystemClock.now();

    assert!(daemon.poll_input().is_none() && daemon.poll_operator().is_none() && daemon.poll_odometry().is_none());
    planner.want(Velocity::forward_m_s(0.2), now).expect("sent");
    let input = daemon.poll_input().expect("arrived");
    assert_eq!(input.wanted(now, 500_000_000), Velocity::forward_m_s(0.2));
    assert_eq!(input.wanted(now.plus_ns(500_000_001), 500_000_000), Velocity::ZERO, "older than 500 ms");

    let pose = noctule::geometry::Pose2 { x_m: 1.0, y_m: -2.0, heading_rad: 0.5 };
    planner.tell(pose, Velocity::forward_m_s(0.1), now).expect("sent");
    assert_eq!(daemon.poll_odometry().map(|odometry| odometry.pose()), Some(pose));

    for request in [Request::Arm, Request::Stop, Request::Reset] {
        controller.publish_operator(OperatorRequest::new(request, 5, 1, now)).expect("sent");
    }
    let requests: Vec<_> = std::iter::from_fn(|| daemon.poll_operator()).filter_map(|r| r.request()).collect();
    assert_eq!(requests, [Request::Arm, Request::Stop, Request::Reset], "none is lost");
    let echo: Vec<_> = std::iter::from_fn(|| controller.next_operator()).filter_map(|r| r.request()).collect();
    assert_eq!(echo.len(), 3, "the controller hears them, too");

    controller.publish_platform(PlatformVelocity { linear_m_s: 0.1, ..PlatformVelocity::blank() }).expect("sent");
    assert_eq!(daemon.poll_platform().map(|velocity| velocity.linear_m_s), Some(0.1));
    daemon.publish_cues(Cues::new(&noctule::signal::Cues::default(), &CueThresholds::default())).expect("sent");
    daemon.publish_health(Health::blank()).expect("sent");
}

#[test]
fn a_spoilt_arm_request_is_none_but_a_spoilt_stop_still_stops() {
    let now = SystemClock.now();
    for (request, expected) in [(Request::Arm, None), (Request::Reset, None), (Request::Stop, Some(Request::Stop))] {
        let sound = OperatorRequest::new(request, 5, 1, now);
        assert_eq!(sound.request(), Some(request));
        assert_eq!(OperatorRequest { epoch: 6, ..sound }.request(), expected);
        assert_eq!(OperatorRequest { schema_hash: 0, ..sound }.request(), expected);
    }
    assert_eq!(OperatorRequest { request: 9, ..OperatorRequest::new(Request::Stop, 0, 1, now) }.request(), None);
}

#[test]
fn an_unfit_wanted_velocity_counts_as_standing_still() {
    let now = SystemClock.now();
    let sound = VelocityInput::new(1, now, Velocity::forward_m_s(0.2));
    for unfit in [
        VelocityInput { linear_m_s: f64::NAN, ..sound },
        VelocityInput { angular_rad_s: f64::INFINITY, ..sound },
        VelocityInput { schema_hash: 1, ..sound },
        VelocityInput { t_monotonic_ns: now.boottime_ns + 50_000_001, ..sound },
        VelocityInput { t_monotonic_ns: 0, ..sound },
        VelocityInput { t_monotonic_ns: u64::MAX, ..sound },
    ] {
        assert_eq!(unfit.wanted(now, 500_000_000), Velocity::ZERO, "{unfit:?}");
    }
}

#[test]
fn a_second_daemon_and_a_second_controller_are_refused_with_69() {
    let place = Place::new();
    let _daemon = daemon(&place);
    match DaemonTopics::open(&place.ipc, &sensors(), &[35, 35]) {
        Err(error @ IpcError::DaemonRunning { pid, .. }) => {
            assert_eq!((pid, error.exit_code()), (std::process::id(), 69));
        }
        other => panic!("{other:?}"),
    }
    let _controller = ControllerTopics::open(&place.ipc).expect("controller");
    match ControllerTopics::open(&place.ipc) {
        Err(error @ IpcError::PublisherPresent { .. }) => {
            assert_eq!(error.exit_code(), 69);
            assert!(error.to_string().contains("noctule/platform"), "{error}");
            assert!(error.to_string().contains(&std::process::id().to_string()), "{error}");
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_squatter_on_the_command_topic_is_named_and_the_daemon_does_not_start() {
    let place = Place::new();
    let node = foreign_node(&place.root(), &place.params.prefix);
    let hash = format!("{:016x}", VelocityCommand::SCHEMA_HASH);
    let attributes = AttributeSpecifier::new()
        .define(&"noctule.schema".try_into().expect("key"), &hash.as_str().try_into().expect("value"))
        .expect("attribute");
    let service = node
        .service_builder(&"noctule/command".try_into().expect("name"))
        .publish_subscribe::<VelocityCommand>()
        .max_publishers(1)
        .max_nodes(32)
        .subscriber_max_buffer_size(1)
        .create_with_attributes(&attributes)
        .expect("squats");
    let _squatter = service.publisher_builder().create().expect("publishes");
    match DaemonTopics::open(&place.ipc, &sensors(), &[35, 35]) {
        Err(error @ IpcError::PublisherPresent { .. }) => {
            assert_eq!(error.exit_code(), 69);
            assert!(error.to_string().contains("noctule/command"), "{error}");
            assert!(error.to_string().contains(&std::process::id().to_string()), "{error}");
        }
        other => panic!("{other:?}"),
    }
}

/// The same name and size as ours, with V and omega changed about.
#[repr(C)]
#[derive(Debug, Clone, Copy, ZeroCopySend)]
#[type_name("noctule.VelocityCommand.v1")]
struct SwappedCommand {
    words: [u64; 18],
}

#[test]
fn a_peer_of_another_build_is_refused_by_the_schema_though_name_and_size_agree() {
    let place = Place::new();
    assert_eq!(size_of::<SwappedCommand>(), size_of::<VelocityCommand>());
    let node = foreign_node(&place.root(), &place.params.prefix);
    let attributes = AttributeSpecifier::new()
        .define(&"noctule.schema".try_into().expect("key"), &"0123456789abcdef".try_into().expect("value"))
        .expect("attribute");
    let _service = node
        .service_builder(&"noctule/command".try_into().expect("name"))
        .publish_subscribe::<SwappedCommand>()
        .max_publishers(1)
        .max_nodes(32)
        .subscriber_max_buffer_size(1)
        .create_with_attributes(&attributes)
        .expect("made by another build");
    for error in [
        ControllerTopics::open(&place.ipc).map(drop).expect_err("refused"),
        DaemonTopics::open(&place.ipc, &sensors(), &[35, 35]).map(drop).expect_err("refused"),
    ] {
        assert!(matches!(error, IpcError::Incompatible { .. }), "{error:?}");
        assert_eq!(error.exit_code(), 69);
        assert!(error.to_string().contains("noctule/command"), "{error}");
    }
}

#[test]
fn raw_pings_travel_in_every_format_and_what_does_not_fit_is_refused() {
    for (format, samples) in [
        (SampleFormat::Pdm, Samples::Pdm((0..64).collect())),
        (SampleFormat::PcmI16, Samples::PcmI16((-64..64).collect())),
        (SampleFormat::PcmF32, Samples::PcmF32((0..128).map(|value| value as f32 * 0.5).collect())),
    ] {
        let place = Place::new();
        let shape = RawShape { format, sample_rate_hz: 450e3, channel_count: 2, sample_count: 64 };
        let live = LiveTopics::open(&place.ipc, &[("front".to_owned(), shape)]).expect("live");
        let driver = RawPublisher::open(&place.ipc, "front", shape).expect("driver");
        let emitted_at = SystemClock.now();
        let ping = RawPing { sensor_index: 0, sequence: 9, emitted_at, samples: samples.into() };
        let mut received = RawPing { samples: Samples::zeros(format, shape.len()).into(), ..ping.clone() };
        received.sequence = 0;
        assert!(live.poll(0, &mut received, SystemClock.now()).is_none());
        driver.publish(&ping).expect("sent");
        assert_eq!(live.poll(0, &mut received, SystemClock.now()), Some(Ok(())));
        assert_eq!(received, ping);

        driver.publish(&RawPing { sensor_index: 1, ..ping.clone() }).expect("sent");
        let refusal = live.poll(0, &mut received, SystemClock.now()).expect("arrived").expect_err("refused");
        assert_eq!(refusal, RawRefusal::Header { field: "sensor_index", found: 1.0, allowed: 0.0 });
        driver.publish(&RawPing { samples: Samples::zeros(format, 5).into(), ..ping.clone() }).expect("sent");
        let refusal = live.poll(0, &mut received, SystemClock.now()).expect("arrived").expect_err("refused");
        assert_eq!(refusal, RawRefusal::Length { found: 5, allowed: shape.len() });
        assert_eq!(received, ping, "unchanged by what was refused");
        assert!(driver.publish(&RawPing { samples: Samples::zeros(format, shape.len() + 1).into(), ..ping }).is_err());
    }
}

#[test]
fn the_daemon_asks_for_no_less_memory_than_it_uses_and_leaves_nothing_behind() {
    let place = Place::new();
    let cells = [180 * 941, 180 * 941];
    let topics = DaemonTopics::open(&place.ipc, &sensors(), &cells).expect("daemon");
    let controller = ControllerTopics::open(&place.ipc).expect("controller");
    let used: u64 = std::fs::read_dir("/dev/shm")
        .expect("shared memory")
        .flatten()
        .filter(|entry| entry.file_name().to_string_lossy().starts_with(&place.params.prefix))
        .map(|entry| std::os::unix::fs::MetadataExt::blocks(&entry.metadata().expect("there")) * 512)
        .sum();
    let needed = DaemonTopics::needed_bytes(&sensors(), &cells);
    assert!(used > 2 * 18 * 180 * 941 * 4, "every page is reserved: {used}");
    assert!(needed >= used, "{needed} announced, {used} used");
    assert!(needed < used * 5 / 4, "{needed} announced, {used} used: far too cautious");
    assert!(topics.is_intact());
    drop(controller);
    drop(topics);
    assert_eq!(place.left_behind(), Vec::<String>::new());
}

#[test]
fn more_memory_than_there_is_is_refused_with_73_and_both_numbers() {
    let place = Place::new();
    let error = DaemonTopics::open(&place.ipc, &sensors(), &[1 << 40, 1]).map(drop).expect_err("refused");
    assert_eq!(error.exit_code(), 73);
    let IpcError::NoSpace { needed, free, .. } = error else { panic!("{error:?}") };
    assert!(needed > 1 << 42 && error_names(&[needed, free], &IpcError::NoSpace { place: "/dev/shm", needed, free }));
    assert_eq!(place.left_behind(), Vec::<String>::new());
}

fn error_names(numbers: &[u64], error: &IpcError) -> bool {
    numbers.iter().all(|number| error.to_string().contains(&number.to_string()))
}
