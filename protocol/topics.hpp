// SPDX-License-Identifier: Apache-2.0
// Every topic with its type, its domain and its quality of service; the table is in topics.cpp.
#pragma once

#include <span>

#include "protocol/types.hpp"

namespace suture {

/// A session occupies two DDS domains, N (even) and N + 1: participants of one
/// domain in one process share their receive threads, so that meshes in the
/// domain of the forces would delay these by milliseconds.
enum class Channel {
  kControl,  ///< domain N: poses, forces, models, status, events, commands
  kMesh,     ///< domain N + 1: meshes and what else is only looked at
};

/// How one topic travels.
struct TopicSpec {
  const char* name;
  Channel channel;
  const dds_topic_descriptor_t* descriptor;
  bool reliable;
  bool transient_local;        ///< late joiners get the history
  int depth;                   ///< keep last `depth` per instance
  std::int64_t deadline_ns;    ///< offered by writers, requested by nobody; 0: none
  std::int64_t liveliness_ns;  ///< lease of automatic liveliness, offered by writers; 0: none
};

/// What the gateway composes of the others for web clients (foxglove::SceneUpdate). It is a topic
/// to DDS where its codec is made (`SampleCodec`), and not otherwise.
inline constexpr const char* kComposedScene = "suture/scene";

/// The partition in which a codec writes a sample to itself. Keys of a server permit it.
inline constexpr const char* kCodecPartition = "suture-type-of-a-topic";

/// Returns the specification of the topic that carries `T`.
template <class T>
[[nodiscard]] const TopicSpec& topic() noexcept;

template <>
const TopicSpec& topic<v1::ToolPose>() noexcept;
template <>
const TopicSpec& topic<v1::ToolForce>() noexcept;
template <>
const TopicSpec& topic<v1::HapticModel>() noexcept;
template <>
const TopicSpec& topic<v1::ToolRendered>() noexcept;
template <>
const TopicSpec& topic<v1::DeviceProfile>() noexcept;
template <>
const TopicSpec& topic<v1::Event>() noexcept;
template <>
const TopicSpec& topic<v1::ServerStatus>() noexcept;
template <>
const TopicSpec& topic<v1::Command>() noexcept;
template <>
const TopicSpec& topic<v1::CommandReply>() noexcept;
template <>
const TopicSpec& topic<v1::MeshTopology>() noexcept;
template <>
const TopicSpec& topic<v1::MeshFrame>() noexcept;
template <>
const TopicSpec& topic<v1::ToolView>() noexcept;
template <>
const TopicSpec& topic<v1::NeedleState>() noexcept;
template <>
const TopicSpec& topic<v1::ThreadState>() noexcept;
template <>
const TopicSpec& topic<v1::ContactState>() noexcept;
template <>
const TopicSpec& topic<v1::Quality>() noexcept;

/// Returns all of them, for recorders, gateways and tests.
[[nodiscard]] std::span<const TopicSpec> all_topics() noexcept;

/// True where a sample holds no pointer: taking and writing it allocates nothing.
template <class T>
inline constexpr bool kFixedSize =
    std::is_same_v<T, v1::ToolPose> || std::is_same_v<T, v1::ToolForce> ||
    std::is_same_v<T, v1::ToolRendered> || std::is_same_v<T, v1::DeviceProfile> ||
    std::is_same_v<T, v1::Event> || std::is_same_v<T, v1::Command> ||
    std::is_same_v<T, v1::CommandReply> || std::is_same_v<T, v1::ToolView>;

}  // namespace suture
