// SPDX-License-Identifier: GPL-3.0-or-later
// The axis of a needle, and the rigid motions along it.
//
//   straight   p(s) = c + s e₀                          the tail at the frame's origin
//   arc        p(s) = c + r (cos(s/r) e₀ + sin(s/r) e₁)  the arc's centre at the frame's origin
//
//   s   arc length from the tail (0) to the tip (length), m
//   c, e₀, e₁   origin and axes of the needle's frame in the world
//
// The slide S(σ) is the rigid motion that moves every point along the axis: S(σ) p(s) = p(s + σ).
#pragma once

#include <Eigen/Geometry>
#include <optional>
#include <span>

#include "geometry/tet_mesh.hpp"
#include "scene/scene.hpp"

namespace sutured::needle {

using geometry::Vec3;
using scene::Pose;
using Vec6 = Eigen::Matrix<double, 6, 1>;

/// A straight or circular needle axis in its own frame.
class Curve {
 public:
  /// A straight axis of `length_m`.
  [[nodiscard]] static Curve straight(double length_m);
  /// A circular axis of `radius_m` over `angle_rad` (less than 2π).
  [[nodiscard]] static Curve arc(double radius_m, double angle_rad);
  [[nodiscard]] static Curve of(const scene::Needle& needle);

  [[nodiscard]] double length_m() const { return length_m_; }
  [[nodiscard]] bool is_arc() const { return radius_m_ > 0.0; }
  [[nodiscard]] double radius_m() const { return radius_m_; }

  /// Returns p(s) in the world, for any s (the axis extends beyond its ends).
  [[nodiscard]] Vec3 point(const Pose& pose, double s) const;
  /// Returns the unit tangent at s towards the tip, in the world.
  [[nodiscard]] Vec3 tangent(const Pose& pose, double s) const;
  /// Returns S(σ) applied to `pose`.
  [[nodiscard]] Pose slid(const Pose& pose, double slide_m) const;
  /// Returns the twist of the unit slide (per metre along the axis) about the frame's origin.
  [[nodiscard]] Vec6 slide_twist(const Pose& pose) const;

  /// Returns the first s ≥ `from` at which the axis, shifted by `shift`, passes the plane
  /// normal · x = offset in the direction of `normal`; `from` itself where it is beyond the
  /// plane already and still moving out. None where it never does.
  [[nodiscard]] std::optional<double> leaves_half_space(const Pose& pose, const Vec3& shift,
                                                        const Vec3& normal, double offset_m,
                                                        double from) const;

  /// Returns all s in [from, to] (at most two) at which the axis meets the plane normal · x =
  /// offset.
  int meets_plane(const Pose& pose, const Vec3& normal, double offset_m, double from, double to,
                  std::array<double, 2>& s) const;

  /// Returns the point of the axis between its ends that is nearest to `p`, as s.
  [[nodiscard]] double nearest(const Pose& pose, const Vec3& p) const;

 private:
  double length_m_ = 0.0;
  double radius_m_ = 0.0;  ///< 0 for a straight axis
};

/// Returns the σ that brings S(σ) `from` closest to `to` over points of the axis:
///
///     min_σ Σ wᵢ ‖S(σ) pᵢ − T pᵢ‖²     (paper section 3.1, the sliding component of eq. 2)
///
///   s, weight   one per point; weights ≥ 0, not all zero
[[nodiscard]] double slide_least_squares(const Curve& curve, const Pose& from, const Pose& to,
                                         std::span<const double> s, std::span<const double> weight);

/// Returns `pose` moved by the twist (translation, rotation vector) about `pose.position_m`.
[[nodiscard]] Pose moved(const Pose& pose, const Vec6& twist);

/// Returns the rotation vector of `q`, of angle at most π.
[[nodiscard]] Vec3 rotation_vector(const Eigen::Quaterniond& q);

}  // namespace sutured::needle
