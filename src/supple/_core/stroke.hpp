// The field: one stroke's displacement, its derivatives, and the chain of strokes.
//
// With r = p - pivot and s = |r|², a stroke displaces by (docs/method.md)
//
//     K(p) = A(s) v + B(s) (r·v) r,     A = Σ p_i ρ_i⁻ⁿ + q_i ρ_i⁻ⁿ⁻²,  B = Σ r_i ρ_i⁻ⁿ⁻²,  ρ_i² = s + e_i
//     J(p) u = 2A' (r·u) v + A M u + 2B' (r·u) (r·v) r + B [(u·v + r·M u) r + (r·v) u]              (' = d/ds)
//
// where v = f, M = 0 and n = 1 for a grab; and v = M r and n = 3 for the affine brushes: scale and pinch. A twist turns
// by the angle φ = A(s), which is 0 from the reach on: with M x = axis × x, R the rotation by φ, and S, C the sine and
// the cosine of φ/2,
//
//     K(p) = R r - r = 2S (C M r + S M² r)
//     J(p) u = R u - u + 2A' (r·u) R M r
//
// Strokes of one group act at once: their displacements at the same point are added.
//
// With a reach R, A and B are multiplied by m(t) = (1-t)³ (1 + 3t + 6t²), t = √s / R: 0 beyond, and C². With a fixed
// border, K_β = diag(β) K, J_β = diag(β) J + diag(β' ∘ K), and beyond a face the map is that at the nearest point of
// the face: there, the derivatives across the face are 0.
//
// With a freeze mask (`freeze.hpp`), K and J are those of m K: m J u + (∇m·u) K, before β.
//
// In a clip, a stroke has a stretch of the third axis: with D = diag(1, 1, stretch), K(p) = D⁻¹ K'(D r), K' with the
// force D f. Lengths, such as the reach, are those of D r. Unless it couples time to the plane, both r of the term with
// B are diag(1, 1, 0) r: then K has only the components of v. A grab with a plateau of radius a has K'(h r), where
// h = g(|r|) / |r|, g(ρ) = x² / (x + a/2), and x = max(ρ - a, 0): K is constant within the plateau, C³ at its rim, and
// nowhere steeper, as g' ≤ 1.
//
// All is a template over the number V (`double`, or a vector of doubles) and the dimension D. It uses no std::,
// allocation or exceptions, so that compilers for GPUs accept this file.
#pragma once
#include "freeze.hpp"
#include "simd.hpp"

namespace supple {

// One row of the stroke table, in physical units, in the layout of `supple._core.rows.STROKE_DTYPE`.
struct StrokeRow {
    double pivot[3], force[3], matrix[3][3], radius2[3], p[3], q[3], r[3];
    int64_t terms;
    int64_t power;   // n: 1, with a force, or 3, with a matrix
    int64_t group;   // consecutive strokes with the same number act at once; in a row, 1 if with the one before
    double reach;    // R, or infinity
    double most;     // a bound of the displacement of the strokes that act at once, or infinity
    double turn[3];  // for a twist: the factor of each component of its displacement; otherwise 0
    double stretch;  // of the third axis; `force` is stretched, too
    double coupled;  // 1, or 0 if r of the term with B has no third component
    double flat;     // the radius a of the plateau, or 0
    int64_t mask;    // the number of its freeze mask
};
// A stroke, with derived values.
struct Stroke : StrokeRow {
    double per_reach;      // 1/R, or 0; with a plateau, 1/g(R)
    double rim;            // the length over which a stroke varies at the rim of its plateau
    bool shared;           // its group has other strokes
    bool inner;            // the ball of its reach touches no fixed border: β is 1 in all of it
    const Freeze* freeze;  // or null: m is 1 in all of its ball
    bool turns() const { return turn[0] != 0; }
};

enum Profile : int64_t { QUARTIC = 0, SINE = 1 };

// An axis of the domain, in physical units, between its two faces. `sigma` is the width of the fixed border: -1 for a
// free axis, 0 for one without displacement.
struct Axis {
    double first, last, sigma, spacing;
    int64_t profile;
    bool fixed() const { return sigma >= 0; }
    double extent() const { return last - first; }
};

// The least spacing of D axes.
template <int D>
INLINE double finest_of(const Axis* axes) {
    double finest = axes[0].spacing;
    for (int d = 1; d < D; d++) finest = least(finest, axes[d].spacing);
    return finest;
}

// The nearest coordinate in the domain, along an axis with a fixed border.
template <class V>
INLINE V nearest(V x, const Axis& a) {
    return least(most(x, splat<V>(a.first)), splat<V>(a.last));
}

// The depth of a coordinate within the faces.
template <class V>
INLINE V depth(V x, const Axis& a) {
    return least(V(x - a.first), V(a.last - x));
}

// sin(x) on [0, π/2] by its Taylor series, to the last bit; unlike the library's, it vectorizes.
template <class V>
INLINE V sine(V x) {
    V t = x * x, y = splat<V>(-1.9572941063391263e-20);
    y = y * t + 8.2206352466243295e-18;
    y = y * t - 2.8114572543455206e-15;
    y = y * t + 7.6471637318198164e-13;
    y = y * t - 1.6059043836821613e-10;
    y = y * t + 2.5052108385441720e-08;
    y = y * t - 2.7557319223985893e-06;
    y = y * t + 1.9841269841269841e-04;
    y = y * t - 8.3333333333333332e-03;
    y = y * t + 1.6666666666666666e-01;
    return x - x * t * y;
}

// The sine and cosine of half an angle of up to a few turns; in every other turn, both have the opposite sign.
template <class V>
INLINE void half_turn(V angle, V& s, V& c) {
    // π as the sum of two numbers, of which the first times a small whole number is exact.
    const double first = 0x1.921fb544p1, rest = 0x1.0b4611a626331p-33, shift = 0x1.8p52;
    V turns = V(angle * 0.15915494309189535 + shift) - shift;
    V t = (0.5 * angle - turns * first) - turns * rest;
    s = sine(t);
    c = sine(V((1.5707963267948966 - magnitude(t)) + 6.123233995736766e-17));
}

// β of a coordinate within the domain, and its first and second derivative, up to ORDER.
template <int ORDER, class V>
INLINE void fade(V x, const Axis& a, V* b) {
    const V one = splat<V>(1.0);
    if (!(a.sigma > 0)) {
        for (int i = 0; i <= ORDER; i++) b[i] = i == 0 && a.sigma < 0 ? one : V{};
        return;
    }
    V t = least(V(most(depth(x, a), V{}) / a.sigma), one);
    V side = choose(x + x < a.first + a.last, one, V(-one)) / a.sigma;  // dt/dx
    if (a.profile == SINE) {
        const double quarter = 1.57079632679489661923;
        b[0] = sine(V(quarter * t));
        if (ORDER > 0) b[1] = quarter * side * sine(V(quarter * (1.0 - t)));
        if (ORDER > 1) b[2] = choose(t < 1.0, V(-(quarter / a.sigma) * (quarter / a.sigma) * b[0]), V{});
    } else {  // 2t - 2t³ + t⁴
        b[0] = t * (2.0 + t * t * (t - 2.0));
        if (ORDER > 0) b[1] = side * (2.0 + t * t * (4.0 * t - 6.0));
        if (ORDER > 1) b[2] = (-12.0 / (a.sigma * a.sigma)) * t * (1.0 - t);
    }
}

template <int D, class V>
INLINE V dot(const V* a, const V* b) {
    V s = a[0] * b[0];
    for (int i = 1; i < D; i++) s += a[i] * b[i];
    return s;
}

// M x, for one component.
template <int D, class V>
INLINE V turned(const Stroke& k, const V* x, int i) {
    V y = k.matrix[i][0] * x[0];
    for (int j = 1; j < D; j++) y += k.matrix[i][j] * x[j];
    return y;
}

// A, B and their derivatives: A[1] = 2A', A[2] = 4A''.
template <class V>
struct Radial {
    V A[3], B[3];
};

// g(ρ) of a stroke with a plateau.
template <class V>
INLINE V eased(const Stroke& k, V rho) {
    V x = most(V(rho - k.flat), V{});
    return x * x / (x + 0.5 * k.flat);
}

// The radial profiles of a stroke at s = |r|².
template <int ORDER, class V>
INLINE Radial<V> radial(const Stroke& k, V s) {
    Radial<V> f{};
    const double n = (double)k.power, n2 = n + 2, n4 = n2 * (n + 4);
    for (int i = 0; i < k.terms; i++) {
        V v = inverse_root(V(s + k.radius2[i])), v2 = v * v;
        if (k.power == 3) v *= v2;
        V next = v * v2;
        f.A[0] += k.p[i] * v + k.q[i] * next;
        f.B[0] += k.r[i] * next;
        if (ORDER > 0) {
            f.A[1] -= next * (n * k.p[i] + n2 * k.q[i] * v2);
            f.B[1] -= n2 * k.r[i] * next * v2;
        }
        if (ORDER > 1) {
            V last = next * v2;
            f.A[2] += last * (n * n2 * k.p[i] + n4 * k.q[i] * v2);
            f.B[2] += n4 * k.r[i] * last * v2;
        }
    }
    if (k.per_reach > 0) {  // the product rule with m, m1 = 2m' and m2 = 4m''
        const double i2 = k.per_reach * k.per_reach;
        V t = least(V(root(s) * k.per_reach), splat<V>(1.0)), w = 1.0 - t, w2 = w * w;
        V m = w2 * w * (1.0 + t * (3.0 + 6.0 * t));
        if (ORDER > 0) {
            V m1 = -30.0 * i2 * t * w2;
            if (ORDER > 1) {
                V m2 = -30.0 * i2 * i2 * w * (1.0 - 3.0 * t) / most(t, splat<V>(1e-12));
                f.A[2] = m * f.A[2] + 2.0 * m1 * f.A[1] + m2 * f.A[0];
                f.B[2] = m * f.B[2] + 2.0 * m1 * f.B[1] + m2 * f.B[0];
            }
            f.A[1] = m * f.A[1] + m1 * f.A[0];
            f.B[1] = m * f.B[1] + m1 * f.B[0];
        }
        f.A[0] *= m;
        f.B[0] *= m;
    }
    return f;
}

// The squared length over which a stroke varies, at s = |r|²: ρ²; near the rim of a plateau, where the third
// derivative is of the order 1 / (e a), less.
template <class V>
INLINE V scale2_of(const Stroke& k, V s) {
    V rho2 = s + k.radius2[0];
    if (k.flat > 0) {
        const V rho = root(s), g = eased(k, rho), near = magnitude(V(rho - k.flat)) + k.rim;
        rho2 = least(V(g * g + k.radius2[0]), V(near * near));
    }
    return rho2;
}

// A jet: a point x, tangents t[j] = ∂x/∂u_j and, if MIXED, ∂²x/∂u₀∂u₁; and the squared lengths over which the map
// varies along u₀ and u₁: ρ² / |t|²; 4 max(D_i, σ_i)² / t_i² at the distance D_i from a fixed face of axis i; and
// that of the freeze mask.
template <int D, int TANGENTS, bool MIXED, class V>
struct Jet {
    V x[D];
    V t[TANGENTS > 0 ? TANGENTS : 1][D];
    V mixed[MIXED ? D : 1];
    V smooth2[MIXED ? 2 : 1];
};

// The jet at x with the columns of I as tangents.
template <int D, int TANGENTS, bool MIXED = false, class V>
INLINE Jet<D, TANGENTS, MIXED, V> jet_at(const V* x) {
    Jet<D, TANGENTS, MIXED, V> jet{};
    for (int i = 0; i < D; i++) {
        jet.x[i] = x[i];
        if constexpr (TANGENTS > 0) jet.t[i][i] = splat<V>(1.0);
    }
    if constexpr (MIXED) jet.smooth2[0] = jet.smooth2[1] = splat<V>(1e300);
    return jet;
}

// A stroke's contribution to a jet, without mask and border: K, J u for the tangents u, and J n + K''(u₀, u₁).
template <int D, int TANGENTS, bool MIXED, class V>
struct Moving {
    V K[D], J[TANGENTS > 0 ? TANGENTS : 1][D], second[MIXED ? D : 1];
};

// Apply a plateau: map r, s = |r|², the tangents u and the mixed derivative n by r → h r.
template <int D, int TANGENTS, bool MIXED, class V>
INLINE void ease(const Stroke& k, V* r, V& s, V (*u)[D], V* n) {
    const V rho = root(most(s, splat<V>(1e-60))), x = most(V(rho - k.flat), V{}), over = 1.0 / (x + 0.5 * k.flat);
    const V rho2 = rho * rho, h = x * x * over / rho;
    if constexpr (TANGENTS > 0) {
        // h1 = h'/ρ, h2 = h1'/ρ
        const V slope = x * (x + k.flat) * over * over, h1 = (slope - h) / rho2;
        V ru[TANGENTS];
        for (int j = 0; j < TANGENTS; j++) ru[j] = dot<D>(r, u[j]);
        if constexpr (MIXED) {
            V bend = choose(x > 0.0, V(0.5 * k.flat * k.flat * over * over * over), V{});
            V h2 = (bend - 3.0 * rho * h1) / (rho * rho2), rn = dot<D>(r, n), along = h1 * (dot<D>(u[0], u[1]) + rn);
            along += h2 * ru[0] * ru[1];
            for (int i = 0; i < D; i++) {
                V turned = h1 * (ru[0] * u[1][i] + ru[1] * u[0][i]);
                n[i] = h * n[i] + turned + along * r[i];
            }
        }
        for (int j = 0; j < TANGENTS; j++)
            for (int i = 0; i < D; i++) u[j][i] = h * u[j][i] + h1 * ru[j] * r[i];
    }
    for (int i = 0; i < D; i++) r[i] = h * r[i];
    s = h * h * s;
}

template <int D, bool APART, int TANGENTS, bool MIXED, class V>
INLINE void displace(const Stroke& k, const V* r, V s, const V (*u)[D], const V* n,
                     Moving<D, TANGENTS, MIXED, V>& part) {
    constexpr int ORDER = MIXED ? 2 : TANGENTS > 0 ? 1 : 0;
    constexpr int N = TANGENTS > 0 ? TANGENTS : 1;
    const bool affine = k.power == 3;
    V f[D];
    for (int i = 0; i < D; i++) f[i] = affine ? turned<D>(k, r, i) : splat<V>(k.force[i]);
    Radial<V> g = radial<ORDER>(k, s);
    V plane[2 + N][D];  // r, n and u for the term with B, without their time
    const V *c = r, *cn = n;
    const V(*cu)[D] = u;
    if constexpr (APART) {
        for (int i = 0; i < D; i++) {
            plane[0][i] = i < 2 ? r[i] : V{};
            if constexpr (MIXED) plane[1][i] = i < 2 ? n[i] : V{};
            for (int j = 0; j < TANGENTS; j++) plane[2 + j][i] = i < 2 ? u[j][i] : V{};
        }
        c = plane[0];
        cn = plane[1];
        cu = plane + 2;
    }
    V rf = dot<D>(c, f);
    for (int i = 0; i < D; i++) part.K[i] = g.A[0] * f[i] + g.B[0] * rf * c[i];
    if constexpr (TANGENTS > 0) {
        // w = M u, and uf = u·v + r·w, the derivative of r·v.
        V w[N][D], ru[N], uf[N], h[N];
        for (int j = 0; j < TANGENTS; j++) {
            ru[j] = dot<D>(r, u[j]);
            uf[j] = dot<D>(cu[j], f);
            for (int i = 0; i < D; i++) w[j][i] = affine ? turned<D>(k, u[j], i) : V{};
            if (affine) uf[j] += dot<D>(c, w[j]);
            h[j] = g.B[1] * ru[j] * rf + g.B[0] * uf[j];
            for (int i = 0; i < D; i++) part.J[j][i] = g.A[1] * ru[j] * f[i] + h[j] * c[i] + g.B[0] * rf * cu[j][i];
            if (affine)
                for (int i = 0; i < D; i++) part.J[j][i] += g.A[0] * w[j][i];
        }
        if constexpr (MIXED) {
            V uv = dot<D>(u[0], u[1]), a = g.A[2] * ru[0] * ru[1] + g.A[1] * uv;
            V b = g.B[2] * ru[0] * ru[1] * rf + g.B[1] * (uv * rf + ru[0] * uf[1] + ru[1] * uf[0]);
            V rn = dot<D>(r, n), nf = dot<D>(cn, f), wn[D];
            for (int i = 0; i < D; i++) wn[i] = V{};
            if (affine) {
                for (int i = 0; i < D; i++) wn[i] = turned<D>(k, n, i);
                nf += dot<D>(c, wn);
                b += g.B[0] * (dot<D>(cu[0], w[1]) + dot<D>(cu[1], w[0]));
            }
            V hn = g.B[1] * rn * rf + g.B[0] * nf;
            for (int i = 0; i < D; i++) {
                V Jn = g.A[1] * rn * f[i] + hn * c[i] + g.B[0] * rf * cn[i];
                part.second[i] = a * f[i] + b * c[i] + h[0] * cu[1][i] + h[1] * cu[0][i] + Jn;
                if (affine) part.second[i] += g.A[0] * wn[i] + g.A[1] * (ru[0] * w[1][i] + ru[1] * w[0][i]);
            }
        }
    }
}

// The same for a twist; with φ' = ∂φ/∂u, K''(u₀, u₁) = ∂R/∂φ (φ'₀ u₁ + φ'₁ u₀) + ∂²R/∂φ² r φ'₀ φ'₁ + ∂R/∂φ r φ''.
// `steep2` gets the squares of φ'.
template <int D, int TANGENTS, bool MIXED, class V>
INLINE void swing(const Stroke& k, const V* r, V s, const V (*u)[D], const V* n, Moving<D, TANGENTS, MIXED, V>& part,
                  V* steep2) {
    constexpr int ORDER = MIXED ? 2 : TANGENTS > 0 ? 1 : 0;
    Radial<V> g = radial<ORDER>(k, s);
    V half[2];
    half_turn(g.A[0], half[0], half[1]);
    const V sin_phi = 2.0 * half[0] * half[1], less = 2.0 * half[0] * half[0], cos_phi = 1.0 - less;
    // a M x + b M² x: with (sin φ, 1 - cos φ), R x - x; with (cos φ, sin φ), ∂R/∂φ x; with (-sin φ, cos φ), ∂²R/∂φ² x.
    auto put = [&](const V* x, V a, V b, V* to) INLINE_LAMBDA {
        V once[D];
        for (int i = 0; i < D; i++) once[i] = turned<D>(k, x, i);
        for (int i = 0; i < D; i++) to[i] += k.turn[i] * (a * once[i] + b * turned<D>(k, once, i));
    };
    part = {};
    put(r, sin_phi, less, part.K);
    if constexpr (TANGENTS > 0) {
        V rise[TANGENTS];
        for (int j = 0; j < TANGENTS; j++) {
            rise[j] = g.A[1] * dot<D>(r, u[j]);
            put(u[j], sin_phi, less, part.J[j]);
            put(r, cos_phi * rise[j], sin_phi * rise[j], part.J[j]);
        }
        if constexpr (MIXED) {
            V both = rise[0] * rise[1], bend = g.A[2] * dot<D>(r, u[0]) * dot<D>(r, u[1]) + g.A[1] * dot<D>(u[0], u[1]);
            bend += g.A[1] * dot<D>(r, n);
            put(n, sin_phi, less, part.second);
            put(u[1], cos_phi * rise[0], sin_phi * rise[0], part.second);
            put(u[0], cos_phi * rise[1], sin_phi * rise[1], part.second);
            put(r, bend * cos_phi - both * sin_phi, bend * sin_phi + both * cos_phi, part.second);
            for (int j = 0; j < 2; j++) steep2[j] = rise[j] * rise[j];
        }
    }
}

// Add one stroke's contribution, evaluated at the jet `at`, to a jet: x += K, t += J t, mixed += J mixed + K''(t₀, t₁).
// If `jet` is `at` itself, this maps it by the stroke.
template <int D, int TANGENTS, bool MIXED, class V>
ONCE void add(const Stroke& k, const Axis* axes, const Jet<D, TANGENTS, MIXED, V>& at,
              Jet<D, TANGENTS, MIXED, V>& jet) {
    constexpr int ORDER = MIXED ? 2 : TANGENTS > 0 ? 1 : 0;
    constexpr int N = TANGENTS > 0 ? TANGENTS : 1;
    V place[D], r[D], inside[D], beta[D][3], s = V{};
    for (int i = 0; i < D; i++) {
        V near = at.x[i];
        inside[i] = splat<V>(1.0);
        // Beside the only plane of an axis without extent, the map is that on the plane, even for inner strokes.
        bool fading = axes[i].fixed() && (!k.inner || axes[i].extent() == 0);
        if (fading) {
            near = nearest(near, axes[i]);
            inside[i] = choose(near == at.x[i], inside[i], V{});
            fade<ORDER>(near, axes[i], beta[i]);
        } else {
            beta[i][0] = splat<V>(1.0);
            beta[i][1] = beta[i][2] = V{};
        }
        place[i] = near;
        r[i] = near - k.pivot[i];
        if (i == 2) r[i] *= k.stretch;
        s += r[i] * r[i];
    }
    // The tangents at the nearest point in the domain.
    V u[N][D], n[MIXED ? D : 1], steep2[2];
    for (int j = 0; j < TANGENTS; j++)
        for (int i = 0; i < D; i++) u[j][i] = inside[i] * at.t[j][i];
    if constexpr (MIXED)
        for (int i = 0; i < D; i++) n[i] = inside[i] * at.mixed[i];
    Moving<D, TANGENTS, MIXED, V> part;
    const V round2 = scale2_of(k, s);
    V v[N][D], bent[MIXED ? D : 1];  // u and n, stretched and flattened
    for (int i = 0; i < D; i++) {
        for (int j = 0; j < TANGENTS; j++) v[j][i] = i < 2 ? u[j][i] : V(k.stretch * u[j][i]);
        if constexpr (MIXED) bent[i] = i < 2 ? n[i] : V(k.stretch * n[i]);
    }
    if (k.flat > 0) ease<D, TANGENTS, MIXED>(k, r, s, v, bent);
    if (k.turns())
        swing<D>(k, r, s, v, bent, part, steep2);
    else if (D == 3 && k.coupled == 0)
        displace<D, D == 3>(k, r, s, v, bent, part);
    else
        displace<D, false>(k, r, s, v, bent, part);
    if constexpr (D == 3) {
        const double back = 1.0 / k.stretch;
        part.K[2] *= back;
        for (int j = 0; j < TANGENTS; j++) part.J[j][2] *= back;
        if constexpr (MIXED) part.second[2] *= back;
    }
    V(&K)[D] = part.K;
    V(&Ju)[N][D] = part.J;
    Freed<D, ORDER, V> free{};
    if (k.freeze) {
        free = freed<D, ORDER, V>(*k.freeze, place);
        V turn[N];  // ∇m·u
        for (int j = 0; j < TANGENTS; j++) turn[j] = dot<D>(free.slope, u[j]);
        if constexpr (MIXED) {
            V way = dot<D>(free.slope, n);  // ∇m·n + u₀ᵀ ∇∇m u₁
            for (int i = 0; i < D; i++) way += u[0][i] * dot<D>(free.bend[i], u[1]);
            for (int i = 0; i < D; i++)
                part.second[i] = free.m * part.second[i] + turn[0] * Ju[1][i] + turn[1] * Ju[0][i] + way * K[i];
        }
        for (int j = 0; j < TANGENTS; j++)
            for (int i = 0; i < D; i++) Ju[j][i] = free.m * Ju[j][i] + turn[j] * K[i];
        for (int i = 0; i < D; i++) K[i] *= free.m;
    }
    if constexpr (MIXED) {
        for (int i = 0; i < D; i++)
            jet.mixed[i] += beta[i][0] * part.second[i] +
                            beta[i][1] * (u[0][i] * Ju[1][i] + u[1][i] * Ju[0][i] + n[i] * K[i]) +
                            beta[i][2] * u[0][i] * u[1][i] * K[i];
        for (int j = 0; j < 2; j++) {
            V along[D];
            for (int i = 0; i < D; i++) along[i] = i < 2 ? at.t[j][i] : V(k.stretch * at.t[j][i]);
            V scale2 = round2 / dot<D>(along, along);
            if (k.freeze) {
                V cells = splat<V>(1e-300);  // squared cells of the mask per step of q, along axes along which m varies
                for (int i = 0; i < D; i++)
                    if (k.freeze->size[i] > 1) {
                        const V part = k.freeze->per_step[i] * at.t[j][i];
                        cells += part * part;
                    }
                scale2 = least(scale2, V(free.smooth * free.smooth / cells));
            }
            for (int i = 0; i < D; i++)
                if (axes[i].sigma > 0 && !k.inner) {
                    // β varies along its own axis alone: over σ at a face, and it is constant farther in.
                    V scale = 2.0 * most(depth(at.x[i], axes[i]), splat<V>(axes[i].sigma)), along = at.t[j][i];
                    scale2 = least(scale2, V(scale * scale / most(V(along * along), splat<V>(1e-300))));
                }
            if (k.turns()) scale2 = least(scale2, V(1.0 / most(steep2[j], splat<V>(1e-300))));  // a radian of a twist
            jet.smooth2[j] = least(jet.smooth2[j], scale2);
        }
    }
    for (int j = 0; j < TANGENTS; j++)
        for (int i = 0; i < D; i++) jet.t[j][i] += beta[i][0] * Ju[j][i] + beta[i][1] * u[j][i] * K[i];
    for (int i = 0; i < D; i++) jet.x[i] += beta[i][0] * K[i];
}

// The inverse of the matrix whose columns are t, as columns again.
template <class V>
INLINE void invert(const V (*t)[2], V (*m)[2]) {
    V d = 1.0 / (t[0][0] * t[1][1] - t[1][0] * t[0][1]);
    m[0][0] = t[1][1] * d;
    m[0][1] = -t[0][1] * d;
    m[1][0] = -t[1][0] * d;
    m[1][1] = t[0][0] * d;
}
template <class V>
INLINE void invert(const V (*t)[3], V (*m)[3]) {
    V c[3][3];  // the adjugate
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            int a = (i + 1) % 3, b = (i + 2) % 3, p = (j + 1) % 3, q = (j + 2) % 3;
            c[j][i] = t[a][p] * t[b][q] - t[a][q] * t[b][p];
        }
    V d = 1.0 / (t[0][0] * c[0][0] + t[0][1] * c[1][0] + t[0][2] * c[2][0]);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) m[i][j] = c[i][j] * d;
}
// Component i of the matrix with the columns t, times x.
template <int D, class V>
INLINE V times(const V (*t)[D], const V* x, int i) {
    V s = t[0][i] * x[0];
    for (int j = 1; j < D; j++) s += t[j][i] * x[j];
    return s;
}
// x ← the matrix with the columns t, times x.
template <int D, class V>
INLINE void transform(const V (*t)[D], V* x) {
    V y[D];
    for (int i = 0; i < D; i++) y[i] = times<D>(t, x, i);
    for (int i = 0; i < D; i++) x[i] = y[i];
}

}  // namespace supple
