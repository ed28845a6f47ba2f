// SPDX-License-Identifier: GPL-3.0-or-later
// One web client that speaks Foxglove's protocol.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <map>
#include <string>

#include "gateway/access.hpp"
#include "gateway/feed.hpp"
#include "gateway/foxglove.hpp"
#include "gateway/hands.hpp"
#include "gateway/outbox.hpp"
#include "gateway/web_server.hpp"

namespace sutured::gateway {

/// Who tells clients of channels, and counts those who listen.
class ChannelSource {
 public:
  virtual ~ChannelSource() = default;
  /// Ids from 1, without a gap.
  [[nodiscard]] virtual std::span<const Channel> channels() const = 0;
  virtual void subscribe(std::uint32_t channel) = 0;
  virtual void unsubscribe(std::uint32_t channel) = 0;
  virtual void retained(std::uint32_t channel,
                        const std::function<void(const Delivery&)>& use) const = 0;
};

/// What may be spent: `most` at once, and `per_second` more as time goes.
class Allowance {
 public:
  Allowance(double most, double per_second) : most_(most), per_second_(per_second), left_(most) {}
  void refill(double elapsed_s) { left_ = std::min(left_ + elapsed_s * per_second_, most_); }
  /// Spends one; false where there is none.
  [[nodiscard]] bool spend() {
    if (left_ < 1.0) return false;
    left_ -= 1.0;
    return true;
  }

 private:
  double most_, per_second_, left_;
};

/// The protocol's state for one connection: what it listens to, what it may send, and what
/// waits for it. A message that is wrong is answered with a status that says why; whoever
/// sends `kFaultsMax` of them in short order, or more than `kMessagesPerSecond`, is closed.
///
/// Threads: the gateway's.
class Client : public WebClient {
 public:
  static constexpr std::size_t kChannelsMax = 64;
  static constexpr int kFaultsMax = 100;
  static constexpr double kForgottenFaultsPerSecond = 1.0;
  /// Poses come at up to 4 kHz; some room for the rest.
  static constexpr double kMessagesPerSecond = 6000.0;

  /// `source` and `ports` must outlive it.
  Client(ChannelSource& source, HandPorts& ports, Grant grant, std::string_view session_id);
  ~Client() override;

  void on_text(std::string_view text) override;
  void on_binary(std::span<const std::byte> bytes) override;
  [[nodiscard]] std::optional<Outgoing> next() override { return outbox_.pop(); }
  [[nodiscard]] std::optional<Close> closing() const override;

  /// Queues a sample for those subscriptions that want its channel.
  void deliver(const Delivery& delivery);
  /// Looks whether its token still holds, and closes it where not.
  void renew(const Access& access);

  [[nodiscard]] bool listens_to(std::uint32_t channel) const noexcept;
  [[nodiscard]] const Outbox& outbox() const noexcept { return outbox_; }

 private:
  void carry_out(const Subscribe& subscribe);
  void carry_out(const Unsubscribe& unsubscribe);
  void carry_out(const Advertise& advertise);
  void carry_out(const Unadvertise& unadvertise);
  void carry_out(const Unsupported& unsupported);
  void carry_out(const Malformed& malformed);
  [[nodiscard]] bool admit();
  void complain(const std::string& reason, std::string_view id = {});
  void close(std::uint16_t code, std::string reason);

  ChannelSource& source_;
  Grant grant_;
  Hands hands_;
  Outbox outbox_;
  std::map<std::uint32_t, std::uint32_t> subscriptions_;  // channel by subscription
  std::map<std::uint32_t, std::string> publishes_;        // topic by the client's channel
  std::optional<Close> closing_;
  Allowance messages_{kMessagesPerSecond, kMessagesPerSecond};
  Allowance faults_{kFaultsMax - 1, kForgottenFaultsPerSecond};  // the next one closes
  std::string last_complaint_;
  std::chrono::steady_clock::time_point refilled_ = std::chrono::steady_clock::now();
};

}  // namespace sutured::gateway
