// Python bindings of the margin of strokes to folding.
#include "margin.hpp"

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

#include <tuple>

#include "bindings.hpp"

namespace supple {

namespace {

typedef nb::ndarray<const double, nb::shape<-1, STROKE_NUMBERS>, nb::c_contig, nb::device::cpu> Table;
typedef nb::ndarray<const double, nb::shape<3, AXIS_NUMBERS>, nb::c_contig, nb::device::cpu> Rows;

std::tuple<double, double> smallest_strain(const Table& table, const Rows& domain, double free, double distance,
                                           double target, double gap, Masking freeze) {
    if (!table.shape(0)) throw nb::value_error("a group has one stroke at least");
    const Axes axes = load_axes(domain.data());
    const std::vector<Stroke> strokes =
        load_strokes(table.data(), table.shape(0), axes.data(), freeze.value_or(nullptr));
    const folds::Bounds found = folds::smallest_strain(strokes, axes.data(), free, distance, target, gap);
    return {found.lower, found.upper};
}

std::tuple<double, double, double> smallest_free_strain(const Table& table, double gap) {
    if (table.shape(0) != 1) throw nb::value_error("the free border is for one stroke");
    const folds::Bounds found = folds::smallest_free_strain(load_strokes(table.data(), 1, Axes{}.data()), gap);
    return {found.lower, found.upper, found.point[0]};
}

double largest_displacement(const Table& table, const Rows& domain, Masking freeze) {
    if (!table.shape(0)) throw nb::value_error("a group has one stroke at least");
    const Axes axes = load_axes(domain.data());
    const std::vector<Stroke> strokes =
        load_strokes(table.data(), table.shape(0), axes.data(), freeze.value_or(nullptr));
    return folds::largest_displacement(strokes, axes.data());
}

bool turns_whole(const Table& table, const Rows& domain, Masking freeze) {
    const Axes axes = load_axes(domain.data());
    const std::vector<Stroke> strokes =
        load_strokes(table.data(), table.shape(0), axes.data(), freeze.value_or(nullptr));
    return strokes.size() == 1 && supple::is_whole(strokes[0]);
}

}  // namespace

void bind_margin(nb::module_& m) {
    m.def("smallest_strain", &smallest_strain, "strokes"_a, "axes"_a, "free"_a, "distance"_a, "target"_a, "gap"_a,
          "freeze"_a = nb::none(), "Bound μ of strokes that act at once from below and above.");
    m.def("smallest_free_strain", &smallest_free_strain, "stroke"_a, "gap"_a,
          "Bound μ of a unit force of finite reach in all of space; return the bounds, and how far ahead of the pivot "
          "the upper one is reached.");
    m.def("largest_displacement", &largest_displacement, "strokes"_a, "axes"_a, "freeze"_a = nb::none(),
          "Bound |K| of strokes that act at once from above.");
    m.def("is_whole", &turns_whole, "stroke"_a, "axes"_a, "freeze"_a = nb::none(),
          "True for a twist where neither a border nor a mask changes it.");
}

}  // namespace supple
