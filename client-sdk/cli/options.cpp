// SPDX-License-Identifier: Apache-2.0
#include "options.hpp"

#include <CLI/CLI.hpp>
#include <charconv>
#include <memory>
#include <optional>
#include <string>

#include "commands.hpp"
#include "protocol/number_option.hpp"

namespace suture::cli {
namespace {

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

void add_device(CLI::App& app, Action& action) {
  auto arguments = std::make_shared<DeviceArguments>();
  CLI::App* command = app.add_subcommand(
      "device", "Play a surgeon file as a haptic device would, and feel the forces");
  add_session_options(*command, arguments->session);
  command
      ->add_option("--tool", arguments->tools,
                   "tool to hold, once for each; all tools of the surgeon file by default")
      ->allow_extra_args(false);
  command
      ->add_option("--surgeon", arguments->surgeon,
                   "motions: CSV with time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw; world frame")
      ->required();
  command->add_option("--render", arguments->render, "who computes the force: server, or device")
      ->check(CLI::IsMember({"server", "device"}))
      ->capture_default_str();
  command->add_option("--log", arguments->log,
                      "write what the hand is given, a line a tick, to this CSV file");
  command->add_option("--plot", arguments->plot, "write force over time to this SVG file");
  command->add_option("--summary", arguments->summary, "write the summary to this JSON file");
  command->add_option("--rate", arguments->rate_hz, "poses a second")
      ->check(suture::within(1.0, 4000.0, "Hz"))
      ->capture_default_str();
  command
      ->add_option("--max-force", arguments->max_force_n,
                   "N that the device can show; the scene's limit holds beside it")
      ->check(suture::within(0.001, 1000.0, "N"));
  command->add_option("--max-slew", arguments->max_slew_n_per_s, "N/s, likewise")
      ->check(suture::within(0.001, 1e6, "N/s"));
  command
      ->add_option("--max-stiffness", arguments->max_stiffness_n_per_m,
                   "N/m that the device renders stably; stiffer things are softened")
      ->check(suture::within(0.001, 1e6, "N/m"));
  command
      ->add_option("--max-damping", arguments->max_damping_n_s_per_m,
                   "N s/m that the device renders stably; friction that follows the speed more "
                   "strongly is held from step to step")
      ->check(suture::within(1e-6, 1e6, "N s/m"));
  command->add_flag("--loop", arguments->loop, "play to the end and back again until interrupted");
  command->add_flag("--pause-at-end", arguments->pause_at_end,
                    "pause the server before the last tool leaves, so that the scene stays "
                    "as the hands held it");
  command->add_flag("--quiet", arguments->quiet, "print the summary only");
  command->footer(
      "Examples:\n"
      "  suture device --surgeon stitch.csv\n"
      "  suture device --tool driver --surgeon stitch.csv --log forces.csv --plot force.svg\n"
      "Several tools are as many devices on one clock: it starts when the server has answered "
      "each\n"
      "of them, until then they stand at their first poses. A tool leaves when its rows end; a\n"
      "fault of one ends all.");
  command->callback(
      [arguments, &action] { action = [arguments] { return run_device(*arguments); }; });
}

void add_top(CLI::App& app, Action& action) {
  auto arguments = std::make_shared<TopArguments>();
  CLI::App* command =
      app.add_subcommand("top", "Watch rates, latencies, forces and events of a server");
  add_session_options(*command, arguments->session);
  command->add_flag("--once", arguments->once, "print one table and end");
  command->footer(
      "Examples:\n"
      "  suture top\n"
      "  suture top --session room-2 --once\n"
      "On a terminal the table renews itself; elsewhere it is a line a status.");
  command->callback([arguments, &action] { action = [arguments] { return run_top(*arguments); }; });
}

void add_sessions(CLI::App& app, Action& action) {
  auto arguments = std::make_shared<SessionsArguments>();
  CLI::App* command =
      app.add_subcommand("sessions", "List the sessions that have a server: scene, rates, clients");
  CLI::Option* domain_option =
      command->add_option("--domain", arguments->domains, "DDS domain to look in, even; repeatable")
          ->allow_extra_args(false)
          ->capture_default_str();
  command->add_flag("--all-domains", arguments->all_domains, "look in every domain")
      ->excludes(domain_option);
  add_security_option(*command, arguments->security);
  add_network_options(*command, arguments->network);
  command->add_option("--timeout", arguments->timeout_s, "seconds to wait at most")
      ->check(suture::within(0.001, 3600.0, "s"))
      ->capture_default_str();
  command->add_flag("--json", arguments->json, "write the list as JSON");
  command->footer(
      "Examples:\n"
      "  suture sessions\n"
      "  suture sessions --domain 0 --domain 4 --json\n"
      "Waits until every server that is known has spoken and no other came for 0.6 s. Ends with 3\n"
      "where there is none.");
  command->callback(
      [arguments, &action] { action = [arguments] { return run_sessions(*arguments); }; });
}

void add_doctor(CLI::App& app, Action& action) {
  auto arguments = std::make_shared<DoctorArguments>();
  CLI::App* command =
      app.add_subcommand("doctor", "Grade this machine and its network for 1 kHz haptics");
  command->add_option("--domain", arguments->domain, "DDS domain for the round trip, even")
      ->capture_default_str();
  command->add_option("--seconds", arguments->seconds, "how long each loop is measured")
      ->check(suture::within(0.2, 600.0, "s"))
      ->capture_default_str();
  add_security_option(*command, arguments->security);
  command->add_flag("!--no-network", arguments->network, "leave out the DDS round trip");
  command->footer(
      "Example:\n"
      "  suture doctor\n"
      "Ends with 0 unless something makes 1 kHz impossible here, then with 1.");
  command->callback(
      [arguments, &action] { action = [arguments] { return run_doctor(*arguments); }; });
}

void add_record(CLI::App& app, Action& action) {
  auto arguments = std::make_shared<RecordArguments>();
  CLI::App* command =
      app.add_subcommand("record", "Record every topic of a session to an MCAP file");
  command->add_option("file", arguments->file, "file to write, name.mcap")->required();
  add_place_options(*command, arguments->session);
  command->add_option("--topics", arguments->topics, "only these, as suture/tool/pose,suture/event")
      ->delimiter(',');
  command
      ->add_option("--duration", arguments->duration_s,
                   "seconds to record, from the first sample on")
      ->check(suture::within(0.001, 1e6, "s"));
  command->add_flag("--force", arguments->force, "replace a file that exists");
  command->footer(
      "Examples:\n"
      "  suture record session.mcap\n"
      "  suture record forces.mcap --topics tool/force,event --duration 60\n"
      "Waits for a server and follows it through resets and restarts, until Ctrl-C. Foxglove "
      "opens\n"
      "the file. A recorder that is killed leaves one that can be read up to the last half "
      "second.");
  command->callback(
      [arguments, &action] { action = [arguments] { return run_record(*arguments); }; });
}

void add_replay(CLI::App& app, Action& action) {
  auto arguments = std::make_shared<ReplayArguments>();
  CLI::App* command = app.add_subcommand(
      "replay", "Publish a recording again, or turn it into a surgeon file for `sutured run`");
  command->add_option("file", arguments->file, "recording, name.mcap")->required();
  add_place_options(*command, arguments->session);
  command->add_option("--rate", arguments->rate, "times the speed at which it was recorded")
      ->check(suture::within(0.01, 100.0, "times the speed"))
      ->capture_default_str();
  command->add_flag("--loop", arguments->loop, "begin again at the end, until interrupted");
  CLI::Option* surgeon_option = command->add_option(
      "--surgeon", arguments->surgeon, "write the hands to this CSV file instead of playing");
  command->add_option("--epoch", arguments->epoch, "of several worlds in one recording, this one")
      ->needs(surgeon_option);
  command->add_flag("--force", arguments->force, "replace a surgeon file that exists")
      ->needs(surgeon_option);
  command->footer(
      "Examples:\n"
      "  suture replay session.mcap --session again --rate 0.5\n"
      "  suture replay session.mcap --surgeon hands.csv\n"
      "  sutured run scene.toml --surgeon hands.csv --out out/again\n"
      "Refuses to play into a session where a server answers. A file that was cut off plays as "
      "far\n"
      "as it goes.");
  command->callback(
      [arguments, &action] { action = [arguments] { return run_replay(*arguments); }; });
}

void add_snapshot(CLI::App& app, Action& action) {
  auto arguments = std::make_shared<SnapshotArguments>();
  CLI::App* command = app.add_subcommand(
      "snapshot", "Write a PNG of the scene that a server with --http shows; needs no display");
  command->add_option("file", arguments->file, "picture to write, name.png")->required();
  command->add_option("--url", arguments->url, "the server's page, or a link with a token")
      ->capture_default_str();
  command
      ->add_option("--token", arguments->token,
                   "what the server asks of those who look; SUTURE_TOKEN keeps it off the list of "
                   "processes")
      ->envname("SUTURE_TOKEN");
  command->add_option("--view", arguments->view, "where to look from, one of the page's views")
      ->capture_default_str();
  command
      ->add_option_function<std::string>(
          "--size", [arguments](const std::string& text) { arguments->size = *picture_size(text); },
          "pixels, as 1600x1000")
      ->check([](const std::string& text) {
        return picture_size(text) ? std::string()
                                  : "\"" + text + "\" is no size: take 16x16 to 4096x4096";
      })
      ->default_str("1600x1000");
  command->add_option("--theme", arguments->theme, "colours around the scene: light or dark")
      ->check(CLI::IsMember({"light", "dark"}))
      ->capture_default_str();
  command->add_option("--browser", arguments->browser,
                      "Chromium to draw it; by default the first one in PATH");
  command->add_option("--timeout", arguments->timeout_s, "seconds for all of it")
      ->check(suture::within(0.001, 3600.0, "s"))
      ->capture_default_str();
  command->footer(
      "Examples:\n"
      "  suture snapshot scene.png\n"
      "  suture snapshot needle.png --view needle --size 1200x900 --theme dark\n"
      "  suture snapshot ward.png --url https://ward.example:8443/ --token \"$TOKEN\"\n"
      "Draws by an installed Chromium (Debian: `apt install chromium`); without one it ends with "
      "1.");
  command->callback(
      [arguments, &action] { action = [arguments] { return run_snapshot(*arguments); }; });
}

void add_command(CLI::App& app, Action& action) {
  auto arguments = std::make_shared<CommandArguments>();
  CLI::App* command = app.add_subcommand("command", "Tell the server to do something");
  add_session_options(*command, arguments->session);
  command
      ->add_option("what", arguments->kind,
                   "pause, resume, reset, stop, release, checkpoint, rewind or restore")
      ->required()
      ->check(CLI::IsMember(
          {"pause", "resume", "reset", "stop", "release", "checkpoint", "rewind", "restore"}));
  command->add_option("value", arguments->value,
                      "checkpoint, restore: a name (\"checkpoint\" if none is given); "
                      "rewind: simulated seconds");
  command->add_option("--tool", arguments->tool, "tool whose lease to end (release)");
  command->footer(
      "Examples:\n"
      "  suture command pause\n"
      "  suture command stop                  # zero force for all tools until resume\n"
      "  suture command release --tool driver\n"
      "  suture command checkpoint before-knot\n"
      "  suture command rewind 10\n"
      "  suture command restore before-knot");
  command->callback(
      [arguments, &action] { action = [arguments] { return run_command(*arguments); }; });
}

void add_keys(CLI::App& app, Action& action) {
  auto arguments = std::make_shared<KeysArguments>();
  CLI::App* command =
      app.add_subcommand("keys", "Make a site's authority, and give and withdraw identities");
  command->require_subcommand(1);
  const auto add_site = [&](CLI::App& of) {
    of.add_option("site", arguments->site, "the site's folder")->required();
  };
  const auto add_days = [&](CLI::App& of, const char* what) {
    of.add_option("--days", arguments->days, what)
        ->check(CLI::Range(1, 36500))
        ->capture_default_str();
  };
  CLI::App* keys_init = command->add_subcommand("init", "Make a site's authority");
  add_site(*keys_init);
  keys_init->add_option("--title", arguments->title, "name of the site")->capture_default_str();
  add_days(*keys_init, "until the authority ends (3650)");
  keys_init
      ->add_option("--protection", arguments->protection,
                   "of messages: sign, encrypt, or encrypt-origin (also against insiders)")
      ->check(CLI::IsMember({"sign", "encrypt", "encrypt-origin"}))
      ->capture_default_str();
  CLI::App* keys_add = command->add_subcommand("add", "Give an identity");
  add_site(*keys_add);
  keys_add->add_option("name", arguments->name, "of the identity, given once")->required();
  keys_add
      ->add_option("--role", arguments->roles,
                   "server, device, viewer, recorder or operator (commands); repeatable")
      ->required()
      ->allow_extra_args(false);
  keys_add->add_option("--tool", arguments->tools, "that a device may drive; repeatable")
      ->allow_extra_args(false);
  keys_add->add_option("--domain", arguments->domain, "this domain (and the next one) only");
  keys_add->add_option("--session", arguments->session, "this session only");
  add_days(*keys_add, "until it ends (365)");
  CLI::App* keys_renew = command->add_subcommand("renew", "Give an identity new keys");
  add_site(*keys_renew);
  keys_renew->add_option("name", arguments->name, "of the identity")->required();
  add_days(*keys_renew, "until it ends (365)");
  keys_renew->add_flag("--revoke-old", arguments->revoke_old,
                       "withdraw the keys that it had: somebody may have read them");
  CLI::App* keys_revoke = command->add_subcommand("revoke", "Withdraw an identity");
  add_site(*keys_revoke);
  keys_revoke->add_option("name", arguments->name, "of the identity")->required();
  CLI::App* keys_list = command->add_subcommand("list", "Say who may do what until when");
  add_site(*keys_list);
  command->footer(
      "Examples:\n"
      "  suture keys init site\n"
      "  suture keys add site theatre-1 --role server\n"
      "  suture keys add site left-hand --role device --tool driver\n"
      "  suture keys renew site left-hand --revoke-old\n"
      "  suture keys revoke site left-hand");
  const auto does = [&](CLI::App* of, int (*run)(const KeysArguments&)) {
    of->callback(
        [arguments, run, &action] { action = [arguments, run] { return run(*arguments); }; });
  };
  does(keys_init, run_keys_init);
  does(keys_add, run_keys_add);
  does(keys_renew, run_keys_renew);
  does(keys_revoke, run_keys_revoke);
  does(keys_list, run_keys_list);
}

}  // namespace

void add_commands(CLI::App& app, Action& action) {
  app.require_subcommand(1);
  add_device(app, action);
  add_top(app, action);
  add_sessions(app, action);
  add_doctor(app, action);
  add_record(app, action);
  add_replay(app, action);
  add_snapshot(app, action);
  add_command(app, action);
  add_keys(app, action);
}

}  // namespace suture::cli
