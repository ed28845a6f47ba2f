// SPDX-License-Identifier: GPL-3.0-or-later
#include "commands/run_command.hpp"

#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <optional>
#include <span>
#include <stdexcept>
#include <system_error>

#include "checkpoints/checkpoint_file.hpp"
#include "commands/json_text.hpp"
#include "commands/output_file.hpp"
#include "commands/run_record.hpp"
#include "commands/scene_file.hpp"
#include "protocol/number_option.hpp"
#include "protocol/surgeon.hpp"
#include "protocol/whole_file.hpp"
#include "scene/scene_reader.hpp"
#include "simulation/simulation.hpp"

namespace sutured::commands {
namespace {

using simulation::Simulation;

struct RunOptions {
  std::string scene, surgeon, out;
  double rate_hz = 0.0;     ///< 0: the scene's
  double duration_s = 0.0;  ///< 0: the surgeon's
  std::string from;         ///< checkpoint to go on from; empty: the start
  std::string checkpoint;   ///< to write at the end; empty: none
  double until_s = 0.0;     ///< end there, short of the duration; 0: at the duration
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

/// The number of the step that ends at or right behind `time_s`.
std::uint64_t step_at(double time_s, double rate_hz) {
  return static_cast<std::uint64_t>(std::llround(std::ceil(time_s * rate_hz - 1e-9)));
}

/// The files that grow with each step.
struct StepFiles {
  static constexpr std::array<const char*, 5> kNames{"steps.csv", "timing.csv", "tools.csv",
                                                     "threads.csv", "events.jsonl"};
  std::vector<OutputFile> files;
  OutputFile &steps, &timing, &tools, &threads, &events;

  explicit StepFiles(std::vector<OutputFile> opened)
      : files(std::move(opened)),
        steps(files[0]),
        timing(files[1]),
        tools(files[2]),
        threads(files[3]),
        events(files[4]) {}

  [[nodiscard]] static StepFiles begun(const std::string& folder) {
    std::vector<OutputFile> opened;
    for (const char* name : kNames) opened.emplace_back(folder, name);
    StepFiles made(std::move(opened));
    made.steps << "time_s,rows,active_unilateral_rows,contacts,complementarity_residual\n";
    made.timing
        << "time_s,substeps,track_ns,contact_ns,assemble_ns,solve_ns,model_ns,backward_ns\n";
    made.tools << "time_s,tool,px_m,py_m,pz_m,qx,qy,qz,qw,jaw,fx_n,fy_n,fz_n,tx_nm,ty_nm,tz_nm\n";
    made.threads << "time_s,thread,tension_n,slack_m,punctures\n";
    return made;
  }
  using Sizes = std::array<std::uint64_t, kNames.size()>;
  [[nodiscard]] static StepFiles continued(const std::string& folder, const Sizes& sizes) {
    std::vector<OutputFile> opened;
    for (std::size_t i = 0; i < kNames.size(); ++i)
      opened.emplace_back(folder, kNames[i], sizes[i]);
    for (std::size_t i = 0; i < kNames.size(); ++i) opened[i].drop_rest(sizes[i]);
    return StepFiles(std::move(opened));
  }
  [[nodiscard]] Sizes sizes() {
    Sizes sizes{};
    for (std::size_t i = 0; i < kNames.size(); ++i) sizes[i] = files[i].size();
    return sizes;
  }
};

/// What a run is besides its scene and its surgeon.
struct RunState {
  double rate_hz = 0.0;
  std::uint64_t step = 0;  ///< the last one made
  StepFiles::Sizes sizes{};
};

void archive_run(Archive& archive, RunState& state, Simulation& sim, RunRecord& record) {
  archive(state, sim, record);
}

RunState read_run(const RunOptions& options, const scene::Scene& scene, double rate_hz,
                  Simulation& sim, RunRecord& record) {
  const checkpoints::Checkpoint checkpoint = checkpoints::read_checkpoint(
      options.from, checkpoints::identity_of(scene, checkpoints::Writer::kRun));
  RunState state;
  try {
    Archive archive = Archive::reading(checkpoint.state);
    archive_run(archive, state, sim, record);
    archive.expect_end();
  } catch (const ArchiveError& error) {
    throw std::runtime_error(options.from + ": makes no sense: " + error.what() +
                             "; use another checkpoint");
  }
  if (state.rate_hz != rate_hz)
    throw std::runtime_error(options.from + ": was written at " + std::to_string(state.rate_hz) +
                             " steps per second; give it as --rate");
  return state;
}

/// A run's state is kept at once and written when its results are on the disk.
class EndCheckpoint {
 public:
  EndCheckpoint(const scene::Scene& scene, RunState state, Simulation& sim, RunRecord& record) {
    info_.identity = checkpoints::identity_of(scene, checkpoints::Writer::kRun);
    info_.time_s = sim.time_s();
    Archive archive = Archive::writing(bytes_, Archive::Caches::kKept);
    archive_run(archive, state, sim, record);
  }
  void write(const std::string& path) const { checkpoints::write_checkpoint(path, info_, bytes_); }

 private:
  checkpoints::CheckpointInfo info_;
  std::vector<std::byte> bytes_;
};

/// Refuses a --checkpoint that cannot be written, or would be written over something else of the
/// run, before the run.
void check_checkpoint(const RunOptions& options, const scene::Scene& scene) {
  std::vector<std::filesystem::path> others{scene.path, options.surgeon};
  for (const scene::Tissue& tissue : scene.tissues) others.emplace_back(tissue.mesh_path);
  const std::filesystem::path out(options.out);
  for (const char* name : StepFiles::kNames) others.push_back(out / name);
  for (const char* name : {"final.vtk", "summary.json"}) others.push_back(out / name);
  for (const std::filesystem::path& other : others)
    if (suture::same_file(options.checkpoint, other))
      throw std::runtime_error(options.checkpoint + ": is " + other.string() +
                               "; give --checkpoint a file of its own");
  try {
    const suture::WholeFile probe(options.checkpoint, 0600);
  } catch (const std::system_error& error) {
    throw std::runtime_error(std::string(error.what()) + "; choose another --checkpoint");
  }
}

void write_step(const scene::Scene& scene, const Simulation& sim,
                std::span<const simulation::ToolInput> inputs, StepFiles& files) {
  const auto& report = sim.report();
  files.steps << report.time_s << ',' << report.rows << ',' << report.active_unilateral_rows << ','
              << report.contacts << ',' << report.complementarity_residual << '\n';
  files.timing << report.time_s << ',' << report.substeps << ',' << report.track_ns << ','
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
    files.tools << report.time_s << ',' << scene.tools[i].name << ',' << p[0] << ',' << p[1] << ','
                << p[2] << ',' << q.x() << ',' << q.y() << ',' << q.z() << ',' << q.w() << ','
                << inputs[i].jaw << ',' << w[0] << ',' << w[1] << ',' << w[2] << ',' << w[3] << ','
                << w[4] << ',' << w[5] << '\n';
  }
  for (std::size_t i = 0; i < scene.threads.size(); ++i) {
    const auto& thread = sim.threads()[i];
    files.threads << report.time_s << ',' << scene.threads[i].name << ',' << thread.tension_n << ','
                  << thread.slack_m << ',' << thread.punctures.size() << '\n';
  }
  for (const auto& event : sim.events()) files.events << as_text(to_json(event)) << "\n";
}

int run(const RunOptions& options) {
  const scene::Scene scene = scene::read_scene(scene_file(options.scene));
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
  make_output_folder(options.out);
  if (!options.checkpoint.empty()) check_checkpoint(options, scene);

  Simulation sim(scene);
  const double rate_hz = options.rate_hz > 0.0 ? options.rate_hz : scene.rate_hz;
  const double duration_s = options.duration_s > 0.0 ? options.duration_s : surgeon.end_s();
  const double end_s = options.until_s > 0.0 ? std::min(options.until_s, duration_s) : duration_s;
  const std::uint64_t last = step_at(end_s, rate_hz);
  RunRecord record(scene, sim, rate_hz);
  RunState state;
  state.rate_hz = rate_hz;
  if (!options.from.empty()) state = read_run(options, scene, rate_hz, sim, record);
  if (state.step > last)
    throw std::runtime_error(options.from + ": is of " + std::to_string(sim.time_s()) +
                             " s, behind the end of this run; give a later --until or --duration");
  StepFiles files = options.from.empty() ? StepFiles::begun(options.out)
                                         : StepFiles::continued(options.out, state.sizes);

  std::vector<const suture::SurgeonTrack*> tracks;
  for (const auto& tool : scene.tools) tracks.push_back(surgeon.track(tool.name));
  std::vector<simulation::ToolInput> inputs(scene.tools.size());
  Progress progress(!options.quiet, last);
  while (state.step < last) {
    const double time_s = static_cast<double>(++state.step) / rate_hz;
    for (std::size_t i = 0; i < inputs.size(); ++i)
      inputs[i] = input_at(tracks[i], std::min(time_s, duration_s));
    sim.step(inputs, 1.0 / rate_hz);
    record.watch(sim);
    write_step(scene, sim, inputs, files);
    progress.at(state.step);
  }
  state.sizes = files.sizes();
  for (OutputFile& file : files.files) file.close();
  // Before the record measures for its summary: a run that is not cut does not do that here.
  std::optional<EndCheckpoint> checkpoint;
  if (!options.checkpoint.empty()) checkpoint.emplace(scene, state, sim, record);
  record.write(options.out, sim);
  if (checkpoint) checkpoint->write(options.checkpoint);
  return 0;
}

}  // namespace

void add_run_command(CLI::App& app, Action& action) {
  auto options = std::make_shared<RunOptions>();
  CLI::App* command =
      app.add_subcommand("run", "Play a surgeon file through a scene, without clock or network");
  command
      ->add_option("scene", options->scene, "Scene file (TOML), or the name of an installed scene")
      ->required();
  command->add_option("--surgeon", options->surgeon,
                      "Surgeon file (CSV): time_s,tool,px_m,…,jaw; none: nobody touches the scene");
  command->add_option("--out", options->out, "Folder for the results")->required();
  command->add_option("--rate", options->rate_hz, "Steps per second; the scene's by default")
      ->check(suture::within(1.0, 10000.0, "Hz"));
  command
      ->add_option("--duration", options->duration_s,
                   "Seconds to simulate; the surgeon's by default")
      ->check(suture::within(0.0001, 1e6, "s"));
  command->add_option("--checkpoint", options->checkpoint,
                      "File for the state at the end, from which --from goes on");
  command
      ->add_option("--until", options->until_s,
                   "End at this time (s) of the run, short of its duration")
      ->check(suture::within(0.0001, 1e6, "s"));
  command->add_option("--from", options->from,
                      "Go on from this checkpoint, in the --out of the run that wrote it");
  command->add_flag("--quiet", options->quiet, "No progress bar");
  command->footer(
      "Example: sutured run server/scenes/anastomosis/scene.toml \\\n"
      "           --surgeon server/scenes/anastomosis/surgeon.csv --out out/run\n"
      "Cut in two, it writes the same bytes (but for timing.csv):\n"
      "  sutured run SCENE --surgeon FILE --out out/run --until 4 --checkpoint out/run.checkpoint\n"
      "  sutured run SCENE --surgeon FILE --out out/run --from out/run.checkpoint\n"
      "Writes steps.csv, timing.csv, tools.csv, threads.csv, events.jsonl, final.vtk and "
      "summary.json. Twice "
      "the same run\n"
      "gives the same bytes but for timing.csv.\n"
      "Exit codes: 0 done, 1 faulty input or output, 2 wrong usage.");
  command->callback([options, &action] { action = [options] { return run(*options); }; });
}

}  // namespace sutured::commands
