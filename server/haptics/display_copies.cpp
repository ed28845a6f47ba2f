// SPDX-License-Identifier: GPL-3.0-or-later
#include "haptics/display_copies.hpp"

#include <algorithm>
#include <utility>

namespace sutured::haptics {
namespace {

template <class T>
void copy_first(std::span<const T> from, std::size_t most, std::vector<T>& to) {
  const auto count = static_cast<std::ptrdiff_t>(std::min(from.size(), most));
  to.assign(from.begin(), from.begin() + count);
}

}  // namespace

void reserve_needle(simulation::NeedleState& to) { to.punctures.reserve(kShownPuncturesMax); }

void copy_needle(const simulation::NeedleState& from, simulation::NeedleState& to) {
  to.position_m = from.position_m;
  to.orientation = from.orientation;
  to.holder = from.holder;
  to.active_cells = from.active_cells;
  to.embedded_length_m = from.embedded_length_m;
  to.tip_force_n = from.tip_force_n;
  to.tip_inside = from.tip_inside;
  copy_first(std::span(from.punctures), kShownPuncturesMax, to.punctures);
}

void reserve_thread(simulation::ThreadState& to) {
  to.course_m.reserve(kShownCourseMax);
  to.arc_length_m.reserve(kShownCourseMax);
  to.segment_tension_n.reserve(kShownCourseMax - 1);
  to.punctures.reserve(kShownPuncturesMax);
}

void copy_thread(const simulation::ThreadState& from, simulation::ThreadState& to) {
  to.length_m = from.length_m;
  to.tension_n = from.tension_n;
  to.slack_m = from.slack_m;
  to.taut = from.taut;
  to.overlength_m = from.overlength_m;
  to.head = from.head;
  to.tail = from.tail;
  to.head_holder = from.head_holder;
  to.tail_holder = from.tail_holder;
  copy_first(std::span(from.course_m), kShownCourseMax, to.course_m);
  copy_first(std::span(from.arc_length_m), kShownCourseMax, to.arc_length_m);
  copy_first(std::span(from.segment_tension_n), kShownCourseMax - 1, to.segment_tension_n);
  copy_first(std::span(from.punctures), kShownPuncturesMax, to.punctures);
}

void copy_contacts(std::span<const simulation::ContactPoint> from,
                   std::vector<simulation::ContactPoint>& to) {
  copy_first(from, kShownContactsMax, to);
}

}  // namespace sutured::haptics
