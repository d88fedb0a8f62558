// Folding, for Python.

#include "folds.hpp"

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/tuple.h>

#include <cmath>
#include <tuple>

namespace nb = nanobind;
using namespace nb::literals;

namespace supple {

namespace {

using Terms = nb::ndarray<const double, nb::shape<-1, 4>, nb::c_contig, nb::device::cpu>;
using Vector = nb::ndarray<const double, nb::shape<3>, nb::c_contig, nb::device::cpu>;
using Axes = nb::ndarray<const double, nb::shape<3, 4>, nb::c_contig, nb::device::cpu>;

// A stroke in units of ε, the square root of its first radius².
folds::Stroke stroke_of(const Terms& terms, double reach, double& epsilon) {
    if (terms.shape(0) < 1 || terms.shape(0) > 3) throw nb::value_error("a stroke has 1, 2 or 3 terms");
    epsilon = std::sqrt(terms(0, 0));
    folds::Stroke stroke;
    stroke.terms = static_cast<int>(terms.shape(0));
    for (int i = 0; i < stroke.terms; ++i) {
        stroke.term[i] = {terms(i, 0) / terms(0, 0), terms(i, 1) / epsilon, terms(i, 2) / epsilon / terms(0, 0),
                          terms(i, 3) / epsilon};
    }
    stroke.reach = reach / epsilon;
    return stroke;
}

std::tuple<double, double, std::size_t> smallest_strain(const Terms& terms, const Vector& pivot,
                                                        const Vector& direction, double reach, const Axes& domain,
                                                        double free, double upper, double target, double gap) {
    double epsilon;
    folds::Stroke stroke = stroke_of(terms, reach, epsilon);
    std::array<folds::Axis, 3> axes;
    for (int k = 0; k < 3; ++k) {
        stroke.pivot[k] = pivot(k) / epsilon;
        stroke.force[k] = direction(k);
        axes[k] = {
            .extent = domain(k, 0) / epsilon,
            .sigma = domain(k, 1) / epsilon,
            .profile = domain(k, 3) == 1.0 ? folds::Profile::sine : folds::Profile::quartic,
            .active = domain(k, 0) > 0.0 && domain(k, 1) > 0.0,
        };
    }
    const auto found = folds::smallest_strain(stroke, axes, {free * epsilon, upper * epsilon, target * epsilon, gap});
    return {found.lower / epsilon, found.upper / epsilon, found.boxes};
}

std::tuple<double, double, double, std::size_t> smallest_free_strain(const Terms& terms, double reach, double gap) {
    double epsilon;
    const folds::Stroke stroke = stroke_of(terms, reach, epsilon);
    const auto found = folds::smallest_free_strain(stroke, gap);
    return {found.lower / epsilon, found.upper / epsilon, found.distance * epsilon, found.boxes};
}

}  // namespace

void bind_folds(nb::module_& m) {
    m.def(
        "smallest_strain", &smallest_strain, "terms"_a, "pivot"_a, "direction"_a, "reach"_a, "axes"_a, "free"_a,
        "upper"_a, "target"_a, "gap"_a,
        "Bound μ of a unit force with a fixed border from below and above; return the bounds and the count of boxes.");
    m.def("smallest_free_strain", &smallest_free_strain, "terms"_a, "reach"_a, "gap"_a,
          "Bound μ of a unit force of finite reach in all of space; return the bounds, how far ahead of the pivot the "
          "upper one is reached, and the count of boxes.");
}

}  // namespace supple
