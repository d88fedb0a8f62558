// The tables of strokes and axes, as Python packs them (`supple.strokes.STROKE_DTYPE`, `supple.domain.Domain.packed`).
#pragma once
#include <array>
#include <cmath>
#include <vector>

#include "field.hpp"

namespace supple {

constexpr int STROKE_NUMBERS = 20;  // pivot, force, radius2, p, q, r: three each; terms, of int64; and the reach
constexpr int AXIS_NUMBERS = 5;     // first, last, sigma, spacing, profile

typedef std::array<Axis, 3> Axes;

// Read three rows of (first, last, sigma, spacing, profile).
inline Axes load_axes(const double* rows) {
    Axes axes;
    for (int i = 0; i < 3; i++, rows += AXIS_NUMBERS) axes[i] = {rows[0], rows[1], rows[2], rows[3], (int64_t)rows[4]};
    return axes;
}

// True if β = 1 in all of a stroke's ball. Along an axis of sigma 0, β = 0; that has no effect only if K has no such
// component, as in a single plane with the pivot and the force in it.
inline bool is_inner(const Stroke& k, const Axis* axes) {
    for (int i = 0; i < 3; i++) {
        const Axis& a = axes[i];
        bool flat = a.extent() == 0 && k.pivot[i] == a.first && k.force[i] == 0;
        bool clear = a.sigma > 0 && depth(k.pivot[i], a) - k.reach >= a.sigma;
        if (a.fixed() && !flat && !clear) return false;
    }
    return true;
}

// Read `count` rows of STROKE_NUMBERS, and derive the rest.
inline std::vector<Stroke> load_strokes(const double* rows, size_t count, const Axis* axes) {
    std::vector<Stroke> strokes(count);
    for (Stroke& k : strokes) {
        double* parts[] = {k.pivot, k.force, k.radius2, k.p, k.q, k.r};
        for (double* part : parts)
            for (int i = 0; i < 3; i++) part[i] = *rows++;
        memcpy(&k.terms, rows++, sizeof k.terms);
        k.reach = *rows++;
        k.per_reach = std::isfinite(k.reach) ? 1.0 / k.reach : 0.0;
        k.inner = is_inner(k, axes);
    }
    return strokes;
}

}  // namespace supple
