// SPDX-License-Identifier: GPL-3.0-or-later
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "simulation/tissue_state.hpp"
#include "support/block_mesh.hpp"

namespace sutured::simulation {
namespace {

using ::testing::ElementsAre;

scene::Tissue block(double young_modulus_pa) {
  scene::Tissue tissue;
  tissue.mesh = testing::block_mesh(1, 1, 1);
  tissue.young_modulus_pa = young_modulus_pa;
  tissue.poisson_ratio = 0.3;
  return tissue;
}

TEST(AssembleModel, GivesTheTetsOfARegionItsMaterial) {
  scene::Scene scene;
  scene.tissues = {block(1e5), block(2e5)};
  scene.tissues[1].regions.push_back({"stiff", {1, 4}, 9e5, 0.4});
  // A group of that name that is no volume must not matter.
  scene.tissues[1].mesh.groups.push_back({"stiff", 2, {0, 1, 2}, {{0, 1, 2}}, {}});
  const fem::Model model = assemble_model(scene);
  std::vector<double> young_modulus_pa;
  for (const auto material : model.material_of_tet)
    young_modulus_pa.push_back(
        model.materials[static_cast<std::size_t>(material)].young_modulus_pa);
  EXPECT_THAT(young_modulus_pa,
              ElementsAre(1e5, 1e5, 1e5, 1e5, 1e5, 1e5, 2e5, 9e5, 2e5, 2e5, 9e5, 2e5));
}

TEST(AssembleModel, NumbersTissuesOneAfterTheOther) {
  scene::Scene scene;
  scene.tissues = {block(1e5), block(2e5)};
  scene.tissues[1].prescribed.push_back({{3}, {false, true, false}, {7.0, 0.001, 7.0}});
  scene.tissues[1].loads.push_back({{2}, {{1.0, 2.0, 3.0}}});
  const fem::Model model = assemble_model(scene);
  ASSERT_EQ(model.vertices_m.size(), 16U);
  EXPECT_EQ(model.tets[6][0], scene.tissues[1].mesh.tets[0][0] + 8);
  for (std::size_t i = 0; i < 48; ++i) {
    EXPECT_EQ(model.prescribed[i], i == 3 * 11 + 1 ? 1 : 0) << i;
    const double load = i >= 30 && i < 33 ? static_cast<double>(i - 29) : 0.0;
    EXPECT_EQ(model.load_n[i], load) << i;
  }
  EXPECT_EQ(model.prescribed_m[3 * 11 + 1], 0.001);
}

}  // namespace
}  // namespace sutured::simulation
