// What the files that Python sees of the core share.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include "stack.hpp"
#include "table.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace supple {

typedef nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu> Doubles;

inline Axes axes_of(const Doubles& rows) {
    if (rows.shape(0) != 3 || rows.shape(1) != AXIS_NUMBERS) throw nb::value_error("axes must have the shape (3, 4)");
    return load_axes(rows.data());
}
inline std::vector<Stroke> strokes_of(const Doubles& rows, const Axis* axes) {
    if (rows.shape(0) && rows.shape(1) != STROKE_NUMBERS) throw nb::value_error("strokes must have 20 columns");
    return load_strokes(rows.data(), rows.shape(0), axes);
}

// When Python ends, it ends each daemon thread that asks for its lock, in the midst of C++ that does not expect that.
// So such a thread stays out, until the process is gone.
struct Ending {
    std::atomic<bool> begun{false};
    std::thread::id main;
    bool keeps_out() const { return begun && std::this_thread::get_id() != main; }
    void stay_out() const {
        while (keeps_out()) std::this_thread::sleep_for(std::chrono::hours(1));
    }
};
inline Ending ending;

// Do work without Python's lock; what Python was interrupted with goes on.
template <class F>
auto unlocked(F&& work) {
    struct Leaving {
        ~Leaving() { ending.stay_out(); }
    };
    try {
        nb::gil_scoped_release release;
        Leaving leaving;
        return work();
    } catch (const Interrupted&) {
        throw nb::python_error();
    }
}

void bind_points(nb::module_& m);
void bind_plans(nb::module_& m);
void bind_folds(nb::module_& m);
void bind_render(nb::module_& m);

// Plane by plane, for images and for frames: each in a file of its own, which two compilers can work on at once.
void sample_plane(const Plan<2>& plan, const Job& job);
void sample_plane(const Plan<3>& plan, const Job& job);

}  // namespace supple
