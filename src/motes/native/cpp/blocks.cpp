// Kernels that need no model: random numbers, ancestors, weights, moments, innovations.
#include "weights.hpp"

using namespace motes;

// args: key `(2)`; rets: normal numbers `(rows, n)`
static void normal_block(const Frame& frame, const Team& team) {
  Operand out = frame.ret(0);
  Batch batch(out, 2, frame.elements());
  int64_t n = batch.length(out), rows = out.dims[out.rank - 2];
  for_each_run(team, batch, n, [=](int64_t run, const Team& own) {
    const uint32_t* key = batch.of<const uint32_t>(frame.arg(0), run);
    int64_t apart;
    Real* data = batch.rows<Real>(out, run, apart);
    own.each(blocks_of(n), [=](int64_t b) {
      Scratch memory(sizeof(Real) * BLOCK * rows);
      auto* noise = memory.as<Real[BLOCK]>();
      normals({key[0], key[1]}, (uint32_t)(b * BLOCK), (int)rows, noise);
      for (int64_t r = 0; r < rows; r++) __builtin_memcpy(data + r * apart + b * BLOCK, noise[r], sizeof(Real) * length_of(b, n));
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

// args: log weights `(n)`; rets: log of the sum of weights, their sum, that of their squares, that of w log w `(4)`
static void masses(const Frame& frame, const Team& team) {
  Operand given = frame.arg(0);
  Batch batch(frame.ret(0), 1);
  int64_t n = given.dims[given.rank - 1], blocks = blocks_of(n);
  for_each_run(team, batch, n, [=](int64_t run, const Team& own) {
    const Real* log_weights = batch.of<const Real>(given, run);
    Real* out = batch.of<Real>(frame.ret(0), run);
    Scratch memory(sizeof(double) * 3 * blocks);
    double* found = memory.as<double>();
    own.each(blocks, [=](int64_t b) {
      const Real* __restrict from = log_weights + b * BLOCK;
      int m = length_of(b, n);
      Real sum = 0, square = 0, term = 0;
#pragma omp simd reduction(+ : sum, square, term)
      for (int i = 0; i < m; i++) {
        Real w = exp(from[i]);
        sum += w, square += w * w, term += w > 0 ? w * from[i] : 0;
      }
      found[3 * b] = sum, found[3 * b + 1] = square, found[3 * b + 2] = term;
    });
    double all[3] = {0, 0, 0};
    for (int64_t b = 0; b < blocks; b++)
      for (int k = 0; k < 3; k++) all[k] += found[3 * b + k];
    double log_sum = __builtin_log(all[0]);
    if (!(all[0] > 1e-20 && all[0] < INF)) {  // too far from one to be told without an anchor
      Real top = -INF;
      for (int64_t i = 0; i < n; i++) top = log_weights[i] > top ? log_weights[i] : top;
      double sum = 0;
      for (int64_t i = 0; top > -INF && i < n; i++) sum += exp(log_weights[i] - top);
      log_sum = top + __builtin_log(sum);
    }
    out[0] = (Real)log_sum, out[1] = (Real)all[0], out[2] = (Real)all[1], out[3] = (Real)all[2];
  });
}
MOTES_KERNEL(motes_masses, masses)

// args: log weights `(n)`, (log of their sum, number of children, what is added to running sums), (whole part of that, first end, last end);
// rets: where the children of each particle end `(n)`
static void ends(const Frame& frame, const Team& team) {
  Operand out = frame.ret(0);
  Batch batch(out, 1);
  int64_t n = out.dims[out.rank - 1], blocks = blocks_of(n);
  for_each_run(team, batch, n, [=](int64_t run, const Team& own) {
    const Real* log_weights = batch.of<const Real>(frame.arg(0), run);
    const Real* numbers = batch.of<const Real>(frame.arg(1), run);
    const int32_t* whole = batch.of<const int32_t>(frame.arg(2), run);
    int32_t* to = batch.of<int32_t>(out, run);
    Real log_mass = numbers[0];
    double part = numbers[2];
    int32_t base = whole[0], start = whole[1], last = whole[2];
    Scratch memory(sizeof(Real) * blocks * BLOCK + sizeof(double) * (blocks + 1));
    Real* weights = memory.as<Real>();
    double* sums = (double*)(weights + blocks * BLOCK);
    own.each(blocks, [=](int64_t b) {
      const Real* __restrict from = log_weights + b * BLOCK;
      Real* __restrict w = weights + b * BLOCK;
      int m = length_of(b, n);
      double sum = 0;
#pragma omp simd reduction(+ : sum)
      for (int i = 0; i < m; i++) {
        w[i] = log_mass > -INF ? exp(from[i] - log_mass) : 0;
        sum += w[i];
      }
      sums[b + 1] = sum;
    });
    sums[0] = 0;
    for (int64_t b = 0; b < blocks; b++) sums[b + 1] += sums[b];
    double scale = sums[blocks] > 0 ? numbers[1] / sums[blocks] : 0;
    own.each(blocks, [=](int64_t b) {
      auto edge = [=](int64_t at) {
        double end = at == 0 ? start : (at == blocks ? last : base + __builtin_ceil(sums[at] * scale + part));
        return (int32_t)(end < start ? start : (end > last ? last : end));
      };
      const Real* __restrict w = weights + b * BLOCK;
      int32_t* __restrict found = to + b * BLOCK;
      int m = length_of(b, n);
      int32_t low = edge(b), high = edge(b + 1);
      double sum = sums[b] * scale + part;
#pragma omp simd reduction(inscan, + : sum)
      for (int i = 0; i < m; i++) {
        sum += scale * (double)w[i];
#pragma omp scan inclusive(sum)
        double end = base + __builtin_ceil(sum);
        found[i] = (int32_t)(end < low ? low : (end > high ? high : end));
      }
      // rounding must not give the last child to a particle without weight
      int end = m;
      found[--end] = high;
      while (end > 0 && w[end] == 0) found[--end] = high;
    });
  });
}
MOTES_KERNEL(motes_ends, ends)

// args: where the children of each particle end `(s)`, the first slot; rets: whose child is in each slot `(n)`
static void parents(const Frame& frame, const Team& team) {
  Operand out = frame.ret(0), given = frame.arg(0);
  Batch batch(out, 1);
  int64_t n = out.dims[out.rank - 1], s = given.dims[given.rank - 1], blocks = blocks_of(s);
  for_each_run(team, batch, s, [=](int64_t run, const Team& own) {
    const int32_t* ends = batch.of<const int32_t>(given, run);
    int64_t first = *batch.of<const int32_t>(frame.arg(1), run);
    int32_t* slots = batch.of<int32_t>(out, run);
    own.each(blocks, [=](int64_t b) {
      alignas(64) int32_t here[BLOCK + 16];
      int64_t begin = b * BLOCK;
      int m = length_of(b, s);
      auto place = [=](int32_t end) {  // in slots here
        int64_t at = end - first;
        return (int32_t)(at < 0 ? 0 : (at > n ? n : at));
      };
      here[0] = b == 0 ? 0 : place(ends[begin - 1]);
#pragma omp simd
      for (int i = 0; i < m; i++) here[i + 1] = place(ends[begin + i]);
      // whose children end before the last slot: it is nobody's, and gets any parent
      if (b + 1 == blocks) here[m] = (int32_t)n;
      if (here[m] > here[0]) fill(here, (int32_t)begin, m, slots);
    });
  });
}
MOTES_KERNEL(motes_parents, parents)

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

// args: log weights `(n)`, points `(x, n)`, more points; rets: mean `(x)`, covariance `(x, x)` and, where it is asked for, the sum of weights
static void moments(const Frame& frame, const Team& team) {
  Operand out = frame.ret(0);
  Batch batch(out, 1, frame.elements(), false);
  Operand given = frame.arg(0);
  int64_t n = batch.length(given), x = out.dims[out.rank - 1], blocks = blocks_of(n), size = 1 + x + x * (x + 1) / 2;
  int64_t parts = frame.call->args.size - 1;
  for_each_run(team, batch, n, [=](int64_t run, const Team& own) {
    const Real* log_weights = batch.row<const Real>(given, run);
    Scratch memory(sizeof(double) * size * blocks);
    double* found = memory.as<double>();
    own.each(blocks, [=](int64_t b) {
      const Real* rows[MOST_ROWS];
      int at = 0;
      for (int64_t part = 1; part <= parts; part++) {
        Operand one = frame.arg((int)part);
        int64_t apart;
        const Real* data = batch.rows<const Real>(one, run, apart);
        for (int64_t r = 0; r < one.dims[one.rank - 2]; r++) rows[at++] = data + r * apart + b * BLOCK;
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
    if (frame.call->rets.size > 2) *batch.of<Real>(frame.ret(2), run) = (Real)all[0];
    const double* scatter = all + 1 + x;
    for (int64_t r = 0; r < x; r++) {
      mean[r] = (Real)all[1 + r];
      for (int64_t c = 0; c <= r; c++) cov[r * x + c] = cov[c * x + r] = (Real)(*scatter++ / all[0]);
    }
  });
}
MOTES_KERNEL(motes_moments, moments)

// x = L^-1 x for rows of m numbers; a zero pivot gives a zero row
static inline void solve_lower(const double (*L)[MOST_ROWS], int size, Real* __restrict x, int64_t m) {
  for (int r = 0; r < size; r++) {
    Real* __restrict row = x + r * m;
    for (int k = 0; k < r; k++) {
      const Real* __restrict before = x + k * m;
      Real factor = (Real)L[r][k];
#pragma omp simd
      for (int64_t i = 0; i < m; i++) row[i] -= factor * before[i];
    }
    Real inverse = L[r][r] > 0 ? (Real)(1 / L[r][r]) : 0;
#pragma omp simd
    for (int64_t i = 0; i < m; i++) row[i] *= inverse;
  }
}

static inline Real wrapped(Real difference) {
  return difference - (Real)6.283185307179586 * (Real)__builtin_ceil(difference / (Real)6.283185307179586 - (Real)0.5);
}

// Normalized innovation squared of y among m Gaussians of one covariance, and its degrees of freedom, by the steps of `alarm.of_mixture`.
static void judge_innovation(const Real* centers, const Real* cov, const Real* log_weights, const Real* y, const Real* angles, int size,
                             int64_t m, Real* found) {
  constexpr double TOO_FEW = 4;
  Scratch memory(sizeof(Real) * m * (size + 3));
  Real *off = memory.as<Real>(), *weights = off + size * m, *between = weights + m, *weighted = between + m;
  int64_t heaviest = 0;
  for (int64_t i = 1; i < m; i++) heaviest = log_weights[i] > log_weights[heaviest] ? i : heaviest;
  bool turning = false, seen[MOST_ROWS];
  int measured = 0;
  for (int r = 0; r < size; r++) {
    turning |= angles[r] > 0, seen[r] = y[r] == y[r] && __builtin_fabs(cov[r * size + r]) < INF;
    measured += seen[r];
  }
#pragma omp simd
  for (int64_t i = 0; i < m; i++) weights[i] = motes::exp(log_weights[i]);
  for (int r = 0; r < size; r++) {  // differences of angles are wrapped about the heaviest
    const Real* __restrict center = centers + r * m;
    Real* __restrict row = off + r * m;
    Real about = turning ? center[heaviest] : y[r], base = y[r] - about;
    base = angles[r] > 0 ? wrapped(base) : base;
    for (int64_t i = 0; i < m; i++) {
      Real difference = center[i] - about;
      row[i] = seen[r] ? (angles[r] > 0 ? wrapped(difference) : difference) - base : 0;
    }
#pragma omp simd
    for (int64_t i = 0; i < m; i++) weights[i] = row[i] < INF && row[i] > -INF ? weights[i] : 0;
  }
  double total = 0, squares = 0, middle[MOST_ROWS], own[MOST_ROWS][MOST_ROWS], L[MOST_ROWS][MOST_ROWS];
#pragma omp simd reduction(+ : total, squares)
  for (int64_t i = 0; i < m; i++) total += weights[i], squares += (double)weights[i] * weights[i];
  for (int r = 0; r < size; r++) {
    Real* __restrict row = off + r * m;
    double sum = 0;
#pragma omp simd reduction(+ : sum)
    for (int64_t i = 0; i < m; i++) row[i] = weights[i] > 0 ? row[i] : 0, sum += (double)weights[i] * row[i];
    middle[r] = sum / total;
#pragma omp simd
    for (int64_t i = 0; i < m; i++) row[i] -= (Real)middle[r];
  }
  for (int r = 0; r < size; r++) {
    const Real* __restrict row = off + r * m;
#pragma omp simd
    for (int64_t i = 0; i < m; i++) weighted[i] = weights[i] * row[i];
    for (int c = 0; c <= r; c++) {
      const Real* __restrict other = off + c * m;
      double sum = 0;
#pragma omp simd reduction(+ : sum)
      for (int64_t i = 0; i < m; i++) sum += (double)weighted[i] * other[i];
      own[r][c] = seen[r] && seen[c] ? cov[r * size + c] : r == c, own[c][r] = seen[r] && seen[c] ? cov[c * size + r] : r == c;
      L[r][c] = sum / total + own[r][c];
    }
  }
  constexpr double EPS = sizeof(Real) == 4 ? 1.1920928955078125e-7 : 2.220446049250313e-16;
  double least[MOST_ROWS];
  for (int j = 0; j < size; j++) least[j] = 4 * size * EPS * L[j][j];
  for (int j = 0; j < size; j++) {  // a pivot that is zero up to rounding gives a zero column
    for (int k = 0; k < j; k++) L[j][j] -= L[j][k] * L[j][k];
    L[j][j] = L[j][j] > least[j] ? __builtin_sqrt(L[j][j]) : 0;
    for (int i = j + 1; i < size; i++) {
      for (int k = 0; k < j; k++) L[i][j] -= L[i][k] * L[j][k];
      L[i][j] = L[j][j] > 0 ? L[i][j] / L[j][j] : 0;
    }
  }
  auto solve = [&](double* x, int stride) {
    for (int r = 0; r < size; r++) {
      for (int k = 0; k < r; k++) x[r * stride] -= L[r][k] * x[k * stride];
      x[r * stride] = L[r][r] > 0 ? x[r * stride] / L[r][r] : 0;
    }
  };
  solve(middle, 1);
  for (int c = 0; c < size; c++) solve(&own[0][c], MOST_ROWS);
  for (int r = 0; r < size; r++) solve(own[r], 1);
  solve_lower(L, size, off, m);
  __builtin_memset(between, 0, sizeof(Real) * m);
  double square = 0, trace = 0, twice = 0, fourth = 0;
  for (int r = 0; r < size; r++) {
    const Real* __restrict row = off + r * m;
#pragma omp simd
    for (int64_t i = 0; i < m; i++) between[i] += row[i] * row[i];
    square += middle[r] * middle[r], trace += own[r][r];
    for (int c = 0; c < size; c++) twice += own[r][c] * own[r][c];
  }
#pragma omp simd reduction(+ : fourth)
  for (int64_t i = 0; i < m; i++) fourth += (double)weights[i] * between[i] * between[i];
  double count = total * total / squares, share = 1 - trace / size;
  double second = fourth / total + trace * (2 * size - trace) + 4 * trace - 2 * twice;
  double variance = second - size * size + 2 * size * (size + 2) * share * share / count;
  double wider = variance <= 2 * size ? 1 : variance / (2 * size);
  bool known = count > TOO_FEW;
  found[0] = known ? (Real)(square / (wider * (1 + share / count))) : 0;
  found[1] = known ? (Real)(measured / wider) : 0;
}

// args: predicted measurements `(y, m)`, their covariance `(y, y)`, log weights `(m)`, measurement `(y)`, one for each angle in it `(y)`;
// rets: square and degrees of freedom `(2)`
static void innovation(const Frame& frame, const Team& team) {
  Operand out = frame.ret(0), centers = frame.arg(0);
  Batch batch(out, 1);
  int64_t m = centers.dims[centers.rank - 1], size = centers.dims[centers.rank - 2];
  for_each_run(team, batch, 1, [=](int64_t run, const Team&) {
    auto of = [&](int i) { return batch.of<const Real>(frame.arg(i), run); };
    judge_innovation(of(0), of(1), of(2), of(3), of(4), (int)size, m, batch.of<Real>(out, run));
  });
}
MOTES_KERNEL(motes_innovation, innovation)
