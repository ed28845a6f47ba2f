// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "commands.hpp"
#include "protocol/rendezvous.hpp"
#include "suture/types.hpp"

namespace suture::cli {
namespace {

using Json = nlohmann::ordered_json;

/// Both the table and the JSON are made of this: a server's session and how it does.
struct Row {
  std::uint32_t domain = 0;
  std::string session, scene, host, version, state;
  int pid = 0;
  double uptime_s = 0.0;
  double rate_hz = 0.0, achieved_rate_hz = 0.0, step_p99_ms = 0.0;
  std::uint64_t overruns = 0;
  std::uint32_t devices = 0, tools = 0, viewers = 0;
  std::uint32_t faults_present = 0;  ///< FAULT_* of all tools
  std::uint64_t fault_count = 0;     ///< since start
};

/// What strangers call themselves, without what a terminal would obey.
std::string printable(std::string_view text) {
  std::string result(text);
  for (char& c : result)
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) c = '?';
  return result;
}

Row row_of(std::uint32_t domain, const v1::ServerStatus& status) {
  Row row;
  row.domain = domain;
  row.session = printable(text_of(status.session));
  row.scene = printable(text_of(status.scene));
  row.host = printable(text_of(status.host));
  row.version = printable(text_of(status.server_version));
  row.state = name_of(status.state);
  row.pid = status.pid;
  if (status.started_ns > 0)  // else it is about to
    row.uptime_s = 1e-9 * static_cast<double>(status.stamp_ns - status.started_ns);
  row.rate_hz = status.rate_hz;
  row.achieved_rate_hz = status.achieved_rate_hz;
  row.step_p99_ms = 1e-3 * status.step.p99_us;
  row.overruns = status.overruns;
  row.devices = status.devices;
  row.tools = status.tools._length;
  row.viewers = status.viewers;
  for (const v1::ToolStatus& tool : span_of(status.tools)) {
    row.faults_present |= tool.faults;
    row.fault_count += tool.fault_count;
  }
  return row;
}

Json json_of(const Row& row) {
  return {{"session", row.session},
          {"domain", row.domain},
          {"scene", row.scene},
          {"state", row.state},
          {"host", row.host},
          {"pid", row.pid},
          {"version", row.version},
          {"uptime_s", row.uptime_s},
          {"rate_hz", row.rate_hz},
          {"achieved_rate_hz", row.achieved_rate_hz},
          {"step_p99_ms", row.step_p99_ms},
          {"overruns", row.overruns},
          {"devices", row.devices},
          {"tools", row.tools},
          {"viewers", row.viewers},
          {"faults_present", fault_names(row.faults_present)},
          {"fault_count", row.fault_count}};
}

/// As people say it: 42 s, 17 min, 3 h 05 min, 2 d 3 h.
std::string duration_text(double seconds) {
  const auto whole = static_cast<long>(std::max(seconds, 0.0));
  char text[64];
  if (whole < 120)
    std::snprintf(text, sizeof text, "%ld s", whole);
  else if (whole < 7200)
    std::snprintf(text, sizeof text, "%ld min", whole / 60);
  else if (whole < 172800)
    std::snprintf(text, sizeof text, "%ld h %02ld min", whole / 3600, whole / 60 % 60);
  else
    std::snprintf(text, sizeof text, "%ld d %ld h", whole / 86400, whole / 3600 % 24);
  return text;
}

std::string format(const char* pattern, double a, double b) {
  char text[64];
  std::snprintf(text, sizeof text, pattern, a, b);
  return text;
}

/// Columns as wide as what stands in them.
void print_table(const std::vector<Row>& rows) {
  std::vector<std::vector<std::string>> lines{{"session", "domain", "scene", "server", "state",
                                               "up", "steps/s", "step p99", "devices", "viewers",
                                               "faults"}};
  for (const Row& row : rows) {
    std::string faults = std::to_string(row.fault_count);
    if (row.faults_present != 0) faults += ", now " + fault_names(row.faults_present);
    lines.push_back({row.session.empty() ? "(default)" : row.session, std::to_string(row.domain),
                     row.scene, row.host + ':' + std::to_string(row.pid), row.state,
                     duration_text(row.uptime_s),
                     format("%.0f of %.0f", row.achieved_rate_hz, row.rate_hz),
                     format("%.2f ms", row.step_p99_ms, 0.0),
                     std::to_string(row.devices) + " of " + std::to_string(row.tools),
                     std::to_string(row.viewers), faults});
  }
  std::vector<std::size_t> widths(lines.front().size(), 0);
  for (const auto& line : lines)
    for (std::size_t i = 0; i < line.size(); ++i) widths[i] = std::max(widths[i], line[i].size());
  for (const auto& line : lines) {
    std::string text;
    for (std::size_t i = 0; i < line.size(); ++i) {
      text += line[i];
      if (i + 1 < line.size()) text.append(widths[i] + 2 - line[i].size(), ' ');
    }
    std::printf("%s\n", text.c_str());
  }
}

std::string domains_text(const SessionsArguments& arguments) {
  if (arguments.all_domains) return "any domain";
  std::string text = arguments.domains.size() == 1 ? "domain" : "domains";
  for (const std::uint32_t domain : arguments.domains)
    text += (domain == arguments.domains.front() ? " " : ", ") + std::to_string(domain);
  return text;
}

}  // namespace

int run_sessions(const SessionsArguments& arguments) {
  std::vector<std::uint32_t> domains = arguments.domains;
  if (arguments.all_domains) {
    domains.clear();
    for (std::uint32_t domain = 0; domain <= kMaxDomain; domain += 2) domains.push_back(domain);
  }
  std::sort(domains.begin(), domains.end());
  domains.erase(std::unique(domains.begin(), domains.end()), domains.end());
  std::vector<Participant> participants;
  for (const std::uint32_t domain : domains) {
    ParticipantOptions options;
    options.domain = domain;
    options.every_session = true;
    options.security = arguments.security;
    options.network = arguments.network;
    participants.emplace_back(options, Channel::kControl);
  }

  // By domain and session; two servers of one session are two lines.
  std::map<std::pair<std::pair<std::uint32_t, std::string>, Guid>, Row> found;
  listen_to_servers(participants,
                    std::chrono::nanoseconds(static_cast<std::int64_t>(arguments.timeout_s * 1e9)),
                    [&](std::uint32_t domain, const v1::ServerStatus& status) {
                      Row row = row_of(domain, status);
                      found[{{domain, row.session}, guid_of(status.server)}] = std::move(row);
                    });

  std::vector<Row> rows;
  for (auto& [key, row] : found) rows.push_back(std::move(row));
  if (arguments.json) {
    Json list = Json::array();
    for (const Row& row : rows) list.push_back(json_of(row));
    std::printf("%s\n", list.dump(2, ' ', false, Json::error_handler_t::replace).c_str());
  } else if (!rows.empty()) {
    print_table(rows);
  }
  if (!rows.empty()) return kDone;
  throw Error(
      ErrorCode::kNoServer, "no server answers in " + domains_text(arguments),
      "start `sutured serve SCENE.toml`, or look elsewhere with --domain N or --all-domains");
}

}  // namespace suture::cli
