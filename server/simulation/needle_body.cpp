// SPDX-License-Identifier: GPL-3.0-or-later
#include "simulation/needle_body.hpp"

#include <algorithm>
#include <cmath>

namespace sutured::simulation {
namespace {

using constraints::Bounds;
using constraints::ConstraintRows;

// Row compliance per length of cell, ε = κ / ℓ: 1e-7 m²/N at 200 kPa, softer with softer tissue
// (docs/adr/0004-coupling-compliance.md).
constexpr double kCouplingTimesModulus_m = 0.02;
// Compliance of tip rows at 200 kPa, far below the wall's own.
constexpr double kTipComplianceTimesModulus = 1e-4 * 2e5;
// A surface this steep to the axis is not punctured.
constexpr double kGrazingCosine = 0.05;
// From inside, a wall along the axis holds the tip by at most the puncture force over this.
constexpr double kCuttingCosine = 0.2;
// The weak spring to the last pose that keeps a needle's six unknowns regular.
constexpr double kHeldSpring_n_per_m = 0.05;
constexpr double kFreeSpring_n_per_m = 5.0;
// Friction of less embedded length than this is taken at this length.
constexpr double kFrictionLength_m = 1e-4;
// A slide gives way no more than this, whatever the friction: beyond it W is badly scaled, and
// 1 mm of slide in a step costs 10 µN.
constexpr double kSlideComplianceMax_m_per_n = 100.0;
// Within this of the hole the tip has left, the wall does not hold it from returning.
constexpr double kHoleReach_m = 1e-3;

std::size_t at(std::int64_t i) { return static_cast<std::size_t>(i); }

}  // namespace

NeedleBody::NeedleBody(const scene::Scene& scene, int index)
    : scene_(&scene),
      index_(index),
      description_(scene.needles[at(index)]),
      curve_(needle::Curve::of(description_)),
      path_(curve_, static_cast<std::uint64_t>(index) + 1),
      pose_(description_.pose) {}

void NeedleBody::reset() {
  path_.clear();
  pose_ = description_.pose;
  tip_ = {};
  shaft_.reset();
  holder_ = -1;
  held_ = static_slip_ = pending_ = pending_puncture_ = pending_exit_ = false;
  axial_force_n_ = pending_slide_m_ = 0.0;
  world_changed_ = true;
}

void NeedleBody::serialize(Archive& archive) {
  // Given by the scene: scene … curve. Scratch of the least-squares slide: s, weight.
  auto& [scene, index, description, curve, path, pose, mobility, tip, shaft, holder, held,
         static_slip, static_slip_sign, static_limit, embedded_friction, axial_force,
         first_cell_row, cell_rows, pending_slide, pending, pending_puncture, pending_exit,
         began_pressing, world_changed, s, weight, tip_tissue, rows_compliance] = *this;
  archive(path, pose, mobility, tip, shaft, holder, held, static_slip, static_slip_sign,
          static_limit, embedded_friction, axial_force, first_cell_row, cell_rows, pending_slide,
          pending, pending_puncture, pending_exit, began_pressing, world_changed, tip_tissue,
          rows_compliance);
}

Vec6 NeedleBody::jacobian(const Vec3& point_m, const Vec3& direction) const {
  Vec6 j;
  j.head<3>() = direction;
  j.tail<3>() = (point_m - pose_.position_m).cross(direction);
  return j;
}

Vec6 NeedleBody::least_squares_gradient(const Vec3& origin_m) const {
  Vec6 gradient = Vec6::Zero();
  double total = 0.0;
  for (const needle::Cell& cell : path_.cells()) {
    if (cell.active_length_m == 0.0) continue;
    const Vec3 t = curve_.tangent(pose_, cell.s_mid);
    gradient.head<3>() += cell.active_length_m * t;
    gradient.tail<3>() +=
        cell.active_length_m * (curve_.point(pose_, cell.s_mid) - origin_m).cross(t);
    total += cell.active_length_m;
  }
  return total > 0.0 ? Vec6(gradient / total) : gradient;
}

void NeedleBody::begin(const TissueState& tissue, double dt_s, bool held,
                       const std::optional<scene::Pose>& target) {
  held_ = held;
  static_slip_ = false;
  embedded_friction_ = 0.0;
  static_limit_n_ = 0.0;
  for (const needle::Cell& cell : path_.cells()) {
    const auto& t = scene_->tissues[at(tissue.tissue_of_tet(cell.tet))];
    embedded_friction_ += t.friction_n_s_per_m2 * cell.active_length_m;
    static_limit_n_ += t.static_friction_n_per_m * cell.active_length_m;
  }
  if (path_.embedded_length_m() > 0.0) {
    double largest = 0.0;
    for (const auto& t : scene_->tissues) largest = std::max(largest, t.friction_n_s_per_m2);
    embedded_friction_ = std::max(embedded_friction_, largest * kFrictionLength_m);
  }
  const double spring = held ? kHeldSpring_n_per_m : kFreeSpring_n_per_m;
  const double arm = std::max(curve_.is_arc() ? curve_.radius_m() : curve_.length_m(), 1e-3);
  mobility_.mobility.setZero();
  mobility_.mobility.diagonal().head<3>().setConstant(1.0 / spring);
  mobility_.mobility.diagonal().tail<3>().setConstant(1.0 / (spring * arm * arm));
  mobility_.slide_compliance_m_per_n =
      slides_freely() ? std::min(dt_s / embedded_friction_, kSlideComplianceMax_m_per_n) : 0.0;

  if (!least_squares() || !held || !target || path_.embedded_length_m() == 0.0) return;
  // Paper section 3.1: slide first, by as much as brings the embedded part closest to its target.
  s_.clear();
  weight_.clear();
  for (const needle::Cell& cell : path_.cells())
    if (cell.active_length_m > 0.0) {
      s_.push_back(cell.s_mid);
      weight_.push_back(cell.active_length_m);
    }
  double slide = needle::slide_least_squares(curve_, pose_, *target, s_, weight_);
  if (slide > 0.0)
    if (const auto ahead = path_.boundary_ahead(tissue.view(), pose_, slide))
      slide = std::clamp(ahead->second - curve_.length_m(), 0.0, slide);
  pose_ = curve_.slid(pose_, slide);
  path_.slide(tissue.view(), pose_, slide, needle::Passage::kClosed);
}

void NeedleBody::find_contact(const TissueState& tissue, double reach_m) {
  find_tip_contact(tissue, reach_m);
  shaft_.find(tissue, *this, reach_m);
}

void NeedleBody::find_tip_contact(const TissueState& tissue, double reach_m) {
  const needle::TissueView view = tissue.view();
  const Vec3 tip = curve_.point(pose_, curve_.length_m());
  tip_.slipping = false;
  if (path_.tip_inside()) {
    if (tip_.side == TipContact::Side::kOutside) tip_ = {};
    if (!(tip_.side == TipContact::Side::kInside && tip_.pressing)) {
      const auto ahead = path_.boundary_ahead(view, pose_, reach_m);
      tip_ = {};
      if (!ahead) return;
      tip_.side = TipContact::Side::kInside;
      tip_.at = ahead->first;
    }
    tip_.normal = needle::normal(view, tip_.at.triangle);
    return;
  }
  if (tip_.side == TipContact::Side::kInside) tip_ = {};
  if (tip_.side == TipContact::Side::kOutside && tip_.pressing) {
    // It stands on the material point where it came down.
    tip_.normal = needle::normal(view, tip_.at.triangle);
    return;
  }
  tip_ = {};
  // What lies ahead on the axis comes first: close to the hole it has left, the tip may meet
  // another wall.
  if (const auto entry = needle::Path::first_entry(view, curve_, pose_, curve_.length_m(),
                                                   curve_.length_m() + reach_m)) {
    meet(view, entry->first);
    return;
  }
  const auto nearest = view.tree->nearest(tip, 2.0 * reach_m + 1e-3, view.positions_m);
  if (!nearest) return;
  if (!path_.cells().empty() && path_.cells().back().left.triangle >= 0) {
    const needle::BoundaryPoint& hole = path_.cells().back().left;
    if (tissue.tissue_of_triangle(hole.triangle) == tissue.tissue_of_triangle(nearest->triangle) &&
        (needle::position(view, hole) - nearest->closest.point_m).norm() < kHoleReach_m)
      return;
  }
  // Inside the body without a path, the needle was set there or swept in sideways: it is pushed
  // out, but only from near the surface.
  if (std::sqrt(nearest->closest.squared_distance_m2) > reach_m &&
      needle::normal(view, nearest->triangle).dot(tip - nearest->closest.point_m) >= 0.0)
    return;
  meet(view, {nearest->triangle, nearest->closest.barycentric});
}

void NeedleBody::meet(const needle::TissueView& view, const needle::BoundaryPoint& point) {
  tip_.side = TipContact::Side::kOutside;
  tip_.at = point;
  tip_.normal = needle::normal(view, point.triangle);
}

void NeedleBody::add_rows(const TissueState& tissue, ConstraintRows& rows) {
  const needle::TissueView view = tissue.view();
  first_cell_row_ = rows.size();
  for (const needle::Cell& cell : path_.cells()) {
    if (cell.active_length_m == 0.0) continue;
    const Vec3 p = curve_.point(pose_, cell.s_mid), tangent = curve_.tangent(pose_, cell.s_mid);
    const double compliance = kCouplingTimesModulus_m /
                              (tissue.young_modulus_pa(cell.tet) * needle::coupling_length_m(cell));
    for (int axis = 0; axis < 3; ++axis) {
      const Vec3 direction = Vec3::Unit(axis);
      constraints::Row& row = rows.add(Bounds::bilateral(), p[axis], compliance);
      row.needle = index_;
      row.needle_jacobian = jacobian(p, direction);
      row.slide = -tangent[axis];
      if (static_slip_)
        row.target_m +=
            -mobility_.slide_compliance_m_per_n * row.slide * static_slip_sign_ * static_limit_n_;
      for (std::size_t a = 0; a < 4; ++a)
        rows.touch(view.tets[at(cell.tet)][a],
                   cell.barycentric[static_cast<Eigen::Index>(a)] * direction);
    }
  }
  cell_rows_ = rows.size() - first_cell_row_;
  shaft_.add_rows(tissue, *this, index_, rows);

  tip_.first_row = rows.size();
  tip_.rows = 0;
  if (tip_.side == TipContact::Side::kNone) return;
  const Vec3 tip = curve_.point(pose_, curve_.length_m()),
             along = curve_.tangent(pose_, curve_.length_m());
  const auto& triangle = view.surface->triangles[at(tip_.at.triangle)];
  const auto tet = view.surface->tet[at(tip_.at.triangle)];
  const auto& material = scene_->tissues[at(tissue.tissue_of_tet(tet))];
  tip_tissue_ = tissue.tissue_of_tet(tet);
  rows_compliance_ = kTipComplianceTimesModulus / tissue.young_modulus_pa(tet);
  const bool outside = tip_.side == TipContact::Side::kOutside;
  const auto add = [&](const Bounds& bounds, const Vec3& direction) {
    constraints::Row& row = rows.add(bounds, direction.dot(tip), rows_compliance_);
    row.needle = index_;
    row.needle_jacobian = jacobian(tip, direction);
    if (outside && tip_.rows > 0) {
      row.friction_of = tip_.first_row;
      row.friction_coefficient = material.surface_friction_coefficient;
    }
    for (std::size_t a = 0; a < 3; ++a)
      rows.touch(triangle[a], tip_.at.barycentric[static_cast<Eigen::Index>(a)] * direction);
    ++tip_.rows;
  };
  const Vec3 push = outside ? Vec3(-tip_.normal) : tip_.normal;  // the way the tip pushes the wall
  const double cosine = push.dot(along);
  // Over a surface at a grazing angle the tip slides; from inside it is sharp, and cuts at any
  // angle.
  const double share = outside ? cosine : std::max(std::abs(cosine), kCuttingCosine);
  add(Bounds::unilateral(share > kGrazingCosine ? material.puncture_force_n / share
                                                : constraints::kUnbounded),
      push);
  if (!tip_.pressing) return;
  const Vec3 first = tip_.slipping ? tip_.slip_direction : tip_.normal.unitOrthogonal();
  const Bounds cone = tip_.slipping ? Bounds{-tip_.cone_n, tip_.cone_n} : Bounds::bilateral();
  add(cone, first);
  add(cone, tip_.normal.cross(first));
}

bool NeedleBody::read(const ConstraintRows& rows, std::span<const double> lambda, bool may_revise) {
  const bool pressed = shaft_.pressing();
  shaft_.read(lambda);
  if (shaft_.pressing() != pressed) world_changed_ = true;
  axial_force_n_ = 0.0;
  for (int i = first_cell_row_; i < first_cell_row_ + cell_rows_; ++i)
    axial_force_n_ -= rows[i].slide * lambda[at(i)];
  bool good = true;
  if (!held_ && !static_slip_ && cell_rows_ > 0 && std::abs(axial_force_n_) > static_limit_n_ &&
      may_revise) {
    static_slip_ = true;
    static_slip_sign_ = axial_force_n_ > 0.0 ? 1.0 : -1.0;
    // Beyond the limit it creeps as a held needle slides.
    mobility_.slide_compliance_m_per_n =
        std::min(1e-2 / std::max(embedded_friction_, 1e-9), kSlideComplianceMax_m_per_n);
    good = false;
  }
  if (tip_.rows == 0) return good;
  const Vec3 along = curve_.tangent(pose_, curve_.length_m());
  Vec3 force_on_tissue = Vec3::Zero();
  for (int i = 0; i < tip_.rows; ++i)
    force_on_tissue +=
        lambda[at(tip_.first_row + i)] * rows[tip_.first_row + i].needle_jacobian.head<3>();
  tip_.normal_force_n = lambda[at(tip_.first_row)];
  tip_.axial_force_n = force_on_tissue.dot(along);
  tip_.tangent_force_n =
      force_on_tissue - tip_.normal_force_n * rows[tip_.first_row].needle_jacobian.head<3>();
  if (tip_.rows == 3 && tip_.side == TipContact::Side::kOutside && !tip_.slipping && may_revise) {
    const auto& friction = scene_->tissues[at(tip_tissue_)].surface_friction_coefficient;
    const double cone = friction * tip_.normal_force_n, force = tip_.tangent_force_n.norm();
    if (force > cone) {
      tip_.slipping = true;
      tip_.slip_direction = tip_.tangent_force_n / force;
      tip_.cone_n = cone;
      good = false;
    }
  }
  return good;
}

void NeedleBody::commit(const ConstraintRows& rows, std::span<const double> lambda,
                        std::span<const constraints::RowState> states) {
  Vec6 generalised = Vec6::Zero();
  double slide_force = 0.0;
  for (int i = 0; i < rows.size(); ++i) {
    if (rows[i].needle != index_) continue;
    generalised += lambda[at(i)] * rows[i].needle_jacobian;
    slide_force += lambda[at(i)] * rows[i].slide;
  }
  const Vec6 twist = -(mobility_.mobility * generalised);
  pending_slide_m_ = -mobility_.slide_compliance_m_per_n * slide_force;
  if (static_slip_)
    pending_slide_m_ -= mobility_.slide_compliance_m_per_n * static_slip_sign_ * static_limit_n_;
  pose_ = needle::moved(pose_, twist);
  pending_ = true;
  if (tip_.rows == 0) return;
  const bool pressed = tip_.pressing;
  tip_.pressing = tip_.normal_force_n > 0.0;
  if (tip_.pressing != pressed) world_changed_ = true;
  began_pressing_ = tip_.pressing && !pressed;
  const auto& material = scene_->tissues[at(tip_tissue_)];
  const bool outside = tip_.side == TipContact::Side::kOutside;
  const bool faces_wall =
      !outside || -tip_.normal.dot(curve_.tangent(pose_, curve_.length_m())) > kGrazingCosine;
  const bool through = states[at(tip_.first_row)] == constraints::RowState::kUpper ||
                       (faces_wall && tip_.axial_force_n >= material.puncture_force_n);
  pending_puncture_ = through && outside;
  pending_exit_ = through && !outside;
}

void NeedleBody::puncture(const TissueState& tissue, double time_s, std::vector<Event>& events) {
  const needle::TissueView view = tissue.view();
  const double length = curve_.length_m();
  // The axis passes the wall near the tip: at the tip itself, or behind it by as much as it
  // overshot.
  const Vec3 n = needle::normal(view, tip_.at.triangle);
  const Vec3 hole = needle::position(view, tip_.at);
  std::array<double, 2> crossings;
  const int count =
      curve_.meets_plane(pose_, n, n.dot(hole), std::max(0.0, length - 5e-3), length, crossings);
  const double s = count > 0 ? crossings[at(count - 1)] : length;
  path_.enter(view, pose_, tip_.at, s);
  events.push_back({EventKind::kPuncture, time_s, description_.name,
                    scene_->tissues[at(tip_tissue_)].name, hole, tip_.axial_force_n});
  tip_ = {};
  world_changed_ = true;
}

void NeedleBody::track(const TissueState& tissue, double time_s, std::vector<Event>& events) {
  if (!pending_) return;
  pending_ = false;
  const needle::TissueView view = tissue.view();
  const auto tissue_name = [&](const needle::BoundaryPoint& point) {
    return scene_->tissues[at(tissue.tissue_of_triangle(point.triangle))].name;
  };
  if (began_pressing_) {
    began_pressing_ = false;
    if (tip_.side == TipContact::Side::kOutside)
      events.push_back({EventKind::kContact, time_s, description_.name, tissue_name(tip_.at),
                        needle::position(view, tip_.at), tip_.normal_force_n});
  }
  for (const auto& crossing : path_.slide(view, pose_, pending_slide_m_, needle::Passage::kClosed))
    if (crossing.kind == needle::Crossing::Kind::kWithdrawn) {
      events.push_back({EventKind::kExit, time_s, description_.name, tissue_name(crossing.at),
                        needle::position(view, crossing.at), 0.0});
      world_changed_ = true;
    }
  pending_slide_m_ = 0.0;
  if (pending_puncture_) puncture(tissue, time_s, events);
  if (pending_exit_ && path_.tip_inside()) {
    const double force = tip_.axial_force_n;
    for (const auto& crossing : path_.leave(view, pose_, tip_.at))
      if (crossing.kind == needle::Crossing::Kind::kLeft) {
        events.push_back({EventKind::kExit, time_s, description_.name, tissue_name(crossing.at),
                          needle::position(view, crossing.at), force});
        world_changed_ = true;
      }
    tip_ = {};
  }
  pending_puncture_ = pending_exit_ = false;
  if (tip_.side == TipContact::Side::kOutside && tip_.pressing && tip_.slipping) {
    // The material point follows the tip, less the stretch that the tangential rows still carry.
    const Vec3 tip =
        curve_.point(pose_, curve_.length_m()) - rows_compliance_ * tip_.tangent_force_n;
    if (const auto nearest = view.tree->nearest(tip, 5e-3, view.positions_m))
      tip_.at = {nearest->triangle, nearest->closest.barycentric};
  }
}

void NeedleBody::report_punctures(const TissueState& tissue,
                                  std::vector<NeedlePuncture>& punctures) const {
  const double length = curve_.length_m();
  punctures.clear();
  const auto add = [&](const needle::BoundaryPoint& hole, double s, bool inward) {
    if (hole.triangle < 0 || s < 0.0) return;  // behind the tail it is the thread's hole
    punctures.push_back({tissue.tissue_of_triangle(hole.triangle),
                         needle::position(tissue.view(), hole), length - s, inward});
  };
  const auto cells = path_.cells();
  for (auto cell = cells.rbegin(); cell != cells.rend(); ++cell) {
    add(cell->left, cell->s_front, true);
    add(cell->entered, cell->s_back, false);
  }
}

}  // namespace sutured::simulation
