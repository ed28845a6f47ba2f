// SPDX-License-Identifier: GPL-3.0-or-later
#include "needle/path.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <utility>

namespace sutured::needle {
namespace {

constexpr double kTie_m = 1e-10;
constexpr double kNoLength_m = 1e-12;
constexpr double kAhead_m = 1e-9;
constexpr int kIdleMax = 16;
constexpr int kCellsPerWalkMax = 100000;

std::size_t at(std::int32_t i) { return static_cast<std::size_t>(i); }

/// A box around the axis between two parameters.
geometry::Box box_of(const Curve& curve, const Pose& pose, double from, double to) {
  constexpr int kPieces = 8;
  geometry::Box box;
  for (int i = 0; i <= kPieces; ++i)
    box.extend(curve.point(pose, from + (to - from) * i / kPieces));
  const double piece = (to - from) / kPieces;
  const double sagitta = curve.is_arc() ? piece * piece / (8.0 * curve.radius_m()) : 0.0;
  const Vec3 margin = Vec3::Constant(sagitta + kAhead_m);
  return {box.min() - margin, box.max() + margin};
}

}  // namespace

Vec3 triangle_barycentric(const TissueView& tissue, std::int32_t triangle, const Vec3& p) {
  const auto& t = tissue.surface->triangles[at(triangle)];
  const Vec3 &a = tissue.positions_m[at(t[0])], &b = tissue.positions_m[at(t[1])],
             &c = tissue.positions_m[at(t[2])];
  const Vec3 n = (b - a).cross(c - a);
  const double area = n.squaredNorm();
  const double v = (p - a).cross(c - a).dot(n) / area;
  const double w = (b - a).cross(p - a).dot(n) / area;
  return {1.0 - v - w, v, w};
}

Vec3 position(const TissueView& tissue, const BoundaryPoint& point) {
  const auto& t = tissue.surface->triangles[at(point.triangle)];
  return point.barycentric[0] * tissue.positions_m[at(t[0])] +
         point.barycentric[1] * tissue.positions_m[at(t[1])] +
         point.barycentric[2] * tissue.positions_m[at(t[2])];
}

Vec3 normal(const TissueView& tissue, std::int32_t triangle) {
  const auto& t = tissue.surface->triangles[at(triangle)];
  const Vec3 &a = tissue.positions_m[at(t[0])], &b = tissue.positions_m[at(t[1])],
             &c = tissue.positions_m[at(t[2])];
  return (b - a).cross(c - a).normalized();
}

Path::Path(const Curve& curve, std::uint64_t seed)
    : curve_(curve), seed_(seed), random_(static_cast<std::minstd_rand::result_type>(seed)) {
  cells_.reserve(256);
  crossings_.reserve(64);
}

void Path::serialize(Archive& archive) {
  // The curve and the seed are the scene's; crossings are of one call.
  auto& [curve, seed, random, cells, crossings] = *this;
  auto state = std::bit_cast<std::array<std::byte, sizeof random>>(random);
  archive(state, cells);
  if (archive.reads()) random = std::bit_cast<std::minstd_rand>(state);
}

void Path::clear() {
  cells_.clear();
  random_.seed(static_cast<std::minstd_rand::result_type>(seed_));
}

void Path::drop_first_bite() {
  const auto last = std::find_if(cells_.begin(), cells_.end(),
                                 [](const Cell& cell) { return cell.left.triangle >= 0; });
  if (last != cells_.end()) cells_.erase(cells_.begin(), last + 1);
}

double Path::embedded_length_m() const {
  double sum = 0.0;
  for (const Cell& cell : cells_) sum += cell.active_length_m;
  return sum;
}

Path::Step Path::leave_cell(const TissueView& tissue, const Pose& pose, const Vec3& shift,
                            std::int32_t tet, double from) {
  std::array<double, 4> s;
  double first = std::numeric_limits<double>::infinity();
  for (int face = 0; face < 4; ++face) {
    const auto f = geometry::tet_face(tissue.tets[at(tet)], face);
    const Vec3 &a = tissue.positions_m[at(f[0])], &b = tissue.positions_m[at(f[1])],
               &c = tissue.positions_m[at(f[2])];
    const Vec3 n = (b - a).cross(c - a).normalized();
    s[at(face)] = curve_.leaves_half_space(pose, shift, n, n.dot(a), from)
                      .value_or(std::numeric_limits<double>::infinity());
    first = std::min(first, s[at(face)]);
  }
  std::array<int, 4> tied;
  std::size_t count = 0;
  for (int face = 0; face < 4; ++face)
    if (s[at(face)] <= first + kTie_m) tied[count++] = face;
  const int face = count == 1 ? tied[0] : tied[random_() % count];
  return {s[at(face)], face};
}

std::int32_t Path::tet_around(const TissueView& tissue, std::int32_t tet, const Vec3& p) const {
  constexpr std::size_t kLookedAtMax = 128;
  std::array<std::int32_t, kLookedAtMax> queue;
  std::size_t count = 0;
  queue[count++] = tet;
  for (std::size_t next = 0; next < count; ++next) {
    if (fem::barycentric(tissue.corners(queue[next]), p).minCoeff() >= -1e-9) return queue[next];
    for (const auto other : (*tissue.adjacency)[at(queue[next])])
      if (other >= 0 && count < kLookedAtMax &&
          std::find(queue.begin(), queue.begin() + count, other) == queue.begin() + count)
        queue[count++] = other;
  }
  return -1;
}

void Path::update_active(const TissueView& tissue, const Pose& pose, Cell& cell) const {
  const double back = std::max(cell.s_back, 0.0), front = std::min(cell.s_front, curve_.length_m());
  const double length = std::max(front - back, 0.0), mid = 0.5 * (front + back);
  if (length == 0.0) {
    cell.active_length_m = 0.0;
    return;
  }
  Vec3 residual = Vec3::Zero();
  if (cell.active_length_m > 0.0) {
    if (length == cell.active_length_m && mid == cell.s_mid) return;
    const double before = coupling_length_m(cell);
    residual = tissue.at(cell.tet, cell.barycentric) - curve_.point(pose, cell.s_mid);
    cell.active_length_m = length;
    residual *= std::min(1.0, before / coupling_length_m(cell));
  }
  cell.active_length_m = length;
  cell.s_mid = mid;
  cell.barycentric = fem::barycentric(tissue.corners(cell.tet), curve_.point(pose, mid) + residual);
}

void Path::append(std::int32_t tet, double s) {
  Cell cell;
  cell.tet = tet;
  cell.s_back = cell.s_front = s;
  cells_.push_back(cell);
}

/// Walks the tip from parameter `from` in the last cell to the needle's end.
void Path::walk(const TissueView& tissue, const Pose& pose, Vec3 shift, double from,
                Passage passage) {
  const double length = curve_.length_m();
  int idle = 0;
  for (int count = 0; count < kCellsPerWalkMax; ++count) {
    const std::int32_t tet = cells_.back().tet;
    const Step out = leave_cell(tissue, pose, shift, tet, from);
    if (out.s >= length) break;
    idle = out.s - from < kNoLength_m ? idle + 1 : 0;
    double s = std::max(out.s, cells_.back().s_back);
    std::int32_t next = (*tissue.adjacency)[at(tet)][at(out.face)];
    if (idle > kIdleMax && next >= 0) {
      // The axis lies in faces, and the walk goes round between them: look a little ahead.
      s += kAhead_m;
      if (const auto found = tet_around(tissue, tet, curve_.point(pose, s) + shift); found >= 0)
        next = found;
      idle = 0;
    }
    if (next < 0) {
      const auto triangle = tissue.triangle_of_face[4 * at(tet) + at(out.face)];
      const BoundaryPoint point{
          triangle, triangle_barycentric(tissue, triangle, curve_.point(pose, s) + shift)};
      if (passage == Passage::kClosed) {
        crossings_.push_back({Crossing::Kind::kBlocked, point, s});
        cells_.back().s_front = s;
        return;
      }
      cells_.back().s_front = s;
      cells_.back().left = point;
      crossings_.push_back({Crossing::Kind::kLeft, point, s});
      if (passage == Passage::kOnce) return;
      const auto entry = first_entry(tissue, curve_, pose, s + kAhead_m, length);
      if (!entry) return;
      append(tissue.surface->tet[at(entry->first.triangle)], entry->second);
      cells_.back().entered = entry->first;
      crossings_.push_back({Crossing::Kind::kEntered, entry->first, entry->second});
      from = entry->second;
      shift.setZero();
      continue;
    }
    cells_.back().s_front = s;
    if (s - cells_.back().s_back < kNoLength_m) {
      // A cell passed through in a vertex or an edge only leaves no trace.
      cells_.back().tet = next;
      cells_.back().s_back = cells_.back().s_front = s;
      cells_.back().active_length_m = 0.0;
    } else {
      append(next, s);
    }
    from = s;
  }
  cells_.back().s_front = length;
}

std::span<const Crossing> Path::slide(const TissueView& tissue, const Pose& pose, double slide_m,
                                      Passage passage) {
  crossings_.clear();
  const double length = curve_.length_m();
  for (Cell& cell : cells_) {
    cell.s_back -= slide_m;
    cell.s_front -= slide_m;
    cell.s_mid -= slide_m;
  }
  if (slide_m > 0.0) {
    if (tip_inside()) {
      const Cell& tip = cells_.back();
      const bool known = tip.active_length_m > 0.0;
      const Vec3 shift =
          known ? Vec3(tissue.at(tip.tet, tip.barycentric) - curve_.point(pose, tip.s_mid))
                : Vec3::Zero();
      walk(tissue, pose, shift, known ? tip.s_mid : tip.s_back, passage);
    } else if (passage == Passage::kFree) {
      if (const auto entry = first_entry(tissue, curve_, pose, length - slide_m, length))
        enter_at(tissue, pose, entry->first, entry->second, passage);
    }
  } else {
    while (!cells_.empty()) {
      Cell& tip = cells_.back();
      if (tip.left.triangle >= 0) {
        if (tip.s_front < length) break;  // still outside
        crossings_.push_back({Crossing::Kind::kReturned, tip.left, tip.s_front});
        tip.left = {};
      }
      if (tip.s_back < length) {
        tip.s_front = std::min(tip.s_front, length);  // less where a boundary holds the tip
        break;
      }
      if (tip.entered.triangle >= 0)
        crossings_.push_back({Crossing::Kind::kWithdrawn, tip.entered, tip.s_back});
      cells_.pop_back();
    }
  }
  for (Cell& cell : cells_) update_active(tissue, pose, cell);
  return crossings_;
}

void Path::enter_at(const TissueView& tissue, const Pose& pose, const BoundaryPoint& point,
                    double s, Passage passage) {
  append(tissue.surface->tet[at(point.triangle)], s);
  cells_.back().entered = point;
  crossings_.push_back({Crossing::Kind::kEntered, point, s});
  walk(tissue, pose, position(tissue, point) - curve_.point(pose, s), s, passage);
}

std::span<const Crossing> Path::enter(const TissueView& tissue, const Pose& pose,
                                      const BoundaryPoint& point, double s) {
  crossings_.clear();
  enter_at(tissue, pose, point, std::min(s, curve_.length_m() - kAhead_m), Passage::kClosed);
  for (Cell& cell : cells_) update_active(tissue, pose, cell);
  return crossings_;
}

std::span<const Crossing> Path::leave(const TissueView& tissue, const Pose& pose,
                                      const BoundaryPoint& wall) {
  crossings_.clear();
  const Cell& tip = cells_.back();
  const Vec3 shift = tissue.at(tip.tet, tip.barycentric) - curve_.point(pose, tip.s_mid);
  walk(tissue, pose, shift, tip.s_mid, Passage::kOnce);
  if (tip_inside()) {
    // The tip stands at the wall without being through: it goes out where it stands.
    cells_.back().left = wall;
    crossings_.push_back({Crossing::Kind::kLeft, wall, curve_.length_m()});
  }
  for (Cell& cell : cells_) update_active(tissue, pose, cell);
  return crossings_;
}

std::optional<std::pair<BoundaryPoint, double>> Path::boundary_ahead(const TissueView& tissue,
                                                                     const Pose& pose,
                                                                     double reach_m) {
  if (!tip_inside()) return std::nullopt;
  const Cell& tip = cells_.back();
  const bool known = tip.active_length_m > 0.0;
  const Vec3 shift = known
                         ? Vec3(tissue.at(tip.tet, tip.barycentric) - curve_.point(pose, tip.s_mid))
                         : Vec3::Zero();
  double s = known ? tip.s_mid : tip.s_back;
  std::int32_t tet = tip.tet;
  for (int count = 0; count < kCellsPerWalkMax; ++count) {
    const Step out = leave_cell(tissue, pose, shift, tet, s);
    if (out.s > curve_.length_m() + reach_m) return std::nullopt;
    const auto next = (*tissue.adjacency)[at(tet)][at(out.face)];
    if (next < 0) {
      const auto triangle = tissue.triangle_of_face[4 * at(tet) + at(out.face)];
      return std::pair{
          BoundaryPoint{triangle,
                        triangle_barycentric(tissue, triangle, curve_.point(pose, out.s) + shift)},
          out.s};
    }
    // A walk that goes round between faces has no length, so it is ended by the count.
    if (out.s - s < kNoLength_m && count > 64) return std::nullopt;
    s = out.s;
    tet = next;
  }
  return std::nullopt;
}

std::optional<std::pair<BoundaryPoint, double>> Path::first_entry(const TissueView& tissue,
                                                                  const Curve& curve,
                                                                  const Pose& pose, double from,
                                                                  double to) {
  std::optional<std::pair<BoundaryPoint, double>> best;
  if (to <= from) return best;
  tissue.tree->for_each_overlap(box_of(curve, pose, from, to), [&](std::int32_t triangle) {
    const Vec3 n = normal(tissue, triangle);
    const Vec3& a = tissue.positions_m[at(tissue.surface->triangles[at(triangle)][0])];
    std::array<double, 2> s;
    const int count = curve.meets_plane(pose, n, n.dot(a), from, to, s);
    for (int i = 0; i < count; ++i) {
      if (curve.tangent(pose, s[at(i)]).dot(n) >= 0.0) continue;
      if (best && s[at(i)] >= best->second) continue;
      const Vec3 barycentric = triangle_barycentric(tissue, triangle, curve.point(pose, s[at(i)]));
      if (barycentric.minCoeff() >= -1e-9) best = {{triangle, barycentric}, s[at(i)]};
    }
  });
  return best;
}

}  // namespace sutured::needle
