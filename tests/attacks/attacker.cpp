// SPDX-License-Identifier: GPL-3.0-or-later
// An attacker, a process of its own: whatever keys and plugins it is given, it tries to drive a
// tool and to read forces and events, at the level of Cyclone DDS, past the SDK and its checks;
// or it throws packets. Says in one line of JSON how far it came.
#include <arpa/inet.h>
#include <dds/dds.h>
#include <sys/socket.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <random>
#include <string>
#include <vector>

#include "attacks/packets.hpp"
#include "protocol/endpoint.hpp"
#include "protocol/participant.hpp"
#include "protocol/types.hpp"

namespace {

using namespace suture;
using Clock = std::chrono::steady_clock;

struct Options {
  ParticipantOptions session;
  std::string tool;
  std::vector<std::string> partitions, properties;
  std::string packets;
  bool forge = false;
  double seconds = 3.0;
};

dds_entity_t entity(dds_entity_t handle, const char* what) {
  if (handle < 0) throw std::runtime_error(std::string(what) + ": " + dds_strretcode(handle));
  return handle;
}

nlohmann::json drive(const Options& options) {
  // The first participant configures the domain as the SDK does. It stays: Cyclone's collector of
  // garbage may crash where a participant goes that has another one with refused topics beside it.
  static const Participant configured({options.session.domain, "attackers-own", "off"},
                                      Channel::kControl);
  dds_qos_t* const qos = dds_create_qos();
  for (const std::string& property : options.properties) {
    const std::size_t at = property.find('=');
    dds_qset_prop(qos, property.substr(0, at).c_str(), property.substr(at + 1).c_str());
  }
  const dds_entity_t participant =
      entity(dds_create_participant(options.session.domain, qos, nullptr), "its own plugins");
  dds_delete_qos(qos);

  dds_qos_t* const group = dds_create_qos();
  std::vector<const char*> partitions{options.session.session.c_str()};
  dds_qset_partition(group, 1, partitions.data());
  const dds_entity_t subscriber = entity(dds_create_subscriber(participant, group, nullptr), "");
  for (const std::string& name : options.partitions) partitions.push_back(name.c_str());
  dds_qset_partition(group, static_cast<std::uint32_t>(partitions.size()), partitions.data());
  const dds_entity_t publisher = entity(dds_create_publisher(participant, group, nullptr), "");
  dds_delete_qos(group);

  const auto topic_of = [&](const TopicSpec& spec) {
    return entity(dds_create_topic(participant, spec.descriptor, spec.name, nullptr, nullptr),
                  "its own plugins");
  };
  dds_qos_t* const best_effort = dds_create_qos();
  dds_qset_reliability(best_effort, DDS_RELIABILITY_BEST_EFFORT, 0);
  dds_qset_type_consistency(best_effort, DDS_TYPE_CONSISTENCY_DISALLOW_TYPE_COERCION, false, false,
                            false, false, true);
  const dds_entity_t writer = entity(
      dds_create_writer(publisher, topic_of(topic<v1::ToolPose>()), best_effort, nullptr), "");
  const dds_entity_t forces = entity(
      dds_create_reader(subscriber, topic_of(topic<v1::ToolForce>()), best_effort, nullptr), "");
  const dds_entity_t models = entity(
      dds_create_reader(subscriber, topic_of(topic<v1::HapticModel>()), best_effort, nullptr), "");
  dds_delete_qos(best_effort);
  dds_guid_t own{};
  dds_get_guid(writer, &own);

  v1::ToolPose pose{};
  pose.tool_id = tool_id(options.tool);
  pose.orientation_xyzw[3] = 1.0;
  pose.position_m[2] = 0.05;
  pose.flags = suture_v1_POSE_IN_WORLD;
  int matched = 0, answered = 0, read = 0;
  const Clock::time_point end = Clock::now() + std::chrono::duration_cast<Clock::duration>(
                                                   std::chrono::duration<double>(options.seconds));
  while (Clock::now() < end) {
    ++pose.sequence_number;
    pose.stamp_ns = wall_clock_ns();
    dds_write(writer, &pose);
    matched =
        std::max(matched, static_cast<int>(dds_get_matched_subscriptions(writer, nullptr, 0)));
    v1::ToolForce force;
    void* place = &force;
    dds_sample_info_t info;
    while (dds_take(forces, &place, &info, 1, 1) > 0) {
      ++read;
      if (guid_of(force.device) == guid_of(own.v)) ++answered;
    }
    void* model = nullptr;
    while (dds_take(models, &model, &info, 1, 1) > 0) {
      ++read;
      dds_return_loan(models, &model, 1);
      model = nullptr;
    }
    dds_sleepfor(DDS_MSECS(1));
  }
  return {{"error", ""},
          {"sent", pose.sequence_number},
          {"matched", matched},
          {"answered", answered},
          {"read", read}};
}

/// Throws packets at where the recorded ones went, as fast as the sockets take them: as they were,
/// or forged: half of them with a few bytes changed, half of them as if not protected at all.
nlohmann::json throw_packets(const Options& options) {
  std::ifstream file(options.packets, std::ios::binary);
  const std::vector<sutured::attacks::Packet> packets = sutured::attacks::read_packets(file);
  if (packets.empty()) throw std::runtime_error("no packets to throw");
  const int socket = ::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  std::mt19937 random(7);
  std::uint64_t sent = 0;
  const Clock::time_point end = Clock::now() + std::chrono::duration_cast<Clock::duration>(
                                                   std::chrono::duration<double>(options.seconds));
  while (Clock::now() < end) {
    for (const sutured::attacks::Packet& packet : packets) {
      std::vector<char> bytes = packet.bytes;
      if (options.forge) {
        sutured::attacks::forge(bytes, random);
      }
      sent += ::sendto(socket, bytes.data(), bytes.size(), 0,
                       reinterpret_cast<const sockaddr*>(&packet.to), sizeof packet.to) > 0;
    }
  }
  ::close(socket);
  return {{"error", ""}, {"sent", sent}, {"matched", 0}, {"answered", 0}, {"read", 0}};
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("An attacker, for tests");
  Options options;
  app.add_option("--domain", options.session.domain);
  app.add_option("--session", options.session.session);
  app.add_option("--tool", options.tool);
  app.add_option("--partition", options.partitions)->allow_extra_args(false);
  app.add_option("--property", options.properties)->allow_extra_args(false);
  app.add_option("--packets", options.packets);
  app.add_flag("--forge", options.forge);
  app.add_option("--seconds", options.seconds);
  CLI11_PARSE(app, argc, argv);
  nlohmann::json result;
  try {
    result = options.packets.empty() ? drive(options) : throw_packets(options);
  } catch (const std::exception& error) {
    result = {{"error", error.what()}, {"sent", 0}, {"matched", 0}, {"answered", 0}, {"read", 0}};
  }
  std::printf("\n%s\n", result.dump().c_str());
  std::fflush(stdout);
  _exit(0);  // an attacker does not tidy up
}
