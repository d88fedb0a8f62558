// A volume rendered through a camera: rays from the eye, their first surface, and the part behind it.
//
// The paper's Algorithm 3: a ray enters the box; its first sample in the visible range, and, by bisection, the surface
// before it; from there on, steps through a transfer function, composited front to back by c ← c + (1 - α) α_v c_v and
// α ← α + (1 - α) α_v. This equals the paper's back to front, but can end early. Colour and opacity of a step are those
// of all values from its first to its last, as if these were linear in between (pre-integration), so that no visible
// values are missed, however narrow their range. A deformed volume is sampled at p = T⁻¹(q), and its gradient is
// (∂p/∂q)ᵀ ∇f. Rays are clipped against a box; its cut faces are lit as planes, as gradients within a body may point
// anywhere. Rays of neighbouring pixels are marched together, one in each lane of a vector; voxels are read lane by
// lane.
#pragma once
#include <array>
#include <cmath>
#include <limits>

#include "solvers.hpp"
#include "table.hpp"
#include "voxels.hpp"

namespace supple {

constexpr int BRICK = 4;          // voxels; a brick holds one more along each axis, its neighbour's first
constexpr int BISECTIONS = 2;     // before the surface is placed by linear interpolation
constexpr int HALVINGS = 6;       // the same for labels, which have no values in between
constexpr double EXACT = 1e-3;    // voxels: the largest last Newton step of an inverted sample
constexpr float OPAQUE = 0.995f;  // the opacity at which a ray ends
constexpr double LAYER = 4;       // voxels behind a cut face over which its light gives way to that of gradients
constexpr float AMBIENT = 0.15f, DIFFUSE = 0.8f, SPECULAR = 0.2f;  // and the highlight's power is 16
constexpr int TILE = 8;                                            // pixels along a tile's side
constexpr double NEVER = std::numeric_limits<double>::infinity();

// The appearance of a volume: a camera, the light, and a transfer function. Lengths are millimetres along the volume's
// axes, except those of the eye, which is in voxels.
struct Look {
    Double4 eye, spacing, ahead, right, down;  // the ray of a pixel (x, y): ahead + x right + y down
    Double4 first, last;                       // the corners of the visible box, in voxels
    float step, per_step;                      // millimetres from sample to sample; 1 / that
    float per_layer;                           // 1 / the millimetres of LAYER
    Float4 lamp, per_voxel;                    // the position of the light; 1 / spacing, and 1
    bool shaded;
    std::vector<uint8_t> skips;  // the distance in bricks to the next visible one
    int row, layer;              // strides of bricks
    Int4 last_brick;
    std::vector<Float4> table;  // linear red, green and blue, and the opacity of a step
    std::vector<Double4> sums;  // prefix sums of extinction times colour, and of extinction
    float low, scale;           // the value of the first entry, and entries per unit
    float last_entry;
    float threshold, top;  // the visible range
    Double4 plane;         // cuts away what lies beyond it: its normal, and its distance from the first voxel
    float silhouettes;     // how much surfaces darken at grazing angles
    // With shadows, the fraction of the light that arrives at the nodes of a grid.
    std::vector<float> arrives;
    std::array<int64_t, 3> nodes;
    Float4 first_node, per_node;  // the node of a voxel is first_node + per_node voxel
    bool labelled;                // whether values are numbers of labels (`Labels`)
    enum { COMPOSITED, MAXIMUM, MINIMUM, AVERAGE } projection;

    template <class V>
    INLINE V entry(V value) const {
        return least(most(V((value - low) * scale), V{}), V{} + last_entry);
    }
    Float4 colour(float value) const { return table[int32_t(entry(value) + 0.5f)]; }

    INLINE float arriving(Float4 q) const {
        return Voxels(arrives.data(), nodes[0], nodes[1], nodes[2]).sample(first_node + per_node * q);
    }
    // The light of a step between two labels, which are not mixed: half a step of each; and the middle of its visible
    // part, from 0 to 1.
    INLINE Float4 halves(float a, float b, float part, float& middle) const {
        Float4 one = colour(a), other = colour(b);
        middle = a == 0 ? 0.75f : b == 0 ? 0.25f : 0.5f;
        const float left = std::pow(1 - one[3], 0.5f * part), last = left * (1 - std::pow(1 - other[3], 0.5f * part));
        const float all = 1 - left + last;
        if (!(all > 0)) return Float4{};
        Float4 mixed = ((1 - left) * one + last * other) * (1 / all);
        mixed[3] = all;
        return mixed;
    }
    // The prefix sums before an entry, interpolated.
    INLINE Double4 before(float entry) const {
        float at = entry + 0.5f;
        int k = least(int(at), int(last_entry));
        return sums[k] + double(at - float(k)) * (sums[k + 1] - sums[k]);
    }
};

// ---- rays, side by side --------------------------------------------------------------------------------------------

constexpr int RAYS = REGISTER > 16 ? 8 : 4;
typedef Pack<float, RAYS> Floats;
typedef int32_t Chosen __attribute__((vector_size(sizeof(float) * RAYS)));  // -1 for chosen rays, 0 for the others
constexpr float ENDLESS = std::numeric_limits<float>::infinity();

INLINE Floats root(Floats x) {
    for (int l = 0; l < RAYS; l++) x[l] = __builtin_sqrtf(x[l]);  // compiles to one instruction
    return x;
}
// The mask as bits, one for each ray.
INLINE unsigned bits(Chosen lanes) {
#if defined(__AVX__)
    return (unsigned)_mm256_movemask_ps((__m256)lanes);
#elif defined(__SSE2__)
    return (unsigned)_mm_movemask_ps((__m128)lanes);
#else
    unsigned made = 0;
    for (int l = 0; l < RAYS; l++) made |= unsigned(lanes[l] & 1) << l;
    return made;
#endif
}
template <class F>
INLINE void each(Chosen lanes, F&& f) {
    for (unsigned left = bits(lanes); left; left &= left - 1) f(__builtin_ctz(left));
}

// A number for each ray, as a vector or one by one.
template <class V, class S>
struct Each {
    union {
        V all;
        S one[RAYS];
    };
    Each(V all = V{}) : all(all) {}
};
typedef Each<Floats, float> Number;

// Three numbers for each ray.
struct Triple {
    Number part[3];

    INLINE Floats operator[](int i) const { return part[i].all; }
    INLINE Floats& operator[](int i) { return part[i].all; }
    INLINE Float4 of(int l) const { return Float4{part[0].one[l], part[1].one[l], part[2].one[l], 0}; }
    INLINE void set(int l, Float4 v) {
        for (int i = 0; i < 3; i++) part[i].one[l] = v[i];
    }
};
template <class V>
INLINE Floats dot3(const Triple& a, const V& b) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

// A volume of any kind, interpolated at a point of each chosen ray, in voxels. Kernels of rays call it, so that they
// are compiled once for all kinds.
struct Volume {
    const bool coloured;

    virtual Floats values(const Triple& p, Chosen lanes) const = 0;
    // The gradients, per voxel.
    virtual void slopes(const Triple& p, Chosen lanes, Triple& found) const = 0;
    // The volume's own colours, with the opacity of the transfer function.
    virtual void paint(const Triple& p, Chosen lanes, Triple& colour) const = 0;

protected:
    explicit Volume(bool coloured) : coloured(coloured) {}
    ~Volume() = default;
};
// `V` is Voxels, Labels or Coloured.
template <class V>
struct VolumeOf final : Volume {
    const V voxels;
    explicit VolumeOf(const V& voxels) : Volume(V::COLOURED), voxels(voxels) {}

    Floats values(const Triple& p, Chosen lanes) const override {
        Number made;
        if constexpr (V::PLAIN) {
            Each<Chosen, int32_t> cell[3];
            Triple part;
            for (int i = 0; i < 3; i++) {
                const Floats q = least(most(p[i], Floats{}), Floats{} + float(voxels.last[i] + 1));
                cell[i].all = least(__builtin_convertvector(q, Chosen), Chosen{} + voxels.last[i]);
                part[i] = q - __builtin_convertvector(cell[i].all, Floats);
            }
            each(lanes, [&](int l) {
                made.one[l] = voxels.sample(cell[0].one[l], cell[1].one[l], cell[2].one[l], part.part[0].one[l],
                                            part.part[1].one[l], part.part[2].one[l]);
            });
        } else
            each(lanes, [&](int l) { made.one[l] = voxels.sample(p.of(l)); });
        return made.all;
    }
    void slopes(const Triple& p, Chosen lanes, Triple& found) const override {
        each(lanes, [&](int l) { found.set(l, voxels.slopes(p.of(l))); });
    }
    void paint(const Triple& p, Chosen lanes, Triple& colour) const override {
        if constexpr (V::COLOURED) each(lanes, [&](int l) { colour.set(l, voxels.painted(p.of(l), colour.of(l))); });
    }
};

// Some rays, and their results so far. Distances along them are in millimetres from where they enter the box. Steps are
// counted, as a running sum would lose accuracy.
struct Beam {
    double near[RAYS] = {};                                   // millimetres from the eye to where they enter
    Triple first, way, along;                                 // the entry, in voxels; voxels and mm per mm
    Number end{Floats{} - 1};                                 // where they leave the box; below 0 if they miss it
    Number from{Floats{} + ENDLESS}, to{Floats{} - ENDLESS};  // the range in which strokes reach them
    Number surface{Floats{} + ENDLESS}, opaque{Floats{} + ENDLESS};  // the first surface, and where opacity passes 0.9
    Number light[4];                                                 // premultiplied linear colour, and opacity
    Each<Chosen, int32_t> samples;
    double steps[RAYS] = {};  // Newton steps

    // Set a lane to the ray of a pixel (x, y), which ends at a distance from the eye.
    INLINE void enter(const Look& look, int l, double x, double y, double limit) {
        Double4 d = look.ahead + x * look.right + y * look.down;
        d *= 1.0 / root(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        const Double4 w = d / look.spacing, over = 1.0 / (magnitude(w) > 1e-12 ? w : Double4{} + 1e-12);
        const Double4 a = (look.first - look.eye) * over, b = (look.last - look.eye) * over;
        const Double4 low = least(a, b), high = most(a, b);
        const double boxed = most(most(low[0], low[1]), most(low[2], 0.0));
        double enters = boxed, leaves = least(least(high[0], high[1]), high[2]);
        // Cut away what lies beyond the plane; a ray that enters through it sees a cut face.
        double away = -look.plane[3], rate = 0, lamp = 0;
        for (int i = 0; i < 3; i++) {
            away += look.plane[i] * look.eye[i] * look.spacing[i];
            rate += look.plane[i] * d[i];
            lamp += look.plane[i] * look.lamp[i];
        }
        if (rate > 0)
            leaves = least(leaves, -away / rate);
        else if (rate < 0)
            enters = most(enters, -away / rate);
        else if (away > 0)
            leaves = -1;
        if (!look.projection) leaves = least(leaves, limit);
        if (!(enters <= leaves)) return;
        near[l] = enters;
        end.one[l] = float(leaves - enters);
        first.set(l, floats(Double4(look.eye + enters * w)));
        way.set(l, floats(w));
        along.set(l, floats(d));
        per_voxel.set(l, floats(over));
        for (int i = 0; i < 3 && boxed > 0; i++)
            if (low[i] == boxed) face.one[l] = __builtin_fabsf(look.lamp[i]);
        if (enters > boxed) face.one[l] = float(std::abs(lamp));
    }

    // March through a volume; `source` maps a point to its source point.
    template <class Source>
    void march(const Look& look, const Volume& voxels, Source&& source) {
        live = Floats{} <= end.all;
        if (look.projection) return project(look, voxels, source);
        for (int i = 0; i < 3; i++) half[i] = look.lamp[i] - along[i];
        const Floats size = most(root(dot3(half, half)), Floats{} + 1e-6f);
        for (int i = 0; i < 3; i++) half[i] /= size;
        while (true) {
            hop(look);
            if (!bits(live)) return;
            const Number start(at(look, 0)), stop(at(look, 1));
            const Chosen fresh = live & ~known;
            if (bits(fresh)) before.all = fresh ? values(voxels, source, start, fresh) : before.all;
            known = live;
            after.all = values(voxels, source, stop, live);
            Chosen found{}, seen{};
            const Chosen outside = live & (surface.all == ENDLESS);
            if (bits(outside)) found = find(look, voxels, source, start, stop, outside);
            const Chosen behind = live & (surface.all != ENDLESS) & ~found;
            if (bits(behind)) seen = shade(look, voxels, source, start, stop, behind);
            face.all = seen ? face.all : Floats{} - 1;
            inside = found | seen;
            before.all = found ? before.all : after.all;
            count = found ? count : count + 1;
            live &= found | (stop.all < end.all);
        }
    }

    // Write the results of a lane: light, the distance of the first surface and of where opacity passes 0.9, and the
    // numbers of samples and of Newton's steps. `behind` is the colour and the distance of a mesh, if any.
    void write(const Look& look, int l, const float* behind, float* colour, double* depth, int64_t* work) const {
        Float4 made = {light[0].one[l], light[1].one[l], light[2].one[l], light[3].one[l]};
        depth[0] = near[l] + surface.one[l];
        depth[1] = near[l] + opaque.one[l];
        if (behind && behind[3] != ENDLESS) {
            const float left = look.projection ? 1 : 1 - made[3];
            const Float4 mesh = {behind[0], behind[1], behind[2], 1};
            depth[0] = look.projection ? behind[3] : least(depth[0], double(behind[3]));
            made = left == 1 ? mesh : made + left * mesh;
        }
        memcpy(colour, &made, sizeof made);
        work[0] = samples.one[l];
        work[1] = (int64_t)steps[l];
    }

    // The points at distances along the rays, in voxels.
    INLINE Triple points(Floats t) const {
        Triple q;
        for (int i = 0; i < 3; i++) q[i] = first[i] + t * way[i];
        return q;
    }
    INLINE Chosen moved(Floats t) const { return (t >= from.all) & (t <= to.all); }

private:
    Triple per_voxel, half;     // 1 / way; the half vector between the lamp and the eye
    Number face{Floats{} - 1};  // the cosine of the lamp's angle to the cut face while it is visible, or -1
    Chosen live{}, known{};     // rays that have not ended; rays whose value at the start of the step is known
    Chosen inside{};            // rays whose next step must not be skipped
    Floats base{}, count{};     // where the count of steps starts, and the count
    Number before, after;       // the values at both ends of a step

    INLINE Floats at(const Look& look, int steps) const {
        return least(Floats(base + (count + float(steps)) * look.step), end.all);
    }

    // Advance rays to visible bricks.
    INLINE void hop(const Look& look) {
        Chosen left = live & ~inside & ~moved(at(look, 0)), hopped{};
        while (bits(left)) {
            const Floats t = at(look, 0);
            const Triple q = points(t);
            Chosen brick[3];
            for (int i = 0; i < 3; i++)
                brick[i] = least(__builtin_convertvector(q[i] * (1.0f / BRICK), Chosen), Chosen{} + look.last_brick[i]);
            const Each<Chosen, int32_t> index(brick[2] * look.layer + brick[1] * look.row + brick[0]);
            Number away;
            each(left, [&](int l) { away.one[l] = look.skips[index.one[l]]; });
            left &= away.all > 0;
            if (!bits(left)) break;
            Floats leave = Floats{} + ENDLESS;  // the distance to where the ray leaves the empty bricks around it
            for (int i = 0; i < 3; i++) {
                const Floats wall =
                    __builtin_convertvector(brick[i], Floats) + (per_voxel[i] > 0 ? away.all : Floats(1 - away.all));
                leave = least(leave, Floats((float(BRICK) * wall - q[i]) * per_voxel[i]));
            }
            leave = t < from.all ? least(leave, Floats(from.all - t)) : leave;
            const Floats last =
                rounded_up((end.all - base) * look.per_step);  // the remaining steps before the end may be visible
            const Floats next =
                least(Floats(count + most(rounded_up(leave * look.per_step - 1e-3f), Floats{} + 1)), last);
            live &= ~(left & ((t >= end.all) | (last <= count)));  // by rounding, both may differ
            count = left ? next : count;
            hopped |= left;
            left &= live & ~moved(at(look, 0));
        }
        if (!bits(hopped)) return;
        count = hopped ? most(Floats(count - 1), Floats{}) : count;  // back to the step that lies partly in this brick
        known &= ~hopped;
        face.all = hopped ? Floats{} - 1 : face.all;
    }
    INLINE static Floats rounded_up(Floats x) {
        const Floats down = __builtin_convertvector(__builtin_convertvector(x, Chosen), Floats);
        return x > down ? down + 1 : down;
    }

    // The values at distances along chosen rays.
    template <class Source>
    NOINLINE Floats values(const Volume& voxels, Source& source, const Number& t, Chosen lanes) {
        samples.all -= lanes;
        return voxels.values(source.place(*this, t, lanes), lanes);
    }

    // The position of values relative to the visible range: 0 within it, -1 or 1 on either side.
    INLINE static Chosen side(const Look& look, Floats value) { return (value < look.threshold) - (value > look.top); }

    // Find the first surface of rays in a step. Rays with a surface within the step restart at it; they are returned.
    template <class Source>
    INLINE Chosen find(const Look& look, const Volume& voxels, Source& source, const Number& start, const Number& stop,
                       Chosen lanes) {
        const Chosen outer = side(look, before.all), within = lanes & (outer != 0) & (outer != side(look, after.all));
        surface.all = (lanes & (outer == 0)) ? start.all : surface.all;
        if (!bits(within)) return within;
        Floats low = start.all, high = stop.all, u = before.all, v = after.all;
        for (int turn = 0; turn < (look.labelled ? HALVINGS : BISECTIONS); turn++) {
            const Floats middle = 0.5f * (low + high), value = values(voxels, source, middle, within);
            const Chosen same = side(look, value) == outer;
            low = same ? middle : low;
            high = same ? high : middle;
            u = same ? value : u;
            v = same ? v : value;
        }
        if (!look.labelled) {  // by linear interpolation to the end of the visible range
            const Floats limit = outer < 0 ? Floats{} + look.threshold : Floats{} + look.top;
            high = low + (high - low) * ((limit - u) / (v - u));
            v = limit;
        }
        surface.all = within ? high : surface.all;
        base = within ? high : base;
        count = within ? Floats{} : count;
        before.all = within ? v : before.all;
        return within;
    }

    // Colours and opacities of a fraction of a step, along which values go from `before` to `after`; and the middle of
    // its visible part, from 0 to 1.
    INLINE Floats blend(const Look& look, Floats share, Chosen lanes, Triple& colour, Floats& middle) const {
        const Floats lowest = Floats{} + look.threshold, highest = Floats{} + look.top, a = before.all, b = after.all;
        const Number from(least(most(a, lowest), highest)), to(least(most(b, lowest), highest));
        const Chosen level = a == b, visible = lanes & ((from.all != to.all) | ((from.all == a) & (to.all == b)));
        const Floats over = level ? Floats{} : 1 / (b - a);
        const Number mean(0.5f * (from.all + to.all)), first(look.entry(from.all)), last(look.entry(to.all));
        middle = level ? Floats{} + 0.5f : (mean.all - a) * over;
        const Chosen flat = visible & (magnitude(Floats(last.all - first.all)) < 1);
        const Number part(share * over * (1 / look.scale)), seen(level ? share : share * (to.all - from.all) * over);
        Number thick, opacity;
        each(visible & ~flat, [&](int l) {
            const Double4 all = (look.before(last.one[l]) - look.before(first.one[l])) * double(part.one[l]);
            if (!(all[3] > 0)) return;
            colour.set(l, floats(Double4(all * (1 / all[3]))));
            thick.one[l] = float(all[3]);
        });
        opacity.all = 1 - fading(thick.all);
        each(flat, [&](int l) {
            const Float4 one = look.colour(mean.one[l]);
            colour.set(l, one);
            opacity.one[l] = seen.one[l] == 1 ? one[3] : 1 - std::pow(1 - one[3], seen.one[l]);
        });
        return opacity.all;
    }

    // exp(-x) for x ≥ 0, with an error of up to 2e-7.
    INLINE static Floats fading(Floats x) {
        x = least(x, Floats{} + 80.0f) * 1.44269504f;  // as powers of 2
        const Chosen k = __builtin_convertvector(x + 0.5f, Chosen);
        const Floats y = (__builtin_convertvector(k, Floats) - x) * 0.69314718f;  // within ln(2) / 2
        const Floats power =
            1 + y * (1 + y * (0.5f + y * (1 / 6.0f + y * (1 / 24.0f + y * (1 / 120.0f + y / 720.0f)))));
        return power * (Floats)((127 - k) << 23);
    }

    // Add the light of a step. Returns the rays for which some of it is visible.
    template <class Source>
    INLINE Chosen shade(const Look& look, const Volume& voxels, Source& source, const Number& start, const Number& stop,
                        Chosen lanes) {
        Triple colour;
        Number opacity, middle;
        const Number share((stop.all - start.all) * look.per_step);
        if (look.labelled)
            each(lanes, [&](int l) {
                const Float4 mixed = look.halves(before.one[l], after.one[l], share.one[l], middle.one[l]);
                colour.set(l, mixed);
                opacity.one[l] = mixed[3];
            });
        else
            opacity.all = blend(look, share.all, lanes, colour, middle.all);
        const Chosen seen = lanes & (opacity.all > 0);
        if (!bits(seen)) return seen;
        samples.all -= seen;
        const Number t(start.all + middle.all * (stop.all - start.all));
        const Triple p = source.place(*this, t, seen);
        if (voxels.coloured) voxels.paint(p, seen, colour);
        Floats lit = Floats{} + 1, shine{};
        if (look.shaded) {
            Triple slope;
            voxels.slopes(p, seen, slope);
            source.turn(look, t, slope);
            // Ambient and diffuse light, and the highlight; both sides of a surface are lit.
            const Floats size = root(dot3(slope, slope)), over = size > 0 ? 1 / size : Floats{};
            lit = AMBIENT + DIFFUSE * (size > 0 ? magnitude(Floats(dot3(slope, look.lamp) * over)) : Floats{} + 1);
            shine = dot3(slope, half) * over;
            for (int i = 0; i < 4; i++) shine *= shine;
            if (look.silhouettes > 0) {
                const Floats aside = most(Floats(1 - magnitude(Floats(dot3(slope, along) * over))), Floats{});
                const Floats left = size > 0 ? 1 - look.silhouettes * aside * aside : Floats{} + 1;
                lit *= left;
                shine *= left;
            }
            const Floats deep = start.all * look.per_layer,
                         flat = face.all >= 0 ? most(Floats(1 - deep), Floats{}) : Floats{};
            lit += flat * (AMBIENT + DIFFUSE * face.all - lit);
            shine *= 1 - flat;
            if (!look.arrives.empty()) {
                const Triple q = points(t.all);
                Number arrives;
                each(seen, [&](int l) { arrives.one[l] = look.arriving(q.of(l)); });
                lit *= arrives.all;
                shine *= arrives.all;
            }
        }
        const Floats part = seen ? (1 - light[3].all) * opacity.all : Floats{};
        for (int c = 0; c < 3; c++) light[c].all += seen ? part * (colour[c] * lit + SPECULAR * shine) : Floats{};
        light[3].all += part;
        opaque.all = ((opaque.all == ENDLESS) & (light[3].all >= 0.9f)) ? start.all : opaque.all;
        live &= ~(light[3].all > OPAQUE);
        return seen;
    }

    // The extreme or the average value of each ray, and the transfer function's colour for it.
    template <class Source>
    INLINE void project(const Look& look, const Volume& voxels, Source& source) {
        Number value;
        for (Floats t{}; bits(live); count = count + 1, t = count * look.step, live &= t <= end.all) {
            const Floats next = values(voxels, source, t, live);
            if (look.projection == Look::AVERAGE) {
                value.all += live ? next : Floats{};
                continue;
            }
            const Chosen better = live & ((opaque.all == ENDLESS) |
                                          (look.projection == Look::MAXIMUM ? next > value.all : next < value.all));
            value.all = better ? next : value.all;
            opaque.all = better ? t : opaque.all;
        }
        each(samples.all > 0, [&](int l) {
            const bool average = look.projection == Look::AVERAGE;
            const Float4 made = look.colour(average ? value.one[l] / float(samples.one[l]) : value.one[l]);
            for (int c = 0; c < 4; c++) light[c].one[l] = made[c];
            surface.one[l] = average ? 0 : opaque.one[l];
        });
    }
};

// Source points: the points themselves ...
struct Still {
    Triple place(const Beam& beam, const Number& t, Chosen) { return beam.points(t.all); }
    void turn(const Look& look, const Number&, Triple& slope) const {
        for (int i = 0; i < 3; i++) slope[i] *= look.per_voxel[i];
    }
};

// ... or T⁻¹ of them, where strokes reach a ray, with the last displacement on the ray as a guess.
class Inverted {
public:
    Inverted(const Strokes& strokes, const Look& look, Beam& beam) : strokes(strokes), look(look) {
        for (int l = 0; l < RAYS; l++) reach(beam, l);
    }

    INLINE Triple place(Beam& beam, const Number& t, Chosen lanes) {
        Triple p = beam.points(t.all);
        moved = lanes & beam.moved(t.all);
        int each_of[RAYS], n = 0;
        each(moved, [&](int l) { each_of[n++] = l; });
        for (int i = 0; i < n; i += LANES) {
            Lanes q[3];
            Solution<3, Lanes> found{};
            for (int k = 0; k < LANES; k++) {
                const int l = each_of[least(i + k, n - 1)];
                for (int c = 0; c < 3; c++) {
                    q[c][k] = double(p.part[c].one[l]) * look.spacing[c];
                    found.p[c][k] = q[c][k] + shift[c][l];
                }
            }
            settle(q, found);
            for (int k = 0; k < LANES && i + k < n; k++) {
                const int l = each_of[i + k];
                for (int c = 0; c < 3; c++) {
                    shift[c][l] = found.p[c][k] - q[c][k];
                    p.part[c].one[l] = float(found.p[c][k] / look.spacing[c]);
                    for (int j = 0; j < 3; j++) m[j].part[c].one[l] = float(found.m[j][c][k]);
                }
                beam.steps[l] += found.steps[k];
            }
        }
        return p;
    }
    INLINE void turn(const Look&, const Number&, Triple& slope) const {
        Triple f = slope;
        for (int i = 0; i < 3; i++) f[i] *= look.per_voxel[i];
        for (int j = 0; j < 3; j++) {
            Floats sum{};
            for (int c = 0; c < 3; c++) sum += m[j][c] * f[c];
            slope[j] = moved ? sum : f[j];
        }
    }

private:
    const Strokes& strokes;
    const Look& look;
    Chosen moved{};
    double shift[3][RAYS] = {};  // millimetres
    Triple m[3];

    // True if x lies in any stroke's ball; elsewhere T(x) = x. With a fixed border, x is the nearest point of the
    // domain.
    INLINE bool reached(const Lanes* x) const {
        for (const Stroke& k : strokes.table) {
            Lanes s{};
            for (int i = 0; i < 3; i++) {
                const Lanes near = strokes.axes[i].fixed() ? nearest(x[i], strokes.axes[i]) : x[i];
                s += (near - k.pivot[i]) * (near - k.pivot[i]);
            }
            if (k.per_reach == 0 || any(s < k.reach * k.reach)) return true;
        }
        return false;
    }

    // Solve T⁻¹ of q from the guess in `found.p`, or without it if it is not good enough for all lanes.
    INLINE void settle(const Lanes* q, Solution<3, Lanes>& found) const {
        const Axis* axes = strokes.axes.data();
        const double tolerance = EXACT * finest_of<3>(axes);
        if (!reached(q)) {
            for (int i = 0; i < 3; i++) {
                found.p[i] = q[i];
                found.m[i][i] = splat<Lanes>(1.0);
            }
            return;
        }
        newton<3>(strokes.chain(), axes, q, tolerance, 10, found);
        if (!any(without(Mask{} == 0, found.done))) return;
        const Lanes before = found.steps;
        undo<3>(strokes.chain(), axes, q, tolerance, found);
        found.steps += before;
    }

    // Extend the range of a ray in which strokes reach it.
    void reach(Beam& beam, int l) const {
        for (const Stroke& k : strokes.table) {
            double b = 0, d2 = 0;  // the distance to the point nearest the pivot; the pivot's from the start, squared
            for (int i = 0; i < 3; i++) {
                const double r = k.pivot[i] - double(beam.first.part[i].one[l]) * look.spacing[i];
                b += r * double(beam.along.part[i].one[l]);
                d2 += r * r;
            }
            const double half2 = k.reach * k.reach - (d2 - b * b);
            if (!(half2 > 0)) continue;
            beam.from.one[l] = least(beam.from.one[l], float(b - root(half2)));
            beam.to.one[l] = most(beam.to.one[l], float(b + root(half2)));
        }
    }
};

}  // namespace supple
