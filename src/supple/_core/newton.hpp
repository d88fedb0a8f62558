// T⁻¹: Newton's method with backtracking on a chain of strokes, and a continuation if it fails.
//
// Every stroke is one-to-one with a Jacobian that is nowhere singular (`supple.folding.limits` sees to it), so T(p) = q
// has one solution, and the step δ = -(I+J)⁻¹ ξ, ξ = T(p) - q, always leads downhill in |ξ|². From a good guess, the
// whole chain is solved at once; without one, stroke after stroke is undone, the last one first, which cannot fail
// where each is one-to-one.
#pragma once
#include "stroke.hpp"

namespace supple {

// The strokes of a table that apply, in order. If `reached` is not null, it has for each stroke the bits of the lanes
// that it applies to, from bit `lane` on; it changes no bit of other lanes.
struct Chain {
    const Stroke* strokes;
    const int* list;
    int count;
    const uint8_t* reached = nullptr;
    int lane = 0;
    const Stroke& operator[](int i) const { return strokes[list[i]]; }
    // The lanes that a stroke applies to, as bits.
    int lanes_of(int i) const { return reached ? reached[i] >> lane : -1; }
    // The end of the group that begins at i.
    int end_of(int i) const {
        int end = i + 1;
        while (end < count && (*this)[end].group == (*this)[i].group) end++;
        return end;
    }
    Chain part(int from, int end) const {
        return {strokes, list + from, end - from, reached ? reached + from : nullptr, lane};
    }
    // The group that ends before `end`.
    Chain last_before(int end) const {
        int i = end - 1;
        while (i > 0 && (*this)[i - 1].group == (*this)[end - 1].group) i--;
        return part(i, end);
    }
};

// Add one stroke's part to a jet, as `add` does, in some lanes.
template <int D, int TANGENTS, bool MIXED, class V>
INLINE void add_for(int lanes, const Stroke& k, const Axis* axes, const Jet<D, TANGENTS, MIXED, V>& at,
                    Jet<D, TANGENTS, MIXED, V>& jet) {
    constexpr int EVERY = (1 << Masked<V>::lanes) - 1;
    const bool all = (lanes & EVERY) == EVERY;
    if ((lanes & EVERY) == 0) return;
    Jet<D, TANGENTS, MIXED, V> before;
    if (!all) before = jet;
    add(k, axes, at, jet);
    if (all) return;
    V bits{};
    for (int l = 0; l < Masked<V>::lanes; l++) set_lane(bits, l, lanes >> l & 1);
    const auto own = bits > 0.5;
    for (int i = 0; i < D; i++) jet.x[i] = choose(own, jet.x[i], before.x[i]);
    for (int j = 0; j < TANGENTS; j++)
        for (int i = 0; i < D; i++) jet.t[j][i] = choose(own, jet.t[j][i], before.t[j][i]);
    if constexpr (MIXED) {
        for (int i = 0; i < D; i++) jet.mixed[i] = choose(own, jet.mixed[i], before.mixed[i]);
        for (int j = 0; j < 2; j++) jet.smooth2[j] = choose(own, jet.smooth2[j], before.smooth2[j]);
    }
}

// Add the displacements of strokes that act at once, all at the same point, to a jet.
template <int D, int TANGENTS, bool MIXED, class V>
NOINLINE void add_group(const Chain& group, const Axis* axes, Jet<D, TANGENTS, MIXED, V>& jet) {
    const Jet<D, TANGENTS, MIXED, V> at = jet;
    for (int k = 0; k < group.count; k++) add_for(group.lanes_of(k), group[k], axes, at, jet);
}

// Map a jet by a chain: x ← T(x), t ← T'(x) t, mixed ← T'(x) mixed + T''(x)(t₀, t₁). A single stroke of a group is
// added in the same way as several, so that the others, which a lane may not need, change no bit of it.
template <int D, int TANGENTS, bool MIXED, class V>
ONCE void carry(const Chain& chain, const Axis* axes, Jet<D, TANGENTS, MIXED, V>& jet) {
    for (int k = 0, end; k < chain.count; k = end) {
        end = chain.end_of(k);
        if (chain[k].shared)
            add_group(chain.part(k, end), axes, jet);
        else
            add_for(chain.lanes_of(k), chain[k], axes, jet, jet);
    }
}

// Map a point back through a group of one twist, by the opposite angle: this is T⁻¹ where there is neither a border nor
// a mask, and a guess otherwise.
template <int D, class V>
INLINE void turn_back(const Chain& group, const Axis* axes, V* x) {
    if (group.count > 1 || !group[0].turns()) return;
    Stroke back = group[0];
    back.p[0] = -back.p[0];
    back.q[0] = -back.q[0];
    auto jet = jet_at<D, 0>(x);
    add_for(group.lanes_of(0), back, axes, jet, jet);
    for (int i = 0; i < D; i++) x[i] = jet.x[i];
}

// A point p with T(p) = q, the columns of (∂T/∂p)⁻¹ there, the evaluations of T with its Jacobian, and the mask of
// converged lanes.
template <int D, class V>
struct Solution {
    V p[D];
    V m[D][D];
    V steps;
    typename Masked<V>::type done;
};

// Finished lanes do not change while others continue.
template <int D, class V>
INLINE Solution<D, V> choose(typename Masked<V>::type first, const Solution<D, V>& a, const Solution<D, V>& b) {
    Solution<D, V> c = b;
    for (int i = 0; i < D; i++) {
        c.p[i] = choose(first, a.p[i], b.p[i]);
        for (int j = 0; j < D; j++) c.m[j][i] = choose(first, a.m[j][i], b.m[j][i]);
    }
    c.steps = choose(first, a.steps, b.steps);
    c.done = either(both(first, a.done), without(b.done, first));
    return c;
}

// A coordinate with a fixed face: the face maps to itself, and no point crosses it.
template <class V>
INLINE V kept_inside(V x, V q, const Axis& a) {
    if (!a.fixed()) return x;
    V kept = choose(q <= a.first, q, nearest(x, a));
    return choose(q >= a.last, q, kept);
}

template <int D, class V>
INLINE void apply(const Chain& chain, const Axis* axes, V* x) {
    auto jet = jet_at<D, 0>(x);
    carry(chain, axes, jet);
    for (int i = 0; i < D; i++) x[i] = jet.x[i];
}

constexpr double SHORTEST = 0x1p-24;  // the smallest fraction of a step
constexpr double DOWNHILL = 1e-4;     // the fraction of the predicted decrease that a step must achieve
constexpr double STEEP = 10;          // ratio of residuals, and of distances, up to which Newton's steps are trusted
constexpr double CLOSE = 0.03;        // the largest |(∂T/∂p) m - I| of an m whose square is accurate enough

// Solve T(p) = q from the guess in `found.p`, until a step is shorter than `tolerance`, from a residual of at most
// `residual`: where T is very steep, short steps alone do not imply convergence.
template <int D, class V>
CALLED void newton(const Chain& chain, const Axis* axes, const V* q, double tolerance, int limit, Solution<D, V>& found,
                   double residual = 1e150) {
    typedef typename Masked<V>::type M;
    V base[D], step[D], error = splat<V>(1e300), part = splat<V>(1.0);
    M done = error < 0.0;
    for (int i = 0; i < D; i++) {
        base[i] = found.p[i];
        step[i] = V{};
    }
    for (int round = 0; round < limit; round++) {
        V tried[D], e[D], e2 = V{};
        for (int i = 0; i < D; i++) tried[i] = kept_inside(V(base[i] + part * step[i]), q[i], axes[i]);
        auto jet = jet_at<D, D>(tried);
        carry(chain, axes, jet);
        found.steps += choose(done, V{}, splat<V>(1.0));
        for (int i = 0; i < D; i++) {
            e[i] = jet.x[i] - q[i];
            e2 += e[i] * e[i];
        }
        // Lanes that have given up do not change while others continue.
        M taken = without(both(e2 <= error * (1.0 - DOWNHILL * part), part > SHORTEST), done);
        V m[D][D], d[D], d2 = V{};
        invert(jet.t, m);
        for (int i = 0; i < D; i++) {
            d[i] = -times<D>(m, e, i);
            d2 += d[i] * d[i];
        }
        for (int i = 0; i < D; i++) {
            base[i] = choose(taken, tried[i], base[i]);
            step[i] = choose(taken, d[i], step[i]);
            for (int j = 0; j < D; j++) found.m[j][i] = choose(taken, m[j][i], found.m[j][i]);
        }
        error = choose(taken, e2, error);
        part = choose(taken, splat<V>(1.0), V(0.5 * part));
        done = either(done, both(taken, both(d2 <= tolerance * tolerance, e2 <= residual * residual)));
        if (!any(without(part > SHORTEST, done))) break;
    }
    // Apply the last, short step.
    for (int i = 0; i < D; i++) found.p[i] = kept_inside(choose(done, V(base[i] + step[i]), base[i]), q[i], axes[i]);
    found.done = done;
}

// Solve one stroke at one point by following T⁻¹ along the straight line from T(q) to q; false on failure.
template <int D>
NOINLINE bool follow(const Chain& one, const Axis* axes, const double* q, double tolerance, double* p, double& steps) {
    double start[D], here[D];
    for (int i = 0; i < D; i++) start[i] = here[i] = q[i];
    apply<D>(one, axes, start);
    double way = 0, stride = 0.5;
    while (way < 1 && stride > 1e-9) {
        double next = least(1.0, way + stride), target[D];
        Solution<D, double> found{};
        for (int i = 0; i < D; i++) {
            target[i] = start[i] + next * (q[i] - start[i]);
            found.p[i] = here[i];
        }
        newton<D>(one, axes, target, tolerance, 12, found);
        steps += found.steps;
        stride *= found.done ? 2 : 0.5;
        if (!found.done) continue;
        for (int i = 0; i < D; i++) here[i] = found.p[i];
        way = next;
    }
    if (way < 1) return false;
    for (int i = 0; i < D; i++) p[i] = here[i];
    return true;
}

// Solve T(p) = q without a guess: undo stroke after stroke, then polish with the whole chain.
template <int D, class V>
NOINLINE void undo(const Chain& chain, const Axis* axes, const V* q, double tolerance, Solution<D, V>& found) {
    V at[D];
    for (int i = 0; i < D; i++) at[i] = q[i];
    found = Solution<D, V>();
    found.done = splat<V>(0.0) <= 0.0;
    for (int i = 0; i < D; i++) {
        found.p[i] = at[i];
        for (int j = 0; j < D; j++) found.m[j][i] = splat<V>(i == j);
    }
    for (int k = chain.count; k > 0;) {
        const Chain one = chain.last_before(k);
        k -= one.count;
        for (int i = 0; i < D; i++) found.p[i] = at[i];
        turn_back<D>(one, axes, found.p);
        newton<D>(one, axes, at, tolerance, 40, found);
        for (int l = 0; l < Masked<V>::lanes; l++)
            if (!lane(found.done, l)) {
                double target[D], p[D], steps = 0;
                for (int i = 0; i < D; i++) target[i] = lane(at[i], l);
                Chain alone = one;
                alone.lane = l;
                bool known = follow<D>(alone, axes, target, tolerance, p, steps);
                for (int i = 0; i < D && known; i++) set_lane(found.p[i], l, p[i]);
                set_lane(found.steps, l, lane(found.steps, l) + steps);
            }
        for (int i = 0; i < D; i++) at[i] = found.p[i];
    }
    // Also for a single stroke: the matrix must be that at the solution.
    newton<D>(chain, axes, q, tolerance, 8, found);
}

// Take one more Newton step from p with m ≈ (∂T/∂p)⁻¹ in `found`, which makes m exact to second order, and compute
// ∂²p/∂q₀∂q₁ = -m T''(m₀, m₁). It is done if that step is shorter than `tolerance`, the residual at most STEEP times
// that, and m was close. `smooth2`: the squared lengths over which the map varies along q₀ and q₁.
template <int D, class V>
CALLED void polish(const Chain& chain, const Axis* axes, const V* q, double tolerance, Solution<D, V>& found, V* mixed,
                   V* smooth2) {
    Jet<D, D, true, V> jet;
    for (int i = 0; i < D; i++) {
        jet.x[i] = found.p[i];
        jet.mixed[i] = V{};
        for (int j = 0; j < D; j++) jet.t[j][i] = found.m[j][i];
    }
    jet.smooth2[0] = jet.smooth2[1] = splat<V>(1e300);
    carry(chain, axes, jet);
    for (int j = 0; j < 2; j++) smooth2[j] = jet.smooth2[j];
    // jet.t = (∂T/∂p) m ≈ I, so to first order, its inverse is 2I - jet.t.
    V better[D][D], e[D];
    for (int j = 0; j < D; j++)
        for (int i = 0; i < D; i++) better[j][i] = 2.0 * found.m[j][i] - times<D>(found.m, jet.t[j], i);
    for (int i = 0; i < D; i++) e[i] = jet.x[i] - q[i];
    V step2 = V{}, off2 = V{}, e2 = dot<D>(e, e);
    for (int i = 0; i < D; i++) {
        for (int j = 0; j < D; j++) off2 += (jet.t[j][i] - double(i == j)) * (jet.t[j][i] - double(i == j));
        mixed[i] = -times<D>(better, jet.mixed, i);
        V step = times<D>(better, e, i);
        step2 += step * step;
        found.p[i] = kept_inside(V(found.p[i] - step), q[i], axes[i]);
    }
    const double residual = STEEP * tolerance;
    found.done = both(both(step2 <= tolerance * tolerance, e2 <= residual * residual), off2 <= CLOSE * CLOSE);
    found.steps += 1.0;
    for (int i = 0; i < D; i++)
        for (int j = 0; j < D; j++) found.m[j][i] = better[j][i];
}

// T⁻¹(q) at a node, with its derivatives.
template <int D, class V>
struct Solved {
    Solution<D, V> at;
    V mixed[D], smooth2[2];  // as `polish` has them
};

enum class Guess { NONE, POINT, PATCH };  // of a node: nothing; p; p and its derivatives

// Solve T(p) = q at a node, from a guess in `found`; `finest` is the least spacing, and `tolerance` is in pixels.
// `twice`: whether to take a second step where the first one from a patch was too long.
template <int D, class V>
INLINE Solved<D, V> solved(const Chain& chain, const Axis* axes, const V* q, double finest, double tolerance,
                           Guess guess, Solution<D, V> found, bool twice = false) {
    typedef typename Masked<V>::type M;
    // A step this short is applied, and one more after it, which leaves an error of the order of its fourth power.
    const double enough = finest * least(0.02, 0.2 * root(tolerance));
    const M all = splat<V>(0.0) <= 0.0;
    auto polished = [&](const Solution<D, V>& s, double tolerance) {
        Solved<D, V> made{s, {}, {}};
        polish<D>(chain, axes, q, tolerance, made.at, made.mixed, made.smooth2);
        return made;
    };
    auto merged = [&](const Solved<D, V>& a, const Solved<D, V>& b) {
        Solved<D, V> made{choose(a.at.done, a.at, b.at), {}, {}};
        for (int d = 0; d < D; d++) made.mixed[d] = choose(a.at.done, a.mixed[d], b.mixed[d]);
        for (int d = 0; d < 2; d++) made.smooth2[d] = choose(a.at.done, a.smooth2[d], b.smooth2[d]);
        return made;
    };
    auto undo_others = [&](double tolerance) {  // of those that are not found
        Solution<D, V> anew;
        undo<D>(chain, axes, q, tolerance, anew);
        anew.steps += found.steps;
        found = choose(found.done, found, anew);
    };
    found.done = without(all, all);
    Solved<D, V> known{found, {}, {}};
    // One step of a fourth of this length leaves an error of the order of its square.
    if (guess == Guess::PATCH) known = polished(found, enough / 4);
    if (twice && guess == Guess::PATCH && any(without(all, known.at.done)))
        known = merged(known, polished(known.at, enough / 4));
    if (any(without(all, known.at.done))) {
        if (guess != Guess::NONE) newton<D>(chain, axes, q, enough, 12, found, STEEP * enough);
        if (any(without(all, found.done))) undo_others(enough);
        Solved<D, V> more = polished(found, enough);
        more.at.done = both(more.at.done, found.done);
        if (any(without(all, either(known.at.done, more.at.done)))) {
            // The map varies over the last step: continue Newton's method to the end, or undo each stroke to the end.
            const double end = finest * least(1e-6, 1e-4 * tolerance);
            newton<D>(chain, axes, q, end, 20, found, STEEP * enough);
            // A GPU solves the pixels beside a node that is not solved, and keeps its registers.
            if (Masked<V>::lanes > 1 && any(without(all, either(found.done, either(known.at.done, more.at.done)))))
                undo_others(end);
            Solved<D, V> last = polished(found, enough);
            last.at.done = found.done;
            more = merged(more, last);
        }
        more.at.steps += known.at.steps;
        known = merged(known, more);
    }
    return known;
}

}  // namespace supple
