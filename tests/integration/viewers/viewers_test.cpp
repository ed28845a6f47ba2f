// SPDX-License-Identifier: GPL-3.0-or-later
// Fifty viewers at one server while a hand sews, five of whom never read. What they get is counted
// in frames of the server's, not in seconds.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <signal.h>

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <deque>
#include <vector>

#include "support/process.hpp"
#include "support/process_facts.hpp"
#include "support/test_session.hpp"
#include "support/web_client.hpp"

namespace sutured {
namespace {

using testing::eventually;
using testing::metric;
using testing::own_session;
using testing::Process;
using testing::WebClient;

constexpr int kHealthy = 45, kStalled = 5;
constexpr std::uint64_t kFramesEach = 300;  // of both bodies
/// The server publishes 60 a second: one of six is ten.
constexpr double kShareAtLeast = 10.0 / 60.0;
constexpr double kWaitingAtMost = 1 << 20;
/// Sockets, queues and the buffers of a frame under way, of fifty clients.
constexpr double kGrowthAtMost_kib = 64.0 * 1024.0;

/// Returns the number of a MeshFrame of `body`, which every frame of the server has one of; 0 for
/// another body. CDR: 4 bytes of header, the name, `epoch` and `sequence_number` at multiples of 8.
std::uint64_t frame_number(std::string_view cdr, std::string_view body) {
  std::uint32_t length = 0;
  std::memcpy(&length, cdr.data() + 4, sizeof length);
  if (cdr.substr(8, length - 1) != body) return 0;
  const std::size_t epoch = (4 + length + 7) / 8 * 8;
  std::uint64_t number = 0;
  std::memcpy(&number, cdr.data() + 4 + epoch + 8, sizeof number);
  return number;
}

/// One that reads, and counts what it gets by the numbers that the server gives its frames.
class Watcher {
 public:
  explicit Watcher(std::uint16_t port) : client_(port) {
    client_.subscribe(1, "suture/mesh/frame");
  }

  [[nodiscard]] int fd() const { return client_.tcp().fd(); }
  /// Takes in what has arrived; false where the server has gone.
  bool receive() {
    constexpr std::size_t kHead = 13;
    if (!client_.receive()) return false;
    while (const auto message = client_.next()) {
      if (message->text) continue;
      const std::uint64_t number =
          frame_number(std::string_view(message->bytes).substr(kHead), "distal");
      if (number == 0) continue;
      if (got_ == 0) first_ = number;
      last_ = number;
      ++got_;
    }
    return true;
  }
  [[nodiscard]] std::uint64_t got() const { return got_; }
  /// Of the frames that the server has made since the first that came.
  [[nodiscard]] double share() const {
    return static_cast<double>(got_) / static_cast<double>(last_ - first_ + 1);
  }

 private:
  WebClient client_;
  std::uint64_t got_ = 0, first_ = 0, last_ = 0;
};

/// Lets all of them take in what comes until each has `frames`; false where the server goes.
bool watch(std::deque<Watcher>& watchers, std::uint64_t frames) {
  std::vector<pollfd> ready;
  for (const Watcher& watcher : watchers) ready.push_back({watcher.fd(), POLLIN, 0});
  const auto done = [&] {
    return std::all_of(watchers.begin(), watchers.end(),
                       [&](const Watcher& watcher) { return watcher.got() >= frames; });
  };
  constexpr int kPatience_ms = 20'000;  // only a failure reaches it
  while (!done()) {
    if (::poll(ready.data(), ready.size(), kPatience_ms) <= 0) return false;
    for (std::size_t i = 0; i < ready.size(); ++i)
      if (ready[i].revents != 0 && !watchers[i].receive()) return false;
  }
  return true;
}

class Viewers : public ::testing::Test {
 protected:
  static std::vector<std::string> in_session(std::vector<std::string> words) {
    words.insert(words.end(), {"--domain", std::to_string(own_session().domain), "--session",
                               own_session().session});
    return words;
  }
  Viewers() {
    server_.read_until("viewer at http://127.0.0.1:");
    server_.read_until("/\n");
  }

  const std::string scene_ = SUTURED_SOURCE_DIR "/server/scenes/anastomosis/";
  Process server_{in_session({SUTURED_PROGRAM, "serve", scene_ + "scene.toml", "--http", "0"})};
  Process hand_{in_session({SUTURE_CLI, "device", "--surgeon", scene_ + "one_bite.csv", "--loop",
                            "--quiet", "--timeout", "20"})};
};

TEST_F(Viewers, FiftyOfWhomFiveNeverReadTakeNothingFromTheOthers) {
  const std::uint16_t port = testing::port_of(server_.output());
  std::deque<Watcher> healthy;
  healthy.emplace_back(port);
  ASSERT_TRUE(watch(healthy, 60)) << "the scene moves, and is sent";
  const double before_kib = testing::resident_kib(server_.pid());

  std::deque<WebClient> stalled;
  for (int i = 0; i < kStalled; ++i) {
    stalled.emplace_back(port, /*receive_buffer=*/4096);
    for (const auto& [topic, channel] : stalled.back().channels())
      stalled.back().subscribe(channel, topic);
  }
  while (healthy.size() < kHealthy) healthy.emplace_back(port);
  EXPECT_EQ(metric(port, "sutured_web_clients"), kHealthy + kStalled);
  EXPECT_TRUE(eventually([&] { return metric(port, "sutured_viewers") == kHealthy + kStalled; }))
      << "each of them is counted";

  ASSERT_TRUE(watch(healthy, kFramesEach));
  for (const Watcher& watcher : healthy) EXPECT_GE(watcher.share(), kShareAtLeast);
  EXPECT_GT(metric(port, "sutured_web_dropped_samples_total"), 0) << "the stalled lose frames";
  EXPECT_LE(metric(port, "sutured_web_waiting_bytes"), kStalled * kWaitingAtMost);
  EXPECT_LE(testing::resident_kib(server_.pid()) - before_kib, kGrowthAtMost_kib);
  EXPECT_EQ(metric(port, "sutured_web_faults_total"), 0);

  std::vector<double> shares;
  for (const Watcher& watcher : healthy) shares.push_back(watcher.share());
  std::printf("of the server's frames a viewer got %.0f to %.0f %%; memory grew by %.1f MiB\n",
              100 * *std::min_element(shares.begin(), shares.end()),
              100 * *std::max_element(shares.begin(), shares.end()),
              (testing::resident_kib(server_.pid()) - before_kib) / 1024);

  healthy.clear();
  stalled.clear();
  EXPECT_TRUE(eventually([&] { return metric(port, "sutured_viewers") == 0; }))
      << "the reader that stays for a minute is none of them";

  hand_.send(SIGINT);
  EXPECT_EQ(hand_.wait(), 128 + SIGINT) << "it was led to the end: " << hand_.output();
  server_.send(SIGINT);
  EXPECT_EQ(server_.wait(), 0) << server_.output();
}

}  // namespace
}  // namespace sutured
