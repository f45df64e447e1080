// What this machine can do: bootstrap particle filters on the two models of problems.py, fused by hand, every loop vectorized.
//
// Particles are worked on in blocks that stay in the first-level cache. A step has two passes with a barrier behind each:
//   1. block by block: gather parents, move, add noise, weigh, exponentiate against the block's own maximum, sum;
//   2. block by block: running sums of the weights -> end of each particle's row of children -> ancestors.
// Normal numbers are Threefry-2x32-20 words through the inverse error function (Giles 2010). Resampling is systematic, at every step.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <memory>
#include <omp.h>

namespace {
constexpr int BLOCK = 1024, VECTOR = 8;
constexpr float LOG_TWO_PI = 1.8378770664f;

struct Words { uint32_t first, second; };

inline uint32_t rotate(uint32_t x, int by) { return (x << by) | (x >> (32 - by)); }

inline Words threefry(uint32_t key0, uint32_t key1, uint32_t a, uint32_t b) {
  const uint32_t key2 = key0 ^ key1 ^ 0x1BD11BDAu;
  a += key0; b += key1;
#define MIX(by) a += b; b = rotate(b, by); b ^= a;
#define EVEN MIX(13) MIX(15) MIX(26) MIX(6)
#define ODD MIX(17) MIX(29) MIX(16) MIX(24)
  EVEN a += key1; b += key2 + 1;
  ODD a += key2; b += key0 + 2;
  EVEN a += key0; b += key1 + 3;
  ODD a += key1; b += key2 + 4;
  EVEN a += key2; b += key0 + 5;
  return {a, b};
}

// Natural logarithm of a normal positive number, absolute error 1e-7; inline, so that nothing is spilled around a call.
inline float logarithm(float x) {
  const int32_t bits = __builtin_bit_cast(int32_t, x), exponent = (bits - 0x3f3504f3) >> 23;
  const float f = __builtin_bit_cast(float, bits - (exponent << 23)) - 1;
  const float g = f * f;
  float p = 1.00000325f - 0.500019651f * f + g * (0.333032983f - 0.248813396f * f) + (g * g) * (0.206046733f - 0.189019788f * f + g * 0.118274778f);
  return p * f + float(exponent) * 0.693147181f;
}

// Giles's approximation of the inverse error function in single precision, times the square root of two.
inline float normal(uint32_t word) {
  constexpr float near[9] = {2.81022636e-08f, 3.43273939e-07f, -3.5233877e-06f, -4.39150654e-06f, 0.00021858087f,
                             -0.00125372503f, -0.00417768164f, 0.246640727f, 1.50140941f};
  constexpr float tail[9] = {-0.000200214257f, 0.000100950558f, 0.00134934322f, -0.00367342844f, 0.00573950773f,
                             -0.0076224613f, 0.00943887047f, 1.00167406f, 2.83297682f};
  const float x = float(int32_t(word)) * 4.6566126e-10f;
  const float w = -logarithm(std::max(1 - x * x, 1.1920929e-7f)), inner = w - 2.5f, outer = sqrtf(w) - 3;
  float p = near[0], q = tail[0];
#pragma GCC unroll 8
  for (int k = 1; k < 9; k++) p = p * inner + near[k], q = q * outer + tail[k];
  return 1.41421356f * x * (w < 5 ? p : q);
}

inline float azimuth(float y, float x) {
  const float u = fabsf(x), v = fabsf(y), ratio = std::min(u, v) / std::max(u, v), s = ratio * ratio;
  float p = 2.903552482e-03f;
  p = p * s - 1.628300781e-02f; p = p * s + 4.303936747e-02f; p = p * s - 7.533676016e-02f; p = p * s + 1.065467737e-01f;
  p = p * s - 1.420713364e-01f; p = p * s + 1.999305410e-01f; p = p * s - 3.333309396e-01f; p = p * s + 1.0f;
  float angle = p * ratio;
  angle = v > u ? 1.57079633f - angle : angle;
  angle = x < 0 ? 3.14159265f - angle : angle;
  return copysignf(angle, y);
}

// Rows hold one component each of all particles; a model moves particle a of the old rows to place i of the new ones, and weighs it there.
using Rows = float *const *;
using Noise = const float (*)[BLOCK];

struct Radar {
  static constexpr int SIZE = 6, MEASURED = 2;
  static constexpr float mean[6] = {300, 300, 5, -5, 0, 0}, spread[6] = {2, 2, 4, 4, 0.2f, 0.2f};
  static inline void move(Rows old, int a, Rows x, int i, Noise noise) {
    const float px = old[0][a], py = old[1][a], vx = old[2][a], vy = old[3][a], ax = old[4][a], ay = old[5][a];
    x[0][i] = px + 0.5f * vx + 0.125f * ax + noise[0][i];
    x[1][i] = py + 0.5f * vy + 0.125f * ay + noise[1][i];
    x[2][i] = vx + 0.5f * ax + noise[2][i];
    x[3][i] = vy + 0.5f * ay + noise[3][i];
    x[4][i] = ax + 0.1f * noise[4][i];
    x[5][i] = ay + 0.1f * noise[5][i];
  }
  static inline float log_density(const float *y, Rows x, int i) {
    const float range = y[0] - sqrtf(x[0][i] * x[0][i] + x[1][i] * x[1][i]), angle = y[1] - azimuth(x[1][i], x[0][i]);
    return -0.5f * (range * range * 0.01f + angle * angle * 1e6f);
  }
  static double constant() { return -0.5 * (2 * LOG_TWO_PI + std::log(1e-4)); }
};

struct Line {
  static constexpr int SIZE = 1, MEASURED = 1;
  static constexpr float mean[1] = {0}, spread[1] = {1};
  static inline void move(Rows old, int a, Rows x, int i, Noise noise) { x[0][i] = 0.9f * old[0][a] + 0.70710678f * noise[0][i]; }
  static inline float log_density(const float *y, Rows x, int i) { return (y[0] - x[0][i]) * (y[0] - x[0][i]) * (-0.5f / 0.3f); }
  static double constant() { return -0.5 * (LOG_TWO_PI + std::log(0.3)); }
};

struct Part { double sum, squares, before; float highest; };

// The state of a run: two clouds that take turns, weights within blocks, ancestors.
template <class Model> struct Filter {
  int n, blocks;
  std::unique_ptr<float[]> clouds[2], weights;
  std::unique_ptr<int[]> ancestors;
  std::unique_ptr<Part[]> parts;
  double log_likelihood = 0, ess = 0;

  explicit Filter(int n) : n(n), blocks((n + BLOCK - 1) / BLOCK) {
    const size_t room = size_t(blocks) * BLOCK;
    for (auto &cloud : clouds) cloud.reset(new float[room * Model::SIZE]);
    weights.reset(new float[room]);
    ancestors.reset(new int[room]);
    parts.reset(new Part[blocks]);
  }

  int length(int block) const { return std::min(BLOCK, n - block * BLOCK); }

  void advance(int block, int step, const float *y, uint32_t seed) {
    constexpr int D = Model::SIZE, PAIRS = (D + 1) / 2;
    alignas(64) uint32_t words[2 * PAIRS][BLOCK];
    alignas(64) float noise[D][BLOCK];
    const int begin = block * BLOCK, count = length(block);
    const int *parent = ancestors.get() + begin;
    float *weight = weights.get() + begin;
    for (int pair = 0; pair < PAIRS; pair++) {
      uint32_t *even = words[2 * pair], *odd = words[2 * pair + 1];
#pragma omp simd
      for (int i = 0; i < BLOCK; i++) {
        const Words both = threefry(seed, step, begin + i, pair);
        even[i] = both.first;
        odd[i] = both.second;
      }
    }
    for (int d = 0; d < D; d++) {
#pragma omp simd
      for (int i = 0; i < BLOCK; i++) noise[d][i] = normal(words[d][i]);
    }
    float *old[D], *x[D];
    for (int d = 0; d < D; d++) {
      const size_t row = size_t(d) * blocks * BLOCK;
      old[d] = clouds[step % 2].get() + row;
      x[d] = clouds[1 - step % 2].get() + row + begin;
    }
    if (step) {
#pragma omp simd
      for (int i = 0; i < count; i++) Model::move(old, parent[i], x, i, noise);
    } else {
      for (int d = 0; d < D; d++)
        for (int i = 0; i < count; i++) x[d][i] = Model::mean[d] + Model::spread[d] * noise[d][i];
    }
    float highest = -INFINITY;
#pragma omp simd reduction(max : highest)
    for (int i = 0; i < count; i++) {
      const float value = Model::log_density(y, x, i);
      weight[i] = value;
      highest = value > highest ? value : highest;
    }
    float sum = 0, squares = 0;
#pragma omp simd reduction(+ : sum, squares)
    for (int i = 0; i < count; i++) {
      weight[i] = expf(std::max(weight[i] - highest, -40.0f));
      sum += weight[i];
      squares += weight[i] * weight[i];
    }
    parts[block] = {sum, squares, 0, highest};
  }

  // Bring the blocks to a common scale: `before` becomes the number of children expected of all particles before the block.
  void join() {
    float highest = -INFINITY;
    for (int k = 0; k < blocks; k++) highest = std::max(highest, parts[k].highest);
    double total = 0, squares = 0;
    for (int k = 0; k < blocks; k++) {
      const double scale = std::exp(double(parts[k].highest - highest));
      parts[k].before = total;
      total += parts[k].sum * scale;
      squares += parts[k].squares * scale * scale;
    }
    for (int k = 0; k < blocks; k++) parts[k].before *= n / total;
    log_likelihood += Model::constant() + highest + std::log(total / n);
    ess = total * total / squares;
  }

  int end_of(double expected, double u) const { return std::min(std::max(int(std::ceil(expected - u)), 0), n); }

  void resample(int block, double u) {
    alignas(64) int ends[BLOCK];
    const int begin = block * BLOCK, count = length(block);
    const double before = parts[block].before, after = block + 1 < blocks ? parts[block + 1].before : n;
    const double scale = (after - before) / parts[block].sum;
    const float *weight = weights.get() + begin;
    const int first = end_of(before, u), last = block + 1 < blocks ? end_of(after, u) : n;
    double running = 0;
#pragma omp simd reduction(inscan, + : running)
    for (int i = 0; i < count; i++) {
      running += weight[i];
#pragma omp scan inclusive(running)
      ends[i] = int(std::ceil(before + running * scale - u));
    }
    ends[count - 1] = last;
    // each particle writes a whole vector, without asking how many children it has; those after it overwrite what was too much
    int *row = ancestors.get();
    int place = first;
    for (int i = 0; i < count; i++) {
      const int end = ends[i], me = begin + i;
      int done = place;
      if (place + VECTOR <= last) {
        for (int j = 0; j < VECTOR; j++) row[place + j] = me;
        done += VECTOR;
      }
      for (int j = done; j < end; j++) row[j] = me;
      place = end;
    }
  }

  void run(int steps, const float *ys, uint32_t seed) {
#pragma omp parallel
    for (int step = 0; step < steps; step++) {
#pragma omp for schedule(static)
      for (int k = 0; k < blocks; k++) advance(k, step, ys + step * Model::MEASURED, seed);
#pragma omp single
      join();
      const double u = threefry(seed, step, 0, 0x80000000u).first * 2.3283064365386963e-10;
#pragma omp for schedule(static)
      for (int k = 0; k < blocks; k++) resample(k, u);
    }
  }
};

template <class Model> double log_likelihood(int n, int steps, const float *ys, uint32_t seed) {
  Filter<Model> filter(n);
  filter.run(steps, ys, seed);
  return filter.log_likelihood;
}
}  // namespace

// ys holds the measurements step by step; the result is the log likelihood of all.
extern "C" double radar(int n, int steps, const float *ys, uint32_t seed) { return log_likelihood<Radar>(n, steps, ys, seed); }
extern "C" double line(int n, int steps, const float *ys, uint32_t seed) { return log_likelihood<Line>(n, steps, ys, seed); }
