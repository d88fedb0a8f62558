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

// The voxels around a point of the box, from the first one, and how far the point is from that.
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

// The voxels before, at both sides of, and behind a point, along each axis.
struct Around {
    a: vec3u,
    b: vec3u,
    c: vec3u,
    d: vec3u,
}

// The difference over two voxels along an axis, in the row of voxels through one of those around.
fn rise(at: vec3u, axis: vec3<bool>, around: Around, s: f32) -> f32 {
    let a = voxel_of(select(at, around.a, axis));
    let b = voxel_of(select(at, around.b, axis));
    let c = voxel_of(select(at, around.c, axis));
    let d = voxel_of(select(at, around.d, axis));
    return mix(c - a, d - b, s);
}

// The slope along an axis, between rows of voxels along it that are apart along u and v; the parts of the way along all.
fn slope_along(axis: vec3<bool>, u: vec3<bool>, v: vec3<bool>, around: Around, part: vec3f) -> f32 {
    let b = around.b;
    let c = around.c;
    let near = mix(rise(b, axis, around, part.x), rise(select(b, c, u), axis, around, part.x), part.y);
    let far = mix(rise(select(b, c, v), axis, around, part.x), rise(c, axis, around, part.x), part.y);
    return mix(near, far, part.z);
}

// The gradient by central differences of `sample_at`, for each voxel: it reads 32 voxels.
fn slopes_at(p: vec3f) -> vec3f {
    if (LABELLED) {
        return label_slopes_at(p);
    }
    let last = vec3i(settings.size) - 1;
    let whole = clamp(floor(p), vec3f(-2.0), vec3f(last + 1));
    let i = vec3i(whole);
    let f = clamp(p - whole, vec3f(0.0), vec3f(1.0));
    let a = vec3u(clamp(i - 1, vec3i(0), last));
    let b = vec3u(clamp(i, vec3i(0), last));
    let c = vec3u(clamp(i + 1, vec3i(0), last));
    let around = Around(a, b, c, vec3u(clamp(i + 2, vec3i(0), last)));
    let x = vec3<bool>(true, false, false);
    let y = vec3<bool>(false, true, false);
    let z = vec3<bool>(false, false, true);
    return 0.5 * vec3f(
        slope_along(x, y, z, around, f.xyz), slope_along(y, x, z, around, f.yxz), slope_along(z, x, y, around, f.zxy),
    );
}

// The sample of a copy of the volume: labels are those of the nearest voxel, as `supple warp --labels` has it.
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

const SPLINE = 6u; // voxels that a spline reaches

// A cubic B-spline at x, and its slope.
fn bspline(x: f32) -> vec2f {
    let away = abs(x);
    let rest = max(2.0 - away, 0.0);
    let inner = vec2f((4.0 - 3.0 * away * away * rest) / 6.0, x * (1.5 * away - 2.0));
    return select(vec2f(rest * rest * rest / 6.0, -0.5 * sign(x) * rest * rest), inner, away < 1.0);
}

// The gradient of how far the label at a point reaches, for each voxel: it reads 224 voxels.
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
