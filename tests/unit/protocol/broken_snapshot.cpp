// SPDX-License-Identifier: GPL-3.0-or-later
// A triple buffer as it must not be: its exchange is relaxed, so that what one side
// writes is not ordered before what the other reads. Built with the thread sanitizer
// only, which has to find it.
#include <array>
#include <atomic>
#include <cstdint>
#include <cstdio>
#include <thread>

namespace {

struct Value {
  std::array<std::uint64_t, 32> words{};
};

class BrokenSnapshot {
 public:
  void publish(const Value& value) {
    places_[back_] = value;
    back_ = middle_.exchange(back_ | 4U, std::memory_order_relaxed) & 3U;
  }
  bool update() {
    if ((middle_.load(std::memory_order_relaxed) & 4U) == 0) return false;
    front_ = middle_.exchange(front_, std::memory_order_relaxed) & 3U;
    return true;
  }
  const Value& front() const { return places_[front_]; }

 private:
  std::array<Value, 3> places_{};
  std::uint32_t back_ = 0;
  std::atomic<std::uint32_t> middle_{1};
  std::uint32_t front_ = 2;
};

}  // namespace

int main() {
  BrokenSnapshot snapshot;
  std::thread writer([&] {
    Value value;
    for (std::uint64_t i = 1; i <= 100'000; ++i) {
      value.words.fill(i);
      snapshot.publish(value);
    }
  });
  std::uint64_t last = 0;
  while (last < 100'000)
    if (snapshot.update()) last = snapshot.front().words[0];
  writer.join();
  std::printf("last %llu\n", static_cast<unsigned long long>(last));
}
