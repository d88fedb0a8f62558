// A level of a frame, from the one before.

struct Settings {
    fine: vec2u, // samples on the device of the level before, across and down
    coarse: vec2u, // and of this one
    start: vec2u, // their offsets in the levels, in samples: those of the level before, and of this one
    first: vec2u, // their first rows in the whole levels
    blocks: vec2u, // layers of a frame, across and down
    slot: u32,
    number: u32,
    channels: u32,
    white: f32,
}

@group(0) @binding(0) var<uniform> settings: Settings;

fn finer(x: u32, y: u32) -> vec4f {
    let column = min(x, settings.fine.x - 1u);
    let row = u32(clamp(i32(y) - i32(settings.first.x), 0, i32(settings.fine.y) - 1));
    if (settings.number == 1u) {
        return prepared(loaded_at(vec2u(column, row), settings.slot));
    }
    return level_sample(settings.start.x + row * settings.fine.x + column);
}

@compute @workgroup_size(8, 8)
fn halve(@builtin(global_invocation_id) id: vec3u) {
    if (any(id.xy >= settings.coarse)) {
        return;
    }
    let x = 2u * id.x;
    let y = 2u * (id.y + settings.first.y);
    let mean = 0.25 * (finer(x, y) + finer(x + 1u, y) + finer(x, y + 1u) + finer(x + 1u, y + 1u));
    let i = (settings.start.y + id.y * settings.coarse.x + id.x) * CHANNELS;
    levels[i] = mean.x;
    if (CHANNELS > 1u) {
        levels[i + 1u] = mean.y;
    }
    if (CHANNELS > 2u) {
        levels[i + 2u] = mean.z;
    }
    if (CHANNELS > 3u) {
        levels[i + 3u] = mean.w;
    }
}
