// T⁻¹ on one plane: solved at the nodes of a lattice, interpolated by patches, and certified.
//
// At a node, Newton's method gives p = T⁻¹(q), its derivatives ∂p/∂q = (I+J)⁻¹ and, by second-order jets, the twist
// ∂²p/∂x∂y: all that a bicubic Hermite patch needs, exactly, so that a cell depends on its own four nodes alone. A
// cell is checked against T itself at nine points: |M (T(p) - q)| is the distance to T⁻¹(q). If it is too large, or the
// map varies too fast for nine points, the cell is split, down to single pixels, whose corners are nodes. A root cell
// that no stroke can reach is the identity and costs nothing.
//
// In samples that a freeze among the strokes holds, T⁻¹ is that of the strokes before it, from a plan of their own,
// with the same bits as without the later strokes.
//
// A composite map (`Composite`) is solved at the nodes without guesses, and cells are checked against its solutions. If
// it is not smooth, there are no cells: every pixel is solved, with its derivatives.
//
// All lengths are in pixels, except those of `Stroke` and `Axis`.
#pragma once
#include <math.h>

#include <algorithm>
#include <array>
#include <functional>
#include <limits>
#include <memory>
#include <vector>

#include "patch.hpp"
#include "solvers.hpp"
#include "table.hpp"
#include "threads.hpp"

namespace supple {

constexpr int ROOT = 32;          // pixels along the side of a root cell
constexpr int SMALL = 4;          // a side of up to as many pixels is split into single ones at once,
constexpr int BESIDE_FROZEN = 2;  // also beside frozen samples, where many cells are small
constexpr int BAND = 4;           // rows of roots that are solved in order, each from the one before
constexpr int STRIDE = 48;        // pixels of a row of a root, and padding for whole vectors

// A grid of `size` samples, `step` pixels apart, the first at `offset`: the pixels themselves, or chroma.
struct Grid {
    int step[2] = {1, 1};
    double offset[2] = {0, 0};
    int size[2];
    // The first sample at or after a pixel.
    int from(int axis, int pixel) const {
        if (step[axis] == 1 && offset[axis] == 0) return std::min(pixel, size[axis]);
        int i = (int)ceil((pixel - offset[axis]) / step[axis]);
        return std::clamp(i, 0, size[axis]);
    }
};

typedef std::array<int, 4> Box;  // x0, x1, y0, y1

// The source points of samples of a row, as whole numbers and fractions, in samples; and the columns of ∂p/∂q.
template <int D>
struct Row {
    alignas(64) int whole[D][STRIDE];
    float part[D][STRIDE];
    float across[2][STRIDE], down[2][STRIDE];  // ∂p/∂x, ∂p/∂y in the plane
    float depth2[STRIDE];                      // |∂p_z/∂q|², in a stack
    bool same[STRIDE];                         // true outside the balls of all strokes, and where it is frozen
    bool some_same, idle;                      // whether any is the same; whether all are, so that nothing else is set
    bool sloped, averaged;                     // whether the derivatives in the plane are set; and depth2
    int count;                                 // the number of samples of its root
};

// Which rows get derivatives: none, those of roots where the map may shrink, or all.
enum class Slopes { NONE, SHRINKING, ALL };

// Bounds of source points: of each coordinate; of the distance to q; of |∂p/∂x|² + |∂p/∂y|² in the plane; of |∂p_z/∂q|;
// and of the largest eigenvalue of MMᵀ in the plane.
template <int D>
struct Extent {
    double low[D], high[D], moved = 0, spread = 2, rate = 1, widest = 1, largest = 1;
    Extent() {
        std::fill(low, low + D, 1e300);
        std::fill(high, high + D, -1e300);
    }
    Extent& operator|=(const Extent& o) {
        for (int d = 0; d < D; d++) {
            low[d] = std::min(low[d], o.low[d]);
            high[d] = std::max(high[d], o.high[d]);
        }
        moved = std::max(moved, o.moved);
        spread = std::max(spread, o.spread);
        rate = std::max(rate, o.rate);
        widest = std::max(widest, o.widest);
        largest = std::max(largest, o.largest);
        return *this;
    }
};

// The results of a map's checks.
struct Checks {
    double error = 0;        // a bound on the distance of a source point to T⁻¹(q), with a reserve
    double evaluations = 0;  // evaluations of T with its Jacobian
    long unsolved = 0, folds = 0;
    long outside = 0;   // points beyond the grids of a composite's fields
    double widest = 1;  // a bound of max(λ₋, λ₊/400) of MMᵀ: it determines the depth of a pyramid
    Checks& operator|=(const Checks& o) {
        error = std::max(error, o.error);
        evaluations += o.evaluations;
        unsolved += o.unsolved;
        folds += o.folds;
        outside += o.outside;
        widest = std::max(widest, o.widest);
        return *this;
    }
};

template <int D>
class Plan : public Checks {
public:
    // A plan of strokes, or of a composite map; for all of the plane, or at least the rows and columns of a box (x0,
    // x1, y0, y1). `masks` has the freezes between the strokes; `chroma` says whether samples lie between pixels.
    Plan(Strokes strokes, int width, int height, double z, double tolerance, const Composite* map = nullptr,
         const Box* box = nullptr, const Frozen* masks = nullptr, bool chroma = false);

    const int width, height;
    const double z, tolerance;
    const bool chroma;
    const Composite* const map;  // or null; it must live as long
    Box box;
    bool identity = true;

    int roots_down() const { return down; }
    bool is_still(int root) const {
        const Root& r = roots[root];
        return r.held ? under->is_still(root) : r.leaves == 0 && r.first_pixel < 0;
    }
    // Call use(row, x, y, n, at) for the samples of a row of roots in [x0, x1) × [y0, y1): samples x to x + n - 1 of
    // row y are those from `at` on in `row`.
    typedef std::function<void(const Row<D>& row, int x, int y, int n, int at)> Use;
    void each_row(const Grid& grid, int root_row, const int (&box)[4], Slopes slopes, const Use& use) const;
    // Bounds of the source points of a root, or of all.
    Extent<D> extent(int root) const;
    Extent<D> extent() const;
    // The memory of what is solved, in bytes.
    size_t nbytes() const {
        size_t sum = under ? under->nbytes() : 0;
        for (const Band& b : bands)
            sum += b.leaves.size() * sizeof(Leaf<D>) + b.pixels.size() * sizeof(Pixel) + sizeof(Extent<D>) * across;
        return sum;
    }
    int roots_across() const { return across; }
    // The samples `from` to `to` - 1 of a grid that lie in a column of roots, or in a row of them.
    void part_of(const Grid& grid, int axis, int i, int& from, int& to) const {
        from = i == 0 ? 0 : grid.from(axis, i * ROOT);
        to = i == (axis ? down : across) - 1 ? grid.size[axis] : grid.from(axis, (i + 1) * ROOT);
    }
    // The largest distance to T⁻¹(q), measured at every pixel; and the number of pixels where it could not be measured.
    Checks measure(double finest) const;

private:
    struct Cell {
        int root, x0, y0, x1, y1;
        int corner[4];
    };
    struct Ask {  // a node to solve, and guesses
        double q[2], p[D], m[D][D];
        int node, root;
    };
    struct Checked {  // the patch of a cell, checked
        double c[D][16], across_plane[D];
        double step[5][D];  // Newton steps from the patch to T⁻¹(q), at the centres of the cell and of its sides
        bool too_wide, too_high;
    };
    struct Root {
        int band = 0, first = -1, leaves = 0;
        ptrdiff_t first_pixel = -1;  // index among the band's pixels, if every pixel is solved
        bool rim = false;            // some of its pixels may lie outside every ball, or be frozen
        bool held = false;           // a freeze holds all of it: the map is that of the strokes before
        float largest = 1;           // `largest` of its extent
    };
    struct Pixel {
        float part[D], across[2], down[2], depth2;  // relative to the anchor of its root
    };
    struct Band : Checks {
        std::vector<Pixel> pixels;
        std::vector<std::array<int, D>> anchors;  // for each root of the band, row by row
        std::vector<Extent<D>> extents;
        std::vector<Leaf<D>> leaves;
        std::vector<int> next;  // the next leaf of the same root
        Extent<D> extent;       // of a plane in a stack, which determines its frames
    };
    struct Work {  // the scratch data of a band
        Band* band;
        std::vector<Node<D>> nodes;
        std::vector<Cell> cells, split;
        std::vector<Ask> asks;
        std::vector<int> list;         // the strokes that reach some roots, one root for each lane
        std::vector<uint8_t> reached;  // for each stroke of the list, the lanes whose roots it reaches
    };

    int column(int i) const { return i < across ? i * ROOT : last[0]; }
    int line(int j) const { return j < down ? j * ROOT : last[1]; }
    int past(int axis, int pixel) const { return pixel == last[axis] ? size[axis] : pixel; }
    template <class RootOf>
    Chain chain_of(Work& w, RootOf root_of) const;
    void find_reaching(int root_row, int left, int right);
    void thaw(int root);
    void keep_state(const Frozen* masks);
    void solve_band(int index);
    void solve_pixels(int root);
    void solve(Work& w, Guess guess);
    void check(Work& w);
    void split(Work& w, const Cell& cell, const Checked& found);
    void emit(Work& w, int root, int x, int y, int width, int height, const double (*c)[16], const float* depth);
    NOINLINE void fill(const Leaf<D>& leaf, const Grid& grid, int y, int from, int to, int left,
                       Row<D>& __restrict row) const;
    void widen(const Leaf<D>& leaf, Extent<D>& e) const;
    bool mark(int index, const Grid& grid, int x, int y, int n, Row<D>& row) const;
    void same(Row<D>& row, int i, int x, int y) const;
    bool fill_root(const Grid& grid, int index, int left, int right, int y, Slopes slopes, Row<D>& row) const;
    void restore(int index, const Grid& grid, int x, int y, int n, Row<D>& row) const;
    void fill_pixels(const Root& root, int index, int y, int n, Row<D>& row) const;
    double reserve() const { return map || freeze ? ROUGH : RESERVE; }

    const Strokes all;
    const std::vector<Stroke>& strokes = all.table;
    const Axes& axes = all.axes;
    std::vector<Bound> bounds;          // bounds of each stroke
    const Frozen* freeze;               // the mask, if it concerns any stroke
    const Frozen* hold = nullptr;       // the mask of the last freeze between strokes, if it holds any of the box
    int held_rows = 0;                  // the number of rows before that,
    std::unique_ptr<const Plan> under;  // and their plan, where it holds
    int size[2], last[2], across, down;
    size_t words;
    int first_limited = 0;           // the end of the first group with a reach: balls are mapped back no further
    std::vector<uint64_t> reaching;  // for each root, a set of strokes
    std::vector<Root> roots;
    std::vector<Band> bands;
};

extern template class Plan<2>;
extern template class Plan<3>;

}  // namespace supple
