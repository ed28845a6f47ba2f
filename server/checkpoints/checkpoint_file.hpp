// SPDX-License-Identifier: GPL-3.0-or-later
// A checkpoint on disk: whole or not at all, and only for the scene and build that wrote it.
//
//     "SUTCKPT\n"   version   CheckpointInfo   length   state   CRC-64
//     8 bytes       uint32    as archived      uint64           over all before it
//
// Integers are little endian. The state is whoever's `Archive` wrote it. The checksum finds what
// disks and copies do to a file; it does not keep out somebody who means harm: do not read
// checkpoints of people you do not trust.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

namespace sutured::scene {
struct Scene;
}

namespace sutured::checkpoints {

/// Raised whenever the bytes of a state change: what an older one wrote is refused.
inline constexpr std::uint32_t kVersion = 3;

/// A checkpoint that cannot be written or used: `what()` names the file, the reason and the mend.
struct CheckpointError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// Who wrote a checkpoint: they archive different things beside the simulation.
enum class Writer : std::uint8_t { kRun, kServe };

/// Whose state it is. Only equal ones fit each other.
struct Identity {
  Writer writer{};
  std::uint64_t scene = 0;  ///< CRC-64 of the scene's content, meshes included, paths not
  std::string scene_name;
  std::string build;  ///< version of the program
  [[nodiscard]] bool operator==(const Identity&) const = default;
};

/// Returns the identity of `scene` in this build. Cost: a pass over its meshes.
[[nodiscard]] Identity identity_of(const scene::Scene& scene, Writer writer);

/// What stands at the head of a checkpoint.
struct CheckpointInfo {
  Identity identity;
  double time_s = 0.0;         ///< simulated
  std::int64_t stamp_ns = 0;   ///< Unix epoch: when it was taken
  std::uint64_t sequence = 0;  ///< counts up by one a checkpoint of a folder
  std::uint64_t previous = 0;  ///< the one that its past was last written in; 0: none
};

/// Throws CheckpointError where the checkpoint at `path` is `found`'s and not `expected`'s.
void expect_same(const std::filesystem::path& path, const Identity& found,
                 const Identity& expected);

/// Writes a checkpoint to `path` and waits until the disk has it: afterwards the file is the new
/// one or, where that failed, still the one before. Throws CheckpointError.
void write_checkpoint(const std::filesystem::path& path, const CheckpointInfo& info,
                      std::span<const std::byte> state);

struct Checkpoint {
  CheckpointInfo info;
  std::vector<std::byte> state;
};

/// Reads and checks a checkpoint. Throws CheckpointError where it cannot be read, is damaged, or is
/// of another version, build or scene than `expected`.
[[nodiscard]] Checkpoint read_checkpoint(const std::filesystem::path& path,
                                         const Identity& expected);

/// Reads the head alone: the state is not looked at, nor the checksum. Throws CheckpointError.
[[nodiscard]] CheckpointInfo read_checkpoint_info(const std::filesystem::path& path);

}  // namespace sutured::checkpoints
