// SPDX-License-Identifier: GPL-3.0-or-later
// Runs another program and keeps what it said.
#pragma once

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <stdexcept>
#include <string>
#include <vector>

extern char** environ;

namespace sutured::testing {

/// A child process whose output and errors are collected together. It is killed and
/// reaped when the object goes. A name without a path is looked for in PATH.
class Process {
 public:
  explicit Process(const std::vector<std::string>& command) {
    int ends[2];
    if (pipe2(ends, O_CLOEXEC) != 0) throw std::runtime_error("no pipe");
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, ends[1], STDOUT_FILENO);
    posix_spawn_file_actions_adddup2(&actions, ends[1], STDERR_FILENO);
    std::vector<char*> arguments;
    for (const std::string& word : command) arguments.push_back(const_cast<char*>(word.c_str()));
    arguments.push_back(nullptr);
    const int fault =
        posix_spawnp(&pid_, arguments[0], &actions, nullptr, arguments.data(), environ);
    posix_spawn_file_actions_destroy(&actions);
    ::close(ends[1]);
    output_fd_ = ends[0];
    if (fault != 0) throw std::runtime_error("cannot start " + command[0]);
  }
  ~Process() {
    if (pid_ > 0) {
      kill(pid_, SIGKILL);
      waitpid(pid_, nullptr, 0);
    }
    ::close(output_fd_);
  }
  Process(const Process&) = delete;
  Process& operator=(const Process&) = delete;

  void send(int signal) const { kill(pid_, signal); }
  [[nodiscard]] pid_t pid() const { return pid_; }

  /// Reads until the process ends or, where given, until `text` has appeared.
  const std::string& read_until(const std::string& text = "") {
    char buffer[4096];
    while (text.empty() || output_.find(text) == std::string::npos) {
      const ssize_t got = ::read(output_fd_, buffer, sizeof buffer);
      if (got < 0 && errno == EINTR) continue;
      if (got <= 0) break;
      output_.append(buffer, static_cast<std::size_t>(got));
    }
    return output_;
  }

  /// Takes what has come and does not wait: a pipe that nobody empties holds up whoever writes.
  void drain() {
    char buffer[4096];
    pollfd ready{output_fd_, POLLIN, 0};
    while (poll(&ready, 1, 0) > 0) {
      const ssize_t got = ::read(output_fd_, buffer, sizeof buffer);
      if (got <= 0) break;
      output_.append(buffer, static_cast<std::size_t>(got));
    }
  }

  /// Waits for the end; returns the exit code, or 128 + the signal that ended it.
  int wait() {
    read_until();
    int status = 0;
    waitpid(pid_, &status, 0);
    pid_ = -1;
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  }
  [[nodiscard]] const std::string& output() const { return output_; }

 private:
  pid_t pid_ = -1;
  int output_fd_ = -1;
  std::string output_;
};

}  // namespace sutured::testing
