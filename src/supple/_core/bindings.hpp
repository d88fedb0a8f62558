// Declarations shared by the core's binding files.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>

#include <optional>

#include "stack.hpp"
#include "table.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace supple {

// A contiguous array of type T, with SIZES along its axes; -1 for any size.
template <class T, nb::ssize_t... SIZES>
using Array = nb::ndarray<T, nb::shape<SIZES...>, nb::c_contig, nb::device::cpu>;
template <class T>
using Solid = Array<T, -1, -1, -1>;
typedef nb::ndarray<nb::ro, nb::c_contig, nb::device::cpu> Given;  // of any type
typedef nb::ndarray<nb::c_contig, nb::device::cpu> Result;
typedef Array<const double, -1, -1> Doubles;
typedef Array<const double, -1, STROKE_NUMBERS> Rows;
typedef Array<const double, -1, 3> Triples;
typedef Array<const double, 3, AXIS_NUMBERS> AxisRows;

inline Strokes strokes_of(const Rows& rows, const AxisRows& axes, const Frozen* freeze) {
    return Strokes(rows.data(), rows.shape(0), load_axes(axes.data()), freeze);
}

struct Field : Sampled {
    int ndim;
    Given held;  // its values
};

// A composite with the memory of its parts; the fields and the mask are kept alive.
struct Composed : Composite {
    int ndim;
    std::vector<Part> held;
    std::vector<Strokes> strokes;
    std::vector<nb::object> kept;
};

// A map: strokes alone, or a composite, which has them among its parts.
struct Mapping {
    Strokes strokes;
    int ndim;
    const Frozen* freeze;       // or null
    const Composed* composite;  // or null
};

// The values as a new array that owns them.
inline nb::object owned(std::vector<double>* made, std::initializer_list<size_t> shape) {
    nb::capsule owner(made, [](void* p) noexcept { delete (std::vector<double>*)p; });
    return nb::cast(nb::ndarray<nb::numpy, double>(made->data(), shape, owner));
}

// Call body(first, n) for batches of LANES points; the last one may have fewer.
template <class F>
void each_batch(size_t count, F body) {
    constexpr size_t TOGETHER = 512;  // points for a thread at once
    parallel((int)((count + TOGETHER - 1) / TOGETHER), [&](int item, int) {
        size_t first = (size_t)item * TOGETHER, end = std::min(first + TOGETHER, count);
        for (size_t i = first; i < end; i += LANES) body(i, (int)std::min<size_t>(LANES, end - i));
    });
}

// At exit, Python ends daemon threads that wait for its lock; within C++ code, they cannot be unwound. So such threads
// wait here until the process has ended, and exit waits for threads that are already taking the lock.
class Ending {
public:
    // Before and after a thread takes Python's lock again.
    bool try_enter() {
        asking++;
        if (!begun || std::this_thread::get_id() == main) return true;
        asking--;
        return false;
    }
    void enter() {
        while (!try_enter()) std::this_thread::sleep_for(std::chrono::hours(1));
    }
    void entered() { asking--; }
    void forked() { asking = 0; }  // threads of the parent do not exist in its child
    void begin() {
        main = std::this_thread::get_id();
        begun = true;
        nb::gil_scoped_release release;
        while (asking > 0) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }

private:
    std::atomic<bool> begun{false};
    std::atomic<int> asking{0};
    std::thread::id main;
};
inline Ending ending;

// Run work without Python's lock; exceptions of Python's signal handlers are passed on.
template <class F>
auto unlocked(F&& work) {
    struct Entered {
        ~Entered() { ending.entered(); }
    };
    struct Entering {
        ~Entering() { ending.enter(); }
    };
    try {
        Entered entered;
        nb::gil_scoped_release release;
        Entering entering;
        return work();
    } catch (const Interrupted&) {
        throw nb::python_error();
    }
}

void bind_points(nb::module_& m);
void bind_plans(nb::module_& m);
void bind_margin(nb::module_& m);
void bind_fields(nb::module_& m);
void bind_flat(nb::module_& m);
void bind_render(nb::module_& m);

// Sample a plane of an image, or of a stack: each in a file of its own, to be compiled in parallel.
void sample_plane(const Plan<2>& plan, const Job& job);
void sample_plane(const Plan<3>& plan, const Job& job);

}  // namespace supple
