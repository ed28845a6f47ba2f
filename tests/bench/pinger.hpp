// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include "protocol/endpoint.hpp"
#include "protocol/surgeon.hpp"

namespace sutured::bench {

/// Sends poses to one peer and times the first answer to each.
class Pinger {
 public:
  Pinger(const suture::ParticipantOptions& session, const std::string& tool)
      : participant_(session, suture::Channel::kControl), writer_(participant_) {
    pose_.tool_id = suture::tool_id(tool);
    suture::EndpointCallbacks callbacks;
    callbacks.data_available = [this] {
      if (ready_.load(std::memory_order_acquire)) take();
    };
    reader_ = suture::Reader<suture::v1::ToolForce>(participant_, std::move(callbacks));
    ready_.store(true, std::memory_order_release);
  }

  void send(const suture::SurgeonPose& at) {
    for (std::size_t i = 0; i < 3; ++i) pose_.position_m[i] = at.position_m[i];
    for (std::size_t i = 0; i < 4; ++i) pose_.orientation_xyzw[i] = at.orientation_xyzw[i];
    pose_.jaw = static_cast<float>(at.jaw);
    pose_.flags = suture_v1_POSE_IN_WORLD;
    const std::uint64_t sequence = ++pose_.sequence_number;
    pose_.stamp_ns = suture::wall_clock_ns();
    (*sent_ns_)[sequence % kPosesMax].store(suture::monotonic_ns(), std::memory_order_relaxed);
    writer_.write(pose_);
  }

  /// Returns the number of the last pose that was answered; poses count from 1.
  [[nodiscard]] std::uint64_t answered() const { return answered_.load(); }
  /// Returns how many poses were sent.
  [[nodiscard]] std::uint64_t sent() const { return pose_.sequence_number; }
  /// Returns the round trips of those of the poses `first` … `last` that were answered, µs.
  [[nodiscard]] std::vector<double> round_trips_us(std::uint64_t first, std::uint64_t last) const {
    std::vector<double> answered_us;
    for (std::uint64_t i = first; i <= std::min<std::uint64_t>(last, kPosesMax - 1); ++i)
      if (const double us = (*round_trip_us_)[i].load(); us > 0.0) answered_us.push_back(us);
    return answered_us;
  }

 private:
  static constexpr std::size_t kPosesMax = 100'000;
  using Times = std::array<std::atomic<std::int64_t>, kPosesMax>;

  void take() {
    suture::v1::ToolForce force;
    suture::SampleInfo info;
    while (reader_.take(force, info)) {
      const std::int64_t now = suture::monotonic_ns();
      if (!info.valid || force.tool_id != pose_.tool_id ||
          force.pose_sequence <= answered_.load(std::memory_order_relaxed))
        continue;
      answered_.store(force.pose_sequence);
      if (force.pose_sequence >= kPosesMax) continue;
      const std::int64_t sent = (*sent_ns_)[force.pose_sequence].load();
      (*round_trip_us_)[force.pose_sequence].store(1e-3 * static_cast<double>(now - sent));
    }
  }

  suture::Participant participant_;
  suture::Writer<suture::v1::ToolPose> writer_;
  suture::v1::ToolPose pose_{};
  std::unique_ptr<Times> sent_ns_ = std::make_unique<Times>();
  std::atomic<std::uint64_t> answered_{0};
  std::atomic<bool> ready_{false};
  std::unique_ptr<std::array<std::atomic<double>, kPosesMax>> round_trip_us_ =
      std::make_unique<std::array<std::atomic<double>, kPosesMax>>();
  suture::Reader<suture::v1::ToolForce> reader_;  // last: no callback outlives what it uses
};

}  // namespace sutured::bench
