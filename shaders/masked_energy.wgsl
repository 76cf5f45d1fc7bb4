// Energyscapes to the sums of the mask table's rows (specification, section 5; semantics: RowSums in src/signal/mask.rs). Twin:
// src/imaging/cpu/masked_energy.rs.
//
// One workgroup sums one row, in two phases: the sums and the peak, then the nearest cell of at least half the peak. E is the
// gained envelope, zero below the floor; a value that is not finite (tested by bits: WGSL may assume that there is none) makes
// energy and peak infinite and takes no part in sums that have a side. Energies and distances are never negative, so their bits
// compare as they do. The last workgroup writes the nonce that proves that this submission ran.
//
// Bindings: 1 result: energyscapes, then the sums, then the nonce, 2 entries (cell, range index and side, distance), 3 rows
// (sensor, first, count), 4 per sensor and range: gain, floor, 1 / r^2, sqrt(r).
// Workgroups of 128: flow lines have a hundred cells, regions thousands; the tree of additions has seven steps.

const GROUP: u32 = 128u;
const NO_CELL: u32 = 0xffffffffu;
const INFINITY_BITS: u32 = 0x7f800000u;
const RIGHT_BIT: u32 = 0x80000000u;

@group(0) @binding(1) var<storage, read_write> result: array<u32>;
@group(0) @binding(2) var<storage, read> entries: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> rows: array<vec4<u32>>;
@group(0) @binding(4) var<storage, read> ranges: array<vec4<f32>>;

// Energy, turn, flow; number of cells above zero.
var<workgroup> sums: array<vec4<f32>, GROUP>;
// Largest energy (bits) and its entry.
var<workgroup> peaks: array<vec2<u32>, GROUP>;
// Smallest distance (bits) and its entry.
var<workgroup> nearests: array<vec2<u32>, GROUP>;

fn is_finite(bits: u32) -> bool {
    return (bits & INFINITY_BITS) != INFINITY_BITS;
}

// Bits of E of an entry; infinity where it is not finite.
fn energy_bits(sensor: u32, entry: vec4<u32>) -> u32 {
    let range = ranges[sensor * params.range_count + (entry.y & ~RIGHT_BIT)];
    let offset = sensor * params.direction_count * params.range_count;
    let product = bitcast<f32>(result[offset + entry.x]) * range.x;
    let bits = bitcast<u32>(product);
    if (!is_finite(bits)) {
        return INFINITY_BITS;
    }
    return select(bits, 0u, product < range.y || product <= 0.0);
}

// The larger energy, the lower entry of equals.
fn larger(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    let takes_b = b.x > a.x || (b.x == a.x && b.y < a.y);
    return select(a, b, takes_b);
}

// The smaller distance, the lower entry of equals; NO_CELL never wins.
fn nearer(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    let takes_b = b.y != NO_CELL && (a.y == NO_CELL || b.x < a.x || (b.x == a.x && b.y < a.y));
    return select(a, b, takes_b);
}

@compute @workgroup_size(128)
fn masked_energy(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let row_index = group.x;
    // A table without rows still has its nonce written, by one workgroup that sums nothing.
    var row = vec4<u32>(0u);
    if (row_index < params.row_count) {
        row = rows[row_index];
    }
    if (!is_present(row.x)) {
        row.z = 0u;
    }
    var sum = vec4<f32>(0.0);
    var peak = vec2<u32>(0u, NO_CELL);
    for (var index = lane; index < row.z; index += GROUP) {
        let entry = entries[row.y + index];
        let bits = energy_bits(row.x, entry);
        if (bits != 0u) {
            let energy = bitcast<f32>(select(bits, 0u, bits == INFINITY_BITS));
            let range = ranges[row.x * params.range_count + (entry.y & ~RIGHT_BIT)];
            let turn = select(energy * range.z, -energy * range.z, (entry.y & RIGHT_BIT) != 0u);
            sum += vec4<f32>(energy, turn, energy * range.w, 1.0);
            peak = larger(peak, vec2<u32>(bits, index));
        }
    }
    sums[lane] = sum;
    peaks[lane] = peak;
    for (var step = GROUP / 2u; step > 0u; step /= 2u) {
        workgroupBarrier();
        if (lane < step) {
            sums[lane] += sums[lane + step];
            peaks[lane] = larger(peaks[lane], peaks[lane + step]);
        }
    }
    workgroupBarrier();
    let largest = peaks[0];
    let half_peak = 0.5 * bitcast<f32>(select(largest.x, 0u, largest.x == INFINITY_BITS));
    let half_bits = select(bitcast<u32>(half_peak), INFINITY_BITS, largest.x == INFINITY_BITS);

    var nearest = vec2<u32>(INFINITY_BITS, NO_CELL);
    if (largest.x != 0u) {
        for (var index = lane; index < row.z; index += GROUP) {
            let entry = entries[row.y + index];
            let bits = energy_bits(row.x, entry);
            if (bits >= half_bits) {
                nearest = nearer(nearest, vec2<u32>(entry.z, index));
            }
        }
    }
    nearests[lane] = nearest;
    for (var step = GROUP / 2u; step > 0u; step /= 2u) {
        workgroupBarrier();
        if (lane < step) {
            nearests[lane] = nearer(nearests[lane], nearests[lane + step]);
        }
    }
    workgroupBarrier();
    if (lane == 0u && row_index < params.row_count) {
        let total = sums[0];
        let at = params.sums_offset + 8u * row_index;
        result[at] = select(bitcast<u32>(total.x), INFINITY_BITS, largest.x == INFINITY_BITS);
        result[at + 1u] = bitcast<u32>(total.y);
        result[at + 2u] = bitcast<u32>(total.z);
        result[at + 3u] = largest.x;
        result[at + 4u] = nearests[0].x;
        result[at + 5u] = largest.y;
        result[at + 6u] = nearests[0].y;
        result[at + 7u] = u32(total.w);
    }
    if (lane == 0u && row_index + 1u >= params.row_count) {
        result[params.nonce_offset] = params.nonce_low;
        result[params.nonce_offset + 1u] = params.nonce_high;
        result[params.nonce_offset + 2u] = params.nonce_epoch;
        result[params.nonce_offset + 3u] = params.present;
    }
}
