// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <cstdio>
#include <string>
#include <thread>

#include "suture/types.hpp"

namespace suture::cli {

/// A force with the hand that it answers.
struct ForceRecord {
  double time_s = 0.0;  ///< when the hand was sent, on the surgeon's clock
  Hand hand;
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

/// Takes forces from the receive thread without ever holding it up, and writes them to a
/// CSV file and a trace on a thread of its own.
///
/// Between the two is a ring of 16384 records (16 s at 1 kHz); what does not fit is
/// dropped and counted. `push` is for one thread.
class ForceLog {
 public:
  /// Opens `path`, none if empty. Throws Error kBadInput.
  explicit ForceLog(const std::string& path);
  ~ForceLog();
  ForceLog(const ForceLog&) = delete;
  ForceLog& operator=(const ForceLog&) = delete;

  /// Hands over a record. Neither waits nor allocates.
  void push(const ForceRecord& record) noexcept;

  /// Writes what is left and closes the file; throws Error where the disk refused.
  void finish();

  [[nodiscard]] std::uint64_t dropped() const noexcept { return dropped_; }
  /// After `finish` only.
  [[nodiscard]] const ForceTrace& trace() const noexcept { return trace_; }

 private:
  void work();
  void drain();
  void write(const ForceRecord& record);

  static constexpr std::size_t kCapacity = 16384;
  std::array<ForceRecord, kCapacity> ring_{};
  std::atomic<std::uint64_t> head_{0};  // written
  std::atomic<std::uint64_t> tail_{0};  // read
  std::atomic<std::uint64_t> dropped_{0};
  std::atomic<bool> finishing_{false};
  ForceTrace trace_;
  std::string path_;
  std::FILE* file_ = nullptr;
  std::thread worker_;
};

/// Returns the length of `v`.
[[nodiscard]] double length_of(const Vector3& v) noexcept;

}  // namespace suture::cli
