// SPDX-License-Identifier: Apache-2.0
// The one factory of DDS participants: domain configuration, session, security.
#pragma once

#include <dds/dds.h>

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "protocol/network.hpp"
#include "protocol/security.hpp"
#include "protocol/topics.hpp"
#include "suture/error.hpp"

namespace suture {

/// The last domain of forces. Cyclone's ports are 7400 + 250 × domain + …, so that those of 232 are
/// the last that fit into 16 bits; N + 1 must fit too.
inline constexpr std::uint32_t kMaxDomain = 230;

/// Says which session to take part in, and how.
struct ParticipantOptions {
  std::uint32_t domain = 0;  ///< even, ≤ kMaxDomain; meshes use domain + 1
  std::string session{};     ///< DDS partition; empty is the default session
  std::string security{};    ///< folder of keys; empty: as `security_folder` says
  std::string tool{};        ///< that its writers claim, "*": any; empty: none
  /// Take part as if from another process, with receive threads of one's own: what is
  /// written reaches the other participants of this process by the network, never on the
  /// writing thread. For those who serve strangers inside a process that renders forces.
  /// Settings of `CYCLONEDDS_URI` must then stand under `<Domain Id="any">`.
  bool separate = false;
  NetworkOptions network{};
  /// Hear every session of the domain instead of one, and say nothing: `session` must be empty,
  /// and writers cannot be made.
  bool every_session = false;
};

/// Says whether the present process may run SCHED_FIFO threads of `priority`: it
/// starts one and sees. Cyclone aborts the process where it may not, hence the probe.
[[nodiscard]] bool may_run_realtime(int priority) noexcept;

/// Priority of Cyclone's receive thread where real time is permitted; a pose is
/// answered on it.
inline constexpr int kReceivePriority = 70;

/// Takes part in one domain of a session, and leaves it when destroyed. Readers and
/// writers are made from it and must be destroyed before it.
///
/// The first participant of a domain in this process configures it; after our own
/// settings those of the environment's `CYCLONEDDS_URI` apply (buffers, tracing; interfaces and
/// peers are `network`'s), and last what safety needs (no shared memory: after a kill of one side
/// the other hung for minutes). Threads: any, also at once.
class Participant {
 public:
  /// Throws Error kBadInput (domain odd or too large), kNetwork, kPermissionDenied (keys that
  /// do not hold, or do not give the tool; a network without keys).
  Participant(const ParticipantOptions& options, Channel channel);
  ~Participant();
  Participant(Participant&&) noexcept;
  Participant& operator=(Participant&&) noexcept;

  [[nodiscard]] dds_entity_t handle() const noexcept;
  [[nodiscard]] dds_entity_t publisher() const noexcept;   ///< in the session's partition; 0: none
  [[nodiscard]] dds_entity_t subscriber() const noexcept;  ///< in the session's partition
  [[nodiscard]] Channel channel() const noexcept;
  [[nodiscard]] const ParticipantOptions& options() const noexcept;
  /// Returns who takes part; none: unsecured.
  [[nodiscard]] const std::optional<Identity>& identity() const noexcept;
  /// Says whether the receive thread of this domain runs in real time.
  [[nodiscard]] bool receives_in_realtime() const noexcept;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// Turns a negative return code of Cyclone into an Error that names `what` failed.
[[noreturn]] void throw_dds_error(dds_return_t code, const std::string& what);

}  // namespace suture
