// SPDX-License-Identifier: GPL-3.0-or-later
// R4: a thread through 4, 20 and 50 punctures without contact. The problem is convex, so every
// right solver finds the same; here the way a user goes: a scene file and `sutured run`.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>

#include "fem/elements.hpp"
#include "geometry/tet_mesh.hpp"
#include "support/program.hpp"

namespace sutured {
namespace {

using geometry::Vec3;
using nlohmann::json;

const std::string kReference = SUTURED_SOURCE_DIR "/tests/validation/reference/";

json reference() { return json::parse(std::ifstream(kReference + "R4_thread_only.json")); }

/// What `final.vtk` holds of the tissue.
struct FinalState {
  std::vector<Vec3> rest_m, now_m;
  std::vector<geometry::Tet> tets;
};

FinalState read_final_state(const std::string& path) {
  FinalState state;
  std::ifstream file(path);
  std::string word;
  std::size_t count = 0;
  while (file >> word && word != "POINTS") {
  }
  file >> count >> word;
  state.rest_m.resize(count);
  for (Vec3& x : state.rest_m) file >> x[0] >> x[1] >> x[2];
  std::size_t cells = 0;
  file >> word >> cells >> count;
  state.tets.resize(cells);
  for (geometry::Tet& tet : state.tets) {
    file >> count;
    for (auto& v : tet) file >> v;
  }
  while (file >> word && word != "displacement_m") {
  }
  file >> word;
  for (const Vec3& x : state.rest_m) {
    Vec3 u;
    file >> u[0] >> u[1] >> u[2];
    state.now_m.push_back(x + u);
  }
  EXPECT_TRUE(file.good()) << path;
  return state;
}

double volume_m3(const geometry::Tet& tet, const std::vector<Vec3>& x) {
  const auto at = [&](std::size_t i) { return x[static_cast<std::size_t>(tet[i])]; };
  return geometry::signed_volume(at(0), at(1), at(2), at(3));
}

/// The scene as a user would write it, with the vessels as two tissues of one mesh.
std::string scene_text(const json& file, const json& test) {
  std::ostringstream toml;
  toml.precision(17);
  toml << "name = \"R4\"\nrate_hz = 250\n[contact]\nenabled = false\n";
  const auto tissue = [&](const char* name, const char* volume, const std::string& far_end) {
    toml << "[[tissue]]\nname = \"" << name << "\"\nmesh = \"" << kReference
         << "tubes_1k6.msh\"\nvolumes = [\"" << volume
         << "\"]\nyoung_modulus_pa = " << file.at("E").get<double>()
         << "\npoisson_ratio = " << file.at("nu").get<double>() << "\nfixed = [{ box = { "
         << far_end << " } }]\n";
  };
  // Nodes beyond |z| = 20.7495 mm are fixed.
  tissue("below", "1", "min_m = [-1.0, -1.0, -1.0], max_m = [1.0, 1.0, -20.7495e-3]");
  tissue("above", "2", "min_m = [-1.0, -1.0, 20.7495e-3], max_m = [1.0, 1.0, 1.0]");
  toml << "[[thread]]\nname = \"thread\"\nends = \"none\"\nmodel = \"outside\"\npunctures = [\n";
  const std::size_t n = test.at("punctures").size();
  for (std::size_t i = 0; i < n; ++i) {
    const json& puncture = test.at("punctures")[i];
    // Bites alternate between the vessels.
    toml << "  { tissue = \"" << (i / 2 % 2 == 0 ? "below" : "above")
         << "\", vertices = " << puncture.at("nodes") << ", barycentric = " << puncture.at("bary")
         << " },\n";
  }
  toml << "]\nlength_program_m = [[0.0, " << test.at("L0").get<double>() << "], [1.0, "
       << test.at("target_length").get<double>() << "]]\n";
  return toml.str();
}

class ThreadReference : public ::testing::TestWithParam<std::size_t> {};

TEST_P(ThreadReference, R4ThreadWithoutContact) {
  const json file = reference();
  const json& test = file.at("cases")[GetParam()];
  const json& expected = test.at("expect");
  const testing::TemporaryFolder folder;
  const std::string scene = folder.write("scene.toml", scene_text(file, test));
  // A second to close, and 25 steps to come to rest.
  const auto result = testing::run_program(
      {SUTURED_PROGRAM, "run", scene, "--out", folder.path("out"), "--duration", "1.1", "--quiet"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto tolerance = [&](const char* key) { return file.at("tol_rel").at(key).get<double>(); };
  const auto expect = [&](const char* key, double got) {
    const double want = expected.at(key);
    EXPECT_NEAR(got, want, tolerance(key) * want) << key;
    std::printf("  %-12s %.10g, reference %.10g\n", key, got, want);
  };
  const json summary = json::parse(testing::read_file(folder.path("out/summary.json")));
  expect("tension", summary.at("threads").at("thread").at("tension_n"));

  const FinalState state = read_final_state(folder.path("out/final.vtk"));
  double largest = 0.0;
  for (std::size_t v = 0; v < state.rest_m.size(); ++v)
    largest = std::max(largest, (state.now_m[v] - state.rest_m[v]).norm());
  expect("max_u", largest);
  double volume = 0.0, rest_volume = 0.0, determinant = std::numeric_limits<double>::infinity();
  for (const auto& tet : state.tets) {
    const double now = volume_m3(tet, state.now_m), rest = volume_m3(tet, state.rest_m);
    volume += now;
    rest_volume += rest;
    determinant = std::min(determinant, now / rest);
  }
  expect("volume_ratio", volume / rest_volume);
  expect("min_detF", determinant);

  // Vertices keep the file's order only within a tissue: the punctures are found by position.
  std::ifstream mesh(kReference + "tubes_1k6.msh");
  std::string word;
  while (mesh >> word && word != "$Nodes") {
  }
  std::size_t count = 0;
  mesh >> count;
  std::vector<Vec3> nodes(count);
  for (Vec3& x : nodes) mesh >> word >> x[0] >> x[1] >> x[2];
  const auto displaced = [&](std::size_t node) {
    for (std::size_t v = 0; v < state.rest_m.size(); ++v)
      if ((state.rest_m[v] - nodes[node]).norm() < 1e-9) return state.now_m[v];
    ADD_FAILURE() << "node " << node << " is not in final.vtk";
    return Vec3(Vec3::Zero());
  };
  std::vector<Vec3> punctures;
  for (const json& puncture : test.at("punctures")) {
    Vec3 sum = Vec3::Zero();
    for (std::size_t i = 0; i < 3; ++i)
      sum += puncture.at("bary")[i].get<double>() * displaced(puncture.at("nodes")[i]);
    punctures.push_back(sum);
  }
  double length = 0.0;
  for (std::size_t i = 1; i + 1 < punctures.size(); i += 2)
    length += (punctures[i + 1] - punctures[i]).norm();
  expect("length", length);

  // The rims lie at z = ±0.75 mm.
  std::array<double, 2> sum{}, number{};
  for (std::size_t v = 0; v < state.rest_m.size(); ++v) {
    if (std::abs(std::abs(state.rest_m[v].z()) - 0.75e-3) > 1e-6) continue;
    const std::size_t side = state.rest_m[v].z() > 0.0 ? 1 : 0;
    sum[side] += state.now_m[v].z();
    number[side] += 1.0;
  }
  EXPECT_NEAR(sum[1] / number[1] - sum[0] / number[0], expected.at("rim_gap_mean").get<double>(),
              tolerance("rim_gap_mean"));  // absolute, m
}

INSTANTIATE_TEST_SUITE_P(Punctures, ThreadReference, ::testing::Values(0, 1, 2),
                         [](const auto& index) {
                           return std::to_string(std::array{4, 20, 50}[index.param]);
                         });

}  // namespace
}  // namespace sutured
