// SPDX-License-Identifier: GPL-3.0-or-later
// What a network does to the packets of one direction, as a value: no clock, no socket.
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <random>

namespace sutured::testing {

/// How a direction of a network treats packets.
struct Impairment {
  std::int64_t delay_ns = 0;
  std::int64_t jitter_ns = 0;        ///< delays are uniform in delay ± jitter; at most `delay_ns`
  double loss = 0.0;                 ///< share of packets that vanish, 0 … 1
  double reordering = 0.0;           ///< share of packets that later ones may overtake, 0 … 1
  std::int64_t held_ns = 3'000'000;  ///< how much longer those take
  std::uint64_t seed = 1;
};

/// Decides when each packet of one direction leaves.
///
/// The fate of the n-th packet depends on the seed and n alone. Packets keep their order under
/// jitter, as in a queue, but for those that are held back.
class ImpairedLink {
 public:
  explicit ImpairedLink(const Impairment& impairment)
      : impairment_(impairment), random_(impairment.seed) {}

  /// Returns when the packet that arrived at `now_ns` leaves; nothing where it is lost.
  std::optional<std::int64_t> departure_ns(std::int64_t now_ns) {
    // Three draws a packet, whatever becomes of it: no fate shifts the next one's.
    const double lost = unit(), held = unit(), spread = 2.0 * unit() - 1.0;
    if (lost < impairment_.loss) {
      ++lost_;
      return std::nullopt;
    }
    const std::int64_t turn_ns =
        now_ns + impairment_.delay_ns +
        static_cast<std::int64_t>(spread * static_cast<double>(impairment_.jitter_ns));
    ++passed_;
    if (held < impairment_.reordering) {
      ++held_;
      return std::max(turn_ns, last_ns_) + impairment_.held_ns;
    }
    return last_ns_ = std::max(turn_ns, last_ns_);
  }

  [[nodiscard]] std::uint64_t passed() const { return passed_; }
  [[nodiscard]] std::uint64_t lost() const { return lost_; }
  [[nodiscard]] std::uint64_t held_back() const { return held_; }

 private:
  /// Uniform in [0, 1), the same on every standard library.
  double unit() { return static_cast<double>(random_() >> 11U) * 0x1p-53; }

  Impairment impairment_;
  std::mt19937_64 random_;
  std::int64_t last_ns_ = INT64_MIN;
  std::uint64_t passed_ = 0, lost_ = 0, held_ = 0;
};

}  // namespace sutured::testing
