// SPDX-License-Identifier: GPL-3.0-or-later
// Command lines of `sutured` and `suture`, one word a line, the last one perhaps a value of the
// environment: parsed, not carried out.
#include <CLI/CLI.hpp>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <sstream>
#include <string>
#include <string_view>
#include <vector>

#include "commands.hpp"
#include "commands/check_command.hpp"
#include "commands/run_command.hpp"
#include "commands/serve_command.hpp"

namespace {

void parse_server(int count, const char* const* words) {
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

void parse_client(int count, const char* const* words) {
  std::ostringstream out, err;
  const auto parsed = suture::cli::parse_arguments(count, words, out, err);
  if (const auto* code = std::get_if<suture::cli::ExitCode>(&parsed))
    if ((*code == suture::cli::kDone ? out : err).str().empty()) std::abort();
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
  // The one option that the environment may give.
  constexpr std::string_view kToken = "SUTURE_TOKEN=";
  unsetenv("SUTURE_TOKEN");
  if (lines.back().starts_with(kToken)) {
    setenv("SUTURE_TOKEN", lines.back().c_str() + kToken.size(), 1);
    lines.pop_back();
    if (lines.empty()) return 0;
  }
  std::vector<const char*> words;
  for (const std::string& line : lines) words.push_back(line.c_str());
  const int count = static_cast<int>(words.size());
  if (lines[0] == "sutured") parse_server(count, words.data());
  if (lines[0] == "suture") parse_client(count, words.data());
  return 0;
}
