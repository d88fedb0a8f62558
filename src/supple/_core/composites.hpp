// Composite maps as Python objects, shared by the core's binding files.
#pragma once
#include <nanobind/stl/string.h>

#include "bindings.hpp"

namespace supple {

typedef nb::ndarray<nb::ro, nb::c_contig, nb::device::cpu> Held;

struct Field {
    Held values;  // kept alive
    int ndim;
    Sampled held;
};

// A composite with the memory of its parts.
struct OwnComposite : Composite {
    std::vector<Part> held;
    std::vector<Strokes> strokes;

    explicit OwnComposite(const Axes& axes) : Composite{} {
        smooth = true;
        std::copy(axes.begin(), axes.end(), this->axes);
    }
    OwnComposite(const OwnComposite&) = delete;

    void add(const Part& part) {
        held.push_back(part);
        parts = held.data();
        count = (int)held.size();
    }
    Chain chain_of(Strokes some) {
        strokes.push_back(std::move(some));
        return strokes.back().chain();
    }
};

struct AnyComposite {
    int ndim;
    std::shared_ptr<const Composite> held;
    std::vector<nb::object> kept;  // the fields, and the mask
};

}  // namespace supple
