// Energyscapes to the sums of the mask table's rows (specification, section 5; semantics: RowSums in src/signal/mask.rs). Twin:
// src/imaging/cpu/masked_energy.rs.
//
// One workgroup sums one row, in two phases: the sums and the peak, then the nearest cell of at least half the peak. E is the
// gained envelope, zero below the floor; a value that is not finite (tested by bits: WGSL may assume that there is none) makes
// energy and peak infinite and takes no part in sums that have a side. Energies and distances are never negative, so their bits
// compare as they do. The last workgroup writes the nonce that proves that this submission ran.
//
// Bindings: 1 energyscapes of the bank, 2 entries (cell and side, distance), 3 rows (sensor, first, count), 4 per sensor and range:
// gain, floor, 1 / r^2, sqrt(r), 5 sums, then the nonce.
// Workgroups of 128: flow lines have a hundred cells, regions thousands. Lanes are added up in two steps of 8 and 16, with two
// barriers: a tree of halves would have seven.

const GROUP: u32 = 128u;
// Lanes that remain after the first step of a sum.
const LEFT: u32 = 16u;
const NO_CELL: u32 = 0xffffffffu;
const INFINITY_BITS: u32 = 0x7f800000u;
const RIGHT_BIT: u32 = 0x80000000u;

// Bits, not numbers: see above.
@group(0) @binding(1) var<storage, read> energies: array<u32>;
@group(0) @binding(2) var<storage, read> entries: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> rows: array<vec4<u32>>;
@group(0) @binding(4) var<storage, read> ranges: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> result: array<u32>;

// Energy, turn, flow; number of cells above zero.
var<workgroup> sums: array<vec4<f32>, GROUP>;
// Largest energy (bits) and its entry.
var<workgroup> peaks: array<vec2<u32>, GROUP>;
// Smallest distance (bits) and its entry.
var<workgroup> nearests: array<vec2<u32>, GROUP>;

fn is_finite(bits: u32) -> bool {
    return (bits & INFINITY_BITS) != INFINITY_BITS;
}

// Gain, floor, 1 / r^2, sqrt(r) of a cell.
fn range_of(sensor: u32, cell: u32) -> vec4<f32> {
    return ranges[sensor * params.range_count + cell % params.range_count];
}

// Bits of E of a cell; infinity where it is not finite.
fn energy_bits(first_cell: u32, cell: u32, range: vec4<f32>) -> u32 {
    let product = bitcast<f32>(energies[first_cell + cell]) * range.x;
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
    // Wraps to a large number below the bank's first sensor.
    let sensor = row.x - params.sensor_first;
    let is_ours = sensor < params.sensor_count && row_index < params.row_count;
    if (!is_ours || !is_present(sensor)) {
        row.z = 0u;
    }
    let first_cell = sensor * params.cell_stride;
    var sum = vec4<f32>(0.0);
    var peak = vec2<u32>(0u, NO_CELL);
    for (var index = lane; index < row.z; index += GROUP) {
        let entry = entries[row.y + index];
        let cell = entry.x & ~RIGHT_BIT;
        let range = range_of(row.x, cell);
        let bits = energy_bits(first_cell, cell, range);
        if (bits != 0u) {
            let energy = bitcast<f32>(select(bits, 0u, bits == INFINITY_BITS));
            let turn = select(energy * range.z, -energy * range.z, (entry.x & RIGHT_BIT) != 0u);
            sum += vec4<f32>(energy, turn, energy * range.w, 1.0);
            peak = larger(peak, vec2<u32>(bits, index));
        }
    }
    sums[lane] = sum;
    peaks[lane] = peak;
    workgroupBarrier();
    if (lane < LEFT) {
        for (var other = lane + LEFT; other < GROUP; other += LEFT) {
            sum += sums[other];
            peak = larger(peak, peaks[other]);
        }
        sums[lane] = sum;
        peaks[lane] = peak;
    }
    workgroupBarrier();
    var largest = peaks[0];
    for (var other = 1u; other < LEFT; other++) {
        largest = larger(largest, peaks[other]);
    }
    let half_peak = 0.5 * bitcast<f32>(select(largest.x, 0u, largest.x == INFINITY_BITS));
    let half_bits = select(bitcast<u32>(half_peak), INFINITY_BITS, largest.x == INFINITY_BITS);

    var nearest = vec2<u32>(INFINITY_BITS, NO_CELL);
    if (largest.x != 0u) {
        for (var index = lane; index < row.z; index += GROUP) {
            let entry = entries[row.y + index];
            let cell = entry.x & ~RIGHT_BIT;
            if (energy_bits(first_cell, cell, range_of(row.x, cell)) >= half_bits) {
                nearest = nearer(nearest, vec2<u32>(entry.y, index));
            }
        }
    }
    nearests[lane] = nearest;
    workgroupBarrier();
    if (lane < LEFT) {
        for (var other = lane + LEFT; other < GROUP; other += LEFT) {
            nearest = nearer(nearest, nearests[other]);
        }
        nearests[lane] = nearest;
    }
    workgroupBarrier();
    if (lane == 0u && is_ours) {
        for (var other = 1u; other < LEFT; other++) {
            sum += sums[other];
            nearest = nearer(nearest, nearests[other]);
        }
        let at = 8u * row_index;
        result[at] = select(bitcast<u32>(sum.x), INFINITY_BITS, largest.x == INFINITY_BITS);
        result[at + 1u] = bitcast<u32>(sum.y);
        result[at + 2u] = bitcast<u32>(sum.z);
        result[at + 3u] = largest.x;
        result[at + 4u] = nearest.x;
        result[at + 5u] = largest.y;
        result[at + 6u] = nearest.y;
        result[at + 7u] = u32(sum.w);
    }
    if (lane == 0u && row_index + 1u >= params.row_count) {
        let at = 8u * params.row_count;
        result[at] = params.nonce_low;
        result[at + 1u] = params.nonce_high;
        result[at + 2u] = params.nonce_epoch;
        result[at + 3u] = params.present;
    }
}
