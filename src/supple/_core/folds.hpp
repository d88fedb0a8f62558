// How close a stroke comes to folding: the minimum of a smallest eigenvalue over all points, bounded.
//
// Let S = sym(J_β), of a force of length 1, and μ the smallest eigenvalue of S over the domain. Branch and bound
// finds it, the box with the lowest bound first. In a box of widths h, across which no end of the border goes, the
// multilinear interpolant of S from the corners v is a mean of the S(v), and differs from S by Σ_k h_k²/8 |∂_kk S| at
// most. As λ_min is concave,
//
//     λ_min(S(p)) ≥ min_v λ_min(S(v) - D),   D diagonal with  xᵀ D x ≥ Σ_k h_k²/8 |xᵀ ∂_kk S(p) x|.          (1)
//
// With xᵀ S x = Σ_i x_i (β_i ∂_x K_i + β_i' x_i K_i), ∂_x along x, of which only β_k depends on p_k,
//
//     |xᵀ ∂_kk S x| ≤ b⁰ N₃ |x|² + Σ_i b¹_i N₂ x_i² + (2 b¹_k N₂ + b²_k N₁) |x_k| |x| + (2 b²_k N₁ + b³_k N₀) x_k²  (2)
//     |S| ≤ b⁰ N₁ + max_i b¹_i N₀                                                                          (3)
//
// where N_n bounds the n-th derivatives of K in the box, bⁿ_i those of β_i, and b⁰ is the largest of the b⁰_i.
//
// The grab. K of 1, 2 and 3 scales is a constant times the zeroth, first and second divided difference, in e = ε²,
// of
//
//     U = (1-ω) ρ^-1 f + e/2 ρ^-3 f + ω ρ^-3 (r·f) r,    ω = b/a, ρ² = |r|² + e,
//
// hence a mean of U, ∂U/∂e or ∂²U/∂e² / 2. As e = ρ² - |r|², these are, but for a constant, with q = k/(3-2ω),
//
//     ρ^-k f - q ρ^-(k+2) [ |r|² f - 2ω (r·f) r ]                                                           (4)
//     = (1-q) ρ^-k f + q e ρ^-(k+2) f + 2ωq ρ^-(k+2) (r·f) r,    k = 1, 3, 5,                               (5)
//
// where little cancels any more: in (4) near the pivot, in (5) far from it. The n-th derivative of ρ^-k is a
// Gegenbauer polynomial of a cosine times |r|/ρ, over ρ^(k+n). As 2ω ≤ 1, the bracket and its two derivatives are at
// most |r|², 2|r| and 2.
//
// The reach. K_R = m(t) K with t = |r|/R and m = 1 - 10t³ + 15t⁴ - 6t⁵. With M_n a bound of the n-th derivatives of
// m in the box, the N_n of K_R are Σ_j C(n,j) M_j N_(n-j). Along a unit vector at the cosine c to r,
//
//     D m = m' c,   D²m = m'' c² + h (1-c²),   D³m = m''' c³ + 3h' c (1-c²),   h = m'/|r|,                  (6)
//     R m' = -30 t² (1-t)²,  R² h = -30 t (1-t)²,  R² m'' = -60 t (1-t) (1-2t),
//     R³ h' = -30 (1-t) (1-3t),  R³ m''' = -60 (1 - 6t + 6t²)                          for t < 1, 0 beyond.
//
// m''' jumps at t = 1, and D³m at t = 0; the second derivatives of S are bounded all the same, which is all that (1)
// asks for.
//
// The border. β is sin(πt/2), or the quartic 2t - 2t³ + t⁴, of t = depth/σ; 1 beyond t = 1. Boxes are cut there.
//
// All lengths are in units of ε. What rounding can do to a bound is taken off it.

#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numbers>
#include <vector>

namespace supple::folds {

using Three = std::array<double, 3>;

inline constexpr double UNLIMITED = std::numeric_limits<double>::infinity();
// At a double root, the cosine formula for a cubic's roots loses half of the digits.
inline constexpr double CUBIC = 1e-7;
inline constexpr double TINY = 1e-150;
inline constexpr double HUGE_BOUND = 1e100;  // a bound as bad as none, of which the square is still a number
inline constexpr std::size_t MOST_BOXES = 100'000;

// A term (p/ρ + q/ρ³) f + (r/ρ³)(r·f) r of K, with ρ² = |r|² + e.
struct Term {
    double e, p, q, r;
};

struct Stroke {
    int terms = 0;
    std::array<Term, 3> term{};
    Three pivot{};
    Three force{};  // a unit vector
    double reach = UNLIMITED;
};

enum class Profile { quartic, sine };

struct Axis {
    double extent = 0.0;
    double sigma = 0.0;  // width of the border
    Profile profile = Profile::quartic;
    bool active = true;  // whether the domain extends along it: elsewhere there are no points that could fold
};

// The part of an axis that a box takes up.
struct Side {
    double distance = 0.0;  // distance from the pivot of the end nearer to it
    double width = 0.0;
    double away = 1.0;    // 1 or -1, which way along the axis leads away from the pivot
    double depth = 0.0;   // distance of the nearer end from the face
    double inward = 0.0;  // 1 or -1, how the depth changes on the way away from the pivot
    bool fading = false;  // whether it is within the border

    double farthest() const { return distance + width; }
};

using Box = std::array<Side, 3>;

struct Bounds {
    double lower, upper;
    std::size_t boxes;  // how many were looked at
};

// What is known of μ, and how closely it is asked for.
struct Question {
    double free;    // a lower bound of μ without a border
    double upper;   // an upper bound of μ, at most 0
    double target;  // at most 0: a lower bound above it need not be close to the upper one
    double gap;     // how close the bounds must come, as a part of the upper one

    // The lowest bound in a box that nothing more needs to be known of.
    double enough(double known_upper) const { return std::min(target, known_upper * (1.0 + gap)); }
};

// ---------------------------------------------------------------------------------------------------------------------
// Bounds of derivatives in a box

// Bounds of the zeroth to third derivatives of something.
using Derivatives = std::array<double, 4>;

// The largest |f| of `from` ≤ t ≤ `to`, for f with no extrema but those given.
template <class Function, std::size_t N>
double largest(Function f, double from, double to, const std::array<double, N>& extrema) {
    double found = std::max(std::abs(f(from)), std::abs(f(to)));
    for (double t : extrema) {
        if (from < t && t < to) found = std::max(found, std::abs(f(t)));
    }
    return found;
}

struct Fade {
    double value, slope;  // β and its derivative by the depth
};

inline Fade fade(const Axis& axis, double depth) {
    const double t = std::clamp(depth / axis.sigma, 0.0, 1.0);
    if (axis.profile == Profile::sine) {
        const double angle = 0.5 * std::numbers::pi * t;
        return {std::sin(angle), 0.5 * std::numbers::pi / axis.sigma * std::cos(angle)};
    }
    return {t * (2.0 + t * t * (t - 2.0)), 2.0 * (1.0 - t) * (1.0 - t) * (1.0 + 2.0 * t) / axis.sigma};
}

// Bounds of β and its derivatives on a side.
inline Derivatives fade_bounds(const Axis& axis, const Side& side) {
    if (!side.fading) return {axis.active ? 1.0 : 0.0, 0.0, 0.0, 0.0};
    const double end = side.depth + side.inward * side.width;
    const double shallow = std::clamp(std::min(side.depth, end) / axis.sigma, 0.0, 1.0);
    const double deep = std::clamp(std::max(side.depth, end) / axis.sigma, 0.0, 1.0);
    Derivatives b;
    if (axis.profile == Profile::sine) {
        // β and |β''| grow with the depth, β' and |β'''| fall.
        constexpr double k = 0.5 * std::numbers::pi;
        const double sine = std::sin(k * deep), cosine = std::cos(k * shallow);
        b = {sine, k * cosine, k * k * sine, k * k * k * cosine};
    } else {
        const auto value = [](double t) { return t * (2.0 + t * t * (t - 2.0)); };
        const auto slope = [](double t) { return 2.0 * (1.0 - t) * (1.0 - t) * (1.0 + 2.0 * t); };
        const auto second = [](double t) { return 12.0 * t * (1.0 - t); };
        const auto third = [](double t) { return 12.0 - 24.0 * t; };
        b = {value(deep), slope(shallow), largest(second, shallow, deep, std::array{0.5}),
             std::max(std::abs(third(shallow)), std::abs(third(deep)))};
    }
    double scale = 1.0;
    for (double& bound : b) {
        bound *= scale;
        scale /= axis.sigma;
    }
    return b;
}

// Bounds of ρ^-k and its derivatives, times ρ^k, ρ^(k+1) and so on, where |r|/ρ is at most x.
inline Derivatives power_bounds(double k, double x) {
    const double c = k * (k + 2.0);
    const double y = std::min(x, 1.0 / std::sqrt(k + 4.0));
    const double third = std::max(c * y * (3.0 - (k + 4.0) * y * y), c * x * ((k + 4.0) * x * x - 3.0));
    return {1.0, k * x, std::max(k, c * x * x - k), third};
}

// The N_n of K without reach, from equations (4) and (5), where near² ≤ |r|² ≤ far².
inline Derivatives grab_bounds(const Stroke& stroke, double near2, double far2) {
    constexpr std::array<double, 3> amounts{1.0, 11.0 * 0.21 / 2.0, 14641.0 / 331.0 * 0.21 * 0.4641 * 3.0 / 8.0};
    const Term& first = stroke.term[0];
    const double k = 2.0 * stroke.terms - 1.0;
    const double omega = first.r / (first.p + first.r);
    const double q = k / (3.0 - 2.0 * omega);
    const double rho2 = near2 + first.e, rho = std::sqrt(rho2), x = std::sqrt(far2 / (far2 + first.e));

    const Derivatives power = power_bounds(k, x), next = power_bounds(k + 2.0, x);
    const Derivatives bracket{
        x * x * next[0],
        x * (x * next[1] + 2.0 * next[0]),
        x * x * next[2] + 4.0 * x * next[1] + 2.0 * next[0],
        x * x * next[3] + 6.0 * x * next[2] + 6.0 * next[1],
    };
    const double of_power = std::abs(1.0 - q);
    const double of_next = q * std::min(stroke.term[stroke.terms - 1].e / rho2, 1.0);
    const double of_bracket = 3.0 * q - k;  // 2ωq
    double scale = amounts[stroke.terms - 1] * std::sqrt(first.e / rho2);
    for (int i = 1; i < stroke.terms; ++i) scale *= first.e / rho2;  // in all, (ε/ρ)^k
    Derivatives found;
    for (std::size_t n = 0; n < 4; ++n) {
        const double near_pivot = power[n] + q * bracket[n];
        const double far_away = of_power * power[n] + of_next * next[n] + of_bracket * bracket[n];
        found[n] = scale * std::min(near_pivot, far_away);
        scale /= rho;
    }
    return found;
}

// The M_n of m, from equation (6), where from ≤ |r| ≤ to.
inline Derivatives reach_bounds(double reach, double from, double to) {
    const double a = std::min(from / reach, 1.0), b = std::min(to / reach, 1.0);
    const auto first = [](double t) { return 30.0 * t * t * (1.0 - t) * (1.0 - t); };
    const auto second = [](double t) { return 60.0 * t * (1.0 - t) * (1.0 - 2.0 * t); };
    const auto round = [](double t) { return 30.0 * t * (1.0 - t) * (1.0 - t); };  // h
    const auto third = [](double t) { return 60.0 * (1.0 - 6.0 * t * (1.0 - t)); };
    const auto rounder = [](double t) { return 90.0 * (1.0 - t) * (1.0 - 3.0 * t); };  // 3h'
    constexpr double off = std::numbers::inv_sqrt3 / 2.0;
    const double m1 = largest(first, a, b, std::array{0.5});
    const double m2 =
        std::max(largest(second, a, b, std::array{0.5 - off, 0.5 + off}), largest(round, a, b, std::array{1.0 / 3.0}));
    // The largest p c³ + q c (1-c²) of 0 ≤ c ≤ 1.
    const double p = largest(third, a, b, std::array{0.5}), q = largest(rounder, a, b, std::array{2.0 / 3.0});
    const double m3 = q <= 1.5 * p ? p : 2.0 / 3.0 * q * std::sqrt(q / (3.0 * (q - p)));
    const double m0 = (1.0 - a) * (1.0 - a) * (1.0 - a) * (1.0 + a * (3.0 + 6.0 * a));
    return {m0, m1 / reach, m2 / reach / reach, m3 / reach / reach / reach};
}

// The N_n of K_R.
inline Derivatives displacement_bounds(const Stroke& stroke, double near2, double far2) {
    const Derivatives n = grab_bounds(stroke, near2, far2);
    if (std::isinf(stroke.reach)) return n;
    const Derivatives m = reach_bounds(stroke.reach, std::sqrt(near2), std::sqrt(far2));
    return {
        m[0] * n[0],
        m[0] * n[1] + m[1] * n[0],
        m[0] * n[2] + 2.0 * m[1] * n[1] + m[2] * n[0],
        m[0] * n[3] + 3.0 * m[1] * n[2] + 3.0 * m[2] * n[1] + m[3] * n[0],
    };
}

// ---------------------------------------------------------------------------------------------------------------------
// S at a point, and its smallest eigenvalue

struct Symmetric {
    double xx, yy, zz, xy, xz, yz;
};

// λ_min(S - diag(d)), with an error of `slack` times the spread of the eigenvalues.
inline double smallest_eigenvalue(const Symmetric& s, const Three& d, double slack) {
    double a = s.xx - d[0], b = s.yy - d[1], c = s.zz - d[2], xy = s.xy, xz = s.xz, yz = s.yz;
    if (xz == 0.0 && yz == 0.0) return std::min(c, 0.5 * (a + b) - std::sqrt(0.25 * (a - b) * (a - b) + xy * xy));
    const double mean = (a + b + c) / 3.0;
    a -= mean, b -= mean, c -= mean;
    const double p = std::sqrt((a * a + b * b + c * c + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0) + TINY;
    a /= p, b /= p, c /= p, xy /= p, xz /= p, yz /= p;
    const double half = 0.5 * (a * (b * c - yz * yz) - xy * (xy * c - xz * yz) + xz * (xy * yz - b * xz));
    const double angle = std::acos(std::clamp(half, -1.0, 1.0)) / 3.0;
    return mean + p * (2.0 * std::cos(angle + 2.0 * std::numbers::pi / 3.0) + slack);
}

// Whether λ_min(S - diag(d)) ≥ level, or within rounding: by its Cholesky factors.
inline bool is_at_least(const Symmetric& s, const Three& d, double level) {
    const double a = s.xx - d[0] - level;
    if (!(a > 0.0)) return false;
    const double over = 1.0 / a;
    const double b = s.yy - d[1] - level - s.xy * s.xy * over;
    if (!(b > 0.0)) return false;
    const double yz = s.yz - s.xy * s.xz * over;
    return s.zz - d[2] - level - s.xz * s.xz * over - yz * yz / b >= 0.0;
}

// A, B, 2A' and 2B' of K_R, ' by |r|².
struct Radial {
    double a = 0.0, b = 0.0, da = 0.0, db = 0.0;
};

inline Radial radial(const Stroke& stroke, double r2) {
    Radial k;
    const double t = std::sqrt(r2) / stroke.reach;
    if (t >= 1.0) return k;
    for (int i = 0; i < stroke.terms; ++i) {
        const auto [e, p, q, r] = stroke.term[i];
        const double v2 = 1.0 / (r2 + e), v = std::sqrt(v2), v3 = v * v2;
        k.a += p * v + q * v3;
        k.b += r * v3;
        k.da -= v3 * (p + 3.0 * q * v2);
        k.db -= 3.0 * r * v3 * v2;
    }
    if (t > 0.0) {
        const double rest = 1.0 - t, rest2 = rest * rest;
        const double m = rest * rest2 * (1.0 + t * (3.0 + 6.0 * t));
        const double dm = -30.0 * t * rest2 / stroke.reach / stroke.reach;
        k = {m * k.a, m * k.b, m * k.da + dm * k.a, m * k.db + dm * k.b};
    }
    return k;
}

// S at r from the pivot, where the border's factors are β and, by the coordinates, β'.
inline Symmetric strain(const Stroke& stroke, const Three& r, const Three& beta, const Three& slope) {
    const auto& [x, y, z] = r;
    const auto& [fx, fy, fz] = stroke.force;
    const auto& [bx, by, bz] = beta;
    const Radial k = radial(stroke, x * x + y * y + z * z);
    const double rf = x * fx + y * fy + z * fz, g = k.b * rf, h = k.db * rf;
    // J = (2A' f + 2B' (r·f) r) rᵀ + B (r fᵀ + (r·f) I) = c rᵀ + e fᵀ + g I
    const double cx = k.da * fx + h * x, cy = k.da * fy + h * y, cz = k.da * fz + h * z;
    const double ex = k.b * x, ey = k.b * y, ez = k.b * z;
    return {
        bx * (cx * x + ex * fx + g) + slope[0] * (k.a * fx + g * x),
        by * (cy * y + ey * fy + g) + slope[1] * (k.a * fy + g * y),
        bz * (cz * z + ez * fz + g) + slope[2] * (k.a * fz + g * z),
        0.5 * (bx * (cx * y + ex * fy) + by * (cy * x + ey * fx)),
        0.5 * (bx * (cx * z + ex * fz) + bz * (cz * x + ez * fx)),
        0.5 * (by * (cy * z + ey * fz) + bz * (cz * y + ez * fy)),
    };
}

// ---------------------------------------------------------------------------------------------------------------------
// Branch and bound

class Search {
public:
    Search(const Stroke& stroke, const std::array<Axis, 3>& axes, const Question& question)
        : stroke_(stroke), axes_(axes), question_(question), lower_(0.0), upper_(question.upper) {
        for (int i = 0; i < stroke.terms; ++i) {
            const Term& term = stroke.term[i];
            noise_ += 2e-14 * (std::abs(term.p) + std::abs(term.r) + std::abs(term.q) / term.e);
        }
    }

    void add(const Box& box) { push(box, -HUGE_BOUND * HUGE_BOUND * HUGE_BOUND); }

    Bounds run() {
        while (!heap_.empty()) {
            std::pop_heap(heap_.begin(), heap_.end(), later_);
            const std::size_t item = heap_.back();
            heap_.pop_back();
            const double key = keys_[item];
            if (key >= question_.enough(upper_) || boxes_.size() >= MOST_BOXES) {
                lower_ = std::min(lower_, key);
                break;
            }
            visit(item, key);
        }
        return {lower_, upper_, boxes_.size()};
    }

private:
    // What (1) needs to know of a box.
    struct Errors {
        Three all{};                 // D
        std::array<Three, 3> cut{};  // what is left of D after a cut across each axis
        double simple = 0.0;         // the bound (3), or that without a border
        double rounding = 0.0;
    };

    void push(const Box& box, double key) {
        boxes_.push_back(box);
        keys_.push_back(key);
        requeue(boxes_.size() - 1);
    }

    void requeue(std::size_t item) {
        heap_.push_back(item);
        std::push_heap(heap_.begin(), heap_.end(), later_);
    }

    void visit(std::size_t item, double key) {
        const Box box = boxes_[item];
        const Errors errors = errors_in(box);
        const double enough = question_.enough(upper_);
        if (errors.simple >= enough) {
            lower_ = std::min(lower_, errors.simple);
            return;
        }
        // The worst corner, if one is too bad.
        const double harmless = enough + errors.rounding;
        double worst = harmless;
        Symmetric there{};
        const std::array<std::array<Fade, 2>, 3> faded = faded_ends(box);
        for (unsigned v = 0; v < 8; ++v) {
            const std::array<unsigned, 3> end{v & 1u, (v >> 1) & 1u, v >> 2};
            if (repeats(box, end)) continue;
            const Symmetric s = strain_at(box, faded, end);
            if (is_at_least(s, errors.all, worst)) continue;
            const double value = smallest_eigenvalue(s, errors.all, -CUBIC);
            if (value < worst) worst = value, there = s;
        }
        if (worst == harmless) {
            lower_ = std::min(lower_, enough);
            return;
        }
        key = std::max(key, worst - errors.rounding);
        if (!is_at_least(there, {}, upper_)) {
            upper_ = std::min(upper_, smallest_eigenvalue(there, {}, CUBIC) + errors.rounding);
        }

        // The simple bound is no key: where it is the same for many boxes, it would not tell which one leads on.
        const double bound = std::max(key, errors.simple);
        const double largest_error = errors.all[0] + errors.all[1] + errors.all[2];
        if (bound >= question_.enough(upper_) || errors.rounding > largest_error) {
            lower_ = std::min(lower_, bound);
            return;
        }
        split(item, axis_to_cut(box, there, errors), key);
    }

    static bool repeats(const Box& box, const std::array<unsigned, 3>& end) {
        for (std::size_t k = 0; k < 3; ++k) {
            if (end[k] == 1 && box[k].width == 0.0) return true;
        }
        return false;
    }

    std::array<std::array<Fade, 2>, 3> faded_ends(const Box& box) const {
        std::array<std::array<Fade, 2>, 3> found;
        for (std::size_t k = 0; k < 3; ++k) {
            const Side& side = box[k];
            for (unsigned end = 0; end < 2; ++end) {
                found[k][end] = {axes_[k].active ? 1.0 : 0.0, 0.0};
                if (!side.fading) continue;
                found[k][end] = fade(axes_[k], side.depth + side.inward * (end * side.width));
                found[k][end].slope *= side.away * side.inward;  // by the coordinate
            }
        }
        return found;
    }

    Symmetric strain_at(const Box& box, const std::array<std::array<Fade, 2>, 3>& faded,
                        const std::array<unsigned, 3>& end) const {
        Three r, beta, slope;
        for (std::size_t k = 0; k < 3; ++k) {
            r[k] = box[k].away * (box[k].distance + end[k] * box[k].width);
            beta[k] = faded[k][end[k]].value;
            slope[k] = faded[k][end[k]].slope;
        }
        Symmetric s = strain(stroke_, r, beta, slope);
        if (!axes_[0].active) s.xy = s.xz = 0.0;
        if (!axes_[1].active) s.xy = s.yz = 0.0;
        if (!axes_[2].active) s.xz = s.yz = 0.0;
        return s;
    }

    Errors errors_in(const Box& box) const {
        double near2 = 0.0, far2 = 0.0, value = 0.0, steepest = 0.0;
        std::array<Derivatives, 3> b;
        for (std::size_t k = 0; k < 3; ++k) {
            near2 += box[k].distance * box[k].distance;
            far2 += box[k].farthest() * box[k].farthest();
            b[k] = fade_bounds(axes_[k], box[k]);
            value = std::max(value, b[k][0]);
            steepest = std::max(steepest, b[k][1]);
        }
        Errors found;
        if (std::sqrt(near2) >= stroke_.reach) return found;  // nothing moves there

        const Derivatives n = displacement_bounds(stroke_, near2, far2);
        for (std::size_t k = 0; k < 3; ++k) {
            const double share = 0.125 * box[k].width * box[k].width;
            const double mixed = 2.0 * b[k][1] * n[2] + b[k][2] * n[1];  // of |x_k| |x| ≤ |x|²/4 + x_k²
            const double own = mixed + 2.0 * b[k][2] * n[1] + b[k][3] * n[0];
            for (std::size_t i = 0; i < 3; ++i) {
                const double part = value * n[3] + b[i][1] * n[2] + 0.25 * mixed + (i == k ? own : 0.0);
                found.cut[k][i] = axes_[i].active ? std::min(share * part, HUGE_BOUND) : 0.0;
                found.all[i] += found.cut[k][i];
            }
        }
        for (Three& cut : found.cut) {
            for (std::size_t i = 0; i < 3; ++i) cut[i] = found.all[i] - 0.75 * cut[i];  // a half of the width
        }
        found.simple = -(value * n[1] + steepest * n[0]) * (1.0 + 1e-12);
        if (steepest == 0.0) found.simple = std::max(found.simple, question_.free);
        const double rho = std::sqrt(near2 + stroke_.term[0].e);
        const double largest_error = found.all[0] + found.all[1] + found.all[2];
        found.rounding = noise_ / rho * (5.0 / rho + steepest + 2.0 / stroke_.reach) + 1e-14 * largest_error;
        return found;
    }

    // The axis across which a cut raises the bound at a corner most.
    static std::size_t axis_to_cut(const Box& box, const Symmetric& s, const Errors& errors) {
        std::size_t best = 0;
        double highest = -UNLIMITED;
        for (std::size_t k = 0; k < 3; ++k) {
            if (box[k].width == 0.0) continue;
            const double value = smallest_eigenvalue(s, errors.cut[k], -CUBIC);
            if (value > highest) highest = value, best = k;
        }
        return best;
    }

    void split(std::size_t item, std::size_t k, double key) {
        Side& inner = boxes_[item][k];
        inner.width *= 0.5;
        Box other = boxes_[item];
        Side& outer = other[k];
        outer.distance += outer.width;
        outer.depth += outer.inward * outer.width;
        keys_[item] = key;
        requeue(item);
        push(other, key);
    }

    struct Later {
        const std::vector<double>* keys;
        bool operator()(std::size_t a, std::size_t b) const { return (*keys)[a] > (*keys)[b]; }
    };

    const Stroke& stroke_;
    const std::array<Axis, 3>& axes_;
    const Question question_;
    double lower_, upper_;
    double noise_ = 0.0;
    std::vector<Box> boxes_;
    std::vector<double> keys_;  // lower bounds in the boxes
    std::vector<std::size_t> heap_;
    const Later later_{&keys_};
};

// An axis cut at the pivot and where the border ends, as far as the stroke reaches.
inline std::vector<Side> sides(const Axis& axis, double pivot, double reach) {
    if (!axis.active) return {{.distance = std::abs(pivot), .away = pivot > 0.0 ? -1.0 : 1.0}};
    const double touched = reach * (1.0 + 1e-9);
    std::vector<Side> found;
    // Each side is measured from its own face, so that a border that is thin for the extent is still there.
    const auto cut = [&](double low, double high, double p, double sense, bool fading) {
        low = std::max(low, p - touched);
        high = std::min(high, p + touched);
        const bool beside = !(low < p && p < high);
        const std::array<double, 3> edges{low, beside ? high : p, high};
        for (std::size_t i = 0; i < (beside ? 1 : 2); ++i) {
            const double a = edges[i], b = edges[i + 1];
            if (!(a < b)) continue;
            const double away = p <= a ? 1.0 : -1.0, start = p <= a ? a : b;
            found.push_back({std::abs(start - p), b - a, sense * away, start, away, fading});
        }
    };
    cut(0.0, axis.sigma, pivot, 1.0, true);
    cut(axis.sigma, axis.extent - axis.sigma, pivot, 1.0, false);
    cut(0.0, axis.sigma, axis.extent - pivot, -1.0, true);
    return found;
}

// Bounds of μ in a domain with a fixed border.
inline Bounds smallest_strain(const Stroke& stroke, const std::array<Axis, 3>& axes, const Question& question) {
    Search search(stroke, axes, question);
    for (const Side& x : sides(axes[0], stroke.pivot[0], stroke.reach)) {
        for (const Side& y : sides(axes[1], stroke.pivot[1], stroke.reach)) {
            for (const Side& z : sides(axes[2], stroke.pivot[2], stroke.reach)) search.add({x, y, z});
        }
    }
    return search.run();
}

struct FreeBounds {
    double lower, upper;
    double distance;  // of the point on the axis, ahead of the pivot along the force, where S is `upper`
    std::size_t boxes;
};

// Bounds of μ in all of space, of a stroke with a finite reach: ahead along the force for the upper one. S is the same
// all around that axis, so that a half-plane stands for space.
inline FreeBounds smallest_free_strain(Stroke stroke, double gap) {
    stroke.force = {1.0, 0.0, 0.0};
    const auto ahead = [&](double t) { return strain(stroke, {t, 0.0, 0.0}, {1.0, 1.0, 1.0}, {}).xx; };
    // From 0 to R, or to where nothing of interest happens any more.
    const double end = std::min(stroke.reach, 8.0);
    constexpr int STEPS = 256;
    int best = 1;
    for (int i = 2; i < STEPS; ++i) {
        if (ahead(end * i / STEPS) < ahead(end * best / STEPS)) best = i;
    }
    double low = end * (best - 1) / STEPS, high = end * (best + 1) / STEPS;
    constexpr double GOLDEN = 1.0 / std::numbers::phi;
    for (int i = 0; i < 60; ++i) {
        const double a = high - GOLDEN * (high - low), b = low + GOLDEN * (high - low);
        (ahead(a) < ahead(b) ? high : low) = ahead(a) < ahead(b) ? b : a;
    }
    const double distance = 0.5 * (low + high);
    const double upper = ahead(distance) * (1.0 - 1e-12);

    const Question question{-UNLIMITED, upper, 0.0, gap};
    const std::array<Axis, 3> axes{};
    Search search(stroke, axes, question);
    for (double away : {1.0, -1.0}) {
        search.add({Side{.width = stroke.reach, .away = away}, Side{.width = stroke.reach}, Side{}});
    }
    const Bounds found = search.run();
    return {found.lower, found.upper, distance, found.boxes};
}

}  // namespace supple::folds
