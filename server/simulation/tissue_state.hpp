// SPDX-License-Identifier: GPL-3.0-or-later
// All tissues of a scene as one elastic body: one numbering, one factor, one surface.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "constraints/compliance.hpp"
#include "fem/stiffness.hpp"
#include "needle/path.hpp"
#include "scene/scene.hpp"
#include "simulation/simulation.hpp"

namespace sutured::simulation {

/// Returns the model that the tissues of `scene` make side by side, loads and gravity included.
[[nodiscard]] fem::Model assemble_model(const scene::Scene& scene);

/// The tissue between steps: what it is, where it is, and how it gives way.
///
/// Thread: simulation. `refresh` costs one backward pass and allocates nothing.
class TissueState {
 public:
  /// Assembles and factors. Throws scene::SceneError naming the tissue that can move freely.
  explicit TissueState(const scene::Scene& scene);

  /// Takes the forces of solved rows; positions follow at the next `refresh`.
  void apply(const constraints::ConstraintRows& rows, std::span<const double> multiplier_n);
  /// Brings positions and search tree up to the last `apply`.
  void refresh();
  /// Returns to the state without constraint forces.
  void reset();
  void serialize(Archive& archive);

  [[nodiscard]] needle::TissueView view() const {
    return {positions_m_, model_.tets, &adjacency_, &surface_, &tree_, triangle_of_face_};
  }
  [[nodiscard]] constraints::Compliance& compliance() { return *compliance_; }
  [[nodiscard]] const fem::Model& model() const { return model_; }
  [[nodiscard]] std::span<const Vec3> positions_m() const { return positions_m_; }
  [[nodiscard]] std::span<const double> displacements_m() const { return displacement_m_; }
  /// Position of vertex v under loads and prescribed displacements alone.
  [[nodiscard]] Vec3 free_position_m(std::int32_t v) const {
    return free_positions_m_[static_cast<std::size_t>(v)];
  }
  [[nodiscard]] std::span<const Body> bodies() const { return bodies_; }
  [[nodiscard]] int tissue_of_tet(std::int32_t tet) const {
    return tissue_of_tet_[static_cast<std::size_t>(tet)];
  }
  [[nodiscard]] int tissue_of_triangle(std::int32_t triangle) const {
    return tissue_of_tet(surface_.tet[static_cast<std::size_t>(triangle)]);
  }
  [[nodiscard]] const geometry::BoundarySurface& surface() const { return surface_; }
  [[nodiscard]] double young_modulus_pa(std::int32_t tet) const {
    return model_
        .materials[static_cast<std::size_t>(model_.material_of_tet[static_cast<std::size_t>(tet)])]
        .young_modulus_pa;
  }
  /// Tets turned inside out or flat by the last `refresh`: signed volume of their deformed corners
  /// not above zero. Linear elasticity does not resist that; what it says of them is no tissue.
  [[nodiscard]] int inverted_tets() const { return inverted_tets_; }
  /// The first of them, or −1.
  [[nodiscard]] std::int32_t first_inverted_tet() const { return first_inverted_tet_; }
  /// Computes the stress of the last `refresh`; allocates only where `field` is too small.
  void compute_stress(StressField& field) const;

 private:
  void place();
  void count_inverted();

  fem::Model model_;
  std::vector<fem::TetShape> rest_shapes_;  ///< per tet
  std::vector<double> vertex_volume_m3_;    ///< of the tets at each vertex, at rest
  std::vector<int> tissue_of_tet_;
  std::vector<Body> bodies_;
  geometry::TetAdjacency adjacency_;
  geometry::BoundarySurface surface_;
  geometry::TriangleTree tree_;
  std::vector<std::int32_t> triangle_of_face_;
  std::unique_ptr<constraints::Compliance> compliance_;
  std::vector<double> free_displacement_m_;  ///< 3n: of loads and prescribed displacements
  std::vector<double> displacement_m_;       ///< 3n
  std::vector<Vec3> free_positions_m_, positions_m_;
  int inverted_tets_ = 0;
  std::int32_t first_inverted_tet_ = -1;
  bool stale_ = false;
};

}  // namespace sutured::simulation
