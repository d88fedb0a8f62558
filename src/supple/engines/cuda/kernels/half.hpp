// Samples of 16 bits with a fraction, on GPUs; hosts have a type of their own.
#pragma once
#include "simd.hpp"

struct Half {
    uint16_t bits;
    Half() = default;
    INLINE explicit Half(float x) { asm("cvt.rn.f16.f32 %0, %1;" : "=h"(bits) : "f"(x)); }
    INLINE operator float() const {
        float x;
        asm("cvt.f32.f16 %0, %1;" : "=f"(x) : "h"(bits));
        return x;
    }
};
