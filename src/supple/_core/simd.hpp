// Vectors of the width of this instruction set, and the few primitives for the kernels.
//
// The whole module is compiled once for each instruction set, so nothing here chooses at run time. A vector wider
// than a register is two halves (`Pair`). Templates over the number type (`double` or `Lanes`) use only the primitives
// of this file. When NVRTC compiles it for a GPU, there are no vectors, as the threads take the place of lanes.
#pragma once
#if defined(__CUDACC_RTC__)
typedef signed char int8_t;
typedef short int16_t;
typedef int int32_t;
typedef long long int64_t;
typedef unsigned char uint8_t;
typedef unsigned short uint16_t;
typedef unsigned int uint32_t;
typedef unsigned long long uint64_t;
#define INLINE __forceinline__
#define NOINLINE __noinline__
#define CALLED __noinline__
#define ONCE __forceinline__
#define INLINE_LAMBDA
#else
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#if defined(__x86_64__) || defined(_M_X64)
#include <immintrin.h>
#endif
#define INLINE inline __attribute__((always_inline))
#if defined(__clang__)
#define NOINLINE __attribute__((noinline))
#else
#define NOINLINE __attribute__((noinline, noclone))
#endif
#define CALLED NOINLINE  // a function call on GPUs, too, where it is compiled once it is used
#define ONCE NOINLINE    // compiled once for each instruction set (`solvers.hpp`); inline on GPUs
#define INLINE_LAMBDA __attribute__((always_inline))
#endif

namespace supple {

// ---- doubles: points and strokes ----------------------------------------------------------------------------------

template <class V>
INLINE V splat(double x) {
    return V{} + x;
}
template <class V>
INLINE V least(V a, V b) {
    return a < b ? a : b;
}
template <class V>
INLINE V most(V a, V b) {
    return a > b ? a : b;
}
template <class V>
INLINE V magnitude(V a) {
    return most(a, V(-a));
}
#if defined(__CUDACC_RTC__)
INLINE double root(double x) { return sqrt(x); }
INLINE float root(float x) { return sqrtf(x); }
INLINE double inverse_root(double x) { return rsqrt(x); }
INLINE double floored(double x) { return floor(x); }
INLINE float floored(float x) { return floorf(x); }
#else
INLINE double root(double x) { return __builtin_sqrt(x); }
INLINE float root(float x) { return __builtin_sqrtf(x); }
INLINE double floored(double x) { return __builtin_floor(x); }
INLINE float floored(float x) { return __builtin_floorf(x); }
#endif
INLINE double choose(bool m, double a, double b) { return m ? a : b; }
INLINE bool any(bool m) { return m; }
INLINE bool both(bool a, bool b) { return a && b; }
INLINE bool either(bool a, bool b) { return a || b; }
INLINE bool without(bool a, bool b) { return a && !b; }
INLINE double lane(double x, int) { return x; }
INLINE bool lane(bool x, int) { return x; }
INLINE void set_lane(double& x, int, double v) { x = v; }
INLINE void set_lane(bool& x, int, bool v) { x = v; }

template <class V>
struct Masked;
template <>
struct Masked<double> {
    typedef bool type;
    static constexpr int lanes = 1;
};

#if !defined(__CUDACC_RTC__)
#if defined(__AVX__)
constexpr int LANES = 4;
#else
constexpr int LANES = 2;
#endif
typedef double Lanes __attribute__((vector_size(8 * LANES)));
typedef int64_t Mask __attribute__((vector_size(8 * LANES)));

INLINE Lanes root(Lanes x) {
#if defined(__AVX__)
    return (Lanes)_mm256_sqrt_pd((__m256d)x);
#elif defined(__SSE2__)
    return (Lanes)_mm_sqrt_pd((__m128d)x);
#else
    for (int i = 0; i < LANES; i++) x[i] = __builtin_sqrt(x[i]);
    return x;
#endif
}
INLINE Lanes choose(Mask m, Lanes a, Lanes b) { return m ? a : b; }
INLINE bool any(Mask m) {
    int64_t r = 0;
    for (int i = 0; i < LANES; i++) r |= m[i];
    return r != 0;
}
INLINE Mask both(Mask a, Mask b) { return a & b; }
INLINE Mask either(Mask a, Mask b) { return a | b; }
INLINE Mask without(Mask a, Mask b) { return a & ~b; }
template <>
struct Masked<Lanes> {
    typedef Mask type;
    static constexpr int lanes = LANES;
};
INLINE Lanes loaded(const double* from) {
    Lanes v;
    memcpy(&v, from, sizeof v);
    return v;
}
INLINE double lane(Lanes x, int i) { return x[i]; }
INLINE bool lane(Mask x, int i) { return x[i] != 0; }
INLINE void set_lane(Lanes& x, int l, double v) { x[l] = v; }
INLINE void set_lane(Mask& x, int l, bool v) { x[l] = -(int64_t)v; }
template <class V>
INLINE V inverse_root(V x) {
    return 1.0 / root(x);
}
#endif

}  // namespace supple
