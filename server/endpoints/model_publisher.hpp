// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <cstdint>
#include <string>
#include <thread>
#include <vector>

#include "endpoints/force_service.hpp"
#include "haptics/simulation_loop.hpp"

namespace sutured::endpoints {

/// Sends every step's models to devices that render themselves, on a thread of its own:
/// a reliable writer may wait for a slow reader, and neither steps nor forces may.
class ModelPublisher {
 public:
  /// Throws suture::Error. All arguments outlive it.
  ModelPublisher(const suture::Participant& participant, const std::vector<ServedTool>& tools,
                 const ForceService& forces);
  ~ModelPublisher();
  ModelPublisher(const ModelPublisher&) = delete;
  ModelPublisher& operator=(const ModelPublisher&) = delete;

  /// Begins to take models from `loop`, which must live until `stop`.
  void start(haptics::SimulationLoop& loop);
  void stop() noexcept;
  /// Says that a step's models are there. Any thread; never waits.
  void notify() noexcept {
    beat_.fetch_add(1, std::memory_order_release);
    beat_.notify_one();
  }
  /// Returns how many rows of the tool's last model were frozen.
  [[nodiscard]] std::uint32_t frozen_rows(std::size_t tool) const noexcept {
    return frozen_rows_[tool].load(std::memory_order_relaxed);
  }

 private:
  void run(haptics::SimulationLoop& loop) noexcept;

  const std::vector<ServedTool>& tools_;
  const ForceService& forces_;
  std::vector<std::string> names_;
  suture::Writer<suture::v1::HapticModel> writer_;
  std::vector<std::atomic<std::uint32_t>> frozen_rows_;
  std::atomic<std::uint32_t> beat_{0};
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

}  // namespace sutured::endpoints
