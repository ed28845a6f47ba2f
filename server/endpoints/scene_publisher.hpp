// SPDX-License-Identifier: GPL-3.0-or-later
// What is not felt: status, events, commands, and the scene for viewers.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "checkpoints/checkpoint_keeper.hpp"
#include "endpoints/force_service.hpp"
#include "endpoints/model_publisher.hpp"
#include "endpoints/session_claim.hpp"
#include "haptics/realtime.hpp"
#include "haptics/simulation_loop.hpp"
#include "haptics/supervisor.hpp"
#include "scene/scene.hpp"

namespace sutured::endpoints {

/// Everything that the publisher looks at; all of it outlives the publisher.
struct Served {
  const scene::Scene& scene;
  const std::vector<ServedTool>& tools;
  ForceService& forces;
  ModelPublisher& models;
  haptics::SimulationLoop& loop;
  haptics::Supervisor& supervisor;
  const haptics::RealtimeReport& realtime;
  double rate_hz = 0.0;
  std::string session;
  checkpoints::CheckpointKeeper* keeper = nullptr;  ///< null: there are no checkpoints
  std::string resumed;                              ///< Server::resumed
  std::function<int()> more_viewers;                ///< Server::Options
};

/// Sends what viewers and people see, on one thread that nobody waits for: every 10 ms
/// commands, events and leases, twice a second the status, at most 60 times a second
/// frames.
class ScenePublisher {
 public:
  /// Publishes the bodies at rest and begins. Throws suture::Error.
  ScenePublisher(const suture::Participant& control, const suture::Participant& mesh,
                 SessionClaim& claim, Served served);
  ~ScenePublisher();
  ScenePublisher(const ScenePublisher&) = delete;
  ScenePublisher& operator=(const ScenePublisher&) = delete;

  /// Tells once more how things stand, as `leaving`, and ends.
  void finish(const std::string& reason) noexcept;

  /// Returns the last SessionClaim::rival. Threads: any.
  [[nodiscard]] std::string rival() const {
    const std::lock_guard lock(rival_mutex_);
    return rival_;
  }

 private:
  /// How far the counters of a tool have been told as events.
  struct Told {
    std::array<std::uint64_t, haptics::kFaultCount> faults{};
    std::array<std::int64_t, haptics::kFaultCount> at_ns{};
    std::uint64_t leases = 0, returns = 0, recoveries = 0;
    std::uint64_t poses = 0, forces = 0;  // at the last status
    std::uint64_t lease_holder = 0;
  };
  /// The figures of a thread as they were last told.
  struct ToldQuality {
    simulation::ThreadQuality figures;
    std::uint64_t epoch = 0;
    std::int64_t at_ns = 0;
  };
  /// A command that is done when the epoch changes, and what is then told of it.
  struct PendingChange {
    suture::v1::CommandReply reply;
    std::uint64_t epoch_before = 0;
    suture_v1_EventKind event{};
    std::string text;
  };

  void run() noexcept;
  void publish_topology();
  void show(std::int64_t now_ns);
  void publish_frame(const haptics::DisplayFrame& frame);
  void publish_needles(const haptics::DisplayFrame& frame);
  void publish_threads(const haptics::DisplayFrame& frame);
  void publish_contacts(const haptics::DisplayFrame& frame);
  void publish_quality(const haptics::DisplayFrame& frame, std::int64_t now_ns);
  void publish_tools(const haptics::DisplayFrame& frame);
  void publish_status(suture_v1_ServerState state, const std::string& reason);
  void publish_events(std::int64_t now_ns);
  void publish_event(suture::v1::Event& event);
  void tell_channel(std::size_t tool, std::int64_t now_ns);
  void obey();
  void answer(suture::v1::CommandReply& reply, suture_v1_CommandResult result,
              const std::string& text);
  void change_world(const suture::v1::Command& command, suture::v1::CommandReply& reply);
  void keep_checkpoint(const suture::v1::Command& command, suture::v1::CommandReply& reply);
  void finish_checkpoints();
  void execute(const suture::v1::Command& command, suture::v1::CommandReply& reply);
  void heed_devices();
  void remember_profile(std::size_t tool, const suture::Guid& device,
                        const haptics::DeviceLimits& limits);
  void look_for_a_rival();
  void finish_changes();
  void notice(suture_v1_EventKind kind, const std::string& text);
  suture_v1_ServerState state() const;

  Served served_;
  SessionClaim& claim_;
  mutable std::mutex rival_mutex_;
  std::string rival_;

  suture::Writer<suture::v1::Event> events_;
  suture::Reader<suture::v1::DeviceProfile> profiles_;
  suture::Writer<suture::v1::CommandReply> replies_;
  suture::Writer<suture::v1::MeshTopology> topologies_;
  suture::Writer<suture::v1::MeshFrame> frames_;
  suture::Writer<suture::v1::ToolView> tools_;
  suture::Writer<suture::v1::NeedleState> needles_;
  suture::Writer<suture::v1::ThreadState> threads_;
  suture::Writer<suture::v1::ContactState> contacts_;
  suture::Writer<suture::v1::Quality> quality_;

  // Per tool, the oldest first.
  std::vector<std::vector<std::pair<suture::Guid, haptics::DeviceLimits>>> profiles_told_;
  std::vector<std::uint64_t> heeded_;  // per tool: the lease whose device's limits hold
  std::vector<Told> told_;
  std::vector<suture::v1::ToolStatus> tool_status_;
  std::vector<double> course_m_;
  std::vector<suture::v1::Puncture> punctures_;
  std::vector<suture::v1::ContactPoint> contact_points_;
  std::vector<suture::v1::Bite> bites_;
  std::vector<ToldQuality> told_quality_;  // per thread
  std::vector<PendingChange> changes_;
  std::vector<std::pair<std::string, suture::v1::CommandReply>> checkpoints_asked_;  ///< by name
  simulation::StepReport report_;                 // of the last frame
  const haptics::DisplayFrame* shown_ = nullptr;  // the last frame; it stays until the next
  std::int64_t shown_ns_ = 0;
  std::uint64_t status_sequence_ = 0, event_sequence_ = 0, frame_sequence_ = 0;
  std::uint64_t quality_sequence_ = 0;
  std::uint64_t topology_epoch_ = 0, events_dropped_told_ = 0, overruns_told_ = 0;
  std::uint64_t commands_dropped_told_ = 0;
  std::uint64_t steps_then_ = 0, frames_since_ = 0;
  std::array<std::int64_t, haptics::SimulationLoop::kStages> stage_ns_then_{};
  std::int64_t status_ns_ = 0;
  double time_s_ = 0.0;
  std::int64_t overruns_told_ns_ = 0;
  bool stopped_ = false;

  std::atomic<bool> stop_{false};
  std::thread thread_;
};

}  // namespace sutured::endpoints
