// From log likelihoods to normalized log weights, and from log weights to ancestors; sums in double precision, block by block, in an
// order that does not depend on the number of threads.
#pragma once

#include "runtime.hpp"

namespace motes {

constexpr int64_t LIGHT = 24;  // fewer blocks than this of a few operations each are not worth a thread

static inline int64_t blocks_of(int64_t n) { return (n + BLOCK - 1) / BLOCK; }
static inline int length_of(int64_t block, int64_t n) { return (int)(n - block * BLOCK < BLOCK ? n - block * BLOCK : BLOCK); }

// What one block of particles adds to the judgement of a step.
struct Tally {
  Real top, highest, lowest, shortfall;  // shortfall: smallest distance of a log likelihood from the largest it could be
  double sum, squares;              // of weights relative to top
  int64_t invalid;
};

// Adds likelihoods to log weights in place of `joint`, for one block.
static inline Tally tally(const Real* __restrict log_weights, const Real* __restrict likelihood, const Real* __restrict maximum,
                          Real* __restrict joint, int m) {
  Real top = -INF, highest = -INF, lowest = INF, shortfall = INF;
  int invalid = 0;
#pragma omp simd reduction(max : top, highest) reduction(min : lowest, shortfall) reduction(+ : invalid)
  for (int i = 0; i < m; i++) {
    Real given = likelihood[i];
    bool bad = given != given;
    Real known = bad ? -INF : given;
    Real sum = log_weights[i] + known;
    Real distance = maximum[i] - known;
    distance = maximum[i] < INF && maximum[i] > -INF ? distance : 0;
    invalid += bad;
    joint[i] = sum;
    top = sum > top ? sum : top;
    highest = known > highest ? known : highest;
    lowest = known < lowest ? known : lowest;
    shortfall = distance < shortfall ? distance : shortfall;
  }
  double sum = 0, squares = 0;
  if (top > -INF && top < INF) {
    Real part = 0, square = 0;
#pragma omp simd reduction(+ : part, square)
    for (int i = 0; i < m; i++) {
      Real w = exp(joint[i] - top);
      part += w, square += w * w;
    }
    sum = part, squares = square;
  }
  return {top, highest, lowest, shortfall, sum, squares, invalid};
}

// Makes the judgement (log evidence, effective sample size, invalid, lowest, highest, shortfall); gives the log of the sum of weights and top.
struct Judgement { Real top, log_sum; };

static inline Judgement judge(const Tally* tallies, int64_t blocks, Real* __restrict info) {
  Tally all = tallies[0];
  for (int64_t b = 1; b < blocks; b++) {
    const Tally& one = tallies[b];
    if (!(all.top >= one.top)) all.top = one.top;
    all.highest = one.highest > all.highest ? one.highest : all.highest;
    all.lowest = one.lowest < all.lowest ? one.lowest : all.lowest;
    all.shortfall = one.shortfall < all.shortfall ? one.shortfall : all.shortfall;
    all.invalid += one.invalid;
  }
  Real anchor = all.top > -INF && all.top < INF ? all.top : 0;
  double sum = 0, squares = 0;
  for (int64_t b = 0; b < blocks; b++) {
    if (!(tallies[b].top > -INF)) continue;
    double scale = __builtin_exp((double)tallies[b].top - (double)anchor);
    sum += scale * tallies[b].sum, squares += scale * scale * tallies[b].squares;
  }
  if (all.top == INF) sum = INF;
  double log_sum = __builtin_log(sum);
  info[0] = (Real)(anchor + log_sum);
  info[1] = (Real)(sum * sum / squares);
  info[2] = (Real)all.invalid;
  info[3] = all.lowest;
  info[4] = all.highest;
  info[5] = all.shortfall;
  return {anchor, (Real)log_sum};
}

static inline void normalize(Real* __restrict joint, Judgement found, int m) {
#pragma omp simd
  for (int i = 0; i < m; i++) joint[i] = (joint[i] - found.top) - found.log_sum;
}

enum Policy { ALWAYS = 0, NEVER = 1, SIZE = 2, ENTROPY = 3 };

// Turns the ends of the children of one block's particles into the ancestors of these, [ends[0], ends[m]), without branches that cannot
// be foretold.
static inline void fill(const int32_t* __restrict ends, int32_t begin, int m, int32_t* __restrict ancestors) {
  int32_t first = ends[0], last = ends[m];
  __builtin_memset(ancestors + first, 0, sizeof(int32_t) * (last - first));
#pragma omp simd
  for (int i = 0; i < m; i++)
    if (ends[i + 1] > ends[i]) ancestors[ends[i]] = begin + i;
  int32_t latest = 0;
#pragma omp simd reduction(inscan, max : latest)
  for (int32_t c = first; c < last; c++) {
    latest = ancestors[c] > latest ? ancestors[c] : latest;
#pragma omp scan inclusive(latest)
    ancestors[c] = latest;
  }
}

// Turns the cumulative weights of one block into the ancestors of its children [first, last).
static inline void children(const Real* __restrict weights, double before, double scale, double u, int64_t begin, int m, int32_t first,
                            int32_t last, int32_t* __restrict ancestors) {
  if (last <= first) return;
  alignas(64) int32_t ends[BLOCK + 16];
  double sum = before;
#pragma omp simd reduction(inscan, + : sum)
  for (int i = 0; i < m; i++) {
    sum += scale * (double)weights[i];
#pragma omp scan inclusive(sum)
    double end = __builtin_ceil(sum - u);
    end = end < (double)first ? (double)first : (end > (double)last ? (double)last : end);
    ends[i + 1] = (int32_t)end;
  }
  ends[0] = first;
  // rounding must not give the block's last child to a particle without weight
  int end = m;
  ends[end] = last;
  while (end > 1 && weights[end - 1] == 0) ends[--end] = last;
  fill(ends, (int32_t)begin, m, ancestors);
}

// Systematic resampling where the policy asks for it; else every particle is its own ancestor and keeps its weight.
static inline void choose(const Team& team, const Real* log_weights, Real u, Real threshold, Policy policy, int64_t n,
                          int32_t* ancestors, Real* log_weights_after) {
  int64_t blocks = blocks_of(n);
  Scratch memory(sizeof(Real) * blocks * BLOCK + 3 * sizeof(double) * (blocks + 1));
  Real* weights = memory.as<Real>();
  double* sums = (double*)(weights + blocks * BLOCK);
  double *squares = sums + blocks + 1, *terms = squares + blocks;
  if (policy != NEVER) {
    team.each(blocks, [=](int64_t b) {
      const Real* __restrict from = log_weights + b * BLOCK;
      Real* __restrict to = weights + b * BLOCK;
      int m = length_of(b, n);
      double sum = 0;
      Real square = 0, term = 0;
#pragma omp simd reduction(+ : sum, square, term)
      for (int i = 0; i < m; i++) {
        Real w = exp(from[i]);
        to[i] = w;
        sum += w, square += w * w, term += w > 0 ? w * from[i] : 0;
      }
      sums[b + 1] = sum, squares[b] = square, terms[b] = term;
    });
  }
  double square = 0, term = 0;
  sums[0] = 0;
  for (int64_t b = 0; policy != NEVER && b < blocks; b++) sums[b + 1] += sums[b], square += squares[b], term += terms[b];
  bool needed = policy == ALWAYS || (policy == SIZE && 1.0 / square < threshold * (double)n) ||
                (policy == ENTROPY && __builtin_log((double)n) + term > threshold);
  double scale = (double)n / sums[blocks];
  Real equal = (Real)-__builtin_log((double)n);
  team.each(blocks, [=](int64_t b) {
    int64_t begin = b * BLOCK;
    int m = length_of(b, n);
    Real* __restrict to = log_weights_after + begin;
    if (!needed || !(scale < INF)) {
      for (int i = 0; i < m; i++) to[i] = log_weights[begin + i], ancestors[begin + i] = (int32_t)(begin + i);
      return;
    }
    auto edge = [=](int64_t at) {
      double end = at == 0 ? 0 : (at == blocks ? (double)n : __builtin_ceil(sums[at] * scale - u));
      return (int32_t)(end < 0 ? 0 : (end > (double)n ? (double)n : end));
    };
    for (int i = 0; i < m; i++) to[i] = equal;
    children(weights + begin, sums[b] * scale, scale, u, begin, m, edge(b), edge(b + 1), ancestors);
  });
}

// Runs a body for each run of a batch: many runs are shared out over the threads, few are worked through with all threads on each.
template <class Body>
static void for_each_run(const Team& team, const Batch& batch, int64_t n, Body body) {
  if (batch.count >= 2 * team.size() || blocks_of(n) < 2) {
    Team single = team.single();
    team.each(batch.count, [=](int64_t run) { body(run, single); });
  } else {
    for (int64_t run = 0; run < batch.count; run++) body(run, team);
  }
}

struct Seen { const Real *likelihood, *maximum; };

// The whole of weighing. args: anything, log weights `(n)`, ...; rets: log weights `(n)`, judgement `(6)`, ...
// `prepare(batch, run, n)` gives a function of (block, likelihood, maximum) that says where the log likelihoods of a block and the
// largest that they could be stand; it may fill the two arrays that it is given.
template <class Prepare>
static void weigh_runs(const Frame& frame, const Team& team, Prepare prepare) {
  Operand out = frame.ret(0);
  Batch batch(out, 1, frame.elements());
  int64_t n = batch.length(out), blocks = blocks_of(n);
  for_each_run(team, batch, n, [=](int64_t run, const Team& own) {
    const Real* before = batch.row<const Real>(frame.arg(1), run);
    Real* joint = batch.row<Real>(out, run);
    auto see = prepare(batch, run, n);
    Scratch memory(sizeof(Tally) * blocks);
    Tally* tallies = memory.as<Tally>();
    own.each(blocks, [=](int64_t b) {
      alignas(64) Real likelihood[BLOCK], maximum[BLOCK];
      Seen seen = see(b, likelihood, maximum);
      tallies[b] = tally(before + b * BLOCK, seen.likelihood, seen.maximum, joint + b * BLOCK, length_of(b, n));
    });
    Judgement found = judge(tallies, blocks, batch.of<Real>(frame.ret(1), run));
    own.each(blocks, [=](int64_t b) { normalize(joint + b * BLOCK, found, length_of(b, n)); }, LIGHT);
  });
}

}  // namespace motes
