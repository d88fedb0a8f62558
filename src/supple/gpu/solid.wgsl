// T⁻¹ in a volume: solved at the nodes of a cubic lattice, and interpolated in between; see supple/cpu/solid.py.
//
// A node is four vectors: the displacement u in voxels, and the columns of ∂p/∂q.

struct Corner {
    place: u32,
    at: vec3f, // where in its cell, from 0 to 1
}

// The first node of the cell that a point lies in, given in voxels.
fn corner_of(p: vec3f) -> Corner {
    let v = clamp(p / settings.spread, vec3f(0.0), vec3f(settings.nodes - 1u));
    let i = min(vec3u(v), settings.nodes - 2u);
    return Corner(4u * ((i.z * settings.nodes.y + i.y) * settings.nodes.x + i.x), v - vec3f(i));
}

struct Between {
    shift: vec3f, // T⁻¹(q) - q, in voxels
    matrix: mat3x3f, // ∂p/∂q, in voxels a voxel
}

fn along_x(k: u32, s: f32) -> Between {
    return Between(
        bent(nodes[k].xyz, nodes[k + 4u].xyz, nodes[k + 1u].xyz, nodes[k + 5u].xyz, s, settings.spread),
        mat3x3f(
            mix(nodes[k + 1u].xyz, nodes[k + 5u].xyz, s),
            mix(nodes[k + 2u].xyz, nodes[k + 6u].xyz, s),
            mix(nodes[k + 3u].xyz, nodes[k + 7u].xyz, s),
        ),
    );
}

// T⁻¹ at a point, given in voxels.
fn between(p: vec3f) -> Between {
    let corner = corner_of(p);
    let down = 4u * settings.nodes.x;
    let deep = down * settings.nodes.y;
    let s = corner.at;
    let a = along_x(corner.place, s.x);
    let b = along_x(corner.place + down, s.x);
    let c = along_x(corner.place + deep, s.x);
    let d = along_x(corner.place + deep + down, s.x);
    let m = a.matrix + s.y * (b.matrix - a.matrix);
    let n = c.matrix + s.y * (d.matrix - c.matrix);
    let near = bent(a.shift, b.shift, a.matrix[1], b.matrix[1], s.y, settings.spread);
    let far = bent(c.shift, d.shift, c.matrix[1], d.matrix[1], s.y, settings.spread);
    return Between(bent(near, far, m[2], n[2], s.z, settings.spread), m + s.z * (n - m));
}
