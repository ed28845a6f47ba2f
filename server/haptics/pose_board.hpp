// SPDX-License-Identifier: GPL-3.0-or-later
// Where every tool is now, for the models of the others.
#pragma once

#include <cstddef>
#include <memory>
#include <vector>

#include "protocol/haptic_model.hpp"
#include "protocol/snapshot.hpp"

namespace sutured::haptics {

/// Hands the present pose of each tool to each other one: a snapshot for each pair, so that nobody
/// waits. A tool that says nothing more stays where it was.
///
/// Threads: `publish(tool)` and `pose(…, tool)` belong to whoever holds the token of `tool`.
/// Allocates: at construction.
class PoseBoard {
 public:
  explicit PoseBoard(std::size_t tools) : tools_(tools) {
    for (std::size_t i = 0; i < tools * tools; ++i)
      places_.push_back(std::make_unique<suture::Snapshot<Place>>());
  }

  [[nodiscard]] std::size_t tools() const noexcept { return tools_; }

  /// Makes `pose` (world) the present one of `tool`. Cost: one copy for each other tool.
  void publish(std::size_t tool, const suture::Pose& pose) noexcept {
    for (std::size_t reader = 0; reader < tools_; ++reader)
      if (reader != tool) places_[tool * tools_ + reader]->publish({pose, true});
  }
  /// Returns where `tool` is, as `reader` sees it; null where it has never been anywhere.
  [[nodiscard]] const suture::Pose* pose(std::size_t tool, std::size_t reader) noexcept {
    const Place& place = places_[tool * tools_ + reader]->latest();
    return place.known ? &place.pose : nullptr;
  }

 private:
  struct Place {
    suture::Pose pose;
    bool known = false;
  };
  std::size_t tools_;
  std::vector<std::unique_ptr<suture::Snapshot<Place>>> places_;
};

}  // namespace sutured::haptics
