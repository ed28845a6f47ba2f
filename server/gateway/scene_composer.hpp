// SPDX-License-Identifier: GPL-3.0-or-later
// The scene as foxglove::SceneUpdate, for tools that know nothing of sutures.
#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "gateway/foxglove.hpp"
#include "protocol/endpoint.hpp"
#include "protocol/serialized.hpp"

namespace sutured::gateway {

/// Remembers the last of what is looked at, and draws it: tissues as triangles coloured by
/// von Mises stress, needles and threads as lines, punctures and contacts as spheres, tools
/// as axes with an arrow for the force on the hand (10 mm a newton). World frame, metres.
///
/// Threads: the gateway's. It has readers while somebody watches, and for `kReaderStays` more.
class SceneComposer {
 public:
  /// Throws suture::Error. `mesh` must outlive it.
  explicit SceneComposer(const suture::Participant& mesh);
  ~SceneComposer();

  /// As it is offered, with `id`.
  [[nodiscard]] static Channel channel(std::uint32_t id);
  /// Begins to compose, or ends it.
  void watch(bool wanted);
  /// Closes the readers where nobody has watched for `kReaderStays`.
  void close_idle(std::chrono::steady_clock::time_point now);
  /// Says whether it has readers.
  [[nodiscard]] bool reads() const { return readers_ != nullptr; }
  /// Returns the scene where something has come since the last call; it is whole each time,
  /// so that a tool may join, or lose any of them.
  [[nodiscard]] std::optional<suture::SerializedSample> compose();

 private:
  struct Readers;
  struct Tissue {
    std::uint32_t revision = 0;
    std::vector<std::uint32_t> triangle;
    std::vector<float> position_m, von_mises_pa;
  };
  struct Line {
    double diameter_m = 0.0;
    std::vector<double> course_m, tension_n;  // 3 per point; per pair of neighbours, or none
    std::vector<std::array<double, 3>> punctures_m;
  };
  struct Tool {
    std::array<double, 3> position_m{}, force_n{};
    std::array<double, 4> orientation_xyzw{};
  };
  struct Contact {
    std::array<double, 3> position_m{};
    double force_n = 0.0;
  };

  void read();
  void begin_epoch(std::uint64_t epoch);

  const suture::Participant& mesh_;
  suture::SampleCodec codec_;
  std::unique_ptr<Readers> readers_;
  bool watched_ = false;
  std::chrono::steady_clock::time_point left_;  // by the last who watched
  std::uint64_t epoch_ = 0;
  std::int64_t stamp_ns_ = 0;
  bool news_ = false;
  double peak_pa_ = 0.0;  // the end of the colour scale, which follows the scene slowly
  std::map<std::string, Tissue> tissues_;
  std::map<std::string, Line> needles_, threads_;
  std::map<std::string, Tool> tools_;
  std::vector<Contact> contacts_;
};

}  // namespace sutured::gateway
