// Samples of a volume between its voxels, and their slopes; see _core/voxels.hpp.

@group(0) @binding(5) var warped: texture_3d<f32>; // the buffer of a deformed volume
@group(0) @binding(13) var paint: texture_3d<f32>; // colours of voxels, sRGB and opacity

override LABELLED: bool = false; // true if samples are numbers of labels, which are not mixed
override COLOURED: bool = false; // true if voxels have colours of their own
override SAMPLED: u32 = 0u; // the volume that is sampled

const GIVEN = 0u;
const WARPED = 1u;
const EITHER = 2u;

fn voxel_of(i: vec3u, of_buffer: bool) -> f32 {
    if (SAMPLED == GIVEN) {
        return voxel(i);
    }
    if (SAMPLED == WARPED || of_buffer) {
        return textureLoad(warped, i, 0).x;
    }
    return voxel(i);
}

// The trilinear sample at a point, in voxels; outside, that at the nearest point of the box.
fn sample_at(p: vec3f, of_buffer: bool) -> f32 {
    if (LABELLED) {
        return label_at(p, of_buffer);
    }
    let kept = clamp(p, vec3f(0.0), vec3f(settings.size - 1u));
    let i = min(vec3u(kept), settings.size - 2u);
    let f = kept - vec3f(i);
    let j = i + 1u;
    let near = mix(
        mix(voxel_of(i, of_buffer), voxel_of(vec3u(j.x, i.y, i.z), of_buffer), f.x),
        mix(voxel_of(vec3u(i.x, j.y, i.z), of_buffer), voxel_of(vec3u(j.x, j.y, i.z), of_buffer), f.x),
        f.y,
    );
    let far = mix(
        mix(voxel_of(vec3u(i.x, i.y, j.z), of_buffer), voxel_of(vec3u(j.x, i.y, j.z), of_buffer), f.x),
        mix(voxel_of(vec3u(i.x, j.y, j.z), of_buffer), voxel_of(j, of_buffer), f.x),
        f.y,
    );
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
fn rise(at: vec3u, axis: vec3<bool>, around: Around, s: f32, of_buffer: bool) -> f32 {
    let a = voxel_of(select(at, around.a, axis), of_buffer);
    let b = voxel_of(select(at, around.b, axis), of_buffer);
    let c = voxel_of(select(at, around.c, axis), of_buffer);
    let d = voxel_of(select(at, around.d, axis), of_buffer);
    return mix(c - a, d - b, s);
}

// The gradient by central differences of `sample_at`, for each voxel: it reads 32 voxels.
fn slopes_at(p: vec3f, of_buffer: bool) -> vec3f {
    if (LABELLED) {
        return label_slopes_at(p, of_buffer);
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
        mix(
            mix(rise(b, x, around, f.x, of_buffer), rise(select(b, c, y), x, around, f.x, of_buffer), f.y),
            mix(rise(select(b, c, z), x, around, f.x, of_buffer), rise(c, x, around, f.x, of_buffer), f.y),
            f.z,
        ),
        mix(
            mix(rise(b, y, around, f.y, of_buffer), rise(select(b, c, x), y, around, f.y, of_buffer), f.x),
            mix(rise(select(b, c, z), y, around, f.y, of_buffer), rise(c, y, around, f.y, of_buffer), f.x),
            f.z,
        ),
        mix(
            mix(rise(b, z, around, f.z, of_buffer), rise(select(b, c, x), z, around, f.z, of_buffer), f.x),
            mix(rise(select(b, c, y), z, around, f.z, of_buffer), rise(c, z, around, f.z, of_buffer), f.x),
            f.y,
        ),
    );
}

// The sample of a copy of the volume: labels are those of the nearest voxel, as `supple warp --labels` has it.
fn copied_at(p: vec3f) -> f32 {
    if (LABELLED) {
        return voxel_of(vec3u(clamp(p + 0.5, vec3f(0.0), vec3f(settings.size - 1u))), false);
    }
    return sample_at(p, false);
}

// The label at a point, or 0: see Labels in _core/voxels.hpp.
fn label_at(p: vec3f, of_buffer: bool) -> f32 {
    let kept = clamp(p, vec3f(0.0), vec3f(settings.size - 1u));
    let i = min(vec3u(kept), settings.size - 2u);
    let f = kept - vec3f(i);
    var found: array<f32, 8>;
    var weights: array<f32, 8>;
    var same = true;
    var hidden = 0.0;
    for (var k = 0u; k < 8u; k++) {
        let side = vec3u(k & 1u, (k >> 1u) & 1u, k >> 2u);
        let w = select(1.0 - f, f, side == vec3u(1u));
        found[k] = voxel_of(i + side, of_buffer);
        weights[k] = w.x * w.y * w.z;
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
fn label_slopes_at(p: vec3f, of_buffer: bool) -> vec3f {
    let own = label_at(p, of_buffer);
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
            let value = voxel_of(vec3u(clamp(vec3i(first.x + i32(i), row), vec3i(0), last)), of_buffer);
            along += select(select(0.2, 1.0, value == 0.0), 0.0, value == own) * x[i];
        }
        sum -= vec3f(along.y * y.x * z.x, along.x * y.y * z.x, along.x * y.x * z.y);
    }
    return sum;
}

// The colour at a point, with the opacity of the transfer function's: see Coloured in _core/voxels.hpp.
fn painted(p: vec3f, colour: vec4f) -> vec4f {
    if (!COLOURED) {
        return colour;
    }
    let kept = clamp(p, vec3f(0.0), vec3f(settings.size - 1u));
    let i = min(vec3u(kept), settings.size - 2u);
    let f = kept - vec3f(i);
    var sum = vec4f(0.0);
    for (var k = 0u; k < 8u; k++) {
        let side = vec3u(k & 1u, (k >> 1u) & 1u, k >> 2u);
        let w = select(1.0 - f, f, side == vec3u(1u));
        let found = textureLoad(paint, i + side, 0);
        sum += w.x * w.y * w.z * found.w * vec4f(found.xyz, 1.0);
    }
    let u = sum.xyz / max(sum.w, 1e-6);
    return vec4f(select(pow((u + 0.055) / 1.055, vec3f(2.4)), u / 12.92, u <= vec3f(0.04045)), colour.w);
}
