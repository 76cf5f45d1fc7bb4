// The uniform block of every stage: sizes, strides and offsets of the plan, and what changes with every ping set.
//
// Twin: `src/imaging/gpu/params.rs`, field by field (held together by tests/shader_layout.rs). All words are u32 (one f32), so
// that WGSL, Rust and every backend agree on the layout without padding. Written once at open, the last four words a ping set.

struct Params {
    // Sensors of the configuration.
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
    direction_count: u32,
    range_count: u32,
    // Rows of the mask table.
    row_count: u32,
    // 1 with PHAT.
    phat: u32,
    // Taps of the smoothing filter; 0 without.
    smoothing_count: u32,
    // First word of the sums in the result.
    sums_offset: u32,
    // First word of the nonce in the result.
    nonce_offset: u32,
    // Bit s is set where sensor s delivered.
    present: u32,
    // Sequence of the ping set, low and high word, and the epoch of this device.
    nonce_low: u32,
    nonce_high: u32,
    nonce_epoch: u32,
}

@group(0) @binding(0) var<uniform> params: Params;

fn is_present(sensor: u32) -> bool {
    return ((params.present >> sensor) & 1u) == 1u;
}
