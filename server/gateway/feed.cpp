// SPDX-License-Identifier: GPL-3.0-or-later
#include "gateway/feed.hpp"

#include <string>
#include <utility>

#include "idl/idl_text.hpp"

namespace sutured::gateway {
namespace {

// Instances come from whoever writes; a stranger's names shall not fill the memory.
constexpr std::size_t kInstancesKept = 256;

// Every sample of a small topic is worth a short wait; of what is looked at, the latest.
std::size_t depth_of(const suture::TopicSpec& spec) {
  constexpr std::size_t kShortWait = 64;
  if (spec.depth > 1) return static_cast<std::size_t>(spec.depth);
  return spec.channel == suture::Channel::kControl && !spec.transient_local ? kShortWait : 1;
}

}  // namespace

Feed::Feed(const suture::Participant& control, const suture::Participant& mesh,
           std::function<void()> wake)
    : wake_(std::move(wake)) {
  for (const suture::TopicSpec& spec : suture::all_topics()) {
    Channel channel;
    channel.id = static_cast<std::uint32_t>(channels_.size() + 1);
    channel.topic = spec.name;
    channel.schema_name = spec.descriptor->m_typename;
    channel.schema = suture::suture_v1_idl();
    channels_.push_back(std::move(channel));
    Source source;
    source.spec = &spec;
    source.participant = spec.channel == suture::Channel::kControl ? &control : &mesh;
    source.depth = depth_of(spec);
    sources_.push_back(std::move(source));
  }
  for (Source& source : sources_)
    if (source.spec->transient_local) open(source);
}

void Feed::open(Source& source) {
  suture::EndpointCallbacks callbacks;
  callbacks.data_available = [this] {
    if (!pending_.exchange(true, std::memory_order_acq_rel)) wake_();
  };
  source.reader = std::make_unique<suture::SerializedReader>(
      *source.participant, *source.spec, std::move(callbacks), static_cast<int>(source.depth));
}

void Feed::subscribe(std::uint32_t channel) {
  Source& wanted = source(channel);
  ++wanted.subscribers;
  if (!wanted.reader) open(wanted);
}

void Feed::unsubscribe(std::uint32_t channel) {
  Source& wanted = source(channel);
  --wanted.subscribers;
  wanted.left = std::chrono::steady_clock::now();
}

void Feed::close_idle(std::chrono::steady_clock::time_point now) {
  for (Source& source : sources_)
    if (source.subscribers == 0 && !source.spec->transient_local &&
        now - source.left >= kReaderStays)
      source.reader.reset();
}

void Feed::retained(std::uint32_t channel, const std::function<void(const Delivery&)>& use) const {
  for (const auto& [instance, deliveries] : sources_[channel - 1].kept)
    for (const Delivery& delivery : deliveries) use(delivery);
}

void Feed::keep(Source& source, const Delivery& delivery) {
  if (!source.kept.contains(delivery.instance) && source.kept.size() >= kInstancesKept)
    source.kept.erase(source.kept.begin());
  std::deque<Delivery>& kept = source.kept[delivery.instance];
  if (kept.size() >= static_cast<std::size_t>(source.spec->depth)) kept.pop_front();
  kept.push_back(delivery);
}

void Feed::drain(const std::function<void(const Delivery&)>& use) {
  pending_.store(false, std::memory_order_release);  // what comes from here on wakes again
  for (std::size_t i = 0; i < sources_.size(); ++i) {
    Source& source = sources_[i];
    if (!source.reader) continue;
    source.reader->take_each([&](suture::SerializedSample sample, const suture::SampleInfo& info) {
      if (!info.valid) return;  // a writer has left; what it said last stands
      const Delivery delivery{static_cast<std::uint32_t>(i + 1), info.instance, source.depth,
                              suture::wall_clock_ns(), std::move(sample)};
      if (source.spec->transient_local) keep(source, delivery);
      use(delivery);
    });
  }
}

}  // namespace sutured::gateway
