// SPDX-License-Identifier: GPL-3.0-or-later
// `sutured serve --config FILE`: which value wins, and what is said of a bad one.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <regex>
#include <set>
#include <sstream>

#include "support/pressed_block.hpp"
#include "support/program.hpp"
#include "support/temporary_folder.hpp"
#include "support/test_session.hpp"

namespace sutured {
namespace {

using ::testing::HasSubstr;
using testing::ProgramResult;
using testing::run_program;
using ::testing::StartsWith;

const std::string kShipped = std::string(SUTURED_SOURCE_DIR) + "/server/service/sutured.toml";

class ConfigFile : public ::testing::Test {
 protected:
  /// Serves for a moment with options from a file and from the command line.
  [[nodiscard]] ProgramResult serve(const std::string& config,
                                    const std::vector<std::string>& more = {}) const {
    folder_.write("sutured.toml", config);
    std::vector<std::string> words{SUTURED_PROGRAM, "serve", "--config",
                                   folder_.path("sutured.toml")};
    words.insert(words.end(), more.begin(), more.end());
    return run_program(words);
  }
  /// Options enough to serve, by the file.
  [[nodiscard]] std::string enough() const {
    return "scene = \"" + scene_ +
           "\"\nduration = 0.05\ndomain = " + std::to_string(testing::own_session().domain) + "\n";
  }
  testing::TemporaryFolder folder_;
  std::string scene_ = testing::PressedBlock().write(folder_);
  std::string session_ = testing::own_session().session;
};

TEST_F(ConfigFile, GivesEveryOptionAndTheCommandLineWins) {
  const std::string file = enough() + "rate = 120.5\nsession = \"" + session_ + "\"\nkeep = 7\n";
  ProgramResult served = serve(file);
  EXPECT_EQ(served.exit_code, 0) << served.err;
  EXPECT_THAT(served.err, HasSubstr("at 120.5 Hz"));
  EXPECT_THAT(served.err, HasSubstr("session \"" + session_ + "\""));
  served = serve(file, {"--rate", "240"});
  EXPECT_EQ(served.exit_code, 0) << served.err;
  EXPECT_THAT(served.err, HasSubstr("at 240 Hz"));
}

TEST_F(ConfigFile, HasATableForTheServerOfASession) {
  const std::string file = enough() + "rate = 120\n[server." + session_ +
                           "]\nrate = 130\n[server.other]\nrate = 140\nhttp = \"0\"\n";
  const ProgramResult ours = serve(file, {"--session", session_});
  EXPECT_EQ(ours.exit_code, 0) << ours.err;
  EXPECT_THAT(ours.err, HasSubstr("at 130 Hz"));
  EXPECT_THAT(ours.err, ::testing::Not(HasSubstr("viewer at")));
  const ProgramResult third = serve(file, {"--session", session_ + "-b"});
  EXPECT_THAT(third.err, HasSubstr("at 120 Hz"));
}

struct Fault {
  const char* name;
  const char* text;   ///< the file
  const char* place;  ///< line:column
  const char* what;
};

class ConfigFault : public ConfigFile, public ::testing::WithParamInterface<Fault> {};

TEST_P(ConfigFault, IsOneErrorWithPlaceAndMend) {
  const ProgramResult refused = serve(GetParam().text, {"--session", session_});
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_EQ(refused.out, "");
  EXPECT_THAT(refused.err,
              StartsWith(folder_.path("sutured.toml") + ':' + GetParam().place + ": "));
  EXPECT_THAT(refused.err, HasSubstr(GetParam().what));
}

INSTANTIATE_TEST_SUITE_P(
    Faults, ConfigFault,
    ::testing::Values(Fault{"UnknownKey", "domain = 0\nrat = 5\n", "2:1",
                            "there are scene, session, domain"},
                      Fault{"NotToml", "domain = 0\nrate 5\n", "2:6", "toml.io"},
                      Fault{"OutOfRange", "rate = 5000\n", "1:8", "30 to 1000 Hz"},
                      Fault{"NoNumber", "domain = \"two\"\n", "1:10", "domain"},
                      Fault{"NoAddress", "http = \"nowhere\"\n", "1:8", "127.0.0.1:8080"},
                      Fault{"NoChoice", "resume = \"maybe\"\n", "1:10", "crash"},
                      Fault{"TwoOfOne", "scene = [\"a\", \"b\"]\n", "1:9", "without brackets"},
                      Fault{"ADate", "scene = 2026-01-01\n", "1:9", "as on the command line"},
                      Fault{"ServersAreTables", "server = \"x\"\n", "1:10", "[server.NAME]"},
                      Fault{"UnknownKeyOfAnotherServer", "[server.b]\nrat = 5\n", "2:1", "\"rat\""},
                      Fault{"ConfigInConfig", "config = \"x\"\n", "1:1", "no option \"config\""}),
    [](const auto& fault) { return std::string(fault.param.name); });

TEST_F(ConfigFile, IsNotMissing) {
  const ProgramResult refused = run_program({SUTURED_PROGRAM, "serve", "--config", "/no/file"});
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(refused.err, HasSubstr("/no/file"));
}

TEST_F(ConfigFile, ASessionServesTheSceneOfItsNameAndAMissingOneIsNamed) {
  const ProgramResult refused = serve("", {"--session", "no-such-scene"});
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(refused.err, HasSubstr("there is no scene \"no-such-scene\" in /etc/sutured/scenes"));
  const ProgramResult none = serve("");
  EXPECT_EQ(none.exit_code, 2);
  EXPECT_THAT(none.err, HasSubstr("no scene is given"));
}

/// The keys of a file, also those in comments that show a default.
std::set<std::string> keys_of(const std::string& text) {
  static const std::regex kKey("^#?([a-z-]+) = .*");
  std::set<std::string> keys;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);)
    if (std::smatch match; std::regex_match(line, match, kKey)) keys.insert(match[1]);
  return keys;
}

TEST_F(ConfigFile, TheShippedFileNamesEveryOption) {
  const std::string help = run_program({SUTURED_PROGRAM, "serve", "--help"}).out;
  static const std::regex kOption("\n  (?:-.,)?--([a-z-]+)");
  std::set<std::string> options{"scene"};
  for (std::sregex_iterator at(help.begin(), help.end(), kOption), end; at != end; ++at)
    options.insert((*at)[1]);
  options.erase("help");
  options.erase("config");
  ASSERT_GT(options.size(), 10U);
  EXPECT_EQ(keys_of(testing::read_file(kShipped)), options);
}

TEST_F(ConfigFile, TheShippedFileIsGoodAsItIsAndWithEveryLineUncommented) {
  const std::string shipped = testing::read_file(kShipped);
  // But those of the web: its door opens before the scene is read, and the files are not here.
  const std::string all =
      std::regex_replace(shipped, std::regex("(^|\n)#(?!http)(?=[a-z-]+ = |\\[)"), "$1");
  ASSERT_NE(all, shipped);
  for (const std::string& file : {shipped, all}) {
    const ProgramResult read = serve(file, {"/no/scene.toml", "--session", "class-a"});
    EXPECT_EQ(read.exit_code, 1) << read.err;  // beyond its options: the scene is missing
    EXPECT_THAT(read.err, HasSubstr("/no/scene.toml"));
  }
}

}  // namespace
}  // namespace sutured
