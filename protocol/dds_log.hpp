// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <mutex>
#include <string>

namespace suture {

/// Hears what Cyclone DDS has to say, instead of standard error: one at a time in a process.
///
/// Cyclone speaks on the thread that found something, such as one that receives poses, and of every
/// malformed packet: whoever sends those must neither fill a disk nor hold up that thread.
class DdsLog {
 public:
  using Clock = std::chrono::steady_clock;
  static constexpr int kLines = 50;
  static constexpr std::chrono::seconds kPeriod{10};

  /// `tell` is given a line (`error`: more than a warning), at most `kLines` in each `kPeriod`, and
  /// in the next one how many more there were. What OpenSSL says of another site's certificate has
  /// the cause in plain words behind it. Called on Cyclone's threads, one at a time.
  explicit DdsLog(std::function<void(bool error, const std::string& line)> tell);
  /// No call of `tell` is under way afterwards.
  ~DdsLog();
  DdsLog(const DdsLog&) = delete;
  DdsLog& operator=(const DdsLog&) = delete;

  /// Takes a line as one that came at `now`. A line that finds another being told is counted.
  void hear(bool error, const std::string& line, Clock::time_point now) noexcept;

 private:
  std::function<void(bool, const std::string&)> tell_;
  std::mutex mutex_;
  Clock::time_point begun_{};
  int told_ = 0;
  std::atomic<std::uint64_t> untold_ = 0;
};

}  // namespace suture
