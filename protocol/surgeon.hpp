// SPDX-License-Identifier: Apache-2.0
// A surgeon file: recorded or written motions of tools, CSV.
//
//     time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw
//     0.0,driver,0.00,0,0.02,0,0,0,1,1
//     0.5,driver,0.01,0,0.02,0,0,0,1,1
//
// Poses are the tool's, in the world. Times of one tool increase; rows of several tools
// may be mixed. Between rows positions and the jaw move linearly, rotations by slerp
// along the shorter way; before the first row and after the last the tool stands still.
// Empty lines and lines that begin with # are skipped.
#pragma once

#include <array>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "suture/error.hpp"

namespace suture {

/// Where a tool is at one time; world frame.
struct SurgeonPose {
  std::array<double, 3> position_m{};
  std::array<double, 4> orientation_xyzw{0.0, 0.0, 0.0, 1.0};
  double jaw = 0.0;  ///< 0 open … 1 closed
};

/// One row of a surgeon file.
struct SurgeonRow {
  double time_s = 0.0;
  SurgeonPose pose;
};

/// The motion of one tool: rows with increasing times, at least one.
struct SurgeonTrack {
  std::string tool;
  std::vector<SurgeonRow> rows;

  [[nodiscard]] double begin_s() const { return rows.front().time_s; }
  [[nodiscard]] double end_s() const { return rows.back().time_s; }
  /// Returns the pose at `time_s`. Allocates nothing. Cost: a binary search.
  [[nodiscard]] SurgeonPose at(double time_s) const;
};

/// All motions of a file, in the order in which the tools first appear.
struct Surgeon {
  std::vector<SurgeonTrack> tracks;

  /// Returns the track of that tool, or null.
  [[nodiscard]] const SurgeonTrack* track(std::string_view tool) const noexcept;
  /// Returns the last time of all tracks.
  [[nodiscard]] double end_s() const;
};

/// Reads a surgeon file. Throws Error kBadInput with "file:line:column: fault; mend":
/// a wrong header, a missing or superfluous field, something that is no finite number, a
/// quaternion whose length is not 1 within 1e-3, a jaw outside 0 … 1, a time that does
/// not increase, no rows.
[[nodiscard]] Surgeon read_surgeon(const std::string& path);

/// The same from text; `name` stands in messages instead of the path.
[[nodiscard]] Surgeon parse_surgeon(std::string_view text, const std::string& name);

/// Returns the text of a surgeon file: rows of all tools by time, numbers in the fewest digits
/// that `parse_surgeon` turns into the same doubles (quaternions: to their last digit).
[[nodiscard]] std::string surgeon_text(const Surgeon& surgeon);

}  // namespace suture
