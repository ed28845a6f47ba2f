// SPDX-License-Identifier: GPL-3.0-or-later
#include "constraints/inverse_blocks.hpp"

#include <algorithm>
#include <numeric>
#include <utility>

namespace sutured::constraints {
namespace {

// Rows of G lie an odd number of cache lines apart: a power of two would crowd into few sets.
constexpr std::size_t kPitchPadding = 8;
// Vertices to begin with: a part of the paper's scene fits.
constexpr int kCapacity = 192;
// Vertices that `prepare` takes at a time.
constexpr std::size_t kPrepareBatch = 64;
// From so many vertices that join on, their blocks of G are taken as matrix products.
constexpr std::size_t kBatchMin = 4;

}  // namespace

InverseBlocks::InverseBlocks(std::shared_ptr<const fem::CholeskyFactor> factor, std::int32_t part)
    : factor_(std::move(factor)), part_(part) {
  std::int32_t last = -1;
  for (std::int32_t v = 0; v < factor_->vertex_count(); ++v) {
    if (factor_->part_of(v) != part) continue;
    if (last < 0) first_vertex_ = v;
    last = v;
  }
  slot_of_vertex_.assign(static_cast<std::size_t>(last < 0 ? 0 : last - first_vertex_ + 1), -1);
  grow(kCapacity);
}

bool InverseBlocks::owns(std::int32_t vertex) const {
  return vertex >= 0 && vertex < factor_->vertex_count() && factor_->part_of(vertex) == part_;
}

void InverseBlocks::grow(int capacity) {
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
  capacity_ = capacity;
}

int InverseBlocks::free_slot() {
  int free = 0;
  while (free < high_water_ && columns_[static_cast<std::size_t>(free)].vertex >= 0) ++free;
  if (free == capacity_) grow(2 * capacity_);
  high_water_ = std::max(high_water_, free + 1);
  return free;
}

int InverseBlocks::add(std::int32_t vertex) {
  const int slot = slot_of(vertex) = free_slot();
  factor_->walk_path(vertex, columns_[static_cast<std::size_t>(slot)]);
  ++walks_;
  return slot;
}

void InverseBlocks::add(std::span<const std::int32_t> vertices) {
  if (vertices.empty()) return;
  for (const std::int32_t vertex : vertices) {
    const int slot = free_slot();
    columns_[static_cast<std::size_t>(slot)].vertex = vertex;  // taken
    slot_of(vertex) = slot;
  }
  new_columns_.clear();  // only now: taking slots may have moved them
  for (const std::int32_t vertex : vertices)
    new_columns_.push_back(&columns_[static_cast<std::size_t>(find(vertex))]);
  factor_->walk_paths(vertices, new_columns_);
  walks_ += vertices.size();
}

void InverseBlocks::prepare(std::span<const std::int32_t> vertices) {
  if (static_cast<int>(vertices.size()) + kCapacity > capacity_)
    grow(static_cast<int>(vertices.size()) + kCapacity);
  // A few at a time, so that what their products are taken from stays small.
  std::vector<int> slots;
  for (std::size_t first = 0; first < vertices.size(); first += kPrepareBatch) {
    add(vertices.subspan(first, std::min(kPrepareBatch, vertices.size() - first)));
    slots.resize(static_cast<std::size_t>(high_water_));
    std::iota(slots.begin(), slots.end(), 0);
    ensure_pairs(slots);
  }
  prepared_ = static_cast<int>(vertices.size());
}

void InverseBlocks::reserve() {
  const auto values = 3 * static_cast<std::size_t>(factor_->path_length_max(part_));
  // Written once, so that the pages are there, too.
  for (int slot = high_water_; slot < capacity_; ++slot)
    columns_[static_cast<std::size_t>(slot)].value.resize(values);
}

void InverseBlocks::ensure_pair(int a, int b) {
  const auto i = static_cast<std::size_t>(a), j = static_cast<std::size_t>(b);
  const auto n = static_cast<std::size_t>(capacity_);
  if (known_[i * n + j]) return;
  const fem::Mat3 block = factor_->inverse_block(columns_[i], columns_[j]);
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c)
      row_of(3 * a + r)[3 * b + c] = row_of(3 * b + c)[3 * a + r] = block(r, c);
  known_[i * n + j] = known_[j * n + i] = 1;
}

/// Computes G between slots `a` and `b`, as one matrix product a supernode.
void InverseBlocks::make_pairs(std::span<const int> a, std::span<const int> b) {
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
          row_of(3 * i + r)[3 * j + c] = row_of(3 * j + c)[3 * i + r] =
              block[static_cast<std::size_t>(c) * rows + static_cast<std::size_t>(r)];
      known_[static_cast<std::size_t>(i) * n + static_cast<std::size_t>(j)] =
          known_[static_cast<std::size_t>(j) * n + static_cast<std::size_t>(i)] = 1;
    }
}

void InverseBlocks::ensure_pairs(std::span<const int> slots) {
  if (std::equal(slots.begin(), slots.end(), paired_.begin(), paired_.end())) return;
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
  const auto prepared_end = std::lower_bound(slots.begin(), slots.end(), prepared_);
  for (auto slot = prepared_end; slot != slots.end(); ++slot)
    (lacks_one_of(*slot, slots) ? joining_ : unprepared_).push_back(*slot);
  for (auto slot = slots.begin(); slot != prepared_end; ++slot)
    if (lacks_one_of(*slot, unprepared_)) joining_prepared_.push_back(*slot);
  if (joining_.size() + joining_prepared_.size() >= kBatchMin) {
    make_pairs(joining_, slots);
    make_pairs(joining_prepared_, unprepared_);
  } else {
    for (const int slot : joining_)
      for (const int other : slots) ensure_pair(slot, other);
    for (const int slot : joining_prepared_)
      for (const int other : unprepared_) ensure_pair(slot, other);
  }
  paired_.assign(slots.begin(), slots.end());
}

void InverseBlocks::evict(std::uint64_t oldest, std::span<const std::int32_t> loaded) {
  for (int slot = prepared_; slot < high_water_; ++slot) {
    const auto s = static_cast<std::size_t>(slot);
    if (last_used_[s] < oldest &&
        !std::binary_search(loaded.begin(), loaded.end(), columns_[s].vertex))
      forget(slot);
  }
  while (high_water_ > prepared_ && columns_[static_cast<std::size_t>(high_water_ - 1)].vertex < 0)
    --high_water_;
}

void InverseBlocks::clear() {
  for (int slot = prepared_; slot < high_water_; ++slot) forget(slot);
  std::fill(last_used_.begin(), last_used_.end(), std::uint64_t{0});
  high_water_ = prepared_;
  paired_.resize(static_cast<std::size_t>(prepared_));
  std::iota(paired_.begin(), paired_.end(), 0);
}

void InverseBlocks::forget(int slot) {
  const auto s = static_cast<std::size_t>(slot), n = static_cast<std::size_t>(capacity_);
  std::int32_t& vertex = columns_[s].vertex;
  if (vertex < 0) return;
  slot_of(vertex) = -1;
  vertex = -1;
  std::erase(paired_, slot);
  for (std::size_t other = 0; other < n; ++other) known_[s * n + other] = known_[other * n + s] = 0;
}

void InverseBlocks::serialize(Archive& archive) {
  int prepared = prepared_, used = high_water_;
  archive(prepared, used);
  if (prepared != prepared_ || used < prepared ||
      static_cast<std::size_t>(used) > std::max<std::size_t>(slot_of_vertex_.size(), 1))
    throw ArchiveError("it is of another scene");
  while (used > capacity_) grow(2 * capacity_);
  if (archive.reads()) high_water_ = used;
  for (int slot = 0; slot < used; ++slot) archive(last_used_[static_cast<std::size_t>(slot)]);
  const auto n = static_cast<std::size_t>(capacity_);
  for (int slot = prepared; slot < used; ++slot) {
    fem::PathColumns& columns = columns_[static_cast<std::size_t>(slot)];
    archive(columns.vertex);
    if (columns.vertex < 0) continue;
    if (!owns(columns.vertex)) {
      columns.vertex = -1;
      throw ArchiveError("it is of another scene");
    }
    slot_of(columns.vertex) = slot;
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
          archive(row_of(3 * slot + r)[3 * other + c]);
          row_of(3 * other + c)[3 * slot + r] = row_of(3 * slot + r)[3 * other + c];
        }
    }
  }
  archive(paired_);
}

int InverseBlocks::cached_vertices() const {
  return static_cast<int>(std::count_if(columns_.begin(), columns_.begin() + high_water_,
                                        [](const auto& column) { return column.vertex >= 0; }));
}

}  // namespace sutured::constraints
