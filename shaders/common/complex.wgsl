// Complex numbers as vec2 (re, im), and sine and cosine of whole turns.
//
// WGSL's own sin and cos promise an absolute error of 2^-11 only, and nothing outside -pi to pi. These polynomials are within
// 2e-7 for any number of turns whose fraction is exact enough: the error of the argument itself (2^-25 of its size) adds to it.

const SIN_0: f32 = 6.283185280154407;
const SIN_1: f32 = -41.34168061334652;
const SIN_2: f32 = 81.60247636892518;
const SIN_3: f32 = -76.58117264427872;
const SIN_4: f32 = 39.7598270853191;
const COS_1: f32 = -19.739208547715783;
const COS_2: f32 = 64.93934647621015;
const COS_3: f32 = -85.45356476099522;
const COS_4: f32 = 60.143889560342146;
const COS_5: f32 = -24.981434467891656;

// (cos, sin) of 2 pi turns.
fn cos_sin(turns: f32) -> vec2<f32> {
    let rest = turns - round(turns);
    // Beyond a quarter turn the sine is mirrored and the cosine changes sign, so that one short polynomial does.
    let far = abs(rest) > 0.25;
    let folded = select(rest, select(-0.5, 0.5, rest > 0.0) - rest, far);
    let y = folded * folded;
    let sine = folded * (SIN_0 + y * (SIN_1 + y * (SIN_2 + y * (SIN_3 + y * SIN_4))));
    let cosine = 1.0 + y * (COS_1 + y * (COS_2 + y * (COS_3 + y * (COS_4 + y * COS_5))));
    return vec2<f32>(select(cosine, -cosine, far), sine);
}

struct CosSin4 {
    cosine: vec4<f32>,
    sine: vec4<f32>,
}

// The same for four angles.
fn cos_sin_4(turns: vec4<f32>) -> CosSin4 {
    let rest = turns - round(turns);
    let far = abs(rest) > vec4<f32>(0.25);
    let folded = select(rest, select(vec4<f32>(-0.5), vec4<f32>(0.5), rest > vec4<f32>(0.0)) - rest, far);
    let y = folded * folded;
    let sine = folded * (SIN_0 + y * (SIN_1 + y * (SIN_2 + y * (SIN_3 + y * SIN_4))));
    let cosine = 1.0 + y * (COS_1 + y * (COS_2 + y * (COS_3 + y * (COS_4 + y * COS_5))));
    return CosSin4(select(cosine, -cosine, far), sine);
}

fn multiply(a: vec2<f32>, b: vec2<f32>) -> vec2<f32> {
    return vec2<f32>(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x);
}

// a times -j.
fn minus_j(a: vec2<f32>) -> vec2<f32> {
    return vec2<f32>(a.y, -a.x);
}
