// SPDX-License-Identifier: GPL-3.0-or-later
// The service manager's end of sd_notify(3).
#pragma once

#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <string>
#include <system_error>

#include "support/temporary_folder.hpp"

namespace sutured::testing {

class NotifySocket {
 public:
  NotifySocket() {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    path_.copy(address.sun_path, sizeof address.sun_path - 1);
    if (fd_ < 0 || bind(fd_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
      throw std::system_error(errno, std::generic_category(), path_);
  }
  ~NotifySocket() { ::close(fd_); }
  NotifySocket(const NotifySocket&) = delete;
  NotifySocket& operator=(const NotifySocket&) = delete;

  /// What the service's environment needs.
  [[nodiscard]] std::string environment() const { return "NOTIFY_SOCKET=" + path_; }

  /// Returns the next message; empty where none came within `limit`.
  [[nodiscard]] std::string receive(std::chrono::milliseconds limit = std::chrono::seconds(20)) {
    pollfd ready{fd_, POLLIN, 0};
    if (poll(&ready, 1, static_cast<int>(limit.count())) <= 0) return {};
    std::string message(4096, '\0');
    const ssize_t size = recv(fd_, message.data(), message.size(), 0);
    message.resize(size > 0 ? static_cast<std::size_t>(size) : 0);
    return message;
  }
  /// Returns how many messages with `text` wait, and takes all.
  int take_all(const std::string& text) {
    int count = 0;
    for (std::string message; !(message = receive(std::chrono::milliseconds(0))).empty();)
      count += message.find(text) != std::string::npos;
    return count;
  }

 private:
  TemporaryFolder folder_;
  std::string path_ = folder_.path("notify");
  int fd_ = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);
};

}  // namespace sutured::testing
