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
  EXPECT_EQ(summary.at("event_counts"), nlohmann::json({{"contact", 1}, {"taut", 1}}));
}

INSTANTIATE_TEST_SUITE_P(Anastomosis, ClosureScene,
                         ::testing::Values(Scene{"closure20", 20, 0.113},
                                           Scene{"closure50", 50, 0.057}),
                         [](const auto& scene) { return std::string(scene.param.name); });

}  // namespace
}  // namespace sutured
