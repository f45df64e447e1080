// The two stages of a filter with particles, for a traced model: `Model` is written by the translator.
//   LEAVES, ROWS[], RANKS[]: arrays of the particles' state; OUTS, OUT_ROWS[], OUT_RANKS[]: those that the stage changes;
//   TABLES, TABLE_BYTES[]: arrays that all particles share, and the size of their elements;
//   NOISE: rows of random numbers; draw(P, begin, noise) fills them; lanes(...) works on up to BLOCK particles.
#pragma once
#include "weights.hpp"

// what works on up to BLOCK particles is given
#define MOTES_LANES                                                                                                           \
  const uint32_t *P, const Rows<Model>&rows, const int32_t *__restrict ancestors, int64_t first, int m,                       \
      const Real(*__restrict noise)[BLOCK], Real *__restrict likelihood, Real *__restrict maximum
// and a piece of it, which begins at `at`
#define MOTES_PIECE(size) \
  P, rows, ancestors + at, first + at, (m - at < size ? m - at : size), (const Real(*)[BLOCK])(noise[0] + at), likelihood + at, maximum + at

namespace motes {

constexpr int PIECE = 512 / sizeof(Real);

template <class Model>
struct Rows {
  const Real* in[Model::IN_ROWS + 1];
  Real* out[Model::OUT_ROWS_ALL + 1];
  const void* tables[Model::TABLES + 1];
};

template <class Model>
static Rows<Model> rows_of(const Frame& frame, const Batch& batch, int64_t run, int first_out) {
  Rows<Model> rows;
  int at = 0;
  for (int leaf = 0; leaf < Model::LEAVES; leaf++) {
    int64_t apart;  // of any number of particles, where their children are moved
    const Real* data = batch.rows<const Real>(frame.arg(2 + leaf), run, apart);
    for (int r = 0; r < Model::ROWS[leaf]; r++) rows.in[at++] = data + r * apart;
  }
  for (int table = 0; table < Model::TABLES; table++)
    rows.tables[table] = batch.at(frame.arg(2 + Model::LEAVES + table), run, Model::TABLE_BYTES[table]);
  at = 0;
  for (int leaf = 0; leaf < Model::OUTS; leaf++) {
    int64_t apart;
    Real* data = batch.rows<Real>(frame.ret(first_out + leaf), run, apart);
    for (int r = 0; r < Model::OUT_ROWS[leaf]; r++) rows.out[at++] = data + r * apart;
  }
  return rows;
}

// args: parameters, ancestors `(n)`, leaves, tables; rets: changed leaves
template <class Model>
static void move(const Frame& frame, const Team& team) {
  Operand like = frame.ret(0);
  Batch batch(like, Model::OUT_RANKS[0], frame.elements());
  int64_t n = batch.length(like);
  for_each_run(team, batch, n, [=](int64_t run, const Team& own) {
    const uint32_t* parameters = batch.of<const uint32_t>(frame.arg(0), run);
    const int32_t* ancestors = batch.row<const int32_t>(frame.arg(1), run);
    Rows<Model> rows = rows_of<Model>(frame, batch, run, 0);
    own.each(blocks_of(n), [=](int64_t b) {
      alignas(64) Real noise[Model::NOISE + 1][BLOCK];
      Model::draw(parameters, (uint32_t)(b * BLOCK), noise);
      Model::lanes(parameters, rows, ancestors + b * BLOCK, b * BLOCK, length_of(b, n), noise, nullptr, nullptr);
    });
  });
}

// args: parameters, log weights `(n)`, leaves, tables; rets: log weights `(n)`, judgement `(6)`, changed leaves
template <class Model>
static void weigh(const Frame& frame, const Team& team) {
  weigh_runs(frame, team, [=](const Batch& batch, int64_t run, int64_t n) {
    const uint32_t* parameters = batch.of<const uint32_t>(frame.arg(0), run);
    Rows<Model> rows = rows_of<Model>(frame, batch, run, 2);
    return [=](int64_t b, Real* likelihood, Real* maximum) {
      alignas(64) Real noise[Model::NOISE + 1][BLOCK];
      Model::draw(parameters, (uint32_t)(b * BLOCK), noise);
      Model::lanes(parameters, rows, nullptr, b * BLOCK, length_of(b, n), noise, likelihood, maximum);
      return Seen{likelihood, maximum};
    };
  });
}

}  // namespace motes
