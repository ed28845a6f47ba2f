// SPDX-License-Identifier: GPL-3.0-or-later
// The `suture` tool as its own process, against the server's end of the protocol in this one.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <filesystem>
#include <fstream>
#include <map>
#include <mutex>
#include <nlohmann/json.hpp>
#include <sstream>

#include "support/process.hpp"
#include "support/spring_server.hpp"
#include "support/test_session.hpp"

namespace suture {
namespace {

using sutured::testing::eventually;
using sutured::testing::own_session;
using sutured::testing::Process;
using sutured::testing::SpringServer;
using ::testing::HasSubstr;
using ::testing::MatchesRegex;
using ::testing::Not;

class Cli : public ::testing::Test {
 protected:
  Cli() {
    folder_ = std::filesystem::temp_directory_path() / ("suture-cli-" + std::to_string(getpid()));
    std::filesystem::create_directories(folder_);
  }
  ~Cli() override { std::filesystem::remove_all(folder_); }

  [[nodiscard]] std::string path(const std::string& name) const { return folder_ / name; }

  std::string write(const std::string& name, const std::string& text) const {
    std::ofstream(path(name)) << text;
    return path(name);
  }

  [[nodiscard]] std::string read(const std::string& name) const {
    std::ostringstream text;
    text << std::ifstream(path(name)).rdbuf();
    return text.str();
  }

  /// A hand that goes 20 mm along x within half a second.
  [[nodiscard]] std::string surgeon() const {
    return write("surgeon.csv",
                 "time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw\n"
                 "0,driver,0,0,0,0,0,0,1,1\n"
                 "0.5,driver,0.02,0,0,0,0,0,1,1\n");
  }

  /// Two hands that go along x at different speeds, for half a second and for 0.4 s.
  [[nodiscard]] std::string two_hands() const {
    return write("two.csv",
                 "time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw\n"
                 "0,driver,0,0,0,0,0,0,1,1\n"
                 "0,assistant,0,0.01,0,0,0,0,1,1\n"
                 "0.4,assistant,0.008,0.01,0,0,0,0,1,1\n"
                 "0.5,driver,0.02,0,0,0,0,0,1,1\n");
  }

  static SpringServer::Options two_tools() {
    SpringServer::Options options = server_options();
    options.tools = {"driver", "assistant"};
    return options;
  }

  static std::vector<std::string> fields_of(const std::string& line) {
    std::vector<std::string> fields;
    std::istringstream split(line);
    for (std::string field; std::getline(split, field, ',');) fields.push_back(field);
    return fields;
  }

  static std::vector<std::string> command(std::vector<std::string> words) {
    words.insert(words.begin(), SUTURE_CLI);
    words.insert(words.end(), {"--domain", std::to_string(own_session().domain), "--session",
                               own_session().session});
    return words;
  }

  static SpringServer::Options server_options() {
    SpringServer::Options options;
    options.session = own_session();
    return options;
  }

 private:
  std::filesystem::path folder_;
};

/// `suture sessions` of our domain, as JSON; other processes may have sessions there too.
std::map<std::string, nlohmann::json> list_sessions(const std::string& domain) {
  Process list({SUTURE_CLI, "sessions", "--json", "--timeout", "20", "--domain", domain});
  list.wait();
  std::map<std::string, nlohmann::json> rows;
  for (const auto& row :
       nlohmann::json::parse(list.output().substr(0, list.output().rfind(']') + 1)))
    rows[row["session"]] = row;
  return rows;
}

TEST_F(Cli, SessionsListsEveryServerOfADomainAndNoneThatHasLeft) {
  const std::string domain = std::to_string(own_session().domain);
  const std::string name = own_session().session;
  SpringServer::Options options = server_options();
  SpringServer one(options);
  options.session.session.clear();
  options.tools = {"driver", "assistant"};
  SpringServer unnamed(options);
  options.session.session = name + "-b";
  std::optional<SpringServer> other(options);

  std::map<std::string, nlohmann::json> rows = list_sessions(domain);
  ASSERT_TRUE(rows.contains(name) && rows.contains("") && rows.contains(name + "-b"));
  EXPECT_EQ(rows[name]["scene"], "spring");
  EXPECT_EQ(rows[name]["state"], "running");
  EXPECT_EQ(rows[name]["domain"], own_session().domain);
  EXPECT_EQ(rows[name]["tools"], 1);
  EXPECT_EQ(rows[""]["tools"], 2);

  Process table({SUTURE_CLI, "sessions", "--domain", domain});
  EXPECT_EQ(table.wait(), 0);
  EXPECT_THAT(table.output(), HasSubstr("\n(default) "));
  EXPECT_THAT(table.output(), HasSubstr("\n" + name + "-b "));

  other.reset();
  rows = list_sessions(domain);
  EXPECT_TRUE(rows.contains(name));
  EXPECT_FALSE(rows.contains(name + "-b"));
}

TEST_F(Cli, SessionsSaysWhereItFoundNone) {
  // Tests take domains below 200.
  Process list({SUTURE_CLI, "sessions", "--json", "--domain", "228", "--domain", "230"});
  EXPECT_EQ(list.wait(), 3);
  EXPECT_THAT(list.output(), HasSubstr("[]"));
  EXPECT_THAT(list.output(), HasSubstr("no server answers in domains 228, 230"));
  EXPECT_THAT(list.output(), HasSubstr("--all-domains"));
  Process odd({SUTURE_CLI, "sessions", "--domain", "1"});
  EXPECT_EQ(odd.wait(), 2);
  Process both({SUTURE_CLI, "sessions", "--domain", "0", "--all-domains"});
  EXPECT_EQ(both.wait(), 2);
}

TEST_F(Cli, SessionsWaitsForTheWordOfAServerThatIsKnown) {
  const Participant participant(own_session(), Channel::kControl);
  Writer<v1::ServerStatus> server(participant);
  Process list({SUTURE_CLI, "sessions", "--timeout", "20", "--domain",
                std::to_string(own_session().domain)});
  ASSERT_TRUE(eventually([&] { return server.matched() > 0; }));
  // Later than it would wait for strangers.
  std::this_thread::sleep_for(std::chrono::milliseconds(1500));
  v1::ServerStatus status{};
  set_text(status.session, own_session().session);
  set_text(status.scene, "late\x1b[2J");
  status.state = suture_v1_SERVER_PAUSED;
  server.write(status);
  EXPECT_EQ(list.wait(), 0);
  EXPECT_THAT(list.output(), HasSubstr("  late?[2J  "));  // no stranger commands the terminal
  EXPECT_THAT(list.output(), HasSubstr("  paused  "));
}

TEST_F(Cli, DevicePlaysASurgeonFileAndLeavesLogPlotAndSummary) {
  SpringServer server(server_options());
  Process device(
      command({"device", "--tool", "driver", "--surgeon", surgeon(), "--log", path("log.csv"),
               "--plot", path("plot.svg"), "--summary", path("summary.json")}));
  ASSERT_EQ(device.wait(), 0) << device.output();
  EXPECT_THAT(device.output(), HasSubstr("rendering"));
  EXPECT_THAT(device.output(), HasSubstr("round trip"));

  const nlohmann::json summary = nlohmann::json::parse(read("summary.json"));
  EXPECT_FALSE(summary["interrupted"]);
  const nlohmann::json& driver = summary["tools"]["driver"];
  EXPECT_GE(driver["poses_sent"], 300);  // 501 on an idle machine: missed ticks are skipped
  EXPECT_LE(driver["poses_sent"], 501);  // from 0 to 0.5 s, both included
  EXPECT_NEAR(driver["peak_force_n"], 2.0, 0.05);  // 100 N/m over 20 mm
  EXPECT_EQ(driver["out_of_order"], 0);
  EXPECT_GT(driver["round_trip_us"]["p50"], 0.0);

  // Each line of the log holds a tick: the force then, and the pose of the file that it answers.
  std::istringstream log(read("log.csv"));
  std::string line;
  std::getline(log, line);
  EXPECT_THAT(line, MatchesRegex("time_s,tool,hand_sequence,.*round_trip_us,model_age_us"));
  int lines = 0;
  double last_s = -1.0;
  std::uint64_t last_sequence = 0;
  while (std::getline(log, line)) {
    ++lines;
    const std::vector<std::string> fields = fields_of(line);
    ASSERT_EQ(fields.size(), 22U) << line;
    EXPECT_EQ(fields[1], "driver");
    const double time_s = std::stod(fields[0]);
    const double x_m = std::stod(fields[6]);
    EXPECT_LE(x_m, 0.04 * time_s + 1e-7);  // a round trip before; microseconds in the text
    if (fields[4] == "rendering") {
      EXPECT_NEAR(std::stod(fields[14]), -100.0 * x_m, 1e-7);
    }
    EXPECT_GT(time_s, last_s);
    last_s = time_s;
    const std::uint64_t sequence = std::stoull(fields[2]);
    EXPECT_GE(sequence, last_sequence);
    last_sequence = sequence;
  }
  EXPECT_LT(lines, driver["poses_sent"]);
  EXPECT_GE(lines, 300);

  const std::string plot = read("plot.svg");
  EXPECT_THAT(plot, HasSubstr("<svg"));
  EXPECT_THAT(plot, HasSubstr("</svg>"));
  EXPECT_EQ(plot.find("nan"), std::string::npos);
}

/// All poses of a session as they leave, by tool.
class PoseWatcher {
 public:
  PoseWatcher() {
    EndpointCallbacks callbacks;
    callbacks.data_available = [this] {
      if (!ready_) return;
      v1::ToolPose pose;
      SampleInfo info;
      while (reader_.take(pose, info)) {
        if (!info.valid || (pose.flags & suture_v1_POSE_GOODBYE) != 0) continue;
        const std::lock_guard lock(mutex_);
        poses_[pose.tool_id].push_back(pose);
      }
    };
    reader_ = Reader<v1::ToolPose>(participant_, std::move(callbacks));
    ready_ = true;
  }
  std::vector<v1::ToolPose> of(const std::string& tool) {
    const std::lock_guard lock(mutex_);
    return poses_[tool_id(tool)];
  }

 private:
  Participant participant_{own_session(), Channel::kControl};
  std::atomic<bool> ready_{false};
  std::mutex mutex_;
  std::map<std::uint64_t, std::vector<v1::ToolPose>> poses_;
  Reader<v1::ToolPose> reader_;
};

/// When a hand that goes along x at `speed_m_per_s` from 0 has set out: the median over its
/// poses, so that a tick that was held up does not count.
double started_s(const std::vector<v1::ToolPose>& poses, double speed_m_per_s) {
  std::vector<double> starts;
  for (const v1::ToolPose& pose : poses) {
    if (pose.position_m[0] <= 0.0) continue;
    starts.push_back(1e-9 * static_cast<double>(pose.stamp_ns) -
                     pose.position_m[0] / speed_m_per_s);
  }
  const auto middle = starts.begin() + static_cast<std::ptrdiff_t>(starts.size() / 2);
  std::nth_element(starts.begin(), middle, starts.end());
  return starts.empty() ? 0.0 : *middle;
}

TEST_F(Cli, DeviceSummarisesASceneWhoseNameIsNotUtf8) {
  SpringServer::Options options = server_options();
  options.scene = "spr\xffing";
  SpringServer server(options);
  Process device(
      command({"device", "--quiet", "--surgeon", surgeon(), "--summary", path("summary.json")}));
  ASSERT_EQ(device.wait(), 0) << device.output();
  EXPECT_EQ(nlohmann::json::parse(read("summary.json"))["scene"], "spr\xef\xbf\xbding");
}

TEST_F(Cli, DeviceLeavesNoLogWhereNobodyAnswers) {
  Process device(
      command({"device", "--surgeon", surgeon(), "--log", path("log.csv"), "--timeout", "0.01"}));
  EXPECT_EQ(device.wait(), 3) << device.output();
  EXPECT_FALSE(std::filesystem::exists(path("log.csv")));
}

TEST_F(Cli, DevicePlaysEveryToolOfAFileOnOneClock) {
  SpringServer server(two_tools());
  PoseWatcher poses;
  Process device(command({"device", "--surgeon", two_hands(), "--log", path("log.csv"), "--plot",
                          path("plot.svg"), "--summary", path("summary.json")}));
  ASSERT_EQ(device.wait(), 0) << device.output();
  EXPECT_EQ(server.goodbyes(), 2);
  EXPECT_THAT(device.output(), HasSubstr("tools driver, assistant"));

  const double driver_s = started_s(poses.of("driver"), 0.04);
  const double assistant_s = started_s(poses.of("assistant"), 0.02);
  EXPECT_NEAR(driver_s, assistant_s, 1e-3);  // a period

  const nlohmann::json summary = nlohmann::json::parse(read("summary.json"));
  EXPECT_NEAR(summary["tools"]["driver"]["peak_force_n"], 2.0, 0.05);
  EXPECT_NEAR(summary["tools"]["assistant"]["peak_force_n"], 1.281, 0.05);  // 8 and 10 mm
  std::map<std::string, int> lines;
  std::istringstream log(read("log.csv"));
  std::string line;
  std::getline(log, line);
  while (std::getline(log, line)) {
    const std::vector<std::string> fields = fields_of(line);
    ASSERT_EQ(fields.size(), 22U) << line;
    ++lines[fields[1]];
    const double speed_m_per_s = fields[1] == "driver" ? 0.04 : 0.02;
    EXPECT_LE(std::stod(fields[6]), speed_m_per_s * std::stod(fields[0]) + 1e-7);
  }
  for (const char* tool : {"driver", "assistant"}) {
    EXPECT_LT(lines[tool], summary["tools"][tool]["poses_sent"]) << tool;
    EXPECT_GE(lines[tool], 200) << tool;
    EXPECT_THAT(read("plot.svg"), HasSubstr(std::string(">") + tool + "</text>"));
  }
}

TEST_F(Cli, DeviceHoldsEveryToolUntilAllAreAnswered) {
  SpringServer server(two_tools());
  server.set_silent_for("assistant");
  PoseWatcher poses;
  Process device(command({"device", "--surgeon", two_hands(), "--quiet"}));
  ASSERT_TRUE(eventually([&] { return poses.of("driver").size() > 100; }));
  for (const v1::ToolPose& pose : poses.of("driver")) ASSERT_EQ(pose.position_m[0], 0.0);
  server.set_silent_for("");
  EXPECT_EQ(device.wait(), 0) << device.output();
  EXPECT_NEAR(poses.of("driver").back().position_m[0], 0.02, 1e-3);
}

TEST_F(Cli, AFaultOfOneToolEndsAllWithItsName) {
  SpringServer server(two_tools());
  Process device(command({"device", "--surgeon", two_hands(), "--loop"}));
  device.read_until("rendering");
  server.give_away("assistant");
  EXPECT_EQ(device.wait(), 5) << device.output();
  EXPECT_THAT(device.output(), HasSubstr("another device holds the tool \"assistant\""));
  EXPECT_TRUE(eventually([&] { return server.goodbyes() == 2; }));
}

TEST_F(Cli, ASilentToolOfSeveralIsNamed) {
  SpringServer server(two_tools());
  server.set_silent_for("assistant");
  Process device(command({"device", "--surgeon", two_hands()}));
  EXPECT_EQ(device.wait(), 3) << device.output();
  EXPECT_THAT(device.output(), HasSubstr("tool \"assistant\": the server has not answered"));
}

TEST_F(Cli, DeviceTakesTheToolsThatAreNamed) {
  SpringServer server(two_tools());
  PoseWatcher poses;
  Process device(command({"device", "--tool", "assistant", "--surgeon", two_hands()}));
  EXPECT_EQ(device.wait(), 0) << device.output();
  EXPECT_TRUE(poses.of("driver").empty());
  EXPECT_FALSE(poses.of("assistant").empty());
  Process twice(command({"device", "--tool", "driver", "--tool", "assistant", "--tool", "driver",
                         "--surgeon", two_hands()}));
  EXPECT_EQ(twice.wait(), 2);
  EXPECT_THAT(twice.output(), HasSubstr("--tool driver stands there twice"));
}

TEST_F(Cli, DeviceEndsItsLoopWithASummaryWhenInterrupted) {
  SpringServer server(server_options());
  Process device(command({"device", "--tool", "driver", "--surgeon", surgeon(), "--loop"}));
  device.read_until("rendering");
  device.send(SIGINT);
  EXPECT_EQ(device.wait(), 130);
  EXPECT_THAT(device.output(), HasSubstr("summary"));
  EXPECT_TRUE(eventually([&] { return server.matched_devices() == 0; }));
  EXPECT_EQ(server.goodbyes(), 1);
}

TEST_F(Cli, DeviceNamesThePlaceOfAFaultInTheSurgeonFile) {
  const std::string bad = write("bad.csv",
                                "time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw\n"
                                "0,driver,0,0,0,0,0,0,1,1\n"
                                "1,driver,0,oops,0,0,0,0,1,1\n");
  Process device(command({"device", "--tool", "driver", "--surgeon", bad}));
  EXPECT_EQ(device.wait(), 2);
  EXPECT_THAT(device.output(), HasSubstr("bad.csv:3:12: py_m is \"oops\""));
}

TEST_F(Cli, DeviceNamesTheToolsOfAFileThatLacksItsOwn) {
  Process device(command({"device", "--tool", "left", "--surgeon", surgeon()}));
  EXPECT_EQ(device.wait(), 2);
  EXPECT_THAT(device.output(), HasSubstr("it has rows of driver"));
}

TEST_F(Cli, ExitCodesTellWhatIsMissing) {
  Process no_server(
      command({"device", "--tool", "driver", "--surgeon", surgeon(), "--timeout", "0.1"}));
  EXPECT_EQ(no_server.wait(), 3);

  SpringServer::Options options = server_options();
  options.tools = {"other"};
  SpringServer server(options);
  Process unknown(command({"device", "--tool", "driver", "--surgeon", surgeon()}));
  EXPECT_EQ(unknown.wait(), 5);
  EXPECT_THAT(unknown.output(), HasSubstr("it has other"));

  Process usage({SUTURE_CLI, "device"});
  EXPECT_EQ(usage.wait(), 2);
}

TEST_F(Cli, DeviceSaysWhenTheServerDies) {
  auto server = std::make_unique<SpringServer>(server_options());
  Process device(command({"device", "--tool", "driver", "--surgeon", surgeon(), "--loop"}));
  device.read_until("rendering");
  server.reset();
  EXPECT_EQ(device.wait(), 3);
  EXPECT_THAT(device.output(), HasSubstr("server_silent"));
  EXPECT_THAT(device.output(), HasSubstr("has not answered"));
}

/// The play is over before the device would have given up on its own.
TEST_F(Cli, DeviceSaysWhenTheServerIsGoneAtTheEnd) {
  const std::string hands = write("long.csv",
                                  "time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw\n"
                                  "0,driver,0,0,0,0,0,0,1,1\n"
                                  "2,driver,0.02,0,0,0,0,0,1,1\n");
  for (const std::string render : {"server", "device"}) {
    auto server = std::make_unique<SpringServer>(server_options());
    Process device(
        command({"device", "--surgeon", hands, "--render", render, "--log", path("log.csv")}));
    device.read_until("poses sent");
    EXPECT_EQ(device.wait(), 0) << device.output();

    Process abandoned(
        command({"device", "--surgeon", hands, "--render", render, "--log", path("log.csv")}));
    abandoned.read_until("driver");
    ASSERT_TRUE(eventually([&] { return server->last_pose().sequence_number > 500; }));
    server.reset();
    EXPECT_EQ(abandoned.wait(), 3) << abandoned.output();
    EXPECT_THAT(abandoned.output(), HasSubstr("fell silent before the play was over"));
    // What the hand was given: the fade, and nothing from then on.
    std::istringstream log(read("log.csv"));
    std::string line, last;
    while (std::getline(log, line)) last = line;
    const std::vector<std::string> fields = fields_of(last);
    ASSERT_EQ(fields.size(), 22U) << last;
    EXPECT_GT(std::stod(fields[0]), 1.9);
    EXPECT_EQ(std::stod(fields[14]), 0.0);
  }
}

TEST_F(Cli, AResultThatCannotBeWrittenIsAnError) {
  Process made({SUTURE_CLI, "keys", "init", path("site")});
  ASSERT_EQ(made.wait(), 0) << made.output();
  Process list(
      {"sh", "-c", "exec \"$0\" \"$@\" >/dev/full", SUTURE_CLI, "keys", "list", path("site")});
  EXPECT_EQ(list.wait(), 1);
  EXPECT_EQ(list.output(),
            "suture: the output could not be written: No space left on device; see to where "
            "standard output goes\n");
  // What ended it otherwise stays what it ends with.
  Process missing(
      {"sh", "-c", "exec \"$0\" \"$@\" >/dev/full", SUTURE_CLI, "keys", "list", path("none")});
  EXPECT_EQ(missing.wait(), 2);
}

TEST_F(Cli, TopPrintsATableOnce) {
  SpringServer server(server_options());
  Process top(command({"top", "--once"}));
  EXPECT_EQ(top.wait(), 0);
  EXPECT_THAT(top.output(), HasSubstr("scene spring"));
  EXPECT_THAT(top.output(), HasSubstr("driver"));
}

TEST_F(Cli, CommandPrintsTheReply) {
  SpringServer server(server_options());
  Process pause(command({"command", "pause"}));
  EXPECT_EQ(pause.wait(), 0);
  EXPECT_EQ(pause.output(), "done\n");
  Process stop(command({"command", "stop"}));
  EXPECT_EQ(stop.wait(), 6);
  EXPECT_THAT(stop.output(), HasSubstr("springs do not stop"));
  Process release(command({"command", "release", "--tool", "driver"}));
  EXPECT_EQ(release.wait(), 0) << release.output();
}

TEST_F(Cli, CommandNamesAToolThatIsNotThereOrNotAskedFor) {
  SpringServer server(server_options());
  Process unknown(command({"command", "release", "--tool", "nobody"}));
  EXPECT_EQ(unknown.wait(), 5);
  EXPECT_THAT(unknown.output(), HasSubstr("the scene has no tool \"nobody\""));
  EXPECT_THAT(unknown.output(), HasSubstr("it has driver"));
  for (const char* what : {"stop", "pause", "resume", "reset", "checkpoint", "restore"}) {
    Process refused(command({"command", what, "--tool", "driver"}));
    EXPECT_EQ(refused.wait(), 2) << what;
    EXPECT_THAT(refused.output(), HasSubstr("takes no --tool")) << what;
  }
}

TEST_F(Cli, DoctorGradesEveryLineAndMeasuresTheRoundTrip) {
  Process doctor(
      {SUTURE_CLI, "doctor", "--seconds", "0.5", "--domain", std::to_string(own_session().domain)});
  const int code = doctor.wait();
  EXPECT_TRUE(code == 0 || code == 1) << doctor.output();  // the machine's, not ours
  for (const char* line :
       {"kernel", "processors", "free of other work", "SCHED_FIFO", "nice -10", "locked",
        "1 kHz wake-up", "interface", "receive buffers", "round trip over DDS"}) {
    EXPECT_THAT(doctor.output(), HasSubstr(line));
  }
  // What is permitted is not asked for.
  if (doctor.output().find("SCHED_FIFO permitted") != std::string::npos) {
    EXPECT_THAT(doctor.output(), Not(HasSubstr("permit SCHED_FIFO")));
  }
  // What is not good comes with its mend.
  std::istringstream lines(doctor.output());
  std::string before;
  for (std::string line; std::getline(lines, line); before = line) {
    const bool wanting = before.starts_with("  fair") || before.starts_with("  BAD");
    EXPECT_EQ(line.starts_with("        mend: "), wanting) << before << '\n' << line;
  }
}

}  // namespace
}  // namespace suture
