// SPDX-License-Identifier: GPL-3.0-or-later
// Preloaded into an attacker: sets its wall clock back by ATTACKER_CLOCK seconds, so that its
// own software takes expired keys for good ones.
#include <dlfcn.h>
#include <time.h>

#include <cstdlib>

namespace {
time_t back() {
  const char* const text = std::getenv("ATTACKER_CLOCK");
  return text == nullptr ? 0 : std::atol(text);
}
}  // namespace

extern "C" int clock_gettime(clockid_t clock, timespec* time) noexcept {
  using Function = int (*)(clockid_t, timespec*);
  static const auto real = reinterpret_cast<Function>(dlsym(RTLD_NEXT, "clock_gettime"));
  const int result = real(clock, time);
  if (clock == CLOCK_REALTIME) time->tv_sec -= back();
  return result;
}

extern "C" time_t time(time_t* into) noexcept {
  timespec now{};
  clock_gettime(CLOCK_REALTIME, &now);
  if (into != nullptr) *into = now.tv_sec;
  return now.tv_sec;
}
