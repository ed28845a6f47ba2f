// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <sys/types.h>

#include <cstdint>

#include "protocol/latency_histogram.hpp"

namespace suture::cli {

/// Another process of this machine that sends back what it gets, over UDP and over DDS.
///
/// Two processes, because Cyclone hands samples over within one without touching the
/// network. Made by fork: before this process has threads.
class EchoPeer {
 public:
  /// Throws Error kNetwork.
  explicit EchoPeer(std::uint32_t domain);
  ~EchoPeer();
  EchoPeer(const EchoPeer&) = delete;
  EchoPeer& operator=(const EchoPeer&) = delete;

  struct RoundTrips {
    LatencyHistogram udp;
    LatencyHistogram dds;
    std::uint64_t dds_lost = 0;
    bool met = false;  ///< false: the two processes did not find each other over DDS
  };
  /// Sends one packet each way in turn, a pair a millisecond, for `seconds`.
  void measure(double seconds, RoundTrips& result);

 private:
  std::uint32_t domain_;
  pid_t owner_ = 0;  // names the session
  pid_t child_ = -1;
  int lifeline_ = -1;  // closed: the child ends
  std::uint16_t port_ = 0;
};

}  // namespace suture::cli
