// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <map>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "mcap/writer.hpp"
#include "protocol/serialized.hpp"

namespace suture::cli {

/// A recording in the making: samples go in as the bytes that travelled, and a thread of its
/// own compresses and writes them, so that a slow disk holds up nobody who takes samples.
///
/// Between the two wait at most `waiting_bytes_max`; what does not fit is dropped and counted.
/// Chunks reach the file when they are full, and at the latest after 0.3 s.
/// Threads: `add`, `finish` and the counts one; `failed` any.
class Recording {
 public:
  struct Counts {
    std::uint64_t samples = 0;  ///< taken, also those that were dropped
    std::uint64_t missing = 0;  ///< gaps in the sequence numbers: lost before they came here
    std::uint64_t dropped = 0;  ///< too many waited for the disk
  };

  /// Makes the file. Throws Error kBadInput.
  Recording(const std::string& path, mcap::Writer::Existing existing,
            std::span<const TopicSpec* const> topics,
            std::size_t waiting_bytes_max = std::size_t{256} << 20U);
  /// Without `finish`: leaves the file as one that was cut off.
  ~Recording();
  Recording(const Recording&) = delete;
  Recording& operator=(const Recording&) = delete;

  /// Adds a sample of the topic of that index, received now.
  void add(std::size_t topic, SerializedSample sample, const SampleInfo& info);
  /// Adds a metadata record.
  void add(mcap::Metadata metadata);
  /// Returns whether the disk refused; `finish` says why.
  [[nodiscard]] bool failed() const noexcept { return failed_.load(std::memory_order_acquire); }
  /// Writes what waits, the counts as metadata, and the summary. Returns false where nothing was
  /// added and the file that was to be replaced is as it was. Throws Error kBadInput where the disk
  /// refused.
  [[nodiscard]] bool finish();

  [[nodiscard]] const Counts& counts(std::size_t topic) const { return lanes_[topic].counts; }
  [[nodiscard]] Counts total() const;
  /// Returns the time from the first sample to now; 0 before it.
  [[nodiscard]] double duration_s() const;
  /// Returns the length of the file so far.
  [[nodiscard]] std::uint64_t size_bytes() const noexcept {
    return size_bytes_.load(std::memory_order_relaxed);
  }

 private:
  struct Lane {
    const TopicSpec* topic;
    std::uint16_t channel;
    Counts counts;
    // Of each writer and key: the last epoch and sequence number.
    std::map<std::pair<std::uint64_t, std::uint64_t>, std::pair<std::uint64_t, std::uint64_t>> last;
  };
  struct Item {
    SerializedSample sample;
    mcap::Message message;                   // without its data
    std::optional<mcap::Metadata> metadata;  // instead of a sample
  };

  void work() noexcept;
  void write(const std::vector<Item>& items);
  [[nodiscard]] std::uint64_t now_ns() const noexcept;

  mcap::Writer writer_;  // of the thread, once it runs
  std::vector<Lane> lanes_;
  std::size_t waiting_bytes_max_;
  std::int64_t wall_ns_, monotonic_ns_;  // of the same moment: log times never go back
  std::uint64_t first_ns_ = 0;

  std::mutex mutex_;
  std::condition_variable wake_;
  std::vector<Item> waiting_;
  bool finishing_ = false;
  bool used_ = false;  // something was added
  std::atomic<std::size_t> waiting_bytes_{0};
  std::atomic<std::uint64_t> size_bytes_{0};
  std::atomic<bool> failed_{false};
  std::optional<Error> failure_;  // written before failed_ is set
  std::thread thread_;
};

}  // namespace suture::cli
