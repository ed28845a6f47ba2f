// SPDX-License-Identifier: GPL-3.0-or-later
// `sutured run` as a user runs it: the main scene, its surgeon, its files.
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <numbers>
#include <string>
#include <vector>

#include "support/program.hpp"

namespace sutured {
namespace {

const std::string kScene = SUTURED_SOURCE_DIR "/server/scenes/anastomosis/scene.toml";
const std::string kOneBite = SUTURED_SOURCE_DIR "/server/scenes/anastomosis/one_bite.csv";
const std::string kSurgeon = SUTURED_SOURCE_DIR "/server/scenes/anastomosis/surgeon.csv";

testing::ProgramResult run(std::vector<std::string> arguments) {
  arguments.insert(arguments.begin(), {SUTURED_PROGRAM, "run"});
  return testing::run_program(arguments);
}

std::vector<nlohmann::json> events(const std::string& folder) {
  std::ifstream file(folder + "/events.jsonl");
  std::vector<nlohmann::json> result;
  for (std::string line; std::getline(file, line);) result.push_back(nlohmann::json::parse(line));
  return result;
}

std::vector<std::string> course(const std::string& folder) {
  std::vector<std::string> result;
  for (const auto& event : events(folder))
    if (event["kind"] == "puncture" || event["kind"] == "exit")
      result.push_back(event["kind"].get<std::string>() + " " + event["object"].get<std::string>());
  return result;
}

TEST(RunCommand, TwiceGivesTheSameBytes) {
  const testing::TemporaryFolder first, second;
  for (const auto* folder : {&first, &second}) {
    const auto result =
        run({kScene, "--surgeon", kOneBite, "--out", folder->path("out"), "--rate", "125"});
    ASSERT_EQ(result.exit_code, 0) << result.err;
  }
  for (const char* name : {"steps.csv", "tools.csv", "events.jsonl", "final.vtk", "summary.json"}) {
    const std::string bytes = testing::read_file(first.path(std::string("out/") + name));
    EXPECT_GT(bytes.size(), 100U) << name;
    EXPECT_EQ(bytes, testing::read_file(second.path(std::string("out/") + name))) << name;
  }
}

/// The needle goes in and out of both walls at any rate, at the puncture force or a substep beyond
/// it.
TEST(RunCommand, TheCourseOfTheNeedleDoesNotDependOnTheRate) {
  const std::vector<std::string> expected{"puncture proximal", "exit proximal", "puncture distal",
                                          "exit distal"};
  for (const char* rate : {"20", "30", "60", "100", "250"}) {
    const testing::TemporaryFolder folder;
    const auto result =
        run({kScene, "--surgeon", kOneBite, "--out", folder.path("out"), "--rate", rate});
    ASSERT_EQ(result.exit_code, 0) << result.err;
    EXPECT_EQ(course(folder.path("out")), expected) << "at " << rate << " Hz";
    const auto summary = nlohmann::json::parse(testing::read_file(folder.path("out/summary.json")));
    for (const auto& puncture : summary["punctures"]) {
      EXPECT_GT(puncture["force_n"].get<double>(), 0.0499);
      EXPECT_LT(puncture["force_n"].get<double>(), 0.07);
    }
    EXPECT_LT(summary["complementarity_residual_max"].get<double>(), 1e-8);
    EXPECT_GT(summary["tools"]["driver"]["peak_force_n"].get<double>(), 0.05);
    EXPECT_LT(summary["tools"]["driver"]["peak_force_n"].get<double>(), 0.2);
  }
}

/// Eight stitches all around, 45° apart, each by both hands: what happens comes in order at any
/// rate, every hole is where its stitch belongs, and the needle is never dropped.
TEST(RunCommand, TheRunningSutureComesOutAsPlanned) {
  constexpr int kStitches = 8;
  // Stitches are placed up to 1.5° off; the rest is the hands' wobble and the walls' give.
  constexpr double kAside_deg = 6.0;
  std::vector<std::string> expected{"grasp driver needle"};
  for (int stitch = 0; stitch < kStitches; ++stitch) {
    expected.insert(expected.end(),
                    {"puncture needle proximal", "exit needle proximal", "puncture needle distal",
                     "exit needle distal", "grasp assistant needle", "release driver needle"});
    if (stitch + 1 < kStitches)
      expected.insert(expected.end(), {"grasp driver needle", "release assistant needle"});
  }
  for (const char* rate : {"60", "250"}) {
    const testing::TemporaryFolder folder;
    const auto result =
        run({kScene, "--surgeon", kSurgeon, "--out", folder.path("out"), "--rate", rate});
    ASSERT_EQ(result.exit_code, 0) << result.err;
    std::vector<std::string> happened;
    int holes = 0;
    for (const auto& event : events(folder.path("out"))) {
      const auto kind = event["kind"].get<std::string>();
      EXPECT_TRUE(kind != "grip_slip" && kind != "limit" && kind != "solver_residual") << event;
      if (kind != "grasp" && kind != "release" && kind != "puncture" && kind != "exit") continue;
      happened.push_back(kind + " " + event["subject"].get<std::string>() + " " +
                         event["object"].get<std::string>());
      if (kind != "puncture" && kind != "exit") continue;
      const double x = event["position_m"][0], y = event["position_m"][1];
      const double planned_deg = 45.0 * (holes++ / 4);
      const double aside_deg =
          std::remainder(std::atan2(y, x) * 180.0 / std::numbers::pi - planned_deg, 360.0);
      EXPECT_LT(std::abs(aside_deg), kAside_deg) << event << " at " << rate << " Hz";
    }
    EXPECT_EQ(happened, expected) << "at " << rate << " Hz";
    const auto summary = nlohmann::json::parse(testing::read_file(folder.path("out/summary.json")));
    EXPECT_FALSE(summary["needles"]["needle"]["tip_inside"].get<bool>());
    EXPECT_EQ(summary["needles"]["needle"]["embedded_length_m"].get<double>(), 0.0);
    EXPECT_LT(summary["complementarity_residual_max"].get<double>(), 1e-8);
  }
}

TEST(RunCommand, FaultsAreOneClearError) {
  const testing::TemporaryFolder folder;
  const auto missing = run({"nowhere.toml", "--surgeon", kOneBite, "--out", folder.path("out")});
  EXPECT_EQ(missing.exit_code, 1);
  EXPECT_NE(missing.err.find("nowhere.toml"), std::string::npos);

  const std::string strange = folder.path("strange.csv");
  std::ofstream(strange)
      << "time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw\n0,scalpel,0,0,0,0,0,0,1,0\n";
  const auto unknown = run({kScene, "--surgeon", strange, "--out", folder.path("out")});
  EXPECT_EQ(unknown.exit_code, 1);
  EXPECT_NE(unknown.err.find("scalpel"), std::string::npos);
  EXPECT_NE(unknown.err.find("[[tool]]"), std::string::npos);

  const auto unwritable = run({kScene, "--surgeon", kOneBite, "--out", strange + "/out"});
  EXPECT_EQ(unwritable.exit_code, 1);
  EXPECT_NE(unwritable.err.find("--out"), std::string::npos);

  const std::string far = folder.path("far.csv");
  std::ofstream(far)
      << "time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw\n0,driver,1e160,0,0,0,0,0,1,0\n";
  const auto beyond = run({kScene, "--surgeon", far, "--out", folder.path("out")});
  EXPECT_EQ(beyond.exit_code, 1);
  EXPECT_NE(beyond.err.find(far + ":2:10"), std::string::npos) << beyond.err;

  const auto endless = run({kScene, "--surgeon", "/dev/zero", "--out", folder.path("out")});
  EXPECT_EQ(endless.exit_code, 1);
  EXPECT_NE(endless.err.find("not a regular file"), std::string::npos) << endless.err;

  EXPECT_EQ(run({kScene}).exit_code, 2);
}

}  // namespace
}  // namespace sutured
