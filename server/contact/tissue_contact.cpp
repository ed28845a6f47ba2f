// SPDX-License-Identifier: GPL-3.0-or-later
#include "contact/tissue_contact.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace sutured::contact {
namespace {

// A pair is taken in while its gap is below this, what the present motion of its features closes in
// so many steps, and a share of the largest motion of all.
constexpr double kReach_m = 1.1e-5, kClosingSteps = 2.0, kSpeedShare = 0.1;
// No pair is farther apart than the reach: short while all moves slowly; long once anything moved
// by more than a share of the short one in a step, until nothing did for a while.
constexpr double kReachShort_m = 1e-4, kReachLong_m = 4e-4, kReachSpeedShare = 0.3;
constexpr int kSlowSteps = 50;
// What is kept lies within the reach and this.
constexpr double kMargin_m = 2e-4;
// Where nothing is near, how far beyond the reach it is looked for, at least (on a coarse surface,
// an edge's length): the farther it is, the later to look again.
constexpr double kFar_m = 5e-4;
// Deeper than this a vertex is taken to be on another side of the body.
constexpr double kDepthMax_m = 8e-4;
// A pair that is new is no deeper than this and what two steps at the present speed press in.
constexpr double kNewDepth_m = 5e-5;
constexpr double kChoose_m = 2e-6;
// Features face each other beyond this angle.
constexpr double kFacingCosine = -0.3;
// How far outside its feature a nearest point may lie, as a share: new pairs, and those that
// carried force.
constexpr double kOutside = 0.005, kOutsideCarried = 0.05;
// Slope by which a surface may rise above the plane of an edge pair.
constexpr double kRise = 0.05, kRiseCarried = 0.15;
// Edges that bend less than this slope on both sides add nothing to vertices and faces.
constexpr double kFlat = 0.02;
constexpr double kSineMin = 0.05;
// Row compliance times modulus: 2e-5 m/N at 200 kPa.
constexpr double kComplianceTimesModulus = 2e-5 * 2e5;
// How far a row that carries force goes to its pair's present normal in a step.
constexpr double kRelaxation = 0.5;
constexpr double kRestBehind_m = 1e-6;
// Nothing is known of what is near: look at once.
constexpr double kUnknown = -std::numeric_limits<double>::infinity();

std::size_t at(std::int64_t i) { return static_cast<std::size_t>(i); }

bool shares_vertex(const geometry::Triangle& t, std::int32_t v) {
  return t[0] == v || t[1] == v || t[2] == v;
}

}  // namespace

TissueContact::TissueContact(const geometry::BoundarySurface& surface, std::span<const Vec3> rest_m,
                             std::vector<int> tissue_of_triangle,
                             std::vector<double> young_modulus_pa)
    : surface_(&surface),
      features_(surface.triangles, rest_m.size()),
      rest_m_(rest_m.begin(), rest_m.end()),
      tissue_of_triangle_(std::move(tissue_of_triangle)),
      young_modulus_pa_(std::move(young_modulus_pa)),
      normals_(surface.triangles.size()),
      near_vertex_(features_.vertices().size()),
      near_edge_(features_.edges().size()),
      vertex_left_m_(features_.vertices().size()),
      edge_left_m_(features_.edges().size()),
      vertex_clear_(features_.vertices().size()),
      edge_clear_(features_.edges().size()) {
  for (const SurfaceEdge& edge : features_.edges())
    edge_length_m_ += (rest_m_[at(edge.vertices[0])] - rest_m_[at(edge.vertices[1])]).norm();
  edge_length_m_ /= static_cast<double>(std::max<std::size_t>(1, features_.edges().size()));
  far_m_ = std::max(kFar_m, edge_length_m_);
  renew_normals(rest_m_);
  rest_normals_ = normals_;
  reset();
}

void TissueContact::reset() {
  std::fill(vertex_left_m_.begin(), vertex_left_m_.end(), kUnknown);
  std::fill(edge_left_m_.begin(), edge_left_m_.end(), kUnknown);
  std::fill(vertex_clear_.begin(), vertex_clear_.end(), far_m_);
  std::fill(edge_clear_.begin(), edge_clear_.end(), far_m_);
  for (auto& list : near_vertex_) list.clear();
  for (auto& list : near_edge_) list.clear();
  close_vertices_.clear();
  close_edges_.clear();
  pairs_.clear();
  known_.clear();
  last_m_.clear();
  moved_m_.assign(rest_m_.size(), Vec3::Zero());
  way_m_.assign(rest_m_.size(), 0.0);
  motion_m_ = speed_m_ = 0.0;
  reach_m_ = kReachShort_m;
  slow_steps_ = 0;
  chosen_at_m_ = -1.0;
}

void TissueContact::serialize(Archive& archive) {
  // Given by the scene: surface … far. Of one call, or made anew at the start of one: normals,
  // way, cones, known, first_row.
  auto& [surface, features, rest, rest_normals, tissue_of_triangle, young_modulus, edge_length, far,
         last, normals, reach, slow_steps, moved, way, motion, chosen_at, speed, cones, near_vertex,
         near_edge, vertex_left, edge_left, vertex_clear, edge_clear, close_vertices, close_edges,
         pairs, known, first_row] = *this;
  if (archive.reads()) reset();
  archive(last, reach, slow_steps, motion, chosen_at, speed, pairs);
  archive.fixed(moved);
  if (archive.keeps_caches()) {
    archive.fixed(near_vertex);
    archive.fixed(near_edge);
    archive.fixed(vertex_left);
    archive.fixed(edge_left);
    archive.fixed(vertex_clear);
    archive.fixed(edge_clear);
  }
  if (archive.reads()) list_close();
}

const Pair* TissueContact::known(std::uint64_t key) const {
  const auto found =
      std::lower_bound(known_.begin(), known_.end(), key,
                       [](const Pair& pair, std::uint64_t k) { return pair.key() < k; });
  return found != known_.end() && found->key() == key ? &*found : nullptr;
}

/// Whether a pair that is near may be taken in: only one that was known may be deep.
bool TissueContact::admit(Pair& pair) const {
  const Proximity& p = pair.proximity;
  if (!p.valid || p.gap_m < -kDepthMax_m || p.gap_m > reach_m_) return false;
  double closing_m = 0.0;
  for (std::size_t i = 0; i < 4; ++i)
    closing_m -= p.coefficient[i] * p.normal.dot(moved_m_[at(pair.vertices[i])]);
  if (p.gap_m > kReach_m + kClosingSteps * std::max(closing_m, 0.0) + kSpeedShare * speed_m_)
    return false;
  const Pair* const before = known(pair.key());
  if (before == nullptr && p.gap_m < -(kNewDepth_m + 2.0 * speed_m_)) return false;
  if (before != nullptr) {
    pair.force_n = before->force_n;
    pair.normal = before->normal;
    pair.coefficient = before->coefficient;
  }
  return p.margin >= -(pair.force_n > 0.0 ? kOutsideCarried : kOutside);
}

/// Whether the vertex lies behind the triangle at rest already, on the other side of the wall.
bool TissueContact::through_solid(std::int32_t vertex, std::int32_t triangle) const {
  const Vec3& corner_m = rest_m_[at(surface_->triangles[at(triangle)][0])];
  // Not: a triangle without an area has no normal, and no other side.
  return !(rest_normals_[at(triangle)].dot(rest_m_[at(vertex)] - corner_m) >= -kRestBehind_m);
}

Vec3 TissueContact::edge_normal(const SurfaceEdge& edge) const {
  Vec3 sum = normals_[at(edge.triangles[0])];
  if (edge.triangles[1] >= 0) sum += normals_[at(edge.triangles[1])];
  return sum;
}

std::int32_t TissueContact::triangle_of(const Pair& pair, bool second) const {
  const std::int32_t feature = second ? pair.second : pair.first;
  if (pair.kind == PairKind::kEdgeEdge) return features_.edges()[at(feature)].triangles[0];
  return second ? feature : features_.triangles_at(feature)[0];
}

int TissueContact::tissue_of(const Pair& pair, bool second) const {
  return tissue_of_triangle_[at(triangle_of(pair, second))];
}

void TissueContact::renew_normals(std::span<const Vec3> positions_m) {
  const auto& triangles = surface_->triangles;
  for (std::size_t t = 0; t < triangles.size(); ++t) {
    const Vec3 &a = positions_m[at(triangles[t][0])], &b = positions_m[at(triangles[t][1])],
               &c = positions_m[at(triangles[t][2])];
    normals_[t] = (b - a).cross(c - a).normalized();
  }
}

/// Returns the directions that face one of `triangles`.
geometry::OpposingDirections TissueContact::opposing(
    std::span<const std::int32_t> triangles) const {
  const auto normal = [&](std::size_t i) -> const Vec3& { return normals_[at(triangles[i])]; };
  return {geometry::DirectionCone::around(triangles.size(), normal), kFacingCosine};
}

/// Visits (triangle, distance from it) where the surface faces `vertex` in the box of `radius_m`.
template <typename Visit>
void TissueContact::for_each_facing(std::int32_t vertex, double radius_m,
                                    std::span<const Vec3> positions_m,
                                    const geometry::TriangleTree& tree, Visit&& visit) const {
  const auto& triangles = surface_->triangles;
  const Vec3& x = positions_m[at(vertex)];
  const Vec3 half = Vec3::Constant(radius_m);
  const auto own = features_.triangles_at(vertex);
  tree.for_each_opposing({x - half, x + half}, cones_, opposing(own), [&](std::int32_t t) {
    const auto& corners = triangles[at(t)];
    if (shares_vertex(corners, vertex)) return;
    const Vec3& n = normals_[at(t)];
    if (std::none_of(own.begin(), own.end(),
                     [&](auto mine) { return normals_[at(mine)].dot(n) < kFacingCosine; }))
      return;
    const bool self = tissue_of_triangle_[at(own[0])] == tissue_of_triangle_[at(t)];
    if (self && through_solid(vertex, t)) return;
    const auto closest = geometry::closest_point_on_triangle(
        x, positions_m[at(corners[0])], positions_m[at(corners[1])], positions_m[at(corners[2])]);
    visit(t, std::sqrt(closest.squared_distance_m2));
  });
}

std::vector<std::int32_t> TissueContact::facing_vertices(std::span<const Vec3> positions_m,
                                                         const geometry::TriangleTree& tree,
                                                         double distance_m) {
  renew_normals(positions_m);
  tree.fit_cones(normals_, cones_);
  std::vector<std::pair<double, std::int32_t>> found;
  for (const std::int32_t v : features_.vertices()) {
    double nearest = std::numeric_limits<double>::infinity();
    for_each_facing(v, distance_m, positions_m, tree,
                    [&](std::int32_t, double d) { nearest = std::min(nearest, d); });
    if (nearest <= distance_m) found.emplace_back(nearest, v);
  }
  std::sort(found.begin(), found.end());
  std::vector<std::int32_t> vertices;
  for (const auto& [_, v] : found) vertices.push_back(v);
  return vertices;
}

void TissueContact::search(std::span<const Vec3> positions_m, const geometry::TriangleTree& tree) {
  const double kept = reach_m_ + kMargin_m;
  // A little farther than what was clear when it was last looked: surfaces that come closer are
  // looked for in ever smaller boxes.
  const double near = kMargin_m + 0.25 * edge_length_m_;
  const auto look_for = [&](double clear) {
    return reach_m_ + std::clamp(1.2 * clear, near, std::max(near, far_m_));
  };
  // Those that all looked at once do not all look again at once.
  const auto share = [](std::size_t i, double left) {
    return left == kUnknown ? 0.5 + 0.5 * static_cast<double>((i * 2654435761U) % 1024U) / 1024.0
                            : 1.0;
  };
  const auto vertices = features_.vertices();
  const auto facing = [&](std::int32_t a, std::int32_t b) {
    return normals_[at(a)].dot(normals_[at(b)]) < kFacingCosine;
  };
  // Features of one smooth surface do not face each other: most of the tree is passed over.
  const auto due = [&](const std::vector<double>& left_m) {
    return std::any_of(left_m.begin(), left_m.end(), [](double left) { return left <= 0.0; });
  };
  if (!due(vertex_left_m_) && !due(edge_left_m_)) return;
  tree.fit_cones(normals_, cones_);
  bool changed = false;
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    if (vertex_left_m_[i] > 0.0) continue;
    changed = true;
    near_vertex_[i].clear();
    const double within = look_for(vertex_clear_[i]);
    double nearest = within;
    for_each_facing(vertices[i], within, positions_m, tree, [&](std::int32_t t, double distance) {
      if (distance <= kept) near_vertex_[i].push_back(t);
      nearest = std::min(nearest, distance);
    });
    vertex_clear_[i] = near_vertex_[i].empty() ? nearest - reach_m_ : kMargin_m;
    vertex_left_m_[i] = share(i, vertex_left_m_[i]) * vertex_clear_[i];
    std::sort(near_vertex_[i].begin(), near_vertex_[i].end());
  }
  const auto edges = features_.edges();
  for (std::size_t i = 0; i < edges.size(); ++i) {
    if (edge_left_m_[i] > 0.0) continue;
    changed = true;
    const SurfaceEdge& edge = edges[i];
    const Vec3 &a = positions_m[at(edge.vertices[0])], &b = positions_m[at(edge.vertices[1])];
    near_edge_[i].clear();
    const std::span<const std::int32_t> own(edge.triangles.data(), edge.triangles[1] >= 0 ? 2 : 1);
    const double within = look_for(edge_clear_[i]);
    double nearest = within;
    const Vec3 half = Vec3::Constant(within);
    const geometry::Box box(a.cwiseMin(b) - half, a.cwiseMax(b) + half);
    tree.for_each_opposing(box, cones_, opposing(own), [&](std::int32_t t) {
      if (!facing(edge.triangles[0], t) &&
          !(edge.triangles[1] >= 0 && facing(edge.triangles[1], t)))
        return;
      const bool self = tissue_of_triangle_[at(edge.triangles[0])] == tissue_of_triangle_[at(t)];
      if (self && through_solid(edge.vertices[0], t)) return;
      for (const auto f : features_.edges_of(t)) {
        if (f <= static_cast<std::int32_t>(i)) continue;  // each pair once
        const SurfaceEdge& other = edges[at(f)];
        if (shares_vertex({other.vertices[0], other.vertices[1], -1}, edge.vertices[0]) ||
            shares_vertex({other.vertices[0], other.vertices[1], -1}, edge.vertices[1]))
          continue;
        // A lower bound of the distance suffices here.
        const Vec3 &c = positions_m[at(other.vertices[0])], &d = positions_m[at(other.vertices[1])];
        const double distance = geometry::Box(a.cwiseMin(b), a.cwiseMax(b))
                                    .exteriorDistance(geometry::Box(c.cwiseMin(d), c.cwiseMax(d)));
        if (distance <= kept) near_edge_[i].push_back(f);
        nearest = std::min(nearest, distance);
      }
    });
    edge_clear_[i] = near_edge_[i].empty() ? nearest - reach_m_ : kMargin_m;
    edge_left_m_[i] = share(i, edge_left_m_[i]) * edge_clear_[i];
    std::sort(near_edge_[i].begin(), near_edge_[i].end());
    near_edge_[i].erase(std::unique(near_edge_[i].begin(), near_edge_[i].end()),
                        near_edge_[i].end());
  }
  if (changed) list_close();
}

/// Lists the features that have candidates.
void TissueContact::list_close() {
  close_vertices_.clear();
  close_edges_.clear();
  for (std::size_t i = 0; i < near_vertex_.size(); ++i)
    if (!near_vertex_[i].empty()) close_vertices_.push_back(i);
  for (std::size_t i = 0; i < near_edge_.size(); ++i)
    if (!near_edge_[i].empty()) close_edges_.push_back(i);
}

void TissueContact::choose_vertex(std::int32_t vertex, std::span<const std::int32_t> triangles,
                                  std::span<const Vec3> positions_m) {
  const std::size_t first = pairs_.size();
  double shallowest = -kDepthMax_m;
  for (const std::int32_t t : triangles) {
    const auto own = features_.triangles_at(vertex);
    const Vec3& n = normals_[at(t)];
    if (std::none_of(own.begin(), own.end(),
                     [&](auto mine) { return normals_[at(mine)].dot(n) < kFacingCosine; }))
      continue;
    Pair pair;
    pair.kind = PairKind::kVertexFace;
    pair.first = vertex;
    pair.second = t;
    const auto& corners = surface_->triangles[at(t)];
    pair.vertices = {vertex, corners[0], corners[1], corners[2]};
    renew(pair, positions_m);
    if (!admit(pair)) continue;
    if (pair.proximity.gap_m < 0.0) shallowest = std::max(shallowest, pair.proximity.gap_m);
    pairs_.push_back(pair);
  }
  // Behind several faces, the vertex has come in through the nearest.
  const auto deeper = [&](const Pair& pair) { return pair.proximity.gap_m < shallowest; };
  pairs_.erase(
      std::remove_if(pairs_.begin() + static_cast<std::ptrdiff_t>(first), pairs_.end(), deeper),
      pairs_.end());
}

void TissueContact::choose_edge(std::int32_t index, std::span<const std::int32_t> others,
                                std::span<const Vec3> positions_m) {
  const auto edges = features_.edges();
  const SurfaceEdge& edge = edges[at(index)];
  for (const std::int32_t f : others) {
    const SurfaceEdge& other = edges[at(f)];
    Pair pair;
    pair.kind = PairKind::kEdgeEdge;
    pair.first = index;
    pair.second = f;
    pair.vertices = {edge.vertices[0], edge.vertices[1], other.vertices[0], other.vertices[1]};
    renew(pair, positions_m);
    if (!admit(pair)) continue;
    // Around each crossing its own surface stays behind the plane across the normal.
    const double rise = pair.force_n > 0.0 ? kRiseCarried : kRise;
    double sharpest = 0.0;  // how far either surface falls away from its edge
    const auto behind = [&](const SurfaceEdge& e, const Vec3& normal, double sign) {
      const Vec3& origin = positions_m[at(e.vertices[0])];
      const Vec3 along = (positions_m[at(e.vertices[1])] - origin).normalized();
      for (std::size_t k = 0; k < 2; ++k) {
        if (e.opposite[k] < 0) continue;
        Vec3 out = positions_m[at(e.opposite[k])] - origin;
        out -= along * along.dot(out);
        const double slope = sign * normal.dot(out) / out.norm();
        if (slope > rise) return false;
        sharpest = std::max(sharpest, -slope);
      }
      return true;
    };
    const Vec3& n = pair.proximity.normal;
    if (!behind(edge, n, 1.0) || !behind(other, n, -1.0)) continue;
    // Between two surfaces that are flat here the vertices say it all.
    if (sharpest < kFlat && pair.force_n <= 0.0) continue;
    pairs_.push_back(pair);
  }
}

void TissueContact::renew(Pair& pair, std::span<const Vec3> x) const {
  const auto& v = pair.vertices;
  if (pair.kind == PairKind::kVertexFace) {
    pair.proximity = vertex_face(x[at(v[0])], x[at(v[1])], x[at(v[2])], x[at(v[3])]);
    return;
  }
  const Vec3 outward = edge_normal(features_.edges()[at(pair.first)]) -
                       edge_normal(features_.edges()[at(pair.second)]);
  pair.proximity = edge_edge(x[at(v[0])], x[at(v[1])], x[at(v[2])], x[at(v[3])], outward, kSineMin);
}

void TissueContact::choose(std::span<const Vec3> positions_m) {
  known_.swap(pairs_);
  std::sort(known_.begin(), known_.end(),
            [](const Pair& a, const Pair& b) { return a.key() < b.key(); });
  pairs_.clear();
  for (const std::size_t i : close_vertices_)
    choose_vertex(features_.vertices()[i], near_vertex_[i], positions_m);
  for (const std::size_t i : close_edges_)
    choose_edge(static_cast<std::int32_t>(i), near_edge_[i], positions_m);
  chosen_at_m_ = motion_m_;
}

/// Notes what moved since the last update, and what that leaves to each feature until it looks.
void TissueContact::note_motion(std::span<const Vec3> positions_m) {
  const auto vertices = features_.vertices();
  if (last_m_.empty()) {
    for (const auto v : vertices) last_m_.push_back(positions_m[at(v)]);
    return;
  }
  speed_m_ = 0.0;
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    const auto v = at(vertices[i]);
    moved_m_[v] = positions_m[v] - last_m_[i];
    last_m_[i] = positions_m[v];
    way_m_[v] = moved_m_[v].norm();
    speed_m_ = std::max(speed_m_, way_m_[v]);
  }
  motion_m_ += speed_m_;
  // It comes closer to another by no more than both ways: no point of an edge moves farther than
  // one of its ends.
  for (std::size_t i = 0; i < vertices.size(); ++i)
    vertex_left_m_[i] -= speed_m_ + way_m_[at(vertices[i])];
  const auto edges = features_.edges();
  for (std::size_t i = 0; i < edges.size(); ++i)
    edge_left_m_[i] -=
        speed_m_ + std::max(way_m_[at(edges[i].vertices[0])], way_m_[at(edges[i].vertices[1])]);

  if (reach_m_ < kReachLong_m && speed_m_ > kReachSpeedShare * kReachShort_m) {
    for (double& left_m : vertex_left_m_) left_m -= kReachLong_m - reach_m_;
    for (double& left_m : edge_left_m_) left_m -= kReachLong_m - reach_m_;
    reach_m_ = kReachLong_m;
  }
  // What is known of the long reach holds for the short one too.
  slow_steps_ = speed_m_ < 0.5 * kReachSpeedShare * kReachShort_m ? slow_steps_ + 1 : 0;
  if (slow_steps_ > kSlowSteps) reach_m_ = kReachShort_m;
}

void TissueContact::update(std::span<const Vec3> positions_m, const geometry::TriangleTree& tree) {
  note_motion(positions_m);
  renew_normals(positions_m);
  search(positions_m, tree);
  if (chosen_at_m_ < 0.0 || motion_m_ - chosen_at_m_ > kChoose_m) {
    choose(positions_m);
  } else {
    for (Pair& pair : pairs_) renew(pair, positions_m);
  }
  for (Pair& pair : pairs_) follow(pair);
}

void TissueContact::follow(Pair& pair) {
  const Proximity& now = pair.proximity;
  const double share = pair.force_n > 0.0 ? kRelaxation : 1.0;
  pair.normal = ((1.0 - share) * pair.normal + share * now.normal).normalized();
  for (std::size_t i = 0; i < 4; ++i)
    pair.coefficient[i] = std::lerp(pair.coefficient[i], now.coefficient[i], share);
}

double TissueContact::softer_modulus_pa(const Pair& pair) const {
  return std::min(young_modulus_pa_[at(triangle_of(pair, false))],
                  young_modulus_pa_[at(triangle_of(pair, true))]);
}

void TissueContact::add_rows(constraints::ConstraintRows& rows) {
  first_row_ = rows.size();
  for (const Pair& pair : pairs_) {
    constraints::Row& row = rows.add(constraints::Bounds::unilateral(), kThickness_m,
                                     kComplianceTimesModulus / softer_modulus_pa(pair));
    row.key = pair.key();
    for (std::size_t i = 0; i < 4; ++i)
      rows.touch(pair.vertices[i], pair.coefficient[i] * pair.normal);
  }
}

void TissueContact::read(std::span<const double> lambda) {
  for (std::size_t i = 0; i < pairs_.size(); ++i) pairs_[i].force_n = lambda[at(first_row_) + i];
}

}  // namespace sutured::contact
