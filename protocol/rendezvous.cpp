// SPDX-License-Identifier: Apache-2.0
#include "protocol/rendezvous.hpp"

#include <algorithm>
#include <set>

#include "protocol/endpoint.hpp"

namespace suture {
namespace {

using Clock = std::chrono::steady_clock;

/// What the network shows of servers that are not ours to talk to.
struct OtherServers {
  std::set<std::string> sessions;  // where servers of our version answer
  std::set<std::string> types;     // status types of other versions, in our session
};

OtherServers look_around(const Participant& participant) {
  OtherServers others;
  const dds_entity_t reader =
      dds_create_reader(participant.handle(), DDS_BUILTIN_TOPIC_DCPSPUBLICATION, nullptr, nullptr);
  if (reader < 0) return others;
  const std::string own_type = topic<v1::ServerStatus>().descriptor->m_typename;
  constexpr std::string_view kStatusType = "::ServerStatus";
  for (;;) {
    void* sample = nullptr;
    dds_sample_info_t info;
    if (dds_take(reader, &sample, &info, 1, 1) <= 0) break;
    const auto* endpoint = static_cast<const dds_builtintopic_endpoint_t*>(sample);
    const std::string type =
        info.valid_data && endpoint->type_name != nullptr ? endpoint->type_name : "";
    if (info.instance_state == DDS_ALIVE_INSTANCE_STATE && type.starts_with("suture::") &&
        type.ends_with(kStatusType)) {
      std::uint32_t count = 0;
      char** partitions = nullptr;
      std::set<std::string> sessions;
      if (dds_qget_partition(endpoint->qos, &count, &partitions)) {
        for (std::uint32_t i = 0; i < count; ++i) {
          sessions.insert(partitions[i]);
          dds_free(partitions[i]);
        }
        dds_free(partitions);
      }
      if (sessions.empty()) sessions.insert("");
      if (type == own_type) {
        others.sessions.insert(sessions.begin(), sessions.end());
      } else if (sessions.contains(participant.options().session)) {
        others.types.insert(type);
      }
    }
    dds_return_loan(reader, &sample, 1);
  }
  dds_delete(reader);
  others.sessions.erase(participant.options().session);
  return others;
}

std::optional<ServerInfo> listen(const Participant& participant, std::chrono::nanoseconds timeout,
                                 const std::function<bool(const ServerInfo&)>& enough) {
  Reader<v1::ServerStatus> reader(participant);
  WaitSet waitset;
  waitset.attach(reader);
  const Clock::time_point end = Clock::now() + timeout;
  std::optional<ServerInfo> found;
  do {
    waitset.wait(std::max<std::chrono::nanoseconds>(end - Clock::now(), {}));
    reader.take_each([&](const v1::ServerStatus& status, const SampleInfo& info) {
      const bool serves = status.epoch != 0 && status.state != suture_v1_SERVER_LEAVING;
      if (info.valid && info.writers_alive && serves) {
        found = server_info(status);
      }
    });
  } while ((!found || (enough && !enough(*found))) && Clock::now() < end);
  return found;
}

/// Who is secured hears nobody who is not: looks for a server without keys in the session, to say
/// so. It only listens.
std::optional<ServerInfo> find_unsecured_server(const Participant& participant) {
  constexpr std::chrono::milliseconds kListen(1000);
  ParticipantOptions options = participant.options();
  options.separate = true;
  options.security = "off";
  options.tool.clear();
  options.network.unsecured = true;
  try {
    return listen(Participant(options, Channel::kControl), kListen, {});
  } catch (const Error&) {
    return std::nullopt;  // the error to come says more
  }
}

}  // namespace

const char* name_of(v1::ServerState state) noexcept {
  switch (state) {
    case suture_v1_SERVER_STARTING:
      return "starting";
    case suture_v1_SERVER_RUNNING:
      return "running";
    case suture_v1_SERVER_PAUSED:
      return "paused";
    case suture_v1_SERVER_STOPPED:
      return "stopped";
    case suture_v1_SERVER_LEAVING:
      return "leaving";
  }
  return "unknown";
}

std::string session_text(std::string_view session) {
  return session.empty() ? "the default session" : "session \"" + std::string(session) + "\"";
}

const ServerTool* ServerInfo::tool(std::string_view name) const noexcept {
  const auto found =
      std::find_if(tools.begin(), tools.end(), [&](const ServerTool& t) { return t.name == name; });
  return found == tools.end() ? nullptr : &*found;
}

ServerInfo server_info(const v1::ServerStatus& status) {
  ServerInfo info;
  info.server = guid_of(status.server);
  info.epoch = status.epoch;
  info.protocol_version = status.protocol_version;
  info.version = text_of(status.server_version);
  info.session = text_of(status.session);
  info.host = text_of(status.host);
  info.pid = status.pid;
  info.scene = text_of(status.scene);
  for (const v1::ToolStatus& tool : span_of(status.tools)) {
    info.tools.push_back({std::string(text_of(tool.tool)), std::string(text_of(tool.kind)),
                          tool.leased, guid_of(tool.device),
                          ForceLimits{tool.max_force_n, tool.max_torque_nm,
                                      tool.max_force_slew_n_per_s, tool.max_torque_slew_nm_per_s},
                          tool.stale_after_ms});
  }
  return info;
}

ServerInfo await_server(const Participant& participant, std::chrono::nanoseconds timeout,
                        const std::function<bool(const ServerInfo&)>& enough) {
  const ParticipantOptions& options = participant.options();
  const std::optional<ServerInfo> found = listen(participant, timeout, enough);
  if (found) {
    if (found->protocol_version == suture_v1_PROTOCOL_VERSION) return *found;
    throw Error(ErrorCode::kVersionMismatch,
                "the server (sutured " + found->version + " on " + found->host +
                    ") speaks protocol version " + std::to_string(found->protocol_version) +
                    ", this client " + std::to_string(suture_v1_PROTOCOL_VERSION),
                found->protocol_version > suture_v1_PROTOCOL_VERSION ? "update this client"
                                                                     : "update the server");
  }
  const OtherServers others = look_around(participant);
  if (!others.types.empty()) {
    throw Error(ErrorCode::kVersionMismatch,
                "the server speaks another protocol version (" + *others.types.begin() +
                    ", this client " + topic<v1::ServerStatus>().descriptor->m_typename + ")",
                "update the older of the two");
  }
  const std::optional<Identity>& identity = participant.identity();
  if (identity && !options.separate) {
    if (const auto open = find_unsecured_server(participant))
      throw Error(ErrorCode::kPermissionDenied,
                  "the server of " + session_text(options.session) + " (sutured " + open->version +
                      " on " + open->host +
                      ") is not secured, and these keys trust nobody who is not",
                  "start it with --security FOLDER, or say --security off here");
  }
  std::string cause = "no server answers in domain " + std::to_string(options.domain) + ", " +
                      session_text(options.session);
  if (!others.sessions.empty()) {
    cause += " (one does in ";
    for (const std::string& session : others.sessions) {
      if (session != *others.sessions.begin()) cause += ", ";
      cause += session_text(session);
    }
    cause += ")";
  }
  if (identity)
    throw Error(ErrorCode::kNoServer, cause + " to the keys of \"" + identity->name + "\"",
                "where a server runs there, it may refuse these keys (another authority, revoked, "
                "another session or domain in the permissions): its log or a line above names the "
                "cause; else "
                "check domain, session, --interface and --peer");
  throw Error(ErrorCode::kNoServer, cause,
              "start `sutured serve SCENE.toml --domain " + std::to_string(options.domain) +
                  (options.session.empty() ? "" : " --session " + options.session) +
                  "`, or check domain, session, --interface, --peer and firewall; a secured server "
                  "answers only with --security");
}

void listen_to_servers(
    std::span<const Participant> participants, std::chrono::nanoseconds timeout,
    const std::function<void(std::uint32_t domain, const v1::ServerStatus&)>& use) {
  // Servers answer a new participant within tens of milliseconds on a quiet network.
  constexpr std::chrono::milliseconds kQuiet(600);
  // All servers of a domain write one instance, so that a reader of the topic's own depth would
  // keep the last word of one of them.
  constexpr int kServersMax = 1000;
  struct Ear {
    std::uint32_t domain;
    Reader<v1::ServerStatus> reader;
    std::set<std::uint64_t> heard;
    std::size_t known = 0;
  };
  std::vector<Ear> ears;
  for (const Participant& participant : participants)
    ears.push_back({participant.options().domain,
                    Reader<v1::ServerStatus>(participant, {}, kServersMax),
                    {},
                    0});
  WaitSet waitset;
  for (const Ear& ear : ears) waitset.attach(ear.reader);
  const Clock::time_point end = Clock::now() + timeout;
  Clock::time_point quiet_end = Clock::now() + kQuiet;
  bool all_spoke = true;  // nobody is known
  while (Clock::now() < end && !(all_spoke && Clock::now() >= quiet_end)) {
    const Clock::time_point until = all_spoke ? std::min(end, quiet_end) : end;
    waitset.wait(std::max<std::chrono::nanoseconds>(until - Clock::now(), {}));
    all_spoke = true;
    for (Ear& ear : ears) {
      ear.reader.take_each([&](const v1::ServerStatus& status, const SampleInfo& info) {
        if (info.writer != 0) ear.heard.insert(info.writer);
        if (info.valid && info.writers_alive && status.state != suture_v1_SERVER_LEAVING)
          use(ear.domain, status);
      });
      const auto known = static_cast<std::size_t>(ear.reader.matched());
      if (known > ear.known) quiet_end = Clock::now() + kQuiet;
      ear.known = known;
      all_spoke = all_spoke && ear.heard.size() >= known;
    }
  }
}

std::optional<ServerInfo> find_other_server(const Participant& participant,
                                            std::chrono::nanoseconds timeout) {
  return listen(participant, timeout, {});
}

}  // namespace suture
