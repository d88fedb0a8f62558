// T and T⁻¹ of points, one for each thread.

#use newton turns

struct Settings {
    strokes: u32,
    count: u32,
    tolerance: f32,
    turns: u32, // see turns.wgsl
}

var<uniform> settings: Settings;
var<storage, read> anchors: array<vec4f>; // q
var<storage, read> offsets: array<vec4f>; // their offsets, or the target offsets
var<storage, read_write> results: array<vec4f>; // four for each point

@compute @workgroup_size(64)
fn forward(@builtin(global_invocation_id) id: vec3u) {
    let i = id.x;
    if (i >= settings.count) {
        return;
    }
    let at = moved(0u, settings.strokes, anchors[i].xyz, offsets[i].xyz);
    results[4u * i] = vec4f(at.offset, 0.0);
    for (var c = 0u; c < 3u; c++) {
        results[4u * i + 1u + c] = vec4f(at.jacobian[c], 0.0);
    }
}

@compute @workgroup_size(64)
fn inverse(@builtin(global_invocation_id) id: vec3u) {
    let i = id.x;
    if (i >= settings.count) {
        return;
    }
    let found = undo(anchors[i].xyz, settings.tolerance);
    results[4u * i] = vec4f(found.offset, select(found.residual, 1e30, cut_short()));
    results[4u * i + 1u] = vec4f(found.matrix[0], found.steps);
    results[4u * i + 2u] = vec4f(found.matrix[1], 0.0);
    results[4u * i + 3u] = vec4f(found.matrix[2], 0.0);
}
