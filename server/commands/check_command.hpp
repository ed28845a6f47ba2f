// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

namespace CLI {
class App;
}

namespace sutured::commands {

/// Adds `sutured check`, which reports on a scene or a mesh. Sets `exit_code` when it runs: 0 where
/// the file can be simulated, 1 where it has faults.
void add_check_command(CLI::App& app, int& exit_code);

}  // namespace sutured::commands
