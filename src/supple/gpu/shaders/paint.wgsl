// Results of rays, composited over a background as sRGB, into a texture.

struct Settings {
    background: vec3f, // linear light
    width: u32, // pixels
    first: u32, // the first row of this dispatch
    rows: u32, // their number
}

var<uniform> settings: Settings;
var<storage, read> seen: array<vec4f>; // two for each ray, as raymarch.wgsl writes them
var<storage, read_write> lost: atomic<u32>; // rays with an unsolved point
var target_: texture_storage_2d<rgba8unorm, write>;

@compute @workgroup_size(8, 8)
fn paint(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= settings.width || id.y >= settings.rows) {
        return;
    }
    let k = 2u * (id.y * settings.width + id.x);
    let total = seen[k];
    if (seen[k + 1u].w < 0.0) {
        atomicAdd(&lost, 1u);
    }
    let light = clamp(total.xyz + (1.0 - clamp(total.w, 0.0, 1.0)) * settings.background, vec3f(0.0), vec3f(1.0));
    let curved = 1.055 * pow(max(light, vec3f(0.0031308)), vec3f(1.0 / 2.4)) - 0.055;
    let shown = select(curved, light * 12.92, light <= vec3f(0.0031308));
    textureStore(target_, vec2u(id.x, id.y + settings.first), vec4f(shown, 1.0));
}
