// SPDX-License-Identifier: GPL-3.0-or-later
// A device without the SDK's care: it sends whatever a test wants, at 1 kHz or slower.
#pragma once

#include <atomic>
#include <functional>
#include <mutex>
#include <string>
#include <thread>

#include "haptics/realtime.hpp"
#include "haptics/supervisor.hpp"
#include "protocol/endpoint.hpp"

namespace sutured::testing {

class RawDevice {
 public:
  RawDevice(const suture::ParticipantOptions& session, const std::string& tool,
            std::int64_t period_ns = 1'000'000)
      : participant_(session, suture::Channel::kControl),
        writer_(participant_),
        period_ns_(period_ns) {
    pose_.tool_id = suture::tool_id(tool);
    pose_.orientation_xyzw[3] = 1.0;
    thread_ = std::thread([this] { run(); });
  }
  ~RawDevice() {
    stop_ = true;
    thread_.join();
  }

  void move_to(double x, double y, double z) {
    const std::lock_guard lock(mutex_);
    pose_.position_m[0] = x, pose_.position_m[1] = y, pose_.position_m[2] = z;
  }
  /// Spoils each pose from now on; null ends that. Returns the number of the first pose
  /// concerned.
  std::uint64_t spoil(std::function<void(suture::v1::ToolPose&)> how) {
    const std::lock_guard lock(mutex_);
    spoil_ = std::move(how);
    return pose_.sequence_number + 1;
  }
  void pause(bool paused) { paused_ = paused; }
  [[nodiscard]] std::uint64_t sent() {
    const std::lock_guard lock(mutex_);
    return pose_.sequence_number;
  }
  [[nodiscard]] const suture::Guid& guid() const { return writer_.guid(); }

 private:
  void run() {
    haptics::enter_realtime(60);
    std::int64_t due_ns = suture::monotonic_ns() + period_ns_;
    while (!stop_) {
      haptics::sleep_until(due_ns);
      if (!paused_) {
        const std::lock_guard lock(mutex_);
        ++pose_.sequence_number;
        pose_.stamp_ns = suture::wall_clock_ns();
        suture::v1::ToolPose sent = pose_;
        if (spoil_) spoil_(sent);
        writer_.write(sent);
      }
      due_ns = haptics::next_tick(due_ns, suture::monotonic_ns(), period_ns_).at_ns;
    }
  }

  suture::Participant participant_;
  suture::Writer<suture::v1::ToolPose> writer_;
  std::int64_t period_ns_;
  std::mutex mutex_;
  suture::v1::ToolPose pose_{};
  std::function<void(suture::v1::ToolPose&)> spoil_;
  std::atomic<bool> stop_{false}, paused_{false};
  std::thread thread_;
};

}  // namespace sutured::testing
