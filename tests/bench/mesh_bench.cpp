// SPDX-License-Identifier: GPL-3.0-or-later
// What a large mesh on the mesh domain costs the hand: pose in to force out while the process that
// answers also writes 1 MB at 60 Hz to a viewer, against the same without, in turns of half a
// second. Three processes: the server with its main scene, a viewer that takes every frame, and
// the hand.
#include <signal.h>
#include <sys/prctl.h>

#include <cstdio>
#include <stdexcept>

#include "bench/figures.hpp"
#include "bench/pinger.hpp"
#include "bench/turns.hpp"
#include "endpoints/server.hpp"
#include "haptics/supervisor.hpp"
#include "scene/scene_reader.hpp"
#include "support/process.hpp"

namespace sutured::bench {
namespace {

using suture::v1::MeshFrame;

constexpr std::int64_t kMs = 1'000'000;
constexpr std::size_t kFloats = 3U * 87'381U;  // 1 MiB of positions
constexpr double kRate_hz = 60.0;
const std::string kBody = "bench";
const std::string kScene = SUTURED_SOURCE_DIR "/server/scenes/anastomosis/";

}  // namespace

[[noreturn]] void serve_with_mesh(std::uint32_t domain, const std::string& session) {
  const sigset_t turns = signals({SIGUSR1, SIGUSR2});
  sigprocmask(SIG_BLOCK, &turns, nullptr);  // the threads below inherit it
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  endpoints::Server::Options options;
  options.session = {domain, session, {}};
  const endpoints::Server server(scene::read_scene(kScene + "scene.toml"), options);
  const suture::Participant participant(options.session, suture::Channel::kMesh);
  suture::Writer<MeshFrame> writer(participant);
  const std::vector<float> positions_m(kFloats, 0.01F);
  MeshFrame frame{};
  suture::set_text(frame.body, kBody);
  suture::lend(frame.position_m, std::span<const float>(positions_m));
  std::printf("ready\n");
  std::fflush(stdout);
  bool sending = false;
  std::int64_t due_ns = 0;
  for (;;) {
    const std::int64_t left_ns =
        sending ? std::max<std::int64_t>(due_ns - suture::monotonic_ns(), 0) : 1000 * kMs;
    const timespec timeout{left_ns / (1000 * kMs), left_ns % (1000 * kMs)};
    const int signal = sigtimedwait(&turns, nullptr, &timeout);
    if (signal > 0) {
      sending = signal == SIGUSR1;
      due_ns = suture::monotonic_ns();
    } else if (sending) {
      ++frame.sequence_number;
      frame.stamp_ns = suture::wall_clock_ns();
      writer.write(frame);
      due_ns = haptics::next_tick(due_ns, suture::monotonic_ns(),
                                  static_cast<std::int64_t>(1e9 / kRate_hz))
                   .at_ns;
    }
  }
}

void view_mesh(std::uint32_t domain, const std::string& session) {
  const sigset_t end = signals({SIGTERM});
  sigprocmask(SIG_BLOCK, &end, nullptr);
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  const suture::Participant participant({domain, session, {}}, suture::Channel::kMesh);
  suture::Reader<MeshFrame> reader(participant);
  suture::WaitSet arrivals;
  arrivals.attach(reader);
  unsigned long frames = 0;
  const timespec at_once{0, 0};
  while (sigtimedwait(&end, nullptr, &at_once) < 0) {
    if (!arrivals.wait(std::chrono::milliseconds(100))) continue;
    reader.take_each([&](const MeshFrame& frame, const suture::SampleInfo& info) {
      frames += info.valid && frame.position_m._length == kFloats;
    });
  }
  std::printf("%lu frames\n", frames);
}

void measure_mesh(Figures& figures) {
  suture::ParticipantOptions session;
  session.domain = 4U * (static_cast<std::uint32_t>(getpid()) % 50U);
  session.session = "bench-mesh-" + std::to_string(getpid());
  const std::string domain = std::to_string(session.domain);
  testing::Process server(
      {"/proc/self/exe", "--serve-with-mesh", domain, "--session", session.session});
  server.read_until("ready");
  testing::Process viewer({"/proc/self/exe", "--view-mesh", domain, "--session", session.session});
  const suture::Surgeon surgeon = suture::read_surgeon(kScene + "one_bite.csv");
  const suture::SurgeonTrack& track = surgeon.tracks.at(0);

  Pinger hand(session, track.tool);
  Turns turns = play_in_turns(track, hand, server);
  viewer.send(SIGTERM);
  if (viewer.wait() != 0) throw std::runtime_error("the viewer failed: " + viewer.output());
  const double seen_hz = std::atof(viewer.output().c_str()) / Turns::kWith_s;
  if (seen_hz < 0.9 * kRate_hz)
    throw std::runtime_error("only " + std::to_string(seen_hz) +
                             " frames a second reached the viewer: nothing to compare");
  figures.add("mesh_frames_hz", seen_hz, "Hz");
  add(figures, turns, "roundtrip", "mesh", 1.3);
}

}  // namespace sutured::bench
