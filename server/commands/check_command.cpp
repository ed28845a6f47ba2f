// SPDX-License-Identifier: GPL-3.0-or-later
#include "commands/check_command.hpp"

#include <CLI/CLI.hpp>
#include <filesystem>
#include <iostream>
#include <set>
#include <string>
#include <utility>

#include "commands/json_text.hpp"
#include "commands/mesh_report.hpp"
#include "commands/scene_file.hpp"
#include "fem/cholesky_factor.hpp"
#include "geometry/mesh_reader.hpp"
#include "scene/scene_reader.hpp"
#include "simulation/tissue_state.hpp"

namespace sutured::commands {

namespace {

using nlohmann::json;

struct Options {
  std::string path;
  double scale = 1.0;
  bool json = false;
};

void print_json(const json& report) { std::cout << as_text(report, 2) << '\n'; }

void print_notes(const std::vector<std::string>& notes) {
  for (const std::string& note : notes) std::cout << "note: " << note << '\n';
}

std::size_t fixed_vertices(const scene::Tissue& tissue) {
  std::set<std::int32_t> fixed;
  for (const scene::Prescribed& entry : tissue.prescribed)
    fixed.insert(entry.vertices.begin(), entry.vertices.end());
  return fixed.size();
}

void check_mesh(const Options& options) {
  const geometry::MeshReading reading = geometry::read_mesh(options.path, options.scale);
  const MeshReport report = report_mesh(reading.mesh);
  if (options.json) {
    json result = mesh_json(reading.mesh, report);
    result.update({{"ok", true},
                   {"format", reading.format},
                   {"scale", options.scale},
                   {"notes", reading.notes}});
    print_json(result);
    return;
  }
  std::cout << options.path << "  " << reading.format << ", scale " << options.scale << '\n';
  print_mesh(std::cout, reading.mesh, report);
  print_units(std::cout, report, options.scale);
  print_notes(reading.notes);
}

// The 2-norm condition number of the tissue's stiffness matrix, held as the scene holds it.
double stiffness_condition(const scene::Tissue& tissue) {
  scene::Scene alone;
  alone.tissues.push_back(tissue);
  return fem::CholeskyFactor(fem::assemble(simulation::assemble_model(alone))).estimate_condition();
}

void print_tissue(const scene::Tissue& tissue, const MeshReport& report, double condition) {
  std::cout << "\ntissue \"" << tissue.name << "\"  " << tissue.mesh_path << ", "
            << tissue.mesh_format << ", scale " << tissue.scale << '\n';
  print_mesh(std::cout, tissue.mesh, report);
  std::cout << "  material    E = " << tissue.young_modulus_pa * 1e-3 << " kPa, Poisson ratio "
            << tissue.poisson_ratio << ", "
            << report.quality.volume_m3 * tissue.density_kg_per_m3 * 1e3 << " g";
  for (const scene::Region& region : tissue.regions)
    std::cout << "; " << region.group << ": E = " << region.young_modulus_pa * 1e-3
              << " kPa, Poisson ratio " << region.poisson_ratio;
  std::cout << "\n  held        " << fixed_vertices(tissue) << " vertices fixed or prescribed, "
            << tissue.loads.size() << (tissue.loads.size() == 1 ? " load\n" : " loads\n")
            << "  condition   " << condition << " (2-norm of the stiffness matrix, estimated)\n";
}

void print_instruments(const scene::Scene& scene) {
  for (const scene::Needle& needle : scene.needles) {
    std::cout << "\nneedle \"" << needle.name << "\"  ";
    if (needle.shape == scene::NeedleShape::kArc)
      std::cout << "arc of " << needle.arc_deg << "°, radius " << length_text(needle.radius_m)
                << ", ";
    else
      std::cout << "straight, ";
    std::cout << length_text(needle.length_m) << " long, " << length_text(needle.diameter_m)
              << " thick";
  }
  for (const scene::Tool& tool : scene.tools)
    std::cout << "\ntool \"" << tool.name << "\"  "
              << (tool.kind == scene::ToolKind::kProbe ? "probe" : "driver") << ", at most "
              << tool.max_force_n << " N and " << tool.max_torque_nm << " N·m";
  std::cout << '\n';
}

void check_scene(const Options& options) {
  const scene::Scene scene = scene::read_scene(options.path);
  json tissues = json::array();
  if (!options.json)
    std::cout << "scene \"" << scene.name << "\"  " << scene.path << ", " << scene.rate_hz
              << " Hz\n";
  for (const scene::Tissue& tissue : scene.tissues) {
    const MeshReport report = report_mesh(tissue.mesh);
    const double condition = stiffness_condition(tissue);
    if (!options.json) {
      print_tissue(tissue, report, condition);
      continue;
    }
    json entry = mesh_json(tissue.mesh, report);
    entry.update({{"name", tissue.name},
                  {"mesh", tissue.mesh_path},
                  {"format", tissue.mesh_format},
                  {"scale", tissue.scale},
                  {"mass_kg", report.quality.volume_m3 * tissue.density_kg_per_m3},
                  {"fixed_vertices", fixed_vertices(tissue)},
                  {"stiffness_condition", condition}});
    tissues.push_back(std::move(entry));
  }
  if (options.json) {
    print_json({{"ok", true},
                {"scene", scene.name},
                {"rate_hz", scene.rate_hz},
                {"tissues", tissues},
                {"notes", scene.notes}});
    return;
  }
  print_instruments(scene);
  print_notes(scene.notes);
}

json fault_json(const scene::SceneFault& fault) {
  return {{"file", fault.file},
          {"line", fault.line},
          {"column", fault.column},
          {"what", fault.what},
          {"mend", fault.mend}};
}

// Tells the faults on standard error, or as JSON on standard output; returns the exit code.
int tell_faults(const Options& options, const std::string& text, std::size_t count, json faults) {
  if (options.json)
    print_json({{"ok", false}, {"faults", std::move(faults)}});
  else
    std::cerr << text << '\n' << count << (count == 1 ? " fault\n" : " faults\n");
  return 1;
}

int check(const Options& options) {
  const std::string extension = std::filesystem::path(options.path).extension().string();
  try {
    if (extension == ".toml")
      check_scene(options);
    else
      check_mesh(options);
    return 0;
  } catch (const scene::SceneError& error) {
    json faults = json::array();
    for (const scene::SceneFault& fault : error.faults()) faults.push_back(fault_json(fault));
    return tell_faults(options, error.what(), error.faults().size(), std::move(faults));
  } catch (const fem::NotPositiveDefinite& error) {
    const scene::SceneFault fault{options.path, 0, 0, error.what(),
                                  "fix more of the tissue, or repair its flattest tets"};
    return tell_faults(options, scene::SceneError({fault}).what(), 1, {fault_json(fault)});
  } catch (const geometry::MeshError& error) {
    json faults = json::array();
    for (const geometry::MeshFault& fault : error.faults())
      faults.push_back({{"file", options.path},
                        {"line", fault.line},
                        {"entity", fault.entity},
                        {"what", fault.what},
                        {"mend", fault.mend}});
    return tell_faults(options, error.what(), error.faults().size(), std::move(faults));
  }
}

}  // namespace

void add_check_command(CLI::App& app, Action& action) {
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand(
      "check",
      "Report on a scene or a mesh: size, quality, what holds it, or what is wrong with it");
  command
      ->add_option("FILE", options->path,
                   "A scene (*.toml, or the name of an installed one) or a mesh (*.msh, *.vtk)")
      ->required();
  command
      ->add_option("--scale", options->scale, "Metres per unit of a mesh file; a scene has its own")
      ->check(CLI::PositiveNumber);
  command->add_flag("--json", options->json, "Write the report as JSON");
  command->footer(
      "Examples:\n"
      "  sutured check server/scenes/anastomosis/scene.toml\n"
      "  sutured check liver.msh                 # which unit is it in?\n"
      "  sutured check liver.msh --scale 0.1 --json\n"
      "Exit code: 0 good, 1 faults, each as file:line:column, 2 usage.");
  command->callback([options, &action] {
    action = [options] {
      options->path = scene_file(options->path);
      return check(*options);
    };
  });
}

}  // namespace sutured::commands
