// SPDX-License-Identifier: GPL-3.0-or-later
// One thread of another process that hangs, while the others go on.
#pragma once

#include <sys/ptrace.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <system_error>

#include "support/temporary_folder.hpp"

namespace sutured::testing {

/// Halts the thread called `name` of a child until the object goes. Both by the same thread.
class HaltedThread {
 public:
  HaltedThread(pid_t process, const std::string& name) : thread_(find(process, name)) {
    int status = 0;
    if (ptrace(PTRACE_SEIZE, thread_, nullptr, nullptr) != 0 ||
        ptrace(PTRACE_INTERRUPT, thread_, nullptr, nullptr) != 0 ||
        waitpid(thread_, &status, __WALL) != thread_)
      throw std::system_error(errno, std::generic_category(), "ptrace of " + name);
  }
  ~HaltedThread() { ptrace(PTRACE_DETACH, thread_, nullptr, nullptr); }
  HaltedThread(const HaltedThread&) = delete;
  HaltedThread& operator=(const HaltedThread&) = delete;

 private:
  static pid_t find(pid_t process, const std::string& name) {
    for (const auto& task :
         std::filesystem::directory_iterator("/proc/" + std::to_string(process) + "/task"))
      if (read_file(task.path() / "comm") == name + '\n')
        return std::stoi(task.path().filename().string());
    throw std::runtime_error("no thread " + name);
  }

  pid_t thread_;
};

}  // namespace sutured::testing
