// SPDX-License-Identifier: GPL-3.0-or-later
// Keeps the checkpoints of a running server without holding its simulation up.
//
//     simulation thread                      checkpoint thread (nice 10)
//     offer: once a second one copy    ──▶   write, fsync, rename, delete the oldest
//            into memory it has      ◀──
//
// The simulation pays for the copy alone, some tenths of a millisecond for the paper's scene
// (`make bench`), and never waits: where both copies are still being written, it goes on without.
// Copies leave the caches out.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "checkpoints/checkpoint_folder.hpp"
#include "haptics/bounded_queue.hpp"
#include "simulation/quality.hpp"
#include "simulation/simulation.hpp"

namespace sutured::checkpoints {

/// Threads: `offer` and what `Change::apply` does are the simulation's; the rest one other thread.
class CheckpointKeeper {
 public:
  struct Options {
    CheckpointFolder::Options folder;
    std::int64_t period_ns = 1'000'000'000;
  };

  /// Opens the folder. Throws CheckpointError.
  CheckpointKeeper(Options options, const scene::Scene& scene);
  /// Writes what was taken, and ends.
  ~CheckpointKeeper();
  CheckpointKeeper(const CheckpointKeeper&) = delete;
  CheckpointKeeper& operator=(const CheckpointKeeper&) = delete;

  /// Puts another state into a simulation. Throws ArchiveError; the simulation is then reset.
  using Apply = std::function<void(simulation::Simulation&, simulation::QualityMeter*)>;
  struct Change {
    Apply apply;
    std::string text;                  ///< for people: where that is
    std::vector<std::string> refused;  ///< checkpoints that should have been used, and why not
  };
  struct Resumption {
    std::optional<Change> change;
    std::vector<std::string> refused;  ///< as CheckpointFolder::Newest has them
  };
  /// Returns the newest checkpoint. None where there is none that can be used, or (`crash_only`:
  /// nor is any refused) the last server ended as asked. Before the first `offer`.
  [[nodiscard]] Resumption resume(bool crash_only);
  /// Returns the state of `seconds` (simulated) ago, or the oldest there is since the last reset.
  /// Throws CheckpointError.
  [[nodiscard]] Change back_by(double seconds);
  /// Returns the state that was named so. Throws CheckpointError.
  [[nodiscard]] Change to(const std::string& name);

  /// Asks for a checkpoint of that name, of the next `offer`. Throws CheckpointError where the name
  /// is none. `word` tells what became of it.
  void ask(const std::string& name);
  /// Something to tell people.
  struct Word {
    std::string name;  ///< that was asked for; empty: of the checkpoints that nobody asked for
    bool good = false;
    std::string text;
  };
  [[nodiscard]] std::optional<Word> next_word();
  /// Ends as asked: there is nothing to resume.
  void note_ended() { folder_.note_ended(); }

  /// Copies the state where a second has passed since the last copy and the time moved on, or
  /// somebody asked. Call after each step, and now and then while the simulation stands still. A
  /// new `epoch` that no Change began is a reset's.
  /// Waits for nobody. Allocates: when the state is larger than every earlier one.
  void offer(simulation::Simulation& simulation, simulation::QualityMeter* quality,
             std::uint64_t epoch, std::int64_t now_ns);

  /// Returns how long the last copy took, ns, and its size.
  [[nodiscard]] std::int64_t copy_ns() const { return copy_ns_.load(std::memory_order_relaxed); }
  [[nodiscard]] std::size_t copy_bytes() const {
    return copy_bytes_.load(std::memory_order_relaxed);
  }

 private:
  /// What goes on from one state that was put in, or from the start or a reset.
  struct World {
    std::uint64_t number = 0;
    std::uint64_t past = 0;  ///< the checkpoint that it began with; 0: none, a start or a reset
  };
  struct Copy {
    CheckpointInfo info;
    std::vector<std::byte> state;
    std::string name;  ///< empty: of the second
    World world;
  };

  [[nodiscard]] Change change_to(Checkpoint checkpoint, std::uint64_t past,
                                 std::vector<std::string> refused);
  void begin_world(std::uint64_t past);
  void run() noexcept;
  void write(Copy& copy);
  void say(Word word);

  Options options_;
  CheckpointFolder folder_;

  std::array<Copy, 2> copies_;
  haptics::BoundedQueue<Copy*, 4> free_, filled_;  ///< to and from the simulation
  std::atomic<bool> asked_{false}, stop_{false};
  std::mutex mutex_;  ///< of the next two
  std::vector<std::string> names_asked_;
  std::vector<Word> words_;
  std::atomic<std::uint32_t> beat_{0};

  // Simulation's thread.
  std::int64_t due_ns_ = 0;
  double copied_at_s_ = -1.0;
  std::uint64_t epoch_ = 0;   // of the last offer; 0: none yet
  bool begun_by_us_ = false;  // the next epoch is that of a Change
  World world_;
  bool copied_ = true;  ///< something of this world; the first one begins on time
  Copy* spare_ = nullptr;

  // Which world is the present one; the checkpoint written last, and its world.
  std::atomic<std::uint64_t> present_{0}, present_past_{0}, written_{0}, written_world_{0};
  std::atomic<double> time_s_{0.0};
  std::atomic<std::int64_t> copy_ns_{0};
  std::atomic<std::size_t> copy_bytes_{0};
  bool failing_ = false;  // checkpoint thread
  std::thread thread_;
};

}  // namespace sutured::checkpoints
