//! Contract: the bytes on the topics are those of the golden list below, by the rules of C and by a C compiler; Python's
//! `ctypes` is held to the same tables by the Python client's test.

use noctule::io::wire::detections::{Objects, Obstacle, Scan};
use noctule::io::wire::message::{
    EnergyscapeHeader, Odometry, OperatorRequest, RawHeader, VelocityCommand, VelocityInput,
};
use noctule::io::wire::motion::EgoMotion;
use noctule::io::wire::points::PointCloud3;
use noctule::io::wire::telemetry::{Cues, Health, PlatformVelocity};
use noctule::io::wire::{Field, WireType};
use std::fmt::Write as _;
use tempfile::TempDir;

/// Written by hand: type name, size, and every field as `type name[count]` in the order in which it lies.
const GOLDEN: [(&str, usize, &str); 14] = [
    (
        "noctule.RawHeader.v1",
        64,
        "u64 schema_hash; u64 sequence; u64 t_monotonic_ns; u64 t_wall_ns; f64 sample_rate_hz; u32 version; u32 sensor_index; u32 channel_count; u32 sample_count; u32 format; u32 flags",
    ),
    (
        "noctule.EnergyscapeHeader.v1",
        104,
        "u64 schema_hash; u64 sequence; u64 t_monotonic_ns; u64 t_wall_ns; u64 t_completed_ns; f64 direction_first_rad; f64 direction_step_rad; f64 range_first_m; f64 range_step_m; f64 speed_of_sound_m_s; u32 version; u32 sensor_index; u32 direction_count; u32 range_count; u32 backend; u32 flags",
    ),
    (
        "noctule.Cues.v1",
        456,
        "u64 schema_hash; u64 sequence; u64 t_monotonic_ns; u64 t_wall_ns; f64 wall_lateral_m[8]; f64 wall_strength[8]; f64 coverage_ahead_m; f64 coverage_behind_m; f64 nearest_range_m[3]; f64 nearest_bearing_rad[3]; f64 nearest_distance_m[3]; f32 nearest_energy[3]; f32 nearest_side[3]; u32 nearest_sensor[3]; f32 energy[3]; f32 turn[3]; f32 peak[3]; f32 threshold[3]; f32 sensor_energy[9]; f32 sensor_turn[9]; f32 sensor_peak[9]; f32 wall_threshold_single; f32 wall_threshold_corridor; u32 wall_count; u32 sensors_used",
    ),
    (
        "noctule.VelocityCommand.v1",
        144,
        "u64 schema_hash; u64 epoch; u64 publisher_id; u64 sequence; u64 t_monotonic_ns; u64 t_wall_ns; u64 t_published_ns; u64 valid_until_ns; f64 linear_m_s; f64 angular_rad_s; f64 speed_limit_m_s; f64 cause_range_m; f64 cause_bearing_rad; f64 cause_energy; f64 cause_threshold; u32 cause_sensor; u32 layer; u32 state; u32 reason; u32 stuck; u32 checksum",
    ),
    (
        "noctule.VelocityInput.v1",
        48,
        "u64 schema_hash; u64 sequence; u64 t_monotonic_ns; u64 t_wall_ns; f64 linear_m_s; f64 angular_rad_s",
    ),
    (
        "noctule.OperatorRequest.v1",
        48,
        "u64 schema_hash; u64 epoch; u64 sequence; u64 t_monotonic_ns; u64 t_wall_ns; u32 request; u32 checksum",
    ),
    (
        "noctule.Odometry.v1",
        72,
        "u64 schema_hash; u64 sequence; u64 t_monotonic_ns; u64 t_wall_ns; f64 x_m; f64 y_m; f64 heading_rad; f64 linear_m_s; f64 angular_rad_s",
    ),
    (
        "noctule.PlatformVelocity.v1",
        120,
        "u64 schema_hash; u64 sequence; u64 t_monotonic_ns; u64 t_wall_ns; f64 linear_m_s; f64 angular_rad_s; u64 epoch; u64 command_sequence; u64 command_t_monotonic_ns; u64 command_received_ns; u64 received_count; u64 accepted_count; u64 refused_count; u32 state; u32 reason; u32 daemon_state; u32 daemon_reason",
    ),
    (
        "noctule.Scan.v1",
        10256,
        "u64 schema_hash; u64 sequence; u64 t_monotonic_ns; u64 t_wall_ns; u64 t_completed_ns; f64 bearing_first_rad; f64 bearing_step_rad; f64 range_min_m; f64 range_max_m; f32 range_m[360]; f32 amplitude[360]; f32 range_sigma_m[360]; f32 bearing_sigma_rad[360]; f32 free_m[360]; u32 answer[360]; f32 peak_x_m[64]; f32 peak_y_m[64]; f32 peak_amplitude[64]; f32 peak_range_sigma_m[64]; f32 peak_bearing_sigma_rad[64]; u32 peak_sensor[64]; u32 peak_count; u32 sensors_used",
    ),
    (
        "noctule.Obstacle.v1",
        376,
        "u64 schema_hash; u64 sequence; u64 t_monotonic_ns; u64 t_wall_ns; u64 t_completed_ns; f64 projection[8]; f64 reading_m[8]; f64 edge_distance_m; f64 blind_beyond_m; f64 x_m; f64 y_m; f64 along_near_m; f64 along_far_m; f64 across_right_m; f64 across_left_m; f64 extent_sigma_m; f64 passage_left_m; f64 passage_right_m; f64 route_x_m[4]; f64 route_y_m[4]; f64 wish_linear_m_s; f64 wish_angular_rad_s; u32 route_count; u32 edge_index; u32 detected; u32 sonar; u32 blind; u32 cannot_see; u32 far_end_seen; u32 in_the_way; u32 sensors_used; u32 follower",
    ),
    (
        "noctule.Objects.v1",
        9920,
        "u64 schema_hash; u64 sequence; u64 t_monotonic_ns; u64 t_wall_ns; u64 t_completed_ns; f64 robot_x_m; f64 robot_y_m; f64 robot_heading_rad; f64 reading_m[12]; f64 x_m[32]; f64 y_m[32]; f64 variance_x_m2[32]; f64 covariance_xy_m2[32]; f64 variance_y_m2[32]; f64 map_x_m; f64 map_y_m; f64 cell_m; f32 score[32]; u32 pair[32]; u32 object_count; u32 frame; i16 map[4096]",
    ),
    (
        "noctule.EgoMotion.v1",
        776,
        "u64 schema_hash; u64 sequence; u64 t_monotonic_ns; u64 t_wall_ns; u64 t_completed_ns; f64 interval_s; f64 linear_m_s; f64 angular_rad_s; f64 variance_linear_m2_s2; f64 covariance_m_rad_s2; f64 variance_angular_rad2_s2; f64 odometry_linear_m_s; f64 odometry_angular_rad_s; f64 innovation; f64 mover_x_m[8]; f64 mover_y_m[8]; f64 mover_x_m_s[8]; f64 mover_y_m_s[8]; f64 mover_variance_x_m2_s2[8]; f64 mover_covariance_xy_m2_s2[8]; f64 mover_variance_y_m2_s2[8]; f64 mover_radius_m[8]; f64 mover_contact_s[8]; u32 mover_id[8]; u32 mover_age[8]; u32 mover_count; u32 matched_count; u32 inlier_count; u32 linear_observed; u32 angular_observed; u32 slip",
    ),
    (
        "noctule.PointCloud3.v1",
        10000,
        "u64 schema_hash; u64 sequence; u64 t_monotonic_ns; u64 t_wall_ns; u64 t_completed_ns; f64 floor_m; f64 ceiling_m; f32 slice_m[180]; f32 x_m[192]; f32 y_m[192]; f32 z_m[192]; f32 variance_x_m2[192]; f32 covariance_xy_m2[192]; f32 covariance_xz_m2[192]; f32 variance_y_m2[192]; f32 covariance_yz_m2[192]; f32 variance_z_m2[192]; f32 energy[192]; u32 sensor_index[192]; u32 class[192]; u32 point_count; u32 obstacle_count",
    ),
    (
        "noctule.Health.v1",
        368,
        "u64 schema_hash; u64 epoch; u64 t_monotonic_ns; u64 t_wall_ns; u64 ping_set_count; u64 command_count; u64 dropped_count; u64 late_count; u64 gpu_loss_count; u64 stop_count; u64 rejected_count[3]; u64 gap_count[3]; u64 desync_ns; f64 latency_ms; f64 latency_p50_ms; f64 latency_p99_ms; f64 latency_max_ms; f64 stage_ms[5]; u32 bad_channel_count[3]; u32 sensors_present; u32 state; u32 reason; u32 backend; u32 recording; u8 adapter[64]; f64 heard_speed_m_s[3]; f64 heard_speed_sd_m_s[3]; u32 drift[3]; u32 drift_looks",
    ),
];

/// Type name, size, alignment and fields as the program has them.
fn actual() -> Vec<(&'static str, usize, usize, &'static [Field])> {
    fn of<T: WireType>() -> (&'static str, usize, usize, &'static [Field]) {
        (T::TYPE_NAME, size_of::<T>(), align_of::<T>(), T::FIELDS)
    }
    vec![
        of::<RawHeader>(),
        of::<EnergyscapeHeader>(),
        of::<Cues>(),
        of::<VelocityCommand>(),
        of::<VelocityInput>(),
        of::<OperatorRequest>(),
        of::<Odometry>(),
        of::<PlatformVelocity>(),
        of::<Scan>(),
        of::<Obstacle>(),
        of::<Objects>(),
        of::<EgoMotion>(),
        of::<PointCloud3>(),
        of::<Health>(),
    ]
}

/// A field of the golden list: type, name, count.
fn golden_fields(list: &str) -> Vec<(&str, &str, usize)> {
    list.split("; ")
        .map(|field| {
            let (kind, rest) = field.split_once(' ').expect("type and name");
            match rest.split_once('[') {
                Some((name, count)) => (kind, name, count.trim_end_matches(']').parse().expect("count")),
                None => (kind, rest, 1),
            }
        })
        .collect()
}

#[test]
fn every_type_lies_in_memory_as_the_golden_list_says_by_the_rules_of_c() {
    for ((name, size, list), (actual_name, actual_size, alignment, fields)) in GOLDEN.iter().zip(actual()) {
        assert_eq!(*name, actual_name);
        let golden = golden_fields(list);
        assert_eq!(golden.len(), fields.len(), "{name}");
        let mut end = 0_usize;
        for ((kind, field_name, count), field) in golden.iter().zip(fields) {
            let element: usize = kind[1..].parse::<usize>().expect("bits") / 8;
            let offset = end.next_multiple_of(element);
            assert_eq!(offset, end, "{name}.{field_name}: no hidden padding");
            assert_eq!((field.name, field.offset, field.count), (*field_name, offset, *count), "{name}");
            assert_eq!(field.primitive.name(), *kind, "{name}.{field_name}");
            end = offset + element * count;
        }
        assert_eq!((end.next_multiple_of(8), end), (*size, *size), "{name}");
        assert_eq!((actual_size, alignment), (*size, 8), "{name}");
    }
}

#[test]
fn a_c_compiler_lays_every_type_out_in_the_same_way() {
    let mut source = String::from("#include <stddef.h>\n#include <stdint.h>\n");
    for (index, (_, size, list)) in GOLDEN.iter().enumerate() {
        let _ = writeln!(source, "struct t{index} {{");
        for (kind, name, count) in golden_fields(list) {
            let c = match kind {
                "u8" => "uint8_t",
                "u32" => "uint32_t",
                "u64" => "uint64_t",
                "i16" => "int16_t",
                "f32" => "float",
                _ => "double",
            };
            let _ = writeln!(source, "  {c} {name}[{count}];");
        }
        let _ = writeln!(source, "}};\n_Static_assert(sizeof(struct t{index}) == {size}, \"size\");");
        for field in actual()[index].3 {
            let (name, offset) = (field.name, field.offset);
            let _ = writeln!(source, "_Static_assert(offsetof(struct t{index}, {name}) == {offset}, \"{name}\");");
        }
    }
    assert!(compiles(&source), "the C compiler disagrees");
    // Negative control: one offset wrong, and the same compiler must object.
    assert!(!compiles(&source.replacen("linear_m_s) == 64", "linear_m_s) == 72", 1)), "a wrong offset went unnoticed");
}

/// Whether the C compiler that links this test, too, accepts `source`.
fn compiles(source: &str) -> bool {
    let directory = TempDir::new().expect("directory");
    let file = directory.path().join("layout.c");
    std::fs::write(&file, source).expect("written");
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".to_owned());
    let output = std::process::Command::new(compiler).arg("-fsyntax-only").arg(&file).output();
    output.expect("a C compiler, as Rust's own linking needs one").status.success()
}
