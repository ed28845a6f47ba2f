// SPDX-License-Identifier: GPL-3.0-or-later
// Private to this folder: between which bounds a scene's numbers make sense. They are wide, wider
// than anything that is sutured: what lies beyond is a slip of the unit or of the exponent, and
// would end in a matrix that is not finite instead of in an error with its place.
#pragma once

#include "scene/toml_table.hpp"

namespace sutured::scene {

/// Positive and at most `high`.
constexpr Range up_to(double high, const char* mend) {
  return {.low = 0.0, .high = high, .low_open = true, .mend = mend};
}
/// Zero or more and at most `high`.
constexpr Range none_up_to(double high, const char* mend) {
  return {.low = 0.0, .high = high, .mend = mend};
}
/// Each component of a vector, either way.
constexpr Range within(double size, const char* mend) {
  return {.low = -size, .high = size, .mend = mend};
}

inline constexpr Range kScale{
    .low = 1e-9, .high = 1e3, .mend = "metres per unit of the mesh: 0.001 for millimetres"};
inline constexpr Range kModulus{
    .low = 1.0, .high = 1e13, .mend = "pascals: soft tissue has 1e3 to 1e7, steel 2e11"};
inline constexpr Range kDensity{
    .low = 1.0, .high = 1e5, .mend = "kilograms per cubic metre: tissue has about 1000"};
inline constexpr Range kLength = up_to(100.0, "metres: 0.0006 is 0.6 mm");
inline constexpr Range kLengthOrNone = none_up_to(100.0, "metres: 0.0006 is 0.6 mm");
inline constexpr Range kForce = up_to(1e4, "newtons: a hand pushes with up to 100");
inline constexpr Range kTorque = up_to(1e4, "newton metres: a wrist turns with up to 10");
inline constexpr Range kSlew = up_to(1e7, "newtons (or newton metres) a second: 500 is usual");
inline constexpr Range kStiffness = up_to(1e8, "N/m, or N·m/rad: a firm grip has 2000 and 0.5");
inline constexpr Range kSpeed = up_to(1e3, "metres a second: a hand moves with up to 2");
inline constexpr Range kRatio = up_to(1e3, "a factor: 1 changes nothing");
inline constexpr Range kFriction = none_up_to(1e6, "per metre of embedded needle: 20 is usual");
inline constexpr Range kFrictionCoefficient = none_up_to(100.0, "a coefficient: 0.2 is usual");
inline constexpr Range kGravity = within(1e3, "m/s²: [0, 0, -9.81] on earth");
inline constexpr Range kPlace = within(100.0, "metres: 0.0006 is 0.6 mm");
inline constexpr Range kLoad = within(1e4, "newtons");
inline constexpr Range kPressure = within(1e9, "pascals: blood has about 1.6e4");

/// Of a body, from end to end (m).
inline constexpr Range kBodyLength{.low = 1e-4, .high = 10.0};

}  // namespace sutured::scene
