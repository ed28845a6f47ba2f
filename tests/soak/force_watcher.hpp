// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <mutex>
#include <string>
#include <utility>

#include "protocol/endpoint.hpp"

namespace sutured::soak {

/// More than a hand that touches nothing feels.
inline constexpr double kFelt_n = 0.02;

/// Hears every force of a tool, and keeps the worst of each kind.
class ForceWatcher {
 public:
  struct Worst {
    std::uint64_t forces = 0, answers = 0;
    std::uint64_t felt = 0;  ///< forces above `kFelt_n`
    double force_n = 0.0, step_n = 0.0;
    double over_slew = 0.0;  ///< largest step over what the slew limit allows for its time
    /// The steepest fall without a new pose, over the largest force, 1/s; and how often one took a
    /// force that was felt to zero.
    double fall_per_s = 0.0;
    int fades = 0;
    std::uint32_t model_age_us = 0;  ///< while the tool is neither idle nor stopped nor paused
    std::uint32_t faults = 0;
    bool rendering = false;  ///< the last force was the model's
  };

  /// `max_slew_n_per_s`: the tool's limit. `participant` must outlive it.
  ForceWatcher(const suture::Participant& participant, const std::string& tool,
               double max_slew_n_per_s)
      : tool_(suture::tool_id(tool)), max_slew_n_per_s_(max_slew_n_per_s) {
    suture::EndpointCallbacks callbacks;
    callbacks.data_available = [this] {
      if (ready_.load(std::memory_order_acquire)) take();
    };
    reader_ = suture::Reader<suture::v1::ToolForce>(participant, std::move(callbacks));
    ready_.store(true, std::memory_order_release);
  }
  Worst worst() {
    const std::lock_guard lock(mutex_);
    return worst_;
  }

 private:
  void take() {
    suture::v1::ToolForce force;
    suture::SampleInfo info;
    while (reader_.take(force, info)) {
      if (!info.valid || force.tool_id != tool_) continue;
      const std::lock_guard lock(mutex_);
      ++worst_.forces;
      worst_.answers += (force.flags & suture_v1_FORCE_FROM_SUPERVISOR) == 0;
      worst_.faults |= force.faults;
      worst_.rendering = force.state == suture_v1_TOOL_RENDERING;
      // Not finite: more than any limit.
      const double magnitude = norm(force.force_n);
      worst_.force_n = std::max(worst_.force_n, std::isfinite(magnitude) ? magnitude : HUGE_VAL);
      worst_.felt += magnitude > kFelt_n ? 1 : 0;
      if (is_served(force.state) && force.model_age_us != UINT32_MAX)
        worst_.model_age_us = std::max(worst_.model_age_us, force.model_age_us);
      if (last_.sequence_number != 0 && force.sequence_number > last_.sequence_number) {
        double step_n[3];
        for (int k = 0; k < 3; ++k) step_n[k] = force.force_n[k] - last_.force_n[k];
        // Half a millisecond for the clocks of a stamp, which are read one after the other.
        const double elapsed_s =
            1e-9 * static_cast<double>(force.stamp_ns - last_.stamp_ns + 500'000);
        worst_.step_n = std::max(worst_.step_n, norm(step_n));
        worst_.over_slew =
            std::max(worst_.over_slew, norm(step_n) / (max_slew_n_per_s_ * elapsed_s));
        if ((force.flags & suture_v1_FORCE_FROM_SUPERVISOR) != 0 && worst_.force_n > 0.0)
          worst_.fall_per_s = std::max(
              worst_.fall_per_s, (norm(last_.force_n) - magnitude) / (worst_.force_n * elapsed_s));
      }
      largest_n_ = std::max(largest_n_, magnitude);
      if (magnitude == 0.0) {
        worst_.fades += largest_n_ > kFelt_n ? 1 : 0;
        largest_n_ = 0.0;
      }
      last_ = force;
    }
  }

  /// A model that ages takes the tool out of TOOL_RENDERING: its age counts beyond that.
  static bool is_served(suture_v1_ToolState state) {
    return state != suture_v1_TOOL_IDLE && state != suture_v1_TOOL_STOPPED &&
           state != suture_v1_TOOL_PAUSED;
  }
  static double norm(const double (&v)[3]) { return std::hypot(v[0], v[1], v[2]); }

  std::uint64_t tool_;
  double max_slew_n_per_s_;
  std::atomic<bool> ready_{false};
  std::mutex mutex_;
  suture::v1::ToolForce last_{};
  double largest_n_ = 0.0;  // since the last that was zero
  Worst worst_;
  suture::Reader<suture::v1::ToolForce> reader_;
};

}  // namespace sutured::soak
