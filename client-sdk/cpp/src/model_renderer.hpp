// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include "protocol/force_shaping.hpp"
#include "protocol/haptic_model.hpp"
#include "protocol/snapshot.hpp"
#include "protocol/types.hpp"
#include "suture/types.hpp"

namespace suture {

/// A haptic model as it arrived, checked.
struct ReceivedModel {
  HapticModel model;
  v1::Mapping mapping{};
  ForceLimits limits;
  std::int64_t blend_ns = 0;
  std::int64_t ramp_ns = 0;
  bool engaged = false;
  bool stopped = false;
  std::int64_t arrived_ns = 0;  ///< monotonic; 0: none has come
};

/// Fills `received` from the wire; false, with `received` in an unspecified state, where
/// sizes do not fit together or the reference is no pose. Allocates nothing.
[[nodiscard]] bool receive_model(const v1::HapticModel& wire, std::int64_t arrived_ns,
                                 ReceivedModel& received) noexcept;

/// Renders a tool's force on the device's own machine, from the server's last model and
/// with no network in the loop.
///
///     hand ─▶ world ─▶ model ─▶ blend at a swap ─▶ device frame, scaled ─▶ × gain ─▶ limits
///
/// The gain rises from zero within 200 ms. It falls to zero within the model's ramp when
/// no newer model came in time, or the server holds forces back (a fault, a stop, a pause,
/// a clutch): these are the server's to decide in either mode.
///
/// Threads: `receive` on one, `render` on one. Allocates: nothing.
class ModelRenderer {
 public:
  /// Takes a model in; one that does not hold together is dropped.
  void receive(const v1::HapticModel& wire, std::int64_t now_ns) noexcept;

  /// Returns the force for `hand` now. `server` is the last word of the server on this
  /// tool: its state and faults pass through.
  [[nodiscard]] Force render(const Hand& hand, const Force& server, std::int64_t now_ns) noexcept;

 private:
  static constexpr std::int64_t kRiseNs = 200'000'000;

  [[nodiscard]] Wrench model_wrench(const Hand& hand, std::int64_t now_ns) noexcept;
  [[nodiscard]] double ceiling(bool allowed, std::int64_t now_ns) noexcept;

  Snapshot<ReceivedModel> models_;

  // The renderer's.
  ModelEvaluator evaluator_;
  SwapBlend blend_;
  RampedGain gain_{kRiseNs};
  bool allowed_ = false;
  double phase_at_fade_ = 0.0;
  std::int64_t fade_since_ns_ = 0;
  std::int64_t rendered_ns_ = 0;
  Wrench last_;
};

}  // namespace suture
