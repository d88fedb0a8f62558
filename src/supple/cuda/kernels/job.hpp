// The arguments of kernels: the job, in the layout of `supple.cuda.programs`, and maps in one block of memory.
//
// NVRTC compiles this text for GPUs (kernels.cu), and a C++ compiler for tests, which simulate a GPU
// (tests/cuda/host.cpp) and run its blocks one by one.
#pragma once
#include "footprint.hpp"
#include "map.hpp"
#include "patch.hpp"
#include "samples.hpp"

namespace supple::cuda {

// The distance between samples, in samples; for arrays of fewer than 2³¹ samples (SMALL), in 32 bits.
#if defined(SMALL)
using Step = int;
#else
using Step = int64_t;
#endif

// Samples of planes, and the steps from one to the next, in samples.
struct Samples {
    char* first;
    int64_t plane, row, column, channel;
};

// The results of a map's checks: the largest error, as the bits of a float, and counts.
struct Checks {
    int worst, rough, unsolved, folded, outside;
};

// The source point of a pixel: whole numbers and fractions; ∂p/∂x and ∂p/∂y in the plane; |∂p_z/∂q|².
template <int D>
struct Point {
    int whole[D];
    float part[D];
    float across[2], down[2], rate2;
    int same;  // outside every ball, or frozen: the sample is copied
};

template <int D>
constexpr int RUN = D == 3 ? 8 : 1;  // planes whose nodes are solved by one thread

// The i-th of many records of WORDS numbers of 32 bits. Records are interleaved in groups of 32, number by number, so
// that the threads of a warp, with a record each, read and write adjacent addresses.
template <int WORDS>
class Record {
    float* first;

public:
    INLINE Record(void* all, int64_t i) : first((float*)all + (i / 32 * (32 * WORDS) + i % 32)) {}
    INLINE float& operator[](int k) const { return first[32 * k]; }
    INLINE int& whole(int k) const { return ((int*)first)[32 * k]; }
};

// A node: p = T⁻¹(q) as whole numbers and fractions, M, the twist, and the length scales, in pixels.
template <int D>
struct NodeRecord : Record<D*(D + 3) + 2> {
    enum { WHOLE = 0, PART = D, M = 2 * D, MIXED = M + D * D, SMOOTH = MIXED + D };
    using Record<D*(D + 3) + 2>::Record;
};
// The patch of a cell: for each coordinate, a whole number, and the powers of the rest; in volumes, a bilinear ∂p_z/∂z.
template <int D>
struct LeafRecord : Record<17 * D + (D == 3 ? 4 : 0)> {
    enum { ANCHOR = 0, C = D, DEPTH = 17 * D };
    using Record<17 * D + (D == 3 ? 4 : 0)>::Record;
};

struct Job {
    const Map* maps;     // one for each plane, or one
    const int *xs, *ys;  // the nodes, in pixels
    void *nodes, *leaves;
    int *states, *rough;  // of each cell; the list of rough cells
    Checks* checks;
    Samples source, out;
    const double* fill;  // of each channel
    uint64_t top;        // the largest value of integers, equal to `high`
    double tolerance, white, high;
    int map_count, planes, first, shared;  // lattices; the number of the first; the images that share one, or 0
    int width, height, nx, ny;             // pixels, and nodes
    int from_x, from_y;                    // the pixel of the map that the output begins with
    int w, h, count, held_from;            // of the source: size, number of frames, and the first frame in memory
    int channels, between, rule, average, alpha, light;
};
static_assert(sizeof(Job) == JOB_BYTES, "the layout of jobs");
enum State { GOOD = -1, RIM = -2, STILL = -3 };  // the state of a cell; 0 and more: its index among the rough cells

// The index of a sample of the source. PACKED is the number of channels of a pixel, if pixels are contiguous.
INLINE Step source_at(const Job& job, int z, int y, int x, int c = 0) {
#if defined(PACKED)
    const Step column = PACKED, channel = 1;
#else
    const Step column = (Step)job.source.column, channel = (Step)job.source.channel;
#endif
    return z * (Step)job.source.plane + y * (Step)job.source.row + x * column + c * channel;
}
INLINE Step out_at(const Job& job, int z, int y, int x, int c = 0) {
    return z * (Step)job.out.plane + y * (Step)job.out.row + x * (Step)job.out.column + c * (Step)job.out.channel;
}

// Programs are specialized for strokes or composites, and for a way to sample; those of tests are not.
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
