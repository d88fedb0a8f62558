// Interpolation between nodes at distance h, from values and slopes.

// The value at s, from 0 to 1: linear between a and b, plus half of s (1 - s) h times the difference of the slopes.
fn bent(a: vec3f, b: vec3f, slope_a: vec3f, slope_b: vec3f, s: f32, h: f32) -> vec3f {
    return mix(a, b, s) + 0.5 * h * s * (1.0 - s) * (slope_a - slope_b);
}
