// Unsigned samples of 8 or 16 bits.

@group(0) @binding(4) var voxels: texture_3d<u32>;

fn voxel(i: vec3u) -> f32 {
    return f32(textureLoad(voxels, i, 0).x);
}
