// SPDX-License-Identifier: GPL-3.0-or-later
#include "scene/scene_reader.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <numbers>
#include <optional>
#include <utility>

#include "geometry/mesh_reader.hpp"
#include "geometry/regular_file.hpp"
#include "scene/physical_ranges.hpp"
#include "scene/tissue_binder.hpp"
#include "scene/toml_table.hpp"

namespace sutured::scene {

namespace {

constexpr std::uint64_t kSceneBytesMax = 1 << 20;
constexpr std::size_t kToolsMax = 8;  // a model knows one tool and kModelOthersMax others

// A tissue longer than this in metres was most likely written in another unit.
constexpr double kPlausibleLengthMin_m = 1e-3;
constexpr double kPlausibleLengthMax_m = 0.6;

// Names travel as DDS keys and stand in CSV files.
bool is_name(const std::string& name) {
  const auto legal = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' ||
           c == '-' || c == '.';
  };
  return !name.empty() && name.size() <= 32 && std::all_of(name.begin(), name.end(), legal);
}

class SceneBuilder {
 public:
  explicit SceneBuilder(std::string path) : faults_(path) { scene_.path = std::move(path); }

  Scene build(const std::string& text) {
    const toml::table root = parse(text);
    TableReader table(root, "the scene", faults_);
    scene_.name = table.text("name", std::filesystem::path(scene_.path).stem().string());
    scene_.rate_hz = table.number("rate_hz", scene_.rate_hz, {.low = 30.0, .high = 1000.0});
    scene_.gravity_m_per_s2 = table.vector("gravity_m_per_s2", kGravity).value_or(Vec3::Zero());
    // The binders refer to the tissues: these must not move.
    if (const auto* tissues = root.get_as<toml::array>("tissue"))
      scene_.tissues.reserve(tissues->size());
    for_each_table(table, "tissue", [&](TableReader& reader) { read_tissue(reader); });
    for_each_table(table, "needle", [&](TableReader& reader) { read_needle(reader); });
    for_each_table(table, "thread", [&](TableReader& reader) { read_thread(reader); });
    for_each_table(table, "tool", [&](TableReader& reader) { read_tool(reader); });
    if (scene_.tools.size() > kToolsMax)
      faults_.add((*root.get_as<toml::array>("tool"))[kToolsMax].source(),
                  "the scene has " + std::to_string(scene_.tools.size()) + " tools and may have " +
                      std::to_string(kToolsMax),
                  "leave some out: a hand feels up to seven other tools through the tissue");
    for_each_table(table, "wound", [&](TableReader& reader) { read_wound(reader); });
    read_contact(table);
    table.finish();
    if (!table.has("tissue"))
      faults_.add(table.place(), "the scene has no tissue", "add a [[tissue]] with a mesh");
    if (!faults_.empty()) throw SceneError(faults_.sorted());
    return std::move(scene_);
  }

 private:
  toml::table parse(const std::string& text) {
    try {
      return toml::parse(text, scene_.path);
    } catch (const toml::parse_error& error) {
      faults_.add(error.source(), std::string(error.description()), "correct the TOML");
      throw SceneError(faults_.sorted());
    }
  }

  void for_each_table(TableReader& root, const char* key,
                      const std::function<void(TableReader&)>& read) {
    const toml::array* items = root.array(key);
    if (items == nullptr) return;
    for (const toml::node& item : *items) {
      if (!item.is_table()) {
        faults_.add(item.source(), std::string(key) + " is not a list of tables",
                    std::string("write [[") + key + "]]");
        return;
      }
      TableReader reader(*item.as_table(), std::string("[[") + key + "]]", faults_);
      read(reader);
      reader.finish();
    }
  }

  // The name of a table, unique among `others` and fit to travel.
  template <typename Named>
  std::string read_name(TableReader& table, const std::vector<Named>& others) {
    std::string name = table.required_text("name");
    if (!name.empty() && !is_name(name))
      table.fault("name", "the name \"" + name + "\" cannot be used",
                  "use up to 32 letters, digits, '_', '-' and '.'");
    for (const Named& other : others)
      if (!name.empty() && other.name == name)
        table.fault("name", "there are two of " + table.title() + " named \"" + name + "\"",
                    "give each its own name");
    table.rename(table.title() + " \"" + name + "\"");
    return name;
  }

  void read_tissue(TableReader& table) {
    Tissue tissue;
    tissue.name = read_name(table, scene_.tissues);
    const std::string mesh = table.required_text("mesh");
    tissue.scale = table.number("scale", 1.0, kScale);
    const std::vector<std::string> volumes = table.texts("volumes");
    tissue.young_modulus_pa = table.required_number("young_modulus_pa", kModulus);
    if (!table.has("poisson_ratio")) table.required_number("poisson_ratio", kPoissonRatio);
    tissue.poisson_ratio = table.number("poisson_ratio", 0.45, kPoissonRatio);
    tissue.density_kg_per_m3 =
        table.number("density_kg_per_m3", tissue.density_kg_per_m3, kDensity);
    tissue.puncture_force_n = table.number("puncture_force_n", tissue.puncture_force_n, kForce);
    tissue.friction_n_s_per_m2 =
        table.number("friction_n_s_per_m2", tissue.friction_n_s_per_m2, kFriction);
    tissue.static_friction_n_per_m =
        table.number("static_friction_n_per_m", tissue.static_friction_n_per_m, kFriction);
    tissue.surface_friction_coefficient = table.number(
        "surface_friction_coefficient", tissue.surface_friction_coefficient, kFrictionCoefficient);
    if (!mesh.empty()) read_mesh_of(tissue, mesh, volumes, table);
    const bool has_mesh = !tissue.mesh.tets.empty();
    scene_.tissues.push_back(std::move(tissue));
    binders_.emplace_back();
    if (!has_mesh) {
      // The mesh is told of already: these keys are known all the same.
      for (const char* key : {"fixed", "prescribed", "load", "regions"}) (void)table.array(key);
      (void)table.integer("components", 1, 1, 1000);
      return;
    }
    binders_.back() = std::make_unique<TissueBinder>(scene_.tissues.back(), faults_);
    TissueBinder& binder = *binders_.back();
    binder.bind_regions(table);
    binder.bind_fixed(table);
    binder.bind_prescribed(table);
    binder.check_prescribed(table);
    binder.bind_loads(table);
    binder.check_components(table);
  }

  void read_mesh_of(Tissue& tissue, const std::string& mesh,
                    const std::vector<std::string>& volumes, TableReader& table) {
    tissue.mesh_path = (std::filesystem::path(scene_.path).parent_path() / mesh).string();
    try {
      geometry::MeshReading reading = geometry::read_mesh(tissue.mesh_path, tissue.scale, volumes);
      tissue.mesh = std::move(reading.mesh);
      tissue.mesh_format = std::move(reading.format);
      for (const std::string& note : reading.notes) scene_.notes.push_back(mesh + ": " + note);
    } catch (const geometry::MeshError& error) {
      table.fault("mesh", "the mesh of " + table.title() + " cannot be used",
                  "see the faults of " + mesh);
      for (const geometry::MeshFault& fault : error.faults()) {
        const std::string entity = fault.entity.empty() ? "" : fault.entity + ": ";
        faults_.add({tissue.mesh_path, fault.line, 0, entity + fault.what, fault.mend});
      }
      return;
    }
    Eigen::AlignedBox3d box;
    for (const Vec3& x : tissue.mesh.vertices_m) box.extend(x);
    const double length_m = box.sizes().maxCoeff();
    if (!kBodyLength.holds(length_m)) {
      table.fault(
          "scale",
          table.title() + " is " + std::to_string(length_m) + " m long and must be " +
              kBodyLength.text(),
          "scale is in metres per unit of the mesh; `sutured check " + mesh + "` lists the units");
      return;
    }
    if (length_m < kPlausibleLengthMin_m || length_m > kPlausibleLengthMax_m) {
      constexpr double kUsualLength_m = 0.05;
      // The unit that would bring a body of unknown scale nearest to five centimetres, the size of
      // what is sutured.
      double best = 1.0;
      for (const double unit : {1e-3, 1e-2, 1e-1, 1.0})
        if (std::abs(std::log10(length_m / tissue.scale * unit / kUsualLength_m)) <
            std::abs(std::log10(length_m / tissue.scale * best / kUsualLength_m)))
          best = unit;
      scene_.notes.push_back("tissue \"" + tissue.name + "\" is " + std::to_string(length_m) +
                             " m long with scale = " + std::to_string(tissue.scale) +
                             ": is the unit right? (sutured check " + mesh +
                             " lists them; scale = " + std::to_string(best) + " would make it " +
                             std::to_string(length_m / tissue.scale * best) + " m)");
    }
  }

  void read_needle(TableReader& table) {
    Needle needle;
    needle.name = read_name(table, scene_.needles);
    static const std::array<std::string, 2> kShapes{"straight", "arc"};
    static const std::array<std::string, 2> kSlides{"energy_consistent", "least_squares"};
    needle.shape = static_cast<NeedleShape>(table.choice("shape", 1, kShapes));
    needle.slide = static_cast<SlideRule>(table.choice("slide", 0, kSlides));
    const bool arc = needle.shape == NeedleShape::kArc;
    needle.radius_m = table.number("radius_m", needle.radius_m, kLength);
    needle.arc_deg =
        table.number("arc_deg", needle.arc_deg, {.low = 0.0, .high = 350.0, .low_open = true});
    needle.length_m = table.number("length_m", needle.length_m, kLength);
    for (const char* key : {"radius_m", "arc_deg", "length_m"}) {
      const bool of_straight = key == std::string_view("length_m");
      if (table.has(key) && of_straight == arc)
        table.fault(key,
                    std::string(key) + " does not shape a needle that is " + kShapes[arc ? 1 : 0],
                    arc ? "an arc has radius_m and arc_deg" : "a straight needle has length_m");
    }
    if (arc) needle.length_m = needle.radius_m * needle.arc_deg * std::numbers::pi / 180.0;
    needle.diameter_m = table.number("diameter_m", needle.diameter_m, kLength);
    if (needle.diameter_m > 0.5 * (arc ? needle.radius_m : needle.length_m))
      table.fault("diameter_m", table.title() + " is thicker than it is long",
                  "lengths are in metres: 0.0006 is 0.6 mm");
    needle.pose = table.pose("pose");
    scene_.needles.push_back(std::move(needle));
  }

  void read_thread(TableReader& table) {
    Thread thread;
    thread.name = read_name(table, scene_.threads);
    static const std::array<std::string, 2> kTails{"anchored", "free"};
    static const std::array<std::string, 2> kEnds{"held", "none"};
    static const std::array<std::string, 2> kHeads{"swaged", "free"};
    static const std::array<std::string, 2> kModels{"outside", "path"};
    thread.length_m = table.number("length_m", thread.length_m, kLength);
    thread.diameter_m = table.number("diameter_m", thread.diameter_m, kLength);
    thread.tension_max_n = table.number("tension_max_n", thread.tension_max_n, kForce);
    thread.tail_length_m = table.number("tail_length_m", thread.tail_length_m, kLengthOrNone);
    thread.tail = static_cast<ThreadTail>(table.choice("tail", 0, kTails));
    thread.ends = static_cast<ThreadEnds>(table.choice("ends", 0, kEnds));
    thread.head = static_cast<ThreadHead>(table.choice("head", 0, kHeads));
    thread.model =
        static_cast<ThreadModel>(table.choice("model", static_cast<int>(thread.model), kModels));
    const bool swaged = thread.ends == ThreadEnds::kHeld && thread.head == ThreadHead::kSwaged;
    if (swaged || table.has("needle")) {
      thread.needle = table.required_text("needle");
      std::vector<std::string> names;
      for (const Needle& needle : scene_.needles) names.push_back(needle.name);
      if (!thread.needle.empty() &&
          std::find(names.begin(), names.end(), thread.needle) == names.end())
        table.fault("needle",
                    table.title() + " hangs on needle \"" + thread.needle +
                        "\", which is not in the scene" + did_you_mean(thread.needle, names),
                    "name a [[needle]] of the scene, or write ends = \"none\"");
      else if (table.has("needle") && !swaged)
        table.fault("needle", table.title() + " has a needle that rules no end of it",
                    "leave needle out, or write ends = \"held\" and head = \"swaged\"");
      for (const Thread& other : scene_.threads)
        if (!thread.needle.empty() && other.needle == thread.needle)
          table.fault(
              "needle",
              "threads \"" + other.name + "\" and \"" + thread.name + "\" hang on the same needle",
              "give each thread its own needle");
    }
    read_punctures(table, thread);
    const std::size_t known = faults_.count();
    read_length_program(table, thread);
    check_thread(table, thread, faults_.count() == known);
    scene_.threads.push_back(std::move(thread));
  }

  void check_thread(TableReader& table, const Thread& thread, bool good_program) {
    if (thread.punctures.size() % 2 != 0)
      table.fault("punctures",
                  table.title() + " has an odd number of punctures (" +
                      std::to_string(thread.punctures.size()) + "), and every bite has two",
                  "list where each bite enters and where it leaves, from tail to head");
    for (std::size_t i = 0; i + 1 < thread.punctures.size(); i += 2)
      if (thread.punctures[i].tissue != thread.punctures[i + 1].tissue)
        table.fault("punctures",
                    "bite " + std::to_string(i / 2 + 1) + " of " + table.title() +
                        " enters one tissue and leaves another",
                    "list two punctures of the same tissue for each bite");
    if (thread.ends == ThreadEnds::kNone && thread.punctures.size() < 4)
      table.fault("ends", table.title() + " has no ends and fewer than two bites: nothing pulls it",
                  "list at least four punctures, or write ends = \"held\"");
    if (good_program && !thread.length_program.empty() && thread.ends == ThreadEnds::kHeld)
      table.fault("length_program_m",
                  table.title() + " has a length program, but hands rule its ends",
                  "write ends = \"none\", or leave the program out");
  }

  void read_punctures(TableReader& table, Thread& thread) {
    const toml::array* items = table.array("punctures");
    if (items == nullptr) return;
    for (const toml::node& item : *items) {
      if (!item.is_table()) {
        faults_.add(item.source(), "an entry of punctures of " + table.title() + " is not a table",
                    "write { tissue = \"…\", point_m = [x, y, z] }");
        continue;
      }
      TableReader reader(*item.as_table(), "a puncture of " + table.title(), faults_);
      if (auto bite = read_bite(reader)) thread.punctures.push_back(*bite);
      reader.finish();
    }
  }

  // The tissue that `tissue` of `reader` names.
  std::optional<std::size_t> read_tissue_name(TableReader& reader) {
    const std::string name = reader.required_text("tissue");
    std::vector<std::string> names;
    for (const Tissue& tissue : scene_.tissues) names.push_back(tissue.name);
    const auto found = std::find(names.begin(), names.end(), name);
    if (found != names.end()) return static_cast<std::size_t>(found - names.begin());
    if (!name.empty())
      reader.fault("tissue",
                   reader.title() + " is in tissue \"" + name + "\", which is not in the scene" +
                       did_you_mean(name, names),
                   "name a [[tissue]] of the scene");
    return std::nullopt;
  }

  void read_wound(TableReader& table) {
    Wound wound;
    wound.name = read_name(table, scene_.wounds);
    read_edges(table, wound);
    scene_.wounds.push_back(std::move(wound));
  }

  void read_edges(TableReader& table, Wound& wound) {
    if (!table.has("edges"))
      table.fault("", table.title() + " has no edges",
                  "write edges = [{ tissue = \"…\", group = \"…\" }, { tissue = \"…\", group = "
                  "\"…\" }]");
    const toml::array* items = table.array("edges");
    if (items == nullptr) return;
    if (items->size() != wound.edges.size()) {
      table.fault("edges",
                  table.title() + " has " + std::to_string(items->size()) +
                      (items->size() == 1 ? " edge" : " edges"),
                  "write two: the gap is measured from one to the other");
      return;
    }
    for (std::size_t i = 0; i < wound.edges.size(); ++i) {
      const toml::node& item = (*items)[i];
      if (!item.is_table()) {
        faults_.add(item.source(), "an entry of edges of " + table.title() + " is not a table",
                    "write { tissue = \"…\", group = \"…\" }");
        continue;
      }
      TableReader reader(*item.as_table(), "an edge of " + table.title(), faults_);
      wound.edges[i] = read_edge(reader).value_or(WoundEdge());
      reader.finish();
    }
    const WoundEdge &a = wound.edges[0], &b = wound.edges[1];
    if (a.tissue >= 0 && a.tissue == b.tissue && a.group == b.group)
      table.fault("edges", "both edges of " + table.title() + " are the same",
                  "name the two surfaces that are to be sewn together");
  }

  std::optional<WoundEdge> read_edge(TableReader& reader) {
    const auto index = read_tissue_name(reader);
    const std::string group = reader.required_text("group");
    if (!index || group.empty() || binders_[*index] == nullptr) return std::nullopt;
    auto edge = binders_[*index]->edge_of(group, reader.place("group"));
    if (edge) edge->tissue = static_cast<int>(*index);
    return edge;
  }

  std::optional<Bite> read_bite(TableReader& reader) {
    const auto point = reader.vector("point_m");
    const toml::array* nodes = reader.array("vertices");
    const auto barycentric = reader.vector("barycentric");
    const auto tissue = read_tissue_name(reader);
    if (!tissue) return std::nullopt;
    const std::size_t index = *tissue;
    const bool by_nodes = reader.has("vertices") && reader.has("barycentric");
    if (by_nodes == reader.has("point_m") || reader.has("vertices") != reader.has("barycentric")) {
      reader.fault("", reader.title() + " needs one place",
                   "write point_m, or vertices with barycentric");
      return std::nullopt;
    }
    TissueBinder* binder = binders_[index].get();
    if (binder == nullptr) return std::nullopt;
    std::optional<Bite> bite;
    if (by_nodes) {
      std::array<int, 3> corners{};
      bool legal = nodes != nullptr && nodes->size() == 3;
      for (std::size_t i = 0; legal && i < 3; ++i) {
        const auto value = (*nodes)[i].value_exact<std::int64_t>();
        legal = value && *value >= 0 && *value <= std::numeric_limits<int>::max();
        if (legal) corners[i] = static_cast<int>(*value);
      }
      if (!legal || !barycentric || barycentric->minCoeff() < 0.0 ||
          std::abs(barycentric->sum() - 1.0) > 1e-6) {
        reader.fault("vertices", reader.title() + " has no legal barycentric point",
                     "write three nodes and three weights, none negative, that add up to 1");
        return std::nullopt;
      }
      bite = binder->bite_at(corners, *barycentric / barycentric->sum(), reader.place("vertices"));
    } else if (point) {
      bite = binder->bite_at(*point, reader.place("point_m"));
    }
    if (bite) bite->tissue = static_cast<int>(index);
    return bite;
  }

  void read_length_program(TableReader& table, Thread& thread) {
    const toml::array* rows = table.array("length_program_m");
    if (rows == nullptr) return;
    for (const toml::node& row : *rows) {
      const toml::array* pair = row.as_array();
      const auto at = [&](std::size_t i) { return number_of((*pair)[i]).value_or(-1.0); };
      const bool legal = pair != nullptr && pair->size() == 2 && std::isfinite(at(0)) &&
                         at(0) >= 0.0 && kLength.holds(at(1));
      const bool later =
          !legal || thread.length_program.empty() || at(0) > thread.length_program.back().time_s;
      if (!legal || !later) {
        faults_.add(
            row.source(),
            "a row of length_program_m of " + table.title() +
                (legal ? " is not later than the one before" : " is not [time_s, length_m]"),
            "write ascending times and positive lengths: [[0.0, 0.05], [1.0, 0.04]]");
        continue;
      }
      thread.length_program.push_back({at(0), at(1)});
    }
  }

  void read_tool(TableReader& table) {
    Tool tool;
    tool.name = read_name(table, scene_.tools);
    static const std::array<std::string, 2> kKinds{"driver", "probe"};
    tool.kind = static_cast<ToolKind>(table.choice("kind", 0, kKinds));
    const auto take = [&](const char* key, double& value, const Range& range) {
      value = table.number(key, value, range);
    };
    take("capture_radius_m", tool.capture_radius_m, kLength);
    take("probe_radius_m", tool.probe_radius_m, kLength);
    take("max_force_n", tool.max_force_n, kForce);
    take("max_torque_nm", tool.max_torque_nm, kTorque);
    take("max_force_slew_n_per_s", tool.max_force_slew_n_per_s, kSlew);
    take("max_torque_slew_nm_per_s", tool.max_torque_slew_nm_per_s, kSlew);
    take("grip_stiffness_n_per_m", tool.grip_stiffness_n_per_m, kStiffness);
    take("grip_stiffness_nm_per_rad", tool.grip_stiffness_nm_per_rad, kStiffness);
    take("grip_force_max_n", tool.grip_force_max_n, kForce);
    take("grip_torque_max_nm", tool.grip_torque_max_nm, kTorque);
    take("max_speed_m_per_s", tool.max_speed_m_per_s, kSpeed);
    tool.stale_after_ms = table.number(
        "stale_after_ms", tool.stale_after_ms,
        {.low = 1.0,
         .high = 100.0,
         .mend =
             "15 suits a device at 1 kHz, 100 a mouse; beyond it a dead device would still pull"});
    if (const toml::table* inner = table.table("workspace")) {
      TableReader reader(*inner, "workspace of " + table.title(), faults_);
      Workspace& workspace = tool.workspace;
      workspace.pose = reader.pose("pose");
      workspace.motion_scale = reader.number("motion_scale", workspace.motion_scale, kRatio);
      workspace.force_scale = reader.number("force_scale", workspace.force_scale, kRatio);
      workspace.clutch_button = reader.integer("clutch_button", workspace.clutch_button, -1, 31);
      reader.finish();
    }
    scene_.tools.push_back(std::move(tool));
  }

  void read_contact(TableReader& root) {
    const toml::table* inner = root.table("contact");
    if (inner == nullptr) return;
    TableReader table(*inner, "[contact]", faults_);
    scene_.contact.enabled = table.boolean("enabled", true);
    table.finish();
  }

  Scene scene_;
  Faults faults_;
  std::vector<std::unique_ptr<TissueBinder>> binders_;  // one per tissue; none without a mesh
};

}  // namespace

Scene parse_scene(const std::string& text, const std::string& path) {
  return SceneBuilder(path).build(text);
}

Scene read_scene(const std::string& path) {
  std::string text;
  try {
    text = geometry::read_regular_file(path, kSceneBytesMax);
  } catch (const geometry::FileError& error) {
    throw SceneError({{path, 0, 0, error.what(), "name a scene file (*.toml)"}});
  }
  return parse_scene(text, path);
}

}  // namespace sutured::scene
