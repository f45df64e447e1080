// Elementary functions without branches, so that loops over particles vectorize with any compiler; within 2 units in the last place
// of float32 (tan, sinh, cosh, asin, acos: 4). Polynomials are minimax fits made for these intervals.
#pragma once
#include <stdint.h>

#if defined(__FMA__) || defined(__ARM_FEATURE_FMA) || defined(__aarch64__)
#define MOTES_FMA(a, b, c) __builtin_fmaf(a, b, c)
#else
#define MOTES_FMA(a, b, c) ((a) * (b) + (c))
#endif

namespace motes {

template <class To, class From>
static inline __attribute__((always_inline)) To bits(From from) {
  return __builtin_bit_cast(To, from);
}

static inline __attribute__((always_inline)) float fma(float a, float b, float c) { return MOTES_FMA(a, b, c); }

// coefficients from the highest power down
template <class... Rest>
static inline __attribute__((always_inline)) float polynomial(float x, float value, Rest... coefficients) {
  return ((value = fma(value, x, coefficients)), ...);
}

constexpr float INF = __builtin_inff();
constexpr float NOT_A_NUMBER = __builtin_nanf("");

// 2^k for -126 <= k <= 127
static inline __attribute__((always_inline)) float power_of_two(int32_t k) { return bits<float>((k + 127) << 23); }

static inline __attribute__((always_inline)) float round_even(float x) { return __builtin_rintf(x); }

struct Reduced { float rest; int32_t twos; };

// x = twos log 2 + rest
static inline __attribute__((always_inline)) Reduced reduce_exp(float x) {
  float k = round_even(x * 1.44269504f);
  float rest = fma(-k, 0.693145752f, x);
  return {fma(-k, 1.42860677e-06f, rest), (int32_t)k};
}

static inline __attribute__((always_inline)) float scaled(float value, int32_t twos) {
  int32_t half = twos >> 1;
  return value * power_of_two(half) * power_of_two(twos - half);
}

static inline __attribute__((always_inline)) float exp(float x) {
  float inside = x > 89.f ? 89.f : (x < -104.f ? -104.f : x);
  Reduced r = reduce_exp(inside);
  float p = polynomial(r.rest, 0.00138141913f, 0.00836891402f, 0.0416684076f, 0.166665196f, 0.49999994f);
  float value = scaled(fma(p, r.rest * r.rest, r.rest) + 1.f, r.twos);
  return x > 88.7228394f ? INF : (x < -103.972084f ? 0.f : value);
}

static inline __attribute__((always_inline)) float expm1(float x) {
  float inside = x > 89.f ? 89.f : (x < -30.f ? -30.f : x);
  Reduced r = reduce_exp(inside);
  float p = polynomial(r.rest, 2.48094457e-05f, 0.000199045782f, 0.00138889474f, 0.00833329f, 0.0416666679f, 0.166666672f, 0.5f);
  float small = fma(p, r.rest * r.rest, r.rest);
  float half = power_of_two(r.twos - 1);  // 2^twos itself may overflow
  float value = 2.f * fma(half, small, half - 0.5f);
  return x > 88.7228394f ? INF : (x != x ? x : value);
}

// log of (1 + rest) 2^twos, and of that plus a correction much smaller than 1
static inline __attribute__((always_inline)) float log_reduced(float rest, float twos, float correction) {
  float p = polynomial(rest, 0.0674664378f, -0.116756566f, 0.118881635f, -0.124055885f, 0.142195523f, -0.166679963f, 0.200021192f,
                       -0.250000089f, 0.333333135f);
  float square = rest * rest;
  float low = fma(rest * square, p, fma(twos, 1.42860677e-06f, correction));
  return fma(twos, 0.693145752f, fma(-0.5f, square, low) + rest);
}

static inline __attribute__((always_inline)) float log_of(float x, float correction) {
  bool tiny = x < 1.17549435e-38f;
  float y = tiny ? x * 8388608.f : x;
  int32_t i = bits<int32_t>(y) - 0x3F3504F3;  // splits at sqrt(1/2)
  int32_t k = i >> 23;
  float mantissa = bits<float>((i & 0x007FFFFF) + 0x3F3504F3);
  return log_reduced(mantissa - 1.f, (float)k - (tiny ? 23.f : 0.f), correction);
}

static inline __attribute__((always_inline)) float log1p(float x) {
  float sum = 1.f + x;
  float lost = x >= 1.f ? 1.f - (sum - x) : x - (sum - 1.f);
  float value = log_of(sum, lost / sum);
  float small = (x > -1e-4f) & (x < 1e-4f) ? fma(-0.5f * x, x, x) : value;
  return sum == 0.f ? -INF : (sum < 0.f ? NOT_A_NUMBER : ((x == INF) | (x != x) ? x : small));
}

struct Turned { float rest; int32_t quarter; };

static inline __attribute__((always_inline)) Turned quarters(float x) {
  double k = __builtin_rint((double)x * 0.63661977236758134);
  k = k > 1e9 ? 1e9 : (k < -1e9 ? -1e9 : k);
  double rest = ((double)x - k * 1.5707963267948966) - k * 6.123233995736766e-17;
  return {(float)rest, (int32_t)k};
}

static inline __attribute__((always_inline)) float sine_core(float x) {
  float s = x * x;
  float p = polynomial(s, 2.71802583e-06f, -0.000198393027f, 0.00833332911f, -0.166666672f);
  return fma(p * s, x, x);
}

static inline __attribute__((always_inline)) float cosine_core(float x) {
  float s = x * x;
  float p = polynomial(s, -2.72048538e-07f, 2.47994485e-05f, -0.00138888834f, 0.0416666679f);
  return fma(p, s * s, fma(-0.5f, s, 1.f));
}

// arctan on [0, 1]
static inline __attribute__((always_inline)) float atan_core(float x) {
  float s = x * x;
  float p = polynomial(s, -0.00179362041f, 0.0109146005f, -0.0311778374f, 0.0579575859f, -0.0840345025f, 0.109521858f, -0.142642424f,
                       0.199985489f, -0.333332986f);
  return fma(p * s, x, x);
}

static inline __attribute__((always_inline)) float atan2(float y, float x) {
  float wide = __builtin_fabsf(x), high = __builtin_fabsf(y);
  float large = wide > high ? wide : high, small = wide > high ? high : wide;
  float ratio = large == 0.f ? 0.f : (small == INF ? 1.f : small / large);
  float angle = atan_core(ratio);
  angle = high > wide ? 1.57079637f - angle : angle;
  angle = bits<int32_t>(x) < 0 ? 3.14159274f - angle : angle;
  angle = (x != x) | (y != y) ? NOT_A_NUMBER : angle;
  return __builtin_copysignf(angle, y);
}


static inline __attribute__((always_inline)) float asin(float x) {
  float size = __builtin_fabsf(x);
  bool outer = size > 0.5f;
  float s = outer ? 0.5f * (1.f - size) : size * size;
  float root = outer ? __builtin_sqrtf(s) : size;
  float p = polynomial(s, 0.0421663299f, 0.0241795015f, 0.0454703793f, 0.0749529749f, 0.166667521f);
  float inner = fma(p * s, root, root);
  return __builtin_copysignf(outer ? 1.57079637f - 2.f * inner : inner, x);
}

static inline __attribute__((always_inline)) float acos(float x) {
  float size = __builtin_fabsf(x);
  float near_one = 2.f * asin(__builtin_sqrtf(0.5f * (1.f - size)));
  float folded = x < 0.f ? 3.14159274f - near_one : near_one;
  return size > 0.5f ? folded : 1.57079637f - asin(x);
}

static inline __attribute__((always_inline)) float tanh(float x) {
  float s = x * x;
  float p = polynomial(s, -0.005704985f, 0.0206390861f, -0.0537397154f, 0.133314416f, -0.333332807f);
  float inner = fma(p * s, x, x);
  float size = __builtin_fabsf(x);
  float outer = __builtin_copysignf(1.f - 2.f / (exp(2.f * size) + 1.f), x);
  return x != x ? x : (size < 0.625f ? inner : outer);
}

static inline __attribute__((always_inline)) float sinh(float x) {
  float s = x * x;
  float p = polynomial(s, 2.81695134e-06f, 0.000198361595f, 0.0083333496f, 0.166666672f);
  float inner = fma(p * s, x, x);
  float half = exp(0.5f * __builtin_fabsf(x));  // the square may be the first to overflow
  float outer = __builtin_copysignf(half * (0.5f * half) - 0.5f / half / half, x);
  return __builtin_fabsf(x) < 1.f ? inner : outer;
}

static inline __attribute__((always_inline)) float absolute(float x) { return __builtin_fabsf(x); }
static inline __attribute__((always_inline)) float floor(float x) { return __builtin_floorf(x); }
static inline __attribute__((always_inline)) float ceil(float x) { return __builtin_ceilf(x); }
static inline __attribute__((always_inline)) float round_away(float x) { return __builtin_roundf(x); }
static inline __attribute__((always_inline)) float sqrt(float x) { return __builtin_sqrtf(x); }

// whole numbers in the total order of float32: -NaN, -inf, ..., -0, 0, ..., inf, NaN
static inline __attribute__((always_inline)) int32_t rank(float x) {
  int32_t word = bits<int32_t>(x);
  return word ^ ((word >> 31) & 0x7FFFFFFF);
}

// as XLA divides: by zero gives -1 (all bits set), and the lowest number by -1 itself
template <class Whole>
static inline __attribute__((always_inline)) Whole quotient(Whole a, Whole b) {
  bool negated = ((Whole)(b + 1) == 0) & ((Whole)-1 < 0);
  Whole by = (b == 0) | negated ? (Whole)1 : b;
  return b == 0 ? (Whole)-1 : negated ? (Whole)(0 - a) : (Whole)(a / by);
}

// as XLA: by zero gives the dividend
template <class Whole>
static inline __attribute__((always_inline)) Whole left_over(Whole a, Whole b) {
  bool negated = ((Whole)(b + 1) == 0) & ((Whole)-1 < 0);
  Whole by = (b == 0) | negated ? (Whole)1 : b;
  return b == 0 ? a : negated ? (Whole)0 : (Whole)(a % by);
}

// saturating, as XLA does it; NaN gives zero
template <class Whole, class Float>
static inline __attribute__((always_inline)) Whole to_whole(Float x) {
  constexpr Float beyond = sizeof(Whole) == 4 ? (Float)2147483648. : (Float)9223372036854775808.;
  constexpr Whole largest = sizeof(Whole) == 4 ? (Whole)INT32_MAX : (Whole)INT64_MAX;
  Float inside = (x >= beyond) | (x < -beyond) | (x != x) ? (Float)0 : x;
  return x >= beyond ? largest : (x < -beyond ? (Whole)(-largest - 1) : (Whole)inside);
}

// x - n y for n the quotient without its fraction, exact while n < 2^29
static inline __attribute__((always_inline)) float remainder(float x, float y) {
  double size = __builtin_fabs((double)y);
  double rest = (double)x - __builtin_trunc((double)x / size) * size;
  rest = (rest < 0) & (x > 0.f) ? rest + size : ((rest > 0) & (x < 0.f) ? rest - size : rest);
  rest = rest >= size ? rest - size : (rest <= -size ? rest + size : rest);
  return (size == (double)INF) & (__builtin_fabsf(x) < INF) ? x : __builtin_copysignf((float)rest, x);
}

// the inverse error function over its argument x, from w = -log(1 - x^2), by the two pieces of Giles (2010): where w < 5, from w - 2.5
static inline __attribute__((always_inline)) float erf_inv_slope_near(float near) {
  return polynomial(near, 2.81022636e-08f, 3.43273939e-07f, -3.5233877e-06f, -4.39150654e-06f, 0.00021858087f, -0.00125372503f,
                    -0.00417768164f, 0.246640727f, 1.50140941f);
}

static inline __attribute__((always_inline)) float erf_inv_slope(float w, float near) {
  float q = polynomial(sqrt(w) - 3.f, -0.000200214257f, 0.000100950558f, 0.00134934322f, -0.00367342844f, 0.00573950773f,
                       -0.0076224613f, 0.00943887047f, 1.00167406f, 2.83297682f);
  return w < 5.f ? erf_inv_slope_near(near) : q;
}

static inline __attribute__((always_inline)) float erf_inv(float x) {
  float size = __builtin_fabsf(x), w = -log1p(-x * x);
  float inside = erf_inv_slope(w, w - 2.5f) * x;
  return size == 1.f ? __builtin_copysignf(INF, x) : (size < 1.f ? inside : NOT_A_NUMBER);
}

}  // namespace motes
