// A deformed volume, filled in bricks: each voxel is the volume sampled at T⁻¹, which is interpolated along rows.

#use newton solid smooth volume turns

struct Settings {
    size: vec3u, // voxels
    strokes: u32,
    nodes: vec3u, // of the lattice of T⁻¹
    spread: f32, // voxels from node to node
    first: u32, // the first brick of this dispatch
    count: u32, // the number of its bricks
    tolerance: f32, // of source points, in voxels
    turns: u32, // see turns.wgsl
}

var<uniform> settings: Settings;
var<storage, read_write> lost: atomic<u32>; // voxels that could not be solved
var made: texture_storage_3d<r32float, write>; // the buffer

override POLISHED: bool; // true if each source point is refined by Newton's method, from that of the lattice

fn source_of(q: vec3f, u: vec3f) -> vec3f {
    let at = q * domain.spacing.xyz;
    if (frozen(at)) {
        return q;
    }
    if (!POLISHED) {
        return q + u;
    }
    let aim = 0.1 * settings.tolerance * finest();
    var found = newton(0u, settings.strokes, at, vec3f(0.0), u * domain.spacing.xyz, aim, 12u);
    if (!(norm_of(in_pixels(found.matrix)) * found.residual <= settings.tolerance * finest())) {
        found = undo(at, aim);
        if (!(norm_of(in_pixels(found.matrix)) * found.residual <= settings.tolerance * finest())) {
            atomicAdd(&lost, 1u);
        }
    }
    return q + found.offset / domain.spacing.xyz;
}

@compute @workgroup_size(64)
fn fill(
    @builtin(local_invocation_index) own: u32,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let place = group.y * groups.x + group.x;
    if (place >= settings.count) {
        return;
    }
    let blocks = (settings.size + BLOCK - 1u) / BLOCK;
    let which = settings.first + place;
    let corner = BLOCK * vec3u(which % blocks.x, which / blocks.x % blocks.y, which / (blocks.x * blocks.y));
    let way = u32(settings.spread);
    for (var row = own; row < BLOCK * BLOCK; row += 64u) {
        let y = corner.y + row % BLOCK;
        let z = corner.z + row / BLOCK;
        if (y >= settings.size.y || z >= settings.size.z) {
            continue;
        }
        let end = min(corner.x + BLOCK, settings.size.x);
        var to = between(vec3f(vec3u(corner.x, y, z)));
        for (var x = corner.x; x < end; x += way) {
            let from_ = to;
            to = between(vec3f(vec3u(x + way, y, z)));
            let rise = to.shift - from_.shift;
            let slope = vec3f(settings.spread, 0.0, 0.0);
            let a = settings.spread * from_.matrix[0] - slope - rise;
            let b = rise - settings.spread * to.matrix[0] + slope;
            for (var i = 0u; i < way && x + i < end; i++) {
                let q = vec3f(vec3u(x + i, y, z));
                let u = cubic(from_.shift, rise, a, b, f32(i) / settings.spread);
                textureStore(made, vec3u(x + i, y, z), vec4f(copied_at(source_of(q, u))));
            }
        }
    }
    if (cut_short()) {
        atomicAdd(&lost, 1u);
    }
}
