// Kernels that need no model: random numbers, ancestors, weights, moments.
#include "weights.hpp"

using namespace motes;

// args: key `(2)`; rets: normal numbers `(rows, n)`
static void normal_block(const Frame& frame, const Team& team) {
  Operand out = frame.ret(0);
  Batch batch(out, 2);
  int64_t n = out.dims[out.rank - 1], rows = out.dims[out.rank - 2];
  for_each_run(team, batch, n, [=](int64_t run, const Team& own) {
    const uint32_t* key = batch.of<const uint32_t>(frame.arg(0), run);
    Real* data = batch.of<Real>(out, run);
    own.each(blocks_of(n), [=](int64_t b) {
      Scratch memory(sizeof(Real) * BLOCK * rows);
      auto* noise = memory.as<Real[BLOCK]>();
      normals({key[0], key[1]}, (uint32_t)(b * BLOCK), (int)rows, noise);
      for (int64_t r = 0; r < rows; r++) __builtin_memcpy(data + r * n + b * BLOCK, noise[r], sizeof(Real) * length_of(b, n));
    });
  });
}
MOTES_KERNEL(motes_normal_block, normal_block)

// args: log weights `(n)`, `(uniform number, threshold, policy)`; rets: ancestors `(n)`, log weights `(n)`
static void ancestors(const Frame& frame, const Team& team) {
  Operand out = frame.ret(0);
  Batch batch(out, 1);
  int64_t n = out.dims[out.rank - 1];
  for_each_run(team, batch, n, [=](int64_t run, const Team& own) {
    const Real* knobs = batch.of<const Real>(frame.arg(1), run);
    choose(own, batch.of<const Real>(frame.arg(0), run), knobs[0], knobs[1], (Policy)(int)knobs[2], n, batch.of<int32_t>(out, run),
           batch.of<Real>(frame.ret(1), run));
  });
}
MOTES_KERNEL(motes_ancestors, ancestors)

// args: log likelihoods `(n)`, log weights `(n)`, the largest that each could be `(n)`; rets: log weights `(n)`, judgement `(6)`
static void weigh(const Frame& frame, const Team& team) {
  weigh_runs(frame, team, [=](const Batch& batch, int64_t run, int64_t) {
    const Real* likelihood = batch.of<const Real>(frame.arg(0), run);
    const Real* maximum = batch.of<const Real>(frame.arg(2), run);
    return [=](int64_t b, Real*, Real*) { return Seen{likelihood + b * BLOCK, maximum + b * BLOCK}; };
  });
}
MOTES_KERNEL(motes_weigh, weigh)

constexpr int MOST_ROWS = 32;

// Weighted sums of one block about its own weighted mean: `moments` holds the weight, the means and the lower triangle of the scatter.
static void block_moments(const Real* const* rows, int x, const Real* __restrict log_weights, int m, double* moments) {
  alignas(64) Real weights[BLOCK], off[MOST_ROWS][BLOCK];
  Real total = 0;
#pragma omp simd reduction(+ : total)
  for (int i = 0; i < m; i++) {
    Real w = motes::exp(log_weights[i]);
    weights[i] = w, total += w;
  }
  moments[0] = total;
  for (int r = 0; r < x; r++) {
    const Real* __restrict row = rows[r];
    Real pivot = row[0], sum = 0;
#pragma omp simd reduction(+ : sum)
    for (int i = 0; i < m; i++) sum += weights[i] > 0 ? weights[i] * (row[i] - pivot) : 0;
    Real center = total > 0 ? pivot + sum / total : pivot;
#pragma omp simd
    for (int i = 0; i < m; i++) off[r][i] = weights[i] > 0 ? row[i] - center : 0;
    moments[1 + r] = center;
  }
  double* scatter = moments + 1 + x;
  for (int r = 0; r < x; r++) {
    alignas(64) Real weighted[BLOCK];
#pragma omp simd
    for (int i = 0; i < m; i++) weighted[i] = weights[i] * off[r][i];
    for (int c = 0; c <= r; c++) {
      Real sum = 0;
#pragma omp simd reduction(+ : sum)
      for (int i = 0; i < m; i++) sum += weighted[i] * off[c][i];
      *scatter++ = sum;
    }
  }
}

// args: log weights `(n)`, points `(x, n)`, more points; rets: mean `(x)`, covariance `(x, x)`
static void moments(const Frame& frame, const Team& team) {
  Operand out = frame.ret(0);
  Batch batch(out, 1);
  Operand given = frame.arg(0);
  int64_t n = given.dims[given.rank - 1], x = out.dims[out.rank - 1], blocks = blocks_of(n), size = 1 + x + x * (x + 1) / 2;
  int64_t parts = frame.call->args.size - 1;
  for_each_run(team, batch, n, [=](int64_t run, const Team& own) {
    const Real* log_weights = batch.of<const Real>(given, run);
    Scratch memory(sizeof(double) * size * blocks);
    double* found = memory.as<double>();
    own.each(blocks, [=](int64_t b) {
      const Real* rows[MOST_ROWS];
      int at = 0;
      for (int64_t part = 1; part <= parts; part++) {
        Operand points = frame.arg((int)part);
        const Real* data = batch.of<const Real>(points, run);
        for (int64_t r = 0; r < points.dims[points.rank - 2]; r++) rows[at++] = data + r * n + b * BLOCK;
      }
      block_moments(rows, (int)x, log_weights + b * BLOCK, length_of(b, n), found + b * size);
    });
    double all[1 + MOST_ROWS + MOST_ROWS * (MOST_ROWS + 1) / 2] = {0};
    for (int64_t b = 0; b < blocks; b++) {  // of two groups: means apart add to the scatter (Chan, Golub, LeVeque 1983)
      const double* one = found + b * size;
      double weight = one[0], sum = all[0] + weight, apart[MOST_ROWS];
      if (!(sum > 0)) continue;
      for (int64_t r = 0; r < x; r++) apart[r] = one[1 + r] - all[1 + r];
      double* scatter = all + 1 + x;
      const double* own_scatter = one + 1 + x;
      for (int64_t r = 0; r < x; r++)
        for (int64_t c = 0; c <= r; c++) *scatter++ += *own_scatter++ + apart[r] * apart[c] * (all[0] * weight / sum);
      for (int64_t r = 0; r < x; r++) all[1 + r] += apart[r] * (weight / sum);
      all[0] = sum;
    }
    Real* mean = batch.of<Real>(out, run);
    Real* cov = batch.of<Real>(frame.ret(1), run);
    const double* scatter = all + 1 + x;
    for (int64_t r = 0; r < x; r++) {
      mean[r] = (Real)all[1 + r];
      for (int64_t c = 0; c <= r; c++) cov[r * x + c] = cov[c * x + r] = (Real)(*scatter++ / all[0]);
    }
  });
}
MOTES_KERNEL(motes_moments, moments)
