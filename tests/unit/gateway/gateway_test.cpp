// SPDX-License-Identifier: GPL-3.0-or-later
// The gateway as a whole, in a session whose server is the test.
#include "gateway/gateway.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <deque>

#include "protocol/endpoint.hpp"
#include "protocol/types.hpp"
#include "support/test_session.hpp"
#include "support/web_client.hpp"

namespace sutured::gateway {
namespace {

using testing::eventually;
using ::testing::HasSubstr;
using ::testing::MatchesRegex;
using testing::own_session;
using testing::WebClient;

class GatewayTest : public ::testing::Test {
 protected:
  static Gateway::Options options() {
    Gateway::Options options;
    options.port = 0;
    options.page = "/nonexistent";
    return options;
  }
  [[nodiscard]] std::uint16_t port() const {
    const std::string url = gateway_.url();
    return static_cast<std::uint16_t>(std::stoi(url.substr(url.rfind(':') + 1)));
  }
  [[nodiscard]] std::string health() const { return testing::http_get(port(), "/healthz"); }
  /// Waits until `/healthz` answers so.
  [[nodiscard]] bool becomes(unsigned status, const std::string& text) const {
    return eventually([&] {
      const std::string answer = health();
      return answer.starts_with("HTTP/1.1 " + std::to_string(status) + " ") &&
             answer.ends_with("\r\n\r\n" + text + "\n");
    });
  }
  void publish(suture_v1_ServerState state, std::string_view reason, std::int64_t stamp_ns) {
    suture::v1::ServerStatus status{};
    status.epoch = 1;
    status.state = state;
    status.stamp_ns = stamp_ns;
    suture::set_text(status.session, own_session().session);
    suture::set_text(status.state_reason, reason);
    writer_.write(status);
  }
  static std::int64_t now_ns() { return suture::wall_clock_ns(); }

  suture::Participant participant_{own_session(), suture::Channel::kControl};
  suture::Writer<suture::v1::ServerStatus> writer_{participant_};
  Gateway gateway_{own_session(), options()};
};

TEST_F(GatewayTest, HealthSaysWhatIsWrong) {
  EXPECT_TRUE(becomes(503, "no status has come from the server")) << health();
  constexpr std::int64_t kAge_ns = 5'000'000'000;
  publish(suture_v1_SERVER_RUNNING, "", now_ns() - kAge_ns);
  EXPECT_TRUE(eventually([&] { return health().find(" s old\n") != std::string::npos; }));
  EXPECT_THAT(health(),
              MatchesRegex("HTTP/1.1 503 [^$]*\r\n\r\nthe last status is [0-9]+ s old\n"));
  // Each as of a clock that is ahead: it does not age on a busy machine.
  const std::int64_t ahead_ns = now_ns() + 3'600'000'000'000;
  publish(suture_v1_SERVER_RUNNING, "", ahead_ns);
  EXPECT_TRUE(becomes(200, "ok")) << health();
  publish(suture_v1_SERVER_STOPPED, "the simulation stands still", ahead_ns);
  EXPECT_TRUE(becomes(503, "the simulation stands still")) << health();
  publish(suture_v1_SERVER_LEAVING, "", ahead_ns);
  EXPECT_TRUE(becomes(503, "the server leaves")) << health();
}

TEST_F(GatewayTest, TakesSixtyFourClientsAndThenWhoComesForOneThatLeft) {
  constexpr int kMax = 64;
  std::deque<WebClient> clients;
  for (int i = 0; i < kMax; ++i) clients.emplace_back(port());
  const auto refusal = [&]() -> std::string {
    try {
      clients.emplace_back(port());
      return "";
    } catch (const std::runtime_error& error) {
      return error.what();
    }
  };
  EXPECT_THAT(refusal(), HasSubstr("HTTP/1.1 503 "));
  EXPECT_THAT(refusal(), HasSubstr("no more than 64 clients at once"));
  EXPECT_THAT(testing::http_get(port(), "/metrics"), HasSubstr("\nsutured_web_clients 64\n"));
  clients.pop_front();
  EXPECT_TRUE(eventually([&] { return refusal().empty(); }));
}

}  // namespace
}  // namespace sutured::gateway
