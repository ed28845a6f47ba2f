// SPDX-License-Identifier: GPL-3.0-or-later
// Against CalculiX: the same tetrahedra (C3D4), the same loads, displacements and reactions
// compared in norm. CalculiX prints seven digits.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <fstream>
#include <sstream>

#include "geometry/mesh_reader.hpp"
#include "support/fem_model.hpp"
#include "support/program.hpp"

namespace sutured {
namespace {

using geometry::TetMesh;
using geometry::Vec3;

constexpr double kToleranceRelative = 1e-6;
constexpr double kGravity = 9.81;

/// What is computed twice.
struct Case {
  fem::Model model;                       ///< its loads without gravity
  std::vector<double> density_kg_per_m3;  ///< per material; empty without gravity (along −y)
};

/// Two vessels of different diameters and moduli, their far ends fixed.
Case vessels(const std::string& file, double scale, std::array<fem::Material, 2> materials) {
  const TetMesh mesh = geometry::read_mesh(SUTURED_SOURCE_DIR + ("/" + file), scale).mesh;
  Case result;
  result.model = testing::model_of(mesh, materials[0]);
  result.model.materials.push_back(materials[1]);
  double end_m = 0.0;
  for (const Vec3& x : mesh.vertices_m) end_m = std::max(end_m, std::abs(x.z()));
  for (std::size_t t = 0; t < mesh.tets.size(); ++t) {
    double z = 0.0;
    for (const auto v : mesh.tets[t]) z += mesh.vertices_m[static_cast<std::size_t>(v)].z();
    result.model.material_of_tet[t] = z > 0.0 ? 1 : 0;
  }
  testing::prescribe(
      result.model, [&](const Vec3& x) { return std::abs(x.z()) > end_m - 1e-6; },
      [](const Vec3&) -> Vec3 { return Vec3::Zero(); });
  return result;
}

Case reference_vessels() {
  return vessels("tests/validation/reference/tubes_1k6.msh", 1.0, {{{2.0e5, 0.45}, {2.0e5, 0.45}}});
}

Case anastomosis_vessels() {
  return vessels("server/scenes/anastomosis/vessels.msh", 0.001, {{{2.0e5, 0.45}, {5.0e5, 0.3}}});
}

std::size_t vertex_nearest(const fem::Model& model, const Vec3& p) {
  std::size_t best = 0;
  for (std::size_t v = 0; v < model.vertices_m.size(); ++v)
    if ((model.vertices_m[v] - p).norm() < (model.vertices_m[best] - p).norm()) best = v;
  return best;
}

void add_point_loads(Case& c) {
  const auto pull = [&](const Vec3& at, const Vec3& force_n) {
    const std::size_t v = vertex_nearest(c.model, at);
    for (std::size_t axis = 0; axis < 3; ++axis)
      c.model.load_n[3 * v + axis] += force_n[static_cast<Eigen::Index>(axis)];
  };
  pull({6e-3, 0, -0.75e-3}, {0.1, 0.02, -0.03});
  pull({0, 5e-3, 5e-3}, {-0.05, 0.2, 0.01});
  pull({-4e-3, 0, -9e-3}, {0.0, -0.1, 0.1});
}

/// Moves the rims at the gap: one sideways, the other along the vessel only.
void add_prescribed_displacements(Case& c) {
  double gap_m = 1.0;
  for (const Vec3& x : c.model.vertices_m) gap_m = std::min(gap_m, std::abs(x.z()));
  testing::prescribe(
      c.model, [&](const Vec3& x) { return x.z() < 0 && x.z() > -gap_m - 1e-6 && x.y() > 3e-3; },
      [](const Vec3& x) { return Vec3(0.5e-3, -0.2e-3, 0.1 * x.y()); });
  for (std::size_t v = 0; v < c.model.vertices_m.size(); ++v) {
    const Vec3& x = c.model.vertices_m[v];
    if (x.z() < 0 || x.z() > gap_m + 1e-6) continue;
    c.model.prescribed[3 * v + 2] = 1;
    c.model.prescribed_m[3 * v + 2] = -0.3e-3;
  }
}

void add_gravity(Case& c) { c.density_kg_per_m3 = {1000.0, 1200.0}; }

struct Load {
  const char* name;
  void (*add)(Case&);
};
struct Mesh {
  const char* name;
  Case (*make)();
};

/// Twenty characters, all that CalculiX reads of a number.
std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.13e", value);
  return text;
}

/// Writes the case in CalculiX's language.
std::string deck(const Case& c) {
  const fem::Model& model = c.model;
  const std::size_t vertices = model.vertices_m.size();
  std::ostringstream out;
  out << "*NODE, NSET=ALL\n";
  for (std::size_t v = 0; v < vertices; ++v)
    out << v + 1 << ", " << number(model.vertices_m[v].x()) << ", "
        << number(model.vertices_m[v].y()) << ", " << number(model.vertices_m[v].z()) << '\n';
  for (std::size_t m = 0; m < model.materials.size(); ++m) {
    out << "*ELEMENT, TYPE=C3D4, ELSET=BODY" << m << '\n';
    for (std::size_t t = 0; t < model.tets.size(); ++t) {
      if (model.material_of_tet[t] != static_cast<std::int32_t>(m)) continue;
      out << t + 1;
      for (const auto v : model.tets[t]) out << ", " << v + 1;
      out << '\n';
    }
    out << "*MATERIAL, NAME=TISSUE" << m << "\n*ELASTIC\n"
        << number(model.materials[m].young_modulus_pa) << ", "
        << number(model.materials[m].poisson_ratio) << '\n';
    if (!c.density_kg_per_m3.empty()) out << "*DENSITY\n" << number(c.density_kg_per_m3[m]) << '\n';
    out << "*SOLID SECTION, ELSET=BODY" << m << ", MATERIAL=TISSUE" << m << '\n';
  }
  std::ostringstream boundary, loads;
  for (std::size_t dof = 0; dof < 3 * vertices; ++dof) {
    if (model.prescribed[dof])
      boundary << dof / 3 + 1 << ", " << dof % 3 + 1 << ", " << dof % 3 + 1 << ", "
               << number(model.prescribed_m[dof]) << '\n';
    else if (model.load_n[dof] != 0.0)
      loads << dof / 3 + 1 << ", " << dof % 3 + 1 << ", " << number(model.load_n[dof]) << '\n';
  }
  out << "*STEP\n*STATIC\n*BOUNDARY\n" << boundary.str();
  if (!loads.str().empty()) out << "*CLOAD\n" << loads.str();
  if (!c.density_kg_per_m3.empty()) {
    out << "*DLOAD\n";
    for (std::size_t m = 0; m < model.materials.size(); ++m)
      out << "BODY" << m << ", GRAV, " << number(kGravity) << ", 0., -1., 0.\n";
  }
  out << "*NODE PRINT, NSET=ALL\nU, RF\n*END STEP\n";
  return out.str();
}

/// Reads the table after the line that starts with `title`: a node and three values a line.
std::vector<double> table(const std::string& dat, const std::string& title, std::size_t vertices) {
  std::vector<double> values(3 * vertices, std::nan(""));
  std::istringstream lines(dat);
  std::string line;
  while (std::getline(lines, line) && line.find(title) == std::string::npos) {
  }
  std::getline(lines, line);  // empty
  std::size_t node = 0;
  double x = 0, y = 0, z = 0;
  while (std::getline(lines, line) &&
         std::sscanf(line.c_str(), "%zu %lf %lf %lf", &node, &x, &y, &z) == 4)
    if (node >= 1 && node <= vertices) {
      values[3 * node - 3] = x;
      values[3 * node - 2] = y;
      values[3 * node - 1] = z;
    }
  return values;
}

/// Returns ‖got − want‖ / ‖want‖ over the degrees of freedom that `pick` picks.
template <typename Pick>
double norm_error(const std::vector<double>& got, const std::vector<double>& want, Pick&& pick) {
  double error = 0.0, norm = 0.0;
  for (std::size_t dof = 0; dof < got.size(); ++dof) {
    if (!pick(dof)) continue;
    error += (got[dof] - want[dof]) * (got[dof] - want[dof]);
    norm += want[dof] * want[dof];
  }
  return std::sqrt(error / norm);
}

class CalculiX : public ::testing::TestWithParam<std::tuple<Mesh, Load>> {};

TEST_P(CalculiX, AgreesInDisplacementsAndReactions) {
  const auto& [mesh, load] = GetParam();
  Case c = mesh.make();
  load.add(c);
  const testing::TemporaryFolder folder;
  folder.write("tissue.inp", deck(c));
  testing::ProgramResult run;
  try {
    run = testing::run_program({"ccx", "-i", folder.path("tissue")});
  } catch (const std::system_error& error) {
    if (error.code() != std::errc::no_such_file_or_directory) throw;
    GTEST_SKIP() << "ccx is not installed: apt-get install calculix-ccx (make test does)";
  }
  ASSERT_EQ(run.exit_code, 0) << run.out << run.err;
  const std::string dat = testing::read_file(folder.path("tissue.dat"));
  const std::size_t vertices = c.model.vertices_m.size();
  const auto their_displacement_m = table(dat, "displacements (vx,vy,vz)", vertices);
  const auto their_force_n = table(dat, "forces (fx,fy,fz)", vertices);

  if (!c.density_kg_per_m3.empty())
    fem::add_gravity(c.model, c.density_kg_per_m3, {0, -kGravity, 0}, c.model.load_n);
  const auto displacement_m = testing::solve(c.model);
  const auto force_n = fem::internal_forces_n(c.model, displacement_m);
  const double displacement_error =
      norm_error(displacement_m, their_displacement_m, [](std::size_t) { return true; });
  const double reaction_error = norm_error(
      force_n, their_force_n, [&](std::size_t dof) { return c.model.prescribed[dof] != 0; });
  EXPECT_LT(displacement_error, kToleranceRelative);
  EXPECT_LT(reaction_error, kToleranceRelative);
  std::printf("CalculiX, %s, %s: displacements %.2g, reactions %.2g relative (tolerance %g)\n",
              mesh.name, load.name, displacement_error, reaction_error, kToleranceRelative);
}

void add_all(Case& c) {
  add_point_loads(c);
  add_prescribed_displacements(c);
  add_gravity(c);
}

std::string name_of(const ::testing::TestParamInfo<std::tuple<Mesh, Load>>& tested) {
  return std::string(std::get<0>(tested.param).name) + "_" + std::get<1>(tested.param).name;
}

INSTANTIATE_TEST_SUITE_P(
    SameTets, CalculiX,
    ::testing::Combine(
        ::testing::Values(Mesh{"reference_vessels", reference_vessels},
                          Mesh{"anastomosis_vessels", anastomosis_vessels}),
        ::testing::Values(Load{"point_loads", add_point_loads},
                          Load{"prescribed_displacements", add_prescribed_displacements},
                          Load{"gravity", add_gravity}, Load{"all_at_once", add_all})),
    name_of);

}  // namespace
}  // namespace sutured
