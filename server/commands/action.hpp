// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <functional>

namespace sutured::commands {

/// What a command line asks for; returns the exit code. Empty until a command line was parsed:
/// to parse one does nothing else.
using Action = std::function<int()>;

}  // namespace sutured::commands
