// SPDX-License-Identifier: GPL-3.0-or-later
#include "simulation/quality.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "fem/elements.hpp"

namespace sutured::simulation {
namespace {

constexpr double kAnywhere_m = 1e3;  // a radius that holds every scene
// A bite and the passage that made it are told apart by where they enter. Events stand a substep
// aside of where the tissue is by then, so this is wide; the nearest wins.
constexpr double kSameEntry_m = 2e-3;
constexpr double kSameBite_m = 1e-6;
constexpr int kCourseSamples = 16;
constexpr std::size_t kPassagesMax = 64;
// A course is drawn through the middle of cells and may leave a tet by this share.
constexpr double kOutsideMax = 0.1;

std::size_t at(std::int64_t i) { return static_cast<std::size_t>(i); }

int index_of(const std::vector<std::string>& names, const std::string& name) {
  const auto found = std::find(names.begin(), names.end(), name);
  return found == names.end() ? -1 : static_cast<int>(found - names.begin());
}

double force_n(const ToolResponse& response) { return response.wrench.head<3>().norm(); }

Vec3 tip_of(const needle::Curve& curve, const NeedleState& state) {
  return curve.point({state.position_m, state.orientation}, curve.length_m());
}

bool in_tissue(const NeedleState& needle) {
  return needle.embedded_length_m > 0.0 || needle.tip_inside;
}

bool on_tissue(const NeedleState& needle) { return in_tissue(needle) || needle.tip_force_n != 0.0; }

bool holds(const ToolResponse& response, HeldKind kind, int index) {
  return response.held.kind == kind && response.held.index == index;
}

// A vertex over the border of an edge lies opposite it where the way across is this straight.
constexpr double kAheadCosine = 0.99;

/// The edges that belong to one of the triangles only.
std::vector<std::pair<std::int32_t, std::int32_t>> border_of(
    std::span<const geometry::Triangle> triangles) {
  std::map<std::pair<std::int32_t, std::int32_t>, int> uses;
  for (const geometry::Triangle& t : triangles)
    for (std::size_t i = 0; i < 3; ++i) ++uses[std::minmax(t[i], t[(i + 1) % 3])];
  std::vector<std::pair<std::int32_t, std::int32_t>> border;
  for (const auto& [edge, count] : uses)
    if (count == 1) border.push_back(edge);
  return border;
}

}  // namespace

bool differs(const ThreadQuality& a, const ThreadQuality& b) {
  constexpr double kLength_m = 1e-6, kForce_n = 1e-4, kStress_pa = 1.0;
  const auto apart = [](double x, double y, double least) {
    return std::isnan(x) != std::isnan(y) || std::abs(x - y) > least;
  };
  const auto spreads_apart = [&](const Spread& x, const Spread& y) {
    return apart(x.mean, y.mean, kLength_m) || apart(x.deviation, y.deviation, kLength_m);
  };
  const auto bites_apart = [&](const BiteFigures& x, const BiteFigures& y) {
    return x.tissue != y.tissue || (x.entry_m - y.entry_m).norm() > kLength_m ||
           (x.exit_m - y.exit_m).norm() > kLength_m || apart(x.depth_m, y.depth_m, kLength_m) ||
           apart(x.edge_distance_m, y.edge_distance_m, kLength_m) ||
           apart(x.spacing_m, y.spacing_m, kLength_m) ||
           apart(x.peak_force_n, y.peak_force_n, kForce_n);
  };
  return a.handovers != b.handovers || a.needle_drops != b.needle_drops ||
         a.bites.size() != b.bites.size() || apart(a.needle_path_m, b.needle_path_m, kLength_m) ||
         apart(a.peak_force_n, b.peak_force_n, kForce_n) ||
         apart(a.peak_principal_stress_pa, b.peak_principal_stress_pa, kStress_pa) ||
         apart(a.gap_start.max_m, b.gap_start.max_m, kLength_m) ||
         apart(a.gap.max_m, b.gap.max_m, kLength_m) || apart(a.tension_n, b.tension_n, kForce_n) ||
         spreads_apart(a.depth_m, b.depth_m) || spreads_apart(a.spacing_m, b.spacing_m) ||
         !std::equal(a.bites.begin(), a.bites.end(), b.bites.begin(),
                     [&](const auto& x, const auto& y) { return !bites_apart(x, y); });
}

QualityView quality_view(const Simulation& simulation) {
  return {simulation.time_s(),  simulation.responses(), simulation.needles(),
          simulation.threads(), simulation.events(),    simulation.positions_m()};
}

double peak_principal_stress_pa(const StressField& stress, std::span<const Body> bodies) {
  double peak_pa = kNoFigure;
  for (const Body& body : bodies)
    for (const std::int32_t v : body.surface_vertices) {
      const double principal_pa =
          fem::principal_stress_pa(stress.vertex_pa[at(body.first_vertex + v)])[0];
      if (!(principal_pa <= peak_pa)) peak_pa = principal_pa;
    }
  return peak_pa;
}

Spread spread_of(std::span<const double> values) {
  double sum = 0.0, squares = 0.0;
  int count = 0;
  for (const double value : values) {
    if (std::isnan(value)) continue;
    sum += value;
    ++count;
  }
  if (count == 0) return {};
  const double mean = sum / count;
  for (const double value : values)
    if (!std::isnan(value)) squares += (value - mean) * (value - mean);
  return {mean, std::sqrt(squares / count)};
}

QualityMeter::QualityMeter(const scene::Scene& scene, const Simulation& simulation)
    : rest_m_(simulation.rest_positions_m().begin(), simulation.rest_positions_m().end()) {
  for (const scene::Needle& needle : scene.needles) {
    needle_names_.push_back(needle.name);
    needles_.emplace_back().curve = needle::Curve::of(needle);
  }
  for (const scene::Tissue& tissue : scene.tissues) tissue_names_.push_back(tissue.name);
  for (const scene::Thread& thread : scene.threads)
    needle_of_thread_.push_back(index_of(needle_names_, thread.needle));
  const auto global = [&](const geometry::Triangle& triangle, const Body& body) {
    geometry::Triangle moved = triangle;
    for (std::int32_t& v : moved) v += body.first_vertex;
    return moved;
  };
  for (const Body& body : simulation.bodies()) {
    std::vector<geometry::Triangle> surface;
    for (const geometry::Triangle& triangle : body.surface)
      surface.push_back(global(triangle, body));
    surfaces_at_rest_.emplace_back(surface, rest_m_);
    tets_.emplace_back();
    for (const geometry::Tet& tet : simulation.tets())
      if (tet[0] >= body.first_vertex && tet[0] < body.first_vertex + body.vertex_count)
        tets_.back().push_back(tet);
  }
  for (const scene::Wound& wound : scene.wounds) {
    Wound& made = wounds_.emplace_back();
    for (std::size_t i = 0; i < made.size(); ++i) {
      const scene::WoundEdge& edge = wound.edges[i];
      const Body& body = simulation.bodies()[at(edge.tissue)];
      std::vector<geometry::Triangle> triangles;
      for (const geometry::Triangle& triangle : edge.triangles)
        triangles.push_back(global(triangle, body));
      made[i].tissue = edge.tissue;
      for (const std::int32_t v : edge.vertices) made[i].vertices.push_back(body.first_vertex + v);
      made[i].now = made[i].at_rest = geometry::TriangleTree(triangles, rest_m_);
    }
    keep_opposite(made);
    gaps_at_rest_.push_back(gap_of(made, rest_m_, &Edge::at_rest));
  }
  threads_.resize(scene.threads.size());
  for (ThreadQuality& thread : threads_) thread.bites.reserve(kBitesMax);
  reset();
}

/// Keeps the vertices of each edge that lie opposite the other: whose nearest point there is not on
/// its border, or straight ahead of it. Where none does, all stay.
void QualityMeter::keep_opposite(Wound& wound) const {
  std::array<std::vector<std::int32_t>, 2> opposite;
  for (std::size_t i = 0; i < wound.size(); ++i) {
    const auto border = border_of(wound[1 - i].at_rest.triangles());
    for (const std::int32_t v : wound[i].vertices) {
      const auto nearest = wound[1 - i].at_rest.nearest(rest_m_[at(v)], kAnywhere_m, rest_m_);
      if (!nearest) continue;
      const Vec3& p = nearest->closest.point_m;
      const geometry::Triangle& t = wound[1 - i].at_rest.triangles()[at(nearest->triangle)];
      const Vec3 normal = (rest_m_[at(t[1])] - rest_m_[at(t[0])])
                              .cross(rest_m_[at(t[2])] - rest_m_[at(t[0])])
                              .normalized();
      const Vec3 across = rest_m_[at(v)] - p;
      const bool ahead = std::abs(normal.dot(across)) >= kAheadCosine * across.norm();
      const bool outside =
          !ahead && std::any_of(border.begin(), border.end(), [&](const auto& edge) {
            const Vec3 &a = rest_m_[at(edge.first)], d = rest_m_[at(edge.second)] - a;
            const double share = std::clamp(d.dot(p - a) / d.squaredNorm(), 0.0, 1.0);
            return (a + share * d - p).norm() < 1e-6 * d.norm();
          });
      if (!outside) opposite[i].push_back(v);
    }
  }
  if (opposite[0].empty() && opposite[1].empty()) return;
  for (std::size_t i = 0; i < wound.size(); ++i) wound[i].vertices = std::move(opposite[i]);
}

void QualityMeter::reset() {
  for (Needle& needle : needles_) {
    const needle::Curve curve = needle.curve;
    needle = {};
    needle.curve = curve;
  }
  gaps_ = gaps_at_rest_;
  for (ThreadQuality& thread : threads_) {
    std::vector<BiteFigures> bites = std::move(thread.bites);  // keeps its memory
    thread = {};
    thread.bites = std::move(bites);
    thread.bites.clear();
    thread.gap_start = thread.gap = widest(gaps_at_rest_);
  }
}

void QualityMeter::serialize(Archive& archive) {
  // Given by the scene: needle_names … gaps_at_rest; `measure` fits the wounds' trees.
  auto& [needle_names, tissue_names, needle_of_thread, tets, surfaces_at_rest, rest, wounds,
         gaps_at_rest, gaps, needles, threads, scratch] = *this;
  archive.fixed(gaps);
  archive.fixed(needles);
  archive.fixed(threads);
}

void QualityMeter::Needle::serialize(Archive& archive) {
  auto& [curve_, seen_, tip, path, approach_peak, keeper_, handovers_, drops_, passages_] = *this;
  archive(seen_, tip, path, approach_peak, keeper_, handovers_, drops_, passages_);
}

WoundGap QualityMeter::widest(std::span<const WoundGap> gaps) const {
  WoundGap widest;
  for (const WoundGap& gap : gaps)
    if (!(gap.max_m <= widest.max_m)) widest = gap;
  return widest;
}

// ------------------------------------------------------------------ each step

void QualityMeter::watch(const QualityView& view) {
  for (std::size_t n = 0; n < needles_.size(); ++n) {
    watch_needle(view, n);
    watch_holders(view, n);
    watch_passages(view, n);
  }
  for (std::size_t t = 0; t < threads_.size(); ++t) {
    ThreadQuality& thread = threads_[t];
    thread.elapsed_s = view.time_s;
    thread.tension_n = view.threads[t].tension_n;
    thread.peak_force_n = std::max(thread.peak_force_n, force_on_tissue_n(view, t));
    if (needle_of_thread_[t] < 0) continue;
    const Needle& needle = needles_[at(needle_of_thread_[t])];
    thread.needle_path_m = needle.path_m;
    thread.handovers = needle.handovers;
    thread.needle_drops = needle.drops;
  }
}

void QualityMeter::watch_needle(const QualityView& view, std::size_t n) {
  Needle& needle = needles_[n];
  const Vec3 tip = tip_of(needle.curve, view.needles[n]);
  if (needle.seen) needle.path_m += (tip - needle.tip_m).norm();
  needle.tip_m = tip;
  needle.seen = true;
}

void QualityMeter::watch_holders(const QualityView& view, std::size_t n) {
  Needle& needle = needles_[n];
  int holder = -1;
  bool kept = false;
  for (std::size_t i = 0; i < view.responses.size(); ++i) {
    if (!holds(view.responses[i], HeldKind::kNeedle, static_cast<int>(n))) continue;
    holder = static_cast<int>(i);
    kept = kept || holder == needle.keeper;
  }
  if (kept) return;  // a second hand beside it does not have it yet
  if (holder >= 0) {
    needle.handovers += needle.keeper >= 0;
    needle.keeper = holder;
  } else if (needle.keeper >= 0 && !in_tissue(view.needles[n])) {
    // Neither a hand nor the tissue has it.
    ++needle.drops;
    needle.keeper = -1;
  }
}

void QualityMeter::watch_passages(const QualityView& view, std::size_t n) {
  Needle& needle = needles_[n];
  double peak_n = 0.0;
  for (const ToolResponse& response : view.responses)
    if (holds(response, HeldKind::kNeedle, static_cast<int>(n)))
      peak_n = std::max(peak_n, force_n(response));
  if (view.needles[n].tip_force_n == 0.0 && !in_tissue(view.needles[n]))
    needle.approach_peak_n = 0.0;
  for (const Event& event : view.events) {
    if (event.subject != needle_names_[n]) continue;
    const int tissue = index_of(tissue_names_, event.object);
    if (tissue < 0) continue;
    if (event.kind == EventKind::kPuncture) {
      if (needle.passages.size() == kPassagesMax) needle.passages.erase(needle.passages.begin());
      needle.passages.push_back(
          {tissue, rest_of(event.position_m, tissue, view.positions_m), needle.approach_peak_n});
      needle.approach_peak_n = 0.0;
    } else if (event.kind == EventKind::kExit) {
      const auto open =
          std::find_if(needle.passages.rbegin(), needle.passages.rend(),
                       [&](const Passage& p) { return p.open && p.tissue == tissue; });
      if (open == needle.passages.rend()) continue;
      open->peak_force_n = std::max(open->peak_force_n, peak_n);
      open->open = false;
      needle.approach_peak_n = 0.0;
    }
  }
  for (Passage& passage : needle.passages)
    if (passage.open) passage.peak_force_n = std::max(passage.peak_force_n, peak_n);
  if (view.needles[n].tip_force_n != 0.0)
    needle.approach_peak_n = std::max(needle.approach_peak_n, peak_n);
}

double QualityMeter::force_on_tissue_n(const QualityView& view, std::size_t thread) const {
  const int needle = needle_of_thread_[thread];
  double peak_n = 0.0;
  for (const ToolResponse& response : view.responses) {
    const bool works =
        (needle >= 0 && holds(response, HeldKind::kNeedle, needle) &&
         (on_tissue(view.needles[at(needle)]) || view.threads[thread].tension_n > 0.0)) ||
        holds(response, HeldKind::kThread, static_cast<int>(thread)) ||
        response.held.kind == HeldKind::kTissue ||
        (response.held.kind == HeldKind::kNothing && response.touching);
    if (works) peak_n = std::max(peak_n, force_n(response));
  }
  return peak_n;
}

void QualityMeter::note_principal_stress(double stress_pa) {
  for (ThreadQuality& thread : threads_)
    if (!(stress_pa <= thread.peak_principal_stress_pa))
      thread.peak_principal_stress_pa = stress_pa;
}

// ------------------------------------------------------------------ when asked

void QualityMeter::measure(const QualityView& view) {
  for (std::size_t w = 0; w < wounds_.size(); ++w) {
    for (Edge& edge : wounds_[w]) edge.now.refit(view.positions_m);
    gaps_[w] = gap_of(wounds_[w], view.positions_m, &Edge::now);
  }
  for (std::size_t t = 0; t < threads_.size(); ++t) {
    ThreadQuality& thread = threads_[t];
    thread.gap = widest(gaps_);
    measure_bites(view.threads[t], view.positions_m, t);
    scratch_.clear();
    for (const BiteFigures& bite : thread.bites) scratch_.push_back(bite.depth_m);
    thread.depth_m = spread_of(scratch_);
    scratch_.clear();
    for (const BiteFigures& bite : thread.bites) scratch_.push_back(bite.spacing_m);
    thread.spacing_m = spread_of(scratch_);
  }
}

WoundGap QualityMeter::gap_of(const Wound& wound, std::span<const geometry::Vec3> positions_m,
                              geometry::TriangleTree Edge::*tree) const {
  double sum = 0.0, most = 0.0;
  std::size_t count = 0;
  for (std::size_t i = 0; i < wound.size(); ++i)
    for (const std::int32_t v : wound[i].vertices) {
      const auto nearest =
          (wound[1 - i].*tree).nearest(positions_m[at(v)], kAnywhere_m, positions_m);
      if (!nearest) continue;
      const double distance = std::sqrt(nearest->closest.squared_distance_m2);
      sum += distance;
      most = std::max(most, distance);
      ++count;
    }
  if (count == 0) return {};
  return {sum / static_cast<double>(count), most};
}

void QualityMeter::measure_bites(const ThreadState& state,
                                 std::span<const geometry::Vec3> positions_m, std::size_t thread) {
  std::vector<BiteFigures>& bites = threads_[thread].bites;
  std::size_t count = 0;
  const ThreadPuncture* entry = nullptr;
  // From tail to head, as they were made. The punctures say which way one goes from head to tail:
  // an entry of the needle leads out.
  for (auto p = state.punctures.rbegin(); p != state.punctures.rend() && count < kBitesMax; ++p) {
    if (!p->inward) {
      entry = &*p;
      continue;
    }
    if (entry == nullptr || entry->tissue != p->tissue || p->tissue < 0) continue;
    const auto here = bites.begin() + static_cast<std::ptrdiff_t>(count);
    const auto known = std::find_if(here, bites.end(), [&](const BiteFigures& bite) {
      return bite.tissue == p->tissue &&
             (bite.entry_m - entry->rest_position_m).norm() < kSameBite_m &&
             (bite.exit_m - p->rest_position_m).norm() < kSameBite_m;
    });
    if (known != bites.end()) {
      bites.erase(here, known);  // those before it are gone
    } else {
      bites.insert(here, measure_bite(state, *entry, *p, positions_m));
    }
    ++count;
    entry = nullptr;
  }
  bites.resize(count);
  for (std::size_t i = 0; i < count; ++i) {
    bites[i].peak_force_n = peak_force_of(bites[i], thread);
    bites[i].spacing_m = kNoFigure;
    for (std::size_t j = i; j-- > 0;) {
      if (bites[j].tissue != bites[i].tissue) continue;
      bites[i].spacing_m = (bites[i].entry_m - bites[j].entry_m).norm();
      break;
    }
  }
}

BiteFigures QualityMeter::measure_bite(const ThreadState& state, const ThreadPuncture& entry,
                                       const ThreadPuncture& exit,
                                       std::span<const geometry::Vec3> positions_m) const {
  BiteFigures bite;
  bite.tissue = entry.tissue;
  bite.entry_m = entry.rest_position_m;
  bite.exit_m = exit.rest_position_m;
  // Points of the course strictly inside; where none is drawn, the straight line between the holes.
  const auto first =
      std::upper_bound(state.arc_length_m.begin(), state.arc_length_m.end(), exit.arc_length_m);
  const auto last = std::lower_bound(first, state.arc_length_m.end(), entry.arc_length_m);
  const auto inside = last - first;
  const geometry::TriangleTree& surface = surfaces_at_rest_[at(entry.tissue)];
  const int samples = inside > 0
                          ? static_cast<int>(std::min<std::ptrdiff_t>(inside, kCourseSamples))
                          : kCourseSamples;
  for (int i = 0; i < samples; ++i) {
    const double share = (i + 0.5) / samples;
    Vec3 p = bite.entry_m + share * (bite.exit_m - bite.entry_m);
    if (inside > 0) {
      const auto index = (first - state.arc_length_m.begin()) +
                         static_cast<std::ptrdiff_t>(share * static_cast<double>(inside));
      p = rest_of(state.course_m[at(index)], entry.tissue, positions_m);
    }
    bite.depth_m = std::max(bite.depth_m, distance_at_rest_m(p, surface));
  }
  for (const Wound& wound : wounds_)
    for (const Edge& edge : wound) {
      if (edge.tissue != bite.tissue) continue;
      const double distance = std::min(distance_at_rest_m(bite.entry_m, edge.at_rest),
                                       distance_at_rest_m(bite.exit_m, edge.at_rest));
      if (!(bite.edge_distance_m <= distance)) bite.edge_distance_m = distance;
    }
  return bite;
}

double QualityMeter::peak_force_of(const BiteFigures& bite, std::size_t thread) const {
  const int needle = needle_of_thread_[thread];
  if (needle < 0) return kNoFigure;
  double nearest_m = kSameEntry_m, peak_n = kNoFigure;
  for (const Passage& passage : needles_[at(needle)].passages) {
    const double distance = (passage.entry_m - bite.entry_m).norm();
    if (passage.tissue != bite.tissue || distance > nearest_m) continue;
    nearest_m = distance;
    peak_n = passage.peak_force_n;
  }
  return peak_n;
}

Vec3 QualityMeter::rest_of(const Vec3& p, int tissue,
                           std::span<const geometry::Vec3> positions_m) const {
  double best = -kOutsideMax;
  Vec3 rest = p;
  for (const geometry::Tet& tet : tets_[at(tissue)]) {
    const Vec3 &a = positions_m[at(tet[0])], &b = positions_m[at(tet[1])],
               &c = positions_m[at(tet[2])], &d = positions_m[at(tet[3])];
    // A point this far outside of the box is outside of the tet by more than its share.
    const Eigen::Array3d low = a.cwiseMin(b).cwiseMin(c.cwiseMin(d)).array();
    const Eigen::Array3d high = a.cwiseMax(b).cwiseMax(c.cwiseMax(d)).array();
    const Eigen::Array3d slack = kOutsideMax * (high - low) * 3.0;
    if ((p.array() < low - slack).any() || (p.array() > high + slack).any()) continue;
    Eigen::Matrix3d edges;
    edges << b - a, c - a, d - a;
    const Vec3 weight = edges.inverse() * (p - a);
    const double least = std::min(weight.minCoeff(), 1.0 - weight.sum());
    if (!(least > best)) continue;
    best = least;
    rest = (1.0 - weight.sum()) * rest_m_[at(tet[0])] + weight[0] * rest_m_[at(tet[1])] +
           weight[1] * rest_m_[at(tet[2])] + weight[2] * rest_m_[at(tet[3])];
  }
  return rest;
}

double QualityMeter::distance_at_rest_m(const Vec3& p, const geometry::TriangleTree& tree) const {
  const auto nearest = tree.nearest(p, kAnywhere_m, rest_m_);
  return nearest ? std::sqrt(nearest->closest.squared_distance_m2) : kNoFigure;
}

}  // namespace sutured::simulation
