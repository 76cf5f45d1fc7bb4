// Band spectra of the directions to the energyscape (plan, step 5). Twin: src/imaging/cpu/envelope.rs.
//
// `inverse_first` folds the K bins into M places and does the first pass of the inverse transform, `inverse_pass` a pass between,
// `inverse_last` the last one with the magnitude, the crop to the published ranges and zeros for hidden directions. With smoothing
// `inverse_last_whole` keeps all M magnitudes instead and `smooth_rows` filters them along their circle. One invocation computes one
// butterfly (see common/fft.wgsl; real and imaginary parts are exchanged at the first load, which makes the transform the inverse
// one and leaves the magnitude as it is) or one cell of `smooth_rows`.
//
// Bindings: 1 source, 2 output, complex [row][bin or n], 3 targets [row], 4 energyscapes [direction][range], 5 magnitudes [row][n],
// 6 smoothing taps. A row is a direction of one sensor, as delay-and-sum left it; its target says where its energies go.
// Workgroups: 16 butterflies by 8 rows, since a row has few butterflies and lanes along a row read neighbours; `smooth_rows` 64 along
// a row.

@group(0) @binding(1) var<storage, read> source: array<vec2<f32>>;
@group(0) @binding(2) var<storage, read_write> output: array<vec2<f32>>;
// First cell of the row in the energyscapes; sensor of the bank, and HIDDEN_BIT for a hidden direction.
@group(0) @binding(3) var<storage, read> targets: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read_write> energies: array<f32>;
@group(0) @binding(5) var<storage, read_write> magnitudes: array<f32>;
@group(0) @binding(6) var<storage, read> smoothing: array<f32>;

const HIDDEN_BIT: u32 = 0x80000000u;

fn target_of(row: u32) -> vec2<u32> {
    return targets[params.tile_target_first + row];
}

// Whether something is to be computed for this row.
fn is_row(row: u32) -> bool {
    return row < params.tile_row_count && is_present(target_of(row).y & ~HIDDEN_BIT);
}

// Whether butterfly q of a row is to be computed.
fn is_wanted(row: u32, q: u32) -> bool {
    return q < butterfly_count() && is_row(row);
}

// Sum of the bins that fall into place n of M, exchanged for the inverse transform.
fn folded(row: u32, n: u32) -> vec2<f32> {
    var bin = (n + LEN - params.first_bin % LEN) % LEN;
    var sum = vec2<f32>(0.0);
    while (bin < params.bin_count) {
        sum += source[row * params.bin_count + bin];
        bin += LEN;
    }
    return sum.yx;
}

fn fetch_folded(row: u32, q: u32, r: u32) {
    if (r < radix()) {
        values[r] = folded(row, q + r * butterfly_count());
    }
}

fn magnitude(value: vec2<f32>) -> f32 {
    return sqrt(value.x * value.x + value.y * value.y);
}

fn keep_energy(place: vec2<u32>, q: u32, k: u32) {
    if (k < radix()) {
        let n = output_place(q, k);
        if (n < params.range_count) {
            energies[place.x + n] = select(magnitude(transformed(k)), 0.0, (place.y & HIDDEN_BIT) != 0u);
        }
    }
}

fn keep_magnitude(row: u32, q: u32, k: u32) {
    if (k < radix()) {
        magnitudes[row * LEN + output_place(q, k)] = magnitude(transformed(k));
    }
}

@compute @workgroup_size(16, 8)
fn inverse_first(@builtin(global_invocation_id) id: vec3<u32>) {
    let q = id.x;
    let row = id.y;
    if (!is_wanted(row, q)) {
        return;
    }
    fetch_folded(row, q, 0u); fetch_folded(row, q, 1u); fetch_folded(row, q, 2u); fetch_folded(row, q, 3u);
    fetch_folded(row, q, 4u); fetch_folded(row, q, 5u); fetch_folded(row, q, 6u); fetch_folded(row, q, 7u);
    fetch_folded(row, q, 8u); fetch_folded(row, q, 9u); fetch_folded(row, q, 10u); fetch_folded(row, q, 11u);
    fetch_folded(row, q, 12u); fetch_folded(row, q, 13u); fetch_folded(row, q, 14u); fetch_folded(row, q, 15u);
    fetch_folded(row, q, 16u); fetch_folded(row, q, 17u); fetch_folded(row, q, 18u); fetch_folded(row, q, 19u);
    fetch_folded(row, q, 20u); fetch_folded(row, q, 21u); fetch_folded(row, q, 22u); fetch_folded(row, q, 23u);
    fetch_folded(row, q, 24u); fetch_folded(row, q, 25u); fetch_folded(row, q, 26u); fetch_folded(row, q, 27u);
    transform_values();
    keep_all(row, q);
}

@compute @workgroup_size(16, 8)
fn inverse_pass(@builtin(global_invocation_id) id: vec3<u32>) {
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
fn inverse_last(@builtin(global_invocation_id) id: vec3<u32>) {
    let q = id.x;
    let row = id.y;
    if (!is_wanted(row, q)) {
        return;
    }
    fetch_all(row, q);
    transform_values();
    let place = target_of(row);
    keep_energy(place, q, 0u); keep_energy(place, q, 1u); keep_energy(place, q, 2u); keep_energy(place, q, 3u);
    keep_energy(place, q, 4u); keep_energy(place, q, 5u); keep_energy(place, q, 6u); keep_energy(place, q, 7u);
    keep_energy(place, q, 8u); keep_energy(place, q, 9u); keep_energy(place, q, 10u); keep_energy(place, q, 11u);
    keep_energy(place, q, 12u); keep_energy(place, q, 13u); keep_energy(place, q, 14u); keep_energy(place, q, 15u);
    keep_energy(place, q, 16u); keep_energy(place, q, 17u); keep_energy(place, q, 18u); keep_energy(place, q, 19u);
    keep_energy(place, q, 20u); keep_energy(place, q, 21u); keep_energy(place, q, 22u); keep_energy(place, q, 23u);
    keep_energy(place, q, 24u); keep_energy(place, q, 25u); keep_energy(place, q, 26u); keep_energy(place, q, 27u);
}

@compute @workgroup_size(16, 8)
fn inverse_last_whole(@builtin(global_invocation_id) id: vec3<u32>) {
    let q = id.x;
    let row = id.y;
    if (!is_wanted(row, q)) {
        return;
    }
    fetch_all(row, q);
    transform_values();
    keep_magnitude(row, q, 0u); keep_magnitude(row, q, 1u); keep_magnitude(row, q, 2u); keep_magnitude(row, q, 3u);
    keep_magnitude(row, q, 4u); keep_magnitude(row, q, 5u); keep_magnitude(row, q, 6u); keep_magnitude(row, q, 7u);
    keep_magnitude(row, q, 8u); keep_magnitude(row, q, 9u); keep_magnitude(row, q, 10u); keep_magnitude(row, q, 11u);
    keep_magnitude(row, q, 12u); keep_magnitude(row, q, 13u); keep_magnitude(row, q, 14u); keep_magnitude(row, q, 15u);
    keep_magnitude(row, q, 16u); keep_magnitude(row, q, 17u); keep_magnitude(row, q, 18u); keep_magnitude(row, q, 19u);
    keep_magnitude(row, q, 20u); keep_magnitude(row, q, 21u); keep_magnitude(row, q, 22u); keep_magnitude(row, q, 23u);
    keep_magnitude(row, q, 24u); keep_magnitude(row, q, 25u); keep_magnitude(row, q, 26u); keep_magnitude(row, q, 27u);
}

@compute @workgroup_size(64)
fn smooth_rows(@builtin(global_invocation_id) id: vec3<u32>) {
    let n = id.x;
    let row = id.y;
    if (n >= params.range_count || !is_row(row)) {
        return;
    }
    let length = params.inverse_len;
    var at = (n + length - params.smoothing_count / 2u) % length;
    var sum = 0.0;
    for (var tap = 0u; tap < params.smoothing_count; tap++) {
        sum += smoothing[tap] * magnitudes[row * length + at];
        at = select(at + 1u, 0u, at + 1u == length);
    }
    let place = target_of(row);
    energies[place.x + n] = select(sum, 0.0, (place.y & HIDDEN_BIT) != 0u);
}
