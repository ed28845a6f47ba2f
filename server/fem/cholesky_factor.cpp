// SPDX-License-Identifier: GPL-3.0-or-later
#include "fem/cholesky_factor.hpp"

#include <cholmod.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <random>
#include <string>

#include "fem/in_two_threads.hpp"
#include "fem/simd_kernel.hpp"

extern "C" {
void dtrsm_(const char* side, const char* uplo, const char* trans, const char* diag, const int* m,
            const int* n, const double* alpha, const double* a, const int* lda, double* b,
            const int* ldb);
void dgemm_(const char* transa, const char* transb, const int* m, const int* n, const int* k,
            const double* alpha, const double* a, const int* lda, const double* b, const int* ldb,
            const double* beta, double* c, const int* ldc);
}

namespace sutured::fem {
namespace {

/// t_c −= L[:, 0..3] y_c for three right-hand sides; `stride` between the columns of L and of t.
SUTURED_KERNEL void subtract_four_columns(const double* l, std::int64_t l_stride, const double* y,
                                          std::int64_t count, double* t, std::int64_t t_stride) {
  const double* l0 = l;
  const double* l1 = l + l_stride;
  const double* l2 = l + 2 * l_stride;
  const double* l3 = l + 3 * l_stride;
  double* ta = t;
  double* tb = t + t_stride;
  double* tc = t + 2 * t_stride;
#pragma omp simd
  for (std::int64_t i = 0; i < count; ++i) {
    const double v0 = l0[i], v1 = l1[i], v2 = l2[i], v3 = l3[i];
    ta[i] -= v0 * y[0] + v1 * y[1] + v2 * y[2] + v3 * y[3];
    tb[i] -= v0 * y[4] + v1 * y[5] + v2 * y[6] + v3 * y[7];
    tc[i] -= v0 * y[8] + v1 * y[9] + v2 * y[10] + v3 * y[11];
  }
}

SUTURED_KERNEL void subtract_one_column(const double* l, const double* y, std::int64_t count,
                                        double* t, std::int64_t t_stride) {
  double* ta = t;
  double* tb = t + t_stride;
  double* tc = t + 2 * t_stride;
#pragma omp simd
  for (std::int64_t i = 0; i < count; ++i) {
    ta[i] -= l[i] * y[0];
    tb[i] -= l[i] * y[1];
    tc[i] -= l[i] * y[2];
  }
}

/// d[k] = L[:, k] · t for four columns.
SUTURED_KERNEL void dot_four_columns(const double* l, std::int64_t l_stride, const double* t,
                                     std::int64_t count, double* d) {
  const double* l0 = l;
  const double* l1 = l + l_stride;
  const double* l2 = l + 2 * l_stride;
  const double* l3 = l + 3 * l_stride;
  double d0 = 0, d1 = 0, d2 = 0, d3 = 0;
#pragma omp simd reduction(+ : d0, d1, d2, d3)
  for (std::int64_t i = 0; i < count; ++i) {
    d0 += l0[i] * t[i];
    d1 += l1[i] * t[i];
    d2 += l2[i] * t[i];
    d3 += l3[i] * t[i];
  }
  d[0] = d0;
  d[1] = d1;
  d[2] = d2;
  d[3] = d3;
}

/// d[k] = L[:, k] · t for eight columns.
SUTURED_KERNEL void dot_eight_columns(const double* l, std::int64_t l_stride, const double* t,
                                      std::int64_t count, double* d) {
  const double *l0 = l, *l1 = l0 + l_stride, *l2 = l1 + l_stride, *l3 = l2 + l_stride;
  const double *l4 = l3 + l_stride, *l5 = l4 + l_stride, *l6 = l5 + l_stride, *l7 = l6 + l_stride;
  double d0 = 0, d1 = 0, d2 = 0, d3 = 0, d4 = 0, d5 = 0, d6 = 0, d7 = 0;
#pragma omp simd reduction(+ : d0, d1, d2, d3, d4, d5, d6, d7)
  for (std::int64_t i = 0; i < count; ++i) {
    d0 += l0[i] * t[i];
    d1 += l1[i] * t[i];
    d2 += l2[i] * t[i];
    d3 += l3[i] * t[i];
    d4 += l4[i] * t[i];
    d5 += l5[i] * t[i];
    d6 += l6[i] * t[i];
    d7 += l7[i] * t[i];
  }
  const double sums[8] = {d0, d1, d2, d3, d4, d5, d6, d7};
  std::copy_n(sums, 8, d);
}

SUTURED_KERNEL double dot_one_column(const double* l, const double* t, std::int64_t count) {
  double sum = 0;
#pragma omp simd reduction(+ : sum)
  for (std::int64_t i = 0; i < count; ++i) sum += l[i] * t[i];
  return sum;
}

/// g = Aᵀ B for two triples of columns.
SUTURED_KERNEL void dot_three_by_three(const double* a, std::int64_t a_stride, const double* b,
                                       std::int64_t b_stride, std::int64_t count, double* g) {
  const double *a0 = a, *a1 = a + a_stride, *a2 = a + 2 * a_stride;
  const double *b0 = b, *b1 = b + b_stride, *b2 = b + 2 * b_stride;
  double g00 = 0, g01 = 0, g02 = 0, g10 = 0, g11 = 0, g12 = 0, g20 = 0, g21 = 0, g22 = 0;
#pragma omp simd reduction(+ : g00, g01, g02, g10, g11, g12, g20, g21, g22)
  for (std::int64_t i = 0; i < count; ++i) {
    g00 += a0[i] * b0[i];
    g01 += a0[i] * b1[i];
    g02 += a0[i] * b2[i];
    g10 += a1[i] * b0[i];
    g11 += a1[i] * b1[i];
    g12 += a1[i] * b2[i];
    g20 += a2[i] * b0[i];
    g21 += a2[i] * b1[i];
    g22 += a2[i] * b2[i];
  }
  const double result[9] = {g00, g01, g02, g10, g11, g12, g20, g21, g22};
  std::memcpy(g, result, sizeof result);
}

SUTURED_KERNEL void add_three_columns(const double* a, std::int64_t a_stride, const double* f,
                                      std::int64_t count, double* y) {
  const double *a0 = a, *a1 = a + a_stride, *a2 = a + 2 * a_stride;
#pragma omp simd
  for (std::int64_t i = 0; i < count; ++i) y[i] += a0[i] * f[0] + a1[i] * f[1] + a2[i] * f[2];
}

SUTURED_KERNEL double sum_of(const double* values, std::int64_t count) {
  double sum = 0;
#pragma omp simd reduction(+ : sum)
  for (std::int64_t i = 0; i < count; ++i) sum += values[i];
  return sum;
}

/// x ← L⁻¹ x for the lower n × n triangle of a panel and `columns` right-hand sides, n apart.
void solve_lower(int n, int columns, const double* l, int l_stride, double* x) {
  const double one = 1.0;
  dtrsm_("L", "L", "N", "N", &n, &columns, &one, l, &l_stride, x, &n);
}

/// y = A x, A rows × inner, x inner × columns.
void multiply_dense(int rows, int columns, int inner, const double* a, int a_stride,
                    const double* x, double* y) {
  const double one = 1.0, zero = 0.0;
  dgemm_("N", "N", &rows, &columns, &inner, &one, a, &a_stride, x, &inner, &zero, y, &rows);
}

/// c = Aᵀ B, A inner × rows, B inner × columns.
void multiply_transposed(int rows, int columns, int inner, const double* a, const double* b,
                         double* c) {
  const double one = 1.0, zero = 0.0;
  dgemm_("T", "N", &rows, &columns, &inner, &one, a, &inner, b, &inner, &zero, c, &rows);
}

/// CHOLMOD's workspace, started and finished with its owner.
struct Common {
  Common() { cholmod_l_start(&value); }
  ~Common() { cholmod_l_finish(&value); }
  Common(const Common&) = delete;
  Common& operator=(const Common&) = delete;
  cholmod_common value{};
};

cholmod_sparse view_of(const LinearSystem& system) {
  cholmod_sparse a{};
  a.nrow = a.ncol = static_cast<std::size_t>(system.size());
  a.nzmax = system.row.size();
  // CHOLMOD's C interface has no const; it does not write to these.
  a.p = const_cast<std::int64_t*>(system.column_start.data());  // NOLINT
  a.i = const_cast<std::int64_t*>(system.row.data());           // NOLINT
  a.x = const_cast<double*>(system.value.data());               // NOLINT
  a.stype = -1;
  a.itype = CHOLMOD_LONG;
  a.xtype = CHOLMOD_REAL;
  a.dtype = CHOLMOD_DOUBLE;
  a.sorted = a.packed = 1;
  return a;
}

/// A fill-reducing order of the free degrees of freedom: METIS on the graph of vertices, three
/// times smaller than that of K, which also keeps a vertex's degrees of freedom together.
std::vector<std::int64_t> nodal_order(const LinearSystem& system, cholmod_common* common) {
  const auto n = static_cast<std::size_t>(system.vertex_count);
  std::vector<std::int64_t> vertex_of(static_cast<std::size_t>(system.size()));
  for (std::size_t dof = 0; dof < 3 * n; ++dof)
    if (system.free_index[dof] >= 0)
      vertex_of[static_cast<std::size_t>(system.free_index[dof])] =
          static_cast<std::int64_t>(dof / 3);
  std::vector<std::int64_t> start{0}, rows, seen(n, -1);
  std::size_t column = 0;
  for (std::size_t v = 0; v < n; ++v) {
    while (column < vertex_of.size() && vertex_of[column] == static_cast<std::int64_t>(v)) {
      for (auto k = system.column_start[column]; k < system.column_start[column + 1]; ++k) {
        const auto w = vertex_of[static_cast<std::size_t>(system.row[static_cast<std::size_t>(k)])];
        if (w != static_cast<std::int64_t>(v) &&
            seen[static_cast<std::size_t>(w)] != static_cast<std::int64_t>(v)) {
          seen[static_cast<std::size_t>(w)] = static_cast<std::int64_t>(v);
          rows.push_back(w);
        }
      }
      ++column;
    }
    start.push_back(static_cast<std::int64_t>(rows.size()));
  }
  cholmod_sparse graph{};
  graph.nrow = graph.ncol = n;
  graph.nzmax = rows.size();
  graph.p = start.data();
  graph.i = rows.data();
  graph.stype = -1;
  graph.itype = CHOLMOD_LONG;
  graph.xtype = CHOLMOD_PATTERN;
  graph.packed = 1;
  std::vector<std::int64_t> order(n);
  if (!cholmod_l_metis(&graph, nullptr, 0, 1, order.data(), common))
    throw std::runtime_error("CHOLMOD could not order the tissue with METIS");
  std::vector<std::int64_t> result;
  result.reserve(vertex_of.size());
  for (const auto v : order)
    for (std::size_t axis = 0; axis < 3; ++axis)
      if (const auto f = system.free_index[3 * static_cast<std::size_t>(v) + axis]; f >= 0)
        result.push_back(f);
  return result;
}

// The two shares differ by less than this part of L.
constexpr std::int64_t kUneven = 16;

}  // namespace

struct CholeskyFactor::Impl {
  Common common;
  cholmod_factor* factor = nullptr;
  std::int64_t size = 0;
  std::int32_t vertex_count = 0;
  std::vector<std::int64_t> position;         ///< 3n: row of L of a degree of freedom, or −1
  std::vector<std::int32_t> supernode_of;     ///< per row of L
  std::vector<std::int32_t> parent;           ///< per supernode, −1 at a root
  std::vector<std::int32_t> columns_to_root;  ///< per supernode, itself included
  std::vector<std::int32_t> level;            ///< per supernode, 0 at a root
  std::vector<std::int32_t> part;             ///< per supernode: its root, counted from 0
  std::int32_t part_count = 1;
  std::vector<double> inverse_diagonal;  ///< 1 / L_jj: a product is faster than a division
  std::int64_t panel_rows_max = 0;
  /// Supernodes in the order of `backward`: first those near the roots, then two shares that do not
  /// depend on each other; all in `near_roots` where L is small.
  std::vector<std::int32_t> near_roots;
  std::array<std::vector<std::int32_t>, 2> shares;
  std::vector<int> share_of;  ///< per supernode: −1 near a root, or its share
  // Workspaces of `backward`: right-hand side, then unknowns; a panel for each thread.
  mutable std::vector<double> unknowns;
  mutable std::array<std::vector<double>, 2> panels;
  // A copy of K for the condition estimate and residuals.
  std::vector<std::int64_t> column_start, row;
  std::vector<double> value;

  ~Impl() { cholmod_l_free_factor(&factor, &common.value); }

  [[nodiscard]] const std::int64_t* super() const {
    return static_cast<const std::int64_t*>(factor->super);
  }
  [[nodiscard]] const std::int64_t* rows_start() const {
    return static_cast<const std::int64_t*>(factor->pi);
  }
  [[nodiscard]] const std::int64_t* values_start() const {
    return static_cast<const std::int64_t*>(factor->px);
  }
  [[nodiscard]] const std::int64_t* rows() const {
    return static_cast<const std::int64_t*>(factor->s);
  }
  [[nodiscard]] const double* values() const { return static_cast<const double*>(factor->x); }

  void share_backward(std::int64_t shared_values);
  void accumulate(std::span<const PathLoad> loads, int share) const;
  void backward(std::span<const std::int32_t> supernodes, double* z) const;

  [[nodiscard]] std::int32_t common_ancestor(std::int32_t a, std::int32_t b) const {
    if (a < 0 || b < 0) return -1;
    while (a != b) {
      if (level[static_cast<std::size_t>(a)] < level[static_cast<std::size_t>(b)]) std::swap(a, b);
      a = parent[static_cast<std::size_t>(a)];
      if (a < 0) return -1;
    }
    return a;
  }

  /// Where a row of L stands in a column of `length` entries that ends at the root.
  [[nodiscard]] std::int64_t slot(std::int64_t length, std::int64_t r) const {
    const auto s = static_cast<std::size_t>(supernode_of[static_cast<std::size_t>(r)]);
    return length - columns_to_root[s] + (r - super()[s]);
  }
  std::int64_t begin_path(std::int32_t vertex, PathColumns& columns) const;

  void multiply(std::span<const double> x, std::span<double> y) const {
    std::fill(y.begin(), y.end(), 0.0);
    for (std::size_t j = 0; j < x.size(); ++j)
      for (auto k = column_start[j]; k < column_start[j + 1]; ++k) {
        const auto i = static_cast<std::size_t>(row[static_cast<std::size_t>(k)]);
        const double v = value[static_cast<std::size_t>(k)];
        y[i] += v * x[j];
        if (i != j) y[j] += v * x[i];
      }
  }
};

CholeskyFactor::CholeskyFactor(const LinearSystem& system, std::int64_t shared_values)
    : impl_(std::make_unique<Impl>()) {
  Impl& m = *impl_;
  m.size = system.size();
  m.vertex_count = system.vertex_count;
  m.column_start = system.column_start;
  m.row = system.row;
  m.value = system.value;
  cholmod_common* common = &m.common.value;
  common->print = 0;
  common->supernodal = CHOLMOD_SUPERNODAL;
  common->final_ll = 1;
  common->nmethods = 1;
  common->method[0].ordering = CHOLMOD_GIVEN;
  common->postorder = 1;

  auto order = nodal_order(system, common);
  cholmod_sparse a = view_of(system);
  m.factor = cholmod_l_analyze_p(&a, order.data(), nullptr, 0, common);
  if (m.factor == nullptr)
    throw std::runtime_error("CHOLMOD could not analyse the stiffness matrix");
  cholmod_l_factorize(&a, m.factor, common);
  const auto* permutation = static_cast<const std::int64_t*>(m.factor->Perm);
  if (common->status != CHOLMOD_OK) {
    std::int32_t vertex = -1;
    if (static_cast<std::int64_t>(m.factor->minor) < m.size) {
      const auto failed = permutation[m.factor->minor];
      for (std::size_t dof = 0; dof < system.free_index.size(); ++dof)
        if (system.free_index[dof] == failed) vertex = static_cast<std::int32_t>(dof / 3);
    }
    throw NotPositiveDefinite("the stiffness matrix is not positive definite near vertex " +
                                  std::to_string(vertex) + ": part of the tissue can move freely",
                              vertex);
  }

  std::vector<std::int64_t> inverse(static_cast<std::size_t>(m.size));
  for (std::int64_t i = 0; i < m.size; ++i) inverse[static_cast<std::size_t>(permutation[i])] = i;
  m.position.assign(system.free_index.size(), -1);
  for (std::size_t dof = 0; dof < system.free_index.size(); ++dof)
    if (system.free_index[dof] >= 0)
      m.position[dof] = inverse[static_cast<std::size_t>(system.free_index[dof])];

  const auto supernodes = m.factor->nsuper;
  m.supernode_of.resize(static_cast<std::size_t>(m.size));
  m.parent.assign(supernodes, -1);
  m.columns_to_root.assign(supernodes, 0);
  m.level.assign(supernodes, 0);
  m.part.assign(supernodes, 0);
  std::int32_t roots = 0;
  for (std::size_t s = 0; s < supernodes; ++s)
    for (auto j = m.super()[s]; j < m.super()[s + 1]; ++j)
      m.supernode_of[static_cast<std::size_t>(j)] = static_cast<std::int32_t>(s);
  for (std::size_t s = supernodes; s-- > 0;) {
    const auto columns = m.super()[s + 1] - m.super()[s];
    const auto count = m.rows_start()[s + 1] - m.rows_start()[s];
    m.panel_rows_max = std::max(m.panel_rows_max, static_cast<std::int64_t>(count));
    m.columns_to_root[s] = static_cast<std::int32_t>(columns);
    if (count == columns) {
      m.part[s] = roots++;
      continue;
    }
    const auto up = m.supernode_of[static_cast<std::size_t>(m.rows()[m.rows_start()[s] + columns])];
    m.parent[s] = up;
    m.columns_to_root[s] += m.columns_to_root[static_cast<std::size_t>(up)];
    m.level[s] = m.level[static_cast<std::size_t>(up)] + 1;
    m.part[s] = m.part[static_cast<std::size_t>(up)];
  }
  m.part_count = std::max(roots, 1);
  for (auto& panel : m.panels) panel.resize(static_cast<std::size_t>(m.panel_rows_max));
  m.unknowns.resize(static_cast<std::size_t>(m.size));
  m.share_backward(shared_values);
  m.inverse_diagonal.resize(static_cast<std::size_t>(m.size));
  for (std::size_t s = 0; s < supernodes; ++s) {
    const auto row_count = m.rows_start()[s + 1] - m.rows_start()[s];
    for (auto j = m.super()[s]; j < m.super()[s + 1]; ++j)
      m.inverse_diagonal[static_cast<std::size_t>(j)] =
          1.0 / m.values()[m.values_start()[s] + (j - m.super()[s]) * (row_count + 1)];
  }
}

CholeskyFactor::~CholeskyFactor() = default;

std::int64_t CholeskyFactor::size() const { return impl_->size; }
std::int32_t CholeskyFactor::vertex_count() const { return impl_->vertex_count; }
std::int64_t CholeskyFactor::stored_values() const {
  return static_cast<std::int64_t>(impl_->factor->xsize);
}

std::int32_t CholeskyFactor::part_of(std::int32_t vertex) const {
  for (std::size_t axis = 0; axis < 3; ++axis)
    if (const auto row = impl_->position[3 * static_cast<std::size_t>(vertex) + axis]; row >= 0)
      return impl_
          ->part[static_cast<std::size_t>(impl_->supernode_of[static_cast<std::size_t>(row)])];
  return 0;
}
std::int32_t CholeskyFactor::part_count() const { return impl_->part_count; }
std::int32_t CholeskyFactor::path_length_max(std::int32_t part) const {
  std::int32_t length = 0;
  for (std::size_t s = 0; s < impl_->part.size(); ++s)
    if (impl_->part[s] == part) length = std::max(length, impl_->columns_to_root[s]);
  return length;
}

void CholeskyFactor::solve(std::span<const double> b, std::span<double> x) const {
  cholmod_dense right{};
  right.nrow = right.d = static_cast<std::size_t>(impl_->size);
  right.nzmax = b.size();
  right.ncol = b.size() / right.nrow;
  right.x = const_cast<double*>(b.data());  // NOLINT: CHOLMOD's C interface has no const
  right.xtype = CHOLMOD_REAL;
  right.dtype = CHOLMOD_DOUBLE;
  cholmod_dense* result = cholmod_l_solve(CHOLMOD_A, impl_->factor, &right, &impl_->common.value);
  if (result == nullptr) throw std::bad_alloc();
  std::memcpy(x.data(), result->x, x.size_bytes());
  cholmod_l_free_dense(&result, &impl_->common.value);
}

/// Lays out the columns of a vertex: ones at its degrees of freedom, zeros up to the root. Returns
/// the first of those rows.
std::int64_t CholeskyFactor::Impl::begin_path(std::int32_t vertex, PathColumns& columns) const {
  const Impl& m = *this;
  columns.vertex = vertex;
  columns.first_supernode = -1;
  columns.length = 0;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const auto at = m.position[3 * static_cast<std::size_t>(vertex) + axis];
    if (at < 0) continue;
    const auto s = m.supernode_of[static_cast<std::size_t>(at)];
    // The degrees of freedom of a vertex are coupled, so they lie on one path: the longest
    // way to the root is the path of all three.
    if (m.columns_to_root[static_cast<std::size_t>(s)] > columns.length) {
      columns.length = m.columns_to_root[static_cast<std::size_t>(s)];
      columns.first_supernode = s;
    }
  }
  const std::int64_t length = columns.length;
  columns.value.assign(static_cast<std::size_t>(3 * length), 0.0);
  if (length == 0) return m.size;
  double* entry = columns.value.data();
  std::int64_t first_row = m.size;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const auto at = m.position[3 * static_cast<std::size_t>(vertex) + axis];
    if (at < 0) continue;
    entry[static_cast<std::int64_t>(axis) * length + m.slot(length, at)] = 1.0;
    first_row = std::min(first_row, at);
  }
  return first_row;
}

void CholeskyFactor::walk_path(std::int32_t vertex, PathColumns& columns) const {
  const Impl& m = *impl_;
  const std::int64_t first_row = m.begin_path(vertex, columns);
  const std::int64_t length = columns.length;
  if (length == 0) return;
  double* value = columns.value.data();

  thread_local std::vector<double> below;
  if (static_cast<std::int64_t>(below.size()) < 3 * m.panel_rows_max)
    below.resize(static_cast<std::size_t>(3 * m.panel_rows_max));
  for (std::int32_t s = columns.first_supernode; s >= 0;
       s = m.parent[static_cast<std::size_t>(s)]) {
    const auto i = static_cast<std::size_t>(s);
    const auto column_count = m.super()[i + 1] - m.super()[i];
    const auto row_count = m.rows_start()[i + 1] - m.rows_start()[i];
    const auto rest = row_count - column_count;
    const double* panel = m.values() + m.values_start()[i];
    double* own =
        value + m.slot(length, m.super()[i]);  // contiguous for the supernode's own columns
    std::fill_n(below.begin(), 3 * rest, 0.0);
    auto k = std::max<std::int64_t>(0, first_row - m.super()[i]);  // zeros before the vertex
    while (k < column_count) {
      const std::int64_t width = std::min<std::int64_t>(4, column_count - k);
      double y[12];
      for (std::int64_t c = 0; c < width; ++c)
        for (std::int64_t axis = 0; axis < 3; ++axis) {
          double sum = own[axis * length + k + c];
          for (std::int64_t d = 0; d < c; ++d)
            sum -= panel[(k + d) * row_count + k + c] * y[axis * 4 + d];
          y[axis * 4 + c] = sum / panel[(k + c) * row_count + k + c];
          own[axis * length + k + c] = y[axis * 4 + c];
        }
      const std::int64_t after = k + width;
      if (width == 4) {
        subtract_four_columns(panel + k * row_count + after, row_count, y, column_count - after,
                              own + after, length);
        subtract_four_columns(panel + k * row_count + column_count, row_count, y, rest,
                              below.data(), rest);
      } else {
        for (std::int64_t c = 0; c < width; ++c) {
          const double one[3] = {y[c], y[4 + c], y[8 + c]};
          subtract_one_column(panel + (k + c) * row_count + after, one, column_count - after,
                              own + after, length);
          subtract_one_column(panel + (k + c) * row_count + column_count, one, rest, below.data(),
                              rest);
        }
      }
      k = after;
    }
    const std::int64_t* rows = m.rows() + m.rows_start()[i] + column_count;
    for (std::int64_t r = 0; r < rest; ++r) {
      const auto at = m.slot(length, rows[r]);
      for (std::int64_t axis = 0; axis < 3; ++axis)
        value[axis * length + at] += below[static_cast<std::size_t>(axis * rest + r)];
    }
  }
}

void CholeskyFactor::walk_paths(std::span<const std::int32_t> vertices,
                                std::span<PathColumns* const> columns) const {
  const Impl& m = *impl_;
  if (vertices.size() == 1) return walk_path(vertices[0], *columns[0]);
  thread_local std::vector<std::pair<std::int32_t, std::int32_t>> passes;  // supernode, vertex
  thread_local std::vector<double> own, below;
  passes.clear();
  for (std::size_t v = 0; v < vertices.size(); ++v) {
    m.begin_path(vertices[v], *columns[v]);
    for (auto s = columns[v]->first_supernode; s >= 0; s = m.parent[static_cast<std::size_t>(s)])
      passes.emplace_back(s, static_cast<std::int32_t>(v));
  }
  // A parent has a higher number than its children.
  std::sort(passes.begin(), passes.end());
  for (std::size_t from = 0, to = 0; from < passes.size(); from = to) {
    const auto i = static_cast<std::size_t>(passes[from].first);
    while (to < passes.size() && passes[to].first == passes[from].first) ++to;
    const int width = 3 * static_cast<int>(to - from);
    const auto column_count = m.super()[i + 1] - m.super()[i];
    const auto row_count = m.rows_start()[i + 1] - m.rows_start()[i];
    const auto rest = row_count - column_count;
    const double* panel = m.values() + m.values_start()[i];
    const auto each = [&](auto&& visit) {  // (its column, its length, number among those here)
      for (std::size_t p = from; p < to; ++p) {
        PathColumns& path = *columns[static_cast<std::size_t>(passes[p].second)];
        for (std::int64_t axis = 0; axis < 3; ++axis)
          visit(path.value.data() + axis * path.length, path.length,
                static_cast<std::int64_t>(3 * (p - from)) + axis);
      }
    };
    own.resize(static_cast<std::size_t>(column_count * width));
    each([&](const double* value, std::int64_t length, std::int64_t c) {
      std::copy_n(value + m.slot(length, m.super()[i]), column_count,
                  own.data() + c * column_count);
    });
    solve_lower(static_cast<int>(column_count), width, panel, static_cast<int>(row_count),
                own.data());
    each([&](double* value, std::int64_t length, std::int64_t c) {
      std::copy_n(own.data() + c * column_count, column_count,
                  value + m.slot(length, m.super()[i]));
    });
    if (rest == 0) continue;
    below.resize(static_cast<std::size_t>(rest * width));
    multiply_dense(static_cast<int>(rest), width, static_cast<int>(column_count),
                   panel + column_count, static_cast<int>(row_count), own.data(), below.data());
    const std::int64_t* rows = m.rows() + m.rows_start()[i] + column_count;
    each([&](double* value, std::int64_t length, std::int64_t c) {
      const double* t = below.data() + c * rest;
      for (std::int64_t r = 0; r < rest; ++r) value[m.slot(length, rows[r])] -= t[r];
    });
  }
}

Mat3 CholeskyFactor::inverse_block(const PathColumns& v, const PathColumns& w) const {
  Mat3 block = Mat3::Zero();
  const auto ancestor = impl_->common_ancestor(v.first_supernode, w.first_supernode);
  if (ancestor < 0) return block;
  const auto count = impl_->columns_to_root[static_cast<std::size_t>(ancestor)];
  double g[9];
  dot_three_by_three(v.value.data() + (v.length - count), v.length,
                     w.value.data() + (w.length - count), w.length, count, g);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) block(i, j) = g[3 * i + j];
  return block;
}

void CholeskyFactor::inverse_blocks(std::span<const PathColumns* const> a,
                                    std::span<const PathColumns* const> b,
                                    std::vector<double>& block) const {
  const Impl& m = *impl_;
  using Passes = std::vector<std::pair<std::int32_t, std::int32_t>>;  // supernode, number in a or b
  thread_local Passes passes_a, passes_b;
  thread_local std::vector<double> gathered_a, gathered_b, product;
  const auto rows = 3 * a.size();
  block.assign(rows * 3 * b.size(), 0.0);
  const auto pass = [&](std::span<const PathColumns* const> all, Passes& passes) {
    passes.clear();
    for (std::size_t v = 0; v < all.size(); ++v)
      for (auto s = all[v]->first_supernode; s >= 0; s = m.parent[static_cast<std::size_t>(s)])
        passes.emplace_back(s, static_cast<std::int32_t>(v));
    std::sort(passes.begin(), passes.end());
  };
  pass(a, passes_a);
  pass(b, passes_b);
  for (std::size_t ia = 0, ib = 0; ia < passes_a.size() && ib < passes_b.size();) {
    const std::int32_t s = std::max(passes_a[ia].first, passes_b[ib].first);
    while (ia < passes_a.size() && passes_a[ia].first < s) ++ia;
    while (ib < passes_b.size() && passes_b[ib].first < s) ++ib;
    if (ia == passes_a.size() || ib == passes_b.size()) break;
    if (passes_a[ia].first != s || passes_b[ib].first != s) continue;
    const auto at = static_cast<std::size_t>(s);
    const auto count = m.super()[at + 1] - m.super()[at];
    const auto gather = [&](std::span<const PathColumns* const> all, const Passes& passes,
                            std::size_t from, std::vector<double>& out) {
      std::size_t to = from;
      out.clear();
      for (; to < passes.size() && passes[to].first == s; ++to) {
        const PathColumns& path = *all[static_cast<std::size_t>(passes[to].second)];
        for (std::int64_t axis = 0; axis < 3; ++axis) {
          const double* from_value =
              path.value.data() + axis * path.length + (path.length - m.columns_to_root[at]);
          out.insert(out.end(), from_value, from_value + count);
        }
      }
      return to;
    };
    const std::size_t end_a = gather(a, passes_a, ia, gathered_a);
    const std::size_t end_b = gather(b, passes_b, ib, gathered_b);
    const auto na = 3 * (end_a - ia), nb = 3 * (end_b - ib);
    product.resize(na * nb);
    multiply_transposed(static_cast<int>(na), static_cast<int>(nb), static_cast<int>(count),
                        gathered_a.data(), gathered_b.data(), product.data());
    for (std::size_t j = 0; j < nb; ++j) {
      double* column =
          block.data() + (3 * static_cast<std::size_t>(passes_b[ib + j / 3].second) + j % 3) * rows;
      for (std::size_t i = 0; i < na; i += 3) {
        double* g = column + 3 * static_cast<std::size_t>(passes_a[ia + i / 3].second);
        for (std::size_t k = 0; k < 3; ++k) g[k] += product[j * na + i + k];
      }
    }
    ia = end_a;
    ib = end_b;
  }
}

/// Sums the columns of the loads, where they pass through supernodes of `share`.
void CholeskyFactor::Impl::accumulate(std::span<const PathLoad> loads, int share) const {
  for (const PathLoad& load : loads) {
    const PathColumns& columns = *load.columns;
    for (std::int32_t s = columns.first_supernode; s >= 0;) {
      const auto first = static_cast<std::size_t>(s);
      // What follows on a path often lies next in L, too: one sum for all of it.
      std::int64_t end = super()[first + 1];
      for (s = parent[first];
           s >= 0 && super()[s] == end && share_of[static_cast<std::size_t>(s)] == share_of[first];
           s = parent[static_cast<std::size_t>(s)])
        end = super()[s + 1];
      if (share_of[first] != share) continue;
      add_three_columns(columns.value.data() + (columns.length - columns_to_root[first]),
                        columns.length, load.force_n.data(), end - super()[first],
                        unknowns.data() + super()[first]);
    }
  }
}

/// Splits the elimination forest into two shares of about the same size: subtrees, the largest
/// first to the share that has less. Where that does not come out even, the largest is taken apart.
void CholeskyFactor::Impl::share_backward(std::int64_t shared_values) {
  const auto count = factor->nsuper;
  std::vector<std::int64_t> below(count);  // values of the subtree
  std::vector<std::vector<std::int32_t>> children(count);
  std::vector<std::int32_t> subtrees;
  for (std::size_t s = 0; s < count; ++s) {
    below[s] += values_start()[s + 1] - values_start()[s];
    if (parent[s] < 0) {
      subtrees.push_back(static_cast<std::int32_t>(s));
      continue;
    }
    below[static_cast<std::size_t>(parent[s])] += below[s];
    children[static_cast<std::size_t>(parent[s])].push_back(static_cast<std::int32_t>(s));
  }
  const auto total = static_cast<std::int64_t>(factor->xsize);
  share_of.assign(count, 0);
  if (total >= shared_values) {
    const auto smaller = [&](std::int32_t a, std::int32_t b) {
      return std::pair(below[static_cast<std::size_t>(a)], a) <
             std::pair(below[static_cast<std::size_t>(b)], b);
    };
    while (true) {
      std::sort(subtrees.begin(), subtrees.end(), smaller);
      std::array<std::int64_t, 2> values{};
      for (auto s = subtrees.rbegin(); s != subtrees.rend(); ++s) {
        const int share = values[1] < values[0] ? 1 : 0;
        share_of[static_cast<std::size_t>(*s)] = share;
        values[static_cast<std::size_t>(share)] += below[static_cast<std::size_t>(*s)];
      }
      if (subtrees.empty() || std::abs(values[0] - values[1]) <= total / kUneven) break;
      const auto largest = static_cast<std::size_t>(subtrees.back());
      subtrees.pop_back();
      share_of[largest] = -1;
      subtrees.insert(subtrees.end(), children[largest].begin(), children[largest].end());
    }
    for (std::size_t s = count; s-- > 0;)
      if (parent[s] >= 0 && share_of[static_cast<std::size_t>(parent[s])] >= 0)
        share_of[s] = share_of[static_cast<std::size_t>(parent[s])];
  } else {
    std::fill(share_of.begin(), share_of.end(), -1);
  }
  for (std::size_t s = count; s-- > 0;)
    (share_of[s] < 0 ? near_roots : shares[static_cast<std::size_t>(share_of[s])])
        .push_back(static_cast<std::int32_t>(s));
}

/// Solves for the unknowns of `supernodes`, in their order; `z` is a workspace.
void CholeskyFactor::Impl::backward(std::span<const std::int32_t> supernodes, double* z) const {
  const Impl& m = *this;
  double* x = unknowns.data();
  // In z: a supernode's own unknowns, then those below it.
  for (const std::int32_t supernode : supernodes) {
    const auto s = static_cast<std::size_t>(supernode);
    const auto first = m.super()[s];
    const auto column_count = m.super()[s + 1] - first;
    const auto row_count = m.rows_start()[s + 1] - m.rows_start()[s];
    const double* panel = m.values() + m.values_start()[s];
    const double* inverse = m.inverse_diagonal.data() + first;
    const std::int64_t* rows = m.rows() + m.rows_start()[s];
    std::copy_n(x + first, column_count, z);
    for (std::int64_t r = column_count; r < row_count; ++r) z[r] = x[rows[r]];
    std::int64_t width = 0;
    for (auto k = column_count; k > 0; k -= width) {
      width = k >= 8 ? 8 : k >= 4 ? 4 : 1;
      const auto from = k - width;
      const double* block = panel + from * row_count;
      double d[8];
      if (width == 8) {
        dot_eight_columns(block + k, row_count, z + k, row_count - k, d);
      } else if (width == 4) {
        dot_four_columns(block + k, row_count, z + k, row_count - k, d);
      } else {
        d[0] = dot_one_column(block + k, z + k, row_count - k);
      }
      for (std::int64_t c = width; c-- > 0;) {
        double sum = z[from + c] - d[c];
        for (std::int64_t b = c + 1; b < width; ++b)
          sum -= block[c * row_count + from + b] * z[from + b];
        z[from + c] = sum * inverse[from + c];
      }
    }
    std::copy_n(z, column_count, x + first);
  }
}

void CholeskyFactor::backward(std::span<const PathLoad> loads, std::span<const double> offset,
                              std::span<double> u) const {
  const Impl& m = *impl_;
  std::fill(m.unknowns.begin(), m.unknowns.end(), 0.0);
  m.accumulate(loads, -1);
  m.backward(m.near_roots, m.panels[0].data());
  if (!m.shares[1].empty()) {
    const auto take = [&](std::size_t share) {
      m.accumulate(loads, static_cast<int>(share));
      m.backward(m.shares[share], m.panels[share].data());
    };
    in_two_threads([&] { take(0); }, [&] { take(1); });
  }
  for (std::size_t dof = 0; dof < m.position.size(); ++dof)
    u[dof] = offset[dof] +
             (m.position[dof] >= 0 ? m.unknowns[static_cast<std::size_t>(m.position[dof])] : 0.0);
}

double CholeskyFactor::read_once() const { return sum_of(impl_->values(), stored_values()); }

double CholeskyFactor::estimate_condition() const {
  const auto n = static_cast<std::size_t>(size());
  std::mt19937_64 random(1);
  std::normal_distribution<double> normal;
  const auto largest = [&](const auto& apply) {
    std::vector<double> x(n), y(n);
    for (double& v : x) v = normal(random);
    double eigenvalue = 0;
    for (int iteration = 0; iteration < 60; ++iteration) {
      double norm = 0;
      for (const double v : x) norm += v * v;
      norm = std::sqrt(norm);
      for (double& v : x) v /= norm;
      apply(x, y);
      eigenvalue = 0;
      for (std::size_t i = 0; i < n; ++i) eigenvalue += x[i] * y[i];
      x.swap(y);
    }
    return eigenvalue;
  };
  return largest([&](const auto& x, auto& y) { impl_->multiply(x, y); }) *
         largest([&](const auto& x, auto& y) { solve(x, y); });
}

}  // namespace sutured::fem
