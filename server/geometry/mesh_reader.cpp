// SPDX-License-Identifier: GPL-3.0-or-later
#include "geometry/mesh_reader.hpp"

#include <gmsh.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <mutex>
#include <numeric>
#include <system_error>
#include <unordered_map>
#include <utility>

#include "geometry/mesh_file_guard.hpp"
#include "geometry/topology.hpp"

namespace sutured::geometry {

namespace {

// Six times a tet's volume over the product of the edges at its first vertex; below this the tet
// is flat within the rounding of its coordinates.
constexpr double kFlatness = 1e-10;

constexpr const char* kMendMesh = "repair the mesh where it was made, or mesh its surface again";

std::string plural(std::size_t count, const char* one, const char* many) {
  return std::to_string(count) + ' ' + (count == 1 ? one : many);
}

// A folder that only this process may enter, so that nobody can lay a file beside the mesh (libgmsh
// merges FILE.opt) or put another in its place.
class PrivateFolder {
 public:
  explicit PrivateFolder(const std::string& mesh) {
    std::error_code failed;
    const std::filesystem::path parent = std::filesystem::temp_directory_path(failed);
    std::string name = (parent / "sutured-mesh-XXXXXX").string();
    if (!failed && ::mkdtemp(name.data()) == nullptr)
      failed = std::error_code(errno, std::generic_category());
    if (failed)
      throw MeshError(mesh, {{0, "",
                              "cannot be copied: no folder can be made in " +
                                  (parent.empty() ? "that of TMPDIR" : parent.string()) + " (" +
                                  failed.message() + ")",
                              "make room there, or set TMPDIR to a folder that can be written"}});
    path_ = name;
  }
  ~PrivateFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  PrivateFolder(const PrivateFolder&) = delete;
  PrivateFolder& operator=(const PrivateFolder&) = delete;
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

// libgmsh, started for one file: silent, without the user's option files.
class GmshSession {
 public:
  GmshSession() {
    gmsh::initialize(0, nullptr, false);
    gmsh::option::setNumber("General.Terminal", 0);
  }
  ~GmshSession() { gmsh::finalize(); }
  GmshSession(const GmshSession&) = delete;
  GmshSession& operator=(const GmshSession&) = delete;
};

struct RawTet {
  std::uint64_t tag = 0;
  std::array<std::uint64_t, 4> nodes{};
};

struct RawGroup {
  std::string name;
  int dimension = 0;
  std::vector<std::uint64_t> nodes;                     // dimension 0 and 1; rest of dimension 2
  std::vector<std::array<std::uint64_t, 3>> triangles;  // dimension 2
  std::vector<std::uint64_t> tet_tags;                  // dimension 3
};

// What libgmsh makes of a file, by the file's own numbers.
struct RawMesh {
  std::unordered_map<std::uint64_t, Vec3> nodes;
  std::vector<RawTet> tets;
  std::vector<RawGroup> groups;
  std::size_t orphans = 0;  // nodes without a tet
};

// The nodes of `tets`, sorted, unique.
std::vector<std::uint64_t> used_nodes(const std::vector<RawTet>& tets) {
  std::vector<std::uint64_t> used;
  for (const RawTet& tet : tets) used.insert(used.end(), tet.nodes.begin(), tet.nodes.end());
  std::sort(used.begin(), used.end());
  used.erase(std::unique(used.begin(), used.end()), used.end());
  return used;
}

constexpr int kTriangleType = 2;
constexpr int kTetType = 4;

void read_group(int dimension, int physical_tag, RawMesh& raw) {
  RawGroup group;
  group.dimension = dimension;
  gmsh::model::getPhysicalName(dimension, physical_tag, group.name);
  if (group.name.empty()) group.name = std::to_string(physical_tag);
  std::vector<int> entities;
  gmsh::model::getEntitiesForPhysicalGroup(dimension, physical_tag, entities);
  for (const int entity : entities) {
    std::vector<int> types;
    std::vector<std::vector<std::size_t>> tags;
    std::vector<std::vector<std::size_t>> nodes;
    gmsh::model::mesh::getElements(types, tags, nodes, dimension, entity);
    for (std::size_t k = 0; k < types.size(); ++k) {
      if (types[k] == kTetType)
        group.tet_tags.insert(group.tet_tags.end(), tags[k].begin(), tags[k].end());
      else
        group.nodes.insert(group.nodes.end(), nodes[k].begin(), nodes[k].end());
      if (types[k] == kTriangleType)
        for (std::size_t i = 0; i + 2 < nodes[k].size(); i += 3)
          group.triangles.push_back({nodes[k][i], nodes[k][i + 1], nodes[k][i + 2]});
    }
  }
  raw.groups.push_back(std::move(group));
}

// What libgmsh drops in silence would make another body.
void expect_all(const std::string& path, const char* what, std::size_t read, std::size_t counted) {
  if (read != counted)
    throw MeshError(path, {{0, "",
                            "libgmsh has read " + std::to_string(read) + " of the " +
                                std::to_string(counted) + ' ' + what + " in it",
                            kMendExport}});
}

RawMesh read_with_gmsh(const std::string& path, const CheckedMeshFile& file) {
  static std::mutex singleton;
  const std::lock_guard lock(singleton);
  const PrivateFolder folder(path);
  const std::filesystem::path copy =
      folder.path() / (file.format == MeshFormat::kVtk ? "mesh.vtk" : "mesh.msh");
  {
    std::ofstream out(copy, std::ios::binary);
    out.write(file.bytes.data(), static_cast<std::streamsize>(file.bytes.size()));
    if (!out.flush())
      throw MeshError(path, {{0, "", "cannot be copied to " + folder.path().string(),
                              "make room there, or set TMPDIR"}});
  }
  const GmshSession session;
  RawMesh raw;
  try {
    gmsh::open(copy.string());
    std::vector<std::size_t> tags;
    std::vector<double> coordinates;
    std::vector<double> parametric;
    gmsh::model::mesh::getNodes(tags, coordinates, parametric);
    for (std::size_t i = 0; i < tags.size(); ++i)
      raw.nodes.emplace(tags[i],
                        Vec3(coordinates[3 * i], coordinates[3 * i + 1], coordinates[3 * i + 2]));
    std::vector<std::size_t> triangles;
    std::vector<std::size_t> corners;
    gmsh::model::mesh::getElementsByType(kTriangleType, triangles, corners);
    expect_all(path, "triangles", triangles.size(), file.triangles);
    std::vector<std::size_t> elements;
    std::vector<std::size_t> nodes;
    gmsh::model::mesh::getElementsByType(kTetType, elements, nodes);
    expect_all(path, "tetrahedra", elements.size(), file.tets);
    for (std::size_t i = 0; i < elements.size(); ++i)
      raw.tets.push_back(
          {elements[i], {nodes[4 * i], nodes[4 * i + 1], nodes[4 * i + 2], nodes[4 * i + 3]}});
    gmsh::vectorpair groups;
    gmsh::model::getPhysicalGroups(groups);
    for (const auto& [dimension, tag] : groups) read_group(dimension, tag, raw);
  } catch (const MeshError&) {
    throw;
  } catch (const std::string& error) {  // what libgmsh throws
    throw MeshError(path, {{0, "", "libgmsh cannot read it: " + error, kMendExport}});
  } catch (const std::exception& error) {
    throw MeshError(path,
                    {{0, "", std::string("libgmsh cannot read it: ") + error.what(), kMendExport}});
  }
  raw.orphans = file.node_tags.size() - used_nodes(raw.tets).size();
  // The order of the file is kept where libgmsh keeps none: by element number.
  std::sort(raw.tets.begin(), raw.tets.end(),
            [](const RawTet& a, const RawTet& b) { return a.tag < b.tag; });
  return raw;
}

// Keeps the tets of the physical volumes in `volumes` only.
void select_volumes(const std::string& path, std::span<const std::string> volumes, RawMesh& raw) {
  if (volumes.empty()) return;
  std::vector<MeshFault> faults;
  std::vector<std::uint64_t> selected;
  std::string known;
  for (const RawGroup& group : raw.groups)
    if (group.dimension == 3) known += (known.empty() ? "" : ", ") + group.name;
  for (const std::string& volume : volumes) {
    const auto group = std::find_if(raw.groups.begin(), raw.groups.end(), [&](const RawGroup& g) {
      return g.dimension == 3 && g.name == volume;
    });
    if (group == raw.groups.end()) {
      faults.push_back({0, "volume \"" + volume + "\"", "is no physical volume of the mesh",
                        known.empty() ? "it has none: leave `volumes` out" : "it has " + known});
      continue;
    }
    selected.insert(selected.end(), group->tet_tags.begin(), group->tet_tags.end());
  }
  if (!faults.empty()) throw MeshError(path, std::move(faults));
  std::sort(selected.begin(), selected.end());
  std::erase_if(raw.tets, [&](const RawTet& tet) {
    return !std::binary_search(selected.begin(), selected.end(), tet.tag);
  });
}

// Builds a reading from raw numbers and checks its geometry.
class MeshBuilder {
 public:
  MeshBuilder(std::string path, const CheckedMeshFile& file, RawMesh raw)
      : path_(std::move(path)), file_(file), raw_(std::move(raw)) {}

  MeshReading build(double scale) {
    if (raw_.tets.empty())
      fail({0, "", "there are no tetrahedra in it",
            "mesh the volume too, not only its surface (gmsh FILE -3 -o mesh.msh)"});
    number_vertices(scale);
    for (const RawTet& raw : raw_.tets) {
      Tet tet;
      for (std::size_t i = 0; i < 4; ++i) tet[i] = vertex_of_.at(raw.nodes[i]);
      mesh().tets.push_back(tet);
    }
    check_orientation();
    check_doubles();
    check_faces();
    if (!faults_.empty()) throw MeshError(path_, std::move(faults_));
    for (const RawGroup& group : raw_.groups) add_group(group);
    for (const std::string& section : file_.left_out)
      reading_.notes.push_back("the file's section " + section + " was left out");
    return std::move(reading_);
  }

 private:
  TetMesh& mesh() { return reading_.mesh; }
  [[noreturn]] void fail(MeshFault fault) { throw MeshError(path_, {std::move(fault)}); }
  void add_fault(std::string entity, std::string what, std::string mend) {
    faults_.push_back({0, std::move(entity), std::move(what), std::move(mend)});
  }
  std::string tet_name(std::size_t t) const { return "tet " + std::to_string(raw_.tets[t].tag); }

  // Vertices stand in the order of the file's nodes.
  void number_vertices(double scale) {
    const std::vector<std::uint64_t> used = used_nodes(raw_.tets);
    for (std::size_t i = 0; i < file_.node_tags.size(); ++i) {
      const std::uint64_t tag = file_.node_tags[i];
      if (!std::binary_search(used.begin(), used.end(), tag)) continue;
      const auto node = raw_.nodes.find(tag);
      if (node == raw_.nodes.end())
        fail({0, "node " + std::to_string(tag), "was lost in reading", kMendExport});
      vertex_of_.emplace(tag, static_cast<std::int32_t>(mesh().vertices_m.size()));
      mesh().vertices_m.emplace_back(scale * node->second);
      mesh().file_index.push_back(static_cast<std::int32_t>(i));
    }
    if (const std::size_t orphans = raw_.orphans; orphans > 0)
      reading_.notes.push_back(plural(orphans,
                                      "node belongs to no tet that was read and was dropped",
                                      "nodes belong to no tet that was read and were dropped"));
  }

  void check_orientation() {
    std::vector<double> volumes;
    std::size_t inverted = 0;
    for (std::size_t t = 0; t < mesh().tets.size(); ++t) {
      const auto x = [&](std::size_t i) -> const Vec3& {
        return mesh().vertices_m[static_cast<std::size_t>(mesh().tets[t][i])];
      };
      volumes.push_back(signed_volume(x(0), x(1), x(2), x(3)));
      const double size = (x(1) - x(0)).norm() * (x(2) - x(0)).norm() * (x(3) - x(0)).norm();
      if (!(6.0 * std::abs(volumes[t]) > kFlatness * size)) {
        add_fault(tet_name(t), "has no volume", kMendMesh);
        volumes[t] = 0.0;
      }
      if (volumes[t] < 0.0) ++inverted;
    }
    if (inverted == mesh().tets.size()) {
      for (Tet& tet : mesh().tets) std::swap(tet[2], tet[3]);
      reading_.notes.emplace_back("all tets of the file are left-handed and were turned round");
      return;
    }
    for (std::size_t t = 0; t < volumes.size(); ++t)
      if (volumes[t] < 0.0) add_fault(tet_name(t), "is inverted", kMendMesh);
  }

  void check_doubles() {
    std::vector<std::pair<Tet, std::size_t>> keys;
    for (std::size_t t = 0; t < mesh().tets.size(); ++t) {
      Tet key = mesh().tets[t];
      std::sort(key.begin(), key.end());
      keys.emplace_back(key, t);
    }
    std::sort(keys.begin(), keys.end());
    for (std::size_t i = 1; i < keys.size(); ++i)
      if (keys[i].first == keys[i - 1].first)
        add_fault(tet_name(keys[i].second),
                  "has the same vertices as " + tet_name(keys[i - 1].second),
                  "delete one; a tet in two physical volumes stands once in MSH 4.1");
    has_doubles_ = std::adjacent_find(keys.begin(), keys.end(), [](const auto& a, const auto& b) {
                     return a.first == b.first;
                   }) != keys.end();
  }

  void check_faces() {
    if (has_doubles_) return;  // each of them would be told four times more
    const auto uses = sorted_face_uses(mesh().tets);
    for (std::size_t i = 0; i < uses.size();) {
      std::size_t end = i + 1;
      while (end < uses.size() && uses[end].key == uses[i].key) ++end;
      if (end - i > 2) {
        std::string others;
        for (std::size_t k = i + 1; k < end; ++k)
          others += (k == i + 1 ? "" : ", ") + tet_name(static_cast<std::size_t>(uses[k].tet));
        add_fault(tet_name(static_cast<std::size_t>(uses[i].tet)), "shares one face with " + others,
                  kMendMesh);
      }
      i = end;
    }
  }

  void add_group(const RawGroup& raw) {
    PhysicalGroup group;
    group.name = raw.name;
    group.dimension = raw.dimension;
    const auto add_vertex = [&](std::uint64_t tag) {
      const auto found = vertex_of_.find(tag);
      if (found != vertex_of_.end()) group.vertices.push_back(found->second);
    };
    for (const std::uint64_t tag : raw.nodes) add_vertex(tag);
    for (const auto& nodes : raw.triangles) {
      const bool inside = std::all_of(nodes.begin(), nodes.end(),
                                      [&](std::uint64_t tag) { return vertex_of_.contains(tag); });
      if (inside)
        group.triangles.push_back(
            {vertex_of_.at(nodes[0]), vertex_of_.at(nodes[1]), vertex_of_.at(nodes[2])});
    }
    for (const std::uint64_t tag : raw.tet_tags) {
      const auto found =
          std::lower_bound(raw_.tets.begin(), raw_.tets.end(), tag,
                           [](const RawTet& tet, std::uint64_t value) { return tet.tag < value; });
      if (found == raw_.tets.end() || found->tag != tag) continue;
      const auto t = static_cast<std::size_t>(found - raw_.tets.begin());
      group.tets.push_back(static_cast<std::int32_t>(t));
      group.vertices.insert(group.vertices.end(), mesh().tets[t].begin(), mesh().tets[t].end());
    }
    std::sort(group.tets.begin(), group.tets.end());
    std::sort(group.vertices.begin(), group.vertices.end());
    group.vertices.erase(std::unique(group.vertices.begin(), group.vertices.end()),
                         group.vertices.end());
    if (group.vertices.empty()) return;  // of a volume that was not selected
    mesh().groups.push_back(std::move(group));
  }

  std::string path_;
  const CheckedMeshFile& file_;
  RawMesh raw_;
  MeshReading reading_;
  std::unordered_map<std::uint64_t, std::int32_t> vertex_of_;
  std::vector<MeshFault> faults_;
  bool has_doubles_ = false;
};

}  // namespace

MeshReading read_mesh(const std::string& path, double scale, std::span<const std::string> volumes) {
  if (!(scale > 0.0) || !std::isfinite(scale))
    throw MeshError(path, {{0, "", "the scale must be positive and finite",
                            "0.001 for a file in millimetres"}});
  const CheckedMeshFile file = check_mesh_file(path);
  RawMesh raw = read_with_gmsh(path, file);
  select_volumes(path, volumes, raw);
  MeshReading reading = MeshBuilder(path, file, std::move(raw)).build(scale);
  reading.format = (file.format == MeshFormat::kVtk ? "legacy VTK " : "MSH ") + file.version +
                   (file.binary ? ", binary" : ", text");
  return reading;
}

}  // namespace sutured::geometry
