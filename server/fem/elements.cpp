// SPDX-License-Identifier: GPL-3.0-or-later
#include "fem/elements.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <cmath>

namespace sutured::fem {

TetShape tet_shape(const std::array<Vec3, 4>& x) {
  const Vec3 e1 = x[1] - x[0], e2 = x[2] - x[0], e3 = x[3] - x[0];
  const double determinant = e1.dot(e2.cross(e3));
  TetShape shape;
  shape.volume_m3 = determinant / 6.0;
  shape.gradient[1] = e2.cross(e3) / determinant;
  shape.gradient[2] = e3.cross(e1) / determinant;
  shape.gradient[3] = e1.cross(e2) / determinant;
  shape.gradient[0] = -(shape.gradient[1] + shape.gradient[2] + shape.gradient[3]);
  return shape;
}

Mat3 stiffness_block(const TetShape& shape, const Material& material, int a, int b) {
  const Vec3& ga = shape.gradient[static_cast<std::size_t>(a)];
  const Vec3& gb = shape.gradient[static_cast<std::size_t>(b)];
  const double lambda = material.lambda_pa(), mu = material.mu_pa();
  return shape.volume_m3 * (lambda * ga * gb.transpose() + mu * gb * ga.transpose() +
                            mu * ga.dot(gb) * Mat3::Identity());
}

Vec6 tet_stress_pa(const TetShape& shape, const Material& material, const std::array<Vec3, 4>& u) {
  Mat3 gradient = Mat3::Zero();
  for (std::size_t a = 0; a < 4; ++a) gradient += u[a] * shape.gradient[a].transpose();
  const Mat3 strain = 0.5 * (gradient + gradient.transpose());
  const Mat3 stress =
      material.lambda_pa() * strain.trace() * Mat3::Identity() + 2.0 * material.mu_pa() * strain;
  Vec6 result;
  result << stress(0, 0), stress(1, 1), stress(2, 2), stress(0, 1), stress(1, 2), stress(2, 0);
  return result;
}

double von_mises_pa(const Vec6& s) {
  return std::sqrt(0.5 * ((s[0] - s[1]) * (s[0] - s[1]) + (s[1] - s[2]) * (s[1] - s[2]) +
                          (s[2] - s[0]) * (s[2] - s[0])) +
                   3.0 * (s[3] * s[3] + s[4] * s[4] + s[5] * s[5]));
}

Vec3 principal_stress_pa(const Vec6& s) noexcept {
  Mat3 stress;
  stress << s[0], s[3], s[5],  //
      s[3], s[1], s[4],        //
      s[5], s[4], s[2];
  Eigen::SelfAdjointEigenSolver<Mat3> solver;
  return solver.computeDirect(stress, Eigen::EigenvaluesOnly).eigenvalues().reverse();
}

Eigen::Vector4d barycentric(const std::array<Vec3, 4>& x, const Vec3& p) {
  const TetShape shape = tet_shape(x);
  Eigen::Vector4d result;
  for (int a = 1; a < 4; ++a) result[a] = shape.gradient[static_cast<std::size_t>(a)].dot(p - x[0]);
  result[0] = 1.0 - result[1] - result[2] - result[3];
  return result;
}

}  // namespace sutured::fem
