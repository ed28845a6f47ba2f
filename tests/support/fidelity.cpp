// SPDX-License-Identifier: GPL-3.0-or-later
#include "support/fidelity.hpp"

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <stdexcept>

#include "haptics/model_builder.hpp"
#include "protocol/force_shaping.hpp"
#include "protocol/surgeon.hpp"
#include "scene/scene_reader.hpp"
#include "support/closure_scene.hpp"

namespace sutured::testing {
namespace {

using geometry::Vec3;
using simulation::ToolInput;
using simulation::Vec6;

constexpr double kTick_s = 1e-3;
constexpr std::int64_t kTick_ns = 1'000'000;
constexpr std::int64_t kBlend_ns = 4 * kTick_ns;  // as the server and the SDK blend
constexpr double kTwoPi = 2.0 * std::numbers::pi;

Vec6 vector_of(const suture::Wrench& w) {
  Vec6 v;
  v << w.force_n[0], w.force_n[1], w.force_n[2], w.torque_nm[0], w.torque_nm[1], w.torque_nm[2];
  return v;
}

suture::Pose pose_of(const ToolInput& input) {
  const auto& p = input.position_m;
  const auto& q = input.orientation;
  return {{p.x(), p.y(), p.z()}, {q.x(), q.y(), q.z(), q.w()}};
}

/// The poses of the tools that a model is coupled to, as `evaluate` takes them.
class OtherPoses {
 public:
  [[nodiscard]] std::span<const suture::Pose> of(const suture::HapticModel& model,
                                                 std::span<const ToolInput> inputs) {
    for (int k = 0; k < model.other_count; ++k)
      poses_[static_cast<std::size_t>(k)] =
          pose_of(inputs[static_cast<std::size_t>(model.others[k].tool)]);
    return {poses_.data(), static_cast<std::size_t>(model.other_count)};
  }

 private:
  std::array<suture::Pose, suture::kModelOthersMax> poses_;
};

/// To and fro from zero: at rest at t = 0, as fast as `speed_m_per_s` between.
double to_and_fro_m(double time_s, double frequency_hz, double speed_m_per_s) {
  const double amplitude_m = speed_m_per_s / (kTwoPi * frequency_hz);
  return amplitude_m * (1.0 - std::cos(kTwoPi * frequency_hz * time_s));
}

/// Returns `from` turned with the first needle's circle, `distance_m` along it, about a centre
/// that lies `off_m` beside the circle's own.
ToolInput along_needle(const Hands& prepared, const ToolInput& from, double distance_m,
                       double off_m = 0.0) {
  const needle::Curve curve = needle::Curve::of(prepared.scene.needles[0]);
  const auto& state = prepared.sim.needles()[0];
  const scene::Pose pose{state.position_m + off_m * Vec3::UnitX(), state.orientation};
  const Vec6 twist = curve.slide_twist(pose) * distance_m;
  const scene::Pose moved = needle::moved({pose.position_m, Eigen::Quaterniond::Identity()}, twist);
  ToolInput input = from;
  input.position_m = moved.position_m + moved.orientation * (from.position_m - pose.position_m);
  input.orientation = (moved.orientation * from.orientation).normalized();
  return input;
}

/// The anastomosis, played by the driver's one bite until `until_s`, then still for a while.
struct OneBite {
  scene::Scene scene;
  suture::Surgeon surgeon;
  OneBite() {
    const std::string folder = std::string(SUTURED_SOURCE_DIR) + "/server/scenes/anastomosis/";
    scene = scene::read_scene(folder + "scene.toml");
    surgeon = suture::read_surgeon(folder + "one_bite.csv");
    if (surgeon.track("driver") == nullptr) throw std::runtime_error("one_bite.csv has no driver");
  }
  [[nodiscard]] std::function<void(Hands&)> until(double until_s) const {
    return [track = *surgeon.track("driver"), until_s](Hands& hands) {
      const int steps = static_cast<int>(std::lround(until_s / hands.step_s));
      for (int k = 0; k <= steps; ++k) {
        const suture::SurgeonPose at = track.at(k * hands.step_s);
        ToolInput& input = hands.at(0);
        input.present = true;
        input.position_m = {at.position_m[0], at.position_m[1], at.position_m[2]};
        input.orientation = Eigen::Quaterniond(at.orientation_xyzw[3], at.orientation_xyzw[0],
                                               at.orientation_xyzw[1], at.orientation_xyzw[2]);
        input.jaw = at.jaw;
        hands.step();
      }
      hands.step(100);
    };
  }
};

/// Two sewn vessels whose thread ends in the driver's hand.
FidelityMotion thread_pull() {
  FidelityMotion motion;
  motion.name = "thread";
  motion.title = "thread pulled through 8 punctures, 1 Hz, 53 mm/s";
  motion.scene = hand_sewn_scene(8);
  motion.prepare = [](Hands& hands) {
    hands.step();
    const Vec3 last = hands.thread().punctures.front().position_m;
    hands.grasp(0, last);
    if (hands.response(0).held.kind != simulation::HeldKind::kThread)
      throw std::runtime_error("the driver did not grasp the thread");
    hands.move_by(0, {0.006, 0.0, 0.0}, 0.02);
    hands.step(100);
  };
  motion.move = [](double t, const Hands& prepared, std::span<ToolInput> inputs) {
    inputs[0].position_m =
        prepared.inputs[0].position_m + to_and_fro_m(t, 1.0, 0.053) * Vec3(1.0, 0.0, 0.0);
  };
  return motion;
}

/// Peaks and sums of one predictor.
class ErrorSum {
 public:
  void add(const Vec6& error) {
    force_sum_ += error.head<3>().squaredNorm();
    torque_sum_ += error.tail<3>().squaredNorm();
    force_max_ = std::max(force_max_, error.head<3>().norm());
    ++count_;
  }
  [[nodiscard]] FidelityError over(double peak_force_n, double peak_torque_nm) const {
    const double n = std::max(count_, 1);
    return {100.0 * std::sqrt(force_sum_ / n) / peak_force_n, 100.0 * force_max_ / peak_force_n,
            peak_torque_nm > 0.0 ? 100.0 * std::sqrt(torque_sum_ / n) / peak_torque_nm : 0.0};
  }

 private:
  double force_sum_ = 0.0, torque_sum_ = 0.0, force_max_ = 0.0;
  int count_ = 0;
};

struct Snapshot {
  suture::HapticModel model;
  Vec6 wrench;
  int tick = 0;
};

void take(const simulation::ToolResponse& response, int tick, Snapshot& snapshot) {
  snapshot.model = {};
  snapshot.model.epoch = 1;
  snapshot.model.sequence = static_cast<std::uint64_t>(tick) + 1;
  haptics::fill_model(response, snapshot.model);
  snapshot.wrench = response.wrench;
  snapshot.tick = tick;
}

}  // namespace

std::vector<FidelityMotion> fidelity_motions() {
  std::vector<FidelityMotion> motions;
  const OneBite bite;
  const auto on_vessels = [&](const char* name, const char* title, double until_s) {
    FidelityMotion motion;
    motion.name = name;
    motion.title = title;
    motion.scene = bite.scene;
    motion.prepare = bite.until(until_s);
    return motion;
  };

  FidelityMotion needle =
      on_vessels("needle", "needle through both walls along its way, 1 Hz, 20 mm/s", 5.4);
  needle.move = [](double t, const Hands& prepared, std::span<ToolInput> inputs) {
    // As a hand does it: about a centre that is 1 mm off the arc's own.
    inputs[0] = along_needle(prepared, prepared.inputs[0], to_and_fro_m(t, 1.0, 0.020), 1e-3);
  };
  motions.push_back(needle);

  FidelityMotion sideways =
      on_vessels("sideways", "needle through both walls, sideways, 2 Hz, 30 mm/s", 5.4);
  sideways.move = [](double t, const Hands& prepared, std::span<ToolInput> inputs) {
    inputs[0].position_m =
        prepared.inputs[0].position_m + to_and_fro_m(t, 2.0, 0.030) * Vec3(0.0, 1.0, 0.0);
  };
  motions.push_back(sideways);

  FidelityMotion tip = on_vessels("tip", "tip on a wall, before it enters, 1 Hz, 3.5 mm/s", 2.65);
  tip.move = [](double t, const Hands& prepared, std::span<ToolInput> inputs) {
    inputs[0] = along_needle(prepared, prepared.inputs[0], to_and_fro_m(t, 1.0, 0.0035));
  };
  motions.push_back(tip);

  motions.push_back(thread_pull());

  FidelityMotion two = on_vessels(
      "two_hands", "driver's needle in both walls, assistant lifts a fold beside it, 30 mm/s", 5.4);
  two.prepare = [first = two.prepare](Hands& hands) {
    first(hands);
    // On the proximal vessel's outer wall, 4 mm beside the bite.
    hands.grasp(1, {0.006 * std::cos(0.6), 0.006 * std::sin(0.6), -0.003});
    if (hands.response(1).held.kind != simulation::HeldKind::kTissue)
      throw std::runtime_error("the assistant did not grasp the wall");
    hands.step(100);
  };
  two.move = [](double t, const Hands& prepared, std::span<ToolInput> inputs) {
    inputs[0].position_m =
        prepared.inputs[0].position_m + to_and_fro_m(t, 1.0, 0.010) * Vec3(0.0, 1.0, 0.0);
    inputs[1].position_m = prepared.inputs[1].position_m +
                           to_and_fro_m(t, 2.0, 0.030) * Vec3(std::cos(0.6), std::sin(0.6), 0.0);
  };
  motions.push_back(two);
  return motions;
}

FidelityResult measure_fidelity(const FidelityMotion& motion, const FidelityOptions& options) {
  Hands hands(motion.scene, kTick_s);
  motion.prepare(hands);
  Hands prepared(motion.scene, kTick_s);
  motion.prepare(prepared);
  const auto tool = static_cast<std::size_t>(motion.tool);

  FidelityResult result;
  suture::ModelEvaluator evaluator;
  suture::SwapBlend blend;
  auto before = std::make_unique<Snapshot>(), used = std::make_unique<Snapshot>(),
       newest = std::make_unique<Snapshot>();
  int swaps = 0;
  Vec6 last_truth = Vec6::Zero(), last_shown = Vec6::Zero();
  std::int64_t blend_end_ns = -1;
  OtherPoses others;
  const auto evaluate = [&](std::int64_t now_ns) {
    const suture::HapticModel& model = used->model;
    return evaluator.evaluate(
        model, pose_of(hands.inputs[tool]),
        options.couple_tools ? others.of(model, hands.inputs) : std::span<const suture::Pose>(),
        now_ns);
  };
  const int ticks = static_cast<int>(std::lround(motion.duration_s / kTick_s));
  for (int k = 0; k <= ticks; ++k) {
    motion.move(k * kTick_s, prepared, hands.inputs);
    hands.step();
    const simulation::ToolResponse& response = hands.sim.responses()[tool];
    const Vec6 truth = response.wrench;
    const std::int64_t now_ns = k * kTick_ns;
    result.rows_max =
        std::max(result.rows_max, static_cast<int>(response.condensed.offset_m.size()));
    result.frozen_rows_max = std::max(result.frozen_rows_max, response.condensed.frozen_rows);

    if (k % options.model_period_ms == 0) {
      const suture::Wrench old =
          swaps >= 2 ? blend.apply(evaluate(now_ns), now_ns) : suture::Wrench{};
      std::swap(before, used);
      std::swap(used, newest);
      take(response, k, *newest);
      ++swaps;
      if (swaps >= 3) {
        const suture::Wrench next = evaluate(now_ns);
        blend.swap(old, next, now_ns, kBlend_ns);
        blend_end_ns = now_ns + kBlend_ns;
        result.swap_jump_n =
            std::max(result.swap_jump_n, (vector_of(next) - vector_of(old)).head<3>().norm());
      }
    }
    if (swaps < 2) continue;
    const Vec6 shown = vector_of(blend.apply(evaluate(now_ns), now_ns));
    if (swaps < 3) {
      last_truth = truth;
      last_shown = shown;
      continue;
    }
    if (now_ns <= blend_end_ns)
      result.swap_step_n = std::max(result.swap_step_n,
                                    ((shown - last_shown) - (truth - last_truth)).head<3>().norm());
    last_truth = truth;
    last_shown = shown;
    const double age = static_cast<double>(k - used->tick) / (used->tick - before->tick);
    result.samples.push_back({k * kTick_s, truth, shown, used->wrench,
                              used->wrench + age * (used->wrench - before->wrench)});
  }

  ErrorSum model, held, linear;
  for (const FidelitySample& s : result.samples) {
    result.peak_force_n = std::max(result.peak_force_n, s.truth.head<3>().norm());
    result.peak_torque_nm = std::max(result.peak_torque_nm, s.truth.tail<3>().norm());
    model.add(s.model - s.truth);
    held.add(s.held - s.truth);
    linear.add(s.linear - s.truth);
  }
  result.model = model.over(result.peak_force_n, result.peak_torque_nm);
  result.held = held.over(result.peak_force_n, result.peak_torque_nm);
  result.linear = linear.over(result.peak_force_n, result.peak_torque_nm);
  result.fallbacks = evaluator.fallbacks();
  return result;
}

FidelityError measure_total_error(const FidelityMotion& motion, const FidelityResult& reference,
                                  double rate_hz) {
  Hands prepared(motion.scene, kTick_s);
  motion.prepare(prepared);
  Hands hands(motion.scene, kTick_s);
  motion.prepare(hands);
  const auto tool = static_cast<std::size_t>(motion.tool);
  const int per_step = static_cast<int>(std::lround(1.0 / (rate_hz * kTick_s)));
  suture::ModelEvaluator evaluator;
  auto used = std::make_unique<Snapshot>(), newest = std::make_unique<Snapshot>();
  hands.step_s = per_step * kTick_s;
  std::vector<ToolInput> at = hands.inputs;
  OtherPoses others;
  ErrorSum error;
  std::size_t next = 0;
  const int ticks = static_cast<int>(std::lround(motion.duration_s / kTick_s));
  for (int k = 0; k <= ticks; ++k) {
    motion.move(k * kTick_s, prepared, at);
    if (k % per_step == 0) {
      hands.inputs = at;
      hands.step();
      std::swap(used, newest);
      take(hands.sim.responses()[tool], k, *newest);
    }
    while (next < reference.samples.size() && reference.samples[next].time_s < (k - 0.5) * kTick_s)
      ++next;
    if (next >= reference.samples.size() || k < reference.samples[0].time_s / kTick_s - 0.5)
      continue;
    error.add(vector_of(evaluator.evaluate(used->model, pose_of(at[tool]),
                                           others.of(used->model, at), k * kTick_ns)) -
              reference.samples[next].truth);
  }
  return error.over(reference.peak_force_n, reference.peak_torque_nm);
}

}  // namespace sutured::testing
