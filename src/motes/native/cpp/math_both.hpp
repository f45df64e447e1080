// Elementary functions whose formula is the same in both precisions, from the pieces that each has.
#pragma once
#include "math_double.hpp"

namespace motes {

template <class T>
static inline __attribute__((always_inline)) T log(T x) {
  T value = log_of(x, (T)0);
  return x == 0 ? -INF : (x < 0 ? NOT_A_NUMBER : ((x == INF) | (x != x) ? x : value));
}

template <class T>
static inline __attribute__((always_inline)) T sin(T x) {
  auto r = quarters(x);
  T value = r.quarter & 1 ? cosine_core(r.rest) : sine_core(r.rest);
  return r.quarter & 2 ? -value : value;
}

template <class T>
static inline __attribute__((always_inline)) T cos(T x) {
  auto r = quarters(x);
  T value = r.quarter & 1 ? sine_core(r.rest) : cosine_core(r.rest);
  return (r.quarter + 1) & 2 ? -value : value;
}

template <class T>
static inline __attribute__((always_inline)) T tan(T x) {
  auto r = quarters(x);
  T s = sine_core(r.rest), c = cosine_core(r.rest);
  return r.quarter & 1 ? -c / s : s / c;
}

template <class T>
static inline __attribute__((always_inline)) T atan(T x) { return atan2(x, (T)1); }

template <class T>
static inline __attribute__((always_inline)) T cosh(T x) {
  T half = exp((T)0.5 * absolute(x));  // the square may be the first to overflow
  return half * ((T)0.5 * half) + (T)0.5 / half / half;
}

template <class T>
static inline __attribute__((always_inline)) T logistic(T x) { return 1 / (1 + exp(-x)); }

template <class T>
static inline __attribute__((always_inline)) T rsqrt(T x) { return 1 / sqrt(x); }

}  // namespace motes
