// The residual footprint: the cubic interpolant, averaged over the output pixel less one input pixel.
//
// With M = ∂p/∂q, S = M Mᵀ = [[xx, xy], [xy, yy]], its eigenvalues λ± = h ± d, and α, β = max(λ± - 1, 0):
//     12 Σ = ½(α+β) I + (α-β)/(2d) (S - hI)
// is the covariance of the remaining average, as a pixel of the input is an average already. Constants are those of
// footprint.hpp.

struct Footprint {
    covariance: vec3f, // of one spot: xx, xy and yy of Σ
    wide: bool, // true for several spots, or coarser levels
    major: f32, // λ+ and λ-
    minor: f32,
    axis: vec2f, // of λ+
}

fn footprint_of(m: mat3x3f) -> Footprint {
    let x = vec2f(m[0].x, m[1].x);
    let y = vec2f(m[0].y, m[1].y);
    let xy = dot(x, y);
    let h = 0.5 * (dot(x, x) + dot(y, y));
    let e = 0.5 * (dot(x, x) - dot(y, y));
    let d = sqrt(e * e + xy * xy);
    var out = Footprint(vec3f(0.0), false, h + d, max(h - d, 0.0), vec2f(1.0, 0.0));
    let a = max(out.major - 1.0, 0.0);
    let b = max(out.minor - 1.0, 0.0);
    if (!(a > LOW)) {
        return out;
    }
    if (a >= NARROW || out.minor >= SQUARE) {
        out.wide = true;
        // The eigenvector of λ+, from the column of S - λ- I that is longer.
        let along_x = vec2f(d + e, xy);
        let along_y = vec2f(xy, d - e);
        let axis = select(along_y, along_x, e >= 0.0);
        out.axis = select(vec2f(1.0, 0.0), axis / length(axis), d > 0.0);
        return out;
    }
    let g = min(1.0, (RISE / (RISE - LOW)) * (a - LOW) / a);
    let mean = 0.5 * (a + b);
    let part = select(0.0, 0.5 * (a - b) / d, d > 0.0);
    out.covariance = g / 12.0 * vec3f(mean + part * e, part * xy, mean - part * e);
    return out;
}

// Keys' kernel.
fn keys(t: f32) -> f32 {
    let x = abs(t);
    let inner = 1.0 + x * x * (-(KEYS + 3.0) + (KEYS + 2.0) * x);
    let outer = KEYS * (-4.0 + x * (8.0 + x * (-5.0 + x)));
    return select(select(outer, inner, x <= 1.0), 0.0, x >= 2.0);
}

// Half the sum and half the difference of a sample's weights at both points of an axis.
fn both(t: f32, sigma: f32) -> vec2f {
    let a = keys(t - sigma);
    let b = keys(t + sigma);
    return 0.5 * vec2f(a + b, a - b);
}

// Four cubic samples at (±√Σxx, ±√Σyy) around a point, with weights (1 ± ρ)/4: those of 5 by 5 samples, of which each
// axis has its even and its odd part.
fn spot(level: Level, base: vec2i, part: vec2f, covariance: vec3f, frame: i32) -> vec4f {
    let sigma = sqrt(max(covariance.xz, vec2f(0.0)));
    let product = sigma.x * sigma.y;
    let rho = select(0.0, clamp(covariance.y / product, -1.0, 1.0), product > 0.0);
    let apart = min(sigma, vec2f(WIDEST_SPOT));
    let first = vec2i(floor(part - apart)) - 1;
    let start = vec2f(first) - part;
    var total = vec4f(0.0);
    for (var j = 0; j < 5; j++) {
        let y = both(start.y + f32(j), apart.y);
        if (all(y == vec2f(0.0))) {
            continue;
        }
        for (var i = 0; i < 5; i++) {
            let x = both(start.x + f32(i), apart.x);
            let weight = x.x * y.x + rho * x.y * y.y;
            if (weight != 0.0) {
                total += weight * texel(level, base.x + first.x + i, base.y + first.y + j, frame);
            }
        }
    }
    return total;
}

fn faded(f: f32) -> f32 {
    let x = clamp(f, 0.0, 1.0);
    return x * x * (3.0 - 2.0 * x);
}

// One spot; or several along the major axis, of one level or of two.
fn averaged(place: Place, over: Footprint, frame: i32) -> vec4f {
    var first = 0u;
    var deeper = 0.0; // the weight of the next level
    if (over.wide) {
        var want = max(over.minor, over.major / LONG);
        while (want >= LEVEL && first < settings.levels) {
            first += 1u;
            want *= 0.25;
        }
        if (first < settings.levels) {
            deeper = faded((want - SQUARE) / (LEVEL - SQUARE));
        }
    }
    var total = vec4f(0.0);
    for (var l = 0u; l < select(1u, 2u, deeper > 0.0); l++) {
        let level = level_of(first + l);
        let unit = 1 << level.number;
        let base = place.base.xy >> vec2u(level.number);
        let at = (vec2f(place.base.xy - base * unit) + place.part.xy + 0.5) / f32(unit) - 0.5;
        var count = 1.0;
        var more = 0.0; // the weight of the next count
        var reach = 0.0;
        var minor = 0.0;
        if (over.wide) {
            let scale = 1.0 / f32(unit * unit);
            minor = clamp(over.minor * scale - 1.0, 0.0, FLATTEST);
            reach = sqrt(max(over.major * scale - 1.0, 0.0));
            count = min(floor(reach / PER_SPOT) + 1.0, MOST_SPOTS);
            more = select(0.0, faded((reach / PER_SPOT - (count - 1.0) - FADES) / (1.0 - FADES)), count < MOST_SPOTS);
        }
        for (var m = 0u; m < select(1u, 2u, more > 0.0); m++) {
            let n = count + f32(m);
            let share = select(1.0 - deeper, deeper, l == 1u) * select(1.0 - more, more, m == 1u) / n;
            var covariance = over.covariance;
            if (over.wide) {
                let major = min(reach * reach / (n * n), THICKEST);
                let u = over.axis;
                covariance = vec3f(
                    major * u.x * u.x + minor * u.y * u.y, (major - minor) * u.x * u.y, major * u.y * u.y + minor * u.x * u.x
                ) / 12.0;
            }
            for (var k = 0.0; k < n; k += 1.0) {
                let where_ = at + reach * ((k + 0.5) / n - 0.5) * over.axis;
                let whole = floor(where_);
                total += share * spot(level, base + vec2i(whole), where_ - whole, covariance, frame);
            }
        }
    }
    return total;
}
