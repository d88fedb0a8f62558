// T⁻¹ at a point: Newton's method with backtracking; see _core/newton.hpp.

#use field

struct Found {
    offset: vec3f, // of the source point from q
    residual: f32, // |T(p) - q| there, in physical units
    steps: f32, // evaluations of T with its Jacobian, over all strokes
    matrix: mat3x3f, // ∂p/∂q
}

fn inverse_of(m: mat3x3f) -> mat3x3f {
    let a = cross(m[1], m[2]);
    let b = cross(m[2], m[0]);
    let c = cross(m[0], m[1]);
    return transpose(mat3x3f(a, b, c)) * (1.0 / dot(m[0], a));
}

// A fixed face maps to itself: the solution is on the target's side.
fn kept_inside(q: vec3f, goal: vec3f, w: vec3f) -> vec3f {
    var out = w;
    for (var axis = 0u; axis < 3u; axis++) {
        if (domain.sigma[axis] >= 0.0) {
            let target_ = q[axis] + goal[axis];
            let beyond = target_ <= domain.first[axis] || target_ >= domain.last[axis];
            out[axis] = select(clamped(q[axis], w[axis], axis), goal[axis], beyond);
        }
    }
    return out;
}

// Solve T(q + w) = q + goal for the strokes from first to last - 1, from a guess of w.
fn newton(first: u32, last: u32, q: vec3f, goal: vec3f, guess: vec3f, tolerance: f32, limit: u32) -> Found {
    var best = Found(guess, 1e30, 0.0, IDENTITY);
    var step = vec3f(0.0);
    var part = 1.0;
    var steps = 0.0;
    for (var i = 0u; i < limit; i++) {
        let tried = kept_inside(q, goal, best.offset + part * step);
        let at = moved(first, last, q, tried);
        let error = at.offset - goal;
        let size = length(error);
        steps += 1.0;
        if (size <= best.residual * (1.0 - 1e-4 * part)) {
            let matrix = inverse_of(at.jacobian);
            step = -(matrix * error);
            best = Found(tried, size, steps, matrix);
            part = 1.0;
            if (length(step) <= tolerance) {
                best.offset = kept_inside(q, goal, tried + step); // the last step is known, and applied
                break;
            }
        } else {
            // Halve the step; end when the residual is as small as rounding allows.
            part *= 0.5;
            if (part * length(step) <= 0.01 * tolerance) {
                break;
            }
        }
    }
    best.steps = steps;
    return best;
}

// The point before twist k: q + w turned by the opposite angle, so that its way is mirrored about the plane of the axis
// and the point. That is T⁻¹ without a border and a mask, and a guess otherwise.
fn turned_back(k: u32, q: vec3f, w: vec3f) -> vec3f {
    let longer = vec3f(1.0, 1.0, strokes[k].metric.x);
    let v = strokes[k].matrix * from_pivot(k, q, w);
    let way = longer * (moved(k, k + 1u, q, w).offset - w);
    return w + (way - v * (2.0 * dot(way, v) / max(dot(v, v), 1e-30))) / longer;
}

// T⁻¹(q) without a guess: strokes, or those that act at once, undone from last to first, and polished together.
fn undo(q: vec3f, tolerance: f32) -> Found {
    let count = u32(settings.strokes);
    var w = vec3f(0.0);
    var steps = 0.0;
    for (var last = count; last > 0u;) {
        var first = last - 1u;
        while (!GRABS && first > 0u && strokes[first].joined != 0u) {
            first--;
        }
        var guess = w;
        if (!GRABS && last == first + 1u && strokes[first].turn.x > 0.0) {
            guess = turned_back(first, q, w);
        }
        let found = newton(first, last, q, w, guess, tolerance, 40u);
        last = first;
        w = found.offset;
        steps += found.steps;
    }
    var found = newton(0u, count, q, vec3f(0.0), w, tolerance, 8u);
    found.steps += steps;
    return found;
}
