// Python bindings of sampled fields and composite maps: points, inverses and folds.
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "bindings.hpp"
#include "folds.hpp"

namespace supple {
namespace {

// Read a matrix; the last column of an affine map in n dimensions, the translation, goes to to[i][3].
void fill_matrix(const Doubles& rows, int n, double (*to)[4]) {
    for (int i = 0; i < (int)rows.shape(0); i++)
        for (int j = 0; j < (int)rows.shape(1); j++) to[i][j < n ? j : 3] = rows(i, j);
}

// Whether a field is so smooth, and its samples so far apart, that cells of several pixels may interpolate it.
bool is_smooth(const Sampled& k, const Axis* axes, int ndim) {
    double per_pixel = 0;  // indices
    for (int i = 0; i < ndim; i++)
        for (int j = 0; j < ndim; j++) per_pixel = std::max(per_pixel, fabs(k.to_index[i][j]) * axes[j].spacing);
    return k.order == 3 && per_pixel <= 0.25;
}

constexpr double ROUNDING = 0x1p-48;  // the relative rounding error of numbers that a part computes

// A bound of a part's rounding error, from the magnitudes of its numbers.
template <int D>
double rounding_of(const Part& part, const Axis* axes) {
    double size = 0;
    for (int d = 0; d < D; d++) {
        size += fabs(axes[d].first) + fabs(axes[d].last);
        if (part.kind == AFFINE) size += fabs(part.there[d][3]) + fabs(part.back[d][3]);
        for (int j = 0; part.kind == FIELD && j < D; j++)
            size += fabs(part.field.to_place[d][j] * part.field.to_index[j][3]);
    }
    return ROUNDING * size * (1 + (part.kind == STROKES ? part.chain.count : 0) / 16.0);
}

// Map points by one part after the other. The error of a solved part, G(x) = y, is bounded by four times the next
// Newton step, (∂G/∂x)⁻¹ (G(x) - y), as in `invert_row`; later parts magnify it by the norms of their Jacobians. Each
// part adds its rounding error.
template <int D>
Passed<Lanes> pass_with_error(const Composite& map, bool backwards, const double* rounding,
                              Jet<D, D, false, Lanes>& jet, Lanes& error) {
    const Mask all = Mask{} == 0;
    Passed<Lanes> passed{all, all, all, Lanes{}};
    error = Lanes{};
    for (int n = 0; n < map.count; n++) {
        const int which = backwards ? map.count - 1 - n : n;
        Composite one = map;
        one.parts += which;
        one.count = 1;
        auto own = jet_at<D, D>(jet.x);
        const Passed<Lanes> through = pass<D>(one, backwards, own);
        passed.done = both(passed.done, through.done);
        passed.within = both(passed.within, through.within);
        passed.upright = both(passed.upright, through.upright);
        passed.steps += through.steps;
        Lanes norm2{}, off[D], size{};
        for (int d = 0; d < D; d++) {
            size += magnitude(jet.x[d]) + magnitude(own.x[d]);
            for (int j = 0; j < D; j++) norm2 += own.t[j][d] * own.t[j][d];
        }
        const Lanes norm = root(norm2);
        error *= norm;
        if (one.parts->kind != AFFINE && one.parts->inverted != backwards) {
            auto again = jet_at<D, 0>(own.x);
            pass<D>(one, !backwards, again);
            for (int d = 0; d < D; d++) off[d] = again.x[d] - jet.x[d];
            transform<D>(own.t, off);
            error += 4.0 * root(dot<D>(off, off));
        }
        error += (1.0 + norm) * (rounding[which] + ROUNDING * size);
        for (int d = 0; d < D; d++) jet.x[d] = own.x[d];
    }
    return passed;
}

// Map points (N, 3) by a composite. Return the points, their derivatives or None, and the evaluations; write the status
// of each point and, if `errors` is given, a bound of its error.
nb::object through(const Composed& map, const Triples& points, bool backwards, bool jacobian, Array<uint8_t, -1> status,
                   std::optional<Array<double, -1>> errors) {
    const size_t count = points.shape(0);
    auto *moved = new std::vector<double>(points.data(), points.data() + 3 * count),
         *steps = new std::vector<double>(count), *matrices = new std::vector<double>(jacobian ? 9 * count : 0);
    nb::object first = owned(moved, {count, 3}), second = owned(matrices, {matrices->size() / 9, 3, 3}),
               third = owned(steps, {count});
    const double* from = points.data();
    auto run = [&]<int D>() {
        std::vector<double> rounding;
        for (int n = 0; errors && n < map.count; n++) rounding.push_back(rounding_of<D>(map.parts[n], map.axes));
        each_batch(count, [&](size_t start, int n) {
            Lanes x[D], error{};
            for (int d = 0; d < D; d++)
                for (int l = 0; l < LANES; l++) x[d][l] = from[3 * (start + std::min(l, n - 1)) + d];
            auto jet = jet_at<D, D>(x);
            const Passed<Lanes> passed =
                errors ? pass_with_error<D>(map, backwards, rounding.data(), jet, error) : pass<D>(map, backwards, jet);
            for (int l = 0; l < n; l++) {
                const size_t at = start + l;
                if (errors) errors->data()[at] = passed.done[l] ? error[l] : std::numeric_limits<double>::infinity();
                for (int d = 0; d < D; d++) {
                    (*moved)[3 * at + d] = jet.x[d][l];
                    for (int j = 0; jacobian && j < D; j++) (*matrices)[9 * at + 3 * d + j] = jet.t[j][d][l];
                }
                (*steps)[at] = passed.steps[l];
                status.data()[at] = (passed.done[l] ? 0 : 4) | (passed.within[l] ? 0 : 2) | (passed.upright[l] ? 0 : 1);
            }
        });
    };
    unlocked([&] { map.ndim == 2 ? run.template operator()<2>() : run.template operator()<3>(); });
    return nb::make_tuple(first, jacobian ? second : nb::none(), third);
}

// ---- inverses -------------------------------------------------------------------------------------------------------

enum Status : uint8_t { OK, FOLDED, OUTSIDE, UNCONVERGED };

struct Inversion {
    const Sampled& field;
    double grid[3][4];  // from an index of the result to one of the field
    double back[3][4];
    int size[3];
    double tolerance;
    void* values;
    bool wide;
    float* error;
    uint8_t* status;
};

// In samples. A short step proves nothing where slopes jump, or the field folds: iterate until it is this short;
constexpr double CONVERGED = 1e-8, IN_CELLS = 1e-6;  // within a cell of a linear field, it is a proof

// Guesses of i - target along a row, from the two rows before it, or from the samples before. [component][x]
struct Guesses {
    int stride, rows = 0;
    std::vector<double> off, slope;  // those of the row before, and their change from the row before that

    Guesses(int width, int ndim) : stride(width + LANES), off((size_t)stride * ndim), slope((size_t)stride * ndim) {}
};

// Solve a row of the result.
template <int D>
void invert_row(const Inversion& job, int y, int z, Guesses& guesses) {
    const Sampled& k = job.field;
    const size_t start = ((size_t)z * job.size[1] + y) * job.size[0];
    double near[D] = {}, stretch = 0;  // a bound of the distance in space per unit of the index
    for (int a = 0; a < D; a++)
        for (int b = 0; b < D; b++) stretch += k.to_place[a][b] * k.to_place[a][b];
    stretch = sqrt(stretch);
    for (int x = 0; x < job.size[0]; x += LANES) {
        Lanes target[D], q[3] = {{}, splat<Lanes>(y), splat<Lanes>(z)};
        Undone<D, Lanes> found{};
        const int n = std::min(LANES, job.size[0] - x);
        for (int l = 0; l < LANES; l++) q[0][l] = x + std::min(l, n - 1);
        for (int a = 0; a < D; a++) {
            target[a] = splat<Lanes>(job.grid[a][3]);
            for (int b = 0; b < D; b++) target[a] += job.grid[a][b] * q[b];
            const size_t at = (size_t)a * guesses.stride + x;
            found.i[a] = target[a] +
                         (guesses.rows ? loaded(&guesses.off[at]) + loaded(&guesses.slope[at]) : splat<Lanes>(near[a]));
        }
        undo_field_surely<D, true, Lanes>(k, target, std::min(0.125 * job.tolerance, CONVERGED),
                                          std::min(0.125 * job.tolerance, IN_CELLS), found);
        Lanes off[D], place[D];
        for (int a = 0; a < D; a++) off[a] = found.i[a] - target[a];
        const Mask all = Mask{} == 0;
        Mask in = on_grid<D>(k, found.i);
        if (k.zero) {
            Mask same = without(without(all, in), on_grid<D>(k, target));
            for (int a = 0; a < D; a++) off[a] = choose(same, Lanes{}, off[a]);
            found.step2 = choose(same, Lanes{}, found.step2);
            found.determinant = choose(same, splat<Lanes>(1.0), found.determinant);
            found.done = either(found.done, same);
            in = either(in, same);
        }
        for (int a = 0; a < D; a++) {
            place[a] = Lanes{};
            for (int b = 0; b < D; b++) place[a] += k.to_place[a][b] * off[b];
        }
        // The distance to the solution, and the rounding of the result: in space, and in samples.
        Lanes lost[D], space2{}, samples2{};
        typedef float Kept __attribute__((vector_size(sizeof(float) * LANES)));
        Lanes kept[D];
        for (int a = 0; a < D; a++) {
            kept[a] = job.wide ? place[a] : __builtin_convertvector(__builtin_convertvector(place[a], Kept), Lanes);
            lost[a] = kept[a] - place[a];
            space2 += lost[a] * lost[a];
        }
        for (int a = 0; a < D; a++) {
            Lanes v{};
            for (int b = 0; b < D; b++) v += k.to_index[a][b] * lost[b];
            samples2 += v * v;
        }
        const Lanes left = 4.0 * root(found.step2), error = left * stretch + root(space2);
        const Mask exact = both(found.done, left + root(samples2) <= job.tolerance), upright = found.determinant > 0.0;
        for (int a = 0; a < D; a++) {
            const size_t at = (size_t)a * guesses.stride + x;
            Lanes now = choose(found.done, off[a], Lanes{}), slope{};
            if (guesses.rows) slope = choose(found.done, now - loaded(&guesses.off[at]), Lanes{});
            memcpy(&guesses.off[at], &now, sizeof now);
            memcpy(&guesses.slope[at], &slope, sizeof slope);
            near[a] = now[n - 1];
        }
        for (int l = 0; l < n; l++) {
            const size_t at = start + x + l;
            for (int a = 0; a < D; a++)
                job.wide ? ((double*)job.values)[at * D + a] = kept[a][l]
                         : ((float*)job.values)[at * D + a] = (float)kept[a][l];
            job.error[at] = found.done[l] ? (float)error[l] * (1 + 1e-6f) : std::numeric_limits<float>::infinity();
            uint8_t known = !exact[l] ? UNCONVERGED : !upright[l] ? FOLDED : !in[l] ? OUTSIDE : OK;
            if (known != OK && (job.status[at] != FOLDED || known == UNCONVERGED)) job.status[at] = known;
        }
    }
}

// Mark the samples that folded cells may be mapped to, counting the continuation of the field beyond its ends: two
// preimages imply a third, folded one.
template <int D, int N>
void mark_folds(const Inversion& job) {
    const Sampled& k = job.field;
    // Call f for the samples of a spot, until it returns false. Threads that meet at a sample write the same.
    auto each_of = [&](const Spot<D>& s, auto f) {
        for (int z = D == 3 ? s.low[D - 1] : 0; z < (D == 3 ? s.high[D - 1] : 1); z++)
            for (int y = s.low[1]; y < s.high[1]; y++) {
                uint8_t* row = job.status + ((size_t)z * job.size[1] + y) * job.size[0];
                for (uint8_t* at = row + s.low[0]; at < row + s.high[0]; at++)
                    if (!f(at)) return false;
            }
        return true;
    };
    auto all = [&](const Spot<D>& s) {
        return each_of(s, [](const uint8_t* at) { return __atomic_load_n(at, __ATOMIC_RELAXED) == FOLDED; });
    };
    auto mark = [&](const Spot<D>& s) {
        each_of(s, [](uint8_t* at) { return __atomic_store_n(at, (uint8_t)FOLDED, __ATOMIC_RELAXED), true; });
    };
    each_bad_cell<D, N>(k, true, [&](const int* at, const Patch<D, N>& p, bool turned) {
        bool low[D], high[D];
        for (int d = 0; d < D; d++) {
            low[d] = at[d] < k.first[d];
            high[d] = at[d] >= k.last[d];
        }
        Folds<D, N, decltype(all), decltype(mark)>(job.back, job.size, all, mark).find(p, turned, low, high);
    });
}

template <int D>
void invert_all(const Inversion& job) {
    job.field.order == 1 ? mark_folds<D, 2>(job) : mark_folds<D, 4>(job);
    constexpr int BLOCK = 32;  // rows that are solved in order, each with guesses from the one before
    const int down = (job.size[1] + BLOCK - 1) / BLOCK;
    parallel(down * job.size[2], [&](int item, int) {
        Guesses guesses(job.size[0], D);
        const int z = item / down, first = item % down * BLOCK;
        for (int y = first; y < std::min(first + BLOCK, job.size[1]); y++, guesses.rows++)
            invert_row<D>(job, y, z, guesses);
    });
}

void invert_field(const Field& field, const Doubles& grid, const Doubles& back, double tolerance, Result values,
                  nb::ndarray<float, nb::c_contig, nb::device::cpu> error,
                  nb::ndarray<uint8_t, nb::c_contig, nb::device::cpu> status) {
    const int n = field.ndim;
    const bool wide = values.dtype() == nb::dtype<double>();
    Inversion job{field, {}, {}, {1, 1, 1}, tolerance, values.data(), wide, error.data(), status.data()};
    fill_matrix(grid, n, job.grid);
    fill_matrix(back, n, job.back);
    for (int d = 0; d < n; d++) job.size[d] = (int)values.shape(n - 1 - d);
    unlocked([&] { n == 2 ? invert_all<2>(job) : invert_all<3>(job); });
}

// Set the cells of a field (size - 1 along each axis) in which it may fold to 1: those in which the determinant is not
// proved to be above 0 after all cuts.
template <int D, int N>
void find_cells(const Sampled& k, uint8_t* cells, const int* shape) {
    each_bad_cell<D, N>(k, false, [&](const int* at, const Patch<D, N>& p, bool turned) {
        auto bad = [](auto&& self, const Patch<D, N>& p, int cuts) -> bool {  // for a part that is not proved upright
            if (cuts == CUTS + 1 || turned_at_corner(p)) return true;
            const Halves<D, N> halves(p);
            for (int which = 0; which < 1 << D; which++) {
                const Patch<D, N> part = halves.part(which);
                if (sign_of(part) <= 0 && self(self, part, cuts + 1)) return true;
            }
            return false;
        };
        if (!turned && !bad(bad, p, 0)) return;
        size_t index = 0;
        for (int d = D - 1; d >= 0; d--) index = index * shape[d] + (at[d] - (int)k.first[d]);
        cells[index] = 1;
    });
}

void folded_cells(const Field& k, nb::ndarray<uint8_t, nb::c_contig, nb::device::cpu> cells) {
    int shape[3] = {1, 1, 1};
    for (int d = 0; d < k.ndim; d++) shape[d] = (int)cells.shape(k.ndim - 1 - d);
    unlocked([&] {
        auto run = k.ndim == 2 ? (k.order == 1 ? find_cells<2, 2> : find_cells<2, 4>)
                               : (k.order == 1 ? find_cells<3, 2> : find_cells<3, 4>);
        run(k, cells.data(), shape);
    });
}

}  // namespace

void bind_fields(nb::module_& m) {
    nb::class_<Field>(m, "Sampled", "A displacement field that is sampled on a grid.")
        .def(
            "__init__",
            [](Field* self, Given values, int order, std::vector<double> first, std::vector<double> last, double margin,
               bool zero, const Doubles& to_index, const Doubles& to_place, const Doubles& vectors) {
                const int n = (int)values.ndim() - 1;
                Field& k = *new (self) Field{{}, n, values};
                k.values = values.data();
                k.wide = values.dtype() == nb::dtype<double>();
                k.order = order;
                for (int d = 0; d < 3; d++) {
                    k.size[d] = d < n ? (int)values.shape(n - 1 - d) : 1;
                    k.first[d] = d < n ? first[d] : 0;
                    k.last[d] = d < n ? last[d] : 0;
                }
                k.zero = zero;
                k.margin = margin;
                double matrix[3][4];
                fill_matrix(to_index, n, k.to_index);
                fill_matrix(to_place, n, k.to_place);
                for (int i = 0; i < n; i++)
                    for (int j = 0; j < n; j++) k.to_place[i][3] -= k.to_place[i][j] * k.to_index[j][3];
                fill_matrix(vectors, n, matrix);
                k.diagonal = true;
                for (int i = 0; i < n; i++)
                    for (int j = 0; j < n; j++) {
                        k.vectors[i][j] = matrix[i][j];
                        k.diagonal = k.diagonal && (i == j || matrix[i][j] == 0);
                    }
            },
            "values"_a, "order"_a, "first"_a, "last"_a, "margin"_a, "zero"_a, "to_index"_a, "to_place"_a, "vectors"_a)
        .def("folded_cells", &folded_cells, "cells"_a.noconvert(), "Mark the cells in which it may fold.")
        .def("invert", &invert_field, "grid"_a, "back"_a, "tolerance"_a, "values"_a.noconvert(), "error"_a.noconvert(),
             "status"_a.noconvert(), "Write the inverse displacement of every sample of a grid, its error and status.");
    nb::class_<Composed>(m, "Composite", "Strokes, affine maps and sampled fields, one after the other.")
        .def(
            "__init__",
            [](Composed* self, int ndim, const AxisRows& rows, nb::list parts, nb::object freeze) {
                Composed map{{nullptr, (int)parts.size(), true, {}}, ndim, {}, {}, {freeze}};
                const Frozen* mask = nb::cast<std::optional<const Frozen*>>(freeze).value_or(nullptr);
                const Axes axes = load_axes(rows.data());
                std::copy(axes.begin(), axes.end(), map.axes);
                for (nb::handle h : parts) {
                    nb::tuple item = nb::cast<nb::tuple>(h);
                    std::string kind = nb::cast<std::string>(item[0]);
                    Part part{};
                    part.inverted = nb::cast<bool>(item[2]);
                    if (kind == "field") {
                        part.kind = FIELD;
                        part.field = nb::cast<const Field&>(item[1]);
                        map.smooth = map.smooth && is_smooth(part.field, map.axes, ndim);
                        map.kept.push_back(nb::borrow(item[1]));
                    } else if (kind == "affine") {
                        part.kind = AFFINE;
                        nb::tuple both = nb::cast<nb::tuple>(item[1]);
                        const Doubles there = nb::cast<Doubles>(both[0]), back = nb::cast<Doubles>(both[1]);
                        part.projective = ndim == 2 && there.shape(0) == 3;
                        fill_matrix(there, ndim, part.there);
                        fill_matrix(back, ndim, part.back);
                    } else {
                        part.kind = STROKES;
                        map.strokes.push_back(strokes_of(nb::cast<Rows>(item[1]), rows, mask));
                        part.chain = map.strokes.back().chain();
                    }
                    map.held.push_back(part);
                }
                map.parts = map.held.data();
                new (self) Composed(std::move(map));
            },
            "ndim"_a, "axes"_a, "parts"_a, "freeze"_a.none() = nb::none())
        .def("through", &through, "points"_a, "backwards"_a, "jacobian"_a, "status"_a.noconvert(),
             "errors"_a.noconvert() = nb::none(),
             "Return points (N, 3) mapped by T or T⁻¹, the derivatives or None, and the evaluations; status: 1 folded, "
             "2 outside, 4 unsolved. Without derivatives, a bound on the distance of each to where it belongs is "
             "written to errors.");
}

}  // namespace supple
