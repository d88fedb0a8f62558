// Types of samples, the weights of frames at a time, and linear light.
//
// It uses no std::, allocation or exceptions, so that compilers for GPUs accept this file.
#pragma once
#include "simd.hpp"
#if !defined(__CUDACC_RTC__)
#include <math.h>
#endif

namespace supple {

enum Type { U8, U16, I16, F32, F64, I8, I32, U32, I64, U64 };
enum Between { BETWEEN_NEAREST, BETWEEN_LINEAR, BETWEEN_CUBIC };
constexpr double LONGEST = 64;  // the longest time average of a pixel, in frames

// ---- time ----------------------------------------------------------------------------------------------------------

// The integral of the tent, or of Catmull and Rom's cubic, from 0 to t.
INLINE double integral(int between, double t) {
    double x = least(magnitude(t), 2.0), value;
    if (between == BETWEEN_CUBIC)
        value = x <= 1 ? x - 5.0 / 6 * x * x * x + 3.0 / 8 * x * x * x * x
                       : 2 * x - 2 * x * x + 5.0 / 6 * x * x * x - x * x * x * x / 8 - 1.0 / 6;
    else {
        x = least(x, 1.0);
        value = x - 0.5 * x * x;
    }
    return t > 0 ? value : -value;
}

// The number of frames, beyond one, that a pixel covers, from |∂p_z/∂q|².
INLINE double covered(double rate2) { return rate2 > 1 ? least(root(rate2 - 1), LONGEST) : 0; }

// The number of frames that a pixel reads at a time t, if it covers `width` frames beyond one; and the first of them.
INLINE int frames_at(int between, double t, double width, int& first) {
    if (between == BETWEEN_NEAREST) {
        first = (int)floored(t + 0.5);
        return 1;
    }
    if (width > 1e-3) {
        const double radius = (between == BETWEEN_CUBIC ? 2 : 1) + width / 2;
        first = (int)floored(t - radius) + 1;
        const int n = -(int)floored(-(t + radius)) - first, most = (int)LONGEST + 6;
        return n < most ? n : most;
    }
    const double base = floored(t);
    first = (int)base;
    if (t == base) return 1;
    if (between == BETWEEN_LINEAR) return 2;
    first -= 1;
    return 4;
}
// The weight of the k-th frame for a time at the fraction f after a frame.
template <class N>
INLINE N tap(int between, N f, int k) {
    if (between == BETWEEN_NEAREST || f == 0) return 1;
    if (between == BETWEEN_LINEAR) return k == 0 ? 1 - f : f;
    const N half = N(0.5);
    return k == 0   ? half * f * (f * (2 - f) - 1)
           : k == 1 ? half * (f * f * (3 * f - 5) + 2)
           : k == 2 ? half * f * (f * (4 - 3 * f) + 1)
                    : half * f * f * (f - 1);
}
// The weight of the frame `first` + k.
INLINE double time_weight(int between, double t, double width, int first, int k) {
    if (between == BETWEEN_NEAREST || !(width > 1e-3)) return tap(between, t - floored(t), k);
    const double d = first + k - t;
    return (integral(between, d + width / 2) - integral(between, d - width / 2)) / width;
}

// ---- light ---------------------------------------------------------------------------------------------------------

// From sRGB's values, 0 to 1, to linear light, and back.
INLINE double to_light(double u) { return u <= 0.04045 ? u / 12.92 : pow((u + 0.055) / 1.055, 2.4); }
INLINE double from_light(double u) { return u <= 0.0031308 ? 12.92 * u : 1.055 * pow(u, 1 / 2.4) - 0.055; }

}  // namespace supple
