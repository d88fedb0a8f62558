// Samples of 32 bits.

@group(0) @binding(8) var frames: texture_2d_array<f32>;

fn loaded(at: vec2u, layer: u32) -> vec4f {
    return textureLoad(frames, at, layer, 0);
}
