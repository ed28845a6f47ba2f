// SPDX-License-Identifier: GPL-3.0-or-later
// What the programs that serve the anastomosis for long have in common.
#pragma once

#include <algorithm>
#include <cmath>
#include <string>

#include "protocol/surgeon.hpp"
#include "protocol/topics.hpp"
#include "suture/device.hpp"
#include "suture/session.hpp"

namespace sutured::soak {

inline const std::string kFolder = SUTURED_SOURCE_DIR "/server/scenes/anastomosis/";
/// The largest force and slew that its scene.toml allows to each tool.
inline constexpr double kMaxForce_n = 3.3;
inline constexpr double kMaxSlew_n_per_s = 500.0;

/// For CYCLONEDDS_URI. Cyclone takes the memory for what it receives from a buffer of a domain, and
/// gets a new one when that is full. One of 1 MiB, as it is by default, takes minutes: small ones
/// are full when a server is warm. Each must be larger than a message's share of it, 128 KiB.
inline constexpr const char* kSmallBuffers =
    "<CycloneDDS><Domain Id=\"any\"><Sizing><ReceiveBufferSize>256 KiB</ReceiveBufferSize></Sizing>"
    "</Domain></CycloneDDS>";

/// Fills the history of events that the server keeps for late joiners, which would otherwise grow
/// through most of a run: Cyclone keeps each event in 4 KiB. To resume what runs is an event too.
inline void fill_history(suture::Session& session) {
  for (int i = 0; i < suture::topic<suture::v1::Event>().depth; ++i)
    session.command(suture::CommandKind::kResume);
}

/// Returns the hand of `track` at `time_s`, played to its end, back to its beginning, and again.
inline suture::Hand to_and_fro(const suture::SurgeonTrack& track, double time_s) {
  const double round_s = 2.0 * track.end_s();
  const double phase_s = std::fmod(time_s, round_s);
  const suture::SurgeonPose pose = track.at(std::min(phase_s, round_s - phase_s));
  suture::Hand hand;
  hand.position_m = pose.position_m;
  hand.orientation_xyzw = pose.orientation_xyzw;
  hand.jaw = pose.jaw;
  hand.in_world = true;
  return hand;
}

}  // namespace sutured::soak
