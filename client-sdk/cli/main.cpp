// SPDX-License-Identifier: Apache-2.0
// `suture`: a device without hardware, a live table, a look at the machine, recordings,
// pictures, commands.
#include <CLI/CLI.hpp>
#include <csignal>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <string>

#include "commands.hpp"
#include "options.hpp"
#include "protocol/standard_output.hpp"
#include "suture/error.hpp"

namespace suture::cli {
namespace {

constexpr const char* kExitCodes =
    "Exit codes:\n"
    "  0 done · 1 failed · 2 arguments or an input file · 3 no server · 4 another protocol\n"
    "  version · 5 tool unknown or in use · 6 not permitted · 130 interrupted";

void on_signal(int /*signal*/) { interrupted = true; }

int exit_code_of(ErrorCode code) {
  switch (code) {
    case ErrorCode::kNoServer:
      return kNoServer;
    case ErrorCode::kVersionMismatch:
      return kVersion;
    case ErrorCode::kUnknownTool:
    case ErrorCode::kToolInUse:
      return kTool;
    case ErrorCode::kPermissionDenied:
      return kPermission;
    case ErrorCode::kBadInput:
      return kUsage;
    case ErrorCode::kServerRunning:
    case ErrorCode::kNetwork:
    case ErrorCode::kIncompatibleQos:
      return kFailed;
  }
  return kFailed;
}

int run(int argc, char** argv) {
  CLI::App app("suture: the client's tools for a sutured server", "suture");
  app.set_version_flag("--version", SUTURE_VERSION);
  app.footer(kExitCodes);

  Action action;
  add_commands(app, action);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? kDone : kUsage;
  }

  struct sigaction handler {};
  handler.sa_handler = on_signal;
  sigaction(SIGINT, &handler, nullptr);
  sigaction(SIGTERM, &handler, nullptr);

  try {
    return action();
  } catch (const Error& error) {
    std::fflush(stdout);
    std::fprintf(stderr, "suture: %s\n", error.cause().c_str());
    if (!error.mend().empty()) std::fprintf(stderr, "  %s\n", error.mend().c_str());
    return exit_code_of(error.code());
  } catch (const std::filesystem::filesystem_error& error) {
    std::fflush(stdout);
    std::fprintf(stderr, "suture: %s: %s\n", error.path1().c_str(), error.code().message().c_str());
    return kFailed;
  } catch (const std::exception& error) {
    std::fflush(stdout);
    std::fprintf(stderr, "suture: %s\n", error.what());
    return kFailed;
  }
}

}  // namespace
}  // namespace suture::cli

int main(int argc, char** argv) {
  const int code = suture::cli::run(argc, argv);
  const std::string fault = suture::standard_output_fault();
  if (fault.empty()) return code;
  std::fprintf(stderr, "suture: %s\n", fault.c_str());
  return code == suture::cli::kDone ? suture::cli::kFailed : code;
}
