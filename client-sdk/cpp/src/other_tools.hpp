// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>

#include "protocol/haptic_model.hpp"
#include "protocol/snapshot.hpp"
#include "protocol/types.hpp"

namespace suture {

/// Where the other tools of a scene are, from what travels anyway:
///
///     suture/tool/pose   the hand that leads it, in its device's frame
///     suture/tool/model  the mapping from that frame to the world
///     suture/tool/force  whether the tool follows its hand, or stands (clutch, fault, stop)
///
/// A mapping is used once a model has it that was made after the tool began to follow. Until then,
/// and when nothing comes any more, a tool stays where it was.
///
/// Threads: `receive` on one, `pose` on one. Allocates: nothing.
class OtherTools {
 public:
  static constexpr std::size_t kToolsMax = 16;  ///< beyond, a tool counts as standing still

  void receive(const v1::HapticModel& wire) noexcept;
  void receive(const v1::ToolForce& wire) noexcept;
  void receive(const v1::ToolPose& wire) noexcept;

  /// Returns the last known pose of the tool with this `tool_id`, or `otherwise`.
  [[nodiscard]] const Pose& pose(std::uint64_t tool, const Pose& otherwise) noexcept;

 private:
  struct Tool {
    std::uint64_t id = 0;
    v1::Mapping mapping{};
    std::uint64_t mapped_pose = 0;    // the newest pose that a model has used
    std::uint64_t follows_since = 0;  // the first pose that the tool follows
    bool follows = false, mapped = false;
  };
  struct Place {
    std::uint64_t id = 0;
    Pose pose;
  };
  Tool* find(std::uint64_t id) noexcept;

  std::array<Tool, kToolsMax> tools_;             // the receiver's
  std::array<Snapshot<Place>, kToolsMax> poses_;  // from it to the renderer
};

}  // namespace suture
