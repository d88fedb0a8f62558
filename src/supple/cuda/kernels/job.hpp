// What kernels are given: the job, in the layout of `supple.cuda.layout`, and maps in one block of memory.
//
// The same text is compiled by NVRTC for GPUs (kernels.cu), and by a C++ compiler for tests, which have what stands in
// for a GPU (host.cpp), and run its blocks one by one.
#pragma once
#include "footprint.hpp"
#include "map.hpp"
#include "patch.hpp"
#include "samples.hpp"

namespace supple::cuda {

// Samples of planes, and the steps from one to the next, in samples.
struct Samples {
    char* first;
    int64_t plane, row, column, channel;
};

// Of the map: bits of a float that is not negative, counts.
struct Told {
    int worst, rough, unsolved, folded, outside;
};

// The place that a pixel is sampled at: whole numbers and fractions; ∂p/∂x and ∂p/∂y in the plane; |∂p_z/∂q|².
template <int D>
struct Point {
    int whole[D];
    float part[D];
    float across[2], down[2], rate2;
    int same;  // outside every ball, or frozen: what is there is copied
};

template <int D>
constexpr int RUN = D == 3 ? 8 : 1;  // planes whose nodes are solved by one thread

struct Job {
    const Map* maps;     // one for each plane, or one
    const int *xs, *ys;  // the nodes, in pixels
    void *nodes, *leaves;
    int *states, *rough;  // of each cell; the rough ones
    Told* told;
    Samples source, out;
    const double* fill;  // of each channel
    uint64_t top;        // the largest value of whole numbers, which is `high`
    double tolerance, white, high;
    int map_count, planes, first, shared;  // lattices; the number of the first; the images that share one, or 0
    int width, height, nx, ny;             // pixels, and nodes
    int from_x, from_y;                    // the pixel of the map that the output begins with
    int w, h, count, held_from;            // of the source: its size, its frames, and the first that is there
    int channels, between, rule, average, alpha, light;
};
static_assert(sizeof(Job) == JOB_BYTES, "the layout of jobs");
static_assert(sizeof(Node<2, float>) == 48 && sizeof(Node<3, float>) == 80, "as supple.cuda.warp has them");
static_assert(sizeof(Leaf<2>) == 168 && sizeof(Leaf<3>) == 236, "as supple.cuda.warp makes room for them");

enum State { GOOD = -1, RIM = -2, STILL = -3 };  // of a cell; from 0 on: its place among the rough ones

// Programs are compiled for strokes, or for composites; and for a way to sample; tests for all.
#if defined(COMPOSED)
INLINE constexpr bool composed(const Map&) { return COMPOSED; }
#else
INLINE bool composed(const Map& map) { return map.composite; }
#endif
#if defined(BETWEEN)
INLINE constexpr int between_of(const Job&) { return BETWEEN; }
INLINE constexpr bool averages(const Job&) { return AVERAGE; }
INLINE constexpr bool in_light(const Job&) { return LIGHT; }
#else
INLINE int between_of(const Job& job) { return job.between; }
INLINE bool averages(const Job& job) { return job.average; }
INLINE bool in_light(const Job& job) { return job.light; }
#endif
INLINE int64_t thread() { return (int64_t)blockIdx.x * blockDim.x + threadIdx.x; }
INLINE const Map& map_of(const Job& job, int plane) { return job.maps[job.map_count > 1 ? job.first + plane : 0]; }
INLINE double depth_of(const Job& job, int plane) { return (double)(job.first + plane); }

}  // namespace supple::cuda
