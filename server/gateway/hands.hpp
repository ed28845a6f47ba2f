// SPDX-License-Identifier: GPL-3.0-or-later
// Tools driven, and commands given, from the web: a client becomes a DDS device like any
// other, with writers of its own, and all safety lies where it lies for the others.
#pragma once

#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <string_view>

#include "gateway/access.hpp"
#include "protocol/endpoint.hpp"
#include "protocol/serialized.hpp"

namespace sutured::gateway {

/// What the hands of all clients share: how to read what they send, and the writers of what
/// is not told apart by its writer. These are there from the start, so that a reliable
/// command finds its reader matched.
class HandPorts {
 public:
  /// Throws suture::Error. `control` must outlive it.
  explicit HandPorts(const suture::Participant& control);

  const suture::Participant& control;
  const suture::SampleCodec pose, profile, command;
  suture::Writer<suture::v1::DeviceProfile> profiles;
  suture::Writer<suture::v1::Command> commands;
};

/// Why a message was not sent on.
struct Refusal {
  std::string reason;   ///< empty: it was
  std::string_view id;  ///< for programs (`status`): kMayNotDrive, or empty
};
/// The client's token does not allow to drive that tool.
inline constexpr std::string_view kMayNotDrive = "may-not-drive";

/// What one client publishes. A pose writer comes to be with the first pose of a tool and goes with
/// the client: so the server sees the lease end. It outlives POSE_GOODBYE, which ends the lease by
/// itself: each writer made costs the process some memory for good (Cyclone DDS 0.10.2).
///
/// GUIDs in what a client sends are replaced by its own writers'; POSE_RENDER_DEVICE is
/// cleared, since a hand by the web is always rendered by the server.
/// Threads: the gateway's.
class Hands {
 public:
  static constexpr std::size_t kToolsMax = 8;  ///< as many as a scene has

  explicit Hands(HandPorts& ports) : ports_(ports) {}

  /// Sends one message on, or says why not.
  [[nodiscard]] Refusal publish(std::string_view topic, std::span<const std::byte> bytes,
                                const Rights& rights);
  /// Says whether a client may publish `topic` at all; else why not.
  [[nodiscard]] static std::string refuse(std::string_view topic);

 private:
  [[nodiscard]] suture::Writer<suture::v1::ToolPose>* writer_of(std::uint64_t tool_id);
  Refusal publish_pose(std::span<const std::byte> bytes, const Rights& rights);
  Refusal publish_profile(std::span<const std::byte> bytes, const Rights& rights);
  Refusal publish_command(std::span<const std::byte> bytes, const Rights& rights);

  HandPorts& ports_;
  std::map<std::uint64_t, suture::Writer<suture::v1::ToolPose>> poses_;  // by tool
};

}  // namespace sutured::gateway
