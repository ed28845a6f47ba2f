// SPDX-License-Identifier: GPL-3.0-or-later
// The gateway of a server that a hand drives, under bad messages: bytes at random, broken HTTP,
// broken WebSockets, and those who come and say nothing. What must hold is at the end of `run`.
//
// Each attack ends by its own side's end of sending and waits for the server's, so that the attack
// is as fast as the server and no faster. Those that stay half-open are few, and go on meanwhile.
#include <signal.h>
#include <sys/resource.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cstdio>
#include <deque>
#include <map>
#include <nlohmann/json.hpp>
#include <random>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "soak/long_session.hpp"
#include "support/process.hpp"
#include "support/process_facts.hpp"
#include "support/temporary_folder.hpp"
#include "support/web_client.hpp"

namespace sutured::soak {
namespace {

using testing::metric;
using testing::TcpClient;
using testing::web_frame;
using testing::WebClient;

const std::string kFolder = SUTURED_SOURCE_DIR "/server/scenes/anastomosis/";
/// Of the limit of 128 connections: the rest stay for others.
constexpr std::size_t kHalfOpenMax = 40;
constexpr double kGrowthAtMost_kib = 8.0 * 1024.0;

using Random = std::mt19937_64;

std::size_t below(Random& random, std::size_t end) {
  return std::uniform_int_distribution<std::size_t>(0, end - 1)(random);
}

template <class Choices>
const auto& one_of(Random& random, const Choices& choices) {
  return *(std::begin(choices) + static_cast<std::ptrdiff_t>(below(random, std::size(choices))));
}

std::string noise(Random& random, std::size_t size) {
  std::string bytes(size, '\0');
  for (char& byte : bytes) byte = static_cast<char>(below(random, 256));
  return bytes;
}

/// Changes, takes out or puts in a few bytes.
std::string mutated(Random& random, std::string bytes) {
  for (std::size_t i = below(random, 8) + 1; i > 0 && !bytes.empty(); --i) {
    const std::size_t at = below(random, bytes.size());
    switch (below(random, 3)) {
      case 0:
        bytes[at] = static_cast<char>(below(random, 256));
        break;
      case 1:
        bytes.erase(at, below(random, 8) + 1);
        break;
      default:
        bytes.insert(at, noise(random, below(random, 8) + 1));
    }
  }
  return bytes;
}

constexpr std::string_view kUpgrade =
    "GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
    "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n";

/// HTTP that is nearly right.
std::string bad_http(Random& random) {
  const auto request = [](const std::string& line, const std::string& headers = "") {
    return line + "\r\nHost: 127.0.0.1\r\n" + headers + "\r\n";
  };
  switch (below(random, 14)) {
    case 0:
      return noise(random, below(random, 2000) + 1);
    case 1:
      return mutated(random, std::string(kUpgrade));
    case 2:
      return mutated(random, request("GET /metrics HTTP/1.1"));
    case 3: {  // bodies whose lengths lie
      constexpr std::array kLengths{"5",
                                    "-1",
                                    "0x10",
                                    "18446744073709551616",
                                    "99999999999",
                                    "3, 5",
                                    "5\r\nContent-Length: 6"};
      return request("POST / HTTP/1.1",
                     std::string("Content-Length: ") + one_of(random, kLengths) + "\r\n") +
             noise(random, below(random, 64));
    }
    case 4: {
      constexpr std::array kChunks{"5\r\nab", "ffffffffffffffff\r\n", "zz\r\n\r\n", "0\r\n\r\n",
                                   "1;x=\r\na\r\n0\r\nX: y\r\n\r\n"};
      return request("GET / HTTP/1.1", "Transfer-Encoding: chunked\r\nContent-Length: 3\r\n") +
             one_of(random, kChunks);
    }
    case 5:  // headers without an end, or of 20 KiB
      return "GET / HTTP/1.1\r\nX-Long: " + std::string(below(random, 20'000), 'x');
    case 6: {
      std::string many;
      for (std::size_t i = below(random, 400); i > 0; --i)
        many += "X" + std::to_string(i) + ": y\r\n";
      return request("GET / HTTP/1.1", many);
    }
    case 7: {
      constexpr std::array kTargets{
          "/../../etc/passwd",     "/%2e%2e/%2e%2e/etc/passwd", "//",          "*",
          "http://other.example/", "/assets/\\..\\..",          "/?token=%00", "/\x7f",
          "/index.html/."};
      return request(std::string("GET ") + one_of(random, kTargets) + " HTTP/1.1");
    }
    case 8: {
      constexpr std::array kLines{
          "GET / HTTP/0.9",  "GET / HTTP/2.0",       "GET / HTTP/1.10",  "GET /",
          "PRI * HTTP/2.0",  "CONNECT a:1 HTTP/1.1", "TRACE / HTTP/1.1", "\r\n\r\nGET / HTTP/1.1",
          " GET / HTTP/1.1", "G\0T / HTTP/1.1"};
      return request(one_of(random, kLines));
    }
    case 9: {  // upgrades that lack something
      std::string upgrade(kUpgrade);
      constexpr std::array<std::pair<std::string_view, std::string_view>, 7> kChanges{
          {{"Version: 13", "Version: 8"},
           {"Version: 13", "Version: -1"},
           {"dGhlIHNhbXBsZSBub25jZQ==", "short"},
           {"Sec-WebSocket-Key: ", "X: "},
           {"foxglove.sdk.v1", "chat, , ,foxglove.websocket.v2"},
           {"GET / ", "POST / "},
           {"Host: 127.0.0.1", "Host: rebound.example"}}};
      const auto& [what, by] = one_of(random, kChanges);
      return upgrade.replace(upgrade.find(what), what.size(), by);
    }
    case 10: {  // many at once
      std::string pipeline;
      for (std::size_t i = below(random, 50); i > 0; --i)
        pipeline += request("GET /healthz HTTP/1.1");
      return pipeline + "GET";
    }
    case 11:
      return std::string(kUpgrade) +
             noise(random, below(random, 600));  // does not wait for the yes
    case 12:
      return request("GET / HTTP/1.1", "Authorization: Bearer " + noise(random, 40) + "\r\n");
    default:
      return "\x16\x03\x01" + noise(random, below(random, 300));  // a TLS that is none here
  }
}

/// A frame that no client may send, or whose contents no server wants.
std::string bad_frame(Random& random, const std::map<std::string, std::uint32_t>& channels) {
  constexpr std::uint8_t kText = WebClient::kText, kBinary = WebClient::kBinary;
  constexpr std::string_view kTopics[] = {"suture/tool/pose", "suture/tool/device",
                                          "suture/command"};
  const auto binary = [](std::uint32_t channel, const std::string& payload) {
    std::string message(1, '\1');
    for (int i = 0; i < 4; ++i) message += static_cast<char>(channel >> (8 * i));
    return web_frame(kBinary, message + payload);
  };
  switch (below(random, 18)) {
    case 0:
      return noise(random, below(random, 500) + 1);
    case 1:  // not masked
      return std::string("\x81\x05hello", 7);
    case 2:  // reserved bits and opcodes
      return web_frame(static_cast<std::uint8_t>(0x80U | below(random, 128)), noise(random, 20));
    case 3: {  // lengths that lie
      std::string frame = "\x82\xff";
      for (int i = 0; i < 8; ++i) frame += static_cast<char>(i == 0 ? 0x7f : below(random, 256));
      return frame + noise(random, below(random, 200));
    }
    case 4:  // a control frame that is too long, or in parts
      return below(random, 2) == 0 ? web_frame(0x89, std::string(126 + below(random, 500), 'p'))
                                   : web_frame(0x09, "ping");
    case 5:  // parts in the wrong order
      return web_frame(0x01, "{\"op\":") + web_frame(0x81, "{}") + web_frame(0x80, "x");
    case 6:
      return web_frame(0x80, "continues nothing");
    case 7:  // many parts without an end
    {
      std::string frames = web_frame(0x02, "a");
      for (std::size_t i = below(random, 300); i > 0; --i) frames += web_frame(0x00, "b");
      return frames;
    }
    case 8:  // not UTF-8
      return web_frame(kText, "{\"op\":\"\xff\xfe\xc0\x80" + noise(random, 8) + "\"}");
    case 9: {  // goodbyes that make no sense
      const std::size_t code = below(random, 65536);
      return web_frame(0x88, std::string{static_cast<char>(code >> 8U), static_cast<char>(code)} +
                                 noise(random, below(random, 130)));
    }
    case 10:  // longer than any message may be
      return web_frame(kText, std::string((64U << 10U) + below(random, 4096), '['));
    case 11:  // nested as deep as it goes
      return web_frame(kText,
                       std::string(below(random, 60'000), one_of(random, std::string("[{\""))));
    case 12: {
      constexpr std::array kTexts{
          R"({"op":"subscribe","subscriptions":[{"id":1,"channelId":4294967295}]})",
          R"({"op":"subscribe","subscriptions":[{"id":-1,"channelId":1e99}]})",
          R"({"op":"subscribe","subscriptions":{"id":1}})",
          R"({"op":"unsubscribe","subscriptionIds":[7,7,7,"x"]})",
          R"({"op":"advertise","channels":[{"id":1,"topic":"suture/status","encoding":"cdr"}]})",
          R"({"op":"advertise","channels":[{"id":1,"topic":"suture/tool/pose","encoding":"json"}]})",
          R"({"op":"getParameters","parameterNames":[]})",
          R"({"op":7})",
          "null",
          "0",
          "\"\"",
          ""};
      return web_frame(kText, one_of(random, kTexts));
    }
    case 13:
      return web_frame(
          kText, mutated(random, R"({"op":"subscribe","subscriptions":[{"id":9,"channelId":2}]})"));
    case 14: {  // more subscriptions than there may be
      nlohmann::json list = nlohmann::json::array();
      for (std::uint32_t i = 0; i < 300; ++i)
        list.push_back({{"id", i}, {"channelId", 1 + i % channels.size()}});
      return web_frame(kText, nlohmann::json{{"op", "subscribe"}, {"subscriptions", list}}.dump());
    }
    case 15:  // to a channel that was never offered
      return binary(static_cast<std::uint32_t>(below(random, 1000)),
                    noise(random, below(random, 200)));
    case 16: {  // samples that are none; too short for any, so that no command is one by chance
      std::string frames;
      for (std::uint32_t i = 0; i < 3; ++i)
        frames += web_frame(kText, R"({"op":"advertise","channels":[{"id":)" + std::to_string(i) +
                                       R"(,"topic":")" + std::string(kTopics[i]) +
                                       R"(","encoding":"cdr","schemaName":"x"}]})") +
                  binary(i, std::string("\0\1\0\0", 4) + noise(random, below(random, 24)));
      return frames;
    }
    default: {  // poses of the probe that are not finite, out of order, or of no unit length
      std::string pose = std::string("\0\1\0\0", 4) + noise(random, 124);
      return web_frame(
                 kText,
                 R"({"op":"advertise","channels":[{"id":1,"topic":"suture/tool/pose","encoding":"cdr","schemaName":"x"}]})") +
             binary(1, pose) + binary(1, mutated(random, pose));
    }
  }
}

/// Those who come and say nothing, or one byte at a time.
class HalfOpen {
 public:
  HalfOpen(std::uint16_t port, Random& random) : port_(port), random_(random) {}

  void one_more() {
    if (waiting_.size() < kHalfOpenMax) {
      const bool upgraded = below(random_, 3) == 0;
      waiting_.push_back({TcpClient(port_, 4096), upgraded ? std::string() : bad_http(random_)});
      if (upgraded) waiting_.back().client.send(kUpgrade);  // and then reads nothing
      return;
    }
    const std::size_t which = below(random_, waiting_.size());
    Waiting& one = waiting_[which];
    if (!one.unsent.empty() && one.client.send(one.unsent.substr(0, 1)) &&
        below(random_, 16) != 0) {
      one.unsent.erase(0, 1);
      return;
    }
    if (below(random_, 2) == 0) one.client.abort();
    waiting_.erase(waiting_.begin() + static_cast<std::ptrdiff_t>(which));
  }

 private:
  struct Waiting {
    TcpClient client;
    std::string unsent;
  };
  std::uint16_t port_;
  Random& random_;
  std::deque<Waiting> waiting_;
};

/// Sends bad messages of all kinds until there were `count`.
class Attack {
 public:
  Attack(std::uint16_t port, std::uint64_t seed)
      : port_(port),
        random_(seed),
        half_open_(port, random_),
        channels_(WebClient(port).channels()) {}

  /// Sends a message or some; returns how many.
  std::size_t one() {
    switch (below(random_, 8)) {
      case 0:
        half_open_.one_more();
        return 1;
      case 1:
      case 2:
        return http();
      case 3:
        TcpClient(port_).abort();
        return 1;
      default:
        return web_socket();
    }
  }

 private:
  std::size_t http() {
    TcpClient client(port_);
    client.send(bad_http(random_));
    finish(client);
    return 1;
  }
  std::size_t web_socket() {
    TcpClient client(port_);
    client.send(kUpgrade);
    std::size_t sent = 0;
    do {
      ++sent;
      if (!client.send(bad_frame(random_, channels_))) break;
    } while (below(random_, 4) != 0);
    finish(client);
    return sent;
  }
  void finish(TcpClient& client) {
    if (below(random_, 16) == 0) return client.abort();
    static_cast<void>(client.finish());
  }

  std::uint16_t port_;
  Random random_;
  HalfOpen half_open_;
  std::map<std::string, std::uint32_t> channels_;
};

/// A client that does nothing wrong: it must be served to the end.
class GoodClient {
 public:
  explicit GoodClient(std::uint16_t port) : client_(port) {
    client_.subscribe(1, "suture/mesh/frame");
  }
  [[nodiscard]] const std::string& goodbye() const { return client_.goodbye(); }
  /// Waits for so many frames, and takes all that has arrived, pings too: whoever leaves it there
  /// is let go. False where the server has gone.
  bool frames(int count) {
    while (count > 0 || client_.readable()) {
      const auto message = client_.wait();
      if (!message) return false;
      count -= message->text ? 0 : 1;
    }
    return true;
  }

 private:
  WebClient client_;
};

/// What the server counts, as /metrics tells it.
struct Counts {
  double steps = 0.0, overruns = 0.0, missed_ticks = 0.0;

  static Counts of(std::uint16_t port) {
    return {metric(port, "sutured_steps_total"), metric(port, "sutured_overruns_total"),
            metric(port, "sutured_missed_ticks_total")};
  }
  /// Of the steps since `before`.
  [[nodiscard]] double overrun_share(const Counts& before) const {
    return (overruns - before.overruns) / std::max(steps - before.steps, 1.0);
  }
};

int run(std::size_t count, std::uint64_t seed) {
  const testing::TemporaryFolder folder;
  suture::SessionOptions session;
  session.domain = static_cast<std::uint32_t>(2 * (getpid() % 100));
  session.session = "web-attack-" + std::to_string(getpid());
  const auto in_session = [&](std::vector<std::string> words) {
    words.insert(words.end(),
                 {"--domain", std::to_string(session.domain), "--session", session.session});
    return words;
  };
  testing::Process server(
      in_session({SUTURED_PROGRAM, "serve", kFolder + "scene.toml", "--http", "0"}));
  server.read_until("viewer at http://127.0.0.1:");
  const std::uint16_t port = testing::port_of(server.read_until("/\n"));
  {
    suture::Session commands(session);
    fill_history(commands);
  }
  testing::Process hand(
      in_session({SUTURE_CLI, "device", "--surgeon", kFolder + "one_bite.csv", "--loop", "--quiet",
                  "--timeout", "20", "--summary", folder.path("hand.json")}));
  // From another machine it would not have this one's processors.
  setpriority(PRIO_PROCESS, 0, 19);

  GoodClient good(port);
  const auto driven = [&] {
    return testing::http_get(port, "/healthz").find(" 200 ") != std::string::npos &&
           metric(port, "sutured_devices") >= 1;
  };
  while (!driven())
    if (!good.frames(1)) throw std::runtime_error("the server has gone: " + server.output());
  const Counts begin = Counts::of(port);
  constexpr int kQuietFrames = 600;  // of two bodies
  if (!good.frames(kQuietFrames)) throw std::runtime_error("the server sends nothing");
  const Counts quiet = Counts::of(port);

  std::size_t sent = 0;
  double warm_kib = 0.0, most_kib = 0.0;
  std::array<double, 10> tenths_kib{};
  const int files_before = testing::open_files(server.pid());
  int most_files = 0;
  {
    Attack attack(port, seed);
    std::size_t looked = 0;
    while (sent < count) {
      try {
        sent += attack.one();
      } catch (const std::exception& error) {
        server.send(SIGTERM);
        const int code = server.wait();
        throw std::runtime_error(std::string(error.what()) + ", after " + std::to_string(sent) +
                                 " messages; the server ended with " + std::to_string(code) + ": " +
                                 server.output());
      }
      if (sent - looked < 100) continue;
      looked = sent;
      if (!good.frames(1))
        throw std::runtime_error("the good client was let down after " + std::to_string(sent) +
                                 " messages, \"" + good.goodbye() + "\": " + server.output());
      most_files = std::max(most_files, testing::open_files(server.pid()));
      const double kib = testing::resident_kib(server.pid());
      double& most = sent < count / 5 ? warm_kib : most_kib;
      most = std::max(most, kib);
      double& in_tenth = tenths_kib[std::min<std::size_t>(10 * sent / count, 9)];
      in_tenth = std::max(in_tenth, kib);
    }
  }
  const Counts attacked = Counts::of(port);

  const bool still_served = good.frames(20) && GoodClient(port).frames(20);
  // The good client, and the question itself.
  bool all_gone = false;
  for (int looks = 0; looks < 2000 && !all_gone && good.frames(1); ++looks)
    all_gone = metric(port, "sutured_web_connections") <= 2.0;
  const int files_after = testing::open_files(server.pid());
  const double faults = metric(port, "sutured_web_faults_total");
  const double accepted = metric(port, "sutured_web_connections_total");
  const double refused = metric(port, "sutured_web_connections_refused_total");

  hand.send(SIGINT);
  const int hand_code = hand.wait();
  server.send(SIGTERM);
  const int code = server.wait();
  const auto felt = nlohmann::json::parse(testing::read_file(folder.path("hand.json")));
  const auto& tool = felt.at("tools").begin().value();
  const double answered = tool.at("answered_pct"), peak_n = tool.at("peak_force_n");

  std::printf("%zu bad messages, seed %llu, in %.0f connections, %.0f refused\n", sent,
              static_cast<unsigned long long>(seed), accepted, refused);
  std::printf(
      "  overruns       %.2f %% of the steps, %.2f %% before; %.0f missed ticks, %.0f before\n",
      100.0 * attacked.overrun_share(quiet), 100.0 * quiet.overrun_share(begin),
      attacked.missed_ticks - quiet.missed_ticks, quiet.missed_ticks - begin.missed_ticks);
  std::printf("  forces         %.2f %% of the poses answered, at most %.3f N\n", answered, peak_n);
  std::printf("  memory         %.0f KiB after a fifth, %+.0f at most after that\n", warm_kib,
              most_kib - warm_kib);
  std::printf("  MiB by tenths ");
  for (const double kib : tenths_kib) std::printf(" %.1f", kib / 1024.0);
  std::printf("\n  files          %d before, at most %d, %d after\n", files_before, most_files,
              files_after);

  int failed = 0;
  const auto expect = [&](bool holds, const char* what) {
    if (!holds) std::printf("FAILED: %s\n", what);
    failed += holds ? 0 : 1;
  };
  expect(code == 0, "the server lives, and ends as it was asked to");
  expect(hand_code == 128 + SIGINT, "the hand was led to the end");
  expect(still_served, "good clients are served");
  expect(accepted > static_cast<double>(count) / 10.0, "the attack came through");
  expect(all_gone, "connections end with those who made them");
  expect(faults == 0.0, "no exception ended a connection");
  // Both shares are of a machine that has other things to do too.
  expect(attacked.overrun_share(quiet) <= 2.0 * quiet.overrun_share(begin) + 0.1,
         "steps overrun at most twice as often as before, and one in ten more");
  expect(answered >= 90.0, "poses are answered");
  expect(peak_n <= 3.3, "forces are within the tool's limit");
  expect(most_kib - warm_kib <= kGrowthAtMost_kib, "memory grows by 8 MiB at most");
  expect(most_files <= files_before + 128 + 8, "connections are bounded");
  expect(files_after <= files_before + 4, "files are closed");
  if (failed != 0) std::printf("%s", server.output().c_str());
  return failed == 0 ? 0 : 1;
}

}  // namespace
}  // namespace sutured::soak

int main(int argc, char** argv) {
  CLI::App app("Sends bad messages to the gateway of a server that a hand drives");
  std::size_t count = 100'000;
  std::uint64_t seed = 1;
  app.add_option("--count", count, "how many")->capture_default_str();
  app.add_option("--seed", seed, "of their choice")->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  try {
    return sutured::soak::run(count, seed);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "sutured_web_attack: %s\n", error.what());
    return 1;
  }
}
