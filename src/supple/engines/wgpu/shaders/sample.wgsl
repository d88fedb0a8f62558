// Colours at points of frames: nearest, linear, cubic, and averages over footprints.
//
// Weights are float32; hardware samplers are not used.

// Reflection about the outer edges of the first and the last sample.
fn reflected(i: i32, n: i32) -> i32 {
    let k = ((i % (2 * n)) + 2 * n) % (2 * n);
    return min(k, 2 * n - 1 - k);
}

struct Level {
    size: vec2i, // of the level of a whole frame
    number: u32,
    start: u32, // its offset in the levels of a slot, in samples
}

fn level_of(number: u32) -> Level {
    var size = settings.size;
    var held = settings.held.zw;
    var start = 0u;
    for (var k = 0u; k < number; k++) {
        start += select(0u, size.x * (held.y - held.x), k > 0u);
        size = (size + 1u) / 2u;
        held = vec2u(held.x / 2u, (held.y + 1u) / 2u);
    }
    return Level(vec2i(size), number, start);
}

// The sample of a level: unchanged in the frame itself, and in the form for filtering in coarser levels.
fn stored(level: Level, at: vec2u, frame: u32) -> vec4f {
    // The row in the frame: results of missing rows are not used.
    let rows = min(vec2u(at.y, at.y + 1u) << vec2u(level.number), settings.size.yy);
    let held = settings.held;
    missing += u32(frame < held.x || frame >= held.y || rows.x < held.z || rows.y > held.w);
    var slot = frame - held.x + settings.shift;
    slot -= select(0u, settings.slots, slot >= settings.slots);
    if (level.number == 0u) {
        return loaded_at(vec2u(at.x, at.y - held.z), slot);
    }
    let row = at.y - (held.z >> level.number);
    return level_sample(slot * settings.stride + level.start + row * u32(level.size.x) + at.x);
}

fn texel(level: Level, x: i32, y: i32, frame: i32) -> vec4f {
    let size = vec3i(level.size, i32(settings.frames));
    var at = vec3i(x, y, frame);
    if (OUTSIDE == CONSTANT) {
        if (any(at < vec3i(0)) || any(at >= size)) {
            return prepared(settings.fill);
        }
    } else if (OUTSIDE == REFLECT) {
        at = vec3i(reflected(x, size.x), reflected(y, size.y), reflected(frame, size.z));
    } else {
        at = clamp(at, vec3i(0), size - 1);
    }
    let v = stored(level, vec2u(at.xy), u32(at.z));
    if (level.number > 0u) {
        return v;
    }
    return prepared(v);
}

fn linear_at(base: vec2i, part: vec2f, frame: i32) -> vec4f {
    let level = level_of(0u);
    var total = vec4f(0.0);
    for (var k = 0; k < 4; k++) {
        let at = vec2i(k & 1, k >> 1);
        let weight = select(1.0 - part, part, at == vec2i(1));
        total += weight.x * weight.y * texel(level, base.x + at.x, base.y + at.y, frame);
    }
    return total;
}

// A coordinate is a whole part and a fraction from 0 to 1, whose accuracy in float32 does not depend on the whole part.
struct Place {
    base: vec3i,
    part: vec3f,
}

fn place_of(q: vec3i, shift: vec3f) -> Place {
    // Far outside, all source points are alike; this keeps integers in range.
    let kept = clamp(shift, vec3f(-1e6), vec3f(1e6));
    let whole = floor(kept);
    return Place(q + vec3i(whole), kept - whole);
}

fn in_frame(place: Place, over: Footprint, frame: i32) -> vec4f {
    if (FILTER == NEAREST) {
        let i = place.base.xy + vec2i(place.part.xy >= vec2f(0.5));
        return texel(level_of(0u), i.x, i.y, frame);
    }
    if (FILTER == LINEAR) {
        return linear_at(place.base.xy, place.part.xy, frame);
    }
    if (FILTER == CUBIC) {
        return spot(level_of(0u), place.base.xy, place.part.xy, vec3f(0.0), frame);
    }
    return averaged(place, over, frame);
}

// Catmull and Rom's weights of four frames.
fn weights_in_time(t: f32) -> vec4f {
    return vec4f(
        t * (-0.5 + t * (1.0 - 0.5 * t)),
        1.0 + t * t * (-2.5 + 1.5 * t),
        t * (0.5 + t * (2.0 - 1.5 * t)),
        t * t * (-0.5 + 0.5 * t),
    );
}

// The integral of a kernel between frames, from 0 to t.
fn integral(t: f32) -> f32 {
    if (BETWEEN == CUBIC) {
        let x = min(abs(t), 2.0);
        let inner = x * (1.0 + x * x * (-5.0 / 6.0 + 0.375 * x));
        let outer = x * (2.0 + x * (-2.0 + x * (5.0 / 6.0 - 0.125 * x))) - 1.0 / 6.0;
        return sign(t) * select(outer, inner, x <= 1.0);
    }
    let x = min(abs(t), 1.0);
    return sign(t) * (x - 0.5 * x * x);
}

// The number of frames of a pixel beyond its own: the residual footprint along time.
fn width_in_time(m: mat3x3f) -> f32 {
    let along = vec3f(m[0].z, m[1].z, m[2].z);
    return min(sqrt(max(dot(along, along) - 1.0, 0.0)), LONGEST);
}

fn filtered(q: vec3i, source: Source) -> vec4f {
    let place = place_of(q, source.shift);
    let over = footprint_of(source.matrix);
    // Far outside the clip, time has no effect.
    let kept = clamp(place.base.z, settings.times.x, settings.times.y);
    let part = select(0.0, place.part.z, kept == place.base.z);
    var width = 0.0;
    if (AVERAGE) {
        width = width_in_time(source.matrix);
    }
    let radius = select(1.0, 2.0, BETWEEN == CUBIC) + 0.5 * width;
    var first = kept + i32(floor(part - radius)) + 1;
    var last = kept + i32(ceil(part + radius)) - 1;
    if (BETWEEN == NOTHING || BETWEEN == NEAREST) {
        first = select(0, kept + i32(part >= 0.5), BETWEEN == NEAREST);
        last = first;
    }
    var total = vec4f(0.0);
    var weights = 0.0;
    let cubic = weights_in_time(part);
    for (var frame = first; frame <= last; frame++) {
        let t = f32(frame - kept) - part;
        var weight = 1.0;
        if (BETWEEN == LINEAR || BETWEEN == CUBIC) {
            if (width > 1e-3) {
                weight = (integral(t + 0.5 * width) - integral(t - 0.5 * width)) / width;
            } else if (BETWEEN == CUBIC) {
                weight = cubic[clamp(frame - kept + 1, 0, 3)];
            } else {
                weight = 1.0 - abs(t);
            }
        }
        if (weight != 0.0) {
            total += weight * in_frame(place, over, frame);
            weights += weight;
        }
    }
    return finished(total / weights);
}
