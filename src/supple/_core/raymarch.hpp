// A volume rendered through a camera: rays from the eye, their first surface, and the part behind it.
//
// The paper's Algorithm 3: the entry of a ray into the box, its first sample above a threshold, the surface before that
// by bisection, and from there on steps through a transfer function, composited front to back by
// c ← c + (1 - α) α_v c_v and α ← α + (1 - α) α_v: equal to the paper's back to front, with an early end. Colour and
// opacity of a step are those of all values from its first to its last, as if they were linear in between
// (pre-integration): what is visible of them is not missed, however narrow a window it is. A deformed
// volume is sampled at p = T⁻¹(q), and its gradient is (∂p/∂q)ᵀ ∇f. Rays are clipped against a box; what it cuts
// through is lit as the plane that it is, since gradients within a body point anywhere.
#pragma once
#include <array>
#include <cmath>
#include <limits>

#include "solid.hpp"

namespace supple {

constexpr int BRICK = 4;          // voxels; a brick holds one more along each axis, its neighbour's first
constexpr int BISECTIONS = 2;     // before the surface is found by a straight line between two values
constexpr int HALVINGS = 6;       // of labels, which have no values between
constexpr double EXACT = 1e-3;    // the last Newton step at a sample that is inverted, in voxels
constexpr float OPAQUE = 0.995f;  // the opacity at the end of a ray
constexpr double LAYER = 4;       // voxels behind a cut face over which the light of gradients takes over
constexpr float AMBIENT = 0.15f, DIFFUSE = 0.8f, SPECULAR = 0.2f;  // and the highlight's power is 16
constexpr int TILE = 8;                                            // pixels along a tile's side
constexpr double NEVER = std::numeric_limits<double>::infinity();

// The appearance of a volume: a camera, the light, and a transfer function. In millimetres along the volume's axes,
// except for the eye, in voxels.
struct Look {
    Double4 eye, spacing, ahead, right, down;  // the ray of a pixel (x, y): ahead + x right + y down
    Double4 first, last;                       // the corners of the box that is seen, in voxels
    double step, per_step;                     // millimetres from sample to sample; 1 / that
    double per_layer;                          // 1 / the millimetres of LAYER
    Float4 lamp, per_voxel;                    // the position of the light; 1 / spacing, and 1
    bool shaded;
    std::vector<uint8_t> skips;  // the distance in bricks to the next visible one
    int row, layer;              // of bricks
    Int4 last_brick;
    std::vector<Float4> table;  // linear red, green and blue, and the opacity of a step
    std::vector<Double4> sums;  // of extinction times colour, and of extinction, of all entries before each
    float low, scale;           // the first entry's value, and entries for each unit
    float last_entry;
    float threshold, top;  // the visible range
    Double4 plane;         // what lies beyond it is cut away: its normal, and its distance from the first voxel
    float silhouettes;     // by how much surfaces darken that are seen from the side
    // The part of the light that arrives at the nodes of a grid, if there are shadows.
    std::vector<float> arrives;
    std::array<int64_t, 3> nodes;
    Float4 first_node, per_node;  // the node of a voxel is first_node + per_node voxel
    bool labelled;                // values are numbers of labels, see Labels
    enum { COMPOSITED, MAXIMUM, MINIMUM, AVERAGE } projection;

    INLINE float entry(float value) const { return least(most((value - low) * scale, 0.0f), last_entry); }
    Float4 colour(float value) const { return table[int32_t(entry(value) + 0.5f)]; }
    // The side of the visible range on which a value is: -1, 0 in between, or 1.
    int side(float value) const { return value < threshold ? -1 : value > top; }

    INLINE float arriving(Float4 q) const {
        return Voxels(arrives.data(), nodes[0], nodes[1], nodes[2]).sample(first_node + per_node * q);
    }
    // Colour and opacity of a part of a step, along which values go from `a` to `b`; and where the middle of what is
    // visible is, from 0 to 1.
    INLINE Float4 between(float a, float b, float part, float& middle) const {
        if (labelled) return halves(a, b, part, middle);
        const float from = least(most(a, threshold), top), to = least(most(b, threshold), top);
        if (from == to && (from != a || to != b)) return Float4{};
        const float over = a == b ? 0 : 1 / (b - a), mean = 0.5f * (from + to), e = entry(from), e1 = entry(to);
        middle = a == b ? 0.5f : (mean - a) * over;
        if (__builtin_fabsf(e1 - e) < 1) {
            Float4 flat = colour(mean);
            const float seen = a == b ? part : part * (to - from) * over;
            if (seen != 1 && flat[3] > 0) flat[3] = 1 - std::pow(1 - flat[3], seen);
            return flat;
        }
        const Double4 all = (before(e1) - before(e)) * double(part * over / scale);
        if (!(all[3] > 0)) return Float4{};
        Float4 mixed = floats(Double4(all * (1 / all[3])));
        mixed[3] = 1 - std::exp(-float(all[3]));
        return mixed;
    }

private:
    // Of labels, which are not mixed: half of one before half of the other.
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
    INLINE Double4 before(float entry) const {
        float at = entry + 0.5f;
        int k = least(int(at), int(last_entry));
        return sums[k] + double(at - float(k)) * (sums[k + 1] - sums[k]);
    }
};

// The state of a ray: its next sample, and its results so far.
struct Ray {
    Double4 origin, way;                     // voxels, and voxels a millimetre
    Double4 along;                           // millimetres a millimetre
    double near, far;                        // where it enters and leaves the box
    double t;                                // the next sample; beyond `far` when the ray has ended
    double start;                            // of the step that it is on
    double from = NEVER, to = -NEVER;        // the range in which strokes reach it
    double surface = NEVER, opaque = NEVER;  // the first surface, and where opacity passes 0.9
    Float4 light{};                          // premultiplied linear colour, and opacity
    int64_t samples = 0;
    double steps = 0;      // of Newton's method
    double shift[3] = {};  // millimetres from the last sample to its source
    bool within = false;   // whether the next sample, if visible, needs its gradient

    // `end` is the last voxel of the volume.
    Ray(const Look& look, double x, double y, double limit = NEVER) : origin(look.eye) {
        along = look.ahead + x * look.right + y * look.down;
        along *= 1.0 / root(along[0] * along[0] + along[1] * along[1] + along[2] * along[2]);
        way = along / look.spacing;
        Double4 over = 1.0 / (magnitude(way) > 1e-12 ? way : Double4{} + 1e-12);
        Double4 a = (look.first - origin) * over, b = (look.last - origin) * over, low = least(a, b), high = most(a, b);
        t = near = most(most(low[0], low[1]), most(low[2], 0.0));
        far = least(least(high[0], high[1]), high[2]);
        cut(look);
        if (!look.projection) far = least(far, limit);
        if (!live()) return;
        for (int i = 0; i < 3 && near > 0; i++)
            if (low[i] == near) face = __builtin_fabsf(look.lamp[i]);
        start = near;
        half = look.lamp - floats(along);
        half *= 1.0f / most(__builtin_sqrtf(dot3(half, half)), 1e-6f);
        per_voxel = floats(over);
        sides = per_voxel > 0 ? Float4{} + BRICK : Float4{} - BRICK;
        back = per_voxel > 0 ? Float4{} : Float4{} + BRICK;
    }

    bool live() const { return t <= far; }
    bool moved() const { return t >= from && t <= to; }
    INLINE Float4 at(double t) const { return floats(Double4(origin + t * way)); }

    // Advance to where the ray leaves the empty bricks around it. False if it is in a visible one.
    INLINE bool hop(const Look& look) {
        if (stage != FIRST && stage != LAST) return false;
        Float4 q = at(start);
        Int4 brick = least(whole(q * (1.0f / BRICK)), look.last_brick);
        float away = look.skips[brick[2] * look.layer + brick[1] * look.row + brick[0]];
        if (away == 0) {
            if (stage != FIRST || !hopped) return false;
            t = start = most(near, start - look.step);  // which lies partly in this brick
            stage = PINNED;
            return true;
        }
        Float4 left = (float(BRICK) * floats(brick) + back + away * sides - q) * per_voxel;  // to each side of these
        double leave = least(left[0], least(left[1], left[2]));
        if (start < from) leave = least(leave, from - start);
        face = -1;
        const double next = start + look.step * most(1.0, __builtin_ceil(leave * look.per_step - 1e-3));
        t = start = start < far ? least(next, far) : next;  // what is left before the end may be visible
        stage = FIRST;
        hopped = true;
        return true;
    }

    // Add the sample at t (the gradient, and the value last), and choose the next t. `painted` is its colour, of the
    // transfer function's.
    template <class F>
    INLINE void take(const Look& look, Float4 sample, F&& painted) {
        float value = sample[3];
        samples++;
        if (look.projection) {
            project(look, value);
            t = start += look.step;
            return;
        }
        if (stage == LIT) {
            gather(look, painted(colour), sample);
            next(look, true);
        } else if (stage == BISECT) {
            bool outer = look.side(value) == look.side(before);
            (outer ? start : t1) = t;
            (outer ? before : after) = value;
            t = 0.5 * (start + t1);
            if (++turn < (look.labelled ? HALVINGS : BISECTIONS)) return;
            if (look.labelled) {
                surface = start = t1;
                before = after;
            } else {  // by a straight line to the end of the visible range
                float end = look.side(before) < 0 ? look.threshold : look.top;
                surface = start += (t1 - start) * ((end - before) / (after - before));
                before = end;
            }
            t = t1 = least(start + look.step, most(far, start));
            stage = HELD;
        } else if (stage == FIRST || stage == PINNED) {
            before = value;
            hopped = false;
            t = t1 = least(start + look.step, far);
            stage = HELD;
        } else {
            after = value;
            if (surface == NEVER) {
                int side = look.side(before);
                if (side && side == look.side(after)) return next(look, false);
                if (side) {  // the surface lies within the step
                    face = -1;
                    turn = 0;
                    t = 0.5 * (start + t1);
                    stage = BISECT;
                    return;
                }
                surface = start;
            }
            float middle;
            colour = look.between(before, after, float((t1 - start) * look.per_step), middle);
            if (!(colour[3] > 0)) return next(look, false);
            t = mix(double(middle), start, t1);
            within = true;  // with its gradient, and the colour there
            stage = LIT;
        }
    }

    // The colour of a projection, once the ray has ended.
    void finish(const Look& look) {
        if (!look.projection || samples == 0) return;
        light = look.colour(look.projection == Look::AVERAGE ? float(projected / double(samples)) : float(projected));
        surface = look.projection == Look::AVERAGE ? near : opaque;
    }

    // Go on to the colour and the distance at which a mesh ends the ray, if one does.
    void end_at(const Look& look, Float4 end) {
        if (end[3] == std::numeric_limits<float>::infinity()) return;
        const float left = look.projection ? 1 : 1 - light[3];
        surface = look.projection ? end[3] : least(surface, double(end[3]));
        end[3] = 1;
        light = left == 1 ? end : light + left * end;
    }

private:
    // What is sampled: the start of a step, which may be empty or (pinned) may not, its end, whose step may be empty or
    // (held) may not, points between until the surface is found, or the middle of what is visible.
    enum { FIRST, PINNED, LAST, HELD, BISECT, LIT } stage = FIRST;
    bool hopped = false;  // over empty bricks, to the start of this step
    double t1;            // the end of the step
    float before, after;  // the values at both
    Float4 colour;        // of the step
    int turn;
    double projected = 0;  // the extreme value, or the sum
    float face = -1;       // the cosine of the lamp's angle to the cut face, as long as it is seen from there on
    Float4 half;           // between the lamp and the eye
    Float4 per_voxel, back, sides;  // to leave bricks

    // Go on with the next step.
    INLINE void next(const Look& look, bool seen) {
        within = false;
        if (!seen) face = -1;
        if (t == NEVER || t1 >= far) {
            t = NEVER;
            return;
        }
        start = t1;
        before = after;
        t = t1 = least(start + look.step, far);
        stage = seen ? HELD : LAST;
    }

    // Cut away what lies beyond the plane; where the ray enters through it, that is a cut face.
    void cut(const Look& look) {
        double away = -look.plane[3], rate = 0, lamp = 0;
        for (int i = 0; i < 3; i++) {
            away += look.plane[i] * origin[i] * look.spacing[i];
            rate += look.plane[i] * along[i];
            lamp += look.plane[i] * look.lamp[i];
        }
        if (rate > 0)
            far = least(far, -away / rate);
        else if (away > 0 && rate == 0)
            far = -1;
        else if (rate < 0 && -away / rate > near) {
            t = near = -away / rate;
            face = float(std::abs(lamp));
        }
    }

    INLINE void project(const Look& look, float value) {
        if (look.projection == Look::AVERAGE) {
            projected += value;
        } else if (samples == 1 || (look.projection == Look::MAXIMUM ? value > projected : value < projected)) {
            projected = value;
            opaque = t;
        }
    }

    // Ambient and diffuse light, and the highlight, of a surface with a gradient; both of its sides are lit.
    INLINE void gather(const Look& look, Float4 colour, Float4 gradient) {
        float part = (1 - light[3]) * colour[3], size = dot3(gradient, gradient);
        if (look.shaded) {
            float lit = AMBIENT + DIFFUSE, shine = 0;
            if (size > 0) {
                float over = 1.0f / __builtin_sqrtf(size);
                lit = AMBIENT + DIFFUSE * __builtin_fabsf(dot3(gradient, look.lamp) * over);
                shine = dot3(gradient, half) * over;
                for (int i = 0; i < 4; i++) shine *= shine;
                if (look.silhouettes > 0) {
                    float aside = most(1 - __builtin_fabsf(dot3(gradient, floats(along)) * over), 0.0f);
                    float left = 1 - look.silhouettes * aside * aside;
                    lit *= left;
                    shine *= left;
                }
            }
            if (face >= 0) {
                float deep = float((start - near) * look.per_layer), flat = 1 - least(most(deep, 0.0f), 1.0f);
                lit = mix(flat, lit, AMBIENT + DIFFUSE * face);
                shine *= 1 - flat;
            }
            if (!look.arrives.empty()) {
                float arrives = look.arriving(at(t));
                lit *= arrives;
                shine *= arrives;
            }
            colour = colour * lit + SPECULAR * shine;
        }
        colour[3] = 1;
        light += part * colour;
        if (opaque == NEVER && light[3] >= 0.9f) opaque = start;
        if (light[3] > OPAQUE) t = NEVER;
    }
};

// The sources of points: the points themselves ...
struct Still {
    Float4 source(const Ray&, double, Float4 q) { return q; }
    Float4 turned(double, Float4 slopes) const { return slopes; }
};

// ... or the lattice. Along a stretch of a ray, as long as one or two of its cells, u is the cubic with its values and
// slopes at both ends, and M the line. The positions of stretches do not depend on skipped bricks.
class Cubics {
public:
    Cubics(const Lattice& lattice, int cells, const Ray& ray)
        : lattice(lattice),
          length(cells * lattice.step /
                 root(ray.way[0] * ray.way[0] + ray.way[1] * ray.way[1] + ray.way[2] * ray.way[2])),
          per_length(1 / length) {}

    INLINE Float4 source(const Ray& ray, double t, Float4 q) {
        if (!(t >= start && t <= end)) begin(ray, t);
        float s = float((t - start) * over), s1 = 1 - s;
        return q + (first.u + s * (rise + s1 * (s1 * a + s * b)));
    }
    // Mᵀ times the slopes.
    INLINE Float4 turned(double t, Float4 slopes) const {
        float s = float((t - start) * over);
        Float4 g = slopes;
        for (int j = 0; j < 3; j++) g[j] = dot3(first.m[j] + s * turn[j], slopes);
        return g;
    }

private:
    const Lattice& lattice;
    double length, per_length, start = NEVER, end = -NEVER, over = 0;
    Place first, last;
    Float4 rise, a, b;
    Float4 turn[3];  // the change of M to the end

    NOINLINE void begin(const Ray& ray, double t) {
        double k = floored((t - ray.near) * per_length), before = end;
        start = ray.near + k * length;
        end = ray.near + (k + 1) * length;
        first = start == before ? last : lattice.at(ray.at(start));
        last = lattice.at(ray.at(least(end, ray.far)));
        over = end <= ray.far ? per_length : 1 / most(ray.far - start, 1e-6 * length);
        Float4 way = floats(Double4(least(end - start, ray.far - start) * ray.way));
        rise = last.u - first.u;
        a = -way - rise;  // (M - I) way - rise
        b = way + rise;
        for (int j = 0; j < 3; j++) {
            turn[j] = last.m[j] - first.m[j];
            a += first.m[j] * way[j];
            b -= last.m[j] * way[j];
        }
    }
};

// Add one sample of a volume: `V` is Voxels, Labels or Coloured.
template <class V, class Source>
INLINE void see(const V& voxels, const Look& look, Ray& ray, Source& source) {
    Float4 p = source.source(ray, ray.t, ray.at(ray.t));
    auto painted = [&](Float4 colour) { return voxels.painted(p, colour); };
    if (ray.within && look.shaded)
        ray.take(look, source.turned(ray.t, voxels.slopes(p)) * look.per_voxel, painted);
    else
        ray.take(look, Float4{0, 0, 0, voxels.sample(p)}, painted);
}

// March along some rays, from what `source_of` gives each. First hops are in turn, as each waits for the one before it.
template <class V, class F>
INLINE void march(const V& voxels, const Look& look, std::vector<Ray>& rays, F&& source_of) {
    std::vector<Ray*> left;
    for (Ray& ray : rays) left.push_back(&ray);
    while (!left.empty()) std::erase_if(left, [&](Ray* ray) { return !ray->live() || !ray->hop(look); });
    for (Ray& ray : rays) {
        auto source = source_of(ray);
        while (ray.live())
            if (!ray.hop(look)) see(voxels, look, ray, source);
    }
}

// The range in which strokes reach a ray: millimetres from the eye, `from` and `to`.
inline void find_reached(const Strokes& s, const Look& look, Ray& ray) {
    for (const Stroke& k : s.strokes) {
        double b = 0, d2 = 0;  // the way to the nearest point, and the pivot's distance from the eye
        for (int i = 0; i < 3; i++) {
            double r = k.pivot[i] - look.eye[i] * look.spacing[i];
            b += r * ray.along[i];
            d2 += r * r;
        }
        double half2 = k.reach * k.reach - (d2 - b * b);
        if (!(half2 > 0)) continue;
        ray.from = least(ray.from, b - root(half2));
        ray.to = most(ray.to, b + root(half2));
    }
}

// March along some rays at once, and invert the map at every sample that strokes reach: in lanes, each from the
// displacement of the ray's sample before.
template <class V>
void march_exactly(const V& voxels, const Look& look, const Strokes& s, std::vector<Ray>& rays) {
    std::vector<Ray*> left;
    for (Ray& ray : rays) {
        find_reached(s, look, ray);
        left.push_back(&ray);
    }
    while (true) {
        std::erase_if(left, [&](Ray* ray) {
            Still still;
            while (ray->live() && !ray->moved())
                if (!ray->hop(look)) see(voxels, look, *ray, still);
            return !ray->live();
        });
        const size_t count = left.size();
        if (count == 0) return;
        for (size_t i = 0; i < count; i += LANES) {
            Lanes q[3];
            Solution<3, Lanes> found{};
            for (int l = 0; l < LANES; l++) {
                const Ray& ray = *left[least(i + l, count - 1)];
                Double4 at = (ray.origin + ray.t * ray.way) * look.spacing;
                for (int c = 0; c < 3; c++) {
                    q[c][l] = at[c];
                    found.p[c][l] = at[c] + ray.shift[c];
                }
            }
            s.settle(q, EXACT * s.finest(), found);
            for (int l = 0; l < LANES && i + l < count; l++) {
                Ray& ray = *left[i + l];
                Float4 p{};
                for (int c = 0; c < 3; c++) {
                    ray.shift[c] = found.p[c][l] - q[c][l];
                    p[c] = float(found.p[c][l] / look.spacing[c]);
                }
                ray.steps += found.steps[l];
                Float4 sample = {0, 0, 0, 0};
                if (ray.within && look.shaded) {
                    Float4 f = voxels.slopes(p) * look.per_voxel;
                    for (int j = 0; j < 3; j++)
                        for (int c = 0; c < 3; c++) sample[j] += float(found.m[j][c][l]) * f[c];
                    sample[3] = f[3];
                } else
                    sample[3] = voxels.sample(p);
                ray.take(look, sample, [&](Float4 colour) { return voxels.painted(p, colour); });
            }
        }
    }
}

// ---- where a volume can be seen at all -----------------------------------------------------------------------------

// The smallest and the largest sample of each brick in layer c, of bricks that are `brick` voxels wide.
template <class T>
void ranges(const T* samples, const int64_t* n, int brick, const int64_t* bricks, int64_t c, float* lows,
            float* highs) {
    auto end = [&](int64_t at, int axis) { return least(at * brick + brick + 1, n[axis]); };
    for (int64_t b = 0; b < bricks[1]; b++)
        for (int64_t a = 0; a < bricks[0]; a++) {
            T low = std::numeric_limits<T>::max(), high = std::numeric_limits<T>::lowest();
            for (int64_t z = c * brick; z < end(c, 2); z++)
                for (int64_t y = b * brick; y < end(b, 1); y++)
                    for (int64_t x = a * brick; x < end(a, 0); x++) {
                        T value = samples[(z * n[1] + y) * n[0] + x];
                        low = least(low, value);
                        high = most(high, value);
                    }
            *lows++ = float(low);
            *highs++ = float(high);
        }
}

// The mean of a table's entries, by the samples of each block in layer c, of blocks that are `wide` voxels wide.
template <class T>
void block_means(const T* samples, const int64_t* n, const int64_t* wide, const int64_t* blocks, int64_t c,
                 const float* table, float last_entry, float low, float scale, float* out) {
    auto end = [&](int64_t at, int axis) { return least((at + 1) * wide[axis], n[axis]); };
    for (int64_t b = 0; b < blocks[1]; b++)
        for (int64_t a = 0; a < blocks[0]; a++) {
            float sum = 0;
            int count = 0;
            for (int64_t z = c * wide[2]; z < end(c, 2); z++)
                for (int64_t y = b * wide[1]; y < end(b, 1); y++)
                    for (int64_t x = a * wide[0]; x < end(a, 0); x++, count++) {
                        float entry = (float(samples[(z * n[1] + y) * n[0] + x]) - low) * scale;
                        sum += table[int32_t(least(most(entry, 0.0f), last_entry) + 0.5f)];
                    }
            *out++ = sum / float(count);
        }
}

// The distance of each brick to the nearest visible one, diagonals counting as one; at most 255. Forwards and
// backwards, from the finished neighbours: exact for this distance.
inline void distances(const bool* seen, const int64_t* n, uint8_t* out) {
    const int64_t total = n[0] * n[1] * n[2];
    for (int64_t i = 0; i < total; i++) out[i] = seen[i] ? 0 : 255;
    for (int way : {1, -1})
        for (int64_t i = 0; i < total; i++) {
            int64_t at = way > 0 ? i : total - 1 - i, a = at % n[0], b = at / n[0] % n[1], c = at / (n[0] * n[1]);
            for (int other = 0; other < 13 && out[at] > 1; other++) {  // of 27, in the order of memory
                int64_t x = a + way * (other % 3 - 1), y = b + way * (other / 3 % 3 - 1), z = c + way * (other / 9 - 1);
                if (x < 0 || x >= n[0] || y < 0 || y >= n[1] || z < 0 || z >= n[2]) continue;
                out[at] = uint8_t(least(int(out[at]), out[(z * n[1] + y) * n[0] + x] + 1));
            }
        }
}

// The largest part of what is seen, of voxels that touch by their faces; of equal ones, the first. It is found by
// marking all of them, and then marked alone: a label of each voxel would take eight times the memory.
inline void largest(const bool* seen, const int64_t* n, bool* out) {
    const int64_t strides[3] = {1, n[0], n[0] * n[1]}, total = strides[2] * n[2];
    std::vector<int64_t> front, next;
    // Mark the part around a voxel, front after front, and return the number of its voxels.
    auto mark = [&](int64_t first) {
        int64_t voxels = 0;
        out[first] = true;
        front.assign(1, first);
        while (!front.empty()) {
            voxels += int64_t(front.size());
            next.clear();
            for (int64_t at : front)
                for (int axis = 0; axis < 3; axis++) {
                    const int64_t place = at / strides[axis] % n[axis];
                    for (int way : {-1, 1}) {
                        if (place + way < 0 || place + way >= n[axis]) continue;
                        const int64_t beside = at + way * strides[axis];
                        if (!seen[beside] || out[beside]) continue;
                        out[beside] = true;
                        next.push_back(beside);
                    }
                }
            front.swap(next);
        }
        return voxels;
    };
    for (int64_t i = 0; i < total; i++) out[i] = false;
    int64_t best = -1, most_voxels = 0;
    for (int64_t first = 0; first < total; first++) {
        if (!seen[first] || out[first]) continue;
        const int64_t voxels = mark(first);
        if (voxels > most_voxels) best = first, most_voxels = voxels;
    }
    for (int64_t i = 0; i < total; i++) out[i] = false;
    if (best >= 0) mark(best);
}

// The bricks of the deformed volume that show any visible one of the original, by bounds of their displacement. Bricks
// of the original are `fine` voxels wide: narrower ones give closer bounds, as a displaced brick covers several.
// `slack` is the distance of points from the lattice's bounds, in voxels.
inline void moved(const Lattice& lattice, const bool* seen, const int64_t* n, int fine, float slack,
                  const int64_t* bricks, bool* out) {
    // Sums over all bricks before, so that any box of them is eight numbers.
    const int64_t row = n[0] + 1, layer = row * (n[1] + 1);
    std::vector<int64_t> sums(layer * (n[2] + 1));
    for (int64_t c = 0; c < n[2]; c++)
        for (int64_t b = 0; b < n[1]; b++) {
            int64_t* s = &sums[(c + 1) * layer + (b + 1) * row + 1];
            for (int64_t a = 0, line = 0; a < n[0]; a++, s++) {
                line += *seen++;
                *s = line + s[-row] + s[-layer] - s[-layer - row];
            }
        }
    const int64_t nodes[3] = {lattice.nx, lattice.ny, lattice.nz};
    const Float4 last_brick = {float(n[0] - 1), float(n[1] - 1), float(n[2] - 1), 0};
    for (int64_t e = 0; e < bricks[0] * bricks[1] * bricks[2]; e++) {
        const int64_t brick[3] = {e % bricks[0], e / bricks[0] % bricks[1], e / (bricks[0] * bricks[1])};
        int64_t first[3], last[3];  // of the nodes around it
        for (int i = 0; i < 3; i++) {
            first[i] = least(brick[i] * BRICK / lattice.step, nodes[i] - 1);
            last[i] = least((brick[i] * BRICK + BRICK + lattice.step - 1) / lattice.step, nodes[i] - 1);
        }
        Float4 low[4], high[4];  // of u and the columns of M
        for (int v = 0; v < 4; v++) low[v] = Float4{} + 1e30f, high[v] = Float4{} - 1e30f;
        for (int64_t k = first[2]; k <= last[2]; k++)
            for (int64_t j = first[1]; j <= last[1]; j++)
                for (int64_t i = first[0]; i <= last[0]; i++)
                    for (int v = 0; v < 4; v++) {
                        Float4 value = load<float, 4>(lattice.node(k, j, i) + 4 * v);
                        low[v] = least(low[v], value);
                        high[v] = most(high[v], value);
                    }
        // Add the slopes to the lines between nodes.
        Float4 bent = Float4{} + slack, corner = {float(brick[0]), float(brick[1]), float(brick[2]), 0};
        for (int v = 1; v < 4; v++) bent += 0.125f * lattice.step * (high[v] - low[v]);
        auto brick_at = [&](Float4 p) { return whole(least(most(p / float(fine), Float4{}), last_brick)); };
        Int4 from = brick_at(corner * BRICK + low[0] - bent),
             to = brick_at(corner * BRICK + BRICK + high[0] + bent) + 1;
        auto sum = [&](int z) {
            const int64_t* s = &sums[z * layer];
            return s[to[1] * row + to[0]] - s[from[1] * row + to[0]] - s[to[1] * row + from[0]] +
                   s[from[1] * row + from[0]];
        };
        out[e] = sum(to[2]) > sum(from[2]);
    }
}

}  // namespace supple
