//! A [`Config`] as a TOML file that explains itself.
//!
//! Goes in: a configuration. Comes out: the text of `noctule config --default`: every key with a comment, keys that have no
//! value as a comment of their own. Judges nothing.

use super::Config;
use toml_edit::{ArrayOfTables, DocumentMut, Item, Table, Value};

/// What is said above each key or table header. A table's text names its optional keys, for those that are left out.
const COMMENTS: &[(&str, &str)] = &[
    ("config_version", "Version of this format."),
    ("speed_of_sound_m_s", "Speed of sound; or instead of it: air_temperature_c = 20.0"),
    ("air_temperature_c", "Temperature of the air; or instead of it: speed_of_sound_m_s = 343.0"),
    (
        "recording",
        "Raw data, as the files and the driver have it. Left out, these follow from the format:\n# sample_rate_hz, samples (PDM words for pdm), decimation (pdm only).",
    ),
    ("recording.format", "\"pdm\", \"pcm-i16\" or \"pcm-f32\""),
    ("recording.sample_rate_hz", "Rate of PDM words or PCM samples."),
    ("recording.samples", "PDM words, or PCM samples of one microphone, in a ping."),
    ("recording.decimation", "PDM words per demodulated sample; pdm only."),
    (
        "emission",
        "The sweep sent out, and when the sensors fire. With shape = \"csv\", file names the samples and start_hz, end_hz their band.\n# Optional: file, slot_s.",
    ),
    ("emission.shape", "\"hyperbolic\", \"linear\" or \"csv\""),
    ("emission.start_hz", "Frequency at the start."),
    ("emission.end_hz", "Frequency at the end."),
    ("emission.duration_s", "Duration."),
    ("emission.taper", "Share of the duration that the fade at each end takes, 0 to 0.5."),
    ("emission.file", "CSV of samples at the demodulated rate, relative to this file."),
    ("emission.plan", "When the sensors of a ping set fire: \"together\", or \"in-turn\", one after another."),
    (
        "emission.sweeps",
        "What they send: \"same\", \"alternate\" (every second one from the other end) or \"bands\" (each its part of the band).",
    ),
    (
        "emission.slot_s",
        "From one sensor's emission to the next one's, in turn. Default: until the end of an echo of the longest range.",
    ),
    (
        "imaging",
        "Sonar images. Optional: range_step_m (default: the smaller of 5 mm and c / (2.4 bandwidth)), smoothing_hz, focus_to_m, multiply_order.",
    ),
    ("imaging.backend", "\"auto\" (a hardware GPU, else the CPU), \"gpu\" (any adapter) or \"cpu\""),
    ("imaging.range_min_m", "First range."),
    ("imaging.range_max_m", "Last range."),
    ("imaging.range_step_m", "Largest distance between ranges."),
    (
        "imaging.directions",
        "Directions of interest: a horizontal fan, or { equal_area = 2000 } of the front hemisphere, with elevation_deg = [low, high] if\n# not all of it, or { file = \"directions.csv\" } of azimuth_deg,elevation_deg.",
    ),
    ("imaging.directions.start_deg", "First bearing, 0 ahead, positive to the left."),
    ("imaging.directions.step_deg", "Step from one bearing to the next."),
    ("imaging.directions.count", "Number of bearings."),
    ("imaging.directions.file", "CSV of azimuth_deg,elevation_deg rows instead, relative to this file."),
    (
        "imaging.directions.equal_area",
        "Directions of equal solid angle over the front hemisphere instead, 32 to 16384.",
    ),
    ("imaging.directions.elevation_deg", "Lowest and highest elevation of an equal-area grid."),
    ("imaging.weighting", "Matched filter: \"none\" or \"phat\"."),
    ("imaging.smoothing_hz", "Cut-off of the smoothing low-pass on the envelope."),
    (
        "imaging.focus_to_m",
        "Ranges up to this one are focused on the exact path; 0: plane waves everywhere. Default: where it matters.",
    ),
    ("imaging.beamformer", "\"delay-and-sum\", or cell by cell \"delay-multiply-and-sum\" or \"minimum-variance\"."),
    ("imaging.multiply_order", "Microphones multiplied with one another, 2 to 5."),
    ("imaging.coherence", "Factor on the amplitude: \"none\", \"amplitude\", \"phase\" or \"sign\"."),
    ("imaging.apodization", "Weights of the microphones: \"uniform\" or \"low-side-lobes\"."),
    (
        "imaging.clean_rounds",
        "Rounds of CLEAN, 1 to 16: the strongest echoes are taken out with their side lobes and put back without.",
    ),
    ("sensor", "A sensor, 1 to 3 of them. Any [[sensor]] replaces all built-in ones."),
    ("sensor.name", "Part of the topic names."),
    ("sensor.mount", "Distance and bearing of its place from the robot's centre, yaw against that bearing."),
    ("sensor.mount.distance_m", "Distance of its place from the robot's centre of rotation."),
    ("sensor.mount.bearing_deg", "Bearing of that place, 0 ahead, positive to the left."),
    ("sensor.mount.yaw_deg", "Yaw of the sensor against that bearing: 0 looks outward."),
    ("sensor.array", "\"ertis-v3d1\", or a CSV file of mic,x_m,y_m,z_m rows, relative to this file."),
    ("sensor.disabled_mics", "Microphones that are not used, counted from 0."),
    ("sensor.emitter_m", "Place of the emitter in the sensor's frame: forward, left, up."),
    (
        "sensor.emission",
        "What this sensor sends other than [emission] says: any of shape, start_hz, end_hz, duration_s, taper, file.",
    ),
    ("obstruction", "A shape in the robot frame that hides what is behind it."),
    ("platform", "The robot. Optional: z_m."),
    ("platform.radius_m", "Radius of its footprint, a disc about the centre of rotation."),
    ("platform.max_linear_m_s", "Largest speed, either way."),
    ("platform.max_angular_rad_s", "Largest turn rate, either way."),
    ("platform.max_linear_accel_m_s2", "Largest change of speed."),
    ("platform.max_angular_accel_rad_s2", "Largest change of turn rate."),
    (
        "platform.z_m",
        "Lowest and highest part of the robot above the plane of the sensors' origins, for grids with elevations: what is\n# lower is floor, what is higher it passes under.",
    ),
    (
        "control",
        "The layered controller. A layer whose table says enabled = false is off. Regions are shapes in the robot\n# frame: rectangle, circle, half-circle, sector, trapezoid, polygon; flow-lines for flow following. Left out,\n# or left as they are here, they follow from [platform]. One set of thresholds serves every sensor layout:\n# energies are amplitudes after the gain of [control.energy], and a large wall reads 0.1 at any range. Where it\n# reads otherwise, change thresholds, releases, prominence and energy_reference in proportion.",
    ),
    ("control.rate_hz", "Ping sets a second."),
    ("control.collision_avoidance", "Turn away on the spot; from the fourth time in a row a little backward."),
    (
        "control.collision_avoidance.threshold",
        "Fires when the energies there, of all sensors, sum to more; a pillar of 2 cm gives twice this in one sensor.",
    ),
    ("control.obstacle_avoidance", "Steer around and slow down."),
    (
        "control.obstacle_avoidance.threshold",
        "Fires when any cell there has more energy than this; a pillar of 2 cm has 0.008, a wall 0.09.",
    ),
    ("control.flow_following", "Follow a wall or a corridor. Optional: set_distance_m, to keep from a single wall."),
    ("control.corridor_following", "Balance left against right."),
    (
        "control.energy",
        "What counts as energy: a gain over range, 1 at 1 m, so that a wall reads the same at any range; and a noise\n# floor.",
    ),
    (
        "control.coverage",
        "How much of the way must be seen. Unseen is not free: the robot drives only as fast as it can stop within it.",
    ),
    ("control.stuck", "When the robot counts as stuck, and how it gets away."),
    (
        "ipc",
        "Shared memory. Optional: root, by default /run/noctule as root, else $XDG_RUNTIME_DIR/noctule, else\n# /tmp/noctule-<uid>; relative to this file, mode 0700.",
    ),
    ("ipc.root", "Directory of the shared files, private to one user."),
    ("ipc.prefix", "First characters of every name in it."),
    ("control.movers", "Room for what moves by the ego-motion estimate: less forward speed, never more."),
    ("control.movers.enabled", "Whether the robot slows down, or stands, to let somebody pass."),
    ("control.movers.horizon_s", "How far ahead movers and robot are thought on, straight."),
    ("control.movers.gap_m", "Gap that is to be left between the footprint and a mover."),
    ("safety", "Timeouts of the safe-state contract. None can be switched off."),
    ("safety.max_age_ms", "Oldest capture that may still move the robot."),
    ("safety.hold_latch_s", "How long the controller waits in HOLD before it must be armed again."),
    ("safety.gpu_deadline_ms", "How long a GPU may take for a ping set before the CPU redoes it."),
    ("safety.group_deadline_ms", "How long to wait for the other sensors of an emission."),
    ("safety.input_max_age_ms", "Oldest wanted velocity that is still obeyed."),
    ("detect", "Detectors on ranges, beside the controller."),
    (
        "detect.enabled",
        "Whether the daemon runs them and publishes noctule/scan, /obstacle, /objects, /ego_motion and /points.",
    ),
    (
        "detect.drive_path",
        "Whether the planned path below is driven: its follower wishes on noctule/input as any planner does.",
    ),
    ("detect.projection", "Vector projection on the planned edge."),
    ("detect.projection.range_max_m", "Range beyond which a reading counts nothing."),
    ("detect.projection.edge_distance_max_m", "Distance from the edge beyond which the detector is blind."),
    ("detect.projection.threshold", "A projection above this, of at most 10, is an obstacle."),
    ("detect.projection.cone_deg", "Full apex angle of a virtual sonar's cone."),
    (
        "detect.projection.path_m",
        "Corners [x, y] of the planned path in the frame of odometry; empty: no path, the detector idles.",
    ),
    ("detect.projection.safe_width_m", "Width that the robot needs; a passage that is narrower is none."),
    (
        "detect.projection.safe_path_only",
        "Whether only reflectors count that stand within half of safe_width_m of the edge; false: all, as in paper 001.",
    ),
    ("detect.projection.speed_m_s", "Speed that the follower of the path wishes."),
    ("detect.ring", "Virtual sonar ring."),
    ("detect.ring.ring_radius_m", "Radius of the ring."),
    ("detect.ring.cone_deg", "Full apex angle of a virtual sonar's cone."),
    ("detect.ring.cell_m", "Edge of a cell of the occupancy grid."),
    ("detect.ring.range_noise_m", "Standard deviation of a reading: what an object's covariance follows from."),
    ("detect.ring.range_max_m", "Farthest that a virtual sonar reads."),
    (
        "calibration",
        "What `noctule calibrate` measured of the sensors. Optional: file. Nothing is applied that is not listed; drift is an\n# alarm, never a stop.",
    ),
    ("calibration.file", "File that noctule calibrate wrote, relative to this file."),
    (
        "calibration.apply",
        "What of it is applied: \"speed-of-sound\" (before the configured one), \"emitter\", \"microphones\" (moved along the line\n# from the emitter), \"gains\" (as weights).",
    ),
    (
        "calibration.watch",
        "Whether the daemon watches for drift: against the file, or without one against what it hears in its first minute.",
    ),
    ("calibration.speed_tolerance", "Relative error of the speed of sound that is an alarm; 0.01 is 6 K."),
    ("calibration.path_tolerance_m", "Change of the way from the emitter to a microphone that is an alarm."),
    ("calibration.gain_tolerance_db", "Change of a microphone's gain against the others that is an alarm."),
    ("calibration.level_tolerance_db", "Loss of the emitter's level that is an alarm."),
];

/// What is said above keys that several layers share, by their last part.
const LAYER_COMMENTS: &[(&str, &str)] = &[
    ("enabled", "Whether it is there at all."),
    ("regions", "Where it looks, robot frame, metres."),
    ("threshold", "Fires when any cell there has more energy than this."),
    ("release", "Lets go when not above this energy."),
    ("threshold_single", "Energy along a flow line above which a single wall is followed."),
    ("threshold_corridor", "Energy along flow lines on both sides above which a corridor is followed."),
    ("release_ratio", "Share of a threshold that a wall may fall to before it is lost."),
    ("trigger_count", "Ping sets in a row before it fires."),
    ("release_count", "Ping sets in a row before it lets go."),
    ("omega_rad_s", "Turn rate away from the nearest reflection."),
    ("reverse_m_s", "Speed of the way back."),
    ("reverse_after", "The trigger in a row from which it goes back."),
    ("reverse_max_m", "Longest way back."),
    ("reverse_max_s", "Longest time of going back."),
    ("lambda", "Gain of the turn rate. Paper 000: 1 in simulation, 0.1 on a Husky of 0.6 m radius."),
    ("mu", "Gain of the slow-down; likewise."),
    ("energy_reference", "Energy, for each sensor that hears any, that stops the robot at mu = 1."),
    ("prominence", "By how much a wall must stand out."),
    ("separation_m", "Least distance between two walls."),
    ("set_distance_m", "Distance to keep from a single wall."),
    ("derivative_filter_s", "Time constant of the corridor law's derivative."),
    ("spreading_exponent", "Compensation of spreading, range to this power."),
    ("absorption_db_m", "Compensation of absorption, for each metre of path."),
    ("noise_floor_dbfs", "[range_m, dBFS] points of the envelope before the gain; what is below counts as nothing."),
    (
        "side_lobe_db",
        "Echoes this far below the loudest at their range in the same sensor may be its side lobes: they are left out,\n# and the way ahead counts as seen only up to where one may hide something.",
    ),
    (
        "blind_gap_m",
        "Longest unseen stretch at the footprint that counts as seen before: what is too near to be heard.",
    ),
    ("reaction_s", "Time from an obstacle's coming into view to the beginning of braking."),
    ("time_s", "Time without progress while motion is asked for."),
    ("distance_m", "What counts as progress in that time."),
    ("escape_turn_deg", "First turn on the spot to get away."),
];

/// The comment of a dotted key without indices.
pub(super) fn comment(path: &str) -> Option<&'static str> {
    let find =
        |table: &[(&str, &'static str)], key: &str| table.iter().find(|(name, _)| *name == key).map(|(_, text)| *text);
    let last = path.rsplit('.').next().unwrap_or(path);
    let shared = path.strip_prefix("control.").and_then(|_| find(LAYER_COMMENTS, last));
    find(COMMENTS, path).or(shared)
}

/// Every path that has a comment of its own: keys and sections.
pub(super) fn commented() -> impl Iterator<Item = &'static str> {
    COMMENTS.iter().map(|(path, _)| *path)
}

/// Tables that are written in one line.
const INLINE: [&str; 2] = ["mount", "directions"];
/// And where a key of the same name is a table of its own elsewhere.
const INLINE_PATHS: [&str; 1] = ["sensor.emission"];

pub(super) fn to_toml(config: &Config) -> String {
    let mut document = match toml_edit::ser::to_document(config) {
        Ok(document) => document,
        Err(error) => unreachable!("a configuration is made of tables, lists, numbers and strings: {error}"),
    };
    if config.obstruction.is_empty() {
        document.remove("obstruction");
    }
    lay_out("", &mut document);
    let document: DocumentMut = document;
    format!(
        "# noctule configuration: SI units, robot frame x forward, y left, angles counter-clockwise.\n\n{}",
        document.to_string().trim_start()
    )
}

/// Turns the inline tables and lists of the serializer into sections, and puts a comment above each key.
fn lay_out(path: &str, table: &mut Table) {
    let keys: Vec<String> = table.iter().map(|(key, _)| key.to_owned()).collect();
    for key in keys {
        let key_path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
        let text = comment(&key_path).map_or(String::new(), |text| format!("# {text}\n"));
        let Some(item) = table.get_mut(&key) else { continue };
        match item {
            Item::Value(Value::InlineTable(inline))
                if !INLINE.contains(&key.as_str()) && !INLINE_PATHS.contains(&key_path.as_str()) =>
            {
                let mut section = std::mem::take(inline).into_table();
                lay_out(&key_path, &mut section);
                section.decor_mut().set_prefix(format!("\n{text}"));
                *item = Item::Table(section);
                continue;
            }
            Item::Value(Value::Array(array)) if path.is_empty() => {
                let mut sections = ArrayOfTables::new();
                for value in std::mem::take(array) {
                    let Value::InlineTable(inline) = value else { continue };
                    let mut section = inline.into_table();
                    // One comment for all of them, and for their keys, is enough.
                    let first = sections.is_empty();
                    if first {
                        lay_out(&key_path, &mut section);
                    } else {
                        section.fmt();
                    }
                    section.decor_mut().set_prefix(if first { format!("\n{text}") } else { "\n".to_owned() });
                    sections.push(section);
                }
                *item = Item::ArrayOfTables(sections);
                continue;
            }
            Item::Value(Value::Array(array)) if key == "regions" => one_a_line(array),
            _ => {}
        }
        if let Some(mut key) = table.key_mut(&key) {
            key.leaf_decor_mut().set_prefix(text);
        }
    }
}

fn one_a_line(array: &mut toml_edit::Array) {
    for value in array.iter_mut() {
        value.decor_mut().set_prefix("\n    ");
    }
    array.set_trailing_comma(true);
    array.set_trailing("\n");
}
