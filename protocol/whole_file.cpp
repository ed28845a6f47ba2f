// SPDX-License-Identifier: Apache-2.0
#include "protocol/whole_file.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <string>
#include <system_error>
#include <utility>

namespace suture {

WholeFile::WholeFile(std::filesystem::path path, mode_t mode) : path_(std::move(path)) {
  std::error_code ignored;
  if (path_.empty() || std::filesystem::is_directory(path_, ignored)) {
    errno = EISDIR;
    give_up();
  }
  beside_ = path_.string() + kSuffix;
  ::unlink(beside_.c_str());
  // Nobody else's file, and no link to one.
  fd_ = ::open(beside_.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, mode);
  if (fd_ < 0) give_up();
}

WholeFile::~WholeFile() {
  if (fd_ < 0) return;
  ::close(fd_);
  if (!beside_.empty()) ::unlink(beside_.c_str());
}

void WholeFile::write(std::span<const std::byte> content) {
  while (!content.empty()) {
    const ssize_t written = ::write(fd_, content.data(), content.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) give_up();
    content = content.subspan(static_cast<std::size_t>(written));
  }
}

void WholeFile::commit() {
  if (::fsync(fd_) != 0 || ::rename(beside_.c_str(), path_.c_str()) != 0) give_up();
  beside_.clear();
  // The name, too, must survive the machine's power.
  const std::filesystem::path folder = path_.has_parent_path() ? path_.parent_path() : ".";
  const int fd = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) return;
  ::fsync(fd);
  ::close(fd);
}

void WholeFile::give_up() const {
  throw std::system_error(errno, std::generic_category(), path_.string() + " cannot be written");
}

bool same_file(const std::filesystem::path& a, const std::filesystem::path& b) {
  namespace fs = std::filesystem;
  std::error_code failed;
  if (a.empty() || b.empty()) return false;
  if (fs::exists(a, failed) && fs::exists(b, failed))
    return fs::is_regular_file(a, failed) && fs::equivalent(a, b, failed);
  const fs::path where_a = fs::weakly_canonical(a, failed);
  if (failed) return false;
  const fs::path where_b = fs::weakly_canonical(b, failed);
  return !failed && where_a == where_b;
}

}  // namespace suture
