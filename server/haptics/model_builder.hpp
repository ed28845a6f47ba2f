// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "protocol/haptic_model.hpp"
#include "simulation/types.hpp"

namespace sutured::haptics {

/// Fills `model` with what `response` says near its reference pose; leaves epoch,
/// sequence, stamp and period alone.
/// Thread: simulation. Allocates: nothing.
void fill_model(const simulation::ToolResponse& response, suture::HapticModel& model);

}  // namespace sutured::haptics
