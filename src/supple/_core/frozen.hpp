// A freeze mask with the cells where it is constant, and bounds of its derivatives in boxes.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "freeze.hpp"

namespace supple {

// Bounds of a function and of its first to third derivatives.
typedef std::array<double, 4> Derivatives;

// Bounds of the derivatives of m up to the third, `along` of them along z. Derivatives along z are apart from those
// along x and y, as z is time in a clip, with another step.
struct MaskBounds {
    float all[10];  // by order
    float& of(int across, int along) { return all[(across + along) * (across + along + 1) / 2 + along]; }
    double of(int across, int along) const { return const_cast<MaskBounds*>(this)->of(across, along); }
    double most() const { return all[0]; }
    double slope() const { return std::hypot((double)all[1], (double)all[2]); }
    bool is_level() const { return all[1] == 0 && all[2] == 0; }
};

// Replace 255 by the distance to the nearest 0 of a grid (the largest of those along the axes), or leave it if that is
// more: by one sweep from either end, each from finished neighbours.
inline void to_distances(const int* n, uint8_t* out) {
    const int64_t total = (int64_t)n[0] * n[1] * n[2];
    for (int way : {1, -1})
        for (int64_t i = 0; i < total; i++) {
            const int64_t at = way > 0 ? i : total - 1 - i;
            const int a = int(at % n[0]), b = int(at / n[0] % n[1]), c = int(at / n[0] / n[1]);
            for (int other = 0; other < 13 && out[at] > 1; other++) {  // the 13 of 27 that are earlier in memory
                const int x = a + way * (other % 3 - 1), y = b + way * (other / 3 % 3 - 1),
                          z = c + way * (other / 9 - 1);
                if (x < 0 || x >= n[0] || y < 0 || y >= n[1] || z < 0 || z >= n[2]) continue;
                out[at] = (uint8_t)std::min<int>(out[at], out[((int64_t)z * n[1] + y) * n[0] + x] + 1);
            }
        }
}

class Frozen : public Freeze {
public:
    // From coefficients (nz, ny, nx), from 0 to 1. The outermost four along an axis of several are equal.
    Frozen(const float* from, const int* shape, const double* first, const double* step) {
        const size_t count = (size_t)shape[0] * shape[1] * shape[2];
        held.assign(from, from + count);
        values = held.data();
        for (int i = 0; i < 3; i++) {
            size[i] = shape[2 - i];
            this->first[i] = first[i];
            per_step[i] = 1 / step[i];
        }
        levels.emplace_back();
        levels[0].bounds.resize(count);
        distances.assign(count, 255);
        std::copy(size, size + 3, levels[0].size);
        std::fill(low, low + 3, std::numeric_limits<double>::infinity());
        std::fill(high, high + 3, -std::numeric_limits<double>::infinity());
        const int* n = size;
        for (int z = 0; z < n[2]; z++)
            for (int y = 0; y < n[1]; y++)
                for (int x = 0; x < n[0]; x++) {
                    const MaskBounds found = bounds_of(x, y, z);
                    levels[0].of(x, y, z) = found;
                    if (!found.is_level()) distances[((size_t)z * n[1] + y) * n[0] + x] = 0;
                    if (found.most() == 0) enclose({x, y, z});
                }
        to_distances(n, distances.data());
        calm = distances.data();
        while (levels.back().bounds.size() > 1) halve();
    }
    Frozen(const Frozen&) = delete;

    std::vector<const Frozen*> masks;  // if it stands for several: the common one or null, then those with numbers
    // Freezes between strokes, in order: the row before which each stands, and its mask, or null.
    std::vector<std::pair<int, const Frozen*>> freezes;
    double low[3], high[3];  // a box around all that is frozen, which may be empty

    // Bounds of m and its derivatives in a box.
    MaskBounds bounds_in(const double* low, const double* high) const {
        int from[3], to[3], level = 0;
        double part;
        for (int i = 0; i < 3; i++) {
            from[i] = cell_of(*this, i, low[i], part);
            to[i] = cell_of(*this, i, high[i], part);
            while ((to[i] >> level) - (from[i] >> level) > 2) level++;
        }
        const Level& known = levels[level];
        MaskBounds found{};
        for (int z = from[2] >> level; z <= to[2] >> level; z++)
            for (int y = from[1] >> level; y <= to[1] >> level; y++)
                for (int x = from[0] >> level; x <= to[0] >> level; x++) raise(found, known.of(x, y, z));
        return found;
    }
    // Vectors whose hull contains ∇m at all points of a box, and their number; 0 if the box is in several cells.
    //
    // A polynomial is in the hull of its Bézier points, which here have one degree for all components of the vector.
    int gradients_in(const double* low, const double* high, double (*found)[3]) const {
        double w[2][3][4][4] = {};  // for values, and for derivatives
        int from[3] = {}, n[3];
        for (int i = 0; i < 3; i++) {
            n[i] = size[i] > 1 ? 4 : 1;
            if (n[i] == 1) {
                w[0][i][0][0] = 1;
                continue;
            }
            double a, b;
            const int cell = cell_of(*this, i, low[i], a), last = cell_of(*this, i, high[i], b);
            if (last != cell && !(last == cell + 1 && b < 1e-9)) return 0;
            from[i] = cell - 1;
            bezier_weights(a, b + (last - cell), per_step[i], w[0][i], w[1][i]);
        }
        const int end = n[2] > 1 ? 64 : n[1] > 1 ? 16 : 4;
        int count = 0;
        for (int d = 0; d < 3; d++) {  // the coefficients around, axis by axis
            double c[64] = {};
            for (int k = 0; k < n[2]; k++)
                for (int j = 0; j < n[1]; j++)
                    for (int i = 0; i < n[0]; i++)
                        c[16 * k + 4 * j + i] =
                            values[((int64_t)(from[2] + k) * size[1] + from[1] + j) * size[0] + from[0] + i];
            for (int axis = 0; axis < 3; axis++) {
                if (n[axis] == 1 && d != axis) continue;
                const int stride = 1 << 2 * axis;
                const auto& u = w[d == axis][axis];
                for (int m = 0; m < end; m++) {
                    if (m >> 2 * axis & 3) continue;  // lines along the axis begin elsewhere
                    double* line = c + m;
                    const double own[4] = {line[0], line[stride], line[2 * stride], line[3 * stride]};
                    for (int p = 0; p < 4; p++) {
                        line[p * stride] = 0;
                        for (int i = 0; i < 4; i++) line[p * stride] += u[p][i] * own[i];
                    }
                }
            }
            count = 0;
            for (int r = 0; r < n[2]; r++)
                for (int q = 0; q < n[1]; q++)
                    for (int p = 0; p < n[0]; p++) found[count++][d] = c[16 * r + 4 * q + p];
        }
        return count;
    }
    // The knot nearest to a coordinate; the coordinate itself along an axis without knots.
    double knot(int axis, double x) const {
        if (size[axis] == 1) return x;
        return first[axis] + std::round((x - first[axis]) * per_step[axis]) / per_step[axis];
    }
    // True if m = 1 in a box.
    bool is_free(const double* low, const double* high) const {
        const MaskBounds found = bounds_in(low, high);
        return found.is_level() && found.most() == 1;
    }
    // True if m = 0 in a box.
    bool is_frozen(const double* low, const double* high) const { return bounds_in(low, high).most() == 0; }

private:
    struct Level {  // the largest bounds of blocks of cells
        int size[3];
        std::vector<MaskBounds> bounds;
        MaskBounds& of(int x, int y, int z) { return bounds[((size_t)z * size[1] + y) * size[0] + x]; }
        const MaskBounds& of(int x, int y, int z) const { return bounds[((size_t)z * size[1] + y) * size[0] + x]; }
    };

    // The weights of the coefficients around a cell in the Bézier points of a part [a, b] of it, and in those of its
    // derivative, raised to the same degree.
    static void bezier_weights(double a, double b, double per_step, double (*w)[4], double (*dw)[4]) {
        for (int c = 0; c < 4; c++)
            for (int p = 0; p < 4; p++) {  // the blossom at (a, a, a), (a, a, b), (a, b, b) and (b, b, b)
                const double t[3] = {p > 2 ? b : a, p > 1 ? b : a, p > 0 ? b : a};
                double d[4] = {};
                d[c] = 1;
                for (int j = 0; j < 3; j++) d[j] = ((j + 1 - t[0]) * d[j] + (t[0] - j + 2) * d[j + 1]) / 3;
                for (int j = 0; j < 2; j++) d[j] = ((j + 1 - t[1]) * d[j] + (t[1] - j + 1) * d[j + 1]) / 2;
                w[p][c] = (1 - t[2]) * d[0] + t[2] * d[1];
            }
        if (!(b - a > 1e-9)) {  // a single point: use the slope of the whole cell there
            double weights[3][4];
            spline_weights<4>(a, weights);
            for (int p = 0; p < 4; p++)
                for (int c = 0; c < 4; c++) dw[p][c] = per_step * weights[1][c];
            return;
        }
        const double scale = 3 * per_step / (b - a);
        for (int c = 0; c < 4; c++) {
            double d[3];
            for (int p = 0; p < 3; p++) d[p] = scale * (w[p + 1][c] - w[p][c]);
            dw[0][c] = d[0];
            dw[1][c] = (d[0] + 2 * d[1]) / 3;
            dw[2][c] = (2 * d[1] + d[2]) / 3;
            dw[3][c] = d[2];
        }
    }

    // Add a cell to the frozen box; beyond the outermost cells, m is constant.
    void enclose(const std::array<int, 3>& cell) {
        for (int i = 0; i < 3; i++) {
            const double from = first[i] + cell[i] / per_step[i], far = std::numeric_limits<double>::infinity();
            low[i] = std::min(low[i], cell[i] > 1 ? from : -far);
            high[i] = std::max(high[i], cell[i] < size[i] - 3 ? from + 1 / per_step[i] : far);
        }
    }

    static void raise(MaskBounds& a, const MaskBounds& b) {
        for (int i = 0; i < 10; i++) a.all[i] = std::max(a.all[i], b.all[i]);
    }

    // The bounds in a cell: a derivative of a spline is the spline, one degree lower, of the differences of its
    // coefficients, and at most the largest of those around.
    MaskBounds bounds_of(int x, int y, int z) const {
        const int at[3] = {x, y, z};
        int count[3], from[3];
        for (int i = 0; i < 3; i++) {
            count[i] = size[i] > 1 ? 4 : 1;
            from[i] = size[i] > 1 ? at[i] - 1 : 0;
        }
        double c[4][4][4] = {};
        double lowest = 1, highest = 0;
        for (int k = 0; k < count[2]; k++)
            for (int j = 0; j < count[1]; j++)
                for (int i = 0; i < count[0]; i++) {
                    // Cells beside the outermost coefficients are not asked for.
                    const int a = std::clamp(from[0] + i, 0, size[0] - 1);
                    const int b = std::clamp(from[1] + j, 0, size[1] - 1);
                    const int d = std::clamp(from[2] + k, 0, size[2] - 1);
                    const double v = values[((size_t)d * size[1] + b) * size[0] + a];
                    c[k][j][i] = v;
                    lowest = std::min(lowest, v);
                    highest = std::max(highest, v);
                }
        MaskBounds found{{(float)highest}};
        if (lowest == highest) return found;
        static constexpr int WAYS[4] = {1, 1, 2, 6};
        double sums[4][4] = {};  // by the orders across and along
        for (int p = 0; p < count[0]; p++) {
            if (p) subtract(c, 1, count[0] - p);
            double d[4][4][4];
            std::copy(c[0][0], c[0][0] + 64, d[0][0]);
            for (int q = 0; q + p < 4 && q < count[1]; q++) {
                if (q) subtract(d, 4, count[1] - q);
                double e[4][4][4];
                std::copy(d[0][0], d[0][0] + 64, e[0][0]);
                for (int r = 0; r + q + p < 4 && r < count[2]; r++) {
                    if (r) subtract(e, 16, count[2] - r);
                    double largest = 0;
                    for (int k = 0; k < count[2] - r; k++)
                        for (int j = 0; j < count[1] - q; j++)
                            for (int i = 0; i < count[0] - p; i++) largest = std::max(largest, std::abs(e[k][j][i]));
                    largest *= std::pow(per_step[0], p) * std::pow(per_step[1], q) * std::pow(per_step[2], r);
                    // Times its multiplicity among all derivatives of its order.
                    sums[p + q][r] += WAYS[p + q] / (WAYS[p] * WAYS[q]) * largest * largest;
                }
            }
        }
        for (int p = 0; p < 4; p++)
            for (int r = p == 0; p + r < 4; r++) found.of(p, r) = (float)(std::sqrt(sums[p][r]) * (1 + 1e-7));
        found.of(1, 0) = std::max(found.of(1, 0), 1e-37f);
        return found;
    }
    // Replace `left` coefficients by their differences along an axis with a stride.
    static void subtract(double (*c)[4][4], int stride, int left) {
        double* at = c[0][0];
        for (int i = 0; i < 64; i++)
            if (i / stride % 4 < left) at[i] = at[i + stride] - at[i];
    }

    void halve() {
        const Level& fine = levels.back();
        Level coarse;
        size_t count = 1;
        for (int i = 0; i < 3; i++) count *= coarse.size[i] = (fine.size[i] + 1) / 2;
        coarse.bounds.resize(count);
        for (int z = 0; z < fine.size[2]; z++)
            for (int y = 0; y < fine.size[1]; y++)
                for (int x = 0; x < fine.size[0]; x++) raise(coarse.of(x / 2, y / 2, z / 2), fine.of(x, y, z));
        levels.push_back(std::move(coarse));
    }

    std::vector<float> held;
    std::vector<uint8_t> distances;
    std::vector<Level> levels;
};

}  // namespace supple
