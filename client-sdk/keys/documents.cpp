// SPDX-License-Identifier: Apache-2.0
#include "keys/documents.hpp"

#include <algorithm>
#include <set>
#include <string_view>

#include "client-sdk/xml_text.hpp"
#include "keys/authority.hpp"
#include "protocol/security.hpp"
#include "protocol/topics.hpp"

namespace suture::keys {
namespace {

struct Topics {
  std::set<std::string> written, read;
};

template <class... T>
void add(std::set<std::string>& names) {
  (names.insert(topic<T>().name), ...);
}

Topics topics_of(const Rights& rights) {
  Topics topics;
  for (const Role role : rights.roles) {
    switch (role) {
      case Role::kServer:
        for (const TopicSpec& spec : all_topics()) {
          topics.written.insert(spec.name);
          topics.read.insert(spec.name);
        }
        topics.written.insert(kComposedScene);
        topics.read.insert(kComposedScene);
        break;
      case Role::kDevice:
        add<v1::ToolPose, v1::ToolRendered, v1::DeviceProfile>(topics.written);
        add<v1::ServerStatus, v1::Event, v1::ToolForce, v1::HapticModel, v1::ToolPose>(topics.read);
        break;
      case Role::kViewer:
        add<v1::ServerStatus, v1::Event>(topics.read);
        for (const TopicSpec& spec : all_topics())
          if (spec.channel == Channel::kMesh) topics.read.insert(spec.name);
        break;
      case Role::kRecorder:
        for (const TopicSpec& spec : all_topics()) topics.read.insert(spec.name);
        break;
      case Role::kOperator:
        add<v1::Command>(topics.written);
        add<v1::CommandReply, v1::ServerStatus, v1::Event>(topics.read);
        break;
    }
  }
  return topics;
}

std::string date(std::int64_t unix_s) { return utc_text(unix_s, "%Y-%m-%dT%H:%M:%SZ"); }

std::string domain_range(std::uint32_t first, std::uint32_t last) {
  return "<id_range><min>" + std::to_string(first) + "</min><max>" + std::to_string(last) +
         "</max></id_range>";
}

bool serves(const Rights& rights) {
  return std::find(rights.roles.begin(), rights.roles.end(), Role::kServer) != rights.roles.end();
}

// A server takes part in its domains a second time, for its web clients.
std::string domains(const Rights& rights) {
  if (rights.domain < 0) return "<domains>" + domain_range(0, kSecuredDomains - 1) + "</domains>";
  const auto first = static_cast<std::uint32_t>(rights.domain);
  std::string pairs = domain_range(first, first + 1);
  if (serves(rights))
    pairs += domain_range(separate_secured_domain(first), separate_secured_domain(first) + 1);
  return "<domains>" + pairs + "</domains>";
}

// A session's name never begins with the mark of a tool, so that a right to every session
// is none to a tool.
std::vector<std::string> sessions(const Rights& rights) {
  if (rights.session.empty()) return {"", std::string("[!") + kToolMark + "]*"};
  if (!serves(rights)) return {rights.session};
  return {rights.session, kCodecPartition};
}

std::string criteria(const char* kind, const std::set<std::string>& topics,
                     const std::vector<std::string>& partitions) {
  if (topics.empty()) return "";
  std::string xml = std::string("<") + kind + "><topics>";
  for (const std::string& name : topics) xml += "<topic>" + name + "</topic>";
  xml += "</topics><partitions>";
  for (const std::string& name : partitions)
    xml += "<partition>" + xml_escaped(name) + "</partition>";
  return xml + "</partitions></" + kind + ">\n";
}

}  // namespace

std::string governance_xml(Protection protection) {
  const char* messages = protection == Protection::kSign ? "SIGN"
                         : protection == Protection::kEncrypt
                             ? "ENCRYPT"
                             : "ENCRYPT_WITH_ORIGIN_AUTHENTICATION";
  return std::string(R"(<?xml version="1.0" encoding="utf-8"?>
<dds><domain_access_rules><domain_rule>
<domains>)" + domain_range(0, kSecuredDomains - 1) +
                     R"(</domains>
<allow_unauthenticated_participants>false</allow_unauthenticated_participants>
<enable_join_access_control>true</enable_join_access_control>
<discovery_protection_kind>ENCRYPT</discovery_protection_kind>
<liveliness_protection_kind>ENCRYPT</liveliness_protection_kind>
<rtps_protection_kind>)") +
         messages + R"(</rtps_protection_kind>
<topic_access_rules><topic_rule>
<topic_expression>*</topic_expression>
<enable_discovery_protection>true</enable_discovery_protection>
<enable_liveliness_protection>true</enable_liveliness_protection>
<enable_read_access_control>true</enable_read_access_control>
<enable_write_access_control>true</enable_write_access_control>
<metadata_protection_kind>NONE</metadata_protection_kind>
<data_protection_kind>NONE</data_protection_kind>
</topic_rule></topic_access_rules>
</domain_rule></domain_access_rules></dds>
)";
}

std::string permissions_xml(const std::string& subject, const Rights& rights, std::int64_t now_s,
                            std::int64_t expires_s) {
  const Topics topics = topics_of(rights);
  std::vector<std::string> writes_in = sessions(rights);
  if (serves(rights)) {
    writes_in.push_back(tool_partition("*"));
  } else {
    for (const std::string& tool : rights.tools) writes_in.push_back(tool_partition(tool));
  }
  return "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<dds><permissions><grant name=\"holder\">\n"
         "<subject_name>" +
         xml_escaped(subject) + "</subject_name>\n<validity><not_before>" +
         date(now_s - kClockSkew_s) + "</not_before><not_after>" + date(expires_s) +
         "</not_after></validity>\n<allow_rule>" + domains(rights) + "\n" +
         criteria("publish", topics.written, writes_in) +
         criteria("subscribe", topics.read, sessions(rights)) +
         "</allow_rule>\n<default>DENY</default>\n</grant></permissions></dds>\n";
}

}  // namespace suture::keys
