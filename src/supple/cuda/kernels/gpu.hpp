// How GPUs read samples; hosts have their own half-precision type.
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

// The largest whole number that is not above x.
INLINE int whole_of(float x) { return __float2int_rd(x); }

// A sample of the source, which no kernel writes: reading it waits for no store.
template <class T>
INLINE T sample_at(const T* p) {
    return __ldg(p);
}
INLINE Half sample_at(const Half* p) {
    Half h;
    h.bits = __ldg(&p->bits);
    return h;
}
