// Rows of samples: eight at a time where they have one or two channels and lie close to each other, else one by one.
//
// Source points of neighbours are neighbours: the windows of eight pixels lie in a few rows of samples. Vectors are
// read from each of these rows, and every lane picks its own sample. All kernels are separable,
//
//     v = Σ_r Σ_j d_rj Σ_i a_ri f(x + i, y + j),
//
// with one product (r) for linear and cubic samples, and two for a spot: its left and its right points.
#pragma once
#include "sample.hpp"

namespace supple {

// Output of pixel k of a row: put(k, pixel), or put(k, end, first, pixels) of a block whose lane 0 is pixel `first`.
// The mixture of frames at pixel k: mix_of(k), or mix_of(k, n, times) of a block.

#if defined(__AVX2__)
constexpr int BLOCK = 8;
typedef Pack<float, BLOCK> Eight;
typedef Pack<int32_t, BLOCK> Eights;

// The mixture of frames in a block: frame `first + i` has weight[i], and the constant beyond a clip's ends `constant`.
struct Times {
    static constexpr int MOST = 6;
    int first = 0, count = 1;
    Eight weight[MOST], constant{};
};

// The samples at p + at of each lane; `at` is less than 16, or than 8 where not FAR.
template <bool FAR, class T>
INLINE Eight pick(const T* p, Eights at) {
    if constexpr (std::is_same_v<T, uint8_t>) {  // one shuffle picks and widens
        const __m256i all = _mm256_broadcastsi128_si256(_mm_loadu_si128((const __m128i*)p));
        return (Eight)_mm256_cvtepi32_ps(_mm256_shuffle_epi8(all, (__m256i)(at | (int)0x80808000)));
    }
    Eight v = (Eight)_mm256_permutevar8x32_ps((__m256)load<float, BLOCK>(p), (__m256i)at);
    if constexpr (FAR) {
        Eight w = (Eight)_mm256_permutevar8x32_ps((__m256)load<float, BLOCK>(p + BLOCK), (__m256i)at);
        v = at >= BLOCK ? w : v;
    }
    return v;
}

// The weights of the columns and rows of each lane's window.
template <int RANK, int TAPS>
struct Weights {
    Eight across[RANK][TAPS], down[RANK][TAPS + 1];
};

INLINE void linear_weights(Eight f, Eight* w) {
    w[0] = 1 - f;
    w[1] = f;
}
INLINE void cubic_weights(Eight f, Eight* w) {
    for (int i = 0; i < 4; i++)
        w[i] = KEYS_POWERS[0][i] + f * (KEYS_POWERS[1][i] + f * (KEYS_POWERS[2][i] + f * KEYS_POWERS[3][i]));
}
// The weights of a spot: its left points use its columns, and its right points the next ones where `shift` is set.
INLINE void spot_weights(const Prints& prints, int k, Weights<2, WINDOW>& w) {
    Eight second[4];
    cubic_weights(load<float, BLOCK>(prints.first + k), w.across[0]);
    cubic_weights(load<float, BLOCK>(prints.second + k), second);
    w.across[0][4] = Eight{};
    Eights shifted = load<int32_t, BLOCK>(prints.shift + k) > 0;
    for (int i = 0; i < WINDOW; i++) {
        w.across[0][i] *= 0.5f;
        w.across[1][i] = 0.5f * (shifted ? (i > 0 ? second[i - 1] : Eight{}) : (i < 4 ? second[i] : Eight{}));
        w.down[0][i] = load<float, BLOCK>(prints.left[i] + k);
        w.down[1][i] = load<float, BLOCK>(prints.right[i] + k);
    }
}

// The largest of eight.
INLINE int most_of(Eights v) {
    v = most(v, Eights(__builtin_shufflevector(v, v, 4, 5, 6, 7, 0, 1, 2, 3)));
    v = most(v, Eights(__builtin_shufflevector(v, v, 2, 3, 0, 1, 6, 7, 4, 5)));
    return v[0] > v[1] ? v[0] : v[1];
}
// The least of eight, and by how much the largest is above it: exact below 2^15, which is more than any block needs.
INLINE int least_of(Eights v, int& above) {
    const int first = v[0];
    const __m256i apart = (__m256i)(v - first);
    const __m128i words = _mm_packs_epi32(_mm256_castsi256_si128(apart), _mm256_extracti128_si256(apart, 1));
    auto least = [&](int flip) INLINE_LAMBDA {  // of unsigned words, by one instruction
        const __m128i found = _mm_minpos_epu16(_mm_xor_si128(words, _mm_set1_epi16((short)flip)));
        return _mm_cvtsi128_si32(found) & 0xffff;
    };
    const int low = least(0x8000) - 0x8000;
    above = 0x7fff - least(0x7fff) - low;
    return first + low;
}
// The first n of eight numbers, and the first one in place of the others.
INLINE Eights first_of(const int* v, int n) {
    constexpr Eights lane = {0, 1, 2, 3, 4, 5, 6, 7};
    return lane < n ? load<int32_t, BLOCK>(v) : v[0];
}

// The relative positions of the windows of a block.
struct Windows {
    int x, y;       // the first sample of the leftmost window, and that of the uppermost
    int wide, low;  // the distance of the others, to the right and down
    Eights across, lower;

    INLINE Windows(const int* xs, const int* ys, int n) {
        across = first_of(xs, n);
        lower = first_of(ys, n);
        x = least_of(across, wide);
        y = least_of(lower, low);
        across -= x;
        lower -= y;
    }
    // True if all samples, from `before` to `after` those of the windows, are within the frames, and fit vectors.
    template <int C, class T>
    INLINE bool readable(const Frames<T>& f, int before, int after) const {
        return low <= 1 && wide * C + C <= 2 * BLOCK && x >= before && x + wide + after < f.w && y >= before &&
               y + low + after < f.h && f.has(y + low + after, (x + after) * C + 2 * BLOCK, C);
    }
};

// A term of a sum over rows or frames: 0 for lanes with a weight of 0, whatever their sample is.
template <class T>
INLINE Eight counted(Eight weight, Eight v) {
    if constexpr (std::numeric_limits<T>::is_integer)
        return weight * v;
    else
        return weight != 0 ? weight * v : Eight{};
}

// Sum a kernel over windows whose first sample is p.
template <bool FAR, int C, int RANK, int TAPS, class T>
INLINE void sum_windows(const T* p, ptrdiff_t row, const Windows& at, const Weights<RANK, TAPS>& w, Eight* sum) {
    for (int c = 0; c < C; c++) sum[c] = Eight{};
    for (int j = 0; j < TAPS + at.low; j++, p += row) {
        Eight along[RANK][C] = {};
        for (int i = 0; i < TAPS; i++)
            for (int c = 0; c < C; c++) {
                Eight v = pick<FAR>(p + C * i, at.across * C + c);
                for (int r = 0; r < RANK; r++) along[r][c] += w.across[r][i] * v;
            }
        for (int r = 0; r < RANK; r++)
            for (int c = 0; c < C; c++) sum[c] += counted<T>(w.down[r][j], along[r][c]);
    }
}

// Sample a block by a kernel whose window begins `before` samples from `at`.
template <int C, bool SEVERAL, int RANK, int TAPS, class T>
INLINE void sum_frames(const Frames<T>& f, const Windows& at, int before, Weights<RANK, TAPS>& w, const Times& times,
                       Eight* sum) {
    for (int r = 0; r < RANK; r++) {
        w.down[r][TAPS] = Eight{};
        if (at.low)
            for (int j = TAPS; j >= 0; j--) w.down[r][j] = at.lower ? (j ? w.down[r][j - 1] : Eight{}) : w.down[r][j];
    }
    ptrdiff_t place = (at.y - before) * f.row + (at.x - before) * C;
    auto one = [&](const T* frame, Eight* v) INLINE_LAMBDA {
        __builtin_prefetch(frame + place + 4 * f.row);  // rows are too short for the processor to see them coming
        if (C > 1 || at.wide >= BLOCK)
            sum_windows<true, C>(frame + place, f.row, at, w, v);
        else
            sum_windows<false, C>(frame + place, f.row, at, w, v);
    };
    if constexpr (!SEVERAL) return one(f.at[0], sum);
    for (int c = 0; c < C; c++) sum[c] = times.constant * (float)f.fill[c];
    for (int k = 0; k < times.count; k++) {
        Eight v[C];
        one(f.at[times.first + k], v);
        for (int c = 0; c < C; c++) sum[c] += counted<T>(times.weight[k], v[c]);
    }
}

// Sample the pixels `from` to `end` - 1 of a row in blocks from k on, while these are of one kind: linear or cubic
// samples, or spots where FILTER is AUTO. Returns the first block whose windows lie too far apart, or go beyond an
// edge.
template <Filter FILTER, int C, bool SEVERAL, class T, int D, class MixOf, class Put>
NOINLINE int sample_blocks(const Frames<T>& f, const Row<D>& row, const Prints& prints, int k, int from, int end,
                           const MixOf& mix_of, const Put& put) {
    constexpr bool spots = FILTER == AUTO;
    constexpr int before = FILTER == LINEAR ? 0 : 1, taps = FILTER == LINEAR ? 2 : spots ? WINDOW : 4;
    for (const bool some = prints.any; k < end; k += BLOCK) {
        const int n = std::min(BLOCK, row.count - k);
        if (some && most_of(first_of(prints.kind + k, n)) != (spots ? SPOT : PLAIN)) break;
        Windows at((spots ? prints.x : row.whole[0]) + k, (spots ? prints.y : row.whole[1]) + k, n);
        Times times;
        if (!at.template readable<C>(f, before, taps - 1 - before) || !mix_of(k, n, times)) break;
        Weights<spots ? 2 : 1, taps> w;
        if constexpr (spots)
            spot_weights(prints, k, w);
        else
            for (int d = 0; d < 2; d++) {
                Eight part = load<float, BLOCK>(row.part[d] + k), *to = d ? w.down[0] : w.across[0];
                FILTER == LINEAR ? linear_weights(part, to) : cubic_weights(part, to);
            }
        Eight sum[C];
        sum_frames<C, SEVERAL>(f, at, before, w, times, sum);
        put(k, std::max(k, from), std::min(k + BLOCK, end), sum);
    }
    return k;
}
#endif

// ---- one by one -----------------------------------------------------------------------------------------------------

// A run of pixels that is sampled by the same kernel. Runs depend on positions in a row, not on the wanted part, as
// kernels round differently.
struct Run {
    int from, end;
};

// The places of a row's samples. If `inside`, all windows are within the frames, and indices have 32 bits.
struct Places {
    alignas(64) int at[STRIDE];
    bool inside;

    template <int LEFT, int RIGHT, int C, class T>
    INLINE void find(const Frames<T>& f, const int* x, const int* y, int from, int end) {
        // The start of a window before a frame's first sample is a huge unsigned number.
        uint32_t most_x = 0, most_y = 0;
        for (int k = from; k < end; k++) {
            at[k] = (int)((uint32_t)y[k] * (uint32_t)f.row + (uint32_t)x[k] * (uint32_t)C);
            most_x = std::max(most_x, (uint32_t)(x[k] - LEFT));
            most_y = std::max(most_y, (uint32_t)(y[k] - LEFT));
        }
        constexpr int around = LEFT + RIGHT;
        inside = f.w > around && f.h > around && most_x < (uint32_t)(f.w - around) &&
                 most_y < (uint32_t)(f.h - around) && f.has((int)most_y + around, (int)most_x * C + 20, C) &&
                 f.limit <= INT32_MAX;
        // Prefetch the samples of a row four further down, in one frame.
        if constexpr (sizeof(T) <= 4)
            if (inside && (int)most_y + LEFT + 4 < f.h) {
                const T* next = f.at[0] + at[from] + 4 * f.row;
                if (next)
                    for (int o = 0; o < (end - from) * C; o += 64 / (int)sizeof(T)) __builtin_prefetch(next + o);
            }
    }
};

template <Filter FILTER, class N, int C, bool SEVERAL, class T, int D, class MixOf, class Put>
NOINLINE void sample_each(const Frames<T>& given, const Row<D>& row, Run run, int from, int end, MixOf mix_of,
                          Put put) {
    constexpr int left = FILTER == LINEAR ? 0 : 1, right = FILTER == LINEAR ? 1 : 2;
    const Frames<T> f = given;
    const int *x = row.whole[0], *y = row.whole[1];
    Places places;
    places.find<left, right, C>(f, x, y, run.from, run.end);
    Mix<N> mix = mix_of(run.from);
    for (int k = from; k < end; k++) {
        if constexpr (SEVERAL) mix = mix_of(k);
        auto kernel = [&](auto taps, ptrdiff_t r) INLINE_LAMBDA {
            N fx = (N)row.part[0][k], fy = (N)row.part[1][k];
            if constexpr (FILTER == LINEAR)
                return linear_at<N, C>(taps, r, fx, fy);
            else
                return cubic_at<N, C>(taps, r, fx, fy);
        };
        const ptrdiff_t place = places.inside ? places.at[k] : place_of<C>(f, x[k], y[k]);
        const bool inside = places.inside || inner<C, left, right>(f, x[k], y[k]);
        put(k, around<N, C, left, right, SEVERAL>(f, mix, x[k], y[k], inside, place, kernel));
    }
}

template <class N, int C, bool SEVERAL, class T, int D, class MixOf, class Put>
NOINLINE void sample_footprints(const Frames<T>& given, const Pyramid<N>& pyramid, const Row<D>& row,
                                const Prints& prints, Run run, int from, int end, MixOf mix_of, Put put) {
    const Frames<T> f = given;
    const int *x = row.whole[0], *y = row.whole[1];
    Places places;
    places.find<2, 3, C>(f, x, y, run.from, run.end);
    Mix<N> mix = mix_of(run.from);
    for (int k = from; k < end; k++) {
        const N fx = (N)row.part[0][k], fy = (N)row.part[1][k];
        if constexpr (SEVERAL) mix = mix_of(k);
        auto cubic = [&](auto taps, ptrdiff_t r) INLINE_LAMBDA { return cubic_at<N, C>(taps, r, fx, fy); };
        auto spot = [&](auto taps, ptrdiff_t r) INLINE_LAMBDA {
            Across<N> across{(N)prints.first[k], (N)prints.second[k], prints.shift[k]};
            if constexpr (sizeof(N) == sizeof(float))
                return spot_at<N, C, STRIDE>(taps, r, across, &prints.left[0][k], &prints.right[0][k]);
            else {
                N left[WINDOW], right[WINDOW];
                widen(&prints.left[0][k], STRIDE, left);
                widen(&prints.right[0][k], STRIDE, right);
                return spot_at<N, C, 1>(taps, r, across, left, right);
            }
        };
        if (prints.kind[k] == PLAIN) {
            const ptrdiff_t place = places.inside ? places.at[k] : place_of<C>(f, x[k], y[k]);
            const bool inside = places.inside || inner<C, 1, 2>(f, x[k], y[k]);
            put(k, around<N, C, 1, 2, SEVERAL>(f, mix, x[k], y[k], inside, place, cubic));
        } else if (prints.kind[k] == SPOT)
            put(k, around<N, C, 1, 3, SEVERAL>(f, mix, prints.x[k], prints.y[k],
                                               places.inside || inner<C, 1, 3>(f, prints.x[k], prints.y[k]),
                                               place_of<C>(f, prints.x[k], prints.y[k]), spot));
        else
            put(k, wide<Pixel<N>>(Levels<N>{&f, pyramid, mix, spots_of<N, C, SEVERAL, T>, spots_of < N, C == 1 ? 1 : 4,
                                            SEVERAL, N > },
                                  (N)x[k] + fx, (N)y[k] + fy, (N)prints.xx[k], (N)prints.xy[k], (N)prints.yy[k]));
    }
}

// ---- rows -----------------------------------------------------------------------------------------------------------

// Sample the source points `from` to `end` - 1 of a row: put(k, pixel). mix_of(k) is the mixture of frames.
template <class N, int C, bool SEVERAL, class T, int D, class MixOf, class Put>
INLINE void sample_row(const Frames<T>& f, const Pyramid<N>& pyramid, int filter, const Row<D>& row,
                       const Prints& prints, int from, int end, MixOf mix_of, Put put) {
    auto one_by_one = [&](Run run, int from, int end) {
        if (filter == LINEAR)
            sample_each<LINEAR, N, C, SEVERAL>(f, row, run, from, end, mix_of, put);
        else if (filter == CUBIC || !prints.any)
            sample_each<CUBIC, N, C, SEVERAL>(f, row, run, from, end, mix_of, put);
        else
            sample_footprints<N, C, SEVERAL>(f, pyramid, row, prints, run, from, end, mix_of, put);
    };
#if defined(__AVX2__)
    if constexpr (sizeof(N) == sizeof(float) && C <= 2) {
        // The positions of blocks in a root do not depend on the wanted part.
        for (int k = from & -BLOCK, next; k < end; k = next) {
            next = filter == LINEAR ? sample_blocks<LINEAR, C, SEVERAL>(f, row, prints, k, from, end, mix_of, put)
                                    : sample_blocks<CUBIC, C, SEVERAL>(f, row, prints, k, from, end, mix_of, put);
            if (next == k && prints.any)
                next = sample_blocks<AUTO, C, SEVERAL>(f, row, prints, k, from, end, mix_of, put);
            if (next > k) continue;
            next = k + BLOCK;
            one_by_one({k, std::min(next, row.count)}, std::max(k, from), std::min(next, end));
        }
        return;
    }
#endif
    one_by_one({0, row.count}, from, end);
}

}  // namespace supple
