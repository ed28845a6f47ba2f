// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>

namespace CLI {
class App;
class Option;
}  // namespace CLI

namespace sutured::commands {

/// Adds `--config FILE` to a command whose other options then may stand in that file: TOML, a key
/// for each option, by its long name without dashes, or the name of a positional. To be added
/// before them.
///
///     rate = 500
///     http-origin = ["https://example.org"]   # repeatable: an array
///
///     [server.class-a]                        # only where this is the --session
///     http = "127.0.0.1:8081"
///
/// The command line wins over the file, and a server's table over the rest. Bad TOML, an unknown
/// key, and a value that its option refuses end the command's parsing with a CLI::ConfigError of
/// file:line:column and the mend.
CLI::Option* add_config_option(CLI::App& command);

}  // namespace sutured::commands
