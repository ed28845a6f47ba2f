// SPDX-License-Identifier: GPL-3.0-or-later
#include "commands/serve_command.hpp"

#include <signal.h>
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <limits>
#include <optional>
#include <string>
#include <utility>

#include "commands/run_record.hpp"
#include "endpoints/server.hpp"
#include "protocol/number_option.hpp"
#include "protocol/types.hpp"
#include "scene/scene_reader.hpp"

namespace sutured::commands {
namespace {

constexpr int kSceneFailed = 1, kBadCommandLine = 2, kServerRunning = 3, kNoNetwork = 4;

struct Options {
  std::string scene;
  std::string session;
  std::uint32_t domain = 0;
  std::string http = "off";
  double rate_hz = 0.0;
  double duration_s = 0.0;
  std::string out;  ///< empty: no record
};

/// Keeps the record of what is served, on the simulation's thread. A reset begins a new one.
class ServedRecord {
 public:
  ServedRecord(scene::Scene scene, double rate_hz, std::filesystem::path folder)
      : scene_(std::move(scene)), rate_hz_(rate_hz), folder_(std::move(folder)) {}

  void watch(simulation::Simulation& simulation, bool last) {
    if (simulation.time_s() < time_s_) record_.reset();
    time_s_ = simulation.time_s();
    if (!record_) record_.emplace(scene_, simulation, rate_hz_);
    if (!last) return record_->watch(simulation);
    try {
      record_->write(folder_, simulation);
    } catch (const std::exception& error) {
      failure_ = error.what();
    }
  }
  /// Why the record could not be written; to be read once the server has stopped.
  [[nodiscard]] const std::string& failure() const { return failure_; }

 private:
  scene::Scene scene_;
  double rate_hz_;
  std::filesystem::path folder_;
  double time_s_ = 0.0;
  std::optional<RunRecord> record_;
  std::string failure_;
};

/// Keeps the signals that end a server for `wait`; threads made after it inherit that.
class EndSignals {
 public:
  EndSignals() {
    sigemptyset(&set_);
    sigaddset(&set_, SIGINT);
    sigaddset(&set_, SIGTERM);
    pthread_sigmask(SIG_BLOCK, &set_, &before_);
  }
  ~EndSignals() { pthread_sigmask(SIG_SETMASK, &before_, nullptr); }
  EndSignals(const EndSignals&) = delete;
  EndSignals& operator=(const EndSignals&) = delete;

  /// Returns the signal that came within `duration_ns`, or 0.
  int wait(std::int64_t duration_ns) const {
    const timespec timeout{duration_ns / 1'000'000'000, duration_ns % 1'000'000'000};
    const int signal = sigtimedwait(&set_, nullptr, &timeout);
    return signal > 0 ? signal : 0;
  }

 private:
  sigset_t set_{}, before_{};
};

int exit_code_of(suture::ErrorCode code) {
  switch (code) {
    case suture::ErrorCode::kBadInput:
      return kBadCommandLine;
    case suture::ErrorCode::kServerRunning:
      return kServerRunning;
    default:
      return kNoNetwork;
  }
}

int serve(const Options& options) {
  const EndSignals signals;
  const auto log = spdlog::stderr_color_st("sutured");
  scene::Scene scene = scene::read_scene(options.scene);
  for (const std::string& note : scene.notes) log->info("{}", note);
  const std::string name = scene.name;
  const double rate_hz = options.rate_hz > 0.0 ? options.rate_hz : scene.rate_hz;

  endpoints::Server::Options server_options;
  server_options.session.domain = options.domain;
  server_options.session.session = options.session;
  server_options.rate_hz = rate_hz;
  std::optional<ServedRecord> record;
  if (!options.out.empty()) {
    std::filesystem::create_directories(options.out);
    record.emplace(scene, rate_hz, options.out);
    server_options.watch = [&record](simulation::Simulation& simulation, bool last) {
      record->watch(simulation, last);
    };
  }
  endpoints::Server server(std::move(scene), std::move(server_options));
  if (!server.realtime().note.empty()) log->warn("{}", server.realtime().note);
  if (const std::string notes = server.notes(); !notes.empty()) log->warn("{}", notes);
  log->info(
      "serving scene \"{}\" at {} Hz in domain {}, {}; Ctrl-C ends", name, rate_hz, options.domain,
      options.session.empty() ? "the default session" : "session \"" + options.session + "\"");

  constexpr std::int64_t kLook_ns = 200'000'000;
  const std::int64_t end_ns =
      options.duration_s > 0.0
          ? suture::monotonic_ns() + static_cast<std::int64_t>(options.duration_s * 1e9)
          : std::numeric_limits<std::int64_t>::max();
  std::string reason;
  int code = 0;
  while (reason.empty()) {
    const std::int64_t left_ns = end_ns - suture::monotonic_ns();
    if (left_ns <= 0) {
      reason = "its duration is over";
    } else if (const int signal = signals.wait(std::min(kLook_ns, left_ns)); signal != 0) {
      reason = signal == SIGINT ? "interrupted" : "terminated";
    } else if (std::string failure = server.failure(); !failure.empty()) {
      log->error("the simulation ended: {}", failure);
      reason = "the simulation ended: " + failure;
      code = kSceneFailed;
    }
  }
  const std::string summary = server.summary();
  server.stop(reason);
  if (record && !record->failure().empty()) {
    log->error("{}", record->failure());
    code = kSceneFailed;
  }
  log->info("stopping, {}: {}", reason, summary);
  return code;
}

int serve_and_tell(const Options& options) {
  try {
    return serve(options);
  } catch (const suture::Error& error) {
    std::cerr << "sutured serve: " << error.what() << '\n';
    return exit_code_of(error.code());
  } catch (const std::exception& error) {
    // A scene's faults carry their own file:line:column.
    std::cerr << error.what() << '\n';
    return kSceneFailed;
  }
}

}  // namespace

void add_serve_command(CLI::App& app, int& exit_code) {
  CLI::App* command = app.add_subcommand("serve", "Simulate a scene and let devices feel it");
  auto options = std::make_shared<Options>();
  command->add_option("scene", options->scene, "Scene file (TOML)")->required();
  command->add_option("--session", options->session,
                      "Session name: servers and devices of one name meet (a DDS partition)");
  command->add_option("--domain", options->domain,
                      "DDS domain, even; meshes for viewers travel in the next one");
  command->add_option("--http", options->http, "Gateway for browsers: only 'off' for now")
      ->check([](const std::string& value) {
        return value == "off" ? std::string()
                              : "the gateway is not part of this version: leave --http out, "
                                "or say 'off'";
      });
  command->add_option("--rate", options->rate_hz, "Steps a second, instead of the scene's")
      ->check(suture::within(30.0, 1000.0, "Hz"));
  command->add_option("--duration", options->duration_s, "End after so many seconds")
      ->check(suture::within(0.0001, 1e8, "s"));
  command->add_option("--out", options->out,
                      "Folder for final.vtk and summary.json, written when the server ends");
  command->footer(
      "Examples:\n"
      "  sutured serve server/scenes/anastomosis/scene.toml\n"
      "  sutured serve scene.toml --session class-a --domain 4 --duration 60\n"
      "Exit codes: 0 ended as asked, 1 the scene or the simulation failed, 2 command line,\n"
      "  3 another server has this session, 4 network or permission.");
  command->callback([options, &exit_code] { exit_code = serve_and_tell(*options); });
}

}  // namespace sutured::commands
