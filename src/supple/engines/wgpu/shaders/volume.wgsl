// Samples of a volume between its voxels, and their slopes; see _core/voxels.hpp.

@group(0) @binding(5) var warped: texture_3d<f32>; // the buffer of a deformed volume

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
