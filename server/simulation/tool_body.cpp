// SPDX-License-Identifier: GPL-3.0-or-later
#include "simulation/tool_body.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "simulation/thread_body.hpp"

namespace sutured::simulation {
namespace {

using constraints::Bounds;
using constraints::ConstraintRows;

// The jaw closes above and opens below; between them it stays as it is.
constexpr double kCloses = 0.6, kOpens = 0.4;
// A grip that slips carries this share of its limit.
constexpr double kSlipsBelow = 0.995;
// A thread that pulls at both ends and still too much when solved again is let down by this.
constexpr double kSlipsFurther = 0.8;
// Rows that turn a needle act at this arm, so that they too are in metres and newtons: in radians
// their compliance against the needle's weak spring would drown all others in rounding.
constexpr double kTorqueArm_m = 0.01;
// Rows of a probe at most: the nearest features of the surface.
constexpr std::size_t kProbeRowsMax = 8;
// As small as between tissues: where the probe stands beside an edge, two rows carry what one did,
// and the force must not show it.
constexpr double kProbeComplianceTimesModulus = 2e-5 * 2e5;
// Two closest points this near are the same feature seen from two triangles.
constexpr double kSameFeature_m = 1e-7;

std::size_t at(std::int64_t i) { return static_cast<std::size_t>(i); }

/// Bounds of a slipping grip's row: along the force nearly all of the limit, across it what is
/// left, so that the magnitude never passes the limit.
Bounds slip_bounds(std::size_t axis, double limit) {
  const double bound = limit * (axis == 0 ? kSlipsBelow : 0.07);  // 0.995² + 2 · 0.07² < 1
  return {-bound, bound};
}

/// Three orthonormal axes, the first along `first`.
std::array<Vec3, 3> frame(const Vec3& first) {
  const Vec3 second = first.unitOrthogonal();
  return {first, second, first.cross(second)};
}

}  // namespace

ToolBody::ToolBody(const scene::Scene& scene, int index)
    : scene_(&scene), index_(index), description_(scene.tools[at(index)]) {}

void ToolBody::reset() {
  const ToolInput input;
  *this = ToolBody(*scene_, index_);
  input_ = input;
  world_changed_ = true;
}

void ToolBody::serialize(Archive& archive) {
  // Given by the scene: scene, index, description.
  auto& [scene, index, description, input, closed, held, needle, thread, needle_s, tissue_point,
         anchor_tool, needle_in_tool, slipping_force, slipping_torque, force_axis, torque_axis,
         force, torque, slip_reported, thread_tension_max, first_row, rows, contacts, wrench,
         arm_moment, touching, world_changed] = *this;
  archive(input, closed, held, needle, thread, needle_s, tissue_point, anchor_tool, needle_in_tool,
          slipping_force, slipping_torque, force_axis, torque_axis, force, torque, slip_reported,
          thread_tension_max, first_row, rows, contacts, wrench, arm_moment, touching,
          world_changed);
}

Vec6 ToolBody::jacobian(const Vec3& point_m, const Vec3& direction) const {
  Vec6 j;
  j.head<3>() = direction;
  j.tail<3>() = (point_m - input_.position_m).cross(direction);
  return j;
}

std::string ToolBody::held_name(const TissueState& tissue, std::span<NeedleBody> needles) const {
  if (held_ == Held::kNeedle) return needles[at(needle_)].description().name;
  if (held_ == Held::kThread) return scene_->threads[at(thread_)].name;
  return scene_->tissues[at(tissue.tissue_of_triangle(tissue_point_.triangle))].name;
}

HeldThing ToolBody::held(const TissueState& tissue) const {
  switch (held_) {
    case Held::kNeedle:
      return {HeldKind::kNeedle, needle_};
    case Held::kTissue:
      return {HeldKind::kTissue, tissue.tissue_of_triangle(tissue_point_.triangle)};
    case Held::kThread:
      return {HeldKind::kThread, thread_};
    case Held::kNothing:
      break;
  }
  return {};
}

void ToolBody::move(const ToolInput& input, const TissueState& tissue,
                    std::span<NeedleBody> needles, std::span<ThreadBody> threads, double time_s,
                    std::vector<Event>& events) {
  input_ = input;
  thread_tension_max_n_ = description_.grip_force_max_n;
  if (description_.kind == scene::ToolKind::kProbe) return;
  const bool closes = input.present && (closed_ ? input.jaw > kOpens : input.jaw > kCloses);
  if (closes && !closed_) grasp(tissue, needles, threads, time_s, events);
  const bool lost = held_ == Held::kThread && !threads[at(thread_)].held_by(index_);
  if ((!closes && holds()) || lost) release(tissue, needles, threads, time_s, events);
  closed_ = closes;
}

void ToolBody::grasp(const TissueState& tissue, std::span<NeedleBody> needles,
                     std::span<ThreadBody> threads, double time_s, std::vector<Event>& events) {
  double best = description_.capture_radius_m;
  for (std::size_t n = 0; n < needles.size(); ++n) {
    const double s = needles[n].curve().nearest(needles[n].pose(), input_.position_m);
    const double distance =
        std::max(0.0, (needles[n].curve().point(needles[n].pose(), s) - input_.position_m).norm() -
                          0.5 * needles[n].description().diameter_m);
    if (distance > best) continue;
    best = distance;
    held_ = Held::kNeedle;
    needle_ = static_cast<int>(n);
    needle_s_ = s;
  }
  std::optional<ThreadGrasp> thread_grasp;
  for (std::size_t t = 0; t < threads.size(); ++t) {
    // Its thickness counts: a thread that lies on tissue comes before the tissue.
    const double radius = 0.5 * threads[t].description().diameter_m;
    const auto found = threads[t].nearest(input_.position_m, best + radius);
    if (!found) continue;
    const double distance = std::max(0.0, found->distance_m - radius);
    if (held_ != Held::kNothing && distance >= best) continue;
    best = distance;
    held_ = Held::kThread;
    thread_ = static_cast<int>(t);
    thread_grasp = found;
  }
  const auto view = tissue.view();
  if (const auto nearest = view.tree->nearest(input_.position_m, best, view.positions_m)) {
    const double distance = std::sqrt(nearest->closest.squared_distance_m2);
    if (held_ == Held::kNothing || distance < best) {
      held_ = Held::kTissue;
      tissue_point_ = {nearest->triangle, nearest->closest.barycentric};
    }
  }
  if (held_ == Held::kNothing) return;
  Vec3 point;
  if (held_ == Held::kNeedle) {
    NeedleBody& needle = needles[at(needle_)];
    point = needle.curve().point(needle.pose(), needle_s_);
    needle_in_tool_ = input_.orientation.conjugate() * needle.pose().orientation;
    needle.set_holder(index_);
  } else if (held_ == Held::kThread) {
    point = thread_grasp->point_m;
    threads[at(thread_)].grip(index_, *thread_grasp);
  } else {
    point = needle::position(view, tissue_point_);
  }
  anchor_tool_m_ = to_tool(point);
  force_n_.setZero();
  torque_nm_.setZero();
  world_changed_ = true;
  events.push_back(
      {EventKind::kGrasp, time_s, description_.name, held_name(tissue, needles), point, 0.0});
}

void ToolBody::release(const TissueState& tissue, std::span<NeedleBody> needles,
                       std::span<ThreadBody> threads, double time_s, std::vector<Event>& events) {
  events.push_back({EventKind::kRelease, time_s, description_.name, held_name(tissue, needles),
                    to_world(anchor_tool_m_), force_n_.norm()});
  if (held_ == Held::kNeedle && needles[at(needle_)].holder() == index_)
    needles[at(needle_)].set_holder(-1);
  if (held_ == Held::kThread) threads[at(thread_)].release(index_);
  held_ = Held::kNothing;
  needle_ = thread_ = -1;
  slip_reported_ = false;
  world_changed_ = true;
}

std::optional<scene::Pose> ToolBody::needle_target(int needle) const {
  if (held_ != Held::kNeedle || needle_ != needle) return std::nullopt;
  const scene::Needle& description = scene_->needles[at(needle)];
  const needle::Curve curve = needle::Curve::of(description);
  scene::Pose pose;
  pose.orientation = (input_.orientation * needle_in_tool_).normalized();
  pose.position_m =
      to_world(anchor_tool_m_) - (curve.point({Vec3::Zero(), pose.orientation}, needle_s_));
  return pose;
}

void ToolBody::add_rows(const TissueState& tissue, std::span<NeedleBody> needles, double reach_m,
                        ConstraintRows& rows) {
  first_row_ = rows.size();
  rows_ = contacts_ = 0;
  if (!input_.present) return;
  if (description_.kind == scene::ToolKind::kProbe) {
    add_probe_rows(tissue, reach_m, rows);
  } else if (held_ == Held::kNeedle || held_ == Held::kTissue) {
    const Vec3 anchor = to_world(anchor_tool_m_);
    const double compliance = 1.0 / description_.grip_stiffness_n_per_m;
    const auto force_axes = frame(force_axis_);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const Vec3 e = force_axes[axis];
      const Bounds bounds =
          slipping_force_ ? slip_bounds(axis, description_.grip_force_max_n) : Bounds::bilateral();
      if (held_ == Held::kNeedle) {
        const NeedleBody& needle = needles[at(needle_)];
        const Vec3 point = needle.curve().point(needle.pose(), needle_s_);
        constraints::Row& row = rows.add(bounds, e.dot(point - anchor), compliance);
        row.needle = needle_;
        row.needle_jacobian = needle.jacobian(point, e);
        row.tool = index_;
        row.tool_jacobian = -jacobian(anchor, e);
      } else {
        constraints::Row& row = rows.add(bounds, e.dot(anchor), compliance);
        row.tool = index_;
        row.tool_jacobian = jacobian(anchor, e);
        const auto view = tissue.view();
        const auto& triangle = view.surface->triangles[at(tissue_point_.triangle)];
        for (std::size_t a = 0; a < 3; ++a)
          rows.touch(triangle[a], tissue_point_.barycentric[static_cast<Eigen::Index>(a)] * e);
      }
    }
    if (held_ == Held::kNeedle) {
      const NeedleBody& needle = needles[at(needle_)];
      const Vec3 turn = needle::rotation_vector(needle.pose().orientation *
                                                (input_.orientation * needle_in_tool_).conjugate());
      const auto torque_axes = frame(torque_axis_);
      for (std::size_t axis = 0; axis < 3; ++axis) {
        const Vec3 e = kTorqueArm_m * torque_axes[axis];
        constraints::Row& row = rows.add(
            slipping_torque_ ? slip_bounds(axis, description_.grip_torque_max_nm / kTorqueArm_m)
                             : Bounds::bilateral(),
            e.dot(turn), kTorqueArm_m * kTorqueArm_m / description_.grip_stiffness_nm_per_rad);
        row.needle = needle_;
        row.needle_jacobian.tail<3>() = e;
        row.tool = index_;
        row.tool_jacobian.tail<3>() = -e;
      }
    }
  }
  rows_ = rows.size() - first_row_;
}

void ToolBody::add_probe_rows(const TissueState& tissue, double reach_m, ConstraintRows& rows) {
  struct Feature {
    double gap_m = 0.0;
    Vec3 point_m, normal;
    needle::BoundaryPoint at;
  };
  std::array<Feature, kProbeRowsMax> found;
  std::size_t count = 0;
  const auto view = tissue.view();
  const Vec3 centre = input_.position_m;
  const double radius = description_.probe_radius_m;
  // A centre that has gone under the surface is pushed back through the nearest face.
  const auto nearest = view.tree->nearest(centre, radius + reach_m, view.positions_m);
  if (!nearest) return;
  const bool inside =
      needle::normal(view, nearest->triangle).dot(centre - nearest->closest.point_m) < 0.0 &&
      nearest->closest.feature == geometry::TriangleFeature::kFace;
  const auto consider = [&](std::int32_t triangle) {
    const auto& t = view.surface->triangles[at(triangle)];
    const auto closest = geometry::closest_point_on_triangle(
        centre, view.positions_m[at(t[0])], view.positions_m[at(t[1])], view.positions_m[at(t[2])]);
    const double distance = std::sqrt(closest.squared_distance_m2);
    Feature feature;
    feature.normal = inside || distance < 1e-9 ? needle::normal(view, triangle)
                                               : Vec3((centre - closest.point_m) / distance);
    if (needle::normal(view, triangle).dot(feature.normal) < 0.0) return;  // seen from behind
    feature.gap_m = (inside ? -distance : distance) - radius;
    if (feature.gap_m > reach_m) return;
    feature.point_m = closest.point_m;
    feature.at = {triangle, closest.barycentric};
    for (std::size_t i = 0; i < count; ++i)
      if ((found[i].point_m - feature.point_m).norm() < kSameFeature_m) return;
    if (count < kProbeRowsMax) {
      found[count++] = feature;
      return;
    }
    auto* worst = std::max_element(found.begin(), found.end(),
                                   [](const auto& a, const auto& b) { return a.gap_m < b.gap_m; });
    if (feature.gap_m < worst->gap_m) *worst = feature;
  };
  if (inside) {
    consider(nearest->triangle);
  } else {
    const Vec3 half = Vec3::Constant(radius + reach_m);
    view.tree->for_each_overlap({centre - half, centre + half}, consider);
  }
  for (std::size_t i = 0; i < count; ++i) {
    const Feature& feature = found[i];
    // gap = n · (centre − x) − radius
    constraints::Row& row =
        rows.add(Bounds::unilateral(), radius - feature.normal.dot(centre),
                 kProbeComplianceTimesModulus /
                     tissue.young_modulus_pa(view.surface->tet[at(feature.at.triangle)]));
    row.tool = index_;
    row.tool_jacobian = -jacobian(centre, feature.normal);
    const auto& triangle = view.surface->triangles[at(feature.at.triangle)];
    for (std::size_t a = 0; a < 3; ++a)
      rows.touch(triangle[a],
                 -feature.at.barycentric[static_cast<Eigen::Index>(a)] * feature.normal);
  }
}

bool ToolBody::read(const ConstraintRows& rows, std::span<const double> lambda, bool may_revise) {
  wrench_.setZero();
  arm_moment_.setZero();
  force_n_.setZero();
  torque_nm_.setZero();
  const bool touched = touching_;
  touching_ = holds();
  contacts_ = 0;
  for (int i = 0; i < rows.size(); ++i) {
    const Vec6* const felt = rows[i].jacobian_of(index_);
    if (felt == nullptr) continue;
    const double l = lambda[at(i)];
    wrench_ -= l * *felt;
    const bool own = i >= first_row_ && i < first_row_ + rows_;
    if (description_.kind == scene::ToolKind::kProbe) {
      contacts_ += l > 0.0;
    } else if (!own || i - first_row_ < 3) {
      force_n_ -= l * felt->head<3>();
    } else {
      torque_nm_ -= l * felt->tail<3>();
    }
  }
  touching_ = touching_ || contacts_ > 0;
  if (touching_ != touched) world_changed_ = true;
  if (!holds()) return true;
  arm_moment_ = (to_world(anchor_tool_m_) - input_.position_m) * force_n_.transpose();
  if (!may_revise) return true;
  const double force = force_n_.norm();
  if (held_ == Held::kThread) {
    if (force <= description_.grip_force_max_n) return true;
    // Both ends of it may pull, and the rows of T H across it add to them.
    double tension = 0.0;
    for (int i = 0; i < rows.size(); ++i)
      if (rows[i].jacobian_of(index_) != nullptr && rows[i].bounds.lower_n == 0.0)
        tension = std::max(tension, lambda[at(i)]);
    const double share = kSlipsBelow * description_.grip_force_max_n / force;
    const bool again = thread_tension_max_n_ < description_.grip_force_max_n;
    thread_tension_max_n_ =
        std::min(share * tension, (again ? kSlipsFurther : 1.0) * thread_tension_max_n_);
    return false;
  }
  bool good = true;
  if (!slipping_force_ && force > description_.grip_force_max_n) {
    slipping_force_ = true;
    force_axis_ = force_n_.normalized();
    good = false;
  }
  if (held_ == Held::kNeedle && !slipping_torque_ &&
      torque_nm_.norm() > description_.grip_torque_max_nm) {
    slipping_torque_ = true;
    torque_axis_ = torque_nm_.normalized();
    good = false;
  }
  return good;
}

void ToolBody::commit(const TissueState& tissue, std::span<NeedleBody> needles, double time_s,
                      std::vector<Event>& events) {
  if (!slipping_force_ && !slipping_torque_) return;
  // Force on the tool is λ along the rows: q − a = ε λ.
  if (slipping_force_) {
    const Vec3 stretch = force_n_ / description_.grip_stiffness_n_per_m;
    const Vec3 point = held_ == Held::kNeedle ? needles[at(needle_)].curve().point(
                                                    needles[at(needle_)].pose(), needle_s_)
                                              : needle::position(tissue.view(), tissue_point_);
    anchor_tool_m_ = to_tool(point - stretch);
  }
  if (slipping_torque_) {
    const Vec3 twist = torque_nm_ / description_.grip_stiffness_nm_per_rad;
    const double angle = twist.norm();
    const Eigen::Quaterniond back(
        Eigen::AngleAxisd(-angle, angle > 0 ? Vec3(twist / angle) : Vec3::UnitX()));
    needle_in_tool_ =
        (input_.orientation.conjugate() * back * needles[at(needle_)].pose().orientation)
            .normalized();
  }
  if (!slip_reported_) {
    events.push_back({EventKind::kGripSlip, time_s, description_.name, held_name(tissue, needles),
                      to_world(anchor_tool_m_), force_n_.norm()});
    slip_reported_ = true;
  }
  slipping_force_ = slipping_torque_ = false;
}

}  // namespace sutured::simulation
