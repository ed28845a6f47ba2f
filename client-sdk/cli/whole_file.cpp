// SPDX-License-Identifier: Apache-2.0
#include "whole_file.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <system_error>
#include <utility>

#include "suture/error.hpp"

namespace suture::cli {

WholeFile::WholeFile(std::string path) : path_(std::move(path)) {
  std::error_code ignored;
  if (path_.empty() || std::filesystem::is_directory(path_, ignored)) give_up(EISDIR);
  beside_ = path_ + ".XXXXXX";
  fd_ = ::mkostemp(beside_.data(), O_CLOEXEC);
  if (fd_ < 0) give_up(errno);
}

WholeFile::~WholeFile() {
  if (fd_ >= 0) ::close(fd_);
  if (!beside_.empty()) ::unlink(beside_.c_str());
}

void WholeFile::commit(std::span<const std::byte> content) {
  while (!content.empty()) {
    const ssize_t written = ::write(fd_, content.data(), content.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) give_up(errno);
    content = content.subspan(static_cast<std::size_t>(written));
  }
  // mkostemp gives it to its owner only; a file of other programs is as the umask says.
  const mode_t mask = ::umask(0);
  ::umask(mask);
  if (::fchmod(fd_, 0666 & ~mask) != 0 || ::fsync(fd_) != 0) give_up(errno);
  if (::rename(beside_.c_str(), path_.c_str()) != 0) give_up(errno);
  beside_.clear();
}

void WholeFile::give_up(int fault) const {
  throw Error(ErrorCode::kBadInput,
              "\"" + path_ + "\" cannot be written: " + std::generic_category().message(fault),
              "name a file in a folder that is there and yours");
}

}  // namespace suture::cli
