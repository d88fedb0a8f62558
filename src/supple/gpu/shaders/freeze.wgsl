// m(p), the factor of a freeze mask for every stroke's displacement: a cubic B-spline; see _core/freeze.hpp.
//
// Each coefficient has 16 bits. The lower 8 are m times 255. The next one is 1 if m does not vary in the cell from it
// to the next ones: there, m is the coefficient.

var<storage, read> mask: array<u32>;

override FROZEN: bool = false; // true if there is a mask

// m and its gradient, in physical units.
struct Freed {
    m: f32,
    slope: vec3f,
}

// A cell, and the position of a point in it, from 0 to 1.
struct MaskCell {
    at: vec3u,
    part: vec3f,
}

fn mask_size() -> vec3u {
    return vec3u(domain.mask_size.xyz);
}

// Rounding may choose the cell beside that of q + w, whose spline continues there; `part` is accurate in any case.
fn mask_cell(q: vec3f, w: vec3f) -> MaskCell {
    let u = ((q - domain.mask_first.xyz) + w) * domain.mask_per_step.xyz;
    // Along an axis with one coefficient, the cell is the first.
    let i = max(min(max(floor(u), vec3f(1.0)), domain.mask_size.xyz - 3.0), vec3f(0.0));
    let near = (q - i * domain.mask_step.xyz) - domain.mask_first.xyz;
    let rest = w - (i * domain.mask_step_rest.xyz + domain.mask_first_rest.xyz);
    return MaskCell(vec3u(i), (near + rest) * domain.mask_per_step.xyz);
}

fn mask_at(i: u32) -> u32 {
    return (mask[i >> 1u] >> (16u * (i & 1u))) & 0xffffu;
}

fn mask_in(cell: MaskCell) -> u32 {
    let size = mask_size();
    return mask_at((cell.at.z * size.y + cell.at.y) * size.x + cell.at.x);
}

// The weights of four coefficients, at a part t of the way from the second to the third, and their derivatives.
struct Spline {
    value: vec4f,
    slope: vec4f,
}

fn spline(t: f32, size: u32, per_step: f32) -> Spline {
    if (size == 1u) {
        return Spline(vec4f(1.0, 0.0, 0.0, 0.0), vec4f(0.0));
    }
    let s = 1.0 - t;
    return Spline(
        vec4f(s * s * s, 4.0 - 3.0 * t * t * (2.0 - t), 4.0 - 3.0 * s * s * (2.0 - s), t * t * t) / 6.0,
        0.5 * per_step * vec4f(-s * s, t * (3.0 * t - 4.0), s * (4.0 - 3.0 * s), t * t),
    );
}

// m along a row of coefficients, and its slope.
fn along_row(first: u32, most: u32, x: Spline) -> vec2f {
    let i = first + min(vec4u(0u, 1u, 2u, 3u), vec4u(most));
    let c = vec4f(vec4u(mask_at(i.x), mask_at(i.y), mask_at(i.z), mask_at(i.w)) & vec4u(255u)) / 255.0;
    return vec2f(dot(x.value, c), dot(x.slope, c));
}

fn freed(q: vec3f, w: vec3f) -> Freed {
    let cell = mask_cell(q, w);
    let own = mask_in(cell);
    if (own >= 256u) {
        return Freed(f32(own & 255u) / 255.0, vec3f(0.0));
    }
    let size = mask_size();
    let x = spline(cell.part.x, size.x, domain.mask_per_step.x);
    let y = spline(cell.part.y, size.y, domain.mask_per_step.y);
    let z = spline(cell.part.z, size.z, domain.mask_per_step.z);
    // The first of the coefficients to read, and how many follow it along each axis.
    let first = cell.at - select(vec3u(1u), vec3u(0u), size == vec3u(1u));
    let most = select(vec3u(3u), vec3u(0u), size == vec3u(1u));
    let rows = size.x * min(vec4u(0u, 1u, 2u, 3u), vec4u(most.y));
    var found = vec4f(0.0); // m, and its slopes
    // The loop has a single turn for images: some drivers end loops after many turns.
    for (var k = 0u; k <= most.z; k++) {
        let start = ((first.z + k) * size.y + first.y) * size.x + first.x;
        let a = along_row(start + rows.x, most.x, x);
        let b = along_row(start + rows.y, most.x, x);
        let c = along_row(start + rows.z, most.x, x);
        let d = along_row(start + rows.w, most.x, x);
        let values = vec4f(a.x, b.x, c.x, d.x);
        let along = dot(y.value, values);
        found += vec4f(
            z.value[k] * along,
            z.value[k] * dot(y.value, vec4f(a.y, b.y, c.y, d.y)),
            z.value[k] * dot(y.slope, values),
            z.slope[k] * along,
        );
    }
    return Freed(found.x, found.yzw);
}

// True if m is 0 at a point, given in physical units, and in the cells beside its own.
fn frozen(q: vec3f) -> bool {
    if (!FROZEN) {
        return false;
    }
    let own = mask_in(mask_cell(q, vec3f(0.0)));
    return (own & 255u) == 0u && own >= 256u;
}
