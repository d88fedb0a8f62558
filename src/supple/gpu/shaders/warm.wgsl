// A colour from cold to warm, for numbers from 0 to 1.

fn warm(x: f32) -> vec3f {
    return mix(vec3f(0.10, 0.25, 0.75), vec3f(0.95, 0.35, 0.10), clamp(x, 0.0, 1.0));
}
