// SPDX-License-Identifier: GPL-3.0-or-later
// Scalar constraints on tissue, needles and tools.
//
//     gap_i = C_i x + ε_i λ_i − b_i − J_i η − k_i σ − Jᵗ_i ξ
//
//   x   positions of the tissue's vertices          K u = f + Cᵀ λ
//   η   twist of the needle, unknown                wrench on the needle = −Jᵀ λ
//   σ   slide of the needle along itself, unknown   friction along it    = −k λ
//   ξ   twist of a tool, given                      wrench on the tool   = −Jᵗᵀ λ
//
// A bilateral row has gap = 0; a unilateral one gap ≥ 0, λ ≥ 0, gap λ = 0; in general
// lower ≤ λ ≤ upper, and gap is positive only at the lower bound, negative only at the upper.
// Twists are (translation, rotation vector) in world axes about the body's reference point.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "archive/archive.hpp"
#include "geometry/tet_mesh.hpp"

namespace sutured::constraints {

using geometry::Vec3;
using Vec6 = Eigen::Matrix<double, 6, 1>;
using Mat6 = Eigen::Matrix<double, 6, 6>;

inline constexpr double kUnbounded = std::numeric_limits<double>::infinity();

/// The range of a multiplier, N.
struct Bounds {
  double lower_n = -kUnbounded;
  double upper_n = kUnbounded;
  [[nodiscard]] static Bounds bilateral() { return {}; }
  [[nodiscard]] static Bounds unilateral(double upper_n = kUnbounded) { return {0.0, upper_n}; }
  [[nodiscard]] bool bilateral_unbounded() const {
    return lower_n == -kUnbounded && upper_n == kUnbounded;
  }
};

/// One scalar constraint; its entries stand in ConstraintRows.
struct Row {
  std::int32_t first_entry = 0;
  std::int32_t entry_count = 0;
  Bounds bounds;
  double target_m = 0.0;                ///< b
  double compliance_m_per_n = 0.0;      ///< ε ≥ 0
  std::int32_t needle = -1;             ///< the needle it couples to, or −1
  Vec6 needle_jacobian = Vec6::Zero();  ///< J
  double slide = 0.0;                   ///< k
  std::int32_t tool = -1;               ///< the tool that feels it, or −1
  Vec6 tool_jacobian = Vec6::Zero();    ///< Jᵗ
  std::int32_t second_tool = -1;        ///< another one that feels it (a thread between two jaws)
  Vec6 second_tool_jacobian = Vec6::Zero();
  std::int32_t friction_of = -1;      ///< the normal row whose cone this row's force stays in
  double friction_coefficient = 0.0;  ///< of that cone
  std::uint64_t key = 0;  ///< names the row from step to step, for the warm start; 0: none

  /// Couples the row to one more tool, of two at the most.
  void feel(std::int32_t who, const Vec6& jacobian) {
    if (tool < 0 || tool == who) {
      tool = who;
      tool_jacobian += jacobian;
    } else {
      second_tool = who;
      second_tool_jacobian += jacobian;
    }
  }
  /// Returns Jᵗ of tool `who`, or null where it does not feel the row.
  [[nodiscard]] const Vec6* jacobian_of(std::int32_t who) const {
    return who < 0              ? nullptr
           : tool == who        ? &tool_jacobian
           : second_tool == who ? &second_tool_jacobian
                                : nullptr;
  }
};

/// One vertex of one row.
struct Entry {
  std::int32_t vertex = -1;
  Vec3 coefficient = Vec3::Zero();
};

/// The rows of a step, in the order in which they were added.
class ConstraintRows {
 public:
  void clear() {
    rows_.clear();
    entries_.clear();
  }
  void reserve(std::size_t rows, std::size_t entries) {
    rows_.reserve(rows);
    entries_.reserve(entries);
  }
  /// Adds a row and returns it; valid until the next `add`.
  Row& add(const Bounds& bounds, double target_m, double compliance_m_per_n) {
    Row row;
    row.first_entry = static_cast<std::int32_t>(entries_.size());
    row.bounds = bounds;
    row.target_m = target_m;
    row.compliance_m_per_n = compliance_m_per_n;
    rows_.push_back(row);
    return rows_.back();
  }
  /// Gives the last row `coefficient` at `vertex` (global index). A vertex may repeat.
  void touch(std::int32_t vertex, const Vec3& coefficient) {
    entries_.push_back({vertex, coefficient});
    ++rows_.back().entry_count;
  }
  void serialize(Archive& archive) {
    auto& [rows, entries] = *this;
    archive(rows, entries);
  }
  [[nodiscard]] int size() const { return static_cast<int>(rows_.size()); }
  [[nodiscard]] const Row& operator[](int i) const { return rows_[static_cast<std::size_t>(i)]; }
  [[nodiscard]] Row& operator[](int i) { return rows_[static_cast<std::size_t>(i)]; }
  [[nodiscard]] std::span<const Entry> entries(const Row& row) const {
    return {entries_.data() + row.first_entry, static_cast<std::size_t>(row.entry_count)};
  }
  [[nodiscard]] std::span<Entry> entries(const Row& row) {
    return {entries_.data() + row.first_entry, static_cast<std::size_t>(row.entry_count)};
  }

 private:
  std::vector<Row> rows_;
  std::vector<Entry> entries_;
};

}  // namespace sutured::constraints
