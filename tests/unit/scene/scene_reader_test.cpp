// SPDX-License-Identifier: GPL-3.0-or-later
#include "scene/scene_reader.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <cmath>
#include <numbers>
#include <numeric>
#include <string>
#include <vector>

#include "support/temporary_folder.hpp"

namespace sutured::scene {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::SizeIs;
using ::testing::StartsWith;

// Two tets on one face, in centimetres: five nodes, the group "foot" of three, "base" of one
// triangle of area 0.5 cm², the point "tip", and the volumes "left" and "right".
constexpr const char* kMesh =
    "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n5\n0 1 \"tip\"\n2 2 \"base\"\n"
    "3 3 \"left\"\n3 4 \"right\"\n1 5 \"foot\"\n$EndPhysicalNames\n"
    "$Nodes\n5\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n5 1 1 1\n$EndNodes\n"
    "$Elements\n6\n1 15 2 1 1 5\n2 1 2 5 1 1 2\n3 1 2 5 1 2 3\n4 2 2 2 1 1 3 2\n"
    "5 4 2 3 1 1 2 3 4\n6 4 2 4 2 2 3 4 5\n$EndElements\n";

// Lines 1 to 7 of every scene below.
constexpr const char* kTissue =
    "name = \"test\"\n"
    "[[tissue]]\n"
    "name = \"flap\"\n"
    "mesh = \"a.msh\"\n"
    "scale = 0.01\n"
    "young_modulus_pa = 2.0e5\n"
    "poisson_ratio = 0.45\n";
constexpr const char* kFixed = "fixed = [\"foot\"]\n";  // line 8

class SceneReader : public ::testing::Test {
 protected:
  SceneReader() { folder_.write("a.msh", kMesh); }

  Scene read(const std::string& text) { return read_scene(folder_.write("s.toml", text)); }

  // What a scene's reading complains of, without its folder.
  std::string error_of(const std::string& text) {
    try {
      (void)read(text);
    } catch (const SceneError& error) {
      std::string message = error.what();
      const std::string prefix = folder_.path("");
      for (std::size_t at = 0; (at = message.find(prefix)) != std::string::npos;)
        message.erase(at, prefix.size());
      return message;
    }
    return "";
  }
  std::string error_in_tissue(const std::string& lines) {
    return error_of(std::string(kTissue) + kFixed + lines);
  }
  std::string error_in_scene(const std::string& lines) { return error_in_tissue(lines); }

  testing::TemporaryFolder folder_;
};

TEST_F(SceneReader, ReadsEveryKey) {
  const Scene scene = read(
      "name = \"all\"\nrate_hz = 500\ngravity_m_per_s2 = [0, 0, -9.81]\n"
      "[contact]\nenabled = false\n"
      "[[tissue]]\nname = \"flap\"\nmesh = \"a.msh\"\nscale = 0.01\nyoung_modulus_pa = 1e5\n"
      "poisson_ratio = 0.3\ndensity_kg_per_m3 = 1050\npuncture_force_n = 0.07\n"
      "friction_n_s_per_m2 = 12\nstatic_friction_n_per_m = 3\nsurface_friction_coefficient = 0.2\n"
      "fixed = [\"foot\"]\n"
      "prescribed = [{ group = \"tip\", axes = \"z\", displacement_m = [9, 9, 0.001] }]\n"
      "regions = [{ group = \"left\", young_modulus_pa = 3e5, poisson_ratio = 0.4 }]\n"
      "load = [{ vertex = 3, force_n = [0, 0, 1] }]\ncomponents = 1\n"
      "[[needle]]\nname = \"n\"\nshape = \"straight\"\nlength_m = 0.03\ndiameter_m = 0.001\n"
      "slide = \"least_squares\"\n"
      "pose = { position_m = [1, 2, 3], orientation = [0, 0, 0.6, 0.8] }\n"
      "[[tool]]\nname = \"d\"\nkind = \"driver\"\ncapture_radius_m = 0.004\nmax_force_n = 2\n"
      "max_torque_nm = 0.2\nmax_force_slew_n_per_s = 100\nmax_torque_slew_nm_per_s = 5\n"
      "stale_after_ms = 20\ngrip_stiffness_n_per_m = 1000\ngrip_stiffness_nm_per_rad = 0.4\n"
      "grip_force_max_n = 4\ngrip_torque_max_nm = 0.04\nmax_speed_m_per_s = 1\n"
      "[tool.workspace]\nmotion_scale = 0.2\nforce_scale = 5\nclutch_button = 0\n"
      "pose = { position_m = [0, 0, 1], orientation = [1, 0, 0, 0] }\n"
      "[[tool]]\nname = \"p\"\nkind = \"probe\"\nprobe_radius_m = 0.001\n");
  EXPECT_EQ(scene.name, "all");
  EXPECT_EQ(scene.rate_hz, 500);
  EXPECT_EQ(scene.gravity_m_per_s2, Vec3(0, 0, -9.81));
  EXPECT_FALSE(scene.contact.enabled);
  ASSERT_THAT(scene.tissues, SizeIs(1));
  const Tissue& tissue = scene.tissues[0];
  EXPECT_EQ(tissue.mesh_format, "MSH 2.2, text");
  EXPECT_EQ(tissue.mesh.vertices_m[4], Vec3(0.01, 0.01, 0.01));
  EXPECT_EQ(tissue.young_modulus_pa, 1e5);
  EXPECT_EQ(tissue.poisson_ratio, 0.3);
  EXPECT_EQ(tissue.density_kg_per_m3, 1050);
  EXPECT_EQ(tissue.puncture_force_n, 0.07);
  EXPECT_EQ(tissue.friction_n_s_per_m2, 12);
  EXPECT_EQ(tissue.static_friction_n_per_m, 3);
  EXPECT_EQ(tissue.surface_friction_coefficient, 0.2);
  ASSERT_THAT(tissue.prescribed, SizeIs(2));
  EXPECT_THAT(tissue.prescribed[0].vertices, ElementsAre(0, 1, 2));
  EXPECT_EQ(tissue.prescribed[0].displacement_m, Vec3::Zero());
  EXPECT_THAT(tissue.prescribed[1].vertices, ElementsAre(4));
  EXPECT_THAT(tissue.prescribed[1].axes, ElementsAre(false, false, true));
  ASSERT_THAT(tissue.regions, SizeIs(1));
  EXPECT_EQ(tissue.regions[0].young_modulus_pa, 3e5);
  EXPECT_THAT(tissue.regions[0].tets, ElementsAre(0));
  ASSERT_THAT(tissue.loads, SizeIs(1));
  EXPECT_THAT(tissue.loads[0].vertices, ElementsAre(3));
  const Needle& needle = scene.needles.at(0);
  EXPECT_EQ(needle.shape, NeedleShape::kStraight);
  EXPECT_EQ(needle.length_m, 0.03);
  EXPECT_EQ(needle.slide, SlideRule::kLeastSquares);
  EXPECT_EQ(needle.pose.position_m, Vec3(1, 2, 3));
  EXPECT_DOUBLE_EQ(needle.pose.orientation.w(), 0.8);
  EXPECT_DOUBLE_EQ(needle.pose.orientation.z(), 0.6);
  ASSERT_THAT(scene.tools, SizeIs(2));
  const Tool& driver = scene.tools[0];
  EXPECT_EQ(driver.kind, ToolKind::kDriver);
  EXPECT_EQ(driver.capture_radius_m, 0.004);
  EXPECT_EQ(driver.max_force_n, 2);
  EXPECT_EQ(driver.max_torque_nm, 0.2);
  EXPECT_EQ(driver.max_force_slew_n_per_s, 100);
  EXPECT_EQ(driver.max_torque_slew_nm_per_s, 5);
  EXPECT_EQ(driver.stale_after_ms, 20);
  EXPECT_EQ(driver.grip_stiffness_n_per_m, 1000);
  EXPECT_EQ(driver.grip_stiffness_nm_per_rad, 0.4);
  EXPECT_EQ(driver.grip_force_max_n, 4);
  EXPECT_EQ(driver.grip_torque_max_nm, 0.04);
  EXPECT_EQ(driver.max_speed_m_per_s, 1);
  EXPECT_EQ(driver.workspace.motion_scale, 0.2);
  EXPECT_EQ(driver.workspace.force_scale, 5);
  EXPECT_EQ(driver.workspace.clutch_button, 0);
  EXPECT_EQ(driver.workspace.pose.orientation.x(), 1.0);
  EXPECT_EQ(scene.tools[1].kind, ToolKind::kProbe);
  EXPECT_EQ(scene.tools[1].probe_radius_m, 0.001);
}

TEST_F(SceneReader, AnArcIsAsLongAsItsAngle) {
  const Scene scene = read(std::string(kTissue) + kFixed +
                           "[[needle]]\nname = \"n\"\nradius_m = 0.01\narc_deg = 90\n");
  EXPECT_EQ(scene.needles[0].shape, NeedleShape::kArc);
  EXPECT_NEAR(scene.needles[0].length_m, 0.01 * std::numbers::pi / 2.0, 1e-15);
}

TEST_F(SceneReader, NormalisesAQuaternionThatIsNearlyOne) {
  const Scene scene =
      read(std::string(kTissue) + kFixed +
           "[[needle]]\nname = \"n\"\npose = { orientation = [0, 0, 0, 1.0005] }\n");
  EXPECT_DOUBLE_EQ(scene.needles[0].pose.orientation.norm(), 1.0);
}

TEST_F(SceneReader, BoxesFixTheVerticesInside) {
  const Scene scene = read(std::string(kTissue) +
                           "fixed = [{ box = { min_m = [0, 0, 0], max_m = [0.01, 0.01, 0] } },"
                           " { group = \"tip\", dimension = 0 }]\n");
  EXPECT_THAT(scene.tissues[0].prescribed[0].vertices, ElementsAre(0, 1, 2));
  EXPECT_THAT(scene.tissues[0].prescribed[1].vertices, ElementsAre(4));
}

TEST_F(SceneReader, SpreadsLoadsSoThatTheyAddUp) {
  const Scene scene = read(
      std::string(kTissue) + kFixed +
      "load = [{ group = \"base\", force_n = [0, 0, 3] }, { group = \"base\", pressure_pa = 600 },"
      "{ group = \"tip\", force_n = [1, 0, 0] }, { point_m = [0.0025, 0.0025, 0], force_n = [4, 0, "
      "0] }]\n");
  const auto& loads = scene.tissues[0].loads;
  ASSERT_THAT(loads, SizeIs(4));
  const auto total = [](const NodalLoad& load) {
    return std::accumulate(load.force_n.begin(), load.force_n.end(), Vec3(Vec3::Zero()));
  };
  EXPECT_THAT(loads[0].vertices, ElementsAre(0, 1, 2));
  EXPECT_LT((loads[0].force_n[1] - Vec3(0, 0, 1)).norm(), 1e-15);
  // Pressure pushes against the outward normal −z: 600 Pa on 0.5e-4 m².
  EXPECT_LT((total(loads[1]) - Vec3(0, 0, 0.03)).norm(), 1e-15);
  EXPECT_THAT(loads[2].vertices, ElementsAre(4));
  EXPECT_THAT(loads[3].vertices, ElementsAre(0, 1, 2));
  EXPECT_LT((loads[3].force_n[0] - Vec3(2, 0, 0)).norm(), 1e-12);
  EXPECT_LT((loads[3].force_n[1] - Vec3(1, 0, 0)).norm(), 1e-12);
}

TEST_F(SceneReader, ReadsThreads) {
  const std::string punctures =
      "punctures = [{ tissue = \"flap\", vertices = [0, 1, 2], barycentric = [0.2, 0.3, 0.5] },"
      " { tissue = \"flap\", point_m = [0.0025, 0.0025, 0] },"
      " { tissue = \"flap\", point_m = [0.003, 0.0025, 0] },"
      " { tissue = \"flap\", point_m = [0.003, 0.002, 0] }]\n";
  const Scene scene = read(
      std::string(kTissue) + kFixed +
      "[[needle]]\nname = \"n\"\n"
      "[[thread]]\nname = \"t\"\nneedle = \"n\"\nlength_m = 0.3\ntail = \"free\"\n"
      "tail_length_m = 0.02\ntension_max_n = 0.7\nmodel = \"path\"\n" +
      punctures + "[[thread]]\nname = \"u\"\nends = \"none\"\nmodel = \"outside\"\n" + punctures +
      "length_program_m = [[0, 0.05], [1.5, 0.04]]\n"
      "[[thread]]\nname = \"v\"\nhead = \"free\"\n");
  ASSERT_THAT(scene.threads, SizeIs(3));
  const Thread& thread = scene.threads[0];
  EXPECT_EQ(thread.needle, "n");
  EXPECT_EQ(thread.length_m, 0.3);
  EXPECT_EQ(thread.tail, ThreadTail::kFree);
  EXPECT_EQ(thread.ends, ThreadEnds::kHeld);
  EXPECT_EQ(thread.head, ThreadHead::kSwaged);
  EXPECT_EQ(thread.model, ThreadModel::kPath);
  EXPECT_EQ(thread.tail_length_m, 0.02);
  EXPECT_EQ(thread.tension_max_n, 0.7);
  EXPECT_EQ(scene.threads[1].ends, ThreadEnds::kNone);
  EXPECT_EQ(scene.threads[1].model, ThreadModel::kOutside);
  EXPECT_EQ(scene.threads[2].head, ThreadHead::kFree);
  ASSERT_THAT(thread.punctures, SizeIs(4));
  for (const Bite& bite : thread.punctures) {
    EXPECT_EQ(bite.tissue, 0);
    EXPECT_NEAR(bite.barycentric.sum(), 1.0, 1e-14);
  }
  // The face is wound outward, and the weights have followed their vertices.
  EXPECT_THAT(thread.punctures[0].vertices, ElementsAre(0, 2, 1));
  EXPECT_EQ(thread.punctures[0].barycentric, Vec3(0.2, 0.5, 0.3));
  ASSERT_THAT(scene.threads[1].length_program, SizeIs(2));
  EXPECT_EQ(scene.threads[1].length_program[1].time_s, 1.5);
  EXPECT_THAT(scene.notes, IsEmpty());
}

TEST_F(SceneReader, ReadsTheEdgesOfAWound) {
  // A second tissue of the same mesh: "base" bounds them both.
  const Scene scene = read(std::string(kTissue) + kFixed +
                           "[[tissue]]\nname = \"graft\"\nmesh = \"a.msh\"\nscale = 0.01\n"
                           "young_modulus_pa = 1\npoisson_ratio = 0\nfixed = [\"foot\"]\n"
                           "[[wound]]\nname = \"cut\"\nedges = [{ tissue = \"graft\", group = "
                           "\"base\" }, { tissue = \"flap\", group = \"base\" }]\n");
  ASSERT_THAT(scene.wounds, SizeIs(1));
  EXPECT_EQ(scene.wounds[0].name, "cut");
  EXPECT_EQ(scene.wounds[0].edges[0].tissue, 1);
  EXPECT_EQ(scene.wounds[0].edges[1].tissue, 0);
  for (const WoundEdge& edge : scene.wounds[0].edges) {
    EXPECT_EQ(edge.group, "base");
    ASSERT_THAT(edge.triangles, SizeIs(1));
    EXPECT_THAT(edge.vertices, ElementsAre(0, 1, 2));
  }
}

TEST_F(SceneReader, ReadsTheCommittedScene) {
  const Scene scene =
      read_scene(std::string(SUTURED_SOURCE_DIR) + "/server/scenes/anastomosis/scene.toml");
  ASSERT_THAT(scene.tissues, SizeIs(2));
  EXPECT_THAT(scene.tissues[0].mesh.vertices_m, SizeIs(900));
  EXPECT_THAT(scene.tissues[0].mesh.tets, SizeIs(3240));
  EXPECT_THAT(scene.tissues[1].mesh.vertices_m, SizeIs(720));
  EXPECT_THAT(scene.tissues[1].mesh.tets, SizeIs(2592));
  ASSERT_THAT(scene.wounds, SizeIs(1));
  for (const WoundEdge& edge : scene.wounds[0].edges) EXPECT_THAT(edge.vertices, Not(IsEmpty()));
  EXPECT_THAT(scene.notes, IsEmpty());
}

struct BadScene {
  std::string lines;  // behind line 8
  const char* fault;
};

TEST_F(SceneReader, NamesThePlaceAndTheMendOfEveryFault) {
  const std::string needle = "[[needle]]\nname = \"n\"\n";
  const std::string tool = "[[tool]]\nname = \"d\"\n";
  const std::string thread = needle + "[[thread]]\nname = \"t\"\nneedle = \"n\"\n";
  const std::string wound = "[[wound]]\nname = \"w\"\n";  // lines 9 and 10
  const std::string edge = "{ tissue = \"flap\", group = \"base\" }";
  const std::vector<BadScene> scenes{
      {"[[wound]]\nedges = []\n", "s.toml:9:1: [[wound]] has no name"},
      {wound, "s.toml:9:1: [[wound]] \"w\" has no edges; write edges = [{ tissue = "},
      {wound + "edges = 3\n", "s.toml:11:9: edges of [[wound]] \"w\" is not a list"},
      {wound + "edges = [" + edge + "]\n", "s.toml:11:9: [[wound]] \"w\" has 1 edge; write two"},
      {wound + "edges = [" + edge + ", " + edge + ", " + edge + "]\n",
       "s.toml:11:9: [[wound]] \"w\" has 3 edges; write two"},
      {wound + "edges = [" + edge + ", \"base\"]\n",
       "s.toml:11:47: an entry of edges of [[wound]] \"w\" is not a table"},
      {wound + "edges = [" + edge + ", " + edge + "]\n",
       "s.toml:11:9: both edges of [[wound]] \"w\" are the same"},
      {wound + "edges = [" + edge + ", { tissue = \"flop\", group = \"base\" }]\n",
       "s.toml:11:58: an edge of [[wound]] \"w\" is in tissue \"flop\", which is not in the scene, "
       "did you mean \"flap\"?"},
      {wound + "edges = [" + edge + ", { tissue = \"flap\", group = \"foot\" }]\n",
       "s.toml:11:74: the mesh of tissue \"flap\" has no group \"foot\" of dimension 2; it has "
       "base"},
      {wound + "edges = [" + edge + ", { group = \"base\" }]\n",
       "s.toml:11:47: an edge of [[wound]] \"w\" has no tissue"},
      {wound + "edges = [" + edge + ", { tissue = \"flap\" }]\n",
       "s.toml:11:47: an edge of [[wound]] \"w\" has no group"},
      {wound + "edges = [{ tissue = \"flap\", group = \"base\", box = 1 }, 1]\n",
       "s.toml:11:45: unknown key \"box\" in an edge of [[wound]] \"w\""},
      {"[[wound]]\nedges = [" + edge + ", 1]\nname = \"a b\"\n",
       "s.toml:10:47: an entry of edges of [[wound]] \"a b\""},
      {wound + "edges = [" + edge + ", { tissue = \"\", group = \"base\" }]\n",
       "s.toml:11:58: tissue of an edge of [[wound]] \"w\" is an empty text; write what it names"},
      {wound + "edges = [" + edge + ", { tissue = \"flap\", group = \"\" }]\n",
       "s.toml:11:74: group of an edge of [[wound]] \"w\" is an empty text"},
      {"regions = [{ group = \"\", young_modulus_pa = 1 }]\n",
       "s.toml:9:22: group of an entry of regions of tissue \"flap\" is an empty text"},
      {"load = [{ group = \"\", force_n = [0, 0, 1] }]\n",
       "s.toml:9:19: group of an entry of load of tissue \"flap\" is an empty text"},
      {"prescribed = [{ group = \"\", displacement_m = [0, 0, 1] }]\n",
       "s.toml:9:25: group of an entry of prescribed of tissue \"flap\" is an empty text"},
      {thread + "punctures = [{ tissue = \"\", point_m = [0, 0, 0] }]\n",
       "s.toml:14:25: tissue of a puncture of [[thread]] \"t\" is an empty text"},
      {"[[tool]]\nname = \"\"\n", "s.toml:10:8: name of [[tool]] is an empty text"},
      {needle + "[[thread]]\nname = \"t\"\nneedle = \"\"\n",
       "s.toml:13:10: needle of [[thread]] \"t\" is an empty text"},
      {"[[tissue]]\nname = \"x\"\nmesh = \"\"\nyoung_modulus_pa = 1\npoisson_ratio = 0\n",
       "s.toml:11:8: mesh of [[tissue]] \"x\" is an empty text"},
      {"puncture_force = 1\n",
       "s.toml:9:1: unknown key \"puncture_force\" in [[tissue]] \"flap\", did you mean "
       "\"puncture_force_n\"?; correct or delete it"},
      {"fixd = []\n",
       "s.toml:9:1: unknown key \"fixd\" in [[tissue]] \"flap\", did you mean \"fixed\"?"},
      {"zzz = 1\n", "s.toml:9:1: unknown key \"zzz\" in [[tissue]] \"flap\"; correct"},
      {"[[tisue]]\n", "s.toml:9:3: unknown key \"tisue\" in the scene, did you mean \"tissue\"?"},
      {"a = [1,\n", "s.toml:"},
      {"a = \n", "s.toml:9:"},
      {"density_kg_per_m3 = -1\n",
       "s.toml:9:21: density_kg_per_m3 of [[tissue]] \"flap\" is -1 and must be at least 1 "
       "and at most 100000; kilograms"},
      {"density_kg_per_m3 = nan\n",
       "s.toml:9:21: density_kg_per_m3 of [[tissue]] \"flap\" is nan and must be a finite number"},
      {"density_kg_per_m3 = inf\n",
       "s.toml:9:21: density_kg_per_m3 of [[tissue]] \"flap\" is inf and must be a finite number"},
      {"friction_n_s_per_m2 = \"x\"\n",
       "s.toml:9:23: friction_n_s_per_m2 of [[tissue]] \"flap\" is not a number"},
      {"components = 2\n", "s.toml:9:14: the mesh of tissue \"flap\" falls into 1 part "},
      {"volumes = [3]\n", "s.toml:9:12: volumes of [[tissue]] \"flap\" holds something else"},
      {"volumes = \"left\"\n", "s.toml:9:11: volumes of [[tissue]] \"flap\" is not a list"},
      {"regions = [{ group = \"base\", young_modulus_pa = 1 }]\n",
       "s.toml:9:22: the mesh of tissue \"flap\" has no group \"base\" of dimension 3; it has "
       "left, right"},
      {"regions = [{ group = \"left\" }]\n",
       "s.toml:9:12: an entry of regions of tissue \"flap\" has no young_modulus_pa"},
      {"regions = [{ group = \"left\", young_modulus_pa = 1, poisson_ratio = 0.5 }]\n",
       "s.toml:9:68: poisson_ratio of an entry of regions of tissue \"flap\" is 0.5 and must be at "
       "least 0 and below 0.5; 0.45 to 0.49"},
      {"regions = [{ group = \"left\", young_modulus_pa = 1 }, { group = \"left\", "
       "young_modulus_pa = 2 }]\n",
       "s.toml:9:64: regions \"left\" and \"left\" of tissue \"flap\" share tets"},
      {"regions = [1]\n", "s.toml:9:12: an entry of regions"},
      {"prescribed = [{ group = \"tip\", displacement_m = [1, 2] }]\n",
       "s.toml:9:49: displacement_m of an entry of prescribed of tissue \"flap\" is not three "
       "finite numbers"},
      {"prescribed = [{ group = \"tip\", displacement_m = [1, 2, 3], axes = \"xx\" }]\n",
       "s.toml:9:67: axes of an entry"},
      {"prescribed = [{ group = \"tip\" }]\n",
       "s.toml:9:15: an entry of prescribed of tissue \"flap\" has no displacement_m"},
      {"prescribed = [{ displacement_m = [0, 0, 0] }]\n",
       "s.toml:9:15: an entry of prescribed of tissue \"flap\" must name either a group or a box"},
      {"prescribed = [{ group = \"foot\", axes = \"x\", displacement_m = [1, 0, 0] }]\n",
       "s.toml:9:14: two entries of fixed and prescribed of tissue \"flap\" disagree on 3 "
       "coordinates"},
      {"prescribed = [{ box = { min_m = [5, 5, 5], max_m = [6, 6, 6] }, displacement_m = [0, 0, 0] "
       "}]\n",
       "s.toml:9:23: the box holds no vertex of tissue \"flap\"; the mesh lies between [0, 0, 0] "
       "and [0.01, 0.01, 0.01] m"},
      {"prescribed = [{ box = { min_m = [5, 5, 5] }, displacement_m = [0, 0, 0] }]\n",
       "s.toml:9:23: box of tissue \"flap\" has no max_m"},
      {"load = [{ group = \"tipp\", force_n = [0, 0, 1] }]\n",
       "s.toml:9:19: the mesh of tissue \"flap\" has no group \"tipp\", did you mean \"tip\"?; it "
       "has tip, foot, base, left, right"},
      {"load = [{ group = \"foot\", force_n = [0, 0, 1] }]\n",
       "s.toml:9:19: group \"foot\" of tissue \"flap\" has no triangles to load"},
      {"load = [{ group = \"tip\", pressure_pa = 1 }]\n",
       "s.toml:9:19: the mesh of tissue \"flap\" has no group \"tip\" of dimension 2"},
      {"load = [{ group = \"tip\" }]\n",
       "s.toml:9:9: an entry of load of tissue \"flap\" needs one place and one force"},
      {"load = [{ vertex = 1, group = \"tip\", force_n = [0, 0, 1] }]\n",
       "s.toml:9:9: an entry of load of tissue \"flap\" needs one place"},
      {"load = [{ vertex = 5, force_n = [0, 0, 1] }]\n",
       "s.toml:9:20: node 5 belongs to no tet of tissue \"flap\"; count the nodes of the file from "
       "0"},
      {"load = [{ point_m = [0, 0, 1], force_n = [0, 0, 1] }]\n",
       "s.toml:9:21: [0, 0, 1] m lies off the surface of tissue \"flap\"; the nearest point"},
      {"load = [1]\n", "s.toml:9:9: an entry of load"},
      {"[[tissue]]\nname = \"flap\"\nmesh = \"a.msh\"\nyoung_modulus_pa = 1\npoisson_ratio = "
       "0\nfixed = [\"foot\"]\n",
       "s.toml:10:8: there are two of [[tissue]] named \"flap\""},
      {"[[tool]]\nname = \"a b\"\n", "s.toml:10:8: the name \"a b\" cannot be used; use up to 32"},
      {"[[tool]]\nkind = \"probe\"\n", "s.toml:9:1: [[tool]] has no name; add name"},
      {tool + "kind = \"knife\"\n",
       "s.toml:11:8: kind of [[tool]] \"d\" is \"knife\", which is not known; write \"driver\" or "
       "\"probe\""},
      {tool + "max_force_n = 0\n",
       "s.toml:11:15: max_force_n of [[tool]] \"d\" is 0 and must be above 0 and at most "
       "10000; newtons"},
      {tool + "stale_after_ms = 500\n",
       "s.toml:11:18: stale_after_ms of [[tool]] \"d\" is 500 and must be at least 1 and at most "
       "100; 15 suits"},
      {tool + "[tool.workspace]\nmotion_scale = 0\n",
       "s.toml:12:16: motion_scale of workspace of [[tool]] \"d\" is 0 and must be above 0"},
      {tool + "[tool.workspace]\nforce_scale = -2\n",
       "s.toml:12:15: force_scale of workspace of [[tool]] \"d\" is -2"},
      {tool + "[tool.workspace]\nclutch_button = 99\n",
       "s.toml:12:17: clutch_button of workspace of [[tool]] \"d\" is not an integer from -1 to "
       "31"},
      {tool + "workspace = 3\n", "s.toml:11:13: workspace of [[tool]] \"d\" is not a table"},
      {"[tool]\nname = \"d\"\n", "s.toml:9:1: tool of the scene is not a list"},
      {needle + "pose = { orientation = [0, 0, 0, 2] }\n",
       "s.toml:11:24: the quaternion of [[needle]] \"n\" has the length 2, a rotation has "
       "1"},
      {needle + "pose = { orientation = [0, 0, 1] }\n",
       "s.toml:11:24: orientation of pose of [[needle]] \"n\" is not a quaternion"},
      {needle + "length_m = 0.1\n",
       "s.toml:11:12: length_m does not shape a needle that is arc; an arc has radius_m"},
      {needle + "shape = \"straight\"\narc_deg = 10\n",
       "s.toml:12:11: arc_deg does not shape a needle that is straight"},
      {needle + "arc_deg = 400\n",
       "s.toml:11:11: arc_deg of [[needle]] \"n\" is 400 and must be above 0 and at most 350"},
      {needle + "diameter_m = 0.6\n", "s.toml:11:14: [[needle]] \"n\" is thicker than it is long"},
      {"[[thread]]\nname = \"t\"\nneedle = \"nedle\"\n[[needle]]\nname = \"needle\"\n",
       "s.toml:11:10: [[thread]] \"t\" hangs on needle \"nedle\", which is not in the scene, did "
       "you mean \"needle\"?"},
      {"[[thread]]\nname = \"t\"\n", "s.toml:9:1: [[thread]] \"t\" has no needle"},
      {thread + "length_m = 0\n",
       "s.toml:14:12: length_m of [[thread]] \"t\" is 0 and must be above 0"},
      {thread + "punctures = [{ tissue = \"flop\", point_m = [0, 0, 0] }]\n",
       "s.toml:14:25: a puncture of [[thread]] \"t\" is in tissue \"flop\", which is not in the "
       "scene, did you mean \"flap\"?"},
      {thread + "punctures = [{ tissue = \"flap\" }]\n",
       "s.toml:14:14: a puncture of [[thread]] \"t\" needs one place"},
      {thread + "punctures = [{ tissue = \"flap\", vertices = [1, 2, 3], barycentric = [0.2, 0.3, "
                "0.5] }]\n",
       "s.toml:14:44: these three nodes are no boundary face of tissue \"flap\""},
      {thread + "punctures = [{ tissue = \"flap\", vertices = [0, 1, 2], barycentric = [0.2, 0.3, "
                "0.1] }]\n",
       "s.toml:14:44: a puncture of [[thread]] \"t\" has no legal barycentric point"},
      {thread + "punctures = [4]\n", "s.toml:14:14: an entry of punctures"},
      {thread + "length_program_m = [[1, 0.1], [1, 0.2]]\n",
       "s.toml:14:31: a row of length_program_m of [[thread]] \"t\" is not later"},
      {thread + "punctures = [{ tissue = \"flap\", point_m = [0.0025, 0.0025, 0] }]\n",
       "s.toml:14:13: [[thread]] \"t\" has an odd number of punctures (1), and every bite has two"},
      {thread + "length_program_m = [[1, 0.1]]\n",
       "s.toml:14:20: [[thread]] \"t\" has a length program, but hands rule its ends"},
      {"[[thread]]\nname = \"t\"\nends = \"none\"\n",
       "s.toml:11:8: [[thread]] \"t\" has no ends and fewer than two bites"},
      {thread + "head = \"free\"\n",
       "s.toml:13:10: [[thread]] \"t\" has a needle that rules no end"},
      {thread + "[[thread]]\nname = \"u\"\nneedle = \"n\"\n",
       "s.toml:16:10: threads \"t\" and \"u\" hang on the same needle"},
      {thread + "length_program_m = [[1]]\n",
       "s.toml:14:21: a row of length_program_m of [[thread]] \"t\" is not [time_s, length_m]"},
      {"[contact]\nenabled = 1\n", "s.toml:10:11: enabled of [contact] is not true or false"},
      {"[contact]\non = true\n", "s.toml:10:1: unknown key \"on\" in [contact]"},
  };
  for (const BadScene& scene : scenes) {
    const std::string text = error_in_scene(scene.lines);
    EXPECT_THAT(text, StartsWith(scene.fault)) << scene.lines;
    EXPECT_THAT(text, HasSubstr("; ")) << "no mend: " << text;
  }
}

/// 2^53 + 1 and more are no doubles, but numbers.
TEST_F(SceneReader, TakesAnIntegerTooLongForADoubleForANumber) {
  EXPECT_THAT(error_of("rate_hz = 18888888888888888\n" + std::string(kTissue) + kFixed),
              StartsWith("s.toml:1:11: rate_hz of the scene is 1.88889e+16 and must be"));
  EXPECT_THAT(
      error_of("gravity_m_per_s2 = [0, 0, -9007199254740993]\n" + std::string(kTissue) + kFixed),
      StartsWith("s.toml:1:20: gravity_m_per_s2 of the scene holds"));
}

TEST_F(SceneReader, NamesFaultsOfTheSceneItself) {
  EXPECT_THAT(error_of(""), StartsWith("s.toml:1:1: the scene has no tissue; add a [[tissue]]"));
  EXPECT_THAT(
      error_of(std::string("rate_hz = 2000\n") + kTissue + kFixed),
      StartsWith(
          "s.toml:1:11: rate_hz of the scene is 2000 and must be at least 30 and at most 1000"));
  EXPECT_THAT(error_of(std::string("gravity_m_per_s2 = 9.81\n") + kTissue + kFixed),
              StartsWith("s.toml:1:20: gravity_m_per_s2 of the scene is not three finite numbers"));
  EXPECT_THAT(error_of("tissue = [1]\n"),
              StartsWith("s.toml:1:11: tissue is not a list of tables"));
}

TEST_F(SceneReader, NamesWhatATissueMustHave) {
  const std::string text = error_of("[[tissue]]\nname = \"flap\"\n");
  EXPECT_THAT(text, HasSubstr("s.toml:1:1: [[tissue]] \"flap\" has no mesh"));
  EXPECT_THAT(text, HasSubstr("s.toml:1:1: [[tissue]] \"flap\" has no young_modulus_pa"));
  EXPECT_THAT(text, HasSubstr("s.toml:1:1: [[tissue]] \"flap\" has no poisson_ratio"));
}

TEST_F(SceneReader, RefusesAnIncompressibleTissue) {
  EXPECT_THAT(
      error_of("[[tissue]]\nname = \"flap\"\nmesh = \"a.msh\"\nscale = 0.01\n"
               "young_modulus_pa = 0\npoisson_ratio = 0.5\nfixed = [\"foot\"]\n"),
      ::testing::AllOf(
          HasSubstr(
              "s.toml:5:20: young_modulus_pa of [[tissue]] \"flap\" is 0 and must be at least 1"),
          HasSubstr(
              "s.toml:6:17: poisson_ratio of [[tissue]] \"flap\" is 0.5 and must be at least 0 "
              "and below 0.5; 0.45 to 0.49 is soft tissue; at 0.5 it is incompressible")));
}

TEST_F(SceneReader, RefusesABodyThatNothingHolds) {
  EXPECT_THAT(
      error_of(kTissue),
      StartsWith("s.toml:2:1: tissue \"flap\" is not fixed anywhere: its stiffness matrix is "
                 "singular; fix at least three points"));
  EXPECT_THAT(error_of(std::string(kTissue) + "fixed = [\"tip\"]\n"),
              StartsWith("s.toml:8:9: tissue \"flap\" is not held: 3 rigid motions are left free"));
}

TEST_F(SceneReader, RefusesAMeshInPartsThatNobodyDeclared) {
  folder_.write(
      "a.msh",
      "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n8\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n"
      "5 5 0 0\n6 6 0 0\n7 5 1 0\n8 5 0 1\n$EndNodes\n"
      "$Elements\n2\n5 4 2 3 1 1 2 3 4\n6 4 2 4 2 5 6 7 8\n$EndElements\n");
  const std::string left = "fixed = [{ box = { min_m = [0, 0, 0], max_m = [0.01, 0.01, 0] } }]\n";
  EXPECT_THAT(
      error_of(kTissue + left),
      StartsWith("s.toml:4:8: the mesh of tissue \"flap\" falls into 2 parts (of 1, 1 tets), "
                 "not 1; delete the debris"));
  EXPECT_THAT(
      error_of(kTissue + left + "components = 2\n"),
      StartsWith("s.toml:8:9: component 2 of 2 of tissue \"flap\" (4 vertices about [0.055, "
                 "0.005, 0.005] m) is not fixed anywhere"));
}

TEST_F(SceneReader, NamesTheFaultsOfAMeshByFileAndEntity) {
  folder_.write(
      "a.msh",
      "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 nan\n"
      "$EndNodes\n$Elements\n1\n5 4 2 3 1 1 2 3 4\n$EndElements\n");
  EXPECT_EQ(
      error_of(std::string(kTissue) + kFixed),
      "s.toml:4:8: the mesh of [[tissue]] \"flap\" cannot be used; see the faults of a.msh\n"
      "a.msh:9: node 4: a coordinate is not a finite number; repair the mesh where it was made");
  EXPECT_THAT(error_of("[[tissue]]\nname = \"x\"\nmesh = \"none.msh\"\nyoung_modulus_pa = 1\n"
                       "poisson_ratio = 0\nfixed = [\"a\"]\n"),
              HasSubstr("none.msh: cannot be opened: No such file or directory; "));
}

TEST_F(SceneReader, AsksWhichGroupWhereTwoHaveOneName) {
  folder_.write(
      "a.msh",
      "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n"
      "$EndNodes\n$Elements\n2\n1 2 2 7 1 1 3 2\n5 4 2 7 1 1 2 3 4\n$EndElements\n");
  EXPECT_THAT(
      error_of(std::string(kTissue) + "fixed = [\"7\"]\n"),
      StartsWith("s.toml:8:10: tissue \"flap\" has groups \"7\" of dimension 2 and 3; write { "
                 "group = \"7\", dimension = 3 }"));
  const Scene scene = read(std::string(kTissue) + "fixed = [{ group = \"7\", dimension = 2 }]\n");
  EXPECT_THAT(scene.tissues[0].prescribed[0].vertices, ElementsAre(0, 1, 2));
}

TEST_F(SceneReader, CollectsAllFaultsInOnePassInTheOrderOfTheFile) {
  const std::string text = error_in_scene(
      "a = 1\n[[tool]]\nname = \"d\"\nmax_force_n = -1\nb = 2\n[[needle]]\nname = \"n\"\narc_deg = "
      "0\n");
  std::vector<std::string> lines;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    lines.push_back(text.substr(at, text.find(' ', at) - at));
    at = end + 1;
  }
  EXPECT_THAT(lines, ElementsAre("s.toml:9:1:", "s.toml:12:15:", "s.toml:13:1:", "s.toml:16:11:"));
}

TEST_F(SceneReader, DoubtsAnImplausibleUnit) {
  const Scene scene = read(
      "[[tissue]]\nname = \"flap\"\nmesh = \"a.msh\"\nyoung_modulus_pa = 1e5\n"
      "poisson_ratio = 0.4\nfixed = [\"foot\"]\n");
  EXPECT_THAT(scene.notes, Contains(HasSubstr("is the unit right?")));
}

// Finite, and yet a slip of the unit or of the exponent: each with its place and the unit.
TEST_F(SceneReader, RefusesNumbersThatNoBodyHas) {
  const auto tissue = [](const std::string& scale, const std::string& modulus) {
    return "name = \"test\"\n[[tissue]]\nname = \"flap\"\nmesh = \"a.msh\"\nscale = " + scale +
           "\nyoung_modulus_pa = " + modulus + "\npoisson_ratio = 0.45\n" + kFixed;
  };
  EXPECT_EQ(error_of(tissue("0.01", "1e300")),
            "s.toml:6:20: young_modulus_pa of [[tissue]] \"flap\" is 1e+300 and must be at least 1 "
            "and at most 1e+13; pascals: soft tissue has 1e3 to 1e7, steel 2e11");
  EXPECT_EQ(error_of(tissue("1e30", "2e5")),
            "s.toml:5:9: scale of [[tissue]] \"flap\" is 1e+30 and must be at least 1e-09 and at "
            "most 1000; metres per unit of the mesh: 0.001 for millimetres");
  EXPECT_EQ(error_of(tissue("1e-300", "2e5")).substr(0, 12), "s.toml:5:9: ");
  EXPECT_THAT(error_of(tissue("1000", "2e5")),
              StartsWith("s.toml:5:9: [[tissue]] \"flap\" is 1000"));
  EXPECT_THAT(error_of(tissue("1e-5", "2e5")),
              StartsWith("s.toml:5:9: [[tissue]] \"flap\" is 0.0000"));
  struct Absurd {
    std::string lines, place, mend;
  };
  const std::string tool = "[[tool]]\nname = \"d\"\n", needle = "[[needle]]\nname = \"n\"\n";
  for (const Absurd& absurd : std::vector<Absurd>{
           {"density_kg_per_m3 = 1e200\n", "s.toml:9:21: ", "kilograms per cubic metre"},
           {"puncture_force_n = 1e99\n", "s.toml:9:20: ", "newtons"},
           {"friction_n_s_per_m2 = 1e99\n", "s.toml:9:23: ", "per metre of embedded needle"},
           {"load = [{ point_m = [0.01, 0.01, 0.01], force_n = [0, 1e99, 0] }]\n",
            "s.toml:9:51: ", "newtons"},
           {"regions = [{ group = \"left\", young_modulus_pa = 1e99 }]\n",
            "s.toml:9:49: ", "pascals"},
           {needle + "radius_m = 1e30\n", "s.toml:11:12: ", "metres"},
           {needle + "pose = { position_m = [0, 1e30, 0] }\n", "s.toml:11:23: ", "metres"},
           {tool + "max_force_n = 1e30\n", "s.toml:11:15: ", "newtons"},
           {tool + "max_torque_slew_nm_per_s = 1e30\n", "s.toml:11:28: ", "a second"},
           {tool + "grip_stiffness_n_per_m = 1e30\n", "s.toml:11:26: ", "firm grip"},
           {tool + "workspace = { motion_scale = 1e30 }\n", "s.toml:11:30: ", "a factor"},
       }) {
    const std::string text = error_in_tissue(absurd.lines);
    EXPECT_THAT(text, StartsWith(absurd.place)) << absurd.lines;
    EXPECT_THAT(text, HasSubstr(absurd.mend)) << absurd.lines;
  }
  EXPECT_THAT(error_of("gravity_m_per_s2 = [0, 0, -1e99]\n" + std::string(kTissue) + kFixed),
              HasSubstr("holds -1e+99 and each must be at least -1000 and at most 1000"));
}

TEST_F(SceneReader, RefusesATissueOfWhichNothingCanMove) {
  EXPECT_THAT(error_of(std::string(kTissue) +
                       "fixed = [{ box = { min_m = [-1, -1, -1], max_m = [1, 1, 1] } }]\n"),
              StartsWith("s.toml:8:9: every vertex of tissue \"flap\" is held"));
}

TEST_F(SceneReader, RefusesMoreToolsThanAHandCanFeel) {
  std::string tools;
  for (int i = 0; i < 8; ++i) tools += "[[tool]]\nname = \"t" + std::to_string(i) + "\"\n";
  EXPECT_EQ(error_in_scene(tools), "");
  EXPECT_THAT(error_in_scene(tools + "[[tool]]\nname = \"t8\"\n"),
              StartsWith("s.toml:25:1: the scene has 9 tools and may have 8; leave some out"));
}

TEST_F(SceneReader, RefusesWhatIsNotAFileWithoutWaiting) {
  ASSERT_EQ(::mkfifo(folder_.path("p.toml").c_str(), 0600), 0);
  for (const char* name : {"p.toml", "none.toml", "."}) {
    try {
      (void)read_scene(folder_.path(name));
      FAIL() << name;
    } catch (const SceneError& error) {
      EXPECT_THAT(error.what(), HasSubstr(name));
    }
  }
  folder_.write("big.toml", std::string((1 << 20) + 1, '#'));
  EXPECT_THROW((void)read_scene(folder_.path("big.toml")), SceneError);
}

}  // namespace
}  // namespace sutured::scene
