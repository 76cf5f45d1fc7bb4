//! Contract: the bytes are CDR as ROS 2 writes it, and what goes in comes out bit for bit; damaged bytes are errors.

use super::*;
use crate::io::wire::message::{Odometry, RawHeader, VelocityCommand};
use crate::io::wire::telemetry::Health;
use crate::signal::{Direction, PolarGrid, RangeScan, Reading};
use crate::time::Stamp;
use std::sync::Arc;

#[test]
fn a_header_is_laid_out_as_the_standard_says() {
    let mut bytes = Vec::new();
    encode_into(&TwistStamped { header: Header::new(5_000_000_007, "ab"), ..TwistStamped::default() }, &mut bytes)
        .expect("encoded");
    // Encapsulation, seconds, nanoseconds, length with the terminator, text, padding to eight from behind the encapsulation.
    let expected = [0, 1, 0, 0, 5, 0, 0, 0, 7, 0, 0, 0, 3, 0, 0, 0, b'a', b'b', 0];
    assert_eq!(bytes[..19], expected);
    assert_eq!(bytes.len(), 4 + 16 + 6 * 8);
}

#[test]
fn every_value_of_a_wire_type_comes_back_bit_for_bit() {
    let command = VelocityCommand {
        sequence: u64::MAX - 1,
        linear_m_s: -0.0,
        angular_rad_s: f64::from_bits(0x7ff8_0000_0000_0001),
        cause_sensor: 2,
        ..VelocityCommand::blank()
    };
    for frame in ["", "a", "base_link"] {
        let message = WireMessage { header: Header::new(1, frame), wire: command };
        let mut bytes = Vec::new();
        encode_into(&message, &mut bytes).expect("encoded");
        let back: WireMessage<VelocityCommand> = decode(&bytes).expect("decoded");
        assert_eq!(bytemuck::bytes_of(&back.wire), bytemuck::bytes_of(&command));
        assert_eq!(back.header, message.header);
        for end in 0..bytes.len() {
            assert!(decode::<WireMessage<VelocityCommand>>(&bytes[..end]).is_err(), "cut at {end}");
        }
    }
    let health = Health::blank().with_adapter("a GPU");
    let mut bytes = Vec::new();
    encode_into(&WireMessage { header: Header::default(), wire: health }, &mut bytes).expect("encoded");
    assert_eq!(decode::<WireMessage<Health>>(&bytes).expect("decoded").wire, health);
}

#[test]
fn another_layout_is_refused_by_name() {
    let wire = Odometry { schema_hash: 7, ..Odometry::blank() };
    let error = WireMessage { header: Header::default(), wire }.checked().expect_err("refused").to_string();
    assert!(error.contains("noctule.Odometry.v1") && error.contains("0000000000000007"), "{error}");
}

#[test]
fn samples_are_borrowed_where_they_lie_and_a_length_beyond_the_end_is_refused() {
    let data = [1, 2, 3, 4, 5];
    let message =
        RawPingMessage { header: Header::new(9, "sonar_front"), wire: RawHeader::blank(), data: Octets(&data) };
    let mut bytes = Vec::new();
    encode_into(&message, &mut bytes).expect("encoded");
    let back: RawPingMessage<'_> = decode(&bytes).expect("decoded");
    assert_eq!(back, message);
    assert!(bytes.as_ptr_range().contains(&back.data.0.as_ptr()));
    let count = bytes.len() - data.len() - 4;
    bytes[count..count + 4].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(decode::<RawPingMessage<'_>>(&bytes).is_err());
    assert!(matches!(decode::<RawPingMessage<'_>>(&[0, 0, 0, 0]), Err(RosError::Encapsulation { .. })));
}

#[test]
fn schemas_name_every_field_and_define_every_message_within() {
    let raw = RawPingMessage::schema();
    assert!(raw.starts_with("std_msgs/Header header\nuint64 schema_hash") && raw.contains("\nuint8[] data"), "{raw}");
    assert_eq!(RawPingMessage::type_name(), "noctule_msgs/msg/RawPing");
    assert_eq!(WireMessage::<VelocityCommand>::type_name(), "noctule_msgs/msg/VelocityCommand");
    for schema in [LaserScan::schema(), TFMessage::schema(), DiagnosticArray::schema(), TwistStamped::schema(), raw] {
        let defined: Vec<&str> = schema.lines().filter_map(|line| line.strip_prefix("MSG: ")).collect();
        let used = schema.lines().filter_map(|line| line.split_whitespace().next()).filter(|word| word.contains('/'));
        for word in used {
            assert!(defined.contains(&word.trim_end_matches("[]")), "{word} is not defined in\n{schema}");
        }
        assert!(!schema.contains("\n\n"), "{schema}");
    }
}

#[test]
fn scans_run_right_to_left_and_tell_nothing_heard_from_not_known() {
    let readings = [Reading::Unseen, Reading::Clear, Reading::Echo { range_m: 1.25, energy: 0.5 }];
    for step in [0.5, -0.5] {
        let directions = (0..3).map(|index| Direction::horizontal(f64::from(index - 1) * step)).collect();
        let grid = Arc::new(PolarGrid::new(directions, 0.3, 0.005, 941));
        let mut scan = RangeScan::unseen(grid, 1);
        scan.readings = readings.to_vec();
        scan.emitted_at = Stamp { boottime_ns: 1, wall_ns: 2_500_000_000 };
        if step < 0.0 {
            scan.readings.reverse();
        }
        let laser = laser_scan(&scan, "front", 0.1).expect("equal steps");
        assert_eq!((laser.angle_min, laser.angle_max, laser.angle_increment), (-0.5, 0.5, 0.5));
        assert!(laser.ranges[0].is_nan() && laser.ranges[1] == f32::INFINITY && laser.ranges[2] == 1.25);
        assert_eq!(laser.intensities, [0.0, 0.0, 0.5]);
        assert_eq!(
            (laser.header.stamp, laser.header.frame_id.as_str()),
            (Time { sec: 2, nanosec: 500_000_000 }, "sonar_front")
        );
        assert!((laser.range_max - 5.0025).abs() < 1e-6 && laser.range_min == 0.3);
    }
    let uneven = [0.0, 0.1, 0.3].map(Direction::horizontal).to_vec();
    let scan = RangeScan::unseen(Arc::new(PolarGrid::new(uneven, 0.3, 0.005, 10)), 0);
    assert_eq!(laser_scan(&scan, "front", 0.1), None);
}

#[test]
fn a_point_cloud_has_twenty_bytes_a_point_in_the_order_of_its_fields() {
    let mut points = crate::io::wire::points::PointCloud3 { point_count: 2, ..Default::default() };
    (points.x_m[1], points.y_m[1], points.z_m[1], points.energy[1], points.class[1]) = (1.5, -2.0, 0.25, 0.125, 3);
    let cloud = super::point_cloud(&points);
    assert_eq!((cloud.width, cloud.height, cloud.point_step, cloud.row_step, cloud.data.len()), (2, 1, 20, 40, 40));
    let number = |index: usize| f32::from_le_bytes(cloud.data[20 + 4 * index..][..4].try_into().expect("four"));
    assert_eq!([number(0), number(1), number(2), number(3)], [1.5, -2.0, 0.25, 0.125]);
    assert_eq!(cloud.data[36..], [3, 0, 0, 0]);
    let names: Vec<&str> = cloud.fields.iter().map(|field| field.name.as_str()).collect();
    assert_eq!(names, ["x", "y", "z", "intensity", "class"]);
    // What a reader of the stated layout makes of the bytes.
    let mut bytes = Vec::new();
    super::encode_into(&cloud, &mut bytes).expect("written");
    assert_eq!(super::decode::<super::PointCloud2>(&bytes).expect("read"), cloud);
    points.point_count = 9999;
    assert_eq!(super::point_cloud(&points).width, 192, "no count of a stranger reaches beyond the arrays");
}
