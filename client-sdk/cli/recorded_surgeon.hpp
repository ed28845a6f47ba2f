// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "mcap/reader.hpp"
#include "protocol/surgeon.hpp"

namespace suture::cli {

/// A recording as a surgeon file, for `sutured run`.
struct RecordedSurgeon {
  Surgeon surgeon;
  std::uint64_t epoch = 0;
  std::string scene;     ///< empty: the recording does not say
  double rate_hz = 0.0;  ///< of the server's steps
  /// Why `sutured run` will not repeat the session step by step; empty: it will.
  std::vector<std::string> notes;
};

/// Turns a recording into the motions that the server's simulation followed.
///
/// The time base is the simulation's, not a clock. Each HapticModel names its step, the
/// simulation's time after it, the world pose to which that step took the tool (mapping,
/// scales and clutch are behind it), and the number of the ToolPose, which has the jaw: one
/// row a step and tool. `sutured run` of the same scene at the same rate puts the same inputs
/// into the same steps, to the last digit of a quaternion. What breaks that is in `notes`:
/// steps that the server stretched because it was late, steps that were not recorded, hands
/// that came before the recording or left and came back, poses that were not recorded.
///
/// `epoch`: which of several worlds; by default the last in which a hand moved a tool. Reads
/// `recording` to its end, or to where it is damaged. Throws Error kBadInput where no hand
/// moved a tool, or the topics needed were not recorded.
[[nodiscard]] RecordedSurgeon surgeon_of(mcap::Reader& recording,
                                         std::optional<std::uint64_t> epoch);

}  // namespace suture::cli
