// SPDX-License-Identifier: GPL-3.0-or-later
#include "scene/tissue_binder.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <limits>
#include <map>
#include <set>
#include <utility>

#include "geometry/closest_point.hpp"
#include "scene/physical_ranges.hpp"
#include "scene/rigid_motions.hpp"

namespace sutured::scene {

using geometry::PhysicalGroup;
using geometry::Triangle;

namespace {

std::string vector_text(const Vec3& x) {
  std::array<char, 96> text{};
  std::snprintf(text.data(), text.size(), "[%.4g, %.4g, %.4g]", x.x(), x.y(), x.z());
  return text.data();
}

Triangle sorted(Triangle triangle) {
  std::sort(triangle.begin(), triangle.end());
  return triangle;
}

// Adds up forces by vertex.
class LoadSum {
 public:
  void add(std::int32_t vertex, const Vec3& force_n) {
    sum_.try_emplace(vertex, Vec3::Zero()).first->second += force_n;
  }
  [[nodiscard]] NodalLoad load() const {
    NodalLoad load;
    for (const auto& [vertex, force_n] : sum_) {
      load.vertices.push_back(vertex);
      load.force_n.push_back(force_n);
    }
    return load;
  }

 private:
  std::map<std::int32_t, Vec3> sum_;
};

}  // namespace

TissueBinder::TissueBinder(Tissue& tissue, Faults& faults)
    : tissue_(tissue),
      faults_(faults),
      title_("tissue \"" + tissue.name + "\""),
      faults_before_(faults.size()),
      adjacency_(geometry::tet_adjacency(tissue.mesh.tets)),
      surface_(geometry::boundary_surface(tissue.mesh.tets, adjacency_)) {
  const auto& x = tissue.mesh.vertices_m;
  for (const Triangle& t : surface_.triangles)
    for (std::size_t i = 0; i < 3; ++i)
      mean_edge_m_ +=
          (x[static_cast<std::size_t>(t[i])] - x[static_cast<std::size_t>(t[(i + 1) % 3])]).norm();
  mean_edge_m_ /= 3.0 * static_cast<double>(surface_.triangles.size());
}

const PhysicalGroup* TissueBinder::find_group(std::string_view name, std::optional<int> dimension,
                                              const toml::source_region& place) {
  const PhysicalGroup* found = nullptr;
  std::vector<std::string> names;
  for (const PhysicalGroup& group : tissue_.mesh.groups) {
    if (dimension && group.dimension != *dimension) continue;
    if (std::find(names.begin(), names.end(), group.name) == names.end())
      names.push_back(group.name);
    if (group.name != name) continue;
    if (found != nullptr) {
      faults_.add(place,
                  title_ + " has groups \"" + std::string(name) + "\" of dimension " +
                      std::to_string(found->dimension) + " and " + std::to_string(group.dimension),
                  "write { group = \"" + std::string(name) +
                      "\", dimension = " + std::to_string(group.dimension) + " }");
      return nullptr;
    }
    found = &group;
  }
  if (found != nullptr) return found;
  std::string known;
  for (const std::string& candidate : names) known += (known.empty() ? "" : ", ") + candidate;
  faults_.add(place,
              "the mesh of " + title_ + " has no group \"" + std::string(name) + "\"" +
                  (dimension ? " of dimension " + std::to_string(*dimension) : "") +
                  did_you_mean(name, names),
              known.empty() ? "it has no such groups: use a box" : "it has " + known);
  return nullptr;
}

std::vector<std::int32_t> TissueBinder::vertices_in_box(const toml::table& box,
                                                        const toml::source_region& place) {
  TableReader reader(box, "box of " + title_, faults_);
  const std::size_t faults_before = faults_.size();
  const Vec3 low = reader.required_vector("min_m");
  const Vec3 high = reader.required_vector("max_m");
  reader.finish();
  std::vector<std::int32_t> inside;
  if (faults_.size() > faults_before) return inside;
  Eigen::AlignedBox3d extent;
  for (std::size_t v = 0; v < tissue_.mesh.vertices_m.size(); ++v) {
    const Vec3& x = tissue_.mesh.vertices_m[v];
    extent.extend(x);
    if ((x.array() >= low.array()).all() && (x.array() <= high.array()).all())
      inside.push_back(static_cast<std::int32_t>(v));
  }
  if (inside.empty())
    faults_.add(place, "the box holds no vertex of " + title_,
                "the mesh lies between " + vector_text(extent.min()) + " and " +
                    vector_text(extent.max()) + " m");
  return inside;
}

std::vector<std::int32_t> TissueBinder::selected_vertices(TableReader& reader) {
  const std::string name = reader.text("group", "");
  const int dimension = reader.integer("dimension", -1, 0, 3);
  const toml::table* box = reader.table("box");
  if (reader.has("group") == reader.has("box")) {
    reader.fault("", reader.title() + " must name either a group or a box",
                 "write group = \"…\" or box = { min_m = […], max_m = […] }");
    return {};
  }
  if (box != nullptr) return vertices_in_box(*box, reader.place("box"));
  if (name.empty()) return {};
  const PhysicalGroup* group = find_group(
      name, dimension < 0 ? std::nullopt : std::optional(dimension), reader.place("group"));
  return group == nullptr ? std::vector<std::int32_t>{} : group->vertices;
}

void TissueBinder::bind_fixed(TableReader& table) {
  const toml::array* items = table.array("fixed");
  if (items == nullptr) return;
  for (const toml::node& item : *items) {
    Prescribed fixed;
    if (const auto name = item.value_exact<std::string>()) {
      const PhysicalGroup* group = find_group(*name, std::nullopt, item.source());
      if (group != nullptr) fixed.vertices = group->vertices;
    } else if (item.is_table()) {
      TableReader reader(*item.as_table(), "an entry of fixed of " + title_, faults_);
      fixed.vertices = selected_vertices(reader);
      reader.finish();
    } else {
      faults_.add(item.source(), "an entry of fixed of " + title_ + " is neither a group nor a box",
                  "write \"group\" or { box = { min_m = […], max_m = […] } }");
    }
    if (!fixed.vertices.empty()) tissue_.prescribed.push_back(std::move(fixed));
  }
}

void TissueBinder::bind_prescribed(TableReader& table) {
  const toml::array* items = table.array("prescribed");
  if (items == nullptr) return;
  for (const toml::node& item : *items) {
    if (!item.is_table()) {
      faults_.add(item.source(), "an entry of prescribed of " + title_ + " is not a table",
                  "write { group = \"…\", axes = \"xyz\", displacement_m = [0, 0, 0] }");
      continue;
    }
    TableReader reader(*item.as_table(), "an entry of prescribed of " + title_, faults_);
    Prescribed prescribed;
    prescribed.vertices = selected_vertices(reader);
    prescribed.displacement_m = reader.required_vector("displacement_m", kPlace);
    const std::string axes = reader.text("axes", "xyz");
    prescribed.axes = {false, false, false};
    bool known = !axes.empty();
    for (const char c : axes) {
      const std::size_t axis = std::string_view("xyz").find(c);
      known &= axis < 3 && !prescribed.axes[axis];
      if (axis < 3) prescribed.axes[axis] = true;
    }
    if (!known)
      reader.fault("axes", "axes of " + reader.title() + " is \"" + axes + "\"",
                   "write some of x, y and z, each once: \"xyz\", \"z\"");
    reader.finish();
    if (!prescribed.vertices.empty()) tissue_.prescribed.push_back(std::move(prescribed));
  }
}

void TissueBinder::check_prescribed(TableReader& table) {
  std::vector<std::array<const double*, 3>> given(tissue_.mesh.vertices_m.size(),
                                                  {nullptr, nullptr, nullptr});
  std::size_t torn = 0;
  std::int32_t example = -1;
  for (const Prescribed& entry : tissue_.prescribed) {
    for (const std::int32_t v : entry.vertices) {
      for (std::size_t axis = 0; axis < 3; ++axis) {
        if (!entry.axes[axis]) continue;
        const double* wanted = &entry.displacement_m[static_cast<Eigen::Index>(axis)];
        const double*& there = given[static_cast<std::size_t>(v)][axis];
        if (there != nullptr && *there != *wanted) {
          ++torn;
          example = v;
        }
        there = wanted;
      }
    }
  }
  if (torn > 0)
    table.fault("prescribed",
                "two entries of fixed and prescribed of " + title_ + " disagree on " +
                    std::to_string(torn) + " coordinates, one at " +
                    vector_text(tissue_.mesh.vertices_m[static_cast<std::size_t>(example)]) + " m",
                "let each vertex be prescribed once on each axis");
}

std::optional<std::int32_t> TissueBinder::vertex_of_node(std::int64_t node,
                                                         const toml::source_region& place) {
  const auto& index = tissue_.mesh.file_index;  // ascending
  const auto found = std::lower_bound(index.begin(), index.end(), node);
  if (found != index.end() && *found == node)
    return static_cast<std::int32_t>(found - index.begin());
  faults_.add(
      place, "node " + std::to_string(node) + " belongs to no tet of " + title_,
      "count the nodes of the file from 0; the last one in use is " + std::to_string(index.back()));
  return std::nullopt;
}

std::optional<WoundEdge> TissueBinder::edge_of(std::string_view name,
                                               const toml::source_region& place) {
  const PhysicalGroup* group = find_group(name, 2, place);
  if (group == nullptr) return std::nullopt;
  if (group->triangles.empty()) {
    faults_.add(place, "group \"" + std::string(name) + "\" of " + title_ + " has no triangles",
                "the edge of a wound is a surface group");
    return std::nullopt;
  }
  WoundEdge edge;
  edge.group = name;
  edge.triangles = group->triangles;
  std::set<std::int32_t> used;
  for (const Triangle& t : group->triangles) used.insert(t.begin(), t.end());
  edge.vertices.assign(used.begin(), used.end());
  return edge;
}

std::optional<Bite> TissueBinder::bite_at(const Vec3& point_m, const toml::source_region& place) {
  const auto& x = tissue_.mesh.vertices_m;
  Bite bite;
  geometry::ClosestPoint best;
  best.squared_distance_m2 = std::numeric_limits<double>::infinity();
  for (const Triangle& t : surface_.triangles) {
    const auto closest = geometry::closest_point_on_triangle(
        point_m, x[static_cast<std::size_t>(t[0])], x[static_cast<std::size_t>(t[1])],
        x[static_cast<std::size_t>(t[2])]);
    if (closest.squared_distance_m2 >= best.squared_distance_m2) continue;
    best = closest;
    bite.vertices = t;
  }
  bite.barycentric = best.barycentric;
  if (std::sqrt(best.squared_distance_m2) <= mean_edge_m_) return bite;
  faults_.add(place, vector_text(point_m) + " m lies off the surface of " + title_,
              "the nearest point of the surface is " + vector_text(best.point_m) + " m");
  return std::nullopt;
}

std::optional<Bite> TissueBinder::bite_at(const std::array<int, 3>& nodes, const Vec3& barycentric,
                                          const toml::source_region& place) {
  Bite bite;
  bite.barycentric = barycentric;
  for (std::size_t i = 0; i < 3; ++i) {
    const auto vertex = vertex_of_node(nodes[i], place);
    if (!vertex) return std::nullopt;
    bite.vertices[i] = *vertex;
  }
  for (const Triangle& face : surface_.triangles) {
    if (sorted(face) != sorted(bite.vertices)) continue;
    Bite wound{-1, face, Vec3::Zero()};
    for (std::size_t i = 0; i < 3; ++i)
      for (std::size_t k = 0; k < 3; ++k)
        if (bite.vertices[k] == face[i])
          wound.barycentric[static_cast<Eigen::Index>(i)] =
              barycentric[static_cast<Eigen::Index>(k)];
    return wound;
  }
  faults_.add(place, "these three nodes are no boundary face of " + title_,
              "name a face of the surface, or write point_m = [x, y, z]");
  return std::nullopt;
}

std::optional<NodalLoad> TissueBinder::spread_force(const PhysicalGroup& group, const Vec3& force_n,
                                                    const toml::source_region& place) {
  LoadSum sum;
  if (group.dimension == 0) {
    for (const std::int32_t v : group.vertices)
      sum.add(v, force_n / static_cast<double>(group.vertices.size()));
    return sum.load();
  }
  const auto& x = tissue_.mesh.vertices_m;
  const auto area = [&](const Triangle& t) {
    const Vec3& a = x[static_cast<std::size_t>(t[0])];
    return 0.5 * (x[static_cast<std::size_t>(t[1])] - a)
                     .cross(x[static_cast<std::size_t>(t[2])] - a)
                     .norm();
  };
  double total = 0.0;
  for (const Triangle& t : group.triangles) total += area(t);
  if (group.dimension != 2 || !(total > 0.0)) {
    faults_.add(place, "group \"" + group.name + "\" of " + title_ + " has no triangles to load",
                "name a surface group, or a group of points");
    return std::nullopt;
  }
  for (const Triangle& t : group.triangles)
    for (const std::int32_t v : t) sum.add(v, force_n * (area(t) / total / 3.0));
  return sum.load();
}

std::optional<NodalLoad> TissueBinder::spread_pressure(const PhysicalGroup& group,
                                                       double pressure_pa,
                                                       const toml::source_region& place) {
  std::map<Triangle, Triangle> outward;
  for (const Triangle& face : surface_.triangles) outward.emplace(sorted(face), face);
  LoadSum sum;
  for (const Triangle& t : group.triangles) {
    const auto face = outward.find(sorted(t));
    if (face == outward.end()) {
      faults_.add(place, "group \"" + group.name + "\" of " + title_ + " lies inside the tissue",
                  "a pressure acts on the boundary: name a group of its faces");
      return std::nullopt;
    }
    const auto at = [&](std::size_t i) -> const Vec3& {
      return tissue_.mesh.vertices_m[static_cast<std::size_t>(face->second[i])];
    };
    const Vec3 vector_area = 0.5 * (at(1) - at(0)).cross(at(2) - at(0));
    for (const std::int32_t v : t) sum.add(v, -pressure_pa / 3.0 * vector_area);
  }
  if (group.triangles.empty()) {
    faults_.add(place, "group \"" + group.name + "\" of " + title_ + " has no triangles",
                "a pressure acts on a surface group");
    return std::nullopt;
  }
  return sum.load();
}

std::optional<NodalLoad> TissueBinder::read_load(TableReader& reader) {
  const std::string name = reader.text("group", "");
  const int dimension = reader.integer("dimension", -1, 0, 3);
  const auto point = reader.vector("point_m");
  const int node = reader.integer("vertex", 0, 0, std::numeric_limits<int>::max());
  const double pressure_pa = reader.number("pressure_pa", 0.0, kPressure);
  const auto force = reader.vector("force_n", kLoad);
  reader.finish();
  const int places = static_cast<int>(reader.has("group")) +
                     static_cast<int>(reader.has("point_m")) +
                     static_cast<int>(reader.has("vertex"));
  if (places != 1 || reader.has("force_n") == reader.has("pressure_pa") ||
      (reader.has("pressure_pa") && !reader.has("group"))) {
    reader.fault("", reader.title() + " needs one place and one force",
                 "write group, point_m or vertex with force_n, or group with pressure_pa");
    return std::nullopt;
  }
  const Vec3 force_n = force.value_or(Vec3::Zero());
  if (reader.has("vertex")) {
    const auto vertex = vertex_of_node(node, reader.place("vertex"));
    if (!vertex) return std::nullopt;
    return NodalLoad{{*vertex}, {force_n}};
  }
  if (point) {
    const auto bite = bite_at(*point, reader.place("point_m"));
    if (!bite) return std::nullopt;
    LoadSum sum;
    for (std::size_t i = 0; i < 3; ++i)
      if (const double share = bite->barycentric[static_cast<Eigen::Index>(i)]; share > 0.0)
        sum.add(bite->vertices[i], share * force_n);
    return sum.load();
  }
  if (name.empty()) return std::nullopt;
  const auto place = reader.place("group");
  const bool is_pressure = reader.has("pressure_pa");
  const auto wanted = dimension >= 0 ? std::optional(dimension)
                      : is_pressure  ? std::optional(2)
                                     : std::nullopt;
  const PhysicalGroup* group = find_group(name, wanted, place);
  if (group == nullptr) return std::nullopt;
  return is_pressure ? spread_pressure(*group, pressure_pa, place)
                     : spread_force(*group, force_n, place);
}

void TissueBinder::bind_loads(TableReader& table) {
  const toml::array* items = table.array("load");
  if (items == nullptr) return;
  for (const toml::node& item : *items) {
    if (!item.is_table()) {
      faults_.add(item.source(), "an entry of load of " + title_ + " is not a table",
                  "write { group = \"…\", force_n = [x, y, z] }");
      continue;
    }
    TableReader reader(*item.as_table(), "an entry of load of " + title_, faults_);
    if (auto load = read_load(reader)) tissue_.loads.push_back(std::move(*load));
  }
}

void TissueBinder::bind_regions(TableReader& table) {
  const toml::array* items = table.array("regions");
  if (items == nullptr) return;
  std::vector<std::string> owner(tissue_.mesh.tets.size());
  for (const toml::node& item : *items) {
    if (!item.is_table()) {
      faults_.add(item.source(), "an entry of regions of " + title_ + " is not a table",
                  "write { group = \"…\", young_modulus_pa = …, poisson_ratio = … }");
      continue;
    }
    TableReader reader(*item.as_table(), "an entry of regions of " + title_, faults_);
    Region region;
    region.group = reader.required_text("group");
    region.young_modulus_pa = reader.required_number("young_modulus_pa", kModulus);
    region.poisson_ratio = reader.number("poisson_ratio", tissue_.poisson_ratio, kPoissonRatio);
    reader.finish();
    if (region.group.empty()) continue;
    const PhysicalGroup* group = find_group(region.group, 3, reader.place("group"));
    if (group == nullptr) continue;
    std::string twin;
    for (const std::int32_t t : group->tets) {
      std::string& first = owner[static_cast<std::size_t>(t)];
      if (!first.empty()) twin = first;
      first = region.group;
    }
    if (!twin.empty())
      reader.fault(
          "group",
          "regions \"" + twin + "\" and \"" + region.group + "\" of " + title_ + " share tets",
          "give each tet one region");
    region.tets = group->tets;
    tissue_.regions.push_back(std::move(region));
  }
}

void TissueBinder::check_components(TableReader& table) {
  const int declared = table.integer("components", 1, 1, 1000);
  const geometry::Components components =
      geometry::connected_components(tissue_.mesh.tets, tissue_.mesh.vertices_m.size());
  if (components.count != declared) {
    std::vector<int> tets(static_cast<std::size_t>(components.count), 0);
    for (const std::int32_t c : components.of_tet) ++tets[static_cast<std::size_t>(c)];
    std::sort(tets.rbegin(), tets.rend());
    std::string sizes;
    for (std::size_t i = 0; i < std::min<std::size_t>(tets.size(), 5); ++i)
      sizes += (i == 0 ? "" : ", ") + std::to_string(tets[i]);
    if (tets.size() > 5) sizes += ", …";
    table.fault(table.has("components") ? "components" : "mesh",
                "the mesh of " + title_ + " falls into " + std::to_string(components.count) +
                    (components.count == 1 ? " part (of " : " parts (of ") + sizes +
                    " tets), not " + std::to_string(declared),
                "delete the debris, select with volumes = […], or say components = " +
                    std::to_string(components.count));
    return;  // what follows would tell of each splinter
  }
  if (faults_.size() > faults_before_) return;  // what should hold it may be among the faults
  std::set<std::int32_t> held;
  for (const Prescribed& entry : tissue_.prescribed)
    held.insert(entry.vertices.begin(), entry.vertices.end());
  if (held.size() == tissue_.mesh.vertices_m.size()) {
    table.fault(table.has("fixed") ? "fixed" : "prescribed",
                "every vertex of " + title_ + " is held: nothing of it can move or be felt",
                "fix less of it");
    return;
  }
  for (const LooseComponent& loose :
       loose_components(tissue_.mesh, components, adjacency_, tissue_.prescribed)) {
    const std::string part = components.count == 1
                                 ? title_
                                 : "component " + std::to_string(loose.component + 1) + " of " +
                                       std::to_string(components.count) + " of " + title_ + " (" +
                                       std::to_string(loose.vertex_count) + " vertices about " +
                                       vector_text(loose.centre_m) + " m)";
    if (loose.parts > kRigidPartsMax) {
      table.fault("mesh",
                  part + " hangs together by edges and corners only: it has " +
                      std::to_string(loose.parts) +
                      " parts of tets that share faces, and may have " +
                      std::to_string(kRigidPartsMax),
                  "mesh it so that neighbours share faces");
      continue;
    }
    const std::string what =
        loose.free_motions >= 6
            ? part + " is not fixed anywhere: its stiffness matrix is singular"
            : part + " is not held: " + std::to_string(loose.free_motions) +
                  (loose.free_motions == 1 ? " rigid motion is" : " rigid motions are") +
                  " left free and its stiffness matrix is singular";
    table.fault("fixed", what,
                "fix at least three points that are not in line: fixed = [\"group\"] or "
                "[{ box = { min_m = […], max_m = […] } }]");
  }
}

}  // namespace sutured::scene
