// Composite maps as Python objects, shared by the core's binding files.
#pragma once
#include <nanobind/stl/string.h>

#include "bindings.hpp"
#include "composite.hpp"

namespace supple {

typedef nb::ndarray<nb::ro, nb::c_contig, nb::device::cpu> Held;

struct Field {
    Held values;  // kept alive
    int ndim;
    Sampled held;
};

struct AnyComposite {
    int ndim;
    std::shared_ptr<const Composite> held;
    std::vector<nb::object> kept;  // the fields, and the mask
};

}  // namespace supple
