// The uniform block of every stage: sizes, strides and offsets of the plan, of a bank (the sensors that are imaged together: all, or
// one at a time where a buffer would grow too large) and of a tile (the directions whose spectra stand in memory together: all, or
// a part), and what changes with every ping set. A dispatch is given the block of its bank and tile.
//
// Twin: `src/imaging/gpu/params.rs`, field by field (held together by tests/shader_layout.rs). All words are u32 or f32, so
// that WGSL, Rust and every backend agree on the layout without padding. Written once at open, the last four words a ping set.

struct Params {
    // Sensors of the bank.
    sensor_count: u32,
    // Rows that every sensor has in per-channel buffers: the most channels of any sensor.
    channel_stride: u32,
    // 32-bit words that every sensor has in the raw buffer.
    raw_stride: u32,
    // PDM words, or PCM samples of one channel, in a ping.
    raw_count: u32,
    // Demodulated samples of one channel, Ns.
    sample_count: u32,
    // PDM words per demodulated sample.
    decimation: u32,
    // 32-bit blocks of the bit stream of one channel, zeros before and after included.
    bit_block_count: u32,
    // Blocks of zeros before word 0.
    bit_lead_blocks: u32,
    // First bit of the stream that the thread of output 0 reads.
    bit_start: u32,
    // 32-bit blocks that one thread of the PDM filter reads.
    bit_step_count: u32,
    // What the integer sums of the PDM filter are multiplied with.
    demodulation_scale: f32,
    // Samples in one phase row of the demodulated signal, both margins included; a multiple of 4.
    phase_stride: u32,
    // Samples of a phase row before its sample 0: the left margin, a multiple of 4.
    phase_lead: u32,
    // Groups of four taps in one phase of the band filter.
    tap_step_count: u32,
    // N1.
    forward_len: u32,
    // First bin of the band.
    first_bin: u32,
    // K.
    bin_count: u32,
    // M.
    inverse_len: u32,
    range_count: u32,
    // Rows of the mask table.
    row_count: u32,
    // 1 with PHAT.
    phat: u32,
    // Taps of the smoothing filter; 0 without.
    smoothing_count: u32,
    // Cells from one sensor's energyscape to the next.
    cell_stride: u32,
    // First sensor of the bank.
    sensor_first: u32,
    // Rows of the tile, one a direction of one sensor, and the first of them in the table of targets.
    tile_row_count: u32,
    tile_target_first: u32,
    // What delay-and-sum does for the tile: first quad of beams, first slot of these, the row of that slot for the first of the
    // sensors that share the steering, and rows from one of these sensors to the next.
    quad_first: u32,
    slot_first: u32,
    row_base: u32,
    row_step: u32,
    // Focus: ranges that are focused, place of the first bin in the transform of a channel signal, samples before range
    // 0 and of all of a row; directions of the grid; then samples, and turns of the centre frequency, a metre of path.
    focus_count: u32,
    focus_first_bin: u32,
    focus_lead: u32,
    focus_row_len: u32,
    direction_count: u32,
    // Gains of all channels, behind which the scales of the sensors stand.
    gain_count: u32,
    focus_samples_per_m: f32,
    focus_turns_per_m: f32,
    // Bit s is set where sensor s delivered.
    present: u32,
    // Sequence of the ping set, low and high word, and the epoch of this device.
    nonce_low: u32,
    nonce_high: u32,
    nonce_epoch: u32,
}

@group(0) @binding(0) var<uniform> params: Params;

// Whether a sensor of the bank delivered.
fn is_present(sensor: u32) -> bool {
    return ((params.present >> (params.sensor_first + sensor)) & 1u) == 1u;
}
