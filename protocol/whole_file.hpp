// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <sys/types.h>

#include <cstddef>
#include <filesystem>
#include <span>

namespace suture {

/// A file that is there whole or not at all: written beside its place, and moved there at the end.
///
/// All but the destructor throw std::system_error: "PATH cannot be written: …".
class WholeFile {
 public:
  /// What the name of the file beside ends with; one that a crash left there is replaced.
  static constexpr const char* kSuffix = ".part";

  /// Makes the file beside `path`, so that what cannot be written is known before the work. `mode`
  /// is what others may do with it, less the umask.
  WholeFile(std::filesystem::path path, mode_t mode);
  /// Leaves what was at `path` as it was, unless `commit` has returned.
  ~WholeFile();
  WholeFile(const WholeFile&) = delete;
  WholeFile& operator=(const WholeFile&) = delete;

  void write(std::span<const std::byte> content);
  /// Puts the file at its path, in place of one that is there, once its content is on the disk.
  void commit();

 private:
  [[noreturn]] void give_up() const;  // for what errno says

  std::filesystem::path path_, beside_;
  int fd_ = -1;
};

/// Returns whether both name one regular file, or would, where it is not there yet: what writes the
/// one would destroy the other.
[[nodiscard]] bool same_file(const std::filesystem::path& a, const std::filesystem::path& b);

}  // namespace suture
