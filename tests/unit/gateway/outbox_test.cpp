// SPDX-License-Identifier: GPL-3.0-or-later
#include "gateway/outbox.hpp"

#include <gtest/gtest.h>

#include <set>

#include "support/test_session.hpp"

namespace sutured::gateway {
namespace {

using suture::SerializedSample;

/// Makes real samples: events, whose stamp says which one they are.
class Samples {
 public:
  [[nodiscard]] SerializedSample event(std::int64_t number) const {
    suture::v1::Event event{};
    event.stamp_ns = number;
    return codec_.encode(&event).value();
  }
  [[nodiscard]] std::int64_t number(const SerializedSample& sample) const {
    suture::v1::Event event{};
    EXPECT_TRUE(codec_.decode(sample.bytes(), event));
    return event.stamp_ns;
  }
  [[nodiscard]] std::size_t size() const { return event(0).bytes().size(); }

 private:
  suture::Participant participant_{testing::own_session(), suture::Channel::kControl};
  suture::SampleCodec codec_{participant_, suture_v1_Event_desc, "suture/event"};
};

TEST(Outbox, SendsTextsFirst) {
  const Samples samples;
  Outbox outbox;
  outbox.push(1, 1, 4, 0, samples.event(1));
  outbox.push("hello");
  EXPECT_TRUE(outbox.pop()->text);
  const auto sample = outbox.pop();
  ASSERT_TRUE(sample);
  EXPECT_FALSE(sample->text);
  EXPECT_EQ(sample->head.size(), 13U);
  EXPECT_EQ(samples.number(sample->body), 1);
  EXPECT_FALSE(outbox.pop());
  EXPECT_EQ(outbox.bytes(), 0U);
}

TEST(Outbox, KeepsTheNewestOfEachInstance) {
  const Samples samples;
  Outbox outbox;
  for (std::int64_t i = 0; i < 10; ++i)
    for (std::uint64_t instance : {1U, 2U}) outbox.push(5, instance, 3, 0, samples.event(i));
  EXPECT_EQ(outbox.bytes(), 6 * samples.size());
  EXPECT_EQ(outbox.dropped(), 14U);
  std::vector<std::int64_t> order;
  while (const auto message = outbox.pop()) order.push_back(samples.number(message->body));
  EXPECT_EQ(order, (std::vector<std::int64_t>{7, 7, 8, 8, 9, 9})) << "in turn, oldest first";
}

TEST(Outbox, HoldsNoMoreThanItsBytes) {
  const Samples samples;
  Outbox outbox;
  const std::size_t fit = Outbox::kBytesMax / samples.size();
  for (std::size_t i = 0; i < fit + 100; ++i)
    outbox.push(1, i % 1000, 1'000'000, 0, samples.event(static_cast<std::int64_t>(i)));
  EXPECT_LE(outbox.bytes(), Outbox::kBytesMax);
  EXPECT_EQ(outbox.dropped(), 100U);
}

TEST(Outbox, HoldsNoMoreThanItsQueues) {
  const Samples samples;
  Outbox outbox;
  for (std::size_t i = 0; i < Outbox::kQueuesMax + 10; ++i)
    outbox.push(1, i, 1, 0, samples.event(0));
  EXPECT_EQ(outbox.dropped(), 10U);
  EXPECT_EQ(outbox.bytes(), Outbox::kQueuesMax * samples.size());
}

TEST(Outbox, ForgetsASubscription) {
  const Samples samples;
  Outbox outbox;
  outbox.push(1, 1, 4, 0, samples.event(1));
  outbox.push(2, 1, 4, 0, samples.event(2));
  outbox.push(1, 9, 4, 0, samples.event(3));
  outbox.forget(1);
  EXPECT_EQ(outbox.bytes(), samples.size());
  EXPECT_EQ(samples.number(outbox.pop()->body), 2);
  EXPECT_FALSE(outbox.pop());
}

TEST(Outbox, GivesUpAClientThatReadsNoTexts) {
  Outbox outbox;
  for (std::size_t i = 0; i < Outbox::kTextsMax; ++i) outbox.push("x");
  EXPECT_FALSE(outbox.overrun());
  outbox.push("x");
  EXPECT_TRUE(outbox.overrun());
  EXPECT_EQ(outbox.bytes(), Outbox::kTextsMax);
}

}  // namespace
}  // namespace sutured::gateway
