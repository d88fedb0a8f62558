// The motion between two frames: where a point that is seen between them lies in each, and how far that is trusted.
//
// A field holds, for each pair of frames and where a point is halfway, the displacement v from one frame to the next.
// A point p at the time k + a lies on the path through p + (1/2 - a) v, so it is at p - a v in frame k, and at
// p + (1 - a) v in frame k + 1.
#pragma once
#include "footprint.hpp"
#include "plan.hpp"
#include "samples.hpp"
#include "vectors.hpp"

namespace supple {

constexpr float CUT = 0.1f;       // frames: how fast one frame replaces the other halfway through a cut
constexpr float SETTLED = 0.02f;  // displacements: v is looked up again where its place moves farther

struct Motion {
    const float* fields;   // of pairs in slots: (capacity, h, w, 4) with v in pixels of the frame, its weight, nothing
    const float* longest;  // of each slot: the longest v; 0 for the plain mixture, negative at a cut
    int capacity = 0, w, h;
    double first[2], step;  // the position of the first v in the frame, and the distance of the next

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
    // The longest displacement between some frames.
    double most_from(int first, int last, int count, int rule) const {
        double found = 0;
        for (int k = first; k < last; k++) {
            const int i = placed(k, count, rule), j = placed(k + 1, count, rule);
            if (i >= 0 && j >= 0 && i != j) found = most(found, (double)longest[least(i, j) % capacity]);
        }
        return found;
    }
};

// The samples of a row in the frames before and after their times.
struct Followed {
    Row<3> row[2];
    float share[3][STRIDE];  // the weights of the frame before, of that after, and of the plain mixture

    // False if all are plain mixtures. Always for a whole row of a root, as `Prints::find`.
    template <class Job>
    bool find(const Job& job, const Row<3>& from);
};

template <class Job>
inline bool Followed::find(const Job& job, const Row<3>& from) {
    const Motion& m = job.motion;
    const int n = from.count, every = most(1, (int)(m.step / job.grid.step[0]));  // between two v of a row
    const float* field[STRIDE];  // of the pair of each sample; null for none
    float way[STRIDE];           // 1, or -1 in a mirror image of the clip, which plays backwards
    float v[3][STRIDE];
    bool any = false;
    for (int k = 0; k < n; k++) {
        if (k > 0 && from.whole[2][k] == from.whole[2][k - 1]) {
            field[k] = field[k - 1];
            way[k] = way[k - 1];
            share[2][k] = share[2][k - 1];
            continue;
        }
        const int i = placed(from.whole[2][k], job.count, job.rule);
        const int j = placed(from.whole[2][k] + 1, job.count, job.rule);
        field[k] = nullptr;
        way[k] = share[2][k] = 0;
        if (i < 0 || j < 0 || i == j) continue;
        const int slot = least(i, j) % m.capacity;
        if (m.longest[slot] == 0) continue;
        field[k] = m.fields + (ptrdiff_t)slot * m.h * m.w * 4;
        if (m.longest[slot] > 0) way[k] = i < j ? 1 : -1;
        share[2][k] = 1;
        any = true;
    }
    if (!any) return false;
    float scale[2], start[2];
    for (int d = 0; d < 2; d++) {
        scale[d] = (float)(job.grid.step[d] / m.step);
        start[d] = (float)((job.grid.offset[d] - m.first[d]) / m.step);
    }
    auto look = [&](int k) {
        if (way[k] == 0) {
            v[0][k] = v[1][k] = 0;
            v[2][k] = share[2][k];
            return;
        }
        const float x = ((float)from.whole[0][k] + from.part[0][k]) * scale[0] + start[0];
        const float y = ((float)from.whole[1][k] + from.part[1][k]) * scale[1] + start[1];
        const float ahead = way[k] * (0.5f - from.part[2][k]) / (float)m.step;
        Pixel<float> now = m.at(field[k], x, y), last = now;
        for (int turn = 0; turn < 4; turn++) {
            last = now;
            now = m.at(field[k], x + ahead * now[0], y + ahead * now[1]);
            if (magnitude(ahead * (now[0] - last[0])) + magnitude(ahead * (now[1] - last[1])) < SETTLED) break;
        }
        now = (now + last) * 0.5f;  // where paths cross, there is no one v
        for (int d = 0; d < 3; d++) v[d][k] = now[d];
    };
    look(0);
    for (int left = 0, right; left < n - 1; left = right) {
        right = least(left + every, n - 1);
        look(right);
        const float share = 1 / (float)(right - left);
        for (int k = left + 1; k < right; k++) {
            if (field[left] != field[k] || field[right] != field[k])
                look(k);
            else
                for (int d = 0; d < 3; d++)
                    v[d][k] = v[d][left] + (float)(k - left) * share * (v[d][right] - v[d][left]);
        }
    }
    if (!job.average) {  // what stays in place is mixed
        bool stays = true;
        for (int k = 0; k < n; k++) stays &= !field[k] || (way[k] != 0 && v[0][k] == 0 && v[1][k] == 0);
        if (stays) return false;
    }
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
    for (int k = 0; k < n; k++) {
        const float a = from.part[2][k];
        float weight = a > 0 ? v[2][k] : 0;
        if (job.average) weight *= most(1 - (float)covered(from.depth2[k]), 0.0f);
        const float after = way[k] == 0   ? least(most((a - 0.5f) / CUT + 0.5f, 0.0f), 1.0f)
                            : job.average ? (float)(a >= 0.5f)  // a mixture of two has less grain than each
                                          : a;
        share[0][k] = weight * (1 - after);
        share[1][k] = weight * after;
        share[2][k] = 1 - weight;
    }
    return true;
}

}  // namespace supple
