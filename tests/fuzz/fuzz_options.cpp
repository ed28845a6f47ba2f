// SPDX-License-Identifier: GPL-3.0-or-later
// Command lines of `sutured`, one word a line: parsed, not carried out.
#include <CLI/CLI.hpp>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <vector>

#include "commands/check_command.hpp"
#include "commands/run_command.hpp"
#include "commands/serve_command.hpp"

namespace {

void parse(int count, const char* const* words) {
  CLI::App app("sutured", "sutured");
  app.require_subcommand(1);
  sutured::commands::Action action;
  sutured::commands::add_serve_command(app, action);
  sutured::commands::add_check_command(app, action);
  sutured::commands::add_run_command(app, action);
  try {
    app.parse(count, words);
    if (!action) std::abort();
  } catch (const CLI::ParseError&) {
  }
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
  std::vector<const char*> words;
  for (const std::string& line : lines) words.push_back(line.c_str());
  parse(static_cast<int>(words.size()), words.data());
  return 0;
}
