// SPDX-License-Identifier: Apache-2.0
// The few fields of samples that recorder and replayer look at, taken off the bytes that
// travel (four of encapsulation, then XCDR1, little endian). The order of fields is the
// contract of idl/suture_v1.idl.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "protocol/topics.hpp"

namespace suture::cli {

/// What stands at the head of a sample.
struct SampleHead {
  std::uint64_t key = 0;  ///< of the instance: the tool_id, or the hash of the name; 0: none
  std::uint64_t epoch = 0;
  std::uint64_t sequence = 0;
  /// Says whether `sequence` counts up by one a sample of this writer and key.
  bool counts = false;
};

/// Returns the head of a sample of that topic; none where the bytes are too short for one, or
/// the topic's samples have none.
[[nodiscard]] std::optional<SampleHead> sample_head(const TopicSpec& topic,
                                                    std::span<const std::byte> bytes) noexcept;

/// What a ServerStatus says of who sends it.
struct ServerFacts {
  std::uint64_t epoch = 0;
  std::string version, session, host, scene;
  std::int32_t pid = 0;
  std::int64_t started_ns = 0;
  bool leaving = false;
  double rate_hz = 0.0;
};
[[nodiscard]] std::optional<ServerFacts> server_facts(std::span<const std::byte> bytes);

/// What a HapticModel says of the simulation step that made it.
struct StepFacts {
  std::string tool;
  std::uint64_t epoch = 0;
  std::uint64_t step = 0;
  std::uint64_t pose_sequence = 0;  ///< of the ToolPose that the step took
  double simulation_time_s = 0.0;
  bool engaged = false;  ///< a hand moved the tool
  std::array<double, 3> position_m{};
  std::array<double, 4> orientation_xyzw{};  ///< where the step took the tool; world
};
[[nodiscard]] std::optional<StepFacts> step_facts(std::span<const std::byte> bytes);

/// What a ToolPose says of the jaw.
struct JawFacts {
  std::uint64_t tool_id = 0;
  std::uint64_t sequence = 0;
  double jaw = 0.0;
};
[[nodiscard]] std::optional<JawFacts> jaw_facts(std::span<const std::byte> bytes) noexcept;

}  // namespace suture::cli
