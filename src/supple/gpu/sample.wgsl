// Colours at points of frames: nearest, linear, cubic, and averages over what a pixel covers.
//
// Weights are float32; no sampler of the hardware's takes part.

fn to_light(v: vec3f) -> vec3f {
    let s = v / settings.white;
    let bent_ = pow((max(s, vec3f(0.04045)) + 0.055) / 1.055, vec3f(2.4));
    return settings.white * select(bent_, s / 12.92, s <= vec3f(0.04045));
}

fn from_light(v: vec3f) -> vec3f {
    let s = v / settings.white;
    let bent_ = 1.055 * pow(max(s, vec3f(0.0031308)), vec3f(1.0 / 2.4)) - 0.055;
    return settings.white * select(bent_, s * 12.92, s <= vec3f(0.0031308));
}

// As it is filtered: light, if wanted, and weighted by opacity. Of two channels, the second is opacity.
fn prepared(pixel: vec4f) -> vec4f {
    var v = pixel;
    if (LIGHT) {
        v = vec4f(to_light(v.xyz), v.w);
        if (ALPHA && settings.channels < 4u) {
            v[settings.channels - 1u] = pixel[settings.channels - 1u];
        }
    }
    if (ALPHA) {
        let last = settings.channels - 1u;
        let opacity = pixel[last];
        v *= opacity / settings.white;
        v[last] = opacity;
    }
    return v;
}

fn finished(filtered: vec4f) -> vec4f {
    var v = filtered;
    if (ALPHA) {
        let last = settings.channels - 1u;
        let opacity = v[last];
        v *= select(0.0, settings.white / opacity, opacity > 0.0);
        v[last] = opacity;
    }
    if (LIGHT) {
        let kept = v;
        v = vec4f(from_light(v.xyz), v.w);
        if (ALPHA && settings.channels < 4u) {
            v[settings.channels - 1u] = kept[settings.channels - 1u];
        }
    }
    return v;
}

// Mirrored about the outer edges of the first and the last sample.
fn reflected(i: i32, n: i32) -> i32 {
    let k = ((i % (2 * n)) + 2 * n) % (2 * n);
    return min(k, 2 * n - 1 - k);
}

fn texel(x: i32, y: i32, frame: i32) -> vec4f {
    let size = vec3i(vec3u(settings.size, settings.frames));
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
    let here = vec2u(at.zy);
    // What comes of one that is not here is not used.
    missing += u32(any(here < settings.held.xz) || any(here >= settings.held.yw));
    var layer = here.x - settings.held.x + settings.shift;
    layer -= select(0u, settings.slots, layer >= settings.slots);
    var place = vec2u(u32(at.x), here.y - settings.held.z);
    if (FOLDED) {
        let block = place >> vec2u(SIDE);
        layer = (layer * settings.blocks.y + block.y) * settings.blocks.x + block.x;
        place &= vec2u((1u << SIDE) - 1u);
    }
    return prepared(loaded(place, layer));
}

fn cubic_weights(t: f32) -> vec4f {
    return vec4f(
        t * (-0.5 + t * (1.0 - 0.5 * t)),
        1.0 + t * t * (-2.5 + 1.5 * t),
        t * (0.5 + t * (2.0 - 1.5 * t)),
        t * t * (-0.5 + 0.5 * t),
    );
}

fn linear_at(base: vec2i, part: vec2f, frame: i32) -> vec4f {
    var total = vec4f(0.0);
    for (var k = 0; k < 4; k++) {
        let at = vec2i(k & 1, k >> 1);
        let weight = select(1.0 - part, part, at == vec2i(1));
        total += weight.x * weight.y * texel(base.x + at.x, base.y + at.y, frame);
    }
    return total;
}

fn cubic_at(base: vec2i, part: vec2f, frame: i32) -> vec4f {
    let wx = cubic_weights(part.x);
    let wy = cubic_weights(part.y);
    var total = vec4f(0.0);
    for (var j = 0; j < 4; j++) {
        var row = vec4f(0.0);
        for (var i = 0; i < 4; i++) {
            row += wx[i] * texel(base.x + i - 1, base.y + j - 1, frame);
        }
        total += wy[j] * row;
    }
    return total;
}

// A place is a whole part, and the rest from 0 to 1: what float32 keeps of it does not depend on where it lies.
struct Place {
    base: vec3i,
    part: vec3f,
}

fn place_of(q: vec3i, shift: vec3f) -> Place {
    // Sources far outside are all the same; whole numbers stay within their bounds.
    let kept = clamp(shift, vec3f(-1e6), vec3f(1e6));
    let whole = floor(kept);
    return Place(q + vec3i(whole), kept - whole);
}

fn in_frame(base: vec2i, part: vec2f, frame: i32, cubic: bool) -> vec4f {
    if (FILTER == NEAREST) {
        return texel(base.x + i32(part.x >= 0.5), base.y + i32(part.y >= 0.5), frame);
    }
    if (cubic) {
        return cubic_at(base, part, frame);
    }
    return linear_at(base, part, frame);
}

// The integral of a kernel between frames, from 0 to t.
fn integral(t: f32) -> f32 {
    if (BETWEEN == CUBIC) {
        return cubic_integral(t);
    }
    let x = min(abs(t), 1.0);
    return sign(t) * (x - 0.5 * x * x);
}

// How many frames a pixel covers; the average fades in.
fn width_in_time(m: mat3x3f) -> f32 {
    let along = length(vec3f(m[0].z, m[1].z, m[2].z));
    return min(along * clamp((along - 1.0) * 10.0, 0.0, 1.0), LONGEST);
}

fn filtered(q: vec3i, source: Source) -> vec4f {
    let place = place_of(q, source.shift);
    let over = footprint_of(source.matrix);
    // Far outside the clip, all times are the same.
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
    let cubic = cubic_weights(part);
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
            total += weight * in_picture(place, over, frame);
            weights += weight;
        }
    }
    return finished(total / weights);
}
