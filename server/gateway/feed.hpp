// SPDX-License-Identifier: GPL-3.0-or-later
// The session's topics as web clients get them: the bytes that travel over DDS, unchanged.
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <span>
#include <vector>

#include "gateway/foxglove.hpp"
#include "protocol/serialized.hpp"

namespace sutured::gateway {

/// How long a reader stays that nobody wants any more. Cyclone 0.10.2 keeps some 500 bytes of each
/// reader and writer that ever was (eclipse-cyclonedds issue 1487): who comes and goes shall not
/// make one each time.
inline constexpr std::chrono::seconds kReaderStays{60};

/// A sample of a topic on its way to those who subscribe to it.
struct Delivery {
  std::uint32_t channel;
  std::uint64_t instance;
  std::size_t depth;  ///< how many of them are worth waiting for a slow client
  std::int64_t received_ns;
  suture::SerializedSample sample;
};

/// Reads every topic that somebody wants, and what late joiners must get (topologies,
/// status, quality, events) from the start, so that it is there for whoever comes.
///
/// Any other topic has a reader here while somebody subscribes to it, and for `kReaderStays` more.
/// Threads: the gateway's; `wake` is called on Cyclone's.
class Feed {
 public:
  /// Throws suture::Error. `wake` shall have `drain` called soon on the gateway's thread.
  Feed(const suture::Participant& control, const suture::Participant& mesh,
       std::function<void()> wake);

  /// The native topics, `id` from 1, in the order of suture::all_topics().
  [[nodiscard]] std::span<const Channel> channels() const noexcept { return channels_; }

  /// Counts one subscriber more, or less, of a channel.
  void subscribe(std::uint32_t channel);
  void unsubscribe(std::uint32_t channel);
  /// Closes the readers that nobody has wanted for `kReaderStays`.
  void close_idle(std::chrono::steady_clock::time_point now);
  /// Says whether a channel has a reader.
  [[nodiscard]] bool reads(std::uint32_t channel) const {
    return sources_[channel - 1].reader != nullptr;
  }
  /// Calls `use` for what is kept of a channel, oldest first.
  void retained(std::uint32_t channel, const std::function<void(const Delivery&)>& use) const;
  /// Takes what has arrived and calls `use` for each.
  void drain(const std::function<void(const Delivery&)>& use);

 private:
  struct Source {
    const suture::TopicSpec* spec = nullptr;
    const suture::Participant* participant = nullptr;
    std::size_t depth = 1;
    int subscribers = 0;
    std::chrono::steady_clock::time_point left;          // by the last subscriber
    std::unique_ptr<suture::SerializedReader> reader;    // null: nobody has wanted it
    std::map<std::uint64_t, std::deque<Delivery>> kept;  // by instance
  };
  [[nodiscard]] Source& source(std::uint32_t channel) { return sources_[channel - 1]; }
  void open(Source& source);
  void keep(Source& source, const Delivery& delivery);

  std::function<void()> wake_;
  std::vector<Channel> channels_;
  std::atomic<bool> pending_{false};
  std::vector<Source> sources_;
};

}  // namespace sutured::gateway
