// Samples of 8 or 16 bits.

@group(0) @binding(8) var frames: texture_2d_array<u32>;

fn loaded(at: vec2u, layer: u32) -> vec4f {
    return vec4f(textureLoad(frames, at, layer, 0));
}
