// SPDX-License-Identifier: GPL-3.0-or-later
// A surgeon plays over DDS to a server; what was recorded becomes a surgeon file; run offline,
// that is the same session: step by step the same poses and forces, and the same events.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <cmath>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>

#include "mcap/reader.hpp"
#include "protocol/participant.hpp"
#include "protocol/serialized.hpp"
#include "recorded_surgeon.hpp"
#include "sample_facts.hpp"
#include "support/pressed_block.hpp"
#include "support/process.hpp"
#include "support/temporary_folder.hpp"
#include "support/test_session.hpp"

namespace sutured {
namespace {

using ::testing::HasSubstr;
using testing::own_session;
using testing::Process;

constexpr double kRate_hz = 100.0;  // slow, so that a busy machine keeps it

/// What happened to the needle: kind, subject, object, time and place.
struct Happening {
  std::string kind, subject, object;
  double time_s = 0.0;
  std::array<double, 3> position_m{};
};

const std::map<suture_v1_EventKind, std::string> kKinds{
    {suture_v1_EVENT_GRASP, "grasp"},        {suture_v1_EVENT_RELEASE, "release"},
    {suture_v1_EVENT_CONTACT, "contact"},    {suture_v1_EVENT_PUNCTURE, "puncture"},
    {suture_v1_EVENT_EXIT, "exit"},          {suture_v1_EVENT_RETRACT, "retract"},
    {suture_v1_EVENT_GRIP_SLIP, "grip_slip"}};

class RecordedSurgeon : public ::testing::Test {
 protected:
  /// A needle upright above a block, and a driver.
  [[nodiscard]] std::string scene() const {
    const std::string path = testing::PressedBlock{.young_modulus_pa = 2.0e5}.write(folder_);
    std::ofstream(path, std::ios::app) << R"(
[[needle]]
name = "needle"
shape = "straight"
length_m = 0.025
diameter_m = 0.0006
pose = { position_m = [0.011, 0.009, 0.0365], orientation = [0.0, 0.7071067811865476, 0.0, 0.7071067811865476] }
[[tool]]
name = "driver"
kind = "driver"
capture_radius_m = 0.003
max_force_n = 3.3
)";
    return path;
  }
  /// The hand takes the needle near its tail, drives it 8 mm into the block, draws it out
  /// again and lets go.
  [[nodiscard]] std::string surgeon() const {
    return folder_.write("surgeon.csv",
                         "time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw\n"
                         "0,driver,0.011,0.009,0.0345,0,0,0,1,0\n"
                         "0.2,driver,0.011,0.009,0.0345,0,0,0,1,0\n"
                         "0.4,driver,0.011,0.009,0.0345,0,0,0,1,1\n"
                         "1.2,driver,0.0111,0.0091,0.0250,0.01,0,0,0.99995,1\n"
                         "1.8,driver,0.011,0.009,0.0350,0,0,0,1,1\n"
                         "2.0,driver,0.011,0.009,0.0350,0,0,0,1,0\n");
  }
  static std::vector<std::string> in_session(std::vector<std::string> words) {
    words.insert(words.end(), {"--domain", std::to_string(own_session().domain), "--session",
                               own_session().session});
    return words;
  }
  [[nodiscard]] std::string file(const std::string& name) const { return folder_.path(name); }

  /// Plays the surgeon to a server, recorded to "session.mcap".
  void play(const std::string& scene_path) {
    Process recorder(in_session({SUTURE_CLI, "record", file("session.mcap"), "--force"}));
    recorder.read_until("no server answers yet");
    Process server(
        in_session({SUTURED_PROGRAM, "serve", scene_path, "--rate", std::to_string(kRate_hz)}));
    server.read_until("serving scene");
    Process device(in_session({SUTURE_CLI, "device", "--surgeon", surgeon(), "--tool", "driver"}));
    ASSERT_EQ(device.wait(), 0) << device.output();
    recorder.send(SIGINT);
    ASSERT_EQ(recorder.wait(), 0) << recorder.output();
    server.send(SIGINT);
    ASSERT_EQ(server.wait(), 0) << server.output();
  }

  testing::TemporaryFolder folder_;
};

TEST_F(RecordedSurgeon, IsTheSessionAgainStepByStep) {
  const std::string scene_path = scene();
  // A server that was late has stretched a step, and says so; then the claim is not made.
  suture::cli::RecordedSurgeon recorded;
  for (int attempt = 0; attempt < 5; ++attempt) {
    play(scene_path);
    suture::mcap::Reader reader(file("session.mcap"));
    recorded = suture::cli::surgeon_of(reader, std::nullopt);
    if (recorded.notes.empty()) break;
    std::printf("again: %s\n", recorded.notes.front().c_str());
  }
  ASSERT_TRUE(recorded.notes.empty()) << recorded.notes.front();
  EXPECT_EQ(recorded.rate_hz, kRate_hz);
  EXPECT_EQ(recorded.scene, "block");

  Process convert({SUTURE_CLI, "replay", file("session.mcap"), "--surgeon", file("hands.csv")});
  ASSERT_EQ(convert.wait(), 0) << convert.output();
  EXPECT_THAT(convert.output(), HasSubstr("every step of the server is there"));
  Process run({SUTURED_PROGRAM, "run", scene_path, "--surgeon", file("hands.csv"), "--rate",
               std::to_string(kRate_hz), "--out", file("again"), "--quiet"});
  ASSERT_EQ(run.wait(), 0) << run.output();

  // What the server did: each step's pose and force at it, and its events.
  std::map<std::int64_t, std::array<double, 13>> steps;  // pose and wrench by step
  std::vector<Happening> happened;
  const suture::Participant participant(own_session(), suture::Channel::kControl);
  const suture::SampleCodec events(participant, suture_v1_Event_desc, "suture/event");
  suture::mcap::Reader reader(file("session.mcap"));
  suture::mcap::Message message;
  while (reader.next(message)) {
    const std::string& topic = reader.channel(message).topic;
    if (topic == "suture/tool/model") {
      const auto facts = suture::cli::step_facts(message.data);
      ASSERT_TRUE(facts);
      if (!facts->engaged || facts->tool != "driver") continue;
      std::array<double, 13> step{};
      // The wrench follows the reference pose, without a gap: pose and wrench are 13 doubles.
      const std::size_t text = 4 + 4 + facts->tool.size() + 1 + 16;     // header, name, device
      const std::size_t pose = 4 + (text - 4 + 7) / 8 * 8 + 7 * 8 + 8;  // 7 words, flags
      std::memcpy(step.data(), message.data.data() + pose, sizeof step);
      ASSERT_EQ(step[0], facts->position_m[0]);
      steps[std::llround(facts->simulation_time_s * kRate_hz)] = step;
    } else if (topic == "suture/event") {
      suture::v1::Event event{};
      ASSERT_TRUE(events.decode(message.data, event));
      const auto kind = kKinds.find(event.kind);
      if (kind == kKinds.end()) continue;
      happened.push_back({kind->second,
                          std::string(suture::text_of(event.subject)),
                          std::string(suture::text_of(event.object)),
                          event.simulation_time_s,
                          {event.position_m[0], event.position_m[1], event.position_m[2]}});
    }
  }
  EXPECT_GT(steps.size(), 150U);

  // What the run did.
  std::size_t compared = 0;
  double peak_n = 0.0;
  std::ifstream tools(file("again") + "/tools.csv");
  std::string line;
  std::getline(tools, line);
  while (std::getline(tools, line)) {
    std::vector<std::string> fields;
    std::istringstream split(line);
    for (std::string field; std::getline(split, field, ',');) fields.push_back(field);
    ASSERT_EQ(fields.size(), 16U);
    const auto step = steps.find(std::llround(std::stod(fields[0]) * kRate_hz));
    ASSERT_NE(step, steps.end()) << "the hand was not there at " << fields[0] << " s";
    ++compared;
    // The same inputs up to a quaternion's last digits; what those become within 200 steps
    // of puncture and friction is far below what a hand feels.
    for (int i = 0; i < 7; ++i) EXPECT_NEAR(step->second[i], std::stod(fields[2 + i]), 1e-12);
    for (int i = 0; i < 6; ++i) {
      EXPECT_NEAR(step->second[7 + i], std::stod(fields[10 + i]), 1e-6) << fields[0] << ' ' << i;
      if (i < 3) peak_n = std::max(peak_n, std::abs(step->second[7 + i]));
    }
  }
  EXPECT_EQ(compared, steps.size());
  EXPECT_GT(peak_n, 0.05) << "nobody felt anything: the claim is empty";

  std::vector<Happening> again;
  std::ifstream lines(file("again") + "/events.jsonl");
  while (std::getline(lines, line)) {
    const nlohmann::json event = nlohmann::json::parse(line);
    again.push_back({event["kind"], event["subject"], event["object"], event["time_s"],
                     event["position_m"].get<std::array<double, 3>>()});
  }
  bool punctured = false;
  for (const Happening& there : happened) punctured |= there.kind == "puncture";
  EXPECT_TRUE(punctured);
  std::printf("%zu steps and %zu events compared, peak force %.3f N\n", compared, happened.size(),
              peak_n);
  ASSERT_EQ(again.size(), happened.size());
  for (std::size_t i = 0; i < again.size(); ++i) {
    EXPECT_EQ(again[i].kind, happened[i].kind);
    EXPECT_EQ(again[i].subject, happened[i].subject);
    EXPECT_EQ(again[i].object, happened[i].object);
    EXPECT_NEAR(again[i].time_s, happened[i].time_s, 1e-9);
    for (int k = 0; k < 3; ++k)
      EXPECT_NEAR(again[i].position_m[k], happened[i].position_m[k], 1e-9) << again[i].kind;
  }
}

}  // namespace
}  // namespace sutured
