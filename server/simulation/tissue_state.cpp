// SPDX-License-Identifier: GPL-3.0-or-later
#include "simulation/tissue_state.hpp"

#include <algorithm>
#include <utility>

#include "fem/cholesky_factor.hpp"
#include "fem/in_two_threads.hpp"
#include "scene/scene_error.hpp"

namespace sutured::simulation {
namespace {

// From so many tets on, two threads take what follows from the displacements.
constexpr std::size_t kSharedTets = 50'000;

std::size_t at(std::int64_t i) { return static_cast<std::size_t>(i); }

/// Index of a tissue's first vertex (or tet) in the common numbering.
template <typename Count>
std::int32_t first_of(const scene::Scene& scene, std::size_t tissue, Count&& count) {
  std::size_t sum = 0;
  for (std::size_t i = 0; i < tissue; ++i) sum += count(scene.tissues[i].mesh);
  return static_cast<std::int32_t>(sum);
}

std::int32_t first_vertex(const scene::Scene& scene, std::size_t tissue) {
  return first_of(scene, tissue,
                  [](const geometry::TetMesh& mesh) { return mesh.vertices_m.size(); });
}

}  // namespace

fem::Model assemble_model(const scene::Scene& scene) {
  fem::Model model;
  std::vector<double> density;
  for (std::size_t i = 0; i < scene.tissues.size(); ++i) {
    const scene::Tissue& tissue = scene.tissues[i];
    const auto base = static_cast<std::int32_t>(model.vertices_m.size());
    const auto first_tet = model.tets.size();
    model.vertices_m.insert(model.vertices_m.end(), tissue.mesh.vertices_m.begin(),
                            tissue.mesh.vertices_m.end());
    for (geometry::Tet tet : tissue.mesh.tets) {
      for (auto& v : tet) v += base;
      model.tets.push_back(tet);
    }
    model.material_of_tet.resize(model.tets.size(),
                                 static_cast<std::int32_t>(model.materials.size()));
    model.materials.push_back({tissue.young_modulus_pa, tissue.poisson_ratio});
    density.push_back(tissue.density_kg_per_m3);
    for (const scene::Region& region : tissue.regions) {
      for (const auto tet : region.tets)
        model.material_of_tet[first_tet + at(tet)] =
            static_cast<std::int32_t>(model.materials.size());
      model.materials.push_back({region.young_modulus_pa, region.poisson_ratio});
      density.push_back(tissue.density_kg_per_m3);
    }
    model.prescribed.resize(3 * model.vertices_m.size(), 0);
    model.prescribed_m.resize(3 * model.vertices_m.size(), 0.0);
    model.load_n.resize(3 * model.vertices_m.size(), 0.0);
    for (const scene::Prescribed& prescribed : tissue.prescribed)
      for (const auto v : prescribed.vertices)
        for (std::size_t axis = 0; axis < 3; ++axis)
          if (prescribed.axes[axis]) {
            model.prescribed[3 * at(base + v) + axis] = 1;
            model.prescribed_m[3 * at(base + v) + axis] =
                prescribed.displacement_m[static_cast<Eigen::Index>(axis)];
          }
    for (const scene::NodalLoad& load : tissue.loads)
      for (std::size_t k = 0; k < load.vertices.size(); ++k)
        for (std::size_t axis = 0; axis < 3; ++axis)
          model.load_n[3 * at(base + load.vertices[k]) + axis] +=
              load.force_n[k][static_cast<Eigen::Index>(axis)];
  }
  if (!scene.gravity_m_per_s2.isZero())
    fem::add_gravity(model, density, scene.gravity_m_per_s2, model.load_n);
  return model;
}

TissueState::TissueState(const scene::Scene& scene) : model_(assemble_model(scene)) {
  const std::size_t n = model_.vertices_m.size();
  vertex_volume_m3_.assign(n, 0.0);
  for (const geometry::Tet& tet : model_.tets) {
    std::array<Vec3, 4> x;
    for (std::size_t a = 0; a < 4; ++a) x[a] = model_.vertices_m[at(tet[a])];
    rest_shapes_.push_back(fem::tet_shape(x));
    for (const std::int32_t v : tet) vertex_volume_m3_[at(v)] += rest_shapes_.back().volume_m3;
  }
  adjacency_ = geometry::tet_adjacency(model_.tets);
  surface_ = geometry::boundary_surface(model_.tets, adjacency_);
  triangle_of_face_.assign(4 * model_.tets.size(), -1);
  for (std::size_t i = 0; i < surface_.triangles.size(); ++i)
    triangle_of_face_[at(4 * surface_.tet[i] + surface_.tet_face[i])] =
        static_cast<std::int32_t>(i);
  for (std::size_t i = 0; i < scene.tissues.size(); ++i) {
    const auto& mesh = scene.tissues[i].mesh;
    Body body;
    body.name = scene.tissues[i].name;
    body.first_vertex = first_vertex(scene, i);
    body.vertex_count = static_cast<std::int32_t>(mesh.vertices_m.size());
    tissue_of_tet_.resize(tissue_of_tet_.size() + mesh.tets.size(), static_cast<int>(i));
    bodies_.push_back(std::move(body));
  }
  for (std::size_t i = 0; i < surface_.triangles.size(); ++i) {
    Body& body = bodies_[at(tissue_of_triangle(static_cast<std::int32_t>(i)))];
    geometry::Triangle triangle = surface_.triangles[i];
    for (auto& v : triangle) v -= body.first_vertex;
    body.surface.push_back(triangle);
  }
  for (Body& body : bodies_) {
    for (const auto& triangle : body.surface)
      body.surface_vertices.insert(body.surface_vertices.end(), triangle.begin(), triangle.end());
    std::sort(body.surface_vertices.begin(), body.surface_vertices.end());
    body.surface_vertices.erase(
        std::unique(body.surface_vertices.begin(), body.surface_vertices.end()),
        body.surface_vertices.end());
  }

  const fem::LinearSystem system = fem::assemble(model_);
  std::shared_ptr<const fem::CholeskyFactor> factor;
  try {
    factor = std::make_shared<fem::CholeskyFactor>(system);
  } catch (const fem::NotPositiveDefinite& error) {
    std::string name = scene.name;
    for (const Body& body : bodies_)
      if (error.vertex >= body.first_vertex && error.vertex < body.first_vertex + body.vertex_count)
        name = body.name;
    scene::SceneFault fault;
    fault.file = scene.path;
    fault.what =
        "tissue \"" + name + "\" can move freely: its stiffness matrix is not positive definite";
    fault.mend = "fix a group or a box of it that holds every part in place";
    throw scene::SceneError({fault});
  }
  compliance_ = std::make_unique<constraints::Compliance>(factor);
  std::vector<double> free(at(factor->size()));
  factor->solve(system.right_hand_side_n, free);
  free_displacement_m_.resize(3 * n);
  for (std::size_t dof = 0; dof < 3 * n; ++dof)
    free_displacement_m_[dof] =
        system.free_index[dof] >= 0 ? free[at(system.free_index[dof])] : model_.prescribed_m[dof];
  displacement_m_ = free_displacement_m_;
  positions_m_.resize(n);
  for (std::size_t v = 0; v < n; ++v)
    positions_m_[v] =
        model_.vertices_m[v] +
        Vec3(displacement_m_[3 * v], displacement_m_[3 * v + 1], displacement_m_[3 * v + 2]);
  free_positions_m_ = positions_m_;
  count_inverted();
  tree_ = geometry::TriangleTree(surface_.triangles, positions_m_);
}

void TissueState::apply(const constraints::ConstraintRows& rows,
                        std::span<const double> multiplier_n) {
  compliance_->apply(rows, multiplier_n);
  stale_ = true;
}

void TissueState::refresh() {
  if (!stale_) return;
  compliance_->displacements_m(free_displacement_m_, displacement_m_);
  place();
  stale_ = false;
}

/// Makes what follows from the displacements.
void TissueState::place() {
  for (std::size_t v = 0; v < positions_m_.size(); ++v)
    positions_m_[v] =
        model_.vertices_m[v] +
        Vec3(displacement_m_[3 * v], displacement_m_[3 * v + 1], displacement_m_[3 * v + 2]);
  const auto refit = [this] { tree_.refit(positions_m_); };
  const auto count = [this] { count_inverted(); };
  if (model_.tets.size() >= kSharedTets) {
    fem::in_two_threads(refit, count);
  } else {
    refit();
    count();
  }
}

void TissueState::count_inverted() {
  inverted_tets_ = 0;
  first_inverted_tet_ = -1;
  for (std::size_t t = 0; t < model_.tets.size(); ++t) {
    const auto& [a, b, c, d] = model_.tets[t];
    if (geometry::signed_volume(positions_m_[at(a)], positions_m_[at(b)], positions_m_[at(c)],
                                positions_m_[at(d)]) > 0.0)
      continue;
    if (inverted_tets_++ == 0) first_inverted_tet_ = static_cast<std::int32_t>(t);
  }
}

void TissueState::reset() {
  compliance_->clear();
  apply(constraints::ConstraintRows(), {});
  refresh();
}

void TissueState::serialize(Archive& archive) {
  // Given by the scene: model … triangle_of_face, and where the loads alone bring the tissue.
  // `place` makes the rest.
  auto& [model, rest_shapes, vertex_volume, tissue_of_tet, bodies, adjacency, surface, tree,
         triangle_of_face, compliance, free_displacement, displacement, free_positions, positions,
         inverted_tets, first_inverted_tet, stale] = *this;
  archive(*compliance, stale);
  archive.fixed(displacement);
  if (archive.reads()) place();
}

void TissueState::compute_stress(StressField& field) const {
  field.tet_pa.resize(model_.tets.size());
  field.vertex_pa.assign(positions_m_.size(), Vec6::Zero());
  for (std::size_t t = 0; t < model_.tets.size(); ++t) {
    std::array<Vec3, 4> u;
    for (std::size_t a = 0; a < 4; ++a) {
      const auto v = at(model_.tets[t][a]);
      u[a] = Vec3(displacement_m_[3 * v], displacement_m_[3 * v + 1], displacement_m_[3 * v + 2]);
    }
    field.tet_pa[t] =
        fem::tet_stress_pa(rest_shapes_[t], model_.materials[at(model_.material_of_tet[t])], u);
    for (const std::int32_t v : model_.tets[t])
      field.vertex_pa[at(v)] += rest_shapes_[t].volume_m3 * field.tet_pa[t];
  }
  for (std::size_t v = 0; v < field.vertex_pa.size(); ++v)
    field.vertex_pa[v] /= vertex_volume_m3_[v];
}

}  // namespace sutured::simulation
