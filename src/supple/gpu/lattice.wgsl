// T⁻¹ on planes: solved at nodes STEP pixels apart, and interpolated in between; see supple/cpu/solid.py.
//
// A node is four vectors: the displacement u in pixels, with the node's own error, and the columns of ∂p/∂q, with the
// length in pixels over which the map can be smooth there.

struct Source {
    shift: vec3f, // u, in pixels
    matrix: mat3x3f, // ∂p/∂q, in pixels a pixel
}

// The four nodes around a cell: above and below, each the left and the right one.
struct Patch {
    p: Source,
    q: Source,
    r: Source,
    o: Source,
}

// Where one of the four vectors of a node is written: each has a layer, of rows of whole 256 bytes.
fn place_of_node(i: vec2u, plane: u32, k: u32) -> u32 {
    let pitch = (settings.nodes.x + 15u) & ~15u;
    return ((4u * plane + k) * settings.nodes.y + i.y) * pitch + i.x;
}

// And where it is read.
fn known_at(i: vec2u, plane: u32, k: u32) -> vec4f {
    return textureLoad(lattice, i, 4u * plane + k, 0);
}

fn node_at(i: vec2u, plane: u32) -> Source {
    return Source(
        known_at(i, plane, 0u).xyz,
        mat3x3f(known_at(i, plane, 1u).xyz, known_at(i, plane, 2u).xyz, known_at(i, plane, 3u).xyz),
    );
}

fn patch_at(i: vec2u, plane: u32) -> Patch {
    return Patch(
        node_at(i, plane),
        node_at(i + vec2u(1u, 0u), plane),
        node_at(i + vec2u(0u, 1u), plane),
        node_at(i + vec2u(1u, 1u), plane),
    );
}

// At a place in the cell, from 0 to 1.
fn between_nodes(cell: Patch, at: vec2f) -> Source {
    let s = at.x;
    let upper = bent(cell.p.shift, cell.q.shift, cell.p.matrix[0], cell.q.matrix[0], s, f32(STEP));
    let lower = bent(cell.r.shift, cell.o.shift, cell.r.matrix[0], cell.o.matrix[0], s, f32(STEP));
    let above = cell.p.matrix + s * (cell.q.matrix - cell.p.matrix);
    let below = cell.r.matrix + s * (cell.o.matrix - cell.r.matrix);
    return Source(bent(upper, lower, above[1], below[1], at.y, f32(STEP)), above + at.y * (below - above));
}

// How far from the true T⁻¹(q) a source point is, in pixels, to first order.
fn error_at(q: vec3f, source: Source) -> f32 {
    let at = moved(0u, settings.strokes, q, source.shift * domain.spacing.xyz);
    return length(source.matrix * (at.offset / domain.spacing.xyz));
}

@compute @workgroup_size(8, 8)
fn solve(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= settings.nodes.x || id.y >= settings.nodes.y) {
        return;
    }
    let pixel = (id.xy + vec2u(0u, settings.origin)) * STEP;
    let q = vec3f(vec2f(pixel), f32(settings.first + id.z)) * domain.spacing.xyz;
    let found = undo(q, 1e-3 * finest());
    let m = in_pixels(found.matrix);
    nodes[place_of_node(id.xy, id.z, 0u)] = vec4f(found.offset / domain.spacing.xyz, norm_of(m) * found.residual / finest());
    let smooth_ = smoothness(q, found.offset, m);
    for (var c = 0u; c < 3u; c++) {
        nodes[place_of_node(id.xy, id.z, 1u + c)] = vec4f(m[c], smooth_);
    }
}

// Which cells interpolate well enough: their error, as far as it is seen, with a reserve.
@compute @workgroup_size(8, 8)
fn check(@builtin(global_invocation_id) id: vec3u) {
    let cells = settings.nodes - 1u;
    if (id.x >= cells.x || id.y >= cells.y) {
        return;
    }
    let patch_ = patch_at(id.xy, id.z);
    // What is seen at points says little where the map varies between them.
    var found = 0.0;
    var fine = true;
    for (var k = 0u; k < 4u; k++) {
        let node = id.xy + vec2u(k & 1u, k >> 1u);
        let error = known_at(node, id.z, 0u).w;
        found = max(found, error);
        fine = fine && error <= settings.tolerance && f32(STEP) <= RESOLVED * known_at(node, id.z, 1u).w;
    }
    for (var k = 0u; k < 8u; k++) {
        let at = SEEN[k];
        let p = (vec2f(id.xy + vec2u(0u, settings.origin)) + at) * f32(STEP);
        let q = vec3f(p, f32(settings.first + id.z)) * domain.spacing.xyz;
        let error = RESERVE * error_at(q, between_nodes(patch_, at));
        found = max(found, error);
        fine = fine && error <= settings.tolerance; // and never so if it is not a number
    }
    let cell = (id.z * cells.y + id.y) * cells.x + id.x;
    errors[cell] = select(1e30, found, fine);
    if (!fine) {
        rough[4u + atomicAdd(&stats[2], 1u)] = cell;
    }
}

// How many workgroups the cells take that were found too coarse.
@compute @workgroup_size(1)
fn count() {
    let n = atomicLoad(&stats[2]);
    rough[0] = min(n, MOST_GROUPS);
    rough[1] = (n + MOST_GROUPS - 1u) / MOST_GROUPS;
    rough[2] = 1u;
    rough[3] = n;
}

const MOST_GROUPS = 65535u;

const SEEN = array<vec2f, 8>(
    vec2f(0.5, 0.5), vec2f(0.5, 0.0), vec2f(0.0, 0.5), vec2f(0.25, 0.25),
    vec2f(0.75, 0.25), vec2f(0.25, 0.75), vec2f(0.75, 0.75), vec2f(0.5, 0.25),
);
