// SPDX-License-Identifier: GPL-3.0-or-later
// `suture record` and `suture replay` as processes of their own. What others make of the
// files: tests/interop.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <cstring>
#include <filesystem>
#include <map>
#include <utility>

#include "mcap/reader.hpp"
#include "protocol/endpoint.hpp"
#include "protocol/serialized.hpp"
#include "support/process.hpp"
#include "support/spring_server.hpp"
#include "support/temporary_folder.hpp"
#include "support/test_session.hpp"

namespace suture {
namespace {

using sutured::testing::eventually;
using sutured::testing::own_session;
using sutured::testing::Process;
using sutured::testing::SpringServer;
using ::testing::HasSubstr;
using ::testing::Not;

struct Recorded {
  std::map<std::string, std::vector<std::string>> samples;  // by topic
  std::vector<mcap::Metadata> metadata;
  std::string damage;
  std::uint64_t first_ns = 0, last_ns = 0;

  [[nodiscard]] int sessions() const {
    return static_cast<int>(
        std::count_if(metadata.begin(), metadata.end(),
                      [](const mcap::Metadata& m) { return m.name == "suture.session"; }));
  }
};

Recorded read_recording(const std::string& path) {
  Recorded recorded;
  mcap::Reader reader(path);
  mcap::Message message;
  while (reader.next(message)) {
    recorded.samples[reader.channel(message).topic].emplace_back(
        reinterpret_cast<const char*>(message.data.data()), message.data.size());
    if (recorded.first_ns == 0) recorded.first_ns = message.log_time_ns;
    recorded.last_ns = std::max(recorded.last_ns, message.log_time_ns);
  }
  recorded.metadata = reader.metadata();
  recorded.damage = reader.damage();
  return recorded;
}

class Record : public ::testing::Test {
 protected:
  static std::vector<std::string> command(std::vector<std::string> words,
                                          const std::string& session = own_session().session) {
    words.insert(words.begin(), SUTURE_CLI);
    words.insert(words.end(),
                 {"--domain", std::to_string(own_session().domain), "--session", session});
    return words;
  }
  static SpringServer::Options server_options() {
    SpringServer::Options options;
    options.session = own_session();
    return options;
  }
  /// A hand that goes 20 mm along x within half a second.
  [[nodiscard]] std::string surgeon() const {
    return folder_.write("surgeon.csv",
                         "time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw\n"
                         "0,driver,0,0,0,0,0,0,1,1\n"
                         "0.5,driver,0.02,0,0,0,0,0,1,1\n");
  }
  [[nodiscard]] std::string file(const std::string& name = "session.mcap") const {
    return folder_.path(name);
  }
  /// Records one play of the surgeon file.
  void record_one_play(const std::string& path, std::vector<std::string> more = {}) {
    SpringServer server(server_options());
    std::vector<std::string> words{"record", path};
    words.insert(words.end(), more.begin(), more.end());
    Process recorder(command(words));
    recorder.read_until("server: ");
    Process device(command({"device", "--surgeon", surgeon(), "--quiet"}));
    ASSERT_EQ(device.wait(), 0) << device.output();
    recorder.send(SIGINT);
    ASSERT_EQ(recorder.wait(), 0) << recorder.output();
    EXPECT_THAT(recorder.output(), HasSubstr("recorded "));
  }

  sutured::testing::TemporaryFolder folder_;
};

TEST_F(Record, KeepsTheBytesThatTravelledAndWhoSentThem) {
  record_one_play(file());
  const Recorded recorded = read_recording(file());
  EXPECT_EQ(recorded.damage, "");
  for (const char* topic : {"suture/tool/pose", "suture/tool/force"}) {
    EXPECT_GT(recorded.samples.at(topic).size(), 200U) << topic;  // of 501 on an idle machine
  }
  // Once when the device connects, and once when it runs.
  EXPECT_EQ(recorded.samples.at("suture/tool/device").size(), 2U);
  ASSERT_EQ(recorded.sessions(), 1);
  EXPECT_EQ(recorded.metadata[0].values.at("scene"), "spring");
  EXPECT_EQ(recorded.metadata[0].values.at("epoch"), "1");
  EXPECT_EQ(recorded.metadata.back().name, "suture.recording");

  // Poses are those of the surgeon: the codec takes them for what they are.
  const Participant participant(own_session(), Channel::kControl);
  const SampleCodec codec(participant, suture_v1_ToolPose_desc, "suture/tool/pose");
  double furthest_m = 0.0;
  for (const std::string& bytes : recorded.samples.at("suture/tool/pose")) {
    v1::ToolPose pose{};
    ASSERT_TRUE(codec.decode(std::as_bytes(std::span(bytes)), pose));
    EXPECT_EQ(pose.tool_id, tool_id("driver"));
    furthest_m = std::max(furthest_m, pose.position_m[0]);
  }
  EXPECT_NEAR(furthest_m, 0.02, 1e-3);
}

TEST_F(Record, TakesTheTopicsThatAreNamed) {
  record_one_play(file(), {"--topics", "tool/force,suture/event"});
  const Recorded recorded = read_recording(file());
  ASSERT_EQ(recorded.samples.size(), 1U);  // there was no event
  EXPECT_EQ(recorded.samples.begin()->first, "suture/tool/force");
  EXPECT_EQ(recorded.sessions(), 1) << "who sent them is kept all the same";

  Process wrong(command({"record", file("other.mcap"), "--topics", "tool/forces"}));
  EXPECT_EQ(wrong.wait(), 2);
  EXPECT_THAT(wrong.output(), HasSubstr("no topic \"tool/forces\""));
  EXPECT_FALSE(std::filesystem::exists(file("other.mcap")));
}

TEST_F(Record, WaitsForAServerAndFollowsTheNextOne) {
  Process recorder(command({"record", file()}));
  recorder.read_until("no server answers yet");
  {
    SpringServer server(server_options());
    recorder.read_until("server: sutured");
  }
  recorder.read_until("the server has left");
  SpringServer server(server_options());
  recorder.read_until("the server answers again");  // of the same epoch, here
  recorder.send(SIGTERM);
  EXPECT_EQ(recorder.wait(), 0) << recorder.output();
  const Recorded recorded = read_recording(file());
  EXPECT_EQ(recorded.samples.at("suture/status").size(), 2U);
}

TEST_F(Record, NotesEveryEpoch) {
  Process recorder(command({"record", file()}));
  const Participant participant(own_session(), Channel::kControl);
  Writer<v1::ServerStatus> writer(participant);
  ASSERT_TRUE(eventually([&] { return writer.matched() == 2; }));
  v1::ServerStatus status{};
  status.pid = 7;
  for (const std::uint64_t epoch : {5U, 5U, 6U}) {
    status.epoch = epoch;
    ASSERT_TRUE(writer.write(status));
    ASSERT_TRUE(writer.wait_for_acknowledgements(std::chrono::seconds(20)));
    ++status.sequence_number;
  }
  recorder.read_until("the server was reset");
  status.epoch = 7;
  status.pid = 8;
  ASSERT_TRUE(writer.write(status));
  recorder.read_until("pid 8");
  recorder.send(SIGINT);
  EXPECT_EQ(recorder.wait(), 0) << recorder.output();
  EXPECT_EQ(read_recording(file()).sessions(), 3);
}

TEST_F(Record, EndsByItselfAfterItsDuration) {
  SpringServer server(server_options());
  Process recorder(command({"record", file(), "--duration", "0.3"}));
  EXPECT_EQ(recorder.wait(), 0) << recorder.output();
  EXPECT_EQ(read_recording(file()).damage, "");
}

TEST_F(Record, KilledItLeavesAFileThatReadsUpToTheLastSecond) {
  SpringServer server(server_options());
  Process recorder(command({"record", file()}));
  recorder.read_until("server: ");
  Process device(command({"device", "--surgeon", surgeon(), "--loop"}));
  device.read_until("rendering");
  ASSERT_TRUE(eventually([&] { return std::filesystem::file_size(file()) > 100'000; }));
  const auto killed_ns = static_cast<std::uint64_t>(wall_clock_ns());
  recorder.send(SIGKILL);
  EXPECT_EQ(recorder.wait(), 128 + SIGKILL);

  const Recorded recorded = read_recording(file());
  EXPECT_THAT(recorded.damage, HasSubstr("cut off"));
  EXPECT_GT(recorded.samples.at("suture/tool/force").size(), 300U);
  EXPECT_GT(recorded.last_ns + 1'000'000'000, killed_ns);
  EXPECT_EQ(recorded.sessions(), 1);
}

TEST_F(Record, AFullDiskEndsItWithAWordAndAFileThatReads) {
  SpringServer server(server_options());
  Process device(command({"device", "--surgeon", surgeon(), "--loop"}));
  device.read_until("rendering");
  // A limit on the size of files, in blocks of 1 KiB, stands for the full disk.
  std::string line = "ulimit -f 100; exec";
  for (const std::string& word : command({"record", file()})) line += " '" + word + "'";
  Process recorder({"/bin/bash", "-c", line});
  EXPECT_EQ(recorder.wait(), 2) << recorder.output();
  EXPECT_THAT(recorder.output(), HasSubstr("session.mcap: cannot be written: File too large"));
  const Recorded recorded = read_recording(file());
  EXPECT_GT(recorded.samples.at("suture/tool/force").size(), 100U);
  EXPECT_THAT(recorded.damage, HasSubstr("closing records")) << "a chunk was cut";
}

TEST_F(Record, KeepsAFileThatExistsUntilItIsToldNotToAndSomethingComes) {
  folder_.write("session.mcap", "precious");
  Process recorder(command({"record", file()}));
  EXPECT_EQ(recorder.wait(), 2);
  EXPECT_THAT(recorder.output(), HasSubstr("session.mcap: exists"));
  EXPECT_EQ(sutured::testing::read_file(file()), "precious");
  Process forced(command({"record", file(), "--force"}));
  forced.read_until("no server answers yet");
  forced.send(SIGINT);
  EXPECT_EQ(forced.wait(), 0) << forced.output();
  EXPECT_THAT(forced.output(), HasSubstr("session.mcap is as it was"));
  EXPECT_EQ(sutured::testing::read_file(file()), "precious");
  record_one_play(file(), {"--force"});
  EXPECT_EQ(read_recording(file()).damage, "");
}

TEST_F(Record, ReplayedItIsTheSameRecording) {
  record_one_play(file());
  const std::string other = own_session().session + "-again";
  Process recorder(command({"record", file("again.mcap")}, other));
  recorder.read_until("no server answers yet");
  Process replay(command({"replay", file(), "--rate", "2"}, other));
  EXPECT_EQ(replay.wait(), 0) << replay.output();
  EXPECT_THAT(replay.output(), Not(HasSubstr("left out")));
  recorder.send(SIGINT);
  ASSERT_EQ(recorder.wait(), 0) << recorder.output();

  const Recorded before = read_recording(file());
  const Recorded after = read_recording(file("again.mcap"));
  ASSERT_EQ(after.samples.size(), before.samples.size());
  for (const auto& [topic, samples] : before.samples) {
    // Best effort may lose some on a busy machine; none is new, none changes place.
    const std::vector<std::string>& again = after.samples.at(topic);
    EXPECT_GE(again.size(), samples.size() * 9 / 10) << topic;
    auto place = samples.begin();
    for (const std::string& sample : again) {
      place = std::find(place, samples.end(), sample);
      ASSERT_NE(place, samples.end()) << topic;
      ++place;
    }
  }
}

TEST_F(Record, ReplayTakesTheTimeThatTheSessionTook) {
  record_one_play(file());
  const std::string other = own_session().session + "-again";
  const auto span_ns = [](const std::string& path) {
    const Recorded recorded = read_recording(path);
    return static_cast<double>(recorded.last_ns - recorded.first_ns);
  };
  // A busy machine makes it longer, never shorter.
  for (const auto& [rate, share] : {std::pair("1", 0.9), std::pair("0.5", 1.8)}) {
    Process recorder(command({"record", file("again.mcap"), "--force"}, other));
    recorder.read_until("no server answers yet");
    Process replay(command({"replay", file(), "--rate", rate}, other));
    EXPECT_EQ(replay.wait(), 0) << replay.output();
    recorder.send(SIGINT);
    ASSERT_EQ(recorder.wait(), 0) << recorder.output();
    EXPECT_GE(span_ns(file("again.mcap")), share * span_ns(file())) << rate;
  }
}

TEST_F(Record, ReplayKeepsOutOfASessionWithAServer) {
  record_one_play(file());
  SpringServer server(server_options());
  Process replay(command({"replay", file()}));
  EXPECT_EQ(replay.wait(), 1);
  EXPECT_THAT(replay.output(), HasSubstr("a server answers in this session"));
  EXPECT_THAT(replay.output(), HasSubstr("--session"));
}

TEST_F(Record, ReplayPlaysWhatIsLeftOfACutFile) {
  record_one_play(file());
  const std::string whole = sutured::testing::read_file(file());
  std::uint64_t data_bytes = 0;  // the footer says where the summary begins
  std::memcpy(&data_bytes, whole.data() + whole.size() - 28, sizeof data_bytes);
  folder_.write("cut.mcap", whole.substr(0, data_bytes / 2));
  Process replay(command({"replay", file("cut.mcap"), "--rate", "100"}));
  EXPECT_EQ(replay.wait(), 0) << replay.output();
  EXPECT_THAT(replay.output(), HasSubstr("cut.mcap: byte "));
  EXPECT_THAT(replay.output(), HasSubstr("was cut off"));
}

TEST_F(Record, ReplayLoopsUntilInterrupted) {
  record_one_play(file());
  Process replay(command({"replay", file(), "--rate", "100", "--loop"}));
  replay.read_until("played");
  replay.read_until("played");
  replay.send(SIGINT);
  EXPECT_EQ(replay.wait(), 130) << replay.output();
}

TEST_F(Record, ReplaySaysWhatIsNoRecording) {
  folder_.write("session.mcap", "not a recording");
  Process replay(command({"replay", file()}));
  EXPECT_EQ(replay.wait(), 2);
  EXPECT_THAT(replay.output(), HasSubstr("session.mcap: is not an MCAP file"));
  record_one_play(file("springs.mcap"));
  Process hands(command({"replay", file("springs.mcap"), "--surgeon", file("hands.csv")}));
  EXPECT_EQ(hands.wait(), 2);
  EXPECT_THAT(hands.output(), HasSubstr("no samples of suture/tool/model"));
  EXPECT_FALSE(std::filesystem::exists(file("hands.csv")));
}

}  // namespace
}  // namespace suture
