// SPDX-License-Identifier: GPL-3.0-or-later
#include "commands/run_command.hpp"

#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <stdexcept>

#include "fem/elements.hpp"
#include "needle/curve.hpp"
#include "protocol/surgeon.hpp"
#include "scene/scene_reader.hpp"
#include "simulation/quality.hpp"
#include "simulation/simulation.hpp"

namespace sutured::commands {
namespace {

using simulation::Simulation;

constexpr double kFrameRate_hz = 60.0;

struct RunOptions {
  std::string scene, surgeon, out;
  double rate_hz = 0.0;     ///< 0: the scene's
  double duration_s = 0.0;  ///< 0: the surgeon's
  bool quiet = false;
};

/// A text file that is complete or an exception.
class OutputFile {
 public:
  OutputFile(const std::filesystem::path& directory, const std::string& name)
      : path_(directory / name), stream_(path_) {
    if (!stream_)
      throw std::runtime_error(path_.string() + ": cannot be written; choose another --out");
    stream_.precision(17);
  }
  template <typename T>
  OutputFile& operator<<(const T& value) {
    stream_ << value;
    return *this;
  }
  void close() {
    stream_.close();
    if (!stream_)
      throw std::runtime_error(path_.string() + ": not written completely; is the disk full?");
  }

 private:
  std::filesystem::path path_;
  std::ofstream stream_;
};

const char* name_of(simulation::EventKind kind) {
  using simulation::EventKind;
  switch (kind) {
    case EventKind::kGrasp:
      return "grasp";
    case EventKind::kRelease:
      return "release";
    case EventKind::kContact:
      return "contact";
    case EventKind::kPuncture:
      return "puncture";
    case EventKind::kExit:
      return "exit";
    case EventKind::kGripSlip:
      return "grip_slip";
    case EventKind::kLimit:
      return "limit";
    case EventKind::kSolverResidual:
      return "solver_residual";
    case EventKind::kContactLost:
      return "contact_lost";
    case EventKind::kTaut:
      return "taut";
    case EventKind::kSlack:
      return "slack";
    case EventKind::kUnthread:
      return "unthread";
    case EventKind::kInverted:
      return "inverted";
  }
  return "unknown";
}

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

void write_stress(OutputFile& file, std::span<const simulation::Vec6> stress_pa) {
  file << "SCALARS von_mises_pa double 1\nLOOKUP_TABLE default\n";
  for (const auto& s : stress_pa) file << fem::von_mises_pa(s) << '\n';
  file << "VECTORS principal_pa double\n";
  for (const auto& s : stress_pa) {
    const geometry::Vec3 p = fem::principal_stress_pa(s);
    file << p[0] << ' ' << p[1] << ' ' << p[2] << '\n';
  }
}

/// Legacy VTK with tets at rest, displacements, and stress per vertex and tet, in metres and
/// pascals. The three components of `principal_pa` are the principal stresses, largest first.
void write_vtk(const std::filesystem::path& directory, const Simulation& sim,
               const simulation::StressField& stress, const std::string& title) {
  OutputFile file(directory, "final.vtk");
  const auto rest = sim.rest_positions_m(), now = sim.positions_m();
  file << "# vtk DataFile Version 3.0\n"
       << title << "\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS " << rest.size() << " double\n";
  for (const auto& x : rest) file << x[0] << ' ' << x[1] << ' ' << x[2] << '\n';
  const auto tets = sim.tets();
  file << "CELLS " << tets.size() << ' ' << 5 * tets.size() << '\n';
  for (const auto& t : tets)
    file << "4 " << t[0] << ' ' << t[1] << ' ' << t[2] << ' ' << t[3] << '\n';
  file << "CELL_TYPES " << tets.size() << '\n';
  for (std::size_t i = 0; i < tets.size(); ++i) file << "10\n";
  file << "POINT_DATA " << rest.size() << "\nVECTORS displacement_m double\n";
  for (std::size_t v = 0; v < rest.size(); ++v) {
    const geometry::Vec3 u = now[v] - rest[v];
    file << u[0] << ' ' << u[1] << ' ' << u[2] << '\n';
  }
  write_stress(file, stress.vertex_pa);
  file << "CELL_DATA " << tets.size() << '\n';
  write_stress(file, stress.tet_pa);
  file.close();
}

/// The largest principal and von Mises stress of any tet, and where: the tissue and the rest
/// position of the tet's centre.
nlohmann::json summarise_stress(const Simulation& sim, const simulation::StressField& stress) {
  nlohmann::json summary;
  const auto add = [&](const std::string& name, auto&& measure) {
    const auto less = [&](const auto& a, const auto& b) { return measure(a) < measure(b); };
    const auto largest = std::max_element(stress.tet_pa.begin(), stress.tet_pa.end(), less);
    const auto& tet = sim.tets()[static_cast<std::size_t>(largest - stress.tet_pa.begin())];
    geometry::Vec3 centre = geometry::Vec3::Zero();
    for (const auto v : tet) centre += 0.25 * sim.rest_positions_m()[static_cast<std::size_t>(v)];
    std::string tissue;
    for (const auto& body : sim.bodies())
      if (tet[0] >= body.first_vertex) tissue = body.name;
    summary[name + "_max_pa"] = measure(*largest);
    summary[name + "_max_at"] = {{"tissue", tissue},
                                 {"rest_position_m", {centre[0], centre[1], centre[2]}}};
  };
  add("principal", [](const auto& s) { return fem::principal_stress_pa(s)[0]; });
  add("von_mises", [](const auto& s) { return fem::von_mises_pa(s); });
  return summary;
}

/// Points of a needle's axis, tip to tail: what to draw.
nlohmann::json course_m(const scene::Needle& needle, const scene::Pose& pose) {
  constexpr int kPoints = 33;
  const needle::Curve curve = needle::Curve::of(needle);
  nlohmann::json course = nlohmann::json::array();
  for (int i = 0; i < kPoints; ++i) {
    const geometry::Vec3 p = curve.point(pose, curve.length_m() * (1.0 - i / (kPoints - 1.0)));
    course.push_back({p[0], p[1], p[2]});
  }
  return course;
}

nlohmann::json summarise(const scene::Scene& scene, const Simulation& sim,
                         const nlohmann::json& events, const std::vector<double>& peak_force_n,
                         const std::vector<double>& peak_tension_n,
                         const std::vector<nlohmann::json>& tension_over_time, double residual_max,
                         int inverted_tets_max, std::uint64_t steps, double rate_hz) {
  nlohmann::json summary;
  summary["scene"] = scene.name;
  summary["steps"] = steps;
  summary["rate_hz"] = rate_hz;
  summary["duration_s"] = sim.time_s();
  summary["vertices"] = sim.rest_positions_m().size();
  summary["tets"] = sim.tets().size();
  std::map<std::string, int> counts;
  nlohmann::json punctures = nlohmann::json::array();
  for (const auto& event : events) {
    ++counts[event["kind"]];
    if (event["kind"] == "puncture" || event["kind"] == "exit") punctures.push_back(event);
  }
  summary["event_counts"] = counts;
  summary["punctures"] = punctures;
  nlohmann::json tools = nlohmann::json::object();
  for (std::size_t i = 0; i < scene.tools.size(); ++i)
    tools[scene.tools[i].name] = {{"peak_force_n", peak_force_n[i]}};
  summary["tools"] = tools;
  nlohmann::json needles = nlohmann::json::object();
  for (std::size_t i = 0; i < scene.needles.size(); ++i) {
    const auto& needle = sim.needles()[i];
    needles[scene.needles[i].name] = {
        {"embedded_length_m", needle.embedded_length_m},
        {"active_cells", needle.active_cells},
        {"tip_inside", needle.tip_inside},
        {"diameter_m", scene.needles[i].diameter_m},
        {"course_m", course_m(scene.needles[i], {needle.position_m, needle.orientation})}};
  }
  summary["needles"] = needles;
  nlohmann::json threads = nlohmann::json::object();
  for (std::size_t i = 0; i < scene.threads.size(); ++i) {
    const auto& thread = sim.threads()[i];
    nlohmann::json course = nlohmann::json::array();
    for (const auto& p : thread.course_m) course.push_back({p[0], p[1], p[2]});
    threads[scene.threads[i].name] = {{"tension_n", thread.tension_n},
                                      {"tension_max_n", peak_tension_n[i]},
                                      {"tension_over_time", tension_over_time[i]},
                                      {"slack_m", thread.slack_m},
                                      {"punctures", thread.punctures.size()},
                                      {"diameter_m", scene.threads[i].diameter_m},
                                      {"course_m", course}};
  }
  summary["threads"] = threads;
  double displacement = 0.0;
  for (std::size_t v = 0; v < sim.positions_m().size(); ++v)
    displacement =
        std::max(displacement, (sim.positions_m()[v] - sim.rest_positions_m()[v]).norm());
  summary["displacement_max_m"] = displacement;
  summary["complementarity_residual_max"] = residual_max;
  summary["inverted_tets_max"] = inverted_tets_max;
  return summary;
}

nlohmann::json to_json(const geometry::Vec3& x) { return {x[0], x[1], x[2]}; }

/// Figures that do not exist are null.
nlohmann::json to_json(const simulation::WoundGap& gap) {
  return {{"mean_m", gap.mean_m}, {"max_m", gap.max_m}};
}

nlohmann::json to_json(const simulation::Spread& spread) {
  return {{"mean", spread.mean}, {"standard_deviation", spread.deviation}};
}

/// Per thread what `suture/quality` says of it.
nlohmann::json summarise_quality(const scene::Scene& scene, const simulation::QualityMeter& meter) {
  nlohmann::json threads = nlohmann::json::object();
  for (std::size_t t = 0; t < scene.threads.size(); ++t) {
    const simulation::ThreadQuality& quality = meter.threads()[t];
    nlohmann::json bites = nlohmann::json::array();
    for (const simulation::BiteFigures& bite : quality.bites)
      bites.push_back({{"tissue", scene.tissues[static_cast<std::size_t>(bite.tissue)].name},
                       {"entry_m", to_json(bite.entry_m)},
                       {"exit_m", to_json(bite.exit_m)},
                       {"depth_m", bite.depth_m},
                       {"edge_distance_m", bite.edge_distance_m},
                       {"spacing_m", bite.spacing_m},
                       {"peak_force_n", bite.peak_force_n}});
    threads[scene.threads[t].name] = {
        {"elapsed_s", quality.elapsed_s},
        {"needle_path_m", quality.needle_path_m},
        {"peak_force_n", quality.peak_force_n},
        {"peak_principal_stress_pa", quality.peak_principal_stress_pa},
        {"gap_start_m", quality.gap_start.max_m},
        {"gap_m", quality.gap.max_m},
        {"tension_n", quality.tension_n},
        {"bite_depth_m", to_json(quality.depth_m)},
        {"bite_spacing_m", to_json(quality.spacing_m)},
        {"handovers", quality.handovers},
        {"needle_drops", quality.needle_drops},
        {"bites", bites}};
  }
  return threads;
}

nlohmann::json summarise_wounds(const scene::Scene& scene, const simulation::QualityMeter& meter) {
  nlohmann::json wounds = nlohmann::json::object();
  for (std::size_t w = 0; w < scene.wounds.size(); ++w)
    wounds[scene.wounds[w].name] = {{"gap_at_rest", to_json(meter.gaps_at_rest()[w])},
                                    {"gap", to_json(meter.gaps()[w])}};
  return wounds;
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
  simulation::QualityMeter meter(scene, sim);
  const double rate_hz = options.rate_hz > 0.0 ? options.rate_hz : scene.rate_hz;
  const double duration_s = options.duration_s > 0.0 ? options.duration_s : surgeon.end_s();
  const auto steps =
      static_cast<std::uint64_t>(std::llround(std::ceil(duration_s * rate_hz - 1e-9)));

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
  std::vector<double> peak_force_n(scene.tools.size(), 0.0);
  std::vector<double> peak_tension_n(scene.threads.size(), 0.0);
  // [time_s, tension_n] ten times a second; threads.csv has every step.
  std::vector<nlohmann::json> tension_over_time(scene.threads.size(), nlohmann::json::array());
  const auto tenth = static_cast<std::uint64_t>(std::max(1.0, std::round(rate_hz / 10.0)));
  nlohmann::json events = nlohmann::json::array();
  double residual_max = 0.0;
  int inverted_tets_max = 0;
  const auto take_events = [&] {
    for (const auto& event : sim.events()) {
      const nlohmann::json line = {
          {"time_s", event.time_s},
          {"kind", name_of(event.kind)},
          {"subject", event.subject},
          {"object", event.object},
          {"position_m", {event.position_m[0], event.position_m[1], event.position_m[2]}},
          {"force_n", event.force_n}};
      event_file << line.dump() << "\n";
      events.push_back(line);
    }
  };
  // The peak of the stress is looked for as often as a viewer sees it.
  const auto steps_a_frame =
      static_cast<std::uint64_t>(std::max<long long>(std::llround(rate_hz / kFrameRate_hz), 1));
  simulation::StressField stress;
  Progress progress(!options.quiet, steps);
  for (std::uint64_t step = 1; step <= steps; ++step) {
    const double time_s = static_cast<double>(step) / rate_hz;
    for (std::size_t i = 0; i < inputs.size(); ++i)
      inputs[i] = input_at(tracks[i], std::min(time_s, duration_s));
    sim.step(inputs, 1.0 / rate_hz);
    meter.watch(simulation::quality_view(sim));
    if (step % steps_a_frame == 0) {
      sim.update_displacements();
      sim.compute_stress(stress);
      meter.note_principal_stress(simulation::peak_principal_stress_pa(stress, sim.bodies()));
    }
    const auto& report = sim.report();
    residual_max = std::max(residual_max, report.complementarity_residual);
    inverted_tets_max = std::max(inverted_tets_max, report.inverted_tets);
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
      peak_force_n[i] = std::max(peak_force_n[i], w.head<3>().norm());
      tool_file << report.time_s << ',' << scene.tools[i].name << ',' << p[0] << ',' << p[1] << ','
                << p[2] << ',' << q.x() << ',' << q.y() << ',' << q.z() << ',' << q.w() << ','
                << inputs[i].jaw << ',' << w[0] << ',' << w[1] << ',' << w[2] << ',' << w[3] << ','
                << w[4] << ',' << w[5] << '\n';
    }
    for (std::size_t i = 0; i < scene.threads.size(); ++i) {
      const auto& thread = sim.threads()[i];
      peak_tension_n[i] = std::max(peak_tension_n[i], thread.tension_n);
      if (step % tenth == 0) tension_over_time[i].push_back({report.time_s, thread.tension_n});
      thread_file << report.time_s << ',' << scene.threads[i].name << ',' << thread.tension_n << ','
                  << thread.slack_m << ',' << thread.punctures.size() << '\n';
    }
    take_events();
    progress.at(step);
  }
  sim.update_displacements();
  inverted_tets_max = std::max(inverted_tets_max, sim.report().inverted_tets);
  sim.compute_stress(stress);
  meter.note_principal_stress(simulation::peak_principal_stress_pa(stress, sim.bodies()));
  meter.measure(simulation::quality_view(sim));
  write_vtk(options.out, sim, stress, scene.name);
  nlohmann::json summary =
      summarise(scene, sim, events, peak_force_n, peak_tension_n, tension_over_time, residual_max,
                inverted_tets_max, steps, rate_hz);
  summary["stress"] = summarise_stress(sim, stress);
  summary["quality"] = summarise_quality(scene, meter);
  summary["wound"] = summarise_wounds(scene, meter);
  OutputFile summary_file(options.out, "summary.json");
  summary_file << summary.dump(2) << "\n";
  for (OutputFile* file :
       {&step_file, &timing, &tool_file, &thread_file, &event_file, &summary_file})
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
      ->check(CLI::Range(1.0, 10000.0));
  command
      ->add_option("--duration", options->duration_s,
                   "Seconds to simulate; the surgeon's by default")
      ->check(CLI::Range(1e-4, 1e6));
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
