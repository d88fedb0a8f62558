// Frames on the device, and their coarser levels: each averages 2 by 2 samples of the one before, in their filtered
// form, and repeats the last one of an odd edge. Levels cover the rows on the device, one after the other.

@group(0) @binding(10) var<storage, read_write> levels: array<f32>;

override FOLDED: bool = false; // true if frames have several layers
override CHANNELS: u32 = 4u;

const SIDE = 13u; // bits of a coordinate in a layer

fn loaded_at(at: vec2u, slot: u32) -> vec4f {
    if (FOLDED) {
        let block = at >> vec2u(SIDE);
        let layer = (slot * settings.blocks.y + block.y) * settings.blocks.x + block.x;
        return loaded(at & vec2u((1u << SIDE) - 1u), layer);
    }
    return loaded(at, slot);
}

fn level_sample(i: u32) -> vec4f {
    let k = i * CHANNELS;
    var v = vec4f(levels[k], 0.0, 0.0, 0.0);
    if (CHANNELS > 1u) {
        v.y = levels[k + 1u];
    }
    if (CHANNELS > 2u) {
        v.z = levels[k + 2u];
    }
    if (CHANNELS > 3u) {
        v.w = levels[k + 3u];
    }
    return v;
}
