// SPDX-License-Identifier: GPL-3.0-or-later
// The scenes of the paper's figure 5, by the program that a person would run.
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "support/program.hpp"

namespace sutured {
namespace {

struct Scene {
  const char* name;
  int punctures;
  double closing_tension_n;  ///< as the README of the scenes has it
};
void PrintTo(const Scene& scene, std::ostream* out) { *out << scene.name; }

class ClosureScene : public ::testing::TestWithParam<Scene> {};

TEST_P(ClosureScene, ClosesAtTheTensionOfItsReadme) {
  const testing::TemporaryFolder folder;
  const std::string scene =
      SUTURED_SOURCE_DIR "/server/scenes/anastomosis/" + std::string(GetParam().name) + ".toml";
  const testing::ProgramResult result = testing::run_program(
      {SUTURED_PROGRAM, "run", scene, "--duration", "0.5", "--out", folder.path("out"), "--quiet"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto summary = nlohmann::json::parse(testing::read_file(folder.path("out/summary.json")));
  EXPECT_EQ(summary.at("steps"), 125);
  EXPECT_EQ(summary.at("inverted_tets_max"), 0);
  EXPECT_LT(summary.at("complementarity_residual_max").get<double>(), 1e-8);
  const auto& thread = summary.at("threads").at("suture");
  EXPECT_EQ(thread.at("punctures"), GetParam().punctures);
  EXPECT_EQ(thread.at("slack_m").get<double>(), 0.0);
  // The README gives three digits.
  EXPECT_NEAR(thread.at("tension_n").get<double>(), GetParam().closing_tension_n, 0.0006);
  // The gap of 1.5 mm is closed all around.
  const auto& wound = summary.at("wound").at("anastomosis");
  EXPECT_NEAR(wound.at("gap_at_rest").at("mean_m").get<double>(), 1.5e-3, 1e-9);
  EXPECT_LT(wound.at("gap").at("mean_m").get<double>(), 5e-5);
  EXPECT_LT(wound.at("gap").at("max_m").get<double>(), 2e-4);
  const auto& quality = summary.at("quality").at("suture");
  EXPECT_EQ(quality.at("gap_m"), wound.at("gap").at("max_m"));
  EXPECT_EQ(quality.at("bites").size(), static_cast<std::size_t>(GetParam().punctures) / 2);
  for (const auto& bite : quality.at("bites"))
    EXPECT_NEAR(bite.at("edge_distance_m").get<double>(), 2e-3, 2e-5) << bite;
  EXPECT_EQ(summary.at("event_counts"), nlohmann::json({{"contact", 1}, {"taut", 1}}));
}

INSTANTIATE_TEST_SUITE_P(Anastomosis, ClosureScene,
                         ::testing::Values(Scene{"closure20", 20, 0.113},
                                           Scene{"closure50", 50, 0.057}),
                         [](const auto& scene) { return std::string(scene.param.name); });

}  // namespace
}  // namespace sutured
