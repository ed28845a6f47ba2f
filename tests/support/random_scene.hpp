// SPDX-License-Identifier: GPL-3.0-or-later
// Scenes at random from a seed: small tissues, a needle above them, threads, two hands and a probe.
#pragma once

#include <cstdint>
#include <random>
#include <span>
#include <string>

#include "scene/scene.hpp"

namespace sutured::testing {

/// Draws from a seed; the same draws on every run.
class Random {
 public:
  explicit Random(std::uint64_t seed) : engine_(seed) {}
  /// Returns a number in [low, high).
  double in(double low, double high) {
    return low + (high - low) * (static_cast<double>(engine_() >> 11) * 0x1.0p-53);
  }
  /// Returns an integer in [0, count).
  int below(int count) { return static_cast<int>(in(0.0, static_cast<double>(count))); }
  bool chance(double share) { return in(0.0, 1.0) < share; }
  geometry::Vec3 direction() {
    geometry::Vec3 d;
    do d = geometry::Vec3(in(-1, 1), in(-1, 1), in(-1, 1));
    while (d.norm() > 1.0 || d.norm() < 0.1);
    return d.normalized();
  }
  template <class Value>
  Value one_of(std::initializer_list<Value> values) {
    return values.begin()[below(static_cast<int>(values.size()))];
  }

 private:
  std::mt19937_64 engine_;
};

enum class RandomTissue { kBlock, kTubes, kSlit };

/// Returns the point of a tissue's boundary nearest to `target_m`, at rest.
[[nodiscard]] scene::Bite nearest_on_surface(const scene::Scene& scene, int tissue,
                                             const geometry::Vec3& target_m);

/// Returns tissue of one of three kinds, with random material and gap: a block fixed below, two
/// tubes end to end with a gap, two blocks with a slit between. Up to some 350 vertices.
[[nodiscard]] scene::Scene random_tissue(Random& random, RandomTissue kind);

/// Returns punctures of `stitches` bites: over the gap, where there is one, two bites a stitch.
[[nodiscard]] std::vector<scene::Bite> random_stitches(Random& random, const scene::Scene& scene,
                                                       RandomTissue kind, int stitches);

/// Places the needle with its tip before the surface, pointing in; an arc bows towards the gap.
void place_needle(Random& random, RandomTissue kind, scene::Needle& needle);

/// Returns a whole scene: tissue, a needle (straight or arc), threads or none, tools `driver`,
/// `assistant` and `probe`. Contact is on in most.
[[nodiscard]] scene::Scene random_scene(std::uint64_t seed);

}  // namespace sutured::testing
