// The programs that NVRTC compiles, of one kernel each: UNIT, of DIM dimensions; and what is painted: SAMPLE, NUMBER,
// TOGETHER (channels) and CHOSEN (the filter).
#include "half.hpp"
#include "paint.hpp"
#include "points.hpp"
using namespace supple;
using namespace supple::cuda;

#define KERNEL extern "C" __global__ void __launch_bounds__(128)
#if UNIT == 0
KERNEL points(const Some job) { move_point<DIM>(job); }
#elif UNIT == 1
KERNEL nodes(const Job job) { solve_node<DIM>(job); }
#elif UNIT == 2
KERNEL cells(const Job job) { check_cell<DIM>(job); }
#elif UNIT == 3
KERNEL fill(const Job job) { fill_column<SAMPLE, NUMBER, TOGETHER, CHOSEN, DIM>(job); }
#elif UNIT == 4
KERNEL rough(const Job job) { fill_rough<SAMPLE, NUMBER, TOGETHER, CHOSEN, DIM>(job); }
#endif
