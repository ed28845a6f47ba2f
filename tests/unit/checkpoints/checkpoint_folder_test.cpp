// SPDX-License-Identifier: GPL-3.0-or-later
#include "checkpoints/checkpoint_folder.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "support/temporary_folder.hpp"

namespace sutured::checkpoints {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::SizeIs;

const Identity kIdentity{Writer::kServe, 42, "block", "0.1.0"};

class Folder : public ::testing::Test {
 protected:
  std::unique_ptr<CheckpointFolder> open(std::size_t keep = 10, Identity identity = kIdentity) {
    return std::make_unique<CheckpointFolder>(CheckpointFolder::Options{path_, keep}, identity);
  }
  static std::uint64_t write(CheckpointFolder& folder, double time_s, std::uint64_t previous) {
    CheckpointInfo info;
    info.time_s = time_s;
    info.previous = previous;
    const std::array<std::byte, 3> state{std::byte{1}, std::byte{2}, std::byte{3}};
    return folder.write(info, state);
  }
  /// Seconds 1 to `count`, each the next one's past.
  static void write_seconds(CheckpointFolder& folder, std::uint64_t count) {
    for (std::uint64_t i = 1; i <= count; ++i) write(folder, static_cast<double>(i), i - 1);
  }
  void damage(std::uint64_t sequence) {
    const std::string file = file_of(sequence);
    std::string bytes = testing::read_file(file);
    bytes.back() = static_cast<char>(bytes.back() ^ 1);
    std::ofstream(file, std::ios::binary) << bytes;
  }
  [[nodiscard]] std::string file_of(std::uint64_t sequence) const {
    std::string number = std::to_string(sequence);
    return path_ + "/second." + std::string(10 - number.size(), '0') + number + ".checkpoint";
  }
  static std::uint64_t sequence_of(const CheckpointFolder::Found& found) {
    return found.checkpoint.info.sequence;
  }
  /// 0: there is none.
  static std::uint64_t sequence_of(const CheckpointFolder::Newest& newest) {
    return newest.checkpoint ? newest.checkpoint->info.sequence : 0;
  }

  testing::TemporaryFolder temporary_;
  std::string path_ = temporary_.path("checkpoints");
};

TEST_F(Folder, TakesTheOneBeforeADamagedOneAndSaysSo) {
  auto folder = open();
  write_seconds(*folder, 4);
  damage(4);
  damage(3);
  const auto newest = folder->newest();
  EXPECT_EQ(sequence_of(newest), 2U);
  ASSERT_THAT(newest.refused, SizeIs(2));
  EXPECT_THAT(newest.refused[0], HasSubstr("checksum"));
  EXPECT_EQ(sequence_of(folder->in_the_past_of(4, 4.0)), 2U);
}

TEST_F(Folder, EvenWhereItsHeadIsGoneAndAnotherServerReadsIt) {
  auto folder = open();
  write_seconds(*folder, 4);
  folder.reset();
  std::ofstream(file_of(4), std::ios::binary) << "nonsense";
  folder = open();
  const auto newest = folder->newest();
  EXPECT_EQ(sequence_of(newest), 3U);
  EXPECT_THAT(newest.refused, SizeIs(1));
  EXPECT_EQ(write(*folder, 5.0, 3), 5U);
}

TEST_F(Folder, WhereNoneCanBeUsedEachIsTold) {
  auto folder = open();
  write_seconds(*folder, 2);
  folder.reset();
  Identity next = kIdentity;
  next.build = "0.2.0";
  folder = open(10, next);
  write(*folder, 3.0, 0);
  write(*folder, 4.0, 3);
  damage(4);
  EXPECT_THAT(folder->newest().refused, SizeIs(1)) << "what is another build's is not missed";
  damage(3);
  const auto newest = folder->newest();
  EXPECT_FALSE(newest.checkpoint);
  const auto tells = [&](std::uint64_t sequence, const char* why) {
    return AllOf(HasSubstr(file_of(sequence)), HasSubstr(why));
  };
  EXPECT_THAT(newest.refused, ElementsAre(tells(4, "checksum"), tells(3, "checksum"),
                                          tells(2, "sutured 0.1.0, and this is 0.2.0"),
                                          tells(1, "sutured 0.1.0, and this is 0.2.0")));
}

TEST_F(Folder, KeepsTheLastOnes) {
  auto folder = open(3);
  write_seconds(*folder, 8);
  for (std::uint64_t i = 1; i <= 8; ++i) EXPECT_EQ(std::filesystem::exists(file_of(i)), i > 5) << i;
  EXPECT_EQ(sequence_of(folder->in_the_past_of(8, 0.0)), 6U);
}

TEST_F(Folder, GoesBackInTheOwnPastAfterARewind) {
  auto folder = open();
  write_seconds(*folder, 4);
  EXPECT_EQ(sequence_of(folder->in_the_past_of(4, 2.5)), 2U);
  write(*folder, 2.6, 2);  // 5: what came of going back to 2
  write(*folder, 3.6, 5);  // 6
  EXPECT_EQ(sequence_of(folder->in_the_past_of(6, 3.5)), 5U);
  EXPECT_EQ(sequence_of(folder->in_the_past_of(6, 2.5)), 2U);  // neither 3 nor 4
  folder.reset();
  folder = open();
  EXPECT_EQ(sequence_of(folder->in_the_past_of(6, 2.5)), 2U);
  EXPECT_THROW((void)folder->in_the_past_of(99, 1.0), CheckpointError);
}

/// What an earlier build wrote just after a reset names the abandoned world as its past.
TEST_F(Folder, GoesNotBackBeyondAReset) {
  auto folder = open();
  write_seconds(*folder, 4);
  write(*folder, 0.5, 4);  // 5: the first one after a reset
  write(*folder, 1.5, 5);  // 6
  EXPECT_EQ(sequence_of(folder->in_the_past_of(6, 0.7)), 5U);
  EXPECT_EQ(sequence_of(folder->in_the_past_of(6, -9.0)), 5U);
  damage(5);
  EXPECT_THROW((void)folder->in_the_past_of(6, 0.7), CheckpointError);
}

TEST_F(Folder, DeletesWhatACrashCutOffAndNobodyElsesFiles) {
  open().reset();
  for (const char* name : {"second.0000000007.checkpoint.part", "named.knot.checkpoint.part",
                           "film.mkv.part", "second.part", "x.checkpoint.part"})
    std::ofstream(path_ + "/" + name) << "half";
  open().reset();
  EXPECT_FALSE(std::filesystem::exists(path_ + "/second.0000000007.checkpoint.part"));
  EXPECT_FALSE(std::filesystem::exists(path_ + "/named.knot.checkpoint.part"));
  EXPECT_TRUE(std::filesystem::exists(path_ + "/film.mkv.part"));
  EXPECT_TRUE(std::filesystem::exists(path_ + "/second.part"));
  EXPECT_TRUE(std::filesystem::exists(path_ + "/x.checkpoint.part"));
}

/// Where the folder is gone the server goes on, and refuses.
TEST_F(Folder, AFolderThatCannotBeReadHoldsNoName) {
  const auto folder = open();
  std::filesystem::rename(path_, path_ + ".aside");
  std::filesystem::create_symlink(path_, path_);  // stat fails: too many links
  try {
    (void)folder->named("knot");
    FAIL() << "found";
  } catch (const CheckpointError& error) {
    EXPECT_THAT(error.what(), HasSubstr("there is no checkpoint \"knot\": "));
  }
}

TEST_F(Folder, KnowsHowTheLastServerEnded) {
  auto folder = open();
  EXPECT_TRUE(folder->ended());  // there was none
  write_seconds(*folder, 2);
  folder.reset();
  folder = open();
  EXPECT_FALSE(folder->ended());
  folder->note_ended();
  folder.reset();
  EXPECT_TRUE(open()->ended());
}

/// A state on which a server dies is not resumed for ever.
TEST_F(Folder, ResumesTheOneBeforeWhereAServerDiedOnTheNewest) {
  auto folder = open();
  write_seconds(*folder, 3);
  for (std::uint64_t expected : {3, 2, 1}) {
    folder.reset();
    folder = open();
    EXPECT_EQ(sequence_of(folder->newest()), expected);
    folder->note_resumed(expected);
  }
  folder.reset();
  folder = open();
  const auto none = folder->newest();
  EXPECT_FALSE(none.checkpoint);
  EXPECT_THAT(none.refused, ElementsAre(HasSubstr("refused by the server before"),
                                        HasSubstr("refused by the server before"),
                                        AllOf(HasSubstr(file_of(1)), HasSubstr("died"))));
  write(*folder, 1.5, 1);  // this one lived
  folder.reset();
  EXPECT_EQ(sequence_of(open()->newest()), 4U);
}

TEST_F(Folder, IsOneServersAlone) {
  const auto folder = open();
  try {
    (void)open();
    FAIL() << "two servers";
  } catch (const CheckpointError& error) {
    EXPECT_THAT(error.what(), HasSubstr("another server"));
  }
}

TEST_F(Folder, LeavesAnotherScenesAside) {
  auto folder = open();
  write_seconds(*folder, 3);
  folder.reset();
  Identity other = kIdentity;
  other.scene = 43;
  folder = open(2, other);
  EXPECT_FALSE(folder->newest().checkpoint);
  EXPECT_EQ(write(*folder, 0.0, 0), 4U);
  EXPECT_FALSE(std::filesystem::exists(file_of(2)));
  EXPECT_EQ(sequence_of(folder->newest()), 4U);
}

TEST_F(Folder, NamesStayInIt) {
  auto folder = open();
  folder->write("before-knot_2", {}, {});
  EXPECT_EQ(folder->named("before-knot_2").state.size(), 0U);
  for (const char* name : {"", "..", "../x", "a/b", "a.b", "a b", "ä", "/etc/passwd",
                           "a23456789012345678901234567890123"}) {
    EXPECT_NE(fault_of_name(name), "") << name;
    EXPECT_THROW(folder->write(name, {}, {}), CheckpointError) << name;
    EXPECT_THROW((void)folder->named(name), CheckpointError) << name;
  }
  EXPECT_THROW((void)folder->named("never"), CheckpointError);
}

}  // namespace
}  // namespace sutured::checkpoints
