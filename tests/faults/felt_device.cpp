// SPDX-License-Identifier: GPL-3.0-or-later
#include "faults/felt_device.hpp"

#include <cmath>
#include <utility>

#include "haptics/realtime.hpp"
#include "haptics/supervisor.hpp"
#include "protocol/types.hpp"

namespace sutured::faults {

double Felt::magnitude_n() const { return std::hypot(force_n[0], force_n[1], force_n[2]); }

FeltDevice::FeltDevice(suture::DeviceOptions options, const suture::Hand& hand)
    : device_(std::move(options)), hand_(hand) {
  felt_.reserve(1 << 16);
  thread_ = std::thread([this] { run(); });
}

FeltDevice::~FeltDevice() {
  stop_ = true;
  thread_.join();
}

std::int64_t FeltDevice::spoil(Spoil how) {
  const std::lock_guard lock(mutex_);
  spoil_ = std::move(how);
  return last_good_ns_;
}

void FeltDevice::set_render(suture::Render render) {
  const std::lock_guard lock(mutex_);
  device_.set_render(render);
}

std::vector<Felt> FeltDevice::felt() {
  const std::lock_guard lock(mutex_);
  return felt_;
}

Felt FeltDevice::last() {
  const std::lock_guard lock(mutex_);
  return felt_.empty() ? Felt{} : felt_.back();
}

void FeltDevice::forget() {
  const std::lock_guard lock(mutex_);
  felt_.clear();
}

void FeltDevice::run() {
  haptics::enter_realtime(60);
  constexpr std::int64_t kPeriod_ns = 1'000'000;
  std::int64_t due_ns = suture::monotonic_ns() + kPeriod_ns;
  while (!stop_) {
    haptics::sleep_until(due_ns);
    {
      const std::lock_guard lock(mutex_);
      const std::int64_t asked_ns = suture::monotonic_ns();
      const suture::Force force = device_.read();
      felt_.push_back({suture::monotonic_ns(), force.force_n, force.state, force.faults, asked_ns,
                       force.hand_sequence, force.sequence});
      if (spoil_) {
        for (const suture::Hand& hand : spoil_(hand_)) device_.write(hand);
      } else {
        device_.write(hand_);
        last_good_ns_ = suture::monotonic_ns();
      }
    }
    due_ns = haptics::next_tick(due_ns, suture::monotonic_ns(), kPeriod_ns).at_ns;
  }
}

}  // namespace sutured::faults
