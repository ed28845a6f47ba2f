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

/// What the server answers to `request`, which need not be a whole one.
std::string answer_to(std::uint16_t port, const std::string& request) {
  const testing::TcpClient client(port);
  client.send(request);
  return client.finish();
}

TEST_F(WebServerTest, ReadsAndNothingElse) {
  for (const char* method : {"POST", "PUT", "DELETE", "OPTIONS"}) {
    const std::string answer =
        answer_to(server_.port(), std::string(method) + " / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n");
    EXPECT_TRUE(answer.starts_with("HTTP/1.1 405 ")) << method << ": " << answer;
    EXPECT_THAT(answer, HasSubstr("Allow: GET, HEAD\r\n")) << method;
    EXPECT_THAT(answer, HasSubstr("GET and HEAD only")) << method;
  }
  const std::string head = answer_to(server_.port(), "HEAD / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n");
  EXPECT_TRUE(head.starts_with("HTTP/1.1 200 ")) << head;
  EXPECT_TRUE(head.ends_with("\r\n\r\n")) << "no body: " << head;
}

TEST_F(WebServerTest, HeadersMayHaveEightKibibytes) {
  const auto padded = [&](std::size_t size) {
    std::string request = "GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Padding: ";
    constexpr std::string_view kEnd = "\r\n\r\n";
    request.append(size - request.size() - kEnd.size(), 'x');
    return answer_to(server_.port(), request.append(kEnd));
  };
  constexpr std::size_t kMax = 8U << 10U;
  EXPECT_THAT(padded(kMax), HasSubstr("fine"));
  const std::string refusal = padded(kMax + 512);
  EXPECT_TRUE(refusal.starts_with("HTTP/1.1 431 ")) << refusal;
  EXPECT_THAT(refusal, HasSubstr("the request's headers are too long"));
  EXPECT_THAT(padded(kMax), HasSubstr("fine")) << "the others stay";
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

/// Has always something to send, or never; ends when it is told something, and breaks at "fault".
class Talker : public WebClient {
 public:
  explicit Talker(bool talks) : talks_(talks) {}
  void on_text(std::string_view text) override {
    if (text == "fault") throw std::runtime_error("of the talker");
    told_ = true;
    wake();
  }
  void on_binary(std::span<const std::byte>) override {}
  std::optional<Outgoing> next() override {
    if (!talks_) return std::nullopt;
    return Outgoing{true, std::string(60'000, 'x'), {}};
  }
  [[nodiscard]] std::optional<Close> closing() const override {
    return told_ ? std::optional(Close{1000, "as you say"}) : std::nullopt;
  }

 private:
  bool talks_, told_ = false;
};

/// A server that waits a second for a sign of life, and then as long for the answer to a ping; as
/// long too for the answer to its goodbye.
class PatienceTest : public ::testing::Test {
 protected:
  PatienceTest() {
    thread_ = std::thread([this] { server_.run(); });
  }
  ~PatienceTest() override {
    server_.stop();
    thread_.join();
  }
  [[nodiscard]] std::uint64_t open_connections() {
    std::promise<std::uint64_t> told;
    server_.post([&] { told.set_value(server_.counters().connections_open); });
    return told.get_future().get();
  }
  [[nodiscard]] testing::TcpClient connect(const std::string& path, int receive_buffer = 0) {
    testing::TcpClient client(server_.port(), receive_buffer);
    client.send("GET " + path +
                " HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n");
    return client;
  }

  /// Connects, and returns when the server has let it talk.
  [[nodiscard]] testing::TcpClient talk(const std::string& path) {
    testing::TcpClient client = connect(path);
    hear(client, "\r\n\r\n");
    return client;
  }
  /// Waits until the server has said `words`.
  static void hear(const testing::TcpClient& client, std::string_view words) {
    std::string heard;
    while (heard.find(words) == std::string::npos)
      if (!client.receive(heard)) throw std::runtime_error("gone, after: " + heard);
  }

  std::promise<std::string> faults_;  // told once in a test

  static WebServer::Options impatient() {
    WebServer::Options options;
    options.idle_patience = options.request_patience = std::chrono::seconds(1);
    return options;
  }

  WebServer server_{
      impatient(),
      {.get = [](const Request&) { return plain_reply(404, "no"); },
       .open =
           [](const Request& request) {
             return WebServer::Accepted{std::make_shared<Talker>(request.path == "/talks"), ""};
           },
       .fault = [this](const std::string& text) { faults_.set_value(text); }}};
  std::thread thread_;
};

TEST_F(PatienceTest, AClientThatReadsNothingIsLetGo) {
  const testing::TcpClient stalled = connect("/talks", 4096);
  ASSERT_TRUE(eventually([&] { return open_connections() == 1; }));
  EXPECT_TRUE(eventually([&] { return open_connections() == 0; }))
      << "its connection stays, with what waits to be sent";
}

TEST_F(PatienceTest, AClientThatAnswersNoPingIsLetGo) {
  const testing::TcpClient mute = connect("/silent");
  std::string heard;
  while (mute.receive(heard)) {
  }
  EXPECT_THAT(heard, HasSubstr("101 Switching Protocols"));
  EXPECT_THAT(heard, HasSubstr("\x89")) << "it was asked first";
  EXPECT_TRUE(eventually([&] { return open_connections() == 0; }));
}

TEST_F(PatienceTest, AClientThatBreaksEndsItsConnectionAndWhyIsTold) {
  const testing::TcpClient client = talk("/silent");
  client.send(testing::web_frame(testing::WebClient::kText, "fault"));
  EXPECT_THAT(faults_.get_future().get(), HasSubstr("of the talker"));
  EXPECT_TRUE(eventually([&] { return open_connections() == 0; }));
}

TEST_F(PatienceTest, AClientWhoseNonsenseMeetsTheGoodbyeIsLetGo) {
  for (const bool goes : {false, true}) {
    testing::TcpClient client = talk("/silent");
    // So long that it is read for itself, up to its end: the nonsense behind it is read when the
    // goodbye has been written and its writer has not been told yet.
    client.send(testing::web_frame(testing::WebClient::kText, std::string(20'000, 'x')) +
                testing::web_frame(0xF3, "no frame of RFC 6455"));
    hear(client, "as you say");
    if (goes) client.abort();
    EXPECT_TRUE(eventually([&] { return open_connections() == 0; })) << goes;
  }
}

TEST_F(PatienceTest, AClientThatTalksThroughTheGoodbyeIsLetGo) {
  // A message in parts, in one packet with what ends the connection: all of it has been read, and
  // the parts are on their way to us one by one when the goodbye is written and passes over them.
  constexpr std::uint8_t kFirst = 0x01, kNext = 0x00, kLast = 0x80;
  std::string parts = testing::web_frame(kFirst, "a");
  for (int i = 0; i < 10; ++i) parts += testing::web_frame(kNext, "b");
  parts += testing::web_frame(kLast, "c");
  for (const bool long_ago : {false, true}) {
    const testing::TcpClient client = talk("/silent");
    client.send(testing::web_frame(testing::WebClient::kText, "bye") + parts);
    hear(client, "as you say");
    if (long_ago) client.send(parts);
    EXPECT_TRUE(eventually([&] { return open_connections() == 0; }));
  }
}

TEST_F(PatienceTest, AClientWhoseMessageIsTooLongHearsWhy) {
  // All of it is sent before it is heard: an end that left some unread would be a reset, which
  // takes the goodbye away.
  constexpr std::string_view kWhy =
      "\x03\xF1"
      "a message is longer than 64 KiB";  // 1009
  constexpr std::uint8_t kFirst = 0x01, kNext = 0x00;
  std::string parts = testing::web_frame(kFirst, "a");
  for (int i = 0; i < 40; ++i) parts += testing::web_frame(kNext, std::string(4000, 'b'));
  const std::string whole =
      testing::web_frame(testing::WebClient::kText, std::string(1'000'000, 'x'));
  for (const char* path : {"/silent", "/talks"})
    for (const std::string& message : {whole, parts}) {
      const testing::TcpClient client = talk(path);
      EXPECT_TRUE(client.send(message)) << path;
      hear(client, kWhy);
      EXPECT_TRUE(client.send(testing::web_frame(0x88, kWhy.substr(0, 2)))) << path;
      EXPECT_TRUE(eventually([&] { return open_connections() == 0; })) << path;
    }
}

TEST_F(PatienceTest, AMessageOfTheLargestSizeIsHeard) {
  const testing::TcpClient client = talk("/silent");
  client.send(testing::web_frame(testing::WebClient::kText, std::string(64U << 10U, 'x')));
  hear(client, "as you say");
}

TEST_F(PatienceTest, AClientThatAnswersPingsStays) {
  const testing::TcpClient quiet = connect("/silent");
  std::string heard;
  for (int pings = 0; pings < 3;) {  // more than any one patience lasts
    ASSERT_TRUE(quiet.receive(heard)) << "let go after " << pings << " pings";
    for (std::size_t ping; (ping = heard.find('\x89')) != std::string::npos; ++pings) {
      heard.erase(0, ping + 1);
      quiet.send(testing::web_frame(0x8A, {}));
    }
  }
  EXPECT_EQ(open_connections(), 1U);
}

}  // namespace
}  // namespace sutured::gateway
