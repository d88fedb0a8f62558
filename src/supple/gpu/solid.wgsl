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

struct Edge {
    shift: vec3f,
    down: vec3f,
    deep: vec3f,
}

fn along_x(k: u32, s: f32) -> Edge {
    return Edge(
        bent(nodes[k].xyz, nodes[k + 4u].xyz, nodes[k + 1u].xyz, nodes[k + 5u].xyz, s, settings.spread),
        mix(nodes[k + 2u].xyz, nodes[k + 6u].xyz, s),
        mix(nodes[k + 3u].xyz, nodes[k + 7u].xyz, s),
    );
}

// T⁻¹(q) - q, in voxels.
fn displacement(p: vec3f) -> vec3f {
    let corner = corner_of(p);
    let down = 4u * settings.nodes.x;
    let deep = down * settings.nodes.y;
    let s = corner.at;
    let a = along_x(corner.place, s.x);
    let b = along_x(corner.place + down, s.x);
    let c = along_x(corner.place + deep, s.x);
    let d = along_x(corner.place + deep + down, s.x);
    let near = bent(a.shift, b.shift, a.down, b.down, s.y, settings.spread);
    let far = bent(c.shift, d.shift, c.down, d.down, s.y, settings.spread);
    return bent(near, far, mix(a.deep, b.deep, s.y), mix(c.deep, d.deep, s.y), s.z, settings.spread);
}

fn slopes_between(k: u32, s: f32) -> mat3x3f {
    return mat3x3f(
        mix(nodes[k + 1u].xyz, nodes[k + 5u].xyz, s),
        mix(nodes[k + 2u].xyz, nodes[k + 6u].xyz, s),
        mix(nodes[k + 3u].xyz, nodes[k + 7u].xyz, s),
    );
}

// ∂p/∂q, in voxels a voxel.
fn matrix_at(p: vec3f) -> mat3x3f {
    let corner = corner_of(p);
    let down = 4u * settings.nodes.x;
    let deep = down * settings.nodes.y;
    let s = corner.at;
    let a = slopes_between(corner.place, s.x);
    let b = slopes_between(corner.place + down, s.x);
    let c = slopes_between(corner.place + deep, s.x);
    let d = slopes_between(corner.place + deep + down, s.x);
    let near = a + s.y * (b - a);
    let far = c + s.y * (d - c);
    return near + s.z * (far - near);
}
