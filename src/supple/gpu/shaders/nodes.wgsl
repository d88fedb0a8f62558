// The lattice of a volume: T⁻¹ solved at its nodes, and its cells checked.

#use newton solid smooth turns

struct Settings {
    nodes: vec3u,
    spread: f32, // voxels from node to node
    strokes: u32,
    first: u32, // the first layer of nodes, or of cells, in this dispatch
    last: u32, // the end of the layers
    turns: u32, // see turns.wgsl
}

var<uniform> settings: Settings;
// The nodes of some layers, in the layout of solid.wgsl, in rows padded to 256 bytes.
var<storage, read_write> nodes: array<vec4f>;
// The largest observed error, and the least length scale of the map, in voxels: positive floats, which sort like their
// bits. Errors from LOST on mark unsolved points.
var<storage, read_write> stats: array<atomic<u32>, 2>;

fn saw(error: f32) {
    atomicMax(&stats[0], bitcast<u32>(select(LOST, error, error <= LOST)));
    if (cut_short()) {
        atomicMax(&stats[0], bitcast<u32>(CUT));
    }
}

@compute @workgroup_size(4, 4, 4)
fn solve(@builtin(global_invocation_id) id: vec3u) {
    let i = vec3u(id.xy, id.z + settings.first);
    if (any(i >= settings.nodes) || i.z >= settings.last) {
        return;
    }
    let q = vec3f(i) * settings.spread * domain.spacing.xyz;
    let found = undo(q, 1e-3 * finest());
    let m = in_pixels(found.matrix);
    let pitch = (settings.nodes.x + 15u) & ~15u;
    for (var k = 0u; k < 4u; k++) {
        let row = (2u * id.z + (k >> 1u)) * 2u * settings.nodes.y + 2u * i.y + (k & 1u);
        nodes[row * pitch + i.x] = vec4f(select(m[max(k, 1u) - 1u], found.offset / domain.spacing.xyz, k == 0u), 0.0);
    }
    saw(select(LOST, norm_of(m) * found.residual / finest(), found.residual < LOST));
    atomicMin(&stats[1], bitcast<u32>(smoothness(q, found.offset, m)));
}

@compute @workgroup_size(4, 4, 4)
fn check(@builtin(global_invocation_id) id: vec3u) {
    let i = vec3u(id.xy, id.z + settings.first);
    if (any(i + 1u >= settings.nodes) || i.z >= settings.last) {
        return;
    }
    var m: mat3x3f;
    for (var c = 0u; c < 3u; c++) {
        m[c] = 0.5 * (node_at(i, c + 1u) + node_at(i + 1u, c + 1u));
    }
    var worst = 0.0;
    for (var k = 0u; k < 15u; k++) {
        // The centre of the cell, of its faces and edges at one corner, and of its eighths.
        let bits = vec3f(vec3u(k, k >> 1u, k >> 2u) & vec3u(1u));
        let at = select(0.25 + 0.5 * bits, 0.5 - 0.5 * bits, k < 7u);
        let p = (vec3f(i) + at) * settings.spread;
        let q = p * domain.spacing.xyz;
        let off = moved(0u, settings.strokes, q, between(p).shift * domain.spacing.xyz).offset / domain.spacing.xyz;
        let error = length(m * off);
        worst = max(worst, select(LOST, error, error <= LOST));
    }
    saw(reserve() * worst);
}
