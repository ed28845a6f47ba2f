// SPDX-License-Identifier: GPL-3.0-or-later
// `sutured run` as a user runs it: the main scene, its surgeon, its files.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <numbers>
#include <sstream>
#include <string>
#include <utility>
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

/// Cut where the needle is in a wall, in a hand, and where the thread is in its bites; each time in
/// another process.
TEST(RunCommand, CutInPiecesAndJoinedGivesTheSameBytes) {
  const std::array<std::vector<std::string>, 2> plays{
      std::vector<std::string>{kScene, "--surgeon", kSurgeon, "--rate", "100"},
      {SUTURED_SOURCE_DIR "/server/scenes/anastomosis/closure20.toml", "--duration", "0.6"}};
  const std::array<std::vector<std::string>, 2> cuts{
      std::vector<std::string>{"2.37", "6.1", "13", "40.01"}, {"0.1", "0.5"}};
  for (std::size_t i = 0; i < plays.size(); ++i) {
    const testing::TemporaryFolder whole, joined;
    const auto play = [&](const testing::TemporaryFolder& folder, std::vector<std::string> more) {
      std::vector<std::string> arguments = plays[i];
      arguments.insert(arguments.end(), {"--out", folder.path("out")});
      arguments.insert(arguments.end(), more.begin(), more.end());
      const auto result = run(arguments);
      ASSERT_EQ(result.exit_code, 0) << result.err;
    };
    play(whole, {});
    const std::string file = joined.path("cut.checkpoint");
    std::vector<std::string> from;
    for (const std::string& cut : cuts[i]) {
      std::vector<std::string> more{"--until", cut, "--checkpoint", file};
      more.insert(more.end(), from.begin(), from.end());
      play(joined, more);
      from = {"--from", file};
    }
    play(joined, from);
    for (const char* name :
         {"steps.csv", "tools.csv", "threads.csv", "events.jsonl", "final.vtk", "summary.json"})
      EXPECT_EQ(testing::read_file(whole.path(std::string("out/") + name)),
                testing::read_file(joined.path(std::string("out/") + name)))
          << name << " of " << plays[i][0];
  }
}

TEST(RunCommand, RefusesACheckpointThatIsNotItsOwn) {
  const testing::TemporaryFolder folder;
  const std::string file = folder.path("a.checkpoint"), out = folder.path("out");
  const std::vector<std::string> play{kScene, "--surgeon", kOneBite, "--out", out};
  const auto with = [&](std::vector<std::string> more) {
    std::vector<std::string> arguments = play;
    arguments.insert(arguments.end(), more.begin(), more.end());
    return run(arguments);
  };
  ASSERT_EQ(with({"--until", "0.2", "--checkpoint", file}).exit_code, 0);
  const auto refused = [](const testing::ProgramResult& result, const std::string& word) {
    EXPECT_EQ(result.exit_code, 1) << word;
    EXPECT_NE(result.err.find(word), std::string::npos) << result.err;
  };
  refused(with({"--from", file, "--rate", "100"}), "--rate");
  refused(with({"--from", file, "--until", "0.1"}), "behind the end");
  refused(run({SUTURED_SOURCE_DIR "/server/scenes/anastomosis/closure20.toml", "--duration", "1",
               "--out", out, "--from", file}),
          "is of scene");
  refused(run({kScene, "--surgeon", kOneBite, "--out", folder.path("other"), "--from", file}),
          "give --out");
  refused(with({"--from", kScene}), "no checkpoint");
  std::string bytes = testing::read_file(file);
  bytes[bytes.size() / 2] = static_cast<char>(bytes[bytes.size() / 2] ^ 1);
  std::ofstream(file, std::ios::binary) << bytes;
  refused(with({"--from", file}), "damaged");
}

TEST(RunCommand, RefusesACheckpointThatItCouldNotWriteBeforeTheRun) {
  const testing::TemporaryFolder folder;
  const std::string out = folder.path("out"), surgeon = folder.path("surgeon.csv");
  std::filesystem::copy_file(kOneBite, surgeon);
  const std::string before = testing::read_file(surgeon);
  for (const std::string& file : {folder.path("none/a.checkpoint"), surgeon, out + "/summary.json",
                                  out + "/../out/steps.csv", kScene}) {
    const auto result =
        run({kScene, "--surgeon", surgeon, "--out", out, "--until", "0.2", "--checkpoint", file});
    EXPECT_EQ(result.exit_code, 1) << file;
    EXPECT_NE(result.err.find("--checkpoint"), std::string::npos) << result.err;
    EXPECT_FALSE(std::filesystem::exists(out + "/steps.csv")) << "it began with " << file;
  }
  EXPECT_EQ(testing::read_file(surgeon), before);
}

TEST(RunCommand, GoesOnWithAllItsFilesOrLeavesThemAsTheyWere) {
  const testing::TemporaryFolder folder;
  const std::string out = folder.path("out"), file = folder.path("a.checkpoint");
  const std::vector<std::string> play{kScene, "--surgeon", kOneBite, "--out", out};
  const auto with = [&](std::vector<std::string> more) {
    more.insert(more.begin(), play.begin(), play.end());
    return run(more);
  };
  ASSERT_EQ(with({"--until", "0.1", "--checkpoint", file}).exit_code, 0);
  ASSERT_EQ(with({"--until", "0.3", "--from", file}).exit_code, 0);
  const std::string steps = testing::read_file(out + "/steps.csv");
  std::filesystem::resize_file(out + "/threads.csv", 3);
  EXPECT_EQ(with({"--from", file}).exit_code, 1);
  EXPECT_EQ(testing::read_file(out + "/steps.csv"), steps);
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
    EXPECT_EQ(summary["inverted_tets_max"], 0);
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
    // What the figures say of it.
    const bool at_rate = rate == std::string("250");  // the scene's
    const auto& quality = summary["quality"]["thread"];
    ASSERT_EQ(quality["bites"].size(), 2U * kStitches);
    for (const auto& bite : quality["bites"]) {
      EXPECT_GT(bite["depth_m"].get<double>(), 0.6e-3) << bite;   // through a wall of 1.5 mm, the
      EXPECT_LT(bite["depth_m"].get<double>(), 0.76e-3) << bite;  // middle is 0.75 mm deep
      // At 60 Hz one needle goes in through the rim itself, and the figure says so.
      if (at_rate) {
        EXPECT_GT(bite["edge_distance_m"].get<double>(), 2e-3) << bite;
      }
      EXPECT_GT(bite["peak_force_n"].get<double>(), 0.0499) << bite;  // the puncture force
    }
    // Eight stitches on circles of 12 and 7 mm are 4.6 and 2.7 mm apart.
    if (at_rate) {
      EXPECT_NEAR(quality["bite_spacing_m"]["mean"].get<double>(), 3.65e-3, 0.2e-3);
    }
    EXPECT_EQ(quality["handovers"], 2 * kStitches - 1);
    EXPECT_EQ(quality["needle_drops"], 0);
    // The gap of 1.5 mm is closed all around, the vessels meet there, and the thread holds them.
    EXPECT_NEAR(quality["gap_start_m"].get<double>(), 1.5e-3, 1e-9);
    const auto& wound = summary["wound"]["anastomosis"];
    EXPECT_NEAR(wound["gap_at_rest"]["mean_m"].get<double>(), 1.5e-3, 1e-9);
    EXPECT_LT(wound["gap"]["mean_m"].get<double>(), 5e-5);
    EXPECT_LT(wound["gap"]["max_m"].get<double>(), 2e-4);
    EXPECT_EQ(quality["gap_m"], wound["gap"]["max_m"]);
    EXPECT_GT(summary["contact"]["pairs_with_force"], 2 * kStitches);
    const auto& thread = summary["threads"]["thread"];
    EXPECT_GT(thread["tension_n"].get<double>(), 0.04);
    EXPECT_LT(thread["tension_n"].get<double>(), 0.08);
    EXPECT_EQ(quality["tension_n"], thread["tension_n"]);
    // Ten times a second, from slack to what is left.
    const auto& over_time = thread["tension_over_time"];
    ASSERT_GT(over_time.size(), 500U);
    EXPECT_EQ(over_time[0][1], 0.0);
    EXPECT_EQ(over_time.back()[1], thread["tension_n"]);
    EXPECT_GT(quality["peak_principal_stress_pa"].get<double>(), 2e4);
    EXPECT_LT(quality["peak_principal_stress_pa"].get<double>(), 4e4);
  }
}

/// The scene's needle is half a circle of 8 mm: every point of its course lies on it.
TEST(RunCommand, TheSummaryHoldsTheCourseOfTheNeedle) {
  const testing::TemporaryFolder folder;
  const auto result = run({kScene, "--surgeon", kOneBite, "--out", folder.path("out"), "--rate",
                           "30", "--duration", "4"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto summary = nlohmann::json::parse(testing::read_file(folder.path("out/summary.json")));
  const auto needle = summary["needles"]["needle"];
  EXPECT_DOUBLE_EQ(needle["diameter_m"].get<double>(), 0.0006);
  using Point = std::array<double, 3>;
  const auto course = needle["course_m"].get<std::vector<Point>>();
  ASSERT_EQ(course.size(), 33U);
  const auto distance = [](const Point& a, const Point& b) {
    return std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
  };
  EXPECT_NEAR(distance(course.front(), course.back()), 0.016, 1e-12);
  Point centre{};
  for (std::size_t i = 0; i < 3; ++i) centre[i] = (course.front()[i] + course.back()[i]) / 2;
  for (const Point& p : course) EXPECT_NEAR(distance(p, centre), 0.008, 1e-12);
  EXPECT_TRUE(needle["tip_inside"].get<bool>() || needle["embedded_length_m"].get<double>() > 0.0);
  EXPECT_LT(course.front()[0], 0.006) << "the tip comes first, and is in the vessel";
}

/// The numbers below `header` of a legacy VTK file, `count` of them.
std::vector<double> numbers_below(const std::string& vtk, const std::string& section,
                                  const std::string& header, std::size_t count) {
  const std::size_t begin = vtk.find(header, vtk.find(section));
  std::vector<double> result;
  if (begin == std::string::npos) return result;
  std::istringstream values(vtk.substr(begin + header.size()));
  for (double value = 0.0; result.size() < count && values >> value;) result.push_back(value);
  return result;
}

TEST(RunCommand, TheLastStateHoldsStressPerVertexAndPerTet) {
  const testing::TemporaryFolder folder;
  const auto result = run({kScene, "--surgeon", kOneBite, "--out", folder.path("out"), "--rate",
                           "30", "--duration", "4"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const std::string vtk = testing::read_file(folder.path("out/final.vtk"));
  const auto summary = nlohmann::json::parse(testing::read_file(folder.path("out/summary.json")));
  const auto stress = summary["stress"];
  const std::size_t vertices = summary["vertices"], tets = summary["tets"];
  const std::string scalars = "SCALARS von_mises_pa double 1\nLOOKUP_TABLE default\n";
  const std::string vectors = "VECTORS principal_pa double\n";
  EXPECT_EQ(
      numbers_below(vtk, "POINT_DATA", "VECTORS displacement_m double\n", 3 * vertices).size(),
      3 * vertices);
  for (const auto& [section, size] : {std::pair("POINT_DATA", vertices), {"CELL_DATA", tets}}) {
    ASSERT_NE(vtk.find(std::string(section) + " " + std::to_string(size) + "\n"),
              std::string::npos);
    const auto von_mises = numbers_below(vtk, section, scalars, size);
    const auto principal = numbers_below(vtk, section, vectors, 3 * size);
    ASSERT_EQ(von_mises.size(), size);
    ASSERT_EQ(principal.size(), 3 * size);
    double largest_principal_pa = 0.0, largest_von_mises_pa = 0.0;
    for (std::size_t i = 0; i < size; ++i) {
      const double a = principal[3 * i], b = principal[3 * i + 1], c = principal[3 * i + 2];
      ASSERT_GE(a, b);
      ASSERT_GE(b, c);
      // Eigenvalues in closed form: 1e-7 of the largest.
      ASSERT_NEAR(von_mises[i],
                  std::sqrt(((a - b) * (a - b) + (b - c) * (b - c) + (c - a) * (c - a)) / 2),
                  1e-6 * (std::abs(a) + std::abs(c)));
      largest_principal_pa = std::max(largest_principal_pa, a);
      largest_von_mises_pa = std::max(largest_von_mises_pa, von_mises[i]);
    }
    EXPECT_GT(largest_von_mises_pa, 1e3) << section;
    if (size == tets) {
      EXPECT_DOUBLE_EQ(stress["principal_max_pa"].get<double>(), largest_principal_pa);
      EXPECT_DOUBLE_EQ(stress["von_mises_max_pa"].get<double>(), largest_von_mises_pa);
    }
  }
  // At 4 s the needle is in the proximal wall only; both figures are found where it is.
  for (const char* at : {"principal_max_at", "von_mises_max_at"}) {
    EXPECT_EQ(stress[at]["tissue"], "proximal") << stress;
    EXPECT_LT(stress[at]["rest_position_m"][2].get<double>(), 0.0) << stress;
    EXPECT_GT(stress[at]["rest_position_m"][2].get<double>(), -0.01) << stress;
  }
}

/// The rims are rings of 4.5 to 6 mm and 3.5 to 5 mm, 1.5 mm apart: they face each other from 4.5
/// to 5 mm, and there the running suture closes them but for a part between its stitches.
TEST(RunCommand, TheSummaryTellsTheGapOfTheWound) {
  const testing::TemporaryFolder folder;
  const auto result =
      run({kScene, "--surgeon", kSurgeon, "--out", folder.path("out"), "--rate", "60"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto summary = nlohmann::json::parse(testing::read_file(folder.path("out/summary.json")));
  ASSERT_TRUE(summary["quality"].is_object());
  const auto& wound = summary["wound"]["anastomosis"];
  EXPECT_NEAR(wound["gap_at_rest"]["max_m"].get<double>(), 1.5e-3, 1e-5);
  EXPECT_NEAR(wound["gap_at_rest"]["mean_m"].get<double>(), 1.5e-3, 1e-5);
  EXPECT_LT(wound["gap"]["mean_m"].get<double>(), 0.5e-3);
  EXPECT_GE(wound["gap"]["max_m"].get<double>(), wound["gap"]["mean_m"].get<double>());
}

/// A scene without a name is called after its file.
TEST(RunCommand, EndsWithItsSummaryAlsoWhereANameIsNotText) {
  const testing::TemporaryFolder folder;
  std::string scene = testing::read_file(kScene);
  const auto cut = [&](const std::string& what, const std::string& by) {
    const std::size_t at = scene.find(what);
    ASSERT_NE(at, std::string::npos) << what;
    scene.replace(at, what.size(), by);
  };
  cut("name = \"anastomosis\"\n", "");
  const std::string mesh = "\"vessels.msh\"";
  for (int tissue = 0; tissue < 2; ++tissue)
    cut(mesh, '"' + std::filesystem::path(kScene).replace_filename("vessels.msh").string() + '"');
  const std::string file = folder.path("v\xff.toml");
  std::ofstream(file) << scene;
  const auto result = run({file, "--duration", "0.02", "--out", folder.path("out")});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto summary = nlohmann::json::parse(testing::read_file(folder.path("out/summary.json")));
  EXPECT_EQ(summary.at("scene"), "v\xef\xbf\xbd");
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
