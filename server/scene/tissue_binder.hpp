// SPDX-License-Identifier: GPL-3.0-or-later
// Private to this folder: turns what a scene says of groups, boxes and points into vertices.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "geometry/topology.hpp"
#include "scene/scene.hpp"
#include "scene/toml_table.hpp"

namespace sutured::scene {

inline constexpr Range kPoissonRatio{
    .low = 0.0,
    .high = 0.5,
    .high_open = true,
    .mend =
        "0.45 to 0.49 is soft tissue; at 0.5 it is incompressible, where K is singular and "
        "linear tetrahedra lock"};

/// A tissue's mesh with what binding needs of it.
class TissueBinder {
 public:
  TissueBinder(Tissue& tissue, Faults& faults);

  void bind_fixed(TableReader& table);
  void bind_prescribed(TableReader& table);
  void bind_loads(TableReader& table);
  void bind_regions(TableReader& table);
  /// The count of components, and that each of them is held.
  void check_components(TableReader& table);
  void check_prescribed(TableReader& table);

  /// The surface of a group, as a wound's edge; nullopt, with a fault at `place`, where the mesh
  /// has no such group of surfaces.
  std::optional<WoundEdge> edge_of(std::string_view group, const toml::source_region& place);

  /// The boundary point nearest to `point_m`; nullopt, with a fault at `place`, where it lies
  /// further off the surface than a mean edge.
  std::optional<Bite> bite_at(const Vec3& point_m, const toml::source_region& place);
  /// The bite on the boundary face of three nodes of the file.
  std::optional<Bite> bite_at(const std::array<int, 3>& nodes, const Vec3& barycentric,
                              const toml::source_region& place);

 private:
  std::vector<std::int32_t> vertices_in_box(const toml::table& box,
                                            const toml::source_region& place);
  const geometry::PhysicalGroup* find_group(std::string_view name, std::optional<int> dimension,
                                            const toml::source_region& place);
  /// Vertices named by `group` (and `dimension`) or `box` of `reader`.
  std::vector<std::int32_t> selected_vertices(TableReader& reader);
  std::optional<std::int32_t> vertex_of_node(std::int64_t node, const toml::source_region& place);
  std::optional<NodalLoad> read_load(TableReader& reader);
  std::optional<NodalLoad> spread_force(const geometry::PhysicalGroup& group, const Vec3& force_n,
                                        const toml::source_region& place);
  std::optional<NodalLoad> spread_pressure(const geometry::PhysicalGroup& group, double pressure_pa,
                                           const toml::source_region& place);

  Tissue& tissue_;
  Faults& faults_;
  std::string title_;
  std::size_t faults_before_;  // this tissue's own
  geometry::TetAdjacency adjacency_;
  geometry::BoundarySurface surface_;
  double mean_edge_m_ = 0.0;
};

}  // namespace sutured::scene
