// SPDX-License-Identifier: GPL-3.0-or-later
#include "haptics/realtime.hpp"

#include <linux/capability.h>
#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "protocol/participant.hpp"

namespace sutured::haptics {
namespace {

bool may_lock_memory() {
  rlimit limit{};
  if (getrlimit(RLIMIT_MEMLOCK, &limit) == 0 && limit.rlim_cur == RLIM_INFINITY) return true;
  __user_cap_header_struct header{_LINUX_CAPABILITY_VERSION_3, 0};
  __user_cap_data_struct data[2]{};
  if (syscall(SYS_capget, &header, data) != 0) return false;
  return (data[0].effective & (1U << CAP_IPC_LOCK)) != 0;
}

}  // namespace

RealtimeReport prepare_realtime() {
  RealtimeReport report;
  if (may_lock_memory()) {
    // On fault: large stacks and arenas that are never touched cost nothing.
    report.memory_locked = mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) == 0;
    if (!report.memory_locked)
      report.note = std::string("memory not locked: ") + std::strerror(errno) + "; ";
  } else {
    report.note = "memory not locked: RLIMIT_MEMLOCK is finite; ";
  }
  report.sched_fifo = suture::may_run_realtime(kSupervisorPriority);
  if (!report.sched_fifo) report.note += "no SCHED_FIFO: not permitted; ";
  if (!report.note.empty())
    report.note +=
        "give the user 'rtprio 80' and 'memlock unlimited' in /etc/security/limits.d, "
        "or run with CAP_SYS_NICE and CAP_IPC_LOCK";
  return report;
}

bool enter_realtime(int priority) noexcept {
  sched_param parameters{};
  parameters.sched_priority = priority;
  return pthread_setschedparam(pthread_self(), SCHED_FIFO, &parameters) == 0;
}

void go_before_ordinary_threads() noexcept {
  // On Linux a nice value is the thread's own.
  setpriority(PRIO_PROCESS, static_cast<id_t>(syscall(SYS_gettid)), -10);
}

void go_behind_ordinary_threads() noexcept {
  setpriority(PRIO_PROCESS, static_cast<id_t>(syscall(SYS_gettid)), 10);
}

void name_thread(const char* name) noexcept { pthread_setname_np(pthread_self(), name); }

}  // namespace sutured::haptics
