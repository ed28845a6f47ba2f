// SPDX-License-Identifier: GPL-3.0-or-later
#include "commands/run_record.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <span>

#include "commands/json_text.hpp"
#include "commands/output_file.hpp"
#include "fem/elements.hpp"
#include "needle/curve.hpp"

namespace sutured::commands {
namespace {

using simulation::Simulation;

// The peak of the stress is looked for as often as a viewer sees it.
constexpr double kFrameRate_hz = 60.0;
constexpr double kSampleRate_hz = 10.0;
constexpr std::size_t kPuncturesMax = 10'000;
constexpr std::size_t kSamplesMax = 12'000;

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

}  // namespace

nlohmann::json to_json(const simulation::Event& event) {
  return {{"time_s", event.time_s},
          {"kind", name_of(event.kind)},
          {"subject", event.subject},
          {"object", event.object},
          {"position_m", {event.position_m[0], event.position_m[1], event.position_m[2]}},
          {"force_n", event.force_n}};
}

RunRecord::RunRecord(const scene::Scene& scene, const Simulation& simulation, double rate_hz)
    : scene_(scene),
      rate_hz_(rate_hz),
      meter_(scene_, simulation),
      steps_a_frame_(static_cast<std::uint64_t>(
          std::max<long long>(std::llround(rate_hz / kFrameRate_hz), 1))),
      steps_a_sample_(static_cast<std::uint64_t>(
          std::max<long long>(std::llround(rate_hz / kSampleRate_hz), 1))),
      peak_force_n_(scene.tools.size(), 0.0),
      peak_tension_n_(scene.threads.size(), 0.0),
      tension_over_time_(scene.threads.size()) {}

void RunRecord::watch(Simulation& simulation) {
  ++steps_;
  meter_.watch(simulation::quality_view(simulation));
  if (steps_ % steps_a_frame_ == 0) {
    simulation.update_displacements();
    simulation.compute_stress(stress_);
    meter_.note_principal_stress(
        simulation::peak_principal_stress_pa(stress_, simulation.bodies()));
  }
  const simulation::StepReport& report = simulation.report();
  residual_max_ = std::max(residual_max_, report.complementarity_residual);
  inverted_tets_max_ = std::max(inverted_tets_max_, report.inverted_tets);
  contacts_max_ = std::max(contacts_max_, report.contacts);
  for (std::size_t i = 0; i < peak_force_n_.size(); ++i)
    peak_force_n_[i] =
        std::max(peak_force_n_[i], simulation.responses()[i].wrench.head<3>().norm());
  const bool sample = steps_ % steps_a_sample_ == 0;
  for (std::size_t i = 0; i < peak_tension_n_.size(); ++i) {
    const double tension_n = simulation.threads()[i].tension_n;
    peak_tension_n_[i] = std::max(peak_tension_n_[i], tension_n);
    if (sample) tension_over_time_[i].push_back({report.time_s, tension_n});
  }
  if (sample && !tension_over_time_.empty() && tension_over_time_[0].size() >= kSamplesMax) {
    steps_a_sample_ *= 2;
    for (auto& samples : tension_over_time_) {
      for (std::size_t i = 0; 2 * i + 1 < samples.size(); ++i) samples[i] = samples[2 * i + 1];
      samples.resize(samples.size() / 2);
    }
  }
  for (const simulation::Event& event : simulation.events()) {
    ++event_counts_[static_cast<std::size_t>(event.kind)];
    const bool passes = event.kind == simulation::EventKind::kPuncture ||
                        event.kind == simulation::EventKind::kExit;
    if (passes && punctures_.size() < kPuncturesMax) punctures_.push_back(event);
  }
}

void RunRecord::serialize(Archive& archive) {
  // Given: scene, rate. Of one call: stress.
  auto& [scene, rate, meter, stress, steps, steps_a_frame, steps_a_sample, event_counts, punctures,
         peak_force, peak_tension, tension_over_time, residual_max, inverted_tets_max,
         contacts_max] = *this;
  archive(meter, steps, steps_a_frame, steps_a_sample, event_counts, punctures);
  archive.fixed(peak_force);
  archive.fixed(peak_tension);
  archive.fixed(tension_over_time);
  archive(residual_max, inverted_tets_max, contacts_max);
}

nlohmann::json RunRecord::summarise(const Simulation& sim) const {
  const scene::Scene& scene = scene_;
  nlohmann::json summary;
  summary["scene"] = scene.name;
  summary["steps"] = steps_;
  summary["rate_hz"] = rate_hz_;
  summary["duration_s"] = sim.time_s();
  summary["vertices"] = sim.rest_positions_m().size();
  summary["tets"] = sim.tets().size();
  std::map<std::string, std::uint64_t> counts;
  for (std::size_t kind = 0; kind < event_counts_.size(); ++kind)
    if (event_counts_[kind] > 0)
      counts[name_of(static_cast<simulation::EventKind>(kind))] = event_counts_[kind];
  summary["event_counts"] = counts;
  nlohmann::json punctures = nlohmann::json::array();
  for (const simulation::Event& event : punctures_) punctures.push_back(to_json(event));
  summary["punctures"] = punctures;
  nlohmann::json tools = nlohmann::json::object();
  for (std::size_t i = 0; i < scene.tools.size(); ++i)
    tools[scene.tools[i].name] = {{"peak_force_n", peak_force_n_[i]}};
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
                                      {"tension_max_n", peak_tension_n_[i]},
                                      {"tension_over_time", tension_over_time_[i]},
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
  summary["complementarity_residual_max"] = residual_max_;
  summary["inverted_tets_max"] = inverted_tets_max_;
  double force_n = 0.0;
  for (const simulation::ContactPoint& point : sim.contacts()) force_n += point.force_n;
  summary["contact"] = {{"pairs_in_reach", sim.report().contact_pairs},
                        {"pairs_with_force", sim.contacts().size()},
                        {"touching_max", contacts_max_},
                        {"force_sum_n", force_n}};
  return summary;
}

void RunRecord::write(const std::filesystem::path& folder, Simulation& simulation) {
  simulation.update_displacements();
  inverted_tets_max_ = std::max(inverted_tets_max_, simulation.report().inverted_tets);
  simulation.compute_stress(stress_);
  meter_.note_principal_stress(simulation::peak_principal_stress_pa(stress_, simulation.bodies()));
  meter_.measure(simulation::quality_view(simulation));
  write_vtk(folder, simulation, stress_, scene_.name);
  nlohmann::json summary = summarise(simulation);
  summary["stress"] = summarise_stress(simulation, stress_);
  summary["quality"] = summarise_quality(scene_, meter_);
  summary["wound"] = summarise_wounds(scene_, meter_);
  OutputFile file(folder, "summary.json");
  file << as_text(summary, 2) << "\n";
  file.close();
}

}  // namespace sutured::commands
