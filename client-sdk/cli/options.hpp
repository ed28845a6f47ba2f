// SPDX-License-Identifier: Apache-2.0
// The command line of `suture`, apart from what it asks for.
#pragma once

#include <functional>

namespace CLI {
class App;
}

namespace suture::cli {

/// What a command line asks for; returns the exit code, and throws suture::Error for what ends it
/// early. Empty until a command line was parsed: to parse one does nothing else.
using Action = std::function<int()>;

/// Adds every subcommand. Once `app` has parsed one, `action` does it.
void add_commands(CLI::App& app, Action& action);

}  // namespace suture::cli
