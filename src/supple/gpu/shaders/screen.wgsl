// Composition on the screen: two textures of any size side by side, divided at the split.

struct Settings {
    sides: vec4f, // the sides of the visible part of the textures, across and down the screen
    depth: vec3f, // the divisor, for perspective: at the upper left of the screen, and its changes across and down
    corner: vec2f, // the corner of the visible part at the upper left of the screen
    split: f32, // the right edge of the second texture, from 0 to 1
}

const LINE: f32 = 0.001; // half the width of the line between them

// This is a constant, as software GPUs would sample both textures everywhere.
override SPLIT: bool = true;

var<uniform> settings: Settings;
var first: texture_2d<f32>;
var second: texture_2d<f32>;
var smooth_: sampler;

struct Corner {
    @builtin(position) position: vec4f,
    @location(0) at: vec2f,
}

@vertex
fn corner(@builtin(vertex_index) k: u32) -> Corner {
    let at = vec2f(f32((k << 1u) & 2u), f32(k & 2u));
    return Corner(vec4f(2.0 * at.x - 1.0, 1.0 - 2.0 * at.y, 0.0, 1.0), at);
}

@fragment
fn shown(corner: Corner) -> @location(0) vec4f {
    let depth = max(settings.depth.x + dot(settings.depth.yz, corner.at), 1e-3); // nothing lies beyond a horizon
    let at = (settings.corner + settings.sides.xy * corner.at.x + settings.sides.zw * corner.at.y) / depth;
    var v = textureSampleLevel(first, smooth_, at, 0.0).xyz;
    if (SPLIT) {
        let other = textureSampleLevel(second, smooth_, at, 0.0).xyz;
        v = select(v, other, corner.at.x < settings.split);
        if (abs(corner.at.x - settings.split) < LINE) {
            v = vec3f(1.0);
        }
    }
    return vec4f(v, 1.0);
}
