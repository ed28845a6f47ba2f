// SPDX-License-Identifier: GPL-3.0-or-later
#include "geometry/regular_file.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <system_error>

namespace sutured::geometry {

namespace {

class FileDescriptor {
 public:
  explicit FileDescriptor(int fd) : fd_(fd) {}
  ~FileDescriptor() {
    if (fd_ >= 0) ::close(fd_);
  }
  FileDescriptor(const FileDescriptor&) = delete;
  FileDescriptor& operator=(const FileDescriptor&) = delete;
  [[nodiscard]] int get() const { return fd_; }

 private:
  int fd_;
};

[[noreturn]] void fail_system(const char* what) {
  throw FileError(what + std::generic_category().message(errno));
}

/// A regular file that is open for reading.
class RegularFile {
 public:
  explicit RegularFile(const std::string& path)
      // Not blocking: opening a pipe would wait for its writer.
      : file_(::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY)) {
    struct stat status {};
    if (file_.get() < 0 || ::fstat(file_.get(), &status) != 0) fail_system("cannot be opened: ");
    if (!S_ISREG(status.st_mode)) throw FileError("is not a regular file");
    size_ = static_cast<std::uint64_t>(status.st_size);
  }
  [[nodiscard]] std::uint64_t size() const { return size_; }
  /// Returns the first `count` bytes, or as many as there are.
  [[nodiscard]] std::string read(std::size_t count) const {
    std::string bytes(count, '\0');
    std::size_t filled = 0;
    while (filled < bytes.size()) {
      const ssize_t got = ::read(file_.get(), bytes.data() + filled, bytes.size() - filled);
      if (got < 0 && errno == EINTR) continue;
      if (got < 0) fail_system("cannot be read: ");
      if (got == 0) break;
      filled += static_cast<std::size_t>(got);
    }
    bytes.resize(filled);
    return bytes;
  }

 private:
  FileDescriptor file_;
  std::uint64_t size_ = 0;
};

}  // namespace

std::string read_regular_file(const std::string& path, std::uint64_t bytes_max) {
  const RegularFile file(path);
  if (file.size() > bytes_max)
    throw FileError("is longer than " + std::to_string(bytes_max) + " bytes");
  return file.read(static_cast<std::size_t>(file.size()));
}

FileHead read_regular_file_head(const std::string& path, std::size_t bytes_max) {
  const RegularFile file(path);
  return {file.read(static_cast<std::size_t>(std::min<std::uint64_t>(file.size(), bytes_max))),
          file.size()};
}

}  // namespace sutured::geometry
