// SPDX-License-Identifier: GPL-3.0-or-later
#include "protocol/dds_log.hpp"

#include <dds/dds.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <utility>
#include <vector>

namespace suture {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

class DdsLogTest : public ::testing::Test {
 protected:
  std::vector<std::string> told_;
  DdsLog log_{[this](bool error, const std::string& line) {
    told_.push_back((error ? "error: " : "warning: ") + line);
  }};
};

TEST_F(DdsLogTest, CycloneSpeaksToIt) {
  const dds_entity_t domain = dds_create_domain(
      229, "<CycloneDDS><Domain Id=\"any\"><NoSuchThing>1</NoSuchThing></Domain></CycloneDDS>");
  EXPECT_LT(domain, 0);
  EXPECT_THAT(told_, Contains(HasSubstr("NoSuchThing")));
}

TEST_F(DdsLogTest, TellsAFewLinesAPeriodAndHowManyWereLeftOut) {
  const auto begun = DdsLog::Clock::time_point(std::chrono::hours(1));
  for (int i = 0; i < 3 * DdsLog::kLines; ++i)
    log_.hear(false, "malformed packet", begun + std::chrono::milliseconds(i));
  EXPECT_EQ(told_.size(), static_cast<std::size_t>(DdsLog::kLines));
  log_.hear(true, "of the next", begun + DdsLog::kPeriod);
  ASSERT_EQ(told_.size(), static_cast<std::size_t>(DdsLog::kLines) + 2);
  EXPECT_EQ(told_[told_.size() - 2],
            "warning: " + std::to_string(2 * DdsLog::kLines) + " more lines of DDS were left out");
  EXPECT_EQ(told_.back(), "error: of the next");
}

TEST_F(DdsLogTest, SaysWhoseCertificateOpenSslDoesNotKnow) {
  const auto begun = DdsLog::Clock::time_point(std::chrono::hours(1));
  const std::string of_another =
      "Certificate not valid: error: unable to get local issuer certificate; subject: /CN=other";
  log_.hear(false, of_another, begun);
  log_.hear(false, "Certificate not valid: error: certificate revoked", begun);
  EXPECT_THAT(told_, ElementsAre("warning: " + of_another + " (certificate of another authority)",
                                 "warning: Certificate not valid: error: certificate revoked"));
}

TEST(DdsLog, WhatFailsToTellIsCounted) {
  std::vector<std::string> told;
  bool fails = true;
  DdsLog log([&](bool, const std::string& line) {
    if (std::exchange(fails, false)) throw 1;
    told.push_back(line);
  });
  const auto begun = DdsLog::Clock::time_point(std::chrono::hours(1));
  log.hear(false, "a line", begun);
  log.hear(false, "another", begun + DdsLog::kPeriod);
  EXPECT_THAT(told, ElementsAre("1 more lines of DDS were left out", "another"));
}

}  // namespace
}  // namespace suture
