// SPDX-License-Identifier: GPL-3.0-or-later
// Two hosts and what is between them, for tests; two_hosts_main.cpp has how it is made.
#pragma once

#include <signal.h>

#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "support/process.hpp"

namespace sutured::testing {

/// Two hosts that live as long as the object. Programs that run on them should end before.
class TwoHosts {
 public:
  /// Starts them with the options of the program `two_hosts`. Waits until they are there, or
  /// until it is plain that this machine does not permit it: see `missing`.
  explicit TwoHosts(std::vector<std::string> options) : process_(with_program(std::move(options))) {
    std::istringstream lines(process_.read_until("ready\n"));
    std::string line;
    while (std::getline(lines, line)) {
      if (line.starts_with("a: ")) a_ = words(line.substr(3));
      if (line.starts_with("b: ")) b_ = words(line.substr(3));
    }
    if (!b_.empty()) return;
    constexpr int kSkip = 77;
    if (process_.wait() != kSkip)
      throw std::runtime_error("two_hosts failed: " + process_.output());
  }

  /// Why there are no two hosts on this machine; empty where there are.
  [[nodiscard]] std::string missing() const { return b_.empty() ? process_.output() : ""; }
  /// Returns `command` as it is to be started to run on a host.
  [[nodiscard]] std::vector<std::string> on_a(const std::vector<std::string>& command) const {
    return joined(a_, command);
  }
  [[nodiscard]] std::vector<std::string> on_b(const std::vector<std::string>& command) const {
    return joined(b_, command);
  }

  /// Cuts the way between them, or joins it again; what is sent meanwhile waits in the hosts'
  /// queues as far as these go. With a relay only.
  void cut(bool cut) const { process_.send(cut ? SIGSTOP : SIGCONT); }

  /// Ends them, and returns what the relay says of the packets.
  std::string end() {
    process_.send(SIGTERM);
    process_.wait();
    return process_.output();
  }

 private:
  static std::vector<std::string> with_program(std::vector<std::string> options) {
    options.insert(options.begin(), TWO_HOSTS_PROGRAM);
    return options;
  }
  static std::vector<std::string> words(const std::string& text) {
    std::istringstream stream(text);
    std::vector<std::string> words;
    for (std::string word; stream >> word;) words.push_back(word);
    return words;
  }
  static std::vector<std::string> joined(std::vector<std::string> prefix,
                                         const std::vector<std::string>& command) {
    prefix.insert(prefix.end(), command.begin(), command.end());
    return prefix;
  }

  Process process_;
  std::vector<std::string> a_, b_;
};

}  // namespace sutured::testing
