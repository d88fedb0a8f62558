// Python bindings of plans and of sampling.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <atomic>
#include <optional>
#include <variant>

#include "composites.hpp"

namespace supple {
namespace {

typedef nb::ndarray<nb::ro, nb::c_contig, nb::device::cpu> Source;
typedef nb::ndarray<nb::c_contig, nb::device::cpu> Target;
typedef Array<const float, -1, -1, -1, 4> Fields;
// The motion between frames: displacements, the longest of each pair, the position of the first, and their distance.
typedef std::tuple<Fields, std::vector<float>, double, double, double> Displacements;

int type_of(nb::dlpack::dtype d) {
    const nb::dlpack::dtype known[] = {nb::dtype<uint8_t>(), nb::dtype<uint16_t>(), nb::dtype<int16_t>(),
                                       nb::dtype<float>(),   nb::dtype<double>(),   nb::dtype<int8_t>(),
                                       nb::dtype<int32_t>(), nb::dtype<uint32_t>(), nb::dtype<int64_t>(),
                                       nb::dtype<uint64_t>()};
    for (int i = 0; i < 10; i++)
        if (d == known[i]) return i;
    throw nb::type_error("samples must be integers, or floats of 32 or 64 bits");
}

// A job, and the arrays that it reads and writes.
struct Sampling {
    Source frames;
    Target out;  // (h, w, C); or (planes, h, w, C)
    std::optional<Fields> fields;
    std::vector<double> fill;
    std::vector<float> longest;
    Job job{};
    bool partial;

    // With a corner (x, y, k), `frames` has the part of larger frames from the sample (x, y) of frame k on.
    Sampling(Source frames, Target out, int count, std::tuple<int, int> step, std::tuple<double, double> offset,
             int filter, int between, int rule, bool average, std::vector<double> fill_, int alpha, bool light,
             double white, std::optional<std::tuple<int, int, int>> corner, std::optional<std::tuple<int, int>> size,
             std::optional<Displacements> motion)
        : frames(frames), out(out), fill(std::move(fill_)), partial(corner.has_value()) {
        if (frames.ndim() != 4 || out.ndim() < 3 || out.ndim() > 4)
            throw nb::value_error("frames must be (slots, h, w, C), out (h, w, C)");
        job.type = type_of(frames.dtype());
        size_t height = out.shape(out.ndim() - 3), width = out.shape(out.ndim() - 2);
        job.channels = (int)frames.shape(3);
        if (type_of(out.dtype()) != job.type || out.shape(out.ndim() - 1) != frames.shape(3) ||
            (int)fill.size() != job.channels || alpha >= job.channels)
            throw nb::value_error("out must have the frames' type and channels, and fill a value for each");
        job.frame_bytes = (ptrdiff_t)(frames.shape(1) * frames.shape(2) * frames.shape(3) * frames.itemsize());
        job.count = count;
        job.capacity = (int)frames.shape(0);
        const int h = (int)frames.shape(1), w = (int)frames.shape(2);
        auto [x0, y0, from] = corner.value_or(std::tuple(0, 0, 0));
        std::tie(job.h, job.w) = size.value_or(std::tuple(h, w));
        if (x0 < 0 || y0 < 0 || from < 0 || x0 + w > job.w || y0 + h > job.h ||
            (partial && from + job.capacity > count))
            throw nb::value_error("frames must lie within frames of that size");
        const int held[4] = {x0, x0 + w, y0, y0 + h};
        std::copy(held, held + 4, job.held);
        job.held_from = from;
        job.frames = (const char*)frames.data() - ((ptrdiff_t)y0 * w + x0) * job.pixel_bytes();
        job.out = (char*)out.data();
        job.grid.step[0] = std::get<0>(step);
        job.grid.step[1] = std::get<1>(step);
        job.grid.offset[0] = std::get<0>(offset);
        job.grid.offset[1] = std::get<1>(offset);
        job.grid.size[0] = (int)width;
        job.grid.size[1] = (int)height;
        job.box[1] = (int)width;
        job.box[3] = (int)height;
        job.out_row = (ptrdiff_t)width;
        job.filter = filter;
        job.between = between;
        job.rule = rule;
        job.average = average;
        job.fill = fill.data();
        job.alpha = alpha;
        job.light = light;
        job.white = white;
        if (!motion) return;
        double x, y, apart;
        std::tie(fields, longest, x, y, apart) = *motion;
        const int down = (int)fields->shape(1), across = (int)fields->shape(2);
        if (longest.size() != fields->shape(0) || longest.empty() || down < 2 || across < 2 || !(apart > 0) || partial)
            throw nb::value_error("motion needs whole frames, and fields of at least 2 x 2 displacements");
        job.motion = {fields->data(), longest.data(), (int)longest.size(), across, down, {x, y}, apart};
    }
    Sampling(const Sampling&) = delete;
};

// Whether no sample is NaN or infinite: only these have all bits of the exponent set.
template <class Bits>
bool all_finite(const Bits* samples, size_t count, Bits exponent) {
    constexpr size_t some = 1 << 15;
    std::atomic<bool> all{true};
    parallel((int)((count + some - 1) / some), [&](int item, int) {
        Bits odd = 0;
        for (size_t i = item * some; i < std::min((item + 1) * some, count); i++)
            odd |= (samples[i] & exponent) == exponent;
        if (odd) all = false;
    });
    return all;
}
bool finite(Source samples) {
    const int type = type_of(samples.dtype());
    return unlocked([&] {
        return type == F32   ? all_finite((const uint32_t*)samples.data(), samples.size(), 0x7F800000u)
               : type == F64 ? all_finite((const uint64_t*)samples.data(), samples.size(), (uint64_t)0x7FF << 52)
                             : true;
    });
}

// Whether the part of the frames in memory has all samples that a plan reads.
template <int D>
bool suffices(const Plan<D>& plan, const Sampling& s, const Job& job) {
    return !s.partial || held_of(job).holds(needed(plan, job));
}
void refuse_small() { throw nb::value_error("the samples read lie beyond the part of the frames that is held"); }

// Check the size of a job's output: that of the part of the grid, or of the whole grid; or, for strokes, of the frames.
void check_size(const Job& job, bool composite, bool part, const Box& box, int width, int height) {
    const int w = job.grid.size[0], h = job.grid.size[1];
    bool fits = part        ? w == box[1] - box[0] && h == box[3] - box[2]
                : composite ? w == width && h == height
                            : w == job.w && h == job.h;
    if (part && !composite) fits = fits && job.w == width && job.h == height;
    if (!fits) throw nb::value_error("out must have the size of the part of the grid, or of the frames");
}

// The job for a part of a plan's grid: `out` begins at the corner of the part.
Job placed(Job job, const Box& box, int width, int height) {
    job.grid.size[0] = width;
    job.grid.size[1] = height;
    std::copy(box.begin(), box.end(), job.box);
    job.corner[0] = box[0];
    job.corner[1] = box[2];
    return job;
}

Box checked_box(const std::optional<std::tuple<int, int, int, int>>& box, int width, int height) {
    if (!box) return {0, width, 0, height};
    auto [x0, x1, y0, y1] = *box;
    if (x0 < 0 || y0 < 0 || x0 >= x1 || y0 >= y1 || x1 > width || y1 > height)
        throw nb::value_error("the box must lie in the plane");
    return {x0, x1, y0, y1};
}

std::shared_ptr<const Composite> held(const std::optional<const AnyComposite*>& map) {
    return map && *map ? (*map)->held : nullptr;
}

struct AnyPlan {
    std::variant<Plan<2>, Plan<3>> plan;

    template <class F>
    auto with(F f) const {
        return std::visit(f, plan);
    }
    Checks checks() const {
        return with([](const Checks& plan) { return plan; });
    }
};

template <int D>
nb::tuple extent_of(const Plan<D>& plan) {
    Extent<D> e = unlocked([&] { return plan.extent(); });
    nb::list low, high;
    for (int d = 0; d < D; d++) {
        low.append(e.low[d]);
        high.append(e.high[d]);
    }
    return nb::make_tuple(nb::tuple(low), nb::tuple(high), e.moved, e.rate);
}

template <class T, int D>
void points_of(const Plan<D>& plan, Solid<T>& out) {
    const int x0 = plan.box[0], x1 = plan.box[1], y0 = plan.box[2], y1 = plan.box[3];
    if ((int)out.shape(0) != y1 - y0 || (int)out.shape(1) != x1 - x0 || out.shape(2) != D)
        throw nb::value_error("points must have the plane's shape, or that of its part");
    T* to = out.data();
    Grid grid;
    grid.size[0] = plan.width;
    grid.size[1] = plan.height;
    auto write = [&](const Row<D>& row, int x, int y, int n, int at) {
        T* p = to + ((ptrdiff_t)(y - y0) * (x1 - x0) + x - x0) * D;
        for (int i = 0; i < n; i++, p += D) {
            const double own[3] = {(double)(x + i), (double)y, plan.z};
            for (int d = 0; d < D; d++)
                p[d] = (T)(row.idle ? own[d] : row.whole[d][at + i] + (double)row.part[d][at + i]);
        }
    };
    unlocked([&] {
        parallel(plan.roots_down(), [&](int j, int) { plan.each_row(grid, j, {x0, x1, y0, y1}, Slopes::NONE, write); });
    });
}

// Sample planes of a stack, each by one thread. Returns the accuracy of the map, and the evaluations.
nb::tuple warp_stack(const Doubles& table, const AxisRows& rows, int height, int width, std::vector<int> planes,
                     double tolerance, nb::list samplings, std::optional<const AnyComposite*> map,
                     std::optional<std::tuple<int, int, int, int>> wanted, std::optional<std::vector<bool>> copied,
                     Masking freeze) {
    if (copied && copied->size() != planes.size()) throw nb::value_error("copied must have a value for each plane");
    const Box box = checked_box(wanted, width, height);
    const std::shared_ptr<const Composite> composite = held(map);
    const Strokes strokes = strokes_of(table, rows, freeze);
    std::vector<const Sampling*> all;
    for (nb::handle h : samplings) all.push_back(nb::cast<const Sampling*>(h));
    for (const Sampling* s : all)
        if (s->out.ndim() != 4 || s->out.shape(0) != planes.size())
            throw nb::value_error("out must have an image for each plane");
    for (const Sampling* s : all) check_size(s->job, composite != nullptr, wanted.has_value(), box, width, height);
    std::vector<Checks> checks(planes.size());
    std::atomic<bool> small = false;
    unlocked([&] {
        parallel((int)planes.size(), [&](int i, int) {
            Plan<3> plan(strokes, width, height, planes[i], tolerance, composite, &box, freeze.value_or(nullptr));
            checks[i] = plan;
            // A plane is copied if no displacement in all of it exceeds the tolerance; then a part of it is, too.
            auto unmoved = [&](const Plan<3>& p) { return p.identity || p.extent().moved * sqrt(3.0) <= tolerance; };
            bool still = !composite && (copied ? (*copied)[i] : unmoved(plan));
            if (!copied && still && !plan.identity && wanted && box != Box{0, width, 0, height})
                still = unmoved(
                    Plan<3>(strokes, width, height, planes[i], tolerance, nullptr, nullptr, freeze.value_or(nullptr)));
            for (const Sampling* s : all) {
                Job job = s->job;
                const size_t row = (size_t)job.grid.size[0] * job.pixel_bytes();
                const int height_out = job.grid.size[1];
                job.out += i * row * height_out;
                if (wanted) job = placed(job, box, width, height);
                if (!suffices(plan, *s, job))
                    small = true;
                else if (!still)
                    sample_plane(plan, job);
                else
                    for (int y = 0; y < height_out; y++)
                        memcpy(job.out + y * row, job.sample(job.frame(planes[i]), box[0], box[2] + y), row);
            }
        });
    });
    if (small) refuse_small();
    Checks all_checks;
    for (const Checks& c : checks) all_checks |= c;
    return nb::make_tuple(all_checks.error, all_checks.evaluations,
                          nb::make_tuple(all_checks.folds, all_checks.outside, all_checks.unsolved));
}

// The part of the frames that a box of planes reads, and how far each plane moves there.
nb::tuple needed_of(const Doubles& table, const AxisRows& rows, int ndim, int height, int width,
                    std::vector<int> planes, double tolerance, int count, std::tuple<int, int> size, int filter,
                    int between, int rule, bool average, std::optional<const AnyComposite*> map,
                    std::tuple<int, int, int, int> wanted, Masking freeze) {
    Job job{};
    std::tie(job.h, job.w) = size;
    job.count = count;
    job.filter = filter;
    job.between = between;
    job.rule = rule;
    job.average = average;
    const Box box = checked_box(wanted, width, height);
    job = placed(job, box, width, height);
    const std::shared_ptr<const Composite> composite = held(map);
    const Strokes strokes = strokes_of(table, rows, freeze);
    std::vector<Portion> parts(planes.size());
    std::vector<double> moved(planes.size());
    std::vector<Checks> checks(planes.size());
    auto look = [&]<int D>(int i) {
        Plan<D> plan(strokes, width, height, planes[i], tolerance, composite, &box, freeze.value_or(nullptr));
        parts[i] = needed(plan, job);
        moved[i] = plan.identity ? -1 : plan.extent().moved;
        checks[i] = plan;
    };
    unlocked([&] {
        parallel((int)planes.size(),
                 [&](int i, int) { ndim == 2 ? look.template operator()<2>(i) : look.template operator()<3>(i); });
    });
    Portion all;
    for (const Portion& part : parts) all |= part;
    Checks sum;
    for (const Checks& c : checks) sum |= c;
    return nb::make_tuple(nb::make_tuple(all.box[0], all.box[1], all.box[2], all.box[3], all.frames[0], all.frames[1]),
                          moved, sum.error, nb::make_tuple(sum.unsolved, sum.folds, sum.outside));
}

}  // namespace

void bind_plans(nb::module_& m) {
    nb::class_<Sampling>(m, "Sampling", "What is sampled, how, and into what.")
        .def(nb::init<Source, Target, int, std::tuple<int, int>, std::tuple<double, double>, int, int, int, bool,
                      std::vector<double>, int, bool, double, std::optional<std::tuple<int, int, int>>,
                      std::optional<std::tuple<int, int>>, std::optional<Displacements>>(),
             "frames"_a, "out"_a, "count"_a, "step"_a, "offset"_a, "filter"_a, "between"_a, "rule"_a, "average"_a,
             "fill"_a, "alpha"_a, "light"_a, "white"_a, "corner"_a = nb::none(), "size"_a = nb::none(),
             "motion"_a = nb::none());
    nb::class_<AnyPlan>(m, "Plan", "T⁻¹ on one plane, ready to be filled in.")
        .def(
            "__init__",
            [](AnyPlan* self, const Doubles& table, const AxisRows& rows, int ndim, int height, int width, double z,
               double tolerance, std::optional<const AnyComposite*> map,
               std::optional<std::tuple<int, int, int, int>> wanted, Masking freeze) {
                const Strokes strokes = strokes_of(table, rows, freeze);
                if (height < 1 || width < 1) throw nb::value_error("a plane has at least one pixel");
                if (map && *map && (*map)->ndim != ndim) throw nb::value_error("the map has another number of axes");
                const Box box = checked_box(wanted, width, height);
                auto make = [&](auto which) {
                    new (self) AnyPlan{std::variant<Plan<2>, Plan<3>>(which, strokes, width, height, z, tolerance,
                                                                      held(map), &box, freeze.value_or(nullptr))};
                };
                unlocked([&] { ndim == 2 ? make(std::in_place_index<0>) : make(std::in_place_index<1>); });
            },
            "strokes"_a, "axes"_a, "ndim"_a, "height"_a, "width"_a, "z"_a, "tolerance"_a, "map"_a = nb::none(),
            "box"_a = nb::none(), "freeze"_a = nb::none(), nb::keep_alive<1, 11>())
        .def_prop_ro("error", [](const AnyPlan& p) { return p.checks().error; })
        .def_prop_ro("evaluations", [](const AnyPlan& p) { return p.checks().evaluations; })
        .def_prop_ro("unsolved", [](const AnyPlan& p) { return p.checks().unsolved; })
        .def_prop_ro("folds", [](const AnyPlan& p) { return p.checks().folds; })
        .def_prop_ro("outside", [](const AnyPlan& p) { return p.checks().outside; })
        .def_prop_ro("identity", [](const AnyPlan& p) { return p.with([](auto& plan) { return plan.identity; }); })
        .def_prop_ro("nbytes", [](const AnyPlan& p) { return p.with([](auto& plan) { return plan.nbytes(); }); })
        .def(
            "extent", [](const AnyPlan& p) { return p.with([](auto& plan) { return extent_of(plan); }); },
            "Return the least and the largest coordinates of source points, how far any is from q, and the largest "
            "|∂p_z/∂q|.")
        .def(
            "points", [](const AnyPlan& p, Solid<float> out) { p.with([&](auto& plan) { points_of(plan, out); }); },
            nb::arg("out").noconvert(),
            "Write the source point of every pixel of the plane, or of its part: (h, w, D), in float32 or float64.")
        .def(
            "points", [](const AnyPlan& p, Solid<double> out) { p.with([&](auto& plan) { points_of(plan, out); }); },
            nb::arg("out").noconvert())
        .def(
            "measure",
            [](const AnyPlan& p, double finest) {
                const Checks found = unlocked([&] { return p.with([&](auto& plan) { return plan.measure(finest); }); });
                return nb::make_tuple(found.error, found.unsolved);
            },
            "finest"_a,
            "Return the largest distance of a source point to the true T⁻¹(q), and of how many it is not known.")
        .def(
            "sample",
            [](const AnyPlan& p, const Sampling& s, std::optional<std::tuple<int, int, int, int>> box) {
                Job job = s.job;
                p.with([&](auto& plan) {
                    const bool part = plan.box != Box{0, plan.width, 0, plan.height};
                    check_size(job, plan.map != nullptr, part, plan.box, plan.width, plan.height);
                    if (part) job = placed(job, plan.box, plan.width, plan.height);
                });
                if (box) {
                    auto [x0, x1, y0, y1] = *box;
                    if (x0 < 0 || y0 < 0 || x1 > job.grid.size[0] || y1 > job.grid.size[1])
                        throw nb::value_error("the box must lie in the plane");
                    job.box[0] = x0, job.box[1] = x1, job.box[2] = y0, job.box[3] = y1;
                }
                p.with([&](auto& plan) {
                    if (!suffices(plan, s, job)) refuse_small();
                    unlocked([&] { sample_plane(plan, job); });
                });
            },
            "sampling"_a, "box"_a = nb::none(),
            "Fill what a box (x0, x1, y0, y1) holds of a sampling's output, or all of it.");
    m.def("finite", &finite, "samples"_a.noconvert(), "Return whether no sample is NaN or infinite.");
    m.def("warp_stack", &warp_stack, "strokes"_a, "axes"_a, "height"_a, "width"_a, "planes"_a, "tolerance"_a,
          "samplings"_a, "map"_a = nb::none(), "box"_a = nb::none(), "copied"_a = nb::none(), "freeze"_a = nb::none(),
          "Sample planes of a stack, each by one thread; return the largest error, the evaluations, and how many nodes "
          "or pixels fold, lie outside, and are not solved. `copied` says which planes are copied, if it is known.");
    m.def("needed", &needed_of, "strokes"_a, "axes"_a, "ndim"_a, "height"_a, "width"_a, "planes"_a, "tolerance"_a,
          "count"_a, "size"_a, "filter"_a, "between"_a, "rule"_a, "average"_a, "map"_a, "box"_a,
          "freeze"_a = nb::none(),
          "Return the part (x0, x1, y0, y1, k0, k1) of `count` frames of a size (h, w) that a box of planes reads, and "
          "how far each plane's part moves (-1 for the identity), the largest error, and how many nodes or pixels are "
          "not solved, fold, and lie outside.");
}

}  // namespace supple
