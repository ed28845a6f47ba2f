// SPDX-License-Identifier: GPL-3.0-or-later
#include "commands/run_command.hpp"

#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <stdexcept>

#include "commands/output_file.hpp"
#include "commands/run_record.hpp"
#include "protocol/number_option.hpp"
#include "protocol/surgeon.hpp"
#include "scene/scene_reader.hpp"
#include "simulation/simulation.hpp"

namespace sutured::commands {
namespace {

using simulation::Simulation;

struct RunOptions {
  std::string scene, surgeon, out;
  double rate_hz = 0.0;     ///< 0: the scene's
  double duration_s = 0.0;  ///< 0: the surgeon's
  bool quiet = false;
};

simulation::ToolInput input_at(const suture::SurgeonTrack* track, double time_s) {
  simulation::ToolInput input;
  if (track == nullptr || time_s < track->begin_s() || time_s > track->end_s()) return input;
  const suture::SurgeonPose pose = track->at(time_s);
  input.present = true;
  input.position_m = {pose.position_m[0], pose.position_m[1], pose.position_m[2]};
  const auto& [x, y, z, w] = pose.orientation_xyzw;
  input.orientation = Eigen::Quaterniond(w, x, y, z).normalized();
  input.jaw = pose.jaw;
  return input;
}

/// A bar on a terminal, nothing elsewhere.
class Progress {
 public:
  Progress(bool shown, std::uint64_t total)
      : shown_(shown && isatty(STDERR_FILENO) == 1), total_(total) {}
  void at(std::uint64_t step) {
    if (!shown_) return;
    const int percent = total_ > 0 ? static_cast<int>(100 * step / total_) : 100;
    if (percent == percent_) return;
    percent_ = percent;
    std::cerr << "\r[" << std::string(static_cast<std::size_t>(percent / 4), '#')
              << std::string(static_cast<std::size_t>(25 - percent / 4), ' ') << "] " << percent
              << " %" << (percent == 100 ? "\n" : "") << std::flush;
  }

 private:
  bool shown_;
  std::uint64_t total_;
  int percent_ = -1;
};

int run(const RunOptions& options) {
  const scene::Scene scene = scene::read_scene(options.scene);
  for (const auto& note : scene.notes) std::cerr << "note: " << note << '\n';
  const suture::Surgeon surgeon =
      options.surgeon.empty() ? suture::Surgeon() : suture::read_surgeon(options.surgeon);
  if (options.surgeon.empty() && options.duration_s <= 0.0)
    throw std::runtime_error("without a surgeon nothing says how long to run; give --duration");
  for (const auto& track : surgeon.tracks)
    if (std::none_of(scene.tools.begin(), scene.tools.end(),
                     [&](const auto& tool) { return tool.name == track.tool; }))
      throw std::runtime_error(options.surgeon + ": tool \"" + track.tool +
                               "\" is not in the scene " + options.scene +
                               "; name one of its [[tool]] tables");
  std::error_code failed;
  std::filesystem::create_directories(options.out, failed);
  if (failed)
    throw std::runtime_error(options.out + ": cannot be made: " + failed.message() +
                             "; choose another --out");

  Simulation sim(scene);
  const double rate_hz = options.rate_hz > 0.0 ? options.rate_hz : scene.rate_hz;
  const double duration_s = options.duration_s > 0.0 ? options.duration_s : surgeon.end_s();
  const auto steps =
      static_cast<std::uint64_t>(std::llround(std::ceil(duration_s * rate_hz - 1e-9)));
  RunRecord record(scene, sim, rate_hz);

  OutputFile step_file(options.out, "steps.csv"), timing(options.out, "timing.csv"),
      tool_file(options.out, "tools.csv"), thread_file(options.out, "threads.csv"),
      event_file(options.out, "events.jsonl");
  step_file << "time_s,rows,active_unilateral_rows,contacts,complementarity_residual\n";
  timing << "time_s,substeps,track_ns,contact_ns,assemble_ns,solve_ns,model_ns,backward_ns\n";
  tool_file << "time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw,fx_n,fy_n,fz_n,tx_nm,ty_nm,tz_nm\n";
  thread_file << "time_s,thread,tension_n,slack_m,punctures\n";
  std::vector<const suture::SurgeonTrack*> tracks;
  for (const auto& tool : scene.tools) tracks.push_back(surgeon.track(tool.name));
  std::vector<simulation::ToolInput> inputs(scene.tools.size());
  Progress progress(!options.quiet, steps);
  for (std::uint64_t step = 1; step <= steps; ++step) {
    const double time_s = static_cast<double>(step) / rate_hz;
    for (std::size_t i = 0; i < inputs.size(); ++i)
      inputs[i] = input_at(tracks[i], std::min(time_s, duration_s));
    sim.step(inputs, 1.0 / rate_hz);
    record.watch(sim);
    const auto& report = sim.report();
    step_file << report.time_s << ',' << report.rows << ',' << report.active_unilateral_rows << ','
              << report.contacts << ',' << report.complementarity_residual << '\n';
    timing << report.time_s << ',' << report.substeps << ',' << report.track_ns << ','
           << report.contact_ns << ',' << report.assemble_ns << ',' << report.solve_ns << ','
           << report.model_ns << ',' << report.backward_ns << '\n';
    for (std::size_t i = 0; i < inputs.size(); ++i) {
      if (!inputs[i].present) continue;
      const auto& p = inputs[i].position_m;
      const auto& q = inputs[i].orientation;
      const auto& w = sim.responses()[i].wrench;
      if (!w.allFinite())
        throw std::runtime_error("tool \"" + scene.tools[i].name + "\" feels no finite force at " +
                                 std::to_string(report.time_s) +
                                 " s; see whether the scene's numbers make sense");
      tool_file << report.time_s << ',' << scene.tools[i].name << ',' << p[0] << ',' << p[1] << ','
                << p[2] << ',' << q.x() << ',' << q.y() << ',' << q.z() << ',' << q.w() << ','
                << inputs[i].jaw << ',' << w[0] << ',' << w[1] << ',' << w[2] << ',' << w[3] << ','
                << w[4] << ',' << w[5] << '\n';
    }
    for (std::size_t i = 0; i < scene.threads.size(); ++i) {
      const auto& thread = sim.threads()[i];
      thread_file << report.time_s << ',' << scene.threads[i].name << ',' << thread.tension_n << ','
                  << thread.slack_m << ',' << thread.punctures.size() << '\n';
    }
    for (const auto& event : sim.events()) event_file << to_json(event).dump() << "\n";
    progress.at(step);
  }
  record.write(options.out, sim);
  for (OutputFile* file : {&step_file, &timing, &tool_file, &thread_file, &event_file})
    file->close();
  return 0;
}

}  // namespace

void add_run_command(CLI::App& app, int& exit_code) {
  auto options = std::make_shared<RunOptions>();
  CLI::App* command =
      app.add_subcommand("run", "Play a surgeon file through a scene, without clock or network");
  command->add_option("scene", options->scene, "Scene file (TOML)")->required();
  command->add_option("--surgeon", options->surgeon,
                      "Surgeon file (CSV): time_s,tool,px_m,…,jaw; none: nobody touches the scene");
  command->add_option("--out", options->out, "Folder for the results")->required();
  command->add_option("--rate", options->rate_hz, "Steps per second; the scene's by default")
      ->check(suture::within(1.0, 10000.0, "Hz"));
  command
      ->add_option("--duration", options->duration_s,
                   "Seconds to simulate; the surgeon's by default")
      ->check(suture::within(0.0001, 1e6, "s"));
  command->add_flag("--quiet", options->quiet, "No progress bar");
  command->footer(
      "Example: sutured run server/scenes/anastomosis/scene.toml \\\n"
      "           --surgeon server/scenes/anastomosis/surgeon.csv --out out/run\n"
      "Writes steps.csv, timing.csv, tools.csv, threads.csv, events.jsonl, final.vtk and "
      "summary.json. Twice "
      "the same run\n"
      "gives the same bytes but for timing.csv. Exit code: 0 done, 1 faulty input or output, 2 "
      "wrong usage.");
  command->callback([options, &exit_code] { exit_code = run(*options); });
}

}  // namespace sutured::commands
