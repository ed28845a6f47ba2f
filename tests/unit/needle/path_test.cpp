// SPDX-License-Identifier: GPL-3.0-or-later
// The path of the needle against brute force: every tet against the needle's axis.
#include "needle/path.hpp"

#include <gtest/gtest.h>

#include <numbers>
#include <random>

#include "support/block_mesh.hpp"
#include "support/tissue.hpp"

namespace sutured::needle {
namespace {

struct Stretch {
  std::int32_t tet;
  double from, to;
};

/// Every stretch of the axis within [0, length] that lies in a tet, by clipping against all.
std::vector<Stretch> brute_force(const TissueView& tissue, const Curve& curve, const Pose& pose) {
  std::vector<Stretch> found;
  for (std::int32_t t = 0; t < static_cast<std::int32_t>(tissue.tets.size()); ++t) {
    std::vector<double> cuts{0.0, curve.length_m()};
    std::array<Vec3, 4> n;
    std::array<double, 4> offset;
    for (int face = 0; face < 4; ++face) {
      const auto f = geometry::tet_face(tissue.tets[static_cast<std::size_t>(t)], face);
      const auto x = [&](int i) {
        return tissue.positions_m[static_cast<std::size_t>(f[static_cast<std::size_t>(i)])];
      };
      const auto i = static_cast<std::size_t>(face);
      n[i] = (x(1) - x(0)).cross(x(2) - x(0)).normalized();
      offset[i] = n[i].dot(x(0));
      std::array<double, 2> s;
      const int count = curve.meets_plane(pose, n[i], offset[i], 0.0, curve.length_m(), s);
      cuts.insert(cuts.end(), s.begin(), s.begin() + count);
    }
    std::sort(cuts.begin(), cuts.end());
    for (std::size_t k = 0; k + 1 < cuts.size(); ++k) {
      const Vec3 p = curve.point(pose, 0.5 * (cuts[k] + cuts[k + 1]));
      bool inside = true;
      for (std::size_t i = 0; i < 4; ++i) inside = inside && n[i].dot(p) <= offset[i];
      if (inside) found.push_back({t, cuts[k], cuts[k + 1]});
    }
  }
  return found;
}

constexpr double kShortest_m = 1e-8;  // shorter stretches hang on rounding

std::vector<Stretch> long_ones(std::vector<Stretch> stretches) {
  std::erase_if(stretches, [](const Stretch& s) { return s.to - s.from < kShortest_m; });
  std::sort(stretches.begin(), stretches.end(),
            [](const Stretch& a, const Stretch& b) { return a.from < b.from; });
  return stretches;
}

std::vector<Stretch> active_stretches(const Path& path, const Curve& curve) {
  std::vector<Stretch> result;
  for (const Cell& cell : path.cells())
    result.push_back(
        {cell.tet, std::max(cell.s_back, 0.0), std::min(cell.s_front, curve.length_m())});
  return long_ones(result);
}

/// Two blocks of 20 mm with a gap of 3 mm, their inner vertices shifted.
testing::OwnedTissue two_blocks() {
  auto mesh = testing::block_mesh(4, 4, 4, Vec3(0.02, 0.02, 0.02));
  std::mt19937_64 random(13);
  std::uniform_real_distribution<double> shift(-0.001, 0.001);
  for (Vec3& x : mesh.vertices_m)
    if (x.minCoeff() > 1e-6 && x.maxCoeff() < 0.02 - 1e-6)
      x += Vec3(shift(random), shift(random), shift(random));
  const auto count = static_cast<std::int32_t>(mesh.vertices_m.size());
  const auto other = mesh;
  for (const Vec3& x : other.vertices_m) mesh.vertices_m.push_back(x + Vec3(0.023, 0, 0));
  for (geometry::Tet tet : other.tets) {
    for (auto& v : tet) v += count;
    mesh.tets.push_back(tet);
  }
  return testing::OwnedTissue(std::move(mesh));
}

class PathDrives : public ::testing::TestWithParam<bool> {
 protected:
  double uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random_);
  }
  Pose random_pose() {
    Pose pose;
    pose.position_m = Vec3(uniform(-0.01, 0.053), uniform(-0.01, 0.03), uniform(-0.01, 0.03));
    pose.orientation = Eigen::Quaterniond(std::normal_distribution<double>()(random_),
                                          std::normal_distribution<double>()(random_),
                                          std::normal_distribution<double>()(random_),
                                          std::normal_distribution<double>()(random_))
                           .normalized();
    return pose;
  }
  Curve random_curve() {
    return GetParam() ? Curve::arc(uniform(0.004, 0.012), uniform(0.5, 3.5))
                      : Curve::straight(uniform(0.005, 0.06));
  }
  std::mt19937_64 random_{101};
};

TEST_P(PathDrives, MatchBruteForceAtAnyStepForwardsAndBackwards) {
  const auto tissue = two_blocks();
  const auto view = tissue.view();
  int drives = 0, compared = 0, several_cells = 0, several_bites = 0;
  for (int attempt = 0; attempt < 40000 && drives < 1000; ++attempt) {
    const Curve curve = random_curve();
    Pose pose = random_pose();
    if (!curve.is_arc())
      pose = curve.slid(pose, -curve.length_m() - 0.06);
    else
      pose.position_m[2] = uniform(0, 1) < 0.5 ? uniform(-0.006, 0.003) : uniform(0.017, 0.026);
    if (!brute_force(view, curve, pose).empty()) continue;  // start outside
    ++drives;
    Path path(curve, 7);
    const double largest = std::exp(uniform(std::log(0.05e-3), std::log(20e-3)));
    double travelled = 0.0;
    for (int step = 0; step < 25; ++step) {
      double slide = uniform(-0.4, 1.0) * largest;
      const double turn = 2 * std::numbers::pi * curve.radius_m() - curve.length_m();
      if (step == 0) slide = curve.is_arc() ? uniform(0.2, 0.8) * turn : curve.length_m() + 0.02;
      slide = std::max(slide, -travelled);
      travelled += slide;
      if (curve.is_arc() && travelled > turn) break;
      pose = curve.slid(pose, slide);
      const std::size_t before = path.cells().size();
      path.slide(view, pose, slide, Passage::kFree);
      several_cells += path.cells().size() > before + 3;
      const auto expected = long_ones(brute_force(view, curve, pose));
      const auto got = active_stretches(path, curve);
      ASSERT_EQ(got.size(), expected.size()) << "drive " << drives << " step " << step;
      int bites = 0;
      for (std::size_t i = 0; i < got.size(); ++i) {
        EXPECT_EQ(got[i].tet, expected[i].tet) << "drive " << drives << " step " << step;
        EXPECT_NEAR(got[i].from, expected[i].from, 1e-11);
        EXPECT_NEAR(got[i].to, expected[i].to, 1e-11);
        bites += i == 0 || got[i].from > got[i - 1].to + kShortest_m;
      }
      several_bites += bites > 1;
      compared += !got.empty();
    }
  }
  EXPECT_GE(drives, 1000);
  EXPECT_GT(compared, 4000);
  EXPECT_GT(several_cells, 150);
  EXPECT_GT(several_bites, 50);
}

/// Through vertices, along edges and within faces the cells are a matter of choice; what is not:
/// each holds its stretch, and together they hold as much of the needle as the tissue does.
TEST_P(PathDrives, CoverTheNeedleThroughVerticesEdgesAndFaces) {
  const testing::OwnedTissue tissue(testing::block_mesh(4, 4, 4, Vec3(0.02, 0.02, 0.02)));
  const auto view = tissue.view();
  const auto vertex = [&] {
    return tissue.mesh.vertices_m[random_() % tissue.mesh.vertices_m.size()];
  };
  int checked = 0;
  for (int drive = 0; drive < 1000; ++drive) {
    const Vec3 a = vertex(), b = vertex();
    if ((b - a).norm() < 1e-6) continue;
    Curve curve = Curve::straight(0.05);
    Pose pose;
    if (GetParam()) {
      // A circle through two vertices, in a plane with a third or a random one.
      const Vec3 across = (vertex() - a).cross(b - a);
      if (across.norm() < 1e-12) continue;
      const double chord = (b - a).norm(), radius = chord * uniform(0.55, 2.0);
      const Vec3 e = (b - a).normalized(), n = across.normalized();
      pose.position_m =
          0.5 * (a + b) + n.cross(e) * std::sqrt(radius * radius - 0.25 * chord * chord);
      Eigen::Matrix3d frame;
      frame.col(0) = (a - pose.position_m).normalized();
      frame.col(2) = n;
      frame.col(1) = n.cross(frame.col(0));
      pose.orientation = Eigen::Quaterniond(frame);
      curve = Curve::arc(radius, 1.0);
      pose = curve.slid(pose, -uniform(1.5, 3.0) * radius);
    } else {
      pose.orientation = Eigen::Quaterniond::FromTwoVectors(Vec3::UnitX(), b - a);
      pose.position_m = a - 0.1 * (b - a).normalized();
    }
    if (!brute_force(view, curve, pose).empty()) continue;
    Path path(curve, 11);
    for (int step = 0; step < 40; ++step) {
      const double slide = curve.is_arc() ? 0.1 * curve.radius_m() : 0.004;
      pose = curve.slid(pose, slide);
      path.slide(view, pose, slide, Passage::kFree);
      double inside = 0.0;
      for (const Cell& cell : path.cells()) {
        if (cell.active_length_m == 0.0) continue;
        inside += cell.active_length_m;
        EXPECT_GT(
            fem::barycentric(view.corners(cell.tet), curve.point(pose, cell.s_mid)).minCoeff(),
            -1e-6);
      }
      // The oracle counts a stretch within a face once per tet beside it, and one just outside
      // the boundary by rounding not at all: take it from sampling, at 1 µm.
      double expected = 0.0, grazing = 0.0;
      constexpr int kSamples = 2000;
      for (int i = 0; i < kSamples; ++i) {
        const Vec3 p = curve.point(pose, curve.length_m() * (i + 0.5) / kSamples);
        const double depth = std::min(p.minCoeff(), 0.02 - p.maxCoeff());
        expected += depth > 1e-9;
        grazing += std::abs(depth) <= 1e-9;
      }
      const double sample = curve.length_m() / kSamples;
      EXPECT_GT(inside, expected * sample - 4 * sample) << "drive " << drive << " step " << step;
      EXPECT_LT(inside, (expected + grazing) * sample + 4 * sample)
          << "drive " << drive << " step " << step;
      ++checked;
    }
  }
  EXPECT_GT(checked, 3000);
}

TEST_P(PathDrives, RetractingUndoesTheDrive) {
  const auto tissue = two_blocks();
  const auto view = tissue.view();
  const Curve curve = GetParam() ? Curve::arc(0.008, std::numbers::pi) : Curve::straight(0.03);
  Pose pose;
  pose.position_m = Vec3(0.0215, 0.01, 0.024);
  if (!GetParam()) {
    pose.position_m = Vec3(-0.04, 0.0101, 0.0093);
  } else {
    pose.orientation = Eigen::AngleAxisd(std::numbers::pi / 2, Vec3::UnitX()) *
                       Eigen::AngleAxisd(0.3, Vec3::UnitZ());
  }
  Path path(curve, 3);
  double travelled = 0.0;
  std::size_t most = 0;
  for (int i = 0; i < 60; ++i) {
    const double slide = GetParam() ? 0.0004 : 0.0008;
    pose = curve.slid(pose, slide);
    travelled += slide;
    path.slide(view, pose, slide, Passage::kFree);
    most = std::max(most, path.cells().size());
  }
  EXPECT_GT(most, 5U);
  pose = curve.slid(pose, -travelled);
  const auto crossings = path.slide(view, pose, -travelled, Passage::kFree);
  EXPECT_TRUE(path.cells().empty());
  ASSERT_FALSE(crossings.empty());
  EXPECT_EQ(crossings.back().kind, Crossing::Kind::kWithdrawn);
}

TEST(Path, AClosedBoundaryStopsTheTip) {
  const testing::OwnedTissue tissue(testing::block_mesh(2, 2, 2, Vec3(0.01, 0.01, 0.01)));
  const auto view = tissue.view();
  const Curve curve = Curve::straight(0.03);
  Pose pose;
  pose.position_m = Vec3(-0.0301, 0.0031, 0.0042);  // the tip is 0.1 mm before the block
  Path path(curve, 1);
  pose = curve.slid(pose, 0.001);
  EXPECT_TRUE(path.slide(view, pose, 0.001, Passage::kClosed).empty());
  EXPECT_FALSE(path.tip_inside());
  const auto entry = Path::first_entry(view, curve, pose, 0.028, 0.03);
  ASSERT_TRUE(entry);
  EXPECT_NEAR(entry->second, 0.0291, 1e-12);
  path.enter(view, pose, entry->first, entry->second);
  EXPECT_TRUE(path.tip_inside());
  EXPECT_NEAR(path.embedded_length_m(), 0.0009, 1e-12);
  pose = curve.slid(pose, 0.005);
  path.slide(view, pose, 0.005, Passage::kClosed);
  const auto ahead = path.boundary_ahead(view, pose, 0.01);
  ASSERT_TRUE(ahead);
  EXPECT_NEAR(ahead->second - curve.length_m(), 0.0041, 1e-12);
  pose = curve.slid(pose, 0.006);
  const auto crossings = path.slide(view, pose, 0.006, Passage::kClosed);
  ASSERT_EQ(crossings.size(), 1U);
  EXPECT_EQ(crossings[0].kind, Crossing::Kind::kBlocked);
  EXPECT_TRUE(path.tip_inside());
  path.leave(view, pose, crossings[0].at);
  EXPECT_FALSE(path.tip_inside());
  EXPECT_NEAR(path.embedded_length_m(), 0.01, 1e-12);
}

/// A slide exerts no force: the residual of a row shrinks as its stretch grows, so that
/// residual × length stays, and keeps as it shrinks.
TEST(Path, ResidualTimesLengthNeverGrowsInASlide) {
  const testing::OwnedTissue tissue(testing::block_mesh(2, 2, 2, Vec3(0.01, 0.01, 0.01)));
  const auto view = tissue.view();
  const Curve curve = Curve::straight(0.03);
  Pose pose;
  pose.position_m = Vec3(-0.0235, 0.0031, 0.0042);
  Path path(curve, 1);
  const auto entry = Path::first_entry(view, curve, pose, 0.02, 0.03);
  ASSERT_TRUE(entry);
  path.enter(view, pose, entry->first, entry->second);
  pose.position_m += Vec3(0, 20e-6, -10e-6);  // sideways: every row now has this residual
  const auto force = [&](const Cell& cell) {
    return Vec3((view.at(cell.tet, cell.barycentric) - curve.point(pose, cell.s_mid)) *
                coupling_length_m(cell));
  };
  std::vector<Vec3> before;
  for (const Cell& cell : path.cells()) before.push_back(force(cell));
  ASSERT_GE(before.size(), 2U);
  ASSERT_GT(before[0].norm(), 1e-9);
  pose = curve.slid(pose, 0.0023);
  path.slide(view, pose, 0.0023, Passage::kClosed);
  ASSERT_GT(path.cells().size(), before.size());
  for (std::size_t i = 0; i < path.cells().size(); ++i)
    EXPECT_LT((force(path.cells()[i]) - (i < before.size() ? before[i] : Vec3::Zero())).norm(),
              1e-15)
        << i;
}

INSTANTIATE_TEST_SUITE_P(StraightAndArc, PathDrives, ::testing::Bool(),
                         [](const auto& shape) { return shape.param ? "Arc" : "Straight"; });

}  // namespace
}  // namespace sutured::needle
