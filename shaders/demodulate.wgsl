// Raw samples to PCM, f32, full scale 1 (specification, section 2). Twin: src/imaging/cpu/demodulate.rs.
//
// PDM: `transpose_words` turns 32 words (one bit a microphone) into 32 bit streams; one invocation does 32 words in registers, so
// that `demodulate_pdm` gets 32 samples of one microphone with one load. There one invocation computes 4 consecutive samples of one
// channel: for every 8 bits it looks up the sums of their taps for all 4 at once (a table of 256 vec4 for each 8 bits of the
// window), in fixed point, so that the sum is exact on every device. PCM: one invocation converts 4 consecutive samples.
//
// PCM leaves in phase rows, [sensor][channel][n mod D][n / D]: the band filter then reads whole vectors whatever D is.
// The rows go on beyond both ends as the circle of N samples does (`store_sample`), so that the filter never wraps.
//
// Bindings: 1 raw words, 2 bit streams [sensor][channel][block], 3 table of bit sums, 4 what the words beyond the ends would
// have added, 5 PCM.
// Workgroups of 64 along samples: lanes read neighbouring words, and no thread waits for another.

// D.
override PHASES: u32 = 8u;

@group(0) @binding(1) var<storage, read> raw: array<u32>;
@group(0) @binding(2) var<storage, read_write> bit_streams: array<u32>;
@group(0) @binding(3) var<storage, read> bit_sums: array<vec4<i32>>;
@group(0) @binding(4) var<storage, read> corrections: array<vec4<i32>>;
@group(0) @binding(5) var<storage, read_write> pcm: array<f32>;

var<private> words: array<u32, 32>;

fn take(index: u32, sensor: u32, block: u32) {
    let lead = 32u * params.bit_lead_blocks;
    let at = 32u * block + index;
    // Words outside the ping count as no bit; `corrections` takes them out of the sum.
    words[index] = 0u;
    if (at >= lead && at < lead + params.raw_count) {
        words[index] = raw[sensor * params.raw_stride + at - lead];
    }
}

fn give(index: u32, sensor: u32, block: u32) {
    if (index < params.channel_stride) {
        bit_streams[(sensor * params.channel_stride + index) * params.bit_block_count + block] = words[index];
    }
}

// Exchanges the bits `apart` above the mask in word k with those under the mask in word k + apart.
fn exchange(k: u32, apart: u32, mask: u32) {
    let moved = ((words[k] >> apart) ^ words[k + apart]) & mask;
    words[k + apart] = words[k + apart] ^ moved;
    words[k] = words[k] ^ (moved << apart);
}

@compute @workgroup_size(64)
fn transpose_words(@builtin(global_invocation_id) id: vec3<u32>) {
    let block = id.x;
    let sensor = id.y;
    if (block >= params.bit_block_count || !is_present(sensor)) {
        return;
    }
    take(0u, sensor, block); take(1u, sensor, block); take(2u, sensor, block); take(3u, sensor, block);
    take(4u, sensor, block); take(5u, sensor, block); take(6u, sensor, block); take(7u, sensor, block);
    take(8u, sensor, block); take(9u, sensor, block); take(10u, sensor, block); take(11u, sensor, block);
    take(12u, sensor, block); take(13u, sensor, block); take(14u, sensor, block); take(15u, sensor, block);
    take(16u, sensor, block); take(17u, sensor, block); take(18u, sensor, block); take(19u, sensor, block);
    take(20u, sensor, block); take(21u, sensor, block); take(22u, sensor, block); take(23u, sensor, block);
    take(24u, sensor, block); take(25u, sensor, block); take(26u, sensor, block); take(27u, sensor, block);
    take(28u, sensor, block); take(29u, sensor, block); take(30u, sensor, block); take(31u, sensor, block);
    exchange(0u, 16u, 0x0000ffffu); exchange(1u, 16u, 0x0000ffffu); exchange(2u, 16u, 0x0000ffffu); exchange(3u, 16u, 0x0000ffffu);
    exchange(4u, 16u, 0x0000ffffu); exchange(5u, 16u, 0x0000ffffu); exchange(6u, 16u, 0x0000ffffu); exchange(7u, 16u, 0x0000ffffu);
    exchange(8u, 16u, 0x0000ffffu); exchange(9u, 16u, 0x0000ffffu); exchange(10u, 16u, 0x0000ffffu); exchange(11u, 16u, 0x0000ffffu);
    exchange(12u, 16u, 0x0000ffffu); exchange(13u, 16u, 0x0000ffffu); exchange(14u, 16u, 0x0000ffffu); exchange(15u, 16u, 0x0000ffffu);
    exchange(0u, 8u, 0x00ff00ffu); exchange(1u, 8u, 0x00ff00ffu); exchange(2u, 8u, 0x00ff00ffu); exchange(3u, 8u, 0x00ff00ffu);
    exchange(4u, 8u, 0x00ff00ffu); exchange(5u, 8u, 0x00ff00ffu); exchange(6u, 8u, 0x00ff00ffu); exchange(7u, 8u, 0x00ff00ffu);
    exchange(16u, 8u, 0x00ff00ffu); exchange(17u, 8u, 0x00ff00ffu); exchange(18u, 8u, 0x00ff00ffu); exchange(19u, 8u, 0x00ff00ffu);
    exchange(20u, 8u, 0x00ff00ffu); exchange(21u, 8u, 0x00ff00ffu); exchange(22u, 8u, 0x00ff00ffu); exchange(23u, 8u, 0x00ff00ffu);
    exchange(0u, 4u, 0x0f0f0f0fu); exchange(1u, 4u, 0x0f0f0f0fu); exchange(2u, 4u, 0x0f0f0f0fu); exchange(3u, 4u, 0x0f0f0f0fu);
    exchange(8u, 4u, 0x0f0f0f0fu); exchange(9u, 4u, 0x0f0f0f0fu); exchange(10u, 4u, 0x0f0f0f0fu); exchange(11u, 4u, 0x0f0f0f0fu);
    exchange(16u, 4u, 0x0f0f0f0fu); exchange(17u, 4u, 0x0f0f0f0fu); exchange(18u, 4u, 0x0f0f0f0fu); exchange(19u, 4u, 0x0f0f0f0fu);
    exchange(24u, 4u, 0x0f0f0f0fu); exchange(25u, 4u, 0x0f0f0f0fu); exchange(26u, 4u, 0x0f0f0f0fu); exchange(27u, 4u, 0x0f0f0f0fu);
    exchange(0u, 2u, 0x33333333u); exchange(1u, 2u, 0x33333333u); exchange(4u, 2u, 0x33333333u); exchange(5u, 2u, 0x33333333u);
    exchange(8u, 2u, 0x33333333u); exchange(9u, 2u, 0x33333333u); exchange(12u, 2u, 0x33333333u); exchange(13u, 2u, 0x33333333u);
    exchange(16u, 2u, 0x33333333u); exchange(17u, 2u, 0x33333333u); exchange(20u, 2u, 0x33333333u); exchange(21u, 2u, 0x33333333u);
    exchange(24u, 2u, 0x33333333u); exchange(25u, 2u, 0x33333333u); exchange(28u, 2u, 0x33333333u); exchange(29u, 2u, 0x33333333u);
    exchange(0u, 1u, 0x55555555u); exchange(2u, 1u, 0x55555555u); exchange(4u, 1u, 0x55555555u); exchange(6u, 1u, 0x55555555u);
    exchange(8u, 1u, 0x55555555u); exchange(10u, 1u, 0x55555555u); exchange(12u, 1u, 0x55555555u); exchange(14u, 1u, 0x55555555u);
    exchange(16u, 1u, 0x55555555u); exchange(18u, 1u, 0x55555555u); exchange(20u, 1u, 0x55555555u); exchange(22u, 1u, 0x55555555u);
    exchange(24u, 1u, 0x55555555u); exchange(26u, 1u, 0x55555555u); exchange(28u, 1u, 0x55555555u); exchange(30u, 1u, 0x55555555u);
    give(0u, sensor, block); give(1u, sensor, block); give(2u, sensor, block); give(3u, sensor, block);
    give(4u, sensor, block); give(5u, sensor, block); give(6u, sensor, block); give(7u, sensor, block);
    give(8u, sensor, block); give(9u, sensor, block); give(10u, sensor, block); give(11u, sensor, block);
    give(12u, sensor, block); give(13u, sensor, block); give(14u, sensor, block); give(15u, sensor, block);
    give(16u, sensor, block); give(17u, sensor, block); give(18u, sensor, block); give(19u, sensor, block);
    give(20u, sensor, block); give(21u, sensor, block); give(22u, sensor, block); give(23u, sensor, block);
    give(24u, sensor, block); give(25u, sensor, block); give(26u, sensor, block); give(27u, sensor, block);
    give(28u, sensor, block); give(29u, sensor, block); give(30u, sensor, block); give(31u, sensor, block);
}

// Writes sample n of a row, and again in the margins where the circle of N samples passes it.
fn store_sample(row: u32, n: u32, value: f32) {
    if (n >= params.sample_count) {
        return;
    }
    let q = n / PHASES;
    let at = (row * PHASES + n % PHASES) * params.phase_stride + params.phase_lead + q;
    pcm[at] = value;
    if (q + params.phase_lead >= params.forward_len) {
        pcm[at - params.forward_len] = value;
    }
    if (q + params.phase_lead + params.forward_len < params.phase_stride) {
        pcm[at + params.forward_len] = value;
    }
}

@compute @workgroup_size(64)
fn demodulate_pdm(@builtin(global_invocation_id) id: vec3<u32>) {
    let quad = id.x;
    let sensor = id.z;
    if (4u * quad >= params.sample_count || !is_present(sensor)) {
        return;
    }
    let row = sensor * params.channel_stride + id.y;
    let bit = params.bit_start + 4u * quad * params.decimation;
    let shift = bit & 31u;
    var block = row * params.bit_block_count + (bit >> 5u);
    var sum = corrections[quad];
    var low = bit_streams[block];
    for (var step = 0u; step < params.bit_step_count; step++) {
        block += 1u;
        let high = bit_streams[block];
        // Two shifts, since a shift by 32 is no shift in WGSL.
        let window = (low >> shift) | ((high << (31u - shift)) << 1u);
        let table = 1024u * step;
        sum += bit_sums[table + (window & 255u)];
        sum += bit_sums[table + 256u + ((window >> 8u) & 255u)];
        sum += bit_sums[table + 512u + ((window >> 16u) & 255u)];
        sum += bit_sums[table + 768u + (window >> 24u)];
        low = high;
    }
    let samples = vec4<f32>(sum) * params.demodulation_scale;
    store_sample(row, 4u * quad, samples.x);
    store_sample(row, 4u * quad + 1u, samples.y);
    store_sample(row, 4u * quad + 2u, samples.z);
    store_sample(row, 4u * quad + 3u, samples.w);
}

// Value `index` of a sensor's 16-bit samples, two to a word.
fn sample_i16(sensor: u32, index: u32) -> f32 {
    let word = bitcast<i32>(raw[sensor * params.raw_stride + index / 2u]);
    let value = select(word << 16u, word, (index & 1u) == 1u) >> 16u;
    return f32(value) / 32768.0;
}

@compute @workgroup_size(64)
fn demodulate_i16(@builtin(global_invocation_id) id: vec3<u32>) {
    let n = 4u * id.x;
    let sensor = id.z;
    if (n >= params.sample_count || !is_present(sensor)) {
        return;
    }
    let row = sensor * params.channel_stride + id.y;
    let first = id.y * params.raw_count + n;
    store_sample(row, n, sample_i16(sensor, first));
    store_sample(row, n + 1u, sample_i16(sensor, first + 1u));
    store_sample(row, n + 2u, sample_i16(sensor, first + 2u));
    store_sample(row, n + 3u, sample_i16(sensor, first + 3u));
}

@compute @workgroup_size(64)
fn demodulate_f32(@builtin(global_invocation_id) id: vec3<u32>) {
    let n = 4u * id.x;
    let sensor = id.z;
    if (n >= params.sample_count || !is_present(sensor)) {
        return;
    }
    let row = sensor * params.channel_stride + id.y;
    let first = sensor * params.raw_stride + id.y * params.raw_count + n;
    store_sample(row, n, bitcast<f32>(raw[first]));
    store_sample(row, n + 1u, bitcast<f32>(raw[first + 1u]));
    store_sample(row, n + 2u, bitcast<f32>(raw[first + 2u]));
    store_sample(row, n + 3u, bitcast<f32>(raw[first + 3u]));
}
