// A map in one block of memory, as kernels on a GPU read it.
#pragma once
#include "composite.hpp"

namespace supple {

// Strokes, or a composite; and their freeze mask. All pointers are to addresses in the map's block.
struct Map {
    Chain chain;
    const Composite* composite;  // or null
    const Freeze* freeze;        // or null, if it concerns no stroke
    int64_t limited;             // whether every stroke has a reach, so that points may lie outside of every ball
    Axis axes[3];
};

}  // namespace supple
