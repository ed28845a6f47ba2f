// SPDX-License-Identifier: Apache-2.0
#include "protocol/surgeon.hpp"

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <system_error>

namespace suture {
namespace {

constexpr std::string_view kHeader = "time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw";
constexpr std::size_t kFields = 10;
constexpr std::array<const char*, kFields> kNames{"time_s", "tool", "px_m", "py_m", "pz_m",
                                                  "qx",     "qy",   "qz",   "qw",   "jaw"};
constexpr double kUnitTolerance = 1e-3;
constexpr double kLargest = 1e6;  // seconds or metres; what is larger is a slip of the pen

/// Where in the file the parser is; makes its errors.
struct Place {
  const std::string& file;
  std::size_t line;

  [[noreturn]] void fail(std::size_t column, const std::string& fault,
                         const std::string& mend) const {
    throw Error(ErrorCode::kBadInput,
                file + ":" + std::to_string(line) + ":" + std::to_string(column) + ": " + fault,
                mend);
  }
};

std::string_view trimmed(std::string_view text) {
  while (!text.empty() && (text.front() == ' ' || text.front() == '\t')) text.remove_prefix(1);
  while (!text.empty() && (text.back() == ' ' || text.back() == '\t' || text.back() == '\r')) {
    text.remove_suffix(1);
  }
  return text;
}

struct Field {
  std::string_view text;
  std::size_t column;  // from 1
};

std::array<Field, kFields> split(std::string_view line, const Place& place) {
  std::array<Field, kFields> fields;
  std::size_t begin = 0;
  for (std::size_t i = 0; i < kFields; ++i) {
    if (begin > line.size()) {
      place.fail(line.size() + 1, std::string("the field ") + kNames[i] + " is missing",
                 "a row has 10 fields: " + std::string(kHeader));
    }
    const std::size_t end = std::min(line.find(',', begin), line.size());
    const std::string_view raw = line.substr(begin, end - begin);
    const std::string_view text = trimmed(raw);
    // Where the text stands, or the field where it is empty.
    const std::size_t offset =
        text.empty() ? 0 : static_cast<std::size_t>(text.data() - raw.data());
    fields[i] = {text, begin + offset + 1};
    begin = end + 1;
  }
  if (begin <= line.size()) {
    place.fail(begin + 1, "a field too many", "a row has 10 fields: " + std::string(kHeader));
  }
  return fields;
}

double number(const Field& field, std::size_t index, const Place& place) {
  double value = 0.0;
  const char* const end = field.text.data() + field.text.size();
  const auto [stop, fault] = std::from_chars(field.text.data(), end, value);
  if (fault != std::errc() || stop != end || !std::isfinite(value)) {
    place.fail(field.column, std::string(kNames[index]) + " is \"" + std::string(field.text) + "\"",
               "write a finite number, with a decimal point");
  }
  if (std::abs(value) > kLargest) {
    place.fail(field.column,
               std::string(kNames[index]) + " is " + std::string(field.text) + ", beyond all use",
               "write seconds and metres, up to 1e6");
  }
  return value;
}

SurgeonRow parse_row(const std::array<Field, kFields>& fields, const Place& place) {
  SurgeonRow row;
  row.time_s = number(fields[0], 0, place);
  if (row.time_s < 0.0)
    place.fail(fields[0].column, "time_s is negative", "let time begin at zero");
  for (std::size_t i = 0; i < 3; ++i) row.pose.position_m[i] = number(fields[2 + i], 2 + i, place);
  double squared = 0.0;
  for (std::size_t i = 0; i < 4; ++i) {
    row.pose.orientation_xyzw[i] = number(fields[5 + i], 5 + i, place);
    squared += row.pose.orientation_xyzw[i] * row.pose.orientation_xyzw[i];
  }
  const double length = std::sqrt(squared);
  if (!(std::abs(length - 1.0) <= kUnitTolerance)) {
    place.fail(fields[5].column, "the quaternion has length " + std::to_string(length),
               "write a unit quaternion qx,qy,qz,qw; no rotation is 0,0,0,1");
  }
  for (double& q : row.pose.orientation_xyzw) q /= length;
  row.pose.jaw = number(fields[9], 9, place);
  if (row.pose.jaw < 0.0 || row.pose.jaw > 1.0) {
    place.fail(fields[9].column, "the jaw is " + std::string(fields[9].text),
               "write a number from 0 (open) to 1 (closed)");
  }
  return row;
}

SurgeonPose between(const SurgeonRow& a, const SurgeonRow& b, double time_s) {
  const double f = (time_s - a.time_s) / (b.time_s - a.time_s);
  SurgeonPose pose;
  for (std::size_t i = 0; i < 3; ++i) {
    pose.position_m[i] = (1.0 - f) * a.pose.position_m[i] + f * b.pose.position_m[i];
  }
  pose.jaw = (1.0 - f) * a.pose.jaw + f * b.pose.jaw;

  const auto& p = a.pose.orientation_xyzw;
  const auto& q = b.pose.orientation_xyzw;
  double cosine = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3];
  const double sign = cosine < 0.0 ? -1.0 : 1.0;  // q and −q turn alike: the shorter way
  cosine = std::min(std::abs(cosine), 1.0);
  double weight_p = 1.0 - f;
  double weight_q = f;
  if (cosine < 1.0 - 1e-9) {  // nearer than that linear is exact in double precision
    const double angle = std::acos(cosine);
    weight_p = std::sin((1.0 - f) * angle) / std::sin(angle);
    weight_q = std::sin(f * angle) / std::sin(angle);
  }
  double squared = 0.0;
  for (std::size_t i = 0; i < 4; ++i) {
    pose.orientation_xyzw[i] = weight_p * p[i] + sign * weight_q * q[i];
    squared += pose.orientation_xyzw[i] * pose.orientation_xyzw[i];
  }
  for (double& component : pose.orientation_xyzw) component /= std::sqrt(squared);
  return pose;
}

}  // namespace

SurgeonPose SurgeonTrack::at(double time_s) const {
  const auto next =
      std::upper_bound(rows.begin(), rows.end(), time_s,
                       [](double t, const SurgeonRow& row) { return t < row.time_s; });
  if (next == rows.begin()) return rows.front().pose;
  if (next == rows.end()) return rows.back().pose;
  return between(*(next - 1), *next, time_s);
}

const SurgeonTrack* Surgeon::track(std::string_view tool) const noexcept {
  const auto found = std::find_if(tracks.begin(), tracks.end(),
                                  [&](const SurgeonTrack& t) { return t.tool == tool; });
  return found == tracks.end() ? nullptr : &*found;
}

double Surgeon::end_s() const {
  double end = tracks.front().end_s();
  for (const SurgeonTrack& track : tracks) end = std::max(end, track.end_s());
  return end;
}

Surgeon parse_surgeon(std::string_view text, const std::string& name) {
  Surgeon surgeon;
  bool header_seen = false;
  Place place{name, 0};
  constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF";
  if (text.starts_with(kByteOrderMark)) {
    place.line = 1;
    place.fail(1, "the file begins with a byte order mark",
               "save it as UTF-8 without one (a spreadsheet calls that plain CSV)");
  }
  while (!text.empty()) {
    ++place.line;
    const std::size_t length = std::min(text.find('\n'), text.size());
    const std::string_view line = text.substr(0, length);
    text.remove_prefix(std::min(length + 1, text.size()));
    const std::string_view content = trimmed(line);
    if (content.empty() || content.front() == '#') continue;
    if (!header_seen) {
      if (content != kHeader) {
        const auto differing =
            std::mismatch(content.begin(), content.end(), kHeader.begin(), kHeader.end());
        place.fail(static_cast<std::size_t>(differing.first - content.begin()) + 1,
                   "the header is not that of a surgeon file", "write: " + std::string(kHeader));
      }
      header_seen = true;
      continue;
    }
    const std::array<Field, kFields> fields = split(line, place);
    const Field& tool = fields[1];
    if (tool.text.empty() || tool.text.size() > 32) {
      place.fail(tool.column, "the tool's name is not usable", "write 1 to 32 characters");
    }
    const SurgeonRow row = parse_row(fields, place);
    auto track = std::find_if(surgeon.tracks.begin(), surgeon.tracks.end(),
                              [&](const SurgeonTrack& t) { return t.tool == tool.text; });
    if (track == surgeon.tracks.end()) {
      surgeon.tracks.push_back({std::string(tool.text), {}});
      track = surgeon.tracks.end() - 1;
    } else if (!(row.time_s > track->rows.back().time_s)) {
      place.fail(fields[0].column, "time_s does not increase for the tool \"" + track->tool + "\"",
                 "sort its rows by time and give each time once");
    }
    track->rows.push_back(row);
  }
  if (surgeon.tracks.empty()) {
    place.line = std::max<std::size_t>(place.line, 1);
    place.fail(1, header_seen ? "there are no rows" : "the file is empty",
               "begin with the header " + std::string(kHeader) + " and add a row a moment");
  }
  return surgeon;
}

std::string surgeon_text(const Surgeon& surgeon) {
  std::vector<std::pair<const SurgeonTrack*, const SurgeonRow*>> rows;
  for (const SurgeonTrack& track : surgeon.tracks)
    for (const SurgeonRow& row : track.rows) rows.emplace_back(&track, &row);
  std::stable_sort(rows.begin(), rows.end(), [](const auto& a, const auto& b) {
    return a.second->time_s < b.second->time_s;
  });
  std::string text(kHeader);
  const auto append = [&](double value) {
    if (text.back() != '\n') text += ',';
    std::array<char, 32> digits{};
    const auto end = std::to_chars(digits.data(), digits.data() + digits.size(), value).ptr;
    text.append(digits.data(), end);
  };
  for (const auto& [track, row] : rows) {
    text += '\n';
    append(row->time_s);
    text += ',' + track->tool;
    for (const double value : row->pose.position_m) append(value);
    for (const double value : row->pose.orientation_xyzw) append(value);
    append(row->pose.jaw);
  }
  return text + '\n';
}

Surgeon read_surgeon(const std::string& path) {
  std::error_code unknown;
  const auto kind = std::filesystem::status(path, unknown).type();
  if (kind != std::filesystem::file_type::regular &&
      kind != std::filesystem::file_type::not_found) {
    throw Error(ErrorCode::kBadInput, path + ": is not a regular file",
                "name a surgeon file (CSV)");
  }
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  if (file) text << file.rdbuf();
  if (!file) {
    throw Error(
        ErrorCode::kBadInput,
        path + ": cannot be read: " + std::error_code(errno, std::generic_category()).message(),
        "check the path and its permissions");
  }
  return parse_surgeon(text.view(), path);
}

}  // namespace suture
