// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>

#include "protocol/haptic_model.hpp"

namespace sutured::scene {
struct Workspace;
}

namespace sutured::haptics {

/// Maps a device's frame D to the world W, and wrenches back.
///
///     p_W = p_0 + μ R p_D          q_W = q_R q_D q_T
///     f_D = φ Rᵀ f_W               τ_D = (φ / μ) Rᵀ τ_W
///
///   R, q_R  the workspace's orientation      μ  motion_scale
///   p_0     where the device's origin lies   φ  force_scale
///   q_T     turn between the device's handle and the tool
///
/// p_0 is the workspace's position and q_T the identity until a clutch engages anew: then
/// they are chosen so that the tool stays where it is.
///
/// Why φ / μ for torques: hands turn unscaled but move scaled, so the work at the hand is
/// f_D · dp_D + τ_D · dθ = (φ / μ) (f_W · dp_W + τ_W · dθ). Any other factor makes the
/// stiffness at the hand asymmetric, and a closed loop of the hand would gain energy
/// (docs/adr/0021).
///
/// Thread: one at a time. Allocates: nothing.
class Workspace {
 public:
  /// The device's frame is the world's, nothing is scaled.
  Workspace() = default;
  explicit Workspace(const scene::Workspace& scene);

  [[nodiscard]] suture::Pose to_world(const suture::Pose& device) const noexcept;
  [[nodiscard]] suture::Wrench to_device(const suture::Wrench& world) const noexcept;
  /// Renews p_0 and q_T so that `to_world(device)` is `tool`.
  void engage(const suture::Pose& device, const suture::Pose& tool) noexcept;
  /// Goes back to the scene's p_0 and q_T.
  void reset() noexcept;

  [[nodiscard]] const std::array<double, 3>& position_m() const noexcept { return position_m_; }
  [[nodiscard]] const std::array<double, 4>& orientation_xyzw() const noexcept {
    return orientation_xyzw_;
  }
  [[nodiscard]] const std::array<double, 4>& tool_orientation_xyzw() const noexcept {
    return tool_orientation_xyzw_;
  }
  [[nodiscard]] double motion_scale() const noexcept { return motion_scale_; }
  [[nodiscard]] double force_scale() const noexcept { return force_scale_; }

 private:
  std::array<double, 3> home_m_{}, position_m_{};
  std::array<double, 4> orientation_xyzw_{0.0, 0.0, 0.0, 1.0};
  std::array<double, 4> tool_orientation_xyzw_{0.0, 0.0, 0.0, 1.0};
  double motion_scale_ = 1.0, force_scale_ = 1.0;
};

}  // namespace sutured::haptics
