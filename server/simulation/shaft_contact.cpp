// SPDX-License-Identifier: GPL-3.0-or-later
#include "simulation/shaft_contact.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "simulation/needle_body.hpp"

namespace sutured::simulation {
namespace {

constexpr double kSpacing_m = 0.5e-3;
constexpr double kHole_m = 1.2e-3;
// A point of the axis deeper inside than this is taken to be where it is by intent.
constexpr double kDepthMax_m = 1.0e-3;
// Along a surface every so many points stand for the stretch between them: always the same ones.
constexpr int kStride = 2;
// A touch of more force resists sliding sideways within a step, by its force over this length: a
// row t · Δ(p − x) + (h / λ) μ = 0, which carries nothing once all is still.
constexpr double kResistedForce_n = 5e-3;
constexpr double kSlideLength_m = 1e-3;
constexpr double kComplianceTimesModulus = 1e-4 * 2e5;
// Less of a normal than this across the axis belongs to a point farther along it.
constexpr double kAcrossMin = 0.3;

std::size_t at(std::int64_t i) { return static_cast<std::size_t>(i); }

/// Gives the last row `direction` at the touched point of the surface.
void touch_surface(const needle::TissueView& view, const ShaftContact::Touch& touch,
                   const Vec3& direction, constraints::ConstraintRows& rows) {
  const auto& triangle = view.surface->triangles[at(touch.at.triangle)];
  for (std::size_t a = 0; a < 3; ++a)
    rows.touch(triangle[a], touch.at.barycentric[static_cast<Eigen::Index>(a)] * direction);
}

/// Turns the normal of a touch at right angles to the axis: a tube does not push along itself, and
/// as it slides along itself its gap stays. The end of the shaft alone has a face that may push.
void square_to_axis(const Vec3& tangent, ShaftContact::Touch& touch) {
  const Vec3 across = touch.normal - touch.normal.dot(tangent) * tangent;
  const double share = across.norm();
  if (touch.sample == 0 || share < kAcrossMin) return;
  touch.normal = across / share;
}

}  // namespace

void ShaftContact::serialize(Archive& archive) {
  auto& [touches, count, first_row] = *this;
  archive(count, first_row);
  if (count > kRowsMax) throw ArchiveError("it is of another build");
  for (std::size_t i = 0; i < count; ++i) archive(touches[i]);
}

void ShaftContact::find(const TissueState& tissue, const NeedleBody& needle, double reach_m) {
  const std::array<Touch, kRowsMax> before_now = touches_;
  const std::span<const Touch> known(before_now.data(), count_);
  count_ = 0;
  const needle::TissueView view = tissue.view();
  const needle::Curve& curve = needle.curve();
  const scene::Pose& pose = needle.pose();
  const double radius = 0.5 * needle.description().diameter_m, length = curve.length_m();
  const int last = static_cast<int>(std::floor((length - kHole_m) / kSpacing_m));
  Touch before, now, next;
  constexpr double kFar = std::numeric_limits<double>::infinity();
  before.gap_m = now.gap_m = kFar;
  const auto in_hole = [&](double s) {
    return std::any_of(needle.path().cells().begin(), needle.path().cells().end(),
                       [&](const needle::Cell& cell) {
                         return cell.active_length_m > 0.0 && s > cell.s_back - kHole_m &&
                                s < cell.s_front + kHole_m;
                       });
  };
  const auto look = [&](int sample) {
    Touch touch;
    touch.sample = sample;
    touch.gap_m = kFar;
    if (sample > last) return touch;
    touch.s = sample * kSpacing_m;
    touch.point_m = curve.point(pose, touch.s);
    const auto nearest = view.tree->nearest(touch.point_m, std::max(radius + reach_m, kDepthMax_m),
                                            view.positions_m);
    if (!nearest || in_hole(touch.s)) return touch;
    const Vec3 face = needle::normal(view, nearest->triangle);
    const Vec3 away = touch.point_m - nearest->closest.point_m;
    const double distance = away.norm();
    const bool inside = face.dot(away) < 0.0;
    touch.at = {nearest->triangle, nearest->closest.barycentric};
    if (distance < 1e-9 || inside) {
      touch.normal = face;
      touch.gap_m = -distance - radius;
    } else {
      touch.normal = away / distance;
      touch.gap_m = distance - radius;
    }
    if (touch.gap_m > reach_m) touch.gap_m = kFar;
    const auto then = std::find_if(known.begin(), known.end(),
                                   [&](const Touch& t) { return t.sample == sample; });
    if (then != known.end()) touch.force_n = then->force_n;
    return touch;
  };
  next = look(0);
  for (int sample = 0; sample <= last; ++sample) {
    before = now;
    now = next;
    next = look(sample + 1);
    if (now.gap_m == kFar) continue;
    const bool nearest = now.gap_m <= before.gap_m && now.gap_m < next.gap_m;
    if (!nearest && sample % kStride != 0) continue;
    if (count_ < kRowsMax) {
      touches_[count_++] = now;
      continue;
    }
    Touch* const farthest =
        std::max_element(touches_.begin(), touches_.end(),
                         [](const Touch& a, const Touch& b) { return a.gap_m < b.gap_m; });
    if (now.gap_m < farthest->gap_m) *farthest = now;
  }
  for (std::size_t i = 0; i < count_; ++i)
    square_to_axis(curve.tangent(pose, touches_[i].s), touches_[i]);
}

void ShaftContact::add_rows(const TissueState& tissue, const NeedleBody& needle, int needle_index,
                            constraints::ConstraintRows& rows) {
  first_row_ = rows.size();
  const needle::TissueView view = tissue.view();
  const double radius = 0.5 * needle.description().diameter_m;
  for (const Touch& touch : touches()) {
    constraints::Row& row =
        rows.add(constraints::Bounds::unilateral(), radius - touch.normal.dot(touch.point_m),
                 kComplianceTimesModulus /
                     tissue.young_modulus_pa(view.surface->tet[at(touch.at.triangle)]));
    row.key = (std::uint64_t{1} << 61) | (static_cast<std::uint64_t>(needle_index) << 32) |
              static_cast<std::uint64_t>(touch.sample);
    row.needle = needle_index;
    row.needle_jacobian = -needle.jacobian(touch.point_m, touch.normal);
    touch_surface(view, touch, -touch.normal, rows);
  }
  // Sideways, where a shaft that is pressed hard would roll off within one step.
  for (const Touch& touch : touches()) {
    if (touch.force_n <= kResistedForce_n) continue;
    const Vec3 aside =
        touch.normal.cross(needle.curve().tangent(needle.pose(), touch.s)).normalized();
    constraints::Row& row =
        rows.add(constraints::Bounds::bilateral(), -aside.dot(needle::position(view, touch.at)),
                 kSlideLength_m / touch.force_n);
    row.needle = needle_index;
    row.needle_jacobian = -needle.jacobian(touch.point_m, aside);
    touch_surface(view, touch, -aside, rows);
  }
}

void ShaftContact::read(std::span<const double> lambda) {
  for (std::size_t i = 0; i < count_; ++i) touches_[i].force_n = lambda[at(first_row_) + i];
}

bool ShaftContact::pressing() const {
  return std::any_of(touches().begin(), touches().end(),
                     [](const Touch& touch) { return touch.force_n > 0.0; });
}

}  // namespace sutured::simulation
