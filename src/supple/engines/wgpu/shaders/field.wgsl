// T and its Jacobian: every stroke of a table applied to a point.
//
// With r = p' - pivot (p' is p, clamped to the domain along axes with a fixed border), s = |r|² and ρᵢ² = s + radius2ᵢ,
//     K(p) = m [ Σᵢ (pᵢ/ρᵢ + qᵢ/ρᵢ³) f + (rᵢ/ρᵢ³)(r·f) r ],  m = (1-t)³(1+3t+6t²), t = √s/R, and 0 from t = 1 on.
//
// A point is an anchor q and an offset w from it, in physical units: the accuracy of w, and of distances to pivots, in
// float32 does not depend on the distance of q from the origin. Likewise, a pivot is the sum of two numbers.

struct Stroke {
    pivot: vec3f, terms: f32,
    rest: vec4f, // of the pivot, and 1/R, which is 0 where the reach is unlimited
    force: vec4f,
    radius2: vec4f,
    p: vec4f,
    q: vec4f,
    r: vec4f,
}

struct Domain {
    first: vec4f, // the faces
    last: vec4f,
    sigma: vec4f, // of the fixed border; below 0 if it is free, and 0 for an axis without displacement
    spacing: vec4f, // and the unit of errors, see field.py
    profile: vec4f, // of the fixed border along each axis: QUARTIC or SINE
}

struct Moved {
    offset: vec3f, // of T(q + w) from q
    jacobian: mat3x3f, // ∂T/∂p, column j by the j-th coordinate
}

fn finest() -> f32 {
    return domain.spacing.w;
}

const HALF_PI = 1.5707963267948966;
const QUARTIC = 0.0;
const SINE = 1.0;
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

fn moved_by(k: u32, q: vec3f, at: Moved) -> Moved {
    let near = clamped_to_domain(q, at.offset);
    let d = (q - strokes[k].pivot) + (near - strokes[k].rest.xyz);
    let d2 = dot(d, d);
    let over = strokes[k].rest.w; // 1/R
    let t2 = d2 * over * over;
    if (t2 >= RIM) {
        return at;
    }
    let x = edge(q.x, at.offset.x, 0u);
    let y = edge(q.y, at.offset.y, 1u);
    let z = edge(q.z, at.offset.z, 2u);
    let beta = vec3f(x.x, y.x, z.x);
    let slope = vec3f(x.y, y.y, z.y);
    let inside = vec3f(x.z, y.z, z.z);
    let f = strokes[k].force.xyz;
    var a = 0.0;
    var b = 0.0;
    var da = 0.0;
    var db = 0.0;
    for (var m = 0u; m < u32(strokes[k].terms); m++) {
        let p = strokes[k].p[m];
        let e = strokes[k].q[m];
        let r = strokes[k].r[m];
        let v2 = 1.0 / (d2 + strokes[k].radius2[m]);
        let v = sqrt(v2);
        let v3 = v * v2;
        a += p * v + e * v3;
        b += r * v3;
        da -= v3 * (p + 3.0 * e * v2);
        db -= 3.0 * r * v3 * v2;
    }
    // m, and 2 dm/ds = -30 t (1-t)² / R².
    let t = sqrt(t2);
    let left = 1.0 - t;
    let m_ = left * left * left * (1.0 + t * (3.0 + 6.0 * t));
    let dm = -30.0 * t * left * left * over * over;
    da = m_ * da + dm * a;
    db = m_ * db + dm * b;
    a *= m_;
    b *= m_;
    let rf = dot(d, f);
    let g = b * rf;
    let moving = a * f + g * d;
    let c = da * f + db * rf * d;
    let along = b * d;
    // Column j of β (c dᵀ + b d fᵀ + g I) + diag(β' K): 0 along j beyond a fixed face.
    var m = mat3x3f(
        inside.x * beta * (c * d.x + along * f.x),
        inside.y * beta * (c * d.y + along * f.y),
        inside.z * beta * (c * d.z + along * f.z),
    );
    let own = inside * (beta * g + slope * moving) + 1.0;
    m[0][0] += own.x;
    m[1][1] += own.y;
    m[2][2] += own.z;
    return Moved(at.offset + beta * moving, m * at.jacobian);
}

// True if a point lies outside the balls of all strokes, where T is the identity.
fn unreached(q: vec3f) -> bool {
    let near = clamped_to_domain(q, vec3f(0.0));
    for (var k = 0u; k < settings.strokes; k++) {
        let d = (q - strokes[k].pivot) + (near - strokes[k].rest.xyz);
        let over = strokes[k].rest.w;
        if (dot(d, d) * over * over < RIM) {
            return false;
        }
    }
    return true;
}

fn moved(first: u32, last: u32, q: vec3f, w: vec3f) -> Moved {
    var at = Moved(w, mat3x3f(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0));
    for (var k = first; k < last; k++) {
        at = moved_by(k, q, at);
    }
    return at;
}
