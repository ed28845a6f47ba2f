// SPDX-License-Identifier: GPL-3.0-or-later
// A pose in, a force out, on the receive thread of the control domain.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "haptics/bounded_queue.hpp"
#include "haptics/period_latency.hpp"
#include "haptics/tool_channel.hpp"
#include "protocol/endpoint.hpp"

namespace sutured::endpoints {

/// One tool of the scene with its channel.
struct ServedTool {
  std::string name;
  std::string kind;  ///< driver, probe
  haptics::ToolChannel* channel = nullptr;
};

/// Answers the poses of all tools over DDS, takes what devices render themselves, and obeys
/// a stop.
///
/// A stop and a resume act as they arrive, in their order, on the receive thread, and wait for
/// nobody; only then do they go to whoever answers commands (`next_command`). So no slow
/// viewer, full queue or busy publisher stands between a stop and the force.
///
/// Where the session is secured, a tool obeys those writers alone that are in its partition
/// (suture::tool_partition), into which DDS Security lets nobody whose permissions do not name
/// the tool.
///
/// The pose listener runs on Cyclone's receive thread; it, and `tick` on the supervisor,
/// are the only writers of forces. Both allocate nothing and log nothing; the one
/// exception is a writer's first pose, whose GUID Cyclone is asked for.
class ForceService {
 public:
  /// Throws suture::Error. `tools` and their channels outlive it.
  ForceService(const suture::Participant& participant, const std::vector<ServedTool>& tools);
  ForceService(const ForceService&) = delete;
  ForceService& operator=(const ForceService&) = delete;

  /// The supervisor's tick.
  void tick(std::int64_t now_ns) noexcept;

  /// Moves the oldest command not yet answered into `command`; false where there is none. One
  /// caller.
  bool next_command(suture::v1::Command& command) noexcept { return commands_heard_.pop(command); }
  /// Returns how many commands found no room among those not yet answered: they stay without an
  /// answer, though a stop or a resume of them acted.
  [[nodiscard]] std::uint64_t commands_dropped() const noexcept {
    return commands_heard_.dropped();
  }
  /// Stops all tools; no resume is obeyed any more. Any thread.
  void stop_for_good() noexcept;

  /// Ends the leases of writers that have left. Any one thread, now and then.
  void end_leases_of_the_departed() noexcept;

  /// Returns the GUID of a writer that sent a pose; nobody where it is unknown.
  [[nodiscard]] suture::Guid guid_of_writer(std::uint64_t writer) const noexcept;

  /// Returns how long it took from a pose in hand to its force written, since the last
  /// call, for one tool. One caller.
  haptics::LatencySummary take_tick_times(std::size_t tool) noexcept {
    return lines_[tool]->tick_times.take();
  }
  /// The same of `dds_write` alone, for all tools.
  haptics::LatencySummary take_write_times() noexcept { return write_times_.take(); }
  /// Returns how many poses named a tool that the scene has not, or that their writer may not
  /// drive.
  [[nodiscard]] std::uint64_t strangers() const noexcept {
    return strangers_.load(std::memory_order_relaxed);
  }

 private:
  struct Line {
    std::uint64_t tool_id = 0;
    std::uint64_t right = 0;  // its bit of KnownWriter::rights
    std::string partition;    // of those who may drive it
    haptics::ToolChannel* channel = nullptr;
    // Receive thread: of the last ToolRendered, whose writer it was and for which lease it
    // was looked at, and whether both are of one participant.
    std::uint64_t rendered_writer = 0, rendered_lease = 0;
    bool rendered_is_ours = false;
    haptics::PeriodLatency tick_times;
  };
  /// A writer seen. Written by the receive thread only, oldest replaced.
  struct KnownWriter {
    std::atomic<std::uint64_t> handle{0};
    std::array<std::atomic<std::uint64_t>, 2> guid{};
    std::uint64_t rights = 0;  // receive thread: Line::right of each tool that it may drive
  };

  void on_poses() noexcept;
  void on_rendered() noexcept;
  void on_commands() noexcept;
  Line* line_of(std::uint64_t tool_id) noexcept;
  [[nodiscard]] std::uint64_t rights_of(std::uint64_t writer) const;
  void set_stopped(bool stopped) noexcept;
  /// Returns what is known of a writer; null where it has left.
  const KnownWriter* remember(std::uint64_t writer) noexcept;
  void send(const Line& line, const haptics::ForceSample& force) noexcept;

  bool secured_;
  std::vector<std::unique_ptr<Line>> lines_;
  std::array<KnownWriter, 64> writers_;
  std::size_t next_writer_ = 0;
  haptics::PeriodLatency write_times_;  // of the receive thread
  std::atomic<std::uint64_t> strangers_{0};
  std::atomic<bool> ready_{false}, peers_changed_{false};
  suture::Writer<suture::v1::ToolForce> forces_;
  haptics::BoundedQueue<suture::v1::Command, 64> commands_heard_;
  std::atomic<bool> stopped_for_good_{false};
  // Last: their listeners use all of the above.
  suture::Reader<suture::v1::Command> commands_;
  suture::Reader<suture::v1::ToolRendered> rendered_;
  suture::Reader<suture::v1::ToolPose> poses_;
};

}  // namespace sutured::endpoints
