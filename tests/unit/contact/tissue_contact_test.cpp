// SPDX-License-Identifier: GPL-3.0-or-later
#include "contact/tissue_contact.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <vector>

#include "support/block_mesh.hpp"

namespace sutured::contact {
namespace {

/// Two blocks, the second above the first by `kGap_m` and turned, so that edges cross.
constexpr double kGap_m = 0.75e-3;

struct Blocks {
  Blocks() {
    for (const bool upper : {false, true}) {
      const auto block = testing::block_mesh(6, 6, 2, {9e-3, 9e-3, 3e-3});
      const auto first = static_cast<std::int32_t>(rest_m.size());
      const Eigen::AngleAxisd turn(upper ? 0.3 : 0.0, Vec3::UnitZ());
      for (const Vec3& x : block.vertices_m)
        rest_m.push_back(turn * x + Vec3(0, 0, upper ? 3e-3 + kGap_m : 0.0));
      for (geometry::Tet tet : block.tets) {
        for (auto& v : tet) v += first;
        tets.push_back(tet);
      }
      if (!upper) upper_first = block.vertices_m.size();
    }
    surface = geometry::boundary_surface(tets, geometry::tet_adjacency(tets));
    tree = geometry::TriangleTree(surface.triangles, rest_m);
  }

  [[nodiscard]] TissueContact contact() const {
    std::vector<int> tissue;
    for (const geometry::Triangle& triangle : surface.triangles)
      tissue.push_back(static_cast<std::size_t>(triangle[0]) < upper_first ? 0 : 1);
    return {surface, rest_m, tissue, std::vector<double>(tissue.size(), 2e5)};
  }

  /// The upper block lowered and turned a little; its lower side, and the other's upper one, wavy.
  [[nodiscard]] std::vector<Vec3> lowered(double by_m) const {
    std::vector<Vec3> x = rest_m;
    for (std::size_t v = 0; v < x.size(); ++v) {
      const double wave_m = 0.1 * by_m * std::sin(1e3 * (rest_m[v].x() + 0.5 * rest_m[v].y()));
      if (v < upper_first) {
        x[v].z() += wave_m * rest_m[v].z() / 3e-3;
      } else {
        x[v] = Eigen::AngleAxisd(20.0 * by_m, Vec3::UnitX()) * x[v];
        x[v].z() += wave_m - by_m;
      }
    }
    return x;
  }

  std::vector<Vec3> rest_m;
  std::vector<geometry::Tet> tets;
  std::size_t upper_first = 0;
  geometry::BoundarySurface surface;
  geometry::TriangleTree tree;
};

std::vector<std::uint64_t> keys(const TissueContact& contact) {
  std::vector<std::uint64_t> out;
  for (const Pair& pair : contact.pairs()) out.push_back(pair.key());
  return out;
}

// One that is restored without its caches knows of nothing that is near, and looks at everything.
TEST(TissueContact, FindsInEveryStepWhatOneFindsThatLooksAtEverything) {
  Blocks blocks;
  TissueContact contact = blocks.contact(), anew = blocks.contact();
  double lowered_m = 0.0;
  std::size_t found = 0;
  int steps_with_pairs = 0;
  for (int step = 0; step < 160; ++step) {
    // Slowly, for a while so fast that the reach grows, and slowly again.
    lowered_m += step > 40 && step < 50 ? 35e-6 : 4e-6;
    const std::vector<Vec3> x = blocks.lowered(lowered_m);
    blocks.tree.refit(x);
    std::vector<std::byte> bytes;
    Archive out = Archive::writing(bytes, Archive::Caches::kLeftOut);
    contact.serialize(out);
    Archive in = Archive::reading(bytes);
    anew.serialize(in);
    contact.update(x, blocks.tree);
    anew.update(x, blocks.tree);
    ASSERT_EQ(keys(contact), keys(anew)) << "step " << step;
    found += contact.pairs().size();
    steps_with_pairs += !contact.pairs().empty();
  }
  EXPECT_GT(steps_with_pairs, 20);
  EXPECT_GT(found, 500U);
}

}  // namespace
}  // namespace sutured::contact
