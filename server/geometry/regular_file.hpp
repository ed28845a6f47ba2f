// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
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

/// How a file begins, and how long it is.
struct FileHead {
  std::string bytes;
  std::uint64_t size = 0;
};

/// Returns the first bytes of the regular file at `path`, `bytes_max` at most: to see what it is
/// before all of it is read. Throws FileError likewise, however long it is.
[[nodiscard]] FileHead read_regular_file_head(const std::string& path, std::size_t bytes_max);

}  // namespace sutured::geometry
