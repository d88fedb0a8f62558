// T⁻¹ in a volume: solved at the nodes of a cubic lattice, and interpolated in between.
//
// A node is four vectors: the displacement u in voxels, and the columns of ∂p/∂q. So only the nodes of a cell are read,
// and the error falls at least with the cube of its size. The vectors lie two by two in the texture, so that none of
// its sides is more than twice as long as there are nodes along it.

#use blend

var lattice: texture_3d<f32>;

fn node_at(i: vec3u, k: u32) -> vec3f {
    return textureLoad(lattice, vec3u(i.x, 2u * i.y + (k & 1u), 2u * i.z + (k >> 1u)), 0).xyz;
}

struct Between {
    shift: vec3f, // T⁻¹(q) - q, in voxels
    matrix: mat3x3f, // ∂p/∂q, in voxels a voxel
}

fn along_x(i: vec3u, s: f32) -> Between {
    let j = i + vec3u(1u, 0u, 0u);
    let a = node_at(i, 1u);
    let b = node_at(j, 1u);
    return Between(
        bent(node_at(i, 0u), node_at(j, 0u), a, b, s, settings.spread),
        mat3x3f(mix(a, b, s), mix(node_at(i, 2u), node_at(j, 2u), s), mix(node_at(i, 3u), node_at(j, 3u), s)),
    );
}

// T⁻¹ at a point, given in voxels.
fn between(p: vec3f) -> Between {
    // The first node of its cell, and the position in the cell, from 0 to 1.
    let v = clamp(p / settings.spread, vec3f(0.0), vec3f(settings.nodes - 1u));
    let i = min(vec3u(v), settings.nodes - 2u);
    let s = v - vec3f(i);
    let a = along_x(i, s.x);
    let b = along_x(i + vec3u(0u, 1u, 0u), s.x);
    let c = along_x(i + vec3u(0u, 0u, 1u), s.x);
    let d = along_x(i + vec3u(0u, 1u, 1u), s.x);
    let m = a.matrix + s.y * (b.matrix - a.matrix);
    let n = c.matrix + s.y * (d.matrix - c.matrix);
    let near = bent(a.shift, b.shift, a.matrix[1], b.matrix[1], s.y, settings.spread);
    let far = bent(c.shift, d.shift, c.matrix[1], d.matrix[1], s.y, settings.spread);
    return Between(bent(near, far, m[2], n[2], s.z, settings.spread), m + s.z * (n - m));
}
