// SPDX-License-Identifier: GPL-3.0-or-later
// Meshes made by others: tongue and liver of a public project, read from the folder beside the
// checkout (or $SUTURED_SHARED_DIR) and never copied here.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <string>

#include "geometry/mesh_quality.hpp"
#include "geometry/mesh_reader.hpp"
#include "geometry/topology.hpp"
#include "geometry/triangle_tree.hpp"
#include "scene/scene_reader.hpp"
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

INSTANTIATE_TEST_SUITE_P(MadeByOthers, Anatomy,
                         ::testing::Values(Organ{"tongue.msh", 2238, 10980, 1940},
                                           Organ{"liver.msh", 507, 1493, 860}),
                         name_of);

}  // namespace
}  // namespace sutured
