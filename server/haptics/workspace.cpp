// SPDX-License-Identifier: GPL-3.0-or-later
#include "haptics/workspace.hpp"

#include <Eigen/Geometry>

#include "scene/scene.hpp"

namespace sutured::haptics {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

Vector3d vector_of(const std::array<double, 3>& v) noexcept { return {v[0], v[1], v[2]}; }
Quaterniond quaternion_of(const std::array<double, 4>& q) noexcept {
  return {q[3], q[0], q[1], q[2]};
}
std::array<double, 3> array_of(const Vector3d& v) noexcept { return {v.x(), v.y(), v.z()}; }
std::array<double, 4> array_of(const Quaterniond& q) noexcept {
  return {q.x(), q.y(), q.z(), q.w()};
}

}  // namespace

Workspace::Workspace(const scene::Workspace& scene)
    : home_m_(array_of(scene.pose.position_m)),
      position_m_(home_m_),
      orientation_xyzw_(array_of(scene.pose.orientation.normalized())),
      motion_scale_(scene.motion_scale),
      force_scale_(scene.force_scale) {}

suture::Pose Workspace::to_world(const suture::Pose& device) const noexcept {
  const Quaterniond r = quaternion_of(orientation_xyzw_);
  const Vector3d p = vector_of(position_m_) + motion_scale_ * (r * vector_of(device.position_m));
  const Quaterniond q = r * quaternion_of(device.orientation_xyzw).normalized() *
                        quaternion_of(tool_orientation_xyzw_);
  return {array_of(p), array_of(q)};
}

suture::Wrench Workspace::to_device(const suture::Wrench& world) const noexcept {
  const Quaterniond back = quaternion_of(orientation_xyzw_).conjugate();
  return {array_of(Vector3d(force_scale_ * (back * vector_of(world.force_n)))),
          array_of(Vector3d(force_scale_ / motion_scale_ * (back * vector_of(world.torque_nm))))};
}

void Workspace::engage(const suture::Pose& device, const suture::Pose& tool) noexcept {
  const Quaterniond r = quaternion_of(orientation_xyzw_);
  position_m_ = array_of(
      Vector3d(vector_of(tool.position_m) - motion_scale_ * (r * vector_of(device.position_m))));
  tool_orientation_xyzw_ =
      array_of(((r * quaternion_of(device.orientation_xyzw).normalized()).conjugate() *
                quaternion_of(tool.orientation_xyzw))
                   .normalized());
}

void Workspace::reset() noexcept {
  position_m_ = home_m_;
  tool_orientation_xyzw_ = {0.0, 0.0, 0.0, 1.0};
}

}  // namespace sutured::haptics
