// SPDX-License-Identifier: GPL-3.0-or-later
#include "gateway/client.hpp"

#include <algorithm>
#include <utility>

namespace sutured::gateway {

Client::Client(ChannelSource& source, HandPorts& ports, Grant grant, std::string_view session_id)
    : source_(source), grant_(std::move(grant)), hands_(ports) {
  outbox_.push(server_info("sutured", session_id));
  outbox_.push(gateway::advertise(source_.channels()));
}

Client::~Client() {
  for (const auto& [subscription, channel] : subscriptions_) source_.unsubscribe(channel);
}

std::optional<Close> Client::closing() const {
  if (closing_) return closing_;
  if (outbox_.overrun()) return Close{1008, "too much waits to be read"};
  return std::nullopt;
}

void Client::close(std::uint16_t code, std::string reason) {
  if (!closing_) closing_ = Close{code, std::move(reason)};
  wake();
}

bool Client::admit() {
  const auto now = std::chrono::steady_clock::now();
  const double elapsed_s = std::chrono::duration<double>(now - refilled_).count();
  refilled_ = now;
  messages_.refill(elapsed_s);
  faults_.refill(elapsed_s);
  if (!messages_.spend()) {
    close(1008, "too many messages a second");
    return false;
  }
  return !closing_;
}

// A stream of poses that is wrong in one way is told so once.
void Client::complain(const std::string& reason, std::string_view id) {
  if (!faults_.spend()) return close(1008, "too many faulty messages; the last: " + reason);
  if (reason == last_complaint_) return;
  last_complaint_ = reason;
  outbox_.push(status(StatusLevel::kError, reason, id));
  wake();
}

void Client::on_text(std::string_view text) {
  if (!admit()) return;
  std::visit([this](const auto& message) { carry_out(message); }, parse_client_text(text));
}

void Client::on_binary(std::span<const std::byte> bytes) {
  if (!admit()) return;
  const auto message = parse_client_binary(bytes);
  if (!message) return complain("a binary message must be opcode 1, a channel, and a sample");
  const auto channel = publishes_.find(message->channel);
  if (channel == publishes_.end())
    return complain("channel " + std::to_string(message->channel) + " was not advertised");
  const Refusal refusal = hands_.publish(channel->second, message->payload, grant_.rights);
  if (!refusal.reason.empty()) complain(channel->second + ": " + refusal.reason, refusal.id);
}

void Client::carry_out(const Subscribe& subscribe) {
  for (const auto& [subscription, channel] : subscribe.items) {
    if (channel < 1 || channel > source_.channels().size()) {
      complain("there is no channel " + std::to_string(channel));
    } else if (subscriptions_.contains(subscription)) {
      complain("subscription " + std::to_string(subscription) + " is in use");
    } else if (listens_to(channel)) {
      complain("channel " + std::to_string(channel) + " is subscribed already");
    } else {
      subscriptions_.emplace(subscription, channel);
      source_.subscribe(channel);
      source_.retained(channel, [&, id = subscription](const Delivery& kept) {
        outbox_.push(id, kept.instance, kept.depth, kept.received_ns, kept.sample);
      });
    }
  }
  wake();
}

void Client::carry_out(const Unsubscribe& unsubscribe) {
  for (const std::uint32_t subscription : unsubscribe.subscriptions) {
    const auto found = subscriptions_.find(subscription);
    if (found == subscriptions_.end()) {
      complain("there is no subscription " + std::to_string(subscription));
      continue;
    }
    const std::uint32_t channel = found->second;
    subscriptions_.erase(found);
    outbox_.forget(subscription);
    source_.unsubscribe(channel);
  }
}

void Client::carry_out(const Advertise& advertise) {
  for (const Advertise::Item& item : advertise.items) {
    std::string fault = Hands::refuse(item.topic);
    if (item.encoding != "cdr") fault = "clients publish in encoding \"cdr\"";
    if (publishes_.size() >= kChannelsMax && !publishes_.contains(item.channel))
      fault = "a client publishes at most " + std::to_string(kChannelsMax) + " channels";
    if (fault.empty()) {
      publishes_[item.channel] = item.topic;
    } else {
      complain("channel " + std::to_string(item.channel) + ": " + fault);
    }
  }
}

void Client::carry_out(const Unadvertise& unadvertise) {
  for (const std::uint32_t channel : unadvertise.channels)
    if (publishes_.erase(channel) == 0)
      complain("channel " + std::to_string(channel) + " was not advertised");
}

void Client::carry_out(const Unsupported& unsupported) {
  complain("this server does not offer the operation \"" + unsupported.operation + "\"");
}

void Client::carry_out(const Malformed& malformed) { complain(malformed.reason); }

void Client::deliver(const Delivery& delivery) {
  bool wanted = false;
  for (const auto& [subscription, channel] : subscriptions_) {
    if (channel != delivery.channel) continue;
    outbox_.push(subscription, delivery.instance, delivery.depth, delivery.received_ns,
                 delivery.sample);
    wanted = true;
  }
  if (wanted) wake();
}

bool Client::listens_to(std::uint32_t channel) const noexcept {
  return std::any_of(subscriptions_.begin(), subscriptions_.end(),
                     [&](const auto& entry) { return entry.second == channel; });
}

void Client::renew(const Access& access) {
  if (!access.renew(grant_)) close(1008, "this token no longer holds");
}

}  // namespace sutured::gateway
