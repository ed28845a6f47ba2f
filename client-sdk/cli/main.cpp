// SPDX-License-Identifier: Apache-2.0
// `suture`: a device without hardware, a live table, a look at the machine, recordings,
// pictures, commands.
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <charconv>
#include <csignal>
#include <cstdio>
#include <optional>
#include <string>

#include "commands.hpp"
#include "protocol/number_option.hpp"
#include "suture/error.hpp"

namespace suture::cli {

std::atomic<bool> interrupted{false};

bool on_terminal() noexcept { return isatty(STDOUT_FILENO) == 1; }

namespace {

constexpr const char* kExitCodes =
    "Exit codes:\n"
    "  0 done · 1 failed · 2 arguments or an input file · 3 no server · 4 another protocol\n"
    "  version · 5 tool unknown or in use · 6 not permitted · 130 interrupted";

/// Returns the size in "1600x1000"; nothing where there is none, or a side is too short or long.
std::optional<PictureSize> picture_size(const std::string& text) {
  constexpr int kSideMin_px = 16;
  constexpr int kSideMax_px = 4096;
  PictureSize size;
  const char* const end = text.data() + text.size();
  const auto [cross, no_width] = std::from_chars(text.data(), end, size.width_px);
  if (no_width != std::errc() || cross == end || *cross != 'x') return std::nullopt;
  const auto [last, no_height] = std::from_chars(cross + 1, end, size.height_px);
  if (no_height != std::errc() || last != end) return std::nullopt;
  const auto fits = [](int side_px) { return side_px >= kSideMin_px && side_px <= kSideMax_px; };
  return fits(size.width_px) && fits(size.height_px) ? std::optional(size) : std::nullopt;
}

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

void add_security_option(CLI::App& command, std::string& folder) {
  command.add_option("--security", folder,
                     "folder of keys that `suture keys add` made, or off; else SUTURE_SECURITY's");
}

void add_network_options(CLI::App& command, NetworkOptions& network) {
  command.add_option("--interface", network.interface,
                     "network interface, name or IPv4 address; else SUTURE_INTERFACE's, else this "
                     "machine alone");
  command
      .add_option("--peer", network.peers,
                  "host to look for, once for each; nobody else is heard; else SUTURE_PEERS'")
      ->allow_extra_args(false);
  command.add_flag("--unsecured-network", network.unsecured,
                   "take part in a network without keys: whoever is on it may drive");
}

void add_place_options(CLI::App& command, SessionArguments& session) {
  command.add_option("--domain", session.domain, "DDS domain, even; meshes use the next one")
      ->capture_default_str();
  command.add_option("--session", session.session, "session name (a DDS partition)");
  add_security_option(command, session.security);
  add_network_options(command, session.network);
}

void add_session_options(CLI::App& command, SessionArguments& session) {
  add_place_options(command, session);
  command.add_option("--timeout", session.timeout_s, "seconds to wait for the server")
      ->check(suture::within(0.001, 3600.0, "s"))
      ->capture_default_str();
}

int run(int argc, char** argv) {
  CLI::App app("suture: the client's tools for a sutured server", "suture");
  app.set_version_flag("--version", SUTURE_VERSION);
  app.require_subcommand(1);
  app.footer(kExitCodes);

  DeviceArguments device;
  CLI::App* device_command = app.add_subcommand(
      "device", "Play a surgeon file as a haptic device would, and feel the forces");
  add_session_options(*device_command, device.session);
  device_command
      ->add_option("--tool", device.tools,
                   "tool to hold, once for each; all tools of the surgeon file by default")
      ->allow_extra_args(false);
  device_command
      ->add_option("--surgeon", device.surgeon,
                   "motions: CSV with time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw; world frame")
      ->required();
  device_command->add_option("--render", device.render, "who computes the force: server, or device")
      ->check(CLI::IsMember({"server", "device"}))
      ->capture_default_str();
  device_command->add_option("--log", device.log,
                             "write what the hand is given, a line a tick, to this CSV file");
  device_command->add_option("--plot", device.plot, "write force over time to this SVG file");
  device_command->add_option("--summary", device.summary, "write the summary to this JSON file");
  device_command->add_option("--rate", device.rate_hz, "poses a second")
      ->check(suture::within(1.0, 4000.0, "Hz"))
      ->capture_default_str();
  device_command
      ->add_option("--max-force", device.max_force_n,
                   "N that the device can show; the scene's limit holds beside it")
      ->check(suture::within(0.001, 1000.0, "N"));
  device_command->add_option("--max-slew", device.max_slew_n_per_s, "N/s, likewise")
      ->check(suture::within(0.001, 1e6, "N/s"));
  device_command
      ->add_option("--max-stiffness", device.max_stiffness_n_per_m,
                   "N/m that the device renders stably; stiffer things are softened")
      ->check(suture::within(0.001, 1e6, "N/m"));
  device_command->add_flag("--loop", device.loop,
                           "play to the end and back again until interrupted");
  device_command->add_flag("--pause-at-end", device.pause_at_end,
                           "pause the server before the last tool leaves, so that the scene stays "
                           "as the hands held it");
  device_command->add_flag("--quiet", device.quiet, "print the summary only");
  device_command->footer(
      "Examples:\n"
      "  suture device --surgeon stitch.csv\n"
      "  suture device --tool driver --surgeon stitch.csv --log forces.csv --plot force.svg\n"
      "Several tools are as many devices on one clock: it starts when the server has answered "
      "each\n"
      "of them, until then they stand at their first poses. A tool leaves when its rows end; a\n"
      "fault of one ends all.");

  TopArguments top;
  CLI::App* top_command =
      app.add_subcommand("top", "Watch rates, latencies, forces and events of a server");
  add_session_options(*top_command, top.session);
  top_command->add_flag("--once", top.once, "print one table and end");
  top_command->footer(
      "Examples:\n"
      "  suture top\n"
      "  suture top --session room-2 --once\n"
      "On a terminal the table renews itself; elsewhere it is a line a status.");

  SessionsArguments sessions;
  CLI::App* sessions_command =
      app.add_subcommand("sessions", "List the sessions that have a server: scene, rates, clients");
  CLI::Option* domain_option =
      sessions_command
          ->add_option("--domain", sessions.domains, "DDS domain to look in, even; repeatable")
          ->allow_extra_args(false)
          ->capture_default_str();
  sessions_command->add_flag("--all-domains", sessions.all_domains, "look in every domain")
      ->excludes(domain_option);
  add_security_option(*sessions_command, sessions.security);
  add_network_options(*sessions_command, sessions.network);
  sessions_command->add_option("--timeout", sessions.timeout_s, "seconds to wait at most")
      ->check(suture::within(0.001, 3600.0, "s"))
      ->capture_default_str();
  sessions_command->add_flag("--json", sessions.json, "write the list as JSON");
  sessions_command->footer(
      "Examples:\n"
      "  suture sessions\n"
      "  suture sessions --domain 0 --domain 4 --json\n"
      "Waits until every server that is known has spoken and no other came for 0.6 s. Ends with 3\n"
      "where there is none.");

  DoctorArguments doctor;
  CLI::App* doctor_command =
      app.add_subcommand("doctor", "Grade this machine and its network for 1 kHz haptics");
  doctor_command->add_option("--domain", doctor.domain, "DDS domain for the round trip, even")
      ->capture_default_str();
  doctor_command->add_option("--seconds", doctor.seconds, "how long each loop is measured")
      ->check(suture::within(0.2, 600.0, "s"))
      ->capture_default_str();
  add_security_option(*doctor_command, doctor.security);
  doctor_command->add_flag("!--no-network", doctor.network, "leave out the DDS round trip");
  doctor_command->footer(
      "Example:\n"
      "  suture doctor\n"
      "Ends with 0 unless something makes 1 kHz impossible here, then with 1.");

  RecordArguments record;
  CLI::App* record_command =
      app.add_subcommand("record", "Record every topic of a session to an MCAP file");
  record_command->add_option("file", record.file, "file to write, name.mcap")->required();
  add_place_options(*record_command, record.session);
  record_command
      ->add_option("--topics", record.topics, "only these, as suture/tool/pose,suture/event")
      ->delimiter(',');
  record_command
      ->add_option("--duration", record.duration_s, "seconds to record, from the first sample on")
      ->check(suture::within(0.001, 1e6, "s"));
  record_command->add_flag("--force", record.force, "replace a file that exists");
  record_command->footer(
      "Examples:\n"
      "  suture record session.mcap\n"
      "  suture record forces.mcap --topics tool/force,event --duration 60\n"
      "Waits for a server and follows it through resets and restarts, until Ctrl-C. Foxglove "
      "opens\n"
      "the file. A recorder that is killed leaves one that can be read up to the last half "
      "second.");

  ReplayArguments replay;
  CLI::App* replay_command = app.add_subcommand(
      "replay", "Publish a recording again, or turn it into a surgeon file for `sutured run`");
  replay_command->add_option("file", replay.file, "recording, name.mcap")->required();
  add_place_options(*replay_command, replay.session);
  replay_command->add_option("--rate", replay.rate, "times the speed at which it was recorded")
      ->check(suture::within(0.01, 100.0, "times the speed"))
      ->capture_default_str();
  replay_command->add_flag("--loop", replay.loop, "begin again at the end, until interrupted");
  CLI::Option* surgeon_option = replay_command->add_option(
      "--surgeon", replay.surgeon, "write the hands to this CSV file instead of playing");
  replay_command
      ->add_option("--epoch", replay.epoch, "of several worlds in one recording, this one")
      ->needs(surgeon_option);
  replay_command->add_flag("--force", replay.force, "replace a surgeon file that exists")
      ->needs(surgeon_option);
  replay_command->footer(
      "Examples:\n"
      "  suture replay session.mcap --session again --rate 0.5\n"
      "  suture replay session.mcap --surgeon hands.csv\n"
      "  sutured run scene.toml --surgeon hands.csv --out out/again\n"
      "Refuses to play into a session where a server answers. A file that was cut off plays as "
      "far\n"
      "as it goes.");

  SnapshotArguments snapshot;
  CLI::App* snapshot_command = app.add_subcommand(
      "snapshot", "Write a PNG of the scene that a server with --http shows; needs no display");
  snapshot_command->add_option("file", snapshot.file, "picture to write, name.png")->required();
  snapshot_command->add_option("--url", snapshot.url, "the server's page, or a link with a token")
      ->capture_default_str();
  snapshot_command
      ->add_option("--token", snapshot.token,
                   "what the server asks of those who look; SUTURE_TOKEN keeps it off the list of "
                   "processes")
      ->envname("SUTURE_TOKEN");
  snapshot_command
      ->add_option("--view", snapshot.view, "where to look from, one of the page's views")
      ->capture_default_str();
  snapshot_command
      ->add_option_function<std::string>(
          "--size", [&](const std::string& text) { snapshot.size = *picture_size(text); },
          "pixels, as 1600x1000")
      ->check([](const std::string& text) {
        return picture_size(text) ? std::string()
                                  : "\"" + text + "\" is no size: take 16x16 to 4096x4096";
      })
      ->default_str("1600x1000");
  snapshot_command->add_option("--theme", snapshot.theme, "colours around the scene: light or dark")
      ->check(CLI::IsMember({"light", "dark"}))
      ->capture_default_str();
  snapshot_command->add_option("--browser", snapshot.browser,
                               "Chromium to draw it; by default the first one in PATH");
  snapshot_command->add_option("--timeout", snapshot.timeout_s, "seconds for all of it")
      ->check(suture::within(0.001, 3600.0, "s"))
      ->capture_default_str();
  snapshot_command->footer(
      "Examples:\n"
      "  suture snapshot scene.png\n"
      "  suture snapshot needle.png --view needle --size 1200x900 --theme dark\n"
      "  suture snapshot ward.png --url https://ward.example:8443/ --token \"$TOKEN\"\n"
      "Draws by an installed Chromium (Debian: `apt install chromium`); without one it ends with "
      "1.");

  CommandArguments command;
  CLI::App* command_command = app.add_subcommand("command", "Tell the server to do something");
  add_session_options(*command_command, command.session);
  command_command
      ->add_option("what", command.kind,
                   "pause, resume, reset, stop, release, checkpoint, rewind or restore")
      ->required()
      ->check(CLI::IsMember(
          {"pause", "resume", "reset", "stop", "release", "checkpoint", "rewind", "restore"}));
  command_command->add_option("value", command.value,
                              "checkpoint, restore: a name (\"checkpoint\" if none is given); "
                              "rewind: simulated seconds");
  command_command->add_option("--tool", command.tool, "tool whose lease to end (release)");
  command_command->footer(
      "Examples:\n"
      "  suture command pause\n"
      "  suture command stop                  # zero force for all tools until resume\n"
      "  suture command release --tool driver\n"
      "  suture command checkpoint before-knot\n"
      "  suture command rewind 10\n"
      "  suture command restore before-knot");

  KeysArguments keys;
  CLI::App* keys_command =
      app.add_subcommand("keys", "Make a site's authority, and give and withdraw identities");
  keys_command->require_subcommand(1);
  const auto add_site = [&](CLI::App& of) {
    of.add_option("site", keys.site, "the site's folder")->required();
  };
  const auto add_days = [&](CLI::App& of, const char* what) {
    of.add_option("--days", keys.days, what)->check(CLI::Range(1, 36500))->capture_default_str();
  };
  CLI::App* keys_init = keys_command->add_subcommand("init", "Make a site's authority");
  add_site(*keys_init);
  keys_init->add_option("--title", keys.title, "name of the site")->capture_default_str();
  add_days(*keys_init, "until the authority ends (3650)");
  keys_init
      ->add_option("--protection", keys.protection,
                   "of messages: sign, encrypt, or encrypt-origin (also against insiders)")
      ->check(CLI::IsMember({"sign", "encrypt", "encrypt-origin"}))
      ->capture_default_str();
  CLI::App* keys_add = keys_command->add_subcommand("add", "Give an identity");
  add_site(*keys_add);
  keys_add->add_option("name", keys.name, "of the identity, given once")->required();
  keys_add
      ->add_option("--role", keys.roles,
                   "server, device, viewer, recorder or operator (commands); repeatable")
      ->required()
      ->allow_extra_args(false);
  keys_add->add_option("--tool", keys.tools, "that a device may drive; repeatable")
      ->allow_extra_args(false);
  keys_add->add_option("--domain", keys.domain, "this domain (and the next one) only");
  keys_add->add_option("--session", keys.session, "this session only");
  add_days(*keys_add, "until it ends (365)");
  CLI::App* keys_renew = keys_command->add_subcommand("renew", "Give an identity new keys");
  add_site(*keys_renew);
  keys_renew->add_option("name", keys.name, "of the identity")->required();
  add_days(*keys_renew, "until it ends (365)");
  CLI::App* keys_revoke = keys_command->add_subcommand("revoke", "Withdraw an identity");
  add_site(*keys_revoke);
  keys_revoke->add_option("name", keys.name, "of the identity")->required();
  CLI::App* keys_list = keys_command->add_subcommand("list", "Say who may do what until when");
  add_site(*keys_list);
  keys_command->footer(
      "Examples:\n"
      "  suture keys init site\n"
      "  suture keys add site theatre-1 --role server\n"
      "  suture keys add site left-hand --role device --tool driver\n"
      "  suture keys revoke site left-hand");

  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? kDone : kUsage;
  }

  struct sigaction action {};
  action.sa_handler = on_signal;
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);

  try {
    if (*device_command) return run_device(device);
    if (*top_command) return run_top(top);
    if (*sessions_command) return run_sessions(sessions);
    if (*doctor_command) return run_doctor(doctor);
    if (*record_command) return run_record(record);
    if (*replay_command) return run_replay(replay);
    if (*snapshot_command) return run_snapshot(snapshot);
    if (*keys_init) return run_keys_init(keys);
    if (*keys_add) return run_keys_add(keys);
    if (*keys_renew) return run_keys_renew(keys);
    if (*keys_revoke) return run_keys_revoke(keys);
    if (*keys_list) return run_keys_list(keys);
    return run_command(command);
  } catch (const Error& error) {
    std::fflush(stdout);
    std::fprintf(stderr, "suture: %s\n", error.cause().c_str());
    if (!error.mend().empty()) std::fprintf(stderr, "  %s\n", error.mend().c_str());
    return exit_code_of(error.code());
  }
}

}  // namespace
}  // namespace suture::cli

int main(int argc, char** argv) { return suture::cli::run(argc, argv); }
