// SPDX-License-Identifier: GPL-3.0-or-later
// `sutured run` as a user runs it: the main scene, its surgeon, its files.
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "support/program.hpp"

namespace sutured {
namespace {

const std::string kScene = SUTURED_SOURCE_DIR "/server/scenes/anastomosis/scene.toml";
const std::string kSurgeon = SUTURED_SOURCE_DIR "/server/scenes/anastomosis/surgeon.csv";

testing::ProgramResult run(std::vector<std::string> arguments) {
  arguments.insert(arguments.begin(), {SUTURED_PROGRAM, "run"});
  return testing::run_program(arguments);
}

std::vector<std::string> course(const std::string& folder) {
  std::ifstream file(folder + "/events.jsonl");
  std::vector<std::string> result;
  for (std::string line; std::getline(file, line);) {
    const auto event = nlohmann::json::parse(line);
    if (event["kind"] == "puncture" || event["kind"] == "exit")
      result.push_back(event["kind"].get<std::string>() + " " + event["object"].get<std::string>());
  }
  return result;
}

TEST(RunCommand, TwiceGivesTheSameBytes) {
  const testing::TemporaryFolder first, second;
  for (const auto* folder : {&first, &second}) {
    const auto result =
        run({kScene, "--surgeon", kSurgeon, "--out", folder->path("out"), "--rate", "125"});
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
        run({kScene, "--surgeon", kSurgeon, "--out", folder.path("out"), "--rate", rate});
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

/// The rims are rings of 4.5 to 6 mm and 3.5 to 5 mm, 1.5 mm apart: the outermost vertices lie 1 mm
/// beside the other ring.
TEST(RunCommand, TheSummaryTellsTheGapOfTheWound) {
  const testing::TemporaryFolder folder;
  const auto result =
      run({kScene, "--surgeon", kSurgeon, "--out", folder.path("out"), "--rate", "60"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto summary = nlohmann::json::parse(testing::read_file(folder.path("out/summary.json")));
  ASSERT_TRUE(summary["quality"].is_object());
  const auto& wound = summary["wound"]["anastomosis"];
  EXPECT_NEAR(wound["gap_at_rest"]["max_m"].get<double>(), std::hypot(1.5e-3, 1e-3), 5e-5);
  EXPECT_GT(wound["gap_at_rest"]["mean_m"].get<double>(), 1.5e-3);
  EXPECT_LT(wound["gap_at_rest"]["mean_m"].get<double>(),
            wound["gap_at_rest"]["max_m"].get<double>());
  EXPECT_GT(wound["gap"]["max_m"].get<double>(), 1e-3);
  EXPECT_NE(wound["gap"], wound["gap_at_rest"]);  // the needle is in both walls
}

TEST(RunCommand, FaultsAreOneClearError) {
  const testing::TemporaryFolder folder;
  const auto missing = run({"nowhere.toml", "--surgeon", kSurgeon, "--out", folder.path("out")});
  EXPECT_EQ(missing.exit_code, 1);
  EXPECT_NE(missing.err.find("nowhere.toml"), std::string::npos);

  const std::string strange = folder.path("strange.csv");
  std::ofstream(strange)
      << "time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw\n0,scalpel,0,0,0,0,0,0,1,0\n";
  const auto unknown = run({kScene, "--surgeon", strange, "--out", folder.path("out")});
  EXPECT_EQ(unknown.exit_code, 1);
  EXPECT_NE(unknown.err.find("scalpel"), std::string::npos);
  EXPECT_NE(unknown.err.find("[[tool]]"), std::string::npos);

  const auto unwritable = run({kScene, "--surgeon", kSurgeon, "--out", strange + "/out"});
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
