// SPDX-License-Identifier: GPL-3.0-or-later
// The main promise over real DDS between real processes: a force for every pose, and no
// fault of either side that a hand could feel as more than a smooth end of force.
//
// Times are those of the forces themselves (their stamps and the ticks that made them),
// so that a busy machine cannot break a claim about safety.
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <deque>
#include <filesystem>
#include <fstream>
#include <limits>
#include <map>
#include <mutex>
#include <set>
#include <vector>

#include "integration/serve/raw_device.hpp"
#include "protocol/surgeon.hpp"
#include "support/client_options.hpp"
#include "support/pressed_block.hpp"
#include "support/process.hpp"
#include "support/temporary_folder.hpp"
#include "support/test_session.hpp"
#include "suture/device.hpp"
#include "suture/session.hpp"
#include "suture/viewer.hpp"

namespace sutured {
namespace {

using suture::v1::ToolForce;
using testing::eventually;
using testing::Process;
using testing::RawDevice;

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kPromise_ns = 50 * kMs;
constexpr double kMaxForce_n = 0.5;
constexpr double kMaxSlew_n_per_s = 40.0;
constexpr double kSurface_m = testing::PressedBlock::kSurface_m;
constexpr double kTouching_m = testing::PressedBlock::height_m(0.001);  // a millimetre deep

double norm(const double (&v)[3]) { return std::hypot(v[0], v[1], v[2]); }

/// All forces of the session, whoever they are for.
class ForceWatcher {
 public:
  explicit ForceWatcher(const suture::Participant& participant) {
    suture::EndpointCallbacks callbacks;
    callbacks.data_available = [this] {
      if (!ready_) return;
      ToolForce force;
      suture::SampleInfo info;
      while (reader_.take(force, info)) {
        if (!info.valid) continue;
        const std::lock_guard lock(mutex_);
        forces_.push_back(force);
      }
    };
    reader_ = suture::Reader<ToolForce>(participant, std::move(callbacks));
    ready_ = true;
  }
  std::vector<ToolForce> all() {
    const std::lock_guard lock(mutex_);
    return forces_;
  }
  ToolForce last() {
    const std::lock_guard lock(mutex_);
    return forces_.empty() ? ToolForce{} : forces_.back();
  }
  /// Forgets what came so far.
  void clear() {
    const std::lock_guard lock(mutex_);
    forces_.clear();
  }

 private:
  std::atomic<bool> ready_{false};
  std::mutex mutex_;
  std::vector<ToolForce> forces_;
  suture::Reader<ToolForce> reader_;
};

class Serve : public ::testing::Test {
 protected:
  void start_server(std::vector<std::string> more = {}) {
    std::vector<std::string> command{
        SUTURED_PROGRAM, "serve",         scene_, "--domain", std::to_string(session_.domain),
        "--session",     session_.session};
    command.insert(command.end(), more.begin(), more.end());
    server_.emplace(command);
    ASSERT_NE(server_->read_until("serving scene").find("serving scene"), std::string::npos)
        << server_->output();
  }
  std::unique_ptr<Process> start_source() {
    auto source = std::make_unique<Process>(
        std::vector<std::string>{POSE_SOURCE, std::to_string(session_.domain), session_.session,
                                 "probe", "0.011", "0.009", std::to_string(kTouching_m)});
    source->read_until("ready");
    return source;
  }
  std::unique_ptr<RawDevice> start_device() {
    auto device = std::make_unique<RawDevice>(session_, "probe");
    device->move_to(0.011, 0.009, kTouching_m);
    return device;
  }
  /// Waits until the hand feels the tissue in full.
  void await_rendering() {
    ASSERT_TRUE(eventually([this] {
      const ToolForce force = watcher_.last();
      return force.state == suture_v1_TOOL_RENDERING && norm(force.force_n) > 0.02;
    })) << server_->output();
  }
  /// Waits until one more checkpoint of the second is there.
  static void await_checkpoint(const std::string& folder) {
    const auto files = [&] {
      return std::distance(std::filesystem::directory_iterator(folder), {});
    };
    const auto before = files();
    ASSERT_TRUE(eventually([&] { return files() > before; }));
  }
  void await_zero() {
    ASSERT_TRUE(eventually([this] { return norm(watcher_.last().force_n) == 0.0; }));
  }
  /// Waits until forces go on being sent beyond the promised time.
  void await_end_of_promise() {
    const std::int64_t good_ns = last_answer_ns(watcher_.all());
    ASSERT_TRUE(eventually([&] { return watcher_.last().stamp_ns > good_ns + kPromise_ns + kMs; }));
  }
  void collect_events() {
    suture::v1::Event event;
    suture::SampleInfo info;
    while (event_reader_.take(event, info))
      if (info.valid) events_.push_back(event);
  }
  bool saw_event(suture_v1_EventKind kind, std::uint32_t faults = 0) {
    return eventually([&] {
      collect_events();
      return std::any_of(events_.begin(), events_.end(), [&](const auto& event) {
        return event.kind == kind && (faults == 0 || (event.faults & faults) != 0);
      });
    });
  }
  /// Magnitude and slew of all forces, in their own time. The half millisecond is for the
  /// clocks of a stamp, which are read one after the other.
  static void expect_within_limits(const std::vector<ToolForce>& forces) {
    for (std::size_t i = 0; i < forces.size(); ++i) {
      ASSERT_LE(norm(forces[i].force_n), kMaxForce_n * (1 + 1e-9));
      if (i == 0 || forces[i].sequence_number < forces[i - 1].sequence_number) continue;
      double step[3];
      for (int k = 0; k < 3; ++k) step[k] = forces[i].force_n[k] - forces[i - 1].force_n[k];
      const double elapsed_s =
          static_cast<double>(forces[i].stamp_ns - forces[i - 1].stamp_ns + kMs / 2) * 1e-9;
      ASSERT_LE(norm(step), kMaxSlew_n_per_s * elapsed_s) << "force " << i;
    }
  }
  /// The forces reach zero by 50 ms after `good_ns` and stay there, up to `until_ns`.
  static void expect_zero_after(const std::vector<ToolForce>& forces, std::int64_t good_ns,
                                std::int64_t until_ns = std::numeric_limits<std::int64_t>::max()) {
    int late = 0;
    std::int64_t felt_ns = good_ns;
    for (const ToolForce& force : forces) {
      if (force.stamp_ns <= good_ns || force.stamp_ns >= until_ns) continue;
      if (norm(force.force_n) > 0.0) felt_ns = std::max(felt_ns, force.stamp_ns);
      late += force.stamp_ns > good_ns + kPromise_ns;
    }
    EXPECT_LE(felt_ns - good_ns, kPromise_ns);
    EXPECT_GT(late, 0) << "nothing was sent after the fade: the claim is empty";
    std::printf("zero %.1f ms after the last good sample\n",
                static_cast<double>(felt_ns - good_ns) * 1e-6);
  }
  /// When the last force that answers a pose was computed.
  static std::int64_t last_answer_ns(const std::vector<ToolForce>& forces,
                                     std::uint64_t before_pose = UINT64_MAX) {
    std::int64_t stamp_ns = 0;
    for (const ToolForce& force : forces)
      if ((force.flags & suture_v1_FORCE_FROM_SUPERVISOR) == 0 && force.pose_sequence < before_pose)
        stamp_ns = std::max(stamp_ns, force.stamp_ns);
    return stamp_ns;
  }

  [[nodiscard]] suture::SessionOptions session_options() const {
    return testing::client_options(session_);
  }

  suture::ParticipantOptions session_ = testing::own_session();
  testing::TemporaryFolder folder_;
  std::string scene_ =
      testing::PressedBlock{.max_force_n = kMaxForce_n, .max_force_slew_n_per_s = kMaxSlew_n_per_s}
          .write(folder_);
  suture::Participant participant_{session_, suture::Channel::kControl};
  ForceWatcher watcher_{participant_};
  suture::Reader<suture::v1::Event> event_reader_{participant_};
  std::vector<suture::v1::Event> events_;
  std::optional<Process> server_;
};

TEST_F(Serve, AnswersNearlyEveryPoseOnceAndInOrder) {
  start_server();
  const auto device = start_device();
  await_rendering();
  constexpr std::uint64_t kPoses = 4000;
  watcher_.clear();
  const std::uint64_t first = device->sent() + 1;
  ASSERT_TRUE(eventually([&] { return device->sent() >= first + kPoses; }));
  device->pause(true);
  await_zero();

  std::set<std::uint64_t> answered;
  std::uint64_t last = 0;
  for (const ToolForce& force : watcher_.all()) {
    if ((force.flags & suture_v1_FORCE_FROM_SUPERVISOR) != 0) continue;
    if (force.pose_sequence < first || force.pose_sequence >= first + kPoses) continue;
    ASSERT_GT(force.pose_sequence, last) << "twice, or out of order";
    last = force.pose_sequence;
    answered.insert(last);
  }
  const double share = 100.0 * static_cast<double>(answered.size()) / kPoses;
  std::printf("%.2f %% of %llu poses answered, in order, none twice\n", share,
              static_cast<unsigned long long>(kPoses));
  EXPECT_GE(share, 99.0);
  expect_within_limits(watcher_.all());
}

TEST_F(Serve, EndsTheForceOfADeviceThatIsKilled) {
  start_server();
  auto source = start_source();
  await_rendering();
  source->send(SIGKILL);
  await_zero();
  await_end_of_promise();
  ASSERT_TRUE(saw_event(suture_v1_EVENT_FAULT, suture_v1_FAULT_POSE_STALE));
  const std::vector<ToolForce> forces = watcher_.all();
  expect_within_limits(forces);
  expect_zero_after(forces, last_answer_ns(forces));
  ASSERT_TRUE(saw_event(suture_v1_EVENT_TOOL_RETURNED));
  watcher_.clear();
  source = start_source();
  await_rendering();
  expect_within_limits(watcher_.all());
}

TEST_F(Serve, EndsTheForceOfADeviceThatStallsAndGivesItBack) {
  start_server();
  const auto source = start_source();
  await_rendering();
  source->send(SIGSTOP);
  await_zero();
  await_end_of_promise();
  ASSERT_TRUE(saw_event(suture_v1_EVENT_FAULT, suture_v1_FAULT_POSE_STALE));
  std::vector<ToolForce> forces = watcher_.all();
  expect_within_limits(forces);
  expect_zero_after(forces, last_answer_ns(forces));
  source->send(SIGCONT);
  await_rendering();
  ASSERT_TRUE(saw_event(suture_v1_EVENT_RECOVERED));
  expect_within_limits(watcher_.all());
}

struct BadPose {
  const char* name;
  std::uint32_t fault;
  void (*spoil)(suture::v1::ToolPose&);
};

class ServeBadPose : public Serve, public ::testing::WithParamInterface<BadPose> {};

TEST_P(ServeBadPose, EndsTheForceSmoothlyAndGivesItBack) {
  start_server();
  const auto device = start_device();
  await_rendering();
  const std::uint64_t first_bad = device->spoil(GetParam().spoil);
  await_zero();
  ASSERT_TRUE(saw_event(suture_v1_EVENT_FAULT, GetParam().fault));
  // Long enough that something is sent after the promised time.
  ASSERT_TRUE(eventually([&] { return watcher_.last().pose_sequence > first_bad + 100; }));
  const std::vector<ToolForce> forces = watcher_.all();
  expect_within_limits(forces);
  expect_zero_after(forces, last_answer_ns(forces, first_bad));
  EXPECT_NE(forces.back().faults & GetParam().fault, 0U);
  device->spoil(nullptr);
  await_rendering();
  ASSERT_TRUE(saw_event(suture_v1_EVENT_RECOVERED));
  expect_within_limits(watcher_.all());
}

INSTANTIATE_TEST_SUITE_P(
    Faults, ServeBadPose,
    ::testing::Values(BadPose{"NotANumber", suture_v1_FAULT_POSE_NOT_FINITE,
                              [](suture::v1::ToolPose& pose) {
                                pose.position_m[0] = std::numeric_limits<double>::quiet_NaN();
                              }},
                      BadPose{"WrongQuaternion", suture_v1_FAULT_POSE_QUATERNION,
                              [](suture::v1::ToolPose& pose) { pose.orientation_xyzw[3] = 2.0; }},
                      BadPose{"Jumps", suture_v1_FAULT_POSE_JUMP,
                              [](suture::v1::ToolPose& pose) {
                                if (pose.sequence_number % 2 == 0) pose.position_m[2] += 0.2;
                              }}),
    [](const auto& fault) { return std::string(fault.param.name); });

TEST_F(Serve, TellsASecondDeviceThatTheToolIsInUse) {
  start_server();
  const auto device = start_device();
  await_rendering();
  const auto rival = start_source();
  ASSERT_TRUE(saw_event(suture_v1_EVENT_TOOL_IN_USE));
  const auto forces = watcher_.all();
  for (const ToolForce& force : forces)
    ASSERT_TRUE(suture::guid_of(force.device) == device->guid());
  expect_within_limits(forces);
}

// What the SDK hands to the hand while its server is stopped, or dies and comes again.
class ServeHand : public Serve, public ::testing::WithParamInterface<suture::Render> {
 protected:
  struct Felt {
    std::int64_t time_ns;
    double force_n;
    suture::ForceState state;
    std::uint64_t sequence;
  };

  void start_hand() {
    suture::DeviceOptions options;
    options.domain = session_.domain;
    options.session = session_.session;
    options.tool = "probe";
    options.timeout = std::chrono::seconds(20);
    options.give_up_after = {};
    options.render = GetParam();
    device_.emplace(options);
    hand_ = std::thread([this] {
      device_->run([this](const suture::Force& force, std::chrono::nanoseconds) {
        const std::lock_guard lock(mutex_);
        felt_.push_back({suture::monotonic_ns(),
                         std::hypot(force.force_n[0], force.force_n[1], force.force_n[2]),
                         force.state, force.sequence});
        suture::Hand hand;
        hand.position_m = {0.011, 0.009, kTouching_m};
        return hand;
      });
    });
  }
  void TearDown() override {
    if (device_) device_->stop();
    if (hand_.joinable()) hand_.join();
  }
  bool await_hand(bool feeling) {
    return eventually([&] {
      const std::lock_guard lock(mutex_);
      if (felt_.empty()) return false;
      const Felt& last = felt_.back();
      return feeling ? last.state == suture::ForceState::kRendering && last.force_n > 0.02
                     : last.force_n == 0.0;
    });
  }
  /// After each last new force before a gap of 50 ms the hand felt nothing 50 ms later.
  void expect_safe() {
    const std::lock_guard lock(mutex_);
    int gaps = 0;
    std::int64_t fresh_ns = felt_.front().time_ns;
    std::uint64_t sequence = 0;
    bool counted = false;
    for (const Felt& felt : felt_) {
      EXPECT_LE(felt.force_n, kMaxForce_n * (1 + 1e-9));
      if (felt.sequence != sequence) {
        sequence = felt.sequence;
        fresh_ns = felt.time_ns;
        counted = false;
      } else if (felt.time_ns - fresh_ns > kPromise_ns) {
        gaps += !counted;
        counted = true;
        EXPECT_EQ(felt.force_n, 0.0);
      }
    }
    EXPECT_GE(gaps, 1) << "the server's silence was not seen";
  }

  std::optional<suture::Device> device_;
  std::thread hand_;
  std::mutex mutex_;
  std::vector<Felt> felt_;
};

TEST_P(ServeHand, IsSafeWhileTheServerStalls) {
  start_server();
  start_hand();
  ASSERT_TRUE(await_hand(true));
  server_->send(SIGSTOP);
  ASSERT_TRUE(await_hand(false));
  ASSERT_TRUE(eventually([this] {
    const std::lock_guard lock(mutex_);
    return felt_.back().state == suture::ForceState::kServerSilent;
  }));
  std::this_thread::sleep_for(std::chrono::milliseconds(100));  // let the silence last
  server_->send(SIGCONT);
  ASSERT_TRUE(await_hand(true));
  expect_safe();
  expect_within_limits(watcher_.all());
}

TEST_P(ServeHand, IsSafeWhenTheServerIsKilledAndFeelsTheNextOne) {
  start_server();
  start_hand();
  ASSERT_TRUE(await_hand(true));
  server_->send(SIGKILL);
  ASSERT_TRUE(await_hand(false));
  start_server();
  ASSERT_TRUE(await_hand(true));
  expect_safe();
}

TEST_P(ServeHand, ObeysAStopCommandUntilAResume) {
  start_server();
  start_hand();
  ASSERT_TRUE(await_hand(true));
  suture::Session session(session_options());
  session.command(suture::CommandKind::kStop);
  ASSERT_TRUE(await_hand(false));
  {
    const std::lock_guard lock(mutex_);
    EXPECT_EQ(felt_.back().state, suture::ForceState::kStopped);
  }
  EXPECT_TRUE(eventually([&] { return session.status().state == "stopped"; }));
  session.command(suture::CommandKind::kResume);
  ASSERT_TRUE(await_hand(true));
}

TEST_P(ServeHand, IsReportedAsWhatTheHandFelt) {
  start_server();
  start_hand();
  ASSERT_TRUE(await_hand(true));
  suture::Session session(session_options());
  EXPECT_TRUE(eventually([&] {
    const auto status = session.next_status(std::chrono::seconds(20));
    double felt_n = 0.0;
    {
      const std::lock_guard lock(mutex_);
      felt_n = felt_.back().force_n;
    }
    const suture::ToolStatus& tool = status->tools[0];
    return tool.renders_itself == (GetParam() == suture::Render::kDevice) &&
           std::abs(tool.force_n - felt_n) < 1e-6 && tool.faults == 0;
  }));
}

INSTANTIATE_TEST_SUITE_P(Renderers, ServeHand,
                         ::testing::Values(suture::Render::kServer, suture::Render::kDevice),
                         [](const auto& render) {
                           return render.param == suture::Render::kServer ? "Server" : "Device";
                         });

TEST_F(Serve, KeepsToTheLimitsOfADeviceHoweverManyOthersTellOfTheirs) {
  start_server();
  suture::DeviceOptions options;
  options.domain = session_.domain;
  options.session = session_.session;
  options.tool = "probe";
  options.timeout = std::chrono::seconds(20);
  options.limits.max_force_n = 0.015;
  suture::Device device(options);
  suture::Hand hand;
  hand.position_m = {0.011, 0.009, kTouching_m};
  suture::Writer<suture::v1::DeviceProfile> profiles(participant_);
  suture::v1::DeviceProfile profile{};
  suture::set_text(profile.tool, "probe");
  suture::Guid other = profiles.guid();
  // Others come one by one, as on the day of a course, while this one is held at its limit.
  constexpr int kOthers = 100, kTicks = 300;
  int ticks = 0;
  double felt_n = 0.0, most_n = 0.0;
  device.run(
      [&](const suture::Force& force, std::chrono::nanoseconds) -> std::optional<suture::Hand> {
        felt_n = std::hypot(force.force_n[0], force.force_n[1], force.force_n[2]);
        most_n = std::max(most_n, felt_n);
        const bool there = (force.faults & suture_v1_FAULT_FORCE_LIMIT) != 0 &&
                           force.state == suture::ForceState::kRendering;
        if (ticks == 0 && !there) return hand;
        if (++ticks <= kOthers) {
          other.back() = static_cast<std::uint8_t>(ticks);
          suture::set_guid(profile.device, other);
          EXPECT_TRUE(profiles.write(profile));
        }
        return ticks < kTicks ? std::optional(hand) : std::nullopt;
      });
  EXPECT_NEAR(felt_n, 0.015, 1e-12);
  EXPECT_NEAR(most_n, 0.015, 1e-12);
  EXPECT_GT(device.statistics().forces_received, 0U);
}

TEST_F(Serve, ShowsStressOfThePressedTissue) {
  start_server();
  const suture::Participant mesh(session_, suture::Channel::kMesh);
  suture::Reader<suture::v1::MeshFrame> frames(mesh);
  const auto device = start_device();
  await_rendering();
  double shown_pa = 0.0;
  const auto look = [&](const suture::v1::MeshFrame& frame, const suture::SampleInfo& info) {
    if (!info.valid) return;
    const auto von_mises = suture::span_of(frame.von_mises_pa);
    const auto principal = suture::span_of(frame.principal_pa);
    ASSERT_EQ(suture::span_of(frame.position_m).size(), 3 * von_mises.size());
    ASSERT_EQ(principal.size(), 3 * von_mises.size());
    for (std::size_t v = 0; v < von_mises.size(); ++v) {
      const double a = principal[3 * v], b = principal[3 * v + 1], c = principal[3 * v + 2];
      ASSERT_GE(a, b);
      ASSERT_GE(b, c);
      // Single precision of numbers that may be larger than their differences.
      ASSERT_NEAR(von_mises[v],
                  std::sqrt(((a - b) * (a - b) + (b - c) * (b - c) + (c - a) * (c - a)) / 2),
                  1e-5 * (std::abs(a) + std::abs(c)));
      shown_pa = std::max(shown_pa, static_cast<double>(von_mises[v]));
    }
  };
  EXPECT_TRUE(eventually([&] {
    frames.take_each(look);
    return shown_pa > 100.0 || HasFatalFailure();
  })) << server_->output();
}

TEST_F(Serve, EndsCleanlyOnEitherSignalWithTheForceAtZero) {
  for (const int signal : {SIGINT, SIGTERM}) {
    start_server();
    {
      const auto device = start_device();
      await_rendering();
      server_->send(signal);
      EXPECT_EQ(server_->wait(), 0) << server_->output();
    }
    const std::vector<ToolForce> forces = watcher_.all();
    EXPECT_EQ(norm(forces.back().force_n), 0.0);
    EXPECT_EQ(forces.back().state, suture_v1_TOOL_STOPPED);
    expect_within_limits(forces);
    EXPECT_NE(server_->output().find("stopping"), std::string::npos);
    watcher_.clear();
  }
}

TEST_F(Serve, SaysThatItLeavesInItsLastStatus) {
  suture::Reader<suture::v1::ServerStatus> status(participant_);
  start_server({"--duration", "1"});
  EXPECT_EQ(server_->wait(), 0);
  suture_v1_ServerState last = suture_v1_SERVER_STARTING;
  std::string reason;
  ASSERT_TRUE(eventually([&] {
    status.take_each([&](const suture::v1::ServerStatus& s, const suture::SampleInfo& info) {
      if (!info.valid) return;
      last = s.state;
      reason = suture::text_of(s.state_reason);
    });
    return last == suture_v1_SERVER_LEAVING;
  }));
  EXPECT_EQ(reason, "its duration is over");
}

TEST_F(Serve, RefusesASecondServerInTheSameSessionOnly) {
  start_server();
  Process second({SUTURED_PROGRAM, "serve", scene_, "--domain", std::to_string(session_.domain),
                  "--session", session_.session});
  EXPECT_EQ(second.wait(), 3);
  EXPECT_NE(second.output().find("has a server"), std::string::npos) << second.output();
  EXPECT_NE(second.output().find("--session"), std::string::npos) << second.output();
  Process other({SUTURED_PROGRAM, "serve", scene_, "--domain", std::to_string(session_.domain),
                 "--session", session_.session + "-other", "--duration", "0.1"});
  EXPECT_EQ(other.wait(), 0) << other.output();
}

TEST_F(Serve, OfTwoServersThatStartAtOnceOneServes) {
  const std::vector<std::string> command{
      SUTURED_PROGRAM, "serve",         scene_, "--domain", std::to_string(session_.domain),
      "--session",     session_.session};
  std::vector<std::unique_ptr<Process>> servers;
  for (int i = 0; i < 2; ++i) servers.push_back(std::make_unique<Process>(command));
  suture::Session session(session_options());  // one serves
  const suture::Status status = session.status();
  for (const auto& server : servers) {
    const bool serves = server->pid() == status.pid;
    if (serves) server->send(SIGTERM);
    EXPECT_EQ(server->wait(), serves ? 0 : 3) << server->output();
    EXPECT_EQ(server->output().find("serving scene") != std::string::npos, serves);
    EXPECT_EQ(server->output().find("has a server: scene") != std::string::npos, !serves);
  }
}

TEST_F(Serve, EndsWithItsOwnCodeHoweverOftenItIsAsked) {
  start_server();
  std::atomic<bool> ended{false};
  std::thread impatient([&] {
    while (!ended) server_->send(SIGTERM);
  });
  server_->read_until();
  ended = true;  // its output is closed: it is at its very end, or over
  impatient.join();
  EXPECT_EQ(server_->wait(), 0) << server_->output();
}

TEST_F(Serve, NamesWhatIsWrongWithItsCommandLine) {
  const auto refuses = [this](std::vector<std::string> more, int code, const std::string& text) {
    std::vector<std::string> command{SUTURED_PROGRAM, "serve"};
    command.insert(command.end(), more.begin(), more.end());
    Process process(command);
    EXPECT_EQ(process.wait(), code) << process.output();
    EXPECT_NE(process.output().find(text), std::string::npos) << process.output();
  };
  refuses({scene_, "--domain", "7"}, 2, "even");
  refuses({scene_, "--out", "/proc/x"}, 2, "/proc/x: cannot be made: ");
  refuses({scene_, "--domain", std::to_string(session_.domain), "--session", session_.session,
           "--checkpoints", "/proc/x"},
          2, "/proc/x: cannot be made: ");
  refuses({scene_, "--rate", "5"}, 2, "rate");
  refuses({scene_, "--http", "127.0.0.1:99999"}, 2, "is not an address");
  refuses({scene_, "--http", "::1:8080"}, 2, "is not an address");
  refuses({scene_, "--http", "8080", "--http-key", "key.pem"}, 2, "--http-certificate");
  refuses({scene_, "--domain", std::to_string(session_.domain), "--session", session_.session,
           "--http", "0.0.0.0:0"},
          2, "would let everybody in");
  refuses({scene_, "--duration", "-1"}, 2, "duration");
  refuses({folder_.path("missing.toml")}, 1, "missing.toml");
  refuses({folder_.write("bad.toml", "name = \n")}, 1, "bad.toml:1");
}

TEST_F(Serve, ObeysPauseResumeStopAndReset) {
  start_server();
  const auto device = start_device();
  await_rendering();
  suture::Session session(session_options());
  const auto await_state = [&](suture_v1_ToolState state) {
    return eventually([&] {
      const ToolForce force = watcher_.last();
      return force.state == state &&
             (state == suture_v1_TOOL_RENDERING ? norm(force.force_n) > 0.02
                                                : norm(force.force_n) == 0.0);
    });
  };
  session.command(suture::CommandKind::kPause);
  EXPECT_TRUE(await_state(suture_v1_TOOL_PAUSED));
  session.command(suture::CommandKind::kResume);
  EXPECT_TRUE(await_state(suture_v1_TOOL_RENDERING));
  session.command(suture::CommandKind::kStop);
  EXPECT_TRUE(await_state(suture_v1_TOOL_STOPPED));
  session.command(suture::CommandKind::kResume);
  EXPECT_TRUE(await_state(suture_v1_TOOL_RENDERING));
  const std::uint64_t epoch = watcher_.last().epoch;
  session.command(suture::CommandKind::kReset);
  EXPECT_TRUE(eventually([&] { return watcher_.last().epoch > epoch; }));
  EXPECT_TRUE(await_state(suture_v1_TOOL_RENDERING));
  for (const auto kind : {suture_v1_EVENT_PAUSED, suture_v1_EVENT_RESUMED, suture_v1_EVENT_STOPPED,
                          suture_v1_EVENT_RESET})
    EXPECT_TRUE(saw_event(kind)) << kind;
  expect_within_limits(watcher_.all());
  EXPECT_THROW(session.command(suture::CommandKind::kReleaseTool, {.tool = "spoon"}),
               suture::Error);
}

TEST_F(Serve, ShowsThreadsContactsAndWhatAJawHolds) {
  std::ofstream(scene_, std::ios::app) << R"(
[[needle]]
name = "needle"
pose = { position_m = [0.01, 0.01, 0.06], orientation = [0, 0, 0, 1] }
[[thread]]
name = "thread"
needle = "needle"
tail = "free"
[[tool]]
name = "forceps"
)";
  start_server();
  std::mutex mutex;
  std::string thread, holding;
  std::uint64_t contacts_step = 0, contacts = 0;
  suture::ViewerCallbacks callbacks;
  callbacks.on_thread = [&](const suture::ThreadView& view) {
    const std::lock_guard lock(mutex);
    thread = view.thread;
  };
  callbacks.on_contacts = [&](const suture::ContactsView& view) {
    const std::lock_guard lock(mutex);
    ++contacts;
    contacts_step = view.step;
  };
  callbacks.on_tool = [&](const suture::ToolView& view) {
    const std::lock_guard lock(mutex);
    if (view.tool == "forceps") holding = view.holding;
  };
  suture::Viewer viewer(session_options(), callbacks);
  RawDevice forceps(session_, "forceps");
  forceps.move_to(0.011, 0.009, kSurface_m);
  const auto holds = [&](const std::string& what) {
    return eventually([&] {
      const std::lock_guard lock(mutex);
      return holding == what && thread == "thread" && contacts > 1 && contacts_step > 0;
    });
  };
  EXPECT_TRUE(holds(""));
  forceps.spoil([](suture::v1::ToolPose& pose) { pose.jaw = 1.0F; });  // it closes
  EXPECT_TRUE(holds("block"));
  const auto hand_holds = [this] { return (watcher_.last().flags & suture_v1_FORCE_HOLDING) != 0; };
  EXPECT_TRUE(eventually(hand_holds));
  forceps.spoil(nullptr);
  EXPECT_TRUE(holds(""));
  EXPECT_TRUE(eventually([&] { return !hand_holds(); }));
  viewer.close();
}

TEST_F(Serve, TellsTheQualityOfASutureWhenAFigureChanges) {
  std::ofstream(scene_, std::ios::app) << R"(
[[needle]]
name = "needle"
shape = "straight"
pose = { position_m = [0.01, 0.01, 0.06], orientation = [0, 0, 0, 1] }
[[thread]]
name = "thread"
needle = "needle"
tail = "free"
[[tool]]
name = "forceps"
)";
  start_server();
  RawDevice forceps(session_, "forceps");
  forceps.move_to(0.02, 0.01, 0.06);  // at the needle, in the air
  struct Told {
    double path_m, gap_m;
    std::uint32_t drops;
    std::int64_t stamp_ns;
  };
  std::mutex mutex;
  std::vector<Told> told;
  suture::ViewerCallbacks callbacks;
  callbacks.on_quality = [&](const suture::QualityView& view) {
    const std::lock_guard lock(mutex);
    EXPECT_EQ(view.thread, "thread");
    told.push_back({view.needle_path_m, view.gap_m, view.needle_drops, view.stamp_ns});
  };
  suture::Viewer viewer(session_options(), callbacks);
  const auto tells = [&](auto&& what) {
    return eventually([&] {
      const std::lock_guard lock(mutex);
      return !told.empty() && what(told.back());
    });
  };
  ASSERT_TRUE(tells([](const Told& q) { return q.path_m == 0.0 && q.drops == 0; }));
  forceps.spoil([](suture::v1::ToolPose& pose) { pose.jaw = 1.0F; });
  ASSERT_TRUE(saw_event(suture_v1_EVENT_GRASP));
  forceps.move_to(0.02, 0.01, 0.061);
  ASSERT_TRUE(tells([](const Told& q) { return q.path_m > 0.9e-3 && q.drops == 0; }));
  forceps.spoil(nullptr);  // the jaw opens
  ASSERT_TRUE(tells([](const Told& q) { return q.drops > 0; })) << server_->output();
  viewer.close();
  EXPECT_TRUE(std::isnan(told.back().gap_m));    // the scene has no wound
  for (std::size_t i = 1; i < told.size(); ++i)  // the stamp may come late after the decision
    EXPECT_GE(told[i].stamp_ns - told[i - 1].stamp_ns, 450 * kMs);
}

// ------------------------------------------------------------------ checkpoints

/// The anastomosis, played by a hand that stops with the needle in the first wall.
class ServedBite : public Serve {
 protected:
  static constexpr double kInTheWall_s = 3.3;

  void SetUp() override { scene_ = SUTURED_SOURCE_DIR "/server/scenes/anastomosis/scene.toml"; }

  void play_into_the_wall() {
    track_ = *surgeon_.track("driver");
    device_ = std::make_unique<RawDevice>(session_, "driver");
    const std::int64_t begun_ns = suture::monotonic_ns();
    device_->spoil([this, begun_ns](suture::v1::ToolPose& pose) {
      const double time_s = static_cast<double>(suture::monotonic_ns() - begun_ns) * 1e-9;
      const suture::SurgeonPose at = track_.at(std::clamp(time_s, track_.begin_s(), kInTheWall_s));
      std::copy(at.position_m.begin(), at.position_m.end(), pose.position_m);
      std::copy(at.orientation_xyzw.begin(), at.orientation_xyzw.end(), pose.orientation_xyzw);
      pose.jaw = static_cast<float>(at.jaw);
    });
    suture::ViewerCallbacks callbacks;
    callbacks.on_needle = [this](const suture::NeedleView& view) {
      const std::lock_guard lock(mutex_);
      needle_ = {view.epoch,      std::string(view.holder),
                 view.tip_inside, view.embedded_length_m,
                 view.position_m, view.punctures};
    };
    viewer_ = std::make_unique<suture::Viewer>(session_options(), callbacks);
    ASSERT_TRUE(saw_event(suture_v1_EVENT_PUNCTURE)) << server_->output();
    ASSERT_TRUE(eventually([this] { return needle().embedded_m > 1e-3; }));
    const Needle inside = needle();
    ASSERT_GE(inside.punctures.size(), 1U) << "of where it went in";
    const suture::Puncture& entry = inside.punctures.back();
    EXPECT_EQ(entry.body, "proximal");
    EXPECT_FALSE(entry.inward) << "from tip to tail it leads out";
    EXPECT_NEAR(entry.arc_length_m, inside.embedded_m, 1e-3);
  }
  void TearDown() override {
    if (viewer_) viewer_->close();
    Serve::TearDown();
  }

  struct Needle {
    std::uint64_t epoch = 0;
    std::string holder;
    bool tip_inside = false;
    double embedded_m = 0.0;
    std::array<double, 3> position_m{};
    std::vector<suture::Puncture> punctures;
  };
  Needle needle() {
    const std::lock_guard lock(mutex_);
    return needle_;
  }
  /// Waits until the needle no longer moves, and returns it.
  Needle settled() {
    Needle before = needle();
    int still = 0;
    EXPECT_TRUE(eventually([&] {
      const Needle now = needle();
      if (now.epoch == before.epoch && std::abs(now.embedded_m - before.embedded_m) < 1e-7) {
        ++still;
      } else {
        still = 0;
        before = now;
      }
      return still > 300;
    }));
    return needle();
  }
  static void expect_same(const Needle& now, const Needle& then) {
    EXPECT_EQ(now.holder, then.holder);
    EXPECT_EQ(now.tip_inside, then.tip_inside);
    EXPECT_EQ(now.punctures.size(), then.punctures.size());
    // The hand stands still: what is left is how far friction still lets the needle creep.
    EXPECT_NEAR(now.embedded_m, then.embedded_m, 50e-6);
    for (std::size_t i = 0; i < 3; ++i) EXPECT_NEAR(now.position_m[i], then.position_m[i], 50e-6);
  }
  /// The first force of an epoch is none: it comes back by a ramp.
  void expect_from_zero(std::uint64_t after_epoch) {
    for (const ToolForce& force : watcher_.all()) {
      if (force.epoch <= after_epoch || force.state != suture_v1_TOOL_RAMPING) continue;
      EXPECT_LT(norm(force.force_n), 1e-3);
      return;
    }
    ADD_FAILURE() << "it never ramped";
  }
  static std::size_t files_in(const std::string& folder) {
    return static_cast<std::size_t>(std::distance(std::filesystem::directory_iterator(folder), {}));
  }

  suture::Surgeon surgeon_ =
      suture::read_surgeon(SUTURED_SOURCE_DIR "/server/scenes/anastomosis/one_bite.csv");
  suture::SurgeonTrack track_;
  std::mutex mutex_;
  Needle needle_;
  std::unique_ptr<suture::Viewer> viewer_;
  std::unique_ptr<RawDevice> device_;
};

TEST_F(ServedBite, GoesOnAfterAKillWithTheNeedleInTheWall) {
  const std::string checkpoints = folder_.path("checkpoints");
  start_server({"--checkpoints", checkpoints});
  play_into_the_wall();
  const Needle then = settled();
  ASSERT_EQ(then.holder, "driver");
  const std::size_t files = files_in(checkpoints);
  ASSERT_TRUE(eventually([&] { return files_in(checkpoints) > files + 1; }));  // of it at rest
  server_->send(SIGKILL);
  server_->wait();
  viewer_->close();
  viewer_.reset();
  watcher_.clear();
  start_server({"--checkpoints", checkpoints});
  EXPECT_NE(server_->output().find("resumed at"), std::string::npos) << server_->output();
  suture::ViewerCallbacks callbacks;
  callbacks.on_needle = [this](const suture::NeedleView& view) {
    const std::lock_guard lock(mutex_);
    needle_ = {view.epoch,      std::string(view.holder),
               view.tip_inside, view.embedded_length_m,
               view.position_m, view.punctures};
  };
  viewer_ = std::make_unique<suture::Viewer>(session_options(), callbacks);
  ASSERT_TRUE(eventually([&] { return needle().epoch > then.epoch; }));
  ASSERT_TRUE(eventually([this] { return watcher_.last().state == suture_v1_TOOL_RENDERING; }));
  expect_same(settled(), then);
  expect_from_zero(then.epoch);
  EXPECT_TRUE(saw_event(suture_v1_EVENT_REWOUND));
}

TEST_F(ServedBite, KeepsGoesBackAndRestoresByCommand) {
  start_server({"--checkpoints", folder_.path("checkpoints")});
  play_into_the_wall();
  const Needle then = settled();
  suture::Session session(session_options());
  using Kind = suture::CommandKind;
  EXPECT_NE(session.command(Kind::kCheckpoint, {.checkpoint = "bite"}).find("\"bite\" at"),
            std::string::npos);
  EXPECT_TRUE(saw_event(suture_v1_EVENT_CHECKPOINT));
  session.command(Kind::kReset);
  ASSERT_TRUE(eventually([&] { return needle().epoch > then.epoch && !needle().tip_inside; }));
  const std::uint64_t reset_epoch = needle().epoch;
  session.command(Kind::kRestore, {.checkpoint = "bite"});
  ASSERT_TRUE(eventually([&] { return needle().epoch > reset_epoch; }));
  ASSERT_TRUE(eventually([&] {
    return watcher_.last().epoch > reset_epoch && watcher_.last().state == suture_v1_TOOL_RENDERING;
  }));
  expect_same(settled(), then);
  expect_from_zero(reset_epoch);
  EXPECT_TRUE(saw_event(suture_v1_EVENT_REWOUND));
  // Farther than there is: to the oldest, in the past of what was restored.
  EXPECT_NE(session.command(Kind::kRewind, {.seconds = 1e5}).find("no older checkpoint"),
            std::string::npos);
  ASSERT_TRUE(eventually([this] { return !needle().tip_inside; }));
  for (const char* name : {"../bite", "", "never"})
    EXPECT_THROW(session.command(Kind::kRestore, {.checkpoint = name}), suture::Error) << name;
  EXPECT_THROW(session.command(Kind::kCheckpoint, {.checkpoint = "a/b"}), suture::Error);
  EXPECT_THROW(session.command(Kind::kRewind, {.seconds = -1.0}), suture::Error);
}

TEST_F(Serve, TellsWhyNoCheckpointCanBeUsed) {
  const std::filesystem::path checkpoints = folder_.path("checkpoints");
  const auto seconds = [&] {
    std::set<std::string> files;
    for (const auto& entry : std::filesystem::directory_iterator(checkpoints))
      if (entry.path().extension() == ".checkpoint") files.insert(entry.path().string());
    return files;
  };
  start_server({"--checkpoints", checkpoints});
  ASSERT_TRUE(eventually([&] { return seconds().size() >= 2; }));
  server_->send(SIGKILL);
  server_->wait();
  const std::set<std::string> damaged = seconds();
  for (const std::string& file : damaged) std::filesystem::resize_file(file, 100);
  start_server({"--checkpoints", checkpoints});
  const std::string& told = server_->output();
  for (const std::string& file : damaged)
    EXPECT_NE(told.find("[warning] " + file + ": is damaged"), std::string::npos) << told;
  EXPECT_NE(told.find("no checkpoint can be used: the scene begins anew"), std::string::npos);
  EXPECT_EQ(told.find("resumed at"), std::string::npos);
}

TEST_F(Serve, GoesOnAfterAnEndAsAskedWhereItIsToldTo) {
  const std::string checkpoints = folder_.path("checkpoints");
  const auto starts_and_ends = [&](std::vector<std::string> how) {
    how.insert(how.begin(), {"--checkpoints", checkpoints});
    start_server(how);
    await_checkpoint(checkpoints);
    server_->send(SIGTERM);
    EXPECT_EQ(server_->wait(), 0);
    return server_->output().find("resumed at") != std::string::npos;
  };
  EXPECT_FALSE(starts_and_ends({"--resume", "always"})) << "there is none";
  EXPECT_TRUE(starts_and_ends({"--resume", "always"}));
  EXPECT_FALSE(starts_and_ends({})) << "the default begins anew after an end as asked";
}

TEST_F(Serve, OfARewindAndAResetAtOnceTheLastIsDone) {
  start_server({"--checkpoints", folder_.path("checkpoints"), "--rate", "30"});
  suture::Writer<suture::v1::Command> commands(participant_);
  suture::Reader<suture::v1::CommandReply> replies(participant_);
  ASSERT_TRUE(eventually([&] { return commands.matched() > 0 && replies.matched() > 0; }));
  suture::v1::Command command{};
  suture::set_guid(command.requester, commands.guid());
  std::map<std::uint64_t, suture::v1::CommandReply> answers;
  const auto answer_to = [&](std::uint64_t request) {
    EXPECT_TRUE(eventually([&] {
      suture::v1::CommandReply reply;
      suture::SampleInfo info;
      while (replies.take(reply, info))
        if (info.valid) answers[reply.request] = reply;
      return answers.contains(request);
    })) << request;
    return answers[request];
  };
  const auto ask = [&](suture_v1_CommandKind kind) {
    command.kind = kind;
    command.seconds = 0.1;
    ++command.request;
    commands.write(command);
    return command.request;
  };
  // A server that stands still hears both at once when it goes on; should a beat have come between
  // them, they are given again.
  bool overtaken = false;
  for (int i = 0; i < 5 && !overtaken; ++i) {
    // Until there is something to go back to.
    ASSERT_TRUE(eventually(
        [&] { return answer_to(ask(suture_v1_COMMAND_REWIND)).result == suture_v1_COMMAND_DONE; }));
    server_->send(SIGSTOP);
    const std::uint64_t rewind = ask(suture_v1_COMMAND_REWIND);
    const std::uint64_t reset = ask(suture_v1_COMMAND_RESET);
    server_->send(SIGCONT);
    EXPECT_EQ(answer_to(reset).result, suture_v1_COMMAND_DONE);
    overtaken = answer_to(rewind).result == suture_v1_COMMAND_REFUSED &&
                suture::text_of(answers[rewind].text).starts_with("a reset came behind it");
  }
  EXPECT_TRUE(overtaken);
}

TEST_F(Serve, WithoutAFolderRefusesWhatWantsCheckpoints) {
  start_server();
  suture::Session session(session_options());
  for (const auto kind : {suture::CommandKind::kCheckpoint, suture::CommandKind::kRewind,
                          suture::CommandKind::kRestore}) {
    try {
      session.command(kind, {.checkpoint = "a", .seconds = 1.0});
      ADD_FAILURE() << "not refused";
    } catch (const suture::Error& error) {
      EXPECT_NE(error.mend().find("--checkpoints"), std::string::npos);
    }
  }
}

}  // namespace
}  // namespace sutured
