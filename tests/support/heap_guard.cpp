// SPDX-License-Identifier: GPL-3.0-or-later
#include "support/heap_guard.hpp"

#include <dlfcn.h>
#include <pthread.h>

#include <atomic>
#include <cerrno>
#include <cstdlib>

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define SUTURED_COUNTS_HEAP 0
#else
#define SUTURED_COUNTS_HEAP 1
#endif

namespace {

// Plain thread locals of the executable: their access does not allocate itself.
thread_local std::uint64_t g_thread_allocations = 0;
thread_local std::uint64_t g_thread_frees = 0;
thread_local std::uint64_t g_thread_locks = 0;
thread_local bool g_abort = false;
std::atomic<std::uint64_t> g_process_allocations{0};

#if SUTURED_COUNTS_HEAP
void count_allocation() noexcept {
  if (g_abort) {
    g_abort = false;
    std::abort();
  }
  ++g_thread_allocations;
  g_process_allocations.fetch_add(1, std::memory_order_relaxed);
}
#endif

}  // namespace

#if SUTURED_COUNTS_HEAP
extern "C" {
void* __libc_malloc(std::size_t size);
void* __libc_calloc(std::size_t count, std::size_t size);
void* __libc_realloc(void* block, std::size_t size);
void* __libc_memalign(std::size_t alignment, std::size_t size);
void __libc_free(void* block);

void* malloc(std::size_t size) {
  count_allocation();
  return __libc_malloc(size);
}

void* calloc(std::size_t count, std::size_t size) {
  count_allocation();
  return __libc_calloc(count, size);
}

void* realloc(void* block, std::size_t size) {
  count_allocation();
  return __libc_realloc(block, size);
}

void* memalign(std::size_t alignment, std::size_t size) {
  count_allocation();
  return __libc_memalign(alignment, size);
}

void* aligned_alloc(std::size_t alignment, std::size_t size) {
  count_allocation();
  return __libc_memalign(alignment, size);
}

int posix_memalign(void** block, std::size_t alignment, std::size_t size) {
  count_allocation();
  if (alignment % sizeof(void*) != 0 || (alignment & (alignment - 1)) != 0) return EINVAL;
  void* const result = __libc_memalign(alignment, size);
  if (result == nullptr) return ENOMEM;
  *block = result;
  return 0;
}

void free(void* block) {
  if (block != nullptr) ++g_thread_frees;
  __libc_free(block);
}
}

namespace {

/// The C library's own function of this name. Looked up once a function: dlsym itself locks, but
/// by a call within the C library, which does not come by here.
template <class Function>
Function* next(const char* name) noexcept {
  return reinterpret_cast<Function*>(dlsym(RTLD_NEXT, name));
}

}  // namespace

extern "C" {
int pthread_mutex_lock(pthread_mutex_t* mutex) noexcept {
  static std::atomic<int (*)(pthread_mutex_t*)> real{nullptr};
  auto* call = real.load(std::memory_order_relaxed);
  if (call == nullptr) real.store(call = next<int(pthread_mutex_t*)>("pthread_mutex_lock"));
  ++g_thread_locks;
  return call(mutex);
}

int pthread_mutex_trylock(pthread_mutex_t* mutex) noexcept {
  static std::atomic<int (*)(pthread_mutex_t*)> real{nullptr};
  auto* call = real.load(std::memory_order_relaxed);
  if (call == nullptr) real.store(call = next<int(pthread_mutex_t*)>("pthread_mutex_trylock"));
  ++g_thread_locks;
  return call(mutex);
}

int pthread_rwlock_rdlock(pthread_rwlock_t* lock) noexcept {
  static std::atomic<int (*)(pthread_rwlock_t*)> real{nullptr};
  auto* call = real.load(std::memory_order_relaxed);
  if (call == nullptr) real.store(call = next<int(pthread_rwlock_t*)>("pthread_rwlock_rdlock"));
  ++g_thread_locks;
  return call(lock);
}

int pthread_rwlock_wrlock(pthread_rwlock_t* lock) noexcept {
  static std::atomic<int (*)(pthread_rwlock_t*)> real{nullptr};
  auto* call = real.load(std::memory_order_relaxed);
  if (call == nullptr) real.store(call = next<int(pthread_rwlock_t*)>("pthread_rwlock_wrlock"));
  ++g_thread_locks;
  return call(lock);
}
}
#endif

namespace sutured::testing {

HeapGuard::HeapGuard() noexcept
    : thread_start_(g_thread_allocations),
      process_start_(g_process_allocations.load(std::memory_order_relaxed)),
      frees_start_(g_thread_frees),
      locks_start_(g_thread_locks) {}

std::uint64_t HeapGuard::allocations() const noexcept {
  return g_thread_allocations - thread_start_;
}

std::uint64_t HeapGuard::allocations_of_process() const noexcept {
  return g_process_allocations.load(std::memory_order_relaxed) - process_start_;
}

std::uint64_t HeapGuard::frees() const noexcept { return g_thread_frees - frees_start_; }

std::uint64_t HeapGuard::locks() const noexcept { return g_thread_locks - locks_start_; }

bool HeapGuard::active() noexcept { return SUTURED_COUNTS_HEAP != 0; }

void HeapGuard::abort_on_allocation(bool on) noexcept { g_abort = on; }

}  // namespace sutured::testing
