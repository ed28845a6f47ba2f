// SPDX-License-Identifier: GPL-3.0-or-later
#include "attacks/arena.hpp"

#include <dlfcn.h>
#include <sys/socket.h>

#include <chrono>
#include <ctime>
#include <fstream>
#include <mutex>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "haptics/supervisor.hpp"
#include "keys/authority.hpp"
#include "keys/documents.hpp"
#include "keys/site.hpp"
#include "protocol/security.hpp"
#include "support/test_session.hpp"

// ------------------------------------------------------------------ the eavesdropper

namespace {
struct Recorded {
  std::mutex mutex;
  std::atomic<bool> on{false};
  std::vector<sutured::attacks::Packet> packets;
};
Recorded& recorded() {
  static Recorded instance;
  return instance;
}
}  // namespace

/// Cyclone DDS sends by this function; here it is found first, and keeps what leaves.
extern "C" __attribute__((visibility("default"))) ssize_t sendmsg(int socket, const msghdr* message,
                                                                  int flags) {
  using Function = ssize_t (*)(int, const msghdr*, int);
  static const auto real = reinterpret_cast<Function>(dlsym(RTLD_NEXT, "sendmsg"));
  Recorded& kept = recorded();
  if (kept.on && message->msg_name != nullptr &&
      static_cast<const sockaddr*>(message->msg_name)->sa_family == AF_INET) {
    sutured::attacks::Packet packet;
    std::memcpy(&packet.to, message->msg_name, sizeof packet.to);
    for (std::size_t i = 0; i < message->msg_iovlen; ++i) {
      const auto* from = static_cast<const char*>(message->msg_iov[i].iov_base);
      packet.bytes.insert(packet.bytes.end(), from, from + message->msg_iov[i].iov_len);
    }
    const std::lock_guard lock(kept.mutex);
    kept.packets.push_back(std::move(packet));
  }
  return real(socket, message, flags);
}

namespace sutured::attacks {
namespace {

namespace fs = std::filesystem;
using suture::keys::Rights;
using suture::keys::Role;
using suture::keys::Site;

constexpr std::int64_t kDay_s = 86400;
constexpr int kBack_s = 600;
const std::string kScene = SUTURED_SOURCE_DIR "/server/scenes/anastomosis/scene.toml";

std::string property_of(const suture::Identity& identity, const std::string& name) {
  for (const auto& [key, value] : identity.properties)
    if (key == name) return value;
  throw std::logic_error("no property " + name);
}

std::string as_text(const fs::path& path) { return testing::read_file(path.string()); }

}  // namespace

const std::vector<Attack>& attacks() {
  static const std::vector<Attack> all{
      {"OtherAuthority", "keys of another site's authority, the same names in them",
       "the server: the certificate is not of its authority", false},
      {"Expired", "an expired certificate, the attacker's clock set back",
       "the server: the certificate's dates", false},
      {"Revoked", "a revoked identity, with the list of the revoked from before",
       "the server: its own list of the revoked", false},
      {"NoPermissionForTheTopic", "a viewer that writes poses", "its own software: permissions",
       false},
      {"ChecksDisabled", "the same viewer, its own checks disabled",
       "the server: the viewer's permissions", true},
      {"ReadsForces", "an operator that reads forces and models, its own checks disabled",
       "the server: the operator's permissions", true},
      {"NoPermissionForTheTool", "a device that claims another tool, its own checks disabled",
       "the server: the partition of a tool is not in the device's permissions", true, true},
      {"PosesForAnotherTool", "a device that claims its own tool and sends poses for another",
       "the server: the writer is not in the tool's partition", true, true},
      {"TamperedPermissions", "permissions with another tool written in, the signature kept",
       "the server: the authority's signature", false},
      {"LaxerGovernance", "a governance signed by the authority that protects nothing",
       "the server: its own governance asks for more", false},
      {"Unsecured", "a peer without security", "the server: no unauthenticated peer", false},
      {"Replayed", "the honest device's packets, sent again at full rate",
       "the server: sequence numbers under the message's code", false},
      {"Forged",
       "packets in the honest device's name at full rate: changed, unprotected data, heartbeats",
       "the server: no message without the sender's code", false},
  };
  return all;
}

Arena::Arena() : site_(folder_.path("site")), session_(testing::own_session()) {
  make_keys();
  session_.security = keys("honest");
  session_.tool = "driver";
  server_.emplace(std::vector<std::string>{SUTURED_PROGRAM, "serve", kScene, "--domain",
                                           std::to_string(session_.domain), "--session",
                                           session_.session, "--security", keys("server")});
  honest_.emplace(session_, "driver");
  suture::SessionOptions watched;
  watched.domain = session_.domain;
  watched.session = session_.session;
  watched.security = session_.security;
  watched.timeout = std::chrono::seconds(60);
  watch_.emplace(watched);
  const std::int64_t end_ns = suture::monotonic_ns() + 60'000'000'000;
  while (honest_->answered() == 0) {
    if (suture::monotonic_ns() > end_ns)
      throw std::runtime_error("the honest device is not served");
    static_cast<void>(measured(nullptr, 0.1));
  }
  static_cast<void>(measured(nullptr, 0.5));
}

Arena::~Arena() = default;

std::string Arena::keys(const std::string& name) const { return site_ + "/identities/" + name; }

void Arena::make_keys() {
  using suture::keys::Protection;
  Site::create(site_, "ward 7", 3650, Protection::kEncryptWithOrigin);
  {
    Site site(site_);
    const auto device = [](std::vector<std::string> tools) {
      return Rights{{Role::kDevice, Role::kViewer}, std::move(tools), -1, ""};
    };
    site.add("stolen", device({"assistant"}), kDay_s);
    fs::copy(keys("stolen"), folder_.path("stolen"), fs::copy_options::recursive);
    site.revoke("stolen");
    site.add("server", {{Role::kServer}, {}, -1, ""}, kDay_s);
    site.add("honest", device({"driver"}), kDay_s);
    site.add("other", device({"probe"}), kDay_s);
    site.add("viewer", {{Role::kViewer}, {}, -1, ""}, kDay_s);
    site.add("operator", {{Role::kOperator}, {}, -1, ""}, kDay_s);
    site.add("lax", device({"assistant"}), kDay_s);
    site.add("permitted", device({"assistant"}), kDay_s);
    site.add("expired", device({"assistant"}), 1);
  }
  const suture::keys::KeyPair authority{as_text(site_ + "/authority.key.pem"),
                                        as_text(site_ + "/ca.pem")};
  std::string governance = suture::keys::governance_xml(Protection::kSign);
  for (const std::string tag : {"rtps", "discovery", "liveliness"}) {
    const std::size_t at = governance.find("<" + tag + "_protection_kind>") + tag.size() + 18;
    governance.replace(at, governance.find('<', at) - at, "NONE");
  }
  std::ofstream(keys("lax") + "/governance.p7s") << suture::keys::sign(authority, governance);
  std::string permissions = as_text(keys("other") + "/permissions.p7s");
  const std::size_t at = permissions.find("@probe");
  permissions.replace(at, 6, "@assistant");
  folder_.write("tampered.p7s", permissions);

  const std::string elsewhere = folder_.path("elsewhere");
  Site::create(elsewhere, "ward 7", 3650, Protection::kEncryptWithOrigin);
  Site(elsewhere).add("stranger", {{Role::kDevice, Role::kViewer}, {"assistant"}, -1, ""}, kDay_s);
}

std::vector<std::string> Arena::command(const Attack& attack, double seconds) {
  const suture::Identity honest = suture::read_identity(keys("honest"));
  std::string claim = "assistant", folder = keys("other");
  bool secured = true, lax = false;
  std::vector<std::string> words;
  const auto is = [&](const char* name) { return attack.name == name; };
  if (is("OtherAuthority")) folder = folder_.path("elsewhere") + "/identities/stranger";
  if (is("Revoked")) folder = folder_.path("stolen");
  if (is("NoPermissionForTheTopic") || is("ChecksDisabled")) folder = keys("viewer"), claim = "";
  if (is("ReadsForces")) folder = keys("operator"), claim = "";
  if (is("Permitted")) folder = keys("permitted");
  if (is("PosesForAnotherTool")) claim = "probe";
  if (is("LaxerGovernance")) folder = keys("lax");
  if (is("ChecksDisabled") || is("ReadsForces") || is("NoPermissionForTheTool")) lax = true;
  if (is("Unsecured")) secured = false, claim = "";
  if (is("Expired")) {
    folder = keys("expired");
    words = {"env", "LD_PRELOAD=" SET_BACK_CLOCK, "ATTACKER_CLOCK=" + std::to_string(kBack_s)};
  }
  if (is("TamperedPermissions")) {
    lax = true;
    words = {"env", "ATTACKER_PERMISSIONS=" + folder_.path("tampered.p7s")};
  }
  if (lax) {
    if (words.empty()) words = {"env"};
    words.push_back("ATTACKER_PLUGIN=" + property_of(honest, "dds.sec.access.library.path"));
  }
  for (const std::string& word :
       {std::string(ATTACKER_PROGRAM), std::string("--domain"), std::to_string(session_.domain),
        std::string("--session"), session_.session, std::string("--seconds"),
        std::to_string(seconds), std::string("--tool"), std::string("assistant")})
    words.push_back(word);
  if (is("Replayed") || is("Forged")) {
    words.push_back("--packets");
    words.push_back(folder_.path("packets"));
    if (is("Forged")) words.push_back("--forge");
    return words;
  }
  if (!claim.empty()) {
    words.push_back("--partition");
    words.push_back(suture::tool_partition(claim));
  }
  if (secured) {
    for (auto [name, value] : honest.properties) {
      if (value.starts_with("file:")) value = "file:" + folder + value.substr(value.rfind('/'));
      if (lax && name == "dds.sec.access.library.path") value = LAX_ACCESS;
      words.push_back("--property");
      words.push_back(name + "=" + value);
    }
  }
  return words;
}

Felt Arena::measured(const std::atomic<bool>* until, double seconds) {
  constexpr std::int64_t kMs = 1'000'000;
  suture::SurgeonPose pose;
  pose.position_m = {0.0, 0.0, 0.05};
  pose.orientation_xyzw = {0.0, 0.0, 0.0, 1.0};
  const std::uint64_t first = honest_->sent() + 1;
  const std::int64_t begun_ns = suture::monotonic_ns();
  std::int64_t due_ns = begun_ns;
  while (until != nullptr
             ? !until->load()
             : static_cast<double>(suture::monotonic_ns() - begun_ns) < 1e9 * seconds) {
    honest_->send(pose);
    due_ns = haptics::next_tick(due_ns, suture::monotonic_ns(), kMs).at_ns;
    haptics::sleep_until(due_ns);
  }
  Felt felt;
  felt.sent = honest_->sent() + 1 - first;
  std::vector<double> trips = honest_->round_trips_us(first, honest_->sent());
  felt.lost = felt.sent - trips.size();
  std::sort(trips.begin(), trips.end());
  if (!trips.empty()) {
    felt.p50_us = trips[trips.size() / 2];
    felt.p99_us = trips[trips.size() * 99 / 100];
  }
  return felt;
}

Felt Arena::undisturbed(double seconds) { return measured(nullptr, seconds); }

std::optional<double> Arena::seconds_until_served(double seconds_max) {
  const std::int64_t begun_ns = suture::monotonic_ns();
  for (;;) {
    const Felt felt = measured(nullptr, 0.1);
    const double passed_s = 1e-9 * static_cast<double>(suture::monotonic_ns() - begun_ns);
    if (felt.lost < felt.sent) return passed_s;
    if (passed_s > seconds_max) return std::nullopt;
  }
}

Arena::Result Arena::run(const Attack& attack, double seconds) {
  {
    recorded().on = true;
    static_cast<void>(measured(nullptr, 0.3));
    recorded().on = false;
    const std::lock_guard lock(recorded().mutex);
    std::ofstream file(folder_.path("packets"), std::ios::binary);
    write_packets(file, recorded().packets);
    recorded().packets.clear();
  }
  Result result;
  if (attack.name == "Expired")
    while (std::time(nullptr) <=
           suture::keys::expiry_of(as_text(keys("expired") + "/certificate.pem")))
      static_cast<void>(measured(nullptr, 0.1));
  testing::Process attacker(command(attack, seconds));
  std::atomic<bool> over{false};
  int code = 0;
  std::thread waits([&] {
    code = attacker.wait();
    over = true;
  });
  result.felt = measured(&over, 0.0);
  waits.join();
  const std::string& said = attacker.output();
  const std::size_t line = said.rfind("\n{");
  if (line == std::string::npos)
    throw std::runtime_error("the attacker ended with " + std::to_string(code) + ": " + said);
  const nlohmann::json json = nlohmann::json::parse(said.substr(line + 1));
  result.reached.error = json.at("error").get<std::string>();
  result.reached.sent = json.at("sent").get<std::uint64_t>();
  result.reached.matched = json.at("matched").get<int>();
  result.reached.answered = json.at("answered").get<int>();
  result.reached.read = json.at("read").get<int>();
  for (const suture::ToolStatus& tool : watch_->status().tools) {
    if (tool.tool != "assistant") continue;
    result.poses = tool.poses;
    result.leased = tool.leased;
  }
  return result;
}

}  // namespace sutured::attacks
