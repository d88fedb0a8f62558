// Interpolation between nodes at distance h, from values and slopes.

// The value at s, from 0 to 1: linear between a and b, plus half of s (1 - s) h times the difference of the slopes.
fn bent(a: vec3f, b: vec3f, slope_a: vec3f, slope_b: vec3f, s: f32, h: f32) -> vec3f {
    return mix(a, b, s) + 0.5 * h * s * (1.0 - s) * (slope_a - slope_b);
}

// The cubic at s between two values that differ by `rise`; its derivatives by s are rise + a at 0, and rise - b at 1.
fn cubic(from_: vec3f, rise: vec3f, a: vec3f, b: vec3f, s: f32) -> vec3f {
    return from_ + s * (rise + (1.0 - s) * ((1.0 - s) * a + s * b));
}
