// SPDX-License-Identifier: GPL-3.0-or-later
#include "endpoints/server.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <optional>
#include <sstream>
#include <utility>
#include <vector>

#include "checkpoints/checkpoint_keeper.hpp"
#include "endpoints/force_service.hpp"
#include "endpoints/model_publisher.hpp"
#include "endpoints/scene_publisher.hpp"
#include "endpoints/session_claim.hpp"
#include "haptics/simulation_loop.hpp"
#include "haptics/supervisor.hpp"
#include "simulation/simulation.hpp"

namespace sutured::endpoints {
namespace {

// How long to ask for the session. Discovery and a status kept for late joiners take tens of
// milliseconds on a quiet network; a server tells its status twice a second.
constexpr std::chrono::milliseconds kAsk(600);
constexpr std::int64_t kFadePatience_ns = 100 * haptics::kMillisecond_ns;
constexpr std::size_t kRefusedTold = 10;

}  // namespace

struct Server::State {
  State(scene::Scene scene_in, Options options_in)
      : scene(std::move(scene_in)), options(std::move(options_in)) {
    if (options.rate_hz <= 0.0) options.rate_hz = scene.rate_hz;
  }
  ~State() { tear_down(); }

  // The simulation's thread calls `models`, whose thread reads from `loop`: both threads
  // end before either object does.
  void tear_down() noexcept {
    publisher.reset();
    supervisor.reset();
    if (loop) loop->stop();
    if (models) models->stop();
    models.reset();
    loop.reset();
    keeper.reset();
    forces.reset();
    mesh.reset();
    claim.reset();
    control.reset();
  }

  /// Begins where the last server was; says whether it does.
  bool resume(simulation::Simulation& simulation, simulation::QualityMeter& quality) {
    if (options.resume == Options::Resume::kNever) return false;
    const auto [change, lines] = keeper->resume(options.resume == Options::Resume::kAfterCrash);
    // One more build or a disk that failed refuses all that there are: a line each, to a bound.
    for (std::size_t i = 0; i < std::min(lines.size(), kRefusedTold); ++i)
      refused += lines[i] + '\n';
    if (lines.size() > kRefusedTold)
      refused += std::to_string(lines.size() - kRefusedTold) + " older checkpoints were refused\n";
    if (!change) {
      if (!lines.empty()) refused += "no checkpoint can be used: the scene begins anew\n";
      return false;
    }
    try {
      change->apply(simulation, &quality);
      resumed = change->text;
      return true;
    } catch (const ArchiveError& error) {
      refused += "the last checkpoint makes no sense (" + std::string(error.what()) +
                 "): the scene begins anew\n";
      return false;
    }
  }

  scene::Scene scene;
  Options options;
  haptics::RealtimeReport realtime;
  std::chrono::steady_clock::time_point started = std::chrono::steady_clock::now();

  std::optional<suture::Participant> control, mesh;
  std::optional<SessionClaim> claim;
  std::optional<checkpoints::CheckpointKeeper> keeper;
  std::string resumed, refused;
  std::optional<haptics::PoseBoard> board;
  std::vector<std::unique_ptr<haptics::ToolChannel>> channels;
  std::vector<ServedTool> tools;
  std::optional<ForceService> forces;
  std::optional<ModelPublisher> models;
  std::optional<haptics::SimulationLoop> loop;
  std::optional<haptics::Supervisor> supervisor;
  std::optional<ScenePublisher> publisher;
};

Server::Server(scene::Scene scene, Options options)
    : state_(std::make_unique<State>(std::move(scene), std::move(options))) {
  State& s = *state_;
  // Before any other thread starts, so that all of them live in locked memory.
  s.realtime = haptics::prepare_realtime();
  s.control.emplace(s.options.session, suture::Channel::kControl);
  s.claim.emplace(*s.control, s.scene.name, kAsk);
  s.mesh.emplace(s.options.session, suture::Channel::kMesh);
  simulation::Simulation simulation(s.scene);

  const auto period_ns = static_cast<std::int64_t>(std::llround(1e9 / s.options.rate_hz));
  std::vector<haptics::ToolChannel*> channels;
  s.board.emplace(s.scene.tools.size());
  for (const scene::Tool& tool : s.scene.tools) {
    s.channels.push_back(std::make_unique<haptics::ToolChannel>(tool, period_ns));
    s.channels.back()->join(*s.board, channels.size());
    channels.push_back(s.channels.back().get());
    s.tools.push_back(
        {tool.name, tool.kind == scene::ToolKind::kProbe ? "probe" : "driver", channels.back()});
  }
  s.forces.emplace(*s.control, s.tools);
  s.models.emplace(*s.control, s.tools, *s.forces);
  haptics::SimulationLoop::Options loop_options;
  loop_options.rate_hz = s.options.rate_hz;
  loop_options.models_published = [models = &*s.models] { models->notify(); };
  loop_options.quality.emplace(s.scene, simulation);
  loop_options.watch = s.options.watch;
  if (s.options.checkpoints) {
    s.keeper.emplace(checkpoints::CheckpointKeeper::Options{*s.options.checkpoints}, s.scene);
    loop_options.keep = [keeper = &*s.keeper](auto& simulation_now, auto* quality,
                                              std::uint64_t epoch, std::int64_t now_ns) {
      keeper->offer(simulation_now, quality, epoch, now_ns);
    };
    loop_options.resumed = s.resume(simulation, *loop_options.quality);
  }
  s.loop.emplace(std::move(simulation), channels, std::move(loop_options));
  s.models->start(*s.loop);
  s.supervisor.emplace([forces = &*s.forces](std::int64_t now_ns) { forces->tick(now_ns); });
  s.publisher.emplace(*s.control, *s.mesh, *s.claim,
                      Served{s.scene, s.tools, *s.forces, *s.models, *s.loop, *s.supervisor,
                             s.realtime, s.options.rate_hz, s.options.session.session,
                             s.keeper ? &*s.keeper : nullptr, s.resumed, s.options.more_viewers});
}

Server::~Server() { stop("the server ends"); }

void Server::stop(const std::string& reason) noexcept {
  State& s = *state_;
  if (!s.publisher) return;
  s.forces->stop_for_good();
  // The force threads bring the forces to zero; the promise is 50 ms.
  const std::int64_t end_ns = suture::monotonic_ns() + kFadePatience_ns;
  const auto silent = [&s] {
    for (const auto& channel : s.channels)
      if (!channel->silent()) return false;
    return true;
  };
  while (!silent() && suture::monotonic_ns() < end_ns)
    haptics::sleep_until(suture::monotonic_ns() + haptics::kMillisecond_ns);
  s.publisher->finish(reason);
  const bool whole = s.loop->failure().empty();
  s.loop->stop();
  // One that makes room for a rival has not ended as asked.
  if (s.keeper && whole && s.publisher->rival().empty()) s.keeper->note_ended();
  s.tear_down();
}

std::string Server::failure() const { return state_->loop ? state_->loop->failure() : ""; }

Server::Pulse Server::pulse() const {
  const State& s = *state_;
  if (!s.loop || !s.supervisor) return {};
  return {s.loop->beats(), s.supervisor->ticks()};
}

std::string Server::rival() const { return state_->publisher ? state_->publisher->rival() : ""; }

const haptics::RealtimeReport& Server::realtime() const { return state_->realtime; }

std::string Server::summary() const {
  const State& s = *state_;
  if (!s.loop) return "stopped";
  const double elapsed_s =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - s.started).count();
  std::ostringstream text;
  text << s.loop->steps() << " steps in " << elapsed_s << " s, " << s.loop->overruns()
       << " overruns, " << s.supervisor->missed_ticks() << " missed ticks of the supervisor";
  return text.str();
}

const std::string& Server::resumed() const { return state_->resumed; }

std::string Server::notes() const {
  std::string text = state_->refused;
  if (!text.empty()) text.pop_back();
  for (std::size_t i = 0; i < state_->channels.size(); ++i) {
    const scene::Tool& tool = state_->scene.tools[i];
    const suture::ForceLimits limits = state_->channels[i]->limits();
    if (limits.max_force_n >= tool.max_force_n && limits.max_torque_nm >= tool.max_torque_nm)
      continue;
    std::ostringstream line;
    line << "tool \"" << tool.name << "\" may show " << limits.max_force_n << " N and "
         << limits.max_torque_nm << " N·m: its slew limits cannot end more in time (docs/adr/0022)";
    if (!text.empty()) text += '\n';
    text += line.str();
  }
  return text;
}

}  // namespace sutured::endpoints
