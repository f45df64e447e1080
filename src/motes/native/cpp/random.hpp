// The random stream of motes.core.random: the same words, and normal numbers equal to it within 2 units in the last place.
#pragma once
#include "math_both.hpp"

#ifndef MOTES_REAL
#define MOTES_REAL float
#endif

namespace motes {

typedef MOTES_REAL Real;  // numbers of particles

constexpr int BLOCK = 1024;  // particles that are worked on at a time: all their numbers stay in the first-level cache
constexpr uint32_t UNIFORM_TAG = 0x80000000u;

struct Key { uint32_t first, second; };
struct Words { uint32_t first, second; };

static inline __attribute__((always_inline)) Words threefry(Key key, uint32_t a, uint32_t b) {
  uint32_t third = key.first ^ key.second ^ 0x1BD11BDAu;
  auto four = [&](int r0, int r1, int r2, int r3) {
    a += b, b = (b << r0 | b >> (32 - r0)) ^ a;
    a += b, b = (b << r1 | b >> (32 - r1)) ^ a;
    a += b, b = (b << r2 | b >> (32 - r2)) ^ a;
    a += b, b = (b << r3 | b >> (32 - r3)) ^ a;
  };
  a += key.first, b += key.second;
  four(13, 15, 26, 6), a += key.second, b += third + 1;
  four(17, 29, 16, 24), a += third, b += key.first + 2;
  four(13, 15, 26, 6), a += key.first, b += key.second + 3;
  four(17, 29, 16, 24), a += key.second, b += third + 4;
  four(13, 15, 26, 6), a += third, b += key.first + 5;
  return {a, b};
}

// a random word from a key of one particle's own
static inline __attribute__((always_inline)) uint32_t word(Key key, uint32_t number) {
  Words words = threefry(key, 0, number);
  return words.first ^ words.second;
}

static inline __attribute__((always_inline)) uint64_t word_of_64(Key key, uint32_t number) {
  Words words = threefry(key, 0, number);
  return (uint64_t)words.first << 32 | words.second;
}

// step by step as in motes.core.random: a number between -1 and 1, and 2.5 more than the log of one less its square
struct Centered { float value, log_and_more; };

static inline __attribute__((always_inline)) Centered centered(uint32_t word) {
  float value = (float)(int32_t)word * 4.65661287e-10f;
  value = value < 0.99999994f ? value : 0.99999994f;
  value = value > -0.99999994f ? value : -0.99999994f;
  int32_t shifted = bits<int32_t>((1.f - value) * (1.f + value)) - 0x3F3504F3;
  float rest = bits<float>((shifted & 0x007FFFFF) + 0x3F3504F3) - 1.f;
  float log = polynomial(rest, -0.101022407f, 0.164199948f, -0.173334658f, 0.198730454f, -0.249593437f, 0.333361834f, -0.500006676f,
                         0.999999821f);
  return {value, fma((float)(shifted >> 23), 0.693147182f, fma(log, rest, 2.5f))};
}

static inline __attribute__((always_inline)) float to_normal(uint32_t word) {
  Centered x = centered(word);
  return 1.41421354f * (erf_inv_slope(2.5f - x.log_and_more, -x.log_and_more) * x.value);
}

static inline __attribute__((always_inline)) double to_normal(uint64_t word) {
  double centered = (double)(int64_t)word * 1.0842021724855044e-19;
  centered = centered > 0.99999999999999989 ? 0.99999999999999989 : (centered < -0.99999999999999989 ? -0.99999999999999989 : centered);
  FactoredDouble factored = factor((1. - centered) * (1. + centered));
  double s = factored.rest / (2. + factored.rest), z = s * s;
  double log = fma(polynomial(z, 0.1662237988556164, 0.18140156550162828, 0.2222286313243771, 0.28571424130490974, 0.4000000001123118,
                              0.6666666666666207), z, 2.);
  double w = fma(factored.twos, -0.6931471805599453, -s * log);
  return 1.4142135623730951 * (erf_inv_slope(w) * centered);
}

constexpr int FEW = 64;

// FEW words turned into normal numbers; one in 300 lies in the tails, whose formula is left out where none of the FEW does
static inline void to_normals(const uint32_t* __restrict words, float* __restrict out) {
  float least = INF;
#pragma omp simd reduction(min : least)
  for (int i = 0; i < FEW; i++) {
    Centered x = centered(words[i]);
    out[i] = 1.41421354f * (erf_inv_slope_near(-x.log_and_more) * x.value);
    least = x.log_and_more < least ? x.log_and_more : least;
  }
  if (2.5f - least < 5.f) return;
#pragma omp simd
  for (int i = 0; i < FEW; i++) out[i] = to_normal(words[i]);
}

// rows of standard normal numbers for the BLOCK particles from `begin` on; both words of the cipher are a number each in float32
static inline void normals(Key key, uint32_t begin, int rows, float (*out)[BLOCK]) {
  alignas(64) uint32_t words[2][BLOCK];
  for (int pair = 0; 2 * pair < rows; pair++) {
#pragma omp simd
    for (int i = 0; i < BLOCK; i++) {
      Words w = threefry(key, begin + i, pair);
      words[0][i] = w.first, words[1][i] = w.second;
    }
    for (int half = 0; half < 2 && 2 * pair + half < rows; half++) {
      for (int i = 0; i < BLOCK; i += FEW) to_normals(words[half] + i, out[2 * pair + half] + i);
    }
  }
}

static inline void normals(Key key, uint32_t begin, int rows, double (*out)[BLOCK]) {
  alignas(64) uint32_t words[2][BLOCK];
  for (int r = 0; r < rows; r++) {
    double* __restrict row = out[r];
#pragma omp simd
    for (int i = 0; i < BLOCK; i++) {
      Words w = threefry(key, begin + i, r);
      words[0][i] = w.first, words[1][i] = w.second;
    }
#pragma omp simd
    for (int i = 0; i < BLOCK; i++) row[i] = to_normal((uint64_t)words[0][i] << 32 | words[1][i]);
  }
}

static inline __attribute__((always_inline)) float to_uniform(Words words, float) { return (float)(words.first >> 8) * 5.96046448e-08f; }
static inline __attribute__((always_inline)) double to_uniform(Words words, double) {
  return ((double)(words.first >> 5) * 67108864. + (double)(words.second >> 6)) * 1.1102230246251565e-16;
}

// rows of uniform numbers in [0, 1) for the BLOCK particles from `begin` on
static inline void uniforms(Key key, uint32_t begin, int rows, Real (*out)[BLOCK]) {
  for (int r = 0; r < rows; r++) {
    Real* __restrict row = out[r];
#pragma omp simd
    for (int i = 0; i < BLOCK; i++) row[i] = to_uniform(threefry(key, begin + i, r ^ UNIFORM_TAG), Real());
  }
}

}  // namespace motes
