// Averages over what a pixel covers of a picture; see supple/cpu/footprint.py and supple/cpu/filters.py.
//
// A footprint is described by its covariance. One that is nearly upright is averaged exactly: the cubic interpolant,
// integrated over a box, is a sum of samples. A long or an oblique one is made of several such boxes along its major
// axis, of samples that are averages themselves where even the minor axis is long.

const WIDEST = 2.0;
const OBLIQUE = 0.5; // an upright box stands for a footprint with less covariance than this
const MOST_BOXES = 64.0;
const FINEST = 1.0 / 64.0; // a box that is smaller is a point
// Where the square of the larger singular value is from and to as the average fades in.
const FADE_ANTIALIAS = vec2f(0.9409, 1.0);
const FADE_AUTO = vec2f(1.0, 1.21);
const COARSEST = 2u; // of an average, two to so many samples are read along each side

struct Footprint {
    kind: u32, // a point, a box, or several
    box: vec2f, // how wide it is
    covariance: vec3f, // xx, xy, yy
    major: f32, // and its eigenvalues
    minor: f32,
}

const POINT = 0u;
const BOX = 1u;
const LONG = 2u;

// As large as the footprint where the map shrinks, and fading to a point where it does not.
fn footprint_of(m: mat3x3f) -> Footprint {
    let x = vec2f(m[0].x, m[1].x);
    let y = vec2f(m[0].y, m[1].y);
    let a = dot(x, x);
    let b = dot(x, y);
    let c = dot(y, y);
    let spread = sqrt((a - c) * (a - c) + 4.0 * b * b);
    var major = 0.5 * (a + c + spread);
    var minor = 0.5 * (a + c - spread);
    let fade = select(FADE_AUTO, FADE_ANTIALIAS, FILTER == ANTIALIAS);
    let shrinking = clamp((major - fade.x) / (fade.y - fade.x), 0.0, 1.0);
    major *= shrinking;
    minor = max(minor, 0.0) * shrinking;
    let xx = a * shrinking;
    let xy = b * shrinking;
    let yy = c * shrinking;
    let box = sqrt(vec2f(xx, yy));
    var kind = LONG;
    if (major <= WIDEST * WIDEST && abs(xy) <= OBLIQUE) {
        kind = select(BOX, POINT, all(box < vec2f(FINEST)));
    }
    return Footprint(kind, box, vec3f(xx, xy, yy), major, minor);
}

// The integral of Catmull and Rom's kernel from 0 to t.
fn cubic_integral(t: f32) -> f32 {
    let x = min(abs(t), 2.0);
    let inner = x * (1.0 + x * x * (-5.0 / 6.0 + 0.375 * x));
    let outer = x * (2.0 + x * (-2.0 + x * (5.0 / 6.0 - 0.125 * x))) - 1.0 / 6.0;
    return sign(t) * select(outer, inner, x <= 1.0);
}

// The weights of the samples -2 to 3 under a box.
fn box_weights(part: f32, width: f32) -> array<f32, 6> {
    if (width < FINEST) {
        let w = cubic_weights(part);
        return array<f32, 6>(0.0, w.x, w.y, w.z, w.w, 0.0);
    }
    var out: array<f32, 6>;
    var total = 0.0;
    for (var k = 0; k < 6; k++) {
        let t = f32(k - 2) - part;
        out[k] = cubic_integral(t + 0.5 * width) - cubic_integral(t - 0.5 * width);
        total += out[k];
    }
    for (var k = 0; k < 6; k++) {
        out[k] /= total;
    }
    return out;
}

// The average of ``unit`` by ``unit`` samples; of many, of some of them.
fn averaged(at: vec2i, unit: i32, frame: i32) -> vec4f {
    let bits = min(firstTrailingBit(u32(unit)), COARSEST);
    let count = 1u << bits;
    let apart = unit >> bits;
    var total = vec4f(0.0);
    for (var k = 0u; k < count * count; k++) {
        let i = vec2i(vec2u(k & (count - 1u), k >> bits));
        let place = at * unit + i * apart + apart / 2;
        total += texel(place.x, place.y, frame);
    }
    return total / f32(count * count);
}

// One of them: drivers that have no registers to count through read memory instead.
fn pick(w: array<f32, 6>, k: i32) -> f32 {
    return select(select(select(select(select(w[5], w[4], k == 4), w[3], k == 3), w[2], k == 2), w[1], k == 1), w[0], k == 0);
}

fn boxed(base: vec2i, part: vec2f, box: vec2f, unit: i32, frame: i32) -> vec4f {
    let wx = box_weights(part.x, box.x);
    let wy = box_weights(part.y, box.y);
    var total = vec4f(0.0);
    for (var j = 0; j < 6; j++) {
        let down = pick(wy, j);
        if (down != 0.0) {
            var row = vec4f(0.0);
            for (var i = 0; i < 6; i++) {
                let across = pick(wx, i);
                if (across != 0.0) {
                    row += across * averaged(base + vec2i(i - 2, j - 2), unit, frame);
                }
            }
            total += down * row;
        }
    }
    return total;
}

// One box, or several along the major axis.
fn over_boxes(place: Place, over: Footprint, frame: i32) -> vec4f {
    var unit = 1;
    var count = 1.0;
    var axis = vec2f(0.0);
    var box = over.box;
    var from_ = place.base.xy;
    if (over.kind == LONG) {
        while (unit < 4096 && over.minor > WIDEST * WIDEST * f32(unit * unit)) {
            unit *= 2;
        }
        let c = over.covariance;
        axis = select(vec2f(over.major - c.z, c.y), vec2f(c.y, over.major - c.x), c.x < c.z);
        axis = select(vec2f(1.0, 0.0), normalize(axis), length(axis) > 1e-12) * sqrt(over.major);
        count = clamp(ceil(sqrt(over.major) / (1.5 * f32(unit))), 2.0, MOST_BOXES);
        // What the boxes' spread does not average, and the samples have not, is left to each box.
        let spread = 1.0 - 1.0 / (count * count);
        let had = f32(unit * unit) - 1.0;
        box = min(sqrt(max(c.xz - spread * axis * axis - had, vec2f(0.0))) / f32(unit), vec2f(WIDEST));
        // Averages lie at whole multiples of their size.
        from_ = vec2i(floor(vec2f(place.base.xy) / f32(unit)));
    }
    let part = vec2f(place.base.xy - from_ * unit) + place.part.xy;
    var total = vec4f(0.0);
    for (var k = 0.0; k < count; k += 1.0) {
        let at = (part + ((k + 0.5) / count - 0.5) * axis + 0.5) / f32(unit) - 0.5;
        total += boxed(from_ + vec2i(floor(at)), fract(at), box, unit, frame);
    }
    return total / count;
}

fn in_picture(place: Place, over: Footprint, frame: i32) -> vec4f {
    let averaging = FILTER == ANTIALIAS || FILTER == AUTO;
    if (averaging && over.kind != POINT) {
        return over_boxes(place, over, frame);
    }
    return in_frame(place.base.xy, place.part.xy, frame, averaging || FILTER == CUBIC);
}
