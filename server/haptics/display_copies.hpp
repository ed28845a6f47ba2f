// SPDX-License-Identifier: GPL-3.0-or-later
// Copies of what grows, into frames that must not: a viewer's picture may be cut, the
// simulation's thread may neither allocate for it nor send without end.
#pragma once

#include <span>
#include <vector>

#include "simulation/types.hpp"

namespace sutured::haptics {

inline constexpr std::size_t kShownCourseMax = 2048;  ///< points of one thread
inline constexpr std::size_t kShownPuncturesMax = 256;
inline constexpr std::size_t kShownContactsMax = 512;

/// Makes room for the most punctures that `copy_needle` copies.
void reserve_needle(simulation::NeedleState& to);

/// Copies a needle; punctures beyond `kShownPuncturesMax` are lost, the tail's first. Allocates:
/// never, into a needle that was reserved.
void copy_needle(const simulation::NeedleState& from, simulation::NeedleState& to);

/// Makes room for the longest thread that `copy_thread` copies.
void reserve_thread(simulation::ThreadState& to);

/// Copies a thread; a course beyond `kShownCourseMax` points loses its tail, punctures beyond
/// `kShownPuncturesMax` likewise. Allocates: never, into a thread that was reserved.
void copy_thread(const simulation::ThreadState& from, simulation::ThreadState& to);

/// Copies contacts, the first `kShownContactsMax` of them. Allocates: never, with that capacity.
void copy_contacts(std::span<const simulation::ContactPoint> from,
                   std::vector<simulation::ContactPoint>& to);

}  // namespace sutured::haptics
