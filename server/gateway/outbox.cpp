// SPDX-License-Identifier: GPL-3.0-or-later
#include "gateway/outbox.hpp"

#include <algorithm>

#include "gateway/foxglove.hpp"

namespace sutured::gateway {

void Outbox::push(std::string text) {
  if (texts_.size() >= kTextsMax) {
    overrun_ = true;
    return;
  }
  bytes_ += text.size();
  texts_.push_back(std::move(text));
}

void Outbox::push(std::uint32_t subscription, std::uint64_t instance, std::size_t depth,
                  std::int64_t received_ns, suture::SerializedSample sample) {
  const Key key{subscription, instance};
  auto found = queues_.find(key);
  if (found != queues_.end() && found->second.size() >= depth) {
    bytes_ -= found->second.front().sample.bytes().size();
    found->second.pop_front();
    ++dropped_;
  }
  const std::size_t size = sample.bytes().size();
  if (bytes_ + size > kBytesMax || (found == queues_.end() && queues_.size() >= kQueuesMax)) {
    ++dropped_;
    if (found != queues_.end() && found->second.empty()) {
      queues_.erase(found);
      std::erase(turns_, key);
    }
    return;
  }
  if (found == queues_.end()) {
    found = queues_.try_emplace(key).first;
    turns_.push_back(key);
  }
  found->second.push_back({received_ns, std::move(sample)});
  bytes_ += size;
}

void Outbox::forget(std::uint32_t subscription) {
  std::erase_if(turns_, [&](const Key& key) { return key.first == subscription; });
  std::erase_if(queues_, [&](const auto& entry) {
    if (entry.first.first != subscription) return false;
    for (const Waiting& waiting : entry.second) bytes_ -= waiting.sample.bytes().size();
    return true;
  });
}

std::optional<Outgoing> Outbox::pop() {
  if (!texts_.empty()) {
    Outgoing message{true, std::move(texts_.front()), {}};
    texts_.pop_front();
    bytes_ -= message.head.size();
    return message;
  }
  if (turns_.empty()) return std::nullopt;
  const Key key = turns_.front();
  turns_.pop_front();
  const auto found = queues_.find(key);
  Waiting waiting = std::move(found->second.front());
  found->second.pop_front();
  bytes_ -= waiting.sample.bytes().size();
  if (found->second.empty()) {
    queues_.erase(found);
  } else {
    turns_.push_back(key);
  }
  return Outgoing{false, message_head(key.first, waiting.received_ns), std::move(waiting.sample)};
}

}  // namespace sutured::gateway
