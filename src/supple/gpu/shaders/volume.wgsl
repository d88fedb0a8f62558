// Samples of a volume between its voxels, and their slopes; see _core/voxels.hpp.

var voxels: texture_3d<VOXEL>;
var warped: texture_3d<f32>; // the buffer of a deformed volume

override LABELLED: bool = false; // true if samples are numbers of labels, which are not mixed
override WARPED: bool = false; // true if the buffer is sampled, and not the given volume

fn voxel_of(i: vec3u) -> f32 {
    if (WARPED) {
        return textureLoad(warped, i, 0).x;
    }
    return f32(textureLoad(voxels, i, 0).x);
}

// The first of the eight voxels around a point of the box, and the point's offset from it, from 0 to 1.
struct Cell {
    first: vec3u,
    part: vec3f,
}

fn cell_of(p: vec3f) -> Cell {
    let kept = clamp(p, vec3f(0.0), vec3f(settings.size - 1u));
    let i = min(vec3u(kept), settings.size - 2u);
    return Cell(i, kept - vec3f(i));
}

// One of the eight corners of a cell, with its weight.
struct Corner {
    at: vec3u,
    weight: f32,
}

fn corner_of(cell: Cell, k: u32) -> Corner {
    let side = vec3u(k & 1u, (k >> 1u) & 1u, k >> 2u);
    let w = select(1.0 - cell.part, cell.part, side == vec3u(1u));
    return Corner(cell.first + side, w.x * w.y * w.z);
}

// A sample between a voxel and the next one along x.
fn row_at(i: vec3u, part: f32) -> f32 {
    return mix(voxel_of(i), voxel_of(i + vec3u(1u, 0u, 0u)), part);
}

// The trilinear sample at a point, in voxels; outside, that at the nearest point of the box.
fn sample_at(p: vec3f) -> f32 {
    if (LABELLED) {
        return label_at(p);
    }
    let cell = cell_of(p);
    let i = cell.first;
    let f = cell.part;
    let below = i + vec3u(0u, 1u, 0u);
    let behind = i + vec3u(0u, 0u, 1u);
    let near = mix(row_at(i, f.x), row_at(below, f.x), f.y);
    let far = mix(row_at(behind, f.x), row_at(i + vec3u(0u, 1u, 1u), f.x), f.y);
    return mix(near, far, f.z);
}

// The weights of a cubic B-spline for the four voxels around a point, a part t of the way from the second to the third.
fn spline_weights(t: f32) -> array<f32, 4> {
    let s = 1.0 - t;
    return array(s * s * s / 6.0, (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0,
        (4.0 - 6.0 * s * s + 3.0 * s * s * s) / 6.0, t * t * t / 6.0);
}

// Its derivative: differences are taken before weights, so that it is exactly 0 if all voxels are equal.
fn change(t: f32, a: f32, b: f32, c: f32, d: f32) -> f32 {
    return (0.5 * (1.0 - t) * (1.0 - t)) * (b - a) + (0.5 + t - t * t) * (c - b) + (0.5 * t * t) * (d - c);
}

// The gradient, per voxel, of the cubic B-spline whose coefficients are the voxels: it reads 64 of them.
fn slopes_at(p: vec3f) -> vec3f {
    if (LABELLED) {
        return label_slopes_at(p);
    }
    let cell = cell_of(p);
    let first = vec3i(cell.first) - 1;
    let last = vec3i(settings.size) - 1;
    let f = cell.part;
    let down = spline_weights(f.y);
    let deep = spline_weights(f.z);
    let across = spline_weights(f.x);
    var x: array<f32, 4>;
    var sum = vec3f(0.0);
    for (var i = 0; i < 4; i++) {
        var side: array<f32, 4>;
        for (var k = 0; k < 4; k++) {
            var row: array<f32, 4>;
            for (var j = 0; j < 4; j++) {
                row[j] = voxel_of(vec3u(clamp(first + vec3i(i, j, k), vec3i(0), last)));
            }
            side[k] = down[0] * row[0] + down[1] * row[1] + down[2] * row[2] + down[3] * row[3];
            x[i] += deep[k] * side[k];
            sum.y += across[i] * deep[k] * change(f.y, row[0], row[1], row[2], row[3]);
        }
        sum.z += across[i] * change(f.z, side[0], side[1], side[2], side[3]);
    }
    sum.x = change(f.x, x[0], x[1], x[2], x[3]);
    return sum;
}

// The sample for a deformed copy of the volume: labels are the nearest voxel's, as with `supple warp --labels`.
fn copied_at(p: vec3f) -> f32 {
    if (LABELLED) {
        return voxel_of(vec3u(clamp(p + 0.5, vec3f(0.0), vec3f(settings.size - 1u))));
    }
    return sample_at(p);
}

// The label at a point, or 0: see Labels in _core/voxels.hpp.
fn label_at(p: vec3f) -> f32 {
    let cell = cell_of(p);
    var found: array<f32, 8>;
    var weights: array<f32, 8>;
    var same = true;
    var hidden = 0.0;
    for (var k = 0u; k < 8u; k++) {
        let corner = corner_of(cell, k);
        found[k] = voxel_of(corner.at);
        weights[k] = corner.weight;
        same = same && found[k] == found[0];
        hidden += select(0.0, weights[k], found[k] == 0.0);
    }
    if (same || hidden >= 0.5) {
        return select(0.0, found[0], same);
    }
    var label = 0.0;
    var most = 0.0;
    for (var k = 0u; k < 8u; k++) {
        var weight = 0.0;
        for (var j = 0u; j < 8u; j++) {
            weight += select(0.0, weights[j], found[j] == found[k]);
        }
        if (found[k] != 0.0 && (weight > most || (weight == most && found[k] <= label))) {
            most = weight;
            label = found[k];
        }
    }
    return label;
}

const SPLINE = 6u; // voxels along an axis that the spline of labels reads

// A cubic B-spline at x, and its slope.
fn bspline(x: f32) -> vec2f {
    let away = abs(x);
    let rest = max(2.0 - away, 0.0);
    let inner = vec2f((4.0 - 3.0 * away * away * rest) / 6.0, x * (1.5 * away - 2.0));
    return select(vec2f(rest * rest * rest / 6.0, -0.5 * sign(x) * rest * rest), inner, away < 1.0);
}

// The gradient, per voxel, of the smoothed indicator of the label at a point: it reads 224 voxels.
fn label_slopes_at(p: vec3f) -> vec3f {
    let own = label_at(p);
    let kept = clamp(p, vec3f(0.0), vec3f(settings.size - 1u));
    let first = vec3i(kept) + 1 - i32(SPLINE / 2u);
    let last = vec3i(settings.size) - 1;
    var x: array<vec2f, SPLINE>;
    for (var i = 0u; i < SPLINE; i++) {
        x[i] = bspline((kept.x - f32(first.x + i32(i))) * 4.0 / f32(SPLINE));
    }
    var sum = vec3f(0.0);
    for (var k = 0u; k < SPLINE * SPLINE; k++) {
        let row = first.yz + vec2i(vec2u(k % SPLINE, k / SPLINE));
        let y = bspline((kept.y - f32(row.x)) * 4.0 / f32(SPLINE));
        let z = bspline((kept.z - f32(row.y)) * 4.0 / f32(SPLINE));
        var along = vec2f(0.0);
        for (var i = 0u; i < SPLINE; i++) {
            let value = voxel_of(vec3u(clamp(vec3i(first.x + i32(i), row), vec3i(0), last)));
            along += select(select(0.2, 1.0, value == 0.0), 0.0, value == own) * x[i];
        }
        sum -= vec3f(along.y * y.x * z.x, along.x * y.y * z.x, along.x * y.x * z.y);
    }
    return sum;
}
