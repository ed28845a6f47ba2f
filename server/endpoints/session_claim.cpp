// SPDX-License-Identifier: GPL-3.0-or-later
#include "endpoints/session_claim.hpp"

#include <unistd.h>

#include <algorithm>
#include <array>

#include "protocol/rendezvous.hpp"

namespace sutured::endpoints {
namespace {

using Clock = std::chrono::steady_clock;

// So often a server that asks says so: a reader keeps only the last word of all servers.
constexpr std::chrono::milliseconds kRepeat(100);

constexpr const char* kMend = "end that one, or start this one with another --session or --domain";

std::string host_name() {
  std::array<char, 65> name{};
  return gethostname(name.data(), name.size() - 1) == 0 ? name.data() : "";
}

bool counts(const suture::v1::ServerStatus& status, const suture::SampleInfo& info,
            const suture::Guid& self) {
  return info.valid && info.writers_alive && status.state != suture_v1_SERVER_LEAVING &&
         suture::guid_of(status.server) != self;
}

}  // namespace

void identify(suture::v1::ServerStatus& status, const suture::Guid& server,
              std::string_view session, std::string_view scene) {
  status.stamp_ns = suture::wall_clock_ns();
  status.protocol_version = suture_v1_PROTOCOL_VERSION;
  suture::set_text(status.server_version, SUTURED_VERSION);
  suture::set_guid(status.server, server);
  suture::set_text(status.session, session);
  suture::set_text(status.host, host_name());
  status.pid = getpid();
  suture::set_text(status.scene, scene);
}

SessionClaim::SessionClaim(const suture::Participant& participant, std::string_view scene,
                           std::chrono::nanoseconds patience)
    : options_(participant.options()),
      status_(participant),
      others_(participant),
      guid_(status_.guid()),
      started_ns_(suture::wall_clock_ns()) {
  suture::WaitSet waitset;
  waitset.attach(others_);
  const Clock::time_point end = Clock::now() + patience;
  Clock::time_point due = Clock::now();
  std::string other;
  // A reader keeps one status, and hears our own: what has come is taken before the next is said.
  const auto hear = [&] {
    others_.take_each([&](const suture::v1::ServerStatus& status, const suture::SampleInfo& info) {
      if (!counts(status, info, guid_)) return;
      const bool asks = status.epoch == 0 && status.state == suture_v1_SERVER_STARTING;
      if (!asks || suture::guid_of(status.server) < guid_) other = told(status);
    });
    return !other.empty();
  };
  while (!hear() && Clock::now() < end) {
    if (Clock::now() >= due) {
      say(suture_v1_SERVER_STARTING, scene);
      due += kRepeat;
    }
    waitset.wait(std::max<std::chrono::nanoseconds>(std::min(due, end) - Clock::now(), {}));
  }
  if (!other.empty()) throw suture::Error(suture::ErrorCode::kServerRunning, other, kMend);
  say(suture_v1_SERVER_RUNNING, scene);
}

std::string SessionClaim::rival() {
  std::string other;
  others_.take_each([&](const suture::v1::ServerStatus& status, const suture::SampleInfo& info) {
    if (counts(status, info, guid_) && status.epoch != 0 && suture::guid_of(status.server) < guid_)
      other = told(status) + "; " + kMend;
  });
  return other;
}

void SessionClaim::say(suture_v1_ServerState state, std::string_view scene) {
  suture::v1::ServerStatus status{};
  identify(status, guid_, options_.session, scene);
  status.started_ns = started_ns_;
  status.state = state;
  status_.write(status);
}

std::string SessionClaim::told(const suture::v1::ServerStatus& other) const {
  return suture::session_text(options_.session) + " of domain " + std::to_string(options_.domain) +
         " has a server: scene \"" + std::string(suture::text_of(other.scene)) + "\", process " +
         std::to_string(other.pid) + " on " + std::string(suture::text_of(other.host));
}

}  // namespace sutured::endpoints
