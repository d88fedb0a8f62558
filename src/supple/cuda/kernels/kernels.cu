// The programs that NVRTC compiles, one kernel each: UNIT, for DIM dimensions; and, for painting: SAMPLE, NUMBER,
// TOGETHER (channels), CHOSEN (the filter), BETWEEN, AVERAGE and LIGHT.
#include "gpu.hpp"
#include "paint.hpp"
#include "points.hpp"
using namespace supple;
using namespace supple::cuda;

// More blocks at once are worth fewer registers, as measured on an H100: to fill, a GPU waits for memory more than it
// computes. Without __grid_constant__, each thread would copy its job before passing its address to a call.
#if UNIT == 3
#define BLOCKS (TOGETHER == 1 ? 10 : 8)
#elif UNIT > 0 && UNIT < 3 && defined(COMPOSED) && !COMPOSED
#define BLOCKS (UNIT == 2 ? 6 - DIM : DIM == 2 ? 3 : 1)
#else
#define BLOCKS 1
#endif
#define KERNEL extern "C" __global__ void __launch_bounds__(128, BLOCKS)
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
