// SPDX-License-Identifier: GPL-3.0-or-later
// The command line of the server. Each subcommand lives in commands/.
#include <CLI/CLI.hpp>
#include <exception>
#include <filesystem>
#include <iostream>
#include <sstream>
#include <string>

#include "commands/check_command.hpp"
#include "commands/run_command.hpp"
#include "commands/serve_command.hpp"
#include "commands/service_log.hpp"
#include "fem/blas_kernels.hpp"
#include "protocol/standard_output.hpp"

namespace {

int run(int argc, char** argv) {
  CLI::App app("sutured: a haptic server for suturing simulation", "sutured");
  app.set_version_flag("--version", SUTURED_VERSION);
  app.require_subcommand(1);
  app.footer(
      "Help on one command: sutured COMMAND --help\n"
      "Exit codes: 0 done, 1 a scene, a run or a simulation is at fault, 2 wrong usage; of serve "
      "also\n"
      "  3 another server has this session, 4 network or permission.");

  sutured::commands::Action action;
  sutured::commands::add_serve_command(app, action);
  sutured::commands::add_check_command(app, action);
  sutured::commands::add_run_command(app, action);
  try {
    app.parse(argc, argv);
    return action();
  } catch (const CLI::Success& help) {
    return app.exit(help);
  } catch (const CLI::ParseError& error) {
    std::ostringstream text;
    app.exit(error, std::cout, text);
    sutured::commands::tell_failure(text.str());
    return 2;
  } catch (const std::filesystem::filesystem_error& error) {
    sutured::commands::tell_failure("sutured: " + error.path1().string() + ": " +
                                    error.code().message());
    return 1;
  } catch (const std::exception& error) {
    sutured::commands::tell_failure(std::string("sutured: ") + error.what());
    return 1;
  }
}

}  // namespace

int main(int argc, char** argv) {
  sutured::fem::use_best_blas_kernels(argv);
  const int code = run(argc, argv);
  const std::string fault = suture::standard_output_fault();
  if (fault.empty()) return code;
  sutured::commands::tell_failure("sutured: " + fault);
  return code == 0 ? 1 : code;
}
