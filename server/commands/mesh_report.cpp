// SPDX-License-Identifier: GPL-3.0-or-later
#include "commands/mesh_report.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <iomanip>
#include <nlohmann/json.hpp>
#include <ostream>
#include <sstream>

#include "geometry/topology.hpp"

namespace sutured::commands {

namespace {

using geometry::Vec3;

constexpr std::size_t kWorstShown = 3;
constexpr std::size_t kNameWidth = 24;

std::string number(double x, int digits = 3) {
  std::ostringstream text;
  text << std::setprecision(digits) << x;
  return text.str();
}

// 12345 as "12,345".
std::string count(std::size_t n) {
  std::string text = std::to_string(n);
  for (std::size_t at = text.size(); at > 3;) text.insert(at -= 3, 1, ',');
  return text;
}

std::string volume_text(double volume_m3) {
  return volume_m3 < 1e-7   ? number(volume_m3 * 1e9) + " mm³"
         : volume_m3 < 1e-1 ? number(volume_m3 * 1e6) + " cm³"
                            : number(volume_m3) + " m³";
}

const char* kind_of(int dimension) {
  static constexpr std::array<const char*, 4> kKinds{"points", "curve", "surface", "volume"};
  return kKinds[static_cast<std::size_t>(dimension)];
}

std::string extent_text(const Vec3& sizes_m) {
  return length_text(sizes_m.x()) + " × " + length_text(sizes_m.y()) + " × " +
         length_text(sizes_m.z());
}

std::vector<double> coordinates(const Vec3& x) { return {x.x(), x.y(), x.z()}; }

}  // namespace

std::string length_text(double length_m) {
  const double size = std::abs(length_m);
  if (size < 1e-3 && size > 0.0) return number(length_m * 1e6) + " µm";
  if (size < 1.0) return number(length_m * 1e3) + " mm";
  return number(length_m) + " m";
}

MeshReport report_mesh(const geometry::TetMesh& mesh) {
  MeshReport report;
  report.vertices = mesh.vertices_m.size();
  report.tets = mesh.tets.size();
  report.boundary_faces =
      geometry::boundary_surface(mesh.tets, geometry::tet_adjacency(mesh.tets)).triangles.size();
  report.components = geometry::connected_components(mesh.tets, mesh.vertices_m.size()).count;
  report.quality = geometry::mesh_quality(mesh);
  for (const std::int32_t t : geometry::worst_tets(report.quality, kWorstShown)) {
    Vec3 centre = Vec3::Zero();
    for (const std::int32_t v : mesh.tets[static_cast<std::size_t>(t)])
      centre += 0.25 * mesh.vertices_m[static_cast<std::size_t>(v)];
    report.worst.push_back({t, report.quality.radius_ratio[static_cast<std::size_t>(t)], centre});
  }
  return report;
}

void print_mesh(std::ostream& out, const geometry::TetMesh& mesh, const MeshReport& report) {
  const geometry::MeshQuality& q = report.quality;
  out << "  size        " << count(report.vertices) << " vertices, " << count(report.tets)
      << " tets, " << count(report.boundary_faces) << " boundary faces, " << report.components
      << (report.components == 1 ? " component\n" : " components\n") << "  volume      "
      << volume_text(q.volume_m3) << '\n'
      << "  extent      " << extent_text(q.bounds_m.sizes()) << " (x, y, z)\n"
      << "  edges       " << length_text(q.edge_min_m) << " to " << length_text(q.edge_max_m)
      << ", mean " << length_text(q.edge_mean_m) << '\n'
      << "  quality     3r/R: worst " << number(q.radius_ratio_min) << ", first percentile "
      << number(q.radius_ratio_p01) << ", median " << number(q.radius_ratio_median)
      << "; dihedral angles " << number(q.dihedral_min_deg) << "° to " << number(q.dihedral_max_deg)
      << "°\n"
      << "  worst tets ";
  for (const WorstTet& tet : report.worst) {
    out << (&tet == report.worst.data() ? " " : "; ") << tet.tet << " (" << number(tet.radius_ratio)
        << ") at";
    for (const double x : coordinates(tet.centre_m)) out << ' ' << length_text(x);
  }
  out << "\n  groups     " << (mesh.groups.empty() ? " none" : "") << '\n';
  for (const geometry::PhysicalGroup& group : mesh.groups) {
    out << "    " << std::left << std::setw(static_cast<int>(kNameWidth)) << group.name << ' '
        << std::setw(8) << kind_of(group.dimension) << std::right << std::setw(9)
        << count(group.vertices.size()) << " vertices";
    if (group.dimension == 2) out << std::setw(9) << count(group.triangles.size()) << " triangles";
    if (group.dimension == 3) out << std::setw(9) << count(group.tets.size()) << " tets";
    out << '\n';
  }
}

void print_units(std::ostream& out, const MeshReport& report, double scale) {
  struct Unit {
    const char* name;
    double scale;
  };
  static constexpr std::array<Unit, 5> kUnits{{{"millimetres", 1e-3},
                                               {"centimetres", 1e-2},
                                               {"inches", 0.0254},
                                               {"decimetres", 1e-1},
                                               {"metres", 1.0}}};
  const Vec3 sizes = report.quality.bounds_m.sizes() / scale;
  out << "  unit        the file does not say its unit of length; it spans " << number(sizes.x(), 4)
      << " × " << number(sizes.y(), 4) << " × " << number(sizes.z(), 4) << " of it:\n";
  for (const Unit& unit : kUnits) {
    const double ratio = unit.scale / scale;
    out << "    if " << std::left << std::setw(12) << unit.name << std::right
        << " scale = " << std::left << std::setw(7) << number(unit.scale) << std::right << ' '
        << extent_text(sizes * unit.scale) << ", "
        << volume_text(report.quality.volume_m3 * ratio * ratio * ratio) << '\n';
  }
}

nlohmann::json mesh_json(const geometry::TetMesh& mesh, const MeshReport& report) {
  const geometry::MeshQuality& q = report.quality;
  nlohmann::json groups = nlohmann::json::array();
  for (const geometry::PhysicalGroup& group : mesh.groups)
    groups.push_back({{"name", group.name},
                      {"dimension", group.dimension},
                      {"vertices", group.vertices.size()},
                      {"triangles", group.triangles.size()},
                      {"tets", group.tets.size()}});
  nlohmann::json worst = nlohmann::json::array();
  for (const WorstTet& tet : report.worst)
    worst.push_back({{"tet", tet.tet},
                     {"radius_ratio", tet.radius_ratio},
                     {"centre_m", coordinates(tet.centre_m)}});
  return {{"vertices", report.vertices},
          {"tets", report.tets},
          {"boundary_faces", report.boundary_faces},
          {"components", report.components},
          {"volume_m3", q.volume_m3},
          {"min_m", coordinates(q.bounds_m.min())},
          {"max_m", coordinates(q.bounds_m.max())},
          {"edge_m", {{"min", q.edge_min_m}, {"mean", q.edge_mean_m}, {"max", q.edge_max_m}}},
          {"radius_ratio",
           {{"min", q.radius_ratio_min},
            {"p01", q.radius_ratio_p01},
            {"median", q.radius_ratio_median}}},
          {"dihedral_deg", {{"min", q.dihedral_min_deg}, {"max", q.dihedral_max_deg}}},
          {"worst_tets", worst},
          {"groups", groups}};
}

}  // namespace sutured::commands
