// SPDX-License-Identifier: Apache-2.0
#include "recording.hpp"

#include <chrono>

#include "idl/idl_text.hpp"
#include "sample_facts.hpp"

namespace suture::cli {
namespace {

constexpr auto kBeat = std::chrono::milliseconds(20);
constexpr std::int64_t kFlush_ns = 250'000'000;

}  // namespace

Recording::Recording(const std::string& path, mcap::Writer::Existing existing,
                     std::span<const TopicSpec* const> topics, std::size_t waiting_bytes_max)
    : writer_(path, existing, "", "suture " SUTURE_VERSION),
      waiting_bytes_max_(waiting_bytes_max),
      wall_ns_(wall_clock_ns()),
      monotonic_ns_(monotonic_ns()),
      size_bytes_(writer_.size_bytes()) {
  for (const TopicSpec* topic : topics) {
    const std::uint16_t schema =
        writer_.add_schema(topic->descriptor->m_typename, "omgidl", suture_v1_idl());
    lanes_.push_back({topic, writer_.add_channel(schema, topic->name, "cdr"), {}, {}});
  }
  thread_ = std::thread([this] { work(); });
}

Recording::~Recording() {
  {
    const std::lock_guard lock(mutex_);
    finishing_ = true;
  }
  wake_.notify_one();
  if (thread_.joinable()) thread_.join();
}

std::uint64_t Recording::now_ns() const noexcept {
  return static_cast<std::uint64_t>(wall_ns_ + (suture::monotonic_ns() - monotonic_ns_));
}

void Recording::add(std::size_t topic, SerializedSample sample, const SampleInfo& info) {
  used_ = true;
  Lane& lane = lanes_[topic];
  const std::uint64_t received_ns = now_ns();
  if (first_ns_ == 0) first_ns_ = received_ns;
  ++lane.counts.samples;
  std::uint32_t sequence = 0;
  if (const std::optional<SampleHead> head = sample_head(*lane.topic, sample.bytes())) {
    sequence = static_cast<std::uint32_t>(head->sequence);
    if (head->counts) {
      auto& [epoch, last] = lane.last[{info.writer, head->key}];
      if (last != 0 && epoch == head->epoch && head->sequence > last + 1) {
        lane.counts.missing += head->sequence - last - 1;
      }
      epoch = head->epoch;
      last = head->sequence;
    }
  }
  const std::size_t size = sample.bytes().size();
  if (failed() || waiting_bytes_.load() + size > waiting_bytes_max_) {
    ++lane.counts.dropped;
    return;
  }
  waiting_bytes_.fetch_add(size);
  const std::lock_guard lock(mutex_);
  waiting_.push_back(
      {std::move(sample),
       {lane.channel, sequence, received_ns, static_cast<std::uint64_t>(info.stamp_ns), {}},
       {}});
}

void Recording::add(mcap::Metadata metadata) {
  used_ = true;
  const std::lock_guard lock(mutex_);
  waiting_.push_back({{}, {}, std::move(metadata)});
}

Recording::Counts Recording::total() const {
  Counts total;
  for (const Lane& lane : lanes_) {
    total.samples += lane.counts.samples;
    total.missing += lane.counts.missing;
    total.dropped += lane.counts.dropped;
  }
  return total;
}

double Recording::duration_s() const {
  return first_ns_ == 0 ? 0.0 : 1e-9 * static_cast<double>(now_ns() - first_ns_);
}

bool Recording::finish() {
  const Counts all = total();
  if (used_ || !writer_.replaces()) {
    add(mcap::Metadata{"suture.recording",
                       {{"duration_s", std::to_string(duration_s())},
                        {"samples", std::to_string(all.samples)},
                        {"missing", std::to_string(all.missing)},
                        {"dropped", std::to_string(all.dropped)}}});
  }
  {
    const std::lock_guard lock(mutex_);
    finishing_ = true;
  }
  wake_.notify_one();
  thread_.join();
  if (failed()) throw Error(*failure_);
  if (writer_.replaces()) return false;
  writer_.finish();
  size_bytes_ = writer_.size_bytes();
  return true;
}

void Recording::work() noexcept {
  std::vector<Item> items;
  std::int64_t flushed_ns = suture::monotonic_ns();
  for (bool finishing = false; !finishing;) {
    {
      std::unique_lock lock(mutex_);
      finishing = wake_.wait_for(lock, kBeat, [this] { return finishing_; });
      items.swap(waiting_);
    }
    try {
      write(items);
      if (const std::int64_t now = suture::monotonic_ns(); now - flushed_ns >= kFlush_ns) {
        flushed_ns = now;
        writer_.flush();
      }
      size_bytes_.store(writer_.size_bytes(), std::memory_order_relaxed);
    } catch (const Error& error) {
      if (!failed()) failure_ = error;
      failed_.store(true, std::memory_order_release);
    }
    items.clear();
  }
  try {
    writer_.flush();
  } catch (const Error& error) {
    if (!failed()) failure_ = error;
    failed_.store(true, std::memory_order_release);
  }
}

void Recording::write(const std::vector<Item>& items) {
  for (const Item& item : items) {
    if (item.metadata) {
      writer_.write(*item.metadata);
      continue;
    }
    mcap::Message message = item.message;
    message.data = item.sample.bytes();
    waiting_bytes_.fetch_sub(message.data.size());
    writer_.write(message);
  }
}

}  // namespace suture::cli
