// Images and frames in a window: the visible part, scaled and warped by strokes.
//
// T⁻¹ is solved at every 16th pixel of the window, and interpolated at the others, optionally followed by Newton's
// method. All offsets are in physical units.

#use newton

struct Settings {
    size: vec2u, // pixels of the window
    nodes: vec2u,
    origin: vec2f, // the position of the window's first pixel, in pixels of the image
    scale: f32, // pixels of the image from one pixel of the window to the next
    time: f32, // the frame as a coordinate of T; 0 where each frame is a separate picture
    frame: f32, // the frame to show
    source: vec2u, // pixels of the image
    frames: u32, // of the whole clip
    earliest: u32, // of the frames held
    held: u32, // their number
    slots: u32, // the capacity
    stride: u32, // words from frame to frame, with all levels
    levels: u32, // each half as large as the one before
    strokes: u32,
    overlay: u32,
    every: f32, // pixels from line to line of a grid
    back: vec4f, // behind the image; and the width of the checkerboard squares behind transparent pixels
}

var<uniform> settings: Settings;
var<storage, read_write> nodes: array<vec4f>; // three for each: (w, residual), (∂p/∂x, steps), (∂p/∂y, 0)
var<storage, read> pixels: array<u32>; // sRGB and opacity, of 8 bits each
var laid: texture_2d<f32>; // an image that is drawn already
var target_: texture_storage_2d<rgba8unorm, write>;

// These are constants, since software GPUs run both sides of a branch, and all threads as often as the longest loop.
override BENT: bool = true; // true if there are strokes
override DRAGGED: bool = false; // true if one sample for each pixel will do, with T⁻¹ interpolated between nodes
override LAID: bool = false; // true if the image is drawn already, and strokes are for the overlay

const GRID = 1u;
const STRETCH = 2u;
const RESIDUAL = 3u;
const INVERSIONS = 4u;

struct Seen {
    w: vec3f,
    right: vec3f, // ∂p/∂q with respect to x and y
    below: vec3f,
    residual: f32,
    steps: f32,
}

fn anchor(at: vec2f) -> vec3f {
    return vec3f(settings.origin + settings.scale * at, settings.time) * domain.spacing.xyz;
}

@compute @workgroup_size(8, 8)
fn solve(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= settings.nodes.x || id.y >= settings.nodes.y) {
        return;
    }
    let found = undo(anchor(vec2f(id.xy * CELL)), 1e-3 * finest());
    let k = 3u * (id.y * settings.nodes.x + id.x);
    nodes[k] = vec4f(found.offset, found.residual);
    nodes[k + 1u] = vec4f(found.matrix[0], found.steps);
    nodes[k + 2u] = vec4f(found.matrix[1], 0.0);
}

// The value at s, from 0 to 1, between nodes at distance h: linear between a and b, plus half of s (1 - s) h times the
// difference of the slopes.
fn bent(a: vec3f, b: vec3f, slope_a: vec3f, slope_b: vec3f, s: f32, h: f32) -> vec3f {
    return mix(a, b, s) + 0.5 * h * s * (1.0 - s) * (slope_a - slope_b);
}

fn interpolated(at: vec2f) -> Seen {
    let v = at / f32(CELL);
    let i = min(vec2u(v), settings.nodes - 2u);
    let s = v - vec2f(i);
    let a = 3u * (i.y * settings.nodes.x + i.x);
    let c = a + 3u * settings.nodes.x;
    let x = vec3f(1.0, 0.0, 0.0);
    let y = vec3f(0.0, 1.0, 0.0);
    let h = f32(CELL) * settings.scale * domain.spacing.xyz;
    let upper = bent(nodes[a].xyz, nodes[a + 3u].xyz, nodes[a + 1u].xyz, nodes[a + 4u].xyz, s.x, h.x);
    let lower = bent(nodes[c].xyz, nodes[c + 3u].xyz, nodes[c + 1u].xyz, nodes[c + 4u].xyz, s.x, h.x);
    let above = mix(nodes[a + 2u].xyz, nodes[a + 5u].xyz, s.x);
    let below = mix(nodes[c + 2u].xyz, nodes[c + 5u].xyz, s.x);
    let right = mix(mix(nodes[a + 1u].xyz, nodes[a + 4u].xyz, s.x), mix(nodes[c + 1u].xyz, nodes[c + 4u].xyz, s.x), s.y);
    return Seen(
        bent(upper, lower, above, below, s.y, h.y), right, mix(above, below, s.y),
        max(nodes[a].w, nodes[c].w), max(nodes[a + 1u].w, nodes[c + 1u].w),
    );
}

fn source_of(at: vec2f) -> Seen {
    let q = anchor(at);
    if (!BENT || frozen(q)) {
        return Seen(vec3f(0.0), vec3f(1.0, 0.0, 0.0), vec3f(0.0, 1.0, 0.0), 0.0, 0.0);
    }
    let guess = interpolated(at);
    // Beside what is frozen, the map may vary too much from node to node.
    if (DRAGGED && !FROZEN) {
        return guess;
    }
    let wanted = 1e-3 * finest();
    var found = newton(0u, settings.strokes, q, vec3f(0.0), guess.w, wanted, select(6u, 12u, FROZEN));
    if (FROZEN && !(found.residual <= 0.05 * finest())) {
        found = undo(q, wanted);
    }
    return Seen(found.offset, found.matrix[0], found.matrix[1], found.residual, found.steps);
}

// A pixel of a level of a frame, weighted by its opacity.
fn texel(at: vec2i, level: u32, frame: i32) -> vec4f {
    var size = settings.source;
    var start = 0u;
    for (var k = 0u; k < level; k++) {
        start += size.x * size.y;
        size = (size + 1u) / 2u;
    }
    let kept = vec2u(clamp(at, vec2i(0), vec2i(size) - 1));
    // The frames held are in a ring.
    let here = clamp(frame, i32(settings.earliest), i32(settings.earliest + settings.held) - 1);
    let slot = u32(here) % settings.slots;
    let v = unpack4x8unorm(pixels[slot * settings.stride + start + kept.y * size.x + kept.x]);
    return vec4f(v.xyz * v.w, v.w);
}

fn linear_at(p: vec2f, level: u32, frame: i32) -> vec4f {
    let q = (p + 0.5) / f32(1u << level) - 0.5;
    let whole = floor(clamp(q, vec2f(-1e6), vec2f(1e6)));
    let part = q - whole;
    let i = vec2i(whole);
    let upper = mix(texel(i, level, frame), texel(i + vec2i(1, 0), level, frame), part.x);
    let lower = mix(texel(i + vec2i(0, 1), level, frame), texel(i + vec2i(1, 1), level, frame), part.x);
    return mix(upper, lower, part.y);
}

fn at_time(p: vec2f, level: u32, time: f32) -> vec4f {
    let kept = clamp(time, 0.0, f32(settings.frames - 1u));
    let before = i32(floor(kept));
    let part = kept - f32(before);
    if (settings.frames == 1u || part == 0.0) {
        return linear_at(p, level, before);
    }
    return mix(linear_at(p, level, before), linear_at(p, level, before + 1), part);
}

// How much of a pixel's footprint, which is centred at a point, lies on the image.
fn cover_of(q: vec2f) -> f32 {
    let inside = clamp(
        (min(q + 0.5, vec2f(settings.source) - 0.5 - q)) / settings.scale + 0.5, vec2f(0.0), vec2f(1.0)
    );
    return inside.x * inside.y;
}

// A colour from cold to warm, for numbers from 0 to 1.
fn warm(x: f32) -> vec3f {
    return mix(vec3f(0.10, 0.25, 0.75), vec3f(0.95, 0.35, 0.10), clamp(x, 0.0, 1.0));
}

// The image at a point of a frame, averaged over a footprint that covers so many of its pixels; over a checkerboard
// where it is transparent.
fn image(id: vec2u, p: vec2f, right: vec2f, below: vec2f, covers: f32, time: f32) -> vec3f {
    if (LAID) {
        return textureLoad(laid, id, 0).xyz;
    }
    let levels = log2(max(covers, 1e-6)) - select(1.0, 0.5, DRAGGED);
    let level = u32(clamp(ceil(levels - 0.5), 0.0, f32(settings.levels - 1u)));
    let taps = select(u32(clamp(ceil(covers / f32(1u << level) - 0.1), 1.0, 4.0)), 1u, DRAGGED);
    var total = vec4f(0.0);
    for (var j = 0u; j < taps; j++) {
        for (var i = 0u; i < taps; i++) {
            let s = (vec2f(vec2u(i, j)) + 0.5) / f32(taps) - 0.5;
            total += at_time(p + s.x * right + s.y * below, level, time);
        }
    }
    total /= f32(taps * taps);
    let square = vec2u((vec2f(id) + 0.5) / settings.back.w);
    let ground = select(0.42, 0.58, ((square.x + square.y) & 1u) == 0u);
    return total.xyz + (1.0 - total.w) * ground;
}

@compute @workgroup_size(8, 8)
fn paint(@builtin(global_invocation_id) thread: vec3u) {
    let id = thread.xy;
    if (id.x >= settings.size.x || id.y >= settings.size.y) {
        return;
    }
    let at = vec2f(id);
    let q = settings.origin + settings.scale * at;
    let cover = cover_of(q);
    if (cover == 0.0) {
        textureStore(target_, id, vec4f(settings.back.xyz, 1.0));
        return;
    }
    let seen = source_of(at);
    let p = q + seen.w.xy / domain.spacing.xy;
    let time = settings.frame + seen.w.z / domain.spacing.z;
    // The footprint of a pixel in the image.
    let right = settings.scale * seen.right.xy * domain.spacing.x / domain.spacing.xy;
    let below = settings.scale * seen.below.xy * domain.spacing.y / domain.spacing.xy;
    let covers = max(length(right), length(below));
    var shown = image(id, p, right, below, covers, time);
    if (settings.overlay == GRID) {
        let lines = abs(p / settings.every - round(p / settings.every)) * settings.every / max(covers, 1e-6);
        shown = mix(vec3f(1.0), shown, clamp(min(lines.x, lines.y) - 0.2, 0.25, 1.0));
    } else if (settings.overlay == STRETCH) {
        let area = abs(seen.right.x * seen.below.y - seen.right.y * seen.below.x);
        let larger = clamp(-0.5 * log2(max(area, 1e-6)), -0.5, 0.5);
        // Areas that keep their size keep their colour; the root makes a change of a tenth visible.
        shown = mix(shown, warm(0.5 + sign(larger) * 0.5), 0.7 * sqrt(2.0 * abs(larger)));
    } else if (settings.overlay == RESIDUAL) {
        shown = mix(shown, warm(1.0 + log2(max(seen.residual / finest(), 1e-9)) / 16.0), 0.6);
    } else if (settings.overlay == INVERSIONS) {
        shown = mix(shown, warm(seen.steps / 8.0), 0.6);
    }
    textureStore(target_, id, vec4f(mix(settings.back.xyz, shown, select(cover, 1.0, LAID)), 1.0));
}
