// SPDX-License-Identifier: GPL-3.0-or-later
#include "protocol/surgeon.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace suture {
namespace {

using ::testing::HasSubstr;
using ::testing::StartsWith;

const std::string kHeader = "time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw\n";

Surgeon parse(const std::string& rows) { return parse_surgeon(kHeader + rows, "s.csv"); }

TEST(Surgeon, InterpolatesPositionsAndJawLinearly) {
  const Surgeon surgeon = parse("0,a,0,0,0,0,0,0,1,0\n2,a,0.2,-0.4,1,0,0,0,1,1\n");
  const SurgeonPose pose = surgeon.track("a")->at(0.5);
  EXPECT_NEAR(pose.position_m[0], 0.05, 1e-15);
  EXPECT_NEAR(pose.position_m[1], -0.1, 1e-15);
  EXPECT_NEAR(pose.position_m[2], 0.25, 1e-15);
  EXPECT_NEAR(pose.jaw, 0.25, 1e-15);
}

TEST(Surgeon, TurnsAtConstantSpeed) {
  // From none to 90° about z: after a third of the time, 30°.
  const double h = std::sqrt(0.5);
  const Surgeon surgeon = parse("0,a,0,0,0,0,0,0,1,0\n3,a,0,0,0,0,0," + std::to_string(h) + "," +
                                std::to_string(h) + ",0\n");
  const SurgeonPose pose = surgeon.tracks[0].at(1.0);
  const double angle = 30.0 * std::numbers::pi / 180.0;
  EXPECT_NEAR(pose.orientation_xyzw[2], std::sin(angle / 2), 1e-6);  // six digits in the text
  EXPECT_NEAR(pose.orientation_xyzw[3], std::cos(angle / 2), 1e-6);
}

TEST(Surgeon, TurnsTheShorterWay) {
  const Surgeon surgeon = parse("0,a,0,0,0,0,0,0,1,0\n1,a,0,0,0,0,0,0.0,-1,0\n");
  const SurgeonPose pose = surgeon.tracks[0].at(0.5);
  EXPECT_NEAR(std::abs(pose.orientation_xyzw[3]), 1.0, 1e-12);  // the same rotation: no turn
}

TEST(Surgeon, StandsStillBeforeAndAfter) {
  const Surgeon surgeon = parse("1,a,1,0,0,0,0,0,1,0\n2,a,2,0,0,0,0,0,1,0\n");
  EXPECT_EQ(surgeon.tracks[0].at(-5.0).position_m[0], 1.0);
  EXPECT_EQ(surgeon.tracks[0].at(9.0).position_m[0], 2.0);
  EXPECT_EQ(surgeon.tracks[0].at(2.0).position_m[0], 2.0);
}

TEST(Surgeon, KeepsToolsApart) {
  const Surgeon surgeon = parse(
      "0,a,1,0,0,0,0,0,1,0\n0,b,2,0,0,0,0,0,1,0\n# a pause\n\n1,b,3,0,0,0,0,0,1,0\r\n0.5, a "
      ",4,0,0,0,0,0,1,0");
  ASSERT_EQ(surgeon.tracks.size(), 2U);
  EXPECT_EQ(surgeon.tracks[0].tool, "a");
  EXPECT_EQ(surgeon.track("a")->end_s(), 0.5);
  EXPECT_EQ(surgeon.track("b")->at(0.5).position_m[0], 2.5);
  EXPECT_EQ(surgeon.track("c"), nullptr);
  EXPECT_EQ(surgeon.end_s(), 1.0);
}

struct Fault {
  std::string rows;
  std::string place;
  std::string says;
  friend void PrintTo(const Fault& fault, std::ostream* out) { *out << fault.rows; }
};

class SurgeonFault : public ::testing::TestWithParam<Fault> {};

TEST_P(SurgeonFault, IsNamedWithLineAndColumn) {
  try {
    parse(GetParam().rows);
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::kBadInput);
    EXPECT_THAT(error.cause(), StartsWith("s.csv:" + GetParam().place + ": "));
    EXPECT_THAT(error.cause(), HasSubstr(GetParam().says));
    EXPECT_FALSE(error.mend().empty());
  }
}

INSTANTIATE_TEST_SUITE_P(Of, SurgeonFault,
                         ::testing::Values(Fault{"0,a,0,0,0,0,0,0,1\n", "2:18", "jaw is missing"},
                                           Fault{"0,a,0,0,0,0,0,0,1,0,9\n", "2:21", "too many"},
                                           Fault{"0,a,0,zero,0,0,0,0,1,0\n", "2:7", "py_m"},
                                           Fault{"0,a,0,1.0x,0,0,0,0,1,0\n", "2:7", "1.0x"},
                                           Fault{"0,a,nan,0,0,0,0,0,1,0\n", "2:5", "nan"},
                                           Fault{"inf,a,0,0,0,0,0,0,1,0\n", "2:1", "time_s"},
                                           Fault{"-1,a,0,0,0,0,0,0,1,0\n", "2:1", "negative"},
                                           Fault{"0,a,,0,0,0,0,0,1,0\n", "2:5", "px_m"},
                                           Fault{"0,a,0,0,0, 0,0,0,2,0\n", "2:12", "quaternion"},
                                           Fault{"0,a,0,0,0,0,0,0,0,0\n", "2:11", "quaternion"},
                                           Fault{"0,a,0,0,0,0,0,0,1,1.5\n", "2:19", "jaw"},
                                           Fault{"0,,0,0,0,0,0,0,1,0\n", "2:3", "name"},
                                           Fault{"0,a,0,0,0,0,0,0,1,0\n0,a,0,0,0,0,0,0,1,0\n",
                                                 "3:1", "increase"},
                                           Fault{"", "1:1", "no rows"}));

TEST(Surgeon, WantsItsHeader) {
  try {
    static_cast<void>(parse_surgeon("time_s,tool,x,y,z\n", "s.csv"));
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_THAT(error.cause(), StartsWith("s.csv:1:13: "));
  }
}

TEST(Surgeon, NamesAByteOrderMark) {
  try {
    static_cast<void>(parse_surgeon("\xEF\xBB\xBF" + kHeader + "0,a,0,0,0,0,0,0,1,0\n", "s.csv"));
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("s.csv:1:1: the file begins with a byte order mark"));
    EXPECT_THAT(error.mend(), HasSubstr("UTF-8 without one"));
  }
}

TEST(Surgeon, NamesAFileThatCannotBeRead) {
  try {
    static_cast<void>(read_surgeon("/no/such/file.csv"));
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_THAT(error.cause(), HasSubstr("/no/such/file.csv"));
    EXPECT_THAT(error.cause(), HasSubstr("No such file"));
  }
}

TEST(Surgeon, IsWrittenAsItReads) {
  // Numbers that no short decimal gives, rows of two tools among each other.
  const Surgeon before = parse(
      "0,a,0.1,0.2,0.30000000000000004,0,0,0,1,0.3333333333333333\n"
      "0.004,b,1e-9,-2,3,0.5,0.5,0.5,0.5,1\n0.012,a,0,0,0,0.6,0,0,0.8,0\n"
      "0.008,b,0,0,0,0,0,0,1,1\n");
  const std::string text = surgeon_text(before);
  EXPECT_THAT(text, HasSubstr("\n0.008,b,"));
  const Surgeon after = parse_surgeon(text, "again.csv");
  ASSERT_EQ(after.tracks.size(), 2U);
  for (std::size_t t = 0; t < 2; ++t) {
    EXPECT_EQ(after.tracks[t].tool, before.tracks[t].tool);
    ASSERT_EQ(after.tracks[t].rows.size(), before.tracks[t].rows.size());
    for (std::size_t r = 0; r < 2; ++r) {
      const SurgeonRow& got = after.tracks[t].rows[r];
      const SurgeonRow& wanted = before.tracks[t].rows[r];
      EXPECT_EQ(got.time_s, wanted.time_s);
      EXPECT_EQ(got.pose.position_m, wanted.pose.position_m);
      EXPECT_EQ(got.pose.jaw, wanted.pose.jaw);
      for (int i = 0; i < 4; ++i)
        EXPECT_DOUBLE_EQ(got.pose.orientation_xyzw[i], wanted.pose.orientation_xyzw[i]);
    }
  }
}

}  // namespace
}  // namespace suture
