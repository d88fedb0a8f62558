// The kernels that fill planes: the source point of each pixel, from the patch of its cell or solved, and its colour. T
// is the type of the samples, N that of sums, C the number of channels that are summed together: all of them, 1 or 3,
// or up to 4, one of which may be opacity.
#pragma once
#include "lattice.hpp"

namespace supple::cuda {

constexpr int GROUPED = 4;  // channels that are summed together, for any number of channels, and opacity
constexpr int MAP = 4;      // no filter: the points themselves are written, or, with `average`, their displacements

template <class T>
constexpr bool WHOLE = T(0.5f) == T(0);
template <>
constexpr bool WHOLE<Half> = false;

// C numbers that are summed together.
template <class N, int C>
struct Sum {
    N v[C];
    INLINE Sum& add(N by, const Sum& o) {
        for (int c = 0; c < C; c++) v[c] += by * o.v[c];
        return *this;
    }
    INLINE Sum& operator+=(const Sum& o) { return add(1, o); }
    INLINE Sum operator-(const Sum& o) const { return Sum(*this).add(-1, o); }
    INLINE Sum operator*(N by) const { return Sum{}.add(by, *this); }
    INLINE friend Sum operator*(N by, const Sum& s) { return s * by; }
};

// Weights of RANK products of TAPS columns and rows.
template <class N, int RANK, int TAPS>
struct Taps {
    static constexpr int before = TAPS / 2 - 1;  // samples before the point
    N across[RANK][TAPS], down[RANK][TAPS];
};

// A group of channels: C colours, or three and the opacity that weights them.
template <class T, class N, int C>
struct Group {
    const Job& job;
    int first, some;  // the first colour, and their number

    // The sum with `value(c)` of each channel.
    template <class Value>
    INLINE Sum<N, C> sum_of(Value value) const {
        Sum<N, C> s{};
        N weight = 1;
        if (C == GROUPED && job.alpha >= 0) {
            s.v[C - 1] = (N)value(job.alpha);
            weight = s.v[C - 1] / (N)job.white;
        }
        for (int c = 0; c < C; c++)
            if (C != GROUPED || c < some) {
                const auto v = value(first + c);
                s.v[c] = weight * (in_light(job) ? (N)(job.white * to_light((double)v / job.white)) : (N)v);
            }
        return s;
    }
    INLINE Sum<N, C> read(const T* p) const {
        return sum_of([&](int c) { return sample_at(p + source_at(job, 0, 0, 0, c)); });
    }
    // Σ_r Σ_j d_rj Σ_i a_ri f(i, j)
    template <int RANK, int TAPS, class Sample>
    INLINE Sum<N, C> summed(const Taps<N, RANK, TAPS>& taps, Sample sample) const {
        Sum<N, C> sum{};
        for (int j = 0; j < TAPS; j++) {
            Sum<N, C> along[RANK] = {};
            for (int i = 0; i < TAPS; i++) {
                const Sum<N, C> v = sample(i, j);
                for (int r = 0; r < RANK; r++) along[r].add(taps.across[r][i], v);
            }
            for (int r = 0; r < RANK; r++) sum.add(taps.down[r][j], along[r]);
        }
        return sum;
    }
    // An address for each row: of an offset for each sample, NVRTC 13.0 made those of other samples in some kernels.
    template <int RANK, int TAPS>
    INLINE Sum<N, C> summed(const T* first, const Taps<N, RANK, TAPS>& taps) const {
        return summed(taps,
                      [&](int i, int j) { return read(first + source_at(job, 0, j, 0) + source_at(job, 0, 0, i)); });
    }
    INLINE Sum<N, C> constant() const {
        return sum_of([&](int c) { return job.fill[c]; });
    }
    INLINE T rounded(N v) const {
        if constexpr (WHOLE<T>) {
            constexpr N low = T(-1) < T(0) ? -(N)(1ull << (8 * sizeof(T) - 1)) : 0;
            v = floored(v + N(0.5));
            if (v >= (N)job.high) return (T)job.top;
            if (v <= low) return (T)low;
            return v == v ? (T)v : T(0);
        } else
            return (T)v;
    }
    INLINE void write(const Sum<N, C>& s, T* p) const {
        N opacity = 0;
        if (C == GROUPED && job.alpha >= 0) {
            // A cubic overshoots: clamp opacity, but divide colours by the unclamped value.
            opacity = s.v[C - 1];
            p[out_at(job, 0, 0, 0, job.alpha)] = rounded(least(most(opacity, N(0)), (N)job.white));
        }
        for (int c = 0; c < C; c++)
            if (C != GROUPED || c < some) {
                N v = s.v[c];
                if (C == GROUPED && job.alpha >= 0) v = opacity > 0 ? v * (N)job.white / opacity : 0;
                if (in_light(job)) v = (N)(job.white * from_light((double)v / job.white));
                p[out_at(job, 0, 0, 0, first + c)] = rounded(v);
            }
    }
};

// Call use(group) with each group of the channels.
template <class T, class N, int C, class Use>
INLINE void each_group(const Job& job, Use use) {
    if (C != GROUPED) return use(Group<T, N, C>{job, 0, C});
    const bool opaque = job.alpha < 0;
    const int colours = opaque ? job.channels : job.channels - 1, each = opaque ? C : C - 1;
    for (int first = 0; first < colours; first += each)
        use(Group<T, N, C>{job, first, colours - first < each ? colours - first : each});
}

// A frame, or the fill value if there is none; or a level of its pyramid, whose samples are averages of 2ᵏ × 2ᵏ,
// computed when they are read; an odd edge repeats its last sample. There are up to `count` levels.
template <class T, class N, int C>
struct Level {
    const Group<T, N, C>& group;
    const T* frame;  // or null
    int k = 0, count = 0;

    INLINE static int side(int n, int k) { return (int)(((int64_t)n + (1 << k) - 1) >> k); }
    INLINE Sum<N, C> at(int x, int y) const {
        const Job& job = group.job;
        x = placed(x, side(job.w, k), job.rule);
        y = placed(y, side(job.h, k), job.rule);
        if (!frame || x < 0 || y < 0) return group.constant();
        Sum<N, C> sum{};
        // For larger squares, average 16 × 16 evenly spaced samples.
        const int many = 1 << (k < 4 ? k : 4), apart = (1 << k) / many;
        for (int j = 0; j < many; j++) {
            const T* row = frame + source_at(job, 0, member(y, j * apart + apart / 2, job.h), 0);
            for (int i = 0; i < many; i++)
                sum += group.read(row + source_at(job, 0, 0, member(x, i * apart + apart / 2, job.w)));
        }
        return sum * (N(1) / (many * many));
    }
    // The n-th source sample, along an axis, of a sample of this level.
    INLINE int member(int i, int n, int count) const {
        for (int finer = k - 1; finer >= 0; finer--) i = least(2 * i + (n >> finer & 1), side(count, finer) - 1);
        return i;
    }
    // A function call, so that the few pixels that need it cost the others no registers.
    template <int RANK, int TAPS>
    NOINLINE static Sum<N, C> at_an_edge(const Group<T, N, C>& group, const T* frame, int k, int x, int y,
                                         const Taps<N, RANK, TAPS>& taps) {
        const Level level{group, frame, k};
        return level.group.summed(taps, [&](int i, int j) { return level.at(x + i, y + j); });
    }
    template <int RANK, int TAPS>
    INLINE Sum<N, C> window(int x, int y, const Taps<N, RANK, TAPS>& taps) const {
        const Job& job = group.job;
        if (k == 0 && frame && x >= 0 && y >= 0 && x + TAPS <= job.w && y + TAPS <= job.h)
            return group.summed(frame + source_at(job, 0, y, x), taps);
        return at_an_edge(group, frame, k, x, y, taps);
    }
    template <class W>
    INLINE Sum<N, C> spot(int x, int y, Across<W> at, const W* left, const W* right) const {
        Taps<N, 2, WINDOW> taps;
        for (int i = 0; i < WINDOW; i++) {
            const int j = i - at.shift;
            taps.across[0][i] = i < 4 ? N(0.5) * keys(i, N(at.first)) : 0;
            taps.across[1][i] = j >= 0 && j < 4 ? N(0.5) * keys(j, N(at.second)) : 0;
        }
        widen(left, 1, taps.down[0]);
        widen(right, 1, taps.down[1]);
        return window(x - 1, y - 1, taps);
    }
    template <class W>
    INLINE Sum<N, C> spots(int k, int n, W x, W y, W ux, W uy, W length, W w2) const {
        return supple::spots<Sum<N, C>>(Level{group, frame, k}, n, x, y, ux, uy, length, w2);
    }
};

// An element of S = MMᵀ, where M is in the plane.
template <int D>
INLINE float square(const Point<D>& p, int i, int j) {
    return p.across[i] * p.across[j] + p.down[i] * p.down[j];
}

// The weights of the samples around a point, without a footprint.
template <class N, int FILTER, int D>
INLINE auto taps_of(const Point<D>& p) {
    constexpr int TAPS = FILTER == LINEAR ? 2 : 4;
    const N u = p.part[0], v = p.part[1];
    Taps<N, 1, TAPS> taps;
    for (int i = 0; i < TAPS; i++) {
        taps.across[0][i] = FILTER == LINEAR ? (i ? u : 1 - u) : keys(i, u);
        taps.down[0][i] = FILTER == LINEAR ? (i ? v : 1 - v) : keys(i, v);
    }
    return taps;
}

// Sample one frame at a point.
template <class T, class N, int C, int FILTER, int D>
INLINE Sum<N, C> in_frame(const Level<T, N, C>& frame, const Point<D>& p, const Print& print) {
    const int x = p.whole[0], y = p.whole[1];
    const N u = p.part[0], v = p.part[1];
    if (FILTER == AUTO && print.kind == SPOT)
        return frame.spot(print.x, print.y, print.across, print.left, print.right);
    if (FILTER == AUTO && print.kind == WIDE) {
        Level<T, N, C> levels = frame;
        const int side = frame.group.job.w > frame.group.job.h ? frame.group.job.w : frame.group.job.h;
        while (levels.count < LEVELS && levels.side(side, levels.count) > 1) levels.count++;
        return wide<Sum<N, C>>(levels, x + u, y + v, N(square(p, 0, 0)), N(square(p, 0, 1)), N(square(p, 1, 1)));
    }
    const auto taps = taps_of<N, FILTER>(p);
    return frame.window(x - taps.before, y - taps.before, taps);
}

// Frame k of the source, which must be in memory.
template <class T>
INLINE const T* frame_at(const Job& job, int k) {
    return (const T*)job.source.first + source_at(job, k - job.held_from, 0, 0);
}
// Frame k of the source, or null for the fill value.
template <class T>
INLINE const T* frame_of(const Job& job, int k) {
    k = placed(k, job.count, job.rule);
    return k < 0 ? nullptr : frame_at<T>(job, k);
}

// Sample all frames that a pixel covers.
template <class T, class N, int C, int FILTER>
INLINE Sum<N, C> in_time(const Group<T, N, C>& group, const Point<3>& p, const Print& print) {
    const Job& job = group.job;
    Sum<N, C> sum{};
    auto add = [&](int k, N weight) {
        const Level<T, N, C> frame{group, frame_of<T>(job, k)};
        sum.add(weight, frame.frame ? in_frame<T, N, C, FILTER>(frame, p, print) : group.constant());
    };
    const int between = between_of(job);
    const double width = averages(job) ? covered(p.rate2) : 0;
    if (averages(job) && width > 1e-3) {
        double t = p.whole[2] + (double)p.part[2];
        if (job.rule != REFLECT) t = within(t, -3 - LONGEST / 2, job.count + 2 + LONGEST / 2);
        int first;
        const int n = frames_at(between, t, width, first);
        for (int k = 0; k < n; k++) add(first + k, (N)time_weight(between, t, width, first, k));
    } else if (between == BETWEEN_NEAREST)
        add(p.whole[2] + (p.part[2] >= 0.5f), 1);
    else {
        const int up = p.part[2] >= 1;  // a time just before a frame, rounded up to it
        const N f = p.part[2] - (float)up;
        const int before = between == BETWEEN_CUBIC, count = 2 + 2 * before;
        for (int k = 0; k < count; k++)
            if (k == before || f != 0) add(p.whole[2] + up - before + k, f != 0 ? tap(between, f, k) : 1);
    }
    return sum;
}

// The pixel (x, y) of a plane of the output.
template <class T>
INLINE T* pixel_of(const Job& job, int plane, int x, int y) {
    return (T*)job.out.first + out_at(job, plane, y - job.from_y, x - job.from_x);
}

// Paint the pixel (x, y) of a plane at the address `to`.
template <class T, class N, int C, int FILTER, int D>
INLINE void paint(const Job& job, int plane, int x, int y, const Point<D>& p, T* to) {
    const int own = job.first + plane;
    if constexpr (FILTER == MAP) {
        const int at[3] = {x, y, own};
        for (int d = 0; d < D; d++) {
            const double moved = p.same ? 0.0 : (double)(p.whole[d] - at[d]) + p.part[d];
            to[out_at(job, 0, 0, 0, d)] = (T)(averages(job) ? moved : at[d] + moved);
        }
    } else {
        const T* here = frame_at<T>(job, own);
        if (p.same) {
            const T* from = here + source_at(job, 0, y, x);
            for (int c = 0; c < job.channels; c++) to[out_at(job, 0, 0, 0, c)] = from[source_at(job, 0, 0, 0, c)];
            return;
        }
        if constexpr (FILTER == NEAREST) {
            const int u = placed(p.whole[0] + (p.part[0] >= 0.5f), job.w, job.rule);
            const int v = placed(p.whole[1] + (p.part[1] >= 0.5f), job.h, job.rule);
            if constexpr (D == 3) here = frame_of<T>(job, p.whole[2] + (p.part[2] >= 0.5f));
            const bool fills = u < 0 || v < 0 || !here;
            const T* from = fills ? nullptr : here + source_at(job, 0, v, u);
            const Group<T, N, C> group{job, 0, 0};
            for (int c = 0; c < job.channels; c++)
                to[out_at(job, 0, 0, 0, c)] = fills ? group.rounded(job.fill[c]) : from[source_at(job, 0, 0, 0, c)];
        } else {
            Print print{};
            if constexpr (FILTER == AUTO) {
                const float xx = square(p, 0, 0), xy = square(p, 0, 1), yy = square(p, 1, 1);
                if (shrinks(xx, xy, yy)) {
                    float sx, sy, rho;
                    const int kind = spread_of(xx, xy, yy, sx, sy, rho);
                    print = print_of(kind, sx, sy, rho, p.whole[0], p.whole[1], p.part[0], p.part[1]);
                }
            }
            each_group<T, N, C>(job, [&](const Group<T, N, C>& group) {
                if constexpr (D == 2)
                    group.write(in_frame<T, N, C, FILTER>(Level<T, N, C>{group, here}, p, print), to);
                else
                    group.write(in_time<T, N, C, FILTER>(group, p, print), to);
            });
        }
    }
}

// Paint a pixel if it has no footprint, and all its samples are in the frame, so that they load independently.
template <class T, class N, int C, int FILTER, int D>
INLINE bool paint_inside(const Job& job, int plane, const Point<D>& p, T* to) {
    if (FILTER == AUTO && shrinks(square(p, 0, 0), square(p, 0, 1), square(p, 1, 1))) return false;
    const auto taps = taps_of<N, FILTER>(p);
    constexpr int TAPS = 2 * taps.before + 2;
    const int x = p.whole[0] - taps.before, y = p.whole[1] - taps.before, between = between_of(job);
    const int before = between == BETWEEN_CUBIC, count = 2 + 2 * before;
    int z = job.first + plane;
    N f = 0;
    if constexpr (D == 3) {
        if (between == BETWEEN_NEAREST || (averages(job) && covered(p.rate2) > 1e-3)) return false;
        f = p.part[2];
        z = p.whole[2];
        if (f >= 1 || z < before * (f != 0) || z + (count - before - 1) * (f != 0) >= job.count) return false;
    }
    // As unsigned numbers, negative ones are large.
    const unsigned wide = most(job.w - TAPS + 1, 0), tall = most(job.h - TAPS + 1, 0);
    if ((unsigned)x >= wide || (unsigned)y >= tall) return false;
    const T* from = (const T*)job.source.first + source_at(job, z - job.held_from, y, x);
    each_group<T, N, C>(job, [&](const Group<T, N, C>& group) {
        Sum<N, C> sum{};
        if (D == 2 || f == 0)
            sum = group.summed(from, taps);
        else
            for (int k = 0; k < count; k++)
                sum.add(tap(between, f, k), group.summed(from + source_at(job, k - before, 0, 0), taps));
        group.write(sum, to);
    });
    return true;
}

// A column of the pixels of a cell that is not rough: the powers of s are summed once for it.
template <int D>
struct Column {
    int x, state, top, bottom, anchor[D] = {}, face[2];
    float a[D][4], b[D][4], depth[2];  // powers of t of p and ∂p/∂s

    INLINE Column(const Job& job, int plane, int x, int j, int k, int64_t cell)
        : x(x),
          state(job.states[cell]),
          top(job.ys[j]),
          bottom(j == job.ny - 2 ? job.from_y + job.height : job.ys[j + 1]) {
        if (state == STILL) return;  // it has no patch
        using L = LeafRecord<D>;
        const L leaf(job.leaves, cell);
        const float s = (float)(x - job.xs[k]);
        for (int d = 0; d < D; d++) {
            anchor[d] = leaf.whole(L::ANCHOR + d);
            for (int i = 0; i < 4; i++) {
                float c[4];
                for (int n = 0; n < 4; n++) c[n] = leaf[L::C + 16 * d + 4 * i + n];
                a[d][i] = c[0] + s * (c[1] + s * (c[2] + s * c[3]));
                b[d][i] = c[1] + s * (2 * c[2] + 3 * s * c[3]);
            }
        }
        for (int i = 0; D == 3 && i < 2; i++) depth[i] = leaf[L::DEPTH + 2 * i] + s * leaf[L::DEPTH + 2 * i + 1];
        // On a fixed face there is no displacement across it.
        const Map& map = map_of(job, plane);
        for (int d = 0; d < 2; d++) {
            const int last = d ? bottom - 1 : x;
            const bool on = map.axes[d].fixed() && !composed(map) && last * map.axes[d].spacing >= map.axes[d].last;
            face[d] = on ? last : -1;
        }
    }
    // The source point of a moved pixel; with its derivatives, if `derivatives`.
    INLINE Point<D> at(int y, bool derivatives) const {
        const float t = (float)(y - top);
        Point<D> p;
        p.same = false;
        for (int d = 0; d < D; d++) {
            const float at = a[d][0] + t * (a[d][1] + t * (a[d][2] + t * a[d][3]));
            const int whole = whole_of(at);
            p.whole[d] = whole + anchor[d];
            p.part[d] = at - (float)whole;
        }
        for (int d = 0; d < 2; d++)
            if (face[d] == (d ? y : x)) {
                p.whole[d] = face[d];
                p.part[d] = 0;
            }
        if (!derivatives) return p;
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
        const float own = depth[0] + t * depth[1];
        p.rate2 = rate2 + own * own;
        return p;
    }
};

// Paint some rows of a column. A function call, so that most pixels do not need its registers.
template <class T, class N, int C, int FILTER, int D>
NOINLINE void paint_rest(const Job& job, int plane, int x, int j, int k, int64_t cell, int from, int to_row) {
    const Column<D> column(job, plane, x, j, k, cell);
    T* to = pixel_of<T>(job, plane, x, from);
    for (int y = from; y < to_row; y++, to += (Step)job.out.row) {
        Point<D> p;
        p.same = column.state == STILL || (column.state == RIM && unmoved<D>(job, plane, x, y));
        if (!p.same) p = column.at(y, FILTER == AUTO || averages(job));
        paint<T, N, C, FILTER>(job, plane, x, y, p, to);
    }
}

template <class T, class N, int C, int FILTER, int D>
INLINE void fill_column(const Job& job) {
    const int x = job.from_x + (int)thread(), j = blockIdx.y, plane = blockIdx.z;
    if (x >= job.from_x + job.width) return;
    const int wide = job.nx - 1;
    int k = least((int)((float)(x - job.from_x) * wide / job.width), wide - 1);  // near it
    while (k > 0 && job.xs[k] > x) k--;
    while (k < wide - 1 && job.xs[k + 1] <= x) k++;
    const int64_t cell = ((int64_t)(job.shared ? 0 : plane) * (job.ny - 1) + j) * wide + k;
    const int state = job.states[cell];
    if (state >= 0) return;
    int from = job.ys[j], end = j == job.ny - 2 ? job.from_y + job.height : job.ys[j + 1];
    if constexpr (FILTER != NEAREST && FILTER != MAP)
        if (state == GOOD) {
            const Column<D> column(job, plane, x, j, k, cell);
            T* to = pixel_of<T>(job, plane, x, column.top);
            from = column.bottom;  // the range of rows that are left
            end = column.top;
            for (int y = column.top; y < column.bottom; y++, to += (Step)job.out.row) {
                const Point<D> p = column.at(y, FILTER == AUTO || averages(job));
                if (!paint_inside<T, N, C, FILTER>(job, plane, p, to)) {
                    from = least(from, y);
                    end = y + 1;
                }
            }
        }
    if (from < end) paint_rest<T, N, C, FILTER, D>(job, plane, x, j, k, cell, from, end);
}

// Paint the pixels of rough cells; each block paints one cell at a time.
template <class T, class N, int C, int FILTER, int D>
INLINE void fill_rough(const Job& job) {
    const int wide = job.nx - 1, tall = job.ny - 1;
    for (int n = blockIdx.x; n < job.checks->rough; n += gridDim.x) {
        const int cell = job.rough[n], own = cell / (wide * tall), j = cell / wide % tall, k = cell % wide;
        const int left = job.xs[k], right = k == wide - 1 ? job.from_x + job.width : job.xs[k + 1];
        const int top = job.ys[j], bottom = j == tall - 1 ? job.from_y + job.height : job.ys[j + 1];
        for (int i = threadIdx.x; i < (right - left) * (bottom - top); i += blockDim.x) {
            const int x = left + i % (right - left), y = top + i / (right - left);
            Point<D> p;
            solve_pixel<D>(job, own, x, y, p);
            const int from = job.shared ? 0 : own, end = job.shared ? job.shared : own + 1;
            for (int plane = from; plane < end; plane++)
                paint<T, N, C, FILTER>(job, plane, x, y, p, pixel_of<T>(job, plane, x, y));
        }
    }
}

}  // namespace supple::cuda
