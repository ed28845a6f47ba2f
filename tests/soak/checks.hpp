// SPDX-License-Identifier: GPL-3.0-or-later
// What must hold after every step, whatever the hands did.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "simulation/simulation.hpp"

namespace sutured::soak {

/// Largest complementarity residual that no event speaks of.
inline constexpr double kSilentResidualMax = 1e-8;

/// Returns what is wrong with the outputs of the last step, or nothing. `displaced`:
/// `update_displacements` was called after it, so tets are checked too.
[[nodiscard]] std::optional<std::string> fault_of(const scene::Scene& scene,
                                                  const simulation::Simulation& sim,
                                                  bool displaced);

/// Counts the tets of `sim` whose determinant is not above zero.
[[nodiscard]] int count_inverted(const simulation::Simulation& sim);

/// Hashes every bit of the last step's outputs that does not depend on when displacements are asked
/// for: responses, needles, threads, contacts, events, counts.
[[nodiscard]] std::uint64_t hash_of(const simulation::Simulation& sim, std::uint64_t hash);

/// Hashes every bit of where tissue, needles and threads are.
[[nodiscard]] std::uint64_t hash_of_places(const simulation::Simulation& sim);

}  // namespace sutured::soak
