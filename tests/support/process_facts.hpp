// SPDX-License-Identifier: GPL-3.0-or-later
// What the kernel knows of a process.
#pragma once

#include <sys/types.h>
#include <unistd.h>

#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <set>
#include <sstream>
#include <string>
#include <system_error>

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

/// Returns how many threads a process has; -1 where there is no process.
inline int threads(pid_t pid) {
  std::error_code error;
  const std::filesystem::directory_iterator folder("/proc/" + std::to_string(pid) + "/task", error);
  return error ? -1 : static_cast<int>(std::distance(begin(folder), end(folder)));
}

/// Returns the UDP ports (IPv4) that a process listens at.
inline std::set<std::uint16_t> udp_ports(pid_t pid) {
  std::set<std::string> inodes;
  std::error_code fault;
  for (std::filesystem::directory_iterator entry("/proc/" + std::to_string(pid) + "/fd", fault),
       end;
       !fault && entry != end; entry.increment(fault)) {
    const std::string target = std::filesystem::read_symlink(entry->path(), fault).string();
    if (target.starts_with("socket:[")) inodes.insert(target.substr(8, target.size() - 9));
  }
  std::set<std::uint16_t> ports;
  std::ifstream table("/proc/net/udp");
  std::string line;
  std::getline(table, line);
  while (std::getline(table, line)) {
    // sl local remote st queues tr:when retransmits uid timeout inode …
    std::istringstream words(line);
    std::string slot, local, skipped, inode;
    words >> slot >> local;
    for (int i = 0; i < 7; ++i) words >> skipped;
    words >> inode;
    if (inodes.contains(inode) && local.size() > 5)
      ports.insert(static_cast<std::uint16_t>(std::stoul(local.substr(9), nullptr, 16)));
  }
  return ports;
}

}  // namespace sutured::testing
