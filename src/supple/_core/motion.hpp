// The motion between two frames: the place of a point between them in each frame, and the weight of that.
//
// For each pair of frames, a field has, at the place of a point halfway, its displacement v from one frame to the next.
// A point p at the time k + a lies on the path through p + (1/2 - a) v, so it is at p - a v in frame k, and at
// p + (1 - a) v in frame k + 1.
#pragma once
#include "footprint.hpp"
#include "plan.hpp"
#include "samples.hpp"
#include "vectors.hpp"

namespace supple {

constexpr float CUT = 0.1f;       // frames: the duration of the change of frames, halfway through a cut
constexpr float SETTLED = 0.02f;  // lattice steps: v is looked up again if its place moves farther

struct Motion {
    const float* fields;   // pairs in slots, (capacity, h, w, 4): v in pixels of the frame, its weight, and 0
    const float* longest;  // the length of each slot's longest v; 0 for the plain mixture, negative at a cut
    int capacity = 0, w, h;
    double first[2], step;  // the position of the first v in the frame, and the distance between neighbours

    // v and its weight at a position of a field.
    INLINE Pixel<float> at(const float* field, float x, float y) const {
        x = least(most(x, 0.0f), (float)(w - 1));
        y = least(most(y, 0.0f), (float)(h - 1));
        const int i = least((int)x, w - 2), j = least((int)y, h - 2);
        const float *p = field + ((ptrdiff_t)j * w + i) * 4, *q = p + 4 * (ptrdiff_t)w;
        const Pixel<float> a = load<float, 4>(p), b = load<float, 4>(p + 4);
        const Pixel<float> left = a + (y - (float)j) * (load<float, 4>(q) - a);
        const Pixel<float> right = b + (y - (float)j) * (load<float, 4>(q + 4) - b);
        return left + (x - (float)i) * (right - left);
    }
    // `longest` of the frames k and k + 1; 0 where these are one, or the constant beyond a clip's ends.
    float longest_after(int k, int count, int rule) const {
        const int i = placed(k, count, rule), j = placed(k + 1, count, rule);
        return i < 0 || j < 0 || i == j ? 0 : longest[least(i, j) % capacity];
    }
    // The longest displacement in the pairs from frame `first` to frame `last`.
    double most_from(int first, int last, int count, int rule) const {
        float found = 0;
        for (int k = first; k < last; k++) found = most(found, longest_after(k, count, rule));
        return found;
    }
    // Give the weights of n frames from `first` on that are beyond a cut, as seen at a time, to the others.
    template <class N>
    void cut(double t, int first, int n, int count, int rule, N* weight) const {
        const int own = least(most((int)floored(t + 0.5) - first, 0), n - 1);
        int low = own, high = own;
        while (low > 0 && longest_after(first + low - 1, count, rule) >= 0) low--;
        while (high < n - 1 && longest_after(first + high, count, rule) >= 0) high++;
        if (high - low == n - 1) return;
        N sum = 0;
        for (int k = 0; k < n; k++) sum += weight[k] *= k >= low && k <= high;
        for (int k = low; k <= high; k++) weight[k] /= sum;
    }
};

// The samples of a row in the frames before and after their times.
struct Followed {
    Row<3> row[2];
    float share[3][STRIDE];  // the weights of the earlier frame, the later frame, and the plain mixture

    // False if all are plain mixtures. Always called for a whole row of a root, like `Prints::find`.
    template <class Job>
    bool find(const Job& job, const Row<3>& from);
};

template <class Job>
inline bool Followed::find(const Job& job, const Row<3>& from) {
    const Motion& m = job.motion;
    const int n = from.count, every = least(most((int)(m.step / job.grid.step[0]), 1), 4);  // between two v of a row
    float scale[2], start[2];
    for (int d = 0; d < 2; d++) {
        scale[d] = (float)(job.grid.step[d] / m.step);
        start[d] = (float)((job.grid.offset[d] - m.first[d]) / m.step);
    }
    float way[STRIDE];  // 1; -1 in the mirror image of a clip, which plays backwards; 0 at a cut, or for a mixture
    float v[3][STRIDE];
    bool any = false, stays = true;
    for (int k = 0, end; k < n; k = end) {  // samples of one pair
        const int pair = from.whole[2][k];
        for (end = k + 1; end < n && from.whole[2][end] == pair;) end++;
        const int i = placed(pair, job.count, job.rule), j = placed(pair + 1, job.count, job.rule);
        const int slot = least(i, j) % m.capacity;
        const float longest = m.longest_after(pair, job.count, job.rule);
        const float forth = longest <= 0 ? 0.0f : i < j ? 1.0f : -1.0f;
        any |= longest != 0;
        stays &= longest >= 0;
        std::fill(way + k, way + end, forth);
        if (forth == 0) {
            for (int d = 0; d < 3; d++) std::fill(v[d] + k, v[d] + end, d == 2 && longest < 0 ? 1.0f : 0.0f);
            continue;
        }
        const float* field = m.fields + (ptrdiff_t)slot * m.h * m.w * 4;
        auto look = [&](int at) {
            const float x = ((float)from.whole[0][at] + from.part[0][at]) * scale[0] + start[0];
            const float y = ((float)from.whole[1][at] + from.part[1][at]) * scale[1] + start[1];
            const float ahead = forth * (0.5f - from.part[2][at]) / (float)m.step;
            Pixel<float> now = {}, last;
            for (int turn = 0; turn < 5; turn++) {
                last = now;
                now = m.at(field, x + ahead * now[0], y + ahead * now[1]);
                if (magnitude(ahead * (now[0] - last[0])) + magnitude(ahead * (now[1] - last[1])) < SETTLED) return now;
            }
            return (now + last) * 0.5f;  // where paths cross, v is not unique
        };
        Pixel<float> left = look(k), right = left;
        for (int at = k; at < end; at += every, left = right) {
            const int next = least(at + every, end - 1);
            if (next > at) right = look(next);
            stays &= left[0] == 0 && left[1] == 0 && right[0] == 0 && right[1] == 0;
            const Pixel<float> part = Pixel<float>{0, 1, 2, 3} * (1 / (float)most(next - at, 1));
            for (int d = 0; d < 3; d++) {
                const Pixel<float> four = left[d] + part * (right[d] - left[d]);  // those past the last are replaced
                memcpy(v[d] + at, &four, sizeof four);
            }
        }
    }
    if (!any || (stays && !job.average)) return false;  // without displacements, mix plainly
    for (Row<3>& to : row) {
        to.sloped = from.sloped;
        to.count = n;
        if (!from.sloped) continue;
        memcpy(to.across, from.across, sizeof from.across);
        memcpy(to.down, from.down, sizeof from.down);
    }
    for (int side = 0; side < 2; side++) {
        for (int d = 0; d < 2; d++) {
            const float per = 1 / (float)job.grid.step[d];
            for (int k = 0; k < n; k++) {
                const float to = from.part[d][k] + way[k] * ((float)side - from.part[2][k]) * per * v[d][k];
                const float whole = floored(to);
                row[side].whole[d][k] = from.whole[d][k] + (int)whole;
                row[side].part[d][k] = to - whole;
            }
        }
        for (int k = 0; k < n; k++) {
            row[side].whole[2][k] = from.whole[2][k] + side;
            row[side].part[2][k] = row[side].depth2[k] = 0;
        }
    }
    if (job.average)
        for (int k = 0; k < n; k++) v[2][k] *= most(1 - (float)covered(from.depth2[k]), 0.0f);
    for (int k = 0; k < n; k++) {
        const float a = from.part[2][k], sudden = least(most((a - 0.5f) / CUT + 0.5f, 0.0f), 1.0f);
        const float slow = job.average ? (float)(a >= 0.5f) : a;  // a mixture of two has less grain than each
        const float weight = a > 0 ? v[2][k] : 0.0f, after = way[k] == 0 ? sudden : slow;
        share[0][k] = weight * (1 - after);
        share[1][k] = weight * after;
        share[2][k] = 1 - weight;
    }
    return true;
}

}  // namespace supple
