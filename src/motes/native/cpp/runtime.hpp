// What every kernel needs of its surroundings: its operands, the threads of XLA, scratch memory that is kept between calls.
// Nothing needs the library of C++: some compilers have to build it first, and to read its headers takes longer than to compile a model.
#pragma once
#include <sched.h>
#include <stdlib.h>

#include "random.hpp"
#include "xla/ffi/api/c_api.h"

namespace motes {

// One operand or result: `small` trailing axes for one run, any axes before them are a batch of runs (size one where all runs share it).
// Where a cloud is cut into elements, the last axis of the batch is that of the elements. Arrays of particles have it not before their
// rows, but within their last axis, side by side as they lie in memory; `shared` ones are whole for each element.
struct Operand {
  char* data;
  int64_t rank;
  const int64_t* dims;
  bool shared;
};

struct Frame {
  XLA_FFI_CallFrame* call;
  Operand arg(int i) const { return operand(call->args.args[i], elements() && !(number(0) >> i & 1)); }
  Operand ret(int i) const { return operand(call->rets.rets[i], false); }
  // number of elements that the particles are cut into; none where they are not
  int64_t elements() const { return call->attrs.size == 2 ? number(1) : 0; }

 private:
  // in alphabetical order: which arguments each element has of its own, as bits, and the number of elements
  int64_t number(int i) const { return *(int64_t*)((XLA_FFI_Scalar*)call->attrs.attrs[i])->value; }
  static Operand operand(void* raw, bool shared) {
    auto* buffer = (XLA_FFI_Buffer*)raw;
    return {(char*)buffer->data, buffer->rank, buffer->dims, shared};
  }
};

// The runs of a batch; `like` is a result, which has all axes of the batch, and is an array of particles or not.
struct Batch {
  static constexpr int MOST = 16;
  int64_t axes, count = 1, elements, sizes[MOST];
  Batch(const Operand& like, int64_t small, int64_t elements = 0, bool of_particles = true)
      : axes(like.rank - small + (elements && of_particles)), elements(elements) {
    if (axes > MOST) abort();
    for (int64_t a = 0; a < axes; a++) sizes[a] = elements && a == axes - 1 ? elements : like.dims[a], count *= sizes[a];
  }
  template <class T>
  T* of(const Operand& operand, int64_t run) const { return (T*)at(operand, run, sizeof(T)); }
  // elements of so many bytes
  void* at(const Operand& operand, int64_t run, int64_t bytes) const { return operand.data + offset(operand, run, bytes, axes); }
  // the first row of an array of particles, and how far apart rows are
  template <class T>
  T* rows(const Operand& operand, int64_t run, int64_t& apart) const {
    apart = operand.dims[operand.rank - 1];
    if (!elements) return of<T>(operand, run);
    T* data = (T*)(operand.data + offset(operand, run / elements, sizeof(T), axes - 1));
    return operand.shared ? data : data + run % elements * (apart / elements);
  }
  template <class T>
  T* row(const Operand& operand, int64_t run) const {
    int64_t apart;
    return rows<T>(operand, run, apart);
  }
  // number of particles of a run
  int64_t length(const Operand& operand) const { return operand.dims[operand.rank - 1] / (elements && !operand.shared ? elements : 1); }

 private:
  int64_t offset(const Operand& operand, int64_t run, int64_t bytes, int64_t first) const {
    int64_t size = bytes, found = 0;
    for (int64_t a = first; a < operand.rank; a++) size *= operand.dims[a];
    for (int64_t a = first; a-- > 0;) {
      if (operand.dims[a] != 1) found += run % sizes[a] * size, size *= operand.dims[a];
      run /= sizes[a];
    }
    return found;
  }
};

// Scratch memory, given back to a store when the call ends and taken from it by the next one.
class Scratch {
  struct Piece { void* data; size_t size; };
  struct Store {
    static constexpr int MOST = 64;
    Piece kept[MOST];
    int count;
    bool taken;
    // held for a few instructions
    void lock() {
      while (__atomic_test_and_set(&taken, __ATOMIC_ACQUIRE)) sched_yield();
    }
    void unlock() { __atomic_clear(&taken, __ATOMIC_RELEASE); }
    Piece take(int i) {
      Piece one = kept[i];
      kept[i] = kept[--count];
      return one;
    }
  };
  static Store& store() { static Store one; return one; }
  Piece piece{nullptr, 0};

 public:
  explicit Scratch(size_t bytes) {
    Store& all = store();
    all.lock();
    for (int i = 0; i < all.count && !piece.data; i++)
      if (all.kept[i].size >= bytes && all.kept[i].size <= 4 * bytes + 4096) piece = all.take(i);
    all.unlock();
    if (piece.data) return;
    size_t rounded = (bytes + 4095) / 4096 * 4096;
    piece = {aligned_alloc(4096, rounded), rounded};
    if (!piece.data) abort();
  }
  ~Scratch() {
    Store& all = store();
    all.lock();
    void* old = all.count == Store::MOST ? all.take(0).data : nullptr;
    all.kept[all.count++] = piece;
    all.unlock();
    free(old);
  }
  Scratch(const Scratch&) = delete;
  template <class T>
  T* as() const { return (T*)piece.data; }
};

// Work shared out over XLA's own threads: the calling thread takes part, so that it never waits for a thread that has not begun.
class Team {
  const XLA_FFI_Api* api;
  decltype(XLA_FFI_CallFrame::ctx) context;
  int64_t threads = 1;

  // outlives the call where a helper has not begun when all is done: the last one who lets go of it frees it
  template <class Work>
  struct Shared {
    Work work;
    int64_t count, chunk, next, done, holders;
    void help() {
      for (;;) {
        int64_t begin = __atomic_fetch_add(&next, chunk, __ATOMIC_RELAXED);
        if (begin >= count) return;
        int64_t end = begin + chunk < count ? begin + chunk : count;
        for (int64_t i = begin; i < end; i++) work(i);
        __atomic_fetch_add(&done, end - begin, __ATOMIC_RELEASE);
      }
    }
    void let_go(int64_t of = 1) {
      if (__atomic_sub_fetch(&holders, of, __ATOMIC_ACQ_REL) == 0) free(this);
    }
  };

 public:
  explicit Team(XLA_FFI_CallFrame* call) : api(call->api), context(call->ctx) {
    XLA_FFI_ThreadPool_NumThreads_Args args{XLA_FFI_ThreadPool_NumThreads_Args_STRUCT_SIZE, nullptr, context, &threads};
    if (XLA_FFI_Error* error = api->XLA_FFI_ThreadPool_NumThreads(&args)) {
      XLA_FFI_Error_Destroy_Args destroy{XLA_FFI_Error_Destroy_Args_STRUCT_SIZE, nullptr, error};
      api->XLA_FFI_Error_Destroy(&destroy);
      threads = 1;
    }
  }

  // a team of the calling thread alone, for work that is itself shared out
  Team single() const {
    Team one(*this);
    one.threads = 1;
    return one;
  }

  int64_t size() const { return threads; }

  // work(0) ... work(count - 1), in any order; below the count `least` the calling thread does it all
  template <class Work>
  void each(int64_t count, Work work, int64_t least = 2) const {
    if (threads < 2 || count < least) {
      for (int64_t i = 0; i < count; i++) work(i);
      return;
    }
    using State = Shared<Work>;
    int64_t chunk = count / (4 * threads) > 1 ? count / (4 * threads) : 1;
    int64_t helpers = (threads < count ? threads : count) - 1;
    void* room = malloc(sizeof(State));
    if (!room) abort();
    State first{work, count, chunk, 0, 0, helpers + 1};
    auto* state = (State*)__builtin_memcpy(room, &first, sizeof(State));
    auto task = [](void* raw) {
      ((State*)raw)->help();
      ((State*)raw)->let_go();
    };
    int64_t refused = 0;
    for (int64_t h = 0; h < helpers; h++) {
      XLA_FFI_ThreadPool_Schedule_Args args{XLA_FFI_ThreadPool_Schedule_Args_STRUCT_SIZE, nullptr, context, task, state};
      if (api->XLA_FFI_ThreadPool_Schedule(&args)) refused++;
    }
    state->help();
    for (int64_t spins = 0; __atomic_load_n(&state->done, __ATOMIC_ACQUIRE) < count; spins++) {
      if (spins > 4000) sched_yield();  // a helper has lost its processor to somebody else
#if defined(__x86_64__)
      else __builtin_ia32_pause();
#endif
    }
    state->let_go(1 + refused);
  }
};

// Says which version of the interface the kernel speaks, when XLA asks at registration.
static inline bool asked_for_metadata(XLA_FFI_CallFrame* call) {
  auto* extension = call->extension_start;  // its type has other names in other versions of the interface
  if (!extension || extension->type != XLA_FFI_Extension_Metadata) return false;
  auto* metadata = ((XLA_FFI_Metadata_Extension*)extension)->metadata;
  metadata->api_version.major_version = XLA_FFI_API_MAJOR;
  metadata->api_version.minor_version = XLA_FFI_API_MINOR;
  return true;
}

#define MOTES_KERNEL(name, body)                                     \
  extern "C" __attribute__((visibility("default")))                  \
  XLA_FFI_Error* name(XLA_FFI_CallFrame* call) {                     \
    if (motes::asked_for_metadata(call)) return nullptr;             \
    body(motes::Frame{call}, motes::Team(call));                     \
    return nullptr;                                                  \
  }

}  // namespace motes
