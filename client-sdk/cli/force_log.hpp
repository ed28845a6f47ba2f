// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include "suture/types.hpp"

namespace suture::cli {

/// A force as the hand was given it.
struct ForceRecord {
  double time_s = 0.0;  ///< of that tick, on the surgeon's clock
  Hand hand;            ///< for which it was computed: a round trip before, or a tick
  Force force;
};

/// Force over time, kept at a bounded size: when it is full, neighbours are merged.
class ForceTrace {
 public:
  struct Column {
    double time_s = 0.0;  ///< of its first sample
    double min_n = 0.0;
    double max_n = 0.0;
  };

  void add(double time_s, double force_n);
  [[nodiscard]] const Column* begin() const { return columns_.data(); }
  [[nodiscard]] const Column* end() const { return columns_.data() + count_; }
  [[nodiscard]] std::size_t size() const { return count_; }

 private:
  void merge_neighbours();

  std::array<Column, 4096> columns_{};
  std::size_t count_ = 0;
  std::size_t per_column_ = 1;
  std::size_t in_last_ = 0;
};

/// Takes the forces of several tools from their ticks without ever holding one up, and writes them
/// to one CSV file and a trace a tool, on a thread of its own.
///
/// Between the two is a ring a tool of 16384 records (16 s at 1 kHz); what does not fit is
/// dropped and counted. `push` is for one thread a tool. Lines of one tool keep their order;
/// those of several are mixed within 20 ms.
class ForceLog {
 public:
  /// Opens `path`, none if empty, and leaves what is in it until `begin`: a file that was not there
  /// goes again without one. Throws Error kBadInput.
  ForceLog(const std::string& path, std::span<const std::string> tools);
  ~ForceLog();
  ForceLog(const ForceLog&) = delete;
  ForceLog& operator=(const ForceLog&) = delete;

  /// Begins the file anew; before the first record. Throws Error kBadInput.
  void begin();

  /// Hands over a record of the tool of that index. Neither waits nor allocates.
  void push(std::size_t tool, const ForceRecord& record) noexcept;

  /// Writes what is left and closes the file; throws Error where the disk refused.
  void finish();

  [[nodiscard]] std::uint64_t dropped() const noexcept;
  /// After `finish` only.
  [[nodiscard]] const ForceTrace& trace(std::size_t tool) const noexcept {
    return lanes_[tool]->trace;
  }

 private:
  static constexpr std::size_t kCapacity = 16384;
  struct Lane {
    std::string tool;
    std::array<ForceRecord, kCapacity> ring{};
    std::atomic<std::uint64_t> head{0};  // written
    std::atomic<std::uint64_t> tail{0};  // read
    std::atomic<std::uint64_t> dropped{0};
    ForceTrace trace;
  };

  void work();
  void drain();
  void drain(Lane& lane);
  void write(const Lane& lane, const ForceRecord& record);

  std::vector<std::unique_ptr<Lane>> lanes_;  // one a tool
  std::atomic<bool> finishing_{false};
  std::string path_;
  std::FILE* file_ = nullptr;
  bool made_ = false;  // the file is ours, and nothing is in it
  std::thread worker_;
};

/// Returns the length of `v`.
[[nodiscard]] double length_of(const Vector3& v) noexcept;

}  // namespace suture::cli
