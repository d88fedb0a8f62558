// The margin to folding of strokes that act at once: the least eigenvalue of a matrix field, bounded over all points.
//
// Let S = sym(J_β), for the sum of some strokes (`stroke.hpp`), and μ the minimum of λ_min(S) over the domain. Branch
// and bound finds it, starting with the box with the lowest bound; no box crosses an end of the border. In a box of
// widths h, S differs from the multilinear interpolant of its values at the corners v by at most Σ_k h_k²/8 |∂_kk S|.
// interpolant is a mean of the S(v), and λ_min is concave,
//
//     λ_min(S(p)) ≥ min_v λ_min(S(v) - D),   D diagonal with  xᵀ D x ≥ Σ_k h_k²/8 |xᵀ ∂_kk S(p) x|.          (1)
//
// Let N_n bound the n-th derivatives of K in the box, bⁿ_i those of β_i, and b⁰ be the largest of the b⁰_i. With ∂_x
// along x, xᵀ S x = Σ_i x_i (β_i ∂_x K_i + β_i' x_i K_i), where only β_k depends on p_k. Hence
//
//     |xᵀ ∂_kk S x| ≤ b⁰ N₃ |x|² + Σ_i b¹_i N₂ x_i² + (2 b¹_k N₂ + b²_k N₁) |x_k| |x| + (2 b²_k N₁ + b³_k N₀) x_k²  (2)
//     |S| ≤ b⁰ N₁ + max_i b¹_i N₀                                                                          (3)
//
// The grab. K of 1, 2 and 3 scales is a constant times the zeroth, first and second divided difference, in e = ε², of
//
//     U = (1-ω) ρ^-1 f + e/2 ρ^-3 f + ω ρ^-3 (r·f) r,    ω = b/a, ρ² = |r|² + e,
//
// hence a mean of U, ∂U/∂e or ∂²U/∂e² / 2. As e = ρ² - |r|², these are, but for a constant, with q = k/(3-2ω),
//
//     ρ^-k f - q ρ^-(k+2) [ |r|² f - 2ω (r·f) r ]                                                           (4)
//     = (1-q) ρ^-k f + q e ρ^-(k+2) f + 2ωq ρ^-(k+2) (r·f) r,    k = 1, 3, 5.                               (5)
//
// Bounds of single terms lose little in (4) near the pivot, and in (5) far from it. The n-th derivative of ρ^-k is a
// Gegenbauer polynomial of a cosine times |r|/ρ, over ρ^(k+n). The bracket of (4), a mean of those with 2ω = 0 and 1,
// and (r·f) r, both times ρ^-(k+2), have derivatives along a unit vector that are symmetric matrices in its plane with
// r: polynomials of |r|/ρ and the angle. Their terms cancel, so that bounds of single terms would be up to 25 times too
// large. Their norms were maximized over the angle numerically; `bracket_bounds` exceeds them by at least 0.1 %, except
// at the pivot, where it is tangent to them.
//
// The affine brushes. The derivatives of M r are at most |M| |r| and |M|, those of (rᵀ M r) r at most 1, 3, 6 and 6
// times |M| |r|³, |M| |r|², |M| |r| and |M|; Leibniz' rule bounds products with powers of ρ. Bounds of a sum are sums.
//
// A twist. With Φ_n the bounds of φ, those of R(φ) - I are 2 or Φ₀, Φ₁, Φ₂ + Φ₁² and Φ₃ + 3 Φ₁ Φ₂ + Φ₁³; and r has the
// first derivative alone.
//
// A freeze mask multiplies K, too; the differences of its coefficients bound its derivatives (`frozen.hpp`).
//
// Where m varies much faster than K, (1) needs many boxes. Within one of its cells, with K' = β∘K at the middle, up to
// δ from that elsewhere,
//
//     λ_min(S) ≥ min ½ (K'·g - |K'| |g|) - δ max |g| - max m (max β N₁ + max |β'| N₀),                      (6)
//
// over vectors g whose hull contains ∇m everywhere in the box: λ_min is concave, so the minimum is at one of them.
//
// The reach multiplies K, or φ, by m = 1 - 10t³ + 15t⁴ - 6t⁵, t = |r|/R. Its first three derivatives are at most 30 t²
// (1-t)², 10/√3 and 60, over R, R² and R³; those of the product follow by Leibniz. The third jumps at t = 0 and 1, but
// the second derivatives of S are bounded all the same, which is all that (1) asks for.
//
// With a plateau, K is K'(r') of r' = g(ρ) r/ρ: with N'_n, the bounds of K' where |r'| is, and G_n those of r',
//
//     N₁ = N'₁ G₁,    N₂ = N'₂ G₁² + N'₁ G₂,    N₃ = N'₃ G₁³ + 3 N'₂ G₁ G₂ + N'₁ G₃                          (7)
//
// and for a unit vector u at an angle of cosine c to r, h = g/ρ, r' has the derivatives 2h'c u + (h' + (ρh'' - h') c²)
// r/ρ and 3 (h'/ρ + (h'' - h'/ρ) c²) u + (3c (1-c²) (h'' - h'/ρ) + c³ ρ h''') r/ρ, in which c (1-c²) ≤ 0.385.
//
// Axes along which no stroke of a group moves anything (a clip's time, or its plane) are left out: T is one-to-one if
// it is so along the others, for all coordinates along these. Lengths are in the metric of the strokes, without a
// stretch.
//
// Bounds are reduced by the rounding error.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "newton.hpp"
#include "table.hpp"
#include "threads.hpp"

namespace supple::folds {

constexpr double INFINITE = std::numeric_limits<double>::infinity();
// At a double root, the cosine formula for a cubic's roots loses half of the digits.
constexpr double CUBIC = 1e-7;
constexpr double TINY = 1e-150;
constexpr double HUGE_BOUND = 1e100;  // in place of an infinite bound: its square is finite
constexpr int MOST_BOXES = 200'000;   // the largest number of boxes
constexpr Axis FREE[3] = {{0, 1, -1, 1, QUARTIC}, {0, 1, -1, 1, QUARTIC}, {0, 1, -1, 1, QUARTIC}};

struct Region {
    double low[3], high[3];
    double bound = -INFINITE;  // a lower bound of λ_min(S)
};

// Bounds of μ, and the point where λ_min(S) is the upper one.
struct Bounds {
    double lower = 0, upper = 0, point[3] = {};
};

// ---- bounds of derivatives in a box --------------------------------------------------------------------------------

// Bounds of a product, by Leibniz' rule.
inline Derivatives product(const Derivatives& a, const Derivatives& b) {
    return {
        a[0] * b[0],
        a[0] * b[1] + a[1] * b[0],
        a[0] * b[2] + 2 * a[1] * b[1] + a[2] * b[0],
        a[0] * b[3] + 3 * a[1] * b[2] + 3 * a[2] * b[1] + a[3] * b[0],
    };
}

// Bounds of β between two points of an axis, both within the border or both beyond it.
inline Derivatives fade_bounds(const Axis& axis, double low, double high) {
    if (axis.extent() == 0) return {};  // no points along it that could fold
    const auto [shallow, deep] = std::minmax({depth(low, axis), depth(high, axis)});
    if (!(axis.sigma > 0) || shallow >= axis.sigma) return {1, 0, 0, 0};
    double most[1], steepest[2];  // β grows with the depth, β' falls
    fade<0>(axis.first + deep, axis, most);
    fade<1>(axis.first + shallow, axis, steepest);
    const double value = most[0], slope = std::abs(steepest[1]), sigma2 = axis.sigma * axis.sigma;
    if (axis.profile == SINE) {
        const double k2 = 0.25 * std::numbers::pi * std::numbers::pi / sigma2;  // β'' = -k² β
        return {value, slope, k2 * value, k2 * slope};
    }
    // σ² |β''| = 12 t (1-t), σ³ |β'''| = 12 |1-2t|
    const double a = shallow / axis.sigma, b = std::min(deep / axis.sigma, 1.0), t = std::clamp(0.5, a, b);
    const double third = std::max(std::abs(1 - 2 * a), std::abs(1 - 2 * b));
    return {value, slope, 12 * t * (1 - t) / sigma2, 12 * third / (sigma2 * axis.sigma)};
}

// Bounds of ρ^-k, times ρ^k, ρ^(k+1) and so on, where |r|/ρ is at most x.
inline Derivatives power_bounds(double k, double x) {
    const double c = k * (k + 2);
    return {1, k * x, std::max(k, c * x * x - k), c * std::max(2 / std::sqrt(k + 4), x * ((k + 4) * x * x - 3))};
}

// Bounds of the factors of ρ^-(k+2) in (4) and (5), times ρ^k, ρ^(k+1) and so on, where |r|/ρ is at most x.
inline Derivatives bracket_bounds(double k, double x) {
    static constexpr double LEVEL[3][3] = {{0.67, 2.002, 7.5}, {0.56, 2.34, 10.5}, {0.475, 2.73, 15.4}};
    static constexpr double RISE[3][3] = {{1.06, 1.07, 2.43}, {3.05, 9.7, 49.8}, {9.9, 28.9, 195.5}};
    const int row = ((int)k - 1) / 2;
    const double *level = LEVEL[row], *rise = RISE[row], x2 = x * x, x8 = x2 * x2 * x2 * x2;
    return {
        x2,
        std::min(2 * x, level[0]) + rise[0] * x8,
        level[1] + rise[1] * x8,
        std::min(12 * (k + 2) * x, level[2]) + rise[2] * x8,
    };
}

// Bounds of K for a grab without reach, from (4) and (5), where near² ≤ |r|² ≤ far².
inline Derivatives grab_bounds(const Stroke& stroke, double near2, double far2) {
    const double* e = stroke.radius2;
    const int last = (int)stroke.terms - 1;
    const double k = 2 * last + 1, omega = stroke.r[0] / (stroke.p[0] + stroke.r[0]), q = k / (3 - 2 * omega);
    const double rho2 = near2 + e[0], rho = std::sqrt(rho2), x = std::sqrt(far2 / (far2 + e[0]));
    const Derivatives power = power_bounds(k, x), next = power_bounds(k + 2, x), bracket = bracket_bounds(k, x);
    double scale = strength_of(stroke) * (stroke.p[0] + stroke.q[0] / e[0]) / rho;  // the constant, times ρ^-k
    for (int i = 1; i <= last; i++) scale *= (1 - 0.5 / i) * (e[i] - e[0]) / rho2;
    Derivatives found;
    for (int n = 0; n < 4; n++) {
        const double near_pivot = power[n] + q * bracket[n];
        const double far_away =
            std::abs(1 - q) * power[n] + q * (e[last] / (near2 + e[last])) * next[n] + 2 * omega * q * bracket[n];
        found[n] = scale * std::min(near_pivot, far_away);
        scale /= rho;
    }
    return found;
}

// Bounds of the reach's factor m, likewise.
inline Derivatives support_bounds(const Stroke& stroke, double near2, double far2) {
    const double i = stroke.per_reach, a = i * std::sqrt(near2), b = i * std::sqrt(far2), t = std::clamp(0.5, a, b);
    const double m = (1 - a) * (1 - a) * (1 - a) * (1 + a * (3 + 6 * a));
    return i == 0 ? Derivatives{1, 0, 0, 0}
                  : Derivatives{m, 30 * i * t * t * (1 - t) * (1 - t), 5.7736 * i * i, 60 * i * i * i};
}

// Bounds of K for a twist, likewise.
inline Derivatives twist_bounds(const Stroke& stroke, double near2, double far2) {
    const double e = stroke.radius2[0], rho2 = near2 + e, far = std::sqrt(far2), x = std::sqrt(far2 / (far2 + e));
    const Derivatives third = power_bounds(3, x), fifth = power_bounds(5, x);
    double scale = strength_of(stroke) / (rho2 * std::sqrt(rho2));
    Derivatives phi;
    for (int n = 0; n < 4; n++) {
        phi[n] = scale * (std::abs(stroke.p[0]) * third[n] + std::abs(stroke.q[0]) / rho2 * fifth[n]);
        scale /= std::sqrt(rho2);
    }
    phi = product(support_bounds(stroke, near2, far2), phi);
    const Derivatives turned{std::min(phi[0], 2.0), phi[1], phi[2] + phi[1] * phi[1],
                             phi[3] + 3 * phi[1] * phi[2] + phi[1] * phi[1] * phi[1]};
    return product(turned, {far, 1, 0, 0});
}

// Bounds of K for an affine brush without reach, likewise.
inline Derivatives affine_bounds(const Stroke& stroke, double near2, double far2) {
    const double e = stroke.radius2[0], rho2 = near2 + e, x = std::sqrt(far2 / (far2 + e));
    const Derivatives third = power_bounds(3, x), fifth = power_bounds(5, x);
    const Derivatives cubic{
        x * x * x * fifth[0],
        x * x * (x * fifth[1] + 3 * fifth[0]),
        x * (x * x * fifth[2] + 6 * x * fifth[1] + 6 * fifth[0]),
        x * x * x * fifth[3] + 9 * x * x * fifth[2] + 18 * x * fifth[1] + 6 * fifth[0],
    };
    double scale = strength_of(stroke) / rho2;
    Derivatives found;
    for (int n = 0; n < 4; n++) {
        const double along = x * third[n] + (n ? n * third[n - 1] : 0),
                     next = x * fifth[n] + (n ? n * fifth[n - 1] : 0);
        found[n] = scale * (std::abs(stroke.p[0]) * along + std::abs(stroke.q[0]) / rho2 * next +
                            std::abs(stroke.r[0]) * cubic[n]);
        scale /= std::sqrt(rho2);
    }
    return found;
}

// Bounds of K: the N_n.
inline Derivatives displacement_bounds(const Stroke& stroke, double near2, double far2) {
    if (stroke.turns()) return twist_bounds(stroke, near2, far2);
    const Derivatives n = stroke.power == 3 ? affine_bounds(stroke, near2, far2) : grab_bounds(stroke, near2, far2);
    return stroke.per_reach == 0 ? n : product(support_bounds(stroke, near2, far2), n);
}

// Bounds of K with a plateau, by (7), where near² ≤ |r|² ≤ far².
inline Derivatives eased_bounds(const Stroke& stroke, double near2, double far2) {
    const double near = std::max(std::sqrt(near2), stroke.flat), far = std::max(std::sqrt(far2), near);
    const double x = near - stroke.flat, w = 0.5 * stroke.flat, end = far - stroke.flat + w;
    const double g0 = eased(stroke, near), g1 = eased(stroke, far);
    // g' grows, g'' and |g'''| fall; h' = (g' - h) / ρ, ρ h'' = g'' - 2 h', ρ h''' = g''' - 3 h''.
    const double slope = (end - w) * (end + w) / (end * end), bend = 2 * w * w / std::pow(x + w, 3);
    const double h1 = slope / near, most = std::max(bend, 2 * h1), h2 = most / near, third = 3 * bend / (x + w);
    const double G2 = 2 * h1 + most, G3 = 3 * h2 + 1.155 * (h2 + h1 / near) + third + 3 * h2;
    const Derivatives n = displacement_bounds(stroke, g0 * g0, g1 * g1);
    return {n[0], n[1] * slope, n[2] * slope * slope + n[1] * G2,
            n[3] * slope * slope * slope + 3 * n[2] * slope * G2 + n[1] * G3};
}

// ---- S at points, and its smallest eigenvalue ----------------------------------------------------------------------

template <class V>
struct Symmetric {
    V xx, yy, zz, xy, xz, yz;
};

// S of a group of strokes at points, for the axes along which points move.
inline Symmetric<Lanes> strain(const Chain& group, const Axis* axes, const bool* moving, const Lanes* x) {
    Lanes beta[3][2], J[3][3] = {};
    for (int i = 0; i < 3; i++) fade<1>(x[i], axes[i], beta[i]);
    Jet<3, 3, false, Lanes> at = jet_at<3, 3>(x), moved{};
    for (int k = 0; k < group.count; k++) add(group[k], FREE, at, moved);
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) J[i][j] = beta[i][0] * moved.t[j][i];
        J[i][i] += beta[i][1] * moved.x[i];
    }
    const auto s = [&](int i, int j) { return moving[i] && moving[j] ? 0.5 * (J[i][j] + J[j][i]) : Lanes{}; };
    return {s(0, 0), s(1, 1), s(2, 2), s(0, 1), s(0, 2), s(1, 2)};
}

// S - D of one point.
inline Symmetric<double> less(const Symmetric<Lanes>& s, int l, const double* d) {
    return {s.xx[l] - d[0], s.yy[l] - d[1], s.zz[l] - d[2], s.xy[l], s.xz[l], s.yz[l]};
}

// λ_min, with an error of `slack` times the spread of the eigenvalues.
inline double smallest_eigenvalue(const Symmetric<double>& s, double slack) {
    auto [a, b, c, xy, xz, yz] = s;
    if (xz == 0 && yz == 0) return std::min(c, 0.5 * (a + b) - std::sqrt(0.25 * (a - b) * (a - b) + xy * xy));
    const double mean = (a + b + c) / 3;
    a -= mean, b -= mean, c -= mean;
    const double p = std::sqrt((a * a + b * b + c * c + 2 * (xy * xy + xz * xz + yz * yz)) / 6) + TINY;
    a /= p, b /= p, c /= p, xy /= p, xz /= p, yz /= p;
    const double half = 0.5 * (a * (b * c - yz * yz) - xy * (xy * c - xz * yz) + xz * (xy * yz - b * xz));
    const double angle = std::acos(std::clamp(half, -1.0, 1.0)) / 3;
    return mean + p * (2 * std::cos(angle + 2 * std::numbers::pi / 3) + slack);
}

// True if λ_min ≥ level, up to rounding, by a Cholesky factorization: much faster than λ_min itself.
inline bool is_at_least(const Symmetric<double>& s, double level) {
    const double a = s.xx - level;
    if (!(a > 0)) return false;
    const double b = s.yy - level - s.xy * s.xy / a, yz = s.yz - s.xy * s.xz / a;
    return b > 0 && s.zz - level - s.xz * s.xz / a - yz * yz / b >= 0;
}

// ---- branch and bound ----------------------------------------------------------------------------------------------

class Search {
public:
    // `free` is a lower bound of μ with a free border. The relative distance of the bounds shall be below `gap`, unless
    // the lower one is above `target`.
    Search(const std::vector<Stroke>& strokes, const Axis* axes, double free, double target, double gap)
        : strokes(strokes), axes(axes), free(free), target(target), gap(gap) {
        for (const Stroke& k : strokes) {
            double sum = 0;
            for (int i = 0; i < k.terms; i++)
                sum += std::abs(k.p[i]) + std::abs(k.r[i]) + std::abs(k.q[i]) / k.radius2[i];
            noise.push_back(2e-14 * strength_of(k) * sum);
            if (k.freeze) freeze = &mask_of(k);
            const bool still = k.force[0] == 0 && k.force[1] == 0 && k.power == 1;  // in the plane
            for (int i = 0; i < 2; i++) moving[i] = moving[i] || k.coupled != 0 || !still;
            const double* row = k.matrix[2];
            moving[2] = moving[2] || k.coupled != 0 || k.force[2] != 0 || row[0] != 0 || row[1] != 0 || row[2] != 0;
        }
        // No points along an axis without extent could fold.
        for (int i = 0; i < 3; i++) moving[i] = moving[i] && axes[i].extent() > 0;
    }

    Bounds known;
    std::vector<int> near;  // the strokes that reach the current box
    Derivatives free_of;    // the N_n there, of strokes without a mask
    Derivatives masked;     // and of those with one, without its factor
    MaskBounds mask{};      // bounds of m there

    // List the strokes that reach a box in `near`, and sum their bounds.
    void sum_in(const Region& box) {
        free_of = masked = {};
        if (freeze) mask = freeze->bounds_in(box.low, box.high);
        near.clear();
        for (int s = 0; s < (int)strokes.size(); s++) {
            const Stroke& stroke = strokes[s];
            double near2 = 0, far2 = 0;
            for (int k = 0; k < 3; k++) {
                const double below = box.low[k] - stroke.pivot[k], above = box.high[k] - stroke.pivot[k];
                const double nearest = std::max({below, -above, 0.0}), farthest = std::max(-below, above);
                near2 += nearest * nearest;
                far2 += farthest * farthest;
            }
            if (std::sqrt(near2) >= stroke.reach) continue;  // no displacement there
            near.push_back(s);
            Derivatives own =
                stroke.flat > 0 ? eased_bounds(stroke, near2, far2) : displacement_bounds(stroke, near2, far2);
            for (int i = 0; i < 4; i++) (stroke.freeze ? masked : free_of)[i] += own[i];
        }
    }

    // Bounds of the derivatives of m K in that box: n-th derivatives, n - 1 of them along the axis k, and one along an
    // axis along which points move.
    Derivatives sum_along(int k) const {
        const int x = k < 2, z = k == 2;
        const double m = mask.most(), mk = mask.of(x, z), mkk = mask.of(2 * x, 2 * z);
        const double g = turned(0, 0), gk = turned(x, z), gkk = turned(2 * x, 2 * z), most = std::max(g, mk);
        const Derivatives& N = masked;
        return {
            free_of[0] + m * N[0],
            free_of[1] + m * N[1] + most * N[0],
            free_of[2] + m * N[2] + (mk + most) * N[1] + std::max(gk, mkk) * N[0],
            free_of[3] + m * N[3] + (2 * mk + g) * N[2] + (mkk + 2 * gk) * N[1] + gkk * N[0],
        };
    }

    std::vector<Stroke> those_in(const Region& box) {
        std::vector<Stroke> those;
        sum_in(box);
        for (int s : near) those.push_back(strokes[s]);
        return those;
    }

    void add(const Region& box) {
        waiting.push_back(box);
        std::push_heap(waiting.begin(), waiting.end(), later);
    }

    void run() {
        for (int visited = 0; !waiting.empty(); visited++) {
            std::pop_heap(waiting.begin(), waiting.end(), later);
            const Region box = waiting.back();
            waiting.pop_back();
            if (box.bound > enough() || visited == MOST_BOXES) return settle(box.bound);
            visit(box);
        }
    }

    // Bound μ in a box, or halve the box if the bound is not close enough.
    void visit(Region box) {
        const Errors errors = errors_in(box);
        double worst = enough();  // the least over the corners
        if (errors.simple >= worst) return settle(errors.simple);
        const int corners = box.low[2] < box.high[2] ? 8 : 4;
        for (int v = 0; v < corners; v += LANES) {
            Lanes x[3];
            for (int i = 0; i < 3; i++)
                for (int l = 0; l < LANES; l++) x[i][l] = (v + l) >> i & 1 ? box.high[i] : box.low[i];
            const Symmetric<Lanes> s = strain({strokes.data(), near.data(), (int)near.size()}, axes, moving, x);
            for (int l = 0; l < LANES; l++) {
                const Symmetric<double> lowered = less(s, l, errors.all);
                if (is_at_least(lowered, worst + errors.rounding)) continue;
                worst = std::min(worst, smallest_eigenvalue(lowered, -CUBIC) - errors.rounding);
                const double none[3] = {}, found = smallest_eigenvalue(less(s, l, none), CUBIC) + errors.rounding;
                if (found >= known.upper) continue;
                known.upper = found;
                for (int i = 0; i < 3; i++) known.point[i] = x[i][l];
            }
        }
        // The simple bound does not order boxes, as many may share it.
        box.bound = std::max(box.bound, worst);
        const double bound = std::max(box.bound, errors.simple), *d = errors.all;
        const int k = errors.cut;
        double middle = 0.5 * (box.low[k] + box.high[k]);
        if (freeze)
            if (const double knot = freeze->knot(k, middle); box.low[k] < knot && knot < box.high[k]) middle = knot;
        const bool divisible = box.low[k] < middle && middle < box.high[k];
        if (bound >= enough() || errors.rounding >= d[0] + d[1] + d[2] || !divisible) return settle(bound);
        Region other = box;
        box.high[k] = other.low[k] = middle;
        add(box);
        add(other);
    }

private:
    // The terms of (1) for a box.
    struct Errors {
        double all[3] = {};  // D
        int cut = 0;         // the axis with the largest term, along which the box is halved
        double simple = 0;   // the bound (3), or that with a free border
        double rounding = 0;
    };

    Errors errors_in(const Region& box) {
        double value = 0, steepest = 0;
        Derivatives b[3];
        for (int k = 0; k < 3; k++) {
            b[k] = fade_bounds(axes[k], box.low[k], box.high[k]);
            value = std::max(value, b[k][0]);
            steepest = std::max(steepest, moving[k] ? b[k][1] : 0);
        }
        Errors found;
        sum_in(box);
        if (near.empty()) return found;
        double turn = 0;  // |∇m|
        for (int s : near) {
            const Stroke& stroke = strokes[s];
            const double rho = std::sqrt(stroke.radius2[0]);
            const double own = stroke.freeze ? mask.slope() : 0;
            turn = std::max(turn, own);
            found.rounding +=
                noise[s] / (stroke.power == 3 ? rho * rho : rho) * (5 / rho + steepest + own + 2 * stroke.per_reach);
        }
        double most = 0;
        for (int k = 0; k < 3; k++) {
            const double width = box.high[k] - box.low[k], share = 0.125 * width * width;
            const Derivatives n = sum_along(k);
            const double mixed = 2 * b[k][1] * n[2] + b[k][2] * n[1];  // of |x_k| |x| ≤ |x|²/4 + x_k²
            const double own = mixed + 2 * b[k][2] * n[1] + b[k][3] * n[0];
            double added = 0;
            for (int i = 0; i < 3; i++) {
                if (!moving[i]) continue;
                const double part = value * n[3] + b[i][1] * n[2] + 0.25 * mixed + (i == k ? own : 0);
                const double d = std::min(share * part * (1 + 1e-14), HUGE_BOUND);
                found.all[i] += d;
                added += d;
            }
            if (added > most) most = added, found.cut = k;
        }
        const double first = free_of[1] + mask.most() * masked[1] + turned(0, 0) * masked[0];
        found.simple = -(value * first + steepest * (free_of[0] + mask.most() * masked[0])) * (1 + 1e-12);
        if (steepest == 0 && turn == 0) found.simple = std::max(found.simple, free);
        // Where the others are enough, and not the lowest so far, this takes time for nothing.
        if (turn > 0 && found.simple < std::max(enough(), known.lower))
            found.simple = std::max(found.simple, beside(box, value, steepest));
        return found;
    }

    // The bound (6) in a box, within a cell of the mask.
    double beside(const Region& box, double value, double steepest) const {
        double g[64][3];
        const int count = freeze->gradients_in(box.low, box.high, g);
        if (!count) return -INFINITE;
        Jet<3, 0, false, double> at, moved{};
        double across2 = 0;
        for (int i = 0; i < 3; i++) {
            at.x[i] = 0.5 * (box.low[i] + box.high[i]);
            const double half = 0.5 * (box.high[i] - box.low[i]);
            across2 += half * half;
        }
        for (int s : near) {
            Stroke k = strokes[s];
            k.freeze = nullptr;
            supple::add(k, axes, at, moved);
        }
        for (int i = 0; i < 3; i++)
            if (!moving[i]) moved.x[i] = 0;
        const double away = value * (free_of[1] + masked[1]) + steepest * (free_of[0] + masked[0]),
                     delta = away * std::sqrt(across2);
        const double size = std::sqrt(dot<3>(moved.x, moved.x));
        double lowest = 0, longest = 0;
        for (int n = 0; n < count; n++) {
            for (int i = 0; i < 3; i++)
                if (!moving[i]) g[n][i] = 0;
            const double length = std::sqrt(dot<3>(g[n], g[n]));
            longest = std::max(longest, length);
            lowest = std::min(lowest, 0.5 * (dot<3>(moved.x, g[n]) - size * length));
        }
        return (lowest - delta * longest - mask.most() * away) * (1 + 1e-12);
    }

    // Bound the gradient of a derivative of m, along the axes along which points move.
    double turned(int across, int along) const {
        return std::hypot(moving[0] || moving[1] ? mask.of(across + 1, along) : 0.0,
                          moving[2] ? mask.of(across, along + 1) : 0.0);
    }

    // The lowest bound with which a box need not be halved.
    double enough() const { return std::min(target, known.upper * (1 + gap)); }
    void settle(double bound) { known.lower = std::min(known.lower, bound); }

    static bool later(const Region& a, const Region& b) { return a.bound > b.bound; }

    const std::vector<Stroke>& strokes;
    const Axis* axes;
    const double free, target, gap;
    const Frozen* freeze = nullptr;  // the mask, if a stroke has one
    std::vector<double> noise;       // the rounding error of each stroke
    bool moving[3] = {};             // whether points move along each axis
    std::vector<Region> waiting;     // a heap
};

constexpr size_t FEW = 8;   // strokes: domains of more are divided in advance
constexpr double TILE = 4;  // radii

// Boxes that cover the reach of strokes in a domain; none crosses an end of the border.
inline std::vector<Region> boxes_of(const std::vector<Stroke>& strokes, const Axis* axes) {
    std::vector<double> cuts[3];
    double radius = 0;
    const bool flat = axes[2].extent() == 0;
    for (const Stroke& k : strokes) radius = std::max(radius, std::sqrt(k.radius2[0]));
    for (int i = 0; i < 3; i++) {
        const Axis& a = axes[i];
        // With a depth of σ at least, despite rounding.
        double begin = a.first + a.sigma, end = a.last - a.sigma;
        if (begin - a.first < a.sigma) begin = std::nextafter(begin, a.last);
        if (a.last - end < a.sigma) end = std::nextafter(end, a.first);
        double low = a.last, high = a.first;
        for (const Stroke& k : strokes) {
            low = std::min(low, k.pivot[i] - k.reach);
            high = std::max(high, k.pivot[i] + k.reach);
        }
        low = std::max(a.first, low);
        high = std::min(a.last, high);
        std::vector<double> ends{begin, end, high};
        const double tiles = std::min(std::ceil((high - low) / (TILE * radius)), flat ? 32.0 : 8.0);
        for (int n = 1; strokes.size() > FEW && n < tiles; n++) ends.push_back(low + (high - low) * n / tiles);
        std::sort(ends.begin(), ends.end());
        cuts[i] = {low};
        for (double x : ends)
            if (cuts[i].back() < x && x <= high) cuts[i].push_back(x);
        if (a.extent() == 0) cuts[i] = {a.first, a.first};
    }
    std::vector<Region> boxes;
    for (size_t i = 1; i < cuts[0].size(); i++)
        for (size_t j = 1; j < cuts[1].size(); j++)
            for (size_t k = 1; k < cuts[2].size(); k++)
                boxes.push_back(
                    {{cuts[0][i - 1], cuts[1][j - 1], cuts[2][k - 1]}, {cuts[0][i], cuts[1][j], cuts[2][k]}});
    return boxes;
}

// Bound μ in a domain. With a free border, the worst point of one grab is `distance` times its force from its pivot.
inline Bounds smallest_strain(const std::vector<Stroke>& strokes, const Axis* axes, double free, double distance,
                              double target, double gap) {
    const std::vector<Region> boxes = boxes_of(strokes, axes);
    if (strokes.size() <= FEW) {
        Search search(strokes, axes, free, target, gap);
        Region ahead;
        for (int i = 0; i < 3; i++)
            ahead.low[i] = ahead.high[i] =
                std::clamp(strokes[0].pivot[i] + distance * strokes[0].force[i], axes[i].first, axes[i].last);
        search.visit(ahead);
        for (const Region& box : boxes) search.add(box);
        search.run();
        return search.known;
    }
    std::vector<Bounds> found(boxes.size());
    parallel((int)boxes.size(), [&](int i, int) {
        const std::vector<Stroke> near = Search(strokes, axes, free, target, gap).those_in(boxes[i]);
        Search search(near, axes, free, target, gap);
        search.add(boxes[i]);
        search.run();
        found[i] = search.known;
    });
    Bounds all;
    for (const Bounds& one : found) {
        all.lower = std::min(all.lower, one.lower);
        if (one.upper < all.upper) {
            all.upper = one.upper;
            std::copy(one.point, one.point + 3, all.point);
        }
    }
    return all;
}

// An upper bound of |K_β| in a domain: at most LOOSE times the largest |K|, unless that takes more than MOST_PLACES
// boxes, as where strong strokes nearly cancel.
constexpr double LOOSE = 3;
constexpr int MOST_PLACES = 20'000;
inline double largest_displacement(const std::vector<Stroke>& strokes, const Axis* axes) {
    // Return |K| at the middle of a box, and bound it in the box. It ignores β, so the bound holds, but is not as close
    // near a border.
    const auto look = [](Search& search, const std::vector<Stroke>& among, Region& box) {
        double across2 = 0;
        Jet<3, 0, false, double> at, moved{};
        for (int i = 0; i < 3; i++) {
            const double width = box.high[i] - box.low[i];
            across2 += 0.25 * width * width;
            at.x[i] = 0.5 * (box.low[i] + box.high[i]);
        }
        search.sum_in(box);
        const double most = search.free_of[0] + search.mask.most() * search.masked[0];
        const double steepest =
            search.free_of[1] + search.mask.most() * search.masked[1] + search.mask.slope() * search.masked[0];
        for (int s : search.near) add(among[s], FREE, at, moved);
        const double here = std::sqrt(dot<3>(moved.x, moved.x));
        box.bound = std::min({box.bound, most, here + steepest * std::sqrt(across2)}) * (1 + 1e-12);
        return here;
    };
    // Each part has only the strokes that reach it, so that its boxes are cheap.
    struct Part {
        std::vector<Stroke> near;
        Region box;
        double here;  // the largest |K| that was computed, here or elsewhere
        std::vector<Region> waiting;
    };
    std::vector<Part> parts;
    for (const Region& box : boxes_of(strokes, axes)) parts.push_back({{}, box, 0, {}});
    for (const Stroke& stroke : strokes) {  // displacements are largest at pivots
        Region pivot;
        for (int k = 0; k < 3; k++)
            pivot.low[k] = pivot.high[k] = std::clamp(stroke.pivot[k], axes[k].first, axes[k].last);
        parts.push_back({{}, pivot, 0, {}});
    }
    parallel((int)parts.size(), [&](int i, int) {
        Part& part = parts[i];
        part.near = Search(strokes, axes, -INFINITE, 0, 0).those_in(part.box);
        part.box.bound = INFINITE;
        Search search(part.near, axes, -INFINITE, 0, 0);
        part.here = look(search, part.near, part.box);
        part.waiting = {part.box};
    });
    double known = 0;
    for (const Part& part : parts) known = std::max(known, part.here);
    // Open parts share the boxes that are left equally, so that the result does not depend on threads.
    const auto smaller = [](const Region& a, const Region& b) { return a.bound < b.bound; };
    std::vector<Part*> open;
    for (Part& part : parts)
        if (part.box.bound > LOOSE * known) open.push_back(&part);
    for (int left = MOST_PLACES; !open.empty();) {
        const int each = std::max(left / (int)open.size(), 1);
        std::vector<int> used(open.size());
        parallel((int)open.size(), [&](int i, int) {
            Part& part = *open[i];
            Search search(part.near, axes, -INFINITE, 0, 0);
            part.here = std::max(part.here, known);
            while (part.waiting.front().bound > LOOSE * part.here &&
                   (used[i] < each || !std::isfinite(part.waiting.front().bound))) {
                std::pop_heap(part.waiting.begin(), part.waiting.end(), smaller);
                Region box = part.waiting.back();
                part.waiting.pop_back();
                int widest = 0;
                for (int k = 1; k < 3; k++)
                    if (box.high[k] - box.low[k] > box.high[widest] - box.low[widest]) widest = k;
                Region other = box;
                box.high[widest] = other.low[widest] = 0.5 * (box.low[widest] + box.high[widest]);
                for (Region* half : {&box, &other}) {
                    part.here = std::max(part.here, look(search, part.near, *half));
                    part.waiting.push_back(*half);
                    std::push_heap(part.waiting.begin(), part.waiting.end(), smaller);
                }
                used[i]++;
            }
        });
        for (int some : used) left -= some;
        for (const Part* part : open) known = std::max(known, part->here);
        std::erase_if(open, [&](const Part* part) { return part->waiting.front().bound <= LOOSE * known; });
        if (left < (int)open.size()) break;
    }
    double most = 0;
    for (const Part& part : parts) most = std::max(most, part.waiting.front().bound);
    return most;
}

// Bound μ in all of space, for a stroke at 0 with a finite reach and a force along x. S is symmetric about that axis,
// so a half-plane stands for space.
inline Bounds smallest_free_strain(const std::vector<Stroke>& one, double gap) {
    Search search(one, FREE, -INFINITE, 0, gap);
    const double reach = one[0].reach;
    search.add({{-reach, 0, 0}, {reach, reach, 0}});
    search.run();
    return search.known;
}

}  // namespace supple::folds
