// SPDX-License-Identifier: GPL-3.0-or-later
#include "constraints/compliance.hpp"

#include <algorithm>
#include <array>
#include <concepts>
#include <utility>

#include "fem/simd_kernel.hpp"

namespace sutured::constraints {
namespace {

/// t += Σ c · g over the three rows of each of 1, 2, 3 or 4 vertices: t is read and written once
/// for all of them.
SUTURED_KERNEL void add_one(const double* const* g, std::int64_t stride, const double* c,
                            std::int64_t count, double* t) {
  const double* a = g[0];
#pragma omp simd
  for (std::int64_t i = 0; i < count; ++i)
    t[i] += c[0] * a[i] + c[1] * a[i + stride] + c[2] * a[i + 2 * stride];
}

SUTURED_KERNEL void add_two(const double* const* g, std::int64_t stride, const double* c,
                            std::int64_t count, double* t) {
  const double *a = g[0], *b = g[1];
#pragma omp simd
  for (std::int64_t i = 0; i < count; ++i)
    t[i] += (c[0] * a[i] + c[1] * a[i + stride] + c[2] * a[i + 2 * stride]) +
            (c[3] * b[i] + c[4] * b[i + stride] + c[5] * b[i + 2 * stride]);
}

SUTURED_KERNEL void add_three(const double* const* g, std::int64_t stride, const double* c,
                              std::int64_t count, double* t) {
  const double *a = g[0], *b = g[1], *d = g[2];
#pragma omp simd
  for (std::int64_t i = 0; i < count; ++i)
    t[i] += (c[0] * a[i] + c[1] * a[i + stride] + c[2] * a[i + 2 * stride]) +
            (c[3] * b[i] + c[4] * b[i + stride] + c[5] * b[i + 2 * stride]) +
            (c[6] * d[i] + c[7] * d[i + stride] + c[8] * d[i + 2 * stride]);
}

SUTURED_KERNEL void add_four(const double* const* g, std::int64_t stride, const double* c,
                             std::int64_t count, double* t) {
  const double *a = g[0], *b = g[1], *d = g[2], *e = g[3];
#pragma omp simd
  for (std::int64_t i = 0; i < count; ++i)
    t[i] += (c[0] * a[i] + c[1] * a[i + stride] + c[2] * a[i + 2 * stride]) +
            (c[3] * b[i] + c[4] * b[i + stride] + c[5] * b[i + 2 * stride]) +
            (c[6] * d[i] + c[7] * d[i + stride] + c[8] * d[i + 2 * stride]) +
            (c[9] * e[i] + c[10] * e[i + stride] + c[11] * e[i + 2 * stride]);
}

constexpr std::array kAdd{add_one, add_two, add_three, add_four};

// Rows of T that `sparse_products` takes at a time.
constexpr std::size_t kRowsAtOnce = 4;

/// out[4 j + r] = Σ over the entries of row j of c · t[r][slot], for the first `rows` rows of C and
/// four rows of T; four lanes at a time: each coefficient carries a zero behind it. Entries of row
/// j: first[j] … first[j + 1].
SUTURED_KERNEL void sparse_products(const double* coefficient, const int* offset,
                                    const std::int32_t* first, std::size_t rows,
                                    const double* const* t, double* out) {
  const double *t0 = t[0], *t1 = t[1], *t2 = t[2], *t3 = t[3];
  for (std::size_t j = 0; j < rows; ++j) {
    double sum0[4] = {}, sum1[4] = {}, sum2[4] = {}, sum3[4] = {};
    for (std::int32_t e = first[j]; e < first[j + 1]; ++e) {
      const double* c = coefficient + 4 * e;
      const int x = offset[e];
#pragma omp simd
      for (int k = 0; k < 4; ++k) {
        sum0[k] += c[k] * t0[x + k];
        sum1[k] += c[k] * t1[x + k];
        sum2[k] += c[k] * t2[x + k];
        sum3[k] += c[k] * t3[x + k];
      }
    }
    out[4 * j] = (sum0[0] + sum0[1]) + (sum0[2] + sum0[3]);
    out[4 * j + 1] = (sum1[0] + sum1[1]) + (sum1[2] + sum1[3]);
    out[4 * j + 2] = (sum2[0] + sum2[1]) + (sum2[2] + sum2[3]);
    out[4 * j + 3] = (sum3[0] + sum3[1]) + (sum3[2] + sum3[3]);
  }
}

// Columns of G taken at a time, so that their share of G stays in the second-level cache.
constexpr std::int64_t kBlockColumns = 192;

std::size_t at(std::integral auto i) { return static_cast<std::size_t>(i); }

}  // namespace

Compliance::Compliance(std::shared_ptr<const fem::CholeskyFactor> factor)
    : factor_(std::move(factor)),
      force_n_(at(factor_->vertex_count()), Vec3::Zero()),
      is_loaded_(at(factor_->vertex_count()), 0) {
  for (std::int32_t v = 0; v < factor_->vertex_count(); ++v)
    part_of_.push_back(factor_->part_of(v));
  parts_.reserve(at(factor_->part_count()));
  for (std::int32_t p = 0; p < factor_->part_count(); ++p)
    parts_.push_back({InverseBlocks(factor_, p), {}, {}, {}, {}, {}, {}});
}

void Compliance::prepare(std::span<const std::int32_t> vertices) {
  std::vector<std::vector<std::int32_t>> of_part(parts_.size());
  for (const std::int32_t vertex : vertices) of_part[at(part_of_[at(vertex)])].push_back(vertex);
  for (std::size_t p = 0; p < parts_.size(); ++p) parts_[p].inverse.prepare(of_part[p]);
}

void Compliance::reserve(int rows) {
  std::int64_t pitch = 0;
  for (Part& part : parts_) {
    part.inverse.reserve();
    pitch += 3 * part.inverse.capacity() + 1;
  }
  row_times_g_.resize(at(rows) * at(pitch));
  w_.value.resize(at(rows) * at(rows));
}

void Compliance::clear() {
  for (Part& part : parts_) part.inverse.clear();
  std::fill(force_n_.begin(), force_n_.end(), Vec3::Zero());
  std::fill(is_loaded_.begin(), is_loaded_.end(), std::uint8_t{0});
  loaded_.clear();
  step_ = 0;
  known_ = false;
}

void Compliance::evict(int idle_steps_max) {
  const auto idle = static_cast<std::uint64_t>(idle_steps_max);
  if (step_ <= idle) return;
  for (Part& part : parts_) part.inverse.evict(step_ - idle, loaded_);
}

/// Gives every vertex of the rows its slot, and G every pair of a part.
void Compliance::take_vertices(const ConstraintRows& rows) {
  for (Part& part : parts_) {
    part.new_vertices.clear();
    part.active.clear();
  }
  for (int i = 0; i < rows.size(); ++i)
    for (const Entry& entry : rows.entries(rows[i]))
      if (Part& part = part_of(entry.vertex); part.inverse.find(entry.vertex) < 0)
        part.new_vertices.push_back(entry.vertex);
  for (Part& part : parts_) {
    auto& vertices = part.new_vertices;
    std::sort(vertices.begin(), vertices.end());
    vertices.erase(std::unique(vertices.begin(), vertices.end()), vertices.end());
    part.inverse.add(vertices);
  }
  entry_slot_.clear();
  for (int i = 0; i < rows.size(); ++i)
    for (const Entry& entry : rows.entries(rows[i])) {
      Part& part = part_of(entry.vertex);
      const int slot = part.inverse.find(entry.vertex);
      entry_slot_.push_back(slot);
      if (part.inverse.use(slot, step_)) part.active.push_back(slot);
    }
  for (Part& part : parts_) {
    std::sort(part.active.begin(), part.active.end());
    part.inverse.ensure_pairs(part.active);
  }
}

/// Orders the rows by their last slot, and lays their entries out for both products. In that order
/// a row needs T = C G only as far as the slots of rows before it: W is symmetric, and of two rows
/// the later one takes the product.
void Compliance::order_rows(const ConstraintRows& rows) {
  const int m = rows.size();
  order_.resize(at(m));
  last_slot_.resize(at(m));
  for (int i = 0; i < m; ++i) {
    const auto begin = entry_slot_.begin() + rows[i].first_entry;
    int last = -1;
    for (auto slot = begin; slot != begin + rows[i].entry_count; ++slot)
      last = std::max(last, *slot);
    last_slot_[at(i)] = last;
    order_[at(i)] = i;
  }
  std::sort(order_.begin(), order_.end(), [&](int a, int b) {
    return std::pair(last_slot_[at(a)], a) < std::pair(last_slot_[at(b)], b);
  });
  row_pitch_ = 0;
  for (Part& part : parts_) {
    part.offset = row_pitch_;
    row_pitch_ += 3 * part.inverse.slots() + 1;  // four are read where three are meant
    part.slot.clear();
    part.coefficient.clear();
    part.first_entry.assign(1, 0);
    part.width.clear();
  }
  entry_offset_.clear();
  entry_coefficient_.clear();
  first_entry_.assign(1, 0);
  for (const int i : order_) {
    const auto entries = rows.entries(rows[i]);
    for (std::size_t e = 0; e < entries.size(); ++e) {
      Part& part = part_of(entries[e].vertex);
      const int slot = entry_slot_[at(rows[i].first_entry) + e];
      const Vec3& c = entries[e].coefficient;
      part.slot.push_back(slot);
      part.coefficient.insert(part.coefficient.end(), {c[0], c[1], c[2]});
      entry_offset_.push_back(static_cast<std::int32_t>(part.offset + 3 * slot));
      entry_coefficient_.insert(entry_coefficient_.end(), {c[0], c[1], c[2], 0.0});
    }
    first_entry_.push_back(static_cast<std::int32_t>(entry_offset_.size()));
    for (Part& part : parts_) {
      std::int64_t width = part.width.empty() ? 0 : part.width.back();
      for (std::size_t e = at(part.first_entry.back()); e < part.slot.size(); ++e)
        width = std::max<std::int64_t>(width, 3 * (part.slot[e] + 1));
      part.first_entry.push_back(static_cast<std::int32_t>(part.slot.size()));
      part.width.push_back(width);
    }
  }
}

/// T = C G in the columns of one part, a block of them at a time.
void Compliance::multiply_by_inverse(Part& part) {
  const std::int64_t stride = part.inverse.pitch();
  const std::int64_t end = part.width.empty() ? 0 : part.width.back();
  for (std::int64_t first = 0; first < end; first += kBlockColumns) {
    const auto used = std::lower_bound(part.active.begin(), part.active.end(), first / 3);
    if (used == part.active.end() || 3 * *used >= first + kBlockColumns) continue;  // by nobody
    for (std::size_t k = 0; k < order_.size(); ++k) {
      const std::int64_t count = std::min(kBlockColumns, part.width[k] - first);
      if (count <= 0) continue;
      double* t =
          row_times_g_.data() + static_cast<std::int64_t>(k) * row_pitch_ + part.offset + first;
      std::fill_n(t, count + 1, 0.0);  // and the lane behind them
      const auto last = at(part.first_entry[k + 1]);
      for (std::size_t e = at(part.first_entry[k]); e < last;) {
        const std::size_t taken = std::min(kAdd.size(), last - e);
        std::array<const double*, kAdd.size()> g{};
        for (std::size_t i = 0; i < taken; ++i)
          g[i] = part.inverse.row(part.slot[e + i], 0) + first;
        kAdd[taken - 1](g.data(), stride, part.coefficient.data() + 3 * e, count, t);
        e += taken;
      }
    }
  }
}

/// W = T Cᵀ + ε, both triangles.
void Compliance::multiply_by_rows(const ConstraintRows& rows) {
  const std::size_t m = order_.size();
  products_.resize(kRowsAtOnce * m);
  double* w = w_.value.data();
  for (std::size_t first = 0; first < m; first += kRowsAtOnce) {
    const std::size_t end = std::min(first + kRowsAtOnce, m);
    std::array<const double*, kRowsAtOnce> t{};
    for (std::size_t r = 0; r < kRowsAtOnce; ++r)  // the last once more, for a full number
      t[r] = row_times_g_.data() + std::min(first + r, m - 1) * at(row_pitch_);
    sparse_products(entry_coefficient_.data(), entry_offset_.data(), first_entry_.data(), end,
                    t.data(), products_.data());
    for (std::size_t other = 0; other < end; ++other) {
      const std::size_t j = at(order_[other]);
      for (std::size_t k = std::max(first, other); k < end; ++k) {  // the later row's product
        const std::size_t i = at(order_[k]);
        w[j * m + i] = w[i * m + j] = products_[kRowsAtOnce * other + k - first];
      }
    }
  }
  for (std::size_t i = 0; i < m; ++i) w[i * m + i] += rows[static_cast<int>(i)].compliance_m_per_n;
}

/// W += J M Jᵀ + β k kᵀ.
void Compliance::add_needles(const ConstraintRows& rows, std::span<const NeedleMobility> needles) {
  const int m = rows.size();
  double* w = w_.value.data();
  for (int i = 0; i < m; ++i) {
    const Row& row = rows[i];
    if (row.needle < 0) continue;
    const NeedleMobility& needle = needles[at(row.needle)];
    const Vec6 response = needle.mobility * row.needle_jacobian;
    for (int j = 0; j <= i; ++j) {
      const Row& other = rows[j];
      if (other.needle != row.needle) continue;
      const double sum = response.dot(other.needle_jacobian) +
                         needle.slide_compliance_m_per_n * row.slide * other.slide;
      w[at(j) * at(m) + at(i)] += sum;
      if (i != j) w[at(i) * at(m) + at(j)] += sum;
    }
  }
}

const ComplianceMatrix& Compliance::assemble(const ConstraintRows& rows,
                                             std::span<const NeedleMobility> needles, bool held) {
  ++step_;
  take_vertices(rows);
  kept_ = held && known_;
  if (kept_) return w_;
  known_ = true;
  order_rows(rows);
  w_.size = rows.size();
  w_.value.resize(at(rows.size()) * at(rows.size()));
  row_times_g_.resize(at(rows.size()) * at(row_pitch_));
  for (Part& part : parts_) multiply_by_inverse(part);
  multiply_by_rows(rows);
  add_needles(rows, needles);
  return w_;
}

void Compliance::apply(const ConstraintRows& rows, std::span<const double> multiplier_n) {
  for (const std::int32_t vertex : loaded_) {
    force_n_[at(vertex)].setZero();
    is_loaded_[at(vertex)] = 0;
  }
  loaded_.clear();
  for (int i = 0; i < rows.size(); ++i) {
    const double lambda_n = multiplier_n[at(i)];
    if (lambda_n == 0.0) continue;
    for (const Entry& entry : rows.entries(rows[i])) {
      force_n_[at(entry.vertex)] += lambda_n * entry.coefficient;
      if (!std::exchange(is_loaded_[at(entry.vertex)], std::uint8_t{1}))
        loaded_.push_back(entry.vertex);
    }
  }
  std::sort(loaded_.begin(), loaded_.end());  // sums must not depend on the order of rows
}

Vec3 Compliance::displacement_m(std::int32_t vertex) {
  InverseBlocks& inverse = part_of(vertex).inverse;
  int slot = inverse.find(vertex);
  if (slot < 0) slot = inverse.add(vertex);
  inverse.use(slot, step_);
  Vec3 u = Vec3::Zero();
  for (const std::int32_t other : loaded_) {
    if (part_of_[at(other)] != part_of_[at(vertex)]) continue;
    const int column = inverse.find(other);
    inverse.ensure_pair(slot, column);
    const Vec3& f = force_n_[at(other)];
    for (int r = 0; r < 3; ++r) {
      const double* g = inverse.row(slot, r) + 3 * column;
      u[r] += g[0] * f[0] + g[1] * f[1] + g[2] * f[2];
    }
  }
  return u;
}

void Compliance::displacements_m(std::span<const double> offset, std::span<double> u) {
  loads_.clear();
  for (const std::int32_t vertex : loaded_) {
    const InverseBlocks& inverse = part_of(vertex).inverse;
    loads_.push_back({&inverse.columns(inverse.find(vertex)), force_n_[at(vertex)]});
  }
  factor_->backward(loads_, offset, u);
}

void Compliance::serialize(Archive& archive) {
  if (archive.reads()) clear();
  if (archive.keeps_caches()) {
    archive(step_);
    for (Part& part : parts_) part.inverse.serialize(archive);
  }
  std::vector<std::pair<std::int32_t, Vec3>> forces;
  for (const std::int32_t vertex : loaded_) forces.emplace_back(vertex, force_n_[at(vertex)]);
  archive(forces);
  if (!archive.reads()) return;
  for (Part& part : parts_) part.new_vertices.clear();
  for (const auto& [vertex, _] : forces) {
    if (vertex < 0 || at(vertex) >= part_of_.size() ||
        (!loaded_.empty() && vertex <= loaded_.back()))
      throw ArchiveError("it is of another scene");
    loaded_.push_back(vertex);
    is_loaded_[at(vertex)] = 1;
    if (Part& part = part_of(vertex); part.inverse.find(vertex) < 0)
      part.new_vertices.push_back(vertex);
  }
  for (Part& part : parts_) part.inverse.add(part.new_vertices);
  for (const auto& [vertex, force_n] : forces) {
    InverseBlocks& inverse = part_of(vertex).inverse;
    if (!archive.keeps_caches()) inverse.use(inverse.find(vertex), step_);
    force_n_[at(vertex)] = force_n;
  }
}

int Compliance::cached_vertices() const {
  int sum = 0;
  for (const Part& part : parts_) sum += part.inverse.cached_vertices();
  return sum;
}

std::uint64_t Compliance::walks() const {
  std::uint64_t sum = 0;
  for (const Part& part : parts_) sum += part.inverse.walks();
  return sum;
}

}  // namespace sutured::constraints
