// SPDX-License-Identifier: GPL-3.0-or-later
// Meshes made by others: tongue and liver of a public project, read from the folder beside the
// checkout (or $SUTURED_SHARED_DIR) and never copied here.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "geometry/mesh_quality.hpp"
#include "geometry/mesh_reader.hpp"
#include "geometry/topology.hpp"
#include "geometry/triangle_tree.hpp"
#include "scene/scene_reader.hpp"
#include "support/program.hpp"
#include "support/temporary_folder.hpp"

namespace sutured {
namespace {

using geometry::MeshReading;
using geometry::Vec3;

struct Organ {
  const char* file;
  std::size_t vertices;
  std::size_t tets;
  std::size_t boundary_faces;
  double scale;  // that makes it about as large as the organ
};

std::string name_of(const ::testing::TestParamInfo<Organ>& info) {
  return std::filesystem::path(info.param.file).stem().string();
}

class Anatomy : public ::testing::TestWithParam<Organ> {
 protected:
  void SetUp() override {
    const char* shared = std::getenv("SUTURED_SHARED_DIR");
    const std::filesystem::path folder =
        shared != nullptr ? shared : std::string(SUTURED_SOURCE_DIR) + "/../shared";
    path_ = (folder / "meshes" / GetParam().file).string();
    if (!std::filesystem::exists(path_))
      GTEST_SKIP() << path_
                   << " is missing: set SUTURED_SHARED_DIR to the folder that holds meshes/";
  }
  std::string path_;
};

TEST_P(Anatomy, IsReadWholeAndClosed) {
  const MeshReading reading = geometry::read_mesh(path_, 1.0);
  const geometry::TetMesh& mesh = reading.mesh;
  EXPECT_EQ(mesh.vertices_m.size(), GetParam().vertices);
  EXPECT_EQ(mesh.tets.size(), GetParam().tets);
  const auto adjacency = geometry::tet_adjacency(mesh.tets);
  const auto surface = geometry::boundary_surface(mesh.tets, adjacency);
  EXPECT_EQ(surface.triangles.size(), GetParam().boundary_faces);
  EXPECT_EQ(geometry::connected_components(mesh.tets, mesh.vertices_m.size()).count, 1);
  double enclosed = 0.0;
  Vec3 vector_area = Vec3::Zero();
  for (const auto& t : surface.triangles) {
    const auto x = [&](std::size_t i) -> const Vec3& {
      return mesh.vertices_m[static_cast<std::size_t>(t[i])];
    };
    enclosed += x(0).dot(x(1).cross(x(2))) / 6.0;
    vector_area += (x(1) - x(0)).cross(x(2) - x(0));
  }
  const double volume = geometry::mesh_quality(mesh).volume_m3;
  EXPECT_NEAR(enclosed, volume, 1e-12 * volume);
  EXPECT_LT(vector_area.norm(), 1e-12);
}

TEST_P(Anatomy, HasTetsOfUsableShape) {
  const geometry::MeshQuality quality =
      geometry::mesh_quality(geometry::read_mesh(path_, 1.0).mesh);
  // The tongue holds a few slivers: 3r/R of 0.018, angles of 1° and 178°.
  EXPECT_GT(quality.radius_ratio_min, 0.01);
  EXPECT_GT(quality.radius_ratio_p01, 0.15);
  EXPECT_GT(quality.radius_ratio_median, 0.6);
}

TEST_P(Anatomy, EveryBoundaryVertexIsFoundOnTheSurface) {
  const geometry::TetMesh mesh = geometry::read_mesh(path_, 1.0).mesh;
  const auto surface = geometry::boundary_surface(mesh.tets, geometry::tet_adjacency(mesh.tets));
  const geometry::TriangleTree tree(surface.triangles, mesh.vertices_m);
  for (const std::int32_t v : surface.vertices) {
    const Vec3& x = mesh.vertices_m[static_cast<std::size_t>(v)];
    const auto nearest = tree.nearest(x, 1e-9, mesh.vertices_m);
    ASSERT_TRUE(nearest.has_value()) << "vertex " << v;
    EXPECT_EQ(nearest->closest.squared_distance_m2, 0.0);
  }
}

TEST_P(Anatomy, MakesASceneThatIsHeldByABox) {
  const geometry::TetMesh mesh = geometry::read_mesh(path_, 1.0).mesh;
  Eigen::AlignedBox3d box;
  for (const Vec3& x : mesh.vertices_m) box.extend(x);
  const double floor = 0.04 * (box.min().z() + 0.15 * box.sizes().z());
  const testing::TemporaryFolder folder;
  const std::string body = "[[tissue]]\nname = \"organ\"\nmesh = \"" + path_ +
                           "\"\nscale = 0.04\nyoung_modulus_pa = 1e4\npoisson_ratio = 0.45\n";
  const std::string held = body + "fixed = [{ box = { min_m = [-1, -1, -1], max_m = [1, 1, " +
                           std::to_string(floor) + "] } }]\n";
  const scene::Scene scene = scene::read_scene(folder.write("held.toml", held));
  EXPECT_GT(scene.tissues[0].prescribed[0].vertices.size(), 3U);
  EXPECT_LT(scene.tissues[0].prescribed[0].vertices.size(), mesh.vertices_m.size() / 2);
  try {
    (void)scene::read_scene(folder.write("loose.toml", body));
    FAIL() << "a body that nothing holds was accepted";
  } catch (const scene::SceneError& error) {
    EXPECT_THAT(error.what(), ::testing::HasSubstr("is not fixed anywhere"));
  }
}

// Where the line from `start` along +y crosses the boundary, in order: the oracle of the drive.
std::vector<double> crossings_along_y(const geometry::TetMesh& mesh,
                                      const geometry::BoundarySurface& surface, const Vec3& start) {
  std::vector<double> at_y;
  for (const auto& t : surface.triangles) {
    const auto x = [&](std::size_t i) -> const Vec3& {
      return mesh.vertices_m[static_cast<std::size_t>(t[i])];
    };
    // Barycentric coordinates of the line in the triangle's shadow on the plane y = 0.
    const auto shadow = [](const Vec3& a, const Vec3& b) { return a.x() * b.z() - a.z() * b.x(); };
    const double area = shadow(x(1) - x(0), x(2) - x(0));
    const double b = shadow(start - x(0), x(2) - x(0)) / area;
    const double c = shadow(x(1) - x(0), start - x(0)) / area;
    if (b >= 0.0 && c >= 0.0 && b + c <= 1.0)
      at_y.push_back((1.0 - b - c) * x(0).y() + b * x(1).y() + c * x(2).y());
  }
  std::sort(at_y.begin(), at_y.end());
  return at_y;
}

// A tool's row of a surgeon file, at unit orientation.
std::string row(double time_s, const char* tool, const Vec3& p, double jaw) {
  std::ostringstream text;
  text.precision(17);
  text << time_s << ',' << tool << ',' << p.x() << ',' << p.y() << ',' << p.z() << ",0,0,0,1,"
       << jaw << '\n';
  return text.str();
}

TEST_P(Anatomy, IsFixedProbedAndDrivenThroughByANeedle) {
  const double scale = GetParam().scale;
  const geometry::TetMesh mesh = geometry::read_mesh(path_, scale).mesh;
  const auto surface = geometry::boundary_surface(mesh.tets, geometry::tet_adjacency(mesh.tets));
  Eigen::AlignedBox3d box;
  for (const Vec3& x : mesh.vertices_m) box.extend(x);
  const auto top = std::max_element(mesh.vertices_m.begin(), mesh.vertices_m.end(),
                                    [](const Vec3& a, const Vec3& b) { return a.z() < b.z(); });
  const double puncture_force_n = 0.05;

  // A straight needle along +y through the middle, its tip 3 mm before the bounding box.
  const double length = 1.3 * box.sizes().y();
  const Vec3 tail(box.center().x(), box.min().y() - length - 0.003, box.center().z());
  const auto crossings = crossings_along_y(mesh, surface, tail);
  ASSERT_EQ(crossings.size(), 2U) << "the line should pass the organ once";

  std::ostringstream scene;
  scene.precision(17);
  scene << "rate_hz = 250\n[[tissue]]\nname = \"organ\"\nmesh = \"" << path_
        << "\"\nscale = " << scale
        << "\nyoung_modulus_pa = 1e4\npoisson_ratio = 0.45\npuncture_force_n = " << puncture_force_n
        << "\nfixed = [{ box = { min_m = [-1, -1, -1], max_m = [1, 1, "
        << box.min().z() + 0.2 * box.sizes().z() << "] } }]\n"
        << "[[needle]]\nname = \"needle\"\nshape = \"straight\"\nlength_m = " << length
        << "\ndiameter_m = 0.001\npose = { position_m = [" << tail.x() << ", " << tail.y() << ", "
        << tail.z() << "], orientation = [0, 0, " << std::sqrt(0.5) << ", " << std::sqrt(0.5)
        << "] }\n"
        << "[[tool]]\nname = \"driver\"\n"
        << "[[tool]]\nname = \"probe\"\nkind = \"probe\"\nprobe_radius_m = 0.003\n";

  // Grasp, drive through at 20 mm/s, draw back; meanwhile the probe presses 2 mm on the top.
  const Vec3 grip = tail + Vec3(0.0, 0.002, 0.0);
  const Vec3 through = grip + Vec3(0.0, box.sizes().y() + 0.012, 0.0);
  const double there = 0.2 + (through - grip).norm() / 0.02;
  const Vec3 above = *top + Vec3(0.0, 0.0, 0.005);
  const Vec3 pressed = *top + Vec3(0.0, 0.0, 0.001);  // of the sphere's centre
  const std::string surgeon = "time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw\n" +
                              row(0.0, "driver", grip, 0.0) + row(0.1, "driver", grip, 1.0) +
                              row(0.2, "driver", grip, 1.0) + row(there, "driver", through, 1.0) +
                              row(2.0 * there, "driver", grip, 1.0) +
                              row(0.0, "probe", above, 0.0) + row(there, "probe", pressed, 0.0) +
                              row(2.0 * there, "probe", above, 0.0);

  const testing::TemporaryFolder folder;
  const testing::ProgramResult result = testing::run_program(
      {SUTURED_PROGRAM, "run", folder.write("scene.toml", scene.str()), "--surgeon",
       folder.write("surgeon.csv", surgeon), "--out", folder.path("out"), "--quiet"});
  ASSERT_EQ(result.exit_code, 0) << result.err;

  std::vector<std::string> kinds;
  std::istringstream events(testing::read_file(folder.path("out/events.jsonl")));
  for (std::string line; std::getline(events, line);) {
    const auto event = nlohmann::json::parse(line);
    const std::string kind = event.at("kind");
    if (kind == "contact" || event.at("subject") == "probe") continue;
    kinds.push_back(kind);
    const double y = event.at("position_m").at(1).get<double>();
    if (kind == "puncture") {
      // One step at 20 mm/s overshoots the threshold by less than a tenth.
      EXPECT_NEAR(event.at("force_n").get<double>(), puncture_force_n, 0.1 * puncture_force_n);
      EXPECT_NEAR(y, crossings[0], 0.005);  // the wall gives way by millimetres
    }
    if (kind == "exit" && kinds.size() == 3) {
      EXPECT_NEAR(y, crossings[1], 0.005);
    }
  }
  // In at the near wall, out at the far one, and all the way back out of the near one.
  EXPECT_THAT(kinds, ::testing::ElementsAre("grasp", "puncture", "exit", "exit"));

  const auto summary = nlohmann::json::parse(testing::read_file(folder.path("out/summary.json")));
  EXPECT_EQ(summary.at("vertices"), mesh.vertices_m.size());
  EXPECT_EQ(summary.at("tets"), mesh.tets.size());
  EXPECT_LT(summary.at("complementarity_residual_max").get<double>(), 1e-6);
  const auto& tools = summary.at("tools");
  EXPECT_GT(tools.at("driver").at("peak_force_n").get<double>(), puncture_force_n);
  EXPECT_LT(tools.at("driver").at("peak_force_n").get<double>(), 3.3);
  EXPECT_GT(tools.at("probe").at("peak_force_n").get<double>(), 0.005);
  EXPECT_LT(tools.at("probe").at("peak_force_n").get<double>(), 3.3);
  EXPECT_FALSE(summary.at("needles").at("needle").at("tip_inside").get<bool>());
  // The deformed mesh is a mesh: readable, and no tet inverted.
  EXPECT_EQ(geometry::read_mesh(folder.path("out/final.vtk"), 1.0).mesh.tets.size(),
            mesh.tets.size());
}

INSTANTIATE_TEST_SUITE_P(MadeByOthers, Anatomy,
                         ::testing::Values(Organ{"tongue.msh", 2238, 10980, 1940, 0.025},
                                           Organ{"liver.msh", 507, 1493, 860, 0.1}),
                         name_of);

}  // namespace
}  // namespace sutured
