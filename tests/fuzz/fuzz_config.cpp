// SPDX-License-Identifier: GPL-3.0-or-later
// The configuration file of `sutured serve`: options that are taken, or a fault with its place.
#include <CLI/CLI.hpp>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>

#include "commands/serve_command.hpp"
#include "support/temporary_folder.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const sutured::testing::TemporaryFolder folder;
  const std::string path =
      folder.write("a.toml", std::string_view(reinterpret_cast<const char*>(data), size));
  CLI::App app("sutured", "sutured");
  sutured::commands::Action action;
  sutured::commands::add_serve_command(app, action);
  const char* const words[] = {"sutured",    "serve",     "scene.toml", "--config",
                               path.c_str(), "--session", "class-a"};
  try {
    app.parse(static_cast<int>(std::size(words)), words);
    if (!action) std::abort();
  } catch (const CLI::ConfigError& error) {
    if (std::string(error.what()).find(path) == std::string::npos) std::abort();
  } catch (const CLI::ParseError&) {
  }
  return 0;
}
