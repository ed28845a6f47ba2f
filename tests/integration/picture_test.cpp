// SPDX-License-Identifier: GPL-3.0-or-later
// The picture of a run, as `make picture` draws it.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <system_error>
#include <vector>

#include "support/block_mesh.hpp"
#include "support/program.hpp"

namespace sutured {
namespace {

const std::string kScript = SUTURED_SOURCE_DIR "/server/scenes/picture.py";

testing::ProgramResult python(std::vector<std::string> arguments) {
  arguments.insert(arguments.begin(), SUTURED_PYTHON);
  return testing::run_program(arguments);
}

/// A bar along x under stress that rises along it, as `sutured run` leaves it.
void write_bar(const std::string& path, bool stressed = true) {
  const auto mesh = testing::block_mesh(6, 2, 2, {0.03, 0.01, 0.01});
  std::ofstream vtk(path);
  vtk << "# vtk DataFile Version 3.0\nbar\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS "
      << mesh.vertices_m.size() << " double\n";
  for (const auto& x : mesh.vertices_m) vtk << x[0] << ' ' << x[1] << ' ' << x[2] << '\n';
  vtk << "CELLS " << mesh.tets.size() << ' ' << 5 * mesh.tets.size() << '\n';
  for (const auto& t : mesh.tets)
    vtk << "4 " << t[0] << ' ' << t[1] << ' ' << t[2] << ' ' << t[3] << '\n';
  vtk << "CELL_TYPES " << mesh.tets.size() << '\n';
  for (std::size_t i = 0; i < mesh.tets.size(); ++i) vtk << "10\n";
  vtk << "POINT_DATA " << mesh.vertices_m.size() << "\nVECTORS displacement_m double\n";
  for (std::size_t v = 0; v < mesh.vertices_m.size(); ++v) vtk << "0 0 1e-3\n";
  vtk << "SCALARS von_mises_pa double 1\nLOOKUP_TABLE default\n";
  for (const auto& x : mesh.vertices_m) vtk << (stressed ? 1e6 * x[0] : 0.0) << '\n';
  vtk << "VECTORS principal_pa double\n";
  for (const auto& x : mesh.vertices_m) vtk << 1e6 * x[0] << " 0 0\n";
  vtk << "CELL_DATA " << mesh.tets.size() << "\nSCALARS von_mises_pa double 1\n"
      << "LOOKUP_TABLE default\n";
  for (std::size_t i = 0; i < mesh.tets.size(); ++i) vtk << "7\n";
}

/// What a reader of PNGs finds in the upper view, the legend left out.
struct Pixels {
  double drawn = 0.0;              ///< share of pixels that are not white
  double blue = 0.0;               ///< share of pixels that are blue: threads
  std::array<double, 2> bright{};  ///< of the drawn pixels of its left and right quarter, 0 … 1
};

Pixels look(const std::string& path) {
  const auto result = python({"-c", R"(
import sys, numpy, matplotlib.image
p = matplotlib.image.imread(sys.argv[1])[..., :3]
p = p[: p.shape[0] // 2, : int(0.88 * p.shape[1])]
drawn = (p < 0.97).any(axis=2)
xs = numpy.nonzero(drawn.any(axis=0))[0]
edge = (xs[-1] - xs[0]) // 4
ends = [slice(xs[0], xs[0] + edge), slice(xs[-1] - edge, xs[-1])]
print(drawn.mean(), (p[..., 2] > p[..., 0] + 0.2).mean(),
      *(p[:, end][drawn[:, end]].mean() for end in ends)))",
                              path});
  Pixels pixels;
  std::istringstream(result.out) >> pixels.drawn >> pixels.blue >> pixels.bright[0] >>
      pixels.bright[1];
  EXPECT_EQ(result.exit_code, 0) << result.err;
  return pixels;
}

class Picture : public ::testing::Test {
 protected:
  void SetUp() override {
    try {
      if (python({"-c", "import matplotlib, numpy"}).exit_code == 0) return;
    } catch (const std::system_error&) {
    }
    GTEST_SKIP() << "matplotlib is missing; `make test` installs it";
  }
  testing::ProgramResult draw(std::vector<std::string> more = {}) {
    more.insert(more.begin(), {kScript, folder_.path("")});
    return python(more);
  }
  testing::TemporaryFolder folder_;
};

TEST_F(Picture, ShowsTheTissueAndWhereItsStressIs) {
  write_bar(folder_.path("final.vtk"));
  auto result = draw();
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_EQ(result.err, "");
  EXPECT_NE(result.out.find("picture.png"), std::string::npos);
  const Pixels stressed = look(folder_.path("picture.png"));
  EXPECT_GT(stressed.drawn, 0.2);
  EXPECT_LT(stressed.drawn, 0.9);
  EXPECT_EQ(stressed.blue, 0.0);
  EXPECT_GT(stressed.bright[0], stressed.bright[1] + 0.2);  // pale at rest, dark under stress

  write_bar(folder_.path("final.vtk"), false);
  result = draw({"--out", folder_.path("rest.png")});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const Pixels at_rest = look(folder_.path("rest.png"));
  EXPECT_NEAR(at_rest.drawn, stressed.drawn, 0.01);
  EXPECT_LT(std::abs(at_rest.bright[0] - at_rest.bright[1]), 0.1);

  result =
      draw({"--out", folder_.path("principal.png"), "--field", "principal", "--max-kpa", "15"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const Pixels principal = look(folder_.path("principal.png"));
  EXPECT_GT(principal.bright[0], principal.bright[1] + 0.2);
}

TEST_F(Picture, ShowsThreadsAndNeedlesOfTheSummary) {
  write_bar(folder_.path("final.vtk"));
  nlohmann::json summary;
  summary["needles"]["needle"] = {{"embedded_length_m", 0.0}};  // without a course: left out
  for (int i = 0; i <= 20; ++i)                                 // a ring around the bar
    summary["threads"]["suture"]["course_m"].push_back(
        {0.015, 0.005 + 0.008 * std::cos(0.3 * i), 0.006 + 0.008 * std::sin(0.3 * i)});
  std::ofstream(folder_.path("summary.json")) << summary;
  const auto result = draw();
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_NE(result.out.find("0 needles, 1 threads"), std::string::npos) << result.out;
  EXPECT_GT(look(folder_.path("picture.png")).blue, 1e-3);
}

TEST_F(Picture, FaultsAreOneLineWithTheMend) {
  const auto expect_fault = [&](const std::string& what) {
    const auto result = draw();
    EXPECT_EQ(result.exit_code, 1) << what;
    EXPECT_NE(result.err.find("final.vtk"), std::string::npos) << result.err;
    EXPECT_NE(result.err.find(what), std::string::npos) << result.err;
    EXPECT_NE(result.err.find("; "), std::string::npos) << result.err;
    EXPECT_EQ(std::count(result.err.begin(), result.err.end(), '\n'), 1) << result.err;
  };
  expect_fault("No such file");
  folder_.write("final.vtk", "solid tissue\n");
  expect_fault("not a legacy VTK text file");
  folder_.write("final.vtk", "# vtk DataFile Version 3.0\n\xff\xfe\nASCII\n");
  expect_fault("not text");
  write_bar(folder_.path("final.vtk"));
  const std::string whole = testing::read_file(folder_.path("final.vtk"));
  for (const std::size_t length : {whole.size() / 3, whole.find("POINT_DATA") + 11,
                                   whole.find("SCALARS") + 9, whole.find("VECTORS")}) {
    folder_.write("final.vtk", whole.substr(0, length));
    expect_fault(length == whole.find("VECTORS") ? "holds no displacement_m"
                                                 : "ends in the middle");
  }
  std::string wrong = whole;
  wrong.replace(wrong.find("\n0 0 1e-3") + 1, 8, "0 0 nan ");
  folder_.write("final.vtk", wrong);
  expect_fault("not finite");
  wrong = whole;
  wrong.replace(wrong.find("POINTS "), 8, "POINTS -");
  folder_.write("final.vtk", wrong);
  expect_fault("ends in the middle");
  folder_.write("final.vtk", whole);
  folder_.write("summary.json", "{\"threads\": {\"suture\": {\"course_m\": [[1, 2]]}}}");
  const auto result = draw();
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_NE(result.err.find("summary.json"), std::string::npos) << result.err;
  EXPECT_EQ(draw({"--max-kpa", "-1"}).exit_code, 2);
  EXPECT_EQ(draw({"--field", "colour"}).exit_code, 2);
}

}  // namespace
}  // namespace sutured
