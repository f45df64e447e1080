// The elementary functions once more, in double precision: within 2 units in the last place (tanh, logistic: 3;
// tan, sinh, cosh, asin, acos: 4; erf_inv: 6).
// Whole parts of quotients are read off the bits of a sum with a large number: not every processor converts eight doubles to 64-bit integers.
#pragma once
#include "math.hpp"

#if defined(__FMA__) || defined(__ARM_FEATURE_FMA) || defined(__aarch64__)
#define MOTES_FMA_DOUBLE(a, b, c) __builtin_fma(a, b, c)
#else
#define MOTES_FMA_DOUBLE(a, b, c) ((a) * (b) + (c))
#endif

namespace motes {

static inline __attribute__((always_inline)) double fma(double a, double b, double c) { return MOTES_FMA_DOUBLE(a, b, c); }

// coefficients from the highest power down
template <class... Rest>
static inline __attribute__((always_inline)) double polynomial(double x, double value, Rest... coefficients) {
  return ((value = fma(value, x, coefficients)), ...);
}

constexpr double ROUNDER = 6755399441055744.;  // 3/2 2^52: what is added to it and is below 2^51 becomes whole
constexpr int64_t ROUNDER_BITS = 0x4338000000000000;
constexpr int64_t SQRT_HALF_BITS = 0x3FE6A09E667F3BCD;

static inline __attribute__((always_inline)) double absolute(double x) { return __builtin_fabs(x); }
static inline __attribute__((always_inline)) double floor(double x) { return __builtin_floor(x); }
static inline __attribute__((always_inline)) double ceil(double x) { return __builtin_ceil(x); }
static inline __attribute__((always_inline)) double round_away(double x) { return __builtin_round(x); }
static inline __attribute__((always_inline)) double round_even(double x) { return __builtin_rint(x); }
static inline __attribute__((always_inline)) double sqrt(double x) { return __builtin_sqrt(x); }

// 2^k for -1022 <= k <= 1023
static inline __attribute__((always_inline)) double power_of_two(int64_t k) { return bits<double>((int64_t)((uint64_t)(k + 1023) << 52)); }

struct ReducedDouble { double rest; int64_t twos; };

// x = twos log 2 + rest
static inline __attribute__((always_inline)) ReducedDouble reduce_exp(double x) {
  double shifted = fma(x, 1.4426950408889634, ROUNDER);
  double k = shifted - ROUNDER;
  double rest = fma(-k, 6.93147180369123816490e-01, x);
  return {fma(-k, 1.90821492927058770002e-10, rest), bits<int64_t>(shifted) - ROUNDER_BITS};
}

// exp(rest) - 1
static inline __attribute__((always_inline)) double expm1_core(double rest) {
  double p = polynomial(rest, 2.0914686968086876e-09, 2.5105217004720745e-08, 2.75572736431103e-07, 2.7557255400206422e-06,
                        2.4801587325547743e-05, 0.00019841269874820627, 0.0013888888888883748, 0.008333333333326136, 0.04166666666666667,
                        0.1666666666666667, 0.5);
  return fma(p, rest * rest, rest);
}

static inline __attribute__((always_inline)) double exp(double x) {
  double inside = x > 710. ? 710. : (x < -746. ? -746. : x);
  ReducedDouble r = reduce_exp(inside);
  int64_t half = (int64_t)((uint64_t)(r.twos + 4096) >> 1) - 2048;
  double value = (expm1_core(r.rest) + 1.) * power_of_two(half) * power_of_two(r.twos - half);
  return x > 709.782712893384 ? INF : (x < -745.1332191019411 ? 0. : value);
}

static inline __attribute__((always_inline)) double expm1(double x) {
  double inside = x > 710. ? 710. : (x < -60. ? -60. : x);
  ReducedDouble r = reduce_exp(inside);
  double half = power_of_two(r.twos - 1);  // 2^twos itself may overflow
  double value = 2. * fma(half, expm1_core(r.rest), half - 0.5);
  return x > 709.782712893384 ? INF : ((x != x) | (x == 0.) ? x : value);
}

struct FactoredDouble { double rest, twos; };

// x = (1 + rest) 2^twos, for x > 0 that is not tiny, with 1 + rest between sqrt(1/2) and sqrt(2)
static inline __attribute__((always_inline)) FactoredDouble factor(double x) {
  int64_t i = bits<int64_t>(x) - SQRT_HALF_BITS;
  int64_t above = (int64_t)(((uint64_t)i + (1024ull << 52)) >> 52);  // twos + 1024: not every processor shifts negative ones
  return {bits<double>((i & 0x000FFFFFFFFFFFFF) + SQRT_HALF_BITS) - 1., bits<double>(above + ROUNDER_BITS) - (ROUNDER + 1024.)};
}

// log of x > 0, and of that plus a correction much smaller than 1
static inline __attribute__((always_inline)) double log_of(double x, double correction) {
  bool tiny = x < 2.2250738585072014e-308;
  FactoredDouble factored = factor(tiny ? x * 18014398509481984. : x);
  double rest = factored.rest, twos = factored.twos - (tiny ? 54. : 0.);
  double s = rest / (2. + rest), z = s * s, half = 0.5 * rest * rest;
  double p = polynomial(z, 0.1308723619665962, 0.13268714792348096, 0.15386241881938595, 0.18181795600060793, 0.22222222392089008,
                        0.28571428570801954, 0.4000000000000088, 0.6666666666666666);
  double low = fma(s, fma(p, z, half), fma(twos, 1.90821492927058770002e-10, correction));
  return fma(twos, 6.93147180369123816490e-01, -((half - low) - rest));
}

static inline __attribute__((always_inline)) double log1p(double x) {
  double sum = 1. + x;
  double lost = x >= 1. ? 1. - (sum - x) : x - (sum - 1.);
  double value = log_of(sum, lost / sum);
  double inside = (x == INF) | (x != x) | (x == 0.) ? x : value;
  return sum == 0. ? -INF : (sum < 0. ? NOT_A_NUMBER : inside);
}

struct TurnedDouble { double rest; int64_t quarter; };

// x - quarter pi/2, the latter in three parts of which the first two have 33 bits
static inline __attribute__((always_inline)) TurnedDouble quarters(double x) {
  double turns = x * 0.63661977236758134;
  turns = turns > 1073741824. ? 1073741824. : (turns < -1073741824. ? -1073741824. : turns);
  double shifted = turns + ROUNDER;
  double k = shifted - ROUNDER;
  double rest = fma(-k, 1.57079632673412561417e+00, x);
  rest = fma(-k, 6.07710050630396597660e-11, rest);
  return {fma(-k, 2.02226624879595063154e-21, rest), bits<int64_t>(shifted)};
}

static inline __attribute__((always_inline)) double sine_core(double x) {
  double s = x * x;
  double p = polynomial(s, -7.586685070091267e-13, 1.605853141458901e-10, -2.5052106231157904e-08, 2.7557319219335453e-06,
                        -0.0001984126984126506, 0.008333333333333331, -0.16666666666666666);
  return fma(p * s, x, x);
}

static inline __attribute__((always_inline)) double cosine_core(double x) {
  double s = x * x;
  double p = polynomial(s, -1.1382614868556325e-11, 2.0876146024689747e-09, -2.7557317270560326e-07, 2.4801587298763433e-05,
                        -0.0013888888888887395, 0.041666666666666664);
  double half = 0.5 * s, most = 1. - half;
  return most + fma(p, s * s, (1. - most) - half);
}

// arctan of small / large, both positive and the first not the larger: beyond tan(pi/8) turned back by pi/4
static inline __attribute__((always_inline)) double atan_of(double small, double large) {
  bool turned = small > 0.41421356237309503 * large;
  double above = turned ? small - large : small, below = turned ? small + large : large;
  double x = below == 0. ? 0. : above / below, s = x * x;
  double p = polynomial(s, 0.016284375050043393, -0.03456931506332609, 0.045515447340221615, -0.05230443640686948, 0.05878927554473807,
                        -0.0666642476020052, 0.07692296368042296, -0.09090908753259112, 0.11111111105150588, -0.14285714285659779,
                        0.19999999999999804, -0.3333333333333333);
  double core = fma(p * s, x, x);
  return turned ? 0.7853981633974483 + (core + 3.061616997868383e-17) : core;
}

static inline __attribute__((always_inline)) double atan2(double y, double x) {
  double wide = __builtin_fabs(x), high = __builtin_fabs(y);
  double large = wide > high ? wide : high, small = wide > high ? high : wide;
  double scale = large > 1e300 ? 1e-10 : (large < 1e-290 ? 1e10 : 1.);  // a sum of both stays a number
  bool endless = small == INF;
  double angle = atan_of(endless ? 1. : small * scale, endless ? 1. : large * scale);
  angle = high > wide ? 1.5707963267948966 - (angle - 6.123233995736766e-17) : angle;
  angle = bits<int64_t>(x) < 0 ? 3.141592653589793 - (angle - 1.2246467991473532e-16) : angle;
  angle = (x != x) | (y != y) ? NOT_A_NUMBER : angle;
  return __builtin_copysign(angle, y);
}


static inline __attribute__((always_inline)) double asin(double x) {
  double size = __builtin_fabs(x);
  bool outer = size > 0.5;
  double s = outer ? 0.5 * (1. - size) : size * size;
  double root = outer ? __builtin_sqrt(s) : size;
  double p = polynomial(s, 0.02877844261259304, -0.014881409392818066, 0.017419357964884856, 0.00545087818772055, 0.010324318288744113,
                        0.011478952690257387, 0.013971235301124539, 0.017352391265909227, 0.022372173002005596, 0.030381944137085216,
                        0.04464285714637338, 0.07499999999998425, 0.16666666666666669);
  double inner = fma(p * s, root, root);
  return __builtin_copysign(outer ? 1.5707963267948966 - (2. * inner - 6.123233995736766e-17) : inner, x);
}

static inline __attribute__((always_inline)) double acos(double x) {
  double size = __builtin_fabs(x);
  double near_one = 2. * asin(__builtin_sqrt(0.5 * (1. - size)));
  double folded = x < 0. ? 3.141592653589793 - (near_one - 1.2246467991473532e-16) : near_one;
  return size > 0.5 ? folded : 1.5707963267948966 - (asin(x) - 6.123233995736766e-17);
}

static inline __attribute__((always_inline)) double tanh(double x) {
  double size = __builtin_fabs(x);
  double more = expm1(2. * (size > 22. ? 22. : size));
  return __builtin_copysign(more / (more + 2.), x);
}

static inline __attribute__((always_inline)) double sinh(double x) {
  double size = __builtin_fabs(x);
  double more = expm1(size > 1. ? 1. : size);
  double inner = 0.5 * (more + more / (more + 1.));
  double half = exp(0.5 * size);  // the square may be the first to overflow
  return __builtin_copysign(size < 1. ? inner : half * (0.5 * half) - 0.5 / half / half, x);
}


// whole numbers in the total order of float64
static inline __attribute__((always_inline)) int64_t rank(double x) {
  int64_t word = bits<int64_t>(x);
  return word ^ (word < 0 ? INT64_MAX : 0);
}

// x - n y for n the quotient without its fraction, exact while n < 2^100: what is left of a rounded quotient is a double (fused)
static inline __attribute__((always_inline)) double remainder(double x, double y) {
  double size = __builtin_fabs(y);
  double rest = __builtin_fma(-__builtin_trunc(x / size), size, x);
  rest = __builtin_fma(-__builtin_trunc(rest / size), size, rest);
  rest = (rest < 0) & (x > 0.) ? rest + size : ((rest > 0) & (x < 0.) ? rest - size : rest);
  rest = rest >= size ? rest - size : (rest <= -size ? rest + size : rest);
  return (size == INF) & (__builtin_fabs(x) < INF) ? x : __builtin_copysign(rest, x);
}

// inverse error function over its argument, for w = -log(1 - x^2) below 37: one rational fit, relative error 4e-16, all terms positive
static inline __attribute__((always_inline)) double erf_inv_slope(double w) {
  double above = polynomial(w, 6.552278792315236e-18, 8.971775296547198e-15, 1.1463073011495388e-12, 3.3466637848058696e-11,
                            1.0715689140725503e-09, 2.3186790497885494e-08, 4.092950831955036e-07, 5.918172496398085e-06,
                            6.922194356995133e-05, 0.0006511154704441467, 0.004914311812418407, 0.029358885509827348,
                            0.13290734025861248, 0.4437462229088739, 0.886226925452758);
  double below = polynomial(w, 3.6503073201934257e-16, 1.278283353555561e-13, 7.145828276360274e-12, 1.7963081207581553e-10,
                            5.829580201029391e-09, 9.431982348568857e-08, 1.8027883874053928e-06, 2.0249651161433807e-05,
                            0.00024332523791208575, 0.0019008001466745822, 0.013173997886877988, 0.07439013946739667,
                            0.23891460560855823, 1.);
  return above / below;
}

static inline __attribute__((always_inline)) double erf_inv(double x) {
  double size = __builtin_fabs(x);
  double inside = erf_inv_slope(-log_of((1. - x) * (1. + x), 0.)) * x;
  return size == 1. ? __builtin_copysign(INF, x) : (size < 1. ? inside : NOT_A_NUMBER);
}

}  // namespace motes
