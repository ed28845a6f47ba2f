// SPDX-License-Identifier: GPL-3.0-or-later
// Command lines of `sutured` and `suture`, one word a line, the first one the program; the last one
// may be SUTURE_TOKEN=… of the environment. Parsed, not carried out.
#include <CLI/CLI.hpp>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>
#include <vector>

#include "commands/check_command.hpp"
#include "commands/run_command.hpp"
#include "commands/serve_command.hpp"
#include "options.hpp"

namespace {

template <class Action, class Add>
void parse(const std::vector<const char*>& words, const Add& add_commands) {
  CLI::App app("fuzz", "fuzz");
  app.require_subcommand(1);
  Action action;
  add_commands(app, action);
  try {
    app.parse(static_cast<int>(words.size()), words.data());
    if (!action) std::abort();
  } catch (const CLI::ParseError&) {
  }
}

void add_sutured(CLI::App& app, sutured::commands::Action& action) {
  sutured::commands::add_serve_command(app, action);
  sutured::commands::add_check_command(app, action);
  sutured::commands::add_run_command(app, action);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::vector<std::string> lines(1);
  for (std::size_t i = 0; i < size; ++i) {
    if (data[i] == '\n') {
      lines.emplace_back();
    } else if (data[i] != 0) {  // no argument holds one
      lines.back() += static_cast<char>(data[i]);
    }
  }
  constexpr std::string_view kToken = "SUTURE_TOKEN=";
  unsetenv("SUTURE_TOKEN");
  if (lines.size() > 1 && lines.back().starts_with(kToken)) {
    setenv("SUTURE_TOKEN", lines.back().c_str() + kToken.size(), 1);
    lines.pop_back();
  }
  std::vector<const char*> words;
  for (const std::string& line : lines) words.push_back(line.c_str());
  if (lines.front() == "suture")
    parse<suture::cli::Action>(words, suture::cli::add_commands);
  else
    parse<sutured::commands::Action>(words, add_sutured);
  return 0;
}
