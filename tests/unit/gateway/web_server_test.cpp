// SPDX-License-Identifier: GPL-3.0-or-later
// The server over real sockets. Its TLS: tests/interop.
#include "gateway/web_server.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <future>
#include <mutex>
#include <thread>
#include <vector>

#include "support/test_session.hpp"
#include "support/web_client.hpp"

namespace sutured::gateway {
namespace {

using testing::eventually;
using ::testing::HasSubstr;
using testing::http_get;

/// A server that fails where it is told to, on a thread of its own.
class WebServerTest : public ::testing::Test {
 protected:
  WebServerTest() {
    thread_ = std::thread([this] { server_.run(); });
  }
  ~WebServerTest() override {
    server_.stop();
    thread_.join();
  }
  static Reply get(const Request& request) {
    if (request.path == "/fault") throw std::runtime_error("of ours");
    return plain_reply(200, "fine");
  }
  [[nodiscard]] WebCounters counters() {
    std::promise<WebCounters> told;
    server_.post([&] { told.set_value(server_.counters()); });
    return told.get_future().get();
  }
  [[nodiscard]] std::vector<std::string> told() {
    const std::lock_guard lock(mutex_);
    return told_;
  }

  std::mutex mutex_;
  std::vector<std::string> told_;
  WebServer server_{{},
                    {.get = get,
                     .open = [](const Request&) { return plain_reply(400, "no"); },
                     .fault =
                         [this](const std::string& text) {
                           const std::lock_guard lock(mutex_);
                           told_.push_back(text);
                         }}};
  std::thread thread_;
};

TEST_F(WebServerTest, AFaultEndsItsConnectionAndIsCountedAndTold) {
  for (int i = 0; i < 5; ++i) EXPECT_EQ(http_get(server_.port(), "/fault"), "");
  EXPECT_THAT(http_get(server_.port(), "/"), HasSubstr("fine")) << "the others stay";
  EXPECT_EQ(counters().faults, 5U);
  EXPECT_EQ(counters().connections_open, 0U);
  ASSERT_EQ(told().size(), 1U) << "not as often as strangers may like";
  EXPECT_THAT(told()[0], HasSubstr("of ours"));
}

TEST_F(WebServerTest, ATaskThatFailsIsRunAgain) {
  std::atomic<int> runs = 0;
  server_.every(std::chrono::milliseconds(1), [&runs] {
    ++runs;
    throw std::runtime_error("task");
  });
  EXPECT_TRUE(eventually([&] { return runs >= 3; }));
  server_.post([] { throw std::runtime_error("posted"); });
  EXPECT_GE(counters().faults, 4U);
  EXPECT_THAT(http_get(server_.port(), "/"), HasSubstr("fine"));
  EXPECT_EQ(told().size(), 1U);
}

}  // namespace
}  // namespace sutured::gateway
