// The length scale of the map, for checks of lattices; see _core/plan.hpp.

#use field

const RESERVE = 2.0;
const ROUGH = 3.0; // with a freeze mask: a spline, whose derivatives jump

// From physical units to pixels.
fn in_pixels(matrix: mat3x3f) -> mat3x3f {
    var m: mat3x3f;
    for (var c = 0u; c < 3u; c++) {
        m[c] = matrix[c] * domain.spacing[c] / domain.spacing.xyz;
    }
    return m;
}

fn reserve() -> f32 {
    return select(RESERVE, ROUGH, FROZEN);
}

fn norm_of(m: mat3x3f) -> f32 {
    return sqrt(dot(m[0], m[0]) + dot(m[1], m[1]) + dot(m[2], m[2]));
}

// The length scale of the map at a point, in pixels: a stroke varies over ρ, a twist over a radian of its turn, and its
// border, along each axis by itself, over σ or the distance to it, and a freeze mask as far as it is smooth; all are
// scaled by the derivative of the stroke's input with respect to q.
fn smoothness(q: vec3f, w: vec3f, m: mat3x3f) -> f32 {
    var at = Moved(w, IDENTITY);
    var start = at;
    var least = 1e30;
    for (var k = 0u; k < settings.strokes; k++) {
        if (GRABS || strokes[k].joined == 0u) {
            start = at;
        }
        let x = start.jacobian * (m[0] * domain.spacing.xyz);
        let y = start.jacobian * (m[1] * domain.spacing.xyz);
        let d = from_pivot(k, q, start.offset);
        let longer = vec3f(1.0, 1.0, strokes[k].metric.x);
        let u = longer * x;
        let v = longer * y;
        var scale2 = dot(d, d) + strokes[k].radius2.x;
        let flat_ = strokes[k].metric.z;
        if (flat_ > 0.0) {
            let rho = max(length(d), 1e-12);
            let g = eased(flat_, rho).x * rho;
            let near = abs(rho - flat_) + strokes[k].metric.w;
            scale2 = min(g * g + strokes[k].radius2.x, near * near);
        }
        least = min(least, sqrt(scale2 / max(dot(u, u), dot(v, v))));
        if (!GRABS && strokes[k].turn.x > 0.0) {
            let steep = abs(profile_of(k, dot(d, d)).z) * max(abs(dot(d, u)), abs(dot(d, v)));
            least = min(least, 1.0 / max(steep, 1e-12));
        }
        if (FROZEN) {
            let near = clamped_to_domain(q, start.offset);
            least = min(least, smoothness_of_mask(q, near) / sqrt(max(dot(x, x), dot(y, y))));
        }
        let along = max(abs(x), abs(y));
        let place = q + start.offset;
        for (var axis = 0u; axis < 3u; axis++) {
            if (domain.sigma[axis] > 0.0) {
                let depth = min(place[axis] - domain.first[axis], domain.last[axis] - place[axis]);
                let distance_ = max(domain.sigma[axis], depth);
                least = min(least, 2.0 * distance_ / max(along[axis], 1e-12));
            }
        }
        at = moved_by(k, q, start, at);
    }
    return least;
}
