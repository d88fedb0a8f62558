// Short vectors of samples: Pack<N, L> is L numbers of type N (float or double), a register or a Pair of halves.
#pragma once
#include "simd.hpp"

namespace supple {

#if defined(__AVX__)
constexpr int REGISTER = 32;
#else
constexpr int REGISTER = 16;
#endif

template <class H>
struct Pair {
    H a, b;
    static constexpr int half = sizeof(H) / sizeof(decltype(H{}[0] + 0));
#define EACH(op)                                                                        \
    friend INLINE Pair operator op(Pair x, Pair y) { return {x.a op y.a, x.b op y.b}; } \
    template <class S>                                                                  \
    friend INLINE Pair operator op(Pair x, S y) {                                       \
        return {x.a op y, x.b op y};                                                    \
    }                                                                                   \
    template <class S>                                                                  \
    friend INLINE Pair operator op(S x, Pair y) {                                       \
        return {x op y.a, x op y.b};                                                    \
    }
    // clang-format off
    EACH(+) EACH(-) EACH(*)
#undef EACH
        // clang-format on
        INLINE Pair& operator+=(Pair y) {
        return *this = *this + y;
    }
    INLINE auto operator[](int i) const { return i < half ? a[i] : b[i - half]; }
};

template <class N, int L, bool NATIVE = (sizeof(N) * L <= REGISTER)>
struct PackOf;
template <class N, int L>
struct PackOf<N, L, true> {
    typedef N type __attribute__((vector_size(sizeof(N) * L)));
};
template <class N, int L>
struct PackOf<N, L, false> {
    typedef Pair<typename PackOf<N, L / 2>::type> type;
};
template <class N, int L>
using Pack = typename PackOf<N, L>::type;
template <class N>
using Pixel = Pack<N, 4>;  // up to four channels

// Four lanes of two consecutive pixels, from lane `BY` on.
template <class N, int BY>
INLINE Pixel<N> straddle(Pixel<N> a, Pixel<N> b) {
    if constexpr (sizeof(Pixel<N>) <= REGISTER)
        return __builtin_shufflevector(a, b, BY, BY + 1, BY + 2, BY + 3);
    else {
        N all[8], out[4];
        memcpy(all, &a, sizeof a);
        memcpy(all + 4, &b, sizeof b);
        for (int i = 0; i < 4; i++) out[i] = all[BY + i];
        Pixel<N> r;
        memcpy(&r, out, sizeof r);
        return r;
    }
}
// Quarter (or half) K of a pack: its lanes 4K to 4K + 3.
template <class N, int K, class V>
INLINE Pixel<N> part(V v) {
    if constexpr (sizeof(V) == 4 * sizeof(N))
        return v;
    else if constexpr (sizeof(V) > REGISTER) {
        constexpr int half = (int)(sizeof(V) / sizeof(N) / 8);
        if constexpr (K < half)
            return part<N, K>(v.a);
        else
            return part<N, K - half>(v.b);
    } else
        return __builtin_shufflevector(v, v, 4 * K, 4 * K + 1, 4 * K + 2, 4 * K + 3);
}

// L consecutive samples, converted to N.
template <class N, int L, class T>
INLINE Pack<N, L> load(const T* p) {
    [[maybe_unused]] constexpr bool positive = T(-1) > T(0);
    if constexpr (sizeof(N) * L > REGISTER)
        return {load<N, L / 2>(p), load<N, L / 2>(p + L / 2)};
    else if constexpr (sizeof(T) == sizeof(N)) {
        Pack<N, L> r;
        memcpy(&r, p, sizeof r);
        return r;
    }
#if defined(__AVX2__)
    else if constexpr (L == 8 && sizeof(T) == 1)
        return (Pack<N, L>)_mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_loadl_epi64((const __m128i*)p)));
    else if constexpr (L == 8) {
        const __m128i x = _mm_loadu_si128((const __m128i*)p);
        return (Pack<N, L>)_mm256_cvtepi32_ps(positive ? _mm256_cvtepu16_epi32(x) : _mm256_cvtepi16_epi32(x));
    }
#endif
#if defined(__SSE4_1__)
    else if constexpr (sizeof(T) == 1) {
        int32_t word;
        memcpy(&word, p, 4);
        const __m128i x = _mm_cvtsi32_si128(word);
        return (Pack<N, L>)_mm_cvtepi32_ps(positive ? _mm_cvtepu8_epi32(x) : _mm_cvtepi8_epi32(x));
    } else {
        const __m128i x = _mm_loadl_epi64((const __m128i*)p);
        return (Pack<N, L>)_mm_cvtepi32_ps(positive ? _mm_cvtepu16_epi32(x) : _mm_cvtepi16_epi32(x));
    }
#else
    else {
        Pack<N, L> r;
        for (int i = 0; i < L; i++) r[i] = (N)p[i];
        return r;
    }
#endif
}

// The number of lanes for n numbers.
constexpr int lanes_for(int n) { return n <= 4 ? 4 : n <= 8 ? 8 : 16; }

// The sums over four pixels of C channels each, which lie one after the other in a pack.
template <class N, int C, class V>
INLINE Pixel<N> sum_of(V v) {
    Pixel<N> a = part<N, 0>(v);
    if constexpr (C == 4)
        return a + part<N, 1>(v) + (part<N, 2>(v) + part<N, 3>(v));
    else if constexpr (C == 3) {
        Pixel<N> b = part<N, 1>(v), c = part<N, 2>(v);
        return a + straddle<N, 3>(a, b) + (straddle<N, 2>(b, c) + straddle<N, 1>(c, c));
    } else {
        if constexpr (C == 2)
            a += part<N, 1>(v);
        else
            a += straddle<N, 2>(a, a);
        return a + straddle<N, C>(a, a);
    }
}

}  // namespace supple
