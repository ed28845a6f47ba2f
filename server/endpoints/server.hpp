// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "checkpoints/checkpoint_folder.hpp"
#include "haptics/realtime.hpp"
#include "protocol/participant.hpp"
#include "scene/scene.hpp"

namespace sutured::simulation {
class Simulation;
}

namespace sutured::endpoints {

/// A running server of one scene: simulation, force threads and DDS, put together.
///
/// Threads: the owner's only. Its own threads are listed in docs/architecture.md.
class Server {
 public:
  struct Options {
    suture::ParticipantOptions session;
    double rate_hz = 0.0;  ///< of the simulation; 0: the scene's
    /// haptics::SimulationLoop::Options::watch
    std::function<void(simulation::Simulation&, bool last)> watch;
    /// Where checkpoints are kept; none: they are not, and commands that want them are refused.
    std::optional<checkpoints::CheckpointFolder::Options> checkpoints;
    /// What to add to the frame readers that DDS counts as viewers (Gateway); called on the
    /// publisher's thread, until `stop`.
    std::function<int()> more_viewers = [] { return 0; };
    enum class Resume { kAfterCrash, kAlways, kNever };
    Resume resume = Resume::kAfterCrash;
  };

  /// Builds the simulation and starts serving. Throws suture::Error (kServerRunning where
  /// another server has this session; kBadInput, kNetwork, kPermissionDenied) and what
  /// simulation::Simulation and checkpoints::CheckpointFolder throw.
  Server(scene::Scene scene, Options options);
  /// Stops as `stop` does.
  ~Server();
  Server(const Server&) = delete;
  Server& operator=(const Server&) = delete;

  /// Lets all forces go to zero, then ends the simulation, says that the server leaves,
  /// and leaves. Takes about 50 ms.
  void stop(const std::string& reason) noexcept;

  /// Returns why the simulation ended by itself; empty while it runs.
  [[nodiscard]] std::string failure() const;
  /// How far its loops have come since the start; a loop that hangs counts no more.
  struct Pulse {
    std::uint64_t beats = 0;  ///< of the simulation's loop, which has them while paused too
    std::uint64_t ticks = 0;  ///< of the supervisor
  };
  [[nodiscard]] Pulse pulse() const;
  /// Returns which other server serves this session too and precedes this one, which shall then
  /// end (docs/adr/0043); empty while there is none.
  [[nodiscard]] std::string rival() const;
  [[nodiscard]] const haptics::RealtimeReport& realtime() const;
  /// One line for people: steps, rate, overruns.
  [[nodiscard]] std::string summary() const;
  /// Where the state came from that it began with; empty: from the scene.
  [[nodiscard]] const std::string& resumed() const;
  /// Checkpoints that were refused and what was changed of the scene's wishes, for the log: lines,
  /// or nothing.
  [[nodiscard]] std::string notes() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace sutured::endpoints
