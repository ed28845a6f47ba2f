// SPDX-License-Identifier: GPL-3.0-or-later
#include "support/penetration.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <numeric>
#include <stdexcept>
#include <utility>
#include <vector>

namespace sutured::testing {
namespace {

using geometry::Tet;
using geometry::Triangle;
using geometry::Vec3;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kTouching = 1e-9;     // of the model's diagonal
constexpr double kBarycentric = 1e-9;  // so that no point falls between two tets
constexpr double kEdgeShare = 1e-6;    // to which the deepest point of an edge is found

std::size_t at(std::int64_t i) { return static_cast<std::size_t>(i); }

struct Box {
  Vec3 low = Vec3::Constant(kInfinity), high = Vec3::Constant(-kInfinity);
  void add(const Vec3& p) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  [[nodiscard]] bool meets(const Box& other) const {
    return (low.array() <= other.high.array()).all() && (other.low.array() <= high.array()).all();
  }
};

/// Boxes sorted into the cells of a regular grid.
class Grid {
 public:
  explicit Grid(std::vector<Box> boxes) : boxes_(std::move(boxes)) {
    Box all;
    Vec3 mean = Vec3::Zero();
    for (const Box& box : boxes_) {
      all.add(box.low);
      all.add(box.high);
      mean += (box.high - box.low) / static_cast<double>(boxes_.size());
    }
    low_ = all.low;
    const Vec3 extent = all.high - all.low;
    cell_m_ = std::max({mean.maxCoeff(), extent.maxCoeff() / kCellsMax, 1e-300});
    for (int k = 0; k < 3; ++k) count_[at(k)] = static_cast<int>(extent[k] / cell_m_) + 1;
    first_.assign(at(count_[0]) * at(count_[1]) * at(count_[2]) + 1, 0);
    for (const Box& box : boxes_) for_cells(box, [&](std::size_t cell) { ++first_[cell + 1]; });
    std::partial_sum(first_.begin(), first_.end(), first_.begin());
    item_.resize(at(first_.back()));
    std::vector<std::int32_t> next(first_.begin(), first_.end() - 1);
    for (std::size_t i = 0; i < boxes_.size(); ++i)
      for_cells(boxes_[i],
                [&](std::size_t cell) { item_[at(next[cell]++)] = static_cast<std::int32_t>(i); });
    met_.assign(boxes_.size(), 0);
  }

  /// Calls `use(item)` once for every item whose box meets `box`.
  template <typename Use>
  void for_each(const Box& box, Use&& use) {
    ++round_;
    for_cells(box, [&](std::size_t cell) {
      for (auto i = first_[cell]; i < first_[cell + 1]; ++i) {
        const std::int32_t item = item_[at(i)];
        if (std::exchange(met_[at(item)], round_) == round_) continue;
        if (boxes_[at(item)].meets(box)) use(item);
      }
    });
  }

  /// Returns the least `distance(item)` (infinite: not asked for) and its item, given that it is
  /// never less than that to the item's box.
  template <typename Distance>
  std::pair<double, std::int32_t> nearest(const Vec3& p, Distance&& distance) {
    ++round_;
    std::pair<double, std::int32_t> best{kInfinity, -1};
    const std::array<int, 3> home{cell_of(p, 0), cell_of(p, 1), cell_of(p, 2)};
    const int rings = std::max({count_[0], count_[1], count_[2]});
    for (int ring = 0; ring <= rings; ++ring) {
      for (int k = home[2] - ring; k <= home[2] + ring; ++k)
        for (int j = home[1] - ring; j <= home[1] + ring; ++j) {
          const bool whole = std::abs(k - home[2]) == ring || std::abs(j - home[1]) == ring;
          for (int i = home[0] - ring; i <= home[0] + ring; i += whole || ring == 0 ? 1 : 2 * ring)
            if (i >= 0 && j >= 0 && k >= 0 && i < count_[0] && j < count_[1] && k < count_[2])
              for (auto n = first_[cell(i, j, k)]; n < first_[cell(i, j, k) + 1]; ++n) {
                const std::int32_t item = item_[at(n)];
                if (std::exchange(met_[at(item)], round_) == round_) continue;
                if (const double d = distance(item); d < best.first) best = {d, item};
              }
        }
      if (best.first <= ring * cell_m_) break;  // all nearer ones lie in cells that were visited
    }
    return best;
  }

 private:
  static constexpr int kCellsMax = 64;  // along an axis

  [[nodiscard]] int cell_of(const Vec3& p, int axis) const {
    const double cell = (p[axis] - low_[axis]) / cell_m_;
    return static_cast<int>(std::clamp(cell, 0.0, static_cast<double>(count_[at(axis)] - 1)));
  }
  [[nodiscard]] std::size_t cell(int i, int j, int k) const {
    return at(i) + at(count_[0]) * (at(j) + at(count_[1]) * at(k));
  }
  template <typename Use>
  void for_cells(const Box& box, Use&& use) const {
    for (int k = cell_of(box.low, 2); k <= cell_of(box.high, 2); ++k)
      for (int j = cell_of(box.low, 1); j <= cell_of(box.high, 1); ++j)
        for (int i = cell_of(box.low, 0); i <= cell_of(box.high, 0); ++i) use(cell(i, j, k));
  }

  std::vector<Box> boxes_;
  Vec3 low_;
  double cell_m_ = 0.0;
  std::array<int, 3> count_{};
  std::vector<std::int32_t> first_, item_;
  std::vector<std::int64_t> met_;  // in which round an item was last seen
  std::int64_t round_ = 0;
};

double distance_to_segment(const Vec3& p, const Vec3& a, const Vec3& b) {
  const Vec3 along = b - a;
  const double length2 = along.squaredNorm();
  const double t = length2 > 0.0 ? std::clamp((p - a).dot(along) / length2, 0.0, 1.0) : 0.0;
  return (p - a - t * along).norm();
}

/// Where the foot of the perpendicular lies within the triangle, its length; else the nearest side.
double distance_to_triangle(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) {
  const Vec3 normal = (b - a).cross(c - a);
  const double sides[] = {normal.cross(b - a).dot(p - a), normal.cross(c - b).dot(p - b),
                          normal.cross(a - c).dot(p - c)};
  if (normal.squaredNorm() > 0.0 && sides[0] >= 0.0 && sides[1] >= 0.0 && sides[2] >= 0.0)
    return std::abs(normal.dot(p - a)) / normal.norm();
  return std::min(
      {distance_to_segment(p, a, b), distance_to_segment(p, b, c), distance_to_segment(p, c, a)});
}

/// A surface vertex (both corners the same) or a surface edge.
using Edge = std::array<std::int32_t, 2>;

class Model {
 public:
  Model(std::span<const Vec3> positions_m, std::span<const Tet> tets)
      : x_(positions_m),
        tets_(tets),
        tissue_(part_of_tet()),
        surface_(boundary()),
        tet_grid_(boxes(tets_)) {
    Box all;
    for (const Vec3& x : x_) all.add(x);
    touching_m_ = kTouching * (all.high - all.low).norm();
    for (const auto& triangles : surface_) surface_grid_.emplace_back(boxes<Triangle>(triangles));
  }

  Penetration measure() {
    Penetration result;
    std::vector<Edge> vertices, edges;
    for (const auto& triangles : surface_)
      for (const Triangle& triangle : triangles)
        for (std::size_t i = 0; i < 3; ++i) {
          const auto [a, b] = std::minmax(triangle[i], triangle[(i + 1) % 3]);
          vertices.push_back({a, a});
          vertices.push_back({b, b});
          edges.push_back({a, b});
        }
    const auto measure = [&](std::vector<Edge>& of, int& count, double& depth_m) {
      std::sort(of.begin(), of.end());
      of.erase(std::unique(of.begin(), of.end()), of.end());
      for (const Edge& edge : of) {
        const double deep_m = depth(edge);
        count += deep_m > touching_m_;
        if (deep_m > touching_m_) depth_m = std::max(depth_m, deep_m);
      }
    };
    measure(vertices, result.vertices, result.vertex_depth_m);
    measure(edges, result.edges, result.edge_depth_m);
    return result;
  }

 private:
  struct Part {
    int tissue;
    double begin, end;  // in shares of the edge
  };

  template <typename Corners>
  std::vector<Box> boxes(std::span<const Corners> of) const {
    std::vector<Box> result(of.size());
    for (std::size_t i = 0; i < of.size(); ++i)
      for (const std::int32_t v : of[i]) result[i].add(x_[at(v)]);
    return result;
  }

  [[nodiscard]] std::vector<int> part_of_tet() const {
    std::vector<std::int32_t> parent(x_.size());
    std::iota(parent.begin(), parent.end(), 0);
    const auto root = [&](std::int32_t v) {
      while (parent[at(v)] != v) v = parent[at(v)] = parent[at(parent[at(v)])];
      return v;
    };
    for (const Tet& tet : tets_)
      for (const std::int32_t v : tet) parent[at(root(v))] = root(tet[0]);
    std::map<std::int32_t, int> number;
    std::vector<int> result;
    for (const Tet& tet : tets_)
      result.push_back(
          number.try_emplace(root(tet[0]), static_cast<int>(number.size())).first->second);
    return result;
  }

  /// Per tissue, the faces that one tet uses.
  [[nodiscard]] std::vector<std::vector<Triangle>> boundary() const {
    std::vector<std::pair<Triangle, int>> faces;
    for (std::size_t t = 0; t < tets_.size(); ++t)
      for (std::size_t left_out = 0; left_out < 4; ++left_out) {
        Triangle face{};
        for (std::size_t i = 0, n = 0; i < 4; ++i)
          if (i != left_out) face[n++] = tets_[t][i];
        std::sort(face.begin(), face.end());
        faces.emplace_back(face, tissue_[t]);
      }
    std::sort(faces.begin(), faces.end());
    std::vector<std::vector<Triangle>> result;
    for (std::size_t i = 0, j = 0; i < faces.size(); i = j) {
      while (j < faces.size() && faces[j].first == faces[i].first) ++j;
      if (result.size() <= at(faces[i].second)) result.resize(at(faces[i].second) + 1);
      if (j == i + 1) result[at(faces[i].second)].push_back(faces[i].first);
    }
    return result;
  }

  /// Returns the part of the edge within a tet, if any: that where no barycentric coordinate is
  /// negative. Each is linear along the edge.
  [[nodiscard]] bool cut(const Edge& edge, const Tet& tet, double& begin, double& end) const {
    const Vec3 &a = x_[at(tet[0])], &b = x_[at(tet[1])], &c = x_[at(tet[2])], &d = x_[at(tet[3])];
    const auto volume = [](const Vec3& p, const Vec3& q, const Vec3& r, const Vec3& s) {
      return (q - p).dot((r - p).cross(s - p));
    };
    const double whole = volume(a, b, c, d);
    if (whole == 0.0) return false;
    begin = 0.0;
    end = 1.0;
    const Vec3 &p = x_[at(edge[0])], &q = x_[at(edge[1])];
    const std::array<std::array<double, 2>, 4> share{
        {{volume(p, b, c, d) / whole, volume(q, b, c, d) / whole},
         {volume(a, p, c, d) / whole, volume(a, q, c, d) / whole},
         {volume(a, b, p, d) / whole, volume(a, b, q, d) / whole},
         {volume(a, b, c, p) / whole, volume(a, b, c, q) / whole}}};
    for (const auto& [first, last] : share) {
      const double from = first + kBarycentric, to = last + kBarycentric;
      if (from < 0.0 && to < 0.0) return false;
      if (from < 0.0) begin = std::max(begin, from / (from - to));
      if (to < 0.0) end = std::min(end, from / (from - to));
    }
    return begin <= end;
  }

  [[nodiscard]] double distance(const Vec3& p, const Triangle& triangle) const {
    return distance_to_triangle(p, x_[at(triangle[0])], x_[at(triangle[1])], x_[at(triangle[2])]);
  }

  template <typename Corners>
  static bool share_a_vertex(const Edge& edge, const Corners& corners) {
    return std::find_first_of(corners.begin(), corners.end(), edge.begin(), edge.end()) !=
           corners.end();
  }

  /// The depth of an edge, or of a vertex.
  double depth(const Edge& edge) {
    Box box;
    for (const std::int32_t v : edge) box.add(x_[at(v)]);
    parts_.clear();
    tet_grid_.for_each(box, [&](std::int32_t t) {
      Part part{tissue_[at(t)], 0.0, 1.0};
      if (!share_a_vertex(edge, tets_[at(t)]) && cut(edge, tets_[at(t)], part.begin, part.end))
        parts_.push_back(part);
    });
    double deepest_m = 0.0;
    for (const Part& part : parts_) deepest_m = std::max(deepest_m, depth(edge, part, deepest_m));
    return deepest_m;
  }

  struct Sample {
    double at;
    Vec3 point_m;
    double depth_m;
    std::int32_t triangle;  // the nearest
  };

  /// The depth of a part of an edge; whatever is less than `known_m` is as good as `known_m`.
  double depth(const Edge& edge, const Part& part, double known_m) {
    const Vec3 &p = x_[at(edge[0])], &q = x_[at(edge[1])];
    const double length_m = (q - p).norm();
    const auto& triangles = surface_[at(part.tissue)];
    const auto sample = [&](double share) {
      const Vec3 point_m = p + share * (q - p);
      const auto [depth_m, triangle] =
          surface_grid_[at(part.tissue)].nearest(point_m, [&](std::int32_t i) {
            return share_a_vertex(edge, triangles[at(i)]) ? kInfinity
                                                          : distance(point_m, triangles[at(i)]);
          });
      return triangle < 0 ? Sample{share, point_m, 0.0, -1}  // all of the tissue is around the edge
                          : Sample{share, point_m, depth_m, triangle};
    };
    double deepest_m = known_m;
    std::vector<std::pair<Sample, Sample>> open{{sample(part.begin), sample(part.end)}};
    while (!open.empty()) {
      const auto [a, b] = open.back();
      open.pop_back();
      deepest_m = std::max({deepest_m, a.depth_m, b.depth_m});
      if (a.triangle < 0 || b.triangle < 0) continue;
      double bound_m = 0.5 * (a.depth_m + b.depth_m + (b.at - a.at) * length_m);
      for (const std::int32_t triangle : {a.triangle, b.triangle})
        bound_m = std::min(bound_m, std::max(distance(a.point_m, triangles[at(triangle)]),
                                             distance(b.point_m, triangles[at(triangle)])));
      if (bound_m <= deepest_m + kEdgeShare * length_m) continue;
      const Sample middle = sample(0.5 * (a.at + b.at));
      open.emplace_back(a, middle);
      open.emplace_back(middle, b);
    }
    return deepest_m;
  }

  std::span<const Vec3> x_;
  std::span<const Tet> tets_;
  std::vector<int> tissue_;                     // per tet
  std::vector<std::vector<Triangle>> surface_;  // per tissue
  Grid tet_grid_;
  std::vector<Grid> surface_grid_;
  double touching_m_ = 0.0;
  std::vector<Part> parts_;
};

}  // namespace

Penetration measure_penetration(std::span<const Vec3> positions_m, std::span<const Tet> tets) {
  for (const Vec3& x : positions_m)
    if (!x.allFinite()) throw std::invalid_argument("a position is not finite");
  return tets.empty() ? Penetration() : Model(positions_m, tets).measure();
}

}  // namespace sutured::testing
