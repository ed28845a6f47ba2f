// SPDX-License-Identifier: GPL-3.0-or-later
// G, the blocks of K⁻¹ between the vertices in use of one part of the tissue.
//
//     G_vw = (L⁻¹ P e_v)ᵀ (L⁻¹ P e_w)          3 × 3, m/N, from columns walked to the root
//
// A vertex in use has a slot. G is kept from step to step: a vertex that joins costs one walk of
// its path and its inner products; one that stays costs nothing. Between two parts (two vessels, as
// long as nothing ties them together) K⁻¹ is zero: each part has its own G.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "archive/archive.hpp"
#include "fem/cholesky_factor.hpp"

namespace sutured::constraints {

/// Thread: simulation. Allocates: for vertices it has never seen together.
class InverseBlocks {
 public:
  /// Of part `part` of `factor` (CholeskyFactor::part_of).
  InverseBlocks(std::shared_ptr<const fem::CholeskyFactor> factor, std::int32_t part);

  /// Walks the paths of `vertices` and multiplies their pairs before they are needed, and keeps
  /// them for good, in slots 0, 1 … Call at set-up, with nothing cached.
  void prepare(std::span<const std::int32_t> vertices);

  /// Takes the memory of as many vertices more as a step may well need, so that no step does.
  void reserve();

  /// Returns the slot of a vertex of this part, or −1.
  [[nodiscard]] int find(std::int32_t vertex) const {
    return slot_of_vertex_[static_cast<std::size_t>(vertex - first_vertex_)];
  }
  /// Gives a vertex that has none a slot, by a walk of its own.
  int add(std::int32_t vertex);
  /// Gives each of `vertices`, which have none, a slot: all by one walk.
  void add(std::span<const std::int32_t> vertices);
  /// Marks a slot as used in `step`; returns whether that is news.
  bool use(int slot, std::uint64_t step) {
    std::uint64_t& last = last_used_[static_cast<std::size_t>(slot)];
    if (last == step) return false;
    last = step;
    return true;
  }
  /// Sees that G holds every pair of `slots`, sorted.
  void ensure_pairs(std::span<const int> slots);
  void ensure_pair(int a, int b);

  /// Forgets slots unused since `oldest`, but for the prepared and for the vertices of `loaded`,
  /// sorted.
  void evict(std::uint64_t oldest, std::span<const std::int32_t> loaded);
  /// Forgets all but the prepared: what follows comes out to the bit as after construction.
  void clear();

  /// Archives what is kept beyond the prepared slots, each in its place: the order of slots is the
  /// order of sums. Precondition when reading: nothing else is cached. Throws ArchiveError.
  void serialize(Archive& archive);

  /// Row `axis` of `slot`, of which column 3 w + a is axis a of slot w.
  [[nodiscard]] const double* row(int slot, int axis) const {
    return g_.data() + static_cast<std::size_t>(3 * slot + axis) * pitch_;
  }
  [[nodiscard]] std::int64_t pitch() const { return static_cast<std::int64_t>(pitch_); }
  [[nodiscard]] const fem::PathColumns& columns(int slot) const {
    return columns_[static_cast<std::size_t>(slot)];
  }
  [[nodiscard]] int capacity() const { return capacity_; }  ///< slots for which there is room
  [[nodiscard]] int slots() const { return high_water_; }   ///< those beyond were never used
  [[nodiscard]] int cached_vertices() const;
  [[nodiscard]] std::uint64_t walks() const { return walks_; }

 private:
  int& slot_of(std::int32_t vertex) {
    return slot_of_vertex_[static_cast<std::size_t>(vertex - first_vertex_)];
  }
  [[nodiscard]] bool owns(std::int32_t vertex) const;
  double* row_of(int row) { return g_.data() + static_cast<std::size_t>(row) * pitch_; }
  int free_slot();
  void forget(int slot);
  void grow(int capacity);
  void make_pairs(std::span<const int> a, std::span<const int> b);

  std::shared_ptr<const fem::CholeskyFactor> factor_;
  std::int32_t part_;
  std::int32_t first_vertex_ = 0;    ///< the lowest of this part
  std::vector<int> slot_of_vertex_;  ///< from that one on; −1 where not cached
  int capacity_ = 0;
  std::size_t pitch_ = 0;  ///< doubles from one row of G to the next
  int high_water_ = 0;     ///< slots beyond it were never used
  int prepared_ = 0;       ///< slots that are kept for good, the first
  std::uint64_t walks_ = 0;
  std::vector<fem::PathColumns> columns_;  ///< per slot; vertex −1 where free
  std::vector<std::uint64_t> last_used_;   ///< per slot
  std::vector<double> g_;                  ///< 3 capacity rows, `pitch_` apart
  std::vector<std::uint8_t> known_;        ///< capacity × capacity: pairs present in g_
  std::vector<int> paired_;                ///< slots whose pairs are all present
  // Workspaces.
  std::vector<fem::PathColumns*> new_columns_;
  std::vector<const fem::PathColumns*> columns_a_, columns_b_;
  std::vector<int> joining_, joining_prepared_, unprepared_;
  std::vector<double> new_blocks_;
};

}  // namespace sutured::constraints
