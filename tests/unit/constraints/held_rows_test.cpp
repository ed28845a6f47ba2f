// SPDX-License-Identifier: GPL-3.0-or-later
#include "constraints/held_rows.hpp"

#include <gtest/gtest.h>

#include <array>

namespace sutured::constraints {
namespace {

constexpr std::array<double, 2> kLambda_n{0.3, -0.2};
const std::array<Vec3, 3> kPositions{Vec3(0.01, 0, 0), Vec3(0, 0.02, 0), Vec3(0, 0.01, 0.03)};

/// Two rows whose coefficients are `change` away from those of `two_rows(0)`.
ConstraintRows two_rows(double change) {
  ConstraintRows rows;
  rows.add(Bounds::bilateral(), 1e-3, 2e-4 * (1.0 + change)).key = 7;
  rows.touch(0, Vec3(0.6 + change, 0.8, 0));
  rows.touch(2, Vec3(-0.6, -0.8 + change, 0));
  rows.add(Bounds::unilateral(), 2e-3, 0.0).key = 8;
  rows.touch(1, Vec3(0, 1, change));
  return rows;
}

double gap_m(const ConstraintRows& rows, int i) {
  double gap =
      rows[i].compliance_m_per_n * kLambda_n[static_cast<std::size_t>(i)] - rows[i].target_m;
  for (const Entry& entry : rows.entries(rows[i]))
    gap += entry.coefficient.dot(kPositions[static_cast<std::size_t>(entry.vertex)]);
  return gap;
}

TEST(HeldRows, TakeTheCoefficientsBeforeAndKeepTheirGaps) {
  const ConstraintRows before = two_rows(0), fresh = two_rows(0.9 * kHeldChange);
  ConstraintRows rows = fresh;
  ASSERT_TRUE(hold_coefficients(rows, before, kPositions));
  for (int i = 0; i < 2; ++i) {
    const std::span<const Entry> got = rows.entries(rows[i]), expected = before.entries(before[i]);
    for (std::size_t e = 0; e < expected.size(); ++e)
      EXPECT_EQ(got[e].coefficient, expected[e].coefficient);
    EXPECT_EQ(rows[i].compliance_m_per_n, before[i].compliance_m_per_n);
    EXPECT_NEAR(gap_m(rows, i), gap_m(fresh, i), 2e-4 * kHeldChange);
  }
  EXPECT_EQ(gap_m(rows, 1), gap_m(fresh, 1));
}

TEST(HeldRows, AreAllOrNone) {
  const ConstraintRows before = two_rows(0);
  const auto is_refused = [&](ConstraintRows rows) {
    const double target_m = rows.size() > 0 ? rows[0].target_m : 0.0;
    return !hold_coefficients(rows, before, kPositions) &&
           (rows.size() == 0 || rows[0].target_m == target_m);
  };
  EXPECT_TRUE(is_refused(two_rows(1.1 * kHeldChange)));
  EXPECT_TRUE(is_refused({}));
  ConstraintRows rows = two_rows(0);
  rows[1].key = 9;
  EXPECT_TRUE(is_refused(rows)) << "another row";
  rows = two_rows(0);
  rows[1].needle = 0;
  EXPECT_TRUE(is_refused(rows)) << "of a needle";
  rows = two_rows(0);
  rows.touch(2, Vec3(1e-9, 0, 0));
  EXPECT_TRUE(is_refused(rows)) << "one more vertex";
  rows = two_rows(0);
  rows[1].compliance_m_per_n = 1e-12;
  EXPECT_TRUE(is_refused(rows)) << "another compliance";
}

}  // namespace
}  // namespace sutured::constraints
