/* noctule's wire types. Made by `noctule topics --c-header`: do not edit.
 * SI units, radians; robot frame x forward, y left, angles counter-clockwise; t_..._ns of CLOCK_BOOTTIME. */
#ifndef NOCTULE_TYPES_H
#define NOCTULE_TYPES_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
#define NOCTULE_ASSERT(truth, what) static_assert(truth, what)
#else
#define NOCTULE_ASSERT(truth, what) _Static_assert(truth, what)
#endif

/* Bit of an energyscape's flags: first direction and step tell all directions. */
#define NOCTULE_FLAG_EQUAL_DIRECTIONS 1u

#define NOCTULE_CUES_V1_TYPE_NAME "noctule.Cues.v1"
#define NOCTULE_CUES_V1_SCHEMA_HASH UINT64_C(0xecb8e520460974d6)
struct noctule_cues_v1 {
    uint64_t schema_hash; /* Layout of the writer. */
    uint64_t sequence; /* Sequence of the ping set. */
    uint64_t t_monotonic_ns; /* Oldest emission of the set, CLOCK_BOOTTIME. */
    uint64_t t_wall_ns; /* The same on the wall clock. */
    double wall_lateral_m[8]; /* Lateral distance of each wall from the robot's x axis, left positive. */
    double wall_strength[8]; /* Gamma of each wall, strongest first. */
    double coverage_ahead_m; /* Seen length of way ahead of the footprint. */
    double coverage_behind_m; /* Seen length of way behind the footprint. */
    double nearest_range_m[3]; /* Range of each layer's nearest reflection from its sensor. */
    double nearest_bearing_rad[3]; /* Its bearing. */
    double nearest_distance_m[3]; /* Its distance from the robot's footprint. */
    float nearest_energy[3]; /* Its energy. */
    float nearest_side[3]; /* +1 left, -1 right, 0 both or none. */
    uint32_t nearest_sensor[3]; /* Sensor that heard it; 4294967295 for none. */
    float energy[3]; /* Sum of E|M| of each layer. */
    float turn[3]; /* Sum of E M / r^2 of each layer. */
    float peak[3]; /* Largest E|M| of each layer. */
    float threshold[3]; /* What triggers each layer. */
    float sensor_energy[9]; /* Sum of E|M|, by layer and sensor. */
    float sensor_turn[9]; /* Sum of E M / r^2, by layer and sensor. */
    float sensor_peak[9]; /* Largest E|M|, by layer and sensor. */
    float wall_threshold_single; /* What one wall has to exceed. */
    float wall_threshold_corridor; /* What two walls have to exceed. */
    uint32_t wall_count; /* Number of walls. */
    uint32_t sensors_used; /* Bit k is set when sensor k went in. */
};
NOCTULE_ASSERT(sizeof(struct noctule_cues_v1) == 456, "size of noctule.Cues.v1");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, schema_hash) == 0, "noctule.Cues.v1.schema_hash");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, sequence) == 8, "noctule.Cues.v1.sequence");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, t_monotonic_ns) == 16, "noctule.Cues.v1.t_monotonic_ns");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, t_wall_ns) == 24, "noctule.Cues.v1.t_wall_ns");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, wall_lateral_m) == 32, "noctule.Cues.v1.wall_lateral_m");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, wall_strength) == 96, "noctule.Cues.v1.wall_strength");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, coverage_ahead_m) == 160, "noctule.Cues.v1.coverage_ahead_m");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, coverage_behind_m) == 168, "noctule.Cues.v1.coverage_behind_m");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, nearest_range_m) == 176, "noctule.Cues.v1.nearest_range_m");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, nearest_bearing_rad) == 200, "noctule.Cues.v1.nearest_bearing_rad");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, nearest_distance_m) == 224, "noctule.Cues.v1.nearest_distance_m");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, nearest_energy) == 248, "noctule.Cues.v1.nearest_energy");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, nearest_side) == 260, "noctule.Cues.v1.nearest_side");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, nearest_sensor) == 272, "noctule.Cues.v1.nearest_sensor");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, energy) == 284, "noctule.Cues.v1.energy");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, turn) == 296, "noctule.Cues.v1.turn");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, peak) == 308, "noctule.Cues.v1.peak");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, threshold) == 320, "noctule.Cues.v1.threshold");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, sensor_energy) == 332, "noctule.Cues.v1.sensor_energy");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, sensor_turn) == 368, "noctule.Cues.v1.sensor_turn");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, sensor_peak) == 404, "noctule.Cues.v1.sensor_peak");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, wall_threshold_single) == 440, "noctule.Cues.v1.wall_threshold_single");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, wall_threshold_corridor) == 444, "noctule.Cues.v1.wall_threshold_corridor");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, wall_count) == 448, "noctule.Cues.v1.wall_count");
NOCTULE_ASSERT(offsetof(struct noctule_cues_v1, sensors_used) == 452, "noctule.Cues.v1.sensors_used");

#define NOCTULE_EGO_MOTION_V1_TYPE_NAME "noctule.EgoMotion.v1"
#define NOCTULE_EGO_MOTION_V1_SCHEMA_HASH UINT64_C(0x6d09862921132e0c)
struct noctule_ego_motion_v1 {
    uint64_t schema_hash; /* Layout of the writer. */
    uint64_t sequence; /* Sequence of the newer ping set. */
    uint64_t t_monotonic_ns; /* Its oldest emission, CLOCK_BOOTTIME. */
    uint64_t t_wall_ns; /* The same on the wall clock. */
    uint64_t t_completed_ns; /* When it was complete, CLOCK_BOOTTIME. */
    double interval_s; /* Time since the ping set before; the velocities are means over it. 0 where there was none. */
    double linear_m_s; /* Forward speed by the echoes. */
    double angular_rad_s; /* Turn rate by the echoes. */
    double variance_linear_m2_s2; /* Variance of the speed: as wide as the platform is fast where the echoes do not tell. */
    double covariance_m_rad_s2; /* Covariance of speed and turn rate. */
    double variance_angular_rad2_s2; /* Variance of the turn rate. */
    double odometry_linear_m_s; /* Forward speed by odometry over the same interval; NaN without odometry. */
    double odometry_angular_rad_s; /* Turn rate by odometry; NaN without odometry. */
    double innovation; /* Squared distance of the two in standard deviations, two degrees of freedom. */
    double mover_x_m[8]; /* Movers, the soonest contact first: middle in the robot frame, forward. */
    double mover_y_m[8]; /* To the left. */
    double mover_x_m_s[8]; /* Velocity over ground along the robot's axes, forward. */
    double mover_y_m_s[8]; /* To the left. */
    double mover_variance_x_m2_s2[8]; /* Variance of that velocity, forward. */
    double mover_covariance_xy_m2_s2[8]; /* Covariance of its two parts. */
    double mover_variance_y_m2_s2[8]; /* Variance to the left. */
    double mover_radius_m[8]; /* Radius that each is taken to have. */
    double mover_contact_s[8]; /* Time until it touches the footprint if both go on straight; +inf if they miss each other. */
    uint32_t mover_id[8]; /* Number of its track; stays while it is followed. */
    uint32_t mover_age[8]; /* Ping sets since it was first heard. */
    uint32_t mover_count; /* Number of movers. */
    uint32_t matched_count; /* Reflectors that were heard in both ping sets. */
    uint32_t inlier_count; /* Of these, those that agree with the velocity. */
    uint32_t linear_observed; /* Whether the speed is known better than 0.05 m/s. */
    uint32_t angular_observed; /* Whether the turn rate is known better than 0.1 rad/s. */
    uint32_t slip; /* Whether odometry has contradicted the echoes for several ping sets: wheels slip, or the robot is pushed. */
};
NOCTULE_ASSERT(sizeof(struct noctule_ego_motion_v1) == 776, "size of noctule.EgoMotion.v1");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, schema_hash) == 0, "noctule.EgoMotion.v1.schema_hash");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, sequence) == 8, "noctule.EgoMotion.v1.sequence");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, t_monotonic_ns) == 16, "noctule.EgoMotion.v1.t_monotonic_ns");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, t_wall_ns) == 24, "noctule.EgoMotion.v1.t_wall_ns");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, t_completed_ns) == 32, "noctule.EgoMotion.v1.t_completed_ns");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, interval_s) == 40, "noctule.EgoMotion.v1.interval_s");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, linear_m_s) == 48, "noctule.EgoMotion.v1.linear_m_s");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, angular_rad_s) == 56, "noctule.EgoMotion.v1.angular_rad_s");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, variance_linear_m2_s2) == 64, "noctule.EgoMotion.v1.variance_linear_m2_s2");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, covariance_m_rad_s2) == 72, "noctule.EgoMotion.v1.covariance_m_rad_s2");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, variance_angular_rad2_s2) == 80, "noctule.EgoMotion.v1.variance_angular_rad2_s2");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, odometry_linear_m_s) == 88, "noctule.EgoMotion.v1.odometry_linear_m_s");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, odometry_angular_rad_s) == 96, "noctule.EgoMotion.v1.odometry_angular_rad_s");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, innovation) == 104, "noctule.EgoMotion.v1.innovation");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, mover_x_m) == 112, "noctule.EgoMotion.v1.mover_x_m");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, mover_y_m) == 176, "noctule.EgoMotion.v1.mover_y_m");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, mover_x_m_s) == 240, "noctule.EgoMotion.v1.mover_x_m_s");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, mover_y_m_s) == 304, "noctule.EgoMotion.v1.mover_y_m_s");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, mover_variance_x_m2_s2) == 368, "noctule.EgoMotion.v1.mover_variance_x_m2_s2");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, mover_covariance_xy_m2_s2) == 432, "noctule.EgoMotion.v1.mover_covariance_xy_m2_s2");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, mover_variance_y_m2_s2) == 496, "noctule.EgoMotion.v1.mover_variance_y_m2_s2");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, mover_radius_m) == 560, "noctule.EgoMotion.v1.mover_radius_m");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, mover_contact_s) == 624, "noctule.EgoMotion.v1.mover_contact_s");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, mover_id) == 688, "noctule.EgoMotion.v1.mover_id");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, mover_age) == 720, "noctule.EgoMotion.v1.mover_age");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, mover_count) == 752, "noctule.EgoMotion.v1.mover_count");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, matched_count) == 756, "noctule.EgoMotion.v1.matched_count");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, inlier_count) == 760, "noctule.EgoMotion.v1.inlier_count");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, linear_observed) == 764, "noctule.EgoMotion.v1.linear_observed");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, angular_observed) == 768, "noctule.EgoMotion.v1.angular_observed");
NOCTULE_ASSERT(offsetof(struct noctule_ego_motion_v1, slip) == 772, "noctule.EgoMotion.v1.slip");

#define NOCTULE_ENERGYSCAPE_HEADER_V1_TYPE_NAME "noctule.EnergyscapeHeader.v1"
#define NOCTULE_ENERGYSCAPE_HEADER_V1_SCHEMA_HASH UINT64_C(0x3cbba540b4fee0ab)
struct noctule_energyscape_header_v1 {
    uint64_t schema_hash; /* Layout of the writer. */
    uint64_t sequence; /* Sequence of the raw ping. */
    uint64_t t_monotonic_ns; /* Emission: time of sample 0 of the raw ping, CLOCK_BOOTTIME. */
    uint64_t t_wall_ns; /* The same on the wall clock. */
    uint64_t t_completed_ns; /* When the image was complete, CLOCK_BOOTTIME. */
    double direction_first_rad; /* First direction, 0 on boresight, positive to the left (flag 1). */
    double direction_step_rad; /* Step between directions (flag 1). */
    double range_first_m; /* Range of the first bin. */
    double range_step_m; /* Step between bins. */
    double speed_of_sound_m_s; /* Speed of sound that the ranges were computed with. */
    uint32_t version; /* Version of the header: 1. */
    uint32_t sensor_index; /* Index of the sensor in the configuration. */
    uint32_t direction_count; /* Rows. */
    uint32_t range_count; /* Columns. */
    uint32_t backend; /* 0 CPU, 1 GPU. */
    uint32_t flags; /* 1 equally spaced directions, 2 channels left out, 4 the CPU redid what the GPU failed to do, 8 silence here is no free space. */
};
NOCTULE_ASSERT(sizeof(struct noctule_energyscape_header_v1) == 104, "size of noctule.EnergyscapeHeader.v1");
NOCTULE_ASSERT(offsetof(struct noctule_energyscape_header_v1, schema_hash) == 0, "noctule.EnergyscapeHeader.v1.schema_hash");
NOCTULE_ASSERT(offsetof(struct noctule_energyscape_header_v1, sequence) == 8, "noctule.EnergyscapeHeader.v1.sequence");
NOCTULE_ASSERT(offsetof(struct noctule_energyscape_header_v1, t_monotonic_ns) == 16, "noctule.EnergyscapeHeader.v1.t_monotonic_ns");
NOCTULE_ASSERT(offsetof(struct noctule_energyscape_header_v1, t_wall_ns) == 24, "noctule.EnergyscapeHeader.v1.t_wall_ns");
NOCTULE_ASSERT(offsetof(struct noctule_energyscape_header_v1, t_completed_ns) == 32, "noctule.EnergyscapeHeader.v1.t_completed_ns");
NOCTULE_ASSERT(offsetof(struct noctule_energyscape_header_v1, direction_first_rad) == 40, "noctule.EnergyscapeHeader.v1.direction_first_rad");
NOCTULE_ASSERT(offsetof(struct noctule_energyscape_header_v1, direction_step_rad) == 48, "noctule.EnergyscapeHeader.v1.direction_step_rad");
NOCTULE_ASSERT(offsetof(struct noctule_energyscape_header_v1, range_first_m) == 56, "noctule.EnergyscapeHeader.v1.range_first_m");
NOCTULE_ASSERT(offsetof(struct noctule_energyscape_header_v1, range_step_m) == 64, "noctule.EnergyscapeHeader.v1.range_step_m");
NOCTULE_ASSERT(offsetof(struct noctule_energyscape_header_v1, speed_of_sound_m_s) == 72, "noctule.EnergyscapeHeader.v1.speed_of_sound_m_s");
NOCTULE_ASSERT(offsetof(struct noctule_energyscape_header_v1, version) == 80, "noctule.EnergyscapeHeader.v1.version");
NOCTULE_ASSERT(offsetof(struct noctule_energyscape_header_v1, sensor_index) == 84, "noctule.EnergyscapeHeader.v1.sensor_index");
NOCTULE_ASSERT(offsetof(struct noctule_energyscape_header_v1, direction_count) == 88, "noctule.EnergyscapeHeader.v1.direction_count");
NOCTULE_ASSERT(offsetof(struct noctule_energyscape_header_v1, range_count) == 92, "noctule.EnergyscapeHeader.v1.range_count");
NOCTULE_ASSERT(offsetof(struct noctule_energyscape_header_v1, backend) == 96, "noctule.EnergyscapeHeader.v1.backend");
NOCTULE_ASSERT(offsetof(struct noctule_energyscape_header_v1, flags) == 100, "noctule.EnergyscapeHeader.v1.flags");

#define NOCTULE_HEALTH_V1_TYPE_NAME "noctule.Health.v1"
#define NOCTULE_HEALTH_V1_SCHEMA_HASH UINT64_C(0xebf6fb7287bcce37)
struct noctule_health_v1 {
    uint64_t schema_hash; /* Layout of the writer. */
    uint64_t epoch; /* Random number of this start of the daemon: what an arm request carries. */
    uint64_t t_monotonic_ns; /* When it was sent, CLOCK_BOOTTIME. */
    uint64_t t_wall_ns; /* The same on the wall clock. */
    uint64_t ping_set_count; /* Ping sets imaged. */
    uint64_t command_count; /* Commands published. */
    uint64_t dropped_count; /* Ping sets dropped because newer ones were there. */
    uint64_t late_count; /* Ping sets not ready in time. */
    uint64_t gpu_loss_count; /* GPU losses since the start. */
    uint64_t stop_count; /* Stops since the start. */
    uint64_t rejected_count[3]; /* Pings rejected, by sensor. */
    uint64_t gap_count[3]; /* Missing sequence numbers, by sensor. */
    uint64_t desync_ns; /* Spread of the emission times of the newest set. */
    double latency_ms; /* Newest set, last sample to command published. */
    double latency_p50_ms; /* Median of it since the start. */
    double latency_p99_ms; /* 99th percentile of it since the start. */
    double latency_max_ms; /* Largest since the start. */
    double stage_ms[5]; /* Newest set: demodulate, matched filter, delay and sum, envelope with focus, masked energy. */
    uint32_t bad_channel_count[3]; /* Channels left out, by sensor. */
    uint32_t sensors_present; /* Bit k is set when sensor k delivered in the newest set. */
    uint32_t state; /* State of the daemon. */
    uint32_t reason; /* Why it is in that state. */
    uint32_t backend; /* 0 CPU, 1 GPU. */
    uint32_t recording; /* Recording of the run: 0 off, 1 recording, 2 finished, 3 disk full, 4 disk failed. */
    uint8_t adapter[64]; /* Adapter or instruction set that images, UTF-8, filled up with zeros. */
    double heard_speed_m_s[3]; /* Speed of sound that each sensor's direct path tells; 0 while it is not known. */
    double heard_speed_sd_m_s[3]; /* Standard deviation of its change since the calibration or the start. */
    uint32_t drift[3]; /* What has drifted, by sensor: 1 speed of sound, 2 microphone moved, 4 gain, 8 emitter weaker, 16 emitter moved. */
    uint32_t drift_looks; /* Looks for drift so far, the fewest of any sensor. */
};
NOCTULE_ASSERT(sizeof(struct noctule_health_v1) == 368, "size of noctule.Health.v1");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, schema_hash) == 0, "noctule.Health.v1.schema_hash");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, epoch) == 8, "noctule.Health.v1.epoch");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, t_monotonic_ns) == 16, "noctule.Health.v1.t_monotonic_ns");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, t_wall_ns) == 24, "noctule.Health.v1.t_wall_ns");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, ping_set_count) == 32, "noctule.Health.v1.ping_set_count");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, command_count) == 40, "noctule.Health.v1.command_count");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, dropped_count) == 48, "noctule.Health.v1.dropped_count");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, late_count) == 56, "noctule.Health.v1.late_count");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, gpu_loss_count) == 64, "noctule.Health.v1.gpu_loss_count");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, stop_count) == 72, "noctule.Health.v1.stop_count");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, rejected_count) == 80, "noctule.Health.v1.rejected_count");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, gap_count) == 104, "noctule.Health.v1.gap_count");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, desync_ns) == 128, "noctule.Health.v1.desync_ns");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, latency_ms) == 136, "noctule.Health.v1.latency_ms");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, latency_p50_ms) == 144, "noctule.Health.v1.latency_p50_ms");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, latency_p99_ms) == 152, "noctule.Health.v1.latency_p99_ms");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, latency_max_ms) == 160, "noctule.Health.v1.latency_max_ms");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, stage_ms) == 168, "noctule.Health.v1.stage_ms");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, bad_channel_count) == 208, "noctule.Health.v1.bad_channel_count");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, sensors_present) == 220, "noctule.Health.v1.sensors_present");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, state) == 224, "noctule.Health.v1.state");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, reason) == 228, "noctule.Health.v1.reason");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, backend) == 232, "noctule.Health.v1.backend");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, recording) == 236, "noctule.Health.v1.recording");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, adapter) == 240, "noctule.Health.v1.adapter");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, heard_speed_m_s) == 304, "noctule.Health.v1.heard_speed_m_s");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, heard_speed_sd_m_s) == 328, "noctule.Health.v1.heard_speed_sd_m_s");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, drift) == 352, "noctule.Health.v1.drift");
NOCTULE_ASSERT(offsetof(struct noctule_health_v1, drift_looks) == 364, "noctule.Health.v1.drift_looks");

#define NOCTULE_OBJECTS_V1_TYPE_NAME "noctule.Objects.v1"
#define NOCTULE_OBJECTS_V1_SCHEMA_HASH UINT64_C(0xb0aae93d6e2cfb94)
struct noctule_objects_v1 {
    uint64_t schema_hash; /* Layout of the writer. */
    uint64_t sequence; /* Sequence of the scan. */
    uint64_t t_monotonic_ns; /* Oldest emission that went in, CLOCK_BOOTTIME. */
    uint64_t t_wall_ns; /* The same on the wall clock. */
    uint64_t t_completed_ns; /* When it was complete, CLOCK_BOOTTIME. */
    double robot_x_m; /* Where the robot was, x in the frame of the objects. */
    double robot_y_m; /* The same, y. */
    double robot_heading_rad; /* The same, heading. */
    double reading_m[12]; /* What each sonar of the ring reads, from the ring; +inf for nothing within range, NaN for unseen. */
    double x_m[32]; /* Objects, the surest first: x. */
    double y_m[32]; /* y. */
    double variance_x_m2[32]; /* Variance of x. */
    double covariance_xy_m2[32]; /* Covariance of x and y. */
    double variance_y_m2[32]; /* Variance of y. */
    double map_x_m; /* x of the middle of the map's first cell. */
    double map_y_m; /* The same, y. */
    double cell_m; /* Edge of a cell. */
    float score[32]; /* How sure each object is, 0 to 1. */
    uint32_t pair[32]; /* First sonar of the pair that heard it last; the second is its neighbour to the left. */
    uint32_t object_count; /* Number of objects. */
    uint32_t frame; /* 0 frame of odometry; 1 robot frame, where nobody tells odometry: then nothing is kept from one ping set to the next. */
    int16_t map[4096]; /* Cells of the map, row after row of rising y: occupied to 0 to 100 per cent, -1 for unknown. */
};
NOCTULE_ASSERT(sizeof(struct noctule_objects_v1) == 9920, "size of noctule.Objects.v1");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, schema_hash) == 0, "noctule.Objects.v1.schema_hash");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, sequence) == 8, "noctule.Objects.v1.sequence");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, t_monotonic_ns) == 16, "noctule.Objects.v1.t_monotonic_ns");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, t_wall_ns) == 24, "noctule.Objects.v1.t_wall_ns");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, t_completed_ns) == 32, "noctule.Objects.v1.t_completed_ns");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, robot_x_m) == 40, "noctule.Objects.v1.robot_x_m");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, robot_y_m) == 48, "noctule.Objects.v1.robot_y_m");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, robot_heading_rad) == 56, "noctule.Objects.v1.robot_heading_rad");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, reading_m) == 64, "noctule.Objects.v1.reading_m");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, x_m) == 160, "noctule.Objects.v1.x_m");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, y_m) == 416, "noctule.Objects.v1.y_m");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, variance_x_m2) == 672, "noctule.Objects.v1.variance_x_m2");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, covariance_xy_m2) == 928, "noctule.Objects.v1.covariance_xy_m2");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, variance_y_m2) == 1184, "noctule.Objects.v1.variance_y_m2");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, map_x_m) == 1440, "noctule.Objects.v1.map_x_m");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, map_y_m) == 1448, "noctule.Objects.v1.map_y_m");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, cell_m) == 1456, "noctule.Objects.v1.cell_m");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, score) == 1464, "noctule.Objects.v1.score");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, pair) == 1592, "noctule.Objects.v1.pair");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, object_count) == 1720, "noctule.Objects.v1.object_count");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, frame) == 1724, "noctule.Objects.v1.frame");
NOCTULE_ASSERT(offsetof(struct noctule_objects_v1, map) == 1728, "noctule.Objects.v1.map");

#define NOCTULE_OBSTACLE_V1_TYPE_NAME "noctule.Obstacle.v1"
#define NOCTULE_OBSTACLE_V1_SCHEMA_HASH UINT64_C(0x2640df911e66ed97)
struct noctule_obstacle_v1 {
    uint64_t schema_hash; /* Layout of the writer. */
    uint64_t sequence; /* Sequence of the scan. */
    uint64_t t_monotonic_ns; /* Oldest emission that went in, CLOCK_BOOTTIME. */
    uint64_t t_wall_ns; /* The same on the wall clock. */
    uint64_t t_completed_ns; /* When it was complete, CLOCK_BOOTTIME. */
    double projection[8]; /* Projection of each sonar's vector on the way, 0 to 10. */
    double reading_m[8]; /* What each sonar reads, from its transducer; +inf for nothing within range, NaN for unseen. */
    double edge_distance_m; /* Distance of the robot from the planned edge; NaN without one. */
    double blind_beyond_m; /* Distance from the edge beyond which the detector is blind. */
    double x_m; /* Obstacle: nearest point of it, x in the frame of odometry; NaN without one. */
    double y_m; /* The same, y. */
    double along_near_m; /* Where it begins along the edge, from the edge's start. */
    double along_far_m; /* Where it ends as far as it was seen. */
    double across_right_m; /* Its right end across the edge, left of the edge positive. */
    double across_left_m; /* Its left end. */
    double extent_sigma_m; /* Standard deviation of these. */
    double passage_left_m; /* Free width between the obstacle and what stands to its left; +inf for nothing seen, NaN for unknown. */
    double passage_right_m; /* The same to its right. */
    double route_x_m[4]; /* Sub-route, x of up to four points in the frame of odometry. */
    double route_y_m[4]; /* The same, y. */
    double wish_linear_m_s; /* Forward speed that the follower wishes; the layers have the last word. */
    double wish_angular_rad_s; /* Turn rate that it wishes. */
    uint32_t route_count; /* Points of the sub-route. */
    uint32_t edge_index; /* Index of the planned edge; 4294967295 without one. */
    uint32_t detected; /* Whether an obstacle is detected. */
    uint32_t sonar; /* Sonar with the largest projection, where one is above the threshold; 4294967295 for none. */
    uint32_t blind; /* Whether the robot is too far from the edge to judge: that nothing is detected then means nothing. */
    uint32_t cannot_see; /* Whether a cone ahead is not seen: then the follower waits. */
    uint32_t far_end_seen; /* Whether the far end of the obstacle was seen. */
    uint32_t in_the_way; /* Whether the obstacle reaches into the safe path along the edge. */
    uint32_t sensors_used; /* Bit k is set when sensor k went in. */
    uint32_t follower; /* What the follower does. */
};
NOCTULE_ASSERT(sizeof(struct noctule_obstacle_v1) == 376, "size of noctule.Obstacle.v1");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, schema_hash) == 0, "noctule.Obstacle.v1.schema_hash");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, sequence) == 8, "noctule.Obstacle.v1.sequence");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, t_monotonic_ns) == 16, "noctule.Obstacle.v1.t_monotonic_ns");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, t_wall_ns) == 24, "noctule.Obstacle.v1.t_wall_ns");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, t_completed_ns) == 32, "noctule.Obstacle.v1.t_completed_ns");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, projection) == 40, "noctule.Obstacle.v1.projection");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, reading_m) == 104, "noctule.Obstacle.v1.reading_m");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, edge_distance_m) == 168, "noctule.Obstacle.v1.edge_distance_m");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, blind_beyond_m) == 176, "noctule.Obstacle.v1.blind_beyond_m");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, x_m) == 184, "noctule.Obstacle.v1.x_m");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, y_m) == 192, "noctule.Obstacle.v1.y_m");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, along_near_m) == 200, "noctule.Obstacle.v1.along_near_m");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, along_far_m) == 208, "noctule.Obstacle.v1.along_far_m");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, across_right_m) == 216, "noctule.Obstacle.v1.across_right_m");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, across_left_m) == 224, "noctule.Obstacle.v1.across_left_m");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, extent_sigma_m) == 232, "noctule.Obstacle.v1.extent_sigma_m");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, passage_left_m) == 240, "noctule.Obstacle.v1.passage_left_m");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, passage_right_m) == 248, "noctule.Obstacle.v1.passage_right_m");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, route_x_m) == 256, "noctule.Obstacle.v1.route_x_m");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, route_y_m) == 288, "noctule.Obstacle.v1.route_y_m");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, wish_linear_m_s) == 320, "noctule.Obstacle.v1.wish_linear_m_s");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, wish_angular_rad_s) == 328, "noctule.Obstacle.v1.wish_angular_rad_s");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, route_count) == 336, "noctule.Obstacle.v1.route_count");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, edge_index) == 340, "noctule.Obstacle.v1.edge_index");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, detected) == 344, "noctule.Obstacle.v1.detected");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, sonar) == 348, "noctule.Obstacle.v1.sonar");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, blind) == 352, "noctule.Obstacle.v1.blind");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, cannot_see) == 356, "noctule.Obstacle.v1.cannot_see");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, far_end_seen) == 360, "noctule.Obstacle.v1.far_end_seen");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, in_the_way) == 364, "noctule.Obstacle.v1.in_the_way");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, sensors_used) == 368, "noctule.Obstacle.v1.sensors_used");
NOCTULE_ASSERT(offsetof(struct noctule_obstacle_v1, follower) == 372, "noctule.Obstacle.v1.follower");

#define NOCTULE_ODOMETRY_V1_TYPE_NAME "noctule.Odometry.v1"
#define NOCTULE_ODOMETRY_V1_SCHEMA_HASH UINT64_C(0x7e1fec961aa148f9)
struct noctule_odometry_v1 {
    uint64_t schema_hash; /* Layout of the writer. */
    uint64_t sequence; /* Running number of the sender. */
    uint64_t t_monotonic_ns; /* When it was measured, CLOCK_BOOTTIME. */
    uint64_t t_wall_ns; /* The same on the wall clock. */
    double x_m; /* Position in the odometry frame. */
    double y_m; /* Position in the odometry frame. */
    double heading_rad; /* Heading, counter-clockwise. */
    double linear_m_s; /* Forward speed. */
    double angular_rad_s; /* Turn rate, counter-clockwise. */
};
NOCTULE_ASSERT(sizeof(struct noctule_odometry_v1) == 72, "size of noctule.Odometry.v1");
NOCTULE_ASSERT(offsetof(struct noctule_odometry_v1, schema_hash) == 0, "noctule.Odometry.v1.schema_hash");
NOCTULE_ASSERT(offsetof(struct noctule_odometry_v1, sequence) == 8, "noctule.Odometry.v1.sequence");
NOCTULE_ASSERT(offsetof(struct noctule_odometry_v1, t_monotonic_ns) == 16, "noctule.Odometry.v1.t_monotonic_ns");
NOCTULE_ASSERT(offsetof(struct noctule_odometry_v1, t_wall_ns) == 24, "noctule.Odometry.v1.t_wall_ns");
NOCTULE_ASSERT(offsetof(struct noctule_odometry_v1, x_m) == 32, "noctule.Odometry.v1.x_m");
NOCTULE_ASSERT(offsetof(struct noctule_odometry_v1, y_m) == 40, "noctule.Odometry.v1.y_m");
NOCTULE_ASSERT(offsetof(struct noctule_odometry_v1, heading_rad) == 48, "noctule.Odometry.v1.heading_rad");
NOCTULE_ASSERT(offsetof(struct noctule_odometry_v1, linear_m_s) == 56, "noctule.Odometry.v1.linear_m_s");
NOCTULE_ASSERT(offsetof(struct noctule_odometry_v1, angular_rad_s) == 64, "noctule.Odometry.v1.angular_rad_s");

#define NOCTULE_OPERATOR_REQUEST_V1_TYPE_NAME "noctule.OperatorRequest.v1"
#define NOCTULE_OPERATOR_REQUEST_V1_SCHEMA_HASH UINT64_C(0xec5209bc3b27c482)
struct noctule_operator_request_v1 {
    uint64_t schema_hash; /* Layout of the writer. */
    uint64_t epoch; /* Epoch of the daemon to be armed; read for arm only. */
    uint64_t sequence; /* Running number of the sender. */
    uint64_t t_monotonic_ns; /* When it was asked for, CLOCK_BOOTTIME; an arm request is obeyed for one second. */
    uint64_t t_wall_ns; /* The same on the wall clock. */
    uint32_t request; /* 1 arm, 2 stop, 3 reset. */
    uint32_t checksum; /* CRC-32 (IEEE) of all bytes before it. */
};
NOCTULE_ASSERT(sizeof(struct noctule_operator_request_v1) == 48, "size of noctule.OperatorRequest.v1");
NOCTULE_ASSERT(offsetof(struct noctule_operator_request_v1, schema_hash) == 0, "noctule.OperatorRequest.v1.schema_hash");
NOCTULE_ASSERT(offsetof(struct noctule_operator_request_v1, epoch) == 8, "noctule.OperatorRequest.v1.epoch");
NOCTULE_ASSERT(offsetof(struct noctule_operator_request_v1, sequence) == 16, "noctule.OperatorRequest.v1.sequence");
NOCTULE_ASSERT(offsetof(struct noctule_operator_request_v1, t_monotonic_ns) == 24, "noctule.OperatorRequest.v1.t_monotonic_ns");
NOCTULE_ASSERT(offsetof(struct noctule_operator_request_v1, t_wall_ns) == 32, "noctule.OperatorRequest.v1.t_wall_ns");
NOCTULE_ASSERT(offsetof(struct noctule_operator_request_v1, request) == 40, "noctule.OperatorRequest.v1.request");
NOCTULE_ASSERT(offsetof(struct noctule_operator_request_v1, checksum) == 44, "noctule.OperatorRequest.v1.checksum");

#define NOCTULE_PLATFORM_VELOCITY_V1_TYPE_NAME "noctule.PlatformVelocity.v1"
#define NOCTULE_PLATFORM_VELOCITY_V1_SCHEMA_HASH UINT64_C(0x00a173b4f9f368da)
struct noctule_platform_velocity_v1 {
    uint64_t schema_hash; /* Layout of the writer. */
    uint64_t sequence; /* Running number of the tick. */
    uint64_t t_monotonic_ns; /* When it was sent, CLOCK_BOOTTIME. */
    uint64_t t_wall_ns; /* The same on the wall clock. */
    double linear_m_s; /* Forward speed to drive. */
    double angular_rad_s; /* Turn rate to drive, counter-clockwise. */
    uint64_t epoch; /* Epoch that is armed; 0 for none. */
    uint64_t command_sequence; /* Sequence of the newest command received. */
    uint64_t command_t_monotonic_ns; /* Oldest emission that the newest command was made from, CLOCK_BOOTTIME. */
    uint64_t command_received_ns; /* When the newest command was received, CLOCK_BOOTTIME. */
    uint64_t received_count; /* Commands received since the start. */
    uint64_t accepted_count; /* Commands followed since the start. */
    uint64_t refused_count; /* Commands refused since the start. */
    uint32_t state; /* State of the controller. */
    uint32_t reason; /* Why it is in that state. */
    uint32_t daemon_state; /* State of the daemon in the newest command. */
    uint32_t daemon_reason; /* Why the daemon is in that state. */
};
NOCTULE_ASSERT(sizeof(struct noctule_platform_velocity_v1) == 120, "size of noctule.PlatformVelocity.v1");
NOCTULE_ASSERT(offsetof(struct noctule_platform_velocity_v1, schema_hash) == 0, "noctule.PlatformVelocity.v1.schema_hash");
NOCTULE_ASSERT(offsetof(struct noctule_platform_velocity_v1, sequence) == 8, "noctule.PlatformVelocity.v1.sequence");
NOCTULE_ASSERT(offsetof(struct noctule_platform_velocity_v1, t_monotonic_ns) == 16, "noctule.PlatformVelocity.v1.t_monotonic_ns");
NOCTULE_ASSERT(offsetof(struct noctule_platform_velocity_v1, t_wall_ns) == 24, "noctule.PlatformVelocity.v1.t_wall_ns");
NOCTULE_ASSERT(offsetof(struct noctule_platform_velocity_v1, linear_m_s) == 32, "noctule.PlatformVelocity.v1.linear_m_s");
NOCTULE_ASSERT(offsetof(struct noctule_platform_velocity_v1, angular_rad_s) == 40, "noctule.PlatformVelocity.v1.angular_rad_s");
NOCTULE_ASSERT(offsetof(struct noctule_platform_velocity_v1, epoch) == 48, "noctule.PlatformVelocity.v1.epoch");
NOCTULE_ASSERT(offsetof(struct noctule_platform_velocity_v1, command_sequence) == 56, "noctule.PlatformVelocity.v1.command_sequence");
NOCTULE_ASSERT(offsetof(struct noctule_platform_velocity_v1, command_t_monotonic_ns) == 64, "noctule.PlatformVelocity.v1.command_t_monotonic_ns");
NOCTULE_ASSERT(offsetof(struct noctule_platform_velocity_v1, command_received_ns) == 72, "noctule.PlatformVelocity.v1.command_received_ns");
NOCTULE_ASSERT(offsetof(struct noctule_platform_velocity_v1, received_count) == 80, "noctule.PlatformVelocity.v1.received_count");
NOCTULE_ASSERT(offsetof(struct noctule_platform_velocity_v1, accepted_count) == 88, "noctule.PlatformVelocity.v1.accepted_count");
NOCTULE_ASSERT(offsetof(struct noctule_platform_velocity_v1, refused_count) == 96, "noctule.PlatformVelocity.v1.refused_count");
NOCTULE_ASSERT(offsetof(struct noctule_platform_velocity_v1, state) == 104, "noctule.PlatformVelocity.v1.state");
NOCTULE_ASSERT(offsetof(struct noctule_platform_velocity_v1, reason) == 108, "noctule.PlatformVelocity.v1.reason");
NOCTULE_ASSERT(offsetof(struct noctule_platform_velocity_v1, daemon_state) == 112, "noctule.PlatformVelocity.v1.daemon_state");
NOCTULE_ASSERT(offsetof(struct noctule_platform_velocity_v1, daemon_reason) == 116, "noctule.PlatformVelocity.v1.daemon_reason");

#define NOCTULE_POINT_CLOUD3_V1_TYPE_NAME "noctule.PointCloud3.v1"
#define NOCTULE_POINT_CLOUD3_V1_SCHEMA_HASH UINT64_C(0x68aa68275c9651e8)
struct noctule_point_cloud3_v1 {
    uint64_t schema_hash; /* Layout of the writer. */
    uint64_t sequence; /* Sequence of the ping set. */
    uint64_t t_monotonic_ns; /* Its oldest emission, CLOCK_BOOTTIME. */
    uint64_t t_wall_ns; /* The same on the wall clock. */
    uint64_t t_completed_ns; /* When it was complete, CLOCK_BOOTTIME. */
    double floor_m; /* Height of the floor above the sensors' origins, median of the last echoes from straight below; NaN while unknown. */
    double ceiling_m; /* Height of the ceiling; NaN while unknown. */
    float slice_m[180]; /* Nearest obstacle of each bearing from the robot's centre, two degrees each from straight behind on; +inf without one. */
    float x_m[192]; /* Places, forward. */
    float y_m[192]; /* To the left. */
    float z_m[192]; /* Above the sensors' origins. */
    float variance_x_m2[192]; /* Covariance, forward. */
    float covariance_xy_m2[192]; /* Forward and left. */
    float covariance_xz_m2[192]; /* Forward and up. */
    float variance_y_m2[192]; /* Left. */
    float covariance_yz_m2[192]; /* Left and up. */
    float variance_z_m2[192]; /* Up. */
    float energy[192]; /* Envelope, linear amplitude in units of full scale. */
    uint32_t sensor_index[192]; /* Sensor that heard it, in the order of the configuration. */
    uint32_t class[192]; /* 0 floor, 1 obstacle, 2 overhang, 3 ceiling. */
    uint32_t point_count; /* Number of points. */
    uint32_t obstacle_count; /* Of these, those at the robot's height. */
};
NOCTULE_ASSERT(sizeof(struct noctule_point_cloud3_v1) == 10000, "size of noctule.PointCloud3.v1");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, schema_hash) == 0, "noctule.PointCloud3.v1.schema_hash");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, sequence) == 8, "noctule.PointCloud3.v1.sequence");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, t_monotonic_ns) == 16, "noctule.PointCloud3.v1.t_monotonic_ns");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, t_wall_ns) == 24, "noctule.PointCloud3.v1.t_wall_ns");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, t_completed_ns) == 32, "noctule.PointCloud3.v1.t_completed_ns");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, floor_m) == 40, "noctule.PointCloud3.v1.floor_m");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, ceiling_m) == 48, "noctule.PointCloud3.v1.ceiling_m");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, slice_m) == 56, "noctule.PointCloud3.v1.slice_m");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, x_m) == 776, "noctule.PointCloud3.v1.x_m");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, y_m) == 1544, "noctule.PointCloud3.v1.y_m");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, z_m) == 2312, "noctule.PointCloud3.v1.z_m");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, variance_x_m2) == 3080, "noctule.PointCloud3.v1.variance_x_m2");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, covariance_xy_m2) == 3848, "noctule.PointCloud3.v1.covariance_xy_m2");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, covariance_xz_m2) == 4616, "noctule.PointCloud3.v1.covariance_xz_m2");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, variance_y_m2) == 5384, "noctule.PointCloud3.v1.variance_y_m2");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, covariance_yz_m2) == 6152, "noctule.PointCloud3.v1.covariance_yz_m2");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, variance_z_m2) == 6920, "noctule.PointCloud3.v1.variance_z_m2");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, energy) == 7688, "noctule.PointCloud3.v1.energy");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, sensor_index) == 8456, "noctule.PointCloud3.v1.sensor_index");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, class) == 9224, "noctule.PointCloud3.v1.class");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, point_count) == 9992, "noctule.PointCloud3.v1.point_count");
NOCTULE_ASSERT(offsetof(struct noctule_point_cloud3_v1, obstacle_count) == 9996, "noctule.PointCloud3.v1.obstacle_count");

#define NOCTULE_RAW_HEADER_V1_TYPE_NAME "noctule.RawHeader.v1"
#define NOCTULE_RAW_HEADER_V1_SCHEMA_HASH UINT64_C(0xb100f6234927807a)
struct noctule_raw_header_v1 {
    uint64_t schema_hash; /* Layout of the writer. */
    uint64_t sequence; /* The sensor's own running number. */
    uint64_t t_monotonic_ns; /* Emission: time of sample 0, CLOCK_BOOTTIME. */
    uint64_t t_wall_ns; /* The same on the wall clock. */
    double sample_rate_hz; /* Rate of PDM words or PCM samples. */
    uint32_t version; /* Version of the header: 1. */
    uint32_t sensor_index; /* Index of the sensor in the configuration. */
    uint32_t channel_count; /* Microphones. */
    uint32_t sample_count; /* PDM words, or PCM samples of one microphone. */
    uint32_t format; /* 0 PDM words, 1 PCM i16, 2 PCM f32. */
    uint32_t flags; /* None yet: 0. */
};
NOCTULE_ASSERT(sizeof(struct noctule_raw_header_v1) == 64, "size of noctule.RawHeader.v1");
NOCTULE_ASSERT(offsetof(struct noctule_raw_header_v1, schema_hash) == 0, "noctule.RawHeader.v1.schema_hash");
NOCTULE_ASSERT(offsetof(struct noctule_raw_header_v1, sequence) == 8, "noctule.RawHeader.v1.sequence");
NOCTULE_ASSERT(offsetof(struct noctule_raw_header_v1, t_monotonic_ns) == 16, "noctule.RawHeader.v1.t_monotonic_ns");
NOCTULE_ASSERT(offsetof(struct noctule_raw_header_v1, t_wall_ns) == 24, "noctule.RawHeader.v1.t_wall_ns");
NOCTULE_ASSERT(offsetof(struct noctule_raw_header_v1, sample_rate_hz) == 32, "noctule.RawHeader.v1.sample_rate_hz");
NOCTULE_ASSERT(offsetof(struct noctule_raw_header_v1, version) == 40, "noctule.RawHeader.v1.version");
NOCTULE_ASSERT(offsetof(struct noctule_raw_header_v1, sensor_index) == 44, "noctule.RawHeader.v1.sensor_index");
NOCTULE_ASSERT(offsetof(struct noctule_raw_header_v1, channel_count) == 48, "noctule.RawHeader.v1.channel_count");
NOCTULE_ASSERT(offsetof(struct noctule_raw_header_v1, sample_count) == 52, "noctule.RawHeader.v1.sample_count");
NOCTULE_ASSERT(offsetof(struct noctule_raw_header_v1, format) == 56, "noctule.RawHeader.v1.format");
NOCTULE_ASSERT(offsetof(struct noctule_raw_header_v1, flags) == 60, "noctule.RawHeader.v1.flags");

#define NOCTULE_SCAN_V1_TYPE_NAME "noctule.Scan.v1"
#define NOCTULE_SCAN_V1_SCHEMA_HASH UINT64_C(0x94214d253a498da2)
struct noctule_scan_v1 {
    uint64_t schema_hash; /* Layout of the writer. */
    uint64_t sequence; /* Sequence of the newest ping that went in. */
    uint64_t t_monotonic_ns; /* Oldest emission that went in, CLOCK_BOOTTIME. */
    uint64_t t_wall_ns; /* The same on the wall clock. */
    uint64_t t_completed_ns; /* When the scan was complete, CLOCK_BOOTTIME. */
    double bearing_first_rad; /* Bearing of the first ray in the robot frame. */
    double bearing_step_rad; /* Step between rays, counter-clockwise. */
    double range_min_m; /* Nearest range from the robot's origin that any sensor sees. */
    double range_max_m; /* Farthest range from the robot's origin that any sensor sees. */
    float range_m[360]; /* Range of the nearest echo; +inf for nothing within range, NaN for unseen. */
    float amplitude[360]; /* Envelope of that echo, 1 is full scale. */
    float range_sigma_m[360]; /* Standard deviation of its range. */
    float bearing_sigma_rad[360]; /* Standard deviation of its bearing: small at a reflector, large in the skirt of its main lobe. */
    float free_m[360]; /* Range up to which the ray is known to hold no echo. */
    uint32_t answer[360]; /* 0 unseen, 1 nothing within range, 2 echo. */
    float peak_x_m[64]; /* Reflectors, nearest first: forward of the robot. */
    float peak_y_m[64]; /* To its left. */
    float peak_amplitude[64]; /* Envelope, 1 is full scale. */
    float peak_range_sigma_m[64]; /* Standard deviation along the line of sight. */
    float peak_bearing_sigma_rad[64]; /* Standard deviation of the bearing from the sensor. */
    uint32_t peak_sensor[64]; /* Index of the sensor that heard it. */
    uint32_t peak_count; /* Number of reflectors. */
    uint32_t sensors_used; /* Bit k is set when sensor k went in. */
};
NOCTULE_ASSERT(sizeof(struct noctule_scan_v1) == 10256, "size of noctule.Scan.v1");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, schema_hash) == 0, "noctule.Scan.v1.schema_hash");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, sequence) == 8, "noctule.Scan.v1.sequence");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, t_monotonic_ns) == 16, "noctule.Scan.v1.t_monotonic_ns");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, t_wall_ns) == 24, "noctule.Scan.v1.t_wall_ns");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, t_completed_ns) == 32, "noctule.Scan.v1.t_completed_ns");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, bearing_first_rad) == 40, "noctule.Scan.v1.bearing_first_rad");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, bearing_step_rad) == 48, "noctule.Scan.v1.bearing_step_rad");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, range_min_m) == 56, "noctule.Scan.v1.range_min_m");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, range_max_m) == 64, "noctule.Scan.v1.range_max_m");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, range_m) == 72, "noctule.Scan.v1.range_m");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, amplitude) == 1512, "noctule.Scan.v1.amplitude");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, range_sigma_m) == 2952, "noctule.Scan.v1.range_sigma_m");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, bearing_sigma_rad) == 4392, "noctule.Scan.v1.bearing_sigma_rad");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, free_m) == 5832, "noctule.Scan.v1.free_m");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, answer) == 7272, "noctule.Scan.v1.answer");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, peak_x_m) == 8712, "noctule.Scan.v1.peak_x_m");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, peak_y_m) == 8968, "noctule.Scan.v1.peak_y_m");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, peak_amplitude) == 9224, "noctule.Scan.v1.peak_amplitude");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, peak_range_sigma_m) == 9480, "noctule.Scan.v1.peak_range_sigma_m");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, peak_bearing_sigma_rad) == 9736, "noctule.Scan.v1.peak_bearing_sigma_rad");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, peak_sensor) == 9992, "noctule.Scan.v1.peak_sensor");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, peak_count) == 10248, "noctule.Scan.v1.peak_count");
NOCTULE_ASSERT(offsetof(struct noctule_scan_v1, sensors_used) == 10252, "noctule.Scan.v1.sensors_used");

#define NOCTULE_VELOCITY_COMMAND_V1_TYPE_NAME "noctule.VelocityCommand.v1"
#define NOCTULE_VELOCITY_COMMAND_V1_SCHEMA_HASH UINT64_C(0x8c9d9fc34938a255)
struct noctule_velocity_command_v1 {
    uint64_t schema_hash; /* Layout of the writer. */
    uint64_t epoch; /* Random number of this start of the daemon. */
    uint64_t publisher_id; /* Random number of this publisher. */
    uint64_t sequence; /* Running number within the epoch. */
    uint64_t t_monotonic_ns; /* Oldest emission that it was made from, CLOCK_BOOTTIME: what its age is judged by. */
    uint64_t t_wall_ns; /* The same on the wall clock. */
    uint64_t t_published_ns; /* When it was published, CLOCK_BOOTTIME. */
    uint64_t valid_until_ns; /* Not to be followed later than this, CLOCK_BOOTTIME; MAX_AGE holds besides. */
    double linear_m_s; /* Forward speed V. */
    double angular_rad_s; /* Turn rate omega, counter-clockwise. */
    double speed_limit_m_s; /* Highest forward speed that the seen way allows. */
    double cause_range_m; /* Range of the reflection behind the decision. */
    double cause_bearing_rad; /* Its bearing from the sensor. */
    double cause_energy; /* What was compared with the threshold. */
    double cause_threshold; /* The threshold. */
    uint32_t cause_sensor; /* Sensor that heard it; 4294967295 for none. */
    uint32_t layer; /* Layer that decided. */
    uint32_t state; /* State of the daemon. */
    uint32_t reason; /* Why it is in that state. */
    uint32_t stuck; /* 1 when there is no progress although motion is asked for. */
    uint32_t checksum; /* CRC-32 (IEEE) of all bytes before it. */
};
NOCTULE_ASSERT(sizeof(struct noctule_velocity_command_v1) == 144, "size of noctule.VelocityCommand.v1");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_command_v1, schema_hash) == 0, "noctule.VelocityCommand.v1.schema_hash");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_command_v1, epoch) == 8, "noctule.VelocityCommand.v1.epoch");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_command_v1, publisher_id) == 16, "noctule.VelocityCommand.v1.publisher_id");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_command_v1, sequence) == 24, "noctule.VelocityCommand.v1.sequence");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_command_v1, t_monotonic_ns) == 32, "noctule.VelocityCommand.v1.t_monotonic_ns");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_command_v1, t_wall_ns) == 40, "noctule.VelocityCommand.v1.t_wall_ns");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_command_v1, t_published_ns) == 48, "noctule.VelocityCommand.v1.t_published_ns");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_command_v1, valid_until_ns) == 56, "noctule.VelocityCommand.v1.valid_until_ns");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_command_v1, linear_m_s) == 64, "noctule.VelocityCommand.v1.linear_m_s");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_command_v1, angular_rad_s) == 72, "noctule.VelocityCommand.v1.angular_rad_s");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_command_v1, speed_limit_m_s) == 80, "noctule.VelocityCommand.v1.speed_limit_m_s");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_command_v1, cause_range_m) == 88, "noctule.VelocityCommand.v1.cause_range_m");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_command_v1, cause_bearing_rad) == 96, "noctule.VelocityCommand.v1.cause_bearing_rad");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_command_v1, cause_energy) == 104, "noctule.VelocityCommand.v1.cause_energy");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_command_v1, cause_threshold) == 112, "noctule.VelocityCommand.v1.cause_threshold");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_command_v1, cause_sensor) == 120, "noctule.VelocityCommand.v1.cause_sensor");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_command_v1, layer) == 124, "noctule.VelocityCommand.v1.layer");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_command_v1, state) == 128, "noctule.VelocityCommand.v1.state");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_command_v1, reason) == 132, "noctule.VelocityCommand.v1.reason");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_command_v1, stuck) == 136, "noctule.VelocityCommand.v1.stuck");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_command_v1, checksum) == 140, "noctule.VelocityCommand.v1.checksum");

#define NOCTULE_VELOCITY_INPUT_V1_TYPE_NAME "noctule.VelocityInput.v1"
#define NOCTULE_VELOCITY_INPUT_V1_SCHEMA_HASH UINT64_C(0x2d433eeda3219ce3)
struct noctule_velocity_input_v1 {
    uint64_t schema_hash; /* Layout of the writer. */
    uint64_t sequence; /* Running number of the sender. */
    uint64_t t_monotonic_ns; /* When it was wanted, CLOCK_BOOTTIME. */
    uint64_t t_wall_ns; /* The same on the wall clock. */
    double linear_m_s; /* Forward speed. */
    double angular_rad_s; /* Turn rate, counter-clockwise. */
};
NOCTULE_ASSERT(sizeof(struct noctule_velocity_input_v1) == 48, "size of noctule.VelocityInput.v1");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_input_v1, schema_hash) == 0, "noctule.VelocityInput.v1.schema_hash");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_input_v1, sequence) == 8, "noctule.VelocityInput.v1.sequence");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_input_v1, t_monotonic_ns) == 16, "noctule.VelocityInput.v1.t_monotonic_ns");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_input_v1, t_wall_ns) == 24, "noctule.VelocityInput.v1.t_wall_ns");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_input_v1, linear_m_s) == 32, "noctule.VelocityInput.v1.linear_m_s");
NOCTULE_ASSERT(offsetof(struct noctule_velocity_input_v1, angular_rad_s) == 40, "noctule.VelocityInput.v1.angular_rad_s");

#endif
