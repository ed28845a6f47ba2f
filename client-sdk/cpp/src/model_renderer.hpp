// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <optional>

#include "other_tools.hpp"
#include "protocol/energy_observer.hpp"
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
  std::int64_t stale_after_ns = 0, zero_after_ns = 0;  ///< of age
  bool engaged = false;
  bool stopped = false;
  std::int64_t arrived_ns = 0;                          ///< monotonic; 0: none has come
  std::array<std::uint64_t, kModelOthersMax> others{};  ///< `tool_id` of each of `model.others`
};

/// Where `hand` is in the world under `mapping`.
[[nodiscard]] Pose to_world(const v1::Mapping& mapping, const Hand& hand) noexcept;

/// Fills `received` from the wire; false, with `received` in an unspecified state, where
/// sizes do not fit together, the reference is no pose or a number is not finite. The model is
/// coupled to, and damps no more than, what `device` renders stably
/// (protocol/virtual_coupling.hpp), and the limits are the smaller ones of tool and device. A hand
/// that is `in_world` is not scaled, nor is what it feels. Allocates nothing.
[[nodiscard]] bool receive_model(const v1::HapticModel& wire, std::int64_t arrived_ns,
                                 const DeviceLimits& device, ReceivedModel& received,
                                 bool in_world = false) noexcept;

/// Renders a tool's force on the device's own machine, from the server's last model and
/// with no network in the loop.
///
///     hand ─▶ world ─▶ model ─▶ blend at a swap ─▶ device frame, scaled ─▶ × gain ─▶ limits
///
/// The gain rises from zero within 200 ms. It falls to zero when no newer model came in time,
/// or when the server holds forces back (a fault, a stop, a pause, a clutch), or for a fault
/// seen here: a hand that is no pose, jumps or stays away, the device's stop, energy that
/// nobody put in. A fault is not left to the server's word, which may be a network away or
/// gone. While the gain falls the hand's pose is frozen; after a fault it takes 20 ms of good
/// hands to rise. Where the world was reset or replaced (another epoch), what was felt goes to
/// zero as it was; only then does the new world's force begin.
///
/// Threads: `receive` on one, `render` and the rest on one. Allocates: nothing.
class ModelRenderer {
 public:
  /// `hand_stale_ns`: age of a hand from which on the force fades, as the tool's poses do.
  ModelRenderer(const DeviceLimits& device, double max_speed_m_per_s,
                std::int64_t hand_stale_ns = 15'000'000) noexcept
      : device_(device), max_speed_m_per_s_(max_speed_m_per_s), hand_stale_ns_(hand_stale_ns) {}

  /// Takes a model in; one that does not hold together is dropped.
  void receive(const v1::HapticModel& wire, std::int64_t now_ns) noexcept;
  /// The other tools, which are felt through the tissue: to be told what arrives of them.
  [[nodiscard]] OtherTools& others() noexcept { return others_; }

  /// Returns the force now for `hand`, which was measured at `taken_ns`. `server` is the last
  /// word of the server on this tool: its state and faults pass through. `stop`: hold the force
  /// at zero.
  [[nodiscard]] Force render(const Hand& hand, std::int64_t taken_ns, const Force& server,
                             bool stop, std::int64_t now_ns) noexcept;

  /// Returns the FAULT bits that this renderer saw itself, as of the last call of `render`.
  [[nodiscard]] std::uint32_t faults() const noexcept { return latched_ | ongoing_; }
  /// Says whether the force is the model's in full.
  [[nodiscard]] bool whole() const noexcept { return allowed_ && gain_.phase() >= 1.0; }
  /// The model in force; `arrived_ns` 0: none has come.
  [[nodiscard]] const ReceivedModel& current() const noexcept { return models_.front(); }
  /// Returns the energy given to the hand since the engagement began (J).
  [[nodiscard]] const EnergyObserver& energy() const noexcept { return energy_; }

 private:
  static constexpr std::int64_t kRiseNs = 200'000'000;
  static constexpr std::int64_t kSettleNs = 20'000'000;
  // Of a hand of which nothing is heard: as the server does with a pose.
  static constexpr std::int64_t kHandFadeNs = 30'000'000;

  void heed(const Hand& hand, std::int64_t taken_ns) noexcept;
  [[nodiscard]] Wrench model_wrench(std::int64_t now_ns) noexcept;
  [[nodiscard]] Wrench wanted(const Wrench& world, double gain, bool& limited) const noexcept;
  [[nodiscard]] double ceiling(bool allowed, std::int64_t now_ns) noexcept;

  DeviceLimits device_;
  double max_speed_m_per_s_;
  std::int64_t hand_stale_ns_;
  Snapshot<ReceivedModel> models_;
  std::atomic<bool> in_world_{false};        // the hand, for the thread that receives
  std::atomic<std::int64_t> refused_ns_{0};  // the last model that was not sound, by that thread
  OtherTools others_;

  // The renderer's.
  ModelEvaluator evaluator_;
  SwapBlend blend_;
  RampedGain gain_{kRiseNs};
  EnergyObserver energy_;
  LastingCondition hand_stale_{kRiseNs}, model_stale_{kRiseNs};
  Hand hand_;      // rendered: the last good one, frozen while the gain falls
  Hand previous_;  // the last good one
  bool has_previous_ = false;
  std::int64_t good_ns_ = 0, good_since_ns_ = 0;
  std::uint32_t latched_ = 0, ongoing_ = 0;
  std::uint64_t last_fallbacks_ = 0;
  struct FeltWorld {
    Wrench shown;       // at the hand
    double gain = 1.0;  // of it
  };
  std::optional<FeltWorld> old_world_;  // what fades, of a world that is gone
  bool allowed_ = false;
  double phase_at_fade_ = 0.0;
  std::int64_t fade_since_ns_ = 0;
  std::int64_t rendered_ns_ = 0;
  Wrench last_;
};

}  // namespace suture
