// SPDX-License-Identifier: GPL-3.0-or-later
// HTTP and WebSocket over TCP or TLS, on one thread. Knows nothing of scenes: what is
// served, and who may come, is up to its handlers.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <variant>

#include "gateway/outbox.hpp"

namespace sutured::gateway {

/// What a browser asks for. Everything in it is a stranger's word.
struct Request {
  std::string path;           ///< `/metrics`, without the query
  std::string query;          ///< `token=…`, undecoded
  std::string host;           ///< header Host
  std::string origin;         ///< header Origin; empty from what is no browser
  std::string authorization;  ///< header Authorization
  std::string subprotocols;   ///< header Sec-WebSocket-Protocol
  std::string if_none_match;
  bool accepts_gzip = false;
};

struct Reply {
  unsigned status = 200;
  std::string content_type = "text/plain; charset=utf-8";
  std::shared_ptr<const std::string> body;
  std::string etag;        ///< with quotes; empty: none
  bool gzip = false;       ///< the body is compressed
  bool immutable = false;  ///< may be kept for a year: its path names its contents
};

/// Returns a reply of one line.
[[nodiscard]] Reply plain_reply(unsigned status, std::string text);

/// Why a WebSocket is closed: a code of RFC 6455, section 7.4.1, and a word.
struct Close {
  std::uint16_t code = 1000;
  std::string reason;
};

/// The server's end of one WebSocket. Called on the gateway's thread.
class WebClient {
 public:
  WebClient() = default;
  virtual ~WebClient() = default;
  WebClient(const WebClient&) = delete;
  WebClient& operator=(const WebClient&) = delete;

  virtual void on_text(std::string_view text) = 0;
  virtual void on_binary(std::span<const std::byte> bytes) = 0;
  /// Returns the next message to send, asked for as soon as the last one is on its way.
  [[nodiscard]] virtual std::optional<Outgoing> next() = 0;
  /// Returns why the connection shall end; nothing while it shall not.
  [[nodiscard]] virtual std::optional<Close> closing() const = 0;

  /// To be called when `next` or `closing` has become something; set by the server.
  std::function<void()> wake = [] {};
};

/// What has passed, since the start.
struct WebCounters {
  std::uint64_t connections = 0;       ///< accepted
  std::uint64_t connections_open = 0;  ///< now
  std::uint64_t connections_refused = 0;
  std::uint64_t requests = 0;
  std::uint64_t bytes_sent = 0;      ///< of WebSocket messages
  std::uint64_t bytes_received = 0;  ///< of WebSocket messages
  std::uint64_t faults = 0;          ///< exceptions, each of which ended what it came from
};

/// Serves one address.
///
/// Bounded: connections, the size of requests (8 KiB of headers, no body) and of messages
/// (64 KiB), the time for a request and for an answer to a ping, the kernel's buffers.
/// Threads: `run` on one; `stop` and `post` from any; handlers are called on `run`'s.
class WebServer {
 public:
  struct Options {
    std::string address = "127.0.0.1";  ///< numeric
    std::uint16_t port = 0;             ///< 0: any free one
    std::string certificate, key;       ///< PEM files; empty: no TLS. Others may not read the key
    std::size_t connections_max = 128;
    std::chrono::seconds request_patience{10};
    std::chrono::seconds idle_patience{30};  ///< then a ping; as long again, then the end
  };
  struct Accepted {
    std::shared_ptr<WebClient> client;
    std::string subprotocol;
  };
  struct Handlers {
    std::function<Reply(const Request&)> get;
    std::function<std::variant<Reply, Accepted>(const Request&)> open;
    /// Told of exceptions, at most once in `kFaultSilence`: of the latest, and of how many.
    std::function<void(const std::string&)> fault = [](const std::string&) {};
  };
  static constexpr std::chrono::seconds kFaultSilence{10};

  /// Binds and listens. Throws suture::Error kNetwork or kBadInput.
  WebServer(const Options& options, Handlers handlers);
  ~WebServer();
  WebServer(const WebServer&) = delete;
  WebServer& operator=(const WebServer&) = delete;

  [[nodiscard]] std::uint16_t port() const noexcept;
  /// Serves until `stop`. What a handler or a task throws ends the connection or the task it
  /// came from, and is counted and told.
  void run();
  /// Says goodbye to all clients (code 1001) and lets `run` return, within a third of a
  /// second.
  void stop();
  /// Runs `task` on the serving thread.
  void post(std::function<void()> task);
  /// Runs `task` on the serving thread again and again, until the end.
  void every(std::chrono::milliseconds period, std::function<void()> task);
  [[nodiscard]] const WebCounters& counters() const noexcept;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace sutured::gateway
