// SPDX-License-Identifier: GPL-3.0-or-later
// What fifty web viewers cost the hand, five of whom never read: pose in to force out while the
// server's gateway sends them every frame, against the same without, in turns of half a second.
// Three processes: the server, all viewers, and the hand.
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>

#include <algorithm>
#include <cstdio>
#include <deque>
#include <stdexcept>

#include "bench/figures.hpp"
#include "bench/turns.hpp"
#include "support/process.hpp"
#include "support/web_client.hpp"

namespace sutured::bench {
namespace {

constexpr int kViewers = 50, kStalled = 5;
// What a page subscribes to, the frames first: suture/mesh/topology is sent once.
constexpr const char* kWatched[] = {"suture/mesh/frame", "suture/tool/state", "suture/needle",
                                    "suture/thread", "suture/contact"};
const std::string kScene = SUTURED_SOURCE_DIR "/server/scenes/anastomosis/";

}  // namespace

void watch_web(std::uint16_t port) {
  const sigset_t turns = signals({SIGUSR1, SIGUSR2, SIGTERM});
  sigprocmask(SIG_BLOCK, &turns, nullptr);
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  setpriority(PRIO_PROCESS, 0, 19);  // viewers have machines of their own
  std::deque<testing::WebClient> viewers;
  for (int i = 0; i < kViewers; ++i) viewers.emplace_back(port, i < kStalled ? 4096 : 0);
  std::vector<pollfd> ready;
  for (const testing::WebClient& viewer : viewers) ready.push_back({viewer.tcp().fd(), POLLIN, 0});
  std::printf("ready\n");
  std::fflush(stdout);
  unsigned long frames = 0;
  const timespec at_once{0, 0};
  constexpr int kLook_ms = 10;
  for (;;) {
    const int signal = sigtimedwait(&turns, nullptr, &at_once);
    if (signal == SIGTERM) break;
    if (signal > 0)
      for (const testing::WebClient& viewer : viewers)
        for (std::uint32_t i = 0; i < std::size(kWatched); ++i)
          signal == SIGUSR1 ? viewer.subscribe(i, kWatched[i]) : viewer.unsubscribe(i);
    ::poll(ready.data() + kStalled, kViewers - kStalled, kLook_ms);
    for (int i = kStalled; i < kViewers; ++i) {
      if (ready[static_cast<std::size_t>(i)].revents == 0) continue;
      testing::WebClient& viewer = viewers[static_cast<std::size_t>(i)];
      if (!viewer.receive()) throw std::runtime_error("the server has let a viewer go");
      while (const auto message = viewer.next())
        frames += !message->text && message->bytes[1] == 0;  // subscription 0
    }
  }
  std::printf("%lu frames\n", frames);
}

void measure_viewers(Figures& figures) {
  suture::ParticipantOptions session;
  session.domain = 4U * (static_cast<std::uint32_t>(getpid()) % 50U);
  session.session = "bench-viewers-" + std::to_string(getpid());
  testing::Process server({SUTURED_PROGRAM, "serve", kScene + "scene.toml", "--http", "0",
                           "--domain", std::to_string(session.domain), "--session",
                           session.session});
  server.read_until("viewer at http://127.0.0.1:");
  const std::uint16_t port = testing::port_of(server.read_until("/\n"));
  testing::Process viewers({"/proc/self/exe", "--watch-web", std::to_string(port)});
  if (viewers.read_until("ready").find("ready") == std::string::npos)
    throw std::runtime_error("the viewers failed: " + viewers.output());
  const suture::Surgeon surgeon = suture::read_surgeon(kScene + "one_bite.csv");
  const suture::SurgeonTrack& track = surgeon.tracks.at(0);

  Pinger hand(session, track.tool);
  Turns turns = play_in_turns(track, hand, viewers);
  viewers.send(SIGTERM);
  if (viewers.wait() != 0) throw std::runtime_error("the viewers failed: " + viewers.output());
  constexpr int kBodies = 2;
  const double frames = std::atof(viewers.output().c_str() + viewers.output().find('\n'));
  const double each_hz = frames / kBodies / (kViewers - kStalled) / Turns::kWith_s;
  constexpr double kWatchable_hz = 10.0;
  if (each_hz < kWatchable_hz)
    throw std::runtime_error("a viewer got only " + std::to_string(each_hz) +
                             " frames a second: nothing to compare");
  figures.add("viewer_frames_hz.v50", each_hz, "Hz");
  add(figures, turns, "force", "viewers", 1.2);
}

}  // namespace sutured::bench
