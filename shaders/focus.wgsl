// Band spectra of the channels to the near ranges of the energyscape, focused on their exact path (plan, `focus`).
// Twin: src/imaging/cpu/focus.rs, with channel_signal.rs, combine.rs and minimum_variance.rs beside it.
//
// `signal_first` to `signal_last` transform the spectra of the channels back, about the centre frequency, and keep the stretch that
// focusing reads: row p of a channel holds samples p, p + OVERSAMPLING ..., so that neighbouring ranges read neighbours.
// One invocation of `focus` computes one cell, of `focus_sums` four: for every channel the excess of the path over twice the range
// says which samples to read, between which to interpolate and by how much to turn the phase. Ranges of a block share the excess
// of one of them.
//
// Bindings: 1 source and 2 output of a pass [channel][n], the source of `focus` being the signals; 3 signals [sub-band][channel][row][sample];
// 4 p.u [sensor][direction][channel]; 5 |p|^2 [sensor][channel]; 6 [sensor][direction]: e.u, |e|^2, 1 where hidden; 7 [range]:
// the range whose excess it has; 8 taps [fraction][3]; 9 energyscapes [direction][range]; 10 gains [sensor][channel], then [sensor] the
// number of channels with a gain and what products are scaled with. Sensors of 4 to 6 and 10 are counted from the first of all.
// Workgroups: 16 butterflies by 8 channels; 64 ranges of one direction, which read the same geometry and neighbouring samples.

@group(0) @binding(1) var<storage, read> source: array<vec2<f32>>;
@group(0) @binding(2) var<storage, read_write> output: array<vec2<f32>>;
@group(0) @binding(3) var<storage, read_write> signals: array<vec2<f32>>;
@group(0) @binding(4) var<storage, read> along: array<f32>;
@group(0) @binding(5) var<storage, read> squares: array<f32>;
@group(0) @binding(6) var<storage, read> emitters: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> focus_ranges: array<f32>;
@group(0) @binding(8) var<storage, read> taps: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read_write> energies: array<f32>;
@group(0) @binding(10) var<storage, read> gains: array<f32>;

// Samples of a channel signal from one range to the next.
override OVERSAMPLING: u32 = 2u;
// Channels multiplied with one another, 1 for their sum; factor on the amplitude: 0 none, 1 amplitude, 2 phase, 3 sign.
override ORDER: u32 = 1u;
override COHERENCE: u32 = 0u;
// Sub-bands of minimum variance; 1 for the other beamformers.
override SUB_BANDS: u32 = 1u;

const SNAPSHOTS: u32 = 5u;
// Diagonal loading: a share of the mean power of a channel.
const LOADING: f32 = 1.0;

// Taps of the interpolator, those before the sample itself, and steps of a sample for which they are tabled.
const TAPS: u32 = 10u;
const TAPS_BEFORE: i32 = 4;
const FRACTIONS: f32 = 256.0;
// A channel's sign turns over within 1 / this of the cosine about a right angle, so that rounding decides nothing.
const SIGN_STEEPNESS: f32 = 8.0;

// Whether butterfly q of a channel is to be computed.
fn is_wanted(row: u32, q: u32) -> bool {
    return q < butterfly_count() && row < SUB_BANDS * channel_rows() && is_present(row % channel_rows() / params.channel_stride);
}

// Rows of one sub-band.
fn channel_rows() -> u32 {
    return params.sensor_count * params.channel_stride;
}

// Share of a bin in a sub-band; all shares of a bin make one.
fn share_of(sub_band: u32, bin: u32) -> f32 {
    let place = (f32(bin) + 0.5) / f32(params.bin_count) * f32(SUB_BANDS) - 0.5;
    let distance = abs(clamp(place, 0.0, f32(SUB_BANDS) - 1.0) - f32(sub_band));
    let cosine = cos_sin(0.25 * min(distance, 1.0)).x;
    return cosine * cosine;
}

// Bin at place n of LEN with the centre frequency at zero, exchanged for the inverse transform.
fn fetch_bin(row: u32, q: u32, r: u32) {
    if (r < radix()) {
        let n = q + r * butterfly_count();
        let bin = (n + LEN - params.focus_first_bin) % LEN;
        values[r] = vec2<f32>(0.0);
        if (bin < params.bin_count) {
            values[r] = source[row % channel_rows() * params.bin_count + bin].yx;
            if (SUB_BANDS > 1u) {
                values[r] *= share_of(row / channel_rows(), bin);
            }
        }
    }
}

// Keeps output n wherever it stands in the stretch: samples before the first range come from the end of the circle.
fn keep_sample(row: u32, q: u32, k: u32) {
    if (k < radix()) {
        let n = (output_place(q, k) + OVERSAMPLING * params.focus_lead) % LEN;
        let length = params.focus_row_len;
        let first = (row * OVERSAMPLING + n % OVERSAMPLING) * length;
        let value = transformed(k).yx;
        for (var place = n / OVERSAMPLING; place < length; place += LEN / OVERSAMPLING) {
            signals[first + place] = value;
        }
    }
}

@compute @workgroup_size(16, 8)
fn signal_first(@builtin(global_invocation_id) id: vec3<u32>) {
    let q = id.x;
    let row = id.y;
    if (!is_wanted(row, q)) {
        return;
    }
    fetch_bin(row, q, 0u); fetch_bin(row, q, 1u); fetch_bin(row, q, 2u); fetch_bin(row, q, 3u);
    fetch_bin(row, q, 4u); fetch_bin(row, q, 5u); fetch_bin(row, q, 6u); fetch_bin(row, q, 7u);
    fetch_bin(row, q, 8u); fetch_bin(row, q, 9u); fetch_bin(row, q, 10u); fetch_bin(row, q, 11u);
    fetch_bin(row, q, 12u); fetch_bin(row, q, 13u); fetch_bin(row, q, 14u); fetch_bin(row, q, 15u);
    fetch_bin(row, q, 16u); fetch_bin(row, q, 17u); fetch_bin(row, q, 18u); fetch_bin(row, q, 19u);
    fetch_bin(row, q, 20u); fetch_bin(row, q, 21u); fetch_bin(row, q, 22u); fetch_bin(row, q, 23u);
    fetch_bin(row, q, 24u); fetch_bin(row, q, 25u); fetch_bin(row, q, 26u); fetch_bin(row, q, 27u);
    transform_values();
    keep_all(row, q);
}

@compute @workgroup_size(16, 8)
fn signal_pass(@builtin(global_invocation_id) id: vec3<u32>) {
    let q = id.x;
    let row = id.y;
    if (!is_wanted(row, q)) {
        return;
    }
    fetch_all(row, q);
    transform_values();
    keep_all(row, q);
}

@compute @workgroup_size(16, 8)
fn signal_last(@builtin(global_invocation_id) id: vec3<u32>) {
    let q = id.x;
    let row = id.y;
    if (!is_wanted(row, q)) {
        return;
    }
    fetch_all(row, q);
    transform_values();
    keep_sample(row, q, 0u); keep_sample(row, q, 1u); keep_sample(row, q, 2u); keep_sample(row, q, 3u);
    keep_sample(row, q, 4u); keep_sample(row, q, 5u); keep_sample(row, q, 6u); keep_sample(row, q, 7u);
    keep_sample(row, q, 8u); keep_sample(row, q, 9u); keep_sample(row, q, 10u); keep_sample(row, q, 11u);
    keep_sample(row, q, 12u); keep_sample(row, q, 13u); keep_sample(row, q, 14u); keep_sample(row, q, 15u);
    keep_sample(row, q, 16u); keep_sample(row, q, 17u); keep_sample(row, q, 18u); keep_sample(row, q, 19u);
    keep_sample(row, q, 20u); keep_sample(row, q, 21u); keep_sample(row, q, 22u); keep_sample(row, q, 23u);
    keep_sample(row, q, 24u); keep_sample(row, q, 25u); keep_sample(row, q, 26u); keep_sample(row, q, 27u);
}

// |r u - p| - r for p.u and |p|^2, without the difference of large numbers.
fn excess(range: f32, along_m: f32, square: f32) -> f32 {
    let bend = square - 2.0 * range * along_m;
    return bend / max(sqrt(max(range * range + bend, 0.0)) + range, 1.1754944e-38);
}

// How a channel is read at the range of a cell: taps, place of the first sample in row 0 and its number, turn of the phase.
struct Reading {
    tap_0: vec4<f32>,
    tap_1: vec4<f32>,
    tap_2: vec4<f32>,
    first: u32,
    start: u32,
    turn: vec2<f32>,
}

fn reading_of(sub_band: u32, sensor: u32, channel: u32, direction: u32, cell_range: i32, range: f32, emitter_excess: f32) -> Reading {
    let stride = params.channel_stride;
    let row = params.sensor_first + sensor;
    let along_m = along[(row * params.direction_count + direction) * stride + channel];
    let path = emitter_excess + excess(range, along_m, squares[row * stride + channel]);
    let samples = path * params.focus_samples_per_m;
    let whole = floor(samples);
    let step = (samples - whole) * FRACTIONS;
    let entry = min(floor(step), FRACTIONS - 1.0);
    let share = step - entry;
    let at = 3u * u32(entry);
    // Never negative: `focus_lead` samples stand before the first range.
    let start = u32(max(i32(whole) + i32(params.focus_lead * OVERSAMPLING) - TAPS_BEFORE, 0));
    let channel_row = sub_band * channel_rows() + sensor * stride + channel;
    return Reading(
        mix(taps[at], taps[at + 3u], share),
        mix(taps[at + 1u], taps[at + 4u], share),
        mix(taps[at + 2u], taps[at + 5u], share),
        u32(i32(channel_row * OVERSAMPLING * params.focus_row_len) + cell_range),
        start,
        cos_sin(path * params.focus_turns_per_m),
    );
}

// The channel's signal `farther` ranges behind that of the reading, between its samples and turned.
fn channel_at(reading: Reading, farther: u32) -> vec2<f32> {
    let first = reading.first + farther;
    let start = reading.start;
    var sum = reading.tap_0.x * sample_at(first, start) + reading.tap_0.y * sample_at(first, start + 1u);
    sum += reading.tap_0.z * sample_at(first, start + 2u) + reading.tap_0.w * sample_at(first, start + 3u);
    sum += reading.tap_1.x * sample_at(first, start + 4u) + reading.tap_1.y * sample_at(first, start + 5u);
    sum += reading.tap_1.z * sample_at(first, start + 6u) + reading.tap_1.w * sample_at(first, start + 7u);
    sum += reading.tap_2.x * sample_at(first, start + 8u) + reading.tap_2.y * sample_at(first, start + 9u);
    return multiply(sum, reading.turn);
}

// What a channel adds to a cell: its signal where the path of the cell's block ends.
fn aligned(sensor: u32, channel: u32, direction: u32, cell_range: u32, range: f32, emitter_excess: f32) -> vec2<f32> {
    return channel_at(reading_of(0u, sensor, channel, direction, i32(cell_range), range, emitter_excess), 0u);
}

// Sample n of a channel, counted for range 0; `first` is that of the cell's range in row 0.
fn sample_at(first: u32, n: u32) -> vec2<f32> {
    return source[first + (n % OVERSAMPLING) * params.focus_row_len + n / OVERSAMPLING];
}

// a / b, zero where b is not above zero.
fn over(a: f32, b: f32) -> f32 {
    return select(0.0, a / b, b > 0.0);
}

// The ORDER-th root of what is not negative: the built-in power comes near it, Newton's method does the rest.
fn root(value: f32) -> f32 {
    if (ORDER == 2u) {
        return sqrt(value);
    }
    if (ORDER == 4u) {
        return sqrt(sqrt(value));
    }
    let order = f32(ORDER);
    var guess = exp2(log2(max(value, 1.1754944e-38)) / order);
    for (var step = 0u; step < 2u; step++) {
        var raised = guess;
        for (var factor = 2u; factor < ORDER; factor++) {
            raised *= guess;
        }
        guess = (guess * (order - 1.0) + over(value, raised)) / order;
    }
    return select(0.0, guess, value > 0.0);
}

// One less the scatter about a mean.
fn less_scatter(mean_square: f32) -> f32 {
    return 1.0 - sqrt(max(1.0 - mean_square, 0.0));
}

// Power sums of the channels' values, each with its root for amplitude.
var<private> power_sum_1: vec2<f32>;
var<private> power_sum_2: vec2<f32>;
var<private> power_sum_3: vec2<f32>;
var<private> power_sum_4: vec2<f32>;
var<private> power_sum_5: vec2<f32>;

fn add_powers(value: vec2<f32>) {
    let magnitude = sqrt(dot(value, value));
    let base = value * over(root(magnitude), magnitude);
    power_sum_1 += base;
    var raised = multiply(base, base);
    power_sum_2 += raised;
    if (ORDER > 2u) {
        raised = multiply(raised, base);
        power_sum_3 += raised;
    }
    if (ORDER > 3u) {
        raised = multiply(raised, base);
        power_sum_4 += raised;
    }
    if (ORDER > 4u) {
        power_sum_5 += multiply(raised, base);
    }
}

// Magnitude of the sum of all products of ORDER different channels, by Newton's identities.
fn products() -> f32 {
    let e_1 = power_sum_1;
    let e_2 = (multiply(e_1, power_sum_1) - power_sum_2) / 2.0;
    if (ORDER == 2u) {
        return sqrt(dot(e_2, e_2));
    }
    let e_3 = (multiply(e_2, power_sum_1) - multiply(e_1, power_sum_2) + power_sum_3) / 3.0;
    if (ORDER == 3u) {
        return sqrt(dot(e_3, e_3));
    }
    let e_4 = (multiply(e_3, power_sum_1) - multiply(e_2, power_sum_2) + multiply(e_1, power_sum_3) - power_sum_4) / 4.0;
    if (ORDER == 4u) {
        return sqrt(dot(e_4, e_4));
    }
    let e_5 = (multiply(e_4, power_sum_1) - multiply(e_3, power_sum_2) + multiply(e_2, power_sum_3)
        - multiply(e_1, power_sum_4) + power_sum_5) / 5.0;
    return sqrt(dot(e_5, e_5));
}

// S^H S, its upper half, and S^H 1: see src/imaging/cpu/minimum_variance.rs, step by step the same.
var<private> gram: array<array<vec2<f32>, SNAPSHOTS>, SNAPSHOTS>;
var<private> snapshot_sums: array<vec2<f32>, SNAPSHOTS>;
var<private> snapshot: array<vec2<f32>, SNAPSHOTS>;
var<private> solved: array<vec2<f32>, SNAPSHOTS>;
var<private> inverse: array<f32, SNAPSHOTS>;

fn conjugate(a: vec2<f32>) -> vec2<f32> {
    return vec2<f32>(a.x, -a.y);
}

// Output of least variance of one sub-band.
fn minimum_variance(
    sub_band: u32,
    sensor: u32,
    direction: u32,
    cell_range: u32,
    range: f32,
    emitter_excess: f32,
    count: f32,
) -> vec2<f32> {
    for (var i = 0u; i < SNAPSHOTS; i++) {
        snapshot_sums[i] = vec2<f32>(0.0);
        for (var k = 0u; k < SNAPSHOTS; k++) {
            gram[i][k] = vec2<f32>(0.0);
        }
    }
    for (var channel = 0u; channel < params.channel_stride; channel++) {
        let gain = gains[(params.sensor_first + sensor) * params.channel_stride + channel];
        if (gain <= 0.0) {
            continue;
        }
        for (var i = 0u; i < SNAPSHOTS; i++) {
            let at = i32(cell_range) + (i32(i) - i32(SNAPSHOTS / 2u)) * i32(SUB_BANDS);
            snapshot[i] = channel_at(reading_of(sub_band, sensor, channel, direction, at, range, emitter_excess), 0u) / gain;
        }
        for (var i = 0u; i < SNAPSHOTS; i++) {
            snapshot_sums[i] += conjugate(snapshot[i]);
            for (var k = i; k < SNAPSHOTS; k++) {
                gram[i][k] += multiply(conjugate(snapshot[i]), snapshot[k]);
            }
        }
    }
    var trace = 0.0;
    for (var i = 0u; i < SNAPSHOTS; i++) {
        trace += gram[i][i].x;
        solved[i] = snapshot_sums[i];
    }
    let load = trace * LOADING / max(count, 1.0);
    for (var pivot = 0u; pivot < SNAPSHOTS; pivot++) {
        inverse[pivot] = over(1.0, gram[pivot][pivot].x + load);
        for (var i = pivot + 1u; i < SNAPSHOTS; i++) {
            let factor = conjugate(gram[pivot][i]) * inverse[pivot];
            for (var k = i; k < SNAPSHOTS; k++) {
                gram[i][k] -= multiply(factor, gram[pivot][k]);
            }
            solved[i] -= multiply(factor, solved[pivot]);
        }
    }
    var within = 0.0;
    for (var down = 0u; down < SNAPSHOTS; down++) {
        let i = SNAPSHOTS - 1u - down;
        var rest = solved[i];
        for (var k = i + 1u; k < SNAPSHOTS; k++) {
            rest -= multiply(gram[i][k], solved[k]);
        }
        solved[i] = rest * inverse[i];
        within += dot(snapshot_sums[i], solved[i]);
    }
    return conjugate(solved[SNAPSHOTS / 2u]) * over(load, count - within);
}

@compute @workgroup_size(64)
fn focus(@builtin(global_invocation_id) id: vec3<u32>) {
    let cell_range = id.x;
    let direction = id.y;
    let sensor = id.z;
    if (cell_range >= params.focus_count || !is_present(sensor)) {
        return;
    }
    let row = params.sensor_first + sensor;
    let emitter = emitters[row * params.direction_count + direction];
    let range = focus_ranges[cell_range];
    let emitter_excess = excess(range, emitter.x, emitter.y);
    let scale = vec2<f32>(gains[params.gain_count + 2u * row], gains[params.gain_count + 2u * row + 1u]);
    let cell = sensor * params.cell_stride + direction * params.range_count + cell_range;
    if (SUB_BANDS > 1u) {
        var output_sum = vec2<f32>(0.0);
        for (var band = 0u; band < SUB_BANDS; band++) {
            output_sum += minimum_variance(band, sensor, direction, cell_range, range, emitter_excess, scale.x);
        }
        energies[cell] = select(sqrt(dot(output_sum, output_sum)), 0.0, emitter.z > 0.0);
        return;
    }
    var sum = vec2<f32>(0.0);
    // Sum of the powers over the gains, and mean of the phasors.
    var powers = 0.0;
    var phasor = vec2<f32>(0.0);
    for (var channel = 0u; channel < params.channel_stride; channel++) {
        let gain = gains[row * params.channel_stride + channel];
        let value = aligned(sensor, channel, direction, cell_range, range, emitter_excess);
        sum += value;
        if (COHERENCE == 1u) {
            powers += over(dot(value, value), gain);
        }
        if (COHERENCE == 2u) {
            phasor += value * over(gain, sqrt(dot(value, value)));
        }
        if (ORDER > 1u) {
            add_powers(value * scale.x);
        }
    }
    let length = sqrt(dot(sum, sum));
    var amplitude = length;
    if (ORDER > 1u) {
        amplitude = products() * scale.y;
    }
    if (COHERENCE == 1u) {
        amplitude *= over(dot(sum, sum), powers);
    }
    if (COHERENCE == 2u) {
        amplitude *= less_scatter(dot(phasor, phasor));
    }
    if (COHERENCE == 3u) {
        // The signs refer to the sum, which is known only now.
        var mean = 0.0;
        for (var channel = 0u; channel < params.channel_stride; channel++) {
            let value = aligned(sensor, channel, direction, cell_range, range, emitter_excess);
            let cosine = over(dot(value, sum), sqrt(dot(value, value)) * length);
            mean += gains[row * params.channel_stride + channel] * clamp(SIGN_STEEPNESS * cosine, -1.0, 1.0);
        }
        amplitude *= less_scatter(mean * mean);
    }
    energies[cell] = select(amplitude, 0.0, emitter.z > 0.0);
}

fn keep_sum(cell: u32, farther: u32, cell_range: u32, hidden: bool, sum: vec2<f32>) {
    if (cell_range + farther < params.focus_count) {
        energies[cell + farther] = select(sqrt(dot(sum, sum)), 0.0, hidden);
    }
}

// As `focus` for the plain sum: four neighbouring ranges of one block, which share a reading.
@compute @workgroup_size(64)
fn focus_sums(@builtin(global_invocation_id) id: vec3<u32>) {
    let cell_range = 4u * id.x;
    let direction = id.y;
    let sensor = id.z;
    if (cell_range >= params.focus_count || !is_present(sensor)) {
        return;
    }
    let emitter = emitters[(params.sensor_first + sensor) * params.direction_count + direction];
    let range = focus_ranges[cell_range];
    let emitter_excess = excess(range, emitter.x, emitter.y);
    var sum_0 = vec2<f32>(0.0);
    var sum_1 = vec2<f32>(0.0);
    var sum_2 = vec2<f32>(0.0);
    var sum_3 = vec2<f32>(0.0);
    for (var channel = 0u; channel < params.channel_stride; channel++) {
        let reading = reading_of(0u, sensor, channel, direction, i32(cell_range), range, emitter_excess);
        sum_0 += channel_at(reading, 0u);
        sum_1 += channel_at(reading, 1u);
        sum_2 += channel_at(reading, 2u);
        sum_3 += channel_at(reading, 3u);
    }
    let cell = sensor * params.cell_stride + direction * params.range_count + cell_range;
    keep_sum(cell, 0u, cell_range, emitter.z > 0.0, sum_0);
    keep_sum(cell, 1u, cell_range, emitter.z > 0.0, sum_1);
    keep_sum(cell, 2u, cell_range, emitter.z > 0.0, sum_2);
    keep_sum(cell, 3u, cell_range, emitter.z > 0.0, sum_3);
}
