// SPDX-License-Identifier: GPL-3.0-or-later
// How well somebody sews: the figures that a trainer would judge, from what a simulation shows.
//
// Two calls, because they cost differently:
//
//   watch     after each step     ways, peaks, hand-overs: a few sums
//   measure   when somebody asks  the wound's gap, bites: surface searches; wants displacements
//
// The gap between two edges a, b of a wound, with d(x, e) the distance of x from the triangles of
// e,
//
//     max, mean of { d(x, b) : x a vertex of a } ∪ { d(x, a) : x a vertex of b }
//
// over the vertices that lie opposite the other edge at rest: vessels of different diameters
// overhang each other, and what overhangs has nothing to close against.
//
// A bite is a passage of a thread through a tissue, entered where its needle went in. It is judged
// at rest, so that a pull on the thread does not change it:
//
//     depth   = max over the course c of d(X(c), surface of its tissue)   X: material point at rest
//     edge    = min over entry and exit of d(X, edge of the wound in its tissue)
//     spacing = |X(entry) − X(entry of the bite before in the same tissue)|
//
// Where there is no figure (no wound, a first bite, nobody gave a stress) it is NaN.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "geometry/triangle_tree.hpp"
#include "needle/curve.hpp"
#include "scene/scene.hpp"
#include "simulation/simulation.hpp"

namespace sutured::simulation {

inline constexpr double kNoFigure = std::numeric_limits<double>::quiet_NaN();

/// The distance between the edges of a wound; NaN where there is none.
struct WoundGap {
  double mean_m = kNoFigure;
  double max_m = kNoFigure;
};

/// Mean and standard deviation (of these values, divided by their count); NaN of none.
struct Spread {
  double mean = kNoFigure;
  double deviation = kNoFigure;
};

/// One passage of a thread through a tissue, from where the needle went in. World, at rest.
struct BiteFigures {
  int tissue = -1;  ///< index into Scene::tissues
  Vec3 entry_m = Vec3::Zero();
  Vec3 exit_m = Vec3::Zero();
  double depth_m = 0.0;
  double edge_distance_m = kNoFigure;
  double spacing_m = kNoFigure;
  /// Largest force of a tool that held the needle, from its touch of the tissue to its tip's exit;
  /// NaN of a bite that a scene starts with.
  double peak_force_n = kNoFigure;
};

/// The figures of one thread and its needle.
struct ThreadQuality {
  double elapsed_s = 0.0;      ///< simulated, since the start or the last reset
  double needle_path_m = 0.0;  ///< length of the way of the needle's tip
  /// Largest force of a tool while it works on tissue: with this needle in it, against it or
  /// pulling this thread, with this thread in the jaw, with the jaw on a tissue, or as a probe
  /// that touches.
  double peak_force_n = 0.0;
  double peak_principal_stress_pa = kNoFigure;
  WoundGap gap_start, gap;  ///< at rest and at the last `measure`; of several wounds the widest
  double tension_n = 0.0;
  Spread depth_m, spacing_m;       ///< of the bites
  std::uint32_t handovers = 0;     ///< another tool has the needle; tissue may have had it between
  std::uint32_t needle_drops = 0;  ///< times that neither a tool nor tissue had it any more
  std::vector<BiteFigures> bites;  ///< in the order in which they were made
};

/// Says whether somebody who reads both would see a difference: in a count, a bite, or a figure by
/// more than 1 µm, 0.1 mN or 1 Pa. Time alone makes none.
[[nodiscard]] bool differs(const ThreadQuality& a, const ThreadQuality& b);

/// What the meter sees of a simulation.
struct QualityView {
  double time_s = 0.0;
  std::span<const ToolResponse> responses;
  std::span<const NeedleState> needles;
  std::span<const ThreadState> threads;
  std::span<const Event> events;
  std::span<const geometry::Vec3> positions_m;
};
[[nodiscard]] QualityView quality_view(const Simulation& simulation);

/// Returns the largest principal stress at a vertex of the tissues' surfaces (Pa), the one that
/// viewers see.
[[nodiscard]] double peak_principal_stress_pa(const StressField& stress,
                                              std::span<const Body> bodies);

/// Returns mean and standard deviation of those of `values` that are numbers.
[[nodiscard]] Spread spread_of(std::span<const double> values);

/// Watches a simulation. It has no clock: times are the simulation's.
///
/// Thread: the simulation's. `watch` allocates where a needle punctures, `measure` where there are
/// new bites. Cost of `measure`: a search per vertex of the wounds' edges, some 16 a new bite.
class QualityMeter {
 public:
  /// Bites beyond this number of a thread are not measured.
  static constexpr std::size_t kBitesMax = 256;

  QualityMeter(const scene::Scene& scene, const Simulation& simulation);

  /// Takes in one step; call after each.
  void watch(const QualityView& view);
  /// Takes in `peak_principal_stress_pa` as it is now, at whatever rate it is known.
  void note_principal_stress(double stress_pa);
  /// Measures gaps and bites. The displacements must be up to date
  /// (Simulation::update_displacements).
  void measure(const QualityView& view);
  /// Returns to the state after construction.
  void reset();
  void serialize(Archive& archive);

  [[nodiscard]] std::span<const ThreadQuality> threads() const { return threads_; }
  /// Per wound of the scene: its gap at rest, and at the last `measure`.
  [[nodiscard]] std::span<const WoundGap> gaps_at_rest() const { return gaps_at_rest_; }
  [[nodiscard]] std::span<const WoundGap> gaps() const { return gaps_; }

 private:
  /// One edge of a wound with vertices counted over all bodies.
  struct Edge {
    int tissue = -1;
    std::vector<std::int32_t> vertices;
    geometry::TriangleTree now, at_rest;
  };
  using Wound = std::array<Edge, 2>;
  /// A needle's tip on its way through a tissue.
  struct Passage {
    int tissue = -1;
    Vec3 entry_m = Vec3::Zero();  ///< at rest
    double peak_force_n = 0.0;
    bool open = true;
  };
  struct Needle {
    needle::Curve curve;
    bool seen = false;
    Vec3 tip_m = Vec3::Zero();
    double path_m = 0.0;
    double approach_peak_n = 0.0;  ///< since the tip touches, before it goes in
    int keeper = -1;  ///< tool that held it last, −1 before the first and after a drop
    std::uint32_t handovers = 0, drops = 0;
    std::vector<Passage> passages;
    void serialize(Archive& archive);
  };

  void watch_needle(const QualityView& view, std::size_t needle);
  void watch_holders(const QualityView& view, std::size_t needle);
  void watch_passages(const QualityView& view, std::size_t needle);
  [[nodiscard]] double force_on_tissue_n(const QualityView& view, std::size_t thread) const;
  void measure_bites(const ThreadState& state, std::span<const geometry::Vec3> positions_m,
                     std::size_t thread);
  [[nodiscard]] BiteFigures measure_bite(const ThreadState& state, const ThreadPuncture& entry,
                                         const ThreadPuncture& exit,
                                         std::span<const geometry::Vec3> positions_m) const;
  [[nodiscard]] double peak_force_of(const BiteFigures& bite, std::size_t thread) const;
  void keep_opposite(Wound& wound) const;
  [[nodiscard]] WoundGap gap_of(const Wound& wound, std::span<const geometry::Vec3> positions_m,
                                geometry::TriangleTree Edge::*tree) const;
  [[nodiscard]] WoundGap widest(std::span<const WoundGap> gaps) const;
  /// Where a point of a tissue's inside or surface lies at rest; `p` itself where it is in no tet.
  [[nodiscard]] Vec3 rest_of(const Vec3& p, int tissue,
                             std::span<const geometry::Vec3> positions_m) const;
  [[nodiscard]] double distance_at_rest_m(const Vec3& p, const geometry::TriangleTree& tree) const;

  std::vector<std::string> needle_names_, tissue_names_;
  std::vector<int> needle_of_thread_;                     ///< −1: none
  std::vector<std::vector<geometry::Tet>> tets_;          ///< per tissue
  std::vector<geometry::TriangleTree> surfaces_at_rest_;  ///< per tissue
  std::vector<geometry::Vec3> rest_m_;
  std::vector<Wound> wounds_;
  std::vector<WoundGap> gaps_at_rest_, gaps_;
  std::vector<Needle> needles_;
  std::vector<ThreadQuality> threads_;
  std::vector<double> scratch_;
};

}  // namespace sutured::simulation
