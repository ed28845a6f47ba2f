// SPDX-License-Identifier: GPL-3.0-or-later
#include "checkpoints/checkpoint_keeper.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <limits>
#include <memory>
#include <utility>

#include "haptics/realtime.hpp"
#include "protocol/types.hpp"

namespace sutured::checkpoints {
namespace {

std::string in_seconds(double seconds) {
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), "%.2f s", seconds);
  return text.data();
}

/// What a server's checkpoint is made of.
void archive_served(Archive& archive, simulation::Simulation& simulation,
                    simulation::QualityMeter* quality) {
  bool judged = quality != nullptr;
  archive(simulation, judged);
  if (judged != (quality != nullptr)) throw ArchiveError("it has other figures beside it");
  if (judged) archive(*quality);
}

}  // namespace

CheckpointKeeper::CheckpointKeeper(Options options, const scene::Scene& scene)
    : options_(std::move(options)), folder_(options_.folder, identity_of(scene, Writer::kServe)) {
  for (Copy& copy : copies_) free_.push(&copy);
  thread_ = std::thread([this] { run(); });
}

CheckpointKeeper::~CheckpointKeeper() {
  stop_.store(true);
  beat_.fetch_add(1, std::memory_order_release);
  beat_.notify_one();
  thread_.join();
}

// ------------------------------------------------------------------ simulation's thread

void CheckpointKeeper::begin_world(std::uint64_t past) {
  world_ = {world_.number + 1, past};
  copied_ = false;
  present_past_.store(past);
  present_.store(world_.number);
}

void CheckpointKeeper::offer(simulation::Simulation& simulation, simulation::QualityMeter* quality,
                             std::uint64_t epoch, std::int64_t now_ns) {
  if (epoch != epoch_) {
    if (epoch_ != 0 && !begun_by_us_) begin_world(0);  // somebody reset it
    epoch_ = epoch;
    begun_by_us_ = false;
  }
  time_s_.store(simulation.time_s(), std::memory_order_relaxed);
  const bool due = now_ns >= due_ns_ && (simulation.time_s() != copied_at_s_ || !copied_);
  const bool asked = asked_.load(std::memory_order_relaxed);
  if (!due && !asked) return;
  if (spare_ == nullptr && !free_.pop(spare_)) return;  // the next step will find one
  std::string name;
  if (asked) {
    const std::unique_lock lock(mutex_, std::try_to_lock);
    if (lock && !names_asked_.empty()) {
      name = std::move(names_asked_.front());
      names_asked_.erase(names_asked_.begin());
      asked_.store(!names_asked_.empty(), std::memory_order_relaxed);
    }
  }
  if (!due && name.empty()) return;
  const std::int64_t start_ns = suture::monotonic_ns();
  Copy* copy = std::exchange(spare_, nullptr);
  copy->name = name;
  copy->info.time_s = simulation.time_s();
  copy->info.stamp_ns = suture::wall_clock_ns();
  copy->world = world_;
  copy->state.clear();
  Archive archive = Archive::writing(copy->state, Archive::Caches::kLeftOut);
  archive_served(archive, simulation, quality);
  if (name.empty()) {
    copied_ = true;
    due_ns_ = now_ns < std::numeric_limits<std::int64_t>::max() - options_.period_ns
                  ? now_ns + options_.period_ns
                  : now_ns;
    copied_at_s_ = simulation.time_s();
  }
  copy_bytes_.store(copy->state.size(), std::memory_order_relaxed);
  copy_ns_.store(suture::monotonic_ns() - start_ns, std::memory_order_relaxed);
  filled_.push(copy);
  beat_.fetch_add(1, std::memory_order_release);
  beat_.notify_one();
}

// ------------------------------------------------------------------ checkpoint thread

void CheckpointKeeper::run() noexcept {
  haptics::name_thread("checkpoints");
  haptics::go_behind_ordinary_threads();
  std::uint32_t seen = beat_.load(std::memory_order_acquire);
  for (;;) {
    const bool last = stop_.load();
    Copy* copy = nullptr;
    while (filled_.pop(copy)) {
      write(*copy);
      free_.push(copy);
    }
    if (last) return;
    beat_.wait(seen, std::memory_order_acquire);
    seen = beat_.load(std::memory_order_acquire);
  }
}

void CheckpointKeeper::write(Copy& copy) {
  copy.info.previous =
      written_world_.load() == copy.world.number ? written_.load() : copy.world.past;
  try {
    if (!copy.name.empty()) {
      folder_.write(copy.name, copy.info, copy.state);
      say({copy.name, true, "\"" + copy.name + "\" at " + in_seconds(copy.info.time_s)});
      return;
    }
    written_.store(folder_.write(copy.info, copy.state));
    written_world_.store(copy.world.number);
    if (failing_) say({"", true, "checkpoints are written again"});
    failing_ = false;
  } catch (const std::exception& error) {
    // Of those that nobody asked for, the first failure is told.
    if (!copy.name.empty() || !failing_) say({copy.name, false, error.what()});
    failing_ = failing_ || copy.name.empty();
  }
}

void CheckpointKeeper::say(Word word) {
  const std::lock_guard lock(mutex_);
  words_.push_back(std::move(word));
}

// ------------------------------------------------------------------ others

void CheckpointKeeper::ask(const std::string& name) {
  if (std::string fault = fault_of_name(name); !fault.empty())
    throw CheckpointError("\"" + name + "\": " + fault);
  const std::lock_guard lock(mutex_);
  names_asked_.push_back(name);
  asked_.store(true, std::memory_order_relaxed);
}

std::optional<CheckpointKeeper::Word> CheckpointKeeper::next_word() {
  const std::lock_guard lock(mutex_);
  if (words_.empty()) return std::nullopt;
  Word word = std::move(words_.front());
  words_.erase(words_.begin());
  return word;
}

CheckpointKeeper::Change CheckpointKeeper::change_to(Checkpoint checkpoint, std::uint64_t past,
                                                     std::vector<std::string> refused) {
  Change change;
  change.text = "at " + in_seconds(checkpoint.info.time_s);
  change.refused = std::move(refused);
  const auto state = std::make_shared<std::vector<std::byte>>(std::move(checkpoint.state));
  change.apply = [this, state, past](simulation::Simulation& simulation,
                                     simulation::QualityMeter* quality) {
    begun_by_us_ = true;
    try {
      Archive archive = Archive::reading(*state);
      archive_served(archive, simulation, quality);
      archive.expect_end();
    } catch (const ArchiveError&) {
      simulation.reset();
      if (quality != nullptr) quality->reset();
      begin_world(0);
      throw;
    }
    begin_world(past);
    due_ns_ = 0;
  };
  return change;
}

CheckpointKeeper::Resumption CheckpointKeeper::resume(bool crash_only) {
  if (crash_only && folder_.ended()) return {};
  CheckpointFolder::Newest newest = folder_.newest();
  if (!newest.checkpoint) return {std::nullopt, std::move(newest.refused)};
  const std::uint64_t sequence = newest.checkpoint->info.sequence;
  folder_.note_resumed(sequence);
  return {change_to(std::move(*newest.checkpoint), sequence, {}), std::move(newest.refused)};
}

CheckpointKeeper::Change CheckpointKeeper::back_by(double seconds) {
  const double now_s = time_s_.load(std::memory_order_relaxed);
  const std::uint64_t present = present_.load();
  const std::uint64_t past =
      written_world_.load() == present ? written_.load() : present_past_.load();
  if (past == 0 && present != 0)
    throw CheckpointError("there is nothing to rewind to yet, just after a reset");
  CheckpointFolder::Found found = folder_.in_the_past_of(past, now_s - seconds);
  const double then_s = found.checkpoint.info.time_s;
  const std::uint64_t sequence = found.checkpoint.info.sequence;
  Change change = change_to(std::move(found.checkpoint), sequence, std::move(found.refused));
  change.text += ", " + in_seconds(now_s - then_s) + " back";
  if (then_s > now_s - seconds) change.text += ": there is no older checkpoint";
  return change;
}

CheckpointKeeper::Change CheckpointKeeper::to(const std::string& name) {
  Checkpoint checkpoint = folder_.named(name);
  const std::uint64_t past = checkpoint.info.previous;
  Change change = change_to(std::move(checkpoint), past, {});
  change.text = "\"" + name + "\" " + change.text;
  return change;
}

}  // namespace sutured::checkpoints
