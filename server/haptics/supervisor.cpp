// SPDX-License-Identifier: GPL-3.0-or-later
#include "haptics/supervisor.hpp"

#include <time.h>

#include <cerrno>
#include <utility>

#include "haptics/realtime.hpp"
#include "protocol/types.hpp"

namespace sutured::haptics {

void sleep_until(std::int64_t time_ns) noexcept {
  const timespec until{time_ns / 1'000'000'000, time_ns % 1'000'000'000};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) {
  }
}

Supervisor::Supervisor(std::function<void(std::int64_t)> tick)
    : tick_(std::move(tick)), thread_([this] { run(); }) {}

Supervisor::~Supervisor() {
  stop_.store(true);
  thread_.join();
}

void Supervisor::run() noexcept {
  name_thread("supervisor");
  realtime_.store(enter_realtime(kSupervisorPriority), std::memory_order_relaxed);
  std::int64_t due_ns = suture::monotonic_ns() + kPeriod_ns;
  while (!stop_.load(std::memory_order_relaxed)) {
    sleep_until(due_ns);
    const std::int64_t woke_ns = suture::monotonic_ns();
    wakeup_.record(woke_ns - due_ns);
    tick_(woke_ns);
    ticks_.fetch_add(1, std::memory_order_relaxed);
    const NextTick next = next_tick(due_ns, suture::monotonic_ns(), kPeriod_ns);
    missed_.fetch_add(next.missed, std::memory_order_relaxed);
    due_ns = next.at_ns;
  }
}

}  // namespace sutured::haptics
