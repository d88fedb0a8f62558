// A deformed volume, filled in blocks: each voxel is the volume sampled at T⁻¹, solved from the voxel before it.

#use newton volume turns

struct Settings {
    size: vec3u, // voxels
    strokes: u32,
    first: u32, // the first block of this dispatch
    count: u32, // the number of its blocks
    tolerance: f32, // of source points, in voxels
    turns: u32, // see turns.wgsl
}

var<uniform> settings: Settings;
var<storage, read_write> lost: atomic<u32>; // voxels that could not be solved
var made: texture_storage_3d<r32float, write>; // the buffer

// The norm of a matrix, from physical units to voxels.
fn norm_of(matrix: mat3x3f) -> f32 {
    var sum = 0.0;
    for (var c = 0u; c < 3u; c++) {
        let column = matrix[c] * domain.spacing[c] / domain.spacing.xyz;
        sum += dot(column, column);
    }
    return sqrt(sum);
}

// T⁻¹(q) - q, from a guess, in physical units.
fn offset_at(at: vec3f, guess: vec3f) -> vec3f {
    if (frozen(at)) {
        return vec3f(0.0);
    }
    let wanted = settings.tolerance * finest();
    var found = newton(0u, settings.strokes, at, vec3f(0.0), guess, 0.1 * wanted, 12u);
    if (!(norm_of(found.matrix) * found.residual <= wanted)) {
        found = undo(at, 0.1 * wanted);
        if (!(norm_of(found.matrix) * found.residual <= wanted)) {
            atomicAdd(&lost, 1u);
        }
    }
    return found.offset;
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
    var start = vec3f(0.0);
    for (var row = own; row < BLOCK * BLOCK; row += 64u) {
        let y = corner.y + row % BLOCK;
        let z = corner.z + row / BLOCK;
        if (y >= settings.size.y || z >= settings.size.z) {
            continue;
        }
        var offset = start;
        for (var x = corner.x; x < min(corner.x + BLOCK, settings.size.x); x++) {
            let q = vec3f(vec3u(x, y, z));
            offset = offset_at(q * domain.spacing.xyz, offset);
            start = select(start, offset, x == corner.x);
            textureStore(made, vec3u(x, y, z), vec4f(copied_at(q + offset / domain.spacing.xyz)));
        }
    }
    if (cut_short()) {
        atomicAdd(&lost, 1u);
    }
}
