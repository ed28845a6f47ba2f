// SPDX-License-Identifier: Apache-2.0
#include "other_tools.hpp"

#include <algorithm>
#include <cmath>

#include "model_renderer.hpp"

namespace suture {
namespace {

bool is_pose(const Hand& hand) noexcept {
  double squared = 0.0;
  for (const double q : hand.orientation_xyzw) squared += q * q;
  return std::abs(squared - 1.0) < 1e-2 &&
         std::all_of(hand.position_m.begin(), hand.position_m.end(),
                     [](double x) { return std::isfinite(x); });
}

}  // namespace

OtherTools::Tool* OtherTools::find(std::uint64_t id) noexcept {
  for (Tool& tool : tools_) {
    if (tool.id == 0) tool.id = id;
    if (tool.id == id) return &tool;
  }
  return nullptr;
}

void OtherTools::receive(const v1::HapticModel& wire) noexcept {
  Tool* const tool = find(tool_id(text_of(wire.tool)));
  if (tool == nullptr || (wire.flags & suture_v1_MODEL_ENGAGED) == 0) return;
  tool->mapping = wire.mapping;
  tool->mapped_pose = wire.pose_sequence;
  tool->mapped = true;
}

void OtherTools::receive(const v1::ToolForce& wire) noexcept {
  Tool* const tool = find(wire.tool_id);
  if (tool == nullptr) return;
  const bool follows = (wire.flags & suture_v1_FORCE_ENGAGED) != 0;
  if (follows && !tool->follows) tool->follows_since = wire.pose_sequence;
  tool->follows = follows;
}

void OtherTools::receive(const v1::ToolPose& wire) noexcept {
  Tool* const tool = find(wire.tool_id);
  if (tool == nullptr || !tool->follows || !tool->mapped ||
      tool->mapped_pose < tool->follows_since) {
    return;
  }
  Hand hand;
  for (std::size_t i = 0; i < 3; ++i) hand.position_m[i] = wire.position_m[i];
  for (std::size_t i = 0; i < 4; ++i) hand.orientation_xyzw[i] = wire.orientation_xyzw[i];
  hand.in_world = (wire.flags & suture_v1_POSE_IN_WORLD) != 0;
  if (!is_pose(hand)) return;
  poses_[static_cast<std::size_t>(tool - tools_.data())].publish(
      {tool->id, to_world(tool->mapping, hand)});
}

const Pose& OtherTools::pose(std::uint64_t tool, const Pose& otherwise) noexcept {
  for (Snapshot<Place>& place : poses_) {
    const Place& latest = place.latest();
    if (latest.id == tool) return latest.pose;
  }
  return otherwise;
}

}  // namespace suture
