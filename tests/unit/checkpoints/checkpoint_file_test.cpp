// SPDX-License-Identifier: GPL-3.0-or-later
#include "checkpoints/checkpoint_file.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdint>
#include <filesystem>
#include <fstream>

#include "archive/archive.hpp"
#include "simulation/simulation.hpp"
#include "support/block_scene.hpp"
#include "support/temporary_folder.hpp"

namespace sutured::checkpoints {
namespace {

using ::testing::HasSubstr;

const Identity kIdentity{Writer::kServe, 42, "block", "0.1.0"};
constexpr std::size_t kBlockAtRestBytes = 16010;

std::vector<std::byte> some_state() {
  std::vector<std::byte> state(300);
  for (std::size_t i = 0; i < state.size(); ++i) state[i] = static_cast<std::byte>(i * 7);
  return state;
}

/// Returns why the file is refused; empty where it is not.
std::string refusal(const std::string& path, const Identity& expected = kIdentity) {
  try {
    (void)read_checkpoint(path, expected);
    return "";
  } catch (const CheckpointError& error) {
    return error.what();
  }
}

class CheckpointFile : public ::testing::Test {
 protected:
  CheckpointFile() {
    CheckpointInfo info;
    info.identity = kIdentity;
    info.time_s = 1.5;
    info.sequence = 7;
    info.previous = 6;
    write_checkpoint(path_, info, some_state());
    bytes_ = testing::read_file(path_);
  }
  void put(const std::string& bytes) { std::ofstream(path_, std::ios::binary) << bytes; }

  testing::TemporaryFolder folder_;
  std::string path_ = folder_.path("a.checkpoint");
  std::string bytes_;
};

TEST_F(CheckpointFile, ReadsWhatWasWritten) {
  const Checkpoint read = read_checkpoint(path_, kIdentity);
  EXPECT_EQ(read.state, some_state());
  EXPECT_EQ(read.info.time_s, 1.5);
  EXPECT_EQ(read.info.sequence, 7U);
  EXPECT_EQ(read_checkpoint_info(path_).previous, 6U);
}

TEST_F(CheckpointFile, ADamagedByteAnywhereIsRefused) {
  for (std::size_t i = 0; i < bytes_.size(); ++i) {
    std::string damaged = bytes_;
    damaged[i] = static_cast<char>(damaged[i] ^ 0x10);
    put(damaged);
    EXPECT_NE(refusal(path_), "") << "byte " << i;
  }
}

TEST_F(CheckpointFile, OneThatIsCutOffOrTooLongIsRefused) {
  for (std::size_t size = 0; size < bytes_.size(); ++size) {
    put(bytes_.substr(0, size));
    EXPECT_NE(refusal(path_), "") << size;
  }
  put(bytes_ + "x");
  EXPECT_THAT(refusal(path_), HasSubstr("damaged"));
}

// Longer than any checkpoint is: what it says shows that it was not to be read first.
TEST_F(CheckpointFile, LooksAtTheHeadBeforeItReadsTheRest) {
  constexpr std::uintmax_t kLong = std::uintmax_t{9} << 30;  // sparse
  std::filesystem::resize_file(path_, kLong);
  EXPECT_THAT(refusal(path_), HasSubstr("not as long as it says"));
  put("");
  std::filesystem::resize_file(path_, kLong);
  EXPECT_THAT(refusal(path_), HasSubstr("is no checkpoint"));
  EXPECT_THAT(refusal(folder_.path("")), HasSubstr("is not a regular file"));
}

TEST_F(CheckpointFile, SaysWhoseItIs) {
  Identity other = kIdentity;
  other.scene_name = "vessels";
  other.scene = 43;
  EXPECT_THAT(refusal(path_, other), HasSubstr("is of scene \"block\", and this is \"vessels\""));
  other = kIdentity;
  other.scene = 43;
  EXPECT_THAT(refusal(path_, other), HasSubstr("before it or a mesh was changed"));
  other = kIdentity;
  other.build = "9.9.9";
  EXPECT_THAT(refusal(path_, other), HasSubstr("written by sutured 0.1.0, and this is 9.9.9"));
  other = kIdentity;
  other.writer = Writer::kRun;
  EXPECT_THAT(refusal(path_, other), HasSubstr("sutured serve"));
  EXPECT_THAT(refusal(folder_.path("missing")), HasSubstr("missing"));
  std::string version = bytes_;
  version[9] = 99;  // behind the magic and the archive's first byte
  put(version);
  EXPECT_THAT(refusal(path_), HasSubstr("version 99"));
}

TEST_F(CheckpointFile, OneThatCannotBeWrittenLeavesTheOneBefore) {
  CheckpointInfo info;
  info.identity = kIdentity;
  // A folder in the way of the temporary file.
  std::filesystem::create_directory(path_ + ".part");
  EXPECT_THROW(write_checkpoint(path_, info, {}), CheckpointError);
  EXPECT_EQ(testing::read_file(path_), bytes_);
}

TEST(SceneIdentity, IsOfTheContentNotOfThePaths) {
  const scene::Scene scene = testing::block_scene(4);
  const auto digest = [](const scene::Scene& s) { return identity_of(s, Writer::kServe).scene; };
  scene::Scene moved = scene;
  moved.path = "/elsewhere/scene.toml";
  moved.tissues[0].mesh_path = "/elsewhere/a.msh";
  moved.notes.emplace_back("a note");
  EXPECT_EQ(digest(moved), digest(scene));
  scene::Scene stiffer = scene;
  stiffer.tissues[0].young_modulus_pa *= 1.0 + 1e-15;
  EXPECT_NE(digest(stiffer), digest(scene));
  scene::Scene bent = scene;
  bent.tissues[0].mesh.vertices_m[3].x() += 1e-12;
  EXPECT_NE(digest(bent), digest(scene));
}

/// The bytes of a scene at rest. Where this fails the layout of a state has changed: raise kVersion
/// with this number.
TEST(StateLayout, IsThatOfItsVersion) {
  simulation::Simulation simulation(testing::block_scene(2));
  std::vector<std::byte> bytes;
  Archive archive = Archive::writing(bytes, Archive::Caches::kLeftOut);
  archive(simulation);
  EXPECT_EQ(std::pair(kVersion, bytes.size()), std::pair(3U, kBlockAtRestBytes));
}

}  // namespace
}  // namespace sutured::checkpoints
