// SPDX-License-Identifier: GPL-3.0-or-later
// The server's haptic tick, a pose in and a force out, with 8, 32 and 64 unilateral rows (as many
// as a model holds) and a hand that makes them switch.
#include <algorithm>
#include <cmath>
#include <memory>
#include <random>

#include "bench/figures.hpp"
#include "haptics/tool_channel.hpp"
#include "scene/scene.hpp"
#include "support/heap_guard.hpp"

namespace sutured::bench {
namespace {

using haptics::kMillisecond_ns;
constexpr std::int64_t kPeriod_ns = 4 * kMillisecond_ns;
constexpr int kTip = 0;  // its row; two of friction follow

/// Tissue in contact all round the tool: compliances as of a wall of a vessel (30 N/m), rows
/// that share half of it, normals in all directions, a third of the gaps closed; a tip that
/// pierces at 50 mN, and its friction.
std::unique_ptr<suture::HapticModel> contact_all_round(int rows, std::mt19937_64& random) {
  std::normal_distribution<double> normal;
  auto model = std::make_unique<suture::HapticModel>();
  model->epoch = 1;
  model->period_ns = kPeriod_ns;
  model->touching = true;
  model->rows = rows;
  std::vector<std::array<double, 24>> shape(rows);
  for (int i = 0; i < rows; ++i) {
    for (double& x : shape[i]) x = normal(random);
    double norm = 0.0;
    std::array<double, 3> direction{};
    for (double& x : direction) norm = std::hypot(norm, x = normal(random));
    for (std::size_t axis = 0; axis < 3; ++axis) {
      model->jacobian[i][axis] = direction[axis] / norm;
      model->jacobian[i][3 + axis] = 2e-3 * normal(random);
    }
    model->offset_m[i] = 2e-4 * (normal(random) - 0.4);
    model->multiplier_max_n[i] = i == kTip ? 0.05 : HUGE_VAL;
    if (i == kTip + 1 || i == kTip + 2) {
      model->multiplier_max_n[i] = 0.01;
      model->bound_row[i] = kTip;
      model->bound_slope[i] = 0.2;
    }
    for (int j = 0; j <= i; ++j) {
      double shared = 0.0;
      for (std::size_t k = 0; k < shape[i].size(); ++k) shared += shape[i][k] * shape[j][k];
      model->compliance_m_per_n[suture::packed_index(i, j)] =
          0.03 / 24 * 0.5 * shared + (i == j ? 0.015 : 0.0);
    }
  }
  return model;
}

/// Brings the caches to where other work of a millisecond leaves them.
class OtherWork {
 public:
  void run() {
    for (std::size_t i = 0; i < bytes_.size(); i += 64)
      bytes_[i] = static_cast<char>(bytes_[i] + 1);
  }

 private:
  std::vector<char> bytes_ = std::vector<char>(8U << 20U);
};

struct Ticks {
  std::vector<double> us;  // each in its place; not rendering: missing
  std::uint64_t allocations = 0, pivots_exhausted = 0;
};

/// Plays the same hand and the same models, however often.
Ticks play(int rows) {
  constexpr int kTicks = 20000, kSettling = 300;
  std::mt19937_64 random(1);
  haptics::ToolChannel channel(scene::Tool{}, kPeriod_ns);
  const auto model = contact_all_round(rows, random);
  OtherWork other;
  Ticks result;
  result.us.reserve(kTicks);
  std::int64_t now = 1'000 * kMillisecond_ns;
  haptics::PoseSample pose;
  pose.writer = 1;
  for (int tick = 0; tick < kSettling + kTicks; ++tick) {
    now += kMillisecond_ns;
    if (tick % 4 == 0) {
      // The world goes along with the hand only slowly, so that the motion within a model is
      // what 30 mm/s make of a late one.
      ++model->sequence;
      model->reference.position_m[0] = 1e-4 * std::sin(1e-3 * tick);
      suture::complete_model(*model);
      channel.publish_model(*model, now, now);
    }
    const double t = 1e-3 * tick;
    pose.sequence = static_cast<std::uint64_t>(tick) + 1;
    pose.pose.position_m = {5e-4 * std::sin(40 * t), 5e-4 * std::sin(47 * t + 1),
                            5e-4 * std::sin(53 * t + 2)};
    other.run();
    const testing::HeapGuard heap;
    std::optional<haptics::ForceSample> force;
    const double took_us = time_us([&] { force = channel.on_pose(pose, now); });
    result.allocations += heap.allocations();
    if (tick >= kSettling && force && force->state == haptics::ToolState::kRendering)
      result.us.push_back(took_us);
  }
  if (result.us.size() < kTicks * 9 / 10)
    throw std::runtime_error("the tick was rendering in only " + std::to_string(result.us.size()) +
                             " of " + std::to_string(kTicks) + " ticks: nothing to measure");
  result.pivots_exhausted = channel.counters().of(haptics::Fault::kModelPivots);
  return result;
}

/// A tick's work is the least that it took in kPlays plays: what else the machine does can only
/// add, and adds to other ticks each time. `seen` is the same quantile with all of that, in the
/// play where it was lowest.
void measure_tick(Figures& figures, int rows) {
  constexpr int kPlays = 3;
  Ticks work = play(rows);
  double seen_us = INFINITY;
  const auto look = [&](std::vector<double> us) {
    seen_us = std::min(seen_us, quantile(us, 0.999));
  };
  look(work.us);
  for (int i = 1; i < kPlays; ++i) {
    const Ticks again = play(rows);
    if (again.us.size() != work.us.size())
      throw std::runtime_error("the same hand and models rendered another number of ticks");
    look(again.us);
    for (std::size_t tick = 0; tick < work.us.size(); ++tick)
      work.us[tick] = std::min(work.us[tick], again.us[tick]);
    work.allocations += again.allocations;
  }
  const std::string size = ".m" + std::to_string(rows);
  const bool largest = rows == suture::kModelRowsMax;
  figures.add("tick_us" + size + ".p50", quantile(work.us, 0.5), "us");
  figures.add("tick_us" + size + ".p99", quantile(work.us, 0.99), "us");
  figures.add("tick_us" + size + ".p999", quantile(work.us, 0.999), "us",
              largest ? std::optional(100.0) : std::nullopt);
  figures.add("tick_us" + size + ".max", work.us.back(), "us");
  figures.add("tick_us" + size + ".seen.p999", seen_us, "us");
  figures.add("tick_allocations" + size, static_cast<double>(work.allocations), "", 0.0);
  figures.add("tick_pivots_exhausted" + size, static_cast<double>(work.pivots_exhausted), "");
}

}  // namespace

void measure_tick(Figures& figures) {
  for (const int rows : {8, 32, suture::kModelRowsMax}) measure_tick(figures, rows);
}

}  // namespace sutured::bench
