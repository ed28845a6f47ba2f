// SPDX-License-Identifier: GPL-3.0-or-later
// `sutured serve` as a service manager sees it, at the real socket and on the real log.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <sstream>

#include "protocol/rendezvous.hpp"
#include "support/client_options.hpp"
#include "support/halted_thread.hpp"
#include "support/notify_socket.hpp"
#include "support/pressed_block.hpp"
#include "support/process.hpp"
#include "support/program.hpp"
#include "support/temporary_folder.hpp"
#include "support/test_session.hpp"
#include "suture/session.hpp"

namespace sutured {
namespace {

using testing::eventually;
using testing::HaltedThread;
using ::testing::HasSubstr;
using testing::Process;
using ::testing::StartsWith;

constexpr const char* kWatchdog = "WATCHDOG=1";

class Service : public ::testing::Test {
 protected:
  [[nodiscard]] std::vector<std::string> command(const std::string& scene) const {
    return {"env",
            notify_.environment(),
            "WATCHDOG_USEC=600000",
            SUTURED_PROGRAM,
            "serve",
            scene,
            "--domain",
            std::to_string(session_.domain),
            "--session",
            session_.session};
  }
  [[nodiscard]] suture::SessionOptions session_options() const {
    return testing::client_options(session_);
  }
  bool watchdog_comes() {
    return eventually([this] { return notify_.receive().find(kWatchdog) != std::string::npos; });
  }

  suture::ParticipantOptions session_ = testing::own_session();
  testing::TemporaryFolder folder_;
  std::string scene_ = testing::PressedBlock().write(folder_);
  testing::NotifySocket notify_;
};

TEST_F(Service, IsReadyWhenAClientFindsIt) {
  Process server(command(scene_));
  const std::string message = notify_.receive();
  ASSERT_THAT(message, StartsWith("READY=1\n"));
  EXPECT_THAT(message, HasSubstr("STATUS=serving scene \"block\""));
  const suture::Participant client(session_, suture::Channel::kControl);
  const suture::ServerInfo found = suture::await_server(client, std::chrono::seconds(20));
  EXPECT_EQ(found.pid, server.pid());
}

TEST_F(Service, IsNeverReadyWhereItCannotServe) {
  Process none(command("/nowhere/scene.toml"));
  EXPECT_EQ(none.wait(), 1);
  EXPECT_EQ(notify_.receive(std::chrono::milliseconds(0)), "");
}

TEST_F(Service, SaysThatItStopsBeforeItEnds) {
  Process server(command(scene_));
  ASSERT_THAT(notify_.receive(), StartsWith("READY=1"));
  server.send(SIGTERM);
  EXPECT_EQ(server.wait(), 0) << server.output();
  EXPECT_EQ(notify_.take_all("STOPPING=1"), 1);
}

class ServiceWatchdog : public Service, public ::testing::WithParamInterface<const char*> {};

// Status is sent by a thread of its own, so that it counts time in which the server lives.
TEST_P(ServiceWatchdog, FallsSilentWhileALoopHangsAndTheRestLives) {
  Process server(command(scene_));
  ASSERT_THAT(notify_.receive(), StartsWith("READY=1"));
  ASSERT_TRUE(watchdog_comes()) << server.output();
  ASSERT_TRUE(watchdog_comes());
  suture::Session session(session_options());
  {
    const HaltedThread hung(server.pid(), GetParam());
    notify_.take_all("");
    for (int heard = 0; heard < 6;)
      if (session.next_status(std::chrono::seconds(20))) ++heard;
    // One may have been due already.
    EXPECT_LE(notify_.take_all(kWatchdog), 1);
  }
  EXPECT_TRUE(watchdog_comes()) << "the claim above is empty";
}

INSTANTIATE_TEST_SUITE_P(Loops, ServiceWatchdog, ::testing::Values("simulation", "supervisor"),
                         [](const auto& loop) { return std::string(loop.param); });

TEST_F(Service, KeepsItsWatchdogThroughAPause) {
  Process server(command(scene_));
  ASSERT_THAT(notify_.receive(), StartsWith("READY=1"));
  suture::Session session(session_options());
  session.command(suture::CommandKind::kPause);
  ASSERT_TRUE(eventually([&] { return session.status().state == "paused"; }));
  notify_.take_all("");
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(watchdog_comes());
}

/// A command whose standard error is what JOURNAL_STREAM names, as systemd sets it up.
std::vector<std::string> in_journal(const std::vector<std::string>& command) {
  std::vector<std::string> words{
      "sh", "-c", "JOURNAL_STREAM=$(stat -L -c %d:%i /proc/self/fd/2) exec \"$@\"", "sh"};
  words.insert(words.end(), command.begin(), command.end());
  return words;
}

TEST_F(Service, LogsToTheJournalWithLevels) {
  Process server(in_journal(command(scene_)));
  ASSERT_THAT(notify_.receive(), StartsWith("READY=1"));
  server.send(SIGTERM);
  EXPECT_EQ(server.wait(), 0);
  EXPECT_THAT(server.output(), HasSubstr("<6>serving scene \"block\""));
  EXPECT_THAT(server.output(), HasSubstr("<6>stopping, terminated"));
  std::istringstream lines(server.output());
  for (std::string line; std::getline(lines, line);)
    EXPECT_TRUE(line.size() > 3 && line[0] == '<' && line[2] == '>') << line;
}

TEST_F(Service, LogsEachLineOfAFailureAsAnError) {
  for (const std::vector<std::string>& words :
       {command("/nowhere/scene.toml"),
        std::vector<std::string>{SUTURED_PROGRAM, "serve", "--rate"}}) {
    Process server(in_journal(words));
    EXPECT_NE(server.wait(), 0);
    std::istringstream lines(server.output());
    int count = 0;
    for (std::string line; std::getline(lines, line); ++count) EXPECT_THAT(line, StartsWith("<3>"));
    EXPECT_GT(count, 0);
  }
}

TEST_F(Service, LogsElsewhereWithoutThem) {
  // Inherited from a service that is not ours.
  std::vector<std::string> words = command(scene_);
  words.insert(words.begin() + 1, "JOURNAL_STREAM=1:1");
  Process server(words);
  ASSERT_THAT(notify_.receive(), StartsWith("READY=1"));
  server.send(SIGTERM);
  EXPECT_EQ(server.wait(), 0);
  EXPECT_THAT(server.output(), HasSubstr("serving scene"));
  EXPECT_THAT(server.output(), ::testing::Not(HasSubstr("<6>")));
}

/// The unit as it is installed, with the program it names.
class Unit : public ::testing::Test {
 protected:
  void SetUp() override {
    try {
      testing::run_program({"systemd-analyze", "--version"});
    } catch (const std::system_error&) {
      GTEST_SKIP() << "systemd-analyze is not here: apt-get install systemd";
    }
    const auto installed =
        testing::run_program({CMAKE_PROGRAM, "--install", SUTURED_BINARY_DIR, "--component",
                              "server", "--prefix", folder_.path("usr")});
    ASSERT_EQ(installed.exit_code, 0) << installed.err;
  }
  testing::TemporaryFolder folder_;
  std::string unit_ = folder_.path("usr/lib/systemd/system/sutured@anastomosis.service");
  std::string template_ = folder_.path("usr/lib/systemd/system/sutured@.service");
};

TEST_F(Unit, IsWhatSystemdUnderstands) {
  const auto verified = testing::run_program({"systemd-analyze", "verify", "--man=no", unit_});
  EXPECT_EQ(verified.exit_code, 0);
  EXPECT_EQ(verified.err, "");
  EXPECT_THAT(testing::read_file(template_), ::testing::Not(HasSubstr("@SUTURED")));
}

// Without them the force threads run as ordinary ones, in memory that may be paged out.
TEST_F(Unit, LetsTheForcesHaveRealTimeAndLockedMemory) {
  const std::string unit = testing::read_file(template_);
  for (const char* limit : {"\nLimitRTPRIO=80\n", "\nLimitMEMLOCK=infinity\n"})
    EXPECT_THAT(unit, HasSubstr(limit));
}

TEST_F(Unit, IsShutInAsFarAsItCanBe) {
  // Tenths of systemd's points from 0 to 100; what is left is the network, real time and the
  // gateway's choice of addresses.
  const auto graded = testing::run_program(
      {"systemd-analyze", "security", "--offline=yes", "--no-pager", "--threshold=20", template_});
  EXPECT_EQ(graded.exit_code, 0) << graded.out;
  const std::size_t verdict = graded.out.rfind("Overall exposure");
  ASSERT_NE(verdict, std::string::npos) << graded.out << graded.err;
  std::printf("%s", graded.out.substr(verdict).c_str());
}

}  // namespace
}  // namespace sutured
