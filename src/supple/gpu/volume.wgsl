// Samples of a volume between its voxels, and their slopes; see supple/cpu/voxels.py.

const BYTE = 0u;
const SIGNED_BYTE = 1u;
const SHORT = 2u;
const SIGNED_SHORT = 3u;

override FORMAT: u32;

fn voxel(i: u32) -> f32 {
    switch FORMAT {
        case BYTE: {
            return f32(extractBits(samples[i >> 2u], 8u * (i & 3u), 8u));
        }
        case SIGNED_BYTE: {
            return f32(extractBits(bitcast<i32>(samples[i >> 2u]), 8u * (i & 3u), 8u));
        }
        case SHORT: {
            return f32(extractBits(samples[i >> 1u], 16u * (i & 1u), 16u));
        }
        case SIGNED_SHORT: {
            return f32(extractBits(bitcast<i32>(samples[i >> 1u]), 16u * (i & 1u), 16u));
        }
        default: {
            return bitcast<f32>(samples[i]);
        }
    }
}

// The trilinear sample at a point, in voxels, of the volume that begins with a sample; outside, that at the nearest
// point of the box.
fn sample_at(p: vec3f, first: u32) -> f32 {
    let kept = clamp(p, vec3f(0.0), vec3f(settings.size - 1u));
    let i = min(vec3u(kept), settings.size - 2u);
    let f = kept - vec3f(i);
    let down = settings.pitch;
    let deep = settings.pitch * settings.size.y;
    let k = first + (i.z * settings.size.y + i.y) * settings.pitch + i.x;
    let near = mix(mix(voxel(k), voxel(k + 1u), f.x), mix(voxel(k + down), voxel(k + down + 1u), f.x), f.y);
    let l = k + deep;
    let far = mix(mix(voxel(l), voxel(l + 1u), f.x), mix(voxel(l + down), voxel(l + down + 1u), f.x), f.y);
    return mix(near, far, f.z);
}

// The gradient by central differences, for each voxel.
fn slopes_at(p: vec3f, first: u32) -> vec3f {
    let x = vec3f(1.0, 0.0, 0.0);
    let y = vec3f(0.0, 1.0, 0.0);
    let z = vec3f(0.0, 0.0, 1.0);
    return 0.5 * vec3f(
        sample_at(p + x, first) - sample_at(p - x, first),
        sample_at(p + y, first) - sample_at(p - y, first),
        sample_at(p + z, first) - sample_at(p - z, first),
    );
}
