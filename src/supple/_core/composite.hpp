// Composite maps: strokes, affine maps, homographies and sampled fields one after the other, each forward or inverted.
//
// T is the composition of its parts, the first one first. A point goes through it forwards (T) or backwards (T⁻¹): each
// part is evaluated in its own direction, and solved in the opposite one. Derivatives follow by the chain rule, and for
// a solved part by the implicit function theorem.
//
// It uses no std::, allocation or exceptions, so that compilers for GPUs accept this file.
#pragma once
#include "field.hpp"
#include "newton.hpp"

namespace supple {

enum Kind { STROKES, AFFINE, FIELD };

struct Part {
    Kind kind;
    bool inverted;
    Chain chain;
    double there[3][4], back[3][4];  // an affine map and its inverse
    bool projective;                 // whether it is a homography of the plane: its third row is the denominator
    Sampled field;
};

struct Composite {
    const Part* parts;
    int count;
    bool smooth;  // whether cells of several pixels may interpolate it
    Axis axes[3];
};

// The result of mapping lanes by a composite: the masks of those solved, of those within all fields, and of those where
// no field folds; and the number of evaluations.
template <class V>
struct Passed {
    typename Masked<V>::type done, within, upright;
    V steps;
};

template <int D, int TANGENTS, bool MIXED, class V>
INLINE void pass_affine(const double (*m)[4], Jet<D, TANGENTS, MIXED, V>& jet) {
    auto turned = [&](V* v, bool moved) INLINE_LAMBDA {
        V r[D];
        for (int i = 0; i < D; i++) {
            r[i] = splat<V>(moved ? m[i][3] : 0.0);
            for (int j = 0; j < D; j++) r[i] += m[i][j] * v[j];
        }
        for (int i = 0; i < D; i++) v[i] = r[i];
    };
    turned(jet.x, true);
    for (int j = 0; j < TANGENTS; j++) turned(jet.t[j], false);
    if constexpr (MIXED) turned(jet.mixed, false);
}

// A homography of the plane, x → n(x) / w(x), where w > 0. By the quotient rule, (n/w)ᵢ = (nᵢ − n/w wᵢ) / w, and
// (n/w)₁₂ = (n₁₂ − (n/w)₁ w₂ − (n/w)₂ w₁) / w, as n and w are affine. It varies over lengths of about w / |wᵢ|.
template <int D, int TANGENTS, bool MIXED, class V>
INLINE void pass_projective(const double (*m)[4], Jet<D, TANGENTS, MIXED, V>& jet, Passed<V>& passed) {
    auto along = [&](const V* v) INLINE_LAMBDA { return m[2][0] * v[0] + m[2][1] * v[1]; };
    V slope[TANGENTS > 0 ? TANGENTS : 1], w = along(jet.x) + m[2][3], bend = V{};
    for (int j = 0; j < TANGENTS; j++) slope[j] = along(jet.t[j]);
    if constexpr (MIXED) bend = along(jet.mixed);
    passed.done = both(passed.done, w > 0.0);
    const V part = 1.0 / most(w, splat<V>(1e-300));
    pass_affine<D>(m, jet);
    for (int d = 0; d < 2; d++) {
        jet.x[d] *= part;
        for (int j = 0; j < TANGENTS; j++) jet.t[j][d] = (jet.t[j][d] - jet.x[d] * slope[j]) * part;
        if constexpr (MIXED)
            jet.mixed[d] = (jet.mixed[d] - jet.t[0][d] * slope[1] - jet.t[1][d] * slope[0] - jet.x[d] * bend) * part;
    }
    if constexpr (MIXED)
        for (int j = 0; j < 2; j++)
            jet.smooth2[j] = least(jet.smooth2[j], V(w * w / most(slope[j] * slope[j], splat<V>(1e-300))));
}

constexpr double KNOTS = 4;  // samples over which a field is taken as smooth

template <int D, int TANGENTS, bool MIXED, class V>
NOINLINE void pass_field(const Sampled& k, bool solved, Jet<D, TANGENTS, MIXED, V>& jet, Passed<V>& passed) {
    typedef typename Masked<V>::type M;
    constexpr int ORDER = MIXED ? 2 : 1;
    pass_affine<D>(k.to_index, jet);
    if constexpr (MIXED)
        for (int j = 0; j < 2; j++)
            jet.smooth2[j] =
                least(jet.smooth2[j], V(KNOTS * KNOTS / most(dot<D>(jet.t[j], jet.t[j]), splat<V>(1e-300))));
    Local<D, V> at;
    if (!solved) {
        const M in = on_grid<D>(k, jet.x);
        field_at<D, ORDER, V>(k, jet.x, jet.t[0], jet.t[TANGENTS > 1 ? 1 : 0], at);
        V scale = k.zero ? choose(in, splat<V>(1.0), V{}) : splat<V>(1.0);
        if constexpr (TANGENTS > 0) {
            V full[D][D];
            for (int b = 0; b < D; b++)
                for (int a = 0; a < D; a++) full[b][a] = scale * at.dw[b][a] + double(a == b);
            passed.upright = both(passed.upright, determinant_of(full) > 0.0);
            if constexpr (MIXED) {
                transform<D>(full, jet.mixed);
                for (int a = 0; a < D; a++) jet.mixed[a] += scale * at.second[a];
            }
            for (int j = 0; j < TANGENTS; j++) transform<D>(full, jet.t[j]);
        }
        for (int a = 0; a < D; a++) jet.x[a] += scale * at.w[a];
        passed.steps += 1.0;
    } else {
        Undone<D, V> found{};
        field_at<D, 0, V>(k, jet.x, nullptr, nullptr, at);
        for (int a = 0; a < D; a++) found.i[a] = jet.x[a] - at.w[a];
        undo_field_surely<D, false, V>(k, jet.x, 1e-10, 1e-10, found);
        // Outside a field that is zero there, points stay, unless a point of the grid is mapped to them.
        M in = on_grid<D>(k, found.i), outside = without(in == in, in);
        V stays = V{};
        if (k.zero) {
            M same = both(outside, without(in == in, on_grid<D>(k, jet.x)));
            stays = choose(same, splat<V>(1.0), V{});
            in = either(in, same);
        }
        const M still = stays > 0.0;
        passed.within = both(passed.within, in);
        passed.upright = both(passed.upright, either(still, found.determinant > 0.0));
        passed.done = both(passed.done, either(still, found.done));
        passed.steps += found.steps + 1.0;
        for (int b = 0; b < D; b++)
            for (int a = 0; a < D; a++) found.m[b][a] = choose(still, splat<V>(double(a == b)), found.m[b][a]);
        for (int a = 0; a < D; a++) jet.x[a] = choose(still, jet.x[a], found.i[a]);
        for (int j = 0; j < TANGENTS; j++) transform<D>(found.m, jet.t[j]);
        if constexpr (MIXED) {
            field_at<D, 2, V>(k, jet.x, jet.t[0], jet.t[1], at);
            for (int a = 0; a < D; a++) jet.mixed[a] -= choose(still, V{}, at.second[a]);
            transform<D>(found.m, jet.mixed);
        }
    }
    pass_affine<D>(k.to_place, jet);
}

template <int D, int TANGENTS, bool MIXED, class V>
NOINLINE void pass_strokes(const Chain& chain, const Axis* axes, bool solved, Jet<D, TANGENTS, MIXED, V>& jet,
                           Passed<V>& passed) {
    if (!solved) {
        carry(chain, axes, jet);
        passed.steps += 1.0;
        return;
    }
    Solution<D, V> found;
    undo<D>(chain, axes, jet.x, 1e-9 * finest_of<D>(axes), found);
    passed.done = both(passed.done, found.done);
    passed.steps += found.steps;
    for (int d = 0; d < D; d++) jet.x[d] = found.p[d];
    for (int j = 0; j < TANGENTS; j++) transform<D>(found.m, jet.t[j]);
    if constexpr (MIXED) {
        Jet<D, TANGENTS, true, V> there = jet;
        for (int d = 0; d < D; d++) there.mixed[d] = V{};
        carry(chain, axes, there);
        for (int d = 0; d < D; d++) jet.mixed[d] -= there.mixed[d];
        transform<D>(found.m, jet.mixed);
        for (int j = 0; j < 2; j++) jet.smooth2[j] = there.smooth2[j];
    }
}

// Map a jet by T, or by T⁻¹ if `backwards`.
template <int D, int TANGENTS, bool MIXED, class V>
INLINE Passed<V> pass(const Composite& map, bool backwards, Jet<D, TANGENTS, MIXED, V>& jet) {
    typedef typename Masked<V>::type M;
    const M all = splat<V>(0.0) <= 0.0;
    Passed<V> passed{all, all, all, V{}};
    for (int n = 0; n < map.count; n++) {
        const Part& part = map.parts[backwards ? map.count - 1 - n : n];
        const bool solved = part.inverted != backwards;
        if (part.kind == STROKES)
            pass_strokes<D>(part.chain, map.axes, solved, jet, passed);
        else if (part.kind == FIELD)
            pass_field<D>(part.field, solved, jet, passed);
        else if (D == 2 && part.projective)
            pass_projective<D>(solved ? part.back : part.there, jet, passed);
        else
            pass_affine<D>(solved ? part.back : part.there, jet);
    }
    return passed;
}

// Solve T(p) = q of a composite, with its derivatives.
template <int D, bool MIXED, class V>
INLINE Passed<V> solve_composite(const Composite& map, const V* q, Solved<D, V>& found) {
    auto jet = jet_at<D, D, MIXED>(q);
    const Passed<V> passed = pass<D>(map, true, jet);
    for (int d = 0; d < D; d++) {
        found.at.p[d] = jet.x[d];
        if constexpr (MIXED) found.mixed[d] = jet.mixed[d];
        for (int e = 0; e < D; e++) found.at.m[e][d] = jet.t[e][d];
    }
    for (int j = 0; MIXED && j < 2; j++) found.smooth2[j] = jet.smooth2[j];
    found.at.done = passed.done;
    found.at.steps = passed.steps;
    return passed;
}

}  // namespace supple
