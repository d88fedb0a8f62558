// T⁻¹ on planes: solved at nodes STEP pixels apart; between them, a bicubic Hermite patch of values, slopes and twists.
//
// A node is four vectors: the displacement u in pixels, with the node's own error, and the columns of ∂p/∂q, whose fourth
// components are the twist ∂²p/∂x∂y.

struct Source {
    shift: vec3f, // u, in pixels
    matrix: mat3x3f, // ∂p/∂q, in pixels a pixel
}

struct Node {
    shift: vec3f,
    x: vec3f, // ∂u/∂x and ∂u/∂y
    y: vec3f,
    z: vec3f, // ∂p/∂z
    twist: vec3f,
}

// The four nodes around a cell: above and below, each the left and the right one.
struct Patch {
    p: Node,
    q: Node,
    r: Node,
    o: Node,
}

// The offset of one of the four vectors of a node: each has a layer, of rows padded to 256 bytes.
fn place_of_node(i: vec2u, plane: u32, k: u32) -> u32 {
    let pitch = (settings.nodes.x + 15u) & ~15u;
    return ((4u * plane + k) * settings.nodes.y + i.y) * pitch + i.x;
}

// The texel of that vector.
fn known_at(i: vec2u, plane: u32, k: u32) -> vec4f {
    return textureLoad(lattice, i, 4u * plane + k, 0);
}

fn node_at(i: vec2u, plane: u32) -> Node {
    let x = known_at(i, plane, 1u);
    let y = known_at(i, plane, 2u);
    let z = known_at(i, plane, 3u);
    return Node(
        known_at(i, plane, 0u).xyz, x.xyz - vec3f(1.0, 0.0, 0.0), y.xyz - vec3f(0.0, 1.0, 0.0), z.xyz,
        vec3f(x.w, y.w, z.w),
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

// The weights of two values and their slopes in Hermite's cubic, STEP apart, at 0 to 1; and their derivatives.
struct Hermite {
    value: vec4f, // of the first value and slope, and of the second ones
    slope: vec4f,
}

fn hermite(s: f32) -> Hermite {
    let h = f32(STEP);
    let r = 1.0 - s;
    let bow = 6.0 * s * r / h;
    return Hermite(
        vec4f(r * r * (1.0 + 2.0 * s), h * s * r * r, s * s * (3.0 - 2.0 * s), -h * s * s * r),
        vec4f(-bow, r * (1.0 - 3.0 * s), bow, s * (3.0 * s - 2.0)),
    );
}

fn along(weights: vec4f, a: vec3f, slope_a: vec3f, b: vec3f, slope_b: vec3f) -> vec3f {
    return weights.x * a + weights.y * slope_a + weights.z * b + weights.w * slope_b;
}

// T⁻¹ and its derivative at a point in the cell, from 0 to 1.
fn between_nodes(cell: Patch, at: vec2f) -> Source {
    let s = hermite(at.x);
    let t = hermite(at.y);
    let upper = along(s.value, cell.p.shift, cell.p.x, cell.q.shift, cell.q.x);
    let lower = along(s.value, cell.r.shift, cell.r.x, cell.o.shift, cell.o.x);
    let upper_y = along(s.value, cell.p.y, cell.p.twist, cell.q.y, cell.q.twist);
    let lower_y = along(s.value, cell.r.y, cell.r.twist, cell.o.y, cell.o.twist);
    let upper_x = along(s.slope, cell.p.shift, cell.p.x, cell.q.shift, cell.q.x);
    let lower_x = along(s.slope, cell.r.shift, cell.r.x, cell.o.shift, cell.o.x);
    let upper_xy = along(s.slope, cell.p.y, cell.p.twist, cell.q.y, cell.q.twist);
    let lower_xy = along(s.slope, cell.r.y, cell.r.twist, cell.o.y, cell.o.twist);
    return Source(
        along(t.value, upper, upper_y, lower, lower_y),
        mat3x3f(
            along(t.value, upper_x, upper_xy, lower_x, lower_xy) + vec3f(1.0, 0.0, 0.0),
            along(t.slope, upper, upper_y, lower, lower_y) + vec3f(0.0, 1.0, 0.0),
            mix(mix(cell.p.z, cell.q.z, at.x), mix(cell.r.z, cell.o.z, at.x), at.y),
        ),
    );
}

// ∂²p/∂x∂y at a solved point, in pixels: T(p(q)) = q gives J ∂²p/∂x∂y = -(∂J/∂x) ∂p/∂y, by a central difference.
fn twist_of(q: vec3f, found: Found) -> vec3f {
    let x = found.matrix[0] * domain.spacing.x;
    let y = found.matrix[1] * domain.spacing.y;
    var bend = vec3f(0.0);
    for (var k = 0; k < 2; k++) {
        let way = f32(2 * k - 1);
        bend += way * (moved(0u, settings.strokes, q, found.offset + 0.5 * way * x).jacobian * y);
    }
    return -(found.matrix * bend) / domain.spacing.xyz;
}

// The distance of a source point from T⁻¹(q), in pixels, to first order.
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
    let twist = twist_of(q, found);
    // Cells whose nodes differ too much are not interpolated.
    let resolved = f32(STEP) <= RESOLVED * smoothness(q, found.offset, m);
    let error = select(COARSE, norm_of(m) * found.residual / finest(), resolved);
    nodes[place_of_node(id.xy, id.z, 0u)] = vec4f(found.offset / domain.spacing.xyz, error);
    for (var c = 0u; c < 3u; c++) {
        nodes[place_of_node(id.xy, id.z, 1u + c)] = vec4f(m[c], twist[c]);
    }
}

const COARSE = 1e30; // the error of cells that are not interpolated
const UNMOVED = -1.0; // and of unchanged cells

// True if no stroke reaches a cell, given its first pixel, or if all of it is frozen.
fn unmoved_cell(first: vec3f) -> bool {
    let size = vec3f(vec2f(f32(STEP)), 0.0) * domain.spacing.xyz;
    if (frozen(first + 0.5 * size, 0.5 * size)) {
        return true;
    }
    if (settings.limited == 0u) {
        return false;
    }
    for (var k = 0u; k < settings.strokes; k++) {
        let c = (strokes[k].pivot - first) + strokes[k].rest.xyz; // of the ball, from the cell's corner
        let d = c - clamp(c, vec3f(0.0), size);
        let over = strokes[k].rest.w;
        if (dot(d, d) * over * over < RIM) {
            return false;
        }
    }
    return true;
}

// The errors of cells from their checks, with a reserve.
@compute @workgroup_size(8, 8)
fn check(@builtin(global_invocation_id) id: vec3u) {
    let cells = settings.nodes - 1u;
    if (id.x >= cells.x || id.y >= cells.y) {
        return;
    }
    let cell = (id.z * cells.y + id.y) * cells.x + id.x;
    let first = vec2f((id.xy + vec2u(0u, settings.origin)) * STEP);
    if (unmoved_cell(vec3f(first, f32(settings.first + id.z)) * domain.spacing.xyz)) {
        errors[cell] = UNMOVED;
        return;
    }
    let patch_ = patch_at(id.xy, id.z);
    // Checked points do not represent the map if it varies between them.
    var found = 0.0;
    var fine = true;
    for (var k = 0u; k < 4u; k++) {
        let node = id.xy + vec2u(k & 1u, k >> 1u);
        let error = known_at(node, id.z, 0u).w;
        found = max(found, error);
        fine = fine && error <= settings.tolerance;
    }
    for (var k = 0u; k < select(8u, 10u, FROZEN); k++) {
        let at = SEEN[k];
        let p = (vec2f(id.xy + vec2u(0u, settings.origin)) + at) * f32(STEP);
        let q = vec3f(p, f32(settings.first + id.z)) * domain.spacing.xyz;
        let error = reserve() * error_at(q, between_nodes(patch_, at));
        found = max(found, error);
        fine = fine && error <= settings.tolerance; // false for NaN
    }
    errors[cell] = select(COARSE, found, fine);
    if (!fine) {
        rough[4u + atomicAdd(&stats[2], 1u)] = cell;
    }
}

// The number of workgroups for rough cells.
@compute @workgroup_size(1)
fn count() {
    let n = atomicLoad(&stats[2]);
    rough[0] = min(n, MOST_GROUPS);
    rough[1] = (n + MOST_GROUPS - 1u) / MOST_GROUPS;
    rough[2] = 1u;
    rough[3] = n;
}

const MOST_GROUPS = 65535u;

// The last two are seen of the next cells as well: where m begins to rise, the error may be largest on an edge.
const SEEN = array<vec2f, 10>(
    vec2f(0.5, 0.5), vec2f(0.5, 0.0), vec2f(0.0, 0.5), vec2f(0.25, 0.25),
    vec2f(0.75, 0.25), vec2f(0.25, 0.75), vec2f(0.75, 0.75), vec2f(0.5, 0.25),
    vec2f(1.0, 0.5), vec2f(0.5, 1.0),
);
