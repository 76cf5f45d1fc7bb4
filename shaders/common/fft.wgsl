// One pass of a forward transform (exp(-j...)) of any length of factors 2, 3, 5 and 7: Stockham's autosort form, in which pass
// after pass goes through global memory, no thread waits for another and no reordering is needed. One thread computes one
// butterfly of RADIX = RADIX_ROWS * RADIX_COLUMNS values, held in registers; each pass is a pipeline of its own, specialised by
// the constants below. The inverse transform is the same with real and imaginary parts exchanged before and after.
//
// Thread q of LEN / RADIX reads inputs q + r LEN / RADIX, turns them by r (q mod SPAN) / (SPAN RADIX), transforms them and writes
// output (q / SPAN) SPAN RADIX + q mod SPAN + k SPAN. No loops and constant indices only: otherwise the values leave the registers.

override RADIX_ROWS: u32 = 4u;
override RADIX_COLUMNS: u32 = 4u;
// Length of the whole transform.
override LEN: u32 = 16u;
// Product of the radices of the passes before.
override SPAN: u32 = 1u;

const RADIX_MAX: u32 = 28u;

var<private> values: array<vec2<f32>, RADIX_MAX>;

fn radix() -> u32 {
    return RADIX_ROWS * RADIX_COLUMNS;
}

fn butterfly_count() -> u32 {
    return LEN / (RADIX_ROWS * RADIX_COLUMNS);
}

fn dft_2(first: u32, step: u32) {
    let a = values[first];
    let b = values[first + step];
    values[first] = a + b;
    values[first + step] = a - b;
}

fn dft_3(first: u32, step: u32) {
    let a = values[first];
    let sum = values[first + step] + values[first + 2u * step];
    let turned = minus_j(values[first + step] - values[first + 2u * step]) * 0.8660254037844386;
    let middle = a - 0.5 * sum;
    values[first] = a + sum;
    values[first + step] = middle + turned;
    values[first + 2u * step] = middle - turned;
}

fn dft_4(first: u32, step: u32) {
    let a = values[first] + values[first + 2u * step];
    let b = values[first] - values[first + 2u * step];
    let c = values[first + step] + values[first + 3u * step];
    let d = minus_j(values[first + step] - values[first + 3u * step]);
    values[first] = a + c;
    values[first + step] = b + d;
    values[first + 2u * step] = a - c;
    values[first + 3u * step] = b - d;
}

fn dft_5(first: u32, step: u32) {
    let a = values[first];
    let sum_1 = values[first + step] + values[first + 4u * step];
    let sum_2 = values[first + 2u * step] + values[first + 3u * step];
    let turned_1 = minus_j(values[first + step] - values[first + 4u * step]);
    let turned_2 = minus_j(values[first + 2u * step] - values[first + 3u * step]);
    let even_1 = a + 0.30901699437494745 * sum_1 - 0.8090169943749475 * sum_2;
    let even_2 = a - 0.8090169943749475 * sum_1 + 0.30901699437494745 * sum_2;
    let odd_1 = 0.9510565162951535 * turned_1 + 0.5877852522924731 * turned_2;
    let odd_2 = 0.5877852522924731 * turned_1 - 0.9510565162951535 * turned_2;
    values[first] = a + sum_1 + sum_2;
    values[first + step] = even_1 + odd_1;
    values[first + 2u * step] = even_2 + odd_2;
    values[first + 3u * step] = even_2 - odd_2;
    values[first + 4u * step] = even_1 - odd_1;
}

fn dft_7(first: u32, step: u32) {
    let a = values[first];
    let sum_1 = values[first + step] + values[first + 6u * step];
    let sum_2 = values[first + 2u * step] + values[first + 5u * step];
    let sum_3 = values[first + 3u * step] + values[first + 4u * step];
    let turned_1 = minus_j(values[first + step] - values[first + 6u * step]);
    let turned_2 = minus_j(values[first + 2u * step] - values[first + 5u * step]);
    let turned_3 = minus_j(values[first + 3u * step] - values[first + 4u * step]);
    let even_1 = a + 0.6234898018587336 * sum_1 - 0.2225209339563144 * sum_2 - 0.9009688679024191 * sum_3;
    let even_2 = a - 0.2225209339563144 * sum_1 - 0.9009688679024191 * sum_2 + 0.6234898018587336 * sum_3;
    let even_3 = a - 0.9009688679024191 * sum_1 + 0.6234898018587336 * sum_2 - 0.2225209339563144 * sum_3;
    let odd_1 = 0.7818314824680298 * turned_1 + 0.9749279121818236 * turned_2 + 0.4338837391175581 * turned_3;
    let odd_2 = 0.9749279121818236 * turned_1 - 0.4338837391175581 * turned_2 - 0.7818314824680298 * turned_3;
    let odd_3 = 0.4338837391175581 * turned_1 - 0.7818314824680298 * turned_2 + 0.9749279121818236 * turned_3;
    values[first] = a + sum_1 + sum_2 + sum_3;
    values[first + step] = even_1 + odd_1;
    values[first + 2u * step] = even_2 + odd_2;
    values[first + 3u * step] = even_3 + odd_3;
    values[first + 4u * step] = even_3 - odd_3;
    values[first + 5u * step] = even_2 - odd_2;
    values[first + 6u * step] = even_1 - odd_1;
}

// Transforms `size` values in place; a size of 1 is no work.
fn dft(size: u32, first: u32, step: u32) {
    if (size == 2u) {
        dft_2(first, step);
    } else if (size == 3u) {
        dft_3(first, step);
    } else if (size == 4u) {
        dft_4(first, step);
    } else if (size == 5u) {
        dft_5(first, step);
    } else if (size == 7u) {
        dft_7(first, step);
    }
}

fn dft_column(column: u32) {
    if (column < RADIX_COLUMNS) {
        dft(RADIX_ROWS, column, RADIX_COLUMNS);
    }
}

fn dft_row(row: u32) {
    if (row < RADIX_ROWS) {
        dft(RADIX_COLUMNS, row * RADIX_COLUMNS, 1u);
    }
}

// Turns value (row, column) by row * column / RADIX; the angle is a constant of the pipeline.
fn twist(row: u32, column: u32) {
    if (row < RADIX_ROWS && column < RADIX_COLUMNS) {
        let factor = cos_sin(f32(row * column) / f32(RADIX_ROWS * RADIX_COLUMNS));
        let at = row * RADIX_COLUMNS + column;
        values[at] = multiply(values[at], vec2<f32>(factor.x, -factor.y));
    }
}

fn twist_row(row: u32) {
    twist(row, 1u);
    twist(row, 2u);
    twist(row, 3u);
    twist(row, 4u);
    twist(row, 5u);
    twist(row, 6u);
}

// Transforms `values`: input n stands at n, output k at slot (k mod ROWS) * COLUMNS + k / ROWS.
fn transform_values() {
    dft_column(0u);
    dft_column(1u);
    dft_column(2u);
    dft_column(3u);
    dft_column(4u);
    dft_column(5u);
    dft_column(6u);
    if (RADIX_ROWS > 1u && RADIX_COLUMNS > 1u) {
        twist_row(1u);
        twist_row(2u);
        twist_row(3u);
        twist_row(4u);
        twist_row(5u);
        twist_row(6u);
    }
    dft_row(0u);
    dft_row(1u);
    dft_row(2u);
    dft_row(3u);
    dft_row(4u);
    dft_row(5u);
    dft_row(6u);
}

// Value of output k of `transform_values`.
fn transformed(k: u32) -> vec2<f32> {
    return values[(k % RADIX_ROWS) * RADIX_COLUMNS + k / RADIX_ROWS];
}

// Turns input r of butterfly q as the pass asks; nothing in the first pass.
fn turned(value: vec2<f32>, q: u32, r: u32) -> vec2<f32> {
    if (SPAN == 1u || r == 0u) {
        return value;
    }
    let cycle = SPAN * RADIX_ROWS * RADIX_COLUMNS;
    let position = r * (q % SPAN);
    // Halving the largest angle halves its rounding error.
    let centred = i32(position) - select(0, i32(cycle), 2u * position > cycle);
    let factor = cos_sin(f32(centred) / f32(cycle));
    return multiply(value, vec2<f32>(factor.x, -factor.y));
}

// Place of output k of butterfly q.
fn output_place(q: u32, k: u32) -> u32 {
    return (q / SPAN) * (SPAN * RADIX_ROWS * RADIX_COLUMNS) + q % SPAN + k * SPAN;
}

// A pass reads `source` and writes `output`, which the stage's own file binds.
fn fetch(row: u32, q: u32, r: u32) {
    if (r < radix()) {
        values[r] = turned(source[row * LEN + q + r * butterfly_count()], q, r);
    }
}

fn keep(row: u32, q: u32, k: u32) {
    if (k < radix()) {
        output[row * LEN + output_place(q, k)] = transformed(k);
    }
}

fn fetch_all(row: u32, q: u32) {
    fetch(row, q, 0u); fetch(row, q, 1u); fetch(row, q, 2u); fetch(row, q, 3u);
    fetch(row, q, 4u); fetch(row, q, 5u); fetch(row, q, 6u); fetch(row, q, 7u);
    fetch(row, q, 8u); fetch(row, q, 9u); fetch(row, q, 10u); fetch(row, q, 11u);
    fetch(row, q, 12u); fetch(row, q, 13u); fetch(row, q, 14u); fetch(row, q, 15u);
    fetch(row, q, 16u); fetch(row, q, 17u); fetch(row, q, 18u); fetch(row, q, 19u);
    fetch(row, q, 20u); fetch(row, q, 21u); fetch(row, q, 22u); fetch(row, q, 23u);
    fetch(row, q, 24u); fetch(row, q, 25u); fetch(row, q, 26u); fetch(row, q, 27u);
}

fn keep_all(row: u32, q: u32) {
    keep(row, q, 0u); keep(row, q, 1u); keep(row, q, 2u); keep(row, q, 3u);
    keep(row, q, 4u); keep(row, q, 5u); keep(row, q, 6u); keep(row, q, 7u);
    keep(row, q, 8u); keep(row, q, 9u); keep(row, q, 10u); keep(row, q, 11u);
    keep(row, q, 12u); keep(row, q, 13u); keep(row, q, 14u); keep(row, q, 15u);
    keep(row, q, 16u); keep(row, q, 17u); keep(row, q, 18u); keep(row, q, 19u);
    keep(row, q, 20u); keep(row, q, 21u); keep(row, q, 22u); keep(row, q, 23u);
    keep(row, q, 24u); keep(row, q, 25u); keep(row, q, 26u); keep(row, q, 27u);
}
