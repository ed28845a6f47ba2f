// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "commands/action.hpp"

namespace CLI {
class App;
}

namespace sutured::commands {

/// Adds `sutured run`, which plays a surgeon file through a scene without clock or network. The
/// `action` of such a command line returns 0 when done, 1 where an input has faults or an output
/// cannot be written.
void add_run_command(CLI::App& app, Action& action);

}  // namespace sutured::commands
