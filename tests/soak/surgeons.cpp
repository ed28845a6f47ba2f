// SPDX-License-Identifier: GPL-3.0-or-later
// Random surgeons on random scenes, each from its seed, each in a process of its own; after every
// step all that must hold is checked. A fault names the seed and the command that replays it.
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <map>
#include <string>
#include <thread>
#include <type_traits>
#include <vector>

#include "soak/checks.hpp"
#include "soak/felt.hpp"
#include "soak/hands.hpp"

namespace sutured::soak {
namespace {

using simulation::Event;
using simulation::EventKind;
using simulation::Simulation;
using simulation::ToolInput;

using simulation::kEventKinds;
// A surgeon that has not ended by then never will: the slowest takes seconds.
constexpr unsigned kHangs_s = 600;

/// What one surgeon left; crosses a pipe.
struct Outcome {
  bool good = false;
  std::uint64_t steps = 0, inverted_steps = 0, substeps = 0, forces = 0, felt_forces = 0;
  int resets = 0, replays = 0, inverted_tets = 0, rows = 0;
  double residual = 0.0, displacement_m = 0.0, force_n = 0.0, tension_n = 0.0, felt_n = 0.0;
  std::array<std::uint64_t, kEventKinds> events{};
  char fault[256] = "";
};
static_assert(std::is_trivially_copyable_v<Outcome>);

/// One step of a recording.
struct Played {
  std::vector<ToolInput> inputs;
  bool reset_before = false;
  std::uint64_t hash = 0;  ///< of what came out
};

/// Plays the first `end` steps of a recording again, and asks for displacements at another pace.
/// Returns the first step that comes out otherwise, or `end`.
std::size_t replay(Simulation& sim, const std::vector<Played>& recording, std::size_t end,
                   double dt_s) {
  for (std::size_t i = 0; i < end; ++i) {
    if (recording[i].reset_before) sim.reset();
    sim.step(recording[i].inputs, dt_s);
    if (hash_of(sim, 0) != recording[i].hash) return i;
    if (i % 7 == 3) sim.update_displacements();
  }
  return end;
}

Outcome play(std::uint64_t seed, int steps, bool verbose) {
  Outcome out;
  const scene::Scene scene = testing::random_scene(seed);
  const Temper temper = seed % 2 == 0 ? Temper::kSensible : Temper::kWild;
  const double dt_s = 1.0 / scene.rate_hz;
  Simulation sim(scene);
  const std::uint64_t at_rest = hash_of_places(sim);
  Surgeon surgeon(seed, temper, scene);
  FeltForces felt(seed + 99, scene);
  testing::Random random(seed + 77);
  std::vector<Played> recording;
  std::size_t first_reset = 0;
  const auto fail = [&](const std::string& what) {
    std::snprintf(out.fault, sizeof out.fault, "step %llu: %s",
                  static_cast<unsigned long long>(out.steps), what.c_str());
    return out;
  };
  for (int i = 0; i < steps; ++i) {
    Played played;
    if (i > 0 && random.chance(temper == Temper::kWild ? 0.01 : 0.001)) {
      if (first_reset == 0) first_reset = recording.size();
      played.reset_before = true;
      sim.reset();
      surgeon.forget();
      felt.reset();
      ++out.resets;
      if (hash_of_places(sim) != at_rest) return fail("a reset does not restore the start");
    }
    played.inputs = surgeon.next(sim, dt_s);
    sim.step(played.inputs, dt_s);
    played.hash = hash_of(sim, 0);
    recording.push_back(played);
    ++out.steps;
    surgeon.see(sim.events());
    const bool displaced = random.chance(0.7);
    if (displaced) sim.update_displacements();
    if (verbose) {
      for (const Event& event : sim.events())
        std::printf("%d %.4f s event %d %s %s %.4g\n", i, event.time_s,
                    static_cast<int>(event.kind), event.subject.c_str(), event.object.c_str(),
                    event.force_n);
      std::printf("%d rows %d residual %.2g inverted %d", i, sim.report().rows,
                  sim.report().complementarity_residual, sim.report().inverted_tets);
      for (const auto& r : sim.responses()) std::printf(" %.5f", r.wrench.head<3>().norm());
      for (const auto& t : sim.threads()) std::printf(" T %.5f", t.tension_n);
      std::printf("\n");
    }
    if (const auto fault = fault_of(scene, sim, displaced)) return fail(*fault);
    if (const auto fault = felt.play(sim, played.inputs, dt_s)) return fail(*fault);
    for (const Event& event : sim.events()) ++out.events[static_cast<std::size_t>(event.kind)];
    out.substeps += static_cast<std::uint64_t>(sim.report().substeps);
    out.rows = std::max(out.rows, sim.report().rows);
    out.residual = std::max(out.residual, sim.report().complementarity_residual);
    out.inverted_tets = std::max(out.inverted_tets, sim.report().inverted_tets);
    out.inverted_steps += sim.report().inverted_tets > 0;
    for (const auto& response : sim.responses())
      out.force_n = std::max(out.force_n, response.wrench.head<3>().norm());
    for (const auto& thread : sim.threads())
      out.tension_n = std::max(out.tension_n, thread.tension_n);
    if (displaced)
      for (std::size_t v = 0; v < sim.positions_m().size(); ++v)
        out.displacement_m =
            std::max(out.displacement_m, (sim.positions_m()[v] - sim.rest_positions_m()[v]).norm());
  }
  out.forces = felt.forces();
  out.felt_forces = felt.felt();
  out.felt_n = felt.largest_n();
  if (seed % 5 == 0) {
    Simulation again(scene);
    const auto same = [&](Simulation& on, std::size_t end) {
      ++out.replays;
      return replay(on, recording, end, dt_s);
    };
    if (const auto end = recording.size(), at = same(again, end); at < end)
      return fail("played again, step " + std::to_string(at) + " came out otherwise");
    if (first_reset > 0) {
      sim.reset();
      if (const auto at = same(sim, first_reset); at < first_reset)
        return fail("played after a reset, step " + std::to_string(at) + " came out otherwise");
    }
  }
  out.good = true;
  return out;
}

/// Plays in a child process, so that a crash is one surgeon's.
struct Child {
  std::uint64_t seed = 0;
  int pipe = -1;
};

}  // namespace
}  // namespace sutured::soak

int main(int argc, char** argv) {
  using namespace sutured::soak;
  CLI::App app("Random surgeons on random scenes; every step is checked.");
  std::uint64_t first = 0, count = 100;
  int steps = 300, jobs = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  double seconds = 0.0;
  bool verbose = false;
  app.add_option("--first", first, "seed of the first surgeon");
  app.add_option("--count", count, "how many surgeons");
  app.add_option("--seconds", seconds, "start none after so long; 0: all of them");
  app.add_option("--steps", steps, "steps of each");
  app.add_option("--jobs", jobs, "how many at a time")->check(CLI::PositiveNumber);
  app.add_flag("--verbose", verbose, "print every step");
  CLI11_PARSE(app, argc, argv);

  std::map<pid_t, Child> running;
  std::uint64_t next = first, failed = 0, done = 0;
  Outcome sum;
  const auto start = [&] {
    int ends[2];
    if (pipe(ends) != 0) {
      std::perror("pipe");
      std::exit(2);
    }
    std::fflush(stdout);
    const std::uint64_t seed = next++;
    const pid_t pid = fork();
    if (pid < 0) {
      std::perror("fork");
      std::exit(2);
    }
    if (pid == 0) {
      close(ends[0]);
      alarm(kHangs_s);
      Outcome outcome;
      try {
        outcome = play(seed, steps, verbose);
      } catch (const std::exception& error) {
        std::snprintf(outcome.fault, sizeof outcome.fault, "threw: %s", error.what());
      }
      std::fflush(stdout);
      const bool told = write(ends[1], &outcome, sizeof outcome) == sizeof outcome;
      _exit(told ? 0 : 3);
    }
    close(ends[1]);
    running[pid] = {seed, ends[0]};
  };
  const auto begun = std::chrono::steady_clock::now();
  const auto more = [&] {
    const std::chrono::duration<double> played = std::chrono::steady_clock::now() - begun;
    return next < first + count && (seconds <= 0.0 || played.count() < seconds);
  };
  while (more() || !running.empty()) {
    while (more() && running.size() < static_cast<std::size_t>(jobs)) start();
    int status = 0;
    const pid_t pid = wait(&status);
    const auto child = running.find(pid);
    if (child == running.end()) continue;
    Outcome outcome;
    const bool whole = read(child->second.pipe, &outcome, sizeof outcome) == sizeof outcome;
    close(child->second.pipe);
    if (!whole) {
      outcome = {};
      const int number = WIFSIGNALED(status) ? WTERMSIG(status) : 0;
      std::snprintf(outcome.fault, sizeof outcome.fault, "died: %s",
                    number == SIGALRM ? "hung"
                    : number != 0     ? strsignal(number)
                                      : "no report");
    }
    if (!outcome.good) {
      ++failed;
      const auto seed = static_cast<unsigned long long>(child->second.seed);
      std::printf("surgeon %llu, %s\n  again: %s --first %llu --count 1 --steps %d\n", seed,
                  outcome.fault, argv[0], seed, steps);
    }
    ++done;
    sum.steps += outcome.steps;
    sum.substeps += outcome.substeps;
    sum.inverted_steps += outcome.inverted_steps;
    sum.resets += outcome.resets;
    sum.replays += outcome.replays;
    sum.rows = std::max(sum.rows, outcome.rows);
    sum.inverted_tets = std::max(sum.inverted_tets, outcome.inverted_tets);
    sum.residual = std::max(sum.residual, outcome.residual);
    sum.displacement_m = std::max(sum.displacement_m, outcome.displacement_m);
    sum.force_n = std::max(sum.force_n, outcome.force_n);
    sum.tension_n = std::max(sum.tension_n, outcome.tension_n);
    sum.forces += outcome.forces;
    sum.felt_forces += outcome.felt_forces;
    sum.felt_n = std::max(sum.felt_n, outcome.felt_n);
    for (std::size_t i = 0; i < kEventKinds; ++i) sum.events[i] += outcome.events[i];
    running.erase(child);
  }
  const auto n = [&](EventKind kind) {
    return static_cast<unsigned long long>(sum.events[static_cast<std::size_t>(kind)]);
  };
  std::printf(
      "%llu surgeons, %llu steps, %llu substeps, %d resets, %d replays: %llu faults\n"
      "  events: %llu grasps, %llu releases, %llu contacts, %llu punctures, %llu exits, %llu taut, "
      "%llu slack, %llu unthreaded, %llu slips, %llu limits, %llu inverted, %llu residuals\n"
      "  most: residual %.2g, %d rows, tool %.3g N, tension %.3g N, displacement %.3g mm, "
      "%d tets inside out (in %llu steps)\n"
      "  hands: %.3g N at most in %llu forces, %llu of them not zero\n",
      static_cast<unsigned long long>(done), static_cast<unsigned long long>(sum.steps),
      static_cast<unsigned long long>(sum.substeps), sum.resets, sum.replays,
      static_cast<unsigned long long>(failed), n(EventKind::kGrasp), n(EventKind::kRelease),
      n(EventKind::kContact), n(EventKind::kPuncture), n(EventKind::kExit), n(EventKind::kTaut),
      n(EventKind::kSlack), n(EventKind::kUnthread), n(EventKind::kGripSlip), n(EventKind::kLimit),
      n(EventKind::kInverted), n(EventKind::kSolverResidual), sum.residual, sum.rows, sum.force_n,
      sum.tension_n, 1e3 * sum.displacement_m, sum.inverted_tets,
      static_cast<unsigned long long>(sum.inverted_steps), sum.felt_n,
      static_cast<unsigned long long>(sum.forces),
      static_cast<unsigned long long>(sum.felt_forces));
  // Some feel nothing for a long time; ten of them something in a tenth of their forces.
  const bool felt = sum.felt_forces > sum.forces / 10;
  if (done >= 10 && !felt) std::printf("the hands feel too little: forces are not tried\n");
  return failed == 0 && (felt || done < 10) ? 0 : 1;
}
