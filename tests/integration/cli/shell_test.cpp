// SPDX-License-Identifier: GPL-3.0-or-later
// What a shell and a manual make of `suture --help`: the completion of bash and zsh as they are
// installed, with the shell's own helpers played by this test, and the man pages.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <sstream>
#include <string>
#include <system_error>
#include <vector>

#include "support/program.hpp"
#include "support/temporary_folder.hpp"

namespace suture {
namespace {

using sutured::testing::ProgramResult;
using sutured::testing::run_program;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsSupersetOf;
using ::testing::Not;

const std::string kFolder = std::string(SUTURED_BINARY_DIR) + "/client-sdk/cli/completion/";

bool is_here(const std::string& program) {
  try {
    run_program({program, "--version"});
    return true;
  } catch (const std::system_error&) {
    return false;
  }
}

// Both take the words of a command line, of which the last is being written, and print what they
// offer, a line each; FILES where it is any file.
constexpr const char* kBash = R"(
_init_completion() {
  words=("${typed[@]}") cword=$((${#typed[@]} - 1))
  cur=${words[cword]} prev=${words[cword - 1]}
}
_filedir() { COMPREPLY=(FILES); }
. "$1"; shift
typed=("$@")
_suture "$1"
printf '%s\n' "${COMPREPLY[@]}"
)";
constexpr const char* kZsh = R"(
# What begins with the word that is being written, as zsh itself would choose.
offer() { for word; do [[ $word == ${words[CURRENT]}* ]] && print -r -- $word; done }
compadd() { offer ${(P)2} }
_describe() { local all=(${(P)2}); offer ${all%%:*} }
_files() { print FILES }
file=$1; shift
words=("$@") CURRENT=$#
complete_it() { . $file }
complete_it
)";

class Completion : public ::testing::TestWithParam<std::string> {
 protected:
  void SetUp() override {
    if (!is_here(GetParam())) GTEST_SKIP() << GetParam() << " is not here: apt-get install it";
  }
  /// What is offered for the last one of `words`, behind `suture`.
  static std::vector<std::string> offered(std::vector<std::string> words) {
    const bool bash = GetParam() == "bash";
    std::vector<std::string> command = bash
                                           ? std::vector<std::string>{"bash", "--norc", "-c", kBash}
                                           : std::vector<std::string>{"zsh", "-f", "-c", kZsh};
    command.insert(command.end(), {"shell", kFolder + (bash ? "suture" : "_suture"), SUTURE_CLI});
    command.insert(command.end(), words.begin(), words.end());
    const ProgramResult result = run_program(command);
    EXPECT_EQ(result.err, "");
    std::vector<std::string> lines;
    std::istringstream text(result.out);
    for (std::string line; std::getline(text, line);)
      if (!line.empty()) lines.push_back(line);
    return lines;
  }
};

TEST_P(Completion, KnowsCommandsOptionsAndValues) {
  EXPECT_THAT(offered({"ke"}), ElementsAre("keys"));
  EXPECT_THAT(offered({""}), IsSupersetOf({"device", "keys", "command"}));
  EXPECT_THAT(offered({"sessions", "--dom"}), ElementsAre("--domain"));
  EXPECT_THAT(offered({"command", "rew"}), ElementsAre("rewind"));
  EXPECT_THAT(offered({"device", "--render", "dev"}), ElementsAre("device"));
  EXPECT_THAT(offered({"device", "--surgeon", ""}), ElementsAre("FILES"));
}

TEST_P(Completion, KnowsTheCommandsOfACommand) {
  EXPECT_THAT(offered({"keys", "re"}), ElementsAre("renew", "revoke"));
  EXPECT_THAT(offered({"keys", "add", "--ro"}), ElementsAre("--role"));
  EXPECT_THAT(offered({"keys", "add", "site", "name", "--ro"}), ElementsAre("--role"));
  EXPECT_THAT(offered({"keys", "renew", "--"}), AllOf(Contains("--days"), Not(Contains("--role"))));
  EXPECT_THAT(offered({"keys", "init", "--protection", "si"}), ElementsAre("sign"));
  EXPECT_THAT(offered({"keys", "add", ""}), ElementsAre("FILES")) << "the site";
  EXPECT_THAT(offered({"keys", "ad", ""}), ElementsAre("FILES")) << "no such command";
}

INSTANTIATE_TEST_SUITE_P(Shells, Completion, ::testing::Values("bash", "zsh"),
                         [](const auto& shell) { return shell.param; });

TEST(Manual, OfACommandTellsTheOptionsOfItsCommands) {
  if (!is_here("help2man")) GTEST_SKIP() << "help2man is not here: apt-get install help2man";
  const sutured::testing::TemporaryFolder folder;
  const ProgramResult made = run_program(
      {std::string(SUTURED_SOURCE_DIR) + "/docs/man/make.sh", folder.path("man"), SUTURE_CLI});
  ASSERT_EQ(made.exit_code, 0) << made.err;
  const std::string keys = sutured::testing::read_file(folder.path("man/suture-keys.1"));
  for (const char* heading : {"keys init [OPTIONS] site:", "keys add [OPTIONS] site name:",
                              "keys renew [OPTIONS] site name:", "keys revoke [OPTIONS] site name:",
                              "keys list [OPTIONS] site:"})
    EXPECT_THAT(keys, HasSubstr(std::string(".SS \"suture ") + heading + "\"\n"));
  for (const char* option : {"role", "tool", "days", "protection", "title"})
    EXPECT_THAT(keys, HasSubstr(std::string("\n\\fB\\-\\-") + option + "\\fR"));
  EXPECT_THAT(keys, AllOf(HasSubstr("EXIT STATUS"), HasSubstr(".SH EXAMPLES")));
}

}  // namespace
}  // namespace suture
