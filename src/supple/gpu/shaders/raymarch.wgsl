// A volume rendered through a camera, a ray for each thread; see _core/raymarch.hpp.

#use newton volume turns

struct Settings {
    size: vec3u, // voxels
    strokes: u32,
    bricks: vec3u, // of the map of empty space
    first: u32, // the first row of rays in this dispatch
    picture: vec2u, // columns and rows of rays
    threshold: f32, // the visible range of values
    top: f32,
    eye: vec3f, // in voxels
    ahead: vec3f, // the direction of view, and the steps to the pixels right and below, in millimetres along the axes
    right: vec3f,
    below: vec3f,
    light: vec3f, // its direction
    box_first: vec3f, // the corners of the rendered box, in voxels
    box_last: vec3f,
    plane: vec4f, // of the cut: the unit normal towards the part cut away, and the distance from the first voxel, in mm
    first_node: vec3f, // the position of a voxel among the nodes of the light: first_node + per_node * voxel
    per_node: vec3f,
    step: f32, // millimetres from sample to sample
    low: f32, // the value of the transfer function's first entry, and entries for each unit of value
    scale: f32,
    entries: u32,
    shaded: u32,
    fine: u32, // rays along a pixel's side
    rows: u32,
    turns: u32, // see turns.wgsl
    projection: u32,
    silhouettes: f32, // how much surfaces that are seen edge-on darken
    shadows: u32, // true if there are shadows: `arrives`
    ends: u32, // true if there are meshes
}

var<uniform> settings: Settings;
var skips: texture_3d<u32>;
var colours: texture_3d<f32>; // the transfer function, and its sums before each entry
// Two for each ray: light and opacity; the depths of the first surface and of opacity 0.9, samples and inversions.
var<storage, read_write> seen: array<vec4f>;
var paint: texture_3d<f32>; // colours of voxels, sRGB and opacity
var arrives: texture_3d<f32>; // the part of the light that arrives at nodes
var<storage, read> ends: array<vec4f>; // the meshes that rays end at: colour, and distance

override MODE: u32;
override COLOURED: bool = false; // true if voxels have colours of their own

const RUN = 8u; // samples between two looks at the map of empty space
const BISECTIONS = 2u;
const HALVINGS = 6u; // of labels
const OPAQUE = 0.995;
const LAYER = 4.0; // voxels behind a cut face over which lighting by gradients replaces that of the face
const MAXIMUM = 1u; // projections
const AVERAGE = 3u;
const AMBIENT = 0.15;
const DIFFUSE = 0.8;
const SPECULAR = 0.2; // and the highlight's power is 16

var<private> inversions: f32 = 0.0;
var<private> lost: bool = false; // true if a point could not be solved

// The source of a point, in voxels.
struct Place {
    p: vec3f,
    shift: vec3f, // with EXACT, its offset in physical units: the guess for the next sample
    matrix: mat3x3f, // with EXACT, ∂p/∂q in physical units
}

fn solved(q: vec3f, near: vec3f) -> Place {
    let at = q * domain.spacing.xyz;
    let wanted = 1e-3 * finest();
    var found = newton(0u, settings.strokes, at, vec3f(0.0), near, wanted, 10u);
    inversions += found.steps;
    if (!(found.residual <= 0.05 * finest())) {
        found = undo(at, wanted);
        inversions += found.steps;
        lost = lost || !(found.residual <= 0.05 * finest());
    }
    return Place(q + found.offset / domain.spacing.xyz, found.offset, found.matrix);
}

fn source_of(ray: Ray, t: f32, near: vec3f) -> Place {
    let q = ray.o + t * ray.d;
    if (MODE == EXACT) {
        return solved(q, near);
    }
    return Place(q, near, IDENTITY);
}

struct Ray {
    o: vec3f, // in voxels
    d: vec3f, // voxels a millimetre
    over: vec3f, // 1 / d
    forwards: vec3<bool>,
    near: f32, // where it enters and leaves the box
    far: f32,
    // Samples are a whole number of steps from the start, since a running sum would lose accuracy.
    start: f32,
    count: f32,
}

// The number of steps to leave the empty bricks around a point; 0 in visible ones.
fn steps_to_skip(ray: Ray, t: f32) -> f32 {
    if (MODE == EXACT) {
        return 0.0;
    }
    let q = ray.o + t * ray.d;
    let i = min(vec3u(max(q, vec3f(0.0))) / BRICK, settings.bricks - 1u);
    let away = f32(textureLoad(skips, i, 0).x);
    let wall = f32(BRICK) * (vec3f(i) + select(vec3f(1.0 - away), vec3f(away), ray.forwards));
    let leaves = (wall - ray.o) * ray.over;
    let leave = min(leaves.x, min(leaves.y, leaves.z));
    return select(0.0, max(1.0, ceil((leave - t) / settings.step - 1e-3)), away > 0.0);
}

// The gradient of the deformed volume, per millimetre: (∂p/∂q)ᵀ ∇f.
fn gradient_at(place: Place) -> vec3f {
    let g = slopes_at(place.p);
    if (MODE == EXACT) {
        return (g / domain.spacing.xyz) * place.matrix;
    }
    return g / domain.spacing.xyz;
}

// -1 for a value below the visible range, 0 within it, 1 above.
fn side(value: f32) -> i32 {
    return select(select(0, 1, value > settings.top), -1, value < settings.threshold);
}

// An entry of the transfer function, or of its sums.
fn table_at(entry: u32, row: u32) -> vec4f {
    return textureLoad(colours, vec3u(entry % ROW, row, entry / ROW), 0);
}

fn colour_of(value: f32) -> vec4f {
    return table_at(u32(entry_of(value) + 0.5), 0u);
}

fn entry_of(value: f32) -> f32 {
    return clamp((value - settings.low) * settings.scale, 0.0, f32(settings.entries - 1u));
}

// The sums of extinction times colour, and of extinction, of all entries before a place in the transfer function.
fn sums_before(entry: f32) -> vec4f {
    let at = entry + 0.5;
    let k = min(u32(at), settings.entries - 1u);
    return mix(table_at(k, 1u), table_at(k + 1u, 1u), at - f32(k));
}

// A step along which values are linear: its colour and opacity, and the middle of its visible part, from 0 to 1.
struct Seen {
    colour: vec4f,
    middle: f32,
}

fn between_values(a: f32, b: f32, part: f32) -> Seen {
    if (LABELLED) {
        return halves(a, b, part);
    }
    let from_ = clamp(a, settings.threshold, settings.top);
    let to = clamp(b, settings.threshold, settings.top);
    if (from_ == to && (from_ != a || to != b)) {
        return Seen(vec4f(0.0), 0.5);
    }
    let over = select(0.0, 1.0 / (b - a), a != b);
    let mean = 0.5 * (from_ + to);
    let middle = select(0.5, (mean - a) * over, a != b);
    let e = entry_of(from_);
    let e1 = entry_of(to);
    if (abs(e1 - e) < 1.0) {
        var flat = colour_of(mean);
        let share = select(part, part * (to - from_) * over, a != b);
        if (share != 1.0 && flat.w > 0.0) {
            flat.w = 1.0 - pow(1.0 - flat.w, share);
        }
        return Seen(flat, middle);
    }
    let all = (sums_before(e1) - sums_before(e)) * (part * over / settings.scale);
    if (!(all.w > 0.0)) {
        return Seen(vec4f(0.0), middle);
    }
    return Seen(vec4f(all.xyz / all.w, 1.0 - exp(-all.w)), middle);
}

// A step between two labels, which are not mixed: half of the first, then half of the second.
fn halves(a: f32, b: f32, part: f32) -> Seen {
    let one = colour_of(a);
    let other = colour_of(b);
    let left = pow(1.0 - one.w, 0.5 * part);
    let last = left * (1.0 - pow(1.0 - other.w, 0.5 * part));
    let all = 1.0 - left + last;
    let mixed = ((1.0 - left) * one.xyz + last * other.xyz) / max(all, 1e-30);
    return Seen(vec4f(mixed, all), select(select(0.5, 0.25, b == 0.0), 0.75, a == 0.0));
}

// The mesh at which a ray ends, or FAR.
fn end_of(ray: u32) -> vec4f {
    var end = vec4f(0.0, 0.0, 0.0, FAR);
    if (settings.ends != 0u) {
        end = ends[ray];
    }
    return end;
}

// The light of the volume composited over a mesh.
fn over_mesh(end: vec4f, total: vec4f) -> vec4f {
    return select(total, total + (1.0 - total.w) * vec4f(end.xyz, 1.0), end.w < FAR);
}

@compute @workgroup_size(8, 8)
fn march(@builtin(global_invocation_id) id: vec3u) {
    let size = settings.picture;
    if (id.x >= size.x || id.y >= settings.rows || id.y + settings.first >= size.y) {
        return;
    }
    let fine = f32(settings.fine);
    let pixel = (vec2f(f32(id.x), f32(id.y + settings.first)) + 0.5) / fine - 0.5
        - 0.5 * (vec2f(size) / fine - 1.0);
    let along = normalize(settings.ahead + pixel.x * settings.right + pixel.y * settings.below);
    let d = along / domain.spacing.xyz;
    let o = settings.eye;
    // Where the ray enters and leaves the box.
    let safe = select(d, vec3f(1e-12), abs(d) < vec3f(1e-12));
    let over = 1.0 / safe;
    let one_way = (settings.box_first - o) * over;
    let other_way = (settings.box_last - o) * over;
    let enters = min(one_way, other_way);
    let leaves = max(one_way, other_way);
    var near = max(0.0, max(enters.x, max(enters.y, enters.z)));
    var far = min(leaves.x, min(leaves.y, leaves.z));
    let boxed = near;
    let away = dot(settings.plane.xyz, o * domain.spacing.xyz) - settings.plane.w;
    let rate = dot(settings.plane.xyz, along);
    if (rate > 0.0) {
        far = min(far, -away / rate);
    } else if (rate < 0.0) {
        near = max(near, -away / rate);
    } else if (away > 0.0) {
        far = -1.0;
    }
    let end = end_of(id.y * size.x + id.x);
    if (settings.projection == 0u) {
        far = min(far, end.w);
    }
    let half_ = normalize(settings.light - along);
    var ray = Ray(o, d, over, safe > vec3f(0.0), near, far, near, 0.0);
    var t = near;
    var taken = 0.0;
    var shift = vec3f(0.0);
    var surface = FAR;
    // The cosine of the lamp's angle to the cut face, while the volume is visible from that face on; then -1.
    var face = -1.0;
    for (var i = 0u; i < 3u && near > 0.0; i++) {
        face = select(face, abs(settings.light[i]), enters[i] == near);
    }
    if (near > boxed) {
        face = abs(dot(settings.light, settings.plane.xyz));
    }
    if (settings.projection != 0u) {
        project(ray, 2u * (id.y * size.x + id.x));
        return;
    }
    let layer = LAYER * min(domain.spacing.x, min(domain.spacing.y, domain.spacing.z));
    var total = vec4f(0.0);
    var opaque = FAR;
    var known = false; // the value at the start of a step
    var before = 0.0;
    var within = false;
    while (t < far) {
        if (!within) {
            var hopped = false;
            for (var hop = steps_to_skip(ray, t); hop > 0.0 && t < far; hop = steps_to_skip(ray, t)) {
                ray.count += hop;
                t = ray.start + ray.count * settings.step;
                hopped = true;
            }
            if (hopped) {
                // Go back a step, which lies partly in the visible brick.
                ray.count = max(ray.count - 1.0, 0.0);
                t = ray.start + ray.count * settings.step;
                known = false;
                face = -1.0;
                if (t >= far) {
                    break;
                }
            }
        }
        if (!known) {
            let place = source_of(ray, t, shift);
            shift = place.shift;
            before = sample_at(place.p);
            taken += 1.0;
            known = true;
        }
        within = false;
        for (var j = 0u; j < RUN && t < far; j++) {
            let t1 = min(ray.start + (ray.count + 1.0) * settings.step, far);
            let place = source_of(ray, t1, shift);
            shift = place.shift;
            let after = sample_at(place.p);
            taken += 1.0;
            if (surface == FAR) {
                let outer = side(before);
                if (outer == 0) {
                    surface = t;
                } else if (outer != side(after)) {
                    // The surface lies within the step.
                    face = -1.0;
                    var low = t;
                    var high = t1;
                    var beyond = after;
                    for (var turn = 0u; turn < select(BISECTIONS, HALVINGS, LABELLED); turn++) {
                        let middle = 0.5 * (low + high);
                        let inner = source_of(ray, middle, shift);
                        shift = inner.shift;
                        let there = sample_at(inner.p);
                        taken += 1.0;
                        if (side(there) == outer) {
                            low = middle;
                            before = there;
                        } else {
                            high = middle;
                            beyond = there;
                        }
                    }
                    // Linear interpolation to the end of the visible range.
                    let end = select(settings.top, settings.threshold, outer < 0);
                    surface = select(low + (high - low) * ((end - before) / (beyond - before)), high, LABELLED);
                    before = select(end, beyond, LABELLED);
                    ray.start = surface;
                    ray.count = 0.0;
                    t = surface;
                    within = true;
                    break;
                }
            }
            var step = Seen(vec4f(0.0), 0.5);
            if (surface != FAR) {
                step = between_values(before, after, (t1 - t) / settings.step);
            }
            if (step.colour.w > 0.0) {
                let part = (1.0 - total.w) * step.colour.w;
                within = true;
                var lit = vec2f(1.0, 0.0);
                let middle = mix(t, t1, step.middle);
                let seat = source_of(ray, middle, shift);
                let colour = painted(seat.p, step.colour);
                if (settings.shaded == 1u) {
                    lit = lit_by(gradient_at(seat), half_, along);
                    taken += 1.0;
                    if (face >= 0.0) {
                        let deep = clamp((t - near) / layer, 0.0, 1.0);
                        lit = mix(vec2f(AMBIENT + DIFFUSE * face, 0.0), lit, deep);
                    }
                    if (settings.shadows == 1u) {
                        lit *= arriving(o + middle * d);
                    }
                }
                total += part * vec4f(colour.xyz * lit.x + lit.y, 1.0);
                if (opaque == FAR && total.w >= 0.9) {
                    opaque = t;
                }
                if (total.w > OPAQUE) {
                    t = FAR;
                    break;
                }
            } else {
                face = -1.0;
            }
            before = after;
            ray.count += 1.0;
            t = ray.start + ray.count * settings.step;
        }
    }
    let k = 2u * (id.y * size.x + id.x);
    seen[k] = over_mesh(end, total);
    seen[k + 1u] = vec4f(min(surface, end.w), opaque, taken, select(inversions, -1.0, lost || cut_short()));
}

// The extreme or the average value along a ray, in the colours of the transfer function, which are opaque.
fn project(whole: Ray, k: u32) {
    var ray = whole;
    var shift = vec3f(0.0);
    var value = 0.0;
    var at = FAR;
    var count = 0.0;
    var t = ray.near;
    while (t <= ray.far) {
        let place = source_of(ray, t, shift);
        shift = place.shift;
        let next = sample_at(place.p);
        if (settings.projection == AVERAGE) {
            value += next;
        } else if (count == 0.0 || select((next < value), (next > value), settings.projection == MAXIMUM)) {
            value = next;
            at = t;
        }
        count += 1.0;
        ray.count += 1.0;
        t = ray.start + ray.count * settings.step;
    }
    var total = vec4f(0.0);
    var surface = at;
    if (count > 0.0) {
        if (settings.projection == AVERAGE) {
            value /= count;
            surface = ray.near;
        }
        total = colour_of(value);
    }
    let end = end_of(k / 2u);
    if (end.w < FAR) { // a projection has no depth, so meshes are in front of it
        total = vec4f(end.xyz, 1.0);
        surface = end.w;
    }
    seen[k] = total;
    seen[k + 1u] = vec4f(surface, at, count, select(inversions, -1.0, lost || cut_short()));
}

// The voxels' own colour at a point, if they have one, with the opacity of `colour`: see Coloured in _core/voxels.hpp.
fn painted(p: vec3f, colour: vec4f) -> vec4f {
    if (!COLOURED) {
        return colour;
    }
    let cell = cell_of(p);
    var sum = vec4f(0.0);
    for (var k = 0u; k < 8u; k++) {
        let corner = corner_of(cell, k);
        let found = textureLoad(paint, corner.at, 0);
        sum += corner.weight * found.w * vec4f(found.xyz, 1.0);
    }
    let u = sum.xyz / max(sum.w, 1e-6);
    return vec4f(select(pow((u + 0.055) / 1.055, vec3f(2.4)), u / 12.92, u <= vec3f(0.04045)), colour.w);
}

// Ambient and diffuse light, and the highlight, of a surface with a gradient; both sides are lit.
fn lit_by(gradient: vec3f, half_: vec3f, along: vec3f) -> vec2f {
    let size = length(gradient);
    if (!(size > 0.0)) {
        return vec2f(AMBIENT + DIFFUSE, 0.0);
    }
    let normal = gradient / size;
    let shine = pow(abs(dot(normal, half_)), 16.0);
    let aside = max(1.0 - abs(dot(normal, along)), 0.0);
    let left = 1.0 - settings.silhouettes * aside * aside;
    return left * vec2f(AMBIENT + DIFFUSE * abs(dot(normal, settings.light)), SPECULAR * shine);
}

// The part of the light that arrives at a point, in voxels.
fn arriving(q: vec3f) -> f32 {
    let last = textureDimensions(arrives) - 1u;
    let g = clamp(settings.first_node + settings.per_node * q, vec3f(0.0), vec3f(last));
    let i = min(vec3u(g), last - 1u);
    var light = 0.0;
    for (var k = 0u; k < 8u; k++) {
        let corner = corner_of(Cell(i, g - vec3f(i)), k);
        light += corner.weight * textureLoad(arrives, corner.at, 0).x;
    }
    return light;
}
