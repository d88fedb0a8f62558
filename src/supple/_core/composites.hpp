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
    std::vector<std::vector<Stroke>> strokes;
    std::vector<std::vector<int>> lists;

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
    Chain chain_of(std::vector<Stroke> some) {
        std::vector<int> list(some.size());
        for (size_t i = 0; i < list.size(); i++) list[i] = (int)i;
        strokes.push_back(std::move(some));
        lists.push_back(std::move(list));
        return {strokes.back().data(), lists.back().data(), (int)lists.back().size()};
    }
};

struct AnyComposite {
    int ndim;
    std::shared_ptr<const Composite> held;
    std::vector<nb::object> kept;  // the fields, and the mask
};

}  // namespace supple
