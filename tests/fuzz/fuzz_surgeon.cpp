// SPDX-License-Identifier: GPL-3.0-or-later
// A surgeon's file: tracks that can be played, or a fault with its place. What was read is written
// as text that reads as the same.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>

#include "protocol/surgeon.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  try {
    const suture::Surgeon surgeon = suture::parse_surgeon(text, "hands.csv");
    for (const suture::SurgeonTrack& track : surgeon.tracks) {
      const double middle_s = 0.5 * (track.begin_s() + track.end_s());
      for (const double time_s : {track.begin_s(), middle_s, track.end_s(), -1e300, 1e300}) {
        const suture::SurgeonPose pose = track.at(time_s);
        double squared = 0.0;
        for (const double q : pose.orientation_xyzw) squared += q * q;
        if (!(std::abs(squared - 1.0) < 1e-2)) std::abort();
        if (!(pose.jaw >= 0.0 && pose.jaw <= 1.0)) std::abort();
        for (const double x : pose.position_m)
          if (!std::isfinite(x)) std::abort();
      }
    }
    const std::string written = surgeon_text(surgeon);
    if (surgeon_text(suture::parse_surgeon(written, "again.csv")).size() == 0) std::abort();
  } catch (const suture::Error& error) {
    if (error.code() != suture::ErrorCode::kBadInput) std::abort();
    if (error.cause().find("hands.csv") == std::string::npos) std::abort();
  }
  return 0;
}
