// SPDX-License-Identifier: GPL-3.0-or-later
// What the kernel knows of a process.
#pragma once

#include <sys/types.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

namespace sutured::testing {

/// Returns the memory that a process has in RAM; infinity where there is none.
inline double resident_kib(pid_t pid) {
  std::ifstream file("/proc/" + std::to_string(pid) + "/statm");
  double total = 0.0, resident = 0.0;
  file >> total >> resident;
  return file ? resident * static_cast<double>(sysconf(_SC_PAGESIZE)) / 1024.0 : HUGE_VAL;
}

/// Returns how many files and sockets a process has open; -1 where there is no process.
inline int open_files(pid_t pid) {
  std::error_code error;
  const std::filesystem::directory_iterator folder("/proc/" + std::to_string(pid) + "/fd", error);
  return error ? -1 : static_cast<int>(std::distance(begin(folder), end(folder)));
}

}  // namespace sutured::testing
