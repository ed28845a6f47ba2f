// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <type_traits>

namespace suture {

/// Hands the latest value from one writer to one reader; neither ever waits.
///
/// Why not a mutex: the reader is a force thread, and a lock held by a writer that the
/// scheduler has put aside would hold the force back. Why not a seqlock: its reader
/// repeats while the writer writes, so it is not wait-free, and it reads bytes that are
/// being written, which is a data race. Three places are enough for both sides to own
/// one at all times:
///
///      writer                 middle                 reader
///     ┌──────┐  publish    ┌───────────┐   update   ┌──────┐
///     │ back │ ◀─exchange─▶│ place|new │◀─exchange─▶│ front│
///     └──────┘             └───────────┘            └──────┘
///
/// The middle is one atomic byte: the index of the place that nobody owns, and whether
/// it is newer than the reader's. Each exchange releases what its side wrote (or read)
/// and acquires what the other released, so a place is never touched from both sides.
/// Values that are not taken in time are overwritten: the latest wins.
///
/// "One writer" and "one reader" are roles: different threads may play them one after
/// the other if something else orders them (see the server's ToolChannel).
/// Values whose assignment allocates are filled in place (`back`), where they keep their
/// memory. Allocates: nothing itself. Cost: one copy in, one exchange a side.
template <class T>
class Snapshot {
 public:
  Snapshot() = default;
  Snapshot(const Snapshot&) = delete;
  Snapshot& operator=(const Snapshot&) = delete;

  /// Makes `value` the latest. Writer only.
  void publish(const T& value) noexcept {
    static_assert(std::is_trivially_copyable_v<T>, "fill back() instead");
    places_[back_] = value;
    publish();
  }
  /// The place that the next `publish()` makes the latest, to be filled without a copy.
  /// It holds some earlier value. Writer only.
  [[nodiscard]] T& back() noexcept { return places_[back_]; }
  void publish() noexcept {
    back_ = middle_.exchange(static_cast<std::uint8_t>(back_ | kNew), std::memory_order_acq_rel) &
            kIndex;
  }

  /// True when `update` would bring a newer value. Reader only.
  [[nodiscard]] bool pending() const noexcept {
    return (middle_.load(std::memory_order_relaxed) & kNew) != 0;
  }
  /// Moves to the latest value; false if there is none newer. Reader only.
  bool update() noexcept {
    if (!pending()) return false;
    front_ = middle_.exchange(front_, std::memory_order_acq_rel) & kIndex;
    return true;
  }
  /// The value of the last `update`, a default-made one before the first. It stays as
  /// it is until the next `update`. Reader only.
  [[nodiscard]] const T& front() const noexcept { return places_[front_]; }
  /// Moves to the latest value and returns it; holds until the next `latest` or `update`.
  [[nodiscard]] const T& latest() noexcept {
    update();
    return front();
  }

  /// Calls `prepare(T&)` on all three places, before either side has begun.
  template <class Prepare>
  void for_each_place(Prepare&& prepare) {
    for (T& place : places_) prepare(place);
  }

 private:
  static constexpr std::uint8_t kIndex = 3, kNew = 4;

  std::array<T, 3> places_{};
  // Apart, so that the two sides do not contend for a cache line.
  alignas(64) std::uint8_t back_ = 0;
  alignas(64) std::atomic<std::uint8_t> middle_{1};
  alignas(64) std::uint8_t front_ = 2;
};

}  // namespace suture
