// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <span>
#include <string>

namespace suture::cli {

/// A file that is there whole or not at all: written beside its place, and moved there at the end.
class WholeFile {
 public:
  /// Makes the file beside `path`, so that what cannot be written is known before the work.
  /// Throws suture::Error kBadInput.
  explicit WholeFile(std::string path);
  /// Leaves what was at `path` as it was, unless `commit` has returned.
  ~WholeFile();
  WholeFile(const WholeFile&) = delete;
  WholeFile& operator=(const WholeFile&) = delete;

  /// Writes `content` and puts the file at its path, in place of one that is there.
  /// Throws suture::Error kBadInput.
  void commit(std::span<const std::byte> content);

 private:
  [[noreturn]] void give_up(int fault) const;

  std::string path_;
  std::string beside_;
  int fd_ = -1;
};

}  // namespace suture::cli
