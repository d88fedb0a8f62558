// T and its Jacobian: every stroke of a table applied to a point; see supple/cpu/field.py for the equations.
//
// A point is an anchor q and an offset w from it, in physical units: what float32 keeps of w, and of distances to
// pivots, does not depend on how far from the origin q lies. A pivot is the sum of two numbers for the same reason.

struct Stroke {
    pivot: vec3f, terms: f32,
    rest: vec4f,
    force: vec4f,
    radius2: vec4f,
    p: vec4f,
    q: vec4f,
    r: vec4f,
}

struct Domain {
    extent: vec4f,
    sigma: vec4f, // of the fixed border; below 0 where it is free, and 0 where nothing moves along an axis
    spacing: vec4f, // and the smallest that counts, see field.py
}

struct Moved {
    offset: vec3f, // of T(q + w) from q
    jacobian: mat3x3f, // ∂T/∂p, column j by the j-th coordinate
}

fn finest() -> f32 {
    return domain.spacing.w;
}

const HALF_PI = 1.5707963267948966;

// β, β', the offset of the nearest point of the domain, and 1 where that is the point itself.
fn edge(q: f32, w: f32, extent: f32, sigma: f32) -> vec4f {
    if (sigma < 0.0) {
        return vec4f(1.0, 0.0, w, 1.0);
    }
    if (sigma == 0.0) {
        return vec4f(0.0, 0.0, -q, 0.0);
    }
    let left = q + w;
    let right = (extent - q) - w;
    let near = clamp(w, -q, extent - q);
    let scale = HALF_PI / sigma;
    let angle = clamp(min(left, right), 0.0, sigma) * scale;
    let inside = select(0.0, 1.0, left >= 0.0 && right >= 0.0);
    return vec4f(sin(angle), select(-scale, scale, left < right) * cos(angle), near, inside);
}

fn moved_by(k: u32, q: vec3f, at: Moved) -> Moved {
    let x = edge(q.x, at.offset.x, domain.extent.x, domain.sigma.x);
    let y = edge(q.y, at.offset.y, domain.extent.y, domain.sigma.y);
    let z = edge(q.z, at.offset.z, domain.extent.z, domain.sigma.z);
    let beta = vec3f(x.x, y.x, z.x);
    let slope = vec3f(x.y, y.y, z.y);
    let inside = vec3f(x.w, y.w, z.w);
    let d = (q - strokes[k].pivot) + (vec3f(x.z, y.z, z.z) - strokes[k].rest.xyz);
    let f = strokes[k].force.xyz;
    let d2 = dot(d, d);
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
    let rf = dot(d, f);
    let g = b * rf;
    let moving = a * f + g * d;
    let c = da * f + db * rf * d;
    let along = b * d;
    // Column j of β (c dᵀ + b d fᵀ + g I) + diag(β' K): nothing changes along j beyond a fixed face.
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

fn moved(first: u32, last: u32, q: vec3f, w: vec3f) -> Moved {
    var at = Moved(w, mat3x3f(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0));
    for (var k = first; k < last; k++) {
        at = moved_by(k, q, at);
    }
    return at;
}
