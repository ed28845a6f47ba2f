// SPDX-License-Identifier: GPL-3.0-or-later
#include "commands/serve_command.hpp"

#include <signal.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <limits>
#include <map>
#include <optional>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "checkpoints/checkpoint_file.hpp"
#include "commands/config_file.hpp"
#include "commands/output_file.hpp"
#include "commands/run_record.hpp"
#include "commands/scene_file.hpp"
#include "commands/service_log.hpp"
#include "commands/service_manager.hpp"
#include "endpoints/server.hpp"
#include "gateway/gateway.hpp"
#include "gateway/site.hpp"
#include "protocol/dds_log.hpp"
#include "protocol/number_option.hpp"
#include "protocol/rendezvous.hpp"
#include "protocol/types.hpp"
#include "scene/scene_reader.hpp"

namespace sutured::commands {
namespace {

constexpr int kSceneFailed = 1, kBadCommandLine = 2, kServerRunning = 3, kNoNetwork = 4;

struct Options {
  std::string scene;
  std::string session;
  std::uint32_t domain = 0;
  std::string security;  ///< folder of keys
  suture::NetworkOptions network;
  std::string http = "off";
  std::string http_tokens, http_page, http_certificate, http_key;
  std::vector<std::string> http_origins;
  double rate_hz = 0.0;
  double duration_s = 0.0;
  std::string out;          ///< empty: no record
  std::string checkpoints;  ///< empty: none
  std::size_t keep = 120;
  endpoints::Server::Options::Resume resume = endpoints::Server::Options::Resume::kAfterCrash;
};

/// Keeps the record of what is served, on the simulation's thread. A reset, a rewind and a restore
/// begin a new one.
class ServedRecord {
 public:
  ServedRecord(scene::Scene scene, double rate_hz, std::filesystem::path folder)
      : scene_(std::move(scene)), rate_hz_(rate_hz), folder_(std::move(folder)) {}

  void watch(simulation::Simulation& simulation, bool last) {
    const std::uint64_t step = simulation.report().step;
    if (step != step_ && step != step_ + 1) record_.reset();
    step_ = step;
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
  std::uint64_t step_ = 0;
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
  /// Once one has come they stay kept: whoever asks a second time would else end a server that is
  /// at its end already, with another exit code.
  ~EndSignals() {
    if (!came_) pthread_sigmask(SIG_SETMASK, &before_, nullptr);
  }
  EndSignals(const EndSignals&) = delete;
  EndSignals& operator=(const EndSignals&) = delete;

  /// Returns the signal that came within `duration_ns`, or 0.
  int wait(std::int64_t duration_ns) {
    const timespec timeout{duration_ns / 1'000'000'000, duration_ns % 1'000'000'000};
    const int signal = sigtimedwait(&set_, nullptr, &timeout);
    came_ |= signal > 0;
    return signal > 0 ? signal : 0;
  }

 private:
  sigset_t set_{}, before_{};
  bool came_ = false;
};

/// Splits `ADDR:PORT`, `[ADDR]:PORT` or `PORT`; false where it is none of them.
bool split_address(const std::string& text, std::string& address, std::uint16_t& port) {
  const std::size_t colon = text.rfind(':');
  std::string host = colon == std::string::npos ? "127.0.0.1" : text.substr(0, colon);
  const std::string number = colon == std::string::npos ? text : text.substr(colon + 1);
  if (host.size() > 2 && host.front() == '[' && host.back() == ']')
    host = host.substr(1, host.size() - 2);
  else if (host.empty() || host.find(':') != std::string::npos)
    return false;
  unsigned value = 0;
  const auto [end, error] = std::from_chars(number.data(), number.data() + number.size(), value);
  if (error != std::errc() || end != number.data() + number.size() || value > 65535) return false;
  address = host == "localhost" ? "127.0.0.1" : host;
  port = static_cast<std::uint16_t>(value);
  return true;
}

gateway::Gateway::Options gateway_options(const Options& options, spdlog::logger& log) {
  gateway::Gateway::Options web;
  split_address(options.http, web.address, web.port);
  web.page =
      options.http_page.empty() ? gateway::page_folder() : std::filesystem::path(options.http_page);
  web.tokens = options.http_tokens;
  web.origins = options.http_origins;
  web.certificate = options.http_certificate;
  web.key = options.http_key;
  web.log = [&log](bool bad, const std::string& text) {
    log.log(bad ? spdlog::level::err : spdlog::level::info, "{}", text);
  };
  return web;
}

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

/// The file of the scene asked for; a session without one serves the scene of its own name.
std::string scene_of(const Options& options) {
  const std::string& scene = options.scene.empty() ? options.session : options.scene;
  if (scene.empty())
    throw suture::Error(suture::ErrorCode::kBadInput, "no scene is given",
                        "name its file, as in `sutured serve scene.toml`");
  return scene_file(scene);
}

int serve(const Options& options) {
  EndSignals signals;
  ServiceManager manager;
  const auto log = make_service_log();
  // Nobody reads: then it is not waited for.
  const suture::DdsLog dds_log([&log](bool error, const std::string& line) {
    if (can_tell()) log->log(error ? spdlog::level::err : spdlog::level::warn, "DDS: {}", line);
  });
  const std::string file = scene_of(options);
  suture::ParticipantOptions session;
  session.domain = options.domain;
  session.session = options.session;
  session.security = options.security;
  session.network = options.network;
  // The web's door opens first: what is wrong with it is told before a large scene is read.
  std::optional<gateway::Gateway> web;
  if (options.http != "off") web.emplace(session, gateway_options(options, *log));

  scene::Scene scene = scene::read_scene(file);
  for (const std::string& note : scene.notes) log->info("{}", note);
  const std::string name = scene.name;
  const double rate_hz = options.rate_hz > 0.0 ? options.rate_hz : scene.rate_hz;

  endpoints::Server::Options server_options;
  server_options.session = session;
  server_options.rate_hz = rate_hz;
  if (!options.checkpoints.empty())
    server_options.checkpoints = {options.checkpoints, options.keep};
  server_options.resume = options.resume;
  server_options.more_viewers = [&web] { return web ? web->viewers_beyond_readers() : 0; };
  std::optional<ServedRecord> record;
  if (!options.out.empty()) {
    make_output_folder(options.out);
    record.emplace(scene, rate_hz, options.out);
    server_options.watch = [&record](simulation::Simulation& simulation, bool last) {
      record->watch(simulation, last);
    };
  }
  endpoints::Server server(std::move(scene), std::move(server_options));
  if (!server.realtime().note.empty()) log->warn("{}", server.realtime().note);
  std::istringstream notes(server.notes());
  for (std::string note; std::getline(notes, note);) log->warn("{}", note);
  if (!server.resumed().empty()) log->info("resumed {} of the simulation", server.resumed());
  const std::string serving =
      fmt::format("serving scene \"{}\" at {} Hz in domain {}, {}", name, rate_hz, options.domain,
                  suture::session_text(options.session));
  log->info("{}; Ctrl-C ends", serving);

  if (web) log->info("viewer at {}", web->url());
  manager.ready(serving);

  const std::int64_t end_ns =
      options.duration_s > 0.0
          ? suture::monotonic_ns() + static_cast<std::int64_t>(options.duration_s * 1e9)
          : std::numeric_limits<std::int64_t>::max();
  std::string reason;
  int code = 0;
  while (reason.empty()) {
    manager.watch(server.pulse());
    const std::int64_t left_ns = end_ns - suture::monotonic_ns();
    if (left_ns <= 0) {
      reason = "its duration is over";
    } else if (const int signal = signals.wait(std::min(manager.look_ns(), left_ns)); signal != 0) {
      reason = signal == SIGINT ? "interrupted" : "terminated";
    } else if (std::string rival = server.rival(); !rival.empty()) {
      log->error("{}", rival);
      reason = "another server has the session";
      code = kServerRunning;
    } else if (std::string failure = server.failure(); !failure.empty()) {
      log->error("the simulation ended: {}", failure);
      reason = "the simulation ended: " + failure;
      code = kSceneFailed;
    }
  }
  manager.stopping(reason);
  const std::string summary = server.summary();
  server.stop(reason);
  web.reset();
  if (record && !record->failure().empty()) {
    log->error("{}", record->failure());
    code = kSceneFailed;
  }
  log->info("stopping, {}: {}", reason, summary);
  return code;
}

/// Whoever starts a server again at its end (sutured@.service) does not try a wrong option twice.
int refuse_option(const std::exception& error) {
  tell_failure(std::string("sutured serve: ") + error.what());
  return kBadCommandLine;
}

int serve_and_tell(const Options& options) {
  try {
    return serve(options);
  } catch (const suture::Error& error) {
    tell_failure(std::string("sutured serve: ") + error.what());
    return exit_code_of(error.code());
  } catch (const OutputError& error) {
    return refuse_option(error);
  } catch (const checkpoints::CheckpointError& error) {
    // Of the folder: a checkpoint in it that cannot be used is told, and the scene begins anew.
    return refuse_option(error);
  } catch (const std::exception& error) {
    // A scene's faults carry their own file:line:column.
    tell_failure(error.what());
    return kSceneFailed;
  }
}

}  // namespace

void add_serve_command(CLI::App& app, Action& action) {
  CLI::App* command = app.add_subcommand("serve", "Simulate a scene and let devices feel it");
  auto options = std::make_shared<Options>();
  add_config_option(*command);
  command->add_option(
      "scene", options->scene,
      "Scene file (TOML), or the name of an installed scene; by default the session's "
      "name");
  command->add_option("--session", options->session,
                      "Session name: servers and devices of one name meet (a DDS partition)");
  command->add_option("--domain", options->domain,
                      "DDS domain, even; meshes for viewers travel in the next one");
  command->add_option("--security", options->security,
                      "Folder of keys that `suture keys add` made, or off; else SUTURE_SECURITY's");
  command->add_option("--interface", options->network.interface,
                      "Network interface, name or IPv4 address; else SUTURE_INTERFACE's, else this "
                      "machine alone");
  command
      ->add_option("--peer", options->network.peers,
                   "Host of a device or viewer, repeatable: nobody else is heard; else "
                   "SUTURE_PEERS'")
      ->allow_extra_args(false);
  command->add_flag("--unsecured-network", options->network.unsecured,
                    "Serve a network without keys: whoever is on it may drive the tools");
  CLI::Option* http =
      command
          ->add_option("--http", options->http,
                       "Gateway for browsers and web tools: ADDR:PORT, PORT (on 127.0.0.1) or off; "
                       "port 0: any free one")
          ->check([](const std::string& value) {
            std::string address;
            std::uint16_t port = 0;
            return value == "off" || split_address(value, address, port)
                       ? std::string()
                       : "\"" + value +
                             "\" is not an address: say 127.0.0.1:8080, [::1]:8080, 8080 or off";
          })
          ->capture_default_str();
  command
      ->add_option("--http-tokens", options->http_tokens,
                   "File of the tokens that web clients must bring (docs/guide/viewer.md); "
                   "needed, as TLS is, where ADDR is not loopback")
      ->needs(http);
  command
      ->add_option("--http-origin", options->http_origins,
                   "Pages of this origin may connect too, as https://example.org; repeatable")
      ->needs(http);
  CLI::Option* certificate = command->add_option("--http-certificate", options->http_certificate,
                                                 "PEM file: serve by TLS");
  CLI::Option* key =
      command->add_option("--http-key", options->http_key, "PEM file: its private key");
  certificate->needs(key)->needs(http);
  key->needs(certificate);
  command->add_option("--http-page", options->http_page, "Folder of the web page, if not ours")
      ->check(CLI::ExistingDirectory)
      ->needs(http);
  command->add_option("--rate", options->rate_hz, "Steps a second, instead of the scene's")
      ->check(suture::within(30.0, 1000.0, "Hz"));
  command->add_option("--duration", options->duration_s, "End after so many seconds")
      ->check(suture::within(0.0001, 1e8, "s"));
  command->add_option("--out", options->out,
                      "Folder for final.vtk and summary.json, written when the server ends");
  command->add_option("--checkpoints", options->checkpoints,
                      "Folder for a checkpoint every second, and those taken by command");
  command->add_option("--keep", options->keep, "How many of the every-second checkpoints stay")
      ->check(CLI::Range(2, 100000))
      ->capture_default_str();
  using Resume = endpoints::Server::Options::Resume;
  command
      ->add_option("--resume", options->resume,
                   "Go on from the newest checkpoint: crash (unless the last server ended as "
                   "asked), always or never")
      ->transform(CLI::CheckedTransformer(std::map<std::string, Resume>{
          {"crash", Resume::kAfterCrash}, {"always", Resume::kAlways}, {"never", Resume::kNever}}))
      ->default_str("crash");
  command->footer(
      "Examples:\n"
      "  sutured serve server/scenes/anastomosis/scene.toml\n"
      "  sutured serve scene.toml --session class-a --domain 4 --duration 60\n"
      "  sutured serve scene.toml --http 8080\n"
      "  sutured serve scene.toml --checkpoints /var/lib/sutured/class-a\n"
      "  sutured serve --config /etc/sutured/sutured.toml --session class-a\n"
      "Exit codes: 0 ended as asked, 1 the scene or the simulation failed, 2 options,\n"
      "  3 another server has this session, 4 network or permission.");
  command->callback(
      [options, &action] { action = [options] { return serve_and_tell(*options); }; });
}

}  // namespace sutured::commands
