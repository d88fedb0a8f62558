// Samples of any type as numbers, and their averages.
#include "stack.hpp"

namespace supple {

template <class N>
Numbers<N>::Numbers(const Job& job) : job(job), lanes(job.channels == 1 ? 1 : 4), colours(job.alpha < 0 ? lanes : 3) {
    if (!job.light || bytes_of(job.type) > 2 || job.type == I8 || job.type == I16) return;
    table.resize(job.type == U8 ? 256 : 65536);
    for (size_t i = 0; i < table.size(); i++) table[i] = (N)(job.white * to_light(i / job.white));
}
template <class N>
template <class T>
N Numbers<N>::number(T v) const {
    if (!job.light) return (N)v;
    if constexpr (sizeof(T) <= 2)
        if (!table.empty()) return table[v];
    return (N)(job.white * to_light((double)v / job.white));
}
template <class N>
template <class T>
void Numbers<N>::convert(const T* p, int n, int group, N* out) const {
    int some = count(group), first = group * colours, i = 0;
    // Four numbers at once, except for the last pixels, where fewer may be readable.
    if constexpr (sizeof(N) == sizeof(float) && (sizeof(T) < 4 || std::is_same_v<T, N>))
        for (; lanes == 4 && !job.light && i + 4 < n; i++, p += job.channels, out += lanes) {
            Pixel<N> v = load<N, 4>(p + first);
            if (job.alpha >= 0) {
                v *= (N)((double)p[job.alpha] / job.white);
                v[3] = (N)p[job.alpha];
            }
            for (int c = 0; c < 4; c++) v[c] = c < some || (c == 3 && job.alpha >= 0) ? v[c] : 0;
            memcpy(out, &v, sizeof v);
        }
    for (; i < n; i++, p += job.channels, out += lanes) {
        N weight = job.alpha < 0 ? 1 : (N)((double)p[job.alpha] / job.white);
        for (int c = 0; c < some; c++) out[c] = number(p[first + c]) * weight;
        for (int c = some; c < lanes; c++) out[c] = 0;
        if (job.alpha >= 0) out[lanes - 1] = (N)p[job.alpha];
    }
}
template <class N>
void Numbers<N>::convert(const char* frame, int x, int y, int n, int group, N* out) const {
    const char* p = job.sample(frame, x, y);
    with_type(job.type, [&]<class T>(T) { convert((const T*)p, n, group, out); });
}
template <class N>
void Numbers<N>::constant(int group, double* out) const {
    int some = count(group), first = group * colours;
    double weight = job.alpha < 0 ? 1 : job.fill[job.alpha] / job.white;
    for (int c = 0; c < 4; c++) out[c] = 0;
    for (int c = 0; c < some; c++)
        out[c] = weight * (job.light ? job.white * to_light(job.fill[first + c] / job.white) : job.fill[first + c]);
    if (job.alpha >= 0) out[lanes - 1] = job.fill[job.alpha];
}
template <class N>
template <class T>
void Numbers<N>::store(const N* from, int n, int group, T* p) const {
    constexpr bool whole = std::numeric_limits<T>::is_integer;
    const int some = count(group), first = group * colours;
    const double low = whole ? (double)std::numeric_limits<T>::lowest() : 0;
    const double high = whole ? std::min((double)std::numeric_limits<T>::max(), job.white) : 0;
    const T most = high >= (double)std::numeric_limits<T>::max() ? std::numeric_limits<T>::max() : (T)high;
    for (int i = 0; i < n; i++, p += job.channels, from += 4) {
        double v[4];
        for (int c = 0; c < 4; c++) v[c] = c < lanes ? from[c] : 0;
        if (job.alpha >= 0) {
            // A cubic overshoots: clamp opacity to its range. The colours overshoot with it, and are divided by the
            // unclamped value.
            const double opacity = v[lanes - 1];
            for (int c = 0; c < 4; c++) v[c] = opacity > 0 ? v[c] * job.white / opacity : 0;
            v[lanes - 1] = std::clamp(opacity, 0.0, job.white);
        }
        if (job.light)
            for (int c = 0; c < some; c++) v[c] = job.white * from_light(v[c] / job.white);
        T to[4];
        for (int c = 0; c < 4; c++) {
            if constexpr (whole) {
                const double rounded = floor(v[c] + 0.5);
                to[c] = rounded >= high ? most : rounded > low ? (T)rounded : rounded == rounded ? (T)low : T(0);
            } else
                to[c] = (T)v[c];
        }
        for (int c = 0; c < 4; c++)
            if (c < some) p[first + c] = to[c];
        if (job.alpha >= 0) p[job.alpha] = to[lanes - 1];
    }
}
template <class N>
void Numbers<N>::store(const N* from, int n, int group, char* p) const {
    with_type(job.type, [&]<class T>(T) { store(from, n, group, (T*)p); });
}
int levels_of(const Job& job, double widest) {
    int levels = 0, side = std::max(job.w, job.h);
    if (job.filter != AUTO) return 0;
    for (double want = widest * (1 + 1e-5); want >= 3.2 && side > 1 && levels < LEVELS;
         want /= 4, side = (side + 1) / 2)
        levels++;
    return levels;
}

template <class N>
Averages<N>::Averages(const Job& job, const Numbers<N>& numbers, int group, Span span, double widest)
    : first(span.first) {
    if (job.filter != AUTO) return;
    numbers.constant(group, fill);
    int w = job.w, h = job.h, lanes = numbers.lanes, depth = levels_of(job, widest);
    int x0 = job.held[0], x1 = job.held[1], y0 = job.held[2], y1 = job.held[3];
    while (pyramid.levels < depth) {
        const int half[4] = {x0 / 2, (x1 + 1) / 2, y0 / 2, (y1 + 1) / 2};
        const ptrdiff_t line = (ptrdiff_t)(half[1] - half[0]) * lanes, first = half[2] * line + half[0] * lanes;
        std::vector<const N*> level;
        for (int k = span.first; k <= span.last; k++) {
            const char* frame = job.frame(k);
            const N* above = pyramid.levels ? frames.back()[k - span.first] : nullptr;
            if (!frame) {
                level.push_back(nullptr);
                continue;
            }
            const size_t wide = (size_t)(x1 - x0) * lanes;
            std::vector<N> made((size_t)line * (half[3] - half[2]) + 32), rows(2 * wide);
            for (int y = half[2]; y < half[3]; y++) {
                for (int r = 0; r < 2; r++) {
                    int from = std::min(2 * y + r, h - 1);
                    N* row = rows.data() + r * wide;
                    if (above)
                        memcpy(row, above + (ptrdiff_t)from * wide + (ptrdiff_t)x0 * lanes, sizeof(N) * wide);
                    else
                        numbers.convert(frame, x0, from, x1 - x0, group, row);
                }
                for (int x = half[0]; x < half[1]; x++)
                    for (int c = 0; c < lanes; c++) {
                        int i = (2 * x - x0) * lanes + c, j = (std::min(2 * x + 1, w - 1) - x0) * lanes + c;
                        const N *a = rows.data(), *b = a + wide;
                        made[y * line + (ptrdiff_t)x * lanes + c - first] = (a[i] + a[j] + b[i] + b[j]) / 4;
                    }
            }
            samples.push_back(std::move(made));
            level.push_back(samples.back().data() - first);
        }
        frames.push_back(std::move(level));
        w = (w + 1) / 2;
        h = (h + 1) / 2;
        x0 = half[0], x1 = half[1], y0 = half[2], y1 = half[3];
        const ptrdiff_t limit = (ptrdiff_t)w * h * lanes;
        pyramid.level[pyramid.levels++] = {frames.back().data(), w, h, line, limit, job.rule, fill};
    }
}

template struct Numbers<float>;
template struct Numbers<double>;
template struct Averages<float>;
template struct Averages<double>;

}  // namespace supple
