// SPDX-License-Identifier: GPL-3.0-or-later
// The checkpoints of one server, in a folder that it has to itself:
//
//     second.0000000042.checkpoint     taken every second, the last `keep` of them
//     named.NAME.checkpoint            taken by command, until they are deleted by hand
//     ended                            the last server ended as asked: there is nothing to resume
//     resumed                          the sequence number that the last server resumed
//     lock                             held while a server runs
//
// Every checkpoint knows the one before it in its own past. After a rewind the past is another one
// than that of the files written last, and further rewinds follow it:
//
//     1 ◀─ 2 ◀─ 3 ◀─ 4          rewound to 2: the next one is 5, and from it one rewinds to 2 and 1
//          ▲
//          └─── 5 ◀─ 6
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "checkpoints/checkpoint_file.hpp"

namespace sutured::checkpoints {

/// Returns what is wrong with the name of a checkpoint; empty where nothing is. Letters, digits,
/// '-' and '_', 32 of them at most.
[[nodiscard]] std::string fault_of_name(std::string_view name);

/// Threads: any; a call waits for the others, and for the disk.
class CheckpointFolder {
 public:
  struct Options {
    std::filesystem::path folder;
    std::size_t keep = 120;  ///< of those taken every second, at least 2
  };

  /// Makes the folder where there is none, takes it for this process and reads what is in it.
  /// Throws CheckpointError where it cannot, or where another server has it.
  CheckpointFolder(Options options, Identity identity);
  /// Gives the folder back.
  ~CheckpointFolder();
  CheckpointFolder(const CheckpointFolder&) = delete;
  CheckpointFolder& operator=(const CheckpointFolder&) = delete;

  /// Writes the next checkpoint of the second, and deletes the oldest. Returns its sequence number.
  std::uint64_t write(CheckpointInfo info, std::span<const std::byte> state);
  /// Writes the checkpoint NAME, over one of that name.
  void write(const std::string& name, CheckpointInfo info, std::span<const std::byte> state);

  /// A checkpoint, and which ones were refused before it, a line each.
  struct Found {
    Checkpoint checkpoint;
    std::vector<std::string> refused;
  };
  struct Newest {
    std::optional<Checkpoint> checkpoint;
    std::vector<std::string> refused;
  };
  /// Returns the newest checkpoint that is whole and of this scene and build. Where there is none,
  /// `refused` has a line for each of the second that there is, those of another scene or build
  /// too, the newest first; else for those that are newer and this scene's.
  [[nodiscard]] Newest newest();
  /// Returns the youngest one in the past of `sequence` that was taken at or before `time_s`
  /// (simulated), or the oldest one there is. Throws CheckpointError where there is none.
  [[nodiscard]] Found in_the_past_of(std::uint64_t sequence, double time_s);
  /// Throws CheckpointError.
  [[nodiscard]] Checkpoint named(const std::string& name) const;

  /// Returns whether the last server of this folder ended as asked, or there was none.
  [[nodiscard]] bool ended() const { return ended_; }
  /// Notes what was resumed, until the next `write`: a server that dies before that, on that state,
  /// resumes the one before it.
  void note_resumed(std::uint64_t sequence);
  /// Notes that the server ended as asked.
  void note_ended();

 private:
  [[nodiscard]] std::filesystem::path path_of(std::uint64_t sequence) const;
  [[nodiscard]] std::filesystem::path path_of(const std::string& name) const;
  void read_folder();

  Options options_;
  Identity identity_;
  mutable std::mutex mutex_;
  int lock_fd_ = -1;
  bool ended_ = true;
  std::uint64_t last_ = 0;                         ///< sequence number written last
  std::uint64_t resumed_before_ = 0;               ///< by a server that then died; 0: none
  std::set<std::uint64_t> files_;                  ///< of whichever scene and build
  std::map<std::uint64_t, CheckpointInfo> known_;  ///< of this scene and build, by number
  std::map<std::uint64_t, Identity> others_;       ///< whose those are that are not in `known_`
};

}  // namespace sutured::checkpoints
