// SPDX-License-Identifier: GPL-3.0-or-later
#include "needle/curve.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace sutured::needle {
namespace {

using std::numbers::pi;

// A crossing this little ahead is at the start: its root may be found a turn too late.
constexpr double kRounding_m = 1e-15;

/// The smallest angle ≥ `from` that equals `angle` modulo a turn.
double next_angle(double angle, double from) {
  return angle + 2.0 * pi * std::ceil((from - angle) / (2.0 * pi));
}

}  // namespace

Curve Curve::straight(double length_m) {
  Curve curve;
  curve.length_m_ = length_m;
  return curve;
}

Curve Curve::arc(double radius_m, double angle_rad) {
  Curve curve;
  curve.radius_m_ = radius_m;
  curve.length_m_ = radius_m * angle_rad;
  return curve;
}

Curve Curve::of(const scene::Needle& needle) {
  return needle.shape == scene::NeedleShape::kArc
             ? arc(needle.radius_m, needle.arc_deg * pi / 180.0)
             : straight(needle.length_m);
}

Vec3 Curve::point(const Pose& pose, double s) const {
  if (!is_arc()) return pose.position_m + pose.orientation * Vec3(s, 0, 0);
  const double angle = s / radius_m_;
  return pose.position_m +
         pose.orientation * Vec3(radius_m_ * std::cos(angle), radius_m_ * std::sin(angle), 0);
}

Vec3 Curve::tangent(const Pose& pose, double s) const {
  if (!is_arc()) return pose.orientation * Vec3::UnitX();
  const double angle = s / radius_m_;
  return pose.orientation * Vec3(-std::sin(angle), std::cos(angle), 0);
}

Pose Curve::slid(const Pose& pose, double slide_m) const {
  Pose result = pose;
  if (is_arc()) {
    result.orientation = (pose.orientation *
                          Eigen::Quaterniond(Eigen::AngleAxisd(slide_m / radius_m_, Vec3::UnitZ())))
                             .normalized();
  } else {
    result.position_m += pose.orientation * Vec3(slide_m, 0, 0);
  }
  return result;
}

Vec6 Curve::slide_twist(const Pose& pose) const {
  Vec6 twist = Vec6::Zero();
  if (is_arc())
    twist.tail<3>() = pose.orientation * Vec3(0, 0, 1.0 / radius_m_);
  else
    twist.head<3>() = pose.orientation * Vec3::UnitX();
  return twist;
}

std::optional<double> Curve::leaves_half_space(const Pose& pose, const Vec3& shift,
                                               const Vec3& normal, double offset_m,
                                               double from) const {
  const Vec3 n = pose.orientation.conjugate() * normal;
  const double constant = normal.dot(pose.position_m + shift) - offset_m;
  if (!is_arc()) {
    if (n[0] <= 0.0) return std::nullopt;
    return std::max(from, -constant / n[0]);
  }
  // distance(θ) = h cos(θ − φ) + constant, outward where its derivative is positive
  const double a = radius_m_ * n[0], b = radius_m_ * n[1];
  const double h = std::hypot(a, b), start = from / radius_m_;
  const double distance = a * std::cos(start) + b * std::sin(start) + constant;
  const double slope = -a * std::sin(start) + b * std::cos(start);
  if (distance >= -kRounding_m && slope > 0.0) return from;
  if (std::abs(constant) >= h) return std::nullopt;
  const double root = next_angle(std::atan2(b, a) - std::acos(-constant / h), start);
  return root * radius_m_;
}

int Curve::meets_plane(const Pose& pose, const Vec3& normal, double offset_m, double from,
                       double to, std::array<double, 2>& s) const {
  const Vec3 n = pose.orientation.conjugate() * normal;
  const double constant = normal.dot(pose.position_m) - offset_m;
  int count = 0;
  const auto keep = [&](double at) {
    if (at >= from && at <= to) s[static_cast<std::size_t>(count++)] = at;
  };
  if (!is_arc()) {
    if (n[0] != 0.0) keep(-constant / n[0]);
    return count;
  }
  const double a = radius_m_ * n[0], b = radius_m_ * n[1], h = std::hypot(a, b);
  if (std::abs(constant) > h || h == 0.0) return 0;
  const double phi = std::atan2(b, a), spread = std::acos(-constant / h);
  keep(radius_m_ * next_angle(phi - spread, from / radius_m_));
  keep(radius_m_ * next_angle(phi + spread, from / radius_m_));
  if (count == 2 && s[0] > s[1]) std::swap(s[0], s[1]);
  return count;
}

double Curve::nearest(const Pose& pose, const Vec3& p) const {
  const Vec3 local = pose.orientation.conjugate() * (p - pose.position_m);
  if (!is_arc()) return std::clamp(local[0], 0.0, length_m_);
  const double angle = next_angle(std::atan2(local[1], local[0]), 0.0);
  const double s = angle * radius_m_;
  if (s <= length_m_) return s;
  // Beyond the ends: the nearer of the two.
  return (local - Vec3(radius_m_, 0, 0)).norm() <
                 (pose.orientation.conjugate() * (point(pose, length_m_) - pose.position_m) - local)
                     .norm()
             ? 0.0
             : length_m_;
}

double slide_least_squares(const Curve& curve, const Pose& from, const Pose& to,
                           std::span<const double> s, std::span<const double> weight) {
  double along = 0.0, across = 0.0, total = 0.0;
  for (std::size_t i = 0; i < s.size(); ++i) {
    const Vec3 target = from.orientation.conjugate() * (curve.point(to, s[i]) - from.position_m);
    if (curve.is_arc()) {
      const double angle = s[i] / curve.radius_m();
      along += weight[i] * (std::cos(angle) * target[0] + std::sin(angle) * target[1]);
      across += weight[i] * (-std::sin(angle) * target[0] + std::cos(angle) * target[1]);
    } else {
      across += weight[i] * (target[0] - s[i]);
    }
    total += weight[i];
  }
  return curve.is_arc() ? curve.radius_m() * std::atan2(across, along) : across / total;
}

Pose moved(const Pose& pose, const Vec6& twist) {
  Pose result;
  result.position_m = pose.position_m + twist.head<3>();
  const Vec3 rotation = twist.tail<3>();
  const double angle = rotation.norm();
  result.orientation =
      angle > 0.0
          ? (Eigen::Quaterniond(Eigen::AngleAxisd(angle, rotation / angle)) * pose.orientation)
                .normalized()
          : pose.orientation;
  return result;
}

Vec3 rotation_vector(const Eigen::Quaterniond& q) {
  const Eigen::Quaterniond p = q.w() < 0.0 ? Eigen::Quaterniond(-q.w(), -q.x(), -q.y(), -q.z()) : q;
  const double sine = p.vec().norm();
  if (sine < 1e-12) return 2.0 * p.vec();
  return (2.0 * std::atan2(sine, p.w()) / sine) * p.vec();
}

}  // namespace sutured::needle
