// Planes of an image or of a stack of frames, warped: lattice, check, and colours at T⁻¹ of every pixel.

struct Settings {
    size: vec2u, // samples of a whole plane
    nodes: vec2u, // of the lattice on the device
    fill: vec4f,
    pitch: vec2f, // pixels from sample to sample
    offset: vec2f, // the position of the first sample, in pixels
    strokes: u32,
    first: u32, // of the planes in this dispatch
    frames: u32, // of the whole source
    channels: u32,
    origin: u32, // the lattice's first row of cells
    top: u32, // the first row of samples in this dispatch
    tall: u32, // the number of rows
    groups: u32, // words of pixels in a row
    held: vec4u, // the ranges of the source's frames and rows on the device: from, to
    slots: u32, // the number of frames in the ring
    shift: u32, // the slot of the first frame
    blocks: vec2u, // layers of a frame, across and down
    part: vec2u, // the rows of cells to colour: from, to
    bounds: vec2f, // of the sample type
    white: f32, // the value of white and of full opacity
    tolerance: f32, // of source points, in pixels
    times: vec2i, // beyond which samples are constant
    turns: u32, // see turns.wgsl
    limited: u32, // true if all strokes have a limited reach
    levels: u32, // of a frame, without the frame itself
    stride: u32, // samples from the levels of a slot to those of the next
}

@group(0) @binding(0) var<uniform> settings: Settings;
@group(0) @binding(1) var<uniform> domain: Domain;
@group(0) @binding(2) var<storage, read> strokes: array<Stroke>;
@group(0) @binding(3) var<storage, read_write> nodes: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> errors: array<f32>;
// The largest error of a source point, the number of unsolved points, of rough cells, and of samples that were not on
// the device.
@group(0) @binding(5) var<storage, read_write> stats: array<atomic<u32>, 4>;
@group(0) @binding(6) var<storage, read_write> rough: array<u32>; // workgroups, the number of cells, and their indices
@group(0) @binding(7) var lattice: texture_2d_array<f32>; // the solved nodes
@group(0) @binding(9) var<storage, read_write> target_: array<u32>;
@group(0) @binding(11) var<storage, read> mask: array<u32>; // see freeze.wgsl

override FORMAT: u32 = 0u;
override FILTER: u32 = 0u;
override BETWEEN: u32 = 0u;
override OUTSIDE: u32 = 0u;
override AVERAGE: bool = false; // over the time of a pixel

const BYTE = 0u;
const BYTES = 1u;
const SHORT = 2u;
const SHORTS = 3u;
const BYTE_PAIR = 4u;
const SHORT_PAIR = 5u;
const FLOAT = 6u;
const NEAREST = 0u;
const LINEAR = 1u;
const CUBIC = 2u;
const AUTO = 3u;
const NOTHING = 3u; // without interpolation between frames: one is an image
const EDGE = 0u;
const CONSTANT = 1u;
const REFLECT = 2u;
const STEP = 16u;

var<private> worst: f32 = 0.0;
var<private> lost: u32 = 0u;

const CUT = 1u << 20u; // added to the count of unsolved points, if a thread's loops were ended
var<private> missing: u32 = 0u;

// A workgroup computes the pixels of one cell, which share one read of the lattice.
var<private> cell: vec2u;
var<private> known: f32 = 0.0; // the error of the cell
var<private> patch_: Patch;

// T⁻¹ of a sample: from the lattice if accurate, and otherwise solved from there.
fn source_of(x: u32, y: u32, plane: u32, solving: bool) -> Source {
    let place = settings.pitch * vec2f(vec2u(x, y)) + settings.offset;
    let source = between_nodes(patch_, (place - f32(STEP) * vec2f(cell + vec2u(0u, settings.origin))) / f32(STEP));
    if (!solving) {
        worst = max(worst, known);
        return source;
    }
    let q = vec3f(place, f32(settings.first + plane)) * domain.spacing.xyz;
    let wanted = 0.1 * settings.tolerance * finest();
    var found = newton(0u, settings.strokes, q, vec3f(0.0), source.shift * domain.spacing.xyz, wanted, 12u);
    var m = in_pixels(found.matrix);
    var off = norm_of(m) * found.residual / finest();
    if (!(off <= settings.tolerance)) {
        found = undo(q, wanted);
        m = in_pixels(found.matrix);
        off = norm_of(m) * found.residual / finest();
        if (!(off <= settings.tolerance)) {
            lost += 1u;
        }
    }
    worst = max(worst, select(1e30, off, off <= settings.tolerance));
    return Source(found.offset / domain.spacing.xyz, m);
}

// From pixels to sample indices.
fn in_samples(source: Source) -> Source {
    let unit = vec3f(settings.pitch, 1.0);
    return Source(
        source.shift / unit,
        mat3x3f(
            source.matrix[0] * unit.x / unit,
            source.matrix[1] * unit.y / unit,
            source.matrix[2] / unit,
        ),
    );
}

// True if no stroke reaches a sample, or if it is frozen: it is copied then.
fn passed(x: u32, y: u32, plane: u32) -> bool {
    if (known == UNMOVED) {
        return true;
    }
    if (settings.limited == 0u && !FROZEN) {
        return false;
    }
    let place = settings.pitch * vec2f(vec2u(x, y)) + settings.offset;
    let q = vec3f(place, f32(settings.first + plane)) * domain.spacing.xyz;
    return frozen(q, vec3f(0.0)) || (settings.limited != 0u && unreached(q));
}

fn colour(x: u32, y: u32, plane: u32, solving: bool) -> vec4f {
    if (passed(x, y, plane)) {
        return stored(level_of(0u), vec2u(x, y), select(settings.first + plane, 0u, BETWEEN == NOTHING));
    }
    let source = in_samples(source_of(x, y, plane, solving));
    let v = filtered(vec3i(vec3u(x, y, settings.first + plane)), source);
    if (FORMAT < FLOAT) {
        return clamp(floor(v + 0.5), vec4f(settings.bounds.x), vec4f(settings.bounds.y));
    }
    return v;
}

// Pixels in the words of a thread, and words in a thread.
override PIXELS: u32 = 4u;
override WORDS: u32 = 1u;

fn write(at: vec2u, plane: u32, solving: bool) {
    var words = vec4u(0u);
    // One function for all formats, to keep compiled shaders small.
    for (var k = 0u; k < PIXELS; k++) {
        let x = PIXELS * at.x + k;
        if (x < settings.size.x) {
            let v = colour(x, at.y, plane, solving);
            if (FORMAT >= FLOAT) {
                words = bitcast<vec4u>(v);
            } else {
                let whole = vec4u(v);
                let bits = select(16u, 8u, FORMAT == BYTE || FORMAT == BYTES || FORMAT == BYTE_PAIR);
                let channels = 32u * WORDS / (bits * PIXELS);
                for (var c = 0u; c < channels; c++) {
                    let bit = bits * (channels * k + c);
                    words[bit >> 5u] |= whole[c] << (bit & 31u);
                }
            }
        }
    }
    let row = plane * settings.tall + (at.y - settings.top);
    for (var w = 0u; w < WORDS; w++) {
        target_[(row * settings.groups + at.x) * WORDS + w] = words[w];
    }
}

// Threads along the sides of a cell; each computes several pixels from one read of the lattice.
override ACROSS: u32 = 4u;
override DOWN: u32 = 8u;
override ROWS: u32 = 16u; // of samples in a cell

fn fill(group: vec2u, plane: u32, own: vec2u, solving: bool) {
    patch_ = patch_at(cell, plane);
    let x = group.x * ACROSS + own.x;
    if (x < settings.groups) {
        for (var j = own.y; j < ROWS; j += DOWN) {
            let y = (group.y + settings.origin) * ROWS + j;
            if (y < settings.top + settings.tall) {
                write(vec2u(x, y), plane, solving);
            }
        }
        // Positive numbers are ordered like their bits.
        atomicMax(&stats[0], bitcast<u32>(worst));
        if (cut_short()) {
            lost += CUT;
        }
        if (lost > 0u) {
            atomicAdd(&stats[1], lost);
            lost = 0u;
        }
        if (missing > 0u) {
            atomicAdd(&stats[3], missing);
            missing = 0u;
        }
    }
}

// Good cells.
@compute @workgroup_size(ACROSS, DOWN)
fn warp(@builtin(local_invocation_id) own: vec3u, @builtin(workgroup_id) group: vec3u) {
    let cells = settings.nodes - 1u;
    let place = vec2u(group.x, group.y + settings.part.x);
    cell = min(place, cells - 1u); // a last pixel may be the last node
    known = errors[(group.z * cells.y + cell.y) * cells.x + cell.x];
    if (known <= settings.tolerance) {
        fill(place, group.z, own.xy, false);
    }
}

// Rough cells, in a separate pass: on some GPUs, a branch costs as much as its body, even when not taken.
@compute @workgroup_size(ACROSS, DOWN)
fn solve_and_warp(
    @builtin(local_invocation_id) own: vec3u,
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
) {
    let place = group.y * groups.x + group.x;
    if (place >= rough[3]) {
        return;
    }
    let cells = settings.nodes - 1u;
    let which = rough[4u + place];
    let plane = which / (cells.x * cells.y);
    cell = vec2u(which % cells.x, which / cells.x % cells.y);
    // Pixels on the last nodes have no cell of their own.
    let more = vec2u(u32(cell.x + 1u == cells.x), u32(cell.y + 1u == cells.y));
    for (var j = 0u; j <= more.y; j++) {
        if (cell.y + j >= settings.part.x && cell.y + j < settings.part.y) {
            for (var i = 0u; i <= more.x; i++) {
                fill(cell + vec2u(i, j), plane, own.xy, true);
            }
        }
    }
}
