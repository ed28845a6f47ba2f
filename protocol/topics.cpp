// SPDX-License-Identifier: Apache-2.0
#include "protocol/topics.hpp"

#include <ctime>

namespace suture {
namespace {

constexpr std::int64_t kMs = 1'000'000;

// The quality of service of every topic, in one place.
//
// Writers offer deadline and liveliness; readers request neither, because a reader
// that requests a deadline does not match a writer that offers none, and time
// staleness themselves by arrival. 3 ms of deadline raised false alarms. Nothing is
// keep-all: such a writer blocks and such a reader queues without end. No latency
// budget anywhere: any value at all, however small, costs a millisecond.
// clang-format off
constexpr TopicSpec kTopics[] = {
  // name                   channel            type                        reliable kept   depth deadline liveliness
  {"suture/tool/pose",      Channel::kControl, &suture_v1_ToolPose_desc,      false, false,    1, 5 * kMs, 100 * kMs},
  {"suture/tool/force",     Channel::kControl, &suture_v1_ToolForce_desc,     false, false,    1, 5 * kMs, 100 * kMs},
  {"suture/tool/model",     Channel::kControl, &suture_v1_HapticModel_desc,   true,  false,    1, 0,       100 * kMs},
  {"suture/tool/rendered",  Channel::kControl, &suture_v1_ToolRendered_desc,  false, false,    1, 0,       100 * kMs},
  {"suture/tool/device",    Channel::kControl, &suture_v1_DeviceProfile_desc, true,  true,     1, 0,       0},
  {"suture/event",          Channel::kControl, &suture_v1_Event_desc,         true,  true,  1000, 0,       0},
  {"suture/status",         Channel::kControl, &suture_v1_ServerStatus_desc,  true,  true,     1, 0,       0},
  {"suture/command",        Channel::kControl, &suture_v1_Command_desc,       true,  false,   16, 0,       0},
  {"suture/command/reply",  Channel::kControl, &suture_v1_CommandReply_desc,  true,  false,   16, 0,       0},
  {"suture/mesh/topology",  Channel::kMesh,    &suture_v1_MeshTopology_desc,  true,  true,     1, 0,       0},
  {"suture/mesh/frame",     Channel::kMesh,    &suture_v1_MeshFrame_desc,     false, false,    1, 0,       0},
  {"suture/tool/state",     Channel::kMesh,    &suture_v1_ToolView_desc,      false, false,    1, 0,       0},
  {"suture/needle",         Channel::kMesh,    &suture_v1_NeedleState_desc,   false, false,    1, 0,       0},
  {"suture/thread",         Channel::kMesh,    &suture_v1_ThreadState_desc,   false, false,    1, 0,       0},
  {"suture/contact",        Channel::kMesh,    &suture_v1_ContactState_desc,  false, false,    1, 0,       0},
  {"suture/quality",        Channel::kMesh,    &suture_v1_Quality_desc,       true,  true,     1, 0,       0},
};
// clang-format on

std::int64_t clock_ns(clockid_t clock) noexcept {
  timespec now{};
  clock_gettime(clock, &now);
  return std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

}  // namespace

template <>
const TopicSpec& topic<v1::ToolPose>() noexcept {
  return kTopics[0];
}
template <>
const TopicSpec& topic<v1::ToolForce>() noexcept {
  return kTopics[1];
}
template <>
const TopicSpec& topic<v1::HapticModel>() noexcept {
  return kTopics[2];
}
template <>
const TopicSpec& topic<v1::ToolRendered>() noexcept {
  return kTopics[3];
}
template <>
const TopicSpec& topic<v1::DeviceProfile>() noexcept {
  return kTopics[4];
}
template <>
const TopicSpec& topic<v1::Event>() noexcept {
  return kTopics[5];
}
template <>
const TopicSpec& topic<v1::ServerStatus>() noexcept {
  return kTopics[6];
}
template <>
const TopicSpec& topic<v1::Command>() noexcept {
  return kTopics[7];
}
template <>
const TopicSpec& topic<v1::CommandReply>() noexcept {
  return kTopics[8];
}
template <>
const TopicSpec& topic<v1::MeshTopology>() noexcept {
  return kTopics[9];
}
template <>
const TopicSpec& topic<v1::MeshFrame>() noexcept {
  return kTopics[10];
}
template <>
const TopicSpec& topic<v1::ToolView>() noexcept {
  return kTopics[11];
}
template <>
const TopicSpec& topic<v1::NeedleState>() noexcept {
  return kTopics[12];
}
template <>
const TopicSpec& topic<v1::ThreadState>() noexcept {
  return kTopics[13];
}
template <>
const TopicSpec& topic<v1::ContactState>() noexcept {
  return kTopics[14];
}
template <>
const TopicSpec& topic<v1::Quality>() noexcept {
  return kTopics[15];
}

std::span<const TopicSpec> all_topics() noexcept { return kTopics; }

std::int64_t wall_clock_ns() noexcept { return clock_ns(CLOCK_REALTIME); }
std::int64_t monotonic_ns() noexcept { return clock_ns(CLOCK_MONOTONIC); }

}  // namespace suture
