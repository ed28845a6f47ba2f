// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "commands/action.hpp"

namespace CLI {
class App;
}

namespace sutured::commands {

/// Adds `sutured serve`, which simulates a scene and lets devices feel it until SIGINT,
/// SIGTERM or its `--duration`. The `action` of such a command line returns:
///
///     0  ended as asked                       3  another server has this session
///     1  the scene or the simulation failed   4  the network or a permission is missing
///     2  an option is at fault
void add_serve_command(CLI::App& app, Action& action);

}  // namespace sutured::commands
