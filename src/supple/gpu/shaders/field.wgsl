// T and its Jacobian: every stroke of a table applied to a point.
//
// With r = p' - pivot (p' is p, clamped to the domain along axes with a fixed border), s = |r|² and ρᵢ² = s + eᵢ,
//     K(p) = m [ A v + B (r·v) r ],  A = Σᵢ pᵢ wᵢⁿ + qᵢ wᵢⁿ⁺²,  B = Σᵢ rᵢ wᵢⁿ⁺²,  wᵢ = √eᵢ / ρᵢ,
// and m = (1-t)³(1+3t+6t²), t = √s/R, and 0 from t = 1 on. A grab has n = 1 and v = f; the brushes that are affine at
// their pivot have n = 3 and v = M r. A twist turns r by the angle m A about an axis, with M r the cross product of
// both, and `turn` multiplies the components of its displacement. Strokes that are joined to the one before them act at
// the same point as that. With a freeze mask (freeze.wgsl), K is multiplied by its m as well. In a clip, r is stretched
// along time, and with a plateau multiplied by h; see _core/stroke.hpp.
//
// A point is an anchor q and an offset w from it, in physical units: the accuracy of w, and of distances to pivots, in
// float32 does not depend on the distance of q from the origin. Likewise, a pivot is the sum of two numbers.

#use freeze

var<uniform> domain: Domain;
var<storage, read> strokes: array<Stroke>;

override GRABS: bool = false; // true if all strokes are grabs, one after the other

struct Stroke {
    pivot: vec3f, terms: f32,
    rest: vec4f, // the rest of the pivot; and 1/R, or 0 without a limit; with a plateau, 1/g(R)
    metric: vec4f, // the scale of the third axis; 1 if the r beside B has that axis, or 0; a plateau's radius, and rim
    force: vec3f, power: f32, // n
    matrix: mat3x3f,
    radius2: vec4f,
    p: vec4f,
    q: vec4f,
    r: vec4f,
    turn: vec3f, joined: u32,
}

struct Domain {
    first: vec4f, // the faces
    last: vec4f,
    sigma: vec4f, // of the fixed border; below 0 if it is free, and 0 for an axis without displacement
    spacing: vec4f, // and the unit of errors, see field.py
    profile: vec4f, // of the fixed border along each axis: QUARTIC or SINE
    mask_size: vec4f, // coefficients of the freeze mask along each axis
    mask_first: vec4f, // the position of the first one, and the step from one to the next: each the sum of two numbers,
    mask_step: vec4f, // of which the step's first has so few bits that any number of them is exact
    mask_first_rest: vec4f,
    mask_step_rest: vec4f,
    mask_per_step: vec4f, // 1 / step; 0 along an axis of one coefficient
}

struct Moved {
    offset: vec3f, // of T(q + w) from q
    jacobian: mat3x3f, // ∂T/∂p, column j by the j-th coordinate
}

fn finest() -> f32 {
    return domain.spacing.w;
}

const IDENTITY = mat3x3f(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
const HALF_PI = 1.5707963267948966;
// t² from which on the displacement is 0: m is below 1e-14 there, less than the rounding of t in float32.
const RIM = 0.99999;

// The offset from q to the nearest point of the domain.
fn clamped(q: f32, w: f32, axis: u32) -> f32 {
    if (domain.sigma[axis] < 0.0) {
        return w;
    }
    return clamp(w, domain.first[axis] - q, domain.last[axis] - q);
}

fn clamped_to_domain(q: vec3f, w: vec3f) -> vec3f {
    return vec3f(clamped(q.x, w.x, 0u), clamped(q.y, w.y, 1u), clamped(q.z, w.z, 2u));
}

// β, β', and 1 if the point q + w lies in the domain.
fn edge(q: f32, w: f32, axis: u32) -> vec3f {
    let sigma = domain.sigma[axis];
    if (sigma < 0.0) {
        return vec3f(1.0, 0.0, 1.0);
    }
    if (sigma == 0.0) {
        return vec3f(0.0, 0.0, 1.0);
    }
    let left = (q - domain.first[axis]) + w;
    let right = (domain.last[axis] - q) - w;
    let inside = select(0.0, 1.0, left >= 0.0 && right >= 0.0);
    let side = select(-1.0, 1.0, left < right) / sigma;
    let t = clamp(min(left, right) / sigma, 0.0, 1.0);
    if (domain.profile[axis] == SINE) {
        return vec3f(sin(HALF_PI * t), side * HALF_PI * cos(HALF_PI * t), inside);
    }
    return vec3f(t * (2.0 + t * t * (t - 2.0)), side * (2.0 + t * t * (4.0 * t - 6.0)), inside);
}

// sin(x) on [0, π/2] by its Taylor series: the built-in one is less accurate with some drivers.
fn sine(x: f32) -> f32 {
    let t = x * x;
    let y = 2.7557319e-6 - t * (2.5052108e-8 - t * 1.6059044e-10);
    return x - x * t * (1.6666667e-1 - t * (8.3333333e-3 - t * (1.9841270e-4 - t * y)));
}

// The sine and the cosine of half an angle, up to a common sign.
fn half_turn(angle: f32) -> vec2f {
    let turns = round(angle / (4.0 * HALF_PI));
    // π as the sum of two numbers, of which the first times a small whole number is exact.
    let t = (0.5 * angle - turns * 3.140625) - turns * 9.6765359e-4;
    return vec2f(sine(t), sine(HALF_PI - abs(t)));
}

// A, B and twice their derivatives by s, times m.
fn profile_of(k: u32, d2: f32) -> vec4f {
    let affine = !GRABS && strokes[k].power == 3.0;
    let over = strokes[k].rest.w; // 1/R
    let n = select(1.0, 3.0, affine);
    var a = 0.0;
    var b = 0.0;
    var da = 0.0;
    var db = 0.0;
    for (var m = 0u; m < u32(strokes[k].terms); m++) {
        let e = strokes[k].radius2[m];
        let over_rho2 = 1.0 / (d2 + e);
        let w2 = e * over_rho2;
        var w = sqrt(w2);
        if (affine) {
            w *= w2;
        }
        let p = strokes[k].p[m] * w;
        let q_ = strokes[k].q[m] * w * w2;
        let r = strokes[k].r[m] * w * w2;
        a += p + q_;
        b += r;
        da -= over_rho2 * (n * p + (n + 2.0) * q_);
        db -= over_rho2 * (n + 2.0) * r;
    }
    // m, and 2 dm/ds = -30 t (1-t)² / R².
    let t = min(sqrt(d2) * over, 1.0);
    let left = 1.0 - t;
    let m_ = left * left * left * (1.0 + t * (3.0 + 6.0 * t));
    let dm = -30.0 * t * left * left * over * over;
    return vec4f(m_ * a, m_ * b, m_ * da + dm * a, m_ * db + dm * b);
}

// The vector from a stroke's pivot to q + w, in the stroke's metric.
fn from_pivot(k: u32, q: vec3f, w: vec3f) -> vec3f {
    let d = (q - strokes[k].pivot) + (w - strokes[k].rest.xyz);
    return vec3f(d.xy, d.z * strokes[k].metric.x);
}

// h of a plateau at a distance ρ, and h'/ρ.
fn eased(flat_: f32, rho: f32) -> vec2f {
    let x = max(rho - flat_, 0.0);
    let over = 1.0 / (x + 0.5 * flat_);
    let h = x * x * over / rho;
    return vec2f(h, (x * (x + flat_) * over * over - h) / (rho * rho));
}

// A point and its Jacobian after stroke k, which acts at `start`: the point before the strokes that it is joined to.
fn moved_by(k: u32, q: vec3f, start: Moved, at: Moved) -> Moved {
    let near = clamped_to_domain(q, start.offset);
    let r = from_pivot(k, q, near);
    let metric = strokes[k].metric;
    var ease = vec2f(1.0, 0.0);
    if (metric.z > 0.0) {
        ease = eased(metric.z, max(length(r), 1e-12));
    }
    let d = ease.x * r;
    let d2 = dot(d, d);
    let over = strokes[k].rest.w; // 1/R
    let t2 = d2 * over * over;
    if (t2 >= RIM) {
        return at;
    }
    let x = edge(q.x, start.offset.x, 0u);
    let y = edge(q.y, start.offset.y, 1u);
    let z = edge(q.z, start.offset.z, 2u);
    let beta = vec3f(x.x, y.x, z.x);
    let slope = vec3f(x.y, y.y, z.y);
    let inside = vec3f(x.z, y.z, z.z);
    let affine = !GRABS && strokes[k].power == 3.0;
    let profile = profile_of(k, d2);
    let a = profile.x;
    let b = profile.y;
    let da = profile.z;
    let db = profile.w;
    var v = strokes[k].force;
    if (affine) {
        v = strokes[k].matrix * d;
    }
    let own_axes = vec3f(1.0, 1.0, metric.y);
    let e = own_axes * d; // the r beside B
    let rv = dot(e, v);
    var g = b * rv * own_axes;
    var moving = a * v + b * rv * e;
    let c = da * v + db * rv * e;
    let along = b * e;
    // Column j of β (c dᵀ + b d (v + Mᵀd)ᵀ + A M + g I) + diag(β' K): 0 along j beyond a fixed face.
    var m = mat3x3f(c * d.x + along * v.x, c * d.y + along * v.y, c * d.z + along * (metric.y * v.z));
    if (affine && strokes[k].turn.x > 0.0) {
        let half = half_turn(a);
        let turn = strokes[k].turn;
        let cross_ = strokes[k].matrix;
        let rotation = 2.0 * half.x * (half.y * cross_ + half.x * cross_ * cross_); // minus I
        moving = turn * (rotation * d);
        let way = da * turn * (v + rotation * v);
        m = mat3x3f(turn * rotation[0] + way * d.x, turn * rotation[1] + way * d.y, turn * rotation[2] + way * d.z);
    } else if (affine) {
        let bent = e * strokes[k].matrix;
        m += a * strokes[k].matrix + mat3x3f(along * bent.x, along * bent.y, along * bent.z);
    }
    if (metric.z > 0.0) {
        m += mat3x3f(g.x, 0.0, 0.0, 0.0, g.y, 0.0, 0.0, 0.0, g.z);
        let mr = m * r;
        m = ease.x * m + ease.y * mat3x3f(mr * r.x, mr * r.y, mr * r.z);
        g = vec3f(0.0);
    }
    let back = vec3f(1.0, 1.0, 1.0 / metric.x);
    m = mat3x3f(back * m[0], back * m[1], metric.x * back * m[2]);
    moving *= back;
    if (FROZEN) {
        let free = freed(q, near);
        m = free.m * m + mat3x3f(free.slope.x * moving, free.slope.y * moving, free.slope.z * moving);
        g *= free.m;
        moving *= free.m;
    }
    m = mat3x3f(inside.x * beta * m[0], inside.y * beta * m[1], inside.z * beta * m[2]);
    let own = inside * (beta * g + slope * moving);
    m[0][0] += own.x;
    m[1][1] += own.y;
    m[2][2] += own.z;
    return Moved(at.offset + beta * moving, at.jacobian + m * start.jacobian);
}

fn moved(first: u32, last: u32, q: vec3f, w: vec3f) -> Moved {
    var at = Moved(w, IDENTITY);
    var start = at;
    for (var k = first; k < last; k++) {
        if (GRABS || strokes[k].joined == 0u) {
            start = at;
        }
        at = moved_by(k, q, start, at);
    }
    return at;
}
