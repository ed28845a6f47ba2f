// SPDX-License-Identifier: GPL-3.0-or-later
#include "gateway/hands.hpp"

namespace sutured::gateway {
namespace {

using suture::v1::Command;
using suture::v1::DeviceProfile;
using suture::v1::ToolPose;

std::string_view name_of(const suture::TopicSpec& spec) noexcept { return spec.name; }

Refusal not_a(const char* type) {
  return {std::string("that is not a suture::v1::") + type + " in XCDR1", {}};
}

Refusal may_not_drive() { return {"your token does not allow to drive that tool", kMayNotDrive}; }

Refusal too_many_tools() {
  return {"one client drives at most " + std::to_string(Hands::kToolsMax) + " tools", {}};
}

}  // namespace

HandPorts::HandPorts(const suture::Participant& control_in)
    : control(control_in),
      pose(control, *suture::topic<ToolPose>().descriptor, suture::topic<ToolPose>().name),
      profile(control, *suture::topic<DeviceProfile>().descriptor,
              suture::topic<DeviceProfile>().name),
      command(control, *suture::topic<Command>().descriptor, suture::topic<Command>().name),
      profiles(control),
      commands(control) {}

std::string Hands::refuse(std::string_view topic) {
  if (topic == name_of(suture::topic<ToolPose>()) ||
      topic == name_of(suture::topic<DeviceProfile>()) ||
      topic == name_of(suture::topic<Command>()))
    return {};
  return "clients may publish suture/tool/pose, suture/tool/device and suture/command";
}

Refusal Hands::publish(std::string_view topic, std::span<const std::byte> bytes,
                       const Rights& rights) {
  try {
    if (topic == name_of(suture::topic<ToolPose>())) return publish_pose(bytes, rights);
    if (topic == name_of(suture::topic<DeviceProfile>())) return publish_profile(bytes, rights);
    if (topic == name_of(suture::topic<Command>())) return publish_command(bytes, rights);
  } catch (const suture::Error& error) {
    return {error.what(), {}};
  }
  return {refuse(topic), {}};
}

suture::Writer<ToolPose>* Hands::writer_of(std::uint64_t tool_id) {
  const auto found = poses_.find(tool_id);
  if (found != poses_.end()) return &found->second;
  if (poses_.size() >= kToolsMax) return nullptr;
  return &poses_.emplace(tool_id, suture::Writer<ToolPose>(ports_.control)).first->second;
}

Refusal Hands::publish_pose(std::span<const std::byte> bytes, const Rights& rights) {
  ToolPose pose;
  if (!ports_.pose.decode(bytes, pose)) return not_a("ToolPose");
  if (!rights.may_drive(pose.tool_id)) return may_not_drive();
  pose.flags &= ~std::uint32_t{suture_v1_POSE_RENDER_DEVICE};
  if ((pose.flags & suture_v1_POSE_GOODBYE) != 0 && !poses_.contains(pose.tool_id)) return {};
  suture::Writer<ToolPose>* const writer = writer_of(pose.tool_id);
  if (writer == nullptr) return too_many_tools();
  writer->write(pose);
  return {};
}

Refusal Hands::publish_profile(std::span<const std::byte> bytes, const Rights& rights) {
  DeviceProfile profile;
  if (!ports_.profile.decode(bytes, profile)) return not_a("DeviceProfile");
  const std::uint64_t tool_id = suture::tool_id(suture::text_of(profile.tool));
  if (!rights.may_drive(tool_id)) return may_not_drive();
  suture::Writer<ToolPose>* const poses = writer_of(tool_id);
  if (poses == nullptr) return too_many_tools();
  suture::set_guid(profile.device, poses->guid());
  ports_.profiles.write(profile);
  return {};
}

Refusal Hands::publish_command(std::span<const std::byte> bytes, const Rights& rights) {
  Command command;
  if (!ports_.command.decode(bytes, command)) return not_a("Command");
  // Whoever may look may stop: that is never refused.
  if (!rights.command && command.kind != suture_v1_COMMAND_STOP)
    return {"your token does not allow commands", {}};
  suture::set_guid(command.requester, ports_.commands.guid());
  if (ports_.commands.matched() == 0 || !ports_.commands.write(command))
    return {"the server does not take commands just now; try again", {}};
  return {};
}

}  // namespace sutured::gateway
