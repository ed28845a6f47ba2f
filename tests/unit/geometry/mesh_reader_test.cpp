// SPDX-License-Identifier: GPL-3.0-or-later
#include "geometry/mesh_reader.hpp"

#include <gmock/gmock.h>
#include <gmsh.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <bit>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <numeric>
#include <string>
#include <thread>
#include <vector>

#include "geometry/mesh_quality.hpp"
#include "geometry/topology.hpp"
#include "support/temporary_folder.hpp"

// libgmsh loses a few bytes when it throws; of ours none may be lost.
extern "C" const char* __lsan_default_suppressions();  // NOLINT(*-reserved-identifier)
extern "C" const char* __lsan_default_suppressions() { return "leak:libgmsh\n"; }  // NOLINT

namespace sutured::geometry {
namespace {

using sutured::testing::TemporaryFolder;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::SizeIs;
using ::testing::StartsWith;

// Two tets on one face, six nodes (the last an orphan), groups of every dimension.
constexpr const char* kNodes22 =
    "$Nodes\n6\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n5 1 1 1\n9 7 7 7\n$EndNodes\n";
constexpr const char* kElements22 =
    "$Elements\n5\n1 15 2 8 1 1\n2 1 2 0 1 1 2\n3 2 2 4 1 1 3 2\n4 4 2 1 1 1 2 3 4\n"
    "5 4 2 2 2 2 3 4 5\n$EndElements\n";

std::string msh22(const std::string& nodes = kNodes22, const std::string& elements = kElements22) {
  return "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n2\n3 1 \"left\"\n2 4 \"base\"\n"
         "$EndPhysicalNames\n" +
         nodes + elements;
}

template <typename T>
void append(std::string& bytes, std::initializer_list<T> values) {
  for (const T value : values) {
    const auto raw = std::bit_cast<std::array<char, sizeof(T)>>(value);
    bytes.append(raw.begin(), raw.end());
  }
}

std::string error_of(const std::string& path, double scale = 1.0,
                     const std::vector<std::string>& volumes = {}) {
  try {
    (void)read_mesh(path, scale, volumes);
  } catch (const MeshError& error) {
    return error.what();
  }
  return "";
}

class MeshReader : public ::testing::Test {
 protected:
  // The fault a file of this content gives, without its folder.
  std::string error_in(const std::string& content, const char* name = "a.msh") {
    const std::string text = error_of(folder_.write(name, content));
    const std::string prefix = folder_.path("");
    return text.starts_with(prefix) ? text.substr(prefix.size()) : text;
  }
  TemporaryFolder folder_;
};

TEST_F(MeshReader, ReadsMsh22WithGroupsInTheOrderOfTheFile) {
  const MeshReading reading = read_mesh(folder_.write("a.msh", msh22()), 0.001);
  const TetMesh& mesh = reading.mesh;
  EXPECT_EQ(reading.format, "MSH 2.2, text");
  ASSERT_THAT(mesh.vertices_m, SizeIs(5));
  EXPECT_EQ(mesh.vertices_m[4], Vec3(0.001, 0.001, 0.001));
  EXPECT_THAT(mesh.file_index, ElementsAre(0, 1, 2, 3, 4));
  EXPECT_THAT(mesh.tets, ElementsAre(Tet{0, 1, 2, 3}, Tet{1, 2, 3, 4}));
  EXPECT_THAT(reading.notes, ElementsAre(HasSubstr("1 node belongs to no tet")));
  const PhysicalGroup* left = mesh.find_group("left");
  ASSERT_NE(left, nullptr);
  EXPECT_THAT(left->tets, ElementsAre(0));
  EXPECT_THAT(left->vertices, ElementsAre(0, 1, 2, 3));
  const PhysicalGroup* base = mesh.find_group("base");
  ASSERT_NE(base, nullptr);
  EXPECT_THAT(base->triangles, ElementsAre(Triangle{0, 2, 1}));
  const PhysicalGroup* unnamed = mesh.find_group("2");
  ASSERT_NE(unnamed, nullptr);
  EXPECT_EQ(unnamed->dimension, 3);
  ASSERT_NE(mesh.find_group("8"), nullptr);
  EXPECT_EQ(mesh.find_group("8")->dimension, 0);
}

TEST_F(MeshReader, SaysThatTmpdirIsNoFolder) {
  const std::string path = folder_.write("a.msh", msh22());
  const char* before = std::getenv("TMPDIR");
  const std::string kept = before == nullptr ? "" : before;
  ::setenv("TMPDIR", folder_.path("none").c_str(), 1);
  EXPECT_THAT(error_of(path), HasSubstr("cannot be copied: no folder can be made in"));
  EXPECT_THAT(error_of(path), HasSubstr("; make room there, or set TMPDIR"));
  before == nullptr ? ::unsetenv("TMPDIR") : ::setenv("TMPDIR", kept.c_str(), 1);
}

TEST_F(MeshReader, SelectsPhysicalVolumes) {
  const std::string path = folder_.write("a.msh", msh22());
  const MeshReading reading = read_mesh(path, 1.0, std::vector<std::string>{"2"});
  EXPECT_THAT(reading.mesh.tets, ElementsAre(Tet{0, 1, 2, 3}));
  EXPECT_THAT(reading.mesh.file_index, ElementsAre(1, 2, 3, 4));
  EXPECT_EQ(reading.mesh.find_group("left"), nullptr);
  EXPECT_THAT(error_of(path, 1.0, {"right"}),
              HasSubstr("volume \"right\": is no physical volume of the mesh; it has left, 2"));
}

TEST_F(MeshReader, ReadsMsh1WithSparseNumbers) {
  const MeshReading reading =
      read_mesh(folder_.write("a.msh",
                              "$NOD\n4\n40 0 0 0\n7 1 0 0\n30 0 1 0\n21 0 0 1\n$ENDNOD\n"
                              "$ELM\n2\n1 2 6 1 3 40 30 7\n2 4 5 1 4 40 7 30 21\n$ENDELM\n"),
                1.0);
  EXPECT_THAT(reading.mesh.tets, ElementsAre(Tet{0, 1, 2, 3}));
  EXPECT_THAT(reading.mesh.file_index, ElementsAre(0, 1, 2, 3));
  ASSERT_NE(reading.mesh.find_group("6"), nullptr);
  EXPECT_THAT(reading.mesh.find_group("6")->triangles, ElementsAre(Triangle{0, 2, 1}));
}

TEST_F(MeshReader, ReadsMsh41TextAndBinaryAlike) {
  const std::string text =
      "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n3 3 \"body\"\n$EndPhysicalNames\n"
      "$Entities\n0 0 0 1\n1 0 0 0 1 1 1 1 3 0\n$EndEntities\n"
      "$Nodes\n1 4 1 4\n3 1 0 4\n1\n2\n3\n4\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n$EndNodes\n"
      "$Elements\n1 1 1 1\n3 1 4 1\n1 1 2 3 4\n$EndElements\n";
  std::string binary = "$MeshFormat\n4.1 1 8\n";
  append<std::int32_t>(binary, {1});
  binary += "\n$EndMeshFormat\n$PhysicalNames\n1\n3 3 \"body\"\n$EndPhysicalNames\n$Entities\n";
  append<std::uint64_t>(binary, {0, 0, 0, 1});
  append<std::int32_t>(binary, {1});
  append<double>(binary, {0, 0, 0, 1, 1, 1});
  append<std::uint64_t>(binary, {1});
  append<std::int32_t>(binary, {3});
  append<std::uint64_t>(binary, {0});
  binary += "\n$EndEntities\n$Nodes\n";
  append<std::uint64_t>(binary, {1, 4, 1, 4});
  append<std::int32_t>(binary, {3, 1, 0});
  append<std::uint64_t>(binary, {4, 1, 2, 3, 4});
  append<double>(binary, {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1});
  binary += "\n$EndNodes\n$Elements\n";
  append<std::uint64_t>(binary, {1, 1, 1, 1});
  append<std::int32_t>(binary, {3, 1, 4});
  append<std::uint64_t>(binary, {1, 1, 1, 2, 3, 4});
  binary += "\n$EndElements\n";
  for (const std::string& content : {text, binary}) {
    const MeshReading reading = read_mesh(folder_.write("a.msh", content), 1.0);
    EXPECT_THAT(reading.mesh.tets, ElementsAre(Tet{0, 1, 2, 3}));
    ASSERT_NE(reading.mesh.find_group("body"), nullptr) << reading.format;
    EXPECT_THAT(reading.mesh.find_group("body")->tets, ElementsAre(0));
  }
  // Cut anywhere, it is refused: never a crash, never half a mesh.
  for (const std::string& content : {text, binary}) {
    const std::size_t whole = content.rfind("$EndElements") + std::string("$EndElements").size();
    for (std::size_t length = 0; length < whole; length += 3)
      EXPECT_NE(error_in(content.substr(0, length)), "") << "cut at " << length;
  }
}

TEST_F(MeshReader, ReadsLegacyVtkTextAndBinaryAlike) {
  const std::string head = "# vtk DataFile Version 3.0\nany title\n";
  std::string binary = head + "BINARY\nDATASET UNSTRUCTURED_GRID\nPOINTS 4 float\n";
  const auto append_big = [&](auto value) {
    auto raw = std::bit_cast<std::array<char, 4>>(value);
    std::reverse(raw.begin(), raw.end());
    binary.append(raw.begin(), raw.end());
  };
  for (const float x : {0.F, 0.F, 0.F, 1.F, 0.F, 0.F, 0.F, 1.F, 0.F, 0.F, 0.F, 1.F}) append_big(x);
  binary += "\nMETADATA\nINFORMATION 0\n\nCELLS 1 5\n";
  for (const std::int32_t i : {4, 0, 1, 2, 3}) append_big(i);
  binary += "\nCELL_TYPES 1\n";
  append_big(std::int32_t{10});
  const std::string text = head +
                           "ASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 4 double\n0 0 0 1 0 0\n"
                           "0 1 0 0 0 1\nCELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n10\n"
                           "CELL_DATA 1\nSCALARS a int 1\nLOOKUP_TABLE default\n1\n";
  for (const std::string& content : {text, binary}) {
    const MeshReading reading = read_mesh(folder_.write("a.vtk", content), 2.0);
    EXPECT_THAT(reading.mesh.tets, ElementsAre(Tet{0, 1, 2, 3}));
    EXPECT_EQ(reading.mesh.vertices_m[3], Vec3(0, 0, 2));
  }
}

TEST_F(MeshReader, TurnsAFileRoundThatIsLeftHandedThroughout) {
  const MeshReading reading =
      read_mesh(folder_.write("a.msh", msh22(kNodes22,
                                             "$Elements\n2\n4 4 2 1 1 1 3 2 4\n5 4 2 2 2 2 4 3 5\n"
                                             "$EndElements\n")),
                1.0);
  EXPECT_THAT(reading.mesh.tets, ElementsAre(Tet{0, 2, 3, 1}, Tet{1, 3, 4, 2}));
  EXPECT_NEAR(mesh_quality(reading.mesh).volume_m3, 0.5, 1e-15);
  EXPECT_THAT(reading.notes, ::testing::Contains(HasSubstr("left-handed")));
}

TEST_F(MeshReader, NamesEveryFaultyTet) {
  const std::string text =
      error_in(msh22(kNodes22,
                     "$Elements\n5\n1 4 2 1 1 1 2 3 4\n2 4 2 1 1 2 4 3 5\n3 4 2 1 1 1 2 2 3\n"
                     "4 4 2 1 1 4 1 2 3\n5 4 2 1 1 1 2 3 5\n$EndElements\n"));
  EXPECT_THAT(text, HasSubstr("a.msh: tet 3: has no volume; "));
  EXPECT_THAT(text, HasSubstr("a.msh: tet 2: is inverted; "));
  EXPECT_THAT(text, HasSubstr("a.msh: tet 4: has the same vertices as tet 1; "));
}

TEST_F(MeshReader, NamesAFaceWithThreeTets) {
  const std::string text = error_in(msh22(
      "$Nodes\n6\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n5 1 1 1\n6 .2 .2 3\n$EndNodes\n",
      "$Elements\n3\n1 4 2 1 1 1 2 3 4\n2 4 2 1 1 1 2 3 5\n3 4 2 1 1 1 2 3 6\n$EndElements\n"));
  EXPECT_THAT(text, StartsWith("a.msh: tet 1: shares one face with tet 2, tet 3; "));
}

struct BadFile {
  const char* name;
  std::string content;
  const char* fault;
};

TEST_F(MeshReader, RefusesWhatIsNotAMesh) {
  const std::string canary = folder_.path("canary");
  const std::string script = "SystemCall \"touch " + canary + "\";\n";
  const std::string vtk = "# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\n";
  const std::string format = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n";
  const std::vector<BadFile> files{
      {"a.msh", script, "a.msh: this is not a mesh: "},
      {"a.vtk", script, "a.vtk: this is not a mesh: "},
      {"a.geo", script, "a.geo: a .geo file is a script"},
      {"a.geo", msh22(), "a.geo: a .geo file is a script"},
      {"a.msh.opt", msh22(), "a.msh.opt: mesh files end in .msh or .vtk"},
      {"a.msh.gz", msh22(), "a.msh.gz: mesh files end in .msh or .vtk"},
      {"a", msh22(), "a: mesh files end in .msh or .vtk"},
      {"a.vtk", msh22(), "a.vtk: the content does not match the extension"},
      {"a.msh", "", "a.msh: the file is empty"},
      {"a.msh", " $MeshFormat\n2.2 0 8\n", "a.msh: this is not a mesh: "},
      {"a.msh", "$MeshFormatted\n" + script, "a.msh: this is not a mesh: "},
      {"a.msh", "$NODE\n" + script, "a.msh: this is not a mesh: "},
      {"a.msh", "$MeshFormat\n" + script, "a.msh:2: "},
      {"a.msh", "$MeshFormat\n3.0 0 8\n", "a.msh:2: MSH version \"3.0\" is not read"},
      {"a.msh", "$MeshFormat\n2.2 7 8\n", "a.msh:2: the file type is neither"},
      {"a.msh", format, "a.msh:3: there is no section $Elements"},
      {"a.msh", format + script, "a.msh:4: found \"SystemCall\" where a section"},
      {"a.msh", msh22() + script, "a.msh:26: found \"SystemCall\" where a section"},
      {"a.msh", "$NOD\n" + script, "a.msh:2: found \"SystemCall\" where the number of nodes"},
      {"a.vtk", "# vtk DataFile Version 3.0\n" + script, "a.vtk:2: the file ends where ASCII"},
      {"a.vtk", "# vtk DataFile Version 3.0\nt\n" + script, "a.vtk:3: found \"SystemCall\""},
      {"a.vtk", "# vtk DataFile Version 5.1\nt\nASCII\n", "a.vtk:1: legacy VTK version \"5.1\""},
      {"a.vtk", vtk + script, "a.vtk:5: found \"SystemCall\" where POINTS"},
      {"a.vtk", vtk + "POINTS 1000000000 double\n0 0 0\n", "a.vtk:5: the number of points is"},
      {"a.vtk", vtk + "POINTS -1 double\n0 0 0\n", "a.vtk:5: the number of points is -1"},
      {"a.vtk",
       vtk + "POINTS 1 double\n0 0 0\nCELLS 1 200\n199" + std::string(400, '0').replace(0, 1, " "),
       "a.vtk:8: cell 0: has 199 points"},
      {"a.msh", msh22("$Nodes\n2000000000\n1 0 0 0\n$EndNodes\n"),
       "a.msh:10: the number of nodes is 2000000000"},
      {"a.msh", msh22("$Nodes\n99999999999999999999\n1 0 0 0\n$EndNodes\n"),
       "a.msh:10: found \"99999999999999999999\""},
      {"a.msh", msh22("$Nodes\n1\n2000000000 0 0 0\n$EndNodes\n"),
       "a.msh:11: node number 2000000000 is not between"},
      {"a.msh", msh22("$Nodes\n1\n1 0 nan 0\n$EndNodes\n"),
       "a.msh:11: node 1: a coordinate is not a finite number"},
      {"a.msh", msh22("$Nodes\n1\n1 0 0 -inf\n$EndNodes\n"),
       "a.msh:11: node 1: a coordinate is not a finite number"},
      {"a.msh", msh22("$Nodes\n1\n1 0 1e999 0\n$EndNodes\n"),
       "a.msh:11: node 1: a coordinate is not a finite number"},
      {"a.msh", msh22("$Nodes\n2\n1 0 0 0\n1 0 0 1\n$EndNodes\n"),
       "a.msh:12: node 1: stands twice in the file"},
      {"a.msh", msh22("$Nodes\n1\n1 0 0 " + std::string(5000, '7') + "\n$EndNodes\n"),
       "a.msh:11: a word too long for a coordinate"},
      {"a.msh", msh22(kNodes22, "$Elements\n1\n1 4 2 1 1 1 2 3 44\n$EndElements\n"),
       "a.msh:20: element 1: refers to node 44, which is not in the file"},
      {"a.msh", msh22(kNodes22, "$Elements\n1\n1 4 1000000 1 1 1 2 3 4\n$EndElements\n"),
       "a.msh:20: an element has 1000000 tags"},
      {"a.msh", msh22(kNodes22, "$Elements\n1\n1 5 2 1 1 1 2 3 4 5 1 2 3\n$EndElements\n"),
       "a.msh:20: element 1: has the type 5"},
      {"a.msh", msh22(kNodes22, "$Elements\n1\n1 2 2 1 1 1 2 3\n$EndElements\n"),
       "a.msh: there are no tetrahedra in it"},
      {"a.msh", msh22(kNodes22, "$Elements\n2\n1 4 2 1 1 1 2 3 4\n"),
       "a.msh:20: the file ends where an element's number should stand"},
      {"a.msh",
       msh22(kNodes22, "$Elements\n2\n6 4 2 1 1 1 2 3 4\n6 4 2 1 1 2 3 4 5\n$EndElements\n"),
       "a.msh:21: element 6: stands twice in the file; renumber the elements"},
      {"a.msh", msh22(kNodes22, "$Elements\n2\n6 2 2 1 1 1 2 3\n6 4 2 1 1 1 2 3 4\n$EndElements\n"),
       "a.msh:21: element 6: stands twice in the file"},
      {"a.msh", msh22(kNodes22, "$Elements\n1\n1 4 2 -1 1 1 2 3 4\n$EndElements\n"),
       "a.msh:20: element 1: has the negative group or entity -1"},
      {"a.msh", msh22(kNodes22, "$Elements\n1\n1 4 2 1 -2 1 2 3 4\n$EndElements\n"),
       "a.msh:20: element 1: has the negative group or entity -2"},
      {"a.msh",
       "$NOD\n4\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n$ENDNOD\n$ELM\n2\n7 4 1 1 4 1 2 3 4\n"
       "7 2 1 1 3 1 2 3\n$ENDELM\n",
       "a.msh:11: element 7: stands twice in the file"},
      {"a.msh",
       "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 5 1 5\n3 1 0 5\n1\n2\n3\n4\n5\n0 0 0\n"
       "1 0 0\n0 1 0\n0 0 1\n1 1 1\n$EndNodes\n$Elements\n1 2 3 3\n3 1 4 2\n3 1 2 3 4\n"
       "3 2 3 4 5\n$EndElements\n",
       "a.msh:22: element 3: stands twice in the file"},
      {"a.msh", msh22() + kNodes22, "a.msh:26: section $Nodes stands twice"},
  };
  for (const BadFile& file : files) {
    const std::string text = error_in(file.content, file.name);
    EXPECT_THAT(text, StartsWith(file.fault)) << file.name << ":\n" << file.content.substr(0, 200);
    EXPECT_THAT(text, HasSubstr("; ")) << "no mend: " << text;
    EXPECT_FALSE(std::filesystem::exists(canary)) << "a command ran";
  }
}

// What the guard is for, and the proof that the canary of these tests can be made.
TEST_F(MeshReader, LibgmshAloneWouldRunACommand) {
  const std::string canary = folder_.path("canary");
  const std::string path = folder_.write("a.msh", "SystemCall \"touch " + canary + "\";\n");
  gmsh::initialize(0, nullptr, false);
  gmsh::option::setNumber("General.Terminal", 0);
  gmsh::open(path);
  gmsh::finalize();
  EXPECT_TRUE(std::filesystem::exists(canary));
}

TEST_F(MeshReader, RunsNoScriptLaidBesideTheMeshOrNamedInIt) {
  const std::string canary = folder_.path("canary");
  const std::string script = "SystemCall \"touch " + canary + "\";\n";
  folder_.write("a.msh.opt", script);
  folder_.write(".gmshrc", script);
  folder_.write(".gmsh-options", script);
  const std::string comments = "$Comments\n" + script + "$EndComments\n";
  const std::string views = "$NodeData\n1\n\"" + script + "\"\n$EndNodeData\n";
  const MeshReading reading = read_mesh(folder_.write("a.msh", msh22() + comments + views), 1.0);
  EXPECT_THAT(reading.mesh.tets, SizeIs(2));
  EXPECT_THAT(reading.notes, ::testing::Contains(HasSubstr("$Comments")));
  const std::string shell_name = "a;touch canary;.msh";
  EXPECT_THAT(read_mesh(folder_.write(shell_name, msh22()), 1.0).mesh.tets, SizeIs(2));
  EXPECT_FALSE(std::filesystem::exists(canary));
  EXPECT_FALSE(std::filesystem::exists("canary"));
}

TEST_F(MeshReader, RefusesFoldersPipesAndMissingFilesWithoutWaiting) {
  std::filesystem::create_directory(folder_.path("d.msh"));
  ASSERT_EQ(::mkfifo(folder_.path("p.msh").c_str(), 0600), 0);
  EXPECT_THAT(error_of(folder_.path("d.msh")), HasSubstr("d.msh: is not a regular file"));
  EXPECT_THAT(error_of(folder_.path("p.msh")), HasSubstr("p.msh: is not a regular file"));
  EXPECT_THAT(error_of("/dev/zero"), HasSubstr("is not a regular file"));
  EXPECT_THAT(error_of(folder_.path("none.msh")), HasSubstr("none.msh: cannot be opened: No such"));
}

TEST_F(MeshReader, RefusesAScaleThatIsNone) {
  const std::string path = folder_.write("a.msh", msh22());
  for (const double scale : {0.0, -1.0, std::nan(""), HUGE_VAL})
    EXPECT_THAT(error_of(path, scale), HasSubstr("the scale must be positive and finite"));
}

// Found by fuzz_mesh_reader: the guard lets it pass, libgmsh throws a string.
TEST_F(MeshReader, TellsWhatLibgmshFindsWrong) {
  EXPECT_THAT(error_in("$MeshFormat\n4.1 0 8\n$EndMeshFormat\n"
                       "$Entities\n0 0 1 1\n1 0 0 0 1 1 1 0 0\n1 0 0 0 1 1 1 0 1 99\n"
                       "$EndEntities\n$Nodes\n1 4 1 4\n3 1 0 4\n1\n2\n3\n4\n0 0 0\n1 0 0\n0 1 0\n"
                       "0 0 1\n$EndNodes\n$Elements\n1 1 1 1\n3 7 4 1\n1 1 2 3 4\n$EndElements\n"),
              StartsWith("a.msh: libgmsh cannot read it: "));
}

TEST_F(MeshReader, ShowsTwentyFaultsAndCountsTheRest) {
  std::string elements = "$Elements\n30\n";
  for (int i = 1; i <= 30; ++i) elements += std::to_string(i) + " 4 2 1 1 1 2 3 77\n";
  const std::string text = error_in(msh22(kNodes22, elements + "$EndElements\n"));
  EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), 20);
  EXPECT_THAT(text, HasSubstr("10 more faults"));
}

TEST_F(MeshReader, LeavesNothingInTheTemporaryFolder) {
  const TemporaryFolder temporary;
  const char* old = std::getenv("TMPDIR");
  const std::string saved = old != nullptr ? old : "";
  ::setenv("TMPDIR", temporary.path("").c_str(), 1);
  (void)read_mesh(folder_.write("a.msh", msh22()), 1.0);
  if (old != nullptr)
    ::setenv("TMPDIR", saved.c_str(), 1);
  else
    ::unsetenv("TMPDIR");
  EXPECT_TRUE(std::filesystem::is_empty(temporary.path("")));
}

TEST_F(MeshReader, ReadsFromSeveralThreads) {
  const std::string path = folder_.write("a.msh", msh22());
  std::vector<std::size_t> tets(4, 0);
  std::vector<std::thread> threads;
  for (std::size_t& count : tets)
    threads.emplace_back([&] { count = read_mesh(path, 1.0).mesh.tets.size(); });
  for (std::thread& thread : threads) thread.join();
  EXPECT_THAT(tets, ::testing::Each(2));
}

TEST_F(MeshReader, WritesNothingToTheTerminal) {
  ::testing::internal::CaptureStdout();
  ::testing::internal::CaptureStderr();
  (void)read_mesh(folder_.write("a.msh", msh22()), 1.0);
  EXPECT_EQ(::testing::internal::GetCapturedStdout(), "");
  EXPECT_EQ(::testing::internal::GetCapturedStderr(), "");
}

}  // namespace
}  // namespace sutured::geometry
