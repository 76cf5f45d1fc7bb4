//! What daemon and controller tell of themselves, as it lies in shared memory: the sums behind a decision, what the
//! platform is really told, and the daemon's health.
//!
//! Layouts and conversions only. Arrays over layers are in the order collision avoidance, obstacle avoidance, corridor
//! following; arrays over layers and sensors are `[layer][sensor]`.

use super::message::{backend_name, daemon_state_name, reason_name};
use super::{NO_SENSOR, wire_type};
use crate::io::record::RecordState;
use crate::signal::{GateState, LayerCue, SENSORS_MAX, WALL_PEAKS_MAX};
use iceoryx2::prelude::ZeroCopySend;

/// Region layers whose cues are published.
pub const REGION_LAYERS: usize = 3;
/// Longest adapter name in [`Health`].
pub const ADAPTER_BYTES: usize = 64;
const LAYER_SENSORS: usize = REGION_LAYERS * SENSORS_MAX;

wire_type! {
    /// The fused sums that the controller read, with the thresholds that it compared them with.
    Cues = "noctule.Cues.v1" {
        /// Layout of the writer.
        schema_hash: u64,
        /// Sequence of the ping set.
        sequence: u64,
        /// Oldest emission of the set, CLOCK_BOOTTIME.
        t_monotonic_ns: u64,
        /// The same on the wall clock.
        t_wall_ns: u64,
        /// Lateral distance of each wall from the robot's x axis, left positive.
        wall_lateral_m: [f64; WALL_PEAKS_MAX],
        /// Gamma of each wall, strongest first.
        wall_strength: [f64; WALL_PEAKS_MAX],
        /// Seen length of way ahead of the footprint.
        coverage_ahead_m: f64,
        /// Seen length of way behind the footprint.
        coverage_behind_m: f64,
        /// Range of each layer's nearest reflection from its sensor.
        nearest_range_m: [f64; REGION_LAYERS],
        /// Its bearing.
        nearest_bearing_rad: [f64; REGION_LAYERS],
        /// Its distance from the robot's footprint.
        nearest_distance_m: [f64; REGION_LAYERS],
        /// Its energy.
        nearest_energy: [f32; REGION_LAYERS],
        /// +1 left, -1 right, 0 both or none.
        nearest_side: [f32; REGION_LAYERS],
        /// Sensor that heard it; 4294967295 for none.
        nearest_sensor: [u32; REGION_LAYERS],
        /// Sum of E|M| of each layer.
        energy: [f32; REGION_LAYERS],
        /// Sum of E M / r^2 of each layer.
        turn: [f32; REGION_LAYERS],
        /// Largest E|M| of each layer.
        peak: [f32; REGION_LAYERS],
        /// What triggers each layer.
        threshold: [f32; REGION_LAYERS],
        /// Sum of E|M|, by layer and sensor.
        sensor_energy: [f32; LAYER_SENSORS],
        /// Sum of E M / r^2, by layer and sensor.
        sensor_turn: [f32; LAYER_SENSORS],
        /// Largest E|M|, by layer and sensor.
        sensor_peak: [f32; LAYER_SENSORS],
        /// What one wall has to exceed.
        wall_threshold_single: f32,
        /// What two walls have to exceed.
        wall_threshold_corridor: f32,
        /// Number of walls.
        wall_count: u32,
        /// Bit k is set when sensor k went in.
        sensors_used: u32,
    }
}

wire_type! {
    /// What the controller really commands, 50 times a second, for ever.
    PlatformVelocity = "noctule.PlatformVelocity.v1" {
        /// Layout of the writer.
        schema_hash: u64,
        /// Running number of the tick.
        sequence: u64,
        /// When it was sent, CLOCK_BOOTTIME.
        t_monotonic_ns: u64,
        /// The same on the wall clock.
        t_wall_ns: u64,
        /// Forward speed to drive.
        linear_m_s: f64,
        /// Turn rate to drive, counter-clockwise.
        angular_rad_s: f64,
        /// Epoch that is armed; 0 for none.
        epoch: u64,
        /// Sequence of the newest command received.
        command_sequence: u64,
        /// Oldest emission that the newest command was made from, CLOCK_BOOTTIME.
        command_t_monotonic_ns: u64,
        /// When the newest command was received, CLOCK_BOOTTIME.
        command_received_ns: u64,
        /// Commands received since the start.
        received_count: u64,
        /// Commands followed since the start.
        accepted_count: u64,
        /// Commands refused since the start.
        refused_count: u64,
        /// State of the controller.
        state: u32 as gate_state_name,
        /// Why it is in that state.
        reason: u32 as reason_name,
        /// State of the daemon in the newest command.
        daemon_state: u32 as daemon_state_name,
        /// Why the daemon is in that state.
        daemon_reason: u32 as reason_name,
    }
}

wire_type! {
    /// How the daemon is.
    Health = "noctule.Health.v1" {
        /// Layout of the writer.
        schema_hash: u64,
        /// Random number of this start of the daemon: what an arm request carries.
        epoch: u64,
        /// When it was sent, CLOCK_BOOTTIME.
        t_monotonic_ns: u64,
        /// The same on the wall clock.
        t_wall_ns: u64,
        /// Ping sets imaged.
        ping_set_count: u64,
        /// Commands published.
        command_count: u64,
        /// Ping sets dropped because newer ones were there.
        dropped_count: u64,
        /// Ping sets not ready in time.
        late_count: u64,
        /// GPU losses since the start.
        gpu_loss_count: u64,
        /// Stops since the start.
        stop_count: u64,
        /// Pings rejected, by sensor.
        rejected_count: [u64; SENSORS_MAX],
        /// Missing sequence numbers, by sensor.
        gap_count: [u64; SENSORS_MAX],
        /// Spread of the emission times of the newest set.
        desync_ns: u64,
        /// Newest set, last sample to command published.
        latency_ms: f64,
        /// Median of it since the start.
        latency_p50_ms: f64,
        /// 99th percentile of it since the start.
        latency_p99_ms: f64,
        /// Largest since the start.
        latency_max_ms: f64,
        /// Newest set: demodulate, matched filter, delay and sum, envelope with focus, masked energy.
        stage_ms: [f64; 5],
        /// Channels left out, by sensor.
        bad_channel_count: [u32; SENSORS_MAX],
        /// Bit k is set when sensor k delivered in the newest set.
        sensors_present: u32,
        /// State of the daemon.
        state: u32 as daemon_state_name,
        /// Why it is in that state.
        reason: u32 as reason_name,
        /// 0 CPU, 1 GPU.
        backend: u32 as backend_name,
        /// Recording of the run: 0 off, 1 recording, 2 finished, 3 disk full, 4 disk failed.
        recording: u32 as recording_name,
        /// Adapter or instruction set that images, UTF-8, filled up with zeros.
        adapter: [u8; ADAPTER_BYTES],
        /// Speed of sound that each sensor's direct path tells; 0 while it is not known.
        heard_speed_m_s: [f64; SENSORS_MAX],
        /// Standard deviation of its change since the calibration or the start.
        heard_speed_sd_m_s: [f64; SENSORS_MAX],
        /// What has drifted, by sensor: 1 speed of sound, 2 microphone moved, 4 gain, 8 emitter weaker, 16 emitter moved.
        drift: [u32; SENSORS_MAX],
        /// Looks for drift so far, the fewest of any sensor.
        drift_looks: u32,
    }
}

pub(crate) fn gate_state_name(number: u32) -> Option<&'static str> {
    GateState::from_number(number).map(GateState::as_str)
}

/// Names of the numbers of [`Health::recording`].
const RECORDING_NAMES: [&str; 5] = ["off", "recording", "finished", "disk_full", "disk_failed"];

pub(crate) fn recording_name(number: u32) -> Option<&'static str> {
    RECORDING_NAMES.get(number as usize).copied()
}

/// The number of a recording's state on the wire.
#[must_use]
pub fn recording_number(state: Option<RecordState>) -> u32 {
    state.map_or(0, |state| 1 + state as u32)
}

/// The thresholds that the controller compares cues with.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CueThresholds {
    /// Of collision avoidance, on the sum.
    pub collision: f64,
    /// Of obstacle avoidance, on the peak.
    pub obstacle: f64,
    /// Of corridor following.
    pub corridor: f64,
    /// Of one wall.
    pub wall_single: f64,
    /// Of two walls.
    pub wall_corridor: f64,
}

impl Health {
    /// The same with an adapter's name, cut to what there is room for.
    #[must_use]
    pub fn with_adapter(mut self, name: &str) -> Self {
        let mut end = name.len().min(ADAPTER_BYTES);
        while !name.is_char_boundary(end) {
            end -= 1;
        }
        self.adapter = [0; ADAPTER_BYTES];
        self.adapter[..end].copy_from_slice(&name.as_bytes()[..end]);
        self
    }

    /// Whether a sensor delivered in the newest set.
    #[must_use]
    pub fn delivers(&self, sensor_index: usize) -> bool {
        self.sensors_present >> sensor_index & 1 == 1
    }

    /// The adapter's name.
    #[must_use]
    pub fn adapter_name(&self) -> String {
        super::text_of(&self.adapter)
    }
}

impl Cues {
    /// The cues of a ping set as they are published.
    #[must_use]
    pub fn new(cues: &crate::signal::Cues, thresholds: &CueThresholds) -> Self {
        let mut wire = Self {
            sequence: cues.sequence,
            t_monotonic_ns: cues.emitted_at.boottime_ns,
            t_wall_ns: cues.emitted_at.wall_ns,
            coverage_ahead_m: cues.coverage.ahead_m,
            coverage_behind_m: cues.coverage.behind_m,
            nearest_sensor: [NO_SENSOR; REGION_LAYERS],
            threshold: [thresholds.collision as f32, thresholds.obstacle as f32, thresholds.corridor as f32],
            wall_threshold_single: thresholds.wall_single as f32,
            wall_threshold_corridor: thresholds.wall_corridor as f32,
            wall_count: cues.walls.as_slice().len() as u32,
            ..Self::blank()
        };
        for (index, layer) in [&cues.collision, &cues.obstacle, &cues.corridor].into_iter().enumerate() {
            wire.set_layer(index, layer);
        }
        for (index, peak) in cues.walls.as_slice().iter().enumerate() {
            wire.wall_lateral_m[index] = peak.lateral_m;
            wire.wall_strength[index] = peak.strength;
        }
        for (index, _) in cues.sensors_used.iter().enumerate().filter(|&(_, &used)| used) {
            wire.sensors_used |= 1 << index;
        }
        wire
    }

    fn set_layer(&mut self, index: usize, layer: &LayerCue) {
        self.energy[index] = layer.energy;
        self.turn[index] = layer.turn;
        self.peak[index] = layer.peak;
        for (sensor_index, sums) in layer.sensors.iter().enumerate() {
            let at = index * SENSORS_MAX + sensor_index;
            self.sensor_energy[at] = sums.energy;
            self.sensor_turn[at] = sums.turn;
            self.sensor_peak[at] = sums.peak;
        }
        if let Some(nearest) = &layer.nearest {
            self.nearest_sensor[index] = nearest.sensor_index as u32;
            self.nearest_range_m[index] = nearest.range_m;
            self.nearest_bearing_rad[index] = nearest.bearing_rad;
            self.nearest_distance_m[index] = nearest.distance_m;
            self.nearest_energy[index] = nearest.energy;
            self.nearest_side[index] = f32::from(nearest.side);
        }
    }
}
