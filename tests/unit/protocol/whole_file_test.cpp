// SPDX-License-Identifier: GPL-3.0-or-later
#include "protocol/whole_file.hpp"

#include <gtest/gtest.h>

#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <system_error>

#include "support/temporary_folder.hpp"

namespace suture {
namespace {

namespace fs = std::filesystem;
using sutured::testing::read_file;
using sutured::testing::TemporaryFolder;

std::span<const std::byte> bytes(std::string_view text) { return std::as_bytes(std::span(text)); }

class WholeFileTest : public ::testing::Test {
 protected:
  TemporaryFolder folder_;
  std::string path_ = folder_.write("file", "before");
  std::string beside_ = path_ + WholeFile::kSuffix;
};

TEST_F(WholeFileTest, TakesItsPlaceAtTheEndAndNotBefore) {
  WholeFile file(path_, 0600);
  file.write(bytes("af"));
  file.write(bytes("ter"));
  EXPECT_EQ(read_file(path_), "before");
  file.commit();
  EXPECT_EQ(read_file(path_), "after");
  EXPECT_FALSE(fs::exists(beside_));
  EXPECT_EQ(fs::status(path_).permissions(), fs::perms::owner_read | fs::perms::owner_write);
}

TEST_F(WholeFileTest, GivenUpItLeavesWhatWasThere) {
  {
    WholeFile file(path_, 0600);
    file.write(bytes("half"));
  }
  EXPECT_EQ(read_file(path_), "before");
  EXPECT_FALSE(fs::exists(beside_));
}

TEST_F(WholeFileTest, FollowsNoLinkThatSomebodyLaidBesideIt) {
  const std::string other = folder_.write("other", "theirs");
  fs::create_symlink(other, beside_);
  WholeFile file(path_, 0600);
  file.write(bytes("ours"));
  file.commit();
  EXPECT_EQ(read_file(other), "theirs");
  EXPECT_EQ(read_file(path_), "ours");
  EXPECT_FALSE(fs::is_symlink(path_));
}

TEST_F(WholeFileTest, WhatCannotBeWrittenIsKnownBeforeTheWork) {
  EXPECT_THROW(WholeFile("", 0600), std::system_error);
  EXPECT_THROW(WholeFile(folder_.path(""), 0600), std::system_error) << "a folder";
  EXPECT_THROW(WholeFile(folder_.path("no/such"), 0600), std::system_error);
  fs::create_directory(beside_);
  EXPECT_THROW(WholeFile(path_, 0600), std::system_error) << "a folder in its way";
  EXPECT_EQ(read_file(path_), "before");
}

TEST_F(WholeFileTest, SameFileSeesThroughPathsAndLinks) {
  fs::create_symlink(path_, folder_.path("link"));
  EXPECT_TRUE(same_file(path_, folder_.path("link")));
  EXPECT_TRUE(same_file(path_, folder_.path("./file")));
  EXPECT_TRUE(same_file(folder_.path("new"), folder_.path("./new"))) << "neither is there yet";
  EXPECT_FALSE(same_file(path_, folder_.path("new")));
  EXPECT_FALSE(same_file("", ""));
  EXPECT_FALSE(same_file("/dev/null", "/dev/null"));
}

}  // namespace
}  // namespace suture
