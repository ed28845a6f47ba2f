// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "commands/action.hpp"

namespace CLI {
class App;
}

namespace sutured::commands {

/// Adds `sutured check`, which reports on a scene or a mesh. The `action` of such
/// a command line returns 0 where the file can be simulated, 1 where it has faults.
void add_check_command(CLI::App& app, Action& action);

}  // namespace sutured::commands
