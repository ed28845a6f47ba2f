// SPDX-License-Identifier: GPL-3.0-or-later
#include "constraints/held_rows.hpp"

#include <cmath>
#include <cstddef>

namespace sutured::constraints {
namespace {

bool hardly_differ(const Entry& a, const Entry& b) {
  return a.vertex == b.vertex &&
         (a.coefficient - b.coefficient).cwiseAbs().maxCoeff() <= kHeldChange;
}

bool hardly_differ(const Row& a, const Row& b) {
  const double change_m_per_n = std::abs(a.compliance_m_per_n - b.compliance_m_per_n);
  return a.needle < 0 && b.needle < 0 && a.key == b.key && a.entry_count == b.entry_count &&
         change_m_per_n <= kHeldChange * b.compliance_m_per_n;
}

bool may_hold(const ConstraintRows& rows, const ConstraintRows& before) {
  if (rows.size() != before.size()) return false;
  for (int i = 0; i < rows.size(); ++i) {
    if (!hardly_differ(rows[i], before[i])) return false;
    const auto entries = rows.entries(rows[i]);
    const auto were = before.entries(before[i]);
    for (std::size_t e = 0; e < entries.size(); ++e)
      if (!hardly_differ(entries[e], were[e])) return false;
  }
  return true;
}

}  // namespace

bool hold_coefficients(ConstraintRows& rows, const ConstraintRows& before,
                       std::span<const Vec3> positions_m) {
  if (!may_hold(rows, before)) return false;
  for (int i = 0; i < rows.size(); ++i) {
    const auto entries = rows.entries(rows[i]);
    const auto were = before.entries(before[i]);
    rows[i].compliance_m_per_n = before[i].compliance_m_per_n;
    for (std::size_t e = 0; e < entries.size(); ++e) {
      const Vec3& x = positions_m[static_cast<std::size_t>(entries[e].vertex)];
      rows[i].target_m += (were[e].coefficient - entries[e].coefficient).dot(x);
      entries[e].coefficient = were[e].coefficient;
    }
  }
  return true;
}

}  // namespace sutured::constraints
