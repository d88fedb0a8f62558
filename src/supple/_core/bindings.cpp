// The Python module of the core, and its functions of points.
#include "bindings.hpp"

#include "paper.hpp"

namespace supple {
namespace {

bool python_interrupts() {
    if (!ending.try_enter()) return false;
    nb::gil_scoped_acquire acquire;
    ending.entered();
    return PyErr_CheckSignals() != 0;
}

nb::object forward(const Rows& rows, const AxisRows& axes, const Triples& points, bool jacobian, const Frozen* freeze) {
    const Strokes strokes = strokes_of(rows, axes, freeze);
    const size_t count = points.shape(0);
    auto *moved = new std::vector<double>(count * 3), *matrices = new std::vector<double>(jacobian ? count * 9 : 0);
    nb::object first = owned(moved, {count, 3}), second = owned(matrices, {matrices->size() / 9, 3, 3});
    const double* from = points.data();
    auto run = [&]<int TANGENTS>() {
        each_batch(count, [&](size_t start, int n) {
            Lanes x[3];
            for (int l = 0; l < LANES; l++)
                for (int d = 0; d < 3; d++) x[d][l] = from[3 * (start + std::min(l, n - 1)) + d];
            auto jet = jet_at<3, TANGENTS>(x);
            carry(strokes.chain(), strokes.axes.data(), jet);
            for (int l = 0; l < n; l++)
                for (int d = 0; d < 3; d++) {
                    (*moved)[3 * (start + l) + d] = jet.x[d][l];
                    for (int e = 0; e < TANGENTS; e++) (*matrices)[9 * (start + l) + 3 * d + e] = jet.t[e][d][l];
                }
        });
    };
    unlocked([&] { jacobian ? run.template operator()<3>() : run.template operator()<0>(); });
    return nb::make_tuple(first, jacobian ? second : nb::none());
}

nb::object inverse(const Mapping& map, const Triples& targets, double tolerance) {
    const Chain chain = map.strokes.chain();
    const Axis* axes = map.strokes.axes.data();
    const size_t count = targets.shape(0);
    auto *points = new std::vector<double>(targets.data(), targets.data() + 3 * count),
         *residual = new std::vector<double>(count), *steps = new std::vector<double>(count);
    nb::object made = nb::make_tuple(owned(points, {count, 3}), owned(residual, {count}), owned(steps, {count}));
    const double* from = targets.data();
    auto run = [&]<int D>() {
        each_batch(count, [&](size_t start, int n) {
            Lanes q[D], x[D], e2{};
            for (int l = 0; l < LANES; l++)
                for (int d = 0; d < D; d++) q[d][l] = from[3 * (start + std::min(l, n - 1)) + d];
            Solution<D, Lanes> found;
            undo<D>(chain, axes, q, tolerance, found);
            // The residual is measured again, at the returned point.
            for (int d = 0; d < D; d++) x[d] = found.p[d];
            apply<D>(chain, axes, x);
            for (int d = 0; d < D; d++) e2 += (x[d] - q[d]) * (x[d] - q[d]);
            Lanes r = root(e2);
            for (int l = 0; l < n; l++) {
                for (int d = 0; d < D; d++) (*points)[3 * (start + l) + d] = found.p[d][l];
                (*residual)[start + l] = r[l];
                (*steps)[start + l] = found.steps[l];
            }
        });
    };
    unlocked([&] { map.ndim == 2 ? run.template operator()<2>() : run.template operator()<3>(); });
    return made;
}

void published(const Rows& table, const AxisRows& rows, double z, int every, double mu, double tolerance, int limit,
               bool corrected, Solid<float> points, Array<int64_t, -1, -1> counts, Array<double, -1, -1> residual) {
    const Strokes strokes = strokes_of(table, rows, nullptr);
    const Axes& axes = strokes.axes;
    const Published how{mu, tolerance, limit, corrected};
    const size_t height = points.shape(0), width = points.shape(1), ndim = points.shape(2);
    auto invert = [&]<int D>(int y) {
        for (size_t x = 0, at = y * width; x < width; x++, at++) {
            double p[3] = {x * every * axes[0].spacing, y * every * axes[1].spacing, z * axes[2].spacing};
            int count;
            residual.data()[at] = invert_as_published<D>(strokes, how, p, count);
            counts.data()[at] = count;
            for (int d = 0; d < D; d++) points.data()[D * at + d] = (float)(p[d] / axes[d].spacing);
        }
    };
    unlocked([&] {
        parallel((int)height,
                 [&](int y, int) { ndim == 2 ? invert.template operator()<2>(y) : invert.template operator()<3>(y); });
    });
}

}  // namespace

void make_frozen(Frozen* self, const Solid<const float>& values, std::array<double, 3> first,
                 std::array<double, 3> step) {
    const int shape[3] = {(int)values.shape(0), (int)values.shape(1), (int)values.shape(2)};
    new (self) Frozen(values.data(), shape, first.data(), step.data());
}

// m at points (N, 3), and its gradient.
nb::object freedom(const Frozen& mask, const Triples& points) {
    const size_t count = points.shape(0);
    auto *values = new std::vector<double>(count), *slopes = new std::vector<double>(3 * count);
    nb::object made = nb::make_tuple(owned(values, {count}), owned(slopes, {count, 3}));
    for (size_t i = 0; i < count; i++) {
        const Freed<3, 1, double> found = freed<3, 1, double>(mask, points.data() + 3 * i);
        (*values)[i] = found.m;
        for (int d = 0; d < 3; d++) (*slopes)[3 * i + d] = found.slope[d];
    }
    return made;
}

void bind_points(nb::module_& m) {
    nb::class_<Frozen>(m, "Freeze", "A freeze mask: the B-spline m, a factor of all strokes' displacement.")
        .def("__init__", &make_frozen, "values"_a, "first"_a, "step"_a)
        .def(
            "stand_for",
            [](Frozen& self, nb::list masks, nb::list freezes) {
                for (nb::handle mask : masks)
                    self.masks.push_back(nb::cast<std::optional<const Frozen*>>(mask).value_or(nullptr));
                for (nb::handle freeze : freezes) {
                    const auto [row, number] = nb::cast<std::pair<int, int>>(freeze);
                    self.freezes.push_back({row, self.masks.at(number)});
                }
            },
            "masks"_a, "freezes"_a,
            "Stand for several masks, by their numbers in the rows of strokes; they have to live as long. Of freezes "
            "between rows: the row before which each stands, and the number of its mask.")
        .def("freedom", &freedom, "points"_a, "Return m of points (N, 3), in physical units, and its gradient.");
    nb::class_<Mapping>(m, "Map", "Strokes and their axes, or a composite of them and other maps.")
        .def(
            "__init__",
            [](Mapping* self, const Rows& rows, const AxisRows& axes, int ndim, const Frozen* freeze,
               const Composed* composite) {
                new (self) Mapping{strokes_of(rows, axes, freeze), ndim, freeze, composite};
            },
            "strokes"_a, "axes"_a, "ndim"_a, "freeze"_a.none() = nb::none(), "composite"_a.none() = nb::none(),
            nb::keep_alive<1, 5>(), nb::keep_alive<1, 6>());
    m.def("forward", &forward, "strokes"_a, "axes"_a, "points"_a, "jacobian"_a, "freeze"_a.none() = nb::none(),
          "Return T of points (N, 3), in physical units, and ∂T/∂p (N, 3, 3) or None.");
    m.def("inverse", &inverse, "map"_a, "targets"_a, "tolerance"_a,
          "Return T⁻¹ of points (N, 3) for strokes alone, the residuals |T(p) - q| and the evaluations of T, in "
          "physical units.");
    m.def("invert_as_published", &published, "strokes"_a, "axes"_a, "z"_a, "every"_a, "mu"_a, "tolerance"_a, "limit"_a,
          "corrected"_a, "points"_a.noconvert(), "counts"_a.noconvert(), "residual"_a.noconvert(),
          "Invert every pixel by the published method.");
}

}  // namespace supple

NB_MODULE(SUPPLE_MODULE, m) {
    nb::set_leak_warnings(false);  // a forked child exits while objects of its parent's threads are alive
    supple::interrupted = supple::python_interrupts;
    nb::register_exception_translator([](const std::exception_ptr& p, void*) {
        try {
            std::rethrow_exception(p);
        } catch (const supple::Interrupted&) {
        }  // Python's exception is set already
    });
    supple::after_fork([] { supple::ending.forked(); });
    nb::module_::import_("atexit").attr("register")(nb::cpp_function([] { supple::ending.begin(); }));
    m.def("threads", &supple::threads, "Return how many threads work at once.");
    supple::bind_points(m);
    supple::bind_plans(m);
    supple::bind_margin(m);
    supple::bind_fields(m);
    supple::bind_flat(m);
    supple::bind_render(m);
}
