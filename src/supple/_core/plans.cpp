// Python bindings of plans and of sampling.
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <atomic>
#include <optional>
#include <variant>

#include "bindings.hpp"

namespace supple {
namespace {

typedef Array<const float, -1, -1, -1, 4> Fields;
// The motion between frames: displacements, the longest of each pair, the position of the first, and their distance.
typedef std::tuple<Fields, std::vector<float>, double, double, double> Displacements;
typedef std::tuple<int, int, int, bool>
    Codes;  // the filter, that between frames, the boundary mode, averages over time

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
    Given frames;  // (slots, h, w, C)
    Result out;    // (h, w, C); or (planes, h, w, C)
    std::optional<Fields> fields;
    std::vector<double> fill;
    std::vector<float> longest;
    Job job{};
    bool partial;

    // With a corner (x, y, k), `frames` has the part of larger frames from the sample (x, y) of frame k on.
    Sampling(Given frames, Result out, int count, std::tuple<int, int> step, std::tuple<double, double> offset,
             Codes codes, std::vector<double> fill_, int alpha, bool light, double white,
             std::optional<std::tuple<int, int, int>> corner, std::optional<std::tuple<int, int>> size,
             std::optional<Displacements> motion)
        : frames(frames), out(out), fill(std::move(fill_)), partial(corner.has_value()) {
        job.type = type_of(frames.dtype());
        size_t height = out.shape(out.ndim() - 3), width = out.shape(out.ndim() - 2);
        job.channels = (int)frames.shape(3);
        job.frame_bytes = (ptrdiff_t)(frames.shape(1) * frames.shape(2) * frames.shape(3) * frames.itemsize());
        job.count = count;
        job.capacity = (int)frames.shape(0);
        const int h = (int)frames.shape(1), w = (int)frames.shape(2);
        auto [x0, y0, from] = corner.value_or(std::tuple(0, 0, 0));
        std::tie(job.h, job.w) = size.value_or(std::tuple(h, w));
        const int held[4] = {x0, x0 + w, y0, y0 + h};
        std::copy(held, held + 4, job.held);
        job.held_from = from;
        job.frames = (const char*)frames.data() - ((ptrdiff_t)y0 * w + x0) * job.pixel_bytes();
        job.out = (char*)out.data();
        std::tie(job.grid.step[0], job.grid.step[1]) = step;
        std::tie(job.grid.offset[0], job.grid.offset[1]) = offset;
        job.grid.size[0] = (int)width;
        job.grid.size[1] = (int)height;
        job.box[1] = (int)width;
        job.box[3] = (int)height;
        job.out_row = (ptrdiff_t)width;
        std::tie(job.filter, job.between, job.rule, job.average) = codes;
        job.fill = fill.data();
        job.alpha = alpha;
        job.light = light;
        job.white = white;
        if (!motion) return;
        double x, y, apart;
        std::tie(fields, longest, x, y, apart) = *motion;
        const int down = (int)fields->shape(1), across = (int)fields->shape(2);
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
bool finite(Given samples) {
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

// The job for a part of a plan's grid: `out` begins at the corner of the part.
Job placed(Job job, const Box& box, int width, int height) {
    job.grid.size[0] = width;
    job.grid.size[1] = height;
    std::copy(box.begin(), box.end(), job.box);
    job.corner[0] = box[0];
    job.corner[1] = box[2];
    return job;
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
        throw nb::value_error("points must have the shape of the plane, or of its part");
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

// The values of `Checks` in __init__.pyi.
typedef std::tuple<double, double, long, long, long> Values;
Values values_of(const std::vector<Checks>& some) {
    Checks sum;
    for (const Checks& c : some) sum |= c;
    return {sum.error, sum.evaluations, sum.unsolved, sum.folds, sum.outside};
}

// Sample planes of a stack, each by one thread. Returns the accuracy of the map.
Values warp_stack(const Mapping& map, int height, int width, std::vector<int> planes, double tolerance,
                  std::vector<const Sampling*> all, std::optional<Box> wanted,
                  std::optional<std::vector<bool>> copied) {
    const Box box = wanted.value_or(Box{0, width, 0, height});
    std::vector<Checks> checks(planes.size());
    std::atomic<bool> small = false;
    bool chroma = false;
    for (const Sampling* s : all) chroma |= s->job.grid.step[0] > 1 || s->job.grid.step[1] > 1;
    unlocked([&] {
        parallel((int)planes.size(), [&](int i, int) {
            Plan<3> plan(map.strokes, width, height, planes[i], tolerance, map.composite, &box, map.freeze, chroma);
            checks[i] = plan;
            // A plane is copied if no displacement in all of it exceeds the tolerance; then a part of it is, too.
            auto unmoved = [&](const Plan<3>& p) { return p.identity || p.extent().moved * sqrt(3.0) <= tolerance; };
            bool still = !map.composite && (copied ? (*copied)[i] : unmoved(plan));
            if (!copied && still && !plan.identity && wanted && box != Box{0, width, 0, height})
                still =
                    unmoved(Plan<3>(map.strokes, width, height, planes[i], tolerance, nullptr, nullptr, map.freeze));
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
    return values_of(checks);
}

// The part of the frames that a box of planes reads, and how far each plane moves there.
nb::tuple needed_of(const Mapping& map, int height, int width, std::vector<int> planes, double tolerance, int count,
                    std::tuple<int, int> size, Codes codes, Box box) {
    Job job{};
    std::tie(job.h, job.w) = size;
    job.count = count;
    std::tie(job.filter, job.between, job.rule, job.average) = codes;
    job = placed(job, box, width, height);
    std::vector<Portion> parts(planes.size());
    std::vector<double> moved(planes.size());
    std::vector<Checks> checks(planes.size());
    auto look = [&]<int D>(int i) {
        Plan<D> plan(map.strokes, width, height, planes[i], tolerance, map.composite, &box, map.freeze);
        parts[i] = needed(plan, job);
        moved[i] = plan.identity ? -1 : plan.extent().moved;
        checks[i] = plan;
    };
    unlocked([&] {
        parallel((int)planes.size(),
                 [&](int i, int) { map.ndim == 2 ? look.template operator()<2>(i) : look.template operator()<3>(i); });
    });
    Portion all;
    for (const Portion& part : parts) all |= part;
    return nb::make_tuple(nb::make_tuple(all.box[0], all.box[1], all.box[2], all.box[3], all.frames[0], all.frames[1]),
                          moved, values_of(checks));
}

}  // namespace

void bind_plans(nb::module_& m) {
    nb::class_<Sampling>(m, "Sampling", "What is sampled, how, and into what.")
        .def(nb::init<Given, Result, int, std::tuple<int, int>, std::tuple<double, double>, Codes, std::vector<double>,
                      int, bool, double, std::optional<std::tuple<int, int, int>>, std::optional<std::tuple<int, int>>,
                      std::optional<Displacements>>(),
             "frames"_a, "out"_a, "count"_a, "step"_a, "offset"_a, "codes"_a, "fill"_a, "alpha"_a, "light"_a, "white"_a,
             "corner"_a = nb::none(), "size"_a = nb::none(), "motion"_a = nb::none());
    nb::class_<AnyPlan>(m, "Plan", "T⁻¹ on one plane, ready to be filled in.")
        .def(
            "__init__",
            [](AnyPlan* self, const Mapping& map, int height, int width, double z, double tolerance,
               std::optional<Box> box, bool chroma) {
                auto make = [&](auto which) {
                    new (self) AnyPlan{std::variant<Plan<2>, Plan<3>>(which, map.strokes, width, height, z, tolerance,
                                                                      map.composite, box ? &*box : nullptr, map.freeze,
                                                                      chroma)};
                };
                unlocked([&] { map.ndim == 2 ? make(std::in_place_index<0>) : make(std::in_place_index<1>); });
            },
            "map"_a, "height"_a, "width"_a, "z"_a, "tolerance"_a, "box"_a = nb::none(), "chroma"_a = false,
            nb::keep_alive<1, 2>())
        .def_prop_ro("checks", [](const AnyPlan& p) { return values_of({p.checks()}); })
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
            [](const AnyPlan& p, const Sampling& s, std::optional<Box> box) {
                p.with([&](auto& plan) {
                    Job job = s.job;
                    if (plan.box != Box{0, plan.width, 0, plan.height})
                        job = placed(job, plan.box, plan.width, plan.height);
                    if (box) std::copy(box->begin(), box->end(), job.box);
                    if (!suffices(plan, s, job)) refuse_small();
                    unlocked([&] { sample_plane(plan, job); });
                });
            },
            "sampling"_a, "box"_a = nb::none(),
            "Fill what a box (x0, x1, y0, y1) holds of a sampling's output, or all of it.");
    m.def("finite", &finite, "samples"_a.noconvert(), "Return whether no sample is NaN or infinite.");
    m.def("warp_stack", &warp_stack, "map"_a, "height"_a, "width"_a, "planes"_a, "tolerance"_a, "samplings"_a,
          "box"_a = nb::none(), "copied"_a = nb::none(),
          "Sample planes of a stack, each by one thread; return the largest error, the evaluations, and how many nodes "
          "or pixels are not solved, fold, and lie outside. `copied` says which planes are copied, if it is known.");
    m.def("needed", &needed_of, "map"_a, "height"_a, "width"_a, "planes"_a, "tolerance"_a, "count"_a, "size"_a,
          "codes"_a, "box"_a,
          "Return the part (x0, x1, y0, y1, k0, k1) of `count` frames of a size (h, w) that a box of planes reads, and "
          "how far each plane's part moves (-1 for the identity), and the same checks as `warp_stack`.");
}

}  // namespace supple
