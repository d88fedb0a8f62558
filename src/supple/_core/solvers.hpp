// The solvers of points, compiled once for each instruction set, in solvers.cpp.
#pragma once
#include "composite.hpp"

namespace supple {

#define CARRIES(OF, D, TANGENTS, MIXED) \
    OF template void carry(const Chain&, const Axis*, Jet<D, TANGENTS, MIXED, Lanes>&);
#define PASSES(OF, D, TANGENTS, MIXED)                                                                               \
    OF template void pass_strokes(const Chain&, const Axis*, bool, Jet<D, TANGENTS, MIXED, Lanes>&, Passed<Lanes>&); \
    OF template void pass_field(const Sampled&, bool, Jet<D, TANGENTS, MIXED, Lanes>&, Passed<Lanes>&);
#define SOLVERS(OF, D)                                                                                             \
    CARRIES(OF, D, 0, false)                                                                                       \
    CARRIES(OF, D, D, false)                                                                                       \
    CARRIES(OF, D, D, true)                                                                                        \
    PASSES(OF, D, 0, false)                                                                                        \
    PASSES(OF, D, D, false)                                                                                        \
    PASSES(OF, D, D, true)                                                                                         \
    OF template void newton(const Chain&, const Axis*, const Lanes*, double, int, Solution<D, Lanes>&, double);    \
    OF template void undo(const Chain&, const Axis*, const Lanes*, double, Solution<D, Lanes>&);                   \
    OF template void polish(const Chain&, const Axis*, const Lanes*, double, Solution<D, Lanes>&, Lanes*, Lanes*); \
    OF template void undo_field(const Sampled&, const Lanes*, double, int, Undone<D, Lanes>&);                     \
    OF template bool follow_field(const Sampled&, const double*, const double*, double, Undone<D, double>&);       \
    OF template void field_at<D, 0>(const Sampled&, const double*, const double*, const double*, Local<D, double>&);

#if !defined(SOLVING)
SOLVERS(extern, 2)
SOLVERS(extern, 3)
#endif

}  // namespace supple
