// SPDX-License-Identifier: GPL-3.0-or-later
// K = Pᵀ L Lᵀ P, and the two partial solves the product lives on.
//
// A constraint touches a few vertices. The column L⁻¹ P e_v of a vertex is zero outside one path
// of the elimination tree, from v up to the root, so it is computed by walking that path and
// nothing else. Columns are stored aligned at the root:
//
//        root ── … ── a ── … ── v          y_v  [ v … a … root ]
//                      └── … ── w          y_w      [ w … a … root ]
//
// so that the inner product of two columns, an entry of K⁻¹, is one dense dot product over
// their common end, from the lowest common ancestor a to the root.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <stdexcept>
#include <vector>

#include "fem/stiffness.hpp"

namespace sutured::fem {

/// K is not positive definite: some part of the tissue can move freely, or is degenerate.
struct NotPositiveDefinite : std::runtime_error {
  NotPositiveDefinite(const std::string& what, std::int32_t at)
      : std::runtime_error(what), vertex(at) {}
  std::int32_t vertex;  ///< a vertex of the part that can move
};

/// The three columns L⁻¹ P e_{3v + axis} of one vertex, on its path to the root.
struct PathColumns {
  std::int32_t vertex = -1;
  std::int32_t first_supernode = -1;  ///< −1 where the whole vertex is prescribed
  std::int32_t length = 0;            ///< entries per column
  std::vector<double> value;          ///< 3 × length, one column after the other
};

/// A force (N) on a walked vertex.
struct PathLoad {
  const PathColumns* columns = nullptr;
  Vec3 force_n = Vec3::Zero();
};

/// The supernodal Cholesky factor of a LinearSystem: immutable once made, shared between threads.
class CholeskyFactor {
 public:
  /// From so many values of L on (64 MB), two threads take the backward pass.
  static constexpr std::int64_t kSharedValues = 8'000'000;

  /// Orders (METIS on the graph of vertices), analyses and factors with CHOLMOD.
  /// Throws NotPositiveDefinite.
  explicit CholeskyFactor(const LinearSystem& system, std::int64_t shared_values = kSharedValues);
  ~CholeskyFactor();
  CholeskyFactor(const CholeskyFactor&) = delete;
  CholeskyFactor& operator=(const CholeskyFactor&) = delete;

  [[nodiscard]] std::int64_t size() const;  ///< free degrees of freedom
  [[nodiscard]] std::int32_t vertex_count() const;
  [[nodiscard]] std::int64_t stored_values() const;  ///< doubles in L's panels

  /// Returns which part of the tissue `vertex` belongs to: 0, 1 … below `part_count()`. Block (v,
  /// w) of K⁻¹ is zero where they belong to two. What is wholly prescribed belongs to part 0.
  [[nodiscard]] std::int32_t part_of(std::int32_t vertex) const;
  [[nodiscard]] std::int32_t part_count() const;  ///< at least 1
  /// Returns the most entries per column that a walked vertex of `part` has.
  [[nodiscard]] std::int32_t path_length_max(std::int32_t part) const;

  /// Solves K x = b with CHOLMOD for one or more columns, one after the other (both of length
  /// size() × columns). Allocates. For set-up and oracles.
  void solve(std::span<const double> b, std::span<double> x) const;

  /// Fills `columns` for vertex v by one walk up its path. Allocates only when `columns.value`
  /// grows. Cost: about an eighth of L for the largest paths.
  void walk_path(std::int32_t vertex, PathColumns& columns) const;

  /// Fills `columns[i]` for `vertices[i]`, all of them in one go up the tree: paths share their
  /// upper ends, which are most of them, and there each panel is read once for all. The values
  /// differ from those of `walk_path` by rounding, as they do with what is walked together.
  /// Allocates: scratch that grows with the vertices, kept by the thread.
  void walk_paths(std::span<const std::int32_t> vertices,
                  std::span<PathColumns* const> columns) const;

  /// Returns block (v, w) of K⁻¹, m/N, from two walked vertices.
  [[nodiscard]] Mat3 inverse_block(const PathColumns& v, const PathColumns& w) const;

  /// Writes block (v, w) of K⁻¹ for every v of `a` and w of `b` to `block`, 3 |a| × 3 |b|,
  /// column-major: as `inverse_block`, by one matrix product a shared supernode. Worth it from some
  /// four vertices on. Allocates: scratch that grows with the vertices, kept by the thread.
  void inverse_blocks(std::span<const PathColumns* const> a, std::span<const PathColumns* const> b,
                      std::vector<double>& block) const;

  /// Solves Lᵀ P u = Σ yᵥ fᵥ over the loads, for all vertices, and adds `offset`: u[3v + axis] for
  /// free degrees of freedom, `offset` alone for prescribed ones.
  /// Thread: one per factor. Cost: reading the loads' columns and L once. From `shared_values` of L
  /// on, a second thread that ends with the call takes one half of what lies below the uppermost
  /// separators: the values are the same to the bit. Only there it allocates (that thread).
  void backward(std::span<const PathLoad> loads, std::span<const double> offset,
                std::span<double> u) const;

  /// Sums the values of L: what the memory alone costs, for benchmarks.
  [[nodiscard]] double read_once() const;

  /// Estimates the 2-norm condition number of K by power iterations on K and K⁻¹.
  [[nodiscard]] double estimate_condition() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace sutured::fem
