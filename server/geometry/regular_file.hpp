// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>

namespace sutured::geometry {

/// Why a file could not be read: `what()` says it without the path.
class FileError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Returns the content of the regular file at `path`.
///
/// Throws FileError where it cannot be opened, is anything else (a folder, a pipe, a device) or
/// is longer than `bytes_max`. Never waits for a pipe's writer.
[[nodiscard]] std::string read_regular_file(const std::string& path, std::uint64_t bytes_max);

}  // namespace sutured::geometry
