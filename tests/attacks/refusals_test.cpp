// SPDX-License-Identifier: GPL-3.0-or-later
// What people are told: real processes, keys by `suture keys`, each refusal with its cause.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <csignal>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "keys/site.hpp"
#include "support/process.hpp"
#include "support/temporary_folder.hpp"
#include "support/test_session.hpp"
#include "support/web_client.hpp"

namespace sutured {
namespace {

using ::testing::HasSubstr;
using testing::own_session;
using testing::Process;

struct Said {
  int code = 0;
  std::string text;
};

Said run(const std::vector<std::string>& command) {
  Process process(command);
  const int code = process.wait();
  return {code, process.output()};
}

class Refusals : public ::testing::Test {
 protected:
  Refusals() {
    EXPECT_EQ(keys({"init", site_}).code, 0);
    add("server", {"--role", "server"});
    add("driver", {"--role", "device", "--tool", "driver"});
    add("viewer", {"--role", "viewer"});
    add("teacher", {"--role", "operator", "--role", "viewer"});
  }

  static Said keys(std::vector<std::string> words) {
    words.insert(words.begin(), {SUTURE_CLI, "keys"});
    return run(words);
  }
  void add(const std::string& name, std::vector<std::string> rights) const {
    rights.insert(rights.begin(), {"add", site_, name});
    const Said said = keys(rights);
    EXPECT_EQ(said.code, 0) << said.text;
  }
  [[nodiscard]] std::string folder(const std::string& name) const {
    return site_ + "/identities/" + name;
  }
  void serve(const std::string& security, const std::vector<std::string>& options = {}) {
    std::vector<std::string> words{SUTURED_PROGRAM, "serve",
                                   SUTURED_SOURCE_DIR "/server/scenes/anastomosis/scene.toml"};
    words.insert(words.end(), options.begin(), options.end());
    server_ = std::make_unique<Process>(in_session(words, security));
    server_->read_until("serving scene");
  }
  static std::vector<std::string> in_session(std::vector<std::string> words,
                                             const std::string& security) {
    for (const std::string& word :
         {std::string("--domain"), std::to_string(own_session().domain), std::string("--session"),
          own_session().session, std::string("--security"), security})
      words.push_back(word);
    return words;
  }
  static Said suture(std::vector<std::string> words, const std::string& security) {
    words.insert(words.begin(), SUTURE_CLI);
    return run(in_session(words, security));
  }

  testing::TemporaryFolder folder_;
  std::string site_ = folder_.path("site");
  std::unique_ptr<Process> server_;
};

TEST_F(Refusals, EachRoleDoesItsPartAndNoOther) {
  serve(folder("server"));
  const std::string hands = folder_.write("hands.csv",
                                          "time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw\n"
                                          "0,driver,0,0,0.05,0,0,0,1,0\n"
                                          "0.3,driver,0,0,0.05,0,0,0,1,0\n");
  const Said plays = suture({"device", "--surgeon", hands, "--timeout", "30"}, folder("driver"));
  EXPECT_EQ(plays.code, 0) << plays.text;
  const Said sees = suture({"top", "--once", "--timeout", "30"}, folder("viewer"));
  EXPECT_EQ(sees.code, 0) << sees.text;
  const Said commands = suture({"command", "pause", "--timeout", "30"}, folder("teacher"));
  EXPECT_EQ(commands.code, 0) << commands.text;

  const Said may_not = suture({"command", "pause", "--timeout", "30"}, folder("viewer"));
  EXPECT_EQ(may_not.code, 6) << may_not.text;
  EXPECT_THAT(may_not.text, HasSubstr("Not Allowed By Security"));
  const Said no_tool = suture({"device", "--surgeon", hands, "--timeout", "30"}, folder("viewer"));
  EXPECT_EQ(no_tool.code, 6) << no_tool.text;
  EXPECT_THAT(no_tool.text, HasSubstr("give no right to the tool \"driver\""));
}

// It takes part a second time, with receive threads of its own and the server's keys.
TEST_F(Refusals, WebClientsSeeASecuredScene) {
  add("here", {"--role", "server", "--domain", std::to_string(own_session().domain), "--session",
               own_session().session});
  const std::string hands = folder_.write("hands.csv",
                                          "time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw\n"
                                          "0,driver,0,0,0.05,0,0,0,1,0\n"
                                          "600,driver,0,0,0.05,0,0,0,1,0\n");
  for (const char* keys_of_server : {"server", "here"}) {
    SCOPED_TRACE(keys_of_server);
    serve(folder(keys_of_server), {"--http", "0"});
    testing::WebClient page(testing::port_of(server_->read_until("/\n")));
    page.subscribe(1, "suture/mesh/frame");
    page.subscribe(2, "suture/tool/pose");
    Process device(in_session({SUTURE_CLI, "device", "--surgeon", hands}, folder("driver")));
    bool frame = false, pose = false;
    while (!frame || !pose) {
      const auto message = page.wait();
      ASSERT_TRUE(message) << "the server has gone";
      if (message->text) continue;
      frame |= message->bytes[1] == 1;
      pose |= message->bytes[1] == 2;
    }
    device.send(SIGINT);
    device.wait();
    server_->send(SIGTERM);
    EXPECT_EQ(server_->wait(), 0) << server_->output();
  }
}

TEST_F(Refusals, OtherKeysAreRefusedAndTheCauseIsSaid) {
  const std::string elsewhere = folder_.path("elsewhere");
  ASSERT_EQ(keys({"init", elsewhere}).code, 0);
  ASSERT_EQ(keys({"add", elsewhere, "stranger", "--role", "viewer"}).code, 0);
  serve(folder("server"));
  const Said said = suture({"top", "--once"}, elsewhere + "/identities/stranger");
  EXPECT_EQ(said.code, 3) << said.text;
  EXPECT_THAT(said.text, HasSubstr("to the keys of \"stranger\""));
  // Whoever is asked for a handshake looks first, and says so: the server, or the client itself.
  // Which of them follows from their names alone: of this one the client, of "other" the server.
  EXPECT_THAT(said.text, HasSubstr("Certificate not valid"));
  ASSERT_EQ(keys({"add", elsewhere, "other", "--role", "viewer"}).code, 0);
  EXPECT_EQ(suture({"top", "--once"}, elsewhere + "/identities/other").code, 3);
  server_->send(SIGTERM);
  server_->wait();
  EXPECT_THAT(server_->output(),
              HasSubstr("CN=other(code: 200) (certificate of another authority)"));
}

TEST_F(Refusals, ARevokedIdentityIsRefusedByWhoKnows) {
  std::filesystem::copy(folder("viewer"), folder_.path("stolen"));
  EXPECT_EQ(keys({"revoke", site_, "viewer"}).code, 0);
  const Said own = suture({"top", "--once"}, folder("viewer"));
  EXPECT_EQ(own.code, 6) << own.text;
  EXPECT_THAT(own.text, HasSubstr("is revoked"));
  serve(folder("server"));
  EXPECT_EQ(suture({"top", "--once"}, folder_.path("stolen")).code, 3);
  EXPECT_THAT(server_->read_until("CN=viewer"), HasSubstr("revoked"));
  EXPECT_THAT(keys({"list", site_}).text, HasSubstr("revoked"));
}

TEST_F(Refusals, KeysOfBeforeARenewalMayBeRevokedWithoutTheName) {
  std::filesystem::copy(folder("viewer"), folder_.path("stolen"));
  const Said renewed = keys({"renew", site_, "viewer", "--revoke-old"});
  EXPECT_EQ(renewed.code, 0) << renewed.text;
  EXPECT_THAT(renewed.text, HasSubstr("the keys that it had are revoked: copy " + site_));
  serve(folder("server"));
  const Said own = suture({"top", "--once", "--timeout", "30"}, folder("viewer"));
  EXPECT_EQ(own.code, 0) << own.text;
  EXPECT_EQ(suture({"top", "--once"}, folder_.path("stolen")).code, 3);
  EXPECT_THAT(server_->read_until("CN=viewer"), HasSubstr("revoked"));
  EXPECT_THAT(keys({"renew", site_, "viewer"}).text, HasSubstr("hold until they expire"));
}

TEST_F(Refusals, WhoIsRevokedWhileTheServerRunsIsRefusedOnceItStartsAgain) {
  const std::vector<std::string> keeps{"--checkpoints", folder_.path("checkpoints")};
  serve(folder("server"), keeps);
  std::filesystem::copy(folder("viewer"), folder_.path("stolen"));
  EXPECT_EQ(suture({"top", "--once", "--timeout", "30"}, folder_.path("stolen")).code, 0);
  EXPECT_EQ(keys({"revoke", site_, "viewer"}).code, 0);
  server_->send(SIGTERM);
  server_->wait();
  // It goes on where it was, since it is told to: it ended as asked.
  serve(folder("server"), {keeps[0], keeps[1], "--resume", "always"});
  EXPECT_THAT(server_->output(), HasSubstr("resumed at"));
  EXPECT_EQ(suture({"top", "--once"}, folder_.path("stolen")).code, 3);
  EXPECT_THAT(server_->read_until("CN=viewer"), HasSubstr("revoked"));
  const Said others = suture({"top", "--once", "--timeout", "30"}, folder("teacher"));
  EXPECT_EQ(others.code, 0) << others.text;
}

// What runs out ends what runs, on both sides, and new keys are let in by the same server.
TEST_F(Refusals, KeysThatExpireEndTheConnection) {
  serve(folder("server"));
  const std::string brief =
      suture::keys::Site(site_).add("brief", {{suture::keys::Role::kDevice}, {"driver"}, -1, ""},
                                    /*seconds=*/10);
  const std::string hands = folder_.write("hands.csv",
                                          "time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw\n"
                                          "0,driver,0,0,0.05,0,0,0,1,0\n"
                                          "600,driver,0,0,0.05,0,0,0,1,0\n");
  const Said said = suture({"device", "--surgeon", hands}, brief);
  EXPECT_EQ(said.code, 3) << said.text;
  EXPECT_THAT(said.text, HasSubstr("rendering")) << "it was never served";
  EXPECT_THAT(said.text, HasSubstr("server_silent"));
  EXPECT_THAT(said.text, HasSubstr("the server has not answered"));
  const Said expired = suture({"top", "--once"}, brief);
  EXPECT_EQ(expired.code, 6) << expired.text;
  EXPECT_THAT(expired.text, HasSubstr("expired"));

  EXPECT_EQ(keys({"renew", site_, "brief"}).code, 0);
  const std::string glance = folder_.write("glance.csv",
                                           "time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw\n"
                                           "0,driver,0,0,0.05,0,0,0,1,0\n"
                                           "0.3,driver,0,0,0.05,0,0,0,1,0\n");
  const Said renewed = suture({"device", "--surgeon", glance, "--timeout", "30"}, brief);
  EXPECT_EQ(renewed.code, 0) << renewed.text;
}

TEST_F(Refusals, AnUnsecuredServerIsNamedSo) {
  serve("off");
  const Said said = suture({"top", "--once"}, folder("viewer"));
  EXPECT_EQ(said.code, 6) << said.text;
  EXPECT_THAT(said.text, HasSubstr("is not secured"));
}

TEST_F(Refusals, ASecuredServerDoesNotAnswerTheUnsecured) {
  serve(folder("server"));
  const Said said = suture({"top", "--once"}, "off");
  EXPECT_EQ(said.code, 3) << said.text;
  EXPECT_THAT(said.text, HasSubstr("answers only with --security"));
}

TEST_F(Refusals, TheEnvironmentDoesWhatTheOptionDoes) {
  setenv("SUTURE_SECURITY", folder("nobody").c_str(), 1);
  const Said said = run({SUTURE_CLI, "top", "--once"});
  unsetenv("SUTURE_SECURITY");
  EXPECT_EQ(said.code, 6) << said.text;
  EXPECT_THAT(said.text, HasSubstr("there is no folder of keys"));
}

TEST_F(Refusals, TheEnvironmentGetsEachServed) {
  const std::vector<std::string> here{"--domain", std::to_string(own_session().domain), "--session",
                                      own_session().session};
  const auto with_keys_of = [&](const std::string& name, std::vector<std::string> words) {
    words.insert(words.begin(), {"env", "SUTURE_SECURITY=" + folder(name)});
    words.insert(words.end(), here.begin(), here.end());
    return words;
  };
  server_ = std::make_unique<Process>(with_keys_of(
      "server",
      {SUTURED_PROGRAM, "serve", SUTURED_SOURCE_DIR "/server/scenes/anastomosis/scene.toml"}));
  server_->read_until("serving scene");
  const std::string hands = folder_.write("hands.csv",
                                          "time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw\n"
                                          "0,driver,0,0,0.05,0,0,0,1,0\n"
                                          "0.3,driver,0,0,0.05,0,0,0,1,0\n");
  const Said plays =
      run(with_keys_of("driver", {SUTURE_CLI, "device", "--surgeon", hands, "--timeout", "30"}));
  EXPECT_EQ(plays.code, 0) << plays.text;
  const Said sees = run(with_keys_of("viewer", {SUTURE_CLI, "top", "--once", "--timeout", "30"}));
  EXPECT_EQ(sees.code, 0) << sees.text;
  // It was the environment: without it nobody answers.
  std::vector<std::string> bare{SUTURE_CLI, "top", "--once"};
  bare.insert(bare.end(), here.begin(), here.end());
  EXPECT_EQ(run(bare).code, 3);
}

TEST_F(Refusals, TheDoctorTellsOfKeysThatEndSoon) {
  add("short", {"--role", "viewer", "--days", "3"});
  const auto doctor = [&](const std::string& name) {
    return run({SUTURE_CLI, "doctor", "--no-network", "--seconds", "0.2", "--security",
                folder(name)})
        .text;
  };
  EXPECT_THAT(doctor("short"), HasSubstr("suture keys renew SITE short"));
  EXPECT_THAT(doctor("viewer"), HasSubstr("keys of \"viewer\" hold until"));
}

}  // namespace
}  // namespace sutured
