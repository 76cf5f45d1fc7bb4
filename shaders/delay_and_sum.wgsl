// Band spectra of the channels to band spectra of the directions (plan, step 4). Twin: src/imaging/cpu/delay_and_sum.rs.
//
// Sum over channels of spectrum times exp(-j 2 pi k turns), turns = bin step * delay: fractional delays are exact. One invocation
// computes one bin of up to 8 directions of all sensors that share this steering (1 to 3): four beams, each a direction and, where
// there is one, its mirror image, whose delays are the negative ones. With a cosine and a sine, a + jb gives the four products
// a cos, b sin, b cos, a sin; their sums make both directions, so that the mirror image is free, as are the angles of further sensors.
// Nothing is folded here: the first pass of `envelope` adds the bins that fall together as it reads them.
//
// Bindings: 1 spectra [channel][bin], 2 turns a bin of four beams [quad][channel], 3 slots of every beam and its mirror
// image, 4 spectra of the directions [row][bin]: the tile's slots of the first sensor, then of the next. Sensors stand one after
// another in 1, too.
// Workgroups of 64 along bins: loads and stores are contiguous, the turns are the same for all lanes.

// The sensors of the bank that share this steering, their number, and their channels.
override SENSOR_A: u32 = 0u;
override SENSOR_B: u32 = 0u;
override SENSOR_C: u32 = 0u;
override SENSORS: u32 = 1u;
override CHANNELS: u32 = 32u;

// A beam without a mirror image.
const NO_SLOT: u32 = 0xffffffffu;

@group(0) @binding(1) var<storage, read> spectra: array<vec2<f32>>;
@group(0) @binding(2) var<storage, read> turns: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> beams: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read_write> output: array<vec2<f32>>;

// Sums of the products of four beams.
struct Sums {
    a_cos: vec4<f32>,
    b_sin: vec4<f32>,
    b_cos: vec4<f32>,
    a_sin: vec4<f32>,
}

fn store(row: u32, slot: u32, bin: u32, value: vec2<f32>) {
    if (slot != NO_SLOT) {
        output[(row + slot - params.slot_first) * params.bin_count + bin] = value;
    }
}

// Stores the beams of the `index`-th sensor of this steering.
fn store_beams(sensor: u32, index: u32, quad: u32, bin: u32, sums: Sums) {
    if (!is_present(sensor)) {
        return;
    }
    let row = params.row_base + index * params.row_step;
    let re = sums.a_cos + sums.b_sin;
    let im = sums.b_cos - sums.a_sin;
    let mirrored_re = sums.a_cos - sums.b_sin;
    let mirrored_im = sums.b_cos + sums.a_sin;
    let beam_0 = beams[4u * quad];
    let beam_1 = beams[4u * quad + 1u];
    let beam_2 = beams[4u * quad + 2u];
    let beam_3 = beams[4u * quad + 3u];
    store(row, beam_0.x, bin, vec2<f32>(re.x, im.x));
    store(row, beam_1.x, bin, vec2<f32>(re.y, im.y));
    store(row, beam_2.x, bin, vec2<f32>(re.z, im.z));
    store(row, beam_3.x, bin, vec2<f32>(re.w, im.w));
    store(row, beam_0.y, bin, vec2<f32>(mirrored_re.x, mirrored_im.x));
    store(row, beam_1.y, bin, vec2<f32>(mirrored_re.y, mirrored_im.y));
    store(row, beam_2.y, bin, vec2<f32>(mirrored_re.z, mirrored_im.z));
    store(row, beam_3.y, bin, vec2<f32>(mirrored_re.w, mirrored_im.w));
}

@compute @workgroup_size(64)
fn delay_and_sum(@builtin(global_invocation_id) id: vec3<u32>) {
    let bin = id.x;
    if (bin >= params.bin_count) {
        return;
    }
    let quad = params.quad_first + id.y;
    let frequency = f32(params.first_bin + bin);
    let channel_bins = params.channel_stride * params.bin_count;
    var a = Sums();
    var b = Sums();
    var c = Sums();
    for (var channel = 0u; channel < CHANNELS; channel++) {
        let angle = cos_sin_4(frequency * turns[quad * params.channel_stride + channel]);
        let at = channel * params.bin_count + bin;
        let value_a = spectra[SENSOR_A * channel_bins + at];
        a.a_cos += value_a.x * angle.cosine;
        a.b_sin += value_a.y * angle.sine;
        a.b_cos += value_a.y * angle.cosine;
        a.a_sin += value_a.x * angle.sine;
        if (SENSORS > 1u) {
            let value_b = spectra[SENSOR_B * channel_bins + at];
            b.a_cos += value_b.x * angle.cosine;
            b.b_sin += value_b.y * angle.sine;
            b.b_cos += value_b.y * angle.cosine;
            b.a_sin += value_b.x * angle.sine;
        }
        if (SENSORS > 2u) {
            let value_c = spectra[SENSOR_C * channel_bins + at];
            c.a_cos += value_c.x * angle.cosine;
            c.b_sin += value_c.y * angle.sine;
            c.b_cos += value_c.y * angle.cosine;
            c.a_sin += value_c.x * angle.sine;
        }
    }
    store_beams(SENSOR_A, 0u, quad, bin, a);
    if (SENSORS > 1u) {
        store_beams(SENSOR_B, 1u, quad, bin, b);
    }
    if (SENSORS > 2u) {
        store_beams(SENSOR_C, 2u, quad, bin, c);
    }
}
