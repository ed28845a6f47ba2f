// SPDX-License-Identifier: GPL-3.0-or-later
// A device of the SDK, at 1 kHz, that writes down what its hand feels and does to its hand
// whatever an experiment asks for.
#pragma once

#include <atomic>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

#include "suture/device.hpp"

namespace sutured::faults {

/// What a hand felt at one time.
struct Felt {
  std::int64_t time_ns = 0;  ///< monotonic
  suture::Vector3 force_n{};
  suture::ForceState state = suture::ForceState::kIdle;
  std::uint32_t faults = 0;
  std::int64_t asked_ns = 0;        ///< monotonic: the force is of a time from here to `time_ns`
  std::uint64_t hand_sequence = 0;  ///< the hand that the server's force answers, and which
  std::uint64_t sequence = 0;       ///<   of its forces that is
  std::int64_t stamp_ns = 0;        ///< the server's, of that force; 0: not known

  [[nodiscard]] double magnitude_n() const;
};

/// Threads: its own ticks; everything else one other.
class FeltDevice {
 public:
  /// What to send in place of one hand: any number of hands, none for silence.
  using Spoil = std::function<std::vector<suture::Hand>(const suture::Hand& good)>;

  /// Connects and holds `hand` from then on. Throws what suture::Device throws.
  FeltDevice(suture::DeviceOptions options, const suture::Hand& hand);
  ~FeltDevice();
  FeltDevice(const FeltDevice&) = delete;
  FeltDevice& operator=(const FeltDevice&) = delete;

  /// Spoils every hand from the next on; null ends that. Returns the time of the last good one.
  std::int64_t spoil(Spoil how);
  void set_render(suture::Render render);
  /// Everything felt since the last `forget`.
  [[nodiscard]] std::vector<Felt> felt();
  [[nodiscard]] Felt last();
  void forget();

 private:
  void run();

  suture::Device device_;
  const suture::Hand hand_;
  std::mutex mutex_;
  Spoil spoil_;
  std::vector<Felt> felt_;
  std::int64_t last_good_ns_ = 0;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

}  // namespace sutured::faults
