// PCM to the matched-filtered spectrum of the band (plan, steps 1 to 3). Twin: src/imaging/cpu/matched_filter.rs.
//
// `band_filter`: complex band-pass FIR that keeps every D-th output. One invocation computes 8 consecutive outputs of one channel,
// phase after phase: in one phase the filter is an ordinary convolution, so that a sliding window of three vectors serves 32
// products a load. `forward_pass`, `forward_last`: the transform of N1, one pass a dispatch, one invocation a butterfly (see
// common/fft.wgsl); the last one keeps the K bins of the band only, and multiplies with the reference and the channel's gain
// (with PHAT after bringing the bin to unit magnitude).
//
// Bindings: 1 PCM in phase rows, 2 taps [phase][tap] in pairs, 3 source and 4 output [channel][n], 5 reference [sensor][bin],
// 6 gains [channel], of all sensors. Channels are rows, sensor * stride + channel.
// Workgroups: 64 along outputs; 16 butterflies by 8 rows, since a row has few butterflies and lanes along a row read neighbours.

override PHASES: u32 = 8u;

@group(0) @binding(1) var<storage, read> pcm: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> band_taps: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> source: array<vec2<f32>>;
@group(0) @binding(4) var<storage, read_write> output: array<vec2<f32>>;
@group(0) @binding(5) var<storage, read> reference: array<vec2<f32>>;
@group(0) @binding(6) var<storage, read> gains: array<f32>;

// The same as CPU and specification: below this power a bin has no phase (plan.rs, PHAT_POWER_MIN).
const PHAT_POWER_MIN: f32 = 1e-24;

fn store_output(row: u32, n: u32, re: f32, im: f32) {
    if (n < params.forward_len) {
        output[row * params.forward_len + n] = vec2<f32>(re, im);
    }
}

@compute @workgroup_size(64)
fn band_filter(@builtin(global_invocation_id) id: vec3<u32>) {
    let first = 8u * id.x;
    let sensor = id.z;
    if (first >= params.forward_len || !is_present(sensor)) {
        return;
    }
    let row = sensor * params.channel_stride + id.y;
    var re_low = vec4<f32>(0.0);
    var re_high = vec4<f32>(0.0);
    var im_low = vec4<f32>(0.0);
    var im_high = vec4<f32>(0.0);
    for (var phase = 0u; phase < PHASES; phase++) {
        var at = ((row * PHASES + phase) * params.phase_stride + first) / 4u;
        var tap = phase * params.tap_step_count * 2u;
        var a = pcm[at];
        var b = pcm[at + 1u];
        for (var step = 0u; step < params.tap_step_count; step++) {
            let c = pcm[at + 2u];
            let taps_01 = band_taps[tap];
            let taps_23 = band_taps[tap + 1u];
            re_low += taps_01.x * a;
            im_low += taps_01.y * a;
            re_high += taps_01.x * b;
            im_high += taps_01.y * b;
            let ab_1 = vec4<f32>(a.yzw, b.x);
            let bc_1 = vec4<f32>(b.yzw, c.x);
            re_low += taps_01.z * ab_1;
            im_low += taps_01.w * ab_1;
            re_high += taps_01.z * bc_1;
            im_high += taps_01.w * bc_1;
            let ab_2 = vec4<f32>(a.zw, b.xy);
            let bc_2 = vec4<f32>(b.zw, c.xy);
            re_low += taps_23.x * ab_2;
            im_low += taps_23.y * ab_2;
            re_high += taps_23.x * bc_2;
            im_high += taps_23.y * bc_2;
            let ab_3 = vec4<f32>(a.w, b.xyz);
            let bc_3 = vec4<f32>(b.w, c.xyz);
            re_low += taps_23.z * ab_3;
            im_low += taps_23.w * ab_3;
            re_high += taps_23.z * bc_3;
            im_high += taps_23.w * bc_3;
            a = b;
            b = c;
            at += 1u;
            tap += 2u;
        }
    }
    store_output(row, first, re_low.x, im_low.x);
    store_output(row, first + 1u, re_low.y, im_low.y);
    store_output(row, first + 2u, re_low.z, im_low.z);
    store_output(row, first + 3u, re_low.w, im_low.w);
    store_output(row, first + 4u, re_high.x, im_high.x);
    store_output(row, first + 5u, re_high.y, im_high.y);
    store_output(row, first + 6u, re_high.z, im_high.z);
    store_output(row, first + 7u, re_high.w, im_high.w);
}

@compute @workgroup_size(16, 8)
fn forward_pass(@builtin(global_invocation_id) id: vec3<u32>) {
    let q = id.x;
    let row = id.y;
    if (q >= butterfly_count() || row >= params.sensor_count * params.channel_stride
        || !is_present(row / params.channel_stride)) {
        return;
    }
    fetch_all(row, q);
    transform_values();
    keep_all(row, q);
}

@compute @workgroup_size(16, 8)
fn forward_last(@builtin(global_invocation_id) id: vec3<u32>) {
    let q = id.x;
    let row = id.y;
    if (q >= butterfly_count() || row >= params.sensor_count * params.channel_stride) {
        return;
    }
    fetch_all(row, q);
    transform_values();
    keep_bin(row, q, 0u); keep_bin(row, q, 1u); keep_bin(row, q, 2u); keep_bin(row, q, 3u);
    keep_bin(row, q, 4u); keep_bin(row, q, 5u); keep_bin(row, q, 6u); keep_bin(row, q, 7u);
    keep_bin(row, q, 8u); keep_bin(row, q, 9u); keep_bin(row, q, 10u); keep_bin(row, q, 11u);
    keep_bin(row, q, 12u); keep_bin(row, q, 13u); keep_bin(row, q, 14u); keep_bin(row, q, 15u);
    keep_bin(row, q, 16u); keep_bin(row, q, 17u); keep_bin(row, q, 18u); keep_bin(row, q, 19u);
    keep_bin(row, q, 20u); keep_bin(row, q, 21u); keep_bin(row, q, 22u); keep_bin(row, q, 23u);
    keep_bin(row, q, 24u); keep_bin(row, q, 25u); keep_bin(row, q, 26u); keep_bin(row, q, 27u);
}

fn keep_bin(row: u32, q: u32, k: u32) {
    if (k >= radix()) {
        return;
    }
    let bin = (output_place(q, k) + LEN - params.first_bin % LEN) % LEN;
    if (bin >= params.bin_count) {
        return;
    }
    var value = transformed(k);
    if (params.phat == 1u) {
        let power = dot(value, value);
        value = select(vec2<f32>(0.0), value / sqrt(power), power > PHAT_POWER_MIN);
    }
    let gain = gains[params.sensor_first * params.channel_stride + row];
    let own = reference[(params.sensor_first + row / params.channel_stride) * params.bin_count + bin];
    // A channel left out, or a sensor that did not deliver, gives zeros whatever the transform holds.
    output[row * params.bin_count + bin] = select(multiply(value, own) * gain, vec2<f32>(0.0), gain == 0.0);
}
