// Samples of float32.

@group(0) @binding(4) var voxels: texture_3d<f32>;

fn voxel(i: vec3u) -> f32 {
    return textureLoad(voxels, i, 0).x;
}
