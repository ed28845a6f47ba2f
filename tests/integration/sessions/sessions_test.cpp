// SPDX-License-Identifier: GPL-3.0-or-later
// Eight servers and sixteen devices on this machine, in two domains: each session's tissue has a
// stiffness of its own, so that a force says which session it came from.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <map>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>
#include <vector>

#include "integration/serve/raw_device.hpp"
#include "support/pressed_block.hpp"
#include "support/process.hpp"
#include "support/program.hpp"
#include "support/temporary_folder.hpp"
#include "support/test_session.hpp"

namespace sutured {
namespace {

using suture::v1::ToolForce;
using testing::eventually;
using testing::PressedBlock;
using testing::Process;
using testing::RawDevice;

constexpr int kSessions = 8;
constexpr std::size_t kTools = 2;
constexpr std::int64_t kDevicePeriod_ns = 4'000'000;
constexpr std::size_t kForces = 2000;  // to judge, of each device
// Neighbours differ by a fifth. A served force is the offline one but for the last steps of the way
// to rest.
constexpr double kStiffer = 1.2, kTolerance = 0.005;
constexpr double kSoftest_pa = 8.0e3;  // the stiffest stays below the limit of the force

struct Tool {
  const char* name;
  double x_m, y_m, depth_m;
};
// Of different depth, so that the two tools of a session tell themselves apart too.
constexpr std::array<Tool, kTools> kHands{
    {{"left", 0.006, 0.009, 0.0010}, {"right", 0.014, 0.011, 0.0006}}};

struct Heard {
  ToolForce force;
  std::size_t tool;
};

/// One session: a server in a process of its own, two hands, and all forces in its partition.
class SessionUnderTest {
 public:
  SessionUnderTest(int index, const suture::ParticipantOptions& base) : options_(base) {
    // Half in another domain, by pairs, so that neighbours in stiffness share one.
    options_.domain = (base.domain + (index / 2 % 2 == 0 ? 0U : 2U)) % 200U;
    options_.session = base.session + "-" + std::to_string(index);
    scene_ =
        PressedBlock{.young_modulus_pa = kSoftest_pa * std::pow(kStiffer, index)}.write(folder_);
    std::string text = testing::read_file(scene_);
    const std::size_t first_tool = text.find("[[tool]]");
    const std::string tool = text.substr(first_tool);
    text.resize(first_tool);
    // Patience for a machine that eight servers share; the promise for one is tested elsewhere.
    for (const Tool& hand : kHands)
      text += "[[tool]]\nname = \"" + std::string(hand.name) + "\"\nstale_after_ms = 100\n" +
              tool.substr(tool.find("kind"));
    folder_.write("scene.toml", text);
    play_offline();
    server_ = std::make_unique<Process>(std::vector<std::string>{
        SUTURED_PROGRAM, "serve", scene_, "--domain", std::to_string(options_.domain), "--session",
        options_.session, "--rate", "100"});
    server_->read_until("serving scene");
  }

  /// The hands come, and somebody listens.
  void begin() {
    participant_.emplace(options_, suture::Channel::kControl);
    suture::EndpointCallbacks callbacks;
    callbacks.data_available = [this] { listen(); };
    reader_ = suture::Reader<ToolForce>(*participant_, std::move(callbacks));
    ready_ = true;
    for (const Tool& hand : kHands) {
      devices_.push_back(std::make_unique<RawDevice>(options_, hand.name, kDevicePeriod_ns));
      devices_.back()->move_to(hand.x_m, hand.y_m, PressedBlock::height_m(hand.depth_m));
    }
  }

  [[nodiscard]] double signature_n(std::size_t tool) const { return signature_n_[tool]; }
  static double error(double force_n, double signature_n) {
    return std::abs(force_n - signature_n) / signature_n;
  }
  /// Both hands feel what the scene alone gives them.
  bool settled() {
    const std::lock_guard lock(mutex_);
    std::array<bool, kTools> good{};
    for (std::size_t i = heard_.size(); i-- > 0 && heard_.size() - i < 50;)
      good[heard_[i].tool] |=
          error(norm(heard_[i].force), signature_n_[heard_[i].tool]) < kTolerance;
    return std::all_of(good.begin(), good.end(), [](bool yes) { return yes; });
  }
  void forget() {
    const std::lock_guard lock(mutex_);
    heard_.clear();
  }
  std::vector<Heard> heard() {
    const std::lock_guard lock(mutex_);
    return heard_;
  }
  std::array<std::size_t, kTools> counts() {
    const std::lock_guard lock(mutex_);
    std::array<std::size_t, kTools> counts{};
    for (const Heard& heard : heard_) ++counts[heard.tool];
    return counts;
  }
  [[nodiscard]] int strangers() const { return strangers_; }
  RawDevice& device(std::size_t tool) { return *devices_[tool]; }
  [[nodiscard]] const Process& server() const { return *server_; }
  [[nodiscard]] const suture::ParticipantOptions& options() const { return options_; }
  static double norm(const ToolForce& force) {
    return std::hypot(force.force_n[0], force.force_n[1], force.force_n[2]);
  }

 private:
  /// The forces of the same hands, without network or clock.
  void play_offline() {
    std::ostringstream surgeon;
    surgeon << "time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw\n";
    for (const double time_s : {0.0, 0.5, 1.0})
      for (const Tool& hand : kHands)
        surgeon << time_s << ',' << hand.name << ',' << hand.x_m << ',' << hand.y_m << ','
                << PressedBlock::height_m(time_s == 0.0 ? 0.0 : hand.depth_m) << ",0,0,0,1,0\n";
    const auto ran = testing::run_program({SUTURED_PROGRAM, "run", scene_, "--surgeon",
                                           folder_.write("hands.csv", surgeon.str()), "--out",
                                           folder_.path("out"), "--quiet", "--rate", "100"});
    ASSERT_EQ(ran.exit_code, 0) << ran.err;
    std::istringstream lines(testing::read_file(folder_.path("out/tools.csv")));
    for (std::string line; std::getline(lines, line);) {
      std::vector<std::string> fields;
      std::istringstream split(line);
      for (std::string field; std::getline(split, field, ',');) fields.push_back(field);
      for (std::size_t tool = 0; tool < kTools; ++tool)
        if (fields.size() > 12 && fields[1] == kHands[tool].name)
          signature_n_[tool] =
              std::hypot(std::stod(fields[10]), std::stod(fields[11]), std::stod(fields[12]));
    }
  }

  void listen() {
    if (!ready_) return;
    ToolForce force;
    suture::SampleInfo info;
    while (reader_.take(force, info)) {
      if (!info.valid) continue;
      const std::lock_guard lock(mutex_);
      const auto tool = std::find_if(kHands.begin(), kHands.end(), [&](const Tool& hand) {
        return suture::tool_id(hand.name) == force.tool_id;
      });
      if (tool == kHands.end())
        ++strangers_;
      else
        heard_.push_back({force, static_cast<std::size_t>(tool - kHands.begin())});
    }
  }

  suture::ParticipantOptions options_;
  testing::TemporaryFolder folder_;
  std::string scene_;
  std::array<double, kTools> signature_n_{};
  std::unique_ptr<Process> server_;
  std::atomic<bool> ready_{false};
  std::atomic<int> strangers_{0};
  std::mutex mutex_;
  std::vector<Heard> heard_;
  std::optional<suture::Participant> participant_;
  suture::Reader<ToolForce> reader_;
  std::vector<std::unique_ptr<RawDevice>> devices_;
};

/// Seconds of processor time that a process has used.
double cpu_s(pid_t process) {
  const std::string stat = testing::read_file("/proc/" + std::to_string(process) + "/stat");
  std::istringstream fields(stat.substr(stat.rfind(')') + 2));
  std::string skipped;
  for (int i = 0; i < 11; ++i) fields >> skipped;
  double user = 0.0, system = 0.0;
  fields >> user >> system;
  return (user + system) / static_cast<double>(sysconf(_SC_CLK_TCK));
}

/// Memory of a process alone (its private pages) and with what it shares, MB.
std::pair<double, double> memory_mb(pid_t process) {
  std::ifstream statm("/proc/" + std::to_string(process) + "/statm");
  double size = 0.0, resident = 0.0, shared = 0.0;
  statm >> size >> resident >> shared;
  const double page_mb = static_cast<double>(sysconf(_SC_PAGESIZE)) / 1e6;
  return {(resident - shared) * page_mb, resident * page_mb};
}

TEST(Sessions, EightWithSixteenDevicesNeverFeelEachOther) {
  std::vector<std::unique_ptr<SessionUnderTest>> sessions;
  for (int i = 0; i < kSessions; ++i)
    sessions.push_back(std::make_unique<SessionUnderTest>(i, testing::own_session()));
  ASSERT_FALSE(HasFatalFailure());
  for (auto& session : sessions) session->begin();
  for (int i = 0; i < kSessions; ++i)
    ASSERT_TRUE(eventually([&] { return sessions[i]->settled(); }, std::chrono::seconds(60)))
        << "session " << i << '\n'
        << sessions[i]->server().output();

  // The list has each of them once, with both devices.
  const auto& first = sessions.front()->options();
  std::map<std::string, nlohmann::json> listed;
  const auto list = [&] {
    listed.clear();
    const auto ran = testing::run_program({SUTURE_CLI, "sessions", "--json", "--timeout", "20",
                                           "--domain", std::to_string(first.domain), "--domain",
                                           std::to_string((first.domain + 2) % 200)});
    if (ran.exit_code != 0) return false;
    int ours = 0, devices = 0;
    for (const auto& row : nlohmann::json::parse(ran.out)) {
      const auto name = row["session"].get<std::string>();
      if (name.rfind(testing::own_session().session + "-", 0) != 0) continue;
      ++ours;
      devices += row["devices"].get<int>();
      listed[name] = row;
    }
    return ours == kSessions && listed.size() == kSessions && devices == kSessions * int{kTools};
  };
  ASSERT_TRUE(eventually(list, std::chrono::seconds(60)));
  for (const auto& session : sessions) {
    const nlohmann::json& row = listed.at(session->options().session);
    EXPECT_EQ(row["domain"], session->options().domain);
    EXPECT_EQ(row["pid"], session->server().pid());
    EXPECT_EQ(row["scene"], "block");
  }

  std::vector<double> cpu_before_s;
  for (auto& session : sessions) {
    session->forget();
    cpu_before_s.push_back(cpu_s(session->server().pid()));
  }
  const std::int64_t begin_ns = suture::monotonic_ns();
  ASSERT_TRUE(eventually(
      [&] {
        return std::all_of(sessions.begin(), sessions.end(), [](auto& session) {
          const auto counts = session->counts();
          return *std::min_element(counts.begin(), counts.end()) >= kForces;
        });
      },
      std::chrono::seconds(100)));
  const double elapsed_s = 1e-9 * static_cast<double>(suture::monotonic_ns() - begin_ns);

  std::printf("%d sessions, %zu devices at %.0f Hz, scenes at 100 Hz, %.1f s\n", kSessions,
              kTools * kSessions, 1e9 / kDevicePeriod_ns, elapsed_s);
  std::printf(
      "session  domain   E kPa   left N  right N   worst   CPU %%   own MB   resident MB\n");
  std::set<std::uint64_t> epochs;
  for (int i = 0; i < kSessions; ++i) {
    SessionUnderTest& session = *sessions[i];
    EXPECT_EQ(session.strangers(), 0);
    double worst = 0.0;
    std::array<int, kTools> judged{};
    std::set<std::uint64_t> own_epochs;
    for (const auto& [force, tool] : session.heard()) {
      ASSERT_TRUE(suture::guid_of(force.device) == session.device(tool).guid());
      own_epochs.insert(force.epoch);
      if (force.state != suture_v1_TOOL_RENDERING) continue;  // late on a busy machine: it fades
      ++judged[tool];
      worst = std::max(
          worst, SessionUnderTest::error(SessionUnderTest::norm(force), session.signature_n(tool)));
    }
    EXPECT_LT(worst, kTolerance) << "session " << i;
    for (const int count : judged) EXPECT_GT(count, static_cast<int>(kForces) / 2);
    EXPECT_EQ(own_epochs.size(), 1U);
    epochs.insert(own_epochs.begin(), own_epochs.end());
    const auto [own_mb, resident_mb] = memory_mb(session.server().pid());
    std::printf("%7d %7u %7.1f %8.4f %8.4f %6.2f%% %7.1f %8.1f %13.1f\n", i,
                session.options().domain, 1e-3 * kSoftest_pa * std::pow(kStiffer, i),
                session.signature_n(0), session.signature_n(1), 100.0 * worst,
                100.0 * (cpu_s(session.server().pid()) - cpu_before_s[i]) / elapsed_s, own_mb,
                resident_mb);
  }
  EXPECT_EQ(epochs.size(), static_cast<std::size_t>(kSessions));

  // A hand that leaves the tissue in one session is felt in that one alone.
  SessionUnderTest& moved = *sessions[3];
  moved.device(0).move_to(kHands[0].x_m, kHands[0].y_m, PressedBlock::height_m(-0.005));
  ASSERT_TRUE(eventually([&] {
    const auto all = moved.heard();
    const auto last =
        std::find_if(all.rbegin(), all.rend(), [](const Heard& h) { return h.tool == 0; });
    return last != all.rend() && SessionUnderTest::norm(last->force) == 0.0;
  }));
  for (int i = 0; i < kSessions; ++i)
    if (i != 3) {
      sessions[i]->forget();
      EXPECT_TRUE(eventually([&] { return sessions[i]->settled(); })) << "session " << i;
    }
}

}  // namespace
}  // namespace sutured
