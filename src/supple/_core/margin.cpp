// Python bindings of the margin of strokes to folding.
#include "margin.hpp"

#include <nanobind/stl/tuple.h>

#include "bindings.hpp"

namespace supple {
namespace {

std::tuple<double, double> smallest_strain(const Rows& table, const AxisRows& rows, double free, double distance,
                                           double target, double gap, const Frozen* freeze) {
    const Strokes group = strokes_of(table, rows, freeze);
    const folds::Bounds found = folds::smallest_strain(group.table, group.axes.data(), free, distance, target, gap);
    return {found.lower, found.upper};
}

std::tuple<double, double, double> smallest_free_strain(const Rows& table, double gap) {
    const folds::Bounds found = folds::smallest_free_strain(Strokes(table.data(), 1, Axes{}).table, gap);
    return {found.lower, found.upper, found.point[0]};
}

double largest_displacement(const Rows& table, const AxisRows& rows, const Frozen* freeze) {
    const Strokes group = strokes_of(table, rows, freeze);
    return folds::largest_displacement(group.table, group.axes.data());
}

bool turns_whole(const Rows& table, const AxisRows& rows, const Frozen* freeze) {
    const Strokes group = strokes_of(table, rows, freeze);
    return group.table.size() == 1 && is_whole(group.table[0]);
}

}  // namespace

void bind_margin(nb::module_& m) {
    m.def("smallest_strain", &smallest_strain, "strokes"_a, "axes"_a, "free"_a, "distance"_a, "target"_a, "gap"_a,
          "freeze"_a.none() = nb::none(), "Bound μ of strokes that act at once from below and above.");
    m.def("smallest_free_strain", &smallest_free_strain, "stroke"_a, "gap"_a,
          "Bound μ of a unit force of finite reach in all of space; return the bounds, and how far ahead of the pivot "
          "the upper one is reached.");
    m.def("largest_displacement", &largest_displacement, "strokes"_a, "axes"_a, "freeze"_a.none() = nb::none(),
          "Bound |K| of strokes that act at once from above.");
    m.def("is_whole", &turns_whole, "stroke"_a, "axes"_a, "freeze"_a.none() = nb::none(),
          "True for a twist where neither a border nor a mask changes it.");
}

}  // namespace supple
