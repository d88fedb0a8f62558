// Colours at points of frames: nearest, linear, cubic, and averages over what a pixel covers.
//
// Samples lie in words of 32 bits, as FORMAT says. Weights are float32; no sampler of the hardware's takes part.

const WHITE_8 = 255.0;

fn loaded(i: u32) -> vec4f {
    switch FORMAT {
        case BYTE: {
            return vec4f(f32(extractBits(samples[i >> 2u], 8u * (i & 3u), 8u)), 0.0, 0.0, 0.0);
        }
        case BYTES: {
            return vec4f(unpack4xU8(samples[i]));
        }
        case SHORT: {
            return vec4f(f32(extractBits(samples[i >> 1u], 16u * (i & 1u), 16u)), 0.0, 0.0, 0.0);
        }
        case SHORTS: {
            let a = samples[2u * i];
            let b = samples[2u * i + 1u];
            return vec4f(vec4u(a & 0xffffu, a >> 16u, b & 0xffffu, b >> 16u));
        }
        case FLOAT: {
            return vec4f(bitcast<f32>(samples[i]), 0.0, 0.0, 0.0);
        }
        default: {
            let k = 4u * i;
            return bitcast<vec4f>(vec4u(samples[k], samples[k + 1u], samples[k + 2u], samples[k + 3u]));
        }
    }
}

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
    // The frames that are here begin with one of those of the whole.
    let here = clamp(at.z - i32(settings.earliest), 0, i32(settings.held) - 1);
    return prepared(loaded((u32(here) * settings.size.y + u32(at.y)) * settings.size.x + u32(at.x)));
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
    let upper = mix(texel(base.x, base.y, frame), texel(base.x + 1, base.y, frame), part.x);
    let lower = mix(texel(base.x, base.y + 1, frame), texel(base.x + 1, base.y + 1, frame), part.x);
    return mix(upper, lower, part.y);
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

fn at_place(place: Place, cubic: bool) -> vec4f {
    let base = place.base.xy;
    let part = place.part.xy;
    let frame = place.base.z;
    if (BETWEEN == NOTHING) {
        return in_frame(base, part, 0, cubic);
    }
    if (BETWEEN == NEAREST) {
        return in_frame(base, part, frame + i32(place.part.z >= 0.5), cubic);
    }
    if (BETWEEN == CUBIC) {
        let w = cubic_weights(place.part.z);
        var total = vec4f(0.0);
        for (var k = 0; k < 4; k++) {
            total += w[k] * in_frame(base, part, frame + k - 1, cubic);
        }
        return total;
    }
    return mix(in_frame(base, part, frame, cubic), in_frame(base, part, frame + 1, cubic), place.part.z);
}

// The average over what a pixel covers of the picture, at one time: a grid of points in the parallelogram of ∂p/∂q, less than one source
// pixel apart up to TAPS of them along each side.
fn averaged(q: vec3i, shift: vec3f, matrix: mat3x3f) -> vec4f {
    let taps = clamp(vec2u(ceil(2.0 * vec2f(length(matrix[0].xy), length(matrix[1].xy)))), vec2u(1u), vec2u(TAPS));
    var total = vec4f(0.0);
    for (var j = 0u; j < taps.y; j++) {
        for (var i = 0u; i < taps.x; i++) {
            let s = (vec2f(vec2u(i, j)) + 0.5) / vec2f(taps) - 0.5;
            total += at_place(place_of(q, shift + vec3f(s.x * matrix[0].xy + s.y * matrix[1].xy, 0.0)), true);
        }
    }
    return total / f32(taps.x * taps.y);
}

// The larger singular value of the upper left part: how many source pixels a pixel covers, at most.
fn largest(m: mat3x3f) -> f32 {
    let a = m[0].xy;
    let b = m[1].xy;
    let half_ = 0.5 * (dot(a, a) + dot(b, b));
    let cross_ = a.x * b.y - a.y * b.x;
    return sqrt(half_ + sqrt(max(half_ * half_ - cross_ * cross_, 0.0)));
}

fn filtered(q: vec3i, source: Source) -> vec4f {
    let averaging = FILTER == ANTIALIAS || FILTER == AUTO;
    var value = at_place(place_of(q, source.shift), FILTER == CUBIC || averaging);
    if (averaging) {
        // Where the map shrinks, averages fade in.
        let from_ = select(1.0, 0.97, FILTER == ANTIALIAS);
        let part = smoothstep(from_, select(1.1, 1.0, FILTER == ANTIALIAS), largest(source.matrix));
        if (part > 0.0) {
            value = mix(value, averaged(q, source.shift, source.matrix), part);
        }
    }
    return finished(value);
}
