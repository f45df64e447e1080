// What every kernel needs of its surroundings: its operands, the threads of XLA, scratch memory that is kept between calls.
#pragma once
#include <atomic>
#include <cstdlib>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#include "random.hpp"
#include "xla/ffi/api/c_api.h"

namespace motes {

// One operand or result: `small` trailing axes for one run, any axes before them are a batch of runs (size one where all runs share it).
struct Operand {
  char* data;
  int64_t rank;
  const int64_t* dims;
};

struct Frame {
  XLA_FFI_CallFrame* call;
  Operand arg(int i) const { return operand(call->args.args[i]); }
  Operand ret(int i) const { return operand(call->rets.rets[i]); }
  static Operand operand(void* raw) {
    auto* buffer = (XLA_FFI_Buffer*)raw;
    return {(char*)buffer->data, buffer->rank, buffer->dims};
  }
};

// The runs of a batch; `like` is a result, which has all axes of the batch.
struct Batch {
  int64_t axes, count = 1;
  const int64_t* dims;
  Batch(const Operand& like, int64_t small) : axes(like.rank - small), dims(like.dims) {
    for (int64_t a = 0; a < axes; a++) count *= dims[a];
  }
  template <class T>
  T* of(const Operand& operand, int64_t run) const {
    int64_t size = 1, offset = 0;
    for (int64_t a = axes; a < operand.rank; a++) size *= operand.dims[a];
    for (int64_t a = axes; a-- > 0;) {
      if (operand.dims[a] != 1) offset += run % dims[a] * size, size *= operand.dims[a];
      run /= dims[a];
    }
    return (T*)operand.data + offset;
  }
};

// Scratch memory, given back to a store when the call ends and taken from it by the next one.
class Scratch {
  struct Piece { void* data; size_t size; };
  static std::vector<Piece>& store() { static auto* kept = new std::vector<Piece>; return *kept; }
  static std::mutex& lock() { static auto* mutex = new std::mutex; return *mutex; }
  Piece piece{nullptr, 0};

 public:
  explicit Scratch(size_t bytes) {
    {
      std::lock_guard<std::mutex> guard(lock());
      auto& kept = store();
      for (size_t i = 0; i < kept.size(); i++) {
        if (kept[i].size < bytes || kept[i].size > 4 * bytes + 4096) continue;
        piece = kept[i], kept[i] = kept.back(), kept.pop_back();
        return;
      }
      if (kept.size() >= 64) std::free(kept[0].data), kept[0] = kept.back(), kept.pop_back();
    }
    size_t rounded = (bytes + 4095) / 4096 * 4096;
    piece = {std::aligned_alloc(4096, rounded), rounded};
    if (!piece.data) std::abort();
  }
  ~Scratch() {
    std::lock_guard<std::mutex> guard(lock());
    store().push_back(piece);
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

  template <class Work>
  struct Shared {
    Work work;
    int64_t count, chunk;
    std::atomic<int64_t> next{0}, done{0};
    Shared(Work w, int64_t n, int64_t c) : work(w), count(n), chunk(c) {}
    void help() {
      for (;;) {
        int64_t begin = next.fetch_add(chunk, std::memory_order_relaxed);
        if (begin >= count) return;
        int64_t end = begin + chunk < count ? begin + chunk : count;
        for (int64_t i = begin; i < end; i++) work(i);
        done.fetch_add(end - begin, std::memory_order_release);
      }
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

  // work(0) ... work(count - 1), in any order; `alone` below which count the calling thread does it all
  template <class Work>
  void each(int64_t count, int64_t alone, Work work) const {
    if (threads < 2 || count < alone || count < 2) {
      for (int64_t i = 0; i < count; i++) work(i);
      return;
    }
    using State = Shared<Work>;
    int64_t chunk = count / (4 * threads) > 1 ? count / (4 * threads) : 1;
    auto state = std::make_shared<State>(work, count, chunk);
    int64_t helpers = (threads < count ? threads : count) - 1;
    for (int64_t h = 0; h < helpers; h++) {
      auto* ticket = new std::shared_ptr<State>(state);
      auto task = [](void* raw) {
        std::unique_ptr<std::shared_ptr<State>> own((std::shared_ptr<State>*)raw);
        (*own)->help();
      };
      XLA_FFI_ThreadPool_Schedule_Args args{XLA_FFI_ThreadPool_Schedule_Args_STRUCT_SIZE, nullptr, context, task, ticket};
      if (api->XLA_FFI_ThreadPool_Schedule(&args)) delete ticket;
    }
    state->help();
    for (int64_t spins = 0; state->done.load(std::memory_order_acquire) < count; spins++) {
      if (spins > 4000) std::this_thread::yield();  // a helper has lost its processor to somebody else
#if defined(__x86_64__)
      else __builtin_ia32_pause();
#endif
    }
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
