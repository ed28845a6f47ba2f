// SPDX-License-Identifier: GPL-3.0-or-later
// Two processes exchange poses and forces over the network stack, as device and server do:
// what one process does alone in endpoint_test.cpp never leaves it.
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>

#include "protocol/endpoint.hpp"
#include "support/heap_guard.hpp"
#include "support/test_session.hpp"

namespace suture {
namespace {

using sutured::testing::eventually;
using sutured::testing::HeapGuard;

constexpr std::uint64_t kWarmUp = 500;
constexpr std::uint64_t kCounted = 2000;

/// The device: sends a pose for each answer to the last one, until it is killed.
void play_device(const ParticipantOptions& session) {
  const Participant participant(session, Channel::kControl);
  Writer<v1::ToolPose> writer(participant);
  Reader<v1::ToolForce> reader(participant);
  WaitSet waitset;
  waitset.attach(reader);
  v1::ToolPose pose{};
  pose.tool_id = tool_id("driver");
  pose.orientation_xyzw[3] = 1.0;
  for (;;) {
    ++pose.sequence_number;
    writer.write(pose);
    waitset.wait(std::chrono::milliseconds(20));  // best effort: go on where one is lost
    v1::ToolForce force;
    SampleInfo info;
    while (reader.take(force, info)) {
    }
  }
}

TEST(Exchange, BetweenTwoProcessesAllocatesNothing) {
  if (!HeapGuard::active()) GTEST_SKIP() << "sanitizers bring their own malloc";
  const ParticipantOptions session = sutured::testing::own_session();
  const pid_t device = fork();  // before DDS starts threads
  ASSERT_GE(device, 0);
  if (device == 0) {
    play_device(session);
    _exit(0);
  }

  std::atomic<std::uint64_t> answered{0};
  std::atomic<std::uint64_t> in_callback{0};
  std::atomic<std::uint64_t> before{0}, after{0};
  const HeapGuard whole_process;
  {
    const Participant participant(session, Channel::kControl);
    Writer<v1::ToolForce> writer(participant);
    std::atomic<Reader<v1::ToolPose>*> ready{nullptr};
    EndpointCallbacks callbacks;
    callbacks.data_available = [&] {
      Reader<v1::ToolPose>* const reader = ready;
      if (reader == nullptr) return;
      const HeapGuard guard;
      v1::ToolPose pose;
      SampleInfo info;
      while (reader->take(pose, info)) {
        if (!info.valid) continue;
        v1::ToolForce force{};
        force.tool_id = pose.tool_id;
        force.pose_sequence = pose.sequence_number;
        writer.write(force);
        const std::uint64_t count = ++answered;
        if (count == kWarmUp) before = whole_process.allocations_of_process();
        if (count == kWarmUp + kCounted) after = whole_process.allocations_of_process();
        if (count > kWarmUp) in_callback += guard.allocations();
      }
    };
    Reader<v1::ToolPose> reader(participant, std::move(callbacks));
    ready = &reader;
    EXPECT_TRUE(
        eventually([&] { return answered >= kWarmUp + kCounted; }, std::chrono::seconds(60)));
  }
  kill(device, SIGKILL);
  waitpid(device, nullptr, 0);
  // Cyclone may add a buffer late; a message that cost one would show kCounted times.
  EXPECT_LE(in_callback, 2U);
  // Receiving happens outside the callback, on the same thread; a few allocations of
  // discovery and of Cyclone's timers may fall into the same second.
  std::printf("allocations of the whole process during %llu exchanges: %llu\n",
              static_cast<unsigned long long>(kCounted),
              static_cast<unsigned long long>(after - before));
  EXPECT_LT(after - before, kCounted / 20);
}

}  // namespace
}  // namespace suture
