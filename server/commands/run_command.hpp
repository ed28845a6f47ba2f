// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

namespace CLI {
class App;
}

namespace sutured::commands {

/// Adds `sutured run`, which plays a surgeon file through a scene without clock or network. Sets
/// `exit_code` when it runs: 0 done, 1 where an input has faults or an output cannot be written.
void add_run_command(CLI::App& app, int& exit_code);

}  // namespace sutured::commands
