// SPDX-License-Identifier: GPL-3.0-or-later
#include "constraints/compliance.hpp"

#include <algorithm>
#include <array>
#include <numeric>
#include <utility>

#include "fem/simd_kernel.hpp"

namespace sutured::constraints {
namespace {

/// t += c0 g0 + c1 g1 + c2 g2, the three rows of one vertex.
SUTURED_KERNEL void add_three_rows(const double* g, std::int64_t stride, const double* c,
                                   std::int64_t count, double* t) {
  const double *g0 = g, *g1 = g + stride, *g2 = g + 2 * stride;
#pragma omp simd
  for (std::int64_t i = 0; i < count; ++i) t[i] += c[0] * g0[i] + c[1] * g1[i] + c[2] * g2[i];
}

/// The same over the twelve rows of four vertices, so that t is read and written once for all.
SUTURED_KERNEL void add_twelve_rows(const double* const* g, std::int64_t stride, const double* c,
                                    std::int64_t count, double* t) {
  const double *a = g[0], *b = g[1], *d = g[2], *e = g[3];
#pragma omp simd
  for (std::int64_t i = 0; i < count; ++i)
    t[i] += (c[0] * a[i] + c[1] * a[i + stride] + c[2] * a[i + 2 * stride]) +
            (c[3] * b[i] + c[4] * b[i + stride] + c[5] * b[i + 2 * stride]) +
            (c[6] * d[i] + c[7] * d[i + stride] + c[8] * d[i + 2 * stride]) +
            (c[9] * e[i] + c[10] * e[i + stride] + c[11] * e[i + 2 * stride]);
}

/// out[j] = Σ over the entries of row j of c · t[slot], for the first `rows` rows; four lanes at a
/// time: each coefficient carries a zero behind it. Entries of row j: first[j] … first[j + 1].
SUTURED_KERNEL void sparse_products(const double* coefficient, const int* offset,
                                    const std::int32_t* first, int rows, const double* t,
                                    double* out) {
  for (int j = 0; j < rows; ++j) {
    double sum[4] = {0.0, 0.0, 0.0, 0.0};
    for (std::int32_t e = first[j]; e < first[j + 1]; ++e) {
      const double *c = coefficient + 4 * e, *x = t + offset[e];
#pragma omp simd
      for (int k = 0; k < 4; ++k) sum[k] += c[k] * x[k];
    }
    out[j] = (sum[0] + sum[1]) + (sum[2] + sum[3]);
  }
}

// Rows of G lie an odd number of cache lines apart: a power of two would crowd into few sets.
constexpr std::size_t kPitchPadding = 8;
// Columns of G taken at a time, so that their share of G stays in the second-level cache.
constexpr std::int64_t kBlockColumns = 96;
// Columns of W that are mirrored together: a cache line of each stays in the first-level cache.
constexpr std::size_t kTile = 32;
// Vertices to begin with: the paper's scene fits.
constexpr int kCapacity = 384;
// Vertices that `prepare` takes at a time.
constexpr std::size_t kPrepareBatch = 64;
// From so many vertices that join on, their blocks of G are taken as matrix products.
constexpr std::size_t kBatchMin = 4;

}  // namespace

Compliance::Compliance(std::shared_ptr<const fem::CholeskyFactor> factor)
    : factor_(std::move(factor)),
      slot_of_vertex_(static_cast<std::size_t>(factor_->vertex_count()), -1) {
  grow(kCapacity);
}

void Compliance::grow(int capacity) {
  const auto old = static_cast<std::size_t>(capacity_), now = static_cast<std::size_t>(capacity);
  const std::size_t old_pitch = pitch_;
  pitch_ = 3 * now + kPitchPadding;
  std::vector<double> g(3 * now * pitch_, 0.0);
  std::vector<std::uint8_t> known(now * now, 0);
  for (std::size_t i = 0; i < 3 * old; ++i)
    std::copy_n(g_.begin() + static_cast<std::ptrdiff_t>(i * old_pitch), 3 * old,
                g.begin() + static_cast<std::ptrdiff_t>(i * pitch_));
  for (std::size_t i = 0; i < old; ++i)
    std::copy_n(known_.begin() + static_cast<std::ptrdiff_t>(i * old), old,
                known.begin() + static_cast<std::ptrdiff_t>(i * now));
  g_.swap(g);
  known_.swap(known);
  columns_.resize(now);
  last_used_.resize(now, 0);
  force_n_.resize(now, Vec3::Zero());
  active_.reserve(now);
  loaded_.reserve(now);
  loads_.reserve(now);
  capacity_ = capacity;
}

int Compliance::free_slot() {
  int free = 0;
  while (free < high_water_ && columns_[static_cast<std::size_t>(free)].vertex >= 0) ++free;
  if (free == capacity_) grow(2 * capacity_);
  high_water_ = std::max(high_water_, free + 1);
  return free;
}

int Compliance::slot_of(std::int32_t vertex) {
  int& slot = slot_of_vertex_[static_cast<std::size_t>(vertex)];
  if (slot < 0) {
    slot = free_slot();
    factor_->walk_path(vertex, columns_[static_cast<std::size_t>(slot)]);
    ++walks_;
  }
  last_used_[static_cast<std::size_t>(slot)] = step_;
  return slot;
}

/// Walks the paths of all vertices that join with these rows, together.
void Compliance::walk_new(const ConstraintRows& rows) {
  new_vertices_.clear();
  for (int i = 0; i < rows.size(); ++i)
    for (const Entry& entry : rows.entries(rows[i]))
      if (slot_of_vertex_[static_cast<std::size_t>(entry.vertex)] < 0)
        new_vertices_.push_back(entry.vertex);
  std::sort(new_vertices_.begin(), new_vertices_.end());
  new_vertices_.erase(std::unique(new_vertices_.begin(), new_vertices_.end()), new_vertices_.end());
  walk(new_vertices_);
}

/// Gives each of `vertices`, none of which is known, a slot and its path.
void Compliance::walk(std::span<const std::int32_t> vertices) {
  if (vertices.empty()) return;
  for (const std::int32_t vertex : vertices) {
    const int slot = free_slot();
    columns_[static_cast<std::size_t>(slot)].vertex = vertex;  // taken
    slot_of_vertex_[static_cast<std::size_t>(vertex)] = slot;
  }
  new_columns_.clear();  // only now: taking slots may have moved them
  for (const std::int32_t vertex : vertices) {
    const int slot = slot_of_vertex_[static_cast<std::size_t>(vertex)];
    new_columns_.push_back(&columns_[static_cast<std::size_t>(slot)]);
  }
  factor_->walk_paths(vertices, new_columns_);
  walks_ += vertices.size();
}

void Compliance::prepare(std::span<const std::int32_t> vertices) {
  if (static_cast<int>(vertices.size()) + kCapacity > capacity_)
    grow(static_cast<int>(vertices.size()) + kCapacity);
  // A few at a time, so that what their products are taken from stays small.
  for (std::size_t first = 0; first < vertices.size(); first += kPrepareBatch) {
    walk(vertices.subspan(first, std::min(kPrepareBatch, vertices.size() - first)));
    active_.resize(static_cast<std::size_t>(high_water_));
    std::iota(active_.begin(), active_.end(), 0);
    ensure_pairs();
  }
  active_.clear();
  prepared_ = static_cast<int>(vertices.size());
}

void Compliance::ensure_pair(int a, int b) {
  const auto i = static_cast<std::size_t>(a), j = static_cast<std::size_t>(b);
  const auto n = static_cast<std::size_t>(capacity_);
  if (known_[i * n + j]) return;
  const fem::Mat3 block = factor_->inverse_block(columns_[i], columns_[j]);
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c)
      g_row(3 * a + r)[3 * b + c] = g_row(3 * b + c)[3 * a + r] = block(r, c);
  known_[i * n + j] = known_[j * n + i] = 1;
}

/// Computes G between slots `a` and `b`, as one matrix product a supernode.
void Compliance::make_pairs(std::span<const int> a, std::span<const int> b) {
  if (a.empty() || b.empty()) return;
  const auto gather = [&](std::span<const int> slots, std::vector<const fem::PathColumns*>& out) {
    out.clear();
    for (const int slot : slots) out.push_back(&columns_[static_cast<std::size_t>(slot)]);
  };
  gather(a, columns_a_);
  gather(b, columns_b_);
  factor_->inverse_blocks(columns_a_, columns_b_, new_blocks_);
  const std::size_t rows = 3 * a.size();
  const auto n = static_cast<std::size_t>(capacity_);
  for (std::size_t k = 0; k < b.size(); ++k)
    for (std::size_t l = 0; l < a.size(); ++l) {
      const int i = a[l], j = b[k];
      const double* block = new_blocks_.data() + 3 * k * rows + 3 * l;
      for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 3; ++c)
          g_row(3 * i + r)[3 * j + c] = g_row(3 * j + c)[3 * i + r] =
              block[static_cast<std::size_t>(c) * rows + static_cast<std::size_t>(r)];
      known_[static_cast<std::size_t>(i) * n + static_cast<std::size_t>(j)] =
          known_[static_cast<std::size_t>(j) * n + static_cast<std::size_t>(i)] = 1;
    }
}

/// Sees that G holds every pair of active vertices.
void Compliance::ensure_pairs() {
  if (active_ == paired_) return;
  const auto lacks_one_of = [&](int slot, std::span<const int> others) {
    const auto* known =
        known_.data() + static_cast<std::size_t>(slot) * static_cast<std::size_t>(capacity_);
    return !std::binary_search(paired_.begin(), paired_.end(), slot) &&
           std::any_of(others.begin(), others.end(), [&](int other) { return !known[other]; });
  };
  // The prepared know each other: they may lack only unprepared ones that do not join with all.
  joining_.clear();
  joining_prepared_.clear();
  unprepared_.clear();
  const auto prepared_end = std::lower_bound(active_.begin(), active_.end(), prepared_);
  for (auto slot = prepared_end; slot != active_.end(); ++slot)
    (lacks_one_of(*slot, active_) ? joining_ : unprepared_).push_back(*slot);
  for (auto slot = active_.begin(); slot != prepared_end; ++slot)
    if (lacks_one_of(*slot, unprepared_)) joining_prepared_.push_back(*slot);
  if (joining_.size() + joining_prepared_.size() >= kBatchMin) {
    make_pairs(joining_, active_);
    make_pairs(joining_prepared_, unprepared_);
  } else {
    for (const int slot : joining_)
      for (const int other : active_) ensure_pair(slot, other);
    for (const int slot : joining_prepared_)
      for (const int other : unprepared_) ensure_pair(slot, other);
  }
  paired_ = active_;
}

void Compliance::clear() {
  for (int slot = prepared_; slot < high_water_; ++slot) forget(slot);
  std::fill(last_used_.begin(), last_used_.end(), std::uint64_t{0});
  std::fill(force_n_.begin(), force_n_.end(), Vec3::Zero());
  active_.clear();
  loaded_.clear();
  high_water_ = prepared_;
  paired_.resize(static_cast<std::size_t>(prepared_));
  std::iota(paired_.begin(), paired_.end(), 0);
  step_ = 0;
}

void Compliance::forget(int slot) {
  const auto s = static_cast<std::size_t>(slot), n = static_cast<std::size_t>(capacity_);
  std::int32_t& vertex = columns_[s].vertex;
  if (vertex < 0) return;
  slot_of_vertex_[static_cast<std::size_t>(vertex)] = -1;
  vertex = -1;
  std::erase(paired_, slot);
  for (std::size_t other = 0; other < n; ++other) known_[s * n + other] = known_[other * n + s] = 0;
}

void Compliance::evict(int idle_steps_max) {
  for (int slot = prepared_; slot < high_water_; ++slot) {
    if (last_used_[static_cast<std::size_t>(slot)] + static_cast<std::uint64_t>(idle_steps_max) >=
        step_)
      continue;
    if (std::find(loaded_.begin(), loaded_.end(), slot) != loaded_.end()) continue;
    forget(slot);
  }
  while (high_water_ > prepared_ && columns_[static_cast<std::size_t>(high_water_ - 1)].vertex < 0)
    --high_water_;
}

const ComplianceMatrix& Compliance::assemble(const ConstraintRows& rows,
                                             std::span<const NeedleMobility> needles) {
  ++step_;
  const int m = rows.size();
  walk_new(rows);
  active_.clear();
  entry_slot_.clear();
  for (int i = 0; i < m; ++i)
    for (const Entry& entry : rows.entries(rows[i])) {
      const int slot = slot_of_vertex_[static_cast<std::size_t>(entry.vertex)];
      entry_slot_.push_back(slot);
      if (std::exchange(last_used_[static_cast<std::size_t>(slot)], step_) != step_)
        active_.push_back(slot);
    }
  std::sort(active_.begin(), active_.end());
  ensure_pairs();

  w_.size = m;
  w_.value.resize(static_cast<std::size_t>(m) * static_cast<std::size_t>(m));
  const auto stride = static_cast<std::int64_t>(pitch_);
  // In the order of their last vertex, a row needs T = C G only as far as that vertex: W is
  // symmetric, and of two rows the later one takes the product.
  order_.resize(static_cast<std::size_t>(m));
  row_width_.resize(static_cast<std::size_t>(m));
  for (int i = 0; i < m; ++i) {
    const auto begin = entry_slot_.begin() + rows[i].first_entry;
    int last = -1;
    for (auto slot = begin; slot != begin + rows[i].entry_count; ++slot)
      last = std::max(last, *slot);
    row_width_[static_cast<std::size_t>(i)] = 3 * (last + 1);
    order_[static_cast<std::size_t>(i)] = i;
  }
  std::sort(order_.begin(), order_.end(), [&](int a, int b) {
    return std::pair(row_width_[static_cast<std::size_t>(a)], a) <
           std::pair(row_width_[static_cast<std::size_t>(b)], b);
  });
  // T, a block of columns at a time; a row of it is padded by one lane.
  const auto width = static_cast<std::int64_t>(3) * high_water_;
  const auto pitch = width + 1;
  row_times_g_.resize(static_cast<std::size_t>(m) * static_cast<std::size_t>(pitch));
  for (std::int64_t first = 0; first < width; first += kBlockColumns) {
    const auto used = std::lower_bound(active_.begin(), active_.end(), first / 3);
    if (used == active_.end() || 3 * *used >= first + kBlockColumns) {  // nobody's columns
      for (const int i : order_)  // but the lane behind the block before
        if (row_width_[static_cast<std::size_t>(i)] >= first)
          row_times_g_[static_cast<std::size_t>(i * pitch + first)] = 0.0;
      continue;
    }
    for (const int i : order_) {
      const auto count = std::min(kBlockColumns, row_width_[static_cast<std::size_t>(i)] - first);
      if (count <= 0) continue;
      const auto entries = rows.entries(rows[i]);
      double* t = row_times_g_.data() + i * pitch + first;
      const int* slot = entry_slot_.data() + rows[i].first_entry;
      std::fill_n(t, count + 1, 0.0);
      std::size_t e = 0;
      for (; e + 4 <= entries.size(); e += 4) {
        std::array<const double*, 4> g;
        std::array<double, 12> c;
        for (std::size_t k = 0; k < 4; ++k) {
          g[k] = g_row(3 * slot[e + k]) + first;
          std::copy_n(entries[e + k].coefficient.data(), 3,
                      c.begin() + static_cast<std::ptrdiff_t>(3 * k));
        }
        add_twelve_rows(g.data(), stride, c.data(), count, t);
      }
      for (; e < entries.size(); ++e)
        add_three_rows(g_row(3 * slot[e]) + first, stride, entries[e].coefficient.data(), count, t);
    }
  }
  // W = T Cᵀ and what belongs to needles; C in that order, so that it is read from end to end.
  entry_offset_.clear();
  entry_coefficient_.resize(4 * entry_slot_.size());
  row_first_.clear();
  for (const int i : order_) {
    row_first_.push_back(static_cast<std::int32_t>(entry_offset_.size()));
    const auto entries = rows.entries(rows[i]);
    for (std::size_t e = 0; e < entries.size(); ++e) {
      const Vec3& c = entries[e].coefficient;
      std::copy_n(
          std::array<double, 4>{c[0], c[1], c[2], 0.0}.begin(), 4,
          entry_coefficient_.begin() + static_cast<std::ptrdiff_t>(4 * entry_offset_.size()));
      entry_offset_.push_back(3 * entry_slot_[static_cast<std::size_t>(rows[i].first_entry) + e]);
    }
  }
  row_first_.push_back(static_cast<std::int32_t>(entry_offset_.size()));
  products_.resize(static_cast<std::size_t>(m));
  for (int k = 0; k < m; ++k) {
    const int i = order_[static_cast<std::size_t>(k)];
    const Row& row = rows[i];
    const double* t = row_times_g_.data() + i * pitch;
    double* column = w_.value.data() + static_cast<std::size_t>(i) * static_cast<std::size_t>(m);
    sparse_products(entry_coefficient_.data(), entry_offset_.data(), row_first_.data(), k + 1, t,
                    products_.data());
    for (int other = 0; other <= k; ++other)
      column[order_[static_cast<std::size_t>(other)]] = products_[static_cast<std::size_t>(other)];
    column[i] += row.compliance_m_per_n;
  }
  const auto at = [&](int row, int column) -> double& {
    return w_.value[static_cast<std::size_t>(column) * static_cast<std::size_t>(m) +
                    static_cast<std::size_t>(row)];
  };
  // The other triangle, a tile at a time: its lines lie a column apart.
  for (std::size_t first = 0; first < order_.size(); first += kTile)
    for (std::size_t k = first; k < order_.size(); ++k)
      for (std::size_t other = first; other < std::min(first + kTile, k); ++other)
        at(order_[k], order_[other]) = at(order_[other], order_[k]);
  for (int i = 0; i < m; ++i) {
    const Row& row = rows[i];
    if (row.needle < 0) continue;
    const NeedleMobility& needle = needles[static_cast<std::size_t>(row.needle)];
    const Vec6 response = needle.mobility * row.needle_jacobian;
    for (int j = 0; j <= i; ++j) {
      const Row& other = rows[j];
      if (other.needle != row.needle) continue;
      const double sum = response.dot(other.needle_jacobian) +
                         needle.slide_compliance_m_per_n * row.slide * other.slide;
      at(i, j) += sum;
      if (i != j) at(j, i) += sum;
    }
  }
  return w_;
}

void Compliance::apply(const ConstraintRows& rows, std::span<const double> multiplier_n) {
  for (const int slot : loaded_) force_n_[static_cast<std::size_t>(slot)].setZero();
  loaded_.clear();
  for (int i = 0; i < rows.size(); ++i) {
    const double lambda_n = multiplier_n[static_cast<std::size_t>(i)];
    if (lambda_n == 0.0) continue;
    for (const Entry& entry : rows.entries(rows[i])) {
      const int slot = slot_of_vertex_[static_cast<std::size_t>(entry.vertex)];
      force_n_[static_cast<std::size_t>(slot)] += lambda_n * entry.coefficient;
      loaded_.push_back(slot);
    }
  }
  // In the order of vertices: slots tell what was in use before, and sums must not depend on that.
  std::sort(loaded_.begin(), loaded_.end(), [&](int a, int b) {
    return columns_[static_cast<std::size_t>(a)].vertex <
           columns_[static_cast<std::size_t>(b)].vertex;
  });
  loaded_.erase(std::unique(loaded_.begin(), loaded_.end()), loaded_.end());
}

Vec3 Compliance::displacement_m(std::int32_t vertex) {
  const int slot = slot_of(vertex);
  Vec3 u = Vec3::Zero();
  for (const int other : loaded_) {
    ensure_pair(slot, other);
    for (int r = 0; r < 3; ++r) {
      const double* g = g_row(3 * slot + r) + 3 * other;
      const Vec3& f = force_n_[static_cast<std::size_t>(other)];
      u[r] += g[0] * f[0] + g[1] * f[1] + g[2] * f[2];
    }
  }
  return u;
}

void Compliance::displacements_m(std::span<const double> offset, std::span<double> u) {
  loads_.clear();
  for (const int slot : loaded_)
    loads_.push_back(
        {&columns_[static_cast<std::size_t>(slot)], force_n_[static_cast<std::size_t>(slot)]});
  factor_->backward(loads_, offset, u);
}

void Compliance::serialize(Archive& archive) {
  if (archive.reads()) clear();
  if (archive.keeps_caches()) serialize_slots(archive);
  // The forces, by vertex.
  std::vector<std::pair<std::int32_t, Vec3>> forces;
  for (const int slot : loaded_)
    forces.emplace_back(columns_[static_cast<std::size_t>(slot)].vertex,
                        force_n_[static_cast<std::size_t>(slot)]);
  archive(forces);
  if (!archive.reads()) return;
  new_vertices_.clear();
  for (const auto& [vertex, _] : forces) {
    if (vertex < 0 || static_cast<std::size_t>(vertex) >= slot_of_vertex_.size())
      throw ArchiveError("it is of another scene");
    if (slot_of_vertex_[static_cast<std::size_t>(vertex)] < 0) new_vertices_.push_back(vertex);
  }
  walk(new_vertices_);
  for (const auto& [vertex, force_n] : forces) {
    const int slot = slot_of_vertex_[static_cast<std::size_t>(vertex)];
    if (!archive.keeps_caches()) last_used_[static_cast<std::size_t>(slot)] = step_;
    force_n_[static_cast<std::size_t>(slot)] = force_n;
    loaded_.push_back(slot);
  }
}

/// Archives what `assemble` keeps from step to step beyond the prepared slots, each in its place:
/// the order of slots is the order of sums. Precondition when reading: nothing else is cached.
void Compliance::serialize_slots(Archive& archive) {
  int prepared = prepared_, used = high_water_;
  archive(prepared, used, step_);
  if (prepared != prepared_ || used < prepared ||
      static_cast<std::size_t>(used) > slot_of_vertex_.size())
    throw ArchiveError("it is of another scene");
  while (used > capacity_) grow(2 * capacity_);
  if (archive.reads()) high_water_ = used;
  for (int slot = 0; slot < used; ++slot) archive(last_used_[static_cast<std::size_t>(slot)]);
  const auto n = static_cast<std::size_t>(capacity_);
  for (int slot = prepared; slot < used; ++slot) {
    fem::PathColumns& columns = columns_[static_cast<std::size_t>(slot)];
    archive(columns.vertex);
    if (columns.vertex < 0) continue;
    if (static_cast<std::size_t>(columns.vertex) >= slot_of_vertex_.size())
      throw ArchiveError("it is of another scene");
    slot_of_vertex_[static_cast<std::size_t>(columns.vertex)] = slot;
    archive(columns);
    // G is symmetric: each block once, with the slot that comes first.
    for (int other = 0; other <= slot; ++other) {
      std::uint8_t& known =
          known_[static_cast<std::size_t>(slot) * n + static_cast<std::size_t>(other)];
      archive(known);
      known_[static_cast<std::size_t>(other) * n + static_cast<std::size_t>(slot)] = known;
      if (!known) continue;
      for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 3; ++c) {
          archive(g_row(3 * slot + r)[3 * other + c]);
          g_row(3 * other + c)[3 * slot + r] = g_row(3 * slot + r)[3 * other + c];
        }
    }
  }
  archive(paired_);
}

int Compliance::cached_vertices() const {
  return static_cast<int>(std::count_if(columns_.begin(), columns_.begin() + high_water_,
                                        [](const auto& column) { return column.vertex >= 0; }));
}

}  // namespace sutured::constraints
