// The kernels of the CUDA engine, compiled for the host: blocks run one by one, threads of a block in order.
#include <string.h>

#include <algorithm>
#include <cmath>

// Without optimization, a call is as fast as what is compiled into each caller, and takes a compiler half the time.
#include "simd.hpp"
#undef INLINE
#define INLINE inline
#undef INLINE_LAMBDA
#define INLINE_LAMBDA

// What compilers for GPUs have.
typedef _Float16 Half;
template <class T>
T sample_at(const T* p) {
    return *p;
}
inline int whole_of(float x) { return (int)std::floor(std::clamp(x, -2e9f, 2e9f)); }
struct Place {
    int x, y, z;
};
thread_local Place threadIdx, blockIdx, blockDim, gridDim;
inline int atomicAdd(int* to, int by) {
    const int old = *to;
    *to += by;
    return old;
}
inline void atomicMax(int* to, int value) { *to = std::max(*to, value); }
inline int __float_as_int(float x) {
    int i;
    memcpy(&i, &x, 4);
    return i;
}

#include "paint.hpp"
#include "points.hpp"

using namespace supple;
using namespace supple::cuda;

namespace {

template <class Kernel>
void each(const int* grid, int threads, Kernel kernel) {
    gridDim = {grid[0], grid[1], grid[2]};
    blockDim = {threads, 1, 1};
    for (int z = 0; z < grid[2]; z++)
        for (int y = 0; y < grid[1]; y++)
            for (int x = 0; x < grid[0]; x++)
                for (int t = 0; t < threads; t++) {
                    blockIdx = {x, y, z};
                    threadIdx = {t, 0, 0};
                    kernel();
                }
}

template <class T, class N, int C, int FILTER, int D>
void paint_all(bool rough, const int* grid, int threads, const Job& job) {
    if (rough)
        each(grid, threads, [&] { fill_rough<T, N, C, FILTER, D>(job); });
    else
        each(grid, threads, [&] { fill_column<T, N, C, FILTER, D>(job); });
}
template <class T, class N, int C, int D>
bool with_filter(int filter, bool rough, const int* grid, int threads, const Job& job) {
    switch (filter) {
        case NEAREST: return paint_all<T, N, C, NEAREST, D>(rough, grid, threads, job), true;
        case LINEAR: return paint_all<T, N, C, LINEAR, D>(rough, grid, threads, job), true;
        case CUBIC: return paint_all<T, N, C, CUBIC, D>(rough, grid, threads, job), true;
        case AUTO: return paint_all<T, N, C, AUTO, D>(rough, grid, threads, job), true;
        case cuda::MAP:
            if constexpr (sizeof(T) == 4 && !WHOLE<T>)
                return paint_all<T, N, C, cuda::MAP, D>(rough, grid, threads, job), true;
    }
    return false;
}
template <class T, class N, int D>
bool with_channels(int together, int filter, bool rough, const int* grid, int threads, const Job& job) {
    return together == 1   ? with_filter<T, N, 1, D>(filter, rough, grid, threads, job)
           : together == 3 ? with_filter<T, N, 3, D>(filter, rough, grid, threads, job)
                           : with_filter<T, N, 4, D>(filter, rough, grid, threads, job);
}
template <int D>
bool with_type(const char* sample, int together, int filter, bool rough, const int* grid, int threads, const Job& job) {
#define TYPE(T, N) \
    if (!strcmp(sample, #T)) return with_channels<T, N, D>(together, filter, rough, grid, threads, job);
    TYPE(uint8_t, float)
    TYPE(uint16_t, float)
    TYPE(uint32_t, double)
    TYPE(uint64_t, double)
    TYPE(int8_t, float)
    TYPE(int16_t, float)
    TYPE(int32_t, double)
    TYPE(int64_t, double)
    TYPE(Half, float)
    TYPE(float, float)
    TYPE(double, double)
#undef TYPE
    return false;
}
template <int D>
bool run_in(int unit, const char* sample, int together, int filter, const int* grid, int threads, const void* given) {
    const Job& job = *(const Job*)given;
    switch (unit) {
        case 0: return each(grid, threads, [&] { move_point<D>(*(const Some*)given); }), true;
        case 1: return each(grid, threads, [&] { solve_node<D>(job); }), true;
        case 2: return each(grid, threads, [&] { check_cell<D>(job); }), true;
        default: return with_type<D>(sample, together, filter, unit == 4, grid, threads, job);
    }
}

}  // namespace

// Run a kernel: its unit and dimensions as in kernels.cu, what is painted, and the job. False if there is none such.
extern "C" __attribute__((visibility("default"))) bool run(int unit, int dimensions, const char* sample, int together,
                                                           int filter, const int* grid, int threads, const void* job) {
    return dimensions == 2 ? run_in<2>(unit, sample, together, filter, grid, threads, job)
                           : run_in<3>(unit, sample, together, filter, grid, threads, job);
}
