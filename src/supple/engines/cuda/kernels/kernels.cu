// The programs that NVRTC compiles, of one kernel each: UNIT, of DIM dimensions; and what is painted: SAMPLE, NUMBER,
// TOGETHER (channels), CHOSEN (the filter), BETWEEN, AVERAGE and LIGHT.
#include "gpu.hpp"
#include "paint.hpp"
#include "points.hpp"
using namespace supple;
using namespace supple::cuda;

#ifndef AT_ONCE
#define AT_ONCE 1
#endif
// Without __grid_constant__, a thread would copy its job before a call that is given its address.
#ifndef AT_ONCE2
#define AT_ONCE2 1
#endif
#if UNIT >= 3
#define KERNEL extern "C" __global__ void __launch_bounds__(128, AT_ONCE)
#else
#define KERNEL extern "C" __global__ void __launch_bounds__(128, AT_ONCE2)
#endif
#if UNIT == 0
KERNEL points(const __grid_constant__ Some job) { move_point<DIM>(job); }
#elif UNIT == 1
KERNEL nodes(const __grid_constant__ Job job) { solve_node<DIM>(job); }
#elif UNIT == 2
KERNEL cells(const __grid_constant__ Job job) { check_cell<DIM>(job); }
#elif UNIT == 3
KERNEL fill(const __grid_constant__ Job job) { fill_column<SAMPLE, NUMBER, TOGETHER, CHOSEN, DIM>(job); }
#elif UNIT == 4
KERNEL rough(const __grid_constant__ Job job) { fill_rough<SAMPLE, NUMBER, TOGETHER, CHOSEN, DIM>(job); }
#endif
