// Sampling of a plane of the output from frames of any type: the choice of kernel, number type and frames.
//
// Types of the kernels (8 and 16 bit integers, float32, up to four channels) are read in place. All other samples
// (other types, opacity, linear light, more channels) are first converted to numbers of one or four channels, as much
// of a frame at a time as a root cell can read.
#pragma once
#include <memory>

#include "motion.hpp"
#include "rows.hpp"
#include "samples.hpp"

namespace supple {

// Call f(T()) with the type T of samples.
template <class F>
void with_type(int type, F f) {
    switch (type) {
        case U8: return f(uint8_t());
        case U16: return f(uint16_t());
        case I16: return f(int16_t());
        case F32: return f(float());
        case F64: return f(double());
        case I8: return f(int8_t());
        case I32: return f(int32_t());
        case U32: return f(uint32_t());
        case I64: return f(int64_t());
        default: return f(uint64_t());
    }
}
inline int bytes_of(int type) {
    static const int bytes[] = {1, 2, 2, 4, 8, 1, 4, 4, 8, 8};
    return bytes[type];
}

// A sampling job: source, options, and destination.
struct Job {
    // A window of the clip's `count` frames: frame k is in slot (k - held_from) modulo `capacity`. Only a part of each
    // is in memory; `frames` is where the sample (0, 0) of the first slot would be.
    const char* frames;
    ptrdiff_t frame_bytes;
    int count, capacity, held_from;
    int type, channels, w, h;
    int held[4];  // x0, x1, y0, y1 of the part in memory: contiguous rows
    char* out;    // the destination, from the sample `corner` of the grid on
    Grid grid;
    int box[4];         // x0, x1, y0, y1 of the part to compute
    int corner[2];      // the sample of the grid with which `out` begins
    ptrdiff_t out_row;  // samples of a row of `out`
    int filter, between, rule;
    bool average;        // whether a pixel is averaged over time
    const double* fill;  // for each channel
    int alpha;           // the channel that weights the others, or -1
    bool light;          // whether averages are in linear light
    double white;        // the largest value, which is also full opacity
    Motion motion;       // the motion between frames, if its capacity is not 0

    ptrdiff_t pixel_bytes() const { return (ptrdiff_t)bytes_of(type) * channels; }
    const char* frame(int k) const {  // or null, for the fill value
        k = placed(k, count, rule);
        return k < 0 ? nullptr : frames + ((k - held_from) % capacity) * frame_bytes;
    }
    ptrdiff_t row() const { return held[1] - held[0]; }
    const char* sample(const char* frame, int x, int y) const { return frame + (y * row() + x) * pixel_bytes(); }
    char* target(int x, int y) const { return out + ((y - corner[1]) * out_row + (x - corner[0])) * pixel_bytes(); }
    bool direct() const {
        bool known = type == U8 || type == U16 || type == F32 || (type == I16 && channels == 1);
        return known && channels <= 4 && alpha < 0 && !light;
    }
};

// ---- time ----------------------------------------------------------------------------------------------------------

// The weights of frames from `first` on, for a pixel that covers `width` frames beyond one; returns their number.
template <class N>
inline int time_weights(int between, double t, double width, int& first, N* weight) {
    const int n = frames_at(between, t, width, first);
    for (int k = 0; k < n; k++) weight[k] = (N)time_weight(between, t, width, first, k);
    return n;
}

// The range of frames that samples of a plane may read, from bounds of their times. Beyond a clip's ends, constants and
// edges need only a few more frames.
struct Span {
    int first, last;
};
inline Span frames_of(const Job& job, double low, double high, double rate) {
    double support = job.between == BETWEEN_CUBIC ? 2 : 1, width = 0;
    if (job.average) width = std::min(rate * std::max(job.grid.step[0], job.grid.step[1]), LONGEST) / 2 + 1;
    double out = 3 + LONGEST / 2, slack = 1e-3;
    if (job.rule != REFLECT) {
        low = std::clamp(low, -out, job.count - 1 + out);
        high = std::clamp(high, -out, job.count - 1 + out);
    }
    return {(int)floor(low - slack - width - support), (int)ceil(high + slack + width + support)};
}

// ---- numbers --------------------------------------------------------------------------------------------------------

// Samples as numbers, in groups of channels: in linear light if wanted, and weighted by opacity, which comes last.
template <class N>
struct Numbers {
    const Job& job;
    int lanes, colours;  // numbers per pixel; the number of colours in a group
    std::vector<N> table;

    explicit Numbers(const Job& job);
    int groups() const {
        int all = job.alpha < 0 ? job.channels : job.channels - 1;
        return (all + colours - 1) / colours;
    }
    int count(int group) const {
        int all = job.alpha < 0 ? job.channels : job.channels - 1;
        return std::min(colours, all - group * colours);
    }
    // Convert n samples of a row.
    void convert(const char* frame, int x, int y, int n, int group, N* out) const;
    void store(const N* from, int n, int group, char* p) const;  // four numbers a pixel
    // The fill value, converted.
    void constant(int group, double* out) const;

private:
    template <class T>
    N number(T v) const;
    template <class T>
    void convert(const T* p, int n, int group, N* out) const;
    template <class T>
    void store(const N* from, int n, int group, T* p) const;
};

// Write pixels of a row, which ends at `end`, in a type of the kernels: rounded to nearest, and clamped to the type.
// Where there is room, lanes beyond the C-th are written, and overwritten by the next pixel. Or store them as numbers.
template <class N, class T, int C>
struct Putting {
    T* out;  // of pixel 0
    int end;
    float high;         // the largest value
    Pixel<N>* numbers;  // or null
#if defined(__SSE4_1__)
    // Sums of weighted 16-bit samples do not overflow 32 bits.
    static INLINE __m128i narrowed(__m128i a, __m128i b) {
        __m128i s = std::numeric_limits<T>::is_signed ? _mm_packs_epi32(a, b) : _mm_packus_epi32(a, b);
        return sizeof(T) == 1 ? _mm_packus_epi16(s, s) : s;
    }
#endif
    INLINE void operator()(int k, Pixel<N> v) const {
        if (numbers)
            numbers[k] = v;
        else if constexpr (sizeof(N) == sizeof(float))
            write(k, v);
    }
    INLINE void write(int k, Pixel<float> v) const {
        T* p = out + k * C;
        const bool room = C == 4 || k + 4 / C < end;
        if constexpr (sizeof(T) == 4) {
            if (room)
                memcpy(p, &v, 16);
            else
                for (int c = 0; c < C; c++) p[c] = v[c];
        } else {
#if defined(__SSE4_1__)
            v = (Pixel<float>)_mm_min_ps((__m128)v, _mm_set1_ps(high));
            __m128i four = _mm_cvtps_epi32((__m128)v);
            four = narrowed(four, four);
#else
            T four[4];
            const float low = std::numeric_limits<T>::lowest();
            for (int c = 0; c < 4; c++) four[c] = (T)__builtin_rintf(v[c] > low ? v[c] < high ? v[c] : high : low);
#endif
            if (room)
                memcpy(p, &four, sizeof(T) * 4);
            else
                memcpy(p, &four, sizeof(T) * C);
        }
    }
#if defined(__AVX2__)
    // Write pixels `from` to `to` - 1 of a block that begins at k.
    INLINE void operator()(int k, int from, int to, const Eight* v) const {
        if (numbers) {
            for (int i = from; i < to; i++) numbers[i] = Pixel<float>{v[0][i - k], v[C - 1][i - k]};
            return;
        }
        T all[BLOCK * C];
        if constexpr (sizeof(T) == 4)
            for (int l = 0; l < BLOCK; l++)
                for (int c = 0; c < C; c++) all[C * l + c] = v[c][l];
        else {
            __m128i s = integers(v[0]), t = C > 1 ? integers(v[C - 1]) : s;
            if constexpr (C == 1)
                memcpy(all, &s, sizeof all);
            else if constexpr (sizeof(T) == 1)
                _mm_storeu_si128((__m128i*)all, _mm_unpacklo_epi8(s, t));
            else {
                _mm_storeu_si128((__m128i*)all, _mm_unpacklo_epi16(s, t));
                _mm_storeu_si128((__m128i*)all + 1, _mm_unpackhi_epi16(s, t));
            }
        }
        if (to - from == BLOCK)
            memcpy(out + k * C, all, sizeof all);
        else
            memcpy(out + from * C, all + (from - k) * C, (to - from) * C * sizeof(T));
    }
    INLINE __m128i integers(Eight v) const {
        __m256i s = _mm256_cvtps_epi32(_mm256_min_ps((__m256)v, _mm256_set1_ps(high)));
        return narrowed(_mm256_castsi256_si128(s), _mm256_extracti128_si256(s, 1));
    }
#endif
};

// ---- pyramids -------------------------------------------------------------------------------------------------------

// The number of pyramid levels that a map needs, from its largest squared footprint (`Plan::widest`).
int levels_of(const Job& job, double widest);

// Pyramids of the frames in `span`, with as many levels as a map's footprints need.
template <class N>
struct Averages {
    Pyramid<N> pyramid;
    std::vector<std::vector<N>> samples;
    std::vector<std::vector<const N*>> frames;
    double fill[4];
    int first;

    // The pyramid without the frames before `frame`.
    Pyramid<N> from(int frame) const {
        Pyramid<N> made = pyramid;
        for (int k = 0; k < made.levels; k++) made.level[k].at += frame - first;
        return made;
    }

    Averages(const Job& job, const Numbers<N>& numbers, int group, Span span, double widest);
};

// ---- a plane --------------------------------------------------------------------------------------------------------

// The mixture of frames at the samples of a row. Of the constant beyond a clip's ends, it has only the weight.
template <class N, int D>
struct Mixing {
    const Job& job;
    Span span;
    const Row<D>& row;
    N* weight;
    const void* const* frames;  // those of the span; null: the constant
    bool pairs;                 // whether every sample needs at most two adjacent frames, all of them present
    bool whole = true;          // whether every sample needs one frame
    bool one = false;           // whether all samples lie between the same two frames

    Mixing(const Job& job, Span span, const Row<D>& row, N* weight, const void* const* frames)
        : job(job), span(span), row(row), weight(weight), frames(frames), pairs(false) {
        if constexpr (D == 3) {
            if (job.between != BETWEEN_LINEAR || job.average) return;
            int first = row.whole[2][0], last = first, between = 0;
            for (int k = 0; k < row.count; k++) {
                first = std::min(first, row.whole[2][k]);
                last = std::max(last, row.whole[2][k]);
                between |= row.part[2][k] != 0;
            }
            whole = !between;
            one = first == last;
            pairs = first >= span.first && last < span.last;
            for (int k = first; pairs && k <= last + 1; k++) pairs = frames[k - span.first] != nullptr;
        }
    }
    INLINE Mix<N> operator()(int k) const {
        if constexpr (D == 2)
            return {0, 1, weight, 0};
        else if (pairs) {
            N f = (N)row.part[2][k];
            weight[0] = 1 - f;
            weight[1] = f;
            return {row.whole[2][k] - span.first, f == 0 ? 1 : 2, weight, 0};
        } else
            return any(k);
    }
    NOINLINE Mix<N> any(int k) const {
        double t = row.whole[2][k] + (double)row.part[2][k], width = job.average ? covered(row.depth2[k]) : 0;
        if (job.rule != REFLECT) t = std::clamp(t, -3.0 - LONGEST / 2, job.count + 2.0 + LONGEST / 2);
        int first, n = time_weights(job.between, t, width, first, weight);
        if (job.average && job.motion.capacity) job.motion.cut(t, first, n, job.count, job.rule, weight);
        first -= span.first;
        if (first < 0 || first + n > span.last - span.first + 1) {  // rounding at the ends of a span
            first = std::clamp(first, 0, std::max(span.last - span.first + 1 - n, 0));
            n = std::min(n, span.last - span.first + 1);
        }
        N constant = 0;
        const N* w = weight;
        while (n > 0 && !frames[first]) constant += *w++, first++, n--;
        while (n > 0 && !frames[first + n - 1]) constant += w[--n];
        return {first, n, w, constant};
    }
#if defined(__AVX2__)
    // The mixture of n samples from k on. False if they need too many frames.
    INLINE bool operator()(int k, int n, Times& times) const {
        if constexpr (D == 2) return true;
        times.first = std::numeric_limits<int>::max();
        if (pairs) {
            const Eight part = load<float, BLOCK>(row.part[2] + k);
            if (one) {
                times.first = row.whole[2][k] - span.first;
                times.count = whole ? 1 : 2;
                times.weight[0] = 1 - part;
                times.weight[1] = part;
                return true;
            }
            const Eights at = first_of(row.whole[2] + k, n) - span.first;
            times.first = least_of(at, times.count);
            times.count += whole ? 1 : 2;
            if (times.count > Times::MOST) return false;
            for (int i = 0; i < times.count; i++)
                times.weight[i] = at == times.first + i ? 1 - part : at == times.first + i - 1 ? part : Eight{};
            return true;
        }
        return any(k, n, times);
    }
    // The mixture for a cubic, as `time_weights` computes it, in all lanes at once: only without averages, and where no
    // frame is missing, which is nearly everywhere. False otherwise, and if there are too many frames.
    INLINE bool cubics(int k, int n, Times& times) const {
        typedef double Doubles __attribute__((vector_size(BLOCK * sizeof(double))));  // two registers
        constexpr Eights lane = {0, 1, 2, 3, 4, 5, 6, 7};
        const Eights whole = first_of(row.whole[2] + k, n);
        Eight part = load<float, BLOCK>(row.part[2] + k), rate = load<float, BLOCK>(row.depth2 + k);
        part = lane < n ? part : part[0];
        rate = lane < n && job.average ? rate : Eight{};
        if (most_of(Eights((part >= 0) & (part < 1) & (rate <= 1))) != -1) return false;
        const Doubles base = __builtin_convertvector(whole, Doubles);
        const Doubles f = (base + __builtin_convertvector(part, Doubles)) - base;
        const Eights still = Eights(__builtin_convertvector(f, Eight) == 0), lower = still ? whole : whole - 1;
        times.first = least_of(lower, times.count) - span.first;
        times.count = most_of(still ? whole + 1 : whole + 3) - span.first - times.first;
        if (times.count > Times::MOST || times.first < 0 || times.first + times.count > span.last - span.first + 1)
            return false;
        for (int i = 0; i < times.count; i++)
            if (!frames[times.first + i]) return false;
        const Doubles taps[4] = {0.5 * f * (f * (2 - f) - 1), 0.5 * (f * f * (3 * f - 5) + 2),
                                 0.5 * f * (f * (4 - 3 * f) + 1), 0.5 * f * f * (f - 1)};
        for (int i = 0; i < times.count; i++) {
            const Eights own = times.first + span.first + i - whole + 1;
            times.weight[i] = Eight{};
            for (int j = 0; j < 4; j++)
                times.weight[i] = own == j ? __builtin_convertvector(taps[j], Eight) : times.weight[i];
        }
        return true;
    }
    NOINLINE bool any(int k, int n, Times& times) const {
        if (job.between == BETWEEN_CUBIC && cubics(k, n, times)) return true;
        times.first = std::numeric_limits<int>::max();
        int end = 0;
        std::fill(times.weight, times.weight + Times::MOST, Eight{});
        for (int pass = 0; pass < 2; pass++)
            for (int l = 0; l < n; l++) {
                Mix<N> mix = (*this)(k + l);
                if (pass == 0 && mix.n > 0) {
                    times.first = std::min(times.first, mix.first);
                    end = std::max(end, mix.first + mix.n);
                    if (end - times.first > Times::MOST) return false;
                }
                times.constant[l] = mix.constant;
                for (int i = 0; pass == 1 && i < mix.n; i++)
                    times.weight[mix.first + i - times.first][l] = mix.weight[i];
            }
        times.count = std::max(end - times.first, 0);
        return true;
    }
#endif
};

INLINE void copy_same(const Job& job, const char* frame, int x, int y, int n, const bool* same) {
    const ptrdiff_t size = job.pixel_bytes();
    const char* from = job.sample(frame, x, y);
    for (int i = 0; i < n;) {
        int end = i;
        while (end < n && (!same || same[end])) end++;
        if (end > i) memcpy(job.target(x + i, y), from + i * size, (size_t)(end - i) * size);
        i = end + 1;
    }
}

// The derivatives that footprints and averages over time need.
inline Slopes slopes_of(const Job& job) {
    return job.average ? Slopes::ALL : job.filter == AUTO ? Slopes::SHRINKING : Slopes::NONE;
}

template <int D>
void sample_nearest(const Plan<D>& plan, const Job& job) {
    const ptrdiff_t size = job.pixel_bytes();
    std::vector<char> fill(size);  // in the type of the samples
    Job plain = job;
    plain.alpha = -1;
    plain.light = false;
    const Numbers<double> numbers(plain);
    for (int group = 0; group < numbers.groups(); group++) {
        double values[4];
        numbers.constant(group, values);
        numbers.store(values, 1, group, fill.data());
    }
    const char* own = job.frame((int)plan.z);
    parallel(plan.roots_down(), [&](int j, int) {
        plan.each_row(job.grid, j, job.box, Slopes::NONE, [&](const Row<D>& row, int x, int y, int n, int at) {
            if (row.idle) return copy_same(job, own, x, y, n, nullptr);
            char* to = job.target(x, y);
            auto copy = [&](auto size) {
                for (int i = 0; i < n; i++, to += size) {
                    int u = placed(row.whole[0][at + i] + (row.part[0][at + i] >= 0.5f), job.w, job.rule);
                    int v = placed(row.whole[1][at + i] + (row.part[1][at + i] >= 0.5f), job.h, job.rule);
                    const char* frame = own;
                    if constexpr (D == 3) frame = job.frame(row.whole[2][at + i] + (row.part[2][at + i] >= 0.5f));
                    const char* from = u < 0 || v < 0 || !frame ? fill.data() : job.sample(frame, u, v);
                    memcpy(to, from, size);
                }
            };
            // With a constant size, memcpy is no call.
            size == 1   ? copy(std::integral_constant<ptrdiff_t, 1>())
            : size == 3 ? copy(std::integral_constant<ptrdiff_t, 3>())
            : size == 4 ? copy(std::integral_constant<ptrdiff_t, 4>())
                        : copy(size);
        });
    });
}

// The range of frames that a plane's samples may read.
template <int D>
Span frames_of(const Plan<D>& plan, const Job& job) {
    if constexpr (D == 2) return {0, 0};
    Extent<D> e = plan.extent();
    return frames_of(job, e.low[D - 1], e.high[D - 1], e.rate);
}

// Samples n source points of a row, from `at` on, into `to`, or as numbers. All other work on a plane is compiled once
// for all types.
template <class N, int D>
struct Sampler {
    virtual void operator()(const Row<D>& row, const Prints& prints, N* weight, int at, int n, void* to,
                            Pixel<N>* numbers) const = 0;
    virtual void put(const Pixel<N>*, int, int, void*) const {}  // numbers, in the type of the samples

protected:
    ~Sampler() = default;
};

// A sampler of frames of type T, with a pyramid of numbers.
template <class N, class T, int C, int D>
struct Reader final : Sampler<N, D> {
    const Job& job;
    const Span span;
    const Frames<T> frames;
    const Pyramid<N>& pyramid;
    const float high = (float)std::min((double)std::numeric_limits<T>::max(), job.white);

    Reader(const Job& job, Span span, const Frames<T>& frames, const Pyramid<N>& pyramid)
        : job(job), span(span), frames(frames), pyramid(pyramid) {}
    void operator()(const Row<D>& row, const Prints& prints, N* weight, int at, int n, void* to,
                    Pixel<N>* numbers) const override {
        Mixing<N, D> mixing(job, span, row, weight, (const void* const*)frames.at);
        Pixel<N> own[STRIDE];  // converted together, as each sum would wait long for that of the one before
        const bool later = !numbers && sizeof(T) < sizeof(N) && C > 2;
        const Putting<N, T, C> put{(T*)to - at * C, at + n, high, later ? own : numbers};
        sample_row<N, C, D == 3>(frames, pyramid, job.filter, row, prints, at, at + n, mixing, put);
        if (later) this->put(own, at, n, to);
    }
    void put(const Pixel<N>* numbers, int at, int n, void* to) const override {
        const Putting<N, T, C> put{(T*)to - at * C, at + n, high, nullptr};
        int k = at;
#if defined(__SSE4_1__)
        if constexpr (sizeof(T) == 1 && C == 3)  // four at once, and four bytes more
            for (; k + 6 <= at + n; k += 4) {
                __m128i v[4];
                for (int i = 0; i < 4; i++)
                    v[i] = _mm_cvtps_epi32(_mm_min_ps((__m128)numbers[k + i], _mm_set1_ps(high)));
                v[0] = _mm_packus_epi16(_mm_packus_epi32(v[0], v[1]), _mm_packus_epi32(v[2], v[3]));
                const __m128i colours = _mm_setr_epi8(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, 15, 15, 15, 15);
                _mm_storeu_si128((__m128i*)(put.out + k * C), _mm_shuffle_epi8(v[0], colours));
            }
#endif
        for (; k < at + n; k++) put(k, numbers[k]);
    }
};

// The buffers of a thread for a row.
template <class N>
struct Scratch {
    Prints prints;
    Followed followed;
    N weight[(int)LONGEST + 8] = {1};
    Pixel<N> numbers[STRIDE];
};

// Sample n points of a row along the motion between frames, as numbers; false if there is none to follow.
template <class N, int D>
bool follow(const Job& job, const Sampler<N, D>& sample, const Row<D>& row, Scratch<N>& s, int at, int n) {
    if constexpr (D == 3) {
        if (!s.followed.find(job, row)) return false;
        Pixel<N> own[STRIDE];
        std::fill(s.numbers + at, s.numbers + at + n, Pixel<N>{});
        bool found = false;
        for (int i = 0; i < 3; i++) {
            const float* share = s.followed.share[i];
            if (std::all_of(share + at, share + at + n, [](float s) { return s == 0; })) continue;
            const Row<3>& seen = i < 2 ? s.followed.row[i] : row;
            if (!found || s.prints.any) s.prints.find(seen, job.filter);  // of the same footprints
            found = true;
            sample(seen, s.prints, s.weight, at, n, nullptr, own);
            for (int k = at; k < at + n; k++)
                if (share[k] != 0) s.numbers[k] += (N)share[k] * own[k];
        }
        return true;
    }
    return false;
}

// Sample frames in place.
template <int D>
void sample_direct(const Plan<D>& plan, const Job& job, const Sampler<float, D>& sample) {
    const char* own = job.frame((int)plan.z);
    parallel(plan.roots_down(), [&](int j, int) {
        Scratch<float> s;
        plan.each_row(job.grid, j, job.box, slopes_of(job), [&](const Row<D>& row, int x, int y, int n, int at) {
            if (row.idle) return copy_same(job, own, x, y, n, nullptr);
            if (job.motion.capacity && follow(job, sample, row, s, at, n))
                sample.put(s.numbers, at, n, job.target(x, y));
            else {
                s.prints.find(row, job.filter);
                int from = at, end = at + n;  // of those that are not copied
                while (row.some_same && from < end && row.same[from]) from++;
                while (row.some_same && from < end && row.same[end - 1]) end--;
                sample(row, s.prints, s.weight, from, end - from, job.target(x + from - at, y), nullptr);
            }
            if (row.some_same) copy_same(job, own, x, y, n, row.same + at);
        });
    });
}

// Sample frames of any type, converted to numbers, root by root.
template <class N, int D>
void sample_converted(const Plan<D>& plan, const Job& job) {
    Numbers<N> numbers(job);
    const Span whole = frames_of(plan, job);
    for (int group = 0; group < numbers.groups(); group++) {
        double fill[4];
        numbers.constant(group, fill);
        Averages<N> averages(job, numbers, group, whole, plan.widest);
        parallel(plan.roots_down(), [&](int j, int) {
            Scratch<N> s;
            std::vector<N> tile;
            std::vector<const N*> frames(whole.last - whole.first + 1);
            for (int i = 0; i < plan.roots_across(); i++) {
                int index = j * plan.roots_across() + i, box[4], wanted[4] = {0, 0, job.box[2], job.box[3]};
                plan.part_of(job.grid, 0, i, wanted[0], wanted[1]);
                wanted[0] = std::max(wanted[0], job.box[0]);
                wanted[1] = std::min(wanted[1], job.box[1]);
                if (wanted[0] >= wanted[1]) continue;
                if (plan.is_still(index)) {
                    plan.each_row(job.grid, j, wanted, Slopes::NONE, [&](const Row<D>&, int x, int y, int n, int) {
                        copy_same(job, job.frame((int)plan.z), x, y, n, nullptr);
                    });
                    continue;
                }
                Extent<D> e = plan.extent(index);
                Span span = whole;
                if (D == 3) span = frames_of(job, e.low[D - 1], e.high[D - 1], e.rate);
                if (job.motion.capacity)
                    for (int d = 0; d < 2; d++) {
                        const double far = job.motion.most_from(span.first, span.last, job.count, job.rule);
                        e.low[d] -= far;
                        e.high[d] += far;
                    }
                seen(job, e, 0, box);
                int across = box[1] - box[0], tall = box[3] - box[2];
                ptrdiff_t line = (ptrdiff_t)across * numbers.lanes, size = line * tall;
                tile.resize((size_t)size * (span.last - span.first + 1) + 64);
                for (int k = span.first; k <= span.last; k++) {
                    const char* frame = job.frame(k);
                    N* at = tile.data() + (k - span.first) * size;
                    // As if it were the whole frame, with the sample (0, 0) at the start.
                    frames[k - span.first] = frame ? at - (box[2] * line + (ptrdiff_t)box[0] * numbers.lanes) : nullptr;
                    for (int y = box[2]; frame && y < box[3]; y++)
                        numbers.convert(frame, box[0], y, across, group, at + (y - box[2]) * line);
                }
                const Frames<N> held{frames.data(), job.w, job.h, line, std::numeric_limits<ptrdiff_t>::max(),
                                     job.rule,      fill};
                const Pyramid<N> pyramid = averages.from(span.first);
                const Reader<N, N, 1, D> one(job, span, held, pyramid);
                const Reader<N, N, 4, D> four(job, span, held, pyramid);
                const Sampler<N, D>& sample = numbers.lanes == 1 ? (const Sampler<N, D>&)one : four;
                plan.each_row(job.grid, j, wanted, slopes_of(job), [&](const Row<D>& row, int x, int y, int n, int at) {
                    if (row.idle) return copy_same(job, job.frame((int)plan.z), x, y, n, nullptr);
                    if (!job.motion.capacity || !follow(job, sample, row, s, at, n)) {
                        s.prints.find(row, job.filter);
                        sample(row, s.prints, s.weight, at, n, nullptr, s.numbers);
                    }
                    numbers.store((const N*)(s.numbers + at), n, group, job.target(x, y));
                    if (row.some_same) copy_same(job, job.frame((int)plan.z), x, y, n, row.same + at);
                });
            }
        });
    }
}
// The box of samples of a frame that a root may read: its source points with their footprints, and the samples that
// replace those beyond an edge.
template <int D>
inline void seen(const Job& job, const Extent<D>& e, int levels, int (&box)[4]) {
    int size[2] = {job.w, job.h};
    double ratio = (double)std::max(job.grid.step[0], job.grid.step[1]) / std::min(job.grid.step[0], job.grid.step[1]);
    double longest = 1600.0 * (1 << 2 * levels), margin = 4 << levels;
    if (job.filter == AUTO) margin += 0.5 * sqrt(std::min(e.spread * ratio * ratio, longest));
    for (int d = 0; d < 2; d++) {
        double low = (e.low[d] - job.grid.offset[d]) / job.grid.step[d] - margin;
        double high = (e.high[d] - job.grid.offset[d]) / job.grid.step[d] + margin;
        int n = size[d], first = (int)std::clamp(low, 0.0, n - 1.0), last = (int)std::clamp(high, 0.0, n - 1.0);
        if (job.rule == REFLECT) {  // reflected samples, perhaps anywhere
            if (low < 0) last = (int)std::max((double)last, std::min(-low, n - 1.0));
            if (high > n - 1) first = (int)std::min((double)first, std::max(2 * n - 2 - high, 0.0));
            if (low < -n || high > 2 * n - 1) first = 0, last = n - 1;
        }
        box[2 * d] = first;
        box[2 * d + 1] = last + 1;
    }
}

// The part of the frames that the samples of job.box may read: columns and rows x0, x1, y0, y1, and the first frame and
// the one after the last.
struct Portion {
    int box[4] = {INT32_MAX, 0, INT32_MAX, 0}, frames[2] = {INT32_MAX, 0};

    bool empty() const { return frames[0] >= frames[1]; }  // only the fill value is read
    bool holds(const Portion& o) const {
        if (o.empty()) return true;
        return box[0] <= o.box[0] && o.box[1] <= box[1] && box[2] <= o.box[2] && o.box[3] <= box[3] &&
               frames[0] <= o.frames[0] && o.frames[1] <= frames[1];
    }
    Portion& operator|=(const Portion& o) {
        for (int d = 0; d < 4; d += 2) {
            box[d] = std::min(box[d], o.box[d]);
            box[d + 1] = std::max(box[d + 1], o.box[d + 1]);
        }
        frames[0] = std::min(frames[0], o.frames[0]);
        frames[1] = std::max(frames[1], o.frames[1]);
        return *this;
    }
};
inline Portion held_of(const Job& job) {
    Portion held;
    std::copy(job.held, job.held + 4, held.box);
    held.frames[0] = job.held_from;
    held.frames[1] = job.held_from + job.capacity;
    return held;
}
template <int D>
Portion needed(const Plan<D>& plan, const Job& job) {
    Portion all;
    const int levels = levels_of(job, plan.widest), apart = 1 << levels, size[2] = {job.w, job.h};
    for (int j = 0; j < plan.roots_down(); j++)
        for (int i = 0; i < plan.roots_across(); i++) {
            Portion part;
            int wanted[4];
            plan.part_of(job.grid, 0, i, wanted[0], wanted[1]);
            plan.part_of(job.grid, 1, j, wanted[2], wanted[3]);
            for (int d = 0; d < 4; d += 2) {
                wanted[d] = std::max(wanted[d], job.box[d]);
                wanted[d + 1] = std::min(wanted[d + 1], job.box[d + 1]);
            }
            if (wanted[0] >= wanted[1] || wanted[2] >= wanted[3]) continue;
            if (plan.is_still(j * plan.roots_across() + i)) {  // copied
                std::copy(wanted, wanted + 4, part.box);
            } else {
                seen(job, plan.extent(j * plan.roots_across() + i), levels, part.box);
                for (int d = 0; d < 2; d++) {  // whole samples of the pyramid
                    part.box[2 * d] &= -apart;
                    part.box[2 * d + 1] = std::min((part.box[2 * d + 1] + apart - 1) & -apart, size[d]);
                }
            }
            part.frames[0] = part.frames[1] = 0;
            all |= part;
        }
    Span span = frames_of(plan, job);
    all.frames[0] = job.count;
    all.frames[1] = 0;
    for (int k = span.first; k <= span.last; k++) {
        int frame = placed(k, job.count, job.rule);
        if (frame < 0) continue;
        all.frames[0] = std::min(all.frames[0], frame);
        all.frames[1] = std::max(all.frames[1], frame + 1);
    }
    return all.empty() ? Portion() : all;
}

// Sample frames of a type in place.
template <class T, int D>
void sample_as(const Plan<D>& plan, const Job& job, Span span, const Pyramid<float>& pyramid) {
    std::vector<const T*> at;
    for (int k = span.first; k <= span.last; k++) at.push_back((const T*)job.frame(k));
    auto of = [&]<int C>() {
        const Frames<T> frames{at.data(), job.w,   job.h, job.row() * C, (ptrdiff_t)job.w * job.h * C,
                               job.rule,  job.fill};
        sample_direct(plan, job, Reader<float, T, C, D>(job, span, frames, pyramid));
    };
    if constexpr (std::is_same_v<T, int16_t>)
        of.template operator()<1>();
    else
        job.channels == 1   ? of.template operator()<1>()
        : job.channels == 2 ? of.template operator()<2>()
        : job.channels == 3 ? of.template operator()<3>()
                            : of.template operator()<4>();
}
#define SAMPLES_AS(OF, T) OF template void sample_as<T, 3>(const Plan<3>&, const Job&, Span, const Pyramid<float>&);
#if !defined(SAMPLING)  // compiled in files of their own, in parallel
SAMPLES_AS(extern, uint8_t)
SAMPLES_AS(extern, uint16_t)
#endif

// Fill job.out by sampling at the source points of a plan's grid.
template <int D>
void sample(const Plan<D>& plan, const Job& job) {
    if (job.filter == NEAREST) return sample_nearest(plan, job);
    if (job.direct()) {
        const Span span = frames_of(plan, job);
        // A pyramid's groups have one channel or four; two or three channels are padded with a fourth.
        const Averages<float> averages(job, Numbers<float>(job), 0, span, plan.widest);
        auto of = [&]<class T>() { sample_as<T>(plan, job, span, averages.pyramid); };
        return job.type == U8    ? of.template operator()<uint8_t>()
               : job.type == U16 ? of.template operator()<uint16_t>()
               : job.type == F32 ? of.template operator()<float>()
                                 : of.template operator()<int16_t>();
    }
    bool exact = job.type == F64 || bytes_of(job.type) > 4 || job.type == I32 || job.type == U32;
    exact ? sample_converted<double>(plan, job) : sample_converted<float>(plan, job);
}

}  // namespace supple
