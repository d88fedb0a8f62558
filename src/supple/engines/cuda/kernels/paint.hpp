// The kernels that fill planes: the point that each pixel is sampled at, from the patch of its cell or solved, and its
// colour. T is the type of the samples, N that of sums, C the number of channels that are summed together: 1 or 4.
#pragma once
#include "lattice.hpp"

namespace supple::cuda {

constexpr int MAP = 4;  // no filter: the points themselves are written, or their displacements if it is `average`

// Samples of 16 bits with a fraction.
struct Half {
    uint16_t bits;
    Half() = default;
    INLINE explicit Half(float x) {
        uint32_t u = as<uint32_t>(x), sign = u >> 16 & 0x8000, e = u & 0x7fffffff;
        if (e > 0x7f800000)
            bits = (uint16_t)(sign | 0x7e00);
        else if (e >= 0x477ff000)
            bits = (uint16_t)(sign | 0x7c00);
        else if (e < 0x38800000)  // below the normal ones: added to what has their spacing
            bits = (uint16_t)(sign | (as<uint32_t>(as<float>(e) + 0.5f) - 0x3f000000u));
        else
            bits = (uint16_t)(sign | ((e + 0xc8000fffu + (e >> 13 & 1)) >> 13));
    }
    INLINE operator float() const {
        uint32_t u = (uint32_t)(bits & 0x7fff) << 13, sign = (uint32_t)(bits & 0x8000) << 16;
        if (u >= 0x0f800000)
            u += 0x70000000;  // infinity, and what is no number
        else if (u >= 0x00800000)
            u += 0x38000000;
        else
            u = as<uint32_t>(as<float>(u + 0x38800000) - as<float>(0x38800000u));
        return as<float>(u | sign);
    }

private:
    template <class To, class From>
    static INLINE To as(From x) {
        union {
            From from;
            To to;
        } u;
        u.from = x;
        return u.to;
    }
};

// The limits of a type of samples; of real numbers, none.
template <class T>
struct Limits {
    static constexpr bool whole = T(0.5f) == T(0);
    static constexpr bool below = T(-1) < T(0);
    static constexpr double low = below ? -(double)(1ull << (8 * sizeof(T) - 1)) : 0;
};
template <>
struct Limits<Half> {
    static constexpr bool whole = false;
    static constexpr double low = 0;
};

// C numbers that are summed together.
template <class N, int C>
struct Sum {
    N v[C];
    INLINE Sum operator-(const Sum& o) const {
        Sum s;
        for (int c = 0; c < C; c++) s.v[c] = v[c] - o.v[c];
        return s;
    }
    INLINE Sum operator*(N by) const {
        Sum s;
        for (int c = 0; c < C; c++) s.v[c] = v[c] * by;
        return s;
    }
    INLINE friend Sum operator*(N by, const Sum& s) { return s * by; }
    INLINE Sum& operator+=(const Sum& o) {
        for (int c = 0; c < C; c++) v[c] += o.v[c];
        return *this;
    }
    INLINE void add(N by, const Sum& o) {
        for (int c = 0; c < C; c++) v[c] += by * o.v[c];
    }
};

// A group of channels: C colours, or three and the opacity that weights them.
template <class T, class N, int C>
struct Group {
    const Job& job;
    int first, some;  // the first colour, and their number

    INLINE N number(double v) const { return (N)(job.light ? job.white * to_light(v / job.white) : v); }
    INLINE Sum<N, C> read(const T* p) const {
        Sum<N, C> s{};
        N weight = 1;
        if (C > 1 && job.alpha >= 0) {
            s.v[C - 1] = (N)p[job.alpha * job.source.channel];
            weight = (N)(s.v[C - 1] / job.white);
        }
        for (int c = 0; c < C; c++)
            if (c < some) {
                const T v = p[(first + c) * job.source.channel];
                s.v[c] = weight * (job.light ? number((double)v) : (N)v);
            }
        return s;
    }
    INLINE Sum<N, C> constant() const {
        Sum<N, C> s{};
        N weight = 1;
        if (C > 1 && job.alpha >= 0) {
            s.v[C - 1] = (N)job.fill[job.alpha];
            weight = (N)(job.fill[job.alpha] / job.white);
        }
        for (int c = 0; c < C; c++)
            if (c < some) s.v[c] = weight * number(job.fill[first + c]);
        return s;
    }
    INLINE T rounded(double v) const {
        if constexpr (Limits<T>::whole) {
            v = floored(v + 0.5);
            if (!(v > Limits<T>::low)) return v == v ? (T)Limits<T>::low : T(0);
            if (v >= job.high)
                return job.high >= 18446744073709551615.0  ? T(-1)
                       : job.high >= 9223372036854775807.0 ? T(9223372036854775807ll)
                                                           : (T)job.high;
            return (T)v;
        } else
            return (T)v;
    }
    INLINE void write(const Sum<N, C>& s, T* p) const {
        double opacity = 0;
        if (C > 1 && job.alpha >= 0) {
            // A cubic overshoots: opacity is clamped, and colours are divided by what is not.
            opacity = s.v[C - 1];
            p[job.alpha * job.out.channel] = rounded(within(opacity, 0, job.white));
        }
        for (int c = 0; c < C; c++)
            if (c < some) {
                double v = s.v[c];
                if (C > 1 && job.alpha >= 0) v = opacity > 0 ? v * job.white / opacity : 0;
                if (job.light) v = job.white * from_light(v / job.white);
                p[(first + c) * job.out.channel] = rounded(v);
            }
    }
};

// Where samples around a pixel are in a frame: sample (x, y) is at row[y] + column[x]; null for the constant.
template <class T, class N, int C>
struct Frame {
    const Group<T, N, C>& group;
    const T* first;  // or null, for the constant

    INLINE Sum<N, C> at(int x, int y) const {
        const Job& job = group.job;
        x = placed(x, job.w, job.rule);
        y = placed(y, job.h, job.rule);
        if (!first || x < 0 || y < 0) return group.constant();
        return group.read(first + y * job.source.row + x * job.source.column);
    }
    // Σ_j d_j Σ_i a_i f(x + i, y + j)
    template <int TAPS>
    INLINE Sum<N, C> window(int x, int y, const N* across, const N* down) const {
        const Job& job = group.job;
        Sum<N, C> sum{};
        const bool inside = first && x >= 0 && y >= 0 && x + TAPS <= job.w && y + TAPS <= job.h;
        const T* row = inside ? first + y * job.source.row + x * job.source.column : first;
        for (int j = 0; j < TAPS; j++) {
            Sum<N, C> along{};
            for (int i = 0; i < TAPS; i++)
                along.add(across[i], inside ? group.read(row + i * job.source.column) : at(x + i, y + j));
            sum.add(down[j], along);
            if (inside) row += job.source.row;
        }
        return sum;
    }
};

// A level of a pyramid, whose samples are averages of 2ᵏ × 2ᵏ, made as they are read; an odd edge repeats its last one.
template <class T, class N, int C>
struct Level {
    const Frame<T, N, C>& frame;
    int k;

    INLINE int side(int n) const { return (int)(((int64_t)n + (1 << k) - 1) >> k); }
    INLINE Sum<N, C> at(int x, int y) const {
        if (k == 0) return frame.at(x, y);
        const Job& job = frame.group.job;
        x = placed(x, side(job.w), job.rule);
        y = placed(y, side(job.h), job.rule);
        if (x < 0 || y < 0) return frame.group.constant();
        Sum<N, C> sum{};
        // Of larger squares, 16 × 16 samples that are spread evenly.
        const int many = 1 << (k < 4 ? k : 4), apart = (1 << k) / many;
        for (int j = 0; j < many; j++) {
            const int v = member(y, j * apart + apart / 2, job.h);
            for (int i = 0; i < many; i++) sum += frame.at(member(x, i * apart + apart / 2, job.w), v);
        }
        return sum * (N(1) / (many * many));
    }
    // The n-th of the samples of one of this level.
    INLINE int member(int i, int n, int count) const {
        for (int finer = k - 1; finer >= 0; finer--) {
            const int last = (int)(((int64_t)count + (1 << finer) - 1) >> finer) - 1;
            i = 2 * i + (n >> finer & 1);
            i = i < last ? i : last;
        }
        return i;
    }
    INLINE Sum<N, C> spot(int x, int y, Across<N> across, const N* left, const N* right) const {
        N first[WINDOW], second[WINDOW];
        for (int i = 0; i < WINDOW; i++) {
            const int j = i - across.shift;
            first[i] = i < 4 ? N(0.5) * keys(i, across.first) : 0;
            second[i] = j >= 0 && j < 4 ? N(0.5) * keys(j, across.second) : 0;
        }
        Sum<N, C> sum{};
        for (int j = 0; j < WINDOW; j++) {
            Sum<N, C> a{}, b{};
            for (int i = 0; i < WINDOW; i++) {
                const Sum<N, C> v = at(x - 1 + i, y - 1 + j);
                a.add(first[i], v);
                b.add(second[i], v);
            }
            sum.add(left[j], a);
            sum.add(right[j], b);
        }
        return sum;
    }
};
template <class T, class N, int C>
struct Levels {
    const Frame<T, N, C>& frame;
    int count;
    template <class Use>
    INLINE Sum<N, C> in(int k, Use use) const {
        return use(Level<T, N, C>{frame, k});
    }
};

// The number of levels that an image may need.
INLINE int levels_of(const Job& job) {
    int levels = 0;
    for (int side = job.w > job.h ? job.w : job.h; side > 1 && levels < LEVELS; side = (side + 1) / 2) levels++;
    return levels;
}

// One frame at a point.
template <class T, class N, int C, int FILTER, int D>
INLINE Sum<N, C> in_frame(const Frame<T, N, C>& frame, const Point<D>& p, const Print& print) {
    const int x = p.whole[0], y = p.whole[1];
    const N u = p.part[0], v = p.part[1];
    if constexpr (FILTER == LINEAR) {
        const N across[2] = {1 - u, u}, down[2] = {1 - v, v};
        return frame.template window<2>(x, y, across, down);
    } else {
        if (FILTER == AUTO && print.kind == SPOT) {
            N left[WINDOW], right[WINDOW];
            for (int j = 0; j < WINDOW; j++) {
                left[j] = print.left[j];
                right[j] = print.right[j];
            }
            const Across<N> across{print.across.first, print.across.second, print.across.shift};
            return Level<T, N, C>{frame, 0}.spot(print.x, print.y, across, left, right);
        }
        if (FILTER == AUTO && print.kind == WIDE) {
            const N xx = p.across[0] * p.across[0] + p.down[0] * p.down[0],
                    xy = p.across[0] * p.across[1] + p.down[0] * p.down[1],
                    yy = p.across[1] * p.across[1] + p.down[1] * p.down[1];
            return wide<Sum<N, C>>(Levels<T, N, C>{frame, levels_of(frame.group.job)}, x + u, y + v, xx, xy, yy);
        }
        N across[4], down[4];
        for (int i = 0; i < 4; i++) {
            across[i] = keys(i, u);
            down[i] = keys(i, v);
        }
        return frame.template window<4>(x - 1, y - 1, across, down);
    }
}

// Frame k of the source, or null for the constant.
template <class T>
INLINE const T* frame_of(const Job& job, int k) {
    k = placed(k, job.count, job.rule);
    return k < 0 ? nullptr : (const T*)job.source.first + (k - job.held_from) * job.source.plane;
}

// Paint the pixel (x, y) of a plane, `to` which it is written.
template <class T, class N, int C, int FILTER, int D>
INLINE void paint(const Job& job, int plane, int x, int y, const Point<D>& p, T* to) {
    const int own = job.first + plane;
    if constexpr (FILTER == MAP) {
        const int at[3] = {x, y, own};
        for (int d = 0; d < D; d++) {
            const double moved = p.same ? 0.0 : (double)(p.whole[d] - at[d]) + p.part[d];
            to[d * job.out.channel] = (T)(job.average ? moved : at[d] + moved);
        }
    } else {
        const T* here = (const T*)job.source.first + (own - job.held_from) * job.source.plane;
        if (p.same) {
            const T* from = here + y * job.source.row + x * job.source.column;
            for (int c = 0; c < job.channels; c++) to[c * job.out.channel] = from[c * job.source.channel];
            return;
        }
        if constexpr (FILTER == NEAREST) {
            const int u = placed(p.whole[0] + (p.part[0] >= 0.5f), job.w, job.rule);
            const int v = placed(p.whole[1] + (p.part[1] >= 0.5f), job.h, job.rule);
            if constexpr (D == 3) here = frame_of<T>(job, p.whole[2] + (p.part[2] >= 0.5f));
            const bool fills = u < 0 || v < 0 || !here;
            const T* from = fills ? nullptr : here + v * job.source.row + u * job.source.column;
            const Group<T, N, C> group{job, 0, 0};
            for (int c = 0; c < job.channels; c++)
                to[c * job.out.channel] = fills ? group.rounded(job.fill[c]) : from[c * job.source.channel];
        } else {
            Print print{};
            if constexpr (FILTER == AUTO) {
                const float xx = p.across[0] * p.across[0] + p.down[0] * p.down[0],
                            xy = p.across[0] * p.across[1] + p.down[0] * p.down[1],
                            yy = p.across[1] * p.across[1] + p.down[1] * p.down[1];
                if (shrinks(xx, xy, yy)) print = print_of(xx, xy, yy, p.whole[0], p.whole[1], p.part[0], p.part[1]);
            }
            const int colours = job.alpha < 0 ? job.channels : job.channels - 1, each = job.alpha < 0 ? C : C - 1;
            for (int first = 0; first < colours; first += each) {
                const Group<T, N, C> group{job, first, colours - first < each ? colours - first : each};
                if constexpr (D == 2)
                    group.write(in_frame<T, N, C, FILTER, D>(Frame<T, N, C>{group, here}, p, print), to);
                else {
                    double t = p.whole[2] + (double)p.part[2], width = job.average ? covered(p.rate2) : 0;
                    if (job.rule != REFLECT) t = within(t, -3 - LONGEST / 2, job.count + 2 + LONGEST / 2);
                    int from;
                    const int n = frames_at(job.between, t, width, from);
                    Sum<N, C> sum{};
                    for (int k = 0; k < n; k++) {
                        const N weight = (N)time_weight(job.between, t, width, from, k);
                        const Frame<T, N, C> frame{group, frame_of<T>(job, from + k)};
                        sum.add(weight, frame.first ? in_frame<T, N, C, FILTER, D>(frame, p, print) : group.constant());
                    }
                    group.write(sum, to);
                }
            }
        }
    }
}

template <class T>
INLINE T* target(const Job& job, int plane, int x, int y) {
    return (T*)job.out.first + plane * job.out.plane + (y - job.from_y) * job.out.row +
           (x - job.from_x) * job.out.column;
}

// A column of the pixels of a cell that is not rough: the powers of s are summed once for it.
template <class T, class N, int C, int FILTER, int D>
INLINE void fill_column(const Job& job) {
    const int x = job.from_x + (int)thread(), j = blockIdx.y, plane = blockIdx.z;
    if (x >= job.from_x + job.width) return;
    const int wide = job.nx - 1, tall = job.ny - 1;
    int k = (int)((int64_t)(x - job.from_x) * wide / job.width);  // near it
    while (k > 0 && job.xs[k] > x) k--;
    while (k < wide - 1 && job.xs[k + 1] <= x) k++;
    const int64_t cell = ((int64_t)(job.shared ? 0 : plane) * tall + j) * wide + k;
    const int state = job.states[cell];
    if (state >= 0) return;
    const int top = job.ys[j], bottom = j == tall - 1 ? job.from_y + job.height : job.ys[j + 1];
    const Map& map = map_of(job, plane);
    Point<D> p;
    p.same = true;
    if (state == STILL) {
        for (int y = top; y < bottom; y++) paint<T, N, C, FILTER, D>(job, plane, x, y, p, target<T>(job, plane, x, y));
        return;
    }
    const Leaf<D>& leaf = ((const Leaf<D>*)job.leaves)[cell];
    const float s = (float)(x - leaf.x);
    float a[D][4], b[D][4];  // of p, and of ∂p/∂s: powers of t
    for (int d = 0; d < D; d++)
        for (int i = 0; i < 4; i++) {
            const float* c = leaf.c[d] + 4 * i;
            a[d][i] = c[0] + s * (c[1] + s * (c[2] + s * c[3]));
            b[d][i] = c[1] + s * (2 * c[2] + 3 * s * c[3]);
        }
    for (int y = top; y < bottom; y++) {
        const float t = (float)(y - leaf.y);
        p.same = false;
        if (state == RIM) {
            const double at[3] = {x * map.axes[0].spacing, y * map.axes[1].spacing,
                                  depth_of(job, plane) * map.axes[2].spacing};
            p.same = unmoved<D>(map, at);
        }
        for (int d = 0; d < D; d++) {
            const float at = least(most(a[d][0] + t * (a[d][1] + t * (a[d][2] + t * a[d][3])), -1e9f), 1e9f);
            const float whole = floored(at);
            p.whole[d] = (int)whole + leaf.anchor[d];
            p.part[d] = at - whole;
        }
        // On a fixed face there is no displacement across it.
        const int pixel[2] = {x, y};
        for (int d = 0; d < 2; d++)
            if (map.axes[d].fixed() && !composed(map) && pixel[d] * map.axes[d].spacing >= map.axes[d].last) {
                p.whole[d] = pixel[d];
                p.part[d] = 0;
            }
        if (FILTER == AUTO || D == 3) {
            float rate2 = 0;
            for (int d = 0; d < D; d++) {
                const float across = b[d][0] + t * (b[d][1] + t * (b[d][2] + t * b[d][3]));
                const float down = a[d][1] + t * (2 * a[d][2] + 3 * t * a[d][3]);
                if (d < 2) {
                    p.across[d] = across;
                    p.down[d] = down;
                } else
                    rate2 = across * across + down * down;
            }
            const float own = leaf.depth[0] + s * leaf.depth[1] + t * (leaf.depth[2] + s * leaf.depth[3]);
            p.rate2 = rate2 + own * own;
        }
        paint<T, N, C, FILTER, D>(job, plane, x, y, p, target<T>(job, plane, x, y));
    }
}

// The pixels of rough cells, one of which is a block's at a time.
template <class T, class N, int C, int FILTER, int D>
INLINE void fill_rough(const Job& job) {
    for (int k = blockIdx.x; k < job.told->rough; k += gridDim.x) {
        const Pixels cell = pixels_of(job, job.rough[k]);
        for (int n = threadIdx.x; n < cell.w * cell.h; n += blockDim.x) {
            const int x = cell.x + n % cell.w, y = cell.y + n / cell.w;
            Point<D> p;
            solve_pixel<D>(job, cell.plane, x, y, p);
            const int from = job.shared ? 0 : cell.plane, end = job.shared ? job.shared : cell.plane + 1;
            for (int plane = from; plane < end; plane++)
                paint<T, N, C, FILTER, D>(job, plane, x, y, p, target<T>(job, plane, x, y));
        }
    }
}

}  // namespace supple::cuda
