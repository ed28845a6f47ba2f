// SPDX-License-Identifier: GPL-3.0-or-later
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <numbers>
#include <string>

#include "support/program.hpp"
#include "support/temporary_folder.hpp"

namespace sutured {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::ProgramResult;
using ::testing::StartsWith;

const std::string kScene =
    std::string(SUTURED_SOURCE_DIR) + "/server/scenes/anastomosis/scene.toml";
const std::string kMesh =
    std::string(SUTURED_SOURCE_DIR) + "/server/scenes/anastomosis/vessels.msh";

ProgramResult sutured(std::vector<std::string> arguments) {
  arguments.insert(arguments.begin(), SUTURED_PROGRAM);
  return testing::run_program(std::move(arguments));
}

TEST(CheckCommand, ReportsOnTheCommittedScene) {
  const ProgramResult result = sutured({"check", kScene});
  EXPECT_EQ(result.exit_code, 0) << result.err;
  EXPECT_THAT(result.err, IsEmpty());
  EXPECT_THAT(result.out,
              AllOf(HasSubstr("tissue \"proximal\""),
                    HasSubstr("900 vertices, 3,240 tets, 1,320 boundary faces, 1 component\n"),
                    HasSubstr("tissue \"distal\""),
                    HasSubstr("720 vertices, 2,592 tets, 1,056 boundary faces, 1 component\n"),
                    HasSubstr("90 vertices fixed or prescribed"), HasSubstr("proximal_lumen"),
                    HasSubstr("needle \"needle\"  arc of 180°")));
}

TEST(CheckCommand, WritesTheSameAsJson) {
  const ProgramResult result = sutured({"check", kScene, "--json"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto report = nlohmann::json::parse(result.out);
  EXPECT_TRUE(report.at("ok").get<bool>());
  const auto& tissue = report.at("tissues").at(0);
  EXPECT_EQ(tissue.at("vertices"), 900);
  EXPECT_EQ(tissue.at("fixed_vertices"), 90);
  EXPECT_GT(tissue.at("radius_ratio").at("min").get<double>(), 0.1);  // no slivers
  // The tube of radii 4.5 and 6 mm as a ring of 30 chords, 20 mm long.
  const double tube = 30.0 / 2.0 * std::sin(2.0 * std::numbers::pi / 30.0) * (36.0 - 20.25) * 20e-9;
  EXPECT_NEAR(tissue.at("volume_m3").get<double>(), tube, 1e-6 * tube);
  // Between one and what eight good digits of force allow.
  EXPECT_GT(tissue.at("stiffness_condition").get<double>(), 1e2);
  EXPECT_LT(tissue.at("stiffness_condition").get<double>(), 1e8);
  EXPECT_NEAR(tissue.at("mass_kg").get<double>(), 1000.0 * tube, 1e-3 * tube);
}

TEST(CheckCommand, AsksWhichUnitAMeshIsIn) {
  const ProgramResult result = sutured({"check", kMesh, "--scale", "0.001"});
  EXPECT_EQ(result.exit_code, 0) << result.err;
  EXPECT_THAT(result.out, AllOf(HasSubstr("does not say its unit of length"),
                                HasSubstr("if millimetres  scale = 0.001"),
                                HasSubstr("12 mm × 11.9 mm × 41.5 mm"), HasSubstr("2 components")));
}

TEST(CheckCommand, TellsEachFaultWithItsPlaceAndExitsWithOne) {
  const testing::TemporaryFolder folder;
  const std::string scene = folder.write("s.toml", "name = \"x\"\nrate_hz = 1\nfoo = 2\n");
  const ProgramResult result = sutured({"check", scene});
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_THAT(result.out, IsEmpty());
  EXPECT_THAT(result.err,
              AllOf(HasSubstr(scene + ":2:11: rate_hz"),
                    HasSubstr(scene + ":3:1: unknown key \"foo\""), HasSubstr("\n3 faults\n")));
  const ProgramResult as_json = sutured({"check", scene, "--json"});
  EXPECT_EQ(as_json.exit_code, 1);
  const auto report = nlohmann::json::parse(as_json.out);
  EXPECT_FALSE(report.at("ok").get<bool>());
  ASSERT_EQ(report.at("faults").size(), 3U);
  EXPECT_EQ(report.at("faults").at(1).at("line"), 2);
  EXPECT_EQ(report.at("faults").at(1).at("column"), 11);
}

TEST(CheckCommand, WritesNamesThatAreNotUtf8AsJson) {
  const testing::TemporaryFolder folder;
  const std::string mesh =
      "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n3 1 "
      "\"b\xe9ton\"\n$EndPhysicalNames\n$Nodes\n4\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n$EndNodes\n"
      "$Elements\n1\n1 4 2 1 1 1 2 3 4\n$EndElements\n";
  const ProgramResult result =
      sutured({"check", folder.write("a.msh", mesh), "--scale", "0.01", "--json"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto report = nlohmann::json::parse(result.out);
  EXPECT_EQ(report.at("groups").at(0).at("name"), "b\xef\xbf\xbdton");
  const ProgramResult missing = sutured({"check", folder.path("\xff.msh"), "--json"});
  EXPECT_EQ(missing.exit_code, 1) << missing.err;
  EXPECT_EQ(nlohmann::json::parse(missing.out).at("faults").size(), 1U);
}

TEST(CheckCommand, RefusesAScriptNamedAsAMesh) {
  const testing::TemporaryFolder folder;
  const std::string canary = folder.path("canary");
  const std::string script =
      folder.write("a.msh", "SystemCall \"touch " + canary + "\";\n$MeshFormat\n2.2 0 8\n");
  const ProgramResult result = sutured({"check", script});
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_THAT(result.err, StartsWith(script + ": this is not a mesh"));
  EXPECT_FALSE(std::filesystem::exists(canary));
}

TEST(CheckCommand, AReportThatCannotBeWrittenIsAnError) {
  for (const std::vector<std::string>& words :
       {std::vector<std::string>{"check", kMesh}, {"check", kMesh, "--json"}, {"--help"}}) {
    std::vector<std::string> command{"sh", "-c", "exec \"$0\" \"$@\" >/dev/full", SUTURED_PROGRAM};
    command.insert(command.end(), words.begin(), words.end());
    const ProgramResult result = testing::run_program(command);
    EXPECT_EQ(result.exit_code, 1) << words[0];
    EXPECT_EQ(result.err,
              "sutured: the output could not be written: No space left on device; see to where "
              "standard output goes\n");
  }
}

TEST(CheckCommand, TellsWrongUsageByTwoAndHelpByZero) {
  EXPECT_EQ(sutured({}).exit_code, 2);
  EXPECT_EQ(sutured({"check"}).exit_code, 2);
  EXPECT_EQ(sutured({"check", kMesh, "--scale", "-1"}).exit_code, 2);
  EXPECT_EQ(sutured({"chek", kMesh}).exit_code, 2);
  const ProgramResult help = sutured({"check", "--help"});
  EXPECT_EQ(help.exit_code, 0);
  EXPECT_THAT(help.out, HasSubstr("Examples:"));
}

}  // namespace
}  // namespace sutured
