// Samples of a volume between its voxels, and their slopes; see supple/cpu/voxels.py.

@group(0) @binding(5) var warped: texture_3d<f32>; // the buffer of a deformed one

override SAMPLED: u32 = 0u; // which of the two

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

// The gradient by central differences, for each voxel.
fn slopes_at(p: vec3f, of_buffer: bool) -> vec3f {
    let x = vec3f(1.0, 0.0, 0.0);
    let y = vec3f(0.0, 1.0, 0.0);
    let z = vec3f(0.0, 0.0, 1.0);
    return 0.5 * vec3f(
        sample_at(p + x, of_buffer) - sample_at(p - x, of_buffer),
        sample_at(p + y, of_buffer) - sample_at(p - y, of_buffer),
        sample_at(p + z, of_buffer) - sample_at(p - z, of_buffer),
    );
}
