// CLEAN on the channel signals (plan, `clean`): the loudest cells, their echoes fitted and taken out, and main lobes put back.
// Twin: src/imaging/cpu/clean.rs, with cleaning.rs beside it. Joined to focus.wgsl, whose bindings, constants and functions it uses.
//
// `clean_pick` finds the loudest cell of every window of ranges; `clean_fit` fits the echo of the loudest of three windows, channel by
// channel, and says where it stands in each; `clean_take_out` takes all echoes of a round out of the signals, after which they are
// imaged anew; `clean_put_back` puts the main lobes of all rounds where they are louder than what is left.
//
// Bindings: 1 and 3 signals; 6 hidden directions; 8 taps; 9 energyscapes; 10 gains; 11 picks [sensor][window]: value, direction, range;
// 12 echoes [round][sensor][window][3]: value, direction, range, samples that it is late; wave front; amplitude and its slope over
// frequency; 13 arrivals [sensor][window][channel]: samples behind the cell's, cosine, sine; 14 table: [direction] unit vectors,
// [sensor][channel] place and square, [sensor][4] emitter and square, lobe xx yy zz and slope of a sample, lobe xy xz yz,
// centre of the coordinates;
// 15 pulse [sensor][entry]: pulse and its slope over frequency. Sensors of 10, 14 and 15 are counted from the first of all.
// Workgroups: one window of one sensor each to pick and to fit; one invocation of the others does one sample or one cell.

@group(0) @binding(11) var<storage, read_write> picks: array<vec4<f32>>;
@group(0) @binding(12) var<storage, read_write> echoes: array<vec4<f32>>;
@group(0) @binding(13) var<storage, read_write> arrivals: array<vec4<f32>>;
@group(0) @binding(14) var<storage, read> table: array<vec4<f32>>;
@group(0) @binding(15) var<storage, read> pulse: array<vec4<f32>>;

override ROUND: u32 = 0u;
override ROUNDS: u32 = 1u;
override WINDOWS: u32 = 1u;
override WINDOW_LEN: u32 = 1u;
override PULSE_REACH: u32 = 1u;
override RADIUS_M: f32 = 1.0;
override RANGE_FIRST_M: f32 = 0.0;
override RANGE_STEP_M: f32 = 1.0;

const PULSE_STEPS: u32 = 32u;
const IMPROVEMENTS: u32 = 3u;
const RIDGE: f32 = 1e-4;
// A phase and four coordinates.
const UNKNOWNS: u32 = 5u;
// Most channels of a sensor.
const CHANNELS_MAX: u32 = 256u;
// A lobe ends where its exponent has this root: at -55 dB.
const LOBE_END: f32 = 2.5;
const TWO_PI: f32 = 6.2831855;

var<workgroup> best: array<vec2<f32>, 64>;
var<workgroup> best_cell: array<u32, 64>;
// Values of the channels a sample before, at and behind the place of the echo.
var<workgroup> before: array<vec2<f32>, CHANNELS_MAX>;
var<workgroup> there: array<vec2<f32>, CHANNELS_MAX>;
var<workgroup> behind: array<vec2<f32>, CHANNELS_MAX>;
// The fit so far: samples that it is late, and the wave front.
var<workgroup> fit_late: f32;
var<workgroup> fit_tilt: vec4<f32>;

fn table_sensor(sensor: u32) -> u32 {
    return params.direction_count + params.gain_count + 4u * (params.sensor_first + sensor);
}

fn pulse_entries() -> u32 {
    return 2u * PULSE_REACH * PULSE_STEPS + 1u;
}

// The loudest cell of a window; of equals the one of the lowest direction, then range.
@compute @workgroup_size(64)
fn clean_pick(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let window = group.x;
    let sensor = group.y;
    let first = window * WINDOW_LEN;
    let ranges = min(WINDOW_LEN, params.range_count - min(first, params.range_count));
    var value = 0.0;
    var cell = 0xffffffffu;
    if (is_present(sensor)) {
        for (var index = lane; index < ranges * params.direction_count; index += 64u) {
            let here = index / ranges * params.range_count + first + index % ranges;
            let energy = energies[sensor * params.cell_stride + here];
            if (energy > value || (energy == value && here < cell)) {
                value = energy;
                cell = here;
            }
        }
    }
    best[lane].x = value;
    best_cell[lane] = cell;
    for (var reach = 32u; reach > 0u; reach /= 2u) {
        workgroupBarrier();
        if (lane < reach) {
            let other = best[lane + reach].x;
            if (other > best[lane].x || (other == best[lane].x && best_cell[lane + reach] < best_cell[lane])) {
                best[lane].x = other;
                best_cell[lane] = best_cell[lane + reach];
            }
        }
    }
    if (lane == 0u) {
        let found = best_cell[0];
        let none = best[0].x <= 0.0;
        let direction = select(found / params.range_count, 0u, none);
        let range = select(found % params.range_count, 0u, none);
        picks[sensor * WINDOWS + window] = vec4<f32>(best[0].x, f32(direction), f32(range), 0.0);
    }
}

// Coordinates of a channel for the wave front, in radii of the array.
fn terms_of(sensor: u32, channel: u32) -> vec4<f32> {
    let row = (params.sensor_first + sensor) * params.channel_stride + channel;
    let place = table[params.direction_count + row].xyz / RADIUS_M;
    return vec4<f32>(place, dot(place, place)) - table[table_sensor(sensor) + 3u];
}

// Samples and turns by which an echo's path to a channel is longer than twice its range.
fn arrival_of(sensor: u32, channel: u32, direction: u32, range: u32, tilt: vec4<f32>, late: f32) -> vec3<f32> {
    let row = (params.sensor_first + sensor) * params.channel_stride + channel;
    let range_m = RANGE_FIRST_M + f32(range) * RANGE_STEP_M;
    let unit = table[direction].xyz;
    let place = table[params.direction_count + row];
    let emitter = table[table_sensor(sensor)];
    let terms = terms_of(sensor, channel);
    let path = excess(range_m, dot(place.xyz, unit), place.w) + excess(range_m, dot(emitter.xyz, unit), emitter.w) + dot(terms, tilt);
    return vec3<f32>(path * params.focus_samples_per_m + late, cos_sin(path * params.focus_turns_per_m));
}

fn gain_of(sensor: u32, channel: u32) -> f32 {
    return gains[(params.sensor_first + sensor) * params.channel_stride + channel];
}

fn tap_of(entry: u32, tap: u32, share: f32) -> f32 {
    let at = 3u * entry + tap / 4u;
    return mix(taps[at][tap % 4u], taps[at + 3u][tap % 4u], share);
}

// Reads a channel a sample before an echo's place, there and a sample behind, brought into line.
fn read_around(sensor: u32, channel: u32, range: u32, arrival: vec3<f32>) {
    let whole = floor(arrival.x);
    let step = (arrival.x - whole) * FRACTIONS;
    let entry = min(floor(step), FRACTIONS - 1.0);
    let share = step - entry;
    let row = (sensor * params.channel_stride + channel) * OVERSAMPLING;
    let base = i32(whole) + i32((params.focus_lead + range) * OVERSAMPLING) - TAPS_BEFORE - 1;
    var found_before = vec2<f32>(0.0);
    var found_there = vec2<f32>(0.0);
    var found_behind = vec2<f32>(0.0);
    for (var place = 0u; place < TAPS + 2u; place++) {
        let n = base + i32(place);
        if (n >= 0 && u32(n) / OVERSAMPLING < params.focus_row_len) {
            let value = source[(row + u32(n) % OVERSAMPLING) * params.focus_row_len + u32(n) / OVERSAMPLING];
            if (place < TAPS) {
                found_before += tap_of(u32(entry), place, share) * value;
            }
            if (place > 0u && place <= TAPS) {
                found_there += tap_of(u32(entry), place - 1u, share) * value;
            }
            if (place > 1u) {
                found_behind += tap_of(u32(entry), place - 2u, share) * value;
            }
        }
    }
    before[channel] = multiply(found_before, arrival.yz);
    there[channel] = multiply(found_there, arrival.yz);
    behind[channel] = multiply(found_behind, arrival.yz);
}

fn conjugate_times(a: vec2<f32>, b: vec2<f32>) -> vec2<f32> {
    return vec2<f32>(dot(a, b), a.x * b.y - a.y * b.x);
}

// Amplitude of the pulse and of its slope that the beam shows at its peak and a sample to either side.
fn amplitudes(sensor: u32) -> vec4<f32> {
    var beam_before = vec2<f32>(0.0);
    var beam = vec2<f32>(0.0);
    var beam_behind = vec2<f32>(0.0);
    var whole = 0.0;
    for (var channel = 0u; channel < params.channel_stride; channel++) {
        if (gain_of(sensor, channel) > 0.0) {
            whole += gain_of(sensor, channel);
            beam_before += before[channel];
            beam += there[channel];
            beam_behind += behind[channel];
        }
    }
    let share = over(1.0, whole);
    beam *= share;
    let peak = (params.sensor_first + sensor) * pulse_entries() + PULSE_REACH * PULSE_STEPS;
    let early = pulse[peak - PULSE_STEPS];
    let later = pulse[peak + PULSE_STEPS];
    var slope = conjugate_times(early.zw, beam_before * share - multiply(beam, early.xy));
    slope += conjugate_times(later.zw, beam_behind * share - multiply(beam, later.xy));
    slope *= over(1.0, dot(early.zw, early.zw) + dot(later.zw, later.zw));
    // More slope than echo is another echo.
    slope *= min(sqrt(over(dot(beam, beam), dot(slope, slope))), 1.0);
    return vec4<f32>(beam, slope);
}

var<private> system: array<array<f32, UNKNOWNS>, UNKNOWNS>;
var<private> sides: array<f32, UNKNOWNS>;
var<private> row_terms: array<f32, UNKNOWNS>;

// How the channels' phases change with the coordinates: least squares with a ridge.
fn phase_slopes(sensor: u32, beam: vec2<f32>) -> vec4<f32> {
    for (var i = 0u; i < UNKNOWNS; i++) {
        sides[i] = 0.0;
        for (var k = 0u; k < UNKNOWNS; k++) {
            system[i][k] = select(0.0, RIDGE, i == k);
        }
    }
    for (var channel = 0u; channel < params.channel_stride; channel++) {
        let gain = gain_of(sensor, channel);
        if (gain > 0.0) {
            let value = there[channel];
            let sine = over(conjugate_times(beam, value).y, sqrt(dot(value, value) * dot(beam, beam)));
            let terms = terms_of(sensor, channel);
            row_terms[0] = 1.0;
            row_terms[1] = terms.x;
            row_terms[2] = terms.y;
            row_terms[3] = terms.z;
            row_terms[4] = terms.w;
            for (var i = 0u; i < UNKNOWNS; i++) {
                sides[i] += gain * row_terms[i] * sine;
                for (var k = 0u; k < UNKNOWNS; k++) {
                    system[i][k] += gain * row_terms[i] * row_terms[k];
                }
            }
        }
    }
    for (var pivot = 0u; pivot < UNKNOWNS; pivot++) {
        for (var i = pivot + 1u; i < UNKNOWNS; i++) {
            let factor = system[i][pivot] / system[pivot][pivot];
            for (var k = pivot; k < UNKNOWNS; k++) {
                system[i][k] -= factor * system[pivot][k];
            }
            sides[i] -= factor * sides[pivot];
        }
    }
    for (var up = 0u; up < UNKNOWNS; up++) {
        let i = UNKNOWNS - 1u - up;
        for (var k = i + 1u; k < UNKNOWNS; k++) {
            sides[i] -= system[i][k] * sides[k];
        }
        sides[i] /= system[i][i];
    }
    return vec4<f32>(sides[1], sides[2], sides[3], sides[4]);
}

// Whether a window's loudest cell is an echo of its own: not less than the neighbours', and no flank of something beyond the image.
fn is_candidate(sensor: u32, window: u32) -> bool {
    let pick = picks[sensor * WINDOWS + window];
    let range = u32(pick.z);
    var candidate = pick.x > 0.0 && pick.x < 3.4e38 && range > 0u && range + 1u < params.range_count;
    if (window > 0u) {
        candidate = candidate && pick.x > picks[sensor * WINDOWS + window - 1u].x;
    }
    if (window + 1u < WINDOWS) {
        candidate = candidate && pick.x >= picks[sensor * WINDOWS + window + 1u].x;
    }
    return candidate;
}

@compute @workgroup_size(64)
fn clean_fit(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let window = group.x;
    let sensor = group.y;
    let at = 3u * ((ROUND * params.sensor_count + sensor) * WINDOWS + window);
    let pick = picks[sensor * WINDOWS + window];
    let direction = u32(pick.y);
    let range = u32(pick.z);
    let wanted = is_present(sensor) && is_candidate(sensor, window);
    if (lane == 0u) {
        fit_late = 0.0;
        fit_tilt = vec4<f32>(0.0);
        echoes[at] = vec4<f32>(0.0);
    }
    let slope_per_sample = table[table_sensor(sensor) + 1u].w;
    for (var step = 0u; step <= IMPROVEMENTS; step++) {
        workgroupBarrier();
        for (var channel = lane; wanted && channel < params.channel_stride; channel += 64u) {
            let arrival = arrival_of(sensor, channel, direction, range, fit_tilt, fit_late);
            arrivals[(sensor * WINDOWS + window) * params.channel_stride + channel] = vec4<f32>(arrival, 0.0);
            read_around(sensor, channel, range, arrival);
        }
        workgroupBarrier();
        if (lane == 0u && wanted) {
            let found = amplitudes(sensor);
            if (step == IMPROVEMENTS) {
                echoes[at] = vec4<f32>(pick.x, pick.y, pick.z, fit_late);
                echoes[at + 1u] = fit_tilt;
                echoes[at + 2u] = found;
            } else {
                let most = f32(OVERSAMPLING);
                let late = -over(conjugate_times(found.xy, found.zw).y, dot(found.xy, found.xy) * slope_per_sample);
                fit_late = clamp(fit_late + clamp(late, -most, most), -1.5 * most, 1.5 * most);
                // A phase ahead of the others' is a path that is shorter than was taken.
                fit_tilt -= phase_slopes(sensor, found.xy) / (TWO_PI * params.focus_turns_per_m);
            }
        }
    }
}

// One sample of a channel less all echoes of this round.
@compute @workgroup_size(64)
fn clean_take_out(@builtin(global_invocation_id) id: vec3<u32>) {
    let n = id.x;
    let channel = id.y;
    let sensor = id.z;
    if (n >= OVERSAMPLING * params.focus_row_len || channel >= params.channel_stride || !is_present(sensor)) {
        return;
    }
    let gain = gain_of(sensor, channel);
    let entries = pulse_entries();
    let reach = f32(PULSE_REACH);
    var sum = vec2<f32>(0.0);
    for (var window = 0u; window < WINDOWS; window++) {
        let at = 3u * ((ROUND * params.sensor_count + sensor) * WINDOWS + window);
        let echo = echoes[at];
        if (echo.x > 0.0) {
            let arrival = arrivals[(sensor * WINDOWS + window) * params.channel_stride + channel];
            let place = f32(i32(n) - i32((params.focus_lead + u32(echo.z)) * OVERSAMPLING)) - arrival.x;
            if (abs(place) <= reach) {
                let step = (place + reach) * f32(PULSE_STEPS);
                let entry = min(u32(max(step, 0.0)), entries - 2u);
                let share = step - f32(entry);
                let row = (params.sensor_first + sensor) * entries + entry;
                let read = mix(pulse[row], pulse[row + 1u], share);
                let found = echoes[at + 2u];
                sum += multiply(
                    multiply(found.xy, read.xy) + multiply(found.zw, read.zw),
                    vec2<f32>(arrival.y, -arrival.z) * gain,
                );
            }
        }
    }
    let row = (sensor * params.channel_stride + channel) * OVERSAMPLING + n % OVERSAMPLING;
    signals[row * params.focus_row_len + n / OVERSAMPLING] -= sum;
}

// Exponent of a main lobe across directions.
fn bent(sensor: u32, change: vec3<f32>) -> f32 {
    let lobe = table[table_sensor(sensor) + 1u].xyz;
    let mixed = table[table_sensor(sensor) + 2u].xyz;
    return dot(lobe, change * change) + 2.0 * dot(mixed, change.xxy * change.yzz);
}

// One cell: the louder of what is left and of the main lobes of the echoes.
@compute @workgroup_size(64)
fn clean_put_back(@builtin(global_invocation_id) id: vec3<u32>) {
    let range = id.x;
    let direction = id.y;
    let sensor = id.z;
    if (range >= params.range_count || !is_present(sensor)) {
        return;
    }
    if (emitters[(params.sensor_first + sensor) * params.direction_count + direction].z > 0.0) {
        return;
    }
    let slope_per_sample = table[table_sensor(sensor) + 1u].w;
    let narrow = 0.5 * slope_per_sample * slope_per_sample;
    let reach = u32(LOBE_END / sqrt(narrow)) / OVERSAMPLING + 2u;
    let cell = sensor * params.cell_stride + direction * params.range_count + range;
    var value = energies[cell];
    let first = (range - min(reach, range)) / WINDOW_LEN;
    let last = min((range + reach) / WINDOW_LEN, WINDOWS - 1u);
    for (var window = first; window <= last; window++) {
        for (var round = 0u; round < ROUNDS; round++) {
            let at = 3u * ((round * params.sensor_count + sensor) * WINDOWS + window);
            let echo = echoes[at];
            let away = i32(range) - i32(echo.z);
            if (echo.x > 0.0 && abs(away) <= i32(reach)) {
                let tilt = echoes[at + 1u].xyz / RADIUS_M;
                let change = table[direction].xyz - table[u32(echo.y)].xyz + tilt;
                // The cell itself is to read what it read.
                let across = bent(sensor, tilt) - bent(sensor, change);
                let samples = f32(away) * f32(OVERSAMPLING) - echo.w;
                let along = narrow * (echo.w * echo.w - samples * samples);
                value = max(value, select(0.0, echo.x * exp(across + along), across >= -LOBE_END * LOBE_END));
            }
        }
    }
    energies[cell] = value;
}
