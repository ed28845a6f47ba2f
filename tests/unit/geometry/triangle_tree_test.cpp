// SPDX-License-Identifier: GPL-3.0-or-later
#include "geometry/triangle_tree.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <random>
#include <stdexcept>
#include <vector>

namespace sutured::geometry {
namespace {

Vec3 random_point(std::mt19937_64& random) {
  std::uniform_real_distribution<double> coordinate(-1.0, 1.0);
  const double x = coordinate(random);
  const double y = coordinate(random);
  return {x, y, coordinate(random)};
}

struct Soup {
  std::vector<Vec3> vertices_m;
  std::vector<Triangle> triangles;
};

// Small triangles strewn over the cube [−1, 1]³.
Soup random_soup(std::mt19937_64& random, int count) {
  Soup soup;
  for (int t = 0; t < count; ++t) {
    const Vec3 middle = random_point(random);
    const auto first = static_cast<std::int32_t>(soup.vertices_m.size());
    for (int i = 0; i < 3; ++i) soup.vertices_m.push_back(middle + 0.1 * random_point(random));
    soup.triangles.push_back({first, first + 1, first + 2});
  }
  return soup;
}

ClosestPoint closest(const Soup& soup, std::size_t t, const Vec3& p) {
  const auto x = [&](std::size_t i) {
    return soup.vertices_m[static_cast<std::size_t>(soup.triangles[t][i])];
  };
  return closest_point_on_triangle(p, x(0), x(1), x(2));
}

std::vector<std::int32_t> overlaps_by_all(const Soup& soup, const Box& query) {
  std::vector<std::int32_t> found;
  for (std::size_t t = 0; t < soup.triangles.size(); ++t) {
    Box box;
    for (const std::int32_t v : soup.triangles[t])
      box.extend(soup.vertices_m[static_cast<std::size_t>(v)]);
    if (box.intersects(query)) found.push_back(static_cast<std::int32_t>(t));
  }
  return found;
}

void expect_same_answers_as_brute_force(const TriangleTree& tree, const Soup& soup,
                                        std::mt19937_64& random) {
  for (int q = 0; q < 300; ++q) {
    const Vec3 p = 1.3 * random_point(random);
    Box box(p);
    box.extend(p + 0.3 * random_point(random));
    std::vector<std::int32_t> found;
    tree.for_each_overlap(box, [&](std::int32_t t) { found.push_back(t); });
    std::sort(found.begin(), found.end());
    EXPECT_EQ(found, overlaps_by_all(soup, box));

    const double radius = 0.05 + 0.5 * (q % 5);
    double best = std::numeric_limits<double>::infinity();
    std::int32_t best_triangle = -1;
    for (std::size_t t = 0; t < soup.triangles.size(); ++t) {
      const double squared = closest(soup, t, p).squared_distance_m2;
      if (squared <= radius * radius && squared < best) {
        best = squared;
        best_triangle = static_cast<std::int32_t>(t);
      }
    }
    const auto nearest = tree.nearest(p, radius, soup.vertices_m);
    ASSERT_EQ(nearest.has_value(), best_triangle >= 0);
    if (!nearest) continue;
    EXPECT_EQ(nearest->triangle, best_triangle);
    EXPECT_EQ(nearest->closest.squared_distance_m2, best);
  }
}

TEST(TriangleTree, AnswersAsBruteForceDoesForAnyCount) {
  std::mt19937_64 random(2);
  for (const int count : {1, 2, 4, 5, 9, 64, 700}) {
    const Soup soup = random_soup(random, count);
    const TriangleTree tree(soup.triangles, soup.vertices_m);
    expect_same_answers_as_brute_force(tree, soup, random);
  }
}

TEST(TriangleTree, FollowsMovedVerticesAfterARefit) {
  std::mt19937_64 random(3);
  Soup soup = random_soup(random, 400);
  TriangleTree tree(soup.triangles, soup.vertices_m);
  for (int move = 0; move < 3; ++move) {
    for (Vec3& x : soup.vertices_m) x += 0.2 * random_point(random);
    tree.refit(soup.vertices_m);
    expect_same_answers_as_brute_force(tree, soup, random);
  }
}

// Triangles all around a sphere, so that normals vary smoothly: cones are narrow and prune.
TEST(TriangleTree, VisitsEveryTriangleThatFacesADirection) {
  std::mt19937_64 random(11);
  Soup soup;
  std::vector<Vec3> normals;
  for (int t = 0; t < 2000; ++t) {
    const Vec3 out = random_point(random).normalized();
    const Vec3 across = 0.05 * out.unitOrthogonal(), up = out.cross(across);
    const auto first = static_cast<std::int32_t>(soup.vertices_m.size());
    for (const Vec3& x : {Vec3(out - across), Vec3(out + across), Vec3(out + up)})
      soup.vertices_m.push_back(x);
    soup.triangles.push_back({first, first + 1, first + 2});
    normals.push_back(t % 100 == 0 ? Vec3::Zero().eval() : out);  // some without area
  }
  const TriangleTree tree(soup.triangles, soup.vertices_m);
  std::vector<DirectionCone> cones;
  tree.fit_cones(normals, cones);
  std::size_t visited_all = 0, near_all = 0;
  for (int q = 0; q < 500; ++q) {
    const Vec3 p = random_point(random);
    const Box box(p - Vec3::Constant(0.3), p + Vec3::Constant(0.3));
    const Vec3 a = random_point(random).normalized();
    const Vec3 b = (a + 0.5 * random_point(random)).normalized();
    const auto own = DirectionCone::around(2, [&](std::size_t i) { return i == 0 ? a : b; });
    for (const double cosine_max : {0.0, -0.3, -0.9}) {
      std::vector<std::int32_t> found;
      tree.for_each_opposing(box, cones, OpposingDirections(own, cosine_max),
                             [&](std::int32_t t) { found.push_back(t); });
      std::sort(found.begin(), found.end());
      const auto near = overlaps_by_all(soup, box);
      for (const std::int32_t t : near) {
        const Vec3& n = normals[static_cast<std::size_t>(t)];
        const bool faces = std::min(n.dot(a), n.dot(b)) < cosine_max;
        EXPECT_TRUE(!faces || std::binary_search(found.begin(), found.end(), t));
      }
      EXPECT_TRUE(std::includes(near.begin(), near.end(), found.begin(), found.end()));
      visited_all += found.size();
      near_all += near.size();
    }
  }
  EXPECT_LT(visited_all, near_all / 2);  // it does pass over
}

TEST(TriangleTree, LowerTriangleWinsATie) {
  // Two triangles back to back: both are equally near to anything.
  const std::vector<Vec3> x{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  const std::vector<Triangle> triangles{{0, 1, 2}, {0, 2, 1}};
  const TriangleTree tree(triangles, x);
  EXPECT_EQ(tree.nearest({0.2, 0.2, 1.0}, 2.0, x)->triangle, 0);
}

TEST(TriangleTree, OfTheTrianglesAtAnEdgeTheOneFarthestFromThePointIsNearest) {
  // A rim: a wall that faces +x and a cap that faces +z meet along y, in both orders. Points in
  // front of the wall and hardly above the cap's plane are nearest to that edge.
  const std::vector<Vec3> x{{0, 0, 0}, {0, 1, 0}, {0, 0, -1}, {-1, 0, 0}};
  const Triangle wall{0, 2, 1}, cap{0, 1, 3};
  std::mt19937_64 random(12);
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  for (const auto& triangles :
       {std::vector<Triangle>{wall, cap}, std::vector<Triangle>{cap, wall}}) {
    const TriangleTree tree(triangles, x);
    for (int i = 0; i < 1000; ++i) {
      const double off_wall = 0.1 + uniform(random), above_cap = 0.09 * uniform(random);
      const Vec3 p(off_wall, 0.1 + 0.8 * uniform(random), above_cap);
      const auto nearest = tree.nearest(p, 2.0, x);
      ASSERT_TRUE(nearest.has_value());
      EXPECT_EQ(triangles[static_cast<std::size_t>(nearest->triangle)], wall) << p.transpose();
    }
  }
}

TEST(TriangleTree, WithoutTrianglesFindsNothing) {
  const TriangleTree tree;
  EXPECT_FALSE(tree.nearest(Vec3::Zero(), 1e9, {}).has_value());
  int visits = 0;
  tree.for_each_overlap(Box(Vec3::Constant(-1), Vec3::Constant(1)), [&](int) { ++visits; });
  EXPECT_EQ(visits, 0);
  EXPECT_TRUE(tree.bounds().isEmpty());
}

TEST(TriangleTree, RefusesAnIndexOutOfRange) {
  const std::vector<Vec3> x{{0, 0, 0}};
  const std::vector<Triangle> triangles{{0, 0, 1}};
  EXPECT_THROW(TriangleTree(triangles, x), std::invalid_argument);
}

}  // namespace
}  // namespace sutured::geometry
