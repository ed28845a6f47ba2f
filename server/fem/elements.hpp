// SPDX-License-Identifier: GPL-3.0-or-later
// The linear tetrahedron (C3D4): constant strain, one material per element.
#pragma once

#include <Eigen/Core>
#include <array>

#include "geometry/tet_mesh.hpp"

namespace sutured::fem {

using geometry::Tet;
using geometry::Vec3;
using Mat3 = Eigen::Matrix3d;
using Vec6 = Eigen::Matrix<double, 6, 1>;

/// Isotropic linear elasticity.
struct Material {
  double young_modulus_pa = 0.0;  ///< E > 0
  double poisson_ratio = 0.0;     ///< 0 ≤ ν < 0.5
  [[nodiscard]] double lambda_pa() const {
    return young_modulus_pa * poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio));
  }
  [[nodiscard]] double mu_pa() const { return young_modulus_pa / (2 * (1 + poisson_ratio)); }
};

/// Gradients of the four barycentric coordinates (1/m) and the volume (m³) of a tet.
struct TetShape {
  std::array<Vec3, 4> gradient;
  double volume_m3 = 0.0;
};

/// Computes the shape of the tet with corners `x` (m); the volume is signed.
[[nodiscard]] TetShape tet_shape(const std::array<Vec3, 4>& x);

/// Returns block (a, b) of the element stiffness, N/m:
///
///     K_ab = V (λ ∇φ_a ∇φ_bᵀ + μ ∇φ_b ∇φ_aᵀ + μ (∇φ_a · ∇φ_b) I)
[[nodiscard]] Mat3 stiffness_block(const TetShape& shape, const Material& material, int a, int b);

/// Returns the Cauchy stress (xx, yy, zz, xy, yz, zx; Pa) of corner displacements `u` (m).
[[nodiscard]] Vec6 tet_stress_pa(const TetShape& shape, const Material& material,
                                 const std::array<Vec3, 4>& u);

/// Returns the von Mises equivalent (Pa) of a stress (xx, yy, zz, xy, yz, zx; Pa).
[[nodiscard]] double von_mises_pa(const Vec6& stress_pa);

/// Returns the principal stresses (Pa) of a stress (xx, yy, zz, xy, yz, zx; Pa): its eigenvalues,
/// largest first, in closed form.
///
/// Where two nearly coincide each is off by up to the square root of the rounding error: 1e-7 of
/// the largest component. Allocates: never. Cost: a tenth of a microsecond.
[[nodiscard]] Vec3 principal_stress_pa(const Vec6& stress_pa) noexcept;

/// Returns the barycentric coordinates of `p` in the tet with corners `x`; they sum to one and
/// extend linearly outside. The tet must not be flat.
[[nodiscard]] Eigen::Vector4d barycentric(const std::array<Vec3, 4>& x, const Vec3& p);

}  // namespace sutured::fem
