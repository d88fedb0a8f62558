// The smallest and the largest sample of each brick of a deformed volume; see brick_ranges in _core/render.cpp.

struct Settings {
    size: vec3u, // voxels
    first: u32, // the first layer of bricks in this dispatch
    bricks: vec3u,
    last: u32, // the end of the layers
}

var<uniform> settings: Settings;
var warped: texture_3d<f32>;
var<storage, read_write> found: array<vec2f>;

@compute @workgroup_size(4, 4, 4)
fn ranges(@builtin(global_invocation_id) id: vec3u) {
    let brick = vec3u(id.xy, id.z + settings.first);
    if (any(brick >= settings.bricks) || brick.z >= settings.last) {
        return;
    }
    let start = BRICK * brick;
    let end = min(start + BRICK, settings.size - 1u); // its neighbour's first voxel is its own, too
    var range = vec2f(textureLoad(warped, start, 0).x);
    for (var z = start.z; z <= end.z; z++) {
        for (var y = start.y; y <= end.y; y++) {
            for (var x = start.x; x <= end.x; x++) {
                let value = textureLoad(warped, vec3u(x, y, z), 0).x;
                range = vec2f(min(range.x, value), max(range.y, value));
            }
        }
    }
    found[(id.z * settings.bricks.y + brick.y) * settings.bricks.x + brick.x] = range;
}
