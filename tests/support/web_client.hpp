// SPDX-License-Identifier: GPL-3.0-or-later
// A web client by bare sockets: it can be as slow and as wrong as a test wants.
#pragma once

#include <arpa/inet.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>

namespace sutured::testing {

/// A connection to a port of this machine. Throws std::system_error where nobody listens.
class TcpClient {
 public:
  /// `receive_buffer` is what the kernel keeps for who does not read; 0: as usual.
  explicit TcpClient(std::uint16_t port, int receive_buffer = 0)
      : fd_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    if (receive_buffer > 0)
      setsockopt(fd_, SOL_SOCKET, SO_RCVBUF, &receive_buffer, sizeof receive_buffer);
    const int on = 1;
    setsockopt(fd_, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(port);
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (::connect(fd_, reinterpret_cast<const sockaddr*>(&to), sizeof to) != 0) {
      const std::error_code why(errno, std::generic_category());
      ::close(std::exchange(fd_, -1));
      throw std::system_error(why, "port " + std::to_string(port));
    }
  }
  ~TcpClient() {
    if (fd_ >= 0) ::close(fd_);
  }
  TcpClient(TcpClient&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  TcpClient& operator=(TcpClient&& other) noexcept {
    std::swap(fd_, other.fd_);
    return *this;
  }

  [[nodiscard]] int fd() const { return fd_; }

  /// Sends all of it; false where the other side has gone.
  bool send(std::string_view bytes) const {
    while (!bytes.empty()) {
      const ssize_t sent = ::send(fd_, bytes.data(), bytes.size(), MSG_NOSIGNAL);
      if (sent <= 0) return false;
      bytes.remove_prefix(static_cast<std::size_t>(sent));
    }
    return true;
  }
  /// Says whether something has arrived, or the other side has gone.
  [[nodiscard]] bool readable() const {
    pollfd ready{fd_, POLLIN, 0};
    return ::poll(&ready, 1, 0) > 0;
  }
  /// Appends what comes next to `bytes`, and waits for it; false where the other side has gone.
  /// Throws where nothing comes for half a minute.
  bool receive(std::string& bytes) const {
    constexpr int kPatience_ms = 30'000;  // only a failure reaches it
    pollfd ready{fd_, POLLIN, 0};
    if (::poll(&ready, 1, kPatience_ms) <= 0) throw std::runtime_error("the server says nothing");
    char buffer[16384];
    const ssize_t got = ::recv(fd_, buffer, sizeof buffer, 0);
    if (got <= 0) return false;
    bytes.append(buffer, static_cast<std::size_t>(got));
    return true;
  }
  /// Says that nothing more will be sent, and returns what the other side says until it ends too.
  [[nodiscard]] std::string finish() const {
    ::shutdown(fd_, SHUT_WR);
    std::string rest;
    while (receive(rest)) {
    }
    return rest;
  }
  /// Goes at once, and without a goodbye (RST).
  void abort() {
    const linger at_once{1, 0};
    setsockopt(fd_, SOL_SOCKET, SO_LINGER, &at_once, sizeof at_once);
    ::close(std::exchange(fd_, -1));
  }

 private:
  int fd_;
};

/// Sends one request and returns all of the answer.
inline std::string http_get(std::uint16_t port, const std::string& path) {
  const TcpClient client(port);
  client.send("GET " + path + " HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n");
  return client.finish();
}

/// A frame of RFC 6455 as a client sends it, masked. `first` holds FIN and opcode.
inline std::string web_frame(std::uint8_t first, std::string_view payload) {
  constexpr std::string_view kMask = "\x12\x34\x56\x78";
  std::string frame(1, static_cast<char>(first));
  const std::size_t size = payload.size();
  const int bytes = size < 126 ? 0 : size < 65536 ? 2 : 8;
  frame += static_cast<char>(0x80U | (bytes == 0 ? size : bytes == 2 ? 126U : 127U));
  for (int i = bytes - 1; i >= 0; --i) frame += static_cast<char>(size >> (8 * i));
  frame += kMask;
  for (std::size_t i = 0; i < size; ++i) frame += static_cast<char>(payload[i] ^ kMask[i % 4]);
  return frame;
}

/// A client of the gateway that speaks Foxglove's protocol.
class WebClient {
 public:
  static constexpr std::uint8_t kText = 0x81, kBinary = 0x82, kPong = 0x8A;
  struct Message {
    bool text = false;
    std::string bytes;
  };

  /// Connects, and waits for the list of channels. Throws std::runtime_error where it is refused.
  explicit WebClient(std::uint16_t port, int receive_buffer = 0) : tcp_(port, receive_buffer) {
    tcp_.send(
        "GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n");
    std::size_t end = std::string::npos;
    while ((end = buffer_.find("\r\n\r\n")) == std::string::npos)
      if (!tcp_.receive(buffer_)) throw std::runtime_error("no answer: " + buffer_);
    if (!buffer_.starts_with("HTTP/1.1 101")) throw std::runtime_error("refused: " + buffer_);
    buffer_.erase(0, end + 4);
    while (channels_.empty()) {
      const std::optional<Message> message = wait();
      if (!message) throw std::runtime_error("no channels were told");
      const auto json = nlohmann::json::parse(message->bytes);
      if (json.at("op") != "advertise") continue;
      for (const auto& channel : json.at("channels"))
        channels_[channel.at("topic")] = channel.at("id");
    }
  }

  [[nodiscard]] const TcpClient& tcp() const { return tcp_; }
  [[nodiscard]] const std::map<std::string, std::uint32_t>& channels() const { return channels_; }
  bool send(std::uint8_t first, std::string_view payload) const {
    return tcp_.send(web_frame(first, payload));
  }
  void subscribe(std::uint32_t subscription, const std::string& topic) const {
    send(kText, R"({"op":"subscribe","subscriptions":[{"id":)" + std::to_string(subscription) +
                    R"(,"channelId":)" + std::to_string(channels_.at(topic)) + "}]}");
  }
  void unsubscribe(std::uint32_t subscription) const {
    send(kText, R"({"op":"unsubscribe","subscriptionIds":[)" + std::to_string(subscription) + "]}");
  }

  /// Returns a message that has arrived whole; nothing where there is none.
  std::optional<Message> next() {
    for (;;) {
      const auto byte = [&](std::size_t i) { return static_cast<std::uint8_t>(buffer_[i]); };
      if (buffer_.size() < 2) return std::nullopt;
      const std::size_t wide = byte(1) == 127 ? 8 : byte(1) == 126 ? 2 : 0;
      if (buffer_.size() < 2 + wide) return std::nullopt;
      std::size_t size = wide == 0 ? byte(1) : 0;
      for (std::size_t i = 0; i < wide; ++i) size = size << 8U | byte(2 + i);
      if (buffer_.size() < 2 + wide + size) return std::nullopt;
      const std::uint8_t first = byte(0);
      std::string payload = buffer_.substr(2 + wide, size);
      buffer_.erase(0, 2 + wide + size);
      if (first == 0x89) {
        send(kPong, payload);
      } else if (first == kText || first == kBinary) {
        return Message{first == kText, std::move(payload)};
      } else if (first == 0x88) {
        goodbye_ = payload.size() > 2 ? payload.substr(2) : "no word";
      }
    }
  }
  /// Returns why the server ended this; empty where it did not say goodbye.
  [[nodiscard]] const std::string& goodbye() const { return goodbye_; }
  /// Says whether something has arrived that was not taken in.
  [[nodiscard]] bool readable() const { return tcp_.readable(); }
  /// Takes in what has arrived, or waits for it; false where the server has gone.
  bool receive() { return tcp_.receive(buffer_); }
  /// Waits for the next message; nothing where the server has gone.
  std::optional<Message> wait() {
    for (;;) {
      if (std::optional<Message> message = next()) return message;
      if (!receive()) return std::nullopt;
    }
  }

 private:
  TcpClient tcp_;
  std::string buffer_, goodbye_;
  std::map<std::string, std::uint32_t> channels_;
};

/// Returns the port of `viewer at http://127.0.0.1:PORT/` in what a server has said.
inline std::uint16_t port_of(const std::string& said) {
  constexpr std::string_view kBefore = "viewer at http://127.0.0.1:";
  const std::size_t found = said.find(kBefore);
  if (found == std::string::npos) throw std::runtime_error("the server did not start: " + said);
  return static_cast<std::uint16_t>(std::stoi(said.substr(found + kBefore.size())));
}

/// Returns a figure of /metrics without labels, as `sutured_web_clients`.
inline double metric(std::uint16_t port, const std::string& name) {
  const std::string text = http_get(port, "/metrics");
  const std::size_t found = text.find("\n" + name + " ");
  if (found == std::string::npos) throw std::runtime_error("no " + name + " in: " + text);
  return std::stod(text.substr(found + name.size() + 2));
}

}  // namespace sutured::testing
